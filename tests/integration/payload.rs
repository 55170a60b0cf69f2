//! Mass that joins or leaves the tip during a run: momentum, energy, limits of a run.

use fivebar::effects::payload::Join;
use fivebar::linear::LinearSolve;
use fivebar::observers::{self, Energies};
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::methods::Steps;
use fivebar::simulation::{Method, Parameters, Simulation};

use crate::support::{MGL, enable, unequal};

/// A machine with all links different and without payload.
fn empty(method: Method) -> Parameters {
    let mut parameters = unequal();
    enable(&mut parameters, "payload");
    parameters.effects.payload.mass = 0.0;
    parameters.settings.method = method;
    parameters
}

/// The scene with a payload.
fn holding(from: &Parameters, mass: f64, join: Join) -> Parameters {
    let mut parameters = from.clone();
    (parameters.effects.payload.mass, parameters.effects.payload.join) = (mass, join);
    parameters
}

fn energies(simulation: &Simulation) -> Energies {
    observers::energies(simulation.model(), &simulation.state())
}

fn run(simulation: &mut Simulation, steps: u64) {
    simulation.advance(&default_inputs(), 1e-3, steps).expect("steps");
}

/// Inertia for the proximal rates, from kinetic energies of starts: T = ωᵀ H ω/2.
fn inertia(parameters: &Parameters) -> [[f64; 2]; 2] {
    let kinetic = |omega: [f64; 2]| {
        let mut parameters = parameters.clone();
        parameters.start.omega = omega;
        energies(&Simulation::new(&parameters, &default_inputs()).expect("a start")).kinetic
    };
    let [left, right, both] = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(kinetic);
    [[2.0 * left, both - left - right], [both - left - right, 2.0 * right]]
}

fn times([[a, b], [c, d]]: [[f64; 2]; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    [a * x + b * y, c * x + d * y]
}

/// In a single closed loop without forces the momentum for the proximal rates is conserved: H₁ ω₁ = H₀ ω₀, with both inertias from kinetic
/// energies alone.
#[test]
fn an_impact_keeps_the_momentum() {
    for &method in Method::LIST {
        let before = empty(method);
        let after = holding(&before, 0.08, Join::AtRest);
        let mut simulation = Simulation::new(&before, &default_inputs()).expect("a start");
        let energy = energies(&simulation);
        simulation.tune(&after.effects).expect("allowed");
        let motion = observers::motion(simulation.model(), &simulation.state());
        let momentum = [times(inertia(&before), before.start.omega), times(inertia(&after), [motion.omega[0], motion.omega[3]])];
        for (was, is) in momentum[0].iter().zip(momentum[1]) {
            // Round-off of kinetic energies of some 1e-3 J.
            assert!((was - is).abs() < 1e-15, "{method:?}: {momentum:?}");
        }
        let norms = observers::constraint_norms(simulation.model(), &simulation.state());
        assert!(norms.position < 1e-14 && norms.velocity < 1e-13, "{method:?}: {norms:?}");
        let joined = energies(&simulation);
        let (lost, lifted) = (energy.kinetic - joined.kinetic, joined.potential - energy.potential);
        assert!(lost > 1e-4 && (joined.dissipated - lost).abs() < 1e-17, "{method:?}: {energy:?} {joined:?}");
        // The work of lifting is m g y.
        assert!((lifted - 0.08 * 9.81 * motion.tip.y).abs() < 1e-15 && (joined.input - lifted).abs() < 1e-15, "{joined:?}");
        assert!(joined.error.abs() < 1e-16, "{joined:?}");
    }
}

/// A payload at the tip's velocity joins and leaves without an impact; its energy comes from outside and returns there.
#[test]
fn what_moves_with_the_tip_changes_no_rate() {
    for &method in Method::LIST {
        let start = empty(method);
        let is_dense = method.properties().steps == Steps::Dense;
        let mut simulation = Simulation::new(&start, &default_inputs()).expect("a start");
        run(&mut simulation, 50);
        for (mass, join) in [(0.08, Join::WithTip), (0.02, Join::AtRest), (0.0, Join::WithTip)] {
            let (was, before) = (observers::motion(simulation.model(), &simulation.state()), energies(&simulation));
            let change = mass - simulation.parameters().effects.payload.mass;
            simulation.tune(&holding(&start, mass, join).effects).expect("allowed");
            let (is, after) = (observers::motion(simulation.model(), &simulation.state()), energies(&simulation));
            // The current step of the explicit method is repeated up to here, so values are no longer interpolated: equal within its error.
            let same = if is_dense { 1e-7 } else { 0.0 };
            for (was, is) in was.theta.iter().chain(&was.omega).zip(is.theta.iter().chain(&is.omega)) {
                assert!((was - is).abs() <= same, "{method:?}: {was:?} {is:?}");
            }
            let brought = change * (was.tip_velocity.norm_squared() / 2.0 + 9.81 * was.tip.y);
            // The printed method projects velocities once, by a finite penalty: link velocities are slightly inconsistent.
            let bound = match method {
                Method::I3alpPrinted => 1e-5 * brought.abs(),
                _ if is_dense => 1e-8 * brought.abs(),
                _ => 1e-14,
            };
            assert!((after.input - before.input - brought).abs() < bound, "{method:?}: {brought} {before:?} {after:?}");
            assert_eq!(after.dissipated, before.dissipated);
            run(&mut simulation, 50);
        }
    }
}

/// A payload is picked up, exchanged and put down during the motion, by every method: the balance is as good as without a payload, and all
/// ends agree.
#[test]
fn the_balance_stays_closed() {
    let end = |method: Method| {
        let mut start = empty(method);
        // The printed method's tangent is approximate, so it needs short steps and many iterations.
        let (h, steps) = if method == Method::I3alpPrinted { (1e-4, 500) } else { (1e-3, 50) };
        (start.settings.step_size, start.settings.adaptive) = (h, method == Method::I3alp);
        start.settings.max_iterations = 40;
        start.effects.gravity.g = 1.0;
        let mut simulation = Simulation::new(&start, &default_inputs()).expect("a start");
        let mut go = |effects: Option<(f64, Join)>| {
            if let Some((mass, join)) = effects {
                simulation.tune(&holding(&start, mass, join).effects).expect("allowed");
            }
            simulation.advance(&default_inputs(), h, steps).expect("steps");
            energies(&simulation)
        };
        let alone = go(None);
        for change in [(0.03, Join::AtRest), (0.05, Join::WithTip), (0.01, Join::AtRest), (0.06, Join::AtRest)] {
            let energies = go(Some(change));
            assert!(energies.error.abs() < 1e-5 * MGL + 20.0 * alone.error.abs(), "{method:?}: {alone:?} {energies:?}");
        }
        observers::motion(simulation.model(), &simulation.state()).tip
    };
    let exact = end(Method::Dop853);
    for &method in Method::LIST {
        // Bounds: errors of fixed steps of 1 ms, and the velocity errors of the printed method.
        let bound = if method == Method::I3alpPrinted { 5e-5 } else { 1e-5 };
        let end = end(method);
        assert!((end - exact).norm() < bound, "{method:?}: {end:?} {exact:?}");
    }
}

/// A payload that spreads the inertias too far for the run's linear solve is refused by name, with the allowed maximum; a run that started
/// with the dense solve accepts it.
#[test]
fn a_payload_is_limited_by_the_linear_solve() {
    let start = empty(Method::I3alp);
    let mut simulation = Simulation::new(&start, &default_inputs()).expect("a start");
    run(&mut simulation, 10);
    let state = simulation.state();
    let heavy = holding(&start, 500.0, Join::AtRest);
    let refusal = simulation.tune(&heavy.effects).expect_err("too heavy").to_string();
    let begin = "payload.mass = 500.0 kg is not allowed during this run: it must be at most ";
    let limit: f64 =
        refusal.strip_prefix(begin).and_then(|rest| rest.split(' ').next()).expect("a limit").parse().expect("a number");
    assert_eq!((simulation.state(), simulation.parameters()), (state, &start));
    simulation.tune(&holding(&start, limit * (1.0 - 1e-5), Join::AtRest).effects).expect("just allowed");
    simulation.tune(&holding(&start, limit * (1.0 + 1e-5), Join::AtRest).effects).expect_err("just not");

    let mut simulation = Simulation::new(&heavy, &default_inputs()).expect("a start");
    assert_eq!(simulation.model().solver.linear_solve(), LinearSolve::Dense);
    simulation.tune(&holding(&start, 600.0, Join::AtRest).effects).expect("it takes anything");
    simulation.tune(&holding(&start, 0.1, Join::AtRest).effects).expect("less as well");
    run(&mut simulation, 10);
}

/// A disabled payload may have any mass and changes nothing.
#[test]
fn a_disabled_payload_has_no_influence() {
    let mut start = empty(Method::I3alp);
    start.effects.payload.enabled = false;
    let mut simulation = Simulation::new(&start, &default_inputs()).expect("a start");
    let state = simulation.state();
    simulation.tune(&holding(&start, 1e6, Join::AtRest).effects).expect("allowed");
    assert_eq!(simulation.state(), state);
}
