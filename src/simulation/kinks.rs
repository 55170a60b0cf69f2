//! The kinks of the effects' forces, as the methods that follow their error see them: in the link angles, or in the twelve coordinates.

use std::borrow::Borrow;

use super::angles::{ANGLES, Angles, ByAngles, DISTAL, PLACES, PROXIMAL};
use super::five_bar::FiveBar;
use super::grips::{resolved, slides, turns_between};
use crate::effects::{self, Sides, Slides, Touches, slow};
use crate::integrator::{Extremes, Kinked, System};
use crate::mechanism::coordinates::{THETA, legs_of};
use crate::mechanism::{COORDINATES, Coordinates, LINKS, Parallels, Pose};
use crate::vector::Vector;

/// A system on some sides: itself where there are no others, which saves a copy in each step.
enum On<'b, S> {
    Same(&'b S),
    Others(S),
}

impl<S> Borrow<S> for On<'_, S> {
    #[inline(always)]
    fn borrow(&self) -> &S {
        match self {
            Self::Same(system) => system,
            Self::Others(system) => system,
        }
    }
}

impl<'a> Kinked<ANGLES> for ByAngles<'a> {
    type Sides = Sides;
    type Touches = Touches<'a>;

    #[inline]
    fn has_kinks(&self) -> bool {
        self.model().has_kinks
    }

    #[inline]
    fn has_sides(&self) -> bool {
        self.has_kinks() || self.model().mechanism.geometry.base_distance == 0.0
    }

    #[inline]
    fn turning_rate(&self) -> f64 {
        self.model().turning_rate
    }

    #[inline]
    fn has_bends(&self) -> bool {
        self.model().has_bends
    }

    fn touches(&self, q: &Angles, v: &Angles) -> Touches<'a> {
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        let slides = self.five_bar().slides(&x, &pose, &rates);
        Touches::new(&self.model().effects, &self.five_bar().context(&x, &pose, &rates), slides)
    }

    #[inline]
    fn sides_of(&self, q: &Angles, v: &Angles) -> Sides {
        if !self.has_kinks() {
            return self.branched(Sides::BY_STATE, q, v);
        }
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        let springs = Touches::new(&self.model().effects, &self.five_bar().context(&x, &pose, &rates), Slides::new()).sides();
        self.branched(self.with_resolved_grips(springs, q, v), q, v)
    }

    #[inline(always)]
    fn branched(&self, sides: Sides, q: &Angles, v: &Angles) -> Sides {
        if self.model().mechanism.geometry.base_distance != 0.0 || sides.parallels.is_some() {
            return sides;
        }
        let pairs = |x: &Angles| [legs_of(x, PROXIMAL), legs_of(x, DISTAL)];
        sides.with_parallels(Parallels::of(&self.model().mechanism.geometry, pairs(q), pairs(v)))
    }

    #[inline]
    fn on(&self, sides: Sides) -> impl Borrow<Self> {
        if self.has_sides() { On::Others(self.on_sides(sides)) } else { On::Same(self) }
    }

    fn beyond(&self, at: &Touches<'a>, tolerance: f64) -> f64 {
        at.beyond(&self.five_bar().sides(), tolerance)
    }

    fn behind(&self, q: &Angles, v: &Angles, tolerance: f64) -> Sides {
        let sides = self.touches(q, v).behind(self.five_bar().sides(), tolerance);
        self.with_resolved_grips(sides, q, v)
    }

    fn has_grips(&self) -> bool {
        self.model().sticks
    }

    fn is_pushed(&self) -> bool {
        self.five_bar().sides().any_pushes()
    }

    fn released(&self, at: &Touches<'a>) -> f64 {
        at.released(&self.five_bar().sides())
    }

    fn lasts(&self, at: &Touches<'a>) -> f64 {
        at.last(&self.five_bar().sides())
    }

    fn is_at_rest(&self) -> bool {
        self.five_bar().sides.grips.at_rest()
    }

    fn holds_in_motion(&self, at: &Touches<'a>) -> bool {
        at.any_holds_in_motion(&self.five_bar().sides())
    }

    fn strain(&self, at: &Touches<'a>, tolerance: f64) -> f64 {
        at.strain(&self.five_bar().sides(), tolerance)
    }

    fn stays_within(&self, ends: [&Touches<'a>; 2], duration: f64, extremes: &Extremes<ANGLES>, tolerance: f64) -> bool {
        Touches::stay(ends, &self.five_bar().sides(), duration, &of_links(extremes, PLACES), tolerance)
    }
}

/// Extremes of coordinates, of which these are the angles of the links.
fn of_links<const N: usize>(Extremes { rates, accelerations, higher }: &Extremes<N>, links: [usize; LINKS]) -> effects::Extremes {
    let of = |x: &Vector<N>| links.map(|i| x[i]);
    effects::Extremes {
        rates: of(rates),
        accelerations: of(accelerations),
        higher: higher.as_ref().map(|[jerks, snaps]| [of(jerks), of(snaps)]),
    }
}

impl ByAngles<'_> {
    /// Sides with the grips of a state.
    fn with_resolved_grips(&self, sides: Sides, q: &Angles, v: &Angles) -> Sides {
        if !self.model().sticks {
            return sides;
        }
        let (x, rates) = self.coordinates(&self.pose(q), q, v);
        sides.with_grips(resolved(&self.five_bar().on(sides), &x, &rates))
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// The grips as they are, where there are any.
    fn slides(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Slides {
        if self.model.sticks { slides(&self.general(), q, pose, v) } else { Slides::new() }
    }
}

impl<'a, const BARE: bool> Kinked<COORDINATES> for FiveBar<'a, BARE> {
    type Sides = Sides;
    type Touches = Touches<'a>;

    #[inline(always)]
    fn has_kinks(&self) -> bool {
        !BARE && self.model.has_kinks
    }

    #[inline(always)]
    fn may_touch(&self) -> bool {
        !BARE && self.model.may_touch
    }

    fn touches(&self, q: &Coordinates, v: &Coordinates) -> Touches<'a> {
        let pose = self.pose(q);
        let slides = self.slides(q, &pose, v);
        Touches::new(&self.model.effects, &self.context(q, &pose, v), slides)
    }

    /// Springs are wherever the state is, and so are grips that nobody remembers.
    #[inline]
    fn sides_of(&self, q: &Coordinates, v: &Coordinates) -> Sides {
        if BARE || !self.model.sticks { Sides::BY_STATE } else { Sides::of_grips(resolved(&self.general(), q, v)) }
    }

    #[inline(always)]
    fn on(&self, sides: Sides) -> impl Borrow<Self> {
        FiveBar::on(self, sides)
    }

    #[inline(always)]
    fn has_grips(&self) -> bool {
        !BARE && self.model.sticks
    }

    #[inline(always)]
    fn is_at_rest(&self) -> bool {
        !BARE && self.sides.grips.at_rest()
    }

    fn knows_grips(&self, at: &Touches<'a>) -> bool {
        at.are_known(&self.sides.grips)
    }

    fn beyond(&self, at: &Touches<'a>, tolerance: f64) -> f64 {
        at.beyond(&self.sides(), tolerance)
    }

    fn turns_between(&self, ends: [[&Coordinates; 3]; 2], duration: f64, tolerance: f64) -> bool {
        turns_between(&self.general(), ends, duration, slow(tolerance))
    }

    /// What slips is told by [`Kinked::turns_between`], which knows accelerations.
    fn stays_within(&self, ends: [&Touches<'a>; 2], duration: f64, extremes: &Extremes<COORDINATES>, tolerance: f64) -> bool {
        Touches::show_their_way(ends, duration, &of_links(extremes, THETA), tolerance)
    }
}
