//! The four postures in which the constraints of the paper's machine lose rank, and the cone of motions through each.
//!
//! Let s be the signs of cos θ of the links in the closure. The motions satisfy Σ s ω = 0 and Σ s ω² = 0. One link has the odd sign; the
//! rates of the other three lie on a circle around a third of its rate (`docs/method.md`, equation (23)).

use std::f64::consts::PI;

/// Positions of elbows and tip on the x axis, in link lengths: left elbow, right elbow, tip.
pub const POSTURES: [Vertex; 4] = [
    Vertex { name: "(1, 3, 2)", theta: [0.0, 0.0, PI, 0.0] },
    Vertex { name: "(1, 1, 2)", theta: [0.0, 0.0, 0.0, PI] },
    Vertex { name: "(1, 1, 0)", theta: [0.0, PI, PI, PI] },
    Vertex { name: "(-1, 1, 0)", theta: [PI, 0.0, PI, PI] },
];

/// A posture with all links on the x axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Left elbow, right elbow and tip on the x axis, in link lengths.
    pub name: &'static str,
    /// Link angles, rad.
    pub theta: [f64; 4],
}

impl Vertex {
    /// Signs of the link rates in the closure.
    fn signs(&self) -> [f64; 4] {
        let [c1, c2, c3, c4] = self.theta.map(|theta| f64::cos(theta).signum());
        [c1, c2, -c3, -c4]
    }

    /// The link with the odd sign; the sign of its rate distinguishes the two sheets of the cone.
    pub fn odd(&self) -> usize {
        let signs = self.signs();
        let sum: f64 = signs.iter().sum();
        signs.iter().position(|sign| sign * sum < 0.0).expect("one sign differs: the base has the length of two links")
    }

    /// Direction of the cone at angle `f` around it, with rate 1 of the odd link.
    pub fn direction(&self, f: f64) -> [f64; 4] {
        let radius = (2.0_f64 / 3.0).sqrt();
        let (e1, e2) = (radius * f.cos() / 2_f64.sqrt(), radius * f.sin() / 6_f64.sqrt());
        let rest = [1.0 / 3.0 + e1 + e2, 1.0 / 3.0 - e1 + e2, 1.0 / 3.0 - 2.0 * e2];
        let odd = self.odd();
        let mut rest = rest.into_iter();
        std::array::from_fn(|i| if i == odd { 1.0 } else { rest.next().expect("three other links") })
    }

    /// Unit vector perpendicular to this direction, along the cone's sheet.
    pub(crate) fn across(&self, f: f64) -> [f64; 4] {
        let (a, b) = (self.direction(f + 1e-6), self.direction(f - 1e-6));
        let difference: [f64; 4] = std::array::from_fn(|i| a[i] - b[i]);
        difference.map(|part| part / dot(difference, difference).sqrt())
    }

    /// Difference of the link angles from the posture, without whole turns.
    pub fn offset(&self, theta: [f64; 4]) -> [f64; 4] {
        std::array::from_fn(|i| {
            let difference = theta[i] - self.theta[i];
            difference - 2.0 * PI * (difference / (2.0 * PI)).round()
        })
    }
}

/// The cosine of the angle between two directions.
pub(crate) fn cosine(a: [f64; 4], b: [f64; 4]) -> f64 {
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

fn dot(a: [f64; 4], b: [f64; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
