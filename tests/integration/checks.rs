//! Checks of every step: every kind of step finds every kind of fault in the step in which it happens; correct steps pass
//! (`measure/hard-cases`, command `checks`, runs thousands of random scenes).

use std::f64::consts::PI;

use fivebar::hybrid::Law;
use fivebar::integrator::dense::{DenseStep, Horizon, Scheme, Schemes};
use fivebar::integrator::{
    AccelerationTangents, CONFIGURATION_SIGNS, Events, Features, Implicit, Kkt, Passage, Path, State, StepError, System,
    TangentPoint, Work, dense, i3alp,
};
use fivebar::mechanism::COORDINATES;
use fivebar::observers::{self, Energies};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{FailureCause, Method, Parameters, Simulation};

use crate::support::{methods_of_fixed_steps, methods_with_events};
use fivebar::vector::Vector;

/// A fault of a program.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Half a joule is lost between the two sides.
    Loss,
    /// A sign changes although its determinant is not near 0.
    Sign,
    /// The branch changes between the two sides.
    Branch,
}

/// A point of unit mass in the plane on a spring of 1 N/m, which starts right of the origin and passes it.
#[derive(Clone, Copy, Debug)]
struct Oscillator(Fault);

/// Scalar mass matrix factor; no constraints.
struct Scaled(f64);

impl Kkt<2, 0> for Scaled {
    fn solve(&self, b: &Vector<2>, _: &Vector<0>) -> (Vector<2>, Vector<0>) {
        (1.0 / self.0 * *b, Vector::ZERO)
    }
}

impl System<2, 0> for Oscillator {
    type Pose = Vector<2>;
    type Mass = Scaled;

    fn pose(&self, q: &Vector<2>) -> Vector<2> {
        *q
    }
    fn phi(&self, _: &Vector<2>, _: &Vector<2>) -> Vector<0> {
        Vector::ZERO
    }
    fn phi_q_times(&self, _: &Vector<2>, _: &Vector<2>) -> Vector<0> {
        Vector::ZERO
    }
    fn phi_q_dot_times(&self, _: &Vector<2>, _: &Vector<2>) -> Vector<0> {
        Vector::ZERO
    }
    fn mass_times(&self, _: &Vector<2>, x: &Vector<2>) -> Vector<2> {
        *x
    }
    fn forces(&self, q: &Vector<2>, _: &Vector<2>, _: &Vector<2>) -> (Vector<2>, Work) {
        (-*q, Work::default())
    }
    fn energy(&self, q: &Vector<2>, _: &Vector<2>, v: &Vector<2>) -> f64 {
        let lost = if self.0 == Fault::Loss && q[0] < 0.0 { 0.5 } else { 0.0 };
        (v.dot(v) + q.dot(q)) / 2.0 - lost
    }
    fn factor_mass(&self, _: &Vector<2>, _: f64) -> Scaled {
        Scaled(1.0)
    }
    fn features(&self) -> Features {
        Features { checks: true, ..Features::SMOOTH }
    }
    fn configuration_signs(&self, q: &Vector<2>) -> u8 {
        u8::from(q[0] < 0.0)
    }
    fn determinants(&self, q: &Vector<2>) -> [f64; CONFIGURATION_SIGNS] {
        [if self.0 == Fault::Sign { 100.0 } else { q[0] }, 0.0, 0.0]
    }
    fn branch(&self, q: &Vector<2>, _: &Vector<2>) -> Option<u8> {
        Some(u8::from(self.0 == Fault::Branch && q[0] < 0.0))
    }
    fn acceleration_tangents(&self, _: &State<2, 0>, _: &Vector<2>, _: f64) -> Option<AccelerationTangents<2>> {
        let by_q = [[-1.0, 0.0].into(), [0.0, -1.0].into()];
        Some(AccelerationTangents { by_q, by_v: [Vector::ZERO; 2] })
    }
    fn error_norm(&self, x: &Vector<2>) -> f64 {
        x.max_norm()
    }
    fn length_scale(&self) -> f64 {
        1.0
    }
}

impl Implicit<2, 0> for Oscillator {
    type General = Self;

    fn general(&self) -> Self {
        *self
    }
    fn phi_q_transposed_times(&self, _: &Vector<2>, _: &Vector<0>) -> Vector<2> {
        Vector::ZERO
    }
    fn solve_tangent(
        &self,
        at: &TangentPoint<'_, Vector<2>, 2, 0>,
        _: f64,
        b: &Vector<2>,
        _: &Vector<0>,
    ) -> Result<(Vector<2>, Vector<0>), StepError> {
        Ok((1.0 / (1.0 + at.h * at.h / 4.0) * *b, Vector::ZERO))
    }
}

impl Passage<2> for Oscillator {}

impl Events<2> for Oscillator {
    type Mode = ();
    type GuardValues = ();

    fn guard_values(&self, _: &Vector<2>, _: &Vector<2>) {}

    fn path_bounds(&self, _: &Path<2>) {}

    fn mode_of(&self, _: &Vector<2>, _: &Vector<2>) {}
}

fn by_schemes(system: Oscillator, schemes: Schemes, error_tolerance: f64) -> Result<(), StepError> {
    let settings = dense::Settings {
        schemes,
        error_tolerance,
        energy_scale: 1.0,
        first_step: 1e-3,
        max_iterations: 10,
        max_work: 400_000,
        regularization: 0.0,
    };
    let mut step = DenseStep::start(&system, [1.0, 0.5].into(), [0.0, 1.0].into(), &settings);
    step.advance(&system, &settings, 2.0, Horizon { output: f64::INFINITY, limit: f64::INFINITY }, None)
}

fn by_i3alp(system: Oscillator, error_tolerance: f64) -> Result<(), StepError> {
    let settings = i3alp::Settings {
        adaptive: true,
        error_tolerance,
        tolerance: 1e-13,
        max_iterations: 10,
        max_work: 400_000,
        energy_scale: 1.0,
        energy_at_start: 0.0,
        regularization: 0.0,
    };
    let mut state = State::start(&system, [1.0, 0.5].into(), [0.0, 1.0].into(), 0.0);
    i3alp::MacroStep::of(2.0).advance(&system, &settings, &mut state, &mut ()).map(drop)
}

#[test]
fn every_fault_is_found_by_every_kind_of_step() {
    let schemes = Scheme::LIST.iter().map(|scheme| Schemes::Only(*scheme)).chain([Schemes::Automatic]);
    for by in schemes.map(Some).chain([None]) {
        let name = by.map_or("i3alp".to_owned(), |schemes| format!("{schemes:?}"));
        for tolerance in [1e-6, 1e-8, 1e-10] {
            let found = |fault| match by {
                Some(schemes) => by_schemes(Oscillator(fault), schemes, tolerance),
                None => by_i3alp(Oscillator(fault), tolerance),
            };
            assert_eq!(found(Fault::None), Ok(()), "{name}, {tolerance:e} rad");
            assert!(
                matches!(found(Fault::Loss), Err(StepError::Imbalance { .. })),
                "{name}, {tolerance:e}: {:?}",
                found(Fault::Loss)
            );
            assert!(matches!(found(Fault::Sign), Err(StepError::SignWithoutSingularity { determinant: 0, .. })), "{name}");
            assert_eq!(found(Fault::Branch), Err(StepError::BranchChange), "{name}");
        }
    }
}

/// A run with `more` J of energy in its stored state than it has, as after a program error that loses energy.
fn robbed(simulation: &Simulation, more: f64) -> Simulation {
    let Energies { kinetic, potential, .. } = observers::energies(simulation.model(), &simulation.state());
    let energy = kinetic + potential;
    let mut bytes = borsh::to_vec(simulation.run()).expect("bytes");
    let mut replaced = 0;
    for at in 0..bytes.len() - 8 {
        let value = f64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
        // Steps of 3e-9 rad keep the energy to some 1e-8.
        if (value / energy - 1.0).abs() < 1e-6 {
            bytes[at..at + 8].copy_from_slice(&(energy + more).to_le_bytes());
            replaced += 1;
        }
    }
    assert!(replaced > 0, "the state stores its energy");
    Simulation::restored(simulation.parameters(), borsh::from_slice(&bytes).expect("a run")).expect("a state")
}

fn falling(method: Method, checks: bool) -> Simulation {
    let mut parameters: Parameters = default_parameters();
    (parameters.settings.method, parameters.settings.checks) = (method, checks);
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
    simulation.advance(&default_inputs(), 1e-3, 100).expect("steps");
    simulation
}

/// A step that loses 2 mJ, a hundredth of the energy, is refused with a message, and nothing changes.
#[test]
fn a_five_bar_that_loses_energy_is_stopped() {
    for method in methods_with_events().into_iter().chain([Method::I3alpConserving]) {
        let sound = falling(method, true);
        let ahead =
            |mut simulation: Simulation| simulation.advance(&default_inputs(), 1e-3, 100).map(|()| simulation.state().core.q);
        assert!(ahead(robbed(&sound, 0.0)).is_ok(), "{method:?}");
        let before = robbed(&sound, 2e-3);
        let mut stopped = before.clone();
        let failure = stopped.advance(&default_inputs(), 1e-3, 100).expect_err("a loss");
        assert!(
            matches!(failure.cause, FailureCause::Step(StepError::Imbalance { off, admissible }) if off < -admissible),
            "{method:?}: {failure}"
        );
        assert!(failure.to_string().contains("J that no force explains"), "{failure}");
        assert_eq!(stopped.run(), before.run(), "{method:?}");
    }
}

/// A torque of 1e300 N·m leaves no finite energy. Each method says so, or stops for another reason, and no message has a NaN.
#[test]
fn an_energy_that_is_not_finite_is_named() {
    for &method in Method::LIST {
        let mut simulation = falling(method, true);
        let mut inputs = default_inputs();
        inputs.tau[0] = 1e300;
        if let Err(failure) = simulation.advance(&inputs, 1e-3, 100) {
            assert!(!failure.to_string().contains("NaN"), "{method:?}: {failure}");
        } else {
            let core = simulation.state().core;
            assert!(core.q.is_finite() && core.v.is_finite(), "{method:?}");
        }
    }
}

/// Without checks the state stores no energy, and the motion has the same bits.
#[test]
fn checks_change_no_motion() {
    for &method in Method::LIST {
        let [with, without] = [true, false].map(|checks| falling(method, checks).state().core);
        assert_eq!((with.q, with.v), (without.q, without.v), "{method:?}");
        assert!((0..COORDINATES).all(|i| with.a[i] == without.a[i]), "{method:?}");
    }
}

/// Failing checks of fixed steps are counted: links turn by a tenth of a turn in each step.
#[test]
fn steps_of_fixed_length_are_counted() {
    // The conserving method refuses such a step.
    for method in methods_of_fixed_steps().into_iter().filter(|method| *method != Method::I3alpConserving) {
        let count = |step_size: f64, checks: bool| {
            let mut parameters = default_parameters();
            let settings = &mut parameters.settings;
            (settings.method, settings.adaptive, settings.step_size, settings.checks) = (method, false, step_size, checks);
            (parameters.start.theta, parameters.start.omega) = ([1.2, 1.9], [20.0, -15.0]);
            let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
            for _ in 0..20 {
                if simulation.advance(&default_inputs(), step_size, 1).is_err() {
                    break;
                }
            }
            simulation.breaches()
        };
        assert_eq!(count(1e-4, true), 0, "{method:?}");
        assert!(count(2e-2, true) > 0, "{method:?}");
        assert_eq!(count(2e-2, false), 0, "{method:?}");
    }
}

/// Folded legs remain singular, so that the signs of their bends are round-off, also while friction holds everything.
#[test]
fn folded_legs_that_come_to_rest_are_not_stopped() {
    for method in methods_with_events() {
        for motor in 0..40 {
            let mut parameters = default_parameters();
            parameters.geometry.base_distance = 0.0;
            parameters.settings.method = method;
            let friction = &mut parameters.effects.friction;
            (friction.enabled, friction.law) = (true, Law::Stick);
            (friction.coulomb, friction.breakaway) = ([0.5; 5], [0.6; 5]);
            let [left, right] = [0.3 + 0.07 * f64::from(motor), -1.1 + 0.05 * f64::from(motor)];
            let (theta, omega) = ([left, left + PI, right - PI, right], [2.0, 2.0, -1.0, -1.0]);
            let mut simulation = Simulation::at(&parameters, &default_inputs(), theta, omega).expect("a scene");
            let done = simulation.advance(&default_inputs(), 1e-3, 100);
            done.unwrap_or_else(|failure| panic!("{method:?}, {motor}: {failure}"));
        }
    }
}

/// Folded legs that are nearly in line with each other: the closure determines their bends only to round-off divided by the angle between
/// the legs, so their signs change at random while nothing moves, and that is no fault.
#[test]
fn signs_of_folded_legs_nearly_in_line_are_round_off() {
    for method in methods_with_events() {
        for apart in [1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5] {
            for motor in 0..6 {
                let mut parameters = default_parameters();
                parameters.geometry.base_distance = 0.0;
                (parameters.settings.method, parameters.settings.error_tolerance) = (method, 1e-11);
                parameters.effects.gravity.enabled = false;
                let left = 0.3 + 1.07 * f64::from(motor);
                let right = left + apart;
                let theta = [left, left + PI, right + PI, right];
                let mut simulation = Simulation::at(&parameters, &default_inputs(), theta, [0.0; 4]).expect("a scene");
                let done = simulation.advance(&default_inputs(), 1e-3, 300);
                done.unwrap_or_else(|failure| panic!("{method:?}, {apart:e} rad, {motor}: {failure}"));
            }
        }
    }
}
