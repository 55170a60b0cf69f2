//! A matrix over the turns of the links whose two legs the tip closes.

use super::at_tip;
use crate::mechanism::legs::{Legs, Legs2, both, sum};

/// A matrix of each leg over its two links by rows, closed by the tip: [A b; c −e] with the columns b of the tip's forces and the rows c
/// of its closure.
#[derive(Clone, Copy, Debug)]
pub struct BorderedMatrix {
    /// A⁻¹ by rows.
    inverse: [[Legs; 2]; 2],
    /// A⁻¹ b by links.
    columns: [Legs2; 2],
    /// (c A⁻¹ b + e)⁻¹ by rows.
    tip_inverse: [f64; 4],
}

impl BorderedMatrix {
    /// `pulls`: the rows of b by links; `ends`: the columns of c.
    #[inline(always)]
    pub(super) fn new([[pp, pd], [dp, dd]]: [[Legs; 2]; 2], [p, d]: [Legs2; 2], ends: &[Legs2; 2], e: f64) -> Self {
        let reciprocal = both(1.0) / (pp * dd - pd * dp);
        let inverse @ [[ipp, ipd], [idp, idd]] = [[dd * reciprocal, -pd * reciprocal], [-dp * reciprocal, pp * reciprocal]];
        let columns = [p.scaled(ipp).plus(d.scaled(ipd)), p.scaled(idp).plus(d.scaled(idd))];
        let [xx, yx] = tip_separation(ends, columns.map(|column| column.x));
        let [xy, yy] = tip_separation(ends, columns.map(|column| column.y));
        let (xx, yy) = (xx + e, yy + e);
        let reciprocal = 1.0 / (xx * yy - xy * yx);
        Self { inverse, columns, tip_inverse: [yy * reciprocal, -xy * reciprocal, -yx * reciprocal, xx * reciprocal] }
    }

    /// (c A⁻¹ b + e)⁻¹ x.
    #[inline(always)]
    fn at_tip(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [xx, xy, yx, yy] = self.tip_inverse;
        [xx * x + xy * y, yx * x + yy * y]
    }

    /// y of A x + b y = r, c x − e y = 0, and x of the same with c x − e y = −gap.
    #[inline(always)]
    pub(super) fn solve(&self, [p, d]: [Legs; 2], ends: &[Legs2; 2], gap: [f64; 2]) -> ([Legs; 2], [f64; 2]) {
        let [[pp, pd], [dp, dd]] = self.inverse;
        let free = [pp * p + pd * d, dp * p + dd * d];
        let open @ [x, y] = tip_separation(ends, free);
        let closing = at_tip(self.at_tip([x + gap[0], y + gap[1]]));
        ([free[0] - self.columns[0].dot(closing), free[1] - self.columns[1].dot(closing)], self.at_tip(open))
    }
}

/// By how much the legs' tips come apart where their links turn so far.
#[inline(always)]
fn tip_separation([p, d]: &[Legs2; 2], [turn_p, turn_d]: [Legs; 2]) -> [f64; 2] {
    [sum(p.x * turn_p + d.x * turn_d), sum(p.y * turn_p + d.y * turn_d)]
}
