//! Commands of the servos that act after `servo.delay`: the delayed motion is the motion shifted in time, whatever the grouping of calls;
//! they are part of stored states, bounded in number, and known to the estimator.

use fivebar::estimator::{MEASURED, Measured};
use fivebar::ffi::*;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::methods::Steps;
use fivebar::simulation::{Following, Inputs, Method, Parameters, Signal, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::allocation::allocations;
use crate::fmi_host::{Host, Instantiation, methods, reference};

const H: f64 = 1e-3;
const START: [f64; 2] = [2.2, 0.9];

/// Servos that hold the start against gravity and act late.
fn servos(method: Method, delay: f64) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = START;
    (parameters.settings.method, parameters.settings.step_size) = (method, H);
    parameters.settings.error_tolerance = 1e-9;
    (parameters.effects.servo.enabled, parameters.effects.servo.delay) = (true, delay);
    parameters
}

/// References that stand `by` rad beside the start, with loads that act at once.
fn beside(by: f64) -> Inputs {
    Inputs { servo_theta: START.map(|theta| theta + by), servo_omega: [by, -by], ..default_inputs() }
}

fn angles(simulation: &Simulation) -> [f64; 4] {
    simulation.state().angles()
}

fn apart(one: &Simulation, other: &Simulation) -> f64 {
    let [one, other] = [one, other].map(angles);
    (0..4).map(|i| (one[i] - other[i]).abs()).fold(0.0, f64::max)
}

fn started(parameters: &Parameters) -> Simulation {
    Simulation::new(parameters, &beside(0.0)).expect("a scene")
}

/// A command that acts `delay` late moves the machine as one that is set `delay` later: on the grid of macro steps and between two of its
/// points, within one macro step and at the largest delay. Methods whose steps end with the macro step take the same steps. The others
/// differ by the errors of their steps, and one of them does not pass the break: it redoes no step.
#[test]
fn a_delayed_command_is_a_later_one() {
    for method in Method::LIST {
        for delay in [0.017, 0.0173, 4e-4, 0.1, 1.0e-7] {
            let (mut late, mut at_once) = (started(&servos(*method, delay)), started(&servos(*method, 0.0)));
            late.advance(&beside(0.0), H, 20).expect("steps");
            at_once.advance(&beside(0.0), H, 20).expect("steps");
            late.advance(&beside(0.2), H, 300).expect("steps");
            let mut left = delay;
            while left > H * (1.0 + 1e-9) {
                at_once.advance(&beside(0.0), H, 1).expect("a step");
                left -= H;
            }
            let whole = (left - H).abs() <= 1e-9 * H;
            at_once.advance(&beside(0.0), if whole { H } else { left }, 1).expect("a step");
            if !whole {
                at_once.advance(&beside(0.2), H - left, 1).expect("a step");
            }
            let passed = (delay / H - 1e-9).ceil() as u64;
            at_once.advance(&beside(0.2), H, 300 - passed).expect("steps");
            let off = apart(&late, &at_once);
            match method.properties().steps {
                Steps::Dense => assert!(off < 1e-7, "{method:?}, {delay} s: {off:e} rad"),
                Steps::Fixed | Steps::Adaptive => assert_eq!(off, 0.0, "{method:?}, {delay} s"),
            }
            let moved = angles(&late)[0] - START[0];
            assert!((moved - 0.2).abs() < 0.1, "{method:?}: the servo has followed by {moved} rad");
        }
    }
}

/// A delay of less than a millionth of a macro step is none.
#[test]
fn a_delay_of_round_off_is_none() {
    for method in Method::LIST {
        let [late, at_once] = [5e-10, 0.0].map(|delay| {
            let mut simulation = started(&servos(*method, delay));
            for k in 0..30 {
                simulation.advance(&beside(0.01 * f64::from(k)), H, 3).expect("steps");
            }
            angles(&simulation).map(f64::to_bits)
        });
        assert_eq!(late, at_once, "{method:?}");
    }
}

/// A ramp acts as the same ramp later, if macro steps fall on the same parts of it: their middles differ by round-off.
#[test]
fn a_delayed_ramp_is_a_later_one() {
    let rate = Inputs { servo_theta: [0.5, -0.3], ..Inputs::default() };
    let curvature = Inputs { servo_omega: [0.2, 0.1], ..Inputs::default() };
    let bent = Signal::new(beside(0.0), [rate, curvature]);
    for method in Method::LIST {
        let (mut late, mut at_once) = (started(&servos(*method, 0.017)), started(&servos(*method, 0.0)));
        let mut held = bent;
        held.end(0.05);
        for (simulation, before) in [(&mut late, 0), (&mut at_once, 17)] {
            simulation.advance(&beside(0.0), H, 10 + before).expect("steps");
            simulation.advance_along(&bent, H, 50).expect("steps");
            simulation.advance_along(&held, H, 97 - before).expect("steps");
        }
        let off = apart(&late, &at_once);
        let tolerance = if method.properties().steps == Steps::Dense { 1e-7 } else { 1e-12 };
        assert!(off < tolerance, "{method:?}: {off:e} rad");
    }
}

/// Commands at random times, also faster than the delay: calls between them that are as long as possible, single macro steps and calls of
/// random length give the same bits.
#[test]
fn the_grouping_of_calls_does_not_matter() {
    for method in Method::LIST {
        for delay in [0.0173, 0.004, 3.7e-4] {
            let mut random = ChaCha8Rng::seed_from_u64(5);
            let mut draw = |most: u64| 1 + random.next_u64() % most;
            let mut runs = [0, 1, 2].map(|_| started(&servos(*method, delay)));
            for command in 0..40 {
                let inputs = Inputs { tau: [1e-3 * (command / 5) as f64, 0.0], ..beside(0.02 * (draw(20) as f64 - 10.0)) };
                let steps = draw(12);
                runs[0].advance(&inputs, H, steps).expect("steps");
                for _ in 0..steps {
                    runs[1].advance(&inputs, H, 1).expect("a step");
                }
                let mut left = steps;
                while left > 0 {
                    let some = draw(left);
                    runs[2].advance(&inputs, H, some).expect("steps");
                    left -= some;
                }
                // A step with dense output that ends with its call has no interpolant, which is stored, but not part of the motion.
                let states = runs.each_ref().map(Simulation::state);
                assert_eq!(states[0], states[1], "{method:?}, {delay} s, command {command}");
                assert_eq!(states[0], states[2], "{method:?}, {delay} s, command {command}");
            }
        }
    }
}

/// Commands that are known before they act end the steps of the error-controlled methods: no step is redone for them.
#[test]
fn no_step_passes_a_command_that_waits() {
    for method in Method::LIST.iter().filter(|method| method.properties().steps == Steps::Dense) {
        let counts = [0.0173, 0.0].map(|delay| {
            let mut simulation = started(&servos(*method, delay));
            for k in 0..100 {
                simulation.advance(&beside(0.1 * (0.3 * f64::from(k)).sin()), H, 10).expect("steps");
            }
            simulation.counters()
        });
        let [late, at_once] = counts.map(|counters| counters.rejected);
        assert!(late <= at_once + 2, "{method:?}: {late} rejected steps, {at_once} without a delay");
    }
}

/// Number of the method `i3alpConserving`.
const CONSERVING: i32 = 5;

/// An instance with servos that act 17.3 ms late, ready to step.
fn host(method: i32, values: &[(&str, f64)]) -> Host {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_boolean(&[reference("servo.enabled")], &[1]), fmi2OK);
    assert_eq!(host.set_integer(&[reference("solver.method")], &[method]), fmi2OK);
    if method == CONSERVING {
        // Without a fallback, a step that does not converge is discarded.
        assert_eq!(host.set_integer(&[reference("solver.maxWork")], &[0]), fmi2OK);
    }
    let start = [("base.distance", 0.1), ("init.theta[1]", START[0]), ("init.theta[2]", START[1]), ("servo.delay", 0.0173)];
    let references = [("servo.theta[1]", START[0]), ("servo.theta[2]", START[1])];
    for (name, value) in start.iter().chain(&references).chain(values) {
        assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
    }
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
    host
}

fn real(host: &Host, name: &str) -> f64 {
    let mut value = [f64::NAN];
    assert_eq!(host.get_real(&[reference(name)], &mut value), fmi2OK, "{name}: {:?}", host.take());
    value[0]
}

/// Steps of 5 ms, each with another reference.
fn follow(host: &Host, steps: std::ops::Range<u32>) {
    for k in steps {
        let by = 0.1 * (0.4 * f64::from(k)).sin();
        assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[START[0] + by]), fmi2OK);
        assert_eq!(host.do_step(f64::from(k) * 5e-3, 5e-3), fmi2OK, "{:?}", host.take());
    }
}

fn bytes(host: &Host) -> Vec<u8> {
    let mut state = host.state();
    let (_, size) = host.serialized_size(state);
    let (status, bytes) = host.serialize(state, size);
    assert_eq!((status, host.free_state(&mut state)), (fmi2OK, fmi2OK));
    bytes
}

fn restore(host: &Host, bytes: &[u8]) {
    let mut state = std::ptr::null_mut();
    assert_eq!(host.deserialize(bytes, &mut state), fmi2OK, "{:?}", host.take());
    assert_eq!((host.set_state(state), host.free_state(&mut state)), (fmi2OK, fmi2OK), "{:?}", host.take());
}

/// A stored state has the commands that wait, as a copy and as bytes, also in another instance and after a reset.
#[test]
fn commands_that_wait_are_part_of_the_state() {
    for method in methods() {
        let through = host(method, &[]);
        follow(&through, 0..20);
        let (middle, mut copy) = (bytes(&through), through.state());
        follow(&through, 20..40);
        let end = bytes(&through);
        assert_eq!(through.set_state(copy), fmi2OK);
        assert_eq!(through.free_state(&mut copy), fmi2OK);
        assert_eq!(bytes(&through), middle);
        follow(&through, 20..40);
        assert_eq!(bytes(&through), end, "method {method}: a copy");
        let other = Host::new();
        restore(&other, &middle);
        follow(&other, 20..40);
        assert_eq!(bytes(&other), end, "method {method}: another instance");
        assert_eq!(other.call(fmi2Reset), fmi2OK);
        restore(&other, &middle);
        follow(&other, 20..40);
        assert_eq!(bytes(&other), end, "method {method}: after a reset");
    }
}

/// A discarded step leaves the commands untouched, also a command set for it: the step can be repeated with other inputs.
#[test]
fn a_discarded_step_leaves_the_commands_untouched() {
    for method in methods() {
        let [tried, plain] = [(); 2].map(|()| {
            let host = host(method, &[]);
            follow(&host, 0..20);
            host
        });
        // A torque that no step of any method survives; the tip accelerates without bound.
        let names = ["tau[1]", "servo.theta[1]"].map(reference);
        assert_eq!(tried.set_real(&names, &[1e12, 3.0]), fmi2OK);
        let status = tried.do_step(0.1, 0.05);
        assert_eq!(status, fmi2Discard, "method {method}: {:?}", tried.take());
        assert_eq!(tried.set_real(&names, &[0.0, START[0]]), fmi2OK);
        for host in [&tried, &plain] {
            follow(host, 20..40);
        }
        let shown = ["theta[1]", "theta[2]", "omega[1]", "omega[2]", "energy.input"];
        assert_eq!(shown.map(|name| real(&tried, name).to_bits()), shown.map(|name| real(&plain, name).to_bits()), "{method}");
    }
}

/// Outputs and derivatives belong to the references that act.
#[test]
fn outputs_are_those_of_the_references_that_act() {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_boolean(&[reference("servo.enabled")], &[1]), fmi2OK);
    for (name, value) in [("servo.delay", 0.01), ("init.theta[2]", 2.0), ("servo.theta[1]", 1.6), ("servo.theta[2]", 2.0)] {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    let by_reference = |host: &Host| {
        let mut change = [f64::NAN];
        let unknowns = [reference("servo.torque[1]")];
        let status = host.directional_derivative(&unknowns, &[(reference("servo.theta[1]"), 1.0)], &mut change);
        assert_eq!(status, fmi2OK, "{:?}", host.take());
        change[0]
    };
    // The references of the start act at once.
    assert!(by_reference(&host) > 1.0, "{}", by_reference(&host));
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    let before = real(&host, "servo.torque[1]");
    assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[1.7]), fmi2OK);
    assert_eq!((by_reference(&host), real(&host, "servo.theta[1]")), (0.0, 1.7));
    assert_eq!(real(&host, "servo.torque[1]"), before);
    let mut torques = Vec::new();
    for k in 0..12 {
        assert_eq!(host.do_step(f64::from(k) * H, H), fmi2OK);
        torques.push(real(&host, "servo.torque[1]"));
    }
    // From 10 ms on, the step of 0.1 rad acts: kp is 2 N·m/rad.
    assert!(torques[8] < 0.06 && torques[9] > 0.2, "{torques:?}");
}

/// With a macro step of 1 ms and a delay of 0.1 s, 403 changes may wait. One more is refused in one sentence, and changes nothing.
#[test]
fn too_many_commands_are_refused() {
    let host = host(6, &[("servo.delay", 0.1)]);
    let mut steps = 0;
    let sentence = loop {
        let before = bytes(&host);
        assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[START[0] + 1e-4 * f64::from(steps)]), fmi2OK);
        if host.do_step(f64::from(steps) * 1e-5, 1e-5) == fmi2OK {
            steps += 1;
            continue;
        }
        let line = host.line();
        assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[START[0] + 1e-4 * f64::from(steps - 1)]), fmi2OK);
        assert_eq!(bytes(&host), before);
        break line;
    };
    // The first reference is that of the start.
    assert_eq!(steps, 404);
    assert_eq!(
        sentence,
        "fmi2DoStep: servo.theta or servo.omega have changed more than 403 times within servo.delay = 0.1 s, the limit for \
         solver.stepSize = 0.001 s: they must change less often."
    );
    assert_eq!(host.do_step(f64::from(steps) * 1e-5, 1e-5), fmi2OK, "{:?}", host.take());
}

/// Model exchange refuses a delay, unless there are no servos.
#[test]
fn model_exchange_refuses_a_delay() {
    for (enabled, status) in [(1, fmi2Error), (0, fmi2OK)] {
        let host = Host::instantiate(Instantiation { kind: fmi2ModelExchange, ..Instantiation::default() })
            .unwrap_or_else(|lines| panic!("{lines:?}"));
        assert_eq!(host.setup(None, 0.0, None), fmi2OK);
        assert_eq!(host.set_boolean(&[reference("servo.enabled")], &[enabled]), fmi2OK);
        assert_eq!(host.set_real(&[reference("servo.delay")], &[0.017]), fmi2OK);
        assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
        assert_eq!(host.call(fmi2ExitInitializationMode), status, "{:?}", host.take());
        if status == fmi2Error {
            let line = host.line();
            assert!(line.contains("servo.delay = 0.017 s is not allowed in model exchange"), "{line}");
        }
    }
}

/// Steps with commands that wait allocate nothing, of the library and of an instance, also if they are discarded.
#[test]
fn steps_with_commands_that_wait_allocate_nothing() {
    for method in Method::LIST {
        let mut simulation = started(&servos(*method, 0.0173));
        let count = allocations(|| {
            for k in 0..300 {
                simulation.advance(&beside(1e-3 * f64::from(k % 7)), H, 1).expect("a step");
            }
        });
        assert_eq!(count, 0, "{method:?}");
    }
    let host = host(6, &[]);
    let copy = bytes(&host);
    restore(&host, &copy);
    let (names, tuned) = ([reference("servo.theta[1]")], [reference("servo.kp[1]")]);
    let count = allocations(|| {
        for k in 0..300 {
            assert_eq!(host.set_real(&names, &[START[0] + 1e-3 * f64::from(k % 7)]), fmi2OK);
            if k % 11 == 0 {
                assert_eq!(host.set_real(&tuned, &[2.0 + 1e-3 * f64::from(k)]), fmi2OK);
            }
            assert_eq!(host.do_step(f64::from(k) * H, H), fmi2OK);
        }
    });
    assert_eq!(count, 0);
}

/// Standard deviation of an encoder's step of 0.63 mrad.
const QUANTUM: f64 = 6.3e-4;

/// Root mean square of the innovations, rad, mean normalised square, and number of samples with an alarm, of a twin with this delay, s. The
/// twin tracks a machine with a delay of 17 ms at 100 Hz, whose commands are steps on a course of up to 4 rad/s.
fn followed(delay: f64, learns: bool) -> ([f64; 2], u32) {
    let with = |delay: f64| {
        let mut parameters = servos(Method::Automatic, delay);
        parameters.estimator.enabled = true;
        (parameters.estimator.sigma, parameters.estimator.quantum) = ([0.0; 2], [QUANTUM; 2]);
        parameters.estimator.learn_enabled = learns;
        parameters
    };
    let course = |time: f64| beside(0.4 * (10.0 * time).sin());
    let mut machine = started(&with(0.017));
    let mut twin = Following::new(&with(delay), &course(0.0)).expect("a twin");
    let (mut squares, mut nis, mut alarms) = (0.0, 0.0, 0);
    for sample in 0..1000 {
        let time = 1e-2 * f64::from(sample);
        let theta = MEASURED.map(|link| (angles(&machine)[link] / QUANTUM).round() * QUANTUM);
        twin.correct(&Measured { theta, time: [time; 2] }, time);
        let inputs = Inputs { servo_omega: [0.0; 2], ..course(time) };
        twin.advance_along(&Signal::held(inputs), H, 10).expect("steps");
        machine.advance(&inputs, H, 10).expect("steps");
        let estimator = twin.estimator();
        squares += estimator.innovation().iter().map(|off| off * off).sum::<f64>() / 2000.0;
        nis += estimator.nis() / 1000.0;
        alarms += u32::from(estimator.alarm());
    }
    ([squares.sqrt(), nis], alarms)
}

#[test]
fn a_twin_with_the_delay_of_its_machine_follows_it() {
    for learns in [false, true] {
        let [(right, alarms), (wrong, others)] = [0.017, 0.0].map(|delay| followed(delay, learns));
        // Readings are off by up to half a step. Measured: 0.21 mrad and no alarm; without the delay 1.3 mrad and 990 of 1000 samples.
        // The normalised square is 2 at most: 1 for each encoder, less where intervals confine the angles.
        assert!(right[0] < 0.5 * QUANTUM && right[1] < 2.0 && alarms == 0, "learns {learns}: {right:?}, {alarms} alarms");
        assert!(wrong[0] > 3.0 * right[0] && others > 500, "learns {learns}: {wrong:?}, {others} alarms");
    }
}

/// A forecast of singularities knows a waiting command: this command leads through a direct singularity, while the references that act
/// hold.
#[test]
fn forecasts_know_commands_that_wait() {
    let mut parameters = servos(Method::Automatic, 0.05);
    parameters.estimator.enabled = true;
    parameters.estimator.horizon = 0.5;
    let mut twin = Following::new(&parameters, &beside(0.0)).expect("a twin");
    let probability = Following::singularity_probability;
    twin.advance_along(&Signal::held(beside(0.0)), H, 1).expect("a step");
    assert_eq!(probability(&twin, &beside(0.0)), 0.0);
    // Both motors turn outwards until the distal links are in line.
    let outwards = Inputs { servo_theta: [3.1, 0.0], ..default_inputs() };
    assert_eq!(probability(&twin, &outwards), 1.0, "set, but not yet passed on by a step");
    twin.advance_along(&Signal::held(outwards), H, 1).expect("a step");
    assert_eq!(probability(&twin, &outwards), 1.0);
}
