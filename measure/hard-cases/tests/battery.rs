//! A sample of the battery, one test per item of its list; `cargo xtask hard-cases` runs it in full.

use std::process::Command;
use std::sync::Mutex;

use hard_cases::books::{self, Books, Sample};
use hard_cases::cases::{bits_row, fingerprint, followed, followed_count, hour};
use hard_cases::{Case, Ending, Extent, Row, Setting, Verdict, checks, coaxial, speed};

/// Whether tests run in their long form, `cargo xtask test --nightly`.
fn is_nightly() -> bool {
    std::env::var_os("FIVEBAR_NIGHTLY").is_some()
}

/// The judged settings meet the requirements of every case of an item.
fn hold(item: u8) {
    let cases = Case::of_item(Extent::Quick, item);
    assert!(!cases.is_empty());
    let mut wrong = Vec::new();
    for case in &cases {
        for setting in case.settings.iter().filter(|setting| case.is_judged(**setting)) {
            let row = case.measure(*setting);
            wrong.extend(complaint(&row));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A sample of `hard-cases checks`: scenes of every kind by every method with checked steps, at tolerances from 1e-11 to 1e-3 rad.
#[test]
fn no_check_stops_a_right_step() {
    let mut table = Vec::new();
    let rows = checks::measure(0, 400);
    checks::write_markdown(&rows, &mut table).expect("a table");
    assert!(rows.iter().all(|row| row.is_met() && row.complete() > 50), "{}", String::from_utf8_lossy(&table));
}

fn complaint(row: &Row) -> Option<String> {
    (row.verdict != Verdict::Pass).then(|| format!("{row}\n    {}", row.objections.join("\n    ")))
}

#[test]
fn perturbed_free_falls_keep_energy_and_constraints() {
    hold(1);
}

/// Energies of 200 falls of 50 s meet their target; `cargo xtask bench` only shows the times.
#[test]
fn falls_of_50_s_keep_energy_by_the_explicit_method() {
    let falls = speed::falls(Extent::Full, 50e-3);
    assert_eq!((falls.trials.len(), falls.demand(Setting::EXPLICIT).energy), (200, 1e-7));
    assert!(falls.trials.iter().all(|fall| fall.schedule.len() == 1 && fall.schedule[0].count == 1000 && fall.duration() == 50.0));
    assert_eq!(complaint(&falls.measure(Setting::EXPLICIT)), None);
}

/// The table of times has a row for each communication step. Communication points on the grid do not change the number of sub-steps.
#[test]
fn falls_are_timed_in_communication_steps_of_several_lengths() {
    let rows = speed::rows(Extent::Quick).expect("falls that come to their end");
    let steps: Vec<f64> = rows.iter().map(|row| row.step).collect();
    assert_eq!(steps, [5.0, 50e-3, 1e-3]);
    for row in &rows {
        assert_eq!((row.duration, row.falls.verdict, row.falls.mean), (5.0, Verdict::Pass, rows[0].falls.mean));
        assert!(row.cost[0] > 0.0 && row.cost[1] >= row.cost[0], "{:?}", row.cost);
    }
    let mut table = Vec::new();
    speed::write_markdown(&rows, &mut table).expect("a table");
    assert_eq!(String::from_utf8(table).expect("text").lines().count(), 2 + rows.len());
}

#[test]
fn vertices_are_crossed_and_near_misses_turned() {
    hold(2);
}

#[test]
fn rest_in_a_vertex_stays_or_leaves_on_the_branch_of_least_constraint() {
    hold(3);
}

#[test]
fn other_singular_postures_are_passed() {
    hold(4);
}

#[test]
fn the_paper_torque_test_completes() {
    hold(5);
}

#[test]
fn scales_do_not_matter() {
    hold(6);
}

#[test]
fn a_long_motion_drifts_nowhere() {
    assert_eq!(complaint(&hour(Extent::Quick)), None);
}

/// Following machines, by every judged method.
#[test]
fn machines_are_followed_through_singularities() {
    let mut rows = Vec::new();
    followed(Extent::Quick, "", |row| rows.push(row));
    assert_eq!(rows.len(), followed_count(""));
    assert_eq!(rows.iter().filter(|row| row.verdict == Verdict::Pass).count(), 4 * 4);
    let wrong: Vec<String> = rows.iter().filter(|row| row.verdict == Verdict::Fail).filter_map(complaint).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn two_processes_give_the_same_bits() {
    let other = Command::new(env!("CARGO_BIN_EXE_hard-cases")).arg("fingerprint").output().expect("the program");
    let other = String::from_utf8(other.stdout).expect("text");
    assert_eq!(complaint(&bits_row(&[("in another process", other)])), None);
    assert!(fingerprint().lines().count() > 50);
}

/// The requirements can fail: the printed method ends early, fixed Runge-Kutta steps lose energy.
#[test]
fn failing_methods_are_noticed() {
    let falls = &Case::of_item(Extent::Quick, 1)[0];
    let printed = falls.measure(Setting::Printed(1e-3));
    assert!(printed.failures > 0 && printed.ended_early > 0 && !printed.statuses.is_empty(), "{printed}");
    let rk4 = falls.measure(Setting::Rk4(1e-3));
    assert!(rk4.failures > 0 && rk4.energy > 1.0, "{rk4}");
    assert_eq!(rk4.verdict, Verdict::ForComparison);
}

/// Fixed steps stay fixed, and no method ever returns a value that is not finite.
#[test]
fn no_method_ends_in_nan() {
    for case in Case::all(Extent::Quick) {
        let fixed = [Setting::CONSERVING, Setting::Fixed(1e-3), Setting::Printed(1e-3), Setting::Rk4(1e-3)];
        for setting in [Setting::Default, Setting::EXPLICIT, Setting::AUTOMATIC].into_iter().chain(fixed) {
            for trial in case.trials.iter().take(4) {
                let outcome = trial.run(setting);
                assert!(!matches!(outcome.ending, Ending::NotFinite(_)), "{} by {setting:?}: {:?}", trial.label, outcome.ending);
                if matches!(setting, Setting::Fixed(_) | Setting::Conserving(_)) {
                    assert!(outcome.most <= 1, "{}: {} sub-steps at a fixed step", trial.label, outcome.most);
                }
            }
        }
    }
}

/// Impacts, stops, saturating drives and friction end where a program without the library's code ends.
#[test]
fn loads_with_kinks_are_followed() {
    hold(9);
}

/// Dissipated energy never decreases, also between step ends, where work is a polynomial: in these scenes such an error was up to 6e-4 of
/// the energies at loose tolerances. With torque changes within steps, and communication points 0.1 ms apart. The short form takes two of
/// the scenes and leaves out the smallest tolerance of `i3alp`.
#[test]
fn dissipated_energy_is_never_taken_back() {
    let sample = |scenes: Vec<u64>, by: &str, tolerances: &[f64], points: u64| Sample {
        scenes,
        only: String::new(),
        by: Some(by.into()),
        tolerances: tolerances.to_vec(),
        points,
        push: 1e-3,
    };
    let scenes = || if is_nightly() { vec![200, 210, 235, 244, 254, 272, 275, 293, 301, 369] } else { vec![210, 235] };
    let mut samples = vec![
        sample(scenes(), "dop853", &[1e-4, 1e-6, 3e-9, 1e-12], 10),
        sample(scenes(), "automatic", &[1e-4, 1e-6, 3e-9, 1e-12], 10),
        sample(vec![210, 235], "i3alp", &[1e-4, 3e-9], 1),
    ];
    if is_nightly() {
        samples.push(sample(vec![210], "i3alp", &[1e-12], 1));
    }
    let rows: Vec<Books> = samples.iter().flat_map(|sample| books::measure(sample, |_| ())).collect();
    let wrong: Vec<String> = rows.iter().filter(|row| !row.is_met()).map(Books::to_string).collect();
    assert!(
        rows.len() == 10 * (4 + 4 + 2 + usize::from(is_nightly())) && wrong.is_empty(),
        "{} rows, {}",
        rows.len(),
        wrong.join("\n")
    );
}

/// Every effect with all lengths: each run that completes with OK ends where a program without the library's code ends. The short form takes
/// six of the effects, and the scene with all effects (12); each of the lengths is among them. With friction that sticks (13), that scene takes
/// 40 s.
#[test]
fn machines_with_coaxial_motors_stay_on_their_branch() {
    let complaints = Mutex::new(Vec::new());
    let note = |complaint: &str| complaints.lock().expect("no panic").push(complaint.to_owned());
    let scenes = if is_nightly() { Vec::from_iter(0..14) } else { vec![4, 6, 7, 8, 9, 11, 12] };
    let rows = coaxial::measure(&scenes, note);
    let complaints = complaints.into_inner().expect("no panic").join("\n");
    assert_eq!(rows.len(), scenes.len() + 6 + 1);
    assert!(rows.iter().all(coaxial::Coaxial::is_met), "{complaints}");
}
