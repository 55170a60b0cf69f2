//! Starts: closed, consistent, or refused with one sentence.

use std::f64::consts::{FRAC_PI_2, PI};

use fivebar::mechanism::closure::assemble;
use fivebar::mechanism::coordinates::THETA;
use fivebar::mechanism::{Assembly, Geometry, Start, close};
use fivebar::observers::{self, SingularityKind};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Parameters, Simulation};

use crate::support::unequal;

fn started(parameters: &Parameters) -> Simulation {
    Simulation::new(parameters, &default_inputs()).expect("a legal start")
}

fn refusal(change: impl FnOnce(&mut Parameters)) -> String {
    let mut parameters = default_parameters();
    change(&mut parameters);
    Simulation::new(&parameters, &default_inputs()).expect_err("must be refused").to_string()
}

/// Positions, velocities and accelerations meet the constraints, and the tip is on the requested side.
#[test]
fn starts_are_consistent() {
    let mut coaxial = default_parameters();
    coaxial.geometry.base_distance = 0.0;
    coaxial.start.theta = [2.0, 1.0];
    coaxial.start.omega = [3.0, -1.0];
    for base in [default_parameters(), unequal(), coaxial] {
        for assembly in [Assembly::Plus, Assembly::Minus] {
            let mut parameters = base.clone();
            parameters.start.assembly = assembly;
            let simulation = started(&parameters);
            let norms = observers::constraint_norms(simulation.model(), &simulation.state());
            // Bounds: round-off of sums of lengths below 1 m and rates below 10 rad/s; for accelerations e λ with e = 6e-11 1/kg.
            assert!(norms.position < 1e-15 && norms.velocity < 1e-14 && norms.acceleration < 1e-9, "{norms:?}");
            let singularity = observers::singularity(simulation.model(), &simulation.state());
            if singularity.kind == SingularityKind::None {
                assert_eq!(singularity.jacobians.assembly, assembly);
            }
            let motion = observers::motion(simulation.model(), &simulation.state());
            assert_eq!([motion.omega[0], motion.omega[3]], parameters.start.omega, "prescribed rates are kept exactly");
        }
    }
}

/// The paper's own start: distal links in line, a legal direct singularity with the tip in the middle.
#[test]
fn the_paper_start_is_a_direct_singularity() {
    let simulation = started(&default_parameters());
    let motion = observers::motion(simulation.model(), &simulation.state());
    assert!((motion.tip.x - 0.21).abs() < 1e-16 && (motion.tip.y - 0.21).abs() < 1e-16, "{}", motion.tip);
    assert_eq!(observers::singularity(simulation.model(), &simulation.state()).kind, SingularityKind::Direct);
}

#[test]
fn singular_postures_are_distinguished() {
    for (theta, assembly, kind) in [
        ([FRAC_PI_2, 2.0], Assembly::Plus, SingularityKind::None),
        ([FRAC_PI_2, FRAC_PI_2], Assembly::Plus, SingularityKind::Direct),
        ([0.0, 0.0], Assembly::Plus, SingularityKind::Constraint),
        ([PI, PI], Assembly::Plus, SingularityKind::Constraint),
    ] {
        let mut parameters = default_parameters();
        parameters.start = Start { theta, omega: [0.0; 2], assembly };
        let simulation = started(&parameters);
        let singularity = observers::singularity(simulation.model(), &simulation.state());
        assert_eq!(singularity.kind, kind, "{theta:?}: {singularity:?}");
    }
    // Inverse: the left leg folded back, the tip on the left motor; the right leg closes 0.42 m from its motor.
    let mut folded = default_parameters();
    folded.geometry.base_distance = 0.3;
    let half = (0.15f64 / 0.21).acos();
    folded.start = Start { theta: [1.0, PI - half], omega: [0.0; 2], assembly: Assembly::Plus };
    let kinds = [Assembly::Plus, Assembly::Minus].map(|assembly| {
        folded.start.assembly = assembly;
        let simulation = started(&folded);
        observers::singularity(simulation.model(), &simulation.state()).kind
    });
    assert!(kinds.contains(&SingularityKind::Inverse), "{kinds:?}");
}

/// The determinant's sign and σ_min agree with the posture.
#[test]
fn singular_values_vanish_with_their_determinants() {
    let simulation = started(&unequal());
    let s = observers::singularity(simulation.model(), &simulation.state());
    let [_, l2, l3, _] = unequal().geometry.links.map(|link| link.length);
    let theta = THETA.map(|i| simulation.state().core.q[i]);
    let jx = nalgebra::Matrix2::new(l2 * theta[1].cos(), l2 * theta[1].sin(), l3 * theta[2].cos(), l3 * theta[2].sin());
    assert!((s.jacobians.det_jx - jx.determinant()).abs() < 1e-15);
    assert!((s.jacobians.sigma_jx - jx.singular_values().min()).abs() < 1e-15);
    let at_vertex = {
        let mut parameters = default_parameters();
        parameters.start.theta = [0.0, 0.0];
        let simulation = started(&parameters);
        observers::singularity(simulation.model(), &simulation.state())
    };
    assert!(
        at_vertex.sigma_phi < 1e-12 && at_vertex.jacobians.sigma_jx < 1e-12 && at_vertex.jacobians.sigma_jq < 1e-12,
        "{at_vertex:?}"
    );
}

#[test]
fn starts_that_cannot_be_closed_are_refused_with_a_sentence() {
    let text = refusal(|p| p.start.theta = [PI, 0.0]);
    assert!(text.contains("init.theta") && text.contains("0.84 m apart") && text.contains("0.0 to 0.42 m"), "{text}");
    let text = refusal(|p| {
        p.geometry.base_distance = 0.0;
        p.start.theta = [1.0, 1.0];
    });
    assert!(text.contains("init.theta") && text.contains("same point"), "{text}");
    // Coincident elbows are out of reach if the distal links differ.
    let text = refusal(|p| {
        p.geometry.base_distance = 0.0;
        p.geometry.links[1].length = 0.3;
        p.start.theta = [1.0, 1.0];
    });
    assert!(text.contains("0.0 m apart") && text.contains("0.09 to 0.51 m"), "{text}");
}

#[test]
fn values_without_a_meaning_are_refused_by_name() {
    for (text, name) in [
        (refusal(|p| p.geometry.links[1].mass = -1.0), "link[2].mass = -1.0 kg"),
        (refusal(|p| p.geometry.links[3].inertia = 0.0), "link[4].inertia = 0.0 kg.m2"),
        (refusal(|p| p.geometry.links[0].length = 0.0), "link[1].length = 0.0 m"),
        (refusal(|p| p.geometry.links[2].com = f64::NAN), "link[3].com = NaN m"),
        (refusal(|p| p.geometry.base_distance = -0.1), "base.distance = -0.1 m"),
        (refusal(|p| p.settings.step_size = 0.0), "solver.stepSize = 0.0 s"),
        (refusal(|p| p.settings.error_tolerance = f64::INFINITY), "solver.errorTolerance = inf rad"),
        (refusal(|p| p.start.theta[1] = f64::NAN), "init.theta[2] = NaN rad"),
        (refusal(|p| p.effects.gravity.g = f64::NAN), "gravity.g = NaN m/s2"),
    ] {
        assert!(text.contains(name), "{text}");
        assert!(text.ends_with('.') && text.matches(". ").count() == 0, "one sentence: {text}");
    }
}

fn geometry(lengths: [f64; 4], base_distance: f64) -> Geometry {
    let mut geometry = default_parameters().geometry;
    geometry.base_distance = base_distance;
    for (link, length) in geometry.links.iter_mut().zip(lengths) {
        (link.length, link.com) = (length, length / 2.0);
    }
    geometry
}

/// Rates at a direct singularity: rates that would tear the elbows apart are refused; with others the tip's rate across the line is 0.
#[test]
fn rates_at_a_direct_singularity() {
    let paper = default_parameters().geometry;
    let start = |theta, omega| Start { theta, omega, assembly: Assembly::Plus };
    // Parallel cranks with equal rates keep the distance between the elbows.
    let (_, v) = close(&paper, &start([FRAC_PI_2, FRAC_PI_2], [2.0, 2.0])).expect("rates that closure can meet");
    assert!(THETA[1..3].iter().all(|&i| v[i].abs() < 1e-14), "{v:?}");
    let text = close(&paper, &start([FRAC_PI_2, FRAC_PI_2], [1.0, -1.0])).expect_err("elbows part").to_string();
    assert!(
        text.contains("init.omega = (1.0, -1.0) rad/s") && text.contains("0.42 m/s") && text.contains("allowed is 0"),
        "{text}"
    );
}

/// Rates at a vertex lie on the tangent cone, also for coaxial motors on any line, and move the tip to the requested side.
#[test]
fn rates_at_a_vertex_lie_on_the_cone() {
    for (lengths, base_distance, theta, omega, possible) in [
        ([0.21; 4], 0.42, [0.0, 0.0], [1.0, 0.0], false),
        ([0.21; 4], 0.42, [PI, PI], [1.5, 1.0], true),
        ([0.20, 0.18, 0.12, 0.10], 0.0, [FRAC_PI_2 / 2.0, FRAC_PI_2 / 2.0 + PI], [1.0, 0.0], true),
        ([0.20, 0.18, 0.12, 0.10], 0.0, [0.0, PI], [1.0, 0.0], true),
        // In binary the distance between the elbows differs slightly from the distal links.
        ([0.10, 0.11, 0.12, 0.09], 0.24, [0.0, 0.0], [1.0, 0.3], false),
        ([0.10, 0.11, 0.12, 0.09], 0.24, [0.0, 0.0], [0.3, 1.0], true),
        ([0.13, 0.17, 0.11, 0.19], 0.60, [0.0, PI], [0.7, -1.3], false),
    ] {
        let geometry = geometry(lengths, base_distance);
        let mut mode = vec![];
        for assembly in [Assembly::Plus, Assembly::Minus] {
            match close(&geometry, &Start { theta, omega, assembly }) {
                Ok((q, v)) => {
                    let sign = [1.0, 1.0, -1.0, -1.0];
                    let line = q[THETA[0]];
                    let arm: [f64; 4] = std::array::from_fn(|i| sign[i] * (q[THETA[i]] - line).cos() * geometry.links[i].length);
                    let first: f64 = (0..4).map(|i| arm[i] * v[THETA[i]]).sum();
                    let second: f64 = (0..4).map(|i| arm[i] * v[THETA[i]].powi(2)).sum();
                    assert!(first.abs() < 1e-12 && second.abs() < 1e-10, "{theta:?}: {first:e} {second:e}");
                    // A moment later the tip is on the requested side.
                    let (ahead, _) = assemble(&geometry, THETA.map(|i| q[i] + 1e-4 * v[i]), [0.0; 4]);
                    let (sin, cos) = ((ahead[THETA[2]] - ahead[THETA[1]]).sin(), 1.0);
                    mode.push((assembly, (sin * cos > 0.0) == (assembly == Assembly::Plus)));
                }
                Err(refusal) => assert!(!possible && refusal.to_string().contains("init.omega"), "{refusal}"),
            }
        }
        assert_eq!(mode.len(), if possible { 2 } else { 0 }, "{theta:?}: both sides or none");
        assert!(mode.iter().all(|(_, right)| *right), "{theta:?}: {mode:?}");
    }
}

/// Near a direct singularity the rates still close the loop: both ways of computing them agree in between.
#[test]
fn rates_just_off_a_direct_singularity_close_the_loop() {
    for offset in [1e-15, 1e-13, 1e-12, 1e-10, 8e-10, 1.5e-9, 3e-9, 1e-7] {
        for theta in [[FRAC_PI_2 - offset, FRAC_PI_2], [1.0 - offset, 1.0]] {
            let mut parameters = default_parameters();
            parameters.start = Start { theta, omega: [1.0, 1.0], assembly: Assembly::Plus };
            let Ok(simulation) = Simulation::new(&parameters, &default_inputs()) else { continue };
            let norms = observers::constraint_norms(simulation.model(), &simulation.state());
            // Near the loss of rank, rates that violate the closure by 1e-9 are accepted.
            assert!(norms.position < 1e-14 && norms.velocity < 1e-9, "{theta:?}: {norms:?}");
        }
    }
}

/// Angles with any number of turns start and run like angles within one turn.
#[test]
fn a_start_many_turns_away_is_the_same_motion() {
    let end = |turns: f64| {
        let mut parameters = default_parameters();
        parameters.start.theta = [FRAC_PI_2 + turns * std::f64::consts::TAU, 2.0];
        let mut simulation = started(&parameters);
        simulation.advance(&default_inputs(), 1e-3, 500).expect("steps");
        simulation.state().angles()
    };
    let (near, far) = (end(0.0), end(200.0));
    // 1256 rad have a round-off of 2e-13, amplified by the motion.
    assert!((far[0] - near[0] - 200.0 * std::f64::consts::TAU).abs() < 1e-9, "{near:?} {far:?}");
    assert!((far[3] - near[3]).abs() < 1e-9, "{near:?} {far:?}");
}

/// det J_q and σ(J_q) from J_q's definition, σ(Φ_q) from the eigenvalues of Φ_q Φ_qᵀ, and the combined kind.
#[test]
fn singularity_observers_agree_with_their_definitions() {
    let mut simulation = started(&unequal());
    for _ in 0..40 {
        simulation.advance(&default_inputs(), 1e-3, 25).expect("steps");
        let s = observers::singularity(simulation.model(), &simulation.state());
        let motion = observers::motion(simulation.model(), &simulation.state());
        let [p1, l2, l3, p4] = unequal().geometry.links.map(|link| link.length);
        let reach = |distal: f64, proximal: f64, d: f64, p: f64| d * p * (distal - proximal).sin();
        let legs = [reach(motion.theta[1], motion.theta[0], l2, p1), reach(motion.theta[2], motion.theta[3], l3, p4)];
        assert!(
            (s.jacobians.det_jq - legs[0] * legs[1]).abs() < 1e-15
                && (s.jacobians.sigma_jq - legs[0].abs().min(legs[1].abs())).abs() < 1e-14
        );
        let phi_q = simulation.model().mechanism.pose(&simulation.state().core.q).phi_q();
        let least = (phi_q * phi_q.transpose()).symmetric_eigenvalues().min();
        // Round-off of the smallest eigenvalue, before the square root.
        assert!((s.sigma_phi * s.sigma_phi - least).abs() < 1e-14, "{} {}", s.sigma_phi, least.sqrt());
        assert_eq!(s.jacobians.working, legs.map(|leg| leg >= 0.0));
    }
    // Direct and inverse at once, off the line of the motors: the elbows stretched, the left leg in line with them.
    let mut parameters = default_parameters();
    for (link, length) in parameters.geometry.links.iter_mut().zip([0.2, 0.15, 0.15, 0.45]) {
        link.length = length;
    }
    let (sin, cos) = 1.0f64.sin_cos();
    // The right elbow is 0.5 m from the left motor, on the line at 1 rad, and 0.45 m from its own motor.
    let elbow = [0.5 * cos, 0.5 * sin];
    let aside = (0.45f64.powi(2) - elbow[1].powi(2)).sqrt();
    parameters.geometry.base_distance = elbow[0] + aside;
    parameters.start.theta = [1.0, elbow[1].atan2(-aside)];
    let simulation = started(&parameters);
    assert_eq!(observers::singularity(simulation.model(), &simulation.state()).kind, SingularityKind::Combined);
}
