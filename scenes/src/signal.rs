//! Inputs that change with time, as `xtask/python/signals.py` defines and checks them.

use anyhow::{Context, Result, bail, ensure};
use fivebar::variables::Variable;
use serde_json::{Map, Value as Json};

/// One input's way through its knots.
#[derive(Clone, Debug)]
pub struct Signal {
    /// The input.
    pub variable: &'static Variable,
    shape: Shape,
    /// Whether it is the rate of that way.
    rate: bool,
    /// Times, s, and values.
    knots: Vec<(f64, f64)>,
}

/// The way from one knot to the next.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Linear,
    MinimumJerk,
}

impl Shape {
    /// From 0 to 1 while u goes from 0 to 1.
    fn way(self, u: f64) -> f64 {
        match self {
            Self::Linear => u,
            Self::MinimumJerk => u * u * u * (10.0 - 15.0 * u + 6.0 * u * u),
        }
    }

    /// Its derivative.
    fn slope(self, u: f64) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::MinimumJerk => 30.0 * u * u * (1.0 - u) * (1.0 - u),
        }
    }
}

/// The signals of a file.
pub(crate) fn read(given: &Json) -> Result<Vec<Signal>> {
    let given = given.as_object().context("signals are an object of inputs")?;
    given.keys().map(|name| signal(given, name).with_context(|| format!("signal {name}"))).collect()
}

fn signal(given: &Map<String, Json>, name: &str) -> Result<Signal> {
    let variable = crate::named(name)?;
    let (kind, value) = given[name].as_object().and_then(|kinds| kinds.iter().next()).context("it is no object with one key")?;
    let shape = match kind.as_str() {
        "linear" => Shape::Linear,
        "minimumJerk" => Shape::MinimumJerk,
        "rateOf" => {
            let source = value.as_str().filter(|source| given.contains_key(*source)).context("rateOf names no other signal")?;
            let source = signal(given, source)?;
            ensure!(!source.rate, "rateOf names a rate");
            return Ok(Signal { variable, rate: true, ..source });
        }
        other => bail!("there is no kind {other}"),
    };
    let knots: Vec<(f64, f64)> = serde_json::from_value(value.clone()).context("knots are pairs of time and value")?;
    ensure!(knots.len() > 1 && knots.is_sorted_by(|a, b| a.0 < b.0), "knots are two or more, their times increase");
    Ok(Signal { variable, shape, rate: false, knots })
}

impl Signal {
    /// Its value at a time, s.
    pub fn at(&self, time: f64) -> f64 {
        let segment = self.knots.windows(2).rfind(|knots| knots[0].0 <= time).unwrap_or(&self.knots[..2]);
        let [(from, before), (to, after)] = [segment[0], segment[1]];
        let (u, change) = ((time - from) / (to - from), after - before);
        match self.rate {
            false => before + change * self.shape.way(u.clamp(0.0, 1.0)),
            true if (0.0..1.0).contains(&u) => change / (to - from) * self.shape.slope(u),
            true => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Knots are met, the way rests before and after, the rate is the derivative by central differences.
    #[test]
    fn a_signal_meets_its_knots_and_its_rate() {
        let given = json!({
            "servo.theta[1]": { "minimumJerk": [[0.2, 1.0], [0.6, 3.0], [0.8, 3.0]] },
            "servo.omega[1]": { "rateOf": "servo.theta[1]" },
            "tip.fx": { "linear": [[0.0, 0.0], [1.0, 2.0]] },
        });
        let signals = read(&given).expect("signals");
        let of = |name: &str| signals.iter().find(|signal| signal.variable.name == name).expect("signal");
        let (way, rate) = (of("servo.theta[1]"), of("servo.omega[1]"));
        for (time, value) in [(0.0, 1.0), (0.2, 1.0), (0.4, 2.0), (0.6, 3.0), (2.0, 3.0)] {
            assert!((way.at(time) - value).abs() < 1e-14, "{time} s: {}", way.at(time));
        }
        for time in [0.1, 0.25, 0.33, 0.5, 0.7, 0.9] {
            // The differences' error is d²/6 times the third derivative, below 2e3 here.
            let difference = (way.at(time + 1e-5) - way.at(time - 1e-5)) / 2e-5;
            assert!((rate.at(time) - difference).abs() < 1e-7, "{time} s: {} and {difference}", rate.at(time));
        }
        assert_eq!(of("tip.fx").at(0.25), 0.5);
    }
}
