//! Stored states changed with a corrected checksum, which is no secret: each is refused, or is a motion that closes the loop.
//!
//! Changes bytes of every kind of state (in the nightly run every byte): by every method and every linear solve, at every stage of the life
//! cycle. A forged state is never fatal, never gives a value that is not finite with fmi2OK, and costs bounded work: restoring evaluates
//! some states inside the current step, and `solver.maxWork` ends each later step.

use std::collections::HashMap;
use std::ptr::null_mut;
use std::sync::LazyLock;

use fivebar::ffi::*;
use fivebar::variables::{FmiType, VARIABLES, Value, VariableId};

use crate::fmi_host::Host;
use crate::support::is_nightly;

/// Bytes before the content: name, format, GUID, length. `bytes_that_are_no_state_are_refused` changes them.
const HEAD: usize = 58;
const CHECKSUM: usize = 4;

/// Changes of a byte. Each byte gets one change, its neighbour the next change; the next case starts with another change.
const CHANGES: [fn(u8) -> u8; 7] = [
    |byte| byte ^ 0x01,
    |byte| byte ^ 0x80,
    |_| 0x00,
    |_| 0xff,
    |byte| byte ^ 0x03,
    |byte| byte ^ 0x40,
    |byte| byte.wrapping_add(2),
];

/// The normal run forges one in this many bytes, the nightly run each. Coprime to the number of changes, so that each change reaches every
/// byte of a number.
const STRIDE: usize = 5;

/// A step of the master, s.
const STEP: f64 = 2e-3;

/// A state to forge.
struct Case {
    name: String,
    bytes: Vec<u8>,
}

/// All Real variables in the order of [`REALS`]; `None` if they cannot be read.
type Outputs = Option<Vec<f64>>;

/// Value references by name, cached for all forgeries.
static REFERENCES: LazyLock<HashMap<&str, u32>> =
    LazyLock::new(|| VARIABLES.iter().map(|variable| (variable.name, variable.reference)).collect());

/// References of all Real variables.
static REALS: LazyLock<Vec<u32>> = LazyLock::new(|| {
    VARIABLES.iter().filter(|variable| variable.fmi_type() == FmiType::Real).map(|variable| variable.reference).collect()
});

fn reference(name: &str) -> u32 {
    REFERENCES[name]
}

fn value(outputs: &[f64], name: &str) -> f64 {
    outputs[REALS.binary_search(&reference(name)).expect("a real variable")]
}

/// Whether initialisation is complete.
fn is_running(host: &Host) -> bool {
    host.real_status(2).0 == fmi2OK
}

/// Largest allowed violation of the constraints for the method: positions, m, and velocities, m/s.
///
/// Positions are closed to round-off, with a wide margin; angles of so many turns that their own round-off is larger are the caller's
/// responsibility. The printed method stops at 1e-8 of some 0.9 m. A state is refused if its rates open the loop by 1e-5 of their largest
/// term, some 10 m/s here, and by half of it for the printed method: its projection by a finite penalty leaves a sixth of the velocity
/// error.
fn bounds(host: &Host) -> [f64; 2] {
    let (mut method, mut theta) = ([0], [0.0; 2]);
    assert_eq!(host.get_integer(&[reference("solver.method")], &mut method), fmi2OK);
    assert_eq!(host.get_real(&["init.theta[1]", "init.theta[2]"].map(reference), &mut theta), fmi2OK);
    let rounded = 4.0 * f64::EPSILON * theta[0].abs().max(theta[1].abs());
    if method == [2] { [1e-7 + rounded, 5.0] } else { [1e-10 + rounded, 1e-4] }
}

/// Reads everything; checks that each value is finite.
fn outputs(host: &Host) -> Result<Outputs, String> {
    let mut values = vec![f64::NAN; REALS.len()];
    let mut places = vec![0; 3];
    let integers = ["singular.type", "mode.working", "solver.steps"].map(reference);
    match (host.get_real(&REALS, &mut values), host.get_integer(&integers, &mut places)) {
        (_, status) if status != fmi2OK => Err(format!("integers cannot be read: {:?}", host.take())),
        (status, _) if status == fmi2OK => match values.iter().position(|value| !value.is_finite()) {
            None => Ok(Some(values)),
            Some(place) => Err(format!("variable {} is not finite", REALS[place])),
        },
        (status, _) if status == fmi2Discard => Ok(None),
        (status, _) => Err(format!("reading is answered with {status}: {:?}", host.take())),
    }
}

/// Restores a forged state and continues from it. `Ok(true)` if it is refused; a message if it does harm.
fn judge(forged: &[u8]) -> Result<bool, String> {
    let host = Host::new();
    let mut state = null_mut();
    let status = host.deserialize(forged, &mut state);
    if status == fmi2Error {
        let line = host.line();
        return if line.starts_with("fmi2DeSerializeFMUstate: ") { Ok(true) } else { Err(format!("refused by \"{line}\"")) };
    }
    let set = host.set_state(state);
    if status == fmi2OK && set == fmi2Error && host.free_state(&mut state) == fmi2OK {
        // The state of another kind of instance.
        let line = host.line();
        return if line.contains(": FMUstate belongs to an instance for ") {
            Ok(true)
        } else {
            Err(format!("refused by \"{line}\""))
        };
    }
    if status != fmi2OK || set != fmi2OK {
        return Err(format!("answered with {status}: {:?}", host.take()));
    }
    if host.free_state(&mut state) != fmi2OK {
        return Err("cannot be freed".into());
    }
    follow(&host).map(|()| false)
}

/// Reads an accepted state and continues from it.
fn follow(host: &Host) -> Result<(), String> {
    // If the state says that setup has not happened, setup and initialisation may be refused, as with any parameters.
    host.setup(None, 0.0, None);
    let initialised = [fmi2EnterInitializationMode, fmi2ExitInitializationMode].map(|function| host.call(function));
    if initialised.contains(&fmi2Fatal) {
        return Err(format!("initialising is fatal: {:?}", host.take()));
    }
    let running = is_running(host);
    host.take();
    if !running {
        return Ok(());
    }
    let closed = bounds(host);
    for (moment, name) in ["at once", "later"].into_iter().enumerate() {
        let done = if moment == 0 { Done::All } else { steps(host)? };
        if done == Done::Refused {
            return Ok(());
        }
        let Some(seen) = outputs(host)? else { continue };
        let [position, velocity] = ["solver.positionError", "solver.velocityError"].map(|name| value(&seen, name));
        // Forged rates may be any that close the loop; their round-off grows with them, here above 1000 rad/s.
        let fastest = ["omega[1]", "omega[2]"].map(|name| value(&seen, name).abs()).into_iter().fold(0.0, f64::max);
        if position > closed[0] || velocity > closed[1] * (1.0 + 1e-3 * fastest) {
            return Err(format!("{name}: the loop is open by {position:e} m, {velocity:e} m/s"));
        }
    }
    Ok(())
}

/// Result of some steps.
#[derive(Debug, PartialEq)]
enum Done {
    All,
    /// A step was discarded; the rest was not tried.
    Discarded,
    /// The step was refused as impossible.
    Refused,
}

/// Some steps.
fn steps(host: &Host) -> Result<Done, String> {
    let mut size = [0.0];
    host.get_real(&[reference("solver.stepSize")], &mut size);
    // At most a few macro steps each, because a call may contain a thousand million.
    let size = STEP.min(4.0 * size[0]);
    for _ in 0..3 {
        let (_, point) = host.real_status(2);
        let status = host.do_step(point, size);
        let lines = host.take();
        match status {
            _ if status == fmi2OK => {}
            _ if status == fmi2Discard => return Ok(Done::Discarded),
            _ if status == fmi2Error => {
                // Refusals: wrong stage; a time so large, or so close to the end, that the step is nothing or too much; a tuned value.
                let known = ["the state is \"terminated\"", "does not advance", "past stopTime", "must be", "must not"];
                let expected = lines.last().is_some_and(|line| known.iter().any(|known| line.text.contains(known)));
                return if expected { Ok(Done::Refused) } else { Err(format!("a step is refused: {lines:?}")) };
            }
            _ => return Err(format!("a step is answered with {status}: {lines:?}")),
        }
    }
    Ok(Done::All)
}

/// Forges bytes of the content.
fn forge(case: &Case, number: usize, wrong: &mut Vec<String>) -> [usize; 2] {
    let stride = if is_nightly() { 1 } else { STRIDE };
    let end = case.bytes.len() - CHECKSUM;
    let (mut refused, mut accepted) = (0, 0);
    for position in (HEAD + number % stride..end).step_by(stride) {
        let mut forged = case.bytes.clone();
        forged[position] = CHANGES[(position + number) % CHANGES.len()](forged[position]);
        if forged == case.bytes {
            continue;
        }
        let checksum = adler2::adler32_slice(&forged[..end]);
        forged[end..].copy_from_slice(&checksum.to_le_bytes());
        match judge(&forged) {
            Ok(true) => refused += 1,
            Ok(false) => accepted += 1,
            Err(what) => {
                let [was, is] = [case.bytes[position], forged[position]];
                wrong.push(format!("{}: byte {} of the content, {was:#04x} → {is:#04x}: {what}", case.name, position - HEAD));
            }
        }
    }
    [refused, accepted]
}

/// The state of an instance.
fn case(name: &str, host: &Host) -> Case {
    let mut state = host.state();
    let (_, size) = host.serialized_size(state);
    let (status, bytes) = host.serialize(state, size);
    assert_eq!((status, host.free_state(&mut state)), (fmi2OK, fmi2OK));
    assert_eq!(judge(&bytes), Ok(false), "{name}");
    host.take();
    Case { name: name.to_owned(), bytes }
}

/// A scene with a method and a linear solve, after 10 steps.
fn running(method: i32, adaptive: bool, solve: &str, changing: bool) -> Host {
    let host = Host::initializing(0.0, None);
    let integers = [reference("solver.method")];
    assert_eq!(host.set_integer(&integers, &[method]), fmi2OK);
    let booleans = ["solver.adaptive", "friction.enabled", "contact.enabled"].map(reference);
    let enabled = [adaptive, matches!(solve, "coupled" | "sticking"), solve == "sticking tip"];
    assert_eq!(host.set_boolean(&booleans, &enabled.map(i32::from)), fmi2OK);
    let mut values = vec![("init.theta[2]", 2.0), ("tau[1]", 0.01), ("solver.stepSize", 1e-3)];
    if solve == "sticking" {
        assert_eq!(host.set_integer(&[reference("friction.law")], &[2]), fmi2OK);
        values.extend([("friction.coulomb[1]", 1.0), ("friction.breakaway[1]", 1.0)]);
    }
    if solve == "late" {
        assert_eq!(host.set_boolean(&[reference("servo.enabled")], &[1]), fmi2OK);
        values.extend([("servo.delay", 7e-3), ("servo.theta[1]", 1.6), ("servo.theta[2]", 2.0)]);
    }
    if solve == "stiff" {
        assert_eq!(host.set_boolean(&[reference("servo.enabled")], &[1]), fmi2OK);
        values.extend([("servo.kp[1]", 200.0), ("servo.kd[1]", 2.0), ("servo.limit[1]", 50.0), ("servo.theta[1]", 1.6)]);
        values.extend([("servo.kp[2]", 200.0), ("servo.kd[2]", 2.0), ("servo.limit[2]", 50.0), ("servo.theta[2]", 2.0)]);
    }
    if solve == "sticking tip" {
        assert_eq!(host.set_real(&[reference("init.theta[2]")], &[2.0]), fmi2OK);
        let mut height = [0.0];
        assert_eq!(host.get_real(&[reference("tip.y")], &mut height), fmi2OK);
        assert_eq!(host.set_integer(&[reference("contact.law")], &[2]), fmi2OK);
        // The tip lies on the plane, pressed in far enough to stay there.
        values.extend([("contact.offset", height[0] + 2e-4), ("contact.mu", 20.0), ("contact.d", 50.0)]);
    }
    if solve == "dense" {
        values.extend(
            (1..=4).map(|link| (["link[1].inertia", "link[2].inertia", "link[3].inertia", "link[4].inertia"][link - 1], 1e-9)),
        );
    }
    for (name, value) in values {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK, "{name}: {:?}", host.take());
    }
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
    for step in 0..10 {
        if changing {
            assert_eq!(host.set_real(&[reference("tau[1]")], &[1e-3 * f64::from(step)]), fmi2OK);
        }
        if solve == "late" {
            assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[1.6 + 0.01 * f64::from(step)]), fmi2OK);
            assert_eq!(host.set_input_derivatives(&[(reference("servo.theta[2]"), 1, f64::from(step % 3))]), fmi2OK);
        }
        assert_eq!(host.do_step(f64::from(step) * STEP, STEP), fmi2OK, "{method} {solve}: {:?}", host.take());
    }
    host
}

/// Forges the state of every run, given by method, `solver.adaptive`, whether inputs change, and the linear solve or the effect. The first
/// is case `number`, so that tests in parallel continue the sequence of byte changes.
fn forge_runs(number: usize, runs: &[(i32, bool, bool, &str)]) {
    let (mut wrong, mut counts) = (Vec::new(), Vec::new());
    for (number, &(method, adaptive, changing, solve)) in (number..).zip(runs) {
        let name = format!("method {method}, adaptive {adaptive}, changing {changing}, {solve}");
        let case = case(&name, &running(method, adaptive, solve, changing));
        counts.push((forge(&case, number, &mut wrong), name));
    }
    assert!(wrong.is_empty(), "{} forgeries:\n{}", wrong.len(), wrong.join("\n"));
    assert!(counts.iter().all(|([refused, accepted], _)| *refused > 0 && *accepted > 0), "{counts:?}");
}

/// Every method with one linear solve; the explicit one in the middle of a step and, with changing inputs, at its end; implicit steps of
/// the method that chooses.
fn forge_methods(number: usize, solve: &str) {
    let runs = [
        (1, true, false),
        (1, false, false),
        (2, false, false),
        (3, false, false),
        (4, true, false),
        (4, true, true),
        (5, false, false),
        (6, true, true),
    ];
    forge_runs(number, &runs.map(|(method, adaptive, changing)| (method, adaptive, changing, solve)));
}

#[test]
fn forged_runs_by_two_legs_are_refused_or_go_on() {
    forge_methods(0, "two-leg");
}

#[test]
fn forged_runs_with_coupled_legs_are_refused_or_go_on() {
    forge_methods(8, "coupled");
}

#[test]
fn forged_runs_by_the_dense_solve_are_refused_or_go_on() {
    forge_methods(16, "dense");
}

/// Friction that holds a joint or the tip, and stiff servos.
#[test]
fn forged_runs_that_stick_or_are_stiff_are_refused_or_go_on() {
    let runs = [
        (1, true, false, "sticking"),
        (4, true, false, "sticking"),
        (4, true, true, "sticking"),
        (1, true, false, "sticking tip"),
        (4, true, true, "sticking tip"),
        (6, true, false, "stiff"),
        (6, true, true, "stiff"),
    ];
    forge_runs(24, &runs);
}

/// Commands that wait, of constant references and of ramps.
#[test]
fn forged_runs_with_commands_that_wait_are_refused_or_go_on() {
    forge_runs(31, &[(1, true, false, "late"), (3, false, false, "late"), (5, false, false, "late"), (6, true, false, "late")]);
}

/// Other values of the Real parameters, because a stored state contains only those that differ from their start values. The start itself
/// stays: the digits of a legal angle of 1e15 rad do not determine a posture.
fn with_other_parameters(host: Host) -> Host {
    for variable in VARIABLES.iter().filter(|variable| !variable.name.starts_with("init.")) {
        if let (VariableId::Parameter(_), Some(Value::Real(start))) = (variable.id, variable.start) {
            let value = (1.25 * start + 0.125).min(variable.max.unwrap_or(f64::INFINITY));
            assert_eq!(host.set_real(&[variable.reference], &[value]), fmi2OK, "{:?}", host.take());
        }
    }
    host
}

/// Before and after a run, and with pending values: inputs with derivatives, a tuned parameter.
#[test]
fn forged_stages_and_pending_values_are_refused_or_go_on() {
    let pending = running(1, true, "two-leg", false);
    assert_eq!(pending.set_real(&[reference("gravity.g"), reference("tip.fx")], &[5.0, 0.1]), fmi2OK);
    assert_eq!(pending.set_input_derivatives(&[(reference("tau[1]"), 1, 0.5), (reference("tau[2]"), 2, -3.0)]), fmi2OK);
    let ending = Host::initializing(0.0, Some(1.0));
    assert_eq!(ending.call(fmi2ExitInitializationMode), fmi2OK);
    let mut wrong = Vec::new();
    for (number, (name, host)) in [
        ("instantiated", with_other_parameters(Host::new())),
        ("initializing", with_other_parameters(Host::initializing(0.0, Some(1.0)))),
        ("with a stop time", ending),
        ("pending", pending),
    ]
    .into_iter()
    .enumerate()
    {
        let [refused, accepted] = forge(&case(name, &host), number, &mut wrong);
        assert!(refused > 0 && accepted > 0, "{name}");
    }
    assert!(wrong.is_empty(), "{} forgeries:\n{}", wrong.len(), wrong.join("\n"));
}
