//! Inputs that change with time, as `xtask/python/signals.py` defines and checks them.

use anyhow::{Context, Result, bail, ensure};
use fivebar::variables::Variable;
use num_rational::BigRational;
use num_traits::{FromPrimitive, Num, ToPrimitive, clamp};
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

/// What a signal is computed in: doubles, or fractions without round-off.
trait Number: Num + Clone + PartialOrd + FromPrimitive {}
impl<T: Num + Clone + PartialOrd + FromPrimitive> Number for T {}

fn number<T: Number>(value: f64) -> T {
    T::from_f64(value).expect("JSON has finite numbers only")
}

impl Shape {
    /// From 0 to 1 while u goes from 0 to 1.
    fn way<T: Number>(self, u: T) -> T {
        match self {
            Self::Linear => u,
            Self::MinimumJerk => {
                let bend = number::<T>(10.0) - number::<T>(15.0) * u.clone() + number::<T>(6.0) * u.clone() * u.clone();
                u.clone() * u.clone() * u * bend
            }
        }
    }

    /// Its derivative.
    fn slope<T: Number>(self, u: T) -> T {
        match self {
            Self::Linear => T::one(),
            Self::MinimumJerk => {
                let left = T::one() - u.clone();
                number::<T>(30.0) * u.clone() * u * left.clone() * left
            }
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
    /// Its value at a time, s, to a few units of the last place.
    pub fn at(&self, time: f64) -> f64 {
        self.value(time)
    }

    /// The double nearest to its value at the beginning of a millisecond, counted from 0.
    pub fn nearest(&self, millisecond: u32) -> f64 {
        self.value(BigRational::new(millisecond.into(), 1000.into())).to_f64().expect("between finite knots")
    }

    fn value<T: Number>(&self, time: T) -> T {
        let segment = self.knots.windows(2).rfind(|knots| number::<T>(knots[0].0) <= time).unwrap_or(&self.knots[..2]);
        let [(from, before), (to, after)] = [segment[0], segment[1]].map(|(time, value)| (number::<T>(time), number::<T>(value)));
        let (duration, change) = (to - from.clone(), after - before.clone());
        let u = (time - from) / duration.clone();
        match self.rate {
            false => before + change * self.shape.way(clamp(u, T::zero(), T::one())),
            true if T::zero() <= u && u < T::one() => change / duration * self.shape.slope(u),
            true => T::zero(),
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

    /// To the bit what tests/data/reference/make/make.py holds: values of its `signal_at`, in 80 digits.
    #[test]
    fn the_nearest_double_is_what_references_hold() {
        let held = [
            ("haptic", 1005, "tip.fx", 1.19861025),
            ("haptic", 1100, "tip.fx", 8.407790785948869e-45), // the last knot, 1.1 as a double, is after the millisecond
            ("pick_and_place", 207, "servo.omega[1]", -0.010976847264095969),
            ("pick_and_place", 450, "servo.theta[2]", 0.8649499999999999),
            ("pick_and_place", 1340, "servo.omega[2]", 0.6423852441599988),
        ];
        for (scene, millisecond, name, value) in held {
            let scene = crate::Scene::read(scene).expect("a shipped scene");
            let signal = scene.signals.iter().find(|signal| signal.variable.name == name).expect("its signal");
            assert_eq!(signal.nearest(millisecond), value, "{name} at {millisecond} ms");
            // Doubles are off by some units of the last place, 4e-16 of values around 3.
            let double = signal.at(1e-3 * f64::from(millisecond));
            assert!((double - value).abs() < 5e-15, "{name} at {millisecond} ms: {double}");
        }
    }
}
