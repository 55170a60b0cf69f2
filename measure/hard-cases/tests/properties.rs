//! Properties of random machines, states and loads, beyond the listed cases. Every run must terminate. It must be finite, closed and
//! balanced in energy, or end with a status that leaves the state unchanged.
//!
//! The seed is fixed. `PROPTEST_RNG_SEED` and `PROPTEST_CASES` select other machines; the nightly run has 1024.

use fivebar::mechanism::{Assembly, Link};
use fivebar::observers::{self, SingularityKind};
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};
use hard_cases::{POSTURES, mgl};
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{Config, RngSeed};

fn config() -> Config {
    let mut config = Config { failure_persistence: None, max_shrink_iters: 500, ..Config::default() };
    if std::env::var_os("PROPTEST_CASES").is_none() {
        config.cases = 64;
    }
    if matches!(config.rng_seed, RngSeed::Random) {
        config.rng_seed = RngSeed::Fixed(3);
    }
    // Machines that cannot start are not counted; at least three of four must run.
    config.max_global_rejects = config.cases / 3;
    config
}

fn log_uniform(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.ln()..high.ln()).prop_map(f64::exp)
}

/// Mass, inertia and centre of mass of a link of unit length, scaled to a length.
fn link(length: f64) -> impl Strategy<Value = Link> {
    (log_uniform(1e-3, 10.0), log_uniform(0.01, 0.5), -0.2..1.2).prop_map(move |(mass, inertia, com)| Link {
        length,
        mass,
        inertia: inertia * mass * length * length,
        com: com * length,
    })
}

fn any_link() -> impl Strategy<Value = Link> {
    log_uniform(0.05, 1.0).prop_flat_map(link)
}

/// The link with its length multiplied by `factor`, and its other data to match.
fn stretched(link: Link, factor: f64) -> Link {
    Link { length: link.length * factor, com: link.com * factor, inertia: link.inertia * factor * factor, ..link }
}

/// Changes the distal lengths if they would not meet; `slack` is the resulting distance of the posture from a singularity.
fn reaching(mut parameters: Parameters, slack: f64) -> Parameters {
    let [theta, other] = parameters.start.theta;
    let links = &mut parameters.geometry.links;
    let (left, right) = (links[0].length, links[3].length);
    let across = parameters.geometry.base_distance + right * other.cos() - left * theta.cos();
    let distance = across.hypot(right * other.sin() - left * theta.sin());
    let (longer, shorter) = if links[1].length > links[2].length { (1, 2) } else { (2, 1) };
    if links[1].length + links[2].length < distance {
        let factor = distance * (1.0 + slack) / (links[1].length + links[2].length);
        (links[1], links[2]) = (stretched(links[1], factor), stretched(links[2], factor));
    } else if links[longer].length - links[shorter].length > distance {
        let wanted = links[shorter].length + distance * (1.0 - slack / 2.0);
        links[longer] = stretched(links[longer], wanted / links[longer].length);
    }
    parameters
}

/// A machine of any proportions with any motion, at the default settings.
fn any_scene() -> impl Strategy<Value = Parameters> {
    let links = prop::array::uniform4(any_link());
    let angle = -3.2..3.2;
    (links, 0.0..1.5, (angle.clone(), angle), (-10.0..10.0, -10.0..10.0), any::<(bool, bool)>(), log_uniform(1e-4, 1.0)).prop_map(
        |(links, base, (a, b), (v, w), (above, gravity), slack)| {
            let mut parameters = default_parameters();
            parameters.geometry.links = links;
            parameters.geometry.base_distance = base;
            parameters.start.theta = [a, b];
            parameters.start.omega = [v, w];
            parameters.start.assembly = if above { Assembly::Plus } else { Assembly::Minus };
            parameters.effects.gravity.enabled = gravity;
            reaching(parameters, slack)
        },
    )
}

/// Loads in units of the machine's own mgL (torques) and mg (tip force).
fn any_load() -> impl Strategy<Value = [f64; 4]> {
    let one = prop_oneof![2 => Just(0.0), 1 => -3.0..3.0];
    prop::array::uniform4(one)
}

fn loads(parameters: &Parameters, [left, right, x, y]: [f64; 4]) -> Inputs {
    let unit = mgl(&parameters.geometry);
    let length = parameters.geometry.links.iter().map(|link| link.length).fold(0.0, f64::max);
    Inputs { tau: [left * unit, right * unit], tip_force: [x * unit / length, y * unit / length], ..Inputs::default() }
}

/// Torques of several mgL accelerate links of one gram to thousands of rad/s. A run that reaches this number of sub-steps ends there.
const MOST_SUBSTEPS: u64 = 20_000;

/// Runs `steps` steps of `h` within the bounds of the battery; the unit of energy is the larger of mgL and the largest kinetic energy.
fn follow(
    simulation: &mut Simulation,
    parameters: &Parameters,
    inputs: &Inputs,
    h: f64,
    steps: u64,
    judged: bool,
) -> Result<(), TestCaseError> {
    let unit = mgl(&parameters.geometry);
    let size = parameters.geometry.length_scale() / default_parameters().geometry.length_scale();
    let mut peak: f64 = 0.0;
    for step in 0..steps {
        if simulation.state().core.counters.substeps > MOST_SUBSTEPS {
            return Ok(());
        }
        let before = simulation.state();
        if let Err(failure) = simulation.advance(inputs, h, 1) {
            prop_assert_eq!(before, simulation.state(), "a failed step has changed the state: {}", failure);
            prop_assert!(!failure.to_string().is_empty());
            return Ok(());
        }
        let (model, state) = (simulation.model(), &simulation.state());
        let core = &state.core;
        let sum: f64 = core.q.iter().chain(&core.v).chain(&core.a).chain(&core.lambda).sum();
        prop_assert!(sum.is_finite(), "not finite after step {}", step + 1);
        if !judged {
            continue;
        }
        let (norms, energies) = (observers::constraint_norms(model, state), observers::energies(model, state));
        peak = peak.max(energies.kinetic);
        let error = energies.error.abs() / unit.max(peak);
        prop_assert!(error <= 1e-2, "step {}: energy error {error:e}", step + 1);
        // In a vertex a projection divides by the vanishing singular value.
        if observers::singularity(model, state).kind == SingularityKind::Constraint {
            continue;
        }
        prop_assert!(norms.position <= 1e-12 * size.max(1.0), "step {}: Phi {:e} m, size {size}", step + 1, norms.position);
        let fastest = observers::motion(model, state).omega.into_iter().fold(10.0, |fastest: f64, rate| fastest.max(rate.abs()));
        prop_assert!(
            norms.velocity <= 1e-10 * fastest * size.max(1.0),
            "step {}: Phidot {:e} m/s at {fastest} rad/s",
            step + 1,
            norms.velocity
        );
    }
    Ok(())
}

proptest! {
    #![proptest_config(config())]

    /// Any machine at the default settings.
    #[test]
    fn any_machine_is_finite_closed_and_balanced(parameters in any_scene(), load in any_load(), h in log_uniform(1e-5, 1e-2)) {
        let inputs = loads(&parameters, load);
        let simulation = Simulation::new(&parameters, &inputs);
        prop_assume!(simulation.is_ok());
        follow(&mut simulation.expect("assumed"), &parameters, &inputs, h, 200, true)?;
    }

    /// Other methods and settings: never NaN, and a failed step changes nothing.
    #[test]
    fn no_method_gives_nan(
        mut parameters in any_scene(),
        load in any_load(),
        method in select(Method::LIST),
        adaptive in any::<bool>(),
        tolerance in log_uniform(1e-13, 1e-3),
        h in log_uniform(1e-6, 2e-2),
    ) {
        let settings = &mut parameters.settings;
        (settings.method, settings.adaptive, settings.error_tolerance) = (method, adaptive, tolerance);
        let inputs = loads(&parameters, load);
        let simulation = Simulation::new(&parameters, &inputs);
        prop_assume!(simulation.is_ok());
        follow(&mut simulation.expect("assumed"), &parameters, &inputs, h, 50, false)?;
    }

    /// Rest in a vertex of the paper's lengths with any masses and loads.
    #[test]
    fn rest_in_a_vertex_is_finite_and_balanced(
        links in prop::array::uniform4(link(0.21)),
        vertex in 0..4_usize,
        load in any_load(),
        gravity in any::<bool>(),
    ) {
        let mut parameters = default_parameters();
        parameters.geometry.links = links;
        parameters.effects.gravity.enabled = gravity;
        let inputs = loads(&parameters, load);
        let mut simulation = Simulation::at(&parameters, &inputs, POSTURES[vertex].theta, [0.0; 4]).expect("a vertex");
        follow(&mut simulation, &parameters, &inputs, 1e-3, 100, true)?;
    }

    /// Any direction of the cone through any vertex at any rate: finite and balanced on the way in and out.
    #[test]
    fn motion_through_a_vertex_is_finite_and_balanced(
        vertex in 0..4_usize,
        f in 0.0..std::f64::consts::TAU,
        rate in prop_oneof![log_uniform(0.1, 50.0), log_uniform(0.1, 50.0).prop_map(|rate| -rate)],
        gravity in any::<bool>(),
    ) {
        let mut parameters = default_parameters();
        parameters.effects.gravity.enabled = gravity;
        let omega = POSTURES[vertex].direction(f).map(|part| part * rate);
        let inputs = loads(&parameters, [0.0; 4]);
        let mut simulation = Simulation::at(&parameters, &inputs, POSTURES[vertex].theta, omega).expect("a direction of the cone");
        follow(&mut simulation, &parameters, &inputs, 1e-3, 200, true)?;
    }
}
