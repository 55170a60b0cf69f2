//! A sample of the battery, one test per item of its list: what `cargo xtask hard-cases` runs in full.

use std::process::Command;

use hard_cases::cases::{bits_row, fingerprint, hour};
use hard_cases::{Case, Ending, Extent, Row, Setting, Verdict};

/// The judged settings meet the demands of every case of an item.
fn hold(item: u8) {
    let cases = Case::of_item(Extent::Quick, item);
    assert!(!cases.is_empty());
    let mut wrong = Vec::new();
    for case in &cases {
        for setting in case.settings.iter().filter(|setting| setting.is_judged()) {
            let row = case.measure(*setting);
            wrong.extend(complaint(&row));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn complaint(row: &Row) -> Option<String> {
    (row.verdict != Verdict::Pass).then(|| format!("{row}\n    {}", row.objections.join("\n    ")))
}

#[test]
fn perturbed_free_falls_keep_energy_and_constraints() {
    hold(1);
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
fn the_paper_torque_test_is_survived() {
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

#[test]
fn two_processes_give_the_same_bits() {
    let other = Command::new(env!("CARGO_BIN_EXE_hard-cases")).arg("fingerprint").output().expect("the program");
    let other = String::from_utf8(other.stdout).expect("text");
    assert_eq!(complaint(&bits_row(&[("in another process", other)])), None);
    assert!(fingerprint().lines().count() > 50);
}

/// The demands can be failed: the printed method ends early, fixed Runge-Kutta steps lose the energy.
#[test]
fn methods_that_do_not_hold_are_noticed() {
    let falls = &Case::of_item(Extent::Quick, 1)[0];
    let printed = falls.measure(Setting::Printed(1e-3));
    assert!(printed.failures > 0 && printed.ended_early > 0 && !printed.statuses.is_empty(), "{printed}");
    let rk4 = falls.measure(Setting::Rk4(1e-3));
    assert!(rk4.failures > 0 && rk4.energy > 1.0, "{rk4}");
    assert_eq!(rk4.verdict, Verdict::ForComparison);
}

/// Fixed steps stay fixed, and no method ever hands out a value that is not finite.
#[test]
fn no_method_ends_in_nan() {
    for case in Case::all(Extent::Quick) {
        for setting in [Setting::Default, Setting::EXPLICIT, Setting::Fixed(1e-3), Setting::Printed(1e-3), Setting::Rk4(1e-3)] {
            for trial in case.trials.iter().take(12) {
                let outcome = trial.run(setting);
                assert!(!matches!(outcome.ending, Ending::NotFinite(_)), "{} by {setting:?}: {:?}", trial.label, outcome.ending);
                if matches!(setting, Setting::Fixed(_)) {
                    assert!(outcome.most <= 1, "{}: {} sub-steps at a fixed step", trial.label, outcome.most);
                }
            }
        }
    }
}
