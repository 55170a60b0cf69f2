//! Effects against solutions known without our code.
//!
//! Several tests use a single leg: the right leg is stretched from its motor to the left motor, the left leg folded. The tip is on the left
//! motor axis, and only the folded leg turns about it, with inertia I = I₁ + m₁ c₁² + I₂ + m₂ (L₁ − c₂)², between the vertices at 0 and π.
//! Joint 1 turns at its rate, joint 2 not at all. A torque at joint 3 would buckle the stretched leg; torques on joints 4 and 5 keep it
//! straight.

use std::f64::consts::PI;

use fivebar::observers::{self, Energies};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

use crate::support::{MGL, enable, fall_90_120, run, unequal};

/// The single leg without effects.
fn single_leg() -> Parameters {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    parameters
}

/// Its inertia, kg·m².
fn inertia(parameters: &Parameters) -> f64 {
    let [first, second, ..] = parameters.geometry.links;
    let arm = first.length - second.com;
    first.inertia + first.mass * first.com * first.com + second.inertia + second.mass * arm * arm
}

fn whirling(parameters: &Parameters, inputs: &Inputs, angle: f64, rate: f64) -> Simulation {
    Simulation::at(parameters, inputs, [angle, angle + PI, PI, PI], [rate, rate, 0.0, 0.0]).expect("a folded leg")
}

/// Angle and rate of the leg; checks that the stretched leg has not moved.
fn leg(simulation: &Simulation) -> (f64, f64) {
    let motion = observers::motion(simulation.model(), &simulation.state());
    assert!((motion.theta[2] - PI).abs() < 1e-9 && (motion.theta[3] - PI).abs() < 1e-9, "{motion:?}");
    (motion.theta[0], motion.omega[0])
}

fn energies(simulation: &Simulation) -> Energies {
    observers::energies(simulation.model(), &simulation.state())
}

/// I ω̇ = −b ω: ω = ω₀ exp(−b t/I).
#[test]
fn viscous_friction_slows_a_single_leg_exponentially() {
    let mut parameters = single_leg();
    enable(&mut parameters, "viscous");
    parameters.effects.viscous.b = [2.5e-3, 7e-3, 0.0, 1e-2, 1e-2];
    let mut simulation = whirling(&parameters, &default_inputs(), 0.4, 10.0);
    let decay = 2.5e-3 / inertia(&parameters);
    for _ in 0..10 {
        run(&mut simulation, &default_inputs(), 1e-3, 0.05);
        let t = 0.05 * simulation.state().core.counters.steps as f64 / 50.0;
        let (angle, rate) = leg(&simulation);
        let left = (-decay * t).exp();
        // Local errors of 3e-9 rad in some 1,000 sub-steps.
        assert!((angle - 0.4 - 10.0 / decay * (1.0 - left)).abs() < 3e-6, "{t} s: {angle} rad");
        assert!((rate - 10.0 * left).abs() < 3e-5, "{t} s: {rate} rad/s");
    }
}

/// I ω̇ = −T_c tanh(ω/w_c): sinh(ω/w_c) = sinh(ω₀/w_c) exp(−T_c t/(I w_c)), a constant deceleration T_c/I, then a stop.
#[test]
fn coulomb_friction_slides_evenly_and_stops() {
    let mut parameters = single_leg();
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    friction.coulomb = [5e-3, 1e-3, 0.0, 5e-3, 5e-3];
    friction.breakaway = friction.coulomb;
    let (torque, corner) = (5e-3, 0.01);
    let deceleration = torque / inertia(&parameters);
    let mut simulation = whirling(&parameters, &default_inputs(), 0.4, 5.0);
    run(&mut simulation, &default_inputs(), 1e-3, 0.4);
    let (angle, rate) = leg(&simulation);
    assert!((rate - (5.0 - deceleration * 0.4)).abs() < 1e-5, "sliding: {rate} rad/s");
    assert!((angle - (0.4 + 5.0 * 0.4 - deceleration * 0.08)).abs() < 1e-5, "sliding: {angle} rad");
    // Around the stop, by the closed form with ln sinh x = x − ln 2 for large x.
    let stop = 5.0 / deceleration;
    for after in [-2e-3, -1e-3, 0.0, 1e-3, 2e-3] {
        let mut stopping = whirling(&parameters, &default_inputs(), 0.4, 5.0);
        run(&mut stopping, &default_inputs(), (stop + after) / 100.0, stop + after);
        let scaled = (5.0 / corner - 2f64.ln()) - deceleration * (stop + after) / corner;
        let expected = corner * scaled.exp().asinh();
        assert!((leg(&stopping).1 - expected).abs() < 1e-4, "{after} s from the stop: {} {expected} rad/s", leg(&stopping).1);
    }
    run(&mut simulation, &default_inputs(), 1e-3, 0.2);
    let (angle, rate) = leg(&simulation);
    assert!(rate.abs() < 1e-8, "stopped: {rate} rad/s");
    // The initial energy is dissipated: T_c times the sliding distance.
    let initial = inertia(&parameters) * 12.5;
    assert!((energies(&simulation).dissipated - initial).abs() < 1e-5 * initial, "{:?}", energies(&simulation));
    assert!((torque * (angle - 0.4) - initial).abs() < 1e-3 * initial, "{angle} rad");
}

/// I θ̈ = −k (θ − θ₀): a cosine of frequency √(k/I).
#[test]
fn a_spring_swings_a_single_leg_at_its_frequency() {
    let mut parameters = single_leg();
    enable(&mut parameters, "spring");
    // The other spring holds the stretched leg.
    (parameters.effects.spring.k, parameters.effects.spring.theta0) = ([0.05, 5.0], [PI / 2.0, PI]);
    let frequency = (0.05 / inertia(&parameters)).sqrt();
    let mut simulation = whirling(&parameters, &default_inputs(), PI / 2.0 + 0.8, 0.0);
    for i in 1..=20 {
        run(&mut simulation, &default_inputs(), 1e-3, 0.1);
        let phase = frequency * 0.1 * f64::from(i);
        let (angle, rate) = leg(&simulation);
        assert!((angle - PI / 2.0 - 0.8 * phase.cos()).abs() < 3e-5, "{i}: {angle} rad");
        assert!((rate + 0.8 * frequency * phase.sin()).abs() < 3e-4, "{i}: {rate} rad/s");
    }
    // After a whole turn the spring is wound by 2π more.
    let turned = whirling(&parameters, &default_inputs(), PI / 2.0 + 2.0 * PI + 0.8, 0.0);
    let potential = 0.05 / 2.0 * (2.0 * PI + 0.8f64).powi(2);
    assert!((energies(&turned).potential - potential).abs() < 1e-12 * potential, "{:?}", energies(&turned));
}

/// Below saturation the servo is a spring and a damper: I ë + kd ė + kp e = 0.
#[test]
fn a_servo_answers_a_step_like_a_second_order_system() {
    let mut parameters = single_leg();
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    // The other servo holds the stretched leg; a limit of 1e6 N·m keeps tanh linear.
    (servo.kp, servo.kd, servo.limit) = ([0.2, 5.0], [4e-3, 0.01], [1e6, 1.0]);
    let mass = inertia(&parameters);
    let inputs = Inputs { servo_theta: [1.2, PI], ..default_inputs() };
    let mut simulation = whirling(&parameters, &inputs, 0.7, 0.0);
    let decay = 4e-3 / (2.0 * mass);
    let frequency = (0.2 / mass - decay * decay).sqrt();
    for i in 1..=50 {
        run(&mut simulation, &inputs, 1e-3, 0.02);
        let t = 0.02 * f64::from(i);
        let expected = 1.2 - 0.5 * (-decay * t).exp() * ((frequency * t).cos() + decay / frequency * (frequency * t).sin());
        assert!((leg(&simulation).0 - expected).abs() < 1e-5, "{t} s: {} {expected} rad", leg(&simulation).0);
        let torque = observers::servo_torques(simulation.model(), &simulation.state())[0];
        let (angle, rate) = leg(&simulation);
        assert!((torque - (0.2 * (1.2 - angle) - 4e-3 * rate)).abs() < 1e-9, "{torque} N.m");
    }
    // The balance includes the servo's work: the leg keeps almost no energy, the servo has taken the rest.
    assert!(energies(&simulation).error.abs() < 1e-5 * 0.1 * 0.25, "{:?}", energies(&simulation));
    // A saturated servo gives its limit.
    parameters.effects.servo.limit = [0.01, 1.0];
    let pushed = whirling(&parameters, &inputs, 0.7, 0.0);
    let torque = observers::servo_torques(pushed.model(), &pushed.state())[0];
    assert!((torque - 0.01 * 10f64.tanh()).abs() < 1e-12, "{torque} N.m");
}

/// A stop returns no more energy than it took: all of it without damping; with little damping, ζ = d/(2√(k I)), a fraction exp(−2πζ) (half
/// a period of a damped oscillator); with strong damping almost none.
#[test]
fn a_stop_returns_no_more_energy_than_it_took() {
    for damping in [0.0, 0.005, 0.02, 1.0] {
        let mut parameters = single_leg();
        enable(&mut parameters, "stop");
        (parameters.effects.stop.upper, parameters.effects.stop.d) = ([2.0, 4.0], damping);
        let mut simulation = whirling(&parameters, &default_inputs(), 1.5, 10.0);
        let before = energies(&simulation).kinetic;
        let mut deepest: f64 = 0.0;
        for _ in 0..120 {
            run(&mut simulation, &default_inputs(), 1e-3, 1e-3);
            let energies = energies(&simulation);
            deepest = deepest.max(leg(&simulation).0 - 2.0);
            assert!(energies.kinetic + energies.potential <= before * (1.0 + 1e-4), "{damping}: {energies:?}");
            // Energy error of the default tolerance in a hit at 10 rad/s that lasts 10 ms.
            assert!(energies.error.abs() < 1e-4 * before, "{damping}: {energies:?}");
        }
        let kept = energies(&simulation).kinetic / before;
        let (angle, _) = leg(&simulation);
        assert!(deepest > 1e-3 && angle < 2.0 + 1e-3, "{damping}: {angle} rad");
        // Two small effects: the ramp, 1 mrad of some 30, and the early end of the contact, when the damper would pull.
        let expected = (-PI * damping / (50.0 * inertia(&parameters)).sqrt()).exp();
        assert!((kept - expected).abs() < if damping == 0.0 { 1e-4 } else { 0.02 }, "{damping}: {kept} {expected}");
    }
}

/// At rest on the plane the whole machine is in equilibrium: plane and base joints carry its weight, and the plane's share is k d.
#[test]
fn contact_at_rest_balances_the_weight() {
    let mut parameters = default_parameters();
    enable(&mut parameters, "contact");
    enable(&mut parameters, "viscous");
    enable(&mut parameters, "payload");
    parameters.start.theta[1] = 120f64.to_radians();
    let contact = &mut parameters.effects.contact;
    (contact.offset, contact.mu) = (0.2, 0.8);
    parameters.effects.viscous.b = [5e-3; 5];
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    run(&mut simulation, &default_inputs(), 1e-3, 20.0);
    let (model, state) = (simulation.model(), &simulation.state());
    let motion = observers::motion(model, state);
    let force = observers::contact_force(model, state);
    assert!(motion.omega.iter().all(|rate| rate.abs() < 1e-2) && force.y > 0.1, "{motion:?} {force}");
    let reactions = observers::reactions(model, state);
    let weight = (4.0 * 0.017 + 0.05) * 9.81;
    // The remaining motion is creep of the regularised friction.
    assert!((reactions[0].y + reactions[4].y + force.y - weight).abs() < 1e-3 * weight, "{reactions:?} {force}");
    assert!((reactions[0].x + reactions[4].x + force.x).abs() < 1e-3 * weight, "{reactions:?} {force}");
    let depth = 0.2 - motion.tip.y;
    assert!((force.y - 2e3 * depth).abs() < 1e-3 * force.y, "{force} N at {depth} m");
    assert!(force.x.abs() <= 0.8 * force.y, "{force}");
}

/// A payload equals a heavier distal link, on either side; kinetic energy and weight equal a mass moving with the tip.
#[test]
fn a_payload_is_a_heavier_distal_link() {
    let mut loaded = unequal();
    enable(&mut loaded, "payload");
    let with_payload = |link: usize| {
        let mut parameters = unequal();
        let link = &mut parameters.geometry.links[link];
        let (mass, total) = (0.05, link.mass + 0.05);
        let com = (link.mass * link.com + mass * link.length) / total;
        link.inertia += link.mass * (link.com - com).powi(2) + mass * (link.length - com).powi(2);
        (link.com, link.mass) = (com, total);
        parameters
    };
    let motion = |parameters: &Parameters| {
        let mut parameters = parameters.clone();
        parameters.settings.error_tolerance = 1e-11;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        run(&mut simulation, &default_inputs(), 1e-3, 0.2);
        let state = simulation.state();
        (observers::motion(simulation.model(), &state), energies(&simulation))
    };
    let (payload, energy) = motion(&loaded);
    for link in [1, 2] {
        let (heavier, energy_of_heavier) = motion(&with_payload(link));
        // Different coordinates, hence two runs of the method, at a local error of 1e-11 rad.
        assert!((payload.tip - heavier.tip).norm() < 1e-6, "{link}: {} {}", payload.tip, heavier.tip);
        assert!((energy.kinetic - energy_of_heavier.kinetic).abs() < 1e-5 * MGL, "{link}");
    }
    let bare = unequal();
    let start = |parameters: &Parameters| {
        let simulation = Simulation::new(parameters, &default_inputs()).expect("scene");
        (observers::motion(simulation.model(), &simulation.state()), energies(&simulation))
    };
    let ((at, with), (_, without)) = (start(&loaded), start(&bare));
    let (kinetic, potential) = (0.025 * at.tip_velocity.norm_squared(), 0.05 * 9.81 * at.tip.y);
    assert!(
        (with.kinetic - without.kinetic - kinetic).abs() < 1e-12 && (with.potential - without.potential - potential).abs() < 1e-12
    );
}

/// A geared rotor equals additional inertia of the proximal link.
#[test]
fn a_rotor_is_a_proximal_link_with_more_inertia() {
    let mut geared = fall_90_120(Method::I3alp);
    enable(&mut geared, "rotor");
    geared.effects.rotor.gear_ratio = [5.0, 2.0];
    let mut heavier = fall_90_120(Method::I3alp);
    heavier.geometry.links[0].inertia += 25.0 * 1e-5;
    heavier.geometry.links[3].inertia += 4.0 * 1e-5;
    let tip = |parameters: &Parameters| {
        let mut simulation = Simulation::new(parameters, &default_inputs()).expect("scene");
        run(&mut simulation, &default_inputs(), 1e-3, 1.0);
        observers::motion(simulation.model(), &simulation.state()).tip
    };
    // The arithmetic is the same, apart from one rounding of the sum.
    assert!((tip(&geared) - tip(&heavier)).norm() < 1e-9);
}

/// On a horizontal table nothing changes the kinetic energy.
#[test]
fn a_flat_table_keeps_the_kinetic_energy() {
    let mut parameters = unequal();
    parameters.effects.gravity.tilt = 0.0;
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    let before = energies(&simulation).kinetic;
    for _ in 0..50 {
        run(&mut simulation, &default_inputs(), 1e-3, 0.1);
        assert!((energies(&simulation).kinetic - before).abs() < 1e-4 * before, "{:?}", energies(&simulation));
    }
    // Upright but with the effect disabled: the same bits.
    parameters.effects.gravity.enabled = false;
    let mut off = Simulation::new(&parameters, &default_inputs()).expect("scene");
    run(&mut off, &default_inputs(), 1e-3, 5.0);
    assert_eq!(off.state().core.q, simulation.state().core.q);
}
