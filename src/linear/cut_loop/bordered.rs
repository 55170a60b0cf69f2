//! Bordered matrix of the cut loop: a 2×2 block for the rotations of each leg's links, bordered by the closure of the tip.

use super::at_tip;
use crate::mechanism::legs::{Legs, Legs2, both, sum};

/// The factorised bordered matrix [A b; c −e]: A acts on the two links of each leg, the columns b are the tip's forces, the rows c the
/// tip's closure.
#[derive(Clone, Copy, Debug)]
pub struct BorderedMatrix {
    /// Inverse A⁻¹ by rows.
    inverse: [[Legs; 2]; 2],
    /// Product A⁻¹ b, by links.
    columns: [Legs2; 2],
    /// Inverse Schur complement (c A⁻¹ b + e)⁻¹ by rows.
    tip_inverse: [f64; 4],
}

impl BorderedMatrix {
    /// Factorises A, given by rows. [p, d] are the rows of b by links, and `ends` are the columns of c.
    #[inline(always)]
    pub(super) fn new([[pp, pd], [dp, dd]]: [[Legs; 2]; 2], [p, d]: [Legs2; 2], ends: &[Legs2; 2], e: f64) -> Self {
        let reciprocal = both(1.0) / (pp * dd - pd * dp);
        let inverse @ [[ipp, ipd], [idp, idd]] = [[dd * reciprocal, -pd * reciprocal], [-dp * reciprocal, pp * reciprocal]];
        let columns = [p.scaled(ipp) + d.scaled(ipd), p.scaled(idp) + d.scaled(idd)];
        let [xx, yx] = tip_separation(ends, columns.map(|column| column.x));
        let [xy, yy] = tip_separation(ends, columns.map(|column| column.y));
        let (xx, yy) = (xx + e, yy + e);
        let reciprocal = 1.0 / (xx * yy - xy * yx);
        Self { inverse, columns, tip_inverse: [yy * reciprocal, -xy * reciprocal, -yx * reciprocal, xx * reciprocal] }
    }

    /// The product (c A⁻¹ b + e)⁻¹ x.
    fn at_tip(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [xx, xy, yx, yy] = self.tip_inverse;
        [xx * x + xy * y, yx * x + yy * y]
    }

    /// The product A⁻¹ r.
    pub(super) fn free(&self, [p, d]: [Legs; 2]) -> [Legs; 2] {
        let [[pp, pd], [dp, dd]] = self.inverse;
        [pp * p + pd * d, dp * p + dd * d]
    }

    /// Solves A x + b y = r with two closures: returns x for c x − e y = −gap, and y for c x − e y = 0.
    #[inline(always)]
    pub(super) fn solve(&self, right: [Legs; 2], ends: &[Legs2; 2], gap: [f64; 2]) -> ([Legs; 2], [f64; 2]) {
        let free = self.free(right);
        let open @ [x, y] = tip_separation(ends, free);
        let closing = at_tip(self.at_tip([x + gap[0], y + gap[1]]));
        ([free[0] - self.columns[0].dot(closing), free[1] - self.columns[1].dot(closing)], self.at_tip(open))
    }
}

/// Separation c x of the legs' tips for rotations of their links, m.
pub(super) fn tip_separation([p, d]: &[Legs2; 2], [turn_p, turn_d]: [Legs; 2]) -> [f64; 2] {
    [sum(p.x * turn_p + d.x * turn_d), sum(p.y * turn_p + d.y * turn_d)]
}
