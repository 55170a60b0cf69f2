//! The kinks of the effects' forces, as the methods that follow their error see them: in the link angles, or in the twelve coordinates.

use std::borrow::Borrow;

use super::angles::{ANGLES, Angles, ByAngles, PLACES};
use super::five_bar::FiveBar;
use crate::effects::{Sides, Touches};
use crate::integrator::{Kinked, System};
use crate::mechanism::coordinates::THETA;
use crate::mechanism::{COORDINATES, Coordinates};

impl<'a> Kinked<ANGLES> for ByAngles<'a> {
    type Sides = Sides;
    type Touches = Touches<'a>;

    #[inline]
    fn has_kinks(&self) -> bool {
        self.model().has_kinks
    }

    fn touches(&self, q: &Angles, v: &Angles) -> Touches<'a> {
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        Touches::new(&self.model().effects, &self.five_bar().context(&x, &pose, &rates))
    }

    #[inline]
    fn sides_of(&self, q: &Angles, v: &Angles) -> Sides {
        if self.has_kinks() { self.touches(q, v).sides() } else { Sides::BY_STATE }
    }

    #[inline]
    fn on(&self, sides: Sides) -> impl Borrow<Self> {
        Self::new(self.five_bar().on(sides))
    }

    fn beyond(&self, at: &Touches<'a>, tolerance: f64) -> f64 {
        at.beyond(&self.five_bar().sides(), tolerance)
    }

    fn behind(&self, q: &Angles, v: &Angles, tolerance: f64) -> Sides {
        self.touches(q, v).behind(self.five_bar().sides(), tolerance)
    }

    fn is_touching(&self, at: &Touches<'a>) -> bool {
        at.any(&self.five_bar().sides())
    }

    fn stays_within(&self, ends: [&Touches<'a>; 2], duration: f64, extremes: &[Angles; 2], tolerance: f64) -> bool {
        let extremes = [0, 1].map(|order| PLACES.map(|i| extremes[order][i]));
        Touches::stay_free(ends, &self.five_bar().sides(), duration, extremes, tolerance)
    }
}

impl<'a, const BARE: bool> Kinked<COORDINATES> for FiveBar<'a, BARE> {
    type Sides = Sides;
    type Touches = Touches<'a>;

    #[inline(always)]
    fn has_kinks(&self) -> bool {
        !BARE && self.model.has_kinks
    }

    fn touches(&self, q: &Coordinates, v: &Coordinates) -> Touches<'a> {
        Touches::new(&self.model.effects, &self.context(q, &self.pose(q), v))
    }

    fn sides_of(&self, q: &Coordinates, v: &Coordinates) -> Sides {
        self.touches(q, v).sides()
    }

    fn beyond(&self, at: &Touches<'a>, tolerance: f64) -> f64 {
        at.beyond(&self.sides(), tolerance)
    }

    fn is_touching(&self, at: &Touches<'a>) -> bool {
        at.any(&self.sides())
    }

    fn stays_within(&self, ends: [&Touches<'a>; 2], duration: f64, extremes: &[Coordinates; 2], tolerance: f64) -> bool {
        let extremes = [0, 1].map(|order| THETA.map(|i| extremes[order][i]));
        Touches::stay_free(ends, &self.sides(), duration, extremes, tolerance)
    }
}
