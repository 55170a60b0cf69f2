//! Closure of the loop: q and q̇ from the proximal angles, their rates and the assembly mode.
//!
//! The tip is an intersection of two circles around the elbows, with radii l₂ and l₃. The distal rates solve l₂ ω₂ n̂₂ − l₃ ω₃ n̂₃ = p with
//! the velocity p of the right elbow relative to the left one. [`close`] describes singular postures.

use borsh::{BorshDeserialize, BorshSerialize};

use nalgebra::{Matrix2, Vector2};

use super::coordinates::set_angles;
use super::placement::by_legs;
use super::{Coordinates, Geometry, Mechanism, SceneError};

/// Assembly mode: the side of the arrow from left elbow to right elbow on which the tip lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Assembly {
    /// To the left of the arrow.
    #[default]
    Plus,
    /// To the right of the arrow.
    Minus,
}

impl Assembly {
    fn sign(self) -> f64 {
        match self {
            Self::Plus => 1.0,
            Self::Minus => -1.0,
        }
    }
}

/// Initial state of a run: proximal links (left, right) and assembly mode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// Proximal angles, rad.
    pub theta: [f64; 2],
    /// Proximal rates, rad/s.
    pub omega: [f64; 2],
    /// Assembly mode of the closure.
    pub assembly: Assembly,
}

/// Relative tolerance for distal links that are in line or parallel: far above round-off, far below manufacturing tolerances.
pub(crate) const COLLINEARITY_TOLERANCE: f64 = 1e-9;

/// Round-off of the distance between the elbows, relative to the size of the mechanism: a few sums and products.
const DISTANCE_ROUND_OFF: f64 = 16.0 * f64::EPSILON;

/// Rank tolerance of the distal closure, relative to the lengths of the distal links: smaller singular values are round-off.
const RANK_TOLERANCE: f64 = 1e-12;

/// Smallest sine of the angle between the distal links at which the proximal angles are valid coordinates: rates keep half of their digits.
const LEAST_SINE: f64 = 1e-8;

/// A unit vector û(θ) and its derivative n̂(θ).
fn direction(theta: f64) -> (Vector2<f64>, Vector2<f64>) {
    let (sin, cos) = libm::sincos(theta);
    (Vector2::new(cos, sin), Vector2::new(-sin, cos))
}

/// Elbows of an initial posture, and whether the distal links are in line.
struct ElbowSpan {
    /// Vector from the left to the right elbow, m.
    arrow: Vector2<f64>,
    /// Distance between the elbows, m.
    distance: f64,
    /// Whether the distal links are in line (direct singularity), within [`COLLINEARITY_TOLERANCE`].
    in_line: bool,
    /// Whether the distal links are in line to round-off.
    collinear_exactly: bool,
}

impl ElbowSpan {
    /// Computes the elbows at the proximal angles `theta`, rad; error messages call them `name`. Refuses elbows that the distal links
    /// cannot join, and elbows that coincide.
    fn new(geometry: &Geometry, name: &str, theta: [f64; 2]) -> Result<Self, SceneError> {
        let [l1, l2, l3, l4] = geometry.lengths();
        let arrow = Vector2::new(geometry.base_distance, 0.0) + direction(theta[1]).0 * l4 - direction(theta[0]).0 * l1;
        let distance = libm::hypot(arrow.x, arrow.y);
        let (shortest, longest) = ((l2 - l3).abs(), l2 + l3);
        let start = || format!("{name} = ({:?}, {:?}) rad", theta[0], theta[1]);
        // Round-off of the elbow positions must not make a fully stretched start unreachable.
        let round_off = DISTANCE_ROUND_OFF * geometry.length_scale();
        if distance > longest + round_off || distance < shortest - round_off {
            return Err(SceneError(format!(
                "{} cannot be closed: the elbows are {:?} m apart, link[2].length and link[3].length allow {:?} to {:?} m.",
                start(),
                rounded(distance),
                rounded(shortest),
                rounded(longest)
            )));
        }
        if distance < COLLINEARITY_TOLERANCE * longest {
            return Err(SceneError(format!(
                "{} puts both elbows on the same point, {:?} m apart: the direction to the tip is undetermined, the elbows must be apart.",
                start(),
                rounded(distance)
            )));
        }
        let slack = (longest - distance).min(distance - shortest);
        Ok(Self { arrow, distance, in_line: slack < COLLINEARITY_TOLERANCE * longest, collinear_exactly: slack < round_off })
    }
}

/// Rounds to ten significant digits for an error message, and to 0 below 1e-22. The scale is a product of tens, which is exact: a power
/// function would add a table of 4 kB.
fn rounded(value: f64) -> f64 {
    let mut scale = 1.0;
    while value.abs() * scale < 1e9 && scale < 1e22 {
        scale *= 10.0;
    }
    (value * scale).round() / scale
}

/// Returns coordinates q and velocities q̇ of an initial state that satisfy all constraints.
///
/// Regular postures have exactly one solution. At a direct singularity (distal links in line) the velocity of the tip across the line is
/// undetermined and is set to 0. With all links on one line (a vertex of the configuration space) the distal rates solve the quadratic
/// equation of the tangent cone; of its roots, the root that moves the tip to the side of the assembly mode is used.
///
/// Refused: elbows that the distal links cannot join or that coincide, and rates at a direct singularity or at a vertex for which no distal
/// rates keep the loop closed.
pub fn close(geometry: &Geometry, start: &Start) -> Result<(Coordinates, Coordinates), SceneError> {
    let span = ElbowSpan::new(geometry, "init.theta", start.theta)?;
    let theta = angles(geometry, &span, start);
    let omega = rates(geometry, &span, theta, start)?;
    Ok(assemble(geometry, theta, omega))
}

/// Angles of the four links, rad, from the proximal angles.
fn angles(geometry: &Geometry, span: &ElbowSpan, start: &Start) -> [f64; 4] {
    let [_, l2, l3, _] = geometry.lengths();
    // Position of the tip `along` and `across` the line from left to right elbow, without cancellation when the tip is close to this line.
    let &ElbowSpan { arrow, distance, .. } = span;
    let along = ((l2 - l3) * (l2 + l3) + distance * distance) / (2.0 * distance);
    let across_squared = (l2 + l3 - distance) * (l3 + distance - l2) * (l2 + along) / (2.0 * distance);
    // If the distal links are in line, an error of ε in the distance would tilt them by √ε.
    let across = if span.collinear_exactly { 0.0 } else { start.assembly.sign() * across_squared.max(0.0).sqrt() };
    let unit = arrow / distance;
    let from_left = unit * along + Vector2::new(-unit.y, unit.x) * across;
    let from_right = from_left - arrow;
    [start.theta[0], libm::atan2(from_left.y, from_left.x), libm::atan2(from_right.y, from_right.x), start.theta[1]]
}

/// Angles, rad, and rates, rad/s, of links 1 to 4 from the proximal angles and rates. Refused: distal links that cannot meet, elbows that
/// coincide, and direct singularities, |det J_x| below 1e-8 of its largest possible value.
pub fn links_from_proximal(geometry: &Geometry, start: &Start) -> Result<[[f64; 4]; 2], SceneError> {
    let span = ElbowSpan::new(geometry, "theta", start.theta)?;
    let theta = angles(geometry, &span, start);
    let [(_, n1), (u2, _), (u3, _), (_, n4)] = theta.map(direction);
    check_direct_singularity(u2.perp(&u3))?;
    let [w1, w4] = start.omega;
    let [l1, _, _, l4] = geometry.lengths();
    let [w2, w3] = distal_rates(geometry, [u2, u3], n4 * (l4 * w4) - n1 * (l1 * w1));
    Ok([theta, [w1, w2, w3, w4]])
}

/// Refuses a direct singularity: a sine of the angle between the distal links below 1e-8.
pub fn check_direct_singularity(sine: f64) -> Result<(), SceneError> {
    if sine.abs() < LEAST_SINE {
        return Err(SceneError(format!(
            "|singular.detJx|/(link[2].length link[3].length) = {:e} is not allowed here: it must be at least {LEAST_SINE:e}, because \
             otherwise the distal links are in line and theta, omega are no coordinates.",
            sine.abs()
        )));
    }
    Ok(())
}

/// Rates of the distal links, rad/s, with directions û, from the velocity `parting` of the right elbow relative to the left one, m/s.
/// Products with û₃ and û₂ solve l₂ ω₂ n̂₂ − l₃ ω₃ n̂₃ = parting.
fn distal_rates(geometry: &Geometry, [u2, u3]: [Vector2<f64>; 2], parting: Vector2<f64>) -> [f64; 2] {
    let [_, l2, l3, _] = geometry.lengths();
    let sine = u2.perp(&u3);
    [parting.dot(&u3) / (l2 * sine), parting.dot(&u2) / (l3 * sine)]
}

/// Rates of the four links, rad/s, from the proximal rates.
fn rates(geometry: &Geometry, span: &ElbowSpan, theta: [f64; 4], start: &Start) -> Result<[f64; 4], SceneError> {
    let [w1, w4] = start.omega;
    let [(_, n1), (u2, n2), (u3, n3), (_, n4)] = theta.map(direction);
    let [l1, l2, l3, l4] = geometry.lengths();
    let (left_elbow, right_elbow) = (n1 * (l1 * w1), n4 * (l4 * w4));
    let parting = right_elbow - left_elbow;
    if !span.in_line {
        let [w2, w3] = distal_rates(geometry, [u2, u3], parting);
        return Ok([w1, w2, w3, w4]);
    }
    // All links are on one line: the x axis, or any line through the motors if they are coaxial.
    let line = span.arrow / span.distance;
    if span.collinear_exactly && [n1, n4].iter().all(|n| n.dot(&line).abs() <= COLLINEARITY_TOLERANCE) {
        return vertex_rates(geometry, line, theta, start);
    }
    let speed = (l1 * w1).abs() + (l4 * w4).abs();
    let opening = parting.dot(&line);
    if opening.abs() > COLLINEARITY_TOLERANCE * speed {
        return Err(SceneError(format!(
            "init.omega = ({w1:?}, {w4:?}) rad/s cannot be met: the distal links are in line (direct singularity) and the elbows would part at {:?} m/s, allowed is 0.",
            rounded(opening)
        )));
    }
    // The tip is at rest across the line. Links that are not exactly in line leave a residual, which a least-norm correction closes.
    let rates = Vector2::new(-left_elbow.dot(&n2) / l2, -right_elbow.dot(&n3) / l3);
    let closing = Matrix2::from_columns(&[n2 * l2, -n3 * l3]);
    let change = closing.svd(true, true).solve(&(parting - closing * rates), RANK_TOLERANCE * (l2 + l3)).unwrap_or_default();
    Ok([w1, rates.x + change.x, rates.y + change.y, w4])
}

/// Rates of the four links, rad/s, if all links are on one line: closure to second order, Σ s ω = 0 and Σ s ω² = 0 around the loop, with
/// the signed lengths s along the line.
fn vertex_rates(geometry: &Geometry, line: Vector2<f64>, theta: [f64; 4], start: &Start) -> Result<[f64; 4], SceneError> {
    let [w1, w4] = start.omega;
    let mut arm = [0.0; 4];
    for (i, arm) in arm.iter_mut().enumerate() {
        *arm = direction(theta[i]).0.dot(&line).signum() * geometry.links[i].length;
    }
    let [c1, c2, c3, c4] = arm;
    // The equations are c2 ω2 − c3 ω3 = first and c2 ω2² − c3 ω3² = second.
    let first = c4 * w4 - c1 * w1;
    let second = c4 * w4 * w4 - c1 * w1 * w1;
    let discriminant = c2 * c3 * (first * first + second * (c3 - c2));
    let scale = c2.abs().max(c3.abs()).powi(2) * (c1 * w1).abs().max((c4 * w4).abs()).powi(2);
    if discriminant < -COLLINEARITY_TOLERANCE * scale {
        return Err(SceneError(format!(
            "init.omega = ({w1:?}, {w4:?}) rad/s cannot be met: with all links on one line no rates of the distal links keep the loop closed to second order."
        )));
    }
    let root = discriminant.max(0.0).sqrt();
    let roots = [root, -root].map(|root| {
        let w3 = (root - first * c3) / (c3 * (c3 - c2));
        let w2 = (first + c3 * w3) / c2;
        (w2, w3)
    });
    // Velocity of the tip relative to the turning line through the elbows, times the signed distance from left to right elbow; positive on
    // the side of the assembly mode.
    let side = |(w2, _): (f64, f64)| start.assembly.sign() * c2 * ((c2 - c3) * w2 - first);
    let (w2, w3) = if side(roots[0]) >= side(roots[1]) { roots[0] } else { roots[1] };
    Ok([w1, w2, w3, w4])
}

/// Variations of q and q̇ for variations of the proximal angles and rates (left, right) with the loop closed, at link angles `theta`, rad,
/// and rates `omega`, rad/s. Undefined at a direct singularity, because the proximal angles are no coordinates there.
pub fn varied(
    geometry: &Geometry,
    theta: [f64; 4],
    omega: [f64; 4],
    [proximal_theta, proximal_omega]: [[f64; 2]; 2],
) -> (Coordinates, Coordinates) {
    let turned = closed_displacements(geometry, theta, proximal_theta, [0.0; 4]);
    // A rotation by δθ changes the velocity n̂ ω by −û ω δθ.
    let inward = std::array::from_fn(|i| -omega[i] * turned[i]);
    let quickened = closed_displacements(geometry, theta, proximal_omega, inward);
    let pose = Mechanism::new(geometry).pose_at(by_legs(theta));
    let q = pose.velocities(by_legs(turned));
    let carried = pose.varied(&q).velocities(by_legs(omega));
    let mut v = pose.velocities(by_legs(quickened)) + carried;
    set_angles(&mut v, by_legs(quickened));
    (q, v)
}

/// Displacements across the four links, divided by their lengths, that keep the loop closed, for given displacements of the proximal links
/// and given displacements along all links.
fn closed_displacements(geometry: &Geometry, theta: [f64; 4], [first, fourth]: [f64; 2], along: [f64; 4]) -> [f64; 4] {
    let [(u1, n1), (u2, _), (u3, _), (u4, n4)] = theta.map(direction);
    let [l1, l2, l3, l4] = geometry.lengths();
    let left = n1 * (l1 * first) + u1 * (l1 * along[0]) + u2 * (l2 * along[1]);
    let right = n4 * (l4 * fourth) + u4 * (l4 * along[3]) + u3 * (l3 * along[2]);
    let [second, third] = distal_rates(geometry, [u2, u3], right - left);
    [first, second, third, fourth]
}

/// Coordinates q and velocities q̇ from the angles, rad, and rates, rad/s, of links 1 to 4; each leg is built up from its motor axis.
pub fn assemble(geometry: &Geometry, theta: [f64; 4], omega: [f64; 4]) -> (Coordinates, Coordinates) {
    let (mechanism, angles) = (Mechanism::new(geometry), by_legs(theta));
    let pose = mechanism.pose_at(angles);
    (mechanism.coordinates(&pose, angles), pose.velocities(by_legs(omega)))
}
