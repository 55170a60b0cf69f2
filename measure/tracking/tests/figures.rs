//! A sample of the figures, with other seeds; `cargo xtask estimator` measures them in full.

use fivebar::estimator::Status;
use fivebar::simulation::Following;
use tracking::machine::{COARSE, FINE, Random, follow};
use tracking::quality::{fall, outcome, pick, push};
use tracking::{benchmark, causes, detection, faults, geometry, singular};

/// Checks that the estimate can be stored and read back.
fn soundness(twin: &Following) -> Result<(), &'static str> {
    twin.estimator().check(twin.believed(), &twin.motion())
}

/// Three runs of the published benchmark stay within 1.10 times the best row of its table.
#[test]
fn the_benchmark_is_met() {
    let table = benchmark::table(3, 0);
    assert!(table.figures.iter().all(tracking::report::Figure::is_reached), "{}", table.markdown());
}

/// Most of 32 faults are named. Of 400 faults 93 % are named at 16 bits and 83 % at 0.1°. With these shares fewer than 26 and 21 of 32 have
/// a probability of 0.5 %.
#[test]
fn causes_are_named() {
    let named = causes::named(4, 0);
    assert!(named[0] >= 26 && named[1] >= 21, "{named:?} of 32");
}

/// A unit that learns lengths distinguishes a push from its remaining errors within 12 ms at 16 bits (median). If models are compared as if
/// persistent innovations were white noise, each of the falls raises a false alarm. If the filter of the motion assumes the same noise of
/// samples as learning, pushes take 29 ms.
#[test]
fn learning_hides_no_push_and_raises_no_alarm() {
    assert_eq!(geometry::false_alarms_while_learning([0, 1, 2].map(|seed| 7_800_000 + seed)), 0);
    let mut delays = detection::delays_while_learning([0, 1, 2].map(|seed| 7_700_000 + seed));
    delays.sort_by(f64::total_cmp);
    // One sampling interval is added for round-off of times.
    assert!(delays[1] <= 0.013, "{delays:?} s");
}

/// Late samples show an earlier instant, which moved under its own inputs; a right start is not abandoned. The right starts of these four
/// seeds are abandoned if rates of the samples are compared with the current estimate.
#[test]
fn late_samples_leave_a_right_start() {
    assert_eq!(faults::lost_by_late_samples([43, 58, 94, 110].map(|seed| 1_327_900_000 + seed)), 0);
}

/// A right start of a slow swing by stiff servos is not abandoned. The first five are abandoned if the filters that test the start have all
/// of the quietest model's process noise. Two of the others are abandoned if an axis that turns by nearly one quantisation interval per
/// sample counts as passing an edge with each sample.
#[test]
fn stiff_swings_leave_a_right_start() {
    let [plus, minus] = [[7, 8, 24, 50, 93], [0, 1, 2, 3, 4]].map(|of| of.map(|seed| 1_457_900_000 + seed));
    assert_eq!(faults::lost_in_stiff_swings(plus, minus), [0, 0]);
}

/// A good encoder with jittering time stamps is not reported stuck. The encoders of these five seeds are reported if a rate comes from
/// changes of readings at exact times.
#[test]
fn jitter_makes_no_encoder_stuck() {
    assert_eq!(faults::stuck_by_jitter([4, 5, 7, 13, 35].map(|seed| 1_467_900_000 + seed)), 0);
}

/// An encoder that freezes in a fall as its axis turns back is reported. For these three seeds it is not reported if the rate before the
/// first repeated reading replaces the rate at that reading.
#[test]
fn encoders_that_freeze_as_an_axis_turns_back_are_reported() {
    assert_eq!(faults::silent_in_falls([11, 38, 149].map(|seed| 1_467_900_000 + seed)), 0);
}

/// One encoder alone keeps the tip within its band. The tips of these seeds end outside if the readings are weighted as if the model had no
/// errors.
#[test]
fn one_encoder_keeps_the_tip_in_its_band() {
    assert_eq!(faults::beyond_by_one_encoder([3, 5].map(|seed| 1_497_900_000 + seed)), 0);
}

/// Encoders that freeze at once are reported if the machine turns too fast for a real stop.
#[test]
fn encoders_that_freeze_at_once_are_reported() {
    assert_eq!(faults::silent_where_both_freeze((0..3).map(|seed| 1_497_900_000 + seed)), 0);
}

/// A jump of a reading is reported although single samples are lost. The jump is not reported if one lost sample counts as silence.
#[test]
fn lost_samples_hide_no_jump() {
    assert_eq!(faults::silent_with_lost_samples((0..4).map(|seed| 1_477_900_000 + seed)), 0);
}

/// Machines with masses 5 % off, an unknown payload or pushes are not lost.
#[test]
fn machines_are_not_lost() {
    for (encoder, most) in [(COARSE, 6e-4), (FINE, 1e-4)] {
        for scene in [pick, |random: &mut Random| fall(random, true), push] {
            for seed in 0..3 {
                let mut random = Random::new(100 + seed);
                let outcome = outcome(&scene(&mut random), &encoder, 1e-3, &mut random);
                assert!(!outcome.lost && outcome.rms < most, "{} seed {seed}: {outcome:?}", encoder.name);
            }
        }
    }
}

/// Transversal crossings of direct singularities are followed.
#[test]
fn direct_singularities_are_crossed() {
    for seed in 0..6 {
        for encoder in [COARSE, FINE] {
            let mut random = Random::new(200 + seed);
            let scenario = singular::crossing(&mut random, [0.5, 4.0]);
            assert!(!outcome(&scenario, &encoder, 1e-3, &mut random).lost, "{} seed {seed}", encoder.name);
        }
    }
}

/// Slow crossings that only graze the line of the distal links, and cross it again: the estimate leaves the line on the wrong side, and
/// finds the right one from the later motion.
#[test]
fn grazed_singularities_are_found_out() {
    // The last one crosses the line, returns and crosses again while both assemblies are followed.
    for (seed, encoder) in [(20_000_260, COARSE), (20_010_076, FINE), (759_300_583, COARSE)] {
        let mut random = Random::new(seed);
        let scenario = singular::crossing(&mut random, [0.02, 0.2]);
        let (mut both, mut wrong) = (false, false);
        let mut look = random.clone();
        follow(&scenario, &encoder, 1e-3, &mut look, |at| {
            both |= at.twin.status() == Status::TwoBranches;
            wrong |= at.tip_error > 0.01;
            assert_eq!(soundness(at.twin), Ok(()), "seed {seed} at {} s", at.time);
        })
        .expect("a run");
        assert!(both && wrong, "seed {seed}: no branch was in doubt");
        assert!(!outcome(&scenario, &encoder, 1e-3, &mut random).lost, "seed {seed}");
    }
    // Regression cases of an estimate on the wrong side.
    for (seed, encoder) in [(20_000_319, COARSE), (20_000_318, FINE)] {
        let mut random = Random::new(seed);
        let scenario = singular::crossing(&mut random, [0.02, 0.2]);
        assert!(!outcome(&scenario, &encoder, 1e-3, &mut random).lost, "seed {seed}");
    }
}

/// The estimate takes the machine's branch in exact and near passes of vertices; on the way it can be stored and read back.
#[test]
fn vertices_are_passed() {
    for (seed, aside) in [(0, 0.0), (1, 0.0), (2, 1e-4), (3, 1e-4), (4, 1e-3), (5, 5e-3)] {
        let mut random = Random::new(300 + seed);
        let scenario = singular::vertex(&mut random, aside);
        assert!(!outcome(&scenario, &FINE, 1e-3, &mut random.clone()).lost, "seed {seed}");
        let mut branches = false;
        follow(&scenario, &FINE, 1e-3, &mut random, |at| {
            assert_eq!(soundness(at.twin), Ok(()), "seed {seed} at {} s", at.time);
            branches |= at.twin.status() == Status::TwoBranches;
        })
        .expect("a run");
        assert!(branches || aside > 1e-3, "seed {seed}");
    }
}

/// Behind a vertex, samples that arrive 2 ms late still select the machine's branch. The machines of all these seeds are lost if the old
/// angle is compared with the branches' current angles.
#[test]
fn delayed_samples_choose_the_branch_behind_a_vertex() {
    for seed in [3, 43, 58, 61, 72, 81, 91] {
        let mut random = Random::new(300 + seed);
        let mut scenario = singular::vertex(&mut random, [0.0, 1e-4, 1e-3][seed as usize % 3]);
        (scenario.plan.delay, scenario.model.estimator.max_delay) = (2e-3, 5e-3);
        assert!(!outcome(&scenario, &FINE, 1e-3, &mut random).lost, "seed {seed}");
    }
}

/// After 1.5 s of a fall without samples, through singularities, the estimate finds the machine again: it restarts, is sound at every
/// step, and is right within 1 s. (Without a restart 9 of 10 are lost.)
#[test]
fn lost_machines_are_found_again() {
    let mut begun = 0;
    for seed in 0..4 {
        for encoder in [COARSE, FINE] {
            let mut random = Random::new(400 + seed);
            let scenario = singular::silenced(&mut random);
            assert!(!outcome(&scenario, &encoder, 1e-3, &mut random.clone()).lost, "{} seed {seed}", encoder.name);
            follow(&scenario, &encoder, 1e-3, &mut random, |at| {
                let estimator = at.twin.estimator();
                assert_eq!(soundness(at.twin), Ok(()), "seed {seed} at {} s", at.time);
                if estimator.has_restarted() {
                    assert_eq!(at.twin.status(), Status::Inconsistent);
                    assert!(at.time > 2.0, "seed {seed}: it was not lost at {} s", at.time);
                    begun += 1;
                }
            })
            .expect("a run");
        }
    }
    assert!(begun >= 4, "only {begun} were lost");
}
