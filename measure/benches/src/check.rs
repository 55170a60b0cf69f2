//! Checks of CI: instructions, accesses to data and cache misses stay below their ceilings, and disabled effects cost nothing. No times are
//! checked.

use std::fs;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

use crate::case::Case;
use crate::cases::{self, FOLLOWING, OFF, OFF_CALLS};
use crate::count::{self, Accesses};
use crate::scene::{ESTIMATOR, Scene, effects};

/// The ceilings of instructions, each with its reason.
const CEILINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/ceilings.csv");

/// The ceilings of accesses to data and of cache misses, for the cases that call C functions. One reason holds for all: see
/// [`Memory::above`].
const MEMORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/memory.csv");

/// Largest growth of reads and writes. Another compiler keeps other numbers in registers, as with instructions. Between two runs, copies
/// from other addresses change them by at most 0.6 %.
const MORE_ACCESSES: f64 = 1.03;

/// Largest growth of misses: a factor and a number per operation. Addresses decide which data share sets of the cache. Between runs whose
/// environments differed by 8 bytes, misses varied by at most 2 %, but for one of 7 and 14 per call, where a new state lies elsewhere. A
/// frame of 57 kB that is probed on every call costs 14 more.
const MORE_MISSES: (f64, f64) = (1.1, 8.0);

/// A row of memory.csv: accesses allowed per operation.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
struct Memory {
    table: String,
    case: String,
    reads: u64,
    writes: u64,
    /// Misses of the first data cache.
    misses: u64,
}

impl Memory {
    /// The ceilings of a case that was measured.
    fn above(case: &Case, seen: &Accesses) -> Self {
        let (factor, more) = MORE_MISSES;
        Self {
            table: case.table.into(),
            case: case.name.clone(),
            reads: (MORE_ACCESSES * seen.reads).ceil() as u64,
            writes: (MORE_ACCESSES * seen.writes).ceil() as u64,
            misses: (factor * seen.misses + more).ceil() as u64,
        }
    }

    /// A sentence for each count above its ceiling.
    fn faults(&self, seen: &Accesses) -> Vec<String> {
        let Self { table, case, .. } = self;
        let counts = [
            ("reads of data", seen.reads, self.reads),
            ("writes of data", seen.writes, self.writes),
            ("misses of the first data cache", seen.misses, self.misses),
        ];
        let above = counts.into_iter().filter(|(_, count, ceiling)| *count > *ceiling as f64);
        above.map(|(what, count, ceiling)| format!("{table}, {case}: {count:.1} {what}, the ceiling is {ceiling}")).collect()
    }
}

#[derive(Deserialize)]
struct Ceiling {
    table: String,
    case: String,
    instructions: f64,
    reason: String,
}

/// Fails with the names of all cases above a ceiling, and of all effects that cost something while disabled. If `renew`, first replaces
/// the ceilings of memory.csv by the measured counts and their margins.
pub(crate) fn check(renew: bool) -> Result<()> {
    let (cases, counts) = (cases::all()?, count::counts()?);
    let measured = |file: &str, table: &str, name: &str| {
        let found = cases.iter().zip(&counts).find(|(case, _)| case.table == table && case.name == name);
        found.map(|(_, count)| count).with_context(|| format!("{file} names {table}, {name}, which is no case"))
    };
    let calls = cases.iter().zip(&counts).filter_map(|(case, count)| Some((case, count.accesses?)));
    if renew {
        write(&calls.clone().map(|(case, seen)| Memory::above(case, &seen)).collect::<Vec<_>>())?;
    }
    let mut faults = Vec::new();
    for Ceiling { table, case, instructions, reason } in rows(CEILINGS)? {
        let count = measured("ceilings.csv", &table, &case)?.instructions;
        println!("{table}, {case}: {count:.0} instructions, ceiling {instructions:.0} ({reason})");
        if count > instructions {
            faults.push(format!("{table}, {case}: {count:.0} instructions, the ceiling is {instructions:.0}: {reason}"));
        }
    }
    let memory: Vec<Memory> = rows(MEMORY)?;
    let named = |case: &Case| memory.iter().any(|row| row.table == case.table && row.case == case.name);
    if let Some((case, _)) = calls.clone().find(|(case, _)| !named(case)) {
        faults.push(format!(
            "memory.csv has no row {}, {}: `cargo xtask bench --check --renew-memory` writes it",
            case.table, case.name
        ));
    }
    for row in &memory {
        let Memory { table, case, reads, writes, misses } = row;
        let seen = measured("memory.csv", table, case)?.accesses;
        let seen = seen.with_context(|| format!("memory.csv names {table}, {case}, whose accesses are not counted"))?;
        println!(
            "{table}, {case}: {:.0} reads, ceiling {reads}; {:.0} writes, ceiling {writes}; {:.2} misses, ceiling {misses}",
            seen.reads, seen.writes, seen.misses
        );
        faults.extend(row.faults(&seen));
    }
    let mut free = 0;
    for table in [OFF, OFF_CALLS] {
        let off: Vec<_> = cases.iter().zip(&counts).filter(|(case, _)| case.table == table).collect();
        let (_, usual) = off.first().context("no case of what is off")?;
        free += off.len() - 1;
        for (case, count) in &off {
            if count.instructions != usual.instructions {
                let (seen, usual) = (count.instructions, usual.instructions);
                faults.push(format!("{}, which is off, with other values: {seen} instructions per step, not {usual}", case.name));
            }
        }
    }
    // Cases that follow a machine must show the estimator; otherwise this check would not see it.
    for (case, count) in cases.iter().zip(&counts) {
        if count.estimates != (case.table == FOLLOWING) {
            faults.push(format!(
                "{}, {}: the estimator {}",
                case.table,
                case.name,
                if count.estimates { "runs" } else { "does not run" }
            ));
        }
    }
    for effect in effects().filter(|effect| *effect != "gravity").chain([ESTIMATOR]) {
        if end(&cases::off(effect)?)? != end(&Scene::fall())? {
            faults.push(format!("{effect}, which is off, with other values: another trajectory"));
        }
    }
    ensure!(faults.is_empty(), "{}", faults.join("\n"));
    println!("{free} effects that are off, and the estimator, cost nothing: same instructions, same bits");
    Ok(())
}

/// The rows of a file of ceilings.
fn rows<T: for<'de> Deserialize<'de>>(file: &str) -> Result<Vec<T>> {
    let read = || csv::Reader::from_path(file)?.deserialize().collect::<Result<Vec<T>, csv::Error>>();
    read().with_context(|| file.to_owned())
}

/// Writes memory.csv.
fn write(rows: &[Memory]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.iter().try_for_each(|row| writer.serialize(row))?;
    fs::write(MEMORY, writer.into_inner()?).context("memory.csv cannot be written")
}

/// The bits of positions and velocities after 1 s.
fn end(scene: &Scene) -> Result<Vec<u64>> {
    let mut simulation = scene.simulation()?;
    simulation.advance(&scene.inputs, 1e-3, 1000)?;
    let core = &simulation.state().core;
    Ok(core.q.iter().chain(&core.v).map(|x| x.to_bits()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_count_has_a_ceiling_of_its_own() {
        let case = Case::new("table", "case", 1, || anyhow::bail!("it is not run"));
        let seen = |reads, writes, misses| Accesses { reads, writes, misses };
        let row = Memory::above(&case, &seen(200.0, 100.0, 0.6));
        assert!(row.faults(&seen(206.0, 103.0, 8.6)).is_empty());
        // A stack that is probed page by page: 14 writes more, which all miss.
        assert_eq!(
            row.faults(&seen(200.0, 114.0, 14.6)),
            [
                "table, case: 114.0 writes of data, the ceiling is 103",
                "table, case: 14.6 misses of the first data cache, the ceiling is 9"
            ]
        );
        assert_eq!(row.faults(&seen(207.0, 100.0, 0.6)), ["table, case: 207.0 reads of data, the ceiling is 206"]);
    }
}
