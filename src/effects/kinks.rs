//! Kinks of forces: where a formula changes, and on which side of each a motion is.
//!
//! A method that follows its error ends a step where its motion crosses a border, and begins the next behind it: within a step every
//! force is one smooth formula, and an order stays what it is. Which sides hold is for the method to remember ([`Sides`]); by
//! [`Sides::BY_STATE`], as all other methods have it, every formula is the one of the present state.
//!
//! Kinks are those of the one-sided springs of stops and contact. Friction and servos have smooth laws.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::unilateral_spring::{Border, Phase, UnilateralSpring};
use super::{Active, ForceContext};
use crate::mechanism::LINKS;

/// One-sided springs: that of the contact, and two for each motor's stops.
pub(super) const SPRINGS: usize = 5;

/// Numbers that change sign where a motion passes a kink.
pub const INDICATORS: usize = 3 * SPRINGS;

/// Place of the contact among them.
pub(super) const CONTACT: usize = 0;

/// Places of the lower and the upper stop of the motors.
pub(super) const STOPS: [[usize; 2]; 2] = [[1, 2], [3, 4]];

/// On which side of their kinks forces are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Sides([Option<Phase>; SPRINGS]);

impl Sides {
    /// Wherever the state is.
    pub const BY_STATE: Self = Self([None; SPRINGS]);
}

/// A one-sided spring as it is now.
#[derive(Clone, Copy)]
pub(super) struct Touch<'a> {
    /// Its place in [`Sides`].
    pub(super) place: usize,
    pub(super) spring: &'a UnilateralSpring,
    /// Penetration, m or rad.
    pub(super) depth: f64,
    /// Its rate.
    pub(super) rate: f64,
    /// By how much the penetration changes with the angle of each link at most, m or rad.
    pub(super) arms: &'a [f64; LINKS],
}

impl Touch<'_> {
    /// Whether it does not touch.
    pub(super) fn is_free(&self, at: &ForceContext) -> bool {
        self.phase(&at.sides) == Phase::Free
    }

    /// N, N or N·m.
    pub(super) fn force(&self, at: &ForceContext) -> f64 {
        self.spring.force(self.phase(&at.sides), self.depth, self.rate)
    }

    /// ∂N/∂d and ∂N/∂ḋ.
    pub(super) fn slopes(&self, at: &ForceContext) -> [f64; 2] {
        self.spring.slopes(self.phase(&at.sides), self.depth, self.rate)
    }

    /// U, J.
    pub(super) fn potential(&self, at: &ForceContext) -> f64 {
        self.spring.potential(self.phase(&at.sides), self.depth)
    }

    /// Power lost, W.
    pub(super) fn dissipation(&self, at: &ForceContext) -> f64 {
        self.spring.dissipation(self.phase(&at.sides), self.depth, self.rate)
    }

    /// The phase that holds.
    fn phase(&self, sides: &Sides) -> Phase {
        sides.0[self.place].unwrap_or_else(|| self.spring.phase(self.depth, self.rate))
    }

    /// What a motion may overlook at an angular tolerance, rad: its own error, or a part of the ramp, but no less than round-off.
    fn unit(&self, tolerance: f64) -> f64 {
        /// Part of a ramp that may be overlooked.
        const PART: f64 = 0.01;
        /// Round-off of an angle, rad.
        const ROUND_OFF: f64 = 1e-13;
        let scale: f64 = self.arms.iter().sum();
        (tolerance * scale).min(PART * self.spring.width).max(ROUND_OFF * scale)
    }

    /// The borders of the phase that holds, in units of what may be overlooked.
    fn borders(&self, sides: &Sides, tolerance: f64) -> impl Iterator<Item = Border> {
        let unit = self.unit(tolerance);
        let borders = self.spring.borders(self.phase(sides), self.depth, self.rate).into_iter().flatten();
        borders.map(move |Border { beyond, behind }| Border { beyond: beyond / unit, behind })
    }
}

/// The one-sided springs of a scene as they are now.
pub struct Touches<'a>(ArrayVec<Touch<'a>, SPRINGS>);

impl<'a> Touches<'a> {
    /// Those of a state.
    pub fn new(effects: &'a Active, at: &ForceContext) -> Self {
        Self(effects.iter().flat_map(|effect| effect.touches(at)).collect())
    }

    /// The sides of the state by itself.
    pub fn sides(&self) -> Sides {
        let mut sides = Sides::BY_STATE;
        for touch in &self.0 {
            sides.0[touch.place] = Some(touch.spring.phase(touch.depth, touch.rate));
        }
        sides
    }

    /// Numbers that change sign where a motion passes a kink; 1 of springs that are absent.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let mut indicators = [1.0; INDICATORS];
        for touch in &self.0 {
            indicators[3 * touch.place..][..3].copy_from_slice(&touch.spring.kinks(touch.depth, touch.rate));
        }
        indicators
    }

    /// Whether any touches.
    pub fn any(&self, sides: &Sides) -> bool {
        self.0.iter().any(|touch| touch.phase(sides) != Phase::Free)
    }

    /// How far the state is beyond the border that it is farthest beyond, in units of what may be overlooked at an angular tolerance, rad;
    /// negative on the near side of all.
    pub fn beyond(&self, sides: &Sides, tolerance: f64) -> f64 {
        let borders = self.0.iter().flat_map(|touch| touch.borders(sides, tolerance));
        borders.fold(f64::NEG_INFINITY, |farthest, border| farthest.max(border.beyond))
    }

    /// The sides behind the borders that the state is beyond, and behind the nearest one.
    pub fn behind(&self, sides: Sides, tolerance: f64) -> Sides {
        let nearest = self.beyond(&sides, tolerance).min(0.0);
        let mut behind = sides;
        for touch in &self.0 {
            let crossed = touch.borders(&sides, tolerance).filter(|border| border.beyond >= nearest);
            if let Some(border) = crossed.max_by(|a, b| a.beyond.total_cmp(&b.beyond)) {
                behind.0[touch.place] = Some(border.behind);
            }
        }
        behind
    }

    /// Whether springs that do not touch at one end of a motion cannot have touched on its way, deeper than may be overlooked: it takes
    /// some seconds, and links turn at these rates, rad/s, and accelerations, rad/s², at most.
    pub fn stay_free(ends: [&Self; 2], sides: &Sides, duration: f64, extremes: [[f64; LINKS]; 2], tolerance: f64) -> bool {
        let [from, to] = ends;
        let [rates, accelerations] = extremes;
        let mut pairs = from.0.iter().zip(&to.0).filter(|(touch, _)| touch.phase(sides) == Phase::Free);
        pairs.all(|(from, to)| {
            let bend: f64 = (0..LINKS).map(|link| from.arms[link] * (accelerations[link] + rates[link] * rates[link])).sum();
            deepest([from.depth, from.rate], [to.depth, to.rate], duration, bend) <= from.unit(tolerance)
        })
    }
}

/// The greatest value that a function can have between two places, from values and slopes there and the bound on its second derivative:
/// below both parabolas.
fn deepest([x, u]: [f64; 2], [y, w]: [f64; 2], duration: f64, bend: f64) -> f64 {
    let at = |start: f64, slope: f64, time: f64| start + time * (slope + bend / 2.0 * time);
    // Where they meet: they differ by a linear function of time, which only round-off keeps from rising.
    let rising = u - w + bend * duration;
    let meet =
        if rising > 0.0 { ((y - x - w * duration + bend / 2.0 * duration * duration) / rising).clamp(0.0, duration) } else { 0.0 };
    x.max(y).max(at(x, u, meet).max(at(y, -w, duration - meet)))
}
