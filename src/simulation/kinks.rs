//! The kinks of the effects' forces, as the explicit method sees them in the link angles.

use std::borrow::Borrow;

use super::angles::{ANGLES, Angles, ByAngles, PLACES};
use crate::effects::{ForceContext, Sides, kinks};
use crate::integrator::{Kinked, Stretch, System};

impl Kinked<ANGLES> for ByAngles<'_> {
    type Sides = Sides;

    #[inline]
    fn has_kinks(&self) -> bool {
        self.model().has_kinks
    }

    fn sides_of(&self, q: &Angles, v: &Angles) -> Sides {
        self.at(q, v, |at| Sides::of(&self.model().effects, at))
    }

    #[inline]
    fn on(&self, sides: Sides) -> impl Borrow<Self> {
        Self::new(self.five_bar().on(sides))
    }

    fn beyond(&self, q: &Angles, v: &Angles, tolerance: f64) -> f64 {
        self.at(q, v, |at| kinks::beyond(&self.model().effects, at, tolerance))
    }

    fn behind(&self, q: &Angles, v: &Angles, tolerance: f64) -> Sides {
        self.at(q, v, |at| at.sides.behind(&self.model().effects, at, tolerance))
    }

    fn touches(&self, q: &Angles, v: &Angles) -> bool {
        self.at(q, v, |at| kinks::touching(&self.model().effects, at))
    }

    fn stays_within(&self, stretch: &Stretch<'_, ANGLES>, tolerance: f64) -> bool {
        let &Stretch { ends: [[q, v], [to_q, to_v]], duration, extremes } = stretch;
        let extremes = [0, 1].map(|order| PLACES.map(|i| extremes[order][i]));
        self.at(q, v, |from| {
            self.at(to_q, to_v, |to| {
                kinks::stays_free(&self.model().effects, &kinks::Stretch { ends: [*from, *to], duration, extremes }, tolerance)
            })
        })
    }
}

impl ByAngles<'_> {
    /// What effects answer for a state.
    fn at<T>(&self, q: &Angles, v: &Angles, answer: impl FnOnce(&ForceContext) -> T) -> T {
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        answer(&self.five_bar().context(&x, &pose, &rates))
    }
}
