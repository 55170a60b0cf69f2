//! Physics without a reference: energy, symmetry, reversal, equivalent formulations, determinism.

use fivebar::effects::Mode;
use fivebar::integrator;
use fivebar::mechanism::Assembly;
use fivebar::mechanism::coordinates::THETA;
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::methods::{MethodSettings, method_settings};
use fivebar::simulation::{FailureCause, Inputs, Method, Simulation};

use crate::support::{MGL, angle_error, fall_90_120, run, torque, unequal};

/// The paper's scene: 50 s of free fall through singularities at the default settings.
#[test]
fn the_paper_free_fall_keeps_its_energy_for_50_s() {
    let mut simulation = Simulation::new(&default_parameters(), &default_inputs()).expect("scene");
    let mut worst: f64 = 0.0;
    for _ in 0..50_000 {
        simulation.advance(&default_inputs(), 1e-3, 1).expect("step");
        worst = worst.max(observers::energies(simulation.model(), &simulation.state()).error.abs());
    }
    assert!(worst <= 1e-2 * MGL, "{:e} mgL", worst / MGL);
    assert!(simulation.state().core.q.iter().all(|x| x.is_finite()));
}

/// A fall that passes a vertex after 40.75 s. If the passage ended with a violation of 4e-13 m, which is 3e-9 rad there, no later sub-step
/// would be short enough. (With different rounding the fall is different, and must also continue.)
#[test]
fn after_a_vertex_the_fall_goes_on() {
    let mut parameters = default_parameters();
    parameters.start.theta = [1.4973040086989977, 1.5543928484441125];
    parameters.start.assembly = Assembly::Minus;
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    simulation.advance(&default_inputs(), 1e-3, 50_000).expect("all of it");
    let error = observers::energies(simulation.model(), &simulation.state()).error.abs();
    assert!(error <= 1e-2 * MGL, "{:e} mgL", error / MGL);
}

/// Equal links from 90°/90° stay mirror symmetric: θ₁ + θ₄ = π and θ₂ + θ₃ = π, until round-off (e-fold time 0.1 s) breaks the symmetry.
#[test]
fn a_symmetric_fall_stays_symmetric() {
    let mut simulation = Simulation::new(&default_parameters(), &default_inputs()).expect("scene");
    run(&mut simulation, &default_inputs(), 1e-3, 1.0);
    let theta = THETA.map(|i| simulation.state().core.q[i]);
    for pair in [theta[0] + theta[3], theta[1] + theta[2]] {
        // Tolerance: round-off of 1e-16, grown by e^10.
        assert!((pair - std::f64::consts::PI).abs() < 1e-11, "{theta:?}");
    }
}

/// A mirrored start and load give the mirrored motion.
#[test]
fn a_mirrored_load_gives_the_mirrored_motion() {
    let (parameters, pull) = torque();
    let mirrored = Inputs { tau: [0.0, -pull.tau[0]], ..pull };
    let angles = |inputs: &Inputs| {
        let mut simulation = Simulation::new(&parameters, inputs).expect("scene");
        run(&mut simulation, inputs, 1e-3, 0.3);
        THETA.map(|i| simulation.state().core.q[i])
    };
    let (left, right) = (angles(&pull), angles(&mirrored));
    for (i, j) in [(0, 3), (1, 2), (2, 1), (3, 0)] {
        assert!((left[i] + right[j] - std::f64::consts::PI).abs() < 1e-9, "{left:?} {right:?}");
    }
}

/// A conservative motion, reversed at its end, returns to its start.
#[test]
fn a_reversed_motion_returns() {
    let inputs = default_inputs();
    let start = Simulation::new(&unequal(), &inputs).expect("scene");
    let mut there = Simulation::new(&unequal(), &inputs).expect("scene");
    run(&mut there, &inputs, 1e-4, 0.2);
    let end = there.state().core;
    assert!(angle_error(&end.q, &start.state().core.q) > 0.5, "it has moved");

    let model = there.model();
    let system = FiveBar::new(model, &inputs, &[0; 4]);
    let MethodSettings::MacroStep(method) = method_settings(model, 0.0) else { panic!("the default is i3-ALP") };
    let mut back = integrator::State::start(&system, end.q, -end.v, model.regularization);
    for _ in 0..2000 {
        method.advance(&system, &mut back, &mut { Mode::OF_STATE }, 1e-4).expect("step");
    }
    let error = angle_error(&back.q, &start.state().core.q);
    // A local error of 3e-9 rad in each of 2 × 2000 steps, in the worst case all of one sign.
    assert!(error < 1.2e-5, "{error:e} rad");
}

/// The printed method is close to the default method at the paper's 1 ms while it works. It ends with a status, never with NaN.
#[test]
fn the_printed_method_ends_with_a_status() {
    let mut parameters = default_parameters();
    parameters.settings.method = Method::I3alpPrinted;
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    let mut steps = 0;
    let failure = loop {
        let before = simulation.state();
        match simulation.advance(&default_inputs(), 1e-3, 1) {
            Ok(()) => steps += 1,
            Err(failure) => {
                assert_eq!(before, simulation.state(), "a failed step leaves the state");
                break failure;
            }
        }
        assert!(steps < 50_000, "the printed method was expected to fail on the paper's free fall");
        assert!(simulation.state().core.q.iter().chain(&simulation.state().core.a).all(|x| x.is_finite()));
    };
    assert!(steps > 1000, "it should live for more than a second, failed after {steps} steps: {failure}");
    assert!(matches!(failure.cause, FailureCause::Step(integrator::StepError::NotConverged { .. })), "{failure}");
}

/// Setting inputs to equal values changes no bit, and one step of H equals n steps of H/n.
#[test]
fn steps_do_not_depend_on_how_they_are_grouped() {
    let (parameters, inputs) = torque();
    let mut together = Simulation::new(&parameters, &inputs).expect("scene");
    together.advance(&inputs, 1e-3, 500).expect("steps");
    let mut apart = Simulation::new(&parameters, &inputs).expect("scene");
    for _ in 0..500 {
        apart.advance(&inputs.clone(), 1e-3, 1).expect("step");
    }
    assert_eq!(together.state(), apart.state());
}

/// Observers use the current inputs: after a change of inputs they give the accelerations with which the next step starts, and reading
/// changes nothing.
#[test]
fn observers_answer_for_the_new_input() {
    let mut simulation = Simulation::new(&unequal(), &default_inputs()).expect("scene");
    run(&mut simulation, &default_inputs(), 1e-3, 0.05);
    let push = Inputs { tip_force: [0.0, 1.0], ..Inputs::default() };
    let before = simulation.state();
    let seen = simulation.state_for(&push);
    let change = observers::motion(simulation.model(), &seen).tip_acceleration
        - observers::motion(simulation.model(), &simulation.state()).tip_acceleration;
    assert!(change.y > 0.0, "an upward push accelerates the tip upward: {change}");
    assert_eq!(simulation.state_for(&default_inputs()), before, "those it holds");
    assert_eq!(simulation.state(), before);
}

/// A link that spins for hundreds of turns loses no digits: angles stay within two turns, whole turns are counted separately.
#[test]
fn spinning_links_keep_their_digits() {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    parameters.geometry.base_distance = 0.0;
    parameters.start.theta = [2.0, 1.0];
    parameters.start.omega = [60.0, 60.0];
    let inputs = default_inputs();
    let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
    run(&mut simulation, &inputs, 1e-3, 20.0);
    let state = simulation.state();
    assert!(state.angles()[0] > 1000.0 && state.core.q.iter().all(|x| x.abs() < 13.0), "{:?}", state.angles());
    let energies = observers::energies(simulation.model(), &state);
    // 20 s of local errors of 3e-9 rad at rates of 60 rad/s.
    assert!(energies.error.abs() < 1e-4 * energies.kinetic, "{energies:?}");
}

/// At rest exactly in a vertex the first outputs already show the acceleration on the branch of least constraint. Under gravity in posture
/// (−1, 1, 0) it is (61.4, 19.4, −14.4, 56.5) rad/s² (an independent prototype), not the minimum-norm (60.1, 20.1, …).
#[test]
fn rest_in_a_vertex_starts_on_the_branch_of_least_constraint() {
    use std::f64::consts::PI;
    for adaptive in [true, false] {
        let mut parameters = default_parameters();
        parameters.settings.adaptive = adaptive;
        let mut simulation = Simulation::at(&parameters, &default_inputs(), [PI, 0.0, PI, PI], [0.0; 4]).expect("a vertex");
        let alpha = observers::motion(simulation.model(), &simulation.state()).alpha;
        for (got, want) in alpha.into_iter().zip([61.4, 19.4, -14.4, 56.5]) {
            assert!((got - want).abs() < 0.06, "{alpha:?}");
        }
        run(&mut simulation, &default_inputs(), 1e-3, 0.3);
        let energies = observers::energies(simulation.model(), &simulation.state());
        assert!(energies.error.abs() < 1e-2 * MGL, "{energies:?}");
        assert!(!adaptive || simulation.state().core.counters.launches > 0);
    }
}

/// At fixed steps of 1 ms the second attempt, a descent with line search, carries the paper's free fall past the step at which plain Newton
/// first fails (7.67 s). If it also fails, the step ends with a status and changes nothing.
#[test]
fn a_strictly_fixed_step_is_rescued_or_ends_with_a_status() {
    let mut parameters = default_parameters();
    parameters.settings.adaptive = false;
    let inputs = default_inputs();
    let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
    run(&mut simulation, &inputs, 1e-3, 10.0);
    assert!(simulation.state().core.counters.rescued > 0);
    for _ in 10_000..50_000 {
        let before = simulation.state();
        if let Err(failure) = simulation.advance(&inputs, 1e-3, 1) {
            assert_eq!(simulation.state(), before);
            assert_eq!(failure.elapsed, 0.0);
            return;
        }
        assert!(simulation.state().core.q.iter().all(|x| x.is_finite()));
    }
    panic!("this fall was expected to meet a step that cannot be done");
}

/// Work per macro step is bounded: with a tolerance below round-off it soon ends with a status and changes nothing.
#[test]
fn a_tolerance_below_round_off_ends_with_a_status() {
    let mut parameters = default_parameters();
    parameters.settings.error_tolerance = 1e-15;
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    let before = simulation.state();
    let failure = simulation.advance(&default_inputs(), 10.0, 1).expect_err("too much to ask");
    assert!(matches!(failure.cause, FailureCause::Step(integrator::StepError::TooMuchWork { most: 400_000, .. })), "{failure}");
    assert_eq!(simulation.state(), before);
}

/// The bound is a parameter, in iterations and evaluations: a step that needs more ends with a status that names it; a step that needs less
/// succeeds.
#[test]
fn the_work_of_a_macro_step_is_bounded_by_a_parameter() {
    for method in [Method::I3alp, Method::Dop853] {
        let mut parameters = fall_90_120(method);
        (parameters.settings.adaptive, parameters.settings.max_work) = (true, 500);
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let before = simulation.state();
        // A fall of 2 s with a fast passage.
        let failure = simulation.advance(&default_inputs(), 2.0, 1).expect_err("too much to do at once");
        assert!(matches!(failure.cause, FailureCause::Step(integrator::StepError::TooMuchWork { most: 500, .. })), "{failure}");
        assert!(failure.to_string().contains("solver.maxWork = 500"), "{failure}");
        assert_eq!(simulation.state(), before);
        simulation.advance(&default_inputs(), 1e-2, 200).expect("in small portions");
    }
}
