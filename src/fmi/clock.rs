//! Communication points and macro steps (FMI 2.0.4, section 4.2.2; macro steps are this project's own).
//!
//! The simulated system does not depend on time, so the clock only checks the master's points and divides a communication step H into macro
//! steps. If H is k times the macro step h, it takes k steps of exactly h, counted as integers; otherwise ceil(H/h) equal steps. Each
//! accepted point is the reference for the next step, so a master may count (start + n H) or accumulate (t += H), over any number of steps,
//! without leaving the tolerance.

use borsh::{BorshDeserialize, BorshSerialize};

use super::values::check_finite;
use super::{CallError, Kind};

/// Relative tolerance within which a master's points and step sizes match the planned ones.
const RELATIVE: f64 = 1e-9;

/// Largest deviation of a point that is accepted as rounding, relative to the step, unless doubles at that time are coarser.
const PART: f64 = 0.01;

/// Largest overrun of stopTime by an accepted step of an integrating master, s, unless doubles at that time are coarser.
const MOST_SLACK: f64 = 1e-5;

/// Rounding of H when the master computes it as a difference of two points, in ulps of the larger point.
const ULPS: f64 = 4.0;

/// Largest number of macro steps in one call; more would take at least minutes.
const MOST_STEPS: f64 = 1e9;

/// Clock of an instance: start, end and last communication point, s.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Clock {
    point: f64,
    stop: Option<f64>,
}

/// A planned communication step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Macro step, s.
    pub h: f64,
    /// Number of macro steps.
    pub steps: u64,
    /// Communication point at the end of the last macro step, s.
    end: f64,
}

impl Clock {
    /// fmi2SetupExperiment: a clock at `start`, s, that must not pass `stop`, s. Refuses times that are not finite and a stop before the
    /// start.
    pub fn new(start: f64, stop: Option<f64>) -> Result<Self, CallError> {
        check_finite(start, || format!("startTime is {start} s"))?;
        if let Some(stop) = stop {
            check_finite(stop, || format!("stopTime, undefined for an open end, is {stop} s"))?;
            if stop < start {
                return Err(CallError::error(format!(
                    "stopTime is {stop:?} s, must not be before startTime, which is {start:?} s."
                )));
            }
        }
        Ok(Self { point: start, stop })
    }

    /// Refuses a stored clock that no run can have reached.
    pub(super) fn check(&self, kind: Kind) -> Result<(), CallError> {
        let stop = match kind {
            // The master's integrator may try any time.
            Kind::ModelExchange => None,
            // Rounding may put the last point past the end, by a fraction of a step size that is not stored.
            Kind::CoSimulation => self.stop.map(|stop| stop + RELATIVE * stop.abs().max(1.0)),
        };
        Self::new(self.point, stop).map(drop)
    }

    /// fmi2SetTime: sets the time, s, forward or backward; refuses a time that is not finite.
    pub(super) fn set(&mut self, time: f64) -> Result<(), CallError> {
        check_finite(time, || format!("time is {time} s"))?;
        self.point = time;
        Ok(())
    }

    /// Refuses a time past the end by more than rounding.
    pub(super) fn check_end(&self) -> Result<(), CallError> {
        match self.stop {
            Some(stop) if self.point > stop + slack(stop) => {
                Err(CallError::error(format!("the time is {:?} s, which is past stopTime {stop:?} s.", self.point)))
            }
            _ => Ok(()),
        }
    }

    /// Last communication point, s.
    pub fn point(&self) -> f64 {
        self.point
    }

    /// Checks a communication step of `size` s from `point`, s, and divides it into macro steps of about `h` s. Refuses a point other than
    /// the present one, a size that is not positive and finite or does not advance the clock, an end past the stop time, and more than
    /// 1e9 macro steps.
    pub fn plan(&self, point: f64, size: f64, h: f64) -> Result<Plan, CallError> {
        let end = point + size;
        let expected = point == self.point || (point - self.point).abs() <= tolerance(self.point, size);
        if !(expected && end > point && end < f64::INFINITY) {
            return Err(self.refusal(point, size, expected));
        }
        if let Some(stop) = self.stop
            && end > stop + tolerance(stop, size)
        {
            return Err(past_end(stop, point, end, size));
        }
        let (h, steps) = if size == h { (h, 1) } else { divide(point, size, h)? };
        Ok(Plan { h, steps, end })
    }

    /// Refusal of a communication step: its point is wrong, or its size is not positive and finite, or too small to advance the clock.
    #[cold]
    fn refusal(&self, point: f64, size: f64, expected: bool) -> CallError {
        CallError::error(if !(size > 0.0 && size.is_finite()) {
            format!("communicationStepSize is {size:?} s, must be positive and finite.")
        } else if expected {
            format!("communicationStepSize is {size:?} s, which does not advance the clock at {point:?} s.")
        } else {
            format!("currentCommunicationPoint is {point:?} s, expected {:?} s.", self.point)
        })
    }

    /// Moves the clock to the end of the planned step.
    pub fn advance(&mut self, plan: Plan) {
        self.point = plan.end;
    }
}

/// Refusal of a step past the end. A master may loop while its own sum of step sizes is below stopTime. If rounding makes the sum too
/// small, the master takes one step too many; the message names the difference.
#[cold]
fn past_end(stop: f64, point: f64, end: f64, size: f64) -> CallError {
    let left = stop - point;
    let start = if left <= 0.0 {
        "at stopTime".to_owned()
    } else if left <= tolerance(stop, size) {
        format!("{left:.1e} s before stopTime, a difference within rounding: the run has already reached its end")
    } else {
        format!("{left:?} s before stopTime")
    };
    CallError::error(format!(
        "currentCommunicationPoint + communicationStepSize is {end:?} s, which is past stopTime {stop:?} s; the step starts {start}."
    ))
}

/// Rounding allowed at the end, s, if the step size is unknown.
fn slack(stop: f64) -> f64 {
    (RELATIVE * stop.abs().max(1.0)).min(MOST_SLACK).max(rounding(stop))
}

/// Tolerance of a communication point, s. It is relative to the magnitude of the clock, since a master's sum may have accumulated the
/// rounding of millions of steps. It is at most a hundredth of a step, or the rounding of doubles at that time if that is coarser, and
/// never more than half a step.
fn tolerance(point: f64, size: f64) -> f64 {
    (RELATIVE * point.abs().max(size)).min(PART * size).max(rounding(point)).min(0.5 * size)
}

/// Rounding of a few doubles of this magnitude, s.
fn rounding(point: f64) -> f64 {
    ULPS * f64::EPSILON * point.abs()
}

/// Length, s, and number of the macro steps of a communication step of `size` s from `point`; refuses more than 1e9 of them.
fn divide(point: f64, size: f64, h: f64) -> Result<(f64, u64), CallError> {
    let ratio = size / h;
    if ratio > MOST_STEPS {
        return Err(CallError::error(format!("communicationStepSize is {size:?} s, more than 1e9 times solver.stepSize {h:?} s.")));
    }
    let multiple = ratio.round();
    let rounding = rounding(point.abs().max((point + size).abs()));
    if multiple >= 1.0 && (size - multiple * h).abs() <= RELATIVE * multiple * h + rounding {
        return Ok((h, multiple as u64));
    }
    let count = ratio.ceil();
    Ok((size / count, count as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 1e-3;

    #[test]
    fn the_step_grid() {
        for (point, size, h, expected) in [
            // Multiples of h give steps of exactly h.
            (0.0, 1e-3, H, (H, 1)),
            (0.0, 0.01, H, (H, 10)),
            (0.0, 50.0, H, (H, 50_000)),
            (0.3, 0.1 + 0.2 - 0.3 + 1e-3, H, (H, 1)),
            // A difference of two points carries their rounding.
            (1e4, 10_000.001 - 10_000.0, H, (H, 1)),
            (1e7, 10_000_000.001 - 10_000_000.0, H, (H, 1)),
            // Sizes within 1e-9 of a multiple, and just outside.
            (0.0, 1e-3 * (1.0 + 0.9e-9), H, (H, 1)),
            (0.0, 1e-3 * (1.0 + 1.2e-9), H, (1e-3 * (1.0 + 1.2e-9) / 2.0, 2)),
            // Sizes that are no multiple give equal steps of at most h.
            (0.0, 1.0 / 60.0, H, (1.0 / 60.0 / 17.0, 17)),
            (0.0, 2.5e-3, H, (2.5e-3 / 3.0, 3)),
            (0.0, 4e-4, H, (4e-4, 1)),
            (0.0, 6e-4, H, (6e-4, 1)),
            (0.0, 1.0 / 60.0, 1.0 / 60.0, (1.0 / 60.0, 1)),
        ] {
            assert_eq!(divide(point, size, h).expect("a grid"), expected, "H = {size:?} at {point:?}");
        }
    }

    /// Takes communication steps until `steps` are done; `next` computes each point as the master does.
    fn run(start: f64, size: f64, steps: u64, mut next: impl FnMut(u64, f64) -> f64) {
        let mut clock = Clock::new(start, Some(start + size * steps as f64)).expect("a clock");
        let mut point = start;
        for step in 0..steps {
            let plan = clock.plan(point, size, size).unwrap_or_else(|refused| panic!("step {step}: {}", refused.message));
            assert_eq!((plan.h, plan.steps), (size, 1));
            clock.advance(plan);
            point = next(step + 1, point);
        }
    }

    #[test]
    fn masters_may_count_or_accumulate() {
        for (start, size) in [(0.0, 1.0 / 60.0), (0.0, 1e-3), (12.34, 0.01), (-3.0, 0.1), (1e5, 1e-3)] {
            run(start, size, 10_000_000 / 20, |n, _| start + n as f64 * size);
            run(start, size, 10_000_000 / 20, |_, point| point + size);
        }
    }

    #[test]
    fn ten_million_steps_end_at_the_stop_time() {
        run(0.0, 1e-3, 10_000_000, |_, point| point + 1e-3);
    }

    #[test]
    fn a_rounded_point_is_accepted() {
        let mut clock = Clock::new(0.0, None).expect("a clock");
        clock.advance(clock.plan(0.0, 0.99, H).expect("the first step"));
        assert_eq!(clock.plan(0.9900000000000007, 0.01, H).map(|plan| plan.steps), Ok(10));
    }

    #[test]
    fn what_must_be_refused_is_refused() {
        let clock = Clock::new(2.0, Some(3.0)).expect("a clock");
        for (point, size, expected) in [
            (2.0, 0.0, "communicationStepSize is 0.0 s, must be positive and finite"),
            (2.0, -1e-3, "communicationStepSize is -0.001 s, must be positive and finite"),
            (2.0, f64::NAN, "communicationStepSize is NaN s, must be positive and finite"),
            (2.0, f64::INFINITY, "communicationStepSize is inf s, must be positive and finite"),
            (f64::NAN, 1e-3, "currentCommunicationPoint is NaN s, expected 2.0 s"),
            (0.0, 1e-3, "currentCommunicationPoint is 0.0 s, expected 2.0 s"),
            (2.001, 1e-3, "currentCommunicationPoint is 2.001 s, expected 2.0 s"),
            (2.0005, 1e-3, "currentCommunicationPoint is 2.0005 s, expected 2.0 s"),
            (2.0, 1.001, "is 3.001 s, which is past stopTime 3.0 s; the step starts 1.0 s before stopTime."),
            (2.0, 1e-17, "communicationStepSize is 1e-17 s, which does not advance the clock at 2.0 s"),
        ] {
            let refused = clock.plan(point, size, H).expect_err("a refusal");
            assert!(refused.message.contains(expected), "\"{}\", expected \"{expected}\"", refused.message);
        }
        assert!(clock.plan(2.0, 1.0 + 1e-12, H).is_ok(), "rounding at the stop time");
        assert!(Clock::new(0.0, None).expect("a clock").plan(0.0, 1e300, H).is_err(), "too many steps");
    }

    /// `while t < 10 { step(t, 0.01); t += 0.01 }` makes 1001 steps.
    #[test]
    fn one_step_too_many_is_recognised_as_rounding() {
        let mut clock = Clock::new(0.0, Some(10.0)).expect("a clock");
        let mut point = 0.0;
        for _ in 0..1000 {
            clock.advance(clock.plan(point, 0.01, H).expect("a step"));
            point += 0.01;
        }
        assert!(point < 10.0);
        let refused = clock.plan(point, 0.01, H).expect_err("past the end");
        assert_eq!(
            refused.message,
            "currentCommunicationPoint + communicationStepSize is 10.009999999999831 s, which is past stopTime 10.0 s; the step starts \
             1.7e-13 s before stopTime, a difference within rounding: the run has already reached its end."
        );
        let mut clock = Clock::new(0.0, Some(1.0)).expect("a clock");
        clock.advance(clock.plan(0.0, 1.0, H).expect("a step"));
        assert!(clock.plan(1.0, H, H).is_err_and(|refused| refused.message.ends_with("the step starts at stopTime.")));
    }

    /// At Unix times doubles resolve a tenth of a microsecond. The tolerance is a fraction of the step, not of the time.
    #[test]
    fn far_from_0_no_step_goes_past_the_end() {
        let start = 1e9;
        for (size, past_end) in [(2.0, 1.0), (2.0, 0.1), (1e-3, 4e-4), (1e-3, 5e-5)] {
            let clock = Clock::new(start, Some(start + size - past_end)).expect("a clock");
            let refused = clock.plan(start, size, H).expect_err("past the end");
            assert!(refused.message.contains("which is past stopTime"), "{size} s, {past_end} s past: {}", refused.message);
            assert!(
                clock.plan(start + 0.4 * size, size, H).is_err_and(|refused| refused.message.contains("expected 1000000000.0 s"))
            );
        }
        let mut clock = Clock::new(start, Some(start + 1.0)).expect("a clock");
        clock.set(start + 1.0 + 1e-3).expect("a time");
        assert!(clock.check_end().is_err());
        clock.set(start + 1.0 + 5e-7).expect("a time");
        assert!(clock.check_end().is_ok(), "four doubles later");
        // One master counts, the other adds, for a minute. If the step is not a double, a sum may be off by a hundredth of a step at most.
        run(start, 1e-3, 60_000, |n, _| start + n as f64 * 1e-3);
        run(start, 0.0078125, 60_000, |_, point| point + 0.0078125);
        run(start, 1e-3, 100, |_, point| point + 1e-3);
    }

    #[test]
    fn a_clock_that_runs_backwards_is_refused() {
        assert!(Clock::new(1.0, Some(0.5)).is_err_and(|refused| refused.message.contains("must not be before")));
        assert!(Clock::new(f64::NAN, None).is_err());
        assert!(Clock::new(0.0, Some(f64::INFINITY)).is_err());
        assert!(Clock::new(1.0, Some(1.0)).is_ok());
    }
}
