//! Following machines through direct singularities and vertices, and pushes on the tip.

use fivebar::effects::Inputs;
use fivebar::estimator::{LinkState, Linkage, Pair};
use fivebar::mechanism::Assembly;
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::{Method, Parameters, Simulation};

use crate::machine::{
    COARSE, Encoder, FINE, Links, Plan, Random, Scenario, desk, exact, five_percent, follow, motion, no_inputs, side, start_off,
};
use crate::quality::{fall, outcome, push};
use crate::report::{Figure, Table};

/// Speeds of the tip in fast crossings, m/s.
pub const FAST: [f64; 2] = [0.5, 4.0];
/// Speeds of the tip in slow crossings, m/s.
pub const SLOW: [f64; 2] = [0.02, 0.2];
/// Time before and after a singularity, s.
const AROUND: [f64; 2] = [0.15, 0.25];
/// Largest multiple of this time, until |sin(θ₃ − θ₂)| exceeds the next value.
const LONGEST: u32 = 20;
const CLEAR: f64 = 0.25;
/// Time before and after a vertex, s.
const AROUND_VERTEX: [f64; 2] = [0.2, 0.4];
/// Interval without samples of both encoders, s.
const SILENT: [f64; 2] = [0.5, 2.0];
/// Time within which the estimate must be right again, s.
const FOUND: f64 = 1.0;
/// Errors of the twin's start: small, so that the crossing itself is judged.
const START: [f64; 2] = [0.003, 0.03];

/// An earlier state by the given time, s, without gravity: time runs backwards.
fn earlier(parameters: &Parameters, theta: Links, omega: Links, seconds: f64) -> Option<(Links, Links)> {
    let mut run = Simulation::at(parameters, &default_inputs(), theta, omega.map(|rate| -rate)).ok()?;
    run.advance(&default_inputs(), 1e-3, (seconds / 1e-3).round() as u64).ok()?;
    let (theta, omega) = motion(&run.state());
    Some((theta, omega.map(|rate| -rate)))
}

/// Time, s, after which encoders can show the assembly, at least `least`; `None` if it exceeds the limit for crossings.
fn clear_after(parameters: &Parameters, (theta, omega): (Links, Links), least: f64) -> Option<f64> {
    let mut run = Simulation::at(parameters, &default_inputs(), theta, omega).ok()?;
    run.advance(&default_inputs(), 1e-3, (least / 1e-3).round() as u64).ok()?;
    (0..=LONGEST).find_map(|k| {
        if k > 0 {
            run.advance(&default_inputs(), 1e-3, (AROUND[1] / 1e-3).round() as u64).ok()?;
        }
        (side(&run.state().angles()).abs() > CLEAR).then_some(least + f64::from(k) * AROUND[1])
    })
}

/// A scenario starting at a state of all links.
fn from_state(
    mut model: Parameters,
    truth: Parameters,
    (theta, omega): (Links, Links),
    duration: f64,
    random: &mut Random,
) -> Scenario {
    model.start.theta = [theta[0], theta[3]];
    model.start.omega = [omega[0], omega[3]];
    model.start.assembly = if side(&theta) > 0.0 { Assembly::Plus } else { Assembly::Minus };
    // Start errors that cannot be assembled are drawn again.
    let exact = model.start;
    loop {
        start_off(&mut model, random, START);
        if Simulation::new(&model, &default_inputs()).is_ok() {
            break;
        }
        model.start = exact;
    }
    Scenario { model, truth, course: no_inputs, plan: Plan::default(), duration, from: Some((theta, omega)) }
}

fn without_gravity(mut parameters: Parameters) -> Parameters {
    parameters.effects.gravity.enabled = false;
    parameters
}

/// The tip passes the line of the distal links at a speed in this range, m/s, with a component of at least 0.3 across the line.
pub fn crossing(random: &mut Random, [slow, fast]: [f64; 2]) -> Scenario {
    let model = without_gravity(desk());
    let linkage = Linkage::new(&model.geometry);
    loop {
        let truth = five_percent(&model, random);
        let (first, stretched) = (random.between(0.0, std::f64::consts::TAU), 0.42);
        let elbow = [0.21 * first.cos(), 0.21 * first.sin()];
        // The right elbow is on both circles.
        let to = [elbow[0] - 0.1, elbow[1]];
        let distance = to[0].hypot(to[1]);
        let cosine = (0.21f64.powi(2) + distance * distance - stretched * stretched) / (2.0 * 0.21 * distance);
        if cosine.abs() > 0.99 {
            continue;
        }
        let fourth = to[1].atan2(to[0]) + if random.uniform() < 0.5 { cosine.acos() } else { -cosine.acos() };
        let arrow = [0.1 + 0.21 * fourth.cos() - elbow[0], 0.21 * fourth.sin() - elbow[1]];
        let second = arrow[1].atan2(arrow[0]);
        let theta = [first, second, second + std::f64::consts::PI, fourth];
        let frame = linkage.frame(&theta.into());
        if frame.smallest < 0.3 {
            continue;
        }
        let angle = random.between(0.0, std::f64::consts::TAU);
        let direction = Pair::new(angle.cos(), angle.sin());
        let (omega, tip): (Links, [f64; 2]) = ((frame.basis * direction).into(), (frame.tip() * direction).into());
        let across = -tip[0] * second.sin() + tip[1] * second.cos();
        let speed = tip[0].hypot(tip[1]);
        let scale = random.between(slow, fast) / speed;
        let omega = omega.map(|rate| rate * scale);
        // The motion must cross the line: a motion that only grazes it may also turn back, which encoders cannot show.
        if across.abs() < 0.3 * speed
            || (omega[2] - omega[1]).abs() * 0.21 < 0.3 * scale * speed
            || omega.iter().any(|rate| rate.abs() > 30.0)
        {
            continue;
        }
        // From an instant at which encoders can show the assembly until they can again.
        let before = (1..=LONGEST).find_map(|k| {
            let seconds = f64::from(k) * AROUND[0];
            let state = earlier(&truth, theta, omega, seconds)?;
            (side(&state.0).abs() > CLEAR).then_some((state, seconds))
        });
        let Some((start, seconds)) = before else { continue };
        let slowness = (seconds / AROUND[0]).max(1.0);
        let Some(after) = clear_after(&truth, (theta, omega), slowness * AROUND[1]) else { continue };
        return from_state(model, truth, start, seconds + after, random);
    }
}

/// A slow crossing with an unknown push of up to 0.05 N that starts on the way: the side of the machine and the push explain the samples
/// equally well.
pub fn pushed_crossing(random: &mut Random) -> Scenario {
    let mut scenario = crossing(random, SLOW);
    let (angle, force) = (random.between(0.0, std::f64::consts::TAU), random.between(0.0, 0.05));
    scenario.plan.push = [force * angle.cos(), force * angle.sin()];
    scenario.plan.from = random.between(0.0, scenario.duration);
    scenario
}

/// All links pass through one line, up to an offset, rad.
pub fn vertex(random: &mut Random, offset: f64) -> Scenario {
    let mut model = without_gravity(desk());
    model.geometry.base_distance = 0.42;
    let linkage = Linkage::new(&model.geometry);
    let pi = std::f64::consts::PI;
    loop {
        // −w₀ + w₁ + w₂ + w₃ = 0, and the same for squares.
        let (second, fourth) = (random.between(-4.0, 4.0), random.between(-4.0, 4.0));
        if (second + fourth).abs() < 0.5 || second.abs() < 0.5 || fourth.abs() < 0.5 {
            continue;
        }
        let third = -second * fourth / (second + fourth);
        let omega = [second + third + fourth, second, third, fourth];
        if omega.iter().any(|rate| rate.abs() > 10.0) {
            continue;
        }
        let Some((theta, omega)) = earlier(&model, [pi, 0.0, pi, pi], omega, AROUND_VERTEX[0]) else { continue };
        let frame = linkage.frame(&theta.into());
        if frame.smallest < 0.1 || side(&theta).abs() < 0.1 {
            continue;
        }
        let moved = if offset == 0.0 {
            Some((theta, omega))
        } else {
            let aside = frame.displaced(&LinkState::new(theta, omega), [0.0, offset, 0.0, 0.0]);
            linkage.closed(aside).map(|(moved, _)| (moved.theta.into(), moved.omega.into()))
        };
        let Some(start) = moved else { continue };
        let truth = model.clone();
        return from_state(model, truth, start, AROUND_VERTEX[0] + AROUND_VERTEX[1], random);
    }
}

/// The paper's torque test with rates up to 70 rad/s, from its direct singularity on, with the unit's own method.
pub fn whip(random: &mut Random) -> Scenario {
    let model = without_gravity(exact());
    let mut truth = five_percent(&model, random);
    truth.settings.method = Method::Dop853;
    let mut twin = model.clone();
    loop {
        start_off(&mut twin, random, START);
        if Simulation::new(&twin, &default_inputs()).is_ok() {
            break;
        }
        twin.start = model.start;
    }
    let course = |_: f64, _: &Plan| Inputs { tau: [0.25, 0.0], ..default_inputs() };
    Scenario { model: twin, truth, course, plan: Plan::default(), duration: 2.5, from: None }
}

/// A fall with masses 5 % off, through random singularities. Both encoders are silent for so long that the twin no longer knows the
/// machine's posture.
pub fn silenced(random: &mut Random) -> Scenario {
    let mut scenario = fall(random, true);
    scenario.plan.silent = SILENT;
    scenario.duration = SILENT[1] + FOUND;
    scenario
}

/// Number of lost runs, and how many of these still follow several branches.
fn lost(runs: u64, first: u64, encoder: &Encoder, h: f64, scenario: impl Fn(&mut Random) -> Scenario) -> [f64; 2] {
    let outcomes = (0..runs).map(|seed| {
        let mut random = Random::new(first + seed);
        let scenario = scenario(&mut random);
        outcome(&scenario, encoder, h, &mut random)
    });
    let lost: Vec<_> = outcomes.filter(|outcome| outcome.lost).collect();
    [lost.len() as f64, lost.iter().filter(|outcome| outcome.open).count() as f64]
}

/// Lost runs.
pub fn table(part: f64, first: u64) -> Table {
    let runs = |all: f64| (all * part).round().max(2.0) as u64;
    let mut table = Table::new("Runs lost: more than 10 mm off, or on the wrong branch, at the end");
    for h in [1e-3, 5e-3] {
        let (mut all, mut sum, mut undecided) = (0, 0.0, 0.0);
        for (k, (speed, encoder)) in [(FAST, COARSE), (FAST, FINE), (SLOW, COARSE), (SLOW, FINE)].into_iter().enumerate() {
            let count = runs(200.0);
            all += count;
            let [lost, open] = lost(count, first + 7_300_000 + 10_000 * k as u64, &encoder, h, |random| crossing(random, speed));
            (sum, undecided) = (sum + lost, undecided + open);
        }
        let most = if h < 2e-3 { 0.0 } else { (0.01 * all as f64).floor() };
        table.push(Figure::at_most(
            format!("direct singularities at {} ms", 1e3 * h),
            sum,
            most,
            format!("of {all}; undecided still: {undecided}"),
        ));
    }
    for (k, encoder) in [COARSE, FINE].into_iter().enumerate() {
        let count = runs(100.0);
        let [lost, open] = lost(count, first + 7_320_000 + 10_000 * k as u64, &encoder, 1e-3, pushed_crossing);
        let label = format!("slow direct singularities with a push of up to 0.05 N, {}, 1 ms", encoder.name);
        table.push(Figure::untargeted(label, lost, format!("of {count}; undecided still: {open}")));
    }
    for encoder in [COARSE, FINE] {
        let count = runs(40.0);
        let fails = |seed: &u64| {
            let mut random = Random::new(first + 7_350_000 + seed);
            let scenario = whip(&mut random);
            follow(&scenario, &encoder, 5e-3, &mut random, |_| ()).is_err()
        };
        let failed = (0..count).filter(fails).count() as f64;
        table.push(Figure::at_most(
            format!("whips of 70 rad/s at 5 ms, {}: ended early", encoder.name),
            failed,
            0.0,
            format!("of {count}"),
        ));
    }
    let (mut all, mut sum) = (0, 0.0);
    for (k, offset) in [0.0, 1e-4, 1e-3, 5e-3].into_iter().enumerate() {
        for encoder in [COARSE, FINE] {
            let count = runs(40.0);
            let [lost, _] = lost(count, first + 7_400_000 + 10_000 * k as u64, &encoder, 1e-3, |random| vertex(random, offset));
            table.push(Figure::untargeted(
                format!("vertices, {offset} rad aside, {}, 1 ms", encoder.name),
                lost,
                format!("of {count}"),
            ));
            (all, sum) = (all + count, sum + lost);
        }
    }
    table.push(Figure::at_most("vertices at 1 ms, all".into(), sum, (0.02 * all as f64).floor(), format!("of {all}")));
    for encoder in [COARSE, FINE] {
        let count = runs(100.0);
        let [lost, open] = lost(count, first + 7_600_000, &encoder, 1e-3, silenced);
        let label = format!("falls after 1.5 s without encoders, {}, 1 ms, 1 s later", encoder.name);
        table.push(Figure::at_most(label, lost, (0.05 * count as f64).floor(), format!("of {count}; undecided still: {open}")));
    }
    for encoder in [COARSE, FINE] {
        for h in [0.02, 0.05, 0.1, 0.15] {
            let count = runs(100.0);
            let [lost, open] = lost(count, first + 7_650_000, &encoder, h, |random| fall(random, false));
            let label = format!("free falls with a sample every {} ms, {}", 1e3 * h, encoder.name);
            table.push(Figure::untargeted(label, lost, format!("of {count}; undecided still: {open}")));
        }
    }
    for encoder in [COARSE, FINE] {
        let count = runs(100.0);
        let [lost, _] = lost(count, first + 7_500_000, &encoder, 1e-3, push);
        table.push(Figure::at_most(format!("pushes of 0.5 N, {}, 1 ms", encoder.name), lost, 0.0, format!("of {count}")));
    }
    table
}
