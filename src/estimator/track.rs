//! One estimate: motion, unknown force, and the bank of errors about both.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{Bank, Error, Matrix};
use super::innovation::Innovation;
use super::linkage::{Frame, Linkage, Links, MEASURED, NEAR_VERTEX, Pair};
use super::propagate;
use super::transition::{self, ERRORS, Flow, Scene};

/// Smallest singular value of J over the mean length below which propagated and simulated motion are compared.
const COMPARED_BELOW: f64 = 0.2;
/// Largest differences of angles, rad, and rates, rad/s, for which propagated and simulated motion agree.
const AGREEMENT: [f64; 2] = [1e-3, 0.1];
/// Change of a rate in a step, relative to the fastest rate, that means that the motion has turned in a vertex.
const LEAST_RATE_CHANGE: f64 = 0.3;
/// Largest rate of a credible estimate, rad/s.
const LARGEST_RATE: f64 = 2e3;
/// Rate below which a machine next to a vertex counts as at rest, rad/s.
const REST_RATE: f64 = 0.05;
/// Regularisation of the squared input effects: next to a singularity no input is asked for a force that it cannot exert.
const EFFECT_REGULARIZATION: f64 = 1e-6;

/// An estimate.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Track {
    /// Link angles, rad, without whole turns.
    pub theta: Links,
    /// Rates, rad/s.
    pub omega: Links,
    /// Unknown force as motor torques, N·m, and a tip force, N: the smallest inputs with its effect.
    pub force: [f64; 4],
    /// Bank of errors about the motion and the force.
    pub bank: Bank,
}

/// Result of the time update of a macro step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Transition matrix of the errors.
    pub(super) transition: Matrix,
    /// Whether the motion passed too close to a vertex to know its branch.
    pub(super) held: bool,
}

/// An angle without whole turns, in (−π, π].
pub fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::TAU;
    angle - (angle / TAU).round() * TAU
}

/// Smallest inputs that exert a unit of each force on the tangent basis; tip forces are weighed by the mean length.
#[inline(never)]
pub(super) fn by_inputs(linkage: &Linkage, at: &Frame) -> [Pair; 4] {
    let scale = [1.0, 1.0, 1.0 / linkage.length, 1.0 / linkage.length];
    let effects = effects(at);
    let (mut xx, mut xy, mut yy) = (EFFECT_REGULARIZATION, 0.0, EFFECT_REGULARIZATION);
    for (input, scale) in scale.into_iter().enumerate() {
        let [x, y] = effects.map(|row| row[input] * scale);
        xx += x * x;
        xy += x * y;
        yy += y * y;
    }
    let determinant = xx * yy - xy * xy;
    std::array::from_fn(|input| {
        let squared = scale[input] * scale[input];
        let [x, y] = effects.map(|row| row[input] * squared);
        [(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant]
    })
}

/// Generalised forces on the tangent basis of a unit of each input.
#[inline(never)]
fn effects(at: &Frame) -> [[f64; 4]; 2] {
    let inputs = at.inputs();
    at.basis.map(|direction| std::array::from_fn(|input| (0..4).map(|link| direction[link] * inputs[link][input]).sum()))
}

/// Generalised force of some inputs on the tangent basis, N·m.
fn on_basis(at: &Frame, force: &[f64; 4]) -> Pair {
    effects(at).map(|row| row.iter().zip(force).map(|(effect, force)| effect * force).sum())
}

impl Track {
    /// Transition of the errors over h seconds that end at `theta`, `omega`; `flow` is the propagated motion to compare with.
    #[inline(never)]
    pub(super) fn step(&self, (from, to): (&Frame, &Frame), (theta, omega): (&Links, &Links), flow: &Flow, h: f64) -> Step {
        let smallest = from.smallest.min(to.smallest);
        let agrees = || {
            (0..4).all(|i| {
                wrapped(flow.theta[i] - theta[i]).abs() < AGREEMENT[0]
                    && (flow.omega[i] - omega[i]).abs() < AGREEMENT[1] + AGREEMENT[0] * omega[i].abs()
            })
        };
        // NaN counts as near a vertex.
        let held = !(smallest > NEAR_VERTEX && (smallest > COMPARED_BELOW || agrees()));
        let transition = if held { propagate::straight(from, to, h) } else { propagate::transition(from, to, flow) };
        let finite = transition.iter().flatten().all(|x| x.is_finite());
        if finite { Step { transition, held } } else { Step { transition: propagate::straight(from, to, h), held: true } }
    }

    /// Whether a motion that now has the rates `omega`, rad/s, and a singular value `smallest` has turned next to a vertex: forces do not
    /// change a rate by as much in a step.
    pub(super) fn has_turned(&self, omega: &Links, smallest: f64) -> bool {
        let fastest = self.omega.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()));
        fastest > REST_RATE
            && smallest < NEAR_VERTEX
            && (0..4).any(|i| (omega[i] - self.omega[i]).abs() > LEAST_RATE_CHANGE * fastest)
    }

    /// Estimate h seconds later at constant rates.
    pub(super) fn extrapolated(&self, linkage: &Linkage, h: f64) -> Self {
        // Not closed: the straight line meets the constraints to third order, while J near its rank loss would falsify the rates.
        let along: Links = std::array::from_fn(|i| self.theta[i] + h * self.omega[i]);
        let away = linkage.frame(&along).smallest >= NEAR_VERTEX;
        let (theta, omega) = match linkage.closed(along, self.omega) {
            Some((theta, omega, _)) if away => (theta, omega),
            _ => (along, self.omega),
        };
        Self { theta, omega, ..*self }
    }

    /// Motion that passes a vertex at the lateral distance `aside`, rad: integrated back by `before`, rad of the fastest link, displaced,
    /// and integrated forward, by `steps` steps each; `None` where that fails.
    #[cold]
    #[inline(never)]
    pub(super) fn with_lateral_offset(
        &self,
        linkage: &Linkage,
        scene: &impl Scene,
        (before, aside, steps): (f64, f64, u32),
    ) -> Option<Self> {
        let fastest = self.omega.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()));
        // At rest in a vertex there is no past motion.
        if fastest < REST_RATE {
            return None;
        }
        let time = before / fastest;
        let (theta, omega) = transition::motion(linkage, scene, (self.theta, self.omega), -time, steps);
        let (theta, omega, frame) = linkage.closed(theta, omega)?;
        let [x, y] = frame.coordinates(&omega);
        let speed = (x * x + y * y).sqrt();
        if speed < REST_RATE {
            return None;
        }
        let across = frame.tangent([-aside * y / speed, aside * x / speed]);
        let (theta, omega, _) = linkage.closed(std::array::from_fn(|i| theta[i] + across[i]), omega)?;
        let (theta, omega) = transition::motion(linkage, scene, (theta, omega), time, steps);
        if !theta.iter().chain(&omega).all(|x| x.abs() < LARGEST_RATE) || !linkage.is_closed(&theta, &omega) {
            return None;
        }
        let mut bank = self.bank;
        bank.change_basis(&linkage.frame(&self.theta).basis_map_to(&linkage.frame(&theta)));
        bank.inflate([aside * aside, (aside / before * fastest).powi(2)]);
        Some(Self { theta, omega, bank, ..*self })
    }

    /// Propagated motion with the derivatives by its errors, in at least `least` Runge–Kutta steps.
    pub(super) fn flow(&self, linkage: &Linkage, at: &Frame, scene: &impl Scene, (h, least): (f64, u32)) -> Flow {
        transition::flow(linkage, scene, (&self.theta, &self.omega, at), &by_inputs(linkage, at), h, least)
    }

    /// Innovation of a sample that encoder `encoder` takes now.
    pub(super) fn innovation(&self, at: &Frame, encoder: usize, angle: f64, noise: f64) -> Innovation {
        let link = MEASURED[encoder];
        let mut row = [0.0; ERRORS];
        (row[0], row[1]) = (at.basis[0][link], at.basis[1][link]);
        Innovation { residual: wrapped(angle - self.theta[link]), row, noise }
    }

    /// Injects the mean error into the estimate. Returns the error, the map between the tangent bases and the new frame; `None`, with
    /// nothing changed, where the loop cannot be closed.
    #[inline(never)]
    pub(super) fn inject_error(&mut self, linkage: &Linkage, from: &Frame) -> Option<(Error, [Pair; 2], Frame)> {
        let error = self.bank.mean();
        let (turned, quickened) = (from.tangent([error[0], error[1]]), from.tangent([error[2], error[3]]));
        let (theta, omega, to) = linkage
            .closed(std::array::from_fn(|i| self.theta[i] + turned[i]), std::array::from_fn(|i| self.omega[i] + quickened[i]))?;
        if !omega.iter().all(|rate| rate.abs() < LARGEST_RATE) {
            return None;
        }
        let force = on_basis(from, &self.force);
        let force = [force[0] + error[4], force[1] + error[5]];
        self.force = by_inputs(linkage, from).map(|row| row[0] * force[0] + row[1] * force[1]);
        (self.theta, self.omega) = (theta, omega);
        let turn = from.basis_map_to(&to);
        self.bank.subtract_mean(&error);
        self.bank.change_basis(&turn);
        Some((error, turn, to))
    }

    /// Covariance of the error about the estimate, the bank's mean error included.
    #[inline(never)]
    pub fn covariance(&self) -> Matrix {
        let (error, mut covariance) = self.bank.moments();
        for i in 0..ERRORS {
            for k in 0..ERRORS {
                covariance[i][k] += error[i] * error[k];
            }
        }
        covariance
    }

    /// Log-likelihood of the mirror state next to a direct singularity, at equal distance and opposite rate, which the motors do not
    /// distinguish: by s = sin(θ₃ − θ₂) and ṡ with their covariance.
    #[inline(never)]
    pub(super) fn mirror_log_likelihood(&self, at: &Frame) -> f64 {
        let slope = libm::cos(self.theta[2] - self.theta[1]);
        let row = at.basis.map(|direction| slope * (direction[2] - direction[1]));
        let (s, rate) = (at.side(), slope * (self.omega[2] - self.omega[1]));
        let covariance = self.covariance();
        let element = |i: usize, k: usize| {
            (0..2).map(|a| (0..2).map(|b| row[a] * covariance[2 * i + a][2 * k + b] * row[b]).sum::<f64>()).sum::<f64>()
        };
        let (xx, xy, yy) = (element(0, 0), element(0, 1), element(1, 1));
        let determinant = xx * yy - xy * xy;
        // Half the normalised square of twice the distance.
        -2.0 * (s * s * yy - 2.0 * s * rate * xy + rate * rate * xx) / determinant.max(f64::MIN_POSITIVE)
    }

    /// Whether a stored estimate is possible: closed loop, finite force, sound bank.
    #[cold]
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        linkage.is_closed(&self.theta, &self.omega) && self.force.iter().all(|x| x.is_finite()) && self.bank.is_sound()
    }

    /// Unknown force on the tangent basis, N·m.
    pub fn tangent_force(&self, at: &Frame) -> Pair {
        on_basis(at, &self.force)
    }

    /// Motor torques equivalent to the unknown force, N·m, and their standard deviations; `None` close to a direct singularity, where
    /// motors cannot exert it.
    pub fn motor_torques(&self, at: &Frame) -> Option<(Pair, Pair)> {
        /// Least |det| of the effect of the motors on the tangent basis: closer to a direct singularity torques grow without bound.
        const LEAST_DETERMINANT: f64 = 0.15;
        let [[a, b], [c, d]] = at.basis.map(|direction| MEASURED.map(|link| direction[link]));
        let determinant = a * d - b * c;
        if determinant.abs() < LEAST_DETERMINANT {
            return None;
        }
        let inverse = [[d / determinant, -b / determinant], [-c / determinant, a / determinant]];
        let force = self.tangent_force(at);
        let covariance = self.covariance();
        let torques = inverse.map(|row| row[0] * force[0] + row[1] * force[1]);
        let sigma = inverse.map(|[x, y]| {
            let variance = x * x * covariance[4][4] + 2.0 * x * y * covariance[4][5] + y * y * covariance[5][5];
            variance.max(0.0).sqrt()
        });
        Some((torques, sigma))
    }
}
