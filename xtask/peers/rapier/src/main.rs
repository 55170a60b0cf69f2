//! rapier2d as a peer of `cargo xtask peers`: four links without shapes, five revolute joints.
//!
//! `peer-rapier JOINTS STEP SWEEPS ANGLE ANGLE ANGLE ANGLE`, JOINTS `impulse` or `multibody`. A multibody is a tree, so an impulse joint
//! closes its loop. Reads times, one per line; answers each with the processor time so far, s, four angles and four rates.

use cpu_time::ProcessTime;
use rapier2d_f64::prelude::*;
use std::io::{self, BufRead};

const LENGTH: f64 = 0.21;
const COM: f64 = 0.105;
const MASS: f64 = 0.017;
const INERTIA: f64 = 6.23e-5;
const BASE: f64 = 0.42;
const GRAVITY: f64 = 9.81;

/// Left leg, right leg: index of the proximal link's angle, of the distal link's angle, and x of the motor.
const LEGS: [(usize, usize, f64); 2] = [(0, 1, 0.0), (3, 2, BASE)];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [joints, step, sweeps, angles @ ..] = &arguments[..] else { return Err("too few arguments".into()) };
    let angles: Vec<f64> = angles.iter().map(|angle| angle.parse()).collect::<Result<_, _>>()?;
    let mut world = PhysicsWorld { gravity: Vector::new(0.0, -GRAVITY), ..Default::default() };
    let parameters = &mut world.integration_parameters;
    parameters.dt = step.parse()?;
    parameters.num_solver_iterations = 1;
    parameters.num_internal_pgs_iterations = sweeps.parse()?;
    parameters.warmstart_joints = true;
    parameters.normalized_max_linear_velocity = Real::MAX;
    let links = build(&mut world, &angles, joints == "multibody");

    let (mut spent, mut done) = (0.0, 0);
    for line in io::stdin().lock().lines() {
        let until: f64 = line?.trim().parse()?;
        let steps = (until / world.integration_parameters.dt).round() as u64;
        let clock = ProcessTime::now();
        for _ in done..steps {
            world.step();
        }
        spent += clock.elapsed().as_secs_f64();
        done = steps;
        let bodies = links.map(|link| &world.bodies[link]);
        let state = bodies.iter().map(|body| body.rotation().angle()).chain(bodies.iter().map(|body| body.angvel()));
        println!("{spent} {}", state.map(|x| x.to_string()).collect::<Vec<_>>().join(" "));
    }
    Ok(())
}

/// The links in order of their angles.
fn build(world: &mut PhysicsWorld, angles: &[f64], multibody: bool) -> [RigidBodyHandle; 4] {
    let arm =
        |from: f64, to: f64| RevoluteJointBuilder::new().local_anchor1(Vector::new(from, 0.0)).local_anchor2(Vector::new(to, 0.0));
    let (mut links, mut joints) = ([RigidBodyHandle::invalid(); 4], Vec::new());
    for (near, far, motor) in LEGS {
        // A ground for each leg: with a common ground they form a single multibody, which is a tenth slower.
        let ground = world.insert_body(RigidBodyBuilder::fixed());
        let mut place = Vector::new(motor, 0.0);
        let (mut carrier, mut at, mut turned) = (ground, motor, 0.0);
        for i in [near, far] {
            let properties = MassProperties::new(Vector::new(COM, 0.0), MASS, INERTIA);
            let body = RigidBodyBuilder::dynamic().translation(place).rotation(angles[i]).can_sleep(false);
            links[i] = world.insert_body(body.additional_mass_properties(properties));
            // A multibody joint starts at its zero, so the frame on the carrier is turned to the link's start angle.
            let mut joint = arm(at, 0.0).build();
            joint.data.set_local_frame1(Pose::new(Vector::new(at, 0.0), angles[i] - turned));
            if multibody {
                let made = world.insert_multibody_joint(carrier, links[i], joint);
                joints.extend(made);
            } else {
                world.insert_impulse_joint(carrier, links[i], joint);
            }
            place += Vector::new(angles[i].cos(), angles[i].sin()) * LENGTH;
            (carrier, at, turned) = (links[i], LENGTH, angles[i]);
        }
    }
    for joint in joints {
        // By default rapier damps rotations of multibodies.
        world.multibody_joints.get_mut(joint).expect("it was just made").0.damping_mut().fill(0.0);
    }
    world.insert_impulse_joint(links[1], links[2], arm(LENGTH, LENGTH));
    links
}
