//! Inputs and tunable parameters that change with time, given by a few knots [time in s, value].
//!
//! `{"linear": [[t, v], ...]}` connects the knots by straight lines. `{"minimumJerk": [[t, v], ...]}` rests at each knot and moves between
//! them by 10u³ − 15u⁴ + 6u⁵, the path of least mean square jerk between two rests (Flash and Hogan, J. Neurosci. 5 (1985) 1688, eq. 3).
//! `{"rateOf": "servo.theta[1]"}` is the derivative of another signal. `{"steps": [[t, v], ...]}` keeps the value of each knot until the
//! next; only this kind is allowed for a tunable parameter. Before its first and after its last knot a signal is constant.

use anyhow::{Context, Result, bail};
use model_description::Variable;
use num_rational::BigRational;
use num_traits::{FromPrimitive, Num, ToPrimitive, clamp};
use serde_json::{Map, Value as Json};

use crate::names::{self, unit};

const LINEAR: &str = "linear";
const MINIMUM_JERK: &str = "minimumJerk";
const RATE_OF: &str = "rateOf";
const STEPS: &str = "steps";
const KINDS: [&str; 4] = [LINEAR, MINIMUM_JERK, RATE_OF, STEPS];

/// Lead of a step before its knot, s: a master's sum of step sizes may be slightly below the time of a knot.
const EARLY: f64 = 1e-9;

/// Signal of one variable.
#[derive(Clone, Debug)]
pub struct Signal {
    /// The input or tunable parameter.
    pub variable: &'static Variable,
    shape: Shape,
    /// Whether the signal is the rate of the path through the knots.
    rate: bool,
    /// Times, s, and values.
    knots: Vec<(f64, f64)>,
    /// Time of the last knot as given, s.
    pub(crate) end: f64,
}

/// Path from one knot to the next.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Linear,
    MinimumJerk,
    Steps,
}

/// Number type of a signal: doubles, or fractions without round-off.
trait Number: Num + Clone + PartialOrd + FromPrimitive {}
impl<T: Num + Clone + PartialOrd + FromPrimitive> Number for T {}

fn number<T: Number>(value: f64) -> T {
    T::from_f64(value).expect("JSON has finite numbers only")
}

impl Shape {
    /// Path: from 0 to 1 while u goes from 0 to 1.
    fn way<T: Number>(self, u: T) -> T {
        match self {
            Self::Linear => u,
            Self::Steps if u < T::one() => T::zero(),
            Self::Steps => T::one(),
            Self::MinimumJerk => {
                let bend = number::<T>(10.0) - number::<T>(15.0) * u.clone() + number::<T>(6.0) * u.clone() * u.clone();
                u.clone() * u.clone() * u * bend
            }
        }
    }

    /// Derivative of the path.
    fn slope<T: Number>(self, u: T) -> T {
        match self {
            Self::Linear => T::one(),
            Self::Steps => T::zero(),
            Self::MinimumJerk => {
                let left = T::one() - u.clone();
                number::<T>(30.0) * u.clone() * u * left.clone() * left
            }
        }
    }
}

/// Parses the signals of a file.
pub(crate) fn read(given: Option<&Json>) -> Result<Vec<Signal>> {
    let given = match given {
        None => return Ok(Vec::new()),
        Some(Json::Object(given)) => given,
        Some(other) => bail!("'signals' must be an object of names and signals, not {other}"),
    };
    given.keys().map(|name| signal(given, name).with_context(|| format!("signal '{name}'"))).collect()
}

fn signal(given: &Map<String, Json>, name: &str) -> Result<Signal> {
    let (kind, value) = kind(&given[name])?;
    let variable = if kind == STEPS { names::input_or_tunable(name)? } else { names::input(name)? };
    if kind == RATE_OF {
        // A rate of a rate is not allowed: a signal that names itself would never end.
        let has_knots =
            |source: &&str| given.get(*source).and_then(|source| self::kind(source).ok()).is_some_and(|(kind, _)| kind != RATE_OF);
        let source = value.as_str().filter(has_knots).map(|source| signal(given, source)).transpose()?;
        let is_smooth = |source: &Signal| !source.rate && !matches!(source.shape, Shape::Steps);
        let fits = |source: &Signal| is_smooth(source) && unit(variable) == format!("{}/s", unit(source.variable));
        return match source.filter(fits) {
            Some(source) => Ok(Signal { variable, rate: true, ..source }),
            None => bail!("'{RATE_OF}' must name a signal with knots whose rate has the unit {}, not {value}", unit(variable)),
        };
    }
    let (shape, early) = match kind {
        LINEAR => (Shape::Linear, 0.0),
        STEPS => (Shape::Steps, EARLY),
        _ => (Shape::MinimumJerk, 0.0),
    };
    let knots: Vec<(f64, f64)> = match serde_json::from_value::<Vec<_>>(value.clone()) {
        Ok(knots) if knots.len() > 1 => knots,
        _ => bail!("'{kind}' must be a list of two or more knots [time in s, value], not {value}"),
    };
    if let Some(pair) = knots.windows(2).find(|pair| pair[1].0 <= pair[0].0) {
        bail!("the knots' times must increase, but {} s follows {} s", pair[1].0, pair[0].0);
    }
    if let Some(pair) = knots.windows(2).find(|pair| !((pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0)).is_finite()) {
        bail!("the way between the knots at {:?} s and {:?} s is too steep", pair[0].0, pair[1].0);
    }
    let end = knots[knots.len() - 1].0;
    let knots = knots.into_iter().map(|(time, value)| (time - early, value)).collect();
    Ok(Signal { variable, shape, rate: false, knots, end })
}

/// The only key of a signal, one of [`KINDS`], and its value; refuses anything else.
fn kind(given: &Json) -> Result<(&str, &Json)> {
    match given.as_object().map(|kinds| kinds.iter().collect::<Vec<_>>()).as_deref() {
        Some([(kind, value)]) if KINDS.contains(&kind.as_str()) => Ok((kind, value)),
        _ => bail!("it must be an object with one key, one of {}, not {given}", KINDS.join(", ")),
    }
}

impl Signal {
    /// Value at a time, s, accurate to a few units in the last place.
    pub fn at(&self, time: f64) -> f64 {
        self.value(time)
    }

    /// The double nearest to the value at the beginning of a millisecond, counted from 0.
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

    fn signals(given: Json) -> Vec<Signal> {
        read(Some(&given)).expect("signals")
    }

    /// Between knots the value follows the path, outside it is constant; the rate is the derivative by central differences.
    #[test]
    fn a_signal_meets_its_knots_and_its_rate() {
        let knots = json!([[0.5, 1.0], [1.0, 3.0], [2.0, 2.0]]);
        for shape in [LINEAR, MINIMUM_JERK] {
            let given = json!({ "servo.theta[1]": { shape: knots }, "servo.omega[1]": { RATE_OF: "servo.theta[1]" } });
            let [way, rate] = signals(given).try_into().expect("two");
            for (time, value) in [(-1.0, 1.0), (0.0, 1.0), (0.5, 1.0), (0.75, 2.0), (1.0, 3.0), (2.0, 2.0), (9.0, 2.0)] {
                assert_eq!(way.at(time), value, "{shape}, {time} s");
            }
            for time in [0.1, 0.55, 0.7, 0.95, 1.1, 1.6, 1.99, 2.5] {
                // The error of the differences is d²/6 times the third derivative, about 1e3.
                let difference = (way.at(time + 1e-5) - way.at(time - 1e-5)) / 2e-5;
                assert!((rate.at(time) - difference).abs() < 1e-6, "{shape}, {time} s: {} and {difference}", rate.at(time));
            }
        }
    }

    /// A step signal keeps its value until the next knot, even if the master's time differs from the knot by round-off.
    #[test]
    fn a_step_is_there_at_its_time() {
        let [mass] = signals(json!({ "payload.mass": { STEPS: [[0.1, 1.0], [0.3, 3.0], [0.7, 2.0]] } })).try_into().expect("one");
        for (time, value) in
            [(0.0, 1.0), (0.299, 1.0), (300.0 * 0.001, 3.0), (0.1 + 0.2, 3.0), (0.699, 3.0), (7.0 * 0.1, 2.0), (9.0, 2.0)]
        {
            assert_eq!(mass.at(time), value, "{time} s");
        }
        assert_eq!([299, 300, 699, 700].map(|millisecond| mass.nearest(millisecond)), [1.0, 3.0, 3.0, 2.0]);
    }

    /// Rate and acceleration are 0 there, to first order in the distance of 1e-6 s times the jerk of about 1e3.
    #[test]
    fn a_minimum_jerk_rests_in_its_knots() {
        let way = json!({ MINIMUM_JERK: [[0.5, 1.0], [1.0, 3.0], [2.0, 2.0]] });
        let [_, rate] =
            signals(json!({ "servo.theta[1]": way, "servo.omega[1]": { RATE_OF: "servo.theta[1]" } })).try_into().expect("two");
        for knot in [0.5, 1.0, 2.0] {
            let [before, at, after] = [-1e-6, 0.0, 1e-6].map(|close| rate.at(knot + close));
            assert!([before, at, after].iter().all(|rate| rate.abs() < 1e-8), "{knot} s: {before}, {at}, {after}");
            assert!((at - before).abs().max((after - at).abs()) / 1e-6 < 1e-2, "{knot} s: {before}, {at}, {after}");
        }
    }

    /// The same bits as in tests/data/reference/make/make.py: values of its `signal_at`, in 80 digits.
    #[test]
    fn the_nearest_double_is_what_references_hold() {
        let held = [
            ("haptic", 1005, "tip.fx", 1.19861025),
            ("haptic", 1100, "tip.fx", 8.407790785948869e-45), // the last knot, 1.1 as a double, is after the millisecond
            ("pick_and_place", 207, "servo.omega[1]", -0.010976847264095969),
            ("pick_and_place", 450, "servo.theta[2]", 0.8649499999999999),
            ("pick_and_place", 1340, "servo.omega[2]", 0.6423852441599988),
            ("pick_up", 449, "payload.mass", 0.0),
            ("pick_up", 450, "payload.mass", 0.05),
        ];
        for (scene, millisecond, name, value) in held {
            let scene = crate::Scene::read(scene).expect("a shipped scene");
            let signal = scene.signals.iter().find(|signal| signal.variable.name.full == name).expect("its signal");
            assert_eq!(signal.nearest(millisecond), value, "{name} at {millisecond} ms");
            // Doubles are off by a few units in the last place, 4e-16 for values around 3.
            let double = signal.at(1e-3 * f64::from(millisecond));
            assert!((double - value).abs() < 5e-15, "{name} at {millisecond} ms: {double}");
        }
    }
}
