//! DOP853, the explicit Runge–Kutta method of order 8 by Dormand and Prince: error estimates of order 5 and 3, and dense output of order 7
//! with three more stages.
//!
//! E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.5 and II.6. The digits are those
//! of the authors' code `dop853.f`, rounded to double precision. The test below checks the order conditions.

use super::{MAX_STAGES, Scheme, Stages, Tableau, Weights};
use crate::integrator::dense::trial::{Origin, StageDerivative};
use crate::integrator::{State, System, Work};

/// Coefficients of a sum over stages: (stage, coefficient) without zeros.
type Row = &'static [(usize, f64)];

/// Index of the end of the step: its row, and its derivative, which begins the next step and enters the dense output.
const END: usize = MAX_STAGES;
/// Number of stages including those of the dense output.
const ALL: usize = 16;

/// Fills a row with its zeros.
const fn full(row: Row) -> Weights {
    let mut weights = [0.0; MAX_STAGES];
    let mut i = 0;
    while i < row.len() {
        weights[row[i].0] = row[i].1;
        i += 1;
    }
    weights
}

/// The method of order 8, with twelve stages.
pub(in super::super) struct Dop853;

impl Tableau for Dop853 {
    const SCHEME: Scheme = Scheme::Dop853;
    const STAGES: usize = MAX_STAGES;
    const A: [Weights; MAX_STAGES] = {
        let mut stages = [[0.0; MAX_STAGES]; MAX_STAGES];
        let mut stage = 0;
        while stage < MAX_STAGES {
            stages[stage] = full(A[stage]);
            stage += 1;
        }
        stages
    };
    const END: Weights = full(A[END]);
    const FINE: Weights = full(ERROR_5);
    const COARSE: Weights = full(ERROR_3);
    const DAMPING: f64 = 0.01;
    const SECOND: Option<Weights> = Some(full(SECOND_ERROR));

    /// Coefficients of the dense output, with three more stages.
    fn dense<const N: usize, const M: usize, S: System<N, M>>(
        stages: &Stages<N>,
        system: &S,
        regularization: f64,
        [_, end]: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4] {
        let mut slopes = [StageDerivative::NONE; ALL];
        slopes[..END].copy_from_slice(&stages.slopes);
        slopes[END] = StageDerivative { q: end.v, v: end.a, power: end.power };
        let origin = Origin { q: stages.q, pose: &system.pose(&stages.q), regularization };
        for stage in END + 1..ALL {
            let increment = weighted_sum(stages.h, &slopes, A[stage]);
            slopes[stage].q = slopes[0].q + increment.v;
            slopes[stage].evaluate_acceleration(system, &origin, &increment.q);
        }
        DENSE.map(|row| weighted_sum(stages.h, &slopes, row))
    }
}

/// h times the weighted sum of slopes. A plain loop instead of unrolled code, because few steps need their interpolant.
fn weighted_sum<const N: usize>(h: f64, slopes: &[StageDerivative<N>; ALL], row: Row) -> StageDerivative<N> {
    let mut sum = StageDerivative::NONE;
    for &(stage, coefficient) in row {
        let StageDerivative { q, v, power } = &slopes[stage];
        sum.q += coefficient * *q;
        sum.v += coefficient * *v;
        sum.power = sum.power.plus(coefficient, *power);
    }
    StageDerivative { q: h * sum.q, v: h * sum.v, power: Work::default().plus(h, sum.power) }
}

/// Coefficients of the stages. Row [`END`] is the solution of order 8.
const A: [Row; ALL] = [
    &[],
    &[(0, 0.05260015195876773)],
    &[(0, 0.0197250569845379), (1, 0.0591751709536137)],
    &[(0, 0.02958758547680685), (2, 0.08876275643042054)],
    &[(0, 0.2413651341592667), (2, -0.8845494793282861), (3, 0.924834003261792)],
    &[(0, 0.037037037037037035), (3, 0.17082860872947386), (4, 0.12546768756682242)],
    &[(0, 0.037109375), (3, 0.17025221101954405), (4, 0.06021653898045596), (5, -0.017578125)],
    &[
        (0, 0.03709200011850479),
        (3, 0.17038392571223998),
        (4, 0.10726203044637328),
        (5, -0.015319437748624402),
        (6, 0.008273789163814023),
    ],
    &[
        (0, 0.6241109587160757),
        (3, -3.3608926294469414),
        (4, -0.868219346841726),
        (5, 27.59209969944671),
        (6, 20.154067550477894),
        (7, -43.48988418106996),
    ],
    &[
        (0, 0.47766253643826434),
        (3, -2.4881146199716677),
        (4, -0.590290826836843),
        (5, 21.230051448181193),
        (6, 15.279233632882423),
        (7, -33.28821096898486),
        (8, -0.020331201708508627),
    ],
    &[
        (0, -0.9371424300859873),
        (3, 5.186372428844064),
        (4, 1.0914373489967295),
        (5, -8.149787010746927),
        (6, -18.52006565999696),
        (7, 22.739487099350505),
        (8, 2.4936055526796523),
        (9, -3.0467644718982196),
    ],
    &[
        (0, 2.273310147516538),
        (3, -10.53449546673725),
        (4, -2.0008720582248625),
        (5, -17.9589318631188),
        (6, 27.94888452941996),
        (7, -2.8589982771350235),
        (8, -8.87285693353063),
        (9, 12.360567175794303),
        (10, 0.6433927460157636),
    ],
    &[
        (0, 0.054293734116568765),
        (5, 4.450312892752409),
        (6, 1.8915178993145003),
        (7, -5.801203960010585),
        (8, 0.3111643669578199),
        (9, -0.1521609496625161),
        (10, 0.20136540080403034),
        (11, 0.04471061572777259),
    ],
    &[
        (0, 0.056167502283047954),
        (6, 0.25350021021662483),
        (7, -0.2462390374708025),
        (8, -0.12419142326381637),
        (9, 0.15329179827876568),
        (10, 0.00820105229563469),
        (11, 0.007567897660545699),
        (12, -0.008298),
    ],
    &[
        (0, 0.03183464816350214),
        (5, 0.028300909672366776),
        (6, 0.053541988307438566),
        (7, -0.05492374857139099),
        (10, -0.00010834732869724932),
        (11, 0.0003825710908356584),
        (12, -0.00034046500868740456),
        (13, 0.1413124436746325),
    ],
    &[
        (0, -0.42889630158379194),
        (5, -4.697621415361164),
        (6, 7.683421196062599),
        (7, 4.06898981839711),
        (8, 0.3567271874552811),
        (12, -0.0013990241651590145),
        (13, 2.9475147891527724),
        (14, -9.15095847217987),
    ],
];

/// Error estimate of order 5: solution minus embedded solution.
const ERROR_5: Row = &[
    (0, 0.01312004499419488),
    (5, -1.2251564463762044),
    (6, -0.4957589496572502),
    (7, 1.6643771824549864),
    (8, -0.35032884874997366),
    (9, 0.3341791187130175),
    (10, 0.08192320648511571),
    (11, -0.022355307863886294),
];

/// Error estimate of order 3: solution minus embedded solution.
const ERROR_3: Row = &[
    (0, -0.18980075407240762),
    (5, 4.450312892752409),
    (6, 1.8915178993145003),
    (7, -5.801203960010585),
    (8, -0.4226823213237919),
    (9, -0.1521609496625161),
    (10, 0.20136540080403034),
    (11, 0.02265179219836082),
];

/// Second error estimate of order 5, for sharp nonlinearities. Sums over the stages that satisfy the conditions of order 5 form a space of
/// three dimensions. Among 7,800 steps under friction with known errors, this direction best detects steps that [`ERROR_5`] underestimates.
/// The row has twice the length of that direction: this length took the fewest steps for a given error.
const SECOND_ERROR: Row = &[
    (0, 0.03594421965334723),
    (5, -0.4741121613850806),
    (6, -1.1021348694695676),
    (7, 1.8973022951281686),
    (8, 2.619891933369597),
    (9, -2.655810808708063),
    (10, -0.40644998960190937),
    (11, 0.08536938101350793),
];

/// Higher coefficients of the dense output.
const DENSE: [Row; 4] = [
    &[
        (0, -8.428938276109013),
        (5, 0.5667149535193777),
        (6, -3.0689499459498917),
        (7, 2.38466765651207),
        (8, 2.117034582445028),
        (9, -0.871391583777973),
        (10, 2.2404374302607883),
        (11, 0.6315787787694688),
        (12, -0.08899033645133331),
        (13, 18.148505520854727),
        (14, -9.194632392478356),
        (15, -4.436036387594894),
    ],
    &[
        (0, 10.427508642579134),
        (5, 242.28349177525817),
        (6, 165.20045171727028),
        (7, -374.5467547226902),
        (8, -22.113666853125306),
        (9, 7.733432668472264),
        (10, -30.674084731089398),
        (11, -9.332130526430229),
        (12, 15.697238121770845),
        (13, -31.139403219565178),
        (14, -9.35292435884448),
        (15, 35.81684148639408),
    ],
    &[
        (0, 19.985053242002433),
        (5, -387.0373087493518),
        (6, -189.17813819516758),
        (7, 527.8081592054236),
        (8, -11.57390253995963),
        (9, 6.8812326946963),
        (10, -1.0006050966910838),
        (11, 0.7777137798053443),
        (12, -2.778205752353508),
        (13, -60.19669523126412),
        (14, 84.32040550667716),
        (15, 11.99229113618279),
    ],
    &[
        (0, -25.69393346270375),
        (5, -154.18974869023643),
        (6, -231.5293791760455),
        (7, 357.6391179106141),
        (8, 93.40532418362432),
        (9, -37.45832313645163),
        (10, 104.0996495089623),
        (11, 29.8402934266605),
        (12, -43.53345659001114),
        (13, 96.32455395918828),
        (14, -39.17726167561544),
        (15, -149.72683625798564),
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Moment Σ coefficient · node^power; the nodes are the sums of the rows.
    fn moment(row: Row, power: i32) -> f64 {
        let node = |stage: usize| A[stage].iter().map(|(_, a)| a).sum::<f64>();
        row.iter().map(|&(stage, coefficient)| coefficient * node(stage).powi(power)).sum()
    }

    /// Checks the quadrature conditions of each order and the stage order; measured orders cover the rest.
    #[test]
    fn order_conditions_hold() {
        // Coefficients of rows and nodes reach 43: round-off of 43² ε.
        let zero = |what: &str, value: f64| assert!(value.abs() < 1e-12, "{what}: {value:e}");
        for (stage, node) in
            [(5, 1.0 / 3.0), (6, 0.25), (7, 4.0 / 13.0), (9, 0.6), (11, 1.0), (END, 1.0), (14, 0.2), (15, 7.0 / 9.0)]
        {
            zero("node", moment(A[stage], 0) - node);
        }
        for row in &A[2..] {
            zero("second order of a stage", moment(row, 1) - moment(row, 0).powi(2) / 2.0);
        }
        for row in &A[3..] {
            zero("third order of a stage", moment(row, 2) - moment(row, 0).powi(3) / 3.0);
        }
        for power in 0..8 {
            zero("quadrature of order 8", moment(A[END], power) - 1.0 / f64::from(power + 1));
        }
        for power in 0..5 {
            zero("order 5", moment(ERROR_5, power));
            zero("order 5 at bends", moment(SECOND_ERROR, power));
        }
        for power in 0..3 {
            zero("order 3", moment(ERROR_3, power));
        }
        assert!(moment(ERROR_5, 6).abs() > 1e-4 && moment(ERROR_3, 3).abs() > 1e-4, "an estimate that sees nothing");
    }
}
