//! The dual form equals the paper's penalty step, written as dense matrices from the paper's equations.

use fivebar::effects::Mode;
use fivebar::integrator::{self, Kkt, System, i3alp};
use fivebar::linear::dense::Dense;
use fivebar::linear::two_leg::{Elimination, TwoLeg};
use fivebar::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers};
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::{Inputs, Model, Simulation};
use nalgebra::{SMatrix, SVector};

use crate::support::{fall_90_120, unequal};

type Vector<const K: usize> = SVector<f64, K>;
type Matrix<const R: usize, const C: usize> = SMatrix<f64, R, C>;

/// κ with a well-conditioned penalty form: αβ/m̄ = 1e6.
const KAPPA: f64 = 1e6;

/// One step of the paper (`docs/method.md`, section 2): penalty α, exact tangent, λ* ← λ* + αΦ, two passes of each projection, all with
/// dense matrices. The loads do not depend on q or q̇, so that K = C = 0 apart from the geometric stiffness.
fn penalty_step(
    model: &Model,
    inputs: &Inputs,
    state: &integrator::State<COORDINATES, MULTIPLIERS>,
    h: f64,
) -> [Vector<COORDINATES>; 3] {
    let system = FiveBar::new(model, inputs, &[0; 4]).in_form::<true>();
    let mechanism = &model.mechanism;
    let beta = h * h / 4.0;
    let alpha = KAPPA * mechanism.geometry.mean_mass() / beta;
    let mass = Matrix::<COORDINATES, COORDINATES>::from_diagonal(&Vector::from(*mechanism.mass_times(&[1.0; COORDINATES].into())));
    let [q0, v0, a0] = [state.q, state.v, state.a].map(|x| Vector::from(*x));
    let mut multipliers = Vector::<MULTIPLIERS>::from(*state.lambda);
    let at = |q: &Vector<COORDINATES>| {
        let q = Coordinates::from(<[f64; COORDINATES]>::from(*q));
        let pose = mechanism.pose(&q);
        let force = Vector::from(*system.forces(&q, &pose, &Coordinates::ZERO).0);
        (pose.phi_q(), Vector::from(*mechanism.phi(&q, &pose)), force, pose)
    };

    let mut q = q0 + v0 * h + a0 * (h * h / 2.0);
    for _ in 0..8 {
        let (jacobian, phi, force, _) = at(&q);
        let a = (q - q0 - v0 * h) * (4.0 / (h * h)) - a0;
        let residual = (mass * a + jacobian.transpose() * (phi * alpha + multipliers) - force) * beta;
        let mut tangent = mass + jacobian.transpose() * jacobian * (alpha * beta);
        let total = Multipliers::from(<[f64; MULTIPLIERS]>::from(phi * alpha + multipliers));
        // ∂(Φ_qᵀλ)/∂q by central differences, independent of the tested formula.
        for j in 0..COORDINATES {
            let moved = |step: f64| {
                let mut q = Coordinates::from(<[f64; COORDINATES]>::from(q));
                q[j] += step;
                Vector::from(*mechanism.pose(&q).phi_q_transposed_times(&total))
            };
            tangent.column_mut(j).axpy(beta, &((moved(1e-5) - moved(-1e-5)) / 2e-5), 1.0);
        }
        q -= tangent.lu().solve(&residual).expect("a regular tangent");
        multipliers += at(&q).1 * alpha;
    }

    // Projections in the mass metric, two passes each, on the corrections.
    let (jacobian, _, force, pose) = at(&q);
    let projector = (mass + jacobian.transpose() * jacobian * (alpha * beta)).lu();
    let mut v = (q - q0) * (2.0 / h) - v0;
    for _ in 0..2 {
        v -= projector.solve(&(jacobian.transpose() * (jacobian * v) * (alpha * beta))).expect("a regular projector");
    }
    let centripetal = Vector::from(*pose.phi_q_dot_times(&<[f64; COORDINATES]>::from(v).into()));
    let (mut a, mut total) = (Vector::zeros(), Vector::<MULTIPLIERS>::zeros());
    for _ in 0..6 {
        let right = force - jacobian.transpose() * (total + centripetal * (alpha * beta));
        a = projector.solve(&right).expect("a regular projector");
        total += (jacobian * a + centripetal) * (alpha * beta);
    }
    [q, v, a]
}

#[test]
fn penalty_and_dual_steps_agree() {
    for (mut parameters, inputs) in [
        (fall_90_120(fivebar::simulation::Method::I3alp), Inputs::default()),
        (unequal(), Inputs { tau: [0.02, -0.01], ..default_inputs() }),
    ] {
        parameters.settings.penalty_scale = KAPPA;
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        for h in [1e-3, 2.5e-4] {
            simulation.advance(&inputs, 1e-3, 40).expect("steps");
            let model = simulation.model();
            let mut dual = simulation.state().core;
            // The penalty step starts from q + h q̇ + h²/2 q̈, without extrapolation of the increment.
            dual.jerk = Coordinates::ZERO;
            let penalty = penalty_step(model, &inputs, &dual, h);
            let settings = i3alp::Settings {
                adaptive: false,
                error_tolerance: 1.0,
                tolerance: 1e-15,
                max_iterations: 20,
                max_work: 1000,
                energy_scale: 1.0,
                energy_at_start: 0.0,
                regularization: model.regularization,
            };
            let system = FiveBar::new(model, &inputs, &[0; 4]).in_form::<true>();
            i3alp::MacroStep::of(h).advance(&system, &settings, &mut dual, &mut { Mode::OF_STATE }).expect("step");
            // Round-off of the penalty form is κ ε = 2e-10 of velocities and accelerations. One projection at κ = 1e6 leaves 1e-6 of the
            // violation, which is itself below 1e-6 of the velocity.
            for ((what, bound), (dual, penalty)) in
                [("q", 1e-12), ("q̇", 1e-8), ("q̈", 1e-4)].into_iter().zip([dual.q, dual.v, dual.a].into_iter().zip(penalty))
            {
                let scale = penalty.amax().max(1.0);
                let difference = (Vector::from(*dual) - penalty).amax() / scale;
                assert!(difference < bound, "{what} at h = {h}: {difference:e}");
            }
        }
    }
}

/// The two-leg elimination solves the same saddle-point system as the dense matrix, along a motion and for any right-hand side.
#[test]
fn two_leg_elimination_solves_the_dense_system() {
    for parameters in [unequal(), fall_90_120(fivebar::simulation::Method::I3alp)] {
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        for k in 0..20 {
            simulation.advance(&default_inputs(), 1e-3, 10).expect("steps");
            let mechanism = &simulation.model().mechanism;
            let pose = mechanism.pose(&simulation.state().core.q);
            let mass = Matrix::from_diagonal(&Vector::from(*mechanism.mass_times(&[1.0; COORDINATES].into())));
            let b = Coordinates::from_fn(|i| ((i * 7 + k) as f64).sin());
            let c = Multipliers::from_fn(|i| ((i * 5 + 3 * k) as f64).cos());
            let elimination = Elimination::new(mechanism, 1e-8);
            for regularization in [1e-10, 1e-2, 10.0] {
                let fast = TwoLeg::factor_mass(&elimination, &pose, regularization);
                let dense = Dense::factor(&pose, &mass, regularization);
                let ((x, y), (x_dense, y_dense)) = (fast.solve(&b, &c), dense.solve(&b, &c));
                let close = |fast: &[f64], dense: &[f64]| {
                    let scale = dense.iter().fold(1.0, |largest: f64, x| largest.max(x.abs()));
                    fast.iter().zip(dense).all(|(x, y)| (x - y).abs() < 1e-9 * scale)
                };
                assert!(close(&x[..], &x_dense[..]) && close(&y[..], &y_dense[..]), "regularization {regularization}, sample {k}");
                assert!(
                    close(&fast.correction(&c)[..], &dense.correction(&c)[..]),
                    "correction, regularization {regularization}, sample {k}"
                );
            }
        }
    }
}
