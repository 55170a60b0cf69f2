//! Categories, logger, environment (rules 22 and 26 of this project).

use fivebar::ffi::*;

use super::fmi_host::{Host, Instantiation, Line, reference};

/// Categories passed to the logger by the start, a refused call and the end.
fn categories_of_a_run(host: &Host) -> Vec<String> {
    assert_eq!(host.setup(Some(1e-6), 0.0, None), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host.run(1e-3, 3);
    assert_eq!(host.do_step(9.0, 1e-3), fmi2Error);
    assert_eq!(host.other_statuses(0)[0], fmi2Discard);
    assert_eq!(host.call(fmi2Terminate), fmi2OK);
    let mut categories: Vec<String> = host.take().into_iter().map(|line| line.category).collect();
    categories.dedup();
    categories
}

fn logging(on: bool) -> Host {
    let with = Instantiation { logging_on: on, ..Default::default() };
    Host::instantiate(with).unwrap_or_else(|lines| panic!("{lines:?}"))
}

#[test]
fn problems_pass_by_default_and_events_with_logging_on() {
    assert_eq!(categories_of_a_run(&logging(false)), ["logStatusError", "logStatusDiscard"]);
    assert_eq!(categories_of_a_run(&logging(true)), ["logEvents", "logStatusError", "logStatusDiscard", "logEvents"]);
}

#[test]
fn the_master_chooses_the_categories() {
    for (on, categories, expected) in [
        (false, &[][..], &[][..]),
        (false, &["logAll"], &[]),
        (true, &["logStatusError"], &["logStatusError"]),
        (true, &["logEvents", "logStatusDiscard"], &["logEvents", "logStatusDiscard", "logEvents"]),
        (true, &[], &["logEvents", "logStatusError", "logStatusDiscard", "logEvents"]),
        (true, &["logAll"], &["logEvents", "logStatusError", "logStatusDiscard", "logEvents"]),
    ] {
        let host = logging(true);
        assert_eq!(host.set_debug_logging(on, categories), fmi2OK);
        assert_eq!(categories_of_a_run(&host), expected, "{on} {categories:?}");
    }
}

#[test]
fn an_unknown_category_is_refused_with_the_known_ones() {
    let host = logging(false);
    assert_eq!(host.set_debug_logging(true, &["logAll", "logSql"]), fmi2Error);
    assert_eq!(
        host.line(),
        "fmi2SetDebugLogging: log category \"logSql\" is not declared, declared are: logEvents, logStatusWarning, \
         logStatusDiscard, logStatusError, logStatusFatal, logAll."
    );
}

#[test]
fn the_log_line_of_an_initialised_scene() {
    let host = logging(true);
    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    assert_eq!(host.set_boolean(&[reference("gravity.enabled")], &[fmi2False]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    assert_eq!(
        host.take(),
        [Line {
            instance: "machine".to_owned(),
            status: fmi2OK,
            category: "logEvents".to_owned(),
            text: "ready: method i3alp, h = 0.001 s, adaptive true, effects: none".to_owned(),
        }]
    );
}

/// A master's tolerance gives an event in the log, not a warning: accuracy has its own parameters here.
#[test]
fn a_tolerance_is_logged_as_an_event() {
    let host = logging(true);
    assert_eq!(host.setup(Some(1e-6), 0.0, None), fmi2OK);
    let line = &host.take()[0];
    assert_eq!((line.status, line.category.as_str()), (fmi2OK, "logEvents"));
    assert_eq!(line.text, "fmi2SetupExperiment: tolerance 1e-6 is not used; solver.errorTolerance sets the accuracy.");
}

#[test]
fn a_percent_sign_is_doubled_for_printf() {
    let host = logging(false);
    assert_eq!(host.set_debug_logging(true, &["100%s"]), fmi2Error);
    assert!(host.line().contains("\"100%%s\""));
}

#[test]
fn the_name_is_handed_back_as_it_came() {
    let with = Instantiation { name: Some("Führung %d"), ..Default::default() };
    let host = Host::instantiate(with).unwrap_or_else(|lines| panic!("{lines:?}"));
    assert_eq!(host.do_step(0.0, 1.0), fmi2Error);
    assert_eq!(host.take()[0].instance, "Führung %d");
}

/// Each singularity is logged once, with time and kind; so is a start from rest in a constraint singularity, with its branch.
#[test]
fn singularities_met_are_logged_once() {
    let host = logging(true);
    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    assert_eq!(host.set_real(&[reference("init.theta[2]")], &[2.0]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host.take();
    host.run(1e-3, 400);
    let lines: Vec<String> = host.take().into_iter().map(|line| line.text).collect();
    let mut passes = [0];
    assert_eq!(host.get_integer(&[reference("singular.passes.direct")], &mut passes), fmi2OK);
    let direct: Vec<&String> = lines.iter().filter(|line| line.contains("direct singularity (distal links in line)")).collect();
    assert!(passes[0] > 0 && direct.len() == passes[0] as usize, "{passes:?} {lines:?}");
    assert!(direct[0].starts_with("passed between 0.") && direct[0].contains(" s: "), "{}", direct[0]);

    let host = logging(true);
    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    let straight = std::f64::consts::PI;
    assert_eq!(host.set_real(&["init.theta[1]", "init.theta[2]"].map(reference), &[straight, straight]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host.take();
    host.run(1e-3, 20);
    let launches: Vec<String> = host
        .take()
        .into_iter()
        .map(|line| line.text)
        .filter(|line| line.contains("from rest in a constraint singularity"))
        .collect();
    assert_eq!(launches.len(), 1, "{launches:?}");
    assert!(launches[0].contains("between 0.0 s and 0.001 s") && launches[0].ends_with("0 other local minima"), "{}", launches[0]);
}
