//! Alarms: delay after a push, and rate of false alarms.

use crate::learning;
use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, by_start_values, desk, five_percent, follow, learned, start_off};
use crate::quality::{pick_course, plan, push, servos, sines};
use crate::report::{Figure, Table, median, quantile};

/// Repeated picks with masses 5 % off, and a push of 0.5 N.
fn pushed_pick(random: &mut Random) -> Scenario {
    let mut model = desk();
    model.effects.gravity.enabled = false;
    servos(&mut model, 20.0, 0.5);
    model.start.theta = [2.7567, 1.345];
    let truth = five_percent(&model, random);
    start_off(&mut model, random, [0.02, 0.2]);
    let mut plan = plan(random);
    let angle = random.between(0.0, std::f64::consts::TAU);
    (plan.push, plan.from) = ([0.5 * angle.cos(), 0.5 * angle.sin()], random.between(0.5, 1.3));
    Scenario { model, truth, course: pick_course, plan, duration: 1.6, from: None }
}

fn delay(scenario: &Scenario, encoder: &Encoder, random: &mut Random) -> (f64, bool) {
    let (mut noticed, mut early) = (f64::INFINITY, false);
    let done = follow(scenario, encoder, 1e-3, random, |at| {
        let on = at.twin.estimator().alarm();
        early |= on && at.time < scenario.plan.from && at.time > 0.2;
        if on && at.time >= scenario.plan.from && noticed.is_infinite() {
            noticed = at.time - scenario.plan.from;
        }
    });
    (if done.is_ok() { noticed } else { f64::INFINITY }, early)
}

/// Delay from a push of 0.5 N to the alarm, s, of a unit that learns with its start values, at 16 bits.
pub fn delays_while_learning<const N: usize>(seeds: [u64; N]) -> [f64; N] {
    seeds.map(|seed| {
        let mut random = Random::new(seed);
        let scenario = learned(push(&mut random));
        delay(&scenario, &FINE, &mut random).0
    })
}

/// Number of alarms in a run without pushes.
fn false_alarms(encoder: &Encoder, seconds: f64, seed: u64) -> f64 {
    let mut random = Random::new(seed);
    let scenario = sines(&mut random, seconds);
    let (mut count, mut was) = (0.0, true);
    follow(&scenario, encoder, 1e-3, &mut random, |at| {
        let on = at.twin.estimator().alarm();
        if on && !was && at.time > 0.5 {
            count += 1.0;
        }
        was = on;
    })
    .unwrap_or_else(|failure| panic!("{failure}"));
    count
}

/// Delays and false alarms.
pub fn table(runs: u64, hours: f64, first: u64) -> Table {
    let mut table = Table::new("Alarms at 1 ms: from a push of 0.5 N to the alarm, and without one");
    type Scene = fn(&mut Random) -> Scenario;
    // Bounds of the median at 0.1° and at 16 bits, ms.
    let scenes: [(&str, Scene, Option<[f64; 2]>); 6] = [
        ("sines", push, Some([80.0, 10.0])),
        ("pick", pushed_pick, Some([80.0, 10.0])),
        ("fall under known sines", |random| learning::pushed(random, false), Some([80.0, 12.0])),
        ("fall under known sines, learned", |random| learning::pushed(random, true), Some([80.0, 12.0])),
        // Uncertain geometry delays detection; if it is not learned, the delay is shown but not judged.
        ("sines, start values", |random| by_start_values(push(random)), None),
        ("sines, start values, learned", |random| learned(push(random)), Some([80.0, 12.0])),
    ];
    for (i, encoder) in [COARSE, FINE].into_iter().enumerate() {
        for (name, scene, most) in scenes {
            let delays: Vec<(f64, bool)> = (0..runs)
                .map(|seed| {
                    let mut random = Random::new(first + 7_700_000 + seed);
                    let scenario = scene(&mut random);
                    delay(&scenario, &encoder, &mut random)
                })
                .collect();
            let times = || delays.iter().map(|(time, _)| 1e3 * time);
            let missed = times().filter(|time| time.is_infinite()).count();
            let early = delays.iter().filter(|(_, early)| *early).count();
            let remark = format!("90 %: {:.0} ms; {missed} of {runs} missed, {early} raised before", quantile(times(), 0.9));
            let label = format!("{name}, {}: median, ms", encoder.name);
            table.push(match most {
                Some(most) => Figure::at_most(label, median(times()), most[i], remark),
                None => Figure::untargeted(label, median(times()), remark),
            });
        }
        // Many runs of two minutes, each with different masses.
        let blocks = (hours * 30.0).round().max(1.0) as u64;
        let alarms: f64 = (0..blocks).map(|block| false_alarms(&encoder, 120.0, first + 7_800_000 + block)).sum();
        let per_hour = alarms / (blocks as f64 / 30.0);
        table.push(Figure::at_most(
            format!("{}: false alarms an hour", encoder.name),
            per_hour,
            1.0,
            format!("{alarms} in {blocks} runs of 2 min"),
        ));
    }
    table
}
