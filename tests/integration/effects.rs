//! Every effect: tangents and power against finite differences, energy along the path, and absence.

use std::f64::consts::PI;

use fivebar::dynamics::Conditions;
use fivebar::effects::{Mode, NAMES};
use fivebar::integrator::{System, TangentPoint};
use fivebar::linear::{LinearSolve, LinearSolver};
use fivebar::mechanism::coordinates::THETA;
use fivebar::mechanism::{COORDINATES, Coordinates, Multipliers};
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::methods::{MethodSettings, method_settings};
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{MGL, angle_error, enable, run, slope, unequal};

/// A scene in which all effects, once enabled, act and are smooth for some 0.1 s: wide ramps, contact with plane and stops, servos in their
/// linear range. Nothing is enabled yet.
fn acting() -> Parameters {
    let mut parameters = unequal();
    let effects = &mut parameters.effects;
    effects.gravity.enabled = false;
    effects.rotor.gear_ratio = [3.0, 2.0];
    effects.viscous.b = [2e-3, 1e-3, 3e-3, 5e-4, 1e-3];
    effects.friction.coulomb = [2e-3, 1e-3, 0.0, 3e-3, 1e-3];
    effects.friction.breakaway = [3e-3, 1e-3, 0.0, 4e-3, 2e-3];
    effects.friction.breakaway_velocity = 2.0;
    effects.stop.lower = [1.9, 1.0];
    effects.stop.upper = [2.1, 2.0];
    (effects.stop.k, effects.stop.width) = (0.5, 0.5);
    (effects.contact.nx, effects.contact.ny, effects.contact.offset) = (0.6, 0.8, 0.6);
    (effects.contact.k, effects.contact.d, effects.contact.width, effects.contact.slip_velocity) = (20.0, 0.5, 0.3, 0.5);
    effects.servo.kp = [0.3, 0.2];
    parameters
}

fn references() -> Inputs {
    Inputs { servo_theta: [1.0, 2.0], servo_omega: [0.5, -0.5], tip_force: [0.1, -0.2], tau: [0.01, 0.02] }
}

/// The scene with each effect alone, and with all of them.
fn each_and_all() -> Vec<(String, Parameters)> {
    let mut scenes: Vec<(String, Parameters)> = NAMES
        .iter()
        .map(|name| {
            let mut parameters = acting();
            enable(&mut parameters, name);
            (name.to_string(), parameters)
        })
        .collect();
    let mut all = acting();
    NAMES.iter().for_each(|name| enable(&mut all, name));
    scenes.push(("all".into(), all));
    scenes
}

/// Random states with angles of ±3 rad, positions of ±0.5 m, rates of ±4 rad/s and ±1 m/s.
fn random_states(count: usize) -> Vec<(Coordinates, Coordinates)> {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut scattered = |angle: f64, length: f64| -> Coordinates {
        Coordinates::from_fn(|i| {
            let uniform = (random.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
            uniform * if THETA.contains(&i) { angle } else { length }
        })
    };
    (0..count).map(|_| (scattered(3.0, 0.5), scattered(4.0, 1.0))).collect()
}

/// Central difference of f along coordinate j.
fn difference(x: &Coordinates, j: usize, f: impl Fn(&Coordinates) -> Coordinates) -> Coordinates {
    let step = 1e-6;
    let moved = |s: f64| f(&(*x + s * Coordinates::unit(j)));
    (moved(step) - moved(-step)) / (2.0 * step)
}

/// K = −∂Q/∂q and C = −∂Q/∂q̇ against central differences; both are extracted from the weight W(h) = M + h/2 C + h²/4 K.
#[test]
fn tangents_are_derivatives_of_forces() {
    for (name, parameters) in each_and_all() {
        let inputs = references();
        let simulation = Simulation::new(&parameters, &inputs).expect(&name);
        let system = FiveBar::new(simulation.model(), &inputs, &[1, 0, 0, -2]);
        for (q, v) in random_states(20) {
            let pose = system.pose(&q);
            for j in 0..COORDINATES {
                let unit = Coordinates::unit(j);
                let mass = system.mass_times(&pose, &unit);
                let weight = |h: f64| {
                    system.effective_mass_times(&TangentPoint { q: &q, pose: &pose, v: &v, lambda: &Multipliers::ZERO, h }, &unit)
                };
                let (two, four) = (weight(2.0), weight(4.0));
                let stiffness = (four - 2.0 * two + mass) / 2.0;
                let damping = two - mass - stiffness;
                let by_q = difference(&q, j, |q| system.forces(q, &system.pose(q), &v).0);
                let by_v = difference(&v, j, |v| system.forces(&q, &pose, v).0);
                for i in 0..COORDINATES {
                    // Truncation: third derivatives of up to 1e3 times 1e-12; round-off: forces of up to 1e2 times 1e-16/1e-6.
                    assert!((stiffness[i] + by_q[i]).abs() < 1e-6, "{name}: K[{i}][{j}] = {} {}", stiffness[i], -by_q[i]);
                    assert!((damping[i] + by_v[i]).abs() < 1e-6, "{name}: C[{i}][{j}] = {} {}", damping[i], -by_v[i]);
                }
            }
        }
    }
}

/// The power of all forces, Q·q̇, equals input power minus dissipated power minus the growth of the potential; the dissipated power is
/// never negative.
#[test]
fn powers_and_potentials_account_for_every_force() {
    for (name, parameters) in each_and_all() {
        let inputs = references();
        let simulation = Simulation::new(&parameters, &inputs).expect(&name);
        let (model, turns) = (simulation.model(), [1, 0, 0, -2]);
        let system = FiveBar::new(model, &inputs, &turns);
        for (q, v) in random_states(50) {
            let pose = system.pose(&q);
            let (forces, power) = system.forces(&q, &pose, &v);
            let mechanical = forces.dot(&v);
            let potential = |s: f64| {
                let q = q + s * v;
                let conditions = Conditions { inputs: &inputs, turns: &turns, mode: Mode::OF_STATE };
                model.potential(&q, &conditions.motion([&q, &v], &system.pose(&q)))
            };
            let growth = (potential(1e-6) - potential(-1e-6)) / 2e-6;
            let expected = power.input - power.dissipated - growth;
            assert!((mechanical - expected).abs() < 1e-6 * (1.0 + mechanical.abs()), "{name}: {mechanical} W, {expected} W");
            assert!(power.dissipated >= 0.0, "{name}: {power:?}");
        }
    }
}

/// Kinetic + potential + dissipated − input is constant to the method's order, two, for each effect and for all at once.
#[test]
fn the_energy_balance_closes_with_the_order_of_the_method() {
    for (name, mut parameters) in each_and_all() {
        parameters.settings.adaptive = false;
        let errors: Vec<(f64, f64)> = [1e-3, 5e-4, 2.5e-4, 1.25e-4]
            .into_iter()
            .map(|h| {
                let mut simulation = Simulation::new(&parameters, &references()).expect(&name);
                run(&mut simulation, &references(), h, 0.2);
                (h, observers::energies(simulation.model(), &simulation.state()).error.abs())
            })
            .collect();
        let order = slope(&errors);
        assert!(order > 1.7 && errors[3].1 < 1e-3 * MGL, "{name}: order {order}, {errors:?}");
    }
}

/// Methods that share only the forces find the same motion: tangents and effects are consistent along the path.
#[test]
fn methods_agree_with_all_effects_on() {
    let end = |method: Method, h: f64| {
        let (_, mut parameters) = each_and_all().pop().expect("all");
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, 1e-11);
        let mut simulation = Simulation::new(&parameters, &references()).expect("all");
        run(&mut simulation, &references(), h, 0.3);
        let energies = observers::energies(simulation.model(), &simulation.state());
        (simulation.state().angles(), energies.input, energies.dissipated)
    };
    let implicit = end(Method::I3alp, 1e-3);
    for explicit in [end(Method::Rk4, 1e-4), end(Method::Dop853, 1e-3)] {
        for (a, b) in implicit.0.into_iter().zip(explicit.0) {
            // Some 1e4 sub-steps with local errors of 1e-11 rad.
            assert!((a - b).abs() < 1e-6, "{implicit:?} {explicit:?}");
        }
        assert!((implicit.1 - explicit.1).abs() < 1e-6 * MGL.max(explicit.1.abs()), "{implicit:?} {explicit:?}");
        assert!((implicit.2 - explicit.2).abs() < 1e-5 * explicit.2, "{implicit:?} {explicit:?}");
    }
}

/// q after 0.3 s of fixed 1 ms steps with a linear solve, in the bare form or in the form for any scene.
fn end<const BARE: bool>(scene: &Simulation, inputs: &Inputs, solve: LinearSolve) -> Coordinates {
    let mut model = scene.model().clone();
    model.solver = LinearSolver::new(solve, &model.mechanism, model.regularization);
    let MethodSettings::MacroStep(method) = method_settings(&model, 0.0) else { panic!("the default is i3-ALP") };
    let mut core = scene.state().core;
    for _ in 0..300 {
        method
            .advance(&FiveBar::new(&model, inputs, &[0; 4]).in_form::<BARE>(), &mut core, &mut { Mode::OF_STATE }, 1e-3)
            .expect("step");
    }
    core.q
}

/// The linear solves give the same step up to round-off, which the motion amplifies: leg by leg without effects, and with effects that
/// couple links in every way. The bare form has the same bits.
#[test]
fn the_linear_solves_agree() {
    let mut parameters = unequal();
    parameters.settings.adaptive = false;
    let inputs = Inputs { tau: [0.01, -0.02], tip_force: [0.1, 0.05], ..Inputs::default() };
    let bare = Simulation::new(&parameters, &inputs).expect("scene");
    let dense = end::<false>(&bare, &inputs, LinearSolve::Dense);
    let by_legs = end::<false>(&bare, &inputs, LinearSolve::Structured);
    let error = angle_error(&by_legs, &dense);
    assert!(error < 1e-10, "{error:e} rad");
    assert_eq!(end::<true>(&bare, &inputs, LinearSolve::Structured), by_legs);
    let (_, mut all) = each_and_all().pop().expect("all");
    all.settings.adaptive = false;
    let all = Simulation::new(&all, &references()).expect("scene");
    let ends = [LinearSolve::Structured, LinearSolve::Dense].map(|solve| end::<false>(&all, &references(), solve));
    let error = angle_error(&ends[0], &ends[1]);
    assert!(error < 1e-10, "{error:e} rad");
}

/// A mirrored mechanism with mirrored effects and loads has the mirrored motion.
#[test]
fn mirrored_effects_give_the_mirrored_motion() {
    let (_, mut parameters) = each_and_all().pop().expect("all");
    // Link angles from the side that carries the effect: the payload is on the tip of both.
    let angles = |parameters: &Parameters, inputs: &Inputs| {
        let mut simulation = Simulation::new(parameters, inputs).expect("scene");
        run(&mut simulation, inputs, 1e-3, 0.3);
        simulation.state().angles()
    };
    let inputs = references();
    let distance = parameters.geometry.base_distance;
    let there = angles(&parameters, &inputs);
    let turned = |[left, right]: [f64; 2]| [PI - right, PI - left];
    let swapped = |[left, right]: [f64; 2]| [right, left];
    parameters.geometry.links.reverse();
    parameters.start.theta = turned(parameters.start.theta);
    parameters.start.omega = swapped(parameters.start.omega).map(|x| -x);
    let effects = &mut parameters.effects;
    effects.gravity.direction = PI - effects.gravity.direction;
    effects.rotor.inertia = swapped(effects.rotor.inertia);
    effects.rotor.gear_ratio = swapped(effects.rotor.gear_ratio);
    effects.viscous.b.reverse();
    effects.friction.coulomb.reverse();
    effects.friction.breakaway.reverse();
    effects.spring.theta0 = turned(effects.spring.theta0);
    (effects.stop.lower, effects.stop.upper) = (turned(effects.stop.upper), turned(effects.stop.lower));
    // n·(x, y) ≥ offset with x measured from the other motor.
    effects.contact.offset -= effects.contact.nx * distance;
    effects.contact.nx = -effects.contact.nx;
    effects.servo.kp = swapped(effects.servo.kp);
    let mirrored = Inputs {
        tau: swapped(inputs.tau).map(|x| -x),
        tip_force: [-inputs.tip_force[0], inputs.tip_force[1]],
        servo_theta: turned(inputs.servo_theta),
        servo_omega: swapped(inputs.servo_omega).map(|x| -x),
    };
    let here = angles(&parameters, &mirrored);
    for (i, j) in [(0, 3), (1, 2), (2, 1), (3, 0)] {
        // Sub-steps differ in the last bits, so ends differ like two runs at the default tolerance.
        assert!((there[i] + here[j] - PI).abs() < 1e-6, "{there:?} {here:?}");
    }
}

/// A disabled effect is absent: it is not in the list, and no value of its parameters changes a bit.
#[test]
fn disabled_effects_are_absent() {
    let bits = |parameters: &Parameters| {
        let mut simulation = Simulation::new(parameters, &default_inputs()).expect("scene");
        run(&mut simulation, &default_inputs(), 1e-3, 0.5);
        (simulation.state(), simulation.active_effects().to_vec())
    };
    let mut parameters = default_parameters();
    let bare = bits(&parameters);
    assert_eq!(bare.1, ["gravity"]);
    parameters.effects = acting().effects;
    parameters.effects.gravity.enabled = true;
    // Invalid values, refused if the effect is enabled.
    parameters.effects.friction.breakaway[0] = -1.0;
    parameters.effects.stop.lower = [5.0; 2];
    parameters.effects.contact.ny = 0.0;
    parameters.effects.contact.nx = 0.0;
    assert_eq!(bits(&parameters), bare);

    let nothing_to_hear = Inputs { servo_theta: [0.0; 2], servo_omega: [0.0; 2], ..references() };
    let mut simulation = Simulation::new(&parameters, &nothing_to_hear).expect("scene");
    let mut hears_nothing = Simulation::new(&parameters, &references()).expect("scene");
    run(&mut simulation, &nothing_to_hear, 1e-3, 0.1);
    run(&mut hears_nothing, &references(), 1e-3, 0.1);
    assert_eq!(simulation.state(), hears_nothing.state_for(&nothing_to_hear));
}
