//! Stored states (rules 36 to 39 of this project): complete, several at once, in any order, into another instance, as bytes.

use std::ptr::null_mut;

use fivebar::ffi::*;
use fivebar::variables::VARIABLES;

use crate::fmi_host::{Host, methods, reference};

/// Every Real that can be read, as bits.
fn reals(host: &Host) -> Vec<u64> {
    let references: Vec<u32> =
        VARIABLES.iter().filter(|v| v.fmi_type() == fivebar::variables::FmiType::Real).map(|v| v.reference).collect();
    let mut values = vec![0.0; references.len()];
    assert_eq!(host.get_real(&references, &mut values), fmi2OK, "{:?}", host.take());
    values.into_iter().map(f64::to_bits).collect()
}

/// Everything visible to a master: reals, counters, the current time.
fn seen(host: &Host) -> (Vec<u64>, Vec<i32>, (fmi2Status, f64)) {
    let counters = ["solver.steps", "solver.substeps", "solver.iterations", "solver.rejected", "solver.restarts"].map(reference);
    let mut counts = [0; 5];
    assert_eq!(host.get_integer(&counters, &mut counts), fmi2OK);
    (reals(host), counts.to_vec(), host.real_status(2))
}

/// A driven scene with effects, ready to step: servos, friction, a payload.
fn machine(method: i32) -> Host {
    let host = Host::initializing(0.0, None);
    for effect in ["servo", "friction", "payload"] {
        assert_eq!(host.set_boolean(&[reference(&format!("{effect}.enabled"))], &[1]), fmi2OK);
    }
    assert_eq!(host.set_integer(&[reference("solver.method")], &[method]), fmi2OK);
    let values = [("init.theta[2]", 2.0), ("servo.theta[1]", 1.8), ("servo.theta[2]", 1.9), ("solver.stepSize", 1e-3)];
    for (name, value) in values {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
    host
}

fn steps(host: &Host, from: usize, to: usize) {
    for i in from..to {
        // The input changes on the way, so that pending changes matter.
        assert_eq!(host.set_real(&[reference("tau[1]")], &[0.01 * (i / 7) as f64]), fmi2OK);
        assert_eq!(host.do_step(i as f64 * 2e-3, 2e-3), fmi2OK, "{:?}", host.take());
    }
}

#[test]
fn a_restored_run_is_the_uninterrupted_one_bit_for_bit() {
    for method in methods() {
        let host = machine(method);
        steps(&host, 0, 10);
        let mut early = host.state();
        steps(&host, 10, 30);
        let mut late = host.state();
        let at_late = seen(&host);
        steps(&host, 30, 60);
        let end = seen(&host);

        // Backwards in time, and again; several states at once.
        assert_eq!(host.set_state(early), fmi2OK);
        steps(&host, 10, 30);
        assert_eq!(seen(&host), at_late, "method {method}");
        steps(&host, 30, 60);
        assert_eq!(seen(&host), end, "method {method}");
        assert_eq!(host.set_state(late), fmi2OK);
        assert_eq!(seen(&host), at_late, "method {method}");

        // Into another instance, with any scene and in any state.
        for other in [Host::new(), Host::ready(&[("link[2].mass", 0.1)])] {
            assert_eq!(other.set_state(late), fmi2OK);
            assert_eq!(seen(&other), at_late, "method {method}");
            steps(&other, 30, 60);
            assert_eq!(seen(&other), end, "method {method}");
        }
        assert_eq!((host.free_state(&mut early), host.free_state(&mut late)), (fmi2OK, fmi2OK));
        assert!(early.is_null() && late.is_null());
    }
}

/// The state contains values that were set and have not acted yet (an input, a tunable parameter), parameters and the stage of the life
/// cycle.
#[test]
fn a_state_contains_pending_values() {
    let host = machine(1);
    steps(&host, 0, 5);
    assert_eq!(host.set_real(&[reference("servo.kp[1]"), reference("tip.fx")], &[5.0, 0.3]), fmi2OK);
    let mut pending = host.state();
    assert_eq!(host.do_step(0.01, 2e-3), fmi2OK);
    let after = seen(&host);
    assert_eq!(host.set_real(&[reference("servo.kp[1]"), reference("tip.fx")], &[1.0, 0.0]), fmi2OK);
    assert_eq!(host.set_state(pending), fmi2OK);
    assert_eq!(host.do_step(0.01, 2e-3), fmi2OK);
    assert_eq!(seen(&host), after);

    let initializing = Host::initializing(0.0, None);
    assert_eq!(initializing.set_real(&[reference("link[1].mass")], &[0.05]), fmi2OK);
    let mut before = initializing.state();
    assert_eq!(initializing.call(fmi2ExitInitializationMode), fmi2OK);
    assert_eq!(initializing.set_real(&[reference("link[1].mass")], &[0.06]), fmi2Error);
    assert_eq!(initializing.set_state(before), fmi2OK);
    assert_eq!(initializing.set_real(&[reference("link[1].mass")], &[0.06]), fmi2OK, "in initialization mode again");

    // One variable for several states: it is overwritten. Null is already free.
    assert_eq!(host.get_state(&mut before), fmi2OK);
    assert_eq!(host.set_state(before), fmi2OK);
    for _ in 0..2 {
        assert_eq!((host.free_state(&mut pending), host.free_state(&mut before)), (fmi2OK, fmi2OK));
    }
    host.take();
    assert_eq!(host.null_states(), [fmi2Error; 5]);
    let texts: Vec<String> = host.take().into_iter().map(|line| line.text).collect();
    assert!(
        texts.iter().all(|text| text.ends_with("FMUstate is null.") || text.ends_with("serializedState is null.")),
        "{texts:?}"
    );
}

#[test]
fn bytes_bring_a_state_back_bit_for_bit() {
    for method in methods() {
        let host = machine(method);
        steps(&host, 0, 20);
        let mut state = host.state();
        let (status, size) = host.serialized_size(state);
        let (written, bytes) = host.serialize(state, size);
        assert_eq!((status, written), (fmi2OK, fmi2OK));
        assert_eq!(host.serialize(state, size - 1).0, fmi2Error);
        assert_eq!(host.line(), format!("fmi2SerializeFMUstate: size is {}, must be at least {size}.", size - 1));
        steps(&host, 20, 40);

        let other = Host::new();
        let mut restored = null_mut();
        assert_eq!(other.deserialize(&bytes, &mut restored), fmi2OK, "{:?}", other.take());
        assert_eq!(other.set_state(restored), fmi2OK);
        steps(&other, 20, 40);
        assert_eq!(seen(&other), seen(&host), "method {method}");
        // The restored state gives the same bytes.
        assert_eq!(host.deserialize(&bytes, &mut state), fmi2OK);
        assert_eq!(host.serialize(state, size), (fmi2OK, bytes));
        assert_eq!((host.free_state(&mut state), other.free_state(&mut restored)), (fmi2OK, fmi2OK));
    }
}

/// A step that ends at an event is part of a longer one. A run stored within each such step, at loose and tight tolerances, repeats it with
/// equal bits and continues as without storing. Links meet their stops during the 400 ms.
#[test]
fn steps_that_end_at_kinks_come_back() {
    let start = |tolerance: f64| {
        let host = Host::initializing(0.0, None);
        assert_eq!(host.set_boolean(&[reference("stop.enabled"), reference("spring.enabled")], &[1; 2]), fmi2OK);
        assert_eq!(host.set_integer(&[reference("solver.method")], &[4]), fmi2OK);
        let limits = ["stop.lower[1]", "stop.lower[2]", "stop.upper[1]", "stop.upper[2]", "init.theta[2]", "solver.errorTolerance"];
        let values = [0.52, 0.52, 2.62, 2.62, 2.1, tolerance];
        assert_eq!(host.set_real(&limits.map(reference), &values), fmi2OK);
        assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
        host
    };
    for tolerance in [1e-3, 1e-7, 1e-11] {
        let (host, other) = (start(tolerance), Host::new());
        let points = 1000;
        for i in 0..points {
            let now = 0.4 + 0.4 * f64::from(i) / f64::from(points);
            if i == 0 {
                assert_eq!(host.do_step(0.0, 0.4), fmi2OK, "{:?}", host.take());
            }
            let mut state = host.state();
            let (_, size) = host.serialized_size(state);
            let (_, bytes) = host.serialize(state, size);
            let mut restored = null_mut();
            assert_eq!(other.deserialize(&bytes, &mut restored), fmi2OK, "{tolerance:e} rad, {now} s: {:?}", other.take());
            assert_eq!(other.set_state(restored), fmi2OK, "{tolerance:e} rad, {now} s: {:?}", other.take());
            assert_eq!((host.free_state(&mut state), other.free_state(&mut restored)), (fmi2OK, fmi2OK));
            assert_eq!(host.do_step(now, 4e-4), fmi2OK, "{:?}", host.take());
            if i % 100 == 0 {
                assert_eq!(other.do_step(now, 4e-4), fmi2OK, "{:?}", other.take());
                assert_eq!(seen(&other), seen(&host));
            }
        }
    }
}

/// Every byte changed, every length cut, foreign bytes: fmi2Error with one message, and no change.
#[test]
fn bytes_that_are_no_state_are_refused() {
    let host = machine(4);
    steps(&host, 0, 5);
    let before = seen(&host);
    let mut state = host.state();
    let (_, size) = host.serialized_size(state);
    let (_, bytes) = host.serialize(state, size);
    assert_eq!(host.free_state(&mut state), fmi2OK);
    let refused = |bytes: &[u8]| {
        let mut state = null_mut();
        assert_eq!(host.deserialize(bytes, &mut state), fmi2Error);
        assert!(state.is_null());
        let line = host.line();
        assert!(line.starts_with("fmi2DeSerializeFMUstate: the bytes are not a state of this FMU: "), "{line}");
    };
    for position in 0..bytes.len() {
        for change in [1, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[position] ^= change;
            refused(&changed);
        }
    }
    (0..bytes.len()).for_each(|length| refused(&bytes[..length]));
    refused(&[&bytes[..], &[0]].concat());
    refused(&[0; 4096]);
    assert_eq!(seen(&host), before);
}

/// Bytes changed with a corrected checksum, which is no secret, are refused or are a state: never a panic, in any later use. Here some
/// bytes of the content, at a stage with a scene and at one without, because this also runs under valgrind; `forged_states.rs` has every
/// byte by every method.
#[test]
fn forged_bytes_are_never_fatal() {
    const HEAD: usize = 58;
    let forge = |host: &Host| {
        let mut state = host.state();
        let (_, size) = host.serialized_size(state);
        let (_, bytes) = host.serialize(state, size);
        let (mut refused, other) = (0, Host::new());
        for position in (HEAD..size - 4).step_by(3) {
            for change in [1, 0x80] {
                let mut forged = bytes.clone();
                forged[position] ^= change;
                let checksum = adler2::adler32_slice(&forged[..size - 4]);
                forged[size - 4..].copy_from_slice(&checksum.to_le_bytes());
                let status = other.deserialize(&forged, &mut state);
                assert!([fmi2OK, fmi2Error].contains(&status), "byte {position}: {:?}", other.take());
                if status == fmi2Error {
                    refused += 1;
                    continue;
                }
                if other.set_state(state) == fmi2Error {
                    // Forged into a state of the other kind.
                    assert!(other.line().contains(": FMUstate belongs to an instance for model exchange"));
                    continue;
                }
                let mut place = [0.0];
                for status in [
                    other.do_step(other.real_status(2).1, 1e-3),
                    other.get_real(&[reference("tip.x")], &mut place),
                    other.get_integer(&[reference("singular.type")], &mut [0]),
                    other.call(fmi2ExitInitializationMode),
                    other.call(fmi2Terminate),
                ] {
                    assert!(status <= fmi2Error, "byte {position}, change {change:#x}: {:?}", other.take());
                }
                other.take();
            }
        }
        assert_eq!(other.free_state(&mut state), fmi2OK);
        refused
    };
    // With rk4, which has no sub-steps: other methods take seconds for many of these states before they fail.
    let running = machine(3);
    steps(&running, 0, 5);
    assert!(forge(&running) > 0 && forge(&Host::initializing(0.0, None)) > 0);
}
