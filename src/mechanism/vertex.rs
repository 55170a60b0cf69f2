//! Vertices of the configuration space: all links lie on the x axis, the constraints lose rank and branches intersect.
//!
//! With c = cos θ = ±1 and the signed lengths s = (c₁l₁, c₂l₂, −c₃l₃, −c₄l₄), closure to second order around a vertex is Σ s w = 0 and Σ s
//! w² = 0 for displacements or rates w of the link angles: a quadratic cone in a three-dimensional space.

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

use super::Geometry;
use super::legs::{Legs, both};
use crate::vector::ROUND;

/// Largest distance from a vertex, rad, at which its tangent cone is used: third-order terms are a few percent there.
const LARGEST_OFFSET: f64 = 0.3;

/// Displacements of the link angles (proximal, distal) from the nearest vertex, rad; `None` if any is 0.3 rad or more.
pub fn offset(angles: [Legs; 2]) -> Option<[Legs; 2]> {
    let near = |angle: Legs| {
        let turns = (angle * both(std::f64::consts::FRAC_1_PI) + both(ROUND)) - both(ROUND);
        let offset = angle - turns * both(std::f64::consts::PI);
        (offset.abs().simd_lt(both(LARGEST_OFFSET)).to_bitmask() == 0b11).then_some(offset)
    };
    // The proximal links alone exclude most postures.
    near(angles[0]).and_then(|proximal| near(angles[1]).map(|distal| [proximal, distal]))
}

/// Branch of least constraint: how a motion leaves a vertex from rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// Unit direction of the initial accelerations of the angles of links 1 to 4.
    pub direction: [f64; 4],
    /// Number of other local maxima of the gain; each is a possible branch.
    pub alternatives: u32,
}

/// Applies Gauss's principle of least constraint to the tangent cone at the angles of links 1 to 4, rad. The motion from rest takes the
/// direction d on the cone with the largest gain (g·d)²/(d·M d). Here g are the generalised forces, N·m, and M is the mass matrix in the
/// link angles, kg·m².
///
/// Each local maximum is a possible branch. The largest is taken, or the first around the cone if two are equal. `None` if the forces drive
/// no direction, or if the cone is a single point (the links lock).
pub fn least_constraint(geometry: &Geometry, theta: [f64; 4], force: [f64; 4], mass: [[f64; 4]; 4]) -> Option<Branch> {
    let cone = Cone::new(geometry, theta)?;
    let (force, mass) = (Vector4::from(force), Matrix4::from_fn(|i, j| mass[i][j]));
    let gain = |angle: f64| cone.gain(angle, &force, &mass);

    // Local maxima on a grid around the cone; a golden-section search refines each.
    const GRID: usize = 360;
    let at = |i: usize| (i % GRID) as f64 * std::f64::consts::TAU / GRID as f64;
    let values: [f64; GRID] = std::array::from_fn(|i| gain(at(i)));
    let largest = values.iter().fold(0.0_f64, |largest, &value| largest.max(value));
    if largest <= 0.0 {
        return None;
    }
    let peaks = (0..GRID).filter(|&i| {
        let (before, after) = (values[(i + GRID - 1) % GRID], values[(i + 1) % GRID]);
        values[i] > before && values[i] >= after && values[i] > 1e-9 * largest
    });
    let step = std::f64::consts::TAU / GRID as f64;
    let (mut best, mut count) = ((f64::NEG_INFINITY, 0.0), 0);
    for peak in peaks {
        let angle = golden_maximum(&gain, at(peak) - step, at(peak) + step);
        count += 1;
        // Equal maxima of symmetric cases differ only by rounding; the first is kept.
        if gain(angle) > best.0 * (1.0 + 1e-12) || count == 1 {
            best = (gain(angle), angle);
        }
    }
    let direction = cone.direction(best.1);
    let direction = direction * force.dot(&direction).signum();
    Some(Branch { direction: direction.into(), alternatives: (count as u32).saturating_sub(1) })
}

/// Unit directions on one half of the tangent cone, by the angle around its axis; the other half has the opposite directions.
struct Cone {
    axis: Vector4<f64>,
    across: [Vector4<f64>; 2],
}

impl Cone {
    fn new(geometry: &Geometry, theta: [f64; 4]) -> Option<Self> {
        let s = Vector4::from_fn(|i, _| {
            let side = if i < 2 { 1.0 } else { -1.0 };
            side * libm::cos(theta[i]).signum() * geometry.links[i].length
        });
        // Orthonormal basis of Σ s w = 0: the images of three axes under the reflection that maps the fourth axis to s.
        let last = s.iamax();
        let mut normal = s;
        normal[last] += s[last].signum() * s.norm();
        let reflected = |i: usize| {
            let mut axis = Vector4::zeros();
            axis[i] = 1.0;
            axis - normal * (2.0 * normal[i] / normal.norm_squared())
        };
        let mut free = [Vector4::zeros(); 3];
        for (basis, i) in free.iter_mut().zip((0..4).filter(|&i| i != last)) {
            *basis = reflected(i);
        }
        // In this basis the quadratic form Σ s w² is a cone if one eigenvalue differs in sign from the other two.
        let form = Matrix3::from_fn(|i, j| free[i].component_mul(&s).dot(&free[j]));
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(form);
        let sign = -eigenvalues.product().signum();
        let signed = eigenvalues * sign;
        let odd = signed.imin();
        let rest: [usize; 2] = match odd {
            0 => [1, 2],
            1 => [0, 2],
            _ => [0, 1],
        };
        // After the change of sign, the odd eigenvalue must be negative and the other two positive.
        if !(signed[odd] < 0.0 && rest.iter().all(|&i| signed[i] > 0.0)) {
            return None;
        }
        let vector = |i: usize| {
            let v: Vector3<f64> = eigenvectors.column(i).into();
            (free[0] * v[0] + free[1] * v[1] + free[2] * v[2]) / signed[i].abs().sqrt()
        };
        Some(Self { axis: vector(odd), across: rest.map(vector) })
    }

    fn direction(&self, angle: f64) -> Vector4<f64> {
        let (sin, cos) = libm::sincos(angle);
        (self.axis + self.across[0] * cos + self.across[1] * sin).normalize()
    }

    /// Gain (g·d)²/(d·M d) of a direction, N²·m²/(kg·m²); one compiled copy for all callers.
    #[inline(never)]
    fn gain(&self, angle: f64, force: &Vector4<f64>, mass: &Matrix4<f64>) -> f64 {
        let direction = self.direction(angle);
        force.dot(&direction).powi(2) / direction.dot(&(mass * direction))
    }
}

fn golden_maximum(f: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let ratio = (5f64.sqrt() - 1.0) / 2.0;
    // f is flat at a maximum, so the search finds only half of the digits of the angle.
    while high - low > 1e-9 {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if f(a) < f(b) { low = a } else { high = b }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanism::Link;
    use std::f64::consts::PI;

    fn paper() -> Geometry {
        let link = Link { length: 0.21, mass: 0.017, inertia: 6.23e-5, com: 0.105 };
        Geometry { base_distance: 0.42, links: [link; 4] }
    }

    /// Directions satisfy both equations of the cone, for equal and for unequal lengths.
    #[test]
    fn directions_lie_on_the_cone() {
        let mut unequal = paper();
        for (link, length) in unequal.links.iter_mut().zip([0.2, 0.3, 0.25, 0.17]) {
            link.length = length;
        }
        for (geometry, theta) in [(paper(), [PI, 0.0, PI, PI]), (paper(), [0.0, 0.0, PI, 0.0]), (unequal, [0.0, PI, PI, 0.0])] {
            let cone = Cone::new(&geometry, theta).expect("a cone");
            for k in 0..12 {
                let w = cone.direction(f64::from(k) * 0.5);
                let s = Vector4::from_fn(|i, _| [1.0, 1.0, -1.0, -1.0][i] * theta[i].cos() * geometry.links[i].length);
                let (first, second) = (s.dot(&w), s.dot(&w.component_mul(&w)));
                assert!(first.abs() < 1e-15 && second.abs() < 1e-15, "{first:e} {second:e}");
            }
        }
    }

    #[test]
    fn only_postures_near_the_axis_have_an_offset() {
        let legs = |[left, right]: [f64; 2]| Legs::new([left, right]);
        let near = offset([legs([PI + 0.01, -PI]), legs([-0.02, 3.0 * PI + 0.03])]).expect("near");
        let near = near.map(|legs| legs.to_array());
        for (got, want) in near.as_flattened().iter().zip([0.01, 0.0, -0.02, 0.03]) {
            assert!((got - want).abs() < 1e-14, "{near:?}");
        }
        assert!(offset([legs([PI + 0.31, PI]), legs([0.0, PI])]).is_none());
    }
}
