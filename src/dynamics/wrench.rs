//! Wrenches and slopes in coordinates: the single map from force laws to the formulations of the mechanism.
//!
//! T_j are the joint torques and F is the force on the tip. r is the arm from the centre of mass of link 2 to the tip, l₁ and l₂ are the
//! arms of links 1 and 2 from end to end, and n(·) rotates by +90°:
//!
//! ```text
//! links            (T₁ − T₂, T₂ + T₃, T₄ − T₃, T₅ − T₄)
//! 12 coordinates   F at the centre of mass of link 2, r × F on its angle     J = [1 0 n(r)],          J' = −ω₂ r in θ₂
//! 4 link angles    l₁ × F and l₂ × F on links 1 and 2                        J = [n(l₁) n(l₂)],       J' = [−ω₁ l₁, −ω₂ l₂]
//! finite step      rows by the arm s r_m, columns by the arm r₁              slope of the rows s n(r_m)/2 − Δθ/12 r_m
//! K = Σ_j k_j + Jᵀ (K_tip J + D_tip J') + arms turning under F,    C = Σ_j d_j + Jᵀ D_tip J
//! ```
//!
//! Here ṗ = J q̇ and ∂ṗ/∂q = J'. The joint slopes k_j and d_j are tridiagonal over the links.

use crate::effects::{JOINT_LINKS, Matrix, Planar, Slopes, Wrench, dot, times};
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::legs::Legs;
use crate::mechanism::placement::{ByLink, by_legs, by_links, tip_levers};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Pose};

/// Number of coordinates that slopes may couple.
pub const INNER_COUNT: usize = 6;

/// Coordinates that slopes may couple: the position of link 2, which carries the forces on the tip, and all link angles.
pub const INNER: [usize; INNER_COUNT] = [X[1], Y[1], THETA[0], THETA[1], THETA[2], THETA[3]];

/// Index of the angle of link 2 in [`INNER`].
const TIP_ANGLE: usize = 3;

/// Arms that relate the tip to the angle of link 2: for its motion and for forces on it.
#[derive(Clone, Copy, Debug)]
pub struct TipArm {
    /// Arm of forces on the tip, m: r at an instant, s r_m over a step.
    pub row: Planar,
    /// Arm of the motion of the tip, m: r at an instant, r₁ over a step.
    pub column: Planar,
    /// Derivative of `row` with respect to the angle of link 2, m/rad.
    slope: Planar,
    /// Derivative of the tip's velocity with respect to the angle of link 2, m/s.
    pub turning: Planar,
}

/// Rotates a vector in the plane by +90°.
fn turned([x, y]: Planar) -> Planar {
    [-y, x]
}

/// Cross product (its z component).
fn cross(a: Planar, b: Planar) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Arm from the centre of mass of link 2 to the tip, m. The left leg's sign in the tip's closure is +.
fn arm_of(pose: &Pose) -> Planar {
    [pose.sigma_b_d.x.to_array()[0], pose.sigma_b_d.y.to_array()[0]]
}

impl TipArm {
    /// Arms at an instant, for velocities v.
    pub fn of_pose(pose: &Pose, v: &Coordinates) -> Self {
        let arm = arm_of(pose);
        let rate = v[THETA[1]];
        Self { row: arm, column: arm, slope: turned(arm), turning: arm.map(|r| -rate * r) }
    }

    /// Arms over a step with increments d that ends with velocities v.
    pub fn of_step(secant: &Secant, d: &Coordinates, v: &Coordinates) -> Self {
        let (middle, end) = (arm_of(&secant.middle), arm_of(&secant.end));
        let (sinc, turn, rate) = (secant.sinc[1].to_array()[0], d[THETA[1]], v[THETA[1]]);
        Self {
            row: middle.map(|r| sinc * r),
            column: end,
            // The direction half-way rotates by half of dθ; s = sin(θ/2)/(θ/2) has the slope −θ/12.
            slope: [-0.5 * sinc * middle[1] - turn / 12.0 * middle[0], 0.5 * sinc * middle[0] - turn / 12.0 * middle[1]],
            turning: end.map(|r| -rate * r),
        }
    }

    /// Stiffness of the angle of link 2, N·m/rad, due to a force on the tip, N, whose arm rotates.
    fn geometric(&self, force: Planar) -> f64 {
        -cross(self.slope, force)
    }
}

impl Wrench {
    /// Adds the generalised force in the 12 coordinates, N and N·m. `arm` is the arm of forces on the tip, m.
    pub fn add_to(&self, arm: Planar, forces: &mut Coordinates) {
        for (i, torque) in THETA.into_iter().zip(self.on_links()) {
            forces[i] += torque;
        }
        forces[X[1]] += self.force[0];
        forces[Y[1]] += self.force[1];
        forces[THETA[1]] += cross(arm, self.force);
    }

    /// Generalised force in the 12 coordinates, N and N·m.
    pub fn in_coordinates(&self, pose: &Pose) -> Coordinates {
        let mut forces = Coordinates::ZERO;
        self.add_to(arm_of(pose), &mut forces);
        forces
    }

    /// Torques on the links, N·m: the wrench in the 4 link angles.
    pub fn torques_in_angles(&self, pose: &Pose) -> ByLink {
        let ([p, d], [left, tip, ..]) = (tip_levers(pose), self.on_links());
        let [.., right, base] = self.on_links();
        by_legs([left + cross(p, self.force), tip + cross(d, self.force), right, base])
    }
}

impl Wrench {
    /// Derivative of the wrench's power at constant link rates, W/s: F·Ṫω of the tip, at velocities of the 12 coordinates. The angle of
    /// link 2 carries the tip around the centre of mass.
    pub fn drift_in_coordinates(&self, pose: &Pose, v: &Coordinates) -> f64 {
        let rate = v[THETA[1]];
        -rate * rate * dot(self.force, arm_of(pose))
    }

    /// Derivative of the wrench's power at constant link rates, rad/s, in W/s.
    pub fn drift_in_angles(&self, pose: &Pose, rates: ByLink) -> f64 {
        let ([p, d], [one, two, ..]) = (tip_levers(pose), by_links(rates));
        -one * one * dot(self.force, p) - two * two * dot(self.force, d)
    }
}

/// Arms of the left leg's links in the cut loop of a finite step, m; proximal link first.
#[derive(Clone, Copy, Debug)]
pub struct StepLevers {
    /// Derivatives of the tip's position with respect to the link angles, for the action of forces.
    pub rows: [Planar; 2],
    /// Derivatives of the tip's position at the step's end with respect to the link angles.
    pub columns: [Planar; 2],
    /// Derivatives of the tip's velocity at the step's end with respect to the link angles, m/s.
    pub turning: [Planar; 2],
}

impl Slopes {
    /// Weighted slopes k K + c C of the joints over links 1 to 4, for weights [k, c].
    fn over_links(&self, [k, c]: [f64; 2]) -> [[f64; 4]; 4] {
        let mut matrix = [[0.0; 4]; 4];
        for ((first, second), [stiffness, damping]) in JOINT_LINKS.into_iter().zip(self.joints) {
            let value = k * stiffness + c * damping;
            matrix[first][first] += value;
            if let Some(second) = second {
                matrix[second][second] += value;
                matrix[first][second] -= value;
                matrix[second][first] -= value;
            }
        }
        matrix
    }

    /// Weighted slopes W = k K + c D of the force on the tip.
    fn of_tip(&self, [k, c]: [f64; 2]) -> Matrix {
        let [stiffness, damping] = self.tip;
        [0, 1].map(|i| [0, 1].map(|j| k * stiffness[i][j] + c * damping[i][j]))
    }

    /// Weighted decrease W a + k D b of the force on the tip, for an angle that moves the tip by a, m/rad, and changes its velocity by b,
    /// m/s.
    fn by_angle(&self, weights: [f64; 2], moving: Planar, turning: Planar) -> Planar {
        let (along, dragged) = (times(self.of_tip(weights), moving), times(self.tip[1], turning));
        [0, 1].map(|i| along[i] + weights[0] * dragged[i])
    }

    /// Weighted slopes k K + c C in the coordinates [`INNER`], for weights [k, c].
    pub fn inner(&self, arm: &TipArm, weights: [f64; 2]) -> [[f64; INNER_COUNT]; INNER_COUNT] {
        let mut matrix = [[0.0; INNER_COUNT]; INNER_COUNT];
        for (to, from) in matrix[2..].iter_mut().zip(self.over_links(weights)) {
            to[2..].copy_from_slice(&from);
        }
        let (across, tip) = (turned(arm.row), self.of_tip(weights));
        let by_angle = self.by_angle(weights, turned(arm.column), arm.turning);
        for row in 0..2 {
            for column in 0..2 {
                matrix[row][column] = tip[row][column];
                matrix[TIP_ANGLE][column] += across[row] * tip[row][column];
            }
            matrix[row][TIP_ANGLE] = by_angle[row];
        }
        matrix[TIP_ANGLE][TIP_ANGLE] += dot(across, by_angle) + weights[0] * arm.geometric(self.force);
        matrix
    }

    /// Weighted slopes k K + c C of the link angles, if no slope couples links ([`Slopes::couple_links`]).
    pub fn diagonal(&self, arm: &TipArm, [k, c]: [f64; 2]) -> ByLink {
        let weighted = |joint: usize| k * self.joints[joint][0] + c * self.joints[joint][1];
        [Legs::new([weighted(0), weighted(4)]), Legs::new([k * arm.geometric(self.force), 0.0])]
    }

    /// Stiffness K, N·m/rad, and damping C, N·m·s/rad, of links 1 to 4 in the link angles at link rates, rad/s.
    pub fn torques_in_angles(&self, pose: &Pose, rates: [f64; 4]) -> [[[f64; 4]; 4]; 2] {
        let levers = tip_levers(pose);
        [[1.0, 0.0], [0.0, 1.0]].map(|weights| {
            let mut matrix = self.over_links(weights);
            for (column, lever) in levers.into_iter().enumerate() {
                let by_angle = self.by_angle(weights, turned(lever), lever.map(|l| -rates[column] * l));
                for (row, lever) in levers.into_iter().enumerate() {
                    matrix[row][column] += dot(turned(lever), by_angle);
                }
                matrix[column][column] += weights[0] * dot(lever, self.force);
            }
            matrix
        })
    }

    /// Weighted slope k K + c C with which the joint at the tip couples the distal links.
    pub fn between_legs(&self, weights: [f64; 2]) -> f64 {
        self.over_links(weights)[1][2]
    }

    /// Weighted slopes k K + c C of each leg over its links, proximal link first, in the cut loop of a finite step. They do not include
    /// slopes that couple the legs (see [`Slopes::between_legs`]), or the effect of rows that turn with the forces on the positions.
    pub fn on_legs(&self, arm: &TipArm, levers: &StepLevers, weights: [f64; 2]) -> [[Legs; 2]; 2] {
        let links = self.over_links(weights);
        let mut matrix =
            [[[links[0][0], links[3][3]], [links[0][1], links[3][2]]], [[links[1][0], links[2][3]], [links[1][1], links[2][2]]]];
        for (column, turning) in levers.turning.into_iter().enumerate() {
            let by_angle = self.by_angle(weights, levers.columns[column], turning);
            for (row, lever) in matrix.iter_mut().zip(levers.rows) {
                row[column][0] += dot(lever, by_angle);
            }
        }
        matrix[1][1][0] += weights[0] * arm.geometric(self.force);
        matrix.map(|row| row.map(Legs::new))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::Conditions;
    use crate::dynamics::angles::{angles_of, legs};
    use crate::effects::{FiniteMotion, Inputs, JOINTS, Mode, Motion, TypicalInertia, across_joints};
    use crate::mechanism::Mechanism;
    use crate::mechanism::coordinates::link_angles;
    use crate::simulation::bindings::default_parameters;

    const INPUTS: Inputs = Inputs { tau: [0.0; 2], tip_force: [0.0; 2], servo_theta: [0.0; 2], servo_omega: [0.0; 2] };

    /// A number between −1 and 1, without order.
    fn number(seed: usize) -> f64 {
        (12.9898 * seed as f64 + 0.7).sin()
    }

    fn coordinates(seed: usize) -> Coordinates {
        Coordinates::from_fn(|i| number(seed + i))
    }

    fn links(seed: usize) -> [f64; 4] {
        std::array::from_fn(|i| number(seed + i))
    }

    /// A machine with no two equal parameters.
    fn mechanism() -> Mechanism {
        let mut geometry = default_parameters().geometry;
        for (i, link) in geometry.links.iter_mut().enumerate() {
            (link.length, link.com) = (0.9 + 0.3 * i as f64, 0.4 - 0.1 * i as f64);
        }
        Mechanism::new(&geometry)
    }

    fn conditions() -> Conditions<'static> {
        Conditions { inputs: &INPUTS, turns: &[1, 0, 0, -2], mode: Mode::OF_STATE }
    }

    /// A law that is linear in joint angles and rates and in the tip's position and velocity, without symmetry.
    struct Linear {
        wrench: Wrench,
        slopes: Slopes,
    }

    impl Linear {
        fn new(seed: usize) -> Self {
            let mut next = seed;
            let mut number = || {
                next += 1;
                number(next)
            };
            let wrench = Wrench { torques: std::array::from_fn(|_| number()), force: [number(), number()] };
            let mut matrix = || [[number(), number()], [number(), number()]];
            let tip = [matrix(), matrix()];
            let joints = std::array::from_fn(|_| [number(), number()]);
            Self { wrench, slopes: Slopes { joints, tip, force: [0.0; 2] } }
        }

        fn act(&self, angles: [f64; JOINTS], rates: [f64; JOINTS], position: Planar, velocity: Planar) -> Wrench {
            let change = self.slopes.change(&crate::effects::MotionChange { angles, rates, position, velocity });
            self.wrench.plus(1.0, &change)
        }

        fn at(&self, angles: [f64; 4], Motion { joints, position, velocity }: &Motion) -> Wrench {
            self.act(across_joints(angles), joints.rates, *position, *velocity)
        }

        fn slopes(&self, Wrench { force, .. }: Wrench) -> Slopes {
            Slopes { force, ..self.slopes }
        }
    }

    /// Central differences of a function of N numbers, by columns.
    fn differences<const N: usize, const M: usize>(x: [f64; N], of: impl Fn([f64; N]) -> [f64; M]) -> [[f64; M]; N] {
        const STEP: f64 = 1e-5;
        std::array::from_fn(|column| {
            let [more, less] = [STEP, -STEP].map(|step| {
                let mut moved = x;
                moved[column] += step;
                of(moved)
            });
            std::array::from_fn(|row| (more[row] - less[row]) / (2.0 * STEP))
        })
    }

    /// Truncation: third derivatives of about 10, times 1e-10/6. Round-off: numbers of about 10, times 1e-16/1e-5.
    const BOUND: f64 = 2e-9;

    #[test]
    fn a_wrench_and_its_generalised_forces_have_equal_power() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let wrench = Linear::new(seed).wrench;
            let (q, v) = (coordinates(seed), coordinates(seed + 50));
            let pose = mechanism.pose(&q);
            let at = conditions().motion([&q, &v], &pose);
            let power = wrench.power(&at.joints.rates, at.velocity);
            assert!((wrench.in_coordinates(&pose).dot(&v) - power).abs() < 1e-14, "{power} W in coordinates");

            let (angles, rates) = (by_legs(links(seed)), by_legs(links(seed + 50)));
            let pose = mechanism.pose_at(angles);
            let at = conditions().motion_of_links(&mechanism, [angles, rates], &pose);
            let power = wrench.power(&at.joints.rates, at.velocity);
            let torques = by_links(wrench.torques_in_angles(&pose));
            let by_angles: f64 = torques.iter().zip(links(seed + 50)).map(|(torque, rate)| torque * rate).sum();
            assert!((by_angles - power).abs() < 1e-14, "{power} W in angles, {by_angles}");

            // The 12 coordinates at these angles give the same motion and the same torques.
            let (q, v) = (mechanism.coordinates(&pose, angles), pose.velocities(rates));
            let same = conditions().motion([&q, &v], &pose);
            let apart = |a: Planar, b: Planar| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
            assert!(apart(at.position, same.position) < 1e-14 && apart(at.velocity, same.velocity) < 1e-14, "{at:?} {same:?}");
            assert_eq!((at.joints.rates, at.joints.angles), (same.joints.rates, same.joints.angles));
            let carried = by_links(pose.torques_of(&wrench.in_coordinates(&pose)));
            assert!(carried.iter().zip(torques).all(|(a, b)| (a - b).abs() < 1e-14), "{carried:?} {torques:?}");

            let unit = Wrench::of_tip(wrench.force);
            let a = unit.in_coordinates(&pose).dot(&pose.centripetal(rates)) + unit.drift_in_coordinates(&pose, &v);
            assert!((a - unit.drift_in_angles(&pose, rates)).abs() < 1e-14, "drift of the tip: {a}");
        }
    }

    #[test]
    fn a_mean_wrench_and_its_generalised_forces_do_equal_work() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let (wrench, [q, d, v]) = (Linear::new(seed).wrench, [0, 30, 60].map(|more| coordinates(seed + more)));
            let secant = mechanism.secant(&mechanism.pose(&q), legs(&angles_of(&d)));
            let over = finite(&mechanism, [&q, &d, &v]);
            let mut forces = Coordinates::ZERO;
            wrench.add_to(TipArm::of_step(&secant, &d, &v).row, &mut forces);
            let work = wrench.power(&over.changes, over.change);
            assert!((forces.dot(&d) - work).abs() < 1e-14, "{work} J");
            let end = q + d;
            let [begin, end] = [&q, &end].map(|q| conditions().motion([q, &v], &mechanism.pose(q)).position);
            for i in 0..2 {
                assert!((over.begin[i] - begin[i]).abs() < 1e-14 && (over.begin[i] + over.change[i] - end[i]).abs() < 1e-14);
            }
        }
    }

    fn finite(mechanism: &Mechanism, [q, d, v]: [&Coordinates; 3]) -> FiniteMotion<'static> {
        let inertia = TypicalInertia { joint: 1.0, tip: 1.0 };
        conditions().finite_motion([q, d, v], &mechanism.secant(&mechanism.pose(q), legs(&angles_of(d))), 1e-3, 1.0, inertia)
    }

    /// Entry of the slopes in all coordinates: 0 outside [`INNER`].
    fn entry(inner: &[[f64; INNER_COUNT]; INNER_COUNT], row: usize, column: usize) -> f64 {
        let place = |i: usize| INNER.iter().position(|inner| *inner == i);
        place(row).zip(place(column)).map_or(0.0, |(row, column)| inner[row][column])
    }

    #[test]
    fn slopes_in_the_coordinates_are_derivatives() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let (law, q, v) = (Linear::new(seed), coordinates(seed), coordinates(seed + 50));
            let wrench = |q: &Coordinates, v: &Coordinates| {
                let at = conditions().motion([q, v], &mechanism.pose(q));
                law.at(link_angles(q), &at)
            };
            let forces = |q: Coordinates, v: Coordinates| wrench(&q, &v).in_coordinates(&mechanism.pose(&q)).into();
            let arm = TipArm::of_pose(&mechanism.pose(&q), &v);
            let slopes = law.slopes(wrench(&q, &v));
            let by_q = differences(q.into(), |q| -> [f64; 12] { forces(q.into(), v) });
            let by_v = differences(v.into(), |v| forces(q, v.into()));
            check_inner(&slopes, &arm, &by_q, &by_v);
        }
    }

    fn check_inner(slopes: &Slopes, arm: &TipArm, by_q: &[[f64; 12]; 12], by_v: &[[f64; 12]; 12]) {
        for (weights, by) in [([1.0, 0.0], by_q), ([0.0, 1.0], by_v)] {
            let inner = slopes.inner(arm, weights);
            for (column, by) in by.iter().enumerate() {
                for (row, by) in by.iter().enumerate() {
                    let got = entry(&inner, row, column);
                    assert!((got + by).abs() < BOUND, "{weights:?} {row} {column}: {got} {}", -by);
                }
            }
        }
    }

    #[test]
    fn slopes_over_a_step_are_derivatives() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let (law, q, v) = (Linear::new(seed), coordinates(seed), coordinates(seed + 50));
            // Turns of up to 0.01 rad: the slope of sinc is a first-order approximation.
            let d = 1e-2 * coordinates(seed + 30);
            let begin = mechanism.pose(&q);
            let wrench = |d: &Coordinates, v: &Coordinates| {
                let over = finite(&mechanism, [&q, d, v]);
                law.act(over.changes, over.rates, over.change, over.velocity)
            };
            let forces = |d: Coordinates, v: Coordinates| {
                let mut forces = Coordinates::ZERO;
                wrench(&d, &v).add_to(TipArm::of_step(&mechanism.secant(&begin, legs(&angles_of(&d))), &d, &v).row, &mut forces);
                forces.into()
            };
            let arm = TipArm::of_step(&mechanism.secant(&begin, legs(&angles_of(&d))), &d, &v);
            let slopes = law.slopes(wrench(&d, &v));
            let by_d = differences(d.into(), |d| -> [f64; 12] { forces(d.into(), v) });
            let by_v = differences(v.into(), |v| forces(d, v.into()));
            check_inner(&slopes, &arm, &by_d, &by_v);
        }
    }

    #[test]
    fn slopes_in_the_angles_are_derivatives() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let (law, theta, omega) = (Linear::new(seed), links(seed), links(seed + 50));
            let wrench = |theta: [f64; 4], omega: [f64; 4]| {
                let (angles, rates) = (by_legs(theta), by_legs(omega));
                let pose = mechanism.pose_at(angles);
                (law.at(theta, &conditions().motion_of_links(&mechanism, [angles, rates], &pose)), pose)
            };
            let torques = |theta, omega| {
                let (wrench, pose) = wrench(theta, omega);
                by_links(wrench.torques_in_angles(&pose))
            };
            let (at, pose) = wrench(theta, omega);
            let tangents = law.slopes(at).torques_in_angles(&pose, omega);
            let numeric = [differences(theta, |theta| torques(theta, omega)), differences(omega, |omega| torques(theta, omega))];
            for (tangent, numeric) in tangents.iter().zip(&numeric) {
                for (row, values) in tangent.iter().enumerate() {
                    for (column, got) in values.iter().enumerate() {
                        let want = -numeric[column][row];
                        assert!((got - want).abs() < BOUND, "{row} {column}: {got} {want}");
                    }
                }
            }
        }
    }

    /// The legs of the cut loop carry the coordinates of link 2: rows and columns of the same slopes, leg by leg.
    #[test]
    fn slopes_on_legs_agree_with_slopes_in_coordinates() {
        let mechanism = mechanism();
        for seed in 0..20 {
            let (law, [q, d, v]) = (Linear::new(seed), [0, 30, 60].map(|more| coordinates(seed + more)));
            let arm = TipArm::of_step(&mechanism.secant(&mechanism.pose(&q), legs(&angles_of(&d))), &d, &v);
            let (slopes, weights) = (law.slopes(law.wrench), [number(seed), number(seed + 1)]);
            // For each link of the leg, proximal and distal: displacement of the position of link 2 per unit turn of that link; arbitrary here.
            let carried = |seed: usize| [[number(seed), number(seed + 1)], [number(seed + 2), number(seed + 3)]];
            let (rows, columns) = (carried(seed), carried(seed + 9));
            let with_arm = |[p, d]: [Planar; 2], arm: Planar| [p, [0, 1].map(|i| d[i] + turned(arm)[i])];
            let turning = [[0.0; 2], arm.turning];
            let levers = StepLevers { rows: with_arm(rows, arm.row), columns: with_arm(columns, arm.column), turning };
            let (got, inner) = (slopes.on_legs(&arm, &levers, weights), slopes.inner(&arm, weights));
            let motion = |[x, y]: Planar, link: usize| {
                let mut motion = [0.0; INNER_COUNT];
                (motion[0], motion[1], motion[2 + link]) = (x, y, 1.0);
                motion
            };
            for row in 0..2 {
                for column in 0..2 {
                    let (left, right) = (motion(rows[row], row), motion(columns[column], column));
                    let want: f64 =
                        (0..INNER_COUNT).map(|i| (0..INNER_COUNT).map(|j| left[i] * inner[i][j] * right[j]).sum::<f64>()).sum();
                    let [got_left, got_right] = got[row][column].to_array();
                    assert!((got_left - want).abs() < 1e-14, "{row} {column}: {got_left} {want}");
                    let links = [5, 4];
                    assert_eq!(got_right, inner[links[row]][links[column]]);
                }
            }
        }
    }

    #[test]
    fn slopes_of_the_motors_couple_no_links() {
        let mut slopes = Slopes { force: [1.0, 2.0], ..Slopes::default() };
        (slopes.joints[0], slopes.joints[4]) = ([1.0, 2.0], [3.0, 4.0]);
        assert!(!slopes.couple_links());
        let (mechanism, q, v) = (mechanism(), coordinates(1), coordinates(2));
        let arm = TipArm::of_pose(&mechanism.pose(&q), &v);
        let (diagonal, inner) = (by_links(slopes.diagonal(&arm, [0.3, 0.7])), slopes.inner(&arm, [0.3, 0.7]));
        for (i, row) in inner.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert_eq!(*value, if i == j && i > 1 { diagonal[i - 2] } else { 0.0 });
            }
        }
        for (joint, kind) in [(1, 0), (2, 1), (3, 1)] {
            let mut coupled = slopes;
            coupled.joints[joint][kind] = 1e-300;
            assert!(coupled.couple_links());
        }
        slopes.tip[1][0][1] = -1e-300;
        assert!(slopes.couple_links());
    }
}
