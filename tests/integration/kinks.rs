//! Loads with kinks by the error-controlled explicit method: no touch is missed, nothing false is shown, work is what it is.

use fivebar::fmi::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Method, Parameters, Simulation};

use crate::support::{enable, tip};

/// A machine with motors 10 cm apart, without gravity.
fn close_motors(theta: [f64; 2], omega: [f64; 2]) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.effects.gravity.enabled = false;
    parameters.start.theta = theta;
    parameters.start.omega = omega;
    parameters.settings.method = Method::Dop853;
    parameters
}

/// A slow motion that touches a plane of 100 kN/m with a ramp of 1 µm.
fn slow_touch() -> Parameters {
    let mut parameters = close_motors([2.305042384925536, 0.6405545940084515], [0.01947391254988405, 0.03608366856835523]);
    enable(&mut parameters, "contact");
    let contact = &mut parameters.effects.contact;
    (contact.nx, contact.ny, contact.offset) = (-0.7832714430806205, -0.6216798584918144, -0.16940637383204865);
    (contact.k, contact.width) = (1e5, 1e-6);
    parameters
}

#[test]
fn what_is_shown_between_steps_is_the_motion() {
    let mut simulation = Simulation::new(&slow_touch(), &default_inputs()).expect("a scene");
    for call in 0..600 {
        simulation.advance(&default_inputs(), 8.08 / 600.0, 1).expect("a step");
        let state = simulation.state();
        println!("{call} {:?} {:e}", tip(&simulation), state.kinetic_energy(simulation.model()));
    }
}

#[test]
fn what_a_stop_takes_when_it_lets_go_is_dissipated() {
    let mut parameters = close_motors([2.2, 0.9], [3.0, 0.0]);
    enable(&mut parameters, "stop");
    let stop = &mut parameters.effects.stop;
    (stop.lower[0], stop.k, stop.d) = (2.23, 50.0, 0.5);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    let mut last = 0.0;
    for _ in 0..1000 {
        simulation.advance(&default_inputs(), 1e-3, 1).expect("a step");
        let state = simulation.state();
        let dissipated = state.core.work.dissipated;
        assert!(dissipated >= last, "{dissipated}");
        last = dissipated;
        println!("{dissipated:e} {:e}", state.energy_error(simulation.model()));
    }
}
