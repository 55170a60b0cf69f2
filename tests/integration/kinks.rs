//! Loads with events by the error-controlled methods: no contact is missed, outputs between steps are correct, work balances, and friction
//! that holds creeps only as its law predicts.

use fivebar::effects::Mode;
use fivebar::integrator::{Implicit, i3alp};
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::{Method, Parameters, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{dense_methods, enable, methods_with_events, tip, tip_error};

/// A machine with motors 10 cm apart, without gravity.
fn close_motors(theta: [f64; 2], omega: [f64; 2]) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.effects.gravity.enabled = false;
    parameters.start.theta = theta;
    parameters.start.omega = omega;
    parameters.settings.method = Method::Dop853;
    parameters
}

/// A plane; n·(x, y) ≥ offset is free.
fn plane(parameters: &mut Parameters, [nx, ny]: [f64; 2], offset: f64, [k, d, width]: [f64; 3]) {
    enable(parameters, "contact");
    let contact = &mut parameters.effects.contact;
    (contact.nx, contact.ny, contact.offset) = (nx, ny, offset);
    (contact.k, contact.d, contact.width) = (k, d, width);
}

/// A slow motion that touches a plane of 100 kN/m with a ramp of 1 µm, against an independent program in 80-bit arithmetic. The contact is
/// short: the stages of a step may miss it while the extra evaluations for the interpolant meet it, and then outputs are up to 0.3 m off
/// (291 of 600 points).
#[test]
fn outputs_between_steps_are_the_motion() {
    let mut parameters = close_motors([2.305042384925536, 0.6405545940084515], [0.01947391254988405, 0.03608366856835523]);
    let normal = [-0.7832714430806205, -0.6216798584918144];
    let damping = parameters.effects.contact.d;
    plane(&mut parameters, normal, -0.16940637383204865, [1e5, damping, 1e-6]);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    for call in 1..=600 {
        simulation.advance(&default_inputs(), 8.08 / 600.0, 1).expect("a step");
        let state = simulation.state();
        let energy = state.kinetic_energy(simulation.model()) + state.core.work.dissipated;
        // The initial energy is 9.308e-7 J; energy taken by a contact counts as dissipated.
        assert!((energy - 9.308e-7).abs() < 1e-10, "call {call}: {energy:e} J");
        if call == 513 {
            // The reference has four digits.
            assert!(tip_error(&simulation, [0.0328, 0.2299]) < 1e-4, "{:?}", tip(&simulation));
        }
    }
}

/// Slow contacts, 1 to 50 µm deep; a missed one would cause a large error. The reference is the same method at 1e-13 rad, which agrees with
/// quadruple precision in every scene of this kind (`effects_reference.rs`, `cargo xtask report`).
#[test]
fn no_slow_touch_is_missed() {
    let mut touches = 0;
    for seed in 0..40 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
        let theta = [uniform(1.8, 2.4), uniform(0.7, 1.3)];
        let omega = [uniform(-0.05, 0.05), uniform(-0.05, 0.05)];
        let (duration, angle) = (uniform(4.0, 9.0), uniform(0.0, std::f64::consts::TAU));
        let (depth, k) = (1e-6 * 50_f64.powf(uniform(0.0, 1.0)), 1e5 * 100_f64.powf(uniform(0.0, 1.0)));
        let mut parameters = close_motors(theta, omega);
        let normal = [angle.cos(), angle.sin()];

        // The free motion, and its reach in this direction.
        let mut free = Simulation::new(&parameters, &default_inputs()).expect("a scene");
        let mut reach = f64::INFINITY;
        for _ in 0..2000 {
            free.advance(&default_inputs(), duration / 2000.0, 1).expect("a step");
            let [x, y] = tip(&free);
            reach = reach.min(normal[0] * x + normal[1] * y);
        }
        let damping = if seed % 3 == 0 { 0.0 } else { 5.0 };
        let width = if seed % 2 == 0 { 1e-6 } else { 1e-4 };
        plane(&mut parameters, normal, reach + depth, [k, damping, width]);

        let nudged_end = |nudge: f64, method: Method, tolerance: f64, calls: u64| {
            let mut parameters = parameters.clone();
            (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
            parameters.start.theta[0] += nudge;
            let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
            for _ in 0..calls {
                simulation.advance(&default_inputs(), duration / calls as f64, 1).expect("a step");
                let error = simulation.state().energy_error(simulation.model());
                // Bound for dop853: the error of the interpolant on a plane of up to 1e7 N/m.
                let allowed = if method == Method::Dop853 { 1e-9 } else { 1e-6 };
                assert!(error.abs() < allowed, "seed {seed}, {method:?}: {error:e} J");
            }
            simulation
        };
        let end = |method: Method, tolerance: f64, calls: u64| nudged_end(0.0, method, tolerance, calls);
        let (usual, exact) = (end(Method::Dop853, 3e-9, 600), end(Method::Dop853, 1e-13, 1));
        // A contact multiplies errors by the stiffness: several bounces turned 1e-9 m into 1e-6 m.
        let error = tip_error(&usual, tip(&exact));
        assert!(error < 1e-5, "seed {seed}: {error:e} m");
        // The second-order default method also tracks the motion, unless bounces multiply its errors, which grow like a perturbation of the
        // start.
        let default = tip_error(&end(Method::I3alp, 3e-9, 600), tip(&exact));
        if default > 2e-4 {
            let nudged = tip_error(&nudged_end(1e-7, Method::Dop853, 1e-13, 1), tip(&exact));
            assert!(default < 100.0 * nudged, "seed {seed}: {default:e} m by i3alp, {nudged:e} m by a nudge");
        }
        touches += u32::from(tip_error(&exact, tip(&free)) > 1e-4);
    }
    assert!(touches >= 15, "only {touches} of 40 motions touch with any consequence");
}

/// A contact that lies entirely in one half of a sub-step of the default method: neither end touches, so checking only the ends would miss
/// it. At the looser tolerance one sub-step is the whole macro step, and only the bound in between detects the contact; also if one end
/// touches slightly (the first scene). Against dop853 at 1e-12 rad.
#[test]
fn a_touch_in_either_half_of_a_sub_step_is_met() {
    const LOOSE: f64 = 1e-6;
    let inputs = default_inputs();
    let step = 4e-3;
    for (place, k) in [(0.2, 1e5), (0.35, 1e6), (0.65, 1e5), (0.75, 1e5), (0.75, 1e7), (0.8, 1e6)] {
        // The free motion turns back in some direction at `place` of the first macro step: computed backwards from rest there.
        let mut free = close_motors([2.1, 0.9], [0.0; 2]);
        free.effects.gravity.enabled = true;
        let mut back = Simulation::new(&free, &inputs).expect("a scene");
        back.advance(&inputs, place * step, 1).expect("a step");
        let state = back.state();
        let rates = observers::motion(back.model(), &state).omega;
        let theta = state.angles();
        free.start.theta = [theta[0], theta[3]];
        free.start.omega = [-rates[0], -rates[3]];
        let turning = tip(&Simulation::new(&close_motors([2.1, 0.9], [0.0; 2]), &inputs).expect("a scene"));
        // The tip rises, turns and falls again: it meets a ceiling 2 µm below the highest point 0.6 ms before the turn.
        let mut scene = free.clone();
        plane(&mut scene, [0.0, -1.0], -turning[1] + 2e-6, [k, 0.0, 1e-6]);
        let end = |method: Method, tolerance: f64, parameters: &Parameters| {
            let mut parameters = parameters.clone();
            (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
            parameters.settings.step_size = step;
            let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
            simulation.advance(&inputs, step, 1).expect("a step");
            simulation
        };
        let exact = end(Method::Dop853, 1e-12, &scene);
        let without = tip_error(&end(Method::Dop853, 1e-12, &free), tip(&exact));
        assert_eq!(end(Method::I3alp, LOOSE, &free).counters().substeps, 1);
        for (tolerance, part) in [(3e-9, 1e-3), (LOOSE, 0.1)] {
            let error = tip_error(&end(Method::I3alp, tolerance, &scene), tip(&exact));
            assert!(error < part * without, "at {place}, {tolerance:e} rad: {error:e} m, without the touch {without:e} m");
        }
    }
}

/// A start inside a stop that separates: the energy left in its spring is dissipated, and dissipated energy never decreases. By the
/// independent program 2.4546e-2 J are dissipated in total.
#[test]
fn energy_left_in_a_stop_is_dissipated() {
    let mut parameters = close_motors([2.2, 0.9], [3.0, 0.0]);
    enable(&mut parameters, "stop");
    let stop = &mut parameters.effects.stop;
    (stop.lower[0], stop.k, stop.d) = (2.23, 50.0, 0.5);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    let mut dissipated = 0.0;
    for _ in 0..1000 {
        simulation.advance(&default_inputs(), 1e-3, 1).expect("a step");
        let state = simulation.state();
        assert!(state.core.work.dissipated >= dissipated, "{:e} J are taken back", dissipated - state.core.work.dissipated);
        dissipated = state.core.work.dissipated;
        let error = state.energy_error(simulation.model());
        // The error norm allows 3.6e-9 J per step, and some ten steps lose energy.
        assert!(error.abs() < 1e-8, "{error:e} J");
    }
    assert!((dissipated - 2.4546e-2).abs() < 1e-6, "{dissipated:e} J");
}

/// Separation near a vertex, where steps conserve energy: the energy left in a stop is dissipated there, too.
#[test]
fn energy_left_in_a_stop_near_a_vertex_is_dissipated() {
    // Through the vertex on its tangent cone: rates a, b, c of three links with a + b + c = 1 = a² + b² + c², and 1 of the fourth.
    let (sin, cos) = 0.7_f64.sin_cos();
    let (e1, e2) = (cos / 3.0_f64.sqrt(), sin / 3.0);
    let along = [1.0 / 3.0 + e1 + e2, 1.0 / 3.0 - e1 + e2, 1.0 / 3.0 - 2.0 * e2, 1.0];
    let vertex = [0.0, 0.0, std::f64::consts::PI, 0.0];
    let theta = std::array::from_fn(|i| vertex[i] - 3e-6 * along[i]);
    let omega = along.map(|rate| 20.0 * rate);
    let mut parameters = default_parameters();
    (parameters.settings.method, parameters.effects.gravity.enabled) = (Method::Dop853, false);
    enable(&mut parameters, "stop");
    let stop = &mut parameters.effects.stop;
    (stop.k, stop.d, stop.width) = (50.0, 100.0, 1e-3);
    (stop.lower, stop.upper) = ([theta[0] + 0.1, -9.0], [theta[0] + 3.0, 9.0]);
    let mut simulation = Simulation::at(&parameters, &default_inputs(), theta, omega).expect("a scene");
    for _ in 0..40 {
        simulation.advance(&default_inputs(), 3e-8, 1).expect("a step");
        let state = simulation.state();
        let error = state.energy_error(simulation.model());
        // In total 1.2e-4 J are dissipated. If the scaling of the rates to the energy ignored this loss, it would return it to the motion.
        assert!(error.abs() < 1e-9, "{error:e} J");
    }
    assert!(simulation.state().core.work.dissipated > 1e-4);
}

/// Kinks end steps, and communication points change nothing: the same bits with and without reading.
#[test]
fn kinks_do_not_depend_on_communication_points() {
    let mut parameters = close_motors([2.2, 0.9], [0.0; 2]);
    parameters.effects.gravity.enabled = true;
    plane(&mut parameters, [0.0, 1.0], 0.15, [1e4, 2.0, 1e-5]);
    let mut ends = [1, 50, 1000].map(|calls| {
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
        for _ in 0..calls {
            simulation.advance(&default_inputs(), 1e-3, 1000 / calls).expect("a step");
            simulation.state();
        }
        simulation.state().core
    });
    assert!(ends[0].work.dissipated > 1e-4, "the tip has met the floor");
    let first = ends[0];
    for core in &mut ends {
        assert_eq!((core.q, core.v, core.work), (first.q, first.v, first.work));
    }
}

/// Friction of 0.1 N·m in every joint holds the machine. It creeps as the smooth law predicts, 3.58e-5 rad in a second, and loses 4.87e-6 J
/// (by dop853 and by the independent program). An undamped trapezoidal rule rings at 370 rad/s², creeps 1.04e-3 rad the wrong way and
/// gains 1e-3 J, in 58,047 sub-steps.
#[test]
fn friction_that_holds_creeps_as_its_law_says() {
    let mut parameters = close_motors([2.2, 0.9], [0.0; 2]);
    parameters.effects.gravity.enabled = true;
    parameters.settings.method = Method::I3alp;
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    (friction.coulomb, friction.breakaway, friction.breakaway_velocity) = ([0.1; 5], [0.12; 5], 0.01);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    simulation.advance(&default_inputs(), 1e-3, 1000).expect("a second");
    let state = simulation.state();
    let moved = state.angles()[0] - 2.2;
    assert!((moved - 3.58122e-5).abs() < 1e-9, "moved by {moved:e} rad");
    assert!((state.core.work.dissipated - 4.86991e-6).abs() < 1e-10, "{:e} J", state.core.work.dissipated);
    assert!(state.energy_error(simulation.model()).abs() < 1e-10);
    // Errors of predicted accelerations ring below 1e-2 of the rates' tolerance, 3e-7 rad/s in 1 ms.
    assert!(state.core.a.max_norm() < 1e-4, "{:e} rad/s² at rest", state.core.a.max_norm());
    assert!(state.core.counters.substeps < 1100, "{} sub-steps", state.core.counters.substeps);
}

/// Creep is proportional to the breakaway velocity, here 1e-6 rad/s: 3.5814e-3 of it per second, as this method gives at 1e-3 and 1e-4 rad/s.
/// Without damping 160,000 sub-steps do not complete 30 ms.
#[test]
fn stiff_friction_creeps_as_well() {
    let mut parameters = close_motors([2.2, 0.9], [0.0; 2]);
    parameters.effects.gravity.enabled = true;
    parameters.settings.method = Method::I3alp;
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    (friction.coulomb, friction.breakaway, friction.breakaway_velocity) = ([0.1; 5], [0.12; 5], 1e-5);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    simulation.advance(&default_inputs(), 1e-3, 100).expect("a tenth of a second");
    let state = simulation.state();
    let moved = state.angles()[0] - 2.2;
    assert!((moved - 3.5814e-9).abs() < 0.01 * 3.5814e-9, "moved by {moved:e} rad");
    assert!(state.energy_error(simulation.model()).abs() < 1e-9);
    // Damped: z = hρ is some 1e5, for which an undamped trapezoidal rule rings at 1.7 rad/s².
    assert!(state.core.a.max_norm() < 1e-4, "{:e} rad/s² at rest", state.core.a.max_norm());
    assert!(state.core.counters.substeps < 150, "{} sub-steps", state.core.counters.substeps);
}

/// Absurd but legal masses.
fn absurd(method: Method) -> Parameters {
    let mut parameters = default_parameters();
    parameters.start.theta = [0.4836831119208266, 2.6577424139078643];
    enable(&mut parameters, "rotor");
    enable(&mut parameters, "payload");
    let links = &mut parameters.geometry.links;
    (links[1].mass, links[0].inertia, links[2].inertia) = (1e9, 1e12, 1e-15);
    parameters.settings.method = method;
    parameters
}

/// A call of 18.5 s fails at the default `solver.maxWork`, not after minutes: the message has the time reached; the state is unchanged. The
/// explicit method completes.
#[test]
fn absurd_machines_take_bounded_work() {
    let inputs = default_inputs();
    let mut explicit = Simulation::new(&absurd(Method::Dop853), &inputs).expect("a scene");
    explicit.advance(&inputs, 1e-3, 18_500).expect("18.5 s");
    // Each sub-step takes 12 evaluations.
    assert!(explicit.counters().substeps + explicit.counters().rejected < 20_000, "{:?}", explicit.counters());

    let parameters = absurd(Method::I3alp);
    assert_eq!(parameters.settings.max_work, 400_000);
    let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
    let before = simulation.state();
    let failure = simulation.advance(&inputs, 0.5, 37).expect_err("more than a macro step may do").to_string();
    assert!(failure.contains("solver.maxWork = 400000") && failure.contains("s into the call, "), "{failure}");
    assert_eq!(simulation.state(), before);

    // Work until then: no attempt begins beyond the bound, and each takes a Newton loop, a second one, and a line search of 60 rounds
    // with 30 tries. Iterations count by their linear solves.
    let most = 50_000;
    let settings = i3alp::Settings {
        adaptive: true,
        error_tolerance: parameters.settings.error_tolerance,
        tolerance: parameters.settings.tolerance,
        max_iterations: parameters.settings.max_iterations,
        max_work: most,
        energy_scale: 1.0,
        energy_at_start: 0.0,
        regularization: simulation.model().regularization,
    };
    let system = FiveBar::new(simulation.model(), &inputs, &[0; 4]);
    let mut core = before.core;
    i3alp::MacroStep::of(0.5).advance(&system, &settings, &mut core, &mut { Mode::OF_STATE }).expect_err("more than it may do");
    assert_eq!(system.iteration_work(), 16);
    let done = 16 * core.counters.iterations + core.counters.substeps + core.counters.rejected;
    let attempt = 16 * (2 * 10 + 60 * 31);
    assert!((u64::from(most)..u64::from(most) + attempt).contains(&done), "{done} of {most}");
}

/// A motion that touches a plane of 240 kN/m with a ramp of 1 µm. If at 1e-6 rad stages meet the short contact at random, they create
/// 3.2e7 J from 1.9e-6 J.
#[test]
fn no_touch_makes_energy_at_a_loose_tolerance() {
    let mut parameters = close_motors([2.1935064942368094, 1.0987417143110443], [0.04420263949810131, -0.031088100456916103]);
    let damping = parameters.effects.contact.d;
    plane(&mut parameters, [0.9984330203099676, -0.05595984233998259], 0.010448367007184557, [241408.05339717827, damping, 1e-6]);
    for (method, tolerance) in [(Method::Dop853, 1e-6), (Method::Automatic, 1e-6), (Method::Dop853, 1e-4)] {
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
        let start = simulation.state().kinetic_energy(simulation.model());
        for call in 1..=200 {
            simulation.advance(&default_inputs(), 6.352155035663073 / 200.0, 1).expect("a step");
            let state = simulation.state();
            let energy = state.kinetic_energy(simulation.model());
            // Rates of 0.05 rad/s that are off by ten tolerances per second, and work off by 1.5 J times the tolerance per step.
            assert!(
                energy <= start * (1.0 + 200.0 * tolerance),
                "{method:?}, {tolerance:e}, call {call}: {energy:e} of {start:e} J"
            );
            let error = state.energy_error(simulation.model()).abs();
            assert!(error < start * 200.0 * tolerance, "{method:?}, {tolerance:e}, call {call}: {error:e} J");
        }
        let dissipated = simulation.state().core.work.dissipated;
        assert!(dissipated > 0.0, "the tip has not met the plane");
    }
}

/// Contacts that begin and end within one step, mostly between its stages: none is missed if the free motion would penetrate the plane by
/// twice the position tolerance. Slow and fast, against a run of the method at 1e-12 rad.
#[test]
fn no_touch_within_a_step_is_missed() {
    let inputs = default_inputs();
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    let run = |parameters: &Parameters, method: Method, tolerance: f64, duration: f64| {
        let mut parameters = parameters.clone();
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
        let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
        simulation.advance(&inputs, duration, 1).expect("a step");
        simulation
    };
    let (mut met, mut hidden) = (0, 0);
    for case in 0..60 {
        let (fastest, duration) = if case % 2 == 0 { (5.0, 0.3) } else { (0.05, 8.0) };
        let free = close_motors([uniform(1.8, 2.4), uniform(0.7, 1.3)], [uniform(-fastest, fastest), uniform(-fastest, fastest)]);
        // The free motion, and a plane somewhere along its path, on the outer side.
        const LOOKS: usize = 2000;
        let step = duration / LOOKS as f64;
        let mut exact = run(&free, Method::Dop853, 1e-12, step);
        let mut path = vec![tip(&exact)];
        for _ in 1..LOOKS {
            exact.advance(&inputs, step, 1).expect("a step");
            path.push(tip(&exact));
        }
        let turn = (LOOKS as f64 * uniform(0.3, 0.9)) as usize;
        let [before, here, after] = [path[turn - 1], path[turn], path[turn + 1]];
        let along = [after[0] - before[0], after[1] - before[1]];
        let length = along[0].hypot(along[1]);
        let side =
            if (after[0] - here[0]) * (here[1] - before[1]) > (after[1] - here[1]) * (here[0] - before[0]) { 1.0 } else { -1.0 };
        let normal = [along[1], -along[0]].map(|x| side * x / length);
        let reached: Vec<f64> = path.iter().map(|tip| tip[0] * normal[0] + tip[1] * normal[1]).collect();
        let bend = (reached[turn - 1] - 2.0 * reached[turn] + reached[turn + 1]) / (step * step);
        for tolerance in [1e-4, 1e-6, 1e-8] {
            let arm = free.geometry.links[0].length + free.geometry.links[1].length;
            let depth = uniform(2.0, 50.0) * tolerance * arm;
            // Half the time for which the free motion would be behind the plane.
            let half = (2.0 * depth / bend).sqrt();
            let end = (turn + 1) as f64 * step + 5.0 * half;
            // The first contact with the plane, well within the motion.
            let until = ((end / step) as usize).min(LOOKS);
            if half > 0.1 * end || reached[..until].iter().any(|other| *other < reached[turn] - 0.1 * depth) {
                continue;
            }
            let mut scene = free.clone();
            plane(&mut scene, normal, reached[turn] + depth, [1e7, 0.0, 1e-6]);
            let exact = run(&scene, Method::Dop853, 1e-12, end);
            let exact_free = run(&free, Method::Dop853, 1e-12, end);
            let without = tip_error(&exact_free, tip(&exact));
            for method in dense_methods() {
                let unaware = run(&free, method, tolerance, end);
                // Errors of the motion before the contact at a loose tolerance are not judged.
                if tip_error(&unaware, tip(&exact_free)) > 0.1 * depth || without < depth {
                    continue;
                }
                let error = tip_error(&run(&scene, method, tolerance, end), tip(&exact));
                assert!(error < 0.1 * without, "{case}, {method:?}, {tolerance:e}: {error:e} m, without the touch {without:e} m");
                met += 1;
                hidden += u32::from(2.0 * half < 0.2 * end / unaware.counters().substeps as f64);
            }
        }
    }
    assert!(met > 150 && hidden > 50, "{met} touches, {hidden} of them in a fifth of a step");
}

/// Servos of 1e14 N·m/rad on a light arm: stability limits the explicit method to steps below 0.1 ns. It ends by `solver.maxWork` with the
/// time reached. Without this bound a call of 0.3 s takes 49.5 s.
#[test]
fn absurd_drives_take_bounded_work_by_the_explicit_method() {
    let mut parameters = default_parameters();
    parameters.settings.method = Method::Dop853;
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([1e14; 2], [1e3; 2], [1e15; 2]);
    let inputs = default_inputs();
    let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
    let before = simulation.state();
    let failure = simulation.advance(&inputs, 0.3, 1).expect_err("more than a macro step may do").to_string();
    assert!(failure.contains("s into the call, ") && failure.contains("solver.maxWork = 400000"), "{failure}");
    assert_eq!(simulation.state(), before);
}

/// A drive of 1e8 N·m/rad, 1 µrad from its setpoint, dissipates 5e-5 J within some microseconds: work by the default method equals work by
/// dop853.
#[test]
fn stiff_drives_work_as_they_do() {
    let run = |method: Method, tolerance: f64| {
        let mut parameters = default_parameters();
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
        enable(&mut parameters, "servo");
        let servo = &mut parameters.effects.servo;
        (servo.kp, servo.kd, servo.limit) = ([1e8, 0.0], [30.0, 0.0], [1e8, 1.0]);
        let mut inputs = default_inputs();
        inputs.servo_theta[0] = parameters.start.theta[0] + 1e-6;
        let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
        let mut works = Vec::new();
        for _ in 0..20 {
            simulation.advance(&inputs, 1e-3, 1).expect("a step");
            let state = simulation.state();
            let error = state.energy_error(simulation.model());
            // Bound: a thousandth of the energy lost.
            assert!(error.abs() < 5e-8, "{method:?}: {error:e} J");
            works.push(state.core.work.input);
        }
        works
    };
    let (default, exact) = (run(Method::I3alp, 3e-9), run(Method::Dop853, 1e-10));
    for (default, exact) in default.into_iter().zip(exact) {
        assert!((default - exact).abs() < 5e-8, "{default:e} J, by dop853 {exact:e} J");
    }
}

/// Damped stops and planes with ramps of 1 µm at loose tolerances: the dampers are stiff for the steps, and the interpolant of such a step
/// cannot resolve the separation of a push to a guard's width. If such guards are located again and again, one in twelve of these scenes
/// ends by `solver.maxWork`, in sub-steps of 1e-8 s and less instead of 1e-5 s.
#[test]
fn a_push_that_is_about_to_let_go_is_no_million_events() {
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    macro_rules! one_of {
        ($($value:expr),*) => {{
            let all = [$($value),*];
            all[uniform(0.0, all.len() as f64) as usize]
        }};
    }
    let methods = dense_methods();
    for scene in 0..60 {
        let method = methods[scene % methods.len()];
        let theta = [uniform(1.8, 2.6), uniform(0.5, 1.3)];
        let mut parameters = close_motors(theta, [0, 1].map(|_| uniform(-1.0, 1.0)));
        parameters.settings.method = method;
        parameters.settings.error_tolerance = one_of!(1e-3, 1e-4, 1e-6);
        parameters.effects.gravity.enabled = scene % 4 > 1;
        enable(&mut parameters, "stop");
        let stop = &mut parameters.effects.stop;
        (stop.k, stop.d, stop.width) = (one_of!(0.0, 1.0, 50.0), one_of!(5.0, 100.0), one_of!(1e-6, 1e-3));
        stop.lower = theta.map(|angle| angle + uniform(-0.05, 0.05));
        stop.upper = stop.lower.map(|angle| angle + 1.5);
        let across = uniform(0.0, std::f64::consts::TAU);
        plane(&mut parameters, [across.cos(), across.sin()], uniform(-0.4, 0.1), [100.0, 1e4, 1e-6]);
        parameters.effects.contact.mu = 0.0;
        let Ok(mut simulation) = Simulation::new(&parameters, &default_inputs()) else { continue };
        for call in 0..50 {
            let before = simulation.counters();
            let done = simulation.advance(&default_inputs(), 2e-3, 1);
            assert!(done.is_ok(), "scene {scene}, call {call} by {method:?}: {done:?}");
            let after = simulation.counters();
            let tried = after.substeps + after.rejected - before.substeps - before.rejected;
            // Steps at the limit of stability are some 1e-6 s long; failing runs tried up to 33,000.
            assert!(tried < 6000, "scene {scene}, call {call} by {method:?}: {tried} tries");
        }
    }
}

/// Near vertices damped stops dissipate their energy on whichever branch the motion takes. Straight passages use forces only at their ends,
/// conserved energies only the power there, and tangents are round-off: possible errors of the balance are 1e-4 of the energy by `dop853`
/// and 6e-4 by `i3alp`.
#[test]
fn what_stops_take_next_to_a_vertex_is_lost() {
    use std::f64::consts::{PI, TAU};
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    for scene in 0..60 {
        // On its tangent cone, as above.
        let (sin, cos) = uniform(0.0, TAU).sin_cos();
        let (e1, e2) = (cos / 3.0_f64.sqrt(), sin / 3.0);
        let along = [1.0 / 3.0 + e1 + e2, 1.0 / 3.0 - e1 + e2, 1.0 / 3.0 - 2.0 * e2, 1.0];
        let aside = 10_f64.powf(uniform(-8.0, -4.0)) * if scene % 2 == 0 { 1.0 } else { -1.0 };
        let theta: [f64; 4] = std::array::from_fn(|i| [0.0, 0.0, PI, 0.0][i] + aside * along[i]);
        let speed = [0.05, 1.0, 10.0, 30.0][scene % 4];
        let mut parameters = default_parameters();
        parameters.effects.gravity.enabled = scene % 3 == 0;
        enable(&mut parameters, "stop");
        let stop = &mut parameters.effects.stop;
        stop.k = 10_f64.powf(uniform(0.0, 5.0));
        (stop.d, stop.width) = (10_f64.powf(uniform(-1.0, 2.0)), 10_f64.powf(uniform(-6.0, -2.0)));
        let deep = 10_f64.powf(uniform(-5.0, -1.0)) * if uniform(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        (stop.lower, stop.upper) = ([theta[0] + deep, -9.0], [theta[0] + 3.0, 9.0]);
        let step = 10_f64.powf(uniform(-5.0, -3.0));
        for method in methods_with_events() {
            parameters.settings.method = method;
            let rates = along.map(|rate| speed * rate);
            let mut simulation = Simulation::at(&parameters, &default_inputs(), theta, rates).expect("a scene");
            let start = simulation.state().energy_at_start.abs();
            for call in 0..10 {
                // The default method may run out of work if dampers are stiff near a vertex.
                if simulation.advance(&default_inputs(), step, 1).is_err() {
                    assert!(method == Method::I3alp, "scene {scene}, call {call}");
                    break;
                }
                let error = simulation.state().energy_error(simulation.model()).abs();
                // Bound: 1 µJ, as for all scenes with events, and 1e-6 of the energy at the start.
                assert!(error < 1e-6 * (1.0 + start), "scene {scene} by {method:?}, call {call}: {error:e} of {start} J");
            }
        }
    }
}

/// Drives of up to 1e8 N·m/rad without a damper swing for thousands of periods, and the balance holds: |energy.error| stays below a
/// microjoule at default settings. Some saturate, some are damped.
#[test]
fn stiff_drives_keep_their_books() {
    // kp, kd, limit; initial distance, rad; seconds; and allowed energy error, J.
    let scenes = [
        // Without gravity the method conserves the energy of a linear drive, so the balance is exact to round-off.
        (1e8, 0.0, 1e8, 1e-6, 0.02, 1e-12),
        (1e6, 0.0, 1e8, 1e-5, 0.1, 1e-12),
        // Swings beyond the linear range of the drive have errors of the method's order.
        (1e6, 0.0, 1.0, 1e-5, 0.3, 1e-6),
        (1e6, 1.0, 1.0, 1e-5, 0.3, 1e-6),
        (1e7, 0.0, 10.0, 3e-6, 0.1, 1e-6),
        (1e7, 10.0, 10.0, 3e-6, 0.3, 1e-6),
    ];
    for (kp, kd, limit, off, duration, allowed) in scenes {
        for gravity in [false, true] {
            let mut parameters = default_parameters();
            parameters.effects.gravity.enabled = gravity;
            enable(&mut parameters, "servo");
            let servo = &mut parameters.effects.servo;
            (servo.kp, servo.kd, servo.limit) = ([kp, 0.0], [kd, 0.0], [limit, 1.0]);
            let mut inputs = default_inputs();
            inputs.servo_theta[0] = parameters.start.theta[0] + off;
            let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
            for _ in 0..(1e3 * duration) as u32 {
                simulation.advance(&inputs, 1e-3, 1).expect("a step");
                let error = simulation.state().energy_error(simulation.model());
                // The falling arm also has errors of the method's order.
                let allowed = if gravity { 1e-6 } else { allowed };
                assert!(error.abs() < allowed, "{kp:e} N.m/rad, {kd} N.m.s/rad, {limit} N.m, gravity {gravity}: {error:e} J");
            }
        }
    }
}
