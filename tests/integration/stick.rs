//! Dry friction that sticks: what is held stays, lets go at breakaway, and slips as its closed form says.

use std::f64::consts::PI;

use fivebar::effects::Law;
use fivebar::fmi::bindings::{default_inputs, default_parameters};
use fivebar::mechanism::coordinates::THETA;
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

use crate::support::enable;

/// The methods that can end a step where something stops or lets go.
const METHODS: [Method; 2] = [Method::I3alp, Method::Dop853];

/// A machine with motors 10 cm apart, and friction that sticks.
fn sticking(method: Method, coulomb: [f64; 5], breakaway: [f64; 5]) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = [2.2, 0.9];
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    (friction.law, friction.coulomb, friction.breakaway) = (Law::Stick, coulomb, breakaway);
    parameters.settings.method = method;
    parameters
}

/// Gain of the servo that pulls, N·m/rad, its speed, rad/s, and by how much friction falls when it lets go, N·m.
const KP: f64 = 5.0;
const PULL: f64 = 1e-3;
const DROP: f64 = 0.0025;

/// The left motor joint pulled by a soft servo while friction holds the right one: on the way of 1 mrad the machine is a mass on a spring.
fn pulled(method: Method) -> Parameters {
    let mut parameters = sticking(method, [0.01, 0.0, 0.0, 0.0, 1.0], [0.01 + DROP, 0.0, 0.0, 0.0, 1.0]);
    // So low that friction falls at once.
    parameters.effects.friction.breakaway_velocity = 1e-6;
    parameters.effects.gravity.enabled = false;
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([KP; 2], [0.0; 2], [1e3; 2]);
    parameters
}

/// The references at a time.
fn pulling(parameters: &Parameters, time: f64) -> Inputs {
    Inputs { servo_theta: [parameters.start.theta[0] + PULL * time, parameters.start.theta[1]], ..default_inputs() }
}

/// Inertia that the left motor feels while friction holds the right one, kg·m²: from what a torque does.
fn inertia(parameters: &Parameters) -> f64 {
    let accelerated = |torque: f64| {
        let inputs = Inputs { tau: [torque, 0.0], ..pulling(parameters, 0.0) };
        Simulation::new(parameters, &inputs).expect("a scene").state().core.a[THETA[0]]
    };
    1.0 / (accelerated(2.0) - accelerated(1.0))
}

#[test]
fn explore() {
    for method in METHODS {
        let parameters = pulled(method);
        let i = inertia(&parameters);
        let omega = (KP / i).sqrt();
        let slip = (2.0 * PI - 2.0 * (DROP * omega / (KP * PULL)).atan()) / omega;
        let jump = 2.0 * DROP / KP + PULL * slip;
        println!("{method:?} I {i:e} omega {omega} slip {slip} jump {jump:e} period {}", slip + 2.0 * DROP / (KP * PULL));
        let mut simulation = Simulation::new(&parameters, &pulling(&parameters, 0.0)).expect("a scene");
        let begin = std::time::Instant::now();
        let mut rest = true;
        for step in 0..8000 {
            let t = f64::from(step) * 1e-3;
            if let Err(e) = simulation.advance(&pulling(&parameters, t + 0.5e-3), 1e-3, 1) {
                println!("{t}: {e}");
                break;
            }
            let state = simulation.state();
            let now = state.angles();
            if state.grips.at_rest() != rest {
                println!(
                    "{t} {:e} {:e} {:?} {:e}",
                    now[0] - parameters.start.theta[0],
                    state.core.v[THETA[0]],
                    state.grips.at_rest(),
                    state.energy_error(simulation.model())
                );
            }
            rest = state.grips.at_rest();
        }
        println!("{:?} {:?}", begin.elapsed(), simulation.counters());
    }
}

/// Gravity and friction in all joints.
#[test]
fn fall() {
    for method in METHODS {
        for tol in [3e-9, 1e-10, 1e-12] {
            let mut p = default_parameters();
            p.start.theta[1] = 2.0943951023931953;
            enable(&mut p, "viscous");
            enable(&mut p, "friction");
            p.effects.friction.law = Law::Stick;
            p.settings.method = method;
            p.settings.error_tolerance = tol;
            let mut s = Simulation::new(&p, &default_inputs()).expect("scene");
            let begin = std::time::Instant::now();
            let mut d = 0.0;
            let mut worst = 0.0_f64;
            for step in 0..4000 {
                if let Err(e) = s.advance(&default_inputs(), 1e-3, 1) {
                    println!("{step}: {e}");
                    break;
                }
                let state = s.state();
                if state.core.work.dissipated < d - 1e-15 {
                    println!("{step} falls {:e}", d - state.core.work.dissipated);
                }
                d = state.core.work.dissipated;
                worst = worst.max(state.energy_error(s.model()).abs());
                if step % 500 == 499 {
                    println!("{step} {:?} {:?} {worst:e}", state.angles(), state.grips);
                }
            }
            println!("{method:?} {tol} {:?} {:?}", begin.elapsed(), s.counters());
        }
    }
}

#[test]
fn haptic() {
    for method in METHODS {
        for tol in [3e-9, 1e-10, 1e-12] {
            let mut p = default_parameters();
            p.geometry.base_distance = 0.1;
            p.effects.gravity.enabled = false;
            for e in ["payload", "friction", "contact"] {
                enable(&mut p, e);
            }
            p.effects.contact.offset = 0.2;
            p.start.theta = [2.2209, 0.9207];
            p.effects.friction.law = Law::Stick;
            p.effects.contact.law = Law::Stick;
            p.settings.method = method;
            p.settings.error_tolerance = tol;
            let mut s = Simulation::new(&p, &default_inputs()).expect("scene");
            let begin = std::time::Instant::now();
            let mut d = 0.0;
            let mut worst = 0.0_f64;
            for step in 0..2000 {
                let t = f64::from(step) * 1e-3;
                let i = Inputs {
                    tip_force: [
                        if t > 0.8 && t < 1.1 { 1.2 } else { 0.0 },
                        if t < 0.2 {
                            -0.5 * t / 0.2
                        } else if t < 1.2 {
                            -3.0
                        } else {
                            0.1
                        },
                    ],
                    ..default_inputs()
                };
                if let Err(e) = s.advance(&i, 1e-3, 1) {
                    println!("{step}: {e}");
                    break;
                }
                let state = s.state();
                if state.core.work.dissipated < d - 1e-15 {
                    println!("{step} falls {:e}", d - state.core.work.dissipated);
                }
                d = state.core.work.dissipated;
                worst = worst.max(state.energy_error(s.model()).abs());
                if step % 200 == 199 {
                    println!("{step} {:?} {:?} {worst:e}", state.angles(), state.grips);
                }
            }
            println!("{method:?} {tol} {:?} {:?}", begin.elapsed(), s.counters());
        }
    }
}
