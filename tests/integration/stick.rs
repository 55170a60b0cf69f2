//! Dry friction that sticks: what is held stays, lets go at breakaway, and slips as its closed form says.

use fivebar::effects::Law;
use fivebar::fmi::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

use crate::support::enable;

/// The methods that can end a step where something stops or lets go.
const METHODS: [Method; 2] = [Method::I3alp, Method::Dop853];

/// Friction in the motor joints.
fn with_friction(method: Method, coulomb: [f64; 2], breakaway: [f64; 2]) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = [2.2, 0.9];
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    friction.law = Law::Stick;
    friction.coulomb = [coulomb[0], 0.0, 0.0, 0.0, coulomb[1]];
    friction.breakaway = [breakaway[0], 0.0, 0.0, 0.0, breakaway[1]];
    parameters.settings.method = method;
    parameters
}

/// A motor joint pulled by a soft servo while friction holds the other one: the machine has one degree of freedom, and next to no way to go.
fn pulled(method: Method) -> Parameters {
    let mut parameters = with_friction(method, [0.01, 1.0], [0.0125, 1.0]);
    parameters.effects.friction.breakaway_velocity = 1e-6;
    parameters.effects.gravity.enabled = false;
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([KP; 2], [0.0; 2], [1e3; 2]);
    parameters
}

const KP: f64 = 5.0;
const PULL: f64 = 0.01;

/// Inertia that the left motor feels, from its acceleration under a torque while the other joint is held.
fn inertia(parameters: &Parameters) -> f64 {
    let mut parameters = parameters.clone();
    parameters.effects.friction.coulomb[0] = 0.0;
    parameters.effects.friction.breakaway[0] = 0.0;
    let mut inputs = inputs(&parameters, 0.0);
    inputs.tau[0] = 1e-3;
    let simulation = Simulation::new(&parameters, &inputs).expect("a scene");
    1e-3 / simulation.state().core.a[2]
}

fn inputs(parameters: &Parameters, time: f64) -> Inputs {
    Inputs { servo_theta: [parameters.start.theta[0] + PULL * time, parameters.start.theta[1]], ..default_inputs() }
}

#[test]
fn explore() {
    for method in METHODS {
        let parameters = pulled(method);
        let i = inertia(&parameters);
        let omega = (KP / i).sqrt();
        let drop = 0.0025;
        let slip = (2.0 * std::f64::consts::PI - 2.0 * (drop * omega / (KP * PULL)).atan()) / omega;
        let jump = 2.0 * drop / KP + PULL * slip;
        println!("{method:?} I {i:e} omega {omega} slip {slip} jump {jump:e} period {}", slip + 2.0 * drop / (KP * PULL));
        let mut simulation = Simulation::new(&parameters, &inputs(&parameters, 0.0)).expect("a scene");
        let mut last = simulation.state().angles()[0];
        let begin = std::time::Instant::now();
        for step in 0..1500 {
            let t = f64::from(step) * 1e-3;
            if let Err(e) = simulation.advance(&inputs(&parameters, t + 0.5e-3), 1e-3, 1) {
                println!("{t}: {e}");
                break;
            }
            let state = simulation.state();
            let now = state.angles();
            if (now[0] - last).abs() > 0.0 && step % 10 == 0 {
                println!(
                    "{t} {:e} {:e} {:?} {:e}",
                    now[0] - parameters.start.theta[0],
                    state.core.v[2],
                    state.grips,
                    state.energy_error(simulation.model())
                );
            }
            last = now[0];
        }
        println!("{:?} {:?}", begin.elapsed(), simulation.counters());
    }
}
