//! Tuned constants of the estimator, each with the run or the reason behind it. `docs/notes/estimator.md` describes the runs and defines
//! their words (loud model, silent, beyond its band, edge); `cargo xtask estimator` repeats the runs.

// ---- Models of the bank: notes, "Priors of the models".

/// Number of models.
pub(super) const MODELS: usize = 4;
/// Intensities of the process noise of each model.
#[derive(Debug)]
pub(super) struct Intensities {
    /// Variance rate of the unknown force, 1/s, relative to the squared torque scale. Steps by factors of 100 to 1000 cover a constant
    /// disturbance as well as an impact.
    pub(super) force_walk: [f64; MODELS],
    /// Variance rate of the unknown force due to mass errors, 1/s, relative to the squared inertia torques.
    pub(super) mass_walk: [f64; MODELS],
    /// Spectral density of a white torque on every link, s, relative to the squared torque scale.
    pub(super) white_torque: [f64; MODELS],
}
/// Intensities if masses and friction count as known. If the first force walk is ten times larger, it increases the tip error in free falls
/// by a tenth to a fifth at 16 bits. Only quiet models have a mass walk: in the others the force walk dominates. The mass walk was chosen
/// by the NEES of pushes, falls and sines with masses 5 % off, the white torque by the NEES of falls with exact masses and with masses 5 %
/// off.
pub(super) const TAKEN_AS_KNOWN: Intensities = Intensities {
    force_walk: [4e-5, 0.04, 4.0, 4000.0],
    mass_walk: [2e-4, 0.03, 0.0, 0.0],
    white_torque: [4e-7, 4e-6, 4e-5, 4e-3],
};
/// Intensities if masses and friction are learned. The quiet models assume nearly no force, because a random-walk force would explain the
/// effect of the masses. Chosen by the NEES of the masses in the table `learning` (`--part 0.2 --seeds 7730000000`), which is 0.52 to 0.73.
/// With ten times the intensities of the quiet models and a tenth of the persistence below it is 0.37 to 0.51 (`--part 0.1 --seeds
/// 7710000000`).
pub(super) const LEARNT: Intensities =
    Intensities { force_walk: [4e-10, 4e-8, 4.0, 4000.0], mass_walk: [0.0; MODELS], white_torque: [1e-11, 4e-10, 4e-5, 4e-3] };
/// Factor on the duration of a model if masses and friction are learned, because the variance that a loud model adds after a switch is no
/// information about masses. First value: forces that change smoothly; second: forces that may change within a step. With 10, mass errors
/// are three to four times larger, and a push is found no later. With 300, dry friction 30 % off leaves the masses of falls 1 % off at
/// 16 bits, eight standard deviations; with 10, 0.02 % (table `learning`).
pub(super) const LEARNING_PERSISTENCES: [f64; 2] = [300.0, 10.0];
/// Prior probabilities of the models before any sample, without samples, and next to a direct singularity. There, a push assumed too
/// readily pulls the estimate back from the line of the distal links. Without these priors the ellipses half a second ahead of
/// `pick_and_place` were 72 mm wide for errors of 0.1 mm. A model with probability 0 is not used.
pub(super) const LIKELY_MODELS: [f64; MODELS] = [0.45, 0.45, 0.095, 0.005];
/// Prior probabilities under white encoder noise, when a large innovation may be noise. The torque error of the benchmark at 1° is 1.3 to
/// 1.5 N·m with a probability of 0.2 for the loudest model, 0.81 to 0.93 with 0.005, and 0.80 to 0.82 with 1e-4.
pub(super) const BY_NOISE: [f64; MODELS] = [0.45, 0.45, 0.0999, 0.0001];
/// Prior probabilities with quantised encoders: only a force moves an angle out of its interval, and without warning. The NEES of pushes
/// was 10.2, 7.0, 6.0 and 5.4 with a probability of 0.005, 0.1, 0.2 and 0.3 for the model with the most process noise.
pub(super) const BY_INTERVALS: [f64; MODELS] = [0.3, 0.3, 0.1, 0.3];
/// Distance |sin(θ₃ − θ₂)| from a direct singularity below which motors hardly determine the posture. There, quantised encoders use the
/// priors [`LIKELY_MODELS`], starts are not tracked in both assemblies, and corrections do not fix the motor angles. Chosen by slow
/// crossings: if starts are tracked in both assemblies from 0.1 on, 2 of 800 are lost, with 0.3 none.
pub(super) const NEAR_SINGULARITY: f64 = 0.3;
/// Smallest likelihood ratio of a model in one sample: it lets a model recover after an outlier.
pub(super) const LEAST_LIKELIHOOD: f64 = 1e-12;
/// Probability below which a model is left out of the moments of the mixture: it would not change their digits.
pub(super) const NEGLIGIBLE_PROBABILITY: f64 = 1e-12;
/// Largest variance of angles in each model, rad²; beyond it nothing is known. Loud models reach the variance of an angle anywhere in a
/// turn: after a push in a fall with learning, 81 % of the tips are then within the bands, with 0.3 rad² 29 %. The limit of quiet models is
/// lower, because their variances outgrow their errors in a fall: with the variance of a turn the CRPS of bands 0.5 s ahead is 45 mm in
/// place of 14 mm.
pub(super) const LARGEST_ANGLE_VARIANCES: [f64; MODELS] = [0.3, 0.3, ANYWHERE, ANYWHERE];
/// Variance of an angle that is evenly distributed over a turn, rad².
pub(super) const ANYWHERE: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;
/// Largest variance of rates, rad²/s².
pub(super) const LARGEST_RATE_VARIANCE: f64 = 1e4;
/// Largest number of instants at which a forecast looks for a singularity: the longest horizon, 10 s, every millisecond. This takes 0.3 s.
pub(super) const MOST_CHECKS: f64 = 1e4;
/// Largest number of Runge–Kutta steps of a point in the forecast of singularities, relative to a machine at rest: bounds the work.
pub(super) const MOST_STEPS_OF_POINT: f64 = 1.5;
/// Standard deviation of the unknown force at the start, in torque scales.
pub(super) const UNKNOWN_FORCE: f64 = 0.3;
/// Regularisation of the squared input effects: next to a singularity no input has to produce a force that it cannot exert.
pub(super) const EFFECT_REGULARIZATION: f64 = 1e-6;
/// Largest normalised innovation squared that is reported: keeps it finite.
pub(super) const LARGEST_NIS: f64 = 1e12;
/// Largest logarithms of learned factors: of a mass (factor 2) and of dry friction (factor 10). Beyond these factors the machine is not the
/// described one.
pub(super) const LARGEST_FACTORS: [f64; 2] = [std::f64::consts::LN_2, std::f64::consts::LN_10];
/// Largest learned error of a length or a mounting angle, in standard deviations of its prior. Without this limit, if inexact encoders
/// count as exact, lengths of MuJoCo's machine, known to 0.2 mm, drift by 10 mm in 20 minutes (`cargo xtask mujoco`).
pub(super) const LARGEST_MISFIT: f64 = 4.0;
/// Largest learned error of a length, relative to it: the learned machine can still be simulated.
pub(super) const LARGEST_STRAIN: f64 = 0.05;
/// Time without a move to a bound after which values count as back within their bounds, s. If an encoder is mounted ten standard deviations
/// off, values return to their bounds 32 times in 0.8 s, each time after up to 0.3 s and from more than a tenth away (the machine of
/// `a_value_at_its_bound_is_reported_once`, mounted 20 mrad off).
pub(super) const BOUNDS_LEFT_AFTER: f64 = 1.0;

// ---- Propagation.

/// Smallest number of Runge–Kutta steps per second, 1/s: without and with stiff loads.
pub(super) const LEAST_STEP_RATES: [f64; 2] = [600.0, 2500.0];
/// Runge–Kutta steps per time constant of a damper: stability needs 0.36. A spring gets one step per reciprocal of its natural frequency.
pub(super) const STEPS_PER_DAMPER_TIME: f64 = 0.8;
/// Runge–Kutta steps per radian of the fastest link in a regular posture.
pub(super) const STEPS_PER_RADIAN: f64 = 8.0;
/// Smallest singular value of J over the mean length that shortens Runge–Kutta steps further.
pub(super) const VERTEX_STEP_FLOOR: f64 = 0.01;
/// Largest number of Runge–Kutta steps in a macro step of the estimate: bounds the work.
pub(super) const MOST_STEPS: f64 = 64.0;
/// Largest number of Runge–Kutta steps in a macro step of a hypothesis, which starts next to a vertex: bounds the work.
pub(super) const MOST_FINE_STEPS: f64 = 256.0;
/// Largest turn of a link per Runge–Kutta step of a hypothesis, relative to the smallest singular value of J over the mean length.
pub(super) const LARGEST_TURN: f64 = 0.125;
/// Floor of the smallest singular value in a division, dimensionless.
pub(super) const LEAST_SINGULAR_VALUE: f64 = 1e-6;
/// Smallest singular value of J over the mean length below which propagated and simulated motion are compared.
pub(super) const COMPARED_BELOW: f64 = 0.2;
/// Largest differences of angles, rad, and rates, rad/s, for which propagated and simulated motion agree.
pub(super) const AGREEMENT: [f64; 2] = [1e-3, 0.1];
/// Largest rate of a credible estimate, rad/s.
pub(super) const LARGEST_RATE: f64 = 2e3;
/// Rate at which an estimate restarts, anywhere and at rest, rad/s. Some estimates reach 4e3 rad/s by a force that later samples remove,
/// and find the machine without a restart. With wild samples some reach 2e4 rad/s; then transitions overflow and the run fails
/// (`wild_samples_leave_a_band`).
pub(super) const HOPELESS_RATE: f64 = 1e4;
/// Largest element of a transition: keeps covariances from overflowing.
pub(super) const LARGEST_GROWTH: f64 = 1e100;

// ---- Closed loop.

/// Smallest singular value of J over the mean length below which the branches of a vertex are indistinguishable.
pub(super) const NEAR_VERTEX: f64 = 0.03;
/// Largest error, rad, by which motors are turned exactly; an estimate that is further off is lost. If a lost estimate still tracked the
/// readings, the machine would be found after 0.22 s in place of 0.2 s (`a_lost_machine_is_found_again`). With 0.5 rad, wrong starts seem
/// to turn at 25 rad/s (`a_start_that_is_off_is_no_motion`).
pub(super) const LARGEST_CHARTED_ERROR: f64 = 1.0;
/// Miss of a motor angle too small for another Newton step, rad: the step of an encoder of 22 bits.
pub(super) const LEAST_MISS: f64 = 1e-6;
/// Largest number of Newton steps onto the closure.
pub(super) const NEWTON_STEPS: usize = 8;
/// Tolerance of Newton's iteration relative to the mean length: round-off of four arms.
pub(super) const NEWTON_TOLERANCE: f64 = 1e-13;
/// Regularisation of det JJᵀ relative to the mean length: no division by 0 in a vertex.
pub(super) const RANK_LOSS: f64 = 1e-20;
/// Largest closure error of a stored state relative to the mean length: anywhere, and next to a vertex, which motions cross in a straight line.
pub(super) const CLOSURE_TOLERANCES: [f64; 2] = [1e-4, 1e-2];
/// Regularisation of the squared effect of the tangent basis on the motor angles. Along directions that hardly turn the motors,
/// uncertain lengths move the tip only by J⁺.
pub(super) const MOTOR_REGULARIZATION: f64 = 0.01;
/// Smallest |det| of the effect of the motors on the tangent basis at which unknown forces are reported as motor torques. Closer to a
/// direct singularity these torques grow without bound.
pub(super) const LEAST_TORQUE_DETERMINANT: f64 = 0.15;
/// Smallest |det| of the effect of the motors on the tangent basis at which errors of a mirrored assembly follow from the motor errors.
pub(super) const LEAST_MOTOR_DETERMINANT: f64 = 1e-3;

// ---- Encoders: notes, "Quantised samples".

/// Smallest size of an invalid angle, rad: its fraction of a turn is only round-off.
pub(super) const LARGEST_ANGLE: f64 = 1e9;
/// Round-off of the master's times, relative to them or to 1 s, whichever is larger.
pub(super) const TIME_ROUND_OFF: f64 = 1e-9;
/// Gate: a sample is rejected once if its normalised innovation squared is larger. A reading has jumped if, in the loudest model, the
/// normalised square of the change of its innovation is larger. The smallest value of 60 jumps of 0.1 rad by 0.1° at 5 ms is 48 with the
/// unit's start values, 229 with exact geometry. The largest value of a rejected sample in 1,440 runs without a failure is 7 (table
/// `faults`, `--part 3 --seeds 7920000000`, and 7930000000).
pub(super) const GATE: f64 = 30.0;
/// Gate of the loudest model: normalised innovation squared above which no assumed force explains a sample. With the noise of a single
/// sample, 5 of 400 jumps of 0.1 rad by 0.1° stay silent; with the noise of samples that share a quantisation error, 12 (table `faults`,
/// `--part 10 --seeds 1020000000`).
pub(super) const GATE_OF_LOUDEST_MODEL: f64 = 400.0;
/// Largest number of samples rejected in a row before the encoder is trusted again.
pub(super) const MOST_REJECTED_IN_A_ROW: u32 = 10;
/// Time for which samples of both encoders must have been used before one may count as jumped, s: a new estimate, or one that has been
/// without samples, is itself off. With 0 s 382 of 400 falls after 1.5 s without encoders are lost, with 0.1 s as many as without the rule.
pub(super) const SETTLING_TIME: f64 = 0.1;
/// Silence after which an encoder whose reading jumped counts as new, s: long enough to survive samples lost on the way.
pub(super) const NEW_AFTER_SILENCE: f64 = 1.0;
/// Stuck encoder: smallest distance of its reading from the value that the estimate without it expects, in quantisation intervals, in
/// standard deviations of the noise, and in standard deviations of the expected angle.
pub(super) const OVERDUE: [f64; 3] = [2.0, 4.0, 4.0];
/// Stuck encoder: torque, in torque scales, by which friction or an unknown drive may hold an axis. With 0 a recorded
/// pantograph is lost when a drive holds one axis for 3.6 s (`docs/recordings.md`). Of 660 encoders that freeze, three fewer are reported
/// within 0.2 s with 0.05 than with 0, and nine fewer with 0.1 (table `faults`, `--part 1 --seeds 8402000000`).
pub(super) const LARGEST_HOLD: f64 = 0.05;
/// Stuck encoder: time for which a push may keep an axis inside a quantisation interval by chance, s. With 0.05 s one of 600 pushes at
/// 10 bits and six of 600 runs of `haptic` at 0.1° look like a stuck encoder, with 0.1 s none (table `faults`,
/// `--part 30 --seeds 940000000`).
pub(super) const LONGEST_CHANCE: f64 = 0.1;
/// Stuck encoder: turn of the axis, in quantisation intervals, that a push may cancel by chance. Of 400 encoders that freeze in a fall, at
/// 16 bits with the unit's start values, 11 are silent without this limit and none with 20. At 0.1° with exact geometry two of 200 are with
/// 40. Of 60 pushes at 0.1° with the start values eight are missed with 10, four with 20 (tables `faults`, `--part 10 --seeds` 1280000000
/// and 1300000000, and `detection`, `--seeds 8020000000`).
pub(super) const LARGEST_CHANCE: f64 = 20.0;
/// Smallest persistent error of an encoder that is used alone, rad: its readings keep model errors that both encoders together would
/// reveal. Of 700 falls with the other encoder silent or frozen, 8 are beyond their bands with 1e-3, 5 with 1.5e-3 and 3 with 2e-3; 84,
/// 106 and 130 are off at their ends (table `faults`, `--part 5 --seeds 1520000000`).
pub(super) const ERROR_ALONE: f64 = 2e-3;
/// Time in which [`ERROR_ALONE`] also counts once as noise, s, because model errors are not constant. With the persistent error alone, 11
/// of 40 falls by 0.1° with a frozen encoder are beyond their bands in place of 1 (`--part 2 --seeds 1510000000`).
pub(super) const TIME_ALONE: f64 = 0.1;
/// Standard deviation of an angle beyond which one encoder alone cannot track the machine, rad: the reading is no longer linear in the
/// errors. With 0.2 rad 46 of 200 falls with one encoder are given up or lost, with 0.4 rad as many as without a limit. Without a limit 18
/// of 200 falls by 0.1° with a frozen encoder are beyond their bands in place of 6 (`--part 10 --seeds 1490000000`).
pub(super) const LARGEST_SIGMA_ALONE: f64 = 0.4;
/// Number of samples over which the variance of the time stamps is averaged.
pub(super) const SAMPLES_OF_JITTER: f64 = 50.0;
/// Largest correlation time of the quantisation error, s: an axis at rest repeats its error, but not forever.
pub(super) const CORRELATION_TIME: f64 = 0.3;
/// Correlation time of a persistent reading error, s. While lengths and mounting angles are learned, the error counts once in this time.
/// Errors of constant lengths and mounting angles last longer, errors of eccentric discs less in fast motion. Of 160 slow crossings with
/// geometry off 33 are lost with 0.05 s, 29 with 0.1 s, 17 with 0.3 s and 7 with 1 s; 5, 2, 4 and 8 of the lost ones are silent (table
/// `geometry`, `--part 0.2 --seeds 8210000000`, rows *slow crossings, configured*).
pub(super) const PERSISTENT_TIME: f64 = 0.3;
/// Share of the product of relative mass errors and reading errors due to lengths and mounting angles, rad, that counts as an error of a
/// sample while lengths and mounting angles are learned: a wrong torque moves an axis this far before the torque is corrected. In nine rows
/// of the table `workshop` at 16 bits with discs configured as exact, at least 76 % of the samples are inside with 0, and 95 % with 0.03.
/// With 0.1, sines leave errors of 0.27 mm in place of 0.17 mm in lengths that are 0.1 % off.
pub(super) const PRODUCTS: f64 = 0.03;
/// Ratio of white noise to the quantisation interval above which the quantisation error is white (dither).
pub(super) const DITHER: f64 = 0.4;
/// Largest change of a reading, in quantisation intervals, that counts as passing a single edge between intervals.
pub(super) const SINGLE_EDGE: f64 = 1.5;
/// Standard deviation of the angle at an edge passage, in quantisation intervals: with 0.3, 7 of 2,400 slow crossings were lost.
pub(super) const EDGE_SIGMA: f64 = 0.5;
/// Silence, in sampling intervals since the last sample, after which an encoder counts as silent.
pub(super) const SILENT_AFTER_INTERVALS: f64 = 1.5;
/// Sampling interval assumed before two samples are known, s.
pub(super) const UNKNOWN_INTERVAL: f64 = 0.1;
/// Smallest variance of the white noise that replaces an interval, in Δ²/12, for an axis that crosses one interval per sample. For a slower
/// axis it is multiplied by the number of samples that share an error. With 0.04 the NEES of sines was 1.5.
pub(super) const LEAST_VARIANCE: f64 = 0.003;
/// Smallest standard deviation of a sample, rad, so that no variance is 0.
pub(super) const LEAST_SIGMA: f64 = 1e-9;
/// Standard deviation of the estimate, in quantisation intervals, above which an interval counts as plain white noise of Δ²/12.
pub(super) const WIDEST_SIGMA: f64 = 2.0;
/// Innovation, in quantisation intervals, above which a reading counts as plain white noise: no model expects its cause.
pub(super) const LARGEST_INNOVATION: f64 = 1.5;
/// Largest variance of the replacing noise, in Δ²/12: an estimate well inside an interval learns almost nothing.
pub(super) const LARGEST_VARIANCE: f64 = 1e4;
/// Factor on the noise variance of an interval. Successive intervals limit an error more than variances show: with bounded noise it
/// decreases with the number of samples, not its square root. Chosen by NEES and tip error of free falls.
pub(super) const SUCCESSIVE_INTERVALS_FACTOR: f64 = 0.56;
/// Distance of an interval, in standard deviations, beyond which its probability underflows; its near edge then replaces it.
pub(super) const FARTHEST_INTERVAL: f64 = 35.0;
/// Floors of an interval's probability and of its relative variance: smaller values are round-off.
pub(super) const INTERVAL_FLOORS: [f64; 2] = [1e-300, 1e-3];

// ---- Delayed samples.

/// Smallest |det| of a map between tangent bases by which rows of the history can be transformed.
pub(super) const LEAST_TURN: f64 = 1e-6;
/// Largest derivative of a past angle with respect to the present angles, and with respect to the present rates in units of the age: twice
/// that of a free motion.
pub(super) const LARGEST_ROW: f64 = 2.0;
/// Largest element of the inverse of a transition by which rows of the history can be propagated.
pub(super) const LARGEST_INVERSE: f64 = 1e12;

// ---- Hypotheses: notes, "Hypotheses".

/// How long hypotheses are compared, and which evidence decides.
#[derive(Debug)]
pub(super) struct QuestionRules {
    /// Longest time, s; samples have decided by then.
    pub(super) lifetime: f64,
    /// Log-likelihood ratio at which an alternative is dropped.
    pub(super) refuted: f64,
    /// Log-likelihood ratio at which an alternative replaces the estimate.
    pub(super) decided: f64,
}

/// Which branch follows a vertex; chosen by the passes of vertices in the table `singular`.
pub(super) const AFTER_VERTEX: QuestionRules = QuestionRules { lifetime: 0.5, refuted: -12.0, decided: 6.0 };
/// Which of two assemblies.
pub(super) const WHICH_ASSEMBLY: QuestionRules = QuestionRules { lifetime: 5.0, refuted: -30.0, decided: 6.0 };
/// Torque scale of the unknown force in quiet alternatives, relative to the scale of the estimate. Under a real disturbance the loudest
/// model takes over in both assemblies, so the disturbance does not decide. Of 150 slow crossings with a push of up to 0.05 N at 0.1° 45
/// were lost with only the quietest model, 6 with the quietest and the loudest, 17 with all four models and a scale of 0.003.
pub(super) const QUIET_FORCE_SCALE: f64 = 0.006;
/// Prior probabilities of the models under nearly no unknown force: only the quietest and the loudest.
pub(super) const QUIET_MODELS: [f64; MODELS] = [0.999, 0.0, 0.0, 0.001];
/// Initial standard deviation, in torque scales, of the unknown force in nearly force-free hypotheses. With 0.006 the force pulled back a
/// motion that had crossed the line of the distal links.
pub(super) const INITIAL_FORCE_SIGMA: f64 = 0.001;
/// Variance of the unknown force that is added when the other assembly replaces the estimate, in squared torque scales.
pub(super) const REPLACEMENT_FORCE_VARIANCE: f64 = 0.04;
/// Model of the bank with the noise for the filters that test a start (`doubt.rs`): the quietest.
pub(super) const DOUBT_MODEL: usize = 0;
/// Standard deviation of the noise of the filters that test a start, relative to the quietest model's. With 1 the evidence drifts towards
/// the assembly whose motors it moves more: 34 of 600 right starts in stiff swings are abandoned in silence (`--only faults --part 30
/// --seeds 1450000000`, row `nothing, stiff swing, 16 bit`), with 0.1 none.
pub(super) const DOUBT_NOISE: f64 = 0.1;
/// Standard deviation of the unknown force while both assemblies of a start are tracked, in torque scales: static loads are no evidence.
pub(super) const DOUBT_FORCE: f64 = 2.0;
/// Evidence for and against the assembly of the start that decides the question. With 12 for the start 1 of 1,200 wrong starts was kept,
/// with 16 none of 2,100 (table `starts`). With 16 against the start 7 of 800 right starts, with late samples and in stiff swings, were
/// replaced in silence; with 24 one was (table `faults`, `--part 10 --seeds` 1240000000 and 1250000000, with the model's own noise in place
/// of [`DOUBT_NOISE`]).
pub(super) const DOUBT_ENDS: [f64; 2] = [16.0, 24.0];
/// Log-odds of the other assembly before any sample, if the motion reaches a direct singularity before the start's assembly is decided.
/// With equal odds 7 of 2,400 crossings were undecided at their end, with this value none.
pub(super) const START_ODDS: f64 = -5.0;
/// Mean of r²/S in the better assembly above which neither assembly explains the samples, and the number of samples that this decision
/// needs. A wrong start presses the tip of `haptic` into its wall.
pub(super) const NEITHER_FITS: [f64; 2] = [3.0, 20.0];
/// Log-likelihood ratio of the first samples after a vertex at which an alternative replaces the estimate at once.
pub(super) const IMMEDIATE_EVIDENCE: f64 = 15.0;
/// Angle of the fastest link before the vertex at which turning hypotheses start, rad.
pub(super) const START_DISTANCE: f64 = 0.05;
/// Lateral offset at which turning hypotheses start, rad: their direction hardly depends on it.
pub(super) const LATERAL_OFFSET: f64 = 5e-3;
/// Runge–Kutta steps of a turning hypothesis, backward and forward.
pub(super) const TURNING_STEPS: u32 = 128;
/// Change of a rate in a step, relative to the fastest rate, that reveals a turn of the motion in a vertex.
pub(super) const LEAST_RATE_CHANGE: f64 = 0.3;
/// Rate below which a machine next to a vertex counts as at rest, rad/s.
pub(super) const REST_RATE: f64 = 0.05;
/// Smallest |det| of the map between tangent spaces at which a hypothesis uses the transition matrix of the estimate.
pub(super) const LEAST_BASIS_OVERLAP: f64 = 0.9999;
/// Distance |sin(θ₃ − θ₂)| from a direct singularity at which its passage ends: there, hypotheses in both assemblies are distinguishable.
pub(super) const DISTINGUISHABLE: f64 = 0.1;
/// Rate of sin(θ₃ − θ₂), 1/s, above which a passage is certain: no machine can still turn back.
pub(super) const SLOW_PASSAGE: f64 = 1.0;
/// Smallest log-likelihood of the other side at which hypotheses open: next to the line the estimate errs by more than its covariance.
pub(super) const LEAST_ODDS_TO_OPEN: f64 = -300.0;
/// Smallest log-likelihood assigned to the other side when hypotheses open.
pub(super) const LEAST_INITIAL_ODDS: f64 = -10.0;
/// Largest prior log-likelihood of the mirrored assembly if a quiet motion has crossed the line itself.
pub(super) const LARGEST_ODDS_AFTER_CROSSING: f64 = -4.0;
/// Log-likelihood of the other side far from direct singularities.
pub(super) const NEGLIGIBLE_ODDS: f64 = -1e3;
/// Innovation above which the machine counts as lost, rad.
pub(super) const DIVERGED_INNOVATION: f64 = 0.1;
/// Accumulated time of diverged samples after which the estimate restarts, s.
pub(super) const DIVERGENCE_TIME: f64 = 0.1;
/// Largest duration that a single sample represents, s.
pub(super) const LONGEST_SAMPLE_TIME: f64 = 0.02;

// ---- Forecasts and alarm: notes, "Alarm".

/// Variance rate of the unknown force due to mass errors in a forecast, 1/s, relative to the squared inertia torques. Samples have revealed
/// only mass errors that had an effect so far. Chosen by the coverage of falls with masses 5 % off.
pub(super) const FORECAST_MASS_WALK: f64 = 0.2;
/// Variance rate of the unknown force in a forecast, 1/s, relative to its square: the acting forces change as the machine moves. Chosen by
/// the coverage of the forecasts of every scene.
pub(super) const CARRIED_WALK: f64 = 1.0;
/// Sudden alarm: change of the unknown force, in torque scales, and the probability of the loud models above which it counts.
pub(super) const SUDDEN_CHANGE: (f64, f64) = (0.25, 0.999);
/// Sudden alarm at lower probability: probability of the loud models, and change in standard deviations.
pub(super) const PROBABLE_CHANGE: (f64, f64) = (0.9, 2.5);
/// Lasting alarm: change of the unknown force, in torque scales, and in standard deviations.
pub(super) const LASTING_CHANGE: (f64, f64) = (0.5, 6.0);
/// Time constant with which the largest inertia torques of the last steps decay, s. With 0.1 s 79 % of the faults at 0.1° are named in place of
/// 82 %; with 0.03 s as many as without inertia torques.
pub(super) const VIOLENCE_PERSISTS: f64 = 0.03;
/// Alarm in violent motion: log-evidence of another cause over wrong masses that an alarm needs. With 5, twice as many falls raise a false
/// alarm.
pub(super) const BEYOND_MASSES: f64 = 8.0;
/// Time constant of the reference force, s: slower drift raises no alarm.
pub(super) const REFERENCE_TIME_CONSTANT: f64 = 0.3;
/// Duration of an alarm, s.
pub(super) const ALARM_DURATION: f64 = 0.1;
/// Largest normalised innovation squared of a sample in the average: limits the influence of an outlier.
pub(super) const LARGEST_NIS_IN_MEAN: f64 = 30.0;
/// Consistency test: averaging length in samples.
pub(super) const CONSISTENCY_LENGTH: f64 = 100.0;
/// Consistency test: largest mean normalised innovation squared; the expected value is 1.
pub(super) const LARGEST_CONSISTENT_NIS: f64 = 4.0;

// ---- Causes: notes, "Causes"; runs: `cargo xtask estimator --only causes`.

/// Model of the bank with the noise for the filter that assumes no fault. With a tenth of this model's walks more motor torques are named
/// at 0.1°, and fewer in falls.
pub(super) const CAUSE_MODEL: usize = 1;
/// Normalised innovation squared of a sample from which on explanations are compared: three standard deviations.
pub(super) const SURPRISE: f64 = 9.0;
/// Time in which further surprises count as the same fault, s: longer than an alarm takes at 16 bits.
pub(super) const SAME_SURPRISE: f64 = 0.02;
/// Time after which a surprise without an alarm is forgotten, s: longer than an alarm takes at 0.1°.
pub(super) const DOUBT_TIME: f64 = 0.1;
/// Time for which samples are evaluated, s: postures then differ enough to distinguish a force at the tip from torques.
pub(super) const EVIDENCE_TIME: f64 = 0.5;
/// Time for which a cause is still reported after all is well again, s: as long as a human needs to look.
pub(super) const CAUSE_PERSISTS: f64 = 1.0;
/// Smallest mean of r²/S under the best explanation, by which evidence is divided: neighbouring samples share model errors.
pub(super) const LEAST_SCATTER: f64 = 2.0;
/// Probability of no explanation.
pub(super) const UNEXPLAINED: f64 = 0.05;
/// Standard deviations of the sizes of faults before any sample.
#[derive(Debug)]
pub(super) struct Sizes {
    /// Torques, in torque scales; forces and weights have the same effect at the mean length.
    pub(super) torque: f64,
    /// Jump of an encoder's reading, rad.
    pub(super) jump: f64,
    /// Delay of the samples, s.
    pub(super) delay: f64,
    /// Logarithm of a mass.
    pub(super) mass: f64,
    /// Rate at which viscous friction is as large as a torque, rad/s.
    pub(super) rate: f64,
    /// Logarithm of the factor of dry friction.
    pub(super) friction: f64,
}
/// Sizes of faults, of the order that raises an alarm. With 0.1 for masses the same number of causes is named.
pub(super) const SIZES: Sizes = Sizes { torque: 1.0, jump: 0.1, delay: 5e-3, mass: 0.05, rate: 10.0, friction: 1.0 };
