//! The five-bar with its active effects and held inputs, as the integrator sees it.

use std::marker::PhantomData;

use nalgebra::{SMatrix, SVector};

use super::coupled::Coupled;
use super::dense::Dense;
use super::model::{Model, Solve};
use super::two_leg::TwoLeg;
use crate::effects::tangents::{CoupledTangents, DiagonalTangents, FullTangents, INNER, INNERS};
use crate::effects::{Inputs, Situation, Tangents};
use crate::integrator::{self, Failure, Implicit, Kkt, Power, System};
use crate::mechanism::closure::assemble;
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, largest_angle, legs_of};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose, vertex};

/// The tangent must keep at least this part of the mass matrix; below it the step is too long for a Newton step to be a descent.
const LEAST_INERTIA: f64 = 0.1;

/// What a descent direction needs: at least this part of the mass matrix.
const DESCENT_INERTIA: f64 = 0.3;

/// What to do where A₀ is not sufficiently positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Definite {
    /// Refuse it: the step is too long.
    Demanded,
    /// Raise it until it is: a descent direction.
    Enforced,
}

/// Of which step the tangent A₀ = M + h/2 C + h²/4 (K + ∂(Φ_qᵀλ)/∂q) is factorised.
pub struct TangentOf<'a> {
    at: Situation<'a>,
    /// Multipliers, N for constraints in m.
    lambda: &'a Multipliers,
    /// The step, s.
    h: f64,
    /// e of the saddle-point matrix, 1/kg.
    softness: f64,
    definite: Definite,
}

/// How saddle-point matrices are factorised: chosen once, when the scene is made ready.
pub trait LinearSolve: Sized {
    /// The factor with M, which is always diagonal, in the corner.
    type Mass: Kkt<COORDINATES, MULTIPLIERS>;
    /// The factor with A₀.
    type Tangent: Kkt<COORDINATES, MULTIPLIERS>;
    /// Whether the scene has effects whose force depends on the motion. What they may be asked has to stay in memory, and a scene
    /// without them shall not pay for that.
    const EFFECTS: bool = true;

    /// Factorises with M.
    fn factor_mass(five_bar: &FiveBar<'_, Self>, pose: &Pose, softness: f64) -> Self::Mass;

    /// Factorises with A₀.
    fn factor(five_bar: &FiveBar<'_, Self>, of: &TangentOf<'_>) -> Result<Self::Tangent, Failure>;
}

/// For scenes without effects whose force depends on the motion, with inertias of like size: what a bare mechanism needs, and no code
/// for more.
#[derive(Debug)]
pub enum Bare {}

impl LinearSolve for Bare {
    type Mass = TwoLeg;
    type Tangent = TwoLeg;
    const EFFECTS: bool = false;

    #[inline(always)]
    fn factor_mass(five_bar: &FiveBar<'_, Self>, pose: &Pose, softness: f64) -> TwoLeg {
        TwoLeg::factor_mass(&five_bar.model.elimination, pose, softness)
    }

    #[inline(always)]
    fn factor(five_bar: &FiveBar<'_, Self>, of: &TangentOf<'_>) -> Result<TwoLeg, Failure> {
        five_bar.factor_two_leg(of)
    }
}

/// The geometric stiffness of links 1 to 4, N·m/rad.
fn geometric_stiffness(pose: &Pose, lambda: &Multipliers) -> [f64; 4] {
    let (stiffness_p, stiffness_d) = pose.geometric_stiffness(lambda);
    let ([p_left, p_right], [d_left, d_right]) = (stiffness_p.to_array(), stiffness_d.to_array());
    [p_left, d_left, d_right, p_right]
}

/// A₀ if it is sufficiently positive, or made so.
fn made_definite<const K: usize>(
    mut a0: SMatrix<f64, K, K>,
    mass: &SMatrix<f64, K, K>,
    definite: Definite,
) -> Result<SMatrix<f64, K, K>, Failure> {
    let keeps = |a0: &SMatrix<f64, K, K>, part: f64| ((a0 + a0.transpose()) / 2.0 - mass * part).cholesky().is_some();
    match definite {
        Definite::Demanded if !keeps(&a0, LEAST_INERTIA) => return Err(Failure::IndefiniteTangent),
        Definite::Demanded => {}
        // Doubling ends: some multiple of M outweighs any tangent that is finite.
        Definite::Enforced => {
            let mut more = DESCENT_INERTIA;
            while !keeps(&a0, DESCENT_INERTIA) {
                a0 += mass * more;
                more *= 2.0;
                if !more.is_finite() {
                    return Err(Failure::NotFinite);
                }
            }
        }
    }
    Ok(a0)
}

/// For any scene: which factor, [`Solve`] says.
#[derive(Debug)]
pub enum General {}

/// Any of the factors.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a step allocates nothing")]
pub enum Factor {
    /// Leg by leg.
    TwoLeg(TwoLeg),
    /// Effects couple links.
    Coupled(Coupled),
    /// Whatever the inertias.
    Dense(Dense),
}

impl Kkt<COORDINATES, MULTIPLIERS> for Factor {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        match self {
            Self::TwoLeg(factor) => factor.solve(b, c),
            Self::Coupled(factor) => factor.solve(b, c),
            Self::Dense(factor) => factor.solve(b, c),
        }
    }

    fn correction(&self, c: &Multipliers) -> Coordinates {
        match self {
            Self::TwoLeg(factor) => factor.correction(c),
            Self::Coupled(factor) => factor.correction(c),
            Self::Dense(factor) => factor.correction(c),
        }
    }
}

impl LinearSolve for General {
    type Mass = Factor;
    type Tangent = Factor;

    fn factor_mass(five_bar: &FiveBar<'_, Self>, pose: &Pose, softness: f64) -> Factor {
        match five_bar.model.solve {
            Solve::Dense => Factor::Dense(Dense::factor(pose, &five_bar.mass_matrix(), softness)),
            _ => Factor::TwoLeg(TwoLeg::factor_mass(&five_bar.model.elimination, pose, softness)),
        }
    }

    fn factor(five_bar: &FiveBar<'_, Self>, of: &TangentOf<'_>) -> Result<Factor, Failure> {
        match five_bar.model.solve {
            Solve::Bare | Solve::TwoLegged => five_bar.factor_two_leg(of).map(Factor::TwoLeg),
            Solve::LinksCoupled => five_bar.factor_coupled(of),
            Solve::Dense => five_bar.factor_dense(of).map(Factor::Dense),
        }
    }
}

impl<L: LinearSolve> FiveBar<'_, L> {
    #[inline(always)]
    fn factor_two_leg(&self, of: &TangentOf<'_>) -> Result<TwoLeg, Failure> {
        let &TangentOf { ref at, lambda, h, softness, definite } = of;
        let (model, pose) = (self.model, at.pose);
        let mechanism = &model.mechanism;
        let mut tangents = DiagonalTangents::new(h);
        self.add_tangents(at, &mut tangents);
        let beta = h * h / 4.0;
        let (stiffness_p, stiffness_d) = pose.geometric_stiffness(lambda);
        let inertia_p = mechanism.inertia_p + beta * stiffness_p + legs_of(&tangents.weighted, P_THETA);
        let inertia_d = mechanism.inertia_d + beta * stiffness_d + legs_of(&tangents.weighted, D_THETA);
        if definite == Definite::Enforced {
            let inertia_p = inertia_p.max(DESCENT_INERTIA * mechanism.inertia_p);
            let inertia_d = inertia_d.max(DESCENT_INERTIA * mechanism.inertia_d);
            return Ok(TwoLeg::factor(&model.elimination, pose, [inertia_p, inertia_d], softness));
        }
        let margin_p = inertia_p - LEAST_INERTIA * mechanism.inertia_p;
        let margin_d = inertia_d - LEAST_INERTIA * mechanism.inertia_d;
        let [left, right] = margin_p.fast_min(margin_d).to_array();
        if left > 0.0 && right > 0.0 {
            Ok(TwoLeg::factor(&model.elimination, pose, [inertia_p, inertia_d], softness))
        } else {
            Err(Failure::IndefiniteTangent)
        }
    }

    #[inline(always)]
    fn factor_coupled(&self, of: &TangentOf<'_>) -> Result<Factor, Failure> {
        let &TangentOf { ref at, lambda, h, softness, definite } = of;
        let masses = self.model.mechanism.mass_times(&[1.0; COORDINATES]);
        let inner_masses = SMatrix::from_diagonal(&SVector::from(INNER.map(|i| masses[i])));
        let mut tangents = CoupledTangents::new(h);
        self.add_tangents(at, &mut tangents);
        let mut a0 = inner_masses + tangents.weighted;
        for (i, stiffness) in geometric_stiffness(at.pose, lambda).into_iter().enumerate() {
            let place = INNERS - 4 + i;
            a0[(place, place)] += h * h / 4.0 * stiffness;
        }
        let a0 = made_definite(a0, &inner_masses, definite)?;
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| a0[(i, j)]));
        Ok(Factor::Coupled(Coupled::factor(at.pose, &masses, rows, softness)))
    }

    fn factor_dense(&self, of: &TangentOf<'_>) -> Result<Dense, Failure> {
        let &TangentOf { ref at, lambda, h, softness, definite } = of;
        let mass = self.mass_matrix();
        let mut a0 = mass + self.full_tangents(at, h);
        for (i, stiffness) in THETA.into_iter().zip(geometric_stiffness(at.pose, lambda)) {
            a0[(i, i)] += h * h / 4.0 * stiffness;
        }
        Ok(Dense::factor(at.pose, &made_definite(a0, &mass, definite)?, softness))
    }
}

impl FiveBar<'_, General> {
    /// See [`System::least_constraint`].
    fn branch_of_least_constraint(&self, q: &Coordinates) -> Option<(Coordinates, u32)> {
        // Forces and masses in the link angles, from the motions of the open legs that one angle alone makes.
        let pose = self.pose(q);
        let force = self.forces(q, &pose, &[0.0; COORDINATES]);
        let motions = [0, 1, 2, 3].map(|link| {
            let mut rate = [0.0; 4];
            rate[link] = 1.0;
            assemble(&self.model.mechanism.geometry, THETA.map(|i| q[i]), rate).1
        });
        let dot = |x: &Coordinates, y: &Coordinates| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let forces = motions.map(|motion| dot(&force, &motion));
        let masses = motions.map(|row| {
            let momentum = self.model.mechanism.mass_times(&row);
            motions.map(|column| dot(&momentum, &column))
        });
        let branch = vertex::least_constraint(&self.model.mechanism.geometry, q, forces, masses)?;
        Some((in_angles(branch.direction), branch.alternatives))
    }
}

/// A model with the inputs and whole turns that stay while it is stepped.
#[derive(Debug)]
pub struct FiveBar<'a, L> {
    model: &'a Model,
    inputs: &'a Inputs,
    turns: &'a [i64; 4],
    follows_work: bool,
    linear_solve: PhantomData<L>,
}

impl<'a, L: LinearSolve> FiveBar<'a, L> {
    /// `model` under `inputs`, with the whole turns of links 1 to 4 that q leaves out.
    pub fn new(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4]) -> Self {
        Self { model, inputs, turns, follows_work: inputs.load() || !model.conservative, linear_solve: PhantomData }
    }

    /// The same after whole turns have changed.
    pub(super) fn with_turns<'b>(&self, turns: &'b [i64; 4]) -> FiveBar<'b, L>
    where
        'a: 'b,
    {
        FiveBar { turns, ..*self }
    }

    /// Power of what is followed along the path.
    #[inline(never)]
    pub(super) fn power_of(&self, core: &integrator::State<COORDINATES, MULTIPLIERS>) -> Power {
        self.power(&core.q, &self.pose(&core.q), &core.v)
    }

    /// The model.
    pub(super) fn model(&self) -> &'a Model {
        self.model
    }

    #[inline(always)]
    fn at<'b>(&'b self, q: &'b Coordinates, pose: &'b Pose, v: &'b Coordinates) -> Situation<'b> {
        Situation { q, v, pose, inputs: self.inputs, turns: self.turns }
    }

    #[inline(always)]
    fn add_tangents(&self, at: &Situation, tangents: &mut impl Tangents) {
        self.inputs.add_tangents(at, tangents);
        if L::EFFECTS {
            for effect in &self.model.effects {
                effect.add_tangents(at, tangents);
            }
        }
    }

    fn full_tangents(&self, at: &Situation, h: f64) -> SMatrix<f64, COORDINATES, COORDINATES> {
        let mut tangents = FullTangents::new(h);
        self.add_tangents(at, &mut tangents);
        tangents.weighted
    }

    fn mass_matrix(&self) -> SMatrix<f64, COORDINATES, COORDINATES> {
        SMatrix::from_diagonal(&SVector::from(self.model.mechanism.mass_times(&[1.0; COORDINATES])))
    }
}

/// Values of the four links in the places of their angles.
#[inline(always)]
fn in_angles(values: [f64; 4]) -> Coordinates {
    let mut coordinates = [0.0; COORDINATES];
    for (i, value) in THETA.into_iter().zip(values) {
        coordinates[i] = value;
    }
    coordinates
}

impl<L: LinearSolve> System<COORDINATES, MULTIPLIERS> for FiveBar<'_, L> {
    type Pose = Pose;
    type Mass = L::Mass;

    #[inline(always)]
    fn pose(&self, q: &Coordinates) -> Pose {
        self.model.mechanism.pose(q)
    }

    #[inline(always)]
    fn phi(&self, q: &Coordinates, pose: &Pose) -> Multipliers {
        self.model.mechanism.phi(q, pose)
    }

    #[inline(always)]
    fn phi_q_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_times(v)
    }

    #[inline(always)]
    fn phi_q_dot_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_dot_times(v)
    }

    #[inline(always)]
    fn mass_times(&self, _pose: &Pose, x: &Coordinates) -> Coordinates {
        self.model.mechanism.mass_times(x)
    }

    #[inline(always)]
    fn forces(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Coordinates {
        let at = self.at(q, pose, v);
        let mut forces = self.model.weight;
        self.inputs.add_forces(&at, &mut forces);
        if L::EFFECTS {
            for effect in &self.model.effects {
                effect.add_forces(&at, &mut forces);
            }
        }
        forces
    }

    #[inline(always)]
    fn factor_mass(&self, pose: &Pose, softness: f64) -> L::Mass {
        L::factor_mass(self, pose, softness)
    }

    fn potential(&self, q: &Coordinates, pose: &Pose) -> Option<f64> {
        let at = self.at(q, pose, &[0.0; COORDINATES]);
        Some(self.model.potential(&at) + self.inputs.potential(&at))
    }

    fn conservative(&self) -> bool {
        self.model.conservative
    }

    fn power_without_potential(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> f64 {
        let at = self.at(q, pose, v);
        self.model.effects.iter().map(|effect| effect.input_power(&at) - effect.dissipation(&at)).sum()
    }

    #[inline(always)]
    fn vertex(&self, q: &Coordinates, v: &Coordinates) -> Option<(Coordinates, Coordinates)> {
        // With coaxial motors all links in line are no isolated posture: there they turn together.
        if self.model.mechanism.geometry.base_distance == 0.0 {
            return None;
        }
        let offset = vertex::offset(q)?;
        Some((in_angles(offset), in_angles(THETA.map(|i| v[i]))))
    }

    fn rebuilt(&self, q: &Coordinates, v: &Coordinates) -> (Coordinates, Coordinates) {
        assemble(&self.model.mechanism.geometry, THETA.map(|i| q[i]), THETA.map(|i| v[i]))
    }

    fn least_constraint(&self, q: &Coordinates) -> Option<(Coordinates, u32)> {
        FiveBar::<General>::new(self.model, self.inputs, self.turns).branch_of_least_constraint(q)
    }

    #[inline(always)]
    fn modes(&self, pose: &Pose) -> u8 {
        pose.modes()
    }

    #[inline(always)]
    fn follows_work(&self) -> bool {
        self.follows_work
    }

    #[inline(always)]
    fn power(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Power {
        let at = self.at(q, pose, v);
        let mut power = Power { input: self.inputs.power(&at), dissipated: 0.0 };
        for effect in &self.model.effects {
            power.input += effect.input_power(&at);
            power.dissipated += effect.dissipation(&at);
        }
        power
    }

    #[inline(always)]
    fn angle_norm(&self, x: &Coordinates) -> f64 {
        largest_angle(x)
    }

    #[inline(always)]
    fn size(&self) -> f64 {
        self.model.size
    }
}

impl<'a, L: LinearSolve> Implicit<COORDINATES, MULTIPLIERS> for FiveBar<'a, L> {
    type Tangent = L::Tangent;
    type Rare = FiveBar<'a, General>;

    #[inline(always)]
    fn rare(&self) -> FiveBar<'a, General> {
        let Self { model, inputs, turns, follows_work, .. } = *self;
        FiveBar { model, inputs, turns, follows_work, linear_solve: PhantomData }
    }

    #[inline(always)]
    fn phi_q_transposed_times(&self, pose: &Pose, lambda: &Multipliers) -> Coordinates {
        pose.phi_q_transposed_times(lambda)
    }

    fn weight_times(&self, q: &Coordinates, pose: &Pose, v: &Coordinates, h: f64, x: &Coordinates) -> Coordinates {
        let weight = self.mass_matrix() + self.full_tangents(&self.at(q, pose, v), h);
        (weight * SVector::from(*x)).into()
    }

    #[inline(always)]
    fn factor_tangent(
        &self,
        q: &Coordinates,
        pose: &Pose,
        v: &Coordinates,
        lambda: &Multipliers,
        h: f64,
        softness: f64,
    ) -> Result<L::Tangent, Failure> {
        L::factor(self, &TangentOf { at: self.at(q, pose, v), lambda, h, softness, definite: Definite::Demanded })
    }

    fn factor_descent(
        &self,
        q: &Coordinates,
        pose: &Pose,
        v: &Coordinates,
        lambda: &Multipliers,
        h: f64,
        softness: f64,
    ) -> Option<L::Tangent> {
        L::factor(self, &TangentOf { at: self.at(q, pose, v), lambda, h, softness, definite: Definite::Enforced }).ok()
    }
}
