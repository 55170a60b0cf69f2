//! Steps of a test run with their times, and the slowest tests.

use anyhow::Result;
use std::time::{Duration, Instant};

/// Number of slowest tests shown.
const SLOWEST: usize = 20;

/// A test and its time.
pub(super) struct Timed {
    pub(super) name: String,
    pub(super) time: Duration,
}

/// Completed steps.
pub(super) struct Steps {
    begin: Instant,
    done: Vec<Timed>,
    tests: Vec<Timed>,
}

impl Steps {
    pub(super) fn begin() -> Self {
        Self { begin: Instant::now(), done: Vec::new(), tests: Vec::new() }
    }

    /// Runs one step. If it fails, shows the table of steps before it.
    pub(super) fn run<T>(&mut self, name: &str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        println!("\n== {name} ==");
        let start = Instant::now();
        let result = step();
        let time = start.elapsed();
        match result {
            Ok(value) => {
                self.done.push(Timed { name: name.into(), time });
                Ok(value)
            }
            Err(error) => {
                self.show();
                println!("  {name:36} FAILED after {:.1} s", time.as_secs_f64());
                Err(error.context(format!("step `{name}` failed")))
            }
        }
    }

    pub(super) fn add(&mut self, tests: Vec<Timed>) {
        self.tests.extend(tests);
    }

    pub(super) fn show(&mut self) {
        println!("\n== times ==");
        for Timed { name, time } in &self.done {
            println!("  {name:36} {:7.1} s", time.as_secs_f64());
        }
        println!("  {:36} {:7.1} s", "all", self.begin.elapsed().as_secs_f64());
        self.tests.sort_by_key(|test| std::cmp::Reverse(test.time));
        if !self.tests.is_empty() {
            println!("\n== the slowest of {} tests ==", self.tests.len());
        }
        for Timed { name, time } in self.tests.iter().take(SLOWEST) {
            println!("  {:7.1} s  {name}", time.as_secs_f64());
        }
    }
}
