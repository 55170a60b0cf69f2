//! Derivatives: outputs by inputs and continuous states, outputs and inputs by time (rules 20, 40, 41, 42 of this project).

use std::f64::consts::PI;

use fivebar::effects::NAMES;
use fivebar::ffi::*;
use fivebar::fmi::{Instance, Kind};
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::methods::Steps;
use fivebar::simulation::{Inputs, Method, Signal, Simulation};
use fivebar::variables::{FmiType, VARIABLES, Value, Variable, VariableId};
use model_description::ModelDescription;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::fmi_host::{Host, reference};

const STATES: [&str; 4] = ["theta[1]", "theta[2]", "omega[1]", "omega[2]"];
const STARTS: [&str; 4] = ["init.theta[1]", "init.theta[2]", "init.omega[1]", "init.omega[2]"];

/// A machine with its parameters, which can start from any angles and rates.
#[derive(Clone)]
pub(super) struct Scene {
    pub(super) reals: Vec<(String, f64)>,
    pub(super) enabled: Vec<&'static str>,
    /// 1 plus, 2 minus.
    pub(super) assembly: i32,
}

impl Scene {
    /// An initialised instance.
    fn start(&self, state: [f64; 4]) -> Host {
        let host = self.initializing(state);
        assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
        host
    }

    /// An instance in initialization mode.
    pub(super) fn initializing(&self, state: [f64; 4]) -> Host {
        let host = Host::initializing(0.0, None);
        for (name, value) in &self.reals {
            assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
        }
        for effect in &self.enabled {
            assert_eq!(host.set_boolean(&[reference(&format!("{effect}.enabled"))], &[fmi2True]), fmi2OK);
        }
        assert_eq!(host.set_integer(&[reference("init.assembly")], &[self.assembly]), fmi2OK);
        assert_eq!(host.set_real(&STARTS.map(reference), &state), fmi2OK, "{:?}", host.take());
        host
    }
}

fn real(host: &Host, name: &str) -> f64 {
    let mut value = [f64::NAN];
    assert_eq!(host.get_real(&[reference(name)], &mut value), fmi2OK, "{name}: {:?}", host.take());
    value[0]
}

/// Every computed Real.
fn computed() -> Vec<&'static Variable> {
    VARIABLES.iter().filter(|variable| matches!(variable.id, VariableId::RealComputed(_))).collect()
}

fn read(host: &Host) -> Vec<f64> {
    let references: Vec<u32> = computed().iter().map(|variable| variable.reference).collect();
    let mut values = vec![f64::NAN; references.len()];
    assert_eq!(host.get_real(&references, &mut values), fmi2OK, "{:?}", host.take());
    // The balance residual counts from the start of a run, so between runs its change follows from the energies.
    let place = |name: &str| computed().iter().position(|variable| variable.name == name).expect("it is computed");
    values[place("energy.error")] = values[place("energy.kinetic")] + values[place("energy.potential")];
    values
}

/// Central differences of order 4 of all computed variables, each with its bound of round-off.
///
/// The quotient multiplies the round-off of its values, some 8 ε, by 1.5/step. For an acceleration, round-off is relative to the largest of
/// the terms that cancel: a stop, 0.02 rad deep at 50 N·m/rad, alone accelerates a link of 3e-5 kg·m² by 3e4 rad/s².
fn differences(step: f64, mut at: impl FnMut(f64) -> Vec<f64>) -> Vec<[f64; 2]> {
    let stencil @ [far_below, below, above, far_above] = &[-2.0, -1.0, 1.0, 2.0].map(|k| at(k * step));
    let slope = |i: usize| (8.0 * (above[i] - below[i]) - (far_above[i] - far_below[i])) / (12.0 * step);
    let size = |i: usize| stencil.iter().fold(0.0f64, |size, values| size.max(values[i].abs()));
    let cancelling = |i: usize| if computed()[i].name.starts_with("alpha") { 3e4 } else { 0.0 };
    let round_off = |i: usize| 1.5 * 8.0 * f64::EPSILON * size(i).max(cancelling(i)) / step;
    (0..above.len()).map(|i| [slope(i), round_off(i)]).collect()
}

fn analytic(host: &Host, known: &str) -> Vec<f64> {
    let references: Vec<u32> = computed().iter().map(|variable| variable.reference).collect();
    let mut values = vec![f64::NAN; references.len()];
    let status = host.directional_derivative(&references, &[(reference(known), 1.0)], &mut values);
    assert_eq!(status, fmi2OK, "{known}: {:?}", host.take());
    values
}

/// Dependencies declared in the XML: (unknown, known).
fn declared() -> Vec<(String, String)> {
    let structure = ModelDescription::read().expect("the shipped description").structure;
    let pairs = structure.outputs.into_iter().chain(structure.derivatives).flat_map(|unknown| {
        // A derivative shares its value reference with another variable.
        let name = match unknown.name.as_str() {
            "der(theta[1])" => "omega[1]".to_owned(),
            "der(theta[2])" => "omega[2]".to_owned(),
            "der(omega[1])" => "alpha[1]".to_owned(),
            "der(omega[2])" => "alpha[2]".to_owned(),
            other => other.to_owned(),
        };
        unknown.dependencies.into_iter().map(move |known| (name.clone(), known)).collect::<Vec<_>>()
    });
    pairs.collect()
}

fn inputs() -> Vec<&'static Variable> {
    VARIABLES.iter().filter(|variable| matches!(variable.id, VariableId::Input(_))).collect()
}

/// Every pair of a computed variable and a known at the current state of `host`, against central differences of `scene` from `state`.
/// Derivatives of outputs and states are exactly 0 if no dependency is declared; derivatives of `solver.*` always are.
fn check_pairs(host: &Host, scene: &Scene, state: [f64; 4], label: &str) {
    let declared = declared();
    let check = |known: &str, numeric: Vec<[f64; 2]>| {
        for ((variable, got), [expected, round_off]) in computed().iter().zip(analytic(host, known)).zip(numeric) {
            let name = variable.name;
            let pair = format!("{label}: d {name}/d {known} = {got}, differences {expected}");
            let listed = declared.iter().any(|(unknown, _)| unknown == name);
            if name.starts_with("solver.") || (listed && !declared.iter().any(|(u, k)| u == name && k == known)) {
                assert_eq!(got, 0.0, "{pair}");
            } else {
                // Truncation of sharp laws, (step/scale)⁴ with the sharpest scale 0.01 rad/s (friction), and round-off.
                assert!((got - expected).abs() < 2e-7 * (1.0 + expected.abs()) + round_off, "{pair}, round-off {round_off}");
            }
        }
    };
    for input in inputs() {
        let before = real(host, input.name);
        let numeric = differences(1e-3, |change| {
            assert_eq!(host.set_real(&[input.reference], &[before + change]), fmi2OK);
            read(host)
        });
        assert_eq!(host.set_real(&[input.reference], &[before]), fmi2OK);
        check(input.name, numeric);
    }
    for (i, known) in STATES.into_iter().enumerate() {
        let numeric = differences(1e-4, |change| {
            let mut state = state;
            state[i] += change;
            read(&scene.start(state))
        });
        check(known, numeric);
    }
}

fn uniform(random: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A machine with all links different and all effects: the tip touches the plane and both axes are in their stops.
pub(super) fn everything(random: &mut ChaCha8Rng, assembly: i32) -> (Scene, [f64; 4]) {
    let mut reals: Vec<(String, f64)> = Vec::new();
    let mut set = |name: &str, value: f64| reals.push((name.to_owned(), value));
    for (i, [length, mass, inertia, com]) in
        [[0.20, 0.020, 8.0e-5, 0.07], [0.26, 0.015, 1.1e-4, 0.15], [0.24, 0.030, 9.0e-5, -0.02], [0.17, 0.011, 3.0e-5, 0.19]]
            .into_iter()
            .enumerate()
    {
        for (what, value) in [("length", length), ("mass", mass), ("inertia", inertia), ("com", com)] {
            set(&format!("link[{}].{what}", i + 1), value);
        }
    }
    set("base.distance", 0.3);
    for (name, size) in [("tau[1]", 0.1), ("tau[2]", 0.1), ("tip.fx", 1.0), ("tip.fy", 1.0)] {
        set(name, uniform(random, -size, size));
    }
    for name in ["servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]"] {
        set(name, uniform(random, 0.5, 2.0));
    }
    let state = [uniform(random, 1.2, 1.6), uniform(random, 1.5, 2.1), uniform(random, 1.0, 3.0), uniform(random, -3.0, -1.0)];
    for (i, angle) in state.into_iter().take(2).enumerate() {
        set(&format!("stop.lower[{}]", i + 1), angle - 2.0);
        set(&format!("stop.upper[{}]", i + 1), angle - 0.02);
    }
    set("contact.nx", 0.2);
    set("contact.ny", 0.9);
    let mut scene = Scene { reals, enabled: Vec::new(), assembly };
    let tip = scene.start(state);
    let along = (0.2 * real(&tip, "tip.x") + 0.9 * real(&tip, "tip.y")) / 0.2f64.hypot(0.9);
    scene.reals.push(("contact.offset".to_owned(), along + 1e-3));
    scene.enabled = NAMES.to_vec();
    (scene, state)
}

#[test]
fn declared_dependencies_are_central_differences_and_others_zero_with_all_effects() {
    let mut random = ChaCha8Rng::seed_from_u64(41);
    for assembly in [1, 2] {
        for trial in 0..4 {
            let (scene, state) = everything(&mut random, assembly);
            let host = scene.start(state);
            assert!(real(&host, "contact.fy") > 0.1, "the tip must touch");
            check_pairs(&host, &scene, state, &format!("assembly {assembly}, trial {trial}"));
        }
    }
}

/// Without effects, after a step: the derivatives belong to the new state and the inputs set there.
#[test]
fn declared_dependencies_are_central_differences_on_the_way() {
    for enabled in [vec![], vec!["servo", "viscous", "spring"]] {
        let scene = Scene { reals: vec![("tau[1]".into(), 0.02), ("tip.fy".into(), -0.1)], enabled, assembly: 1 };
        let host = scene.start([1.1, 1.9, 0.5, -1.0]);
        host.run(0.01, 15);
        assert_eq!(host.set_real(&[reference("tau[2]")], &[0.07]), fmi2OK);
        let mut there = scene.clone();
        there.reals.push(("tau[2]".into(), 0.07));
        check_pairs(&host, &there, STATES.map(|name| real(&host, name)), &format!("{:?} after 0.15 s", scene.enabled));
    }
}

/// A symmetric posture: both legs have the same singular value of J_q. Differences across the kink give the mean of both sides.
#[test]
fn coinciding_singular_values_have_the_mean_derivative() {
    let scene = Scene { reals: Vec::new(), enabled: Vec::new(), assembly: 1 };
    let state = [1.2, PI - 1.2, 0.4, -0.3];
    let place = computed().iter().position(|variable| variable.name == "singular.sigmaJq").expect("it is computed");
    let at = |i: usize, change: f64| {
        let mut state = state;
        state[i] += change;
        read(&scene.start(state))[place]
    };
    for (i, known) in STATES.into_iter().enumerate().take(2) {
        let (step, got) = (1e-6, analytic(&scene.start(state), known)[place]);
        let [left, right] = [at(i, 0.0) - at(i, -step), at(i, step) - at(i, 0.0)].map(|difference| difference / step);
        assert!((left - right).abs() > 0.01, "there is a kink: {left} {right}");
        // One-sided differences: curvatures of some 0.1 times the step.
        assert!((got - (left + right) / 2.0).abs() < 1e-6, "{known}: {got} {left} {right}");
    }
}

#[test]
fn a_direction_is_the_sum_of_its_parts() {
    let (scene, state) = everything(&mut ChaCha8Rng::seed_from_u64(42), 1);
    let host = scene.start(state);
    let parts = [("tau[1]", 0.3), ("servo.omega[2]", -2.0), ("theta[2]", 0.7), ("omega[1]", 1.5), ("omega[1]", -0.5)];
    let references: Vec<u32> = computed().iter().map(|variable| variable.reference).collect();
    let mut together = vec![f64::NAN; references.len()];
    let knowns = parts.map(|(name, change)| (reference(name), change));
    assert_eq!(host.directional_derivative(&references, &knowns, &mut together), fmi2OK);
    let single = parts.map(|(name, change)| analytic(&host, name).into_iter().map(|x| x * change).collect::<Vec<_>>());
    for (i, variable) in computed().iter().enumerate() {
        let sum: f64 = single.iter().map(|part| part[i]).sum();
        let size: f64 = single.iter().map(|part| part[i].abs()).sum();
        // Round-off of one solve compared with five, with stiffnesses of some 1e3.
        assert!((together[i] - sum).abs() <= 1e-11 * (1.0 + size), "{}: {} {sum}", variable.name, together[i]);
    }
}

/// At the default start, with the distal links in line, derivatives by inputs exist, by angles and rates they do not.
#[test]
fn in_a_direct_singularity_only_inputs_are_known() {
    let host = Host::ready(&[]);
    for known in STATES {
        assert_eq!(host.directional_derivative(&[reference("tip.x")], &[(reference(known), 1.0)], &mut [0.0]), fmi2Error);
        let text = host.line();
        let begin = "fmi2GetDirectionalDerivative: |singular.detJx|/(link[2].length link[3].length) = ";
        assert!(text.starts_with(begin) && text.contains("must be at least 1e-8"), "{text}");
    }
    for input in inputs() {
        let numeric = differences(1e-3, |change| {
            assert_eq!(host.set_real(&[input.reference], &[change]), fmi2OK);
            read(&host)
        });
        assert_eq!(host.set_real(&[input.reference], &[0.0]), fmi2OK);
        for ((variable, got), [expected, _]) in computed().iter().zip(analytic(&host, input.name)).zip(numeric) {
            // All unknowns are linear in the inputs here, so the rest is round-off of the differences.
            assert!((got - expected).abs() < 1e-8 * (1.0 + got.abs()), "d {}/d {}: {got} {expected}", variable.name, input.name);
        }
    }
}

#[test]
fn what_has_no_derivative_is_refused_by_name() {
    let host = Host::initializing(0.0, None);
    // Initialization mode allows directional derivatives, but not derivatives by time (table of section 4.2.4).
    assert_eq!(host.directional_derivative(&[reference("alpha[1]")], &[(reference("tau[1]"), 1.0)], &mut [0.0]), fmi2OK);
    assert_eq!(host.output_derivative(reference("tip.x"), 1).0, fmi2Error);
    host.take();
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    assert_eq!(host.null_derivatives(0), [fmi2OK; 3]);
    assert_eq!(host.null_derivatives(1), [fmi2Error; 3]);
    host.take();

    let directional = |unknown: u32, known: u32, change: f64| {
        let mut value = [7.0];
        assert_eq!(host.directional_derivative(&[unknown], &[(known, change)], &mut value), fmi2Error);
        assert_eq!(value, [7.0], "nothing is written");
        host.line()
    };
    let [tip, tau, length] = ["tip.x", "tau[1]", "link[1].length"].map(reference);
    assert!(
        directional(tip, length, 1.0)
            .ends_with("link[1].length is not a known: knowns are inputs and the continuous states theta[i], omega[i].")
    );
    assert!(directional(tip, tip, 1.0).contains("tip.x is not a known"));
    assert!(directional(tau, tau, 1.0).contains("tau[1] is not an unknown"));
    assert!(directional(tip, tau, f64::NAN).ends_with("change of tau[1] is NaN, must be finite."));
    assert!(directional(99_999, tau, 1.0).contains("99999 belongs to no variable"));
    // Local variables are allowed, including enumerations and counters.
    let counted = ["singular.type", "solver.steps"].map(reference);
    let mut values = [7.0; 2];
    assert_eq!(host.directional_derivative(&counted, &[(tau, 1.0)], &mut values), fmi2OK);
    assert_eq!(values, [0.0; 2]);

    for (name, order, expected) in [
        ("tip.x", 0, "order of the derivative of tip.x is 0, must be 1 to 2."),
        ("tip.x", 3, "order of the derivative of tip.x is 3, must be 1 to 2."),
        ("omega[1]", 2, "order of the derivative of omega[1] is 2, must be 1."),
        ("contact.fx", 1, "the unit gives no time derivatives of contact.fx, only of positions, angles and their rates."),
        ("passive.theta[1]", 1, "passive.theta[1] is not an output: only outputs have output derivatives."),
        ("solver.steps", 1, "solver.steps (value reference 900) is of type Integer, not Real."),
        ("tau[1]", 1, "tau[1] is not an output: only outputs have output derivatives."),
    ] {
        assert_eq!(host.output_derivative(reference(name), order).0, fmi2Error);
        assert_eq!(host.line(), format!("fmi2GetRealOutputDerivatives: {expected}"));
    }
    for (name, order, value, expected) in [
        ("tau[1]", 0, 1.0, "order of a derivative of tau[1] is 0, must be 1 to 2; fmi2SetReal sets the input itself."),
        ("tau[1]", 3, 1.0, "order of a derivative of tau[1] is 3, must be 1 to 2; fmi2SetReal sets the input itself."),
        ("tau[1]", 1, f64::NAN, "derivative 1 of tau[1] is NaN N.m/s^1, must be finite."),
        ("tip.x", 1, 1.0, "tip.x is not a continuous input: only continuous inputs have input derivatives."),
        ("contact.k", 1, 1.0, "contact.k is not a continuous input: only continuous inputs have input derivatives."),
    ] {
        // All or none: the valid first one is not set either.
        let pair = [(reference("tau[2]"), 1, 1e3), (reference(name), order, value)];
        assert_eq!(host.set_input_derivatives(&pair), fmi2Error);
        assert_eq!(host.line(), format!("fmi2SetRealInputDerivatives: {expected}"));
    }
    host.run(1e-3, 1);
    assert_eq!(real(&host, "tau[2]"), 0.0);
}

/// Derivatives by time agree with the variables that they define, and with differences in time.
#[test]
fn output_derivatives_are_velocities_and_accelerations() {
    let start = || Host::ready(&[("init.theta[1]", 1.2), ("init.theta[2]", 2.0), ("init.omega[1]", 1.0), ("tau[2]", 0.02)]);
    let host = start();
    host.run(1e-3, 20);
    let derivative = |name: &str, order: i32| {
        let (status, value) = host.output_derivative(reference(name), order);
        assert_eq!(status, fmi2OK, "{name}: {:?}", host.take());
        value
    };
    for (name, order, other) in [
        ("theta[1]", 1, "omega[1]"),
        ("theta[2]", 2, "alpha[2]"),
        ("omega[2]", 1, "alpha[2]"),
        ("tip.x", 1, "tip.vx"),
        ("tip.x", 2, "tip.ax"),
        ("tip.y", 2, "tip.ay"),
        ("tip.vy", 1, "tip.ay"),
    ] {
        assert_eq!(derivative(name, order), real(&host, other), "{name}");
    }
    let (earlier, later) = (start(), start());
    earlier.run(1e-3, 19);
    later.run(1e-3, 21);
    for name in ["theta[1]", "theta[2]", "tip.x", "tip.y"] {
        let [before, now, after] = [&earlier, &host, &later].map(|host| real(host, name));
        // h²/6 and h²/12 times third and fourth derivatives of some 1e3 and 1e4. Positions are integrated to 3e-9 per step; a second
        // difference divides this by h², so errors of the steps, h³ times a jerk, also matter.
        assert!((derivative(name, 1) - (after - before) / 2e-3).abs() < 1e-3, "{name}");
        assert!(
            (derivative(name, 2) - (after - 2.0 * now + before) / 1e-6).abs() < 0.05 * (1.0 + derivative(name, 2).abs()),
            "{name}"
        );
    }
}

/// A single leg of inertia I under τ + τ′t + τ″t²/2, constant over each macro step at its mid-step value: ω has the exact impulse minus
/// τ″h²T/24, θ is τ′h²T/12 ahead, both divided by I.
#[test]
fn a_ramp_turns_a_single_leg_as_it_must() {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    let [first, second, ..] = parameters.geometry.links;
    let arm = first.length - second.com;
    let inertia = first.inertia + first.mass * first.com * first.com + second.inertia + second.mass * arm * arm;
    let torque = |x: f64| Inputs { tau: [x, 0.0], ..default_inputs() };
    let (h, t) = (2e-3, 0.2);
    for &method in Method::LIST {
        // Bounds, rad/s and rad: second-order errors at this step of the default, the printed and the conserving method (a quarter at half the
        // step); round-off for the others.
        let (rate_error, angle_error) = match method {
            Method::I3alp => (5e-5, 5e-6),
            Method::I3alpPrinted => (1e-3, 5e-5),
            Method::Rk4 => (1e-8, 5e-9),
            Method::I3alpConserving => (2e-4, 3e-5),
            _ => (1e-12, 1e-12),
        };
        parameters.settings.method = method;
        for (ramp, curvature) in [(0.2, 0.0), (0.2, 0.5), (0.0, 2.0)] {
            let signal = Signal::new(torque(1e-3), [torque(ramp), torque(curvature)]);
            let whirling = Simulation::at(&parameters, &default_inputs(), [0.4, 0.4 + PI, PI, PI], [2.0, 2.0, 0.0, 0.0]);
            let mut simulation = whirling.expect("a folded leg");
            simulation.advance_along(&signal, h, 100).expect("a step");
            let motion = observers::motion(simulation.model(), &simulation.state());
            let impulse = 1e-3 * t + ramp * t * t / 2.0 + curvature * t * t * t / 6.0;
            let twice = 1e-3 * t * t / 2.0 + ramp * t * t * t / 6.0 + curvature * t * t * t * t / 24.0;
            let short = curvature * h * h * t / 24.0;
            // The ramp grows by τ″t, which gives τ″h²T²/24; half of it is lost with the impulse.
            let ahead = ramp * h * h * t / 12.0 + curvature * h * h * t * t / 48.0;
            let rate = motion.omega[0] - 2.0 - (impulse - short) / inertia;
            let angle = motion.theta[0] - 0.4 - 2.0 * t - (twice + ahead) / inertia;
            assert!(rate.abs() < rate_error && angle.abs() < angle_error, "{method:?}, {ramp}, {curvature}: {rate:e} {angle:e}");
        }
    }
}

const MOTION: [&str; 7] = ["theta[1]", "theta[2]", "omega[1]", "omega[2]", "tip.x", "energy.input", "reaction[3].fx"];

fn bits(host: &Host) -> [u64; 7] {
    MOTION.map(|name| real(host, name).to_bits())
}

/// Equal motions, bit for bit except with dense steps: a dense step ends at a foreseen change, and is redone up to an unforeseen one, so that
/// equal steps have differently rounded lengths.
fn same_motion(host: &Host, other: &Host, method: Method) {
    if method.properties().steps != Steps::Dense {
        assert_eq!(bits(host), bits(other), "{method:?}");
    }
    for name in MOTION {
        let (a, b) = (real(host, name), real(other, name));
        assert!((a - b).abs() <= 1e-11 * (1.0 + a.abs()), "{method:?}, {name}: {a} {b}");
    }
}

/// A step along a polynomial equals macro steps with its mid-step values; then the input keeps the final value.
#[test]
fn an_input_with_derivatives_has_its_mid_step_value_in_each_macro_step() {
    for &method in Method::LIST {
        let ready = || {
            let host = Host::initializing(0.0, None);
            assert_eq!(host.set_integer(&[reference("solver.method")], &[method as i32]), fmi2OK);
            assert_eq!(host.set_real(&["init.theta[1]", "init.theta[2]"].map(reference), &[1.2, 2.0]), fmi2OK);
            assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
            host
        };
        let (host, by_hand) = (ready(), ready());
        let [tau, force] = ["tau[1]", "tip.fy"].map(reference);
        assert_eq!(host.set_real(&[tau, force], &[0.01, -0.1]), fmi2OK);
        assert_eq!(host.set_input_derivatives(&[(tau, 1, 0.5), (tau, 2, 8.0), (force, 1, -2.0)]), fmi2OK);
        assert_eq!(host.do_step(0.0, 0.02), fmi2OK);
        let value = |s: f64| [0.01 + 0.5 * s + 8.0 * (s * s / 2.0), -0.1 - 2.0 * s];
        for step in 0..20 {
            let begin = f64::from(step) * 1e-3;
            assert_eq!(by_hand.set_real(&[tau, force], &value(begin + 5e-4)), fmi2OK);
            assert_eq!(by_hand.do_step(begin, 1e-3), fmi2OK);
        }
        // Outputs use the value at the communication point.
        assert_eq!(by_hand.set_real(&[tau, force], &value(0.02)), fmi2OK);
        assert_eq!([real(&host, "tau[1]"), real(&host, "tip.fy")], value(0.02));
        same_motion(&host, &by_hand, method);
        // The derivatives ended with the step.
        assert_eq!((host.do_step(0.02, 0.01), by_hand.do_step(0.02, 0.01)), (fmi2OK, fmi2OK));
        assert_eq!([real(&host, "tau[1]"), real(&host, "tip.fy")], value(0.02));
        same_motion(&host, &by_hand, method);
    }
}

/// A ramp is independent of the communication step up to rounding of its values.
#[test]
fn a_ramp_is_the_same_in_one_step_and_in_many() {
    let tau = reference("tau[1]");
    let run = |count: u32| {
        let host = Host::ready(&[("init.theta[1]", 1.2), ("init.theta[2]", 2.0)]);
        let size = 0.1 / f64::from(count);
        for step in 0..count {
            let begin = f64::from(step) * size;
            assert_eq!(host.set_real(&[tau], &[0.2 * begin]), fmi2OK);
            assert_eq!(host.set_input_derivatives(&[(tau, 1, 0.2)]), fmi2OK);
            assert_eq!(host.do_step(begin, size), fmi2OK);
        }
        MOTION.map(|name| real(&host, name))
    };
    let one = run(1);
    for count in [4, 20, 100] {
        for (name, (got, expected)) in MOTION.into_iter().zip(run(count).into_iter().zip(one)) {
            // Round-off of the torque, 1e-17 N·m, at 1e3 rad/s² per N·m, and of the sums.
            assert!((got - expected).abs() < 1e-11 * (1.0 + expected.abs()), "{count}: {name} {got} {expected}");
        }
    }
}

/// A discarded step leaves the derivatives unchanged, and a stored state contains them, also as bytes.
#[test]
fn pending_derivatives_are_state() {
    let mut instance = Instance::new(Kind::CoSimulation, false);
    instance.set([(reference("init.theta[2]"), Value::Real(2.0))].into_iter()).expect("a start");
    instance.setup_experiment(None, 0.0, None).expect("an experiment");
    instance.enter_initialization_mode().expect("the mode");
    instance
        .set_input_derivatives([(reference("tau[1]"), 1, 3.0), (reference("tau[1]"), 2, -4.0)].into_iter())
        .expect("two orders");
    instance.exit_initialization_mode().expect("a scene");
    let stored = instance.deserialize(&instance.snapshot().to_bytes().expect("bytes")).expect("a state");
    let after = |instance: &mut Instance| {
        instance.do_step(0.0, 0.01).expect("a step");
        let values = instance.get(FmiType::Real, &["tau[1]", "theta[1]"].map(reference)).expect("values");
        [0, 1].map(|i| match values[i] {
            Value::Real(x) => x.to_bits(),
            other => panic!("{other} is no Real"),
        })
    };
    let first = after(&mut instance);
    assert_eq!(f64::from_bits(first[0]), 3.0 * 0.01 - 4.0 * (0.01 * 0.01 / 2.0));
    instance.restore(&stored).expect("a state of the same kind");
    assert_eq!(after(&mut instance), first);

    let host = Host::initializing(0.0, None);
    let printed = 2;
    assert_eq!(host.set_integer(&["solver.method", "solver.maxIterations"].map(reference), &[printed, 1]), fmi2OK);
    assert_eq!(host.set_real(&["solver.stepSize", "init.theta[2]", "init.omega[1]"].map(reference), &[0.1, 2.0, 5.0]), fmi2OK);
    assert_eq!(host.set_input_derivatives(&[(reference("tau[1]"), 1, 1e-3)]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    assert_eq!(host.do_step(0.0, 0.2), fmi2Discard);
    assert_eq!(real(&host, "tau[1]"), 0.0);
    assert_eq!(host.do_step(0.0, 1e-9), fmi2OK, "{:?}", host.take());
    assert_eq!(real(&host, "tau[1]"), 1e-3 * 1e-9);
}

/// A derivative that leaves the range of double precision within the step is refused by name; a shorter step is accepted.
#[test]
fn a_ramp_stays_finite() {
    let host = Host::ready(&[]);
    assert_eq!(host.set_input_derivatives(&[(reference("servo.theta[1]"), 1, 1e308)]), fmi2OK);
    assert_eq!(host.do_step(0.0, 2.0), fmi2Error);
    let refusal = format!("{:?}", host.take());
    assert!(refusal.contains("servo.theta[1], by its derivatives inf rad within 2.0 s, must be finite."), "{refusal}");
    assert_eq!(real(&host, "servo.theta[1]"), 0.0);
    assert_eq!(host.do_step(0.0, 1.0), fmi2OK, "{:?}", host.take());
}
