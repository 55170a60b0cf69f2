//! Discrete state of the hybrid system, the [`Mode`]: phases of force laws with kinks, stick-slip states of friction places, branch of the
//! closure. An error-controlled method ends its step where the trajectory crosses a guard and begins the next step in the next mode. Within
//! a step every force is then one smooth formula, so the method keeps its order. All other methods use [`Mode::OF_STATE`]: the current
//! state determines every formula.

use borsh::{BorshDeserialize, BorshSerialize};

use crate::mechanism::ClosureBranch;

/// Number of kinks. The list in `effects/mod.rs` gives each its index.
pub const KINKS: usize = 5;

/// Number of friction places: five joints, and the tip on the plane.
pub const FRICTION_PLACES: usize = 6;

/// Index of the tip among the friction places.
pub const TIP_FRICTION: usize = FRICTION_PLACES - 1;

/// Phase of a force law with a kink in its quantity x. In each phase the force is one smooth formula, which extends smoothly beyond the
/// borders of the phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Phase {
    /// Below the lower level of x. A unilateral spring has no reaction: no contact, or a separation so fast that the damper would have to
    /// pull.
    Below,
    /// Between the two levels: on the ramp of a unilateral spring.
    Within,
    /// Above the upper level: past the ramp of a unilateral spring.
    Beyond,
}

/// Mode of the hybrid system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Mode {
    /// Phase of the law at every kink; `None` means the phase of the current state.
    pub kinks: [Option<Phase>; KINKS],
    /// Stick-slip state of every friction place.
    pub stick_slip: StickSlips,
    /// Branch of the closure; `None` if the motion is on no branch of a reducible closure (`closure_branch.rs`).
    pub closure_branch: Option<ClosureBranch>,
}

impl Mode {
    /// No stored mode: the current state determines the branch of every force law.
    pub const OF_STATE: Self = Self { kinks: [None; KINKS], stick_slip: StickSlips::OPEN, closure_branch: None };

    /// Whether any law is above its lower level, such as a spring that pushes.
    pub fn has_active_contact(&self) -> bool {
        self.kinks.iter().flatten().any(|phase| *phase != Phase::Below)
    }

    /// A copy of the mode with other stick-slip states.
    pub fn with_stick_slip(self, stick_slip: StickSlips) -> Self {
        Self { stick_slip, ..self }
    }

    /// A copy of the mode on another branch of the closure.
    pub fn with_closure_branch(self, closure_branch: Option<ClosureBranch>) -> Self {
        Self { closure_branch, ..self }
    }

    /// A mode with these stick-slip states and all laws in the phase of the current state.
    pub fn of_stick_slip(stick_slip: StickSlips) -> Self {
        Self::OF_STATE.with_stick_slip(stick_slip)
    }
}

/// Direction of slip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum SlipDirection {
    /// Positive sliding rate.
    Forward,
    /// Negative sliding rate.
    Backward,
}

impl SlipDirection {
    /// Direction of a sliding rate; forward at 0.
    pub fn of(x: f64) -> Self {
        if x < 0.0 { Self::Backward } else { Self::Forward }
    }

    /// Sign of the direction, ±1.
    pub fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

/// Stick-slip state of a friction place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum StickSlip {
    /// Inactive: no friction, the smooth law, or no contact.
    Inactive,
    /// Slips in a direction.
    Slips(SlipDirection),
    /// Sticks. If several places constrain the same motion, the direction is the sign of this place's share relative to the first place.
    Sticks(SlipDirection),
    /// Still: the closure branch keeps the joint from turning, so friction there has no effect.
    Still,
}

impl StickSlip {
    /// Whether the place sticks.
    pub fn sticks(self) -> bool {
        matches!(self, Self::Sticks(_))
    }
}

/// Stick-slip states of all friction places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct StickSlips {
    places: [StickSlip; FRICTION_PLACES],
    /// Whether friction keeps the whole mechanism at rest.
    at_rest: bool,
}

impl StickSlips {
    /// No friction place is active.
    pub const OPEN: Self = Self { places: [StickSlip::Inactive; FRICTION_PLACES], at_rest: false };

    /// State of one friction place.
    pub fn at(&self, place: usize) -> StickSlip {
        self.places[place]
    }

    /// Sets the state of one friction place.
    pub fn set(&mut self, place: usize, state: StickSlip) {
        self.places[place] = state;
    }

    /// Whether friction keeps the whole mechanism at rest.
    pub fn at_rest(&self) -> bool {
        self.at_rest
    }

    /// The states on a closure branch: joints that it keeps from turning are [`StickSlip::Still`].
    pub fn on_branch(mut self, closure_branch: ClosureBranch) -> Self {
        closure_branch.still_joints().iter().for_each(|place| self.set(*place, StickSlip::Still));
        self
    }

    /// Whether the closure branch keeps a friction place from moving.
    pub fn is_still(&self, place: usize) -> bool {
        self.places[place] == StickSlip::Still
    }

    /// The states with all places inactive, except those that the closure branch locks.
    pub fn opened(&self) -> Self {
        let mut stick_slip = Self::OPEN;
        (0..FRICTION_PLACES).filter(|place| self.is_still(*place)).for_each(|place| stick_slip.set(place, StickSlip::Still));
        stick_slip
    }

    /// The states of a mechanism at rest, with these places sticking.
    pub fn resting(self, places: impl Iterator<Item = usize>) -> Self {
        let mut stick_slip = Self { at_rest: true, ..self.opened() };
        places.for_each(|place| stick_slip.set(place, StickSlip::Sticks(SlipDirection::Forward)));
        stick_slip
    }

    /// Whether any friction place sticks.
    pub fn any_sticks(&self) -> bool {
        self.places.iter().any(|state| state.sticks())
    }

    /// Sign of the sliding direction of a place with a rate, rad/s or m/s. A stored slip state gives its direction, a sticking place 0;
    /// without a stored state the rate gives the sign.
    pub fn direction(&self, place: usize, rate: f64) -> f64 {
        match self.places[place] {
            StickSlip::Slips(slip_direction) => slip_direction.sign(),
            StickSlip::Sticks(_) | StickSlip::Still => 0.0,
            StickSlip::Inactive if rate == 0.0 => 0.0,
            StickSlip::Inactive => SlipDirection::of(rate).sign(),
        }
    }
}
