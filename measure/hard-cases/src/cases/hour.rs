//! Item 7 of the battery: one hour of simulated motion.

use std::time::Instant;

use fivebar::fmi::clock::Clock;
use fivebar::observers;
use fivebar::simulation::Simulation;

use super::Extent;
use crate::machine::{NO_LOAD, fall_90_120, mgl};
use crate::report::{Row, Verdict};
use crate::setting::Setting;

/// Macro step, s.
const STEP: f64 = 1e-3;

/// Free fall for an hour in communication steps of 1 ms. The clock, the counters and memory must not drift, and a copy made half way must
/// end with the same bits.
pub fn hour(extent: Extent) -> Row {
    let begin = Instant::now();
    let steps: u64 = extent.pick(3_600_000, 20_000);
    let mut row = Row {
        item: 7,
        case: "one hour",
        method: Setting::Default.method(),
        setting: Setting::Default.label(),
        runs: 1,
        criterion: "complete, clock and counters exact, no allocation, a copy made half way arrives at the same bits".into(),
        ..Row::default()
    };
    if let Err(objection) = run(steps, &mut row) {
        row.failures = 1;
        row.objections.push(objection);
    }
    row.verdict = if row.failures == 0 { Verdict::Pass } else { Verdict::Fail };
    row.seconds = begin.elapsed().as_secs_f64();
    row
}

fn run(steps: u64, row: &mut Row) -> Result<(), String> {
    let parameters = fall_90_120();
    let unit = mgl(&parameters.geometry);
    let mut simulation = Simulation::new(&parameters, &NO_LOAD).map_err(|refusal| refusal.to_string())?;
    let mut clock = Clock::new(0.0, None).map_err(|rejection| rejection.message)?;
    let mut follow = |simulation: &mut Simulation, clock: &mut Clock, range: std::ops::Range<u64>| -> Result<(), String> {
        let mut result = Ok(());
        let allocated = allocation_counter::measure(|| result = advance(simulation, clock, range, unit, row));
        result?;
        if allocated.count_total != 0 {
            return Err(format!("{} allocations", allocated.count_total));
        }
        Ok(())
    };
    follow(&mut simulation, &mut clock, 0..steps / 2)?;
    let (mut copy, mut copied_clock) = (simulation.clone(), clock.clone());
    follow(&mut simulation, &mut clock, steps / 2..steps)?;
    follow(&mut copy, &mut copied_clock, steps / 2..steps)?;

    let counters = simulation.state().core.counters;
    row.mean = counters.substeps as f64 / counters.steps as f64;
    if counters.steps != steps {
        return Err(format!("{} steps counted, {steps} taken", counters.steps));
    }
    let end = steps as f64 * STEP;
    if (clock.point() - end).abs() > 2.0 * f64::EPSILON * end {
        return Err(format!("the clock is at {:?} s instead of {end:?} s", clock.point()));
    }
    if simulation.state() != copy.state() || clock != copied_clock {
        return Err("the copy has arrived elsewhere".into());
    }
    Ok(())
}

/// Steps like a master that counts: communication point n is n H.
fn advance(
    simulation: &mut Simulation,
    clock: &mut Clock,
    range: std::ops::Range<u64>,
    unit: f64,
    row: &mut Row,
) -> Result<(), String> {
    for i in range {
        let plan = clock.plan(i as f64 * STEP, STEP, STEP).map_err(|rejection| rejection.message)?;
        let before = simulation.state().core.counters.substeps;
        simulation.advance(&NO_LOAD, plan.h, plan.steps).map_err(|failure| failure.to_string())?;
        clock.advance(plan);
        let energies = observers::energies(simulation.model(), &simulation.state());
        if !energies.error.is_finite() {
            return Err(format!("not finite at {} s", clock.point()));
        }
        row.energy = row.energy.max(energies.error.abs() / unit);
        row.most = row.most.max(simulation.state().core.counters.substeps - before);
        if i % 100 == 0 {
            let norms = observers::constraint_norms(simulation.model(), &simulation.state());
            row.position = row.position.max(norms.position);
            row.velocity = row.velocity.max(norms.velocity);
        }
    }
    Ok(())
}
