//! Following a machine through the C functions: variables, encoder faults, stored states.

use fivebar::ffi::*;
use fivebar::variables::VARIABLES;

use crate::allocation::allocations;
use crate::fmi_host::{EXACT, Host, methods, reference};

const STATUS: [(&str, i32); 12] = [
    ("off", 1),
    ("following", 2),
    ("coasting", 3),
    ("oneEncoder", 4),
    ("holding", 5),
    ("twoBranches", 6),
    ("inconsistent", 7),
    ("rejected", 8),
    ("late", 9),
    ("future", 10),
    ("invalid", 11),
    ("stuck", 12),
];

/// Items of `estimator.forecast`.
const LINEAR: i32 = 1;
const SIGMA_POINTS: i32 = 2;

/// A fall of the table-top machine with following enabled, ready to step.
fn following(method: i32, values: &[(&str, f64)]) -> Host {
    foreseeing(method, LINEAR, values)
}

/// As [`following`], with a forecast method.
fn foreseeing(method: i32, forecast: i32, values: &[(&str, f64)]) -> Host {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_integer(&[reference("estimator.forecast")], &[forecast]), fmi2OK);
    assert_eq!(host.set_boolean(&[reference("estimator.enabled")], &[1]), fmi2OK);
    assert_eq!(host.set_integer(&[reference("solver.method")], &[method]), fmi2OK);
    let start = [("base.distance", 0.1), ("init.theta[1]", 2.2), ("init.theta[2]", 0.9), ("estimator.sigma0.theta", 0.02)];
    let quanta = [("estimator.quantum[1]", 1e-4), ("estimator.quantum[2]", 1e-4), ("estimator.sigma0.omega", 0.2)];
    for (name, value) in start.iter().chain(&quanta).chain(&EXACT).chain(values) {
        assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
    }
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
    host
}

fn real(host: &Host, name: &str) -> f64 {
    let mut value = [0.0];
    assert_eq!(host.get_real(&[reference(name)], &mut value), fmi2OK, "{name}: {:?}", host.take());
    value[0]
}

fn status(host: &Host) -> &'static str {
    let mut value = [0];
    assert_eq!(host.get_integer(&[reference("estimated.status")], &mut value), fmi2OK);
    STATUS.iter().find(|(_, number)| *number == value[0]).expect("a status").0
}

fn measure(host: &Host, theta: [f64; 2], time: [f64; 2]) {
    let names = ["measured.theta[1]", "measured.theta[2]", "measured.time[1]", "measured.time[2]"].map(reference);
    assert_eq!(host.set_real(&names, &[theta[0], theta[1], time[0], time[1]]), fmi2OK, "{:?}", host.take());
}

const H: f64 = 1e-3;

/// The machine itself: another start, 0.01 rad off.
fn machine() -> Host {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_integer(&[reference("solver.method")], &[4]), fmi2OK);
    for (name, value) in [("base.distance", 0.1), ("init.theta[1]", 2.21), ("init.theta[2]", 0.89)] {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host
}

fn angles(host: &Host) -> [f64; 2] {
    [real(host, "theta[1]"), real(host, "theta[2]")]
}

/// Runs `steps` on both; `seen` changes the samples (angles, times).
fn follow(host: &Host, machine: &Host, steps: std::ops::Range<u32>, seen: impl Fn([f64; 2], f64) -> ([f64; 2], [f64; 2])) {
    for step in steps {
        let time = f64::from(step) * H;
        let (theta, times) = seen(angles(machine).map(|angle| (angle / 1e-4).round() * 1e-4), time);
        measure(host, theta, times);
        assert_eq!(host.do_step(time, H), fmi2OK, "{:?}", host.take());
        assert_eq!(machine.do_step(time, H), fmi2OK);
    }
}

fn at_once(theta: [f64; 2], time: f64) -> ([f64; 2], [f64; 2]) {
    (theta, [time; 2])
}

fn tip_error(host: &Host, machine: &Host) -> f64 {
    ["tip.x", "tip.y"].map(|name| real(host, name) - real(machine, name)).iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn bytes_of(host: &Host, state: fmi2FMUstate) -> Vec<u8> {
    let (status, size) = host.serialized_size(state);
    let (written, bytes) = host.serialize(state, size);
    assert_eq!((status, written), (fmi2OK, fmi2OK));
    bytes
}

fn state_of(host: &Host, bytes: &[u8]) -> fmi2FMUstate {
    let mut state = std::ptr::null_mut();
    assert_eq!(host.deserialize(bytes, &mut state), fmi2OK, "{:?}", host.take());
    state
}

/// Every Real except the samples, as bits.
fn reals(host: &Host) -> Vec<u64> {
    let computed = VARIABLES.iter().filter(|v| v.start.is_none() && v.fmi_type() == fivebar::variables::FmiType::Real);
    let references: Vec<u32> = computed.map(|v| v.reference).collect();
    let mut values = vec![0.0; references.len()];
    assert_eq!(host.get_real(&references, &mut values), fmi2OK, "{:?}", host.take());
    values.into_iter().map(f64::to_bits).collect()
}

#[test]
fn a_disabled_estimator_estimates_nothing() {
    let host = Host::ready(&[]);
    measure(&host, [1.0, 2.0], [0.0, 0.0]);
    let plain = Host::ready(&[]);
    for instance in [&host, &plain] {
        assert_eq!(instance.do_step(0.0, H), fmi2OK);
    }
    assert_eq!((status(&host), real(&host, "estimated.nis"), real(&host, "measured.theta[2]")), ("off", 0.0, 2.0));
    assert_eq!(reals(&host), reals(&plain));
}

#[test]
fn a_machine_is_followed_by_every_method() {
    for method in methods() {
        let (host, machine) = (following(method, &[]), machine());
        assert_eq!(status(&host), "coasting");
        let before = tip_error(&host, &machine);
        follow(&host, &machine, 0..300, at_once);
        let after = tip_error(&host, &machine);
        // 1e-4 rad of 0.21 m are 0.02 mm; the start was 3 mm off.
        assert!(before > 1e-3 && after < 5e-5, "method {method}: {before} {after}");
        assert_eq!(status(&host), "following", "method {method}");
        assert!(real(&host, "estimated.theta.sigma[1]") < 1e-4);
        assert_eq!(host.take(), []);
    }
}

/// Steps with samples, steps without, and forecasts by sigma points allocate nothing, with every method.
#[test]
fn following_allocates_nothing() {
    for method in methods() {
        let (host, machine) = (foreseeing(method, SIGMA_POINTS, &[("estimator.maxDelay", 4e-3)]), machine());
        follow(&host, &machine, 0..20, at_once);
        let samples: Vec<[f64; 4]> = (20..40)
            .map(|step| {
                let ([left, right], time) = (angles(&machine), f64::from(step) * H);
                assert_eq!(machine.do_step(time, H), fmi2OK);
                [left, right, time, time]
            })
            .collect();
        let names = ["measured.theta[1]", "measured.theta[2]", "measured.time[1]", "measured.time[2]"].map(reference);
        let read = ["tip.x", "estimated.tip.cov[1]", "estimated.nis"].map(reference);
        let go = |step: u32, sample: Option<&[f64; 4]>| {
            if let Some(sample) = sample {
                assert_eq!(host.set_real(&names, sample), fmi2OK);
            }
            assert_eq!(host.do_step(f64::from(step) * H, H), fmi2OK);
            assert_eq!(host.get_real(&read, &mut [0.0; 3]), fmi2OK);
        };
        let followed = allocations(|| (20..40).zip(&samples).for_each(|(step, sample)| go(step, Some(sample))));
        // The log has a line for silent encoders.
        (40..60).for_each(|step| go(step, None));
        let coasted = allocations(|| (60..80).for_each(|step| go(step, None)));
        assert_eq!((followed, coasted), (0, 0), "method {method}: {:?}", host.take());
    }
}

/// Outputs change only in fmi2DoStep: samples are no direct inputs of them.
#[test]
fn samples_change_no_output() {
    let (host, machine) = (following(1, &[]), machine());
    follow(&host, &machine, 0..20, at_once);
    let before = reals(&host);
    measure(&host, [0.3, 0.4], [0.02, 0.02]);
    assert_eq!(reals(&host), before);
    let state = host.state();
    measure(&host, [f64::NAN, 0.4], [0.02, 0.02]);
    assert_eq!(reals(&host), before);
    assert_eq!(host.set_state(state), fmi2OK);
    assert_eq!(real(&host, "measured.theta[1]"), 0.3);
    let mut state = state;
    assert_eq!(host.free_state(&mut state), fmi2OK);
}

/// Encoder faults: a status, a cause, one line in the log, and an estimate that continues.
#[test]
fn faults_are_reported_once_and_survived() {
    type Seen = fn([f64; 2], f64) -> ([f64; 2], [f64; 2]);
    let cases: [(&str, f64, &str, Seen); 6] = [
        ("late", 7.0, "is older than estimator.maxDelay", |theta, time| (theta, [time - 0.02, time])),
        ("future", 7.0, "after the communication point", |theta, time| (theta, [time + 0.02, time])),
        ("invalid", 4.0, "is not finite", |theta, time| ([f64::NAN, theta[1]], [time; 2])),
        ("oneEncoder", 4.0, "has been silent", |theta, time| (theta, [0.049, time])),
        ("stuck", 4.0, "repeats its value", |theta, time| ([2.2, theta[1]], [time; 2])),
        ("rejected", 0.0, "too far from the predicted angle", |theta, time| {
            // An occasional outlier.
            let wild = if (time / H).round() as i64 % 10 == 9 { 0.2 } else { 0.0 };
            ([theta[0] + wild, theta[1]], [time; 2])
        }),
    ];
    for (name, cause, text, seen) in cases {
        let (host, machine) = (following(1, &[]), machine());
        follow(&host, &machine, 0..50, at_once);
        assert_eq!(host.take(), [], "{name}");
        assert_eq!(["estimated.cause", "estimated.cause.probability"].map(|name| real(&host, name)), [0.0, 1.0], "{name}");
        follow(&host, &machine, 50..80, seen);
        assert_eq!(status(&host), name);
        assert_eq!(real(&host, "estimated.cause"), cause, "{name}");
        let lines = host.take();
        // A stuck encoder jumps first, so it counts as an outlier before it repeats itself.
        assert_eq!(lines.len(), 1 + usize::from(name == "stuck"), "{name}: {lines:?}");
        let told = &lines[lines.len() - 1].text;
        assert!(told.contains(text) && told.contains("measured.theta[1]"), "{name}: {lines:?}");
        follow(&host, &machine, 80..200, at_once);
        assert_eq!(status(&host), "following", "{name}");
        assert!(tip_error(&host, &machine) < 1e-4, "{name}: {}", tip_error(&host, &machine));
        assert_eq!(host.take(), [], "{name}");
    }
}

/// A stuck encoder remains the cause for a second after it recovers, whatever its first readings are; an encoder that never delivered is
/// no cause.
#[test]
fn a_stuck_encoder_stays_the_cause_for_a_second() {
    let (host, machine) = (following(1, &[]), machine());
    follow(&host, &machine, 0..300, at_once);
    let held = angles(&machine)[0];
    let frozen = move |theta: [f64; 2], time: f64| ([held, theta[1]], [time; 2]);
    follow(&host, &machine, 300..450, frozen);
    assert_eq!(status(&host), "stuck");
    for step in 450..1440 {
        follow(&host, &machine, step..step + 1, at_once);
        assert_eq!(real(&host, "estimated.cause"), 4.0, "{step}");
    }
    follow(&host, &machine, 1440..1500, at_once);
    assert_eq!(real(&host, "estimated.cause"), 0.0);

    let host = following(1, &[]);
    let machine = self::machine();
    follow(&host, &machine, 0..200, |theta, time| (theta, [-1e30, time]));
    assert_eq!(real(&host, "estimated.cause"), 0.0);
}

/// A push at the tip is reported as the cause, with equal bits also from a state stored during the evaluation; a second later there is no
/// cause.
#[test]
fn a_push_is_reported_as_the_cause() {
    let (host, machine) = (following(1, &[]), machine());
    follow(&host, &machine, 0..300, at_once);
    assert_eq!(machine.set_real(&[reference("tip.fx")], &[0.5]), fmi2OK);
    follow(&host, &machine, 300..320, at_once);
    let (mut before, mut machine_before) = (host.state(), machine.state());
    let told = |host: &Host| {
        follow(host, &machine, 320..500, at_once);
        let told = ["estimated.cause", "estimated.cause.probability"].map(|name| real(host, name));
        // Equally likely explanations would have an eighth each.
        assert!(told[0] == 3.0 && told[1] > 0.5, "{told:?}");
        reals(host)
    };
    let first = told(&host);
    let other = following(1, &[]);
    let bytes = bytes_of(&host, before);
    let mut read = state_of(&other, &bytes);
    assert_eq!(other.set_state(read), fmi2OK);
    assert_eq!(machine.set_state(machine_before), fmi2OK);
    assert_eq!(told(&other), first);
    assert_eq!((other.free_state(&mut read), host.free_state(&mut before)), (fmi2OK, fmi2OK));
    assert_eq!(machine.free_state(&mut machine_before), fmi2OK);
    assert_eq!(machine.set_real(&[reference("tip.fx")], &[0.0]), fmi2OK);
    follow(&other, &machine, 500..2500, at_once);
    assert_eq!(real(&other, "estimated.cause"), 0.0);
}

/// A machine moves elsewhere while its encoders are silent. The estimate restarts there, reports this once by its status and in the log,
/// and finds the machine; from a state stored before, in memory or as bytes, it does so with the same bits.
#[test]
fn a_lost_machine_is_found_again() {
    let (host, machine) = (following(1, &[]), machine());
    follow(&host, &machine, 0..50, at_once);
    // For 2 s the twin gets no samples.
    for step in 50..2050 {
        assert_eq!(host.do_step(f64::from(step) * H, H), fmi2OK);
    }
    // Then the unit gets samples of a machine that has fallen from elsewhere.
    let other = Host::initializing(0.0, None);
    assert_eq!(other.set_integer(&[reference("solver.method")], &[4]), fmi2OK);
    for (name, value) in [("base.distance", 0.1), ("init.theta[1]", 2.0), ("init.theta[2]", 1.3)] {
        assert_eq!(other.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    assert_eq!(other.call(fmi2ExitInitializationMode), fmi2OK);
    for step in 0..2050 {
        assert_eq!(other.do_step(f64::from(step) * H, H), fmi2OK);
    }
    let _ = host.take();
    let (mut before, mut machine_before) = (host.state(), other.state());
    let bytes = bytes_of(&host, before);
    let finds = |host: &Host| {
        let mut begun = 0;
        for step in 2050..3000 {
            follow(host, &other, step..step + 1, at_once);
            begun += usize::from(host.take().iter().any(|line| line.text.contains("the estimate diverged and restarts")));
            if begun == 1 && status(host) == "inconsistent" {
                assert!(step < 2250, "late: {step}");
                // Without samples the estimator coasts and does not report its restart again.
                let mut here = host.state();
                for step in step + 1..step + 4 {
                    assert_eq!(host.do_step(f64::from(step) * H, H), fmi2OK);
                }
                assert_eq!(status(host), "coasting");
                let told = host.take();
                assert!(!told.iter().any(|line| line.text.contains("the estimate diverged and restarts")), "{told:?}");
                assert_eq!((host.set_state(here), host.free_state(&mut here)), (fmi2OK, fmi2OK));
            }
        }
        assert_eq!(begun, 1);
        assert!(tip_error(host, &other) < 1e-3, "{}", tip_error(host, &other));
        reals(host)
    };
    let found = finds(&host);
    assert_eq!((host.set_state(before), other.set_state(machine_before)), (fmi2OK, fmi2OK));
    assert_eq!(finds(&host), found);
    let mut read = state_of(&host, &bytes);
    assert_eq!((host.set_state(read), other.set_state(machine_before)), (fmi2OK, fmi2OK));
    assert_eq!(finds(&host), found);
    for (host, state) in [(&host, &mut before), (&host, &mut read), (&other, &mut machine_before)] {
        assert_eq!(host.free_state(state), fmi2OK);
    }
}

/// Innovations have no whole turns.
#[test]
fn turns_do_not_matter() {
    let (host, machine) = (following(1, &[]), machine());
    follow(&host, &machine, 0..100, |theta, time| {
        ([theta[0] + std::f64::consts::TAU, theta[1] - 3.0 * std::f64::consts::TAU], [time; 2])
    });
    assert!(tip_error(&host, &machine) < 1e-4);
    assert!((real(&host, "theta[1]") - real(&machine, "theta[1]")).abs() < 1e-3);
}

/// A stored state plus steps ahead are a forecast; in memory, as bytes and in another instance it has the same bits.
#[test]
fn stored_states_are_everything() {
    for method in methods() {
        let values = [("estimator.maxDelay", 4e-3)];
        let (host, machine) = (following(method, &values), machine());
        let late = |theta: [f64; 2], time: f64| (theta, [time - 2e-3 * f64::from(u8::from(time > 0.01)), time]);
        follow(&host, &machine, 0..60, late);
        let mut state = host.state();
        let bytes = bytes_of(&host, state);
        follow(&host, &machine, 60..90, late);
        for step in 90..120 {
            assert_eq!(host.do_step(f64::from(step) * H, H), fmi2OK);
        }
        let ahead = reals(&host);
        assert_eq!(status(&host), "coasting");
        let machine_again = self::machine();
        for step in 0..60 {
            assert_eq!(machine_again.do_step(f64::from(step) * H, H), fmi2OK);
        }
        let other = Host::new();
        let mut read = state_of(&other, &bytes);
        assert_eq!(other.set_state(read), fmi2OK, "{:?}", other.take());
        follow(&other, &machine_again, 60..90, late);
        assert_eq!(other.do_step(90.0 * H, 30.0 * H), fmi2OK);
        assert_eq!(reals(&other), ahead, "method {method}");
        assert_eq!((host.free_state(&mut state), other.free_state(&mut read)), (fmi2OK, fmi2OK));
    }
}

/// A forecast by sigma points that is stored at its start or during it, as bytes, continues with equal bits, and so does the estimate when
/// samples return.
#[test]
fn forecasts_are_stored() {
    let (host, machine) = (foreseeing(1, SIGMA_POINTS, &[]), machine());
    follow(&host, &machine, 0..60, at_once);
    let mut states: Vec<(u32, Vec<u8>)> = Vec::new();
    for step in 60..90 {
        assert_eq!((host.do_step(f64::from(step) * H, H), machine.do_step(f64::from(step) * H, H)), (fmi2OK, fmi2OK));
        let mut state = host.state();
        states.push((step + 1, bytes_of(&host, state)));
        assert_eq!(host.free_state(&mut state), fmi2OK);
    }
    let (mut machine_state, ahead) = (machine.state(), reals(&host));
    follow(&host, &machine, 90..110, at_once);
    let again = reals(&host);
    for (from, bytes) in states {
        let other = Host::new();
        let mut read = state_of(&other, &bytes);
        assert_eq!((other.set_state(read), machine.set_state(machine_state)), (fmi2OK, fmi2OK), "{:?}", other.take());
        if from < 90 {
            assert_eq!(other.do_step(f64::from(from) * H, f64::from(90 - from) * H), fmi2OK);
        }
        assert_eq!(reals(&other), ahead, "stored at step {from}");
        follow(&other, &machine, 90..110, at_once);
        assert_eq!(reals(&other), again, "stored at step {from}");
        assert_eq!(other.free_state(&mut read), fmi2OK);
    }
    assert_eq!(machine.free_state(&mut machine_state), fmi2OK);
}

/// If disabled, the estimator takes no byte of a stored state; samples that were set are kept.
#[test]
fn off_there_is_no_byte_of_state() {
    let host = Host::ready(&[]);
    let mut state = host.state();
    let plain = bytes_of(&host, state).len();
    assert_eq!(host.free_state(&mut state), fmi2OK);
    measure(&host, [1.0, 2.0], [0.0, 0.0]);
    let mut state = host.state();
    let bytes = bytes_of(&host, state);
    assert_eq!(bytes.len(), plain + 33, "two angles, two times, and that there is no estimate");
    let other = Host::new();
    let mut read = state_of(&other, &bytes);
    assert_eq!(other.set_state(read), fmi2OK);
    assert_eq!(real(&other, "measured.theta[2]"), 2.0);
    assert_eq!((host.free_state(&mut state), other.free_state(&mut read)), (fmi2OK, fmi2OK));
}

/// A delay beyond the history is refused.
#[test]
fn a_refused_scene_says_why() {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_boolean(&[reference("estimator.enabled")], &[1]), fmi2OK);
    assert_eq!(host.set_real(&[reference("estimator.maxDelay")], &[0.5]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2Error);
    let line = host.line();
    assert!(line.contains("estimator.maxDelay = 0.5 s is not allowed: it must be at most 31 steps of solver.stepSize"), "{line}");
}
