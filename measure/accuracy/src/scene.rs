//! Scenes: files of `scenes/`, and the scenes judged against a reference.

use std::rc::Rc;

use anyhow::{Context, Result, ensure};
use fivebar::simulation::bindings::{self, default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Model, Parameters};
use fivebar::variables::{Value, Variable};
use scenes::Scene as File;

use crate::{COMMUNICATION, Choice, Extent, Reference};

/// Kind of difficulty of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// No singularity near, no fast motion.
    Smooth,
    /// Links move fast near singularities.
    Whipping,
    /// Motion with effects: springs, payload, rotors, friction.
    Effects,
    /// Stops and contacts that close and open.
    Impacts,
    /// Loads much faster than the motion.
    Stiff,
    /// Inputs that change every millisecond.
    Driven,
}

impl Kind {
    /// Name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Whipping => "whipping",
            Self::Effects => "with effects",
            Self::Impacts => "with impacts",
            Self::Stiff => "stiff",
            Self::Driven => "driven",
        }
    }
}

/// A scene with its reference.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the file of `scenes/`, without its ending.
    pub name: &'static str,
    /// Kind of difficulty.
    pub kind: Kind,
    /// Duration, s.
    pub end: f64,
    /// The machine, its start and its effects.
    pub parameters: Parameters,
    /// Inputs, constant over each communication step; the last entry applies to all later steps.
    pub inputs: Rc<[Inputs]>,
    /// Reference solution.
    pub reference: Reference,
}

/// Name, kind, length (s), file of the reference.
type Judged = (&'static str, Kind, f64, &'static str);

/// docs/accuracy.md shows the first of each kind.
const JUDGED: [Judged; 22] = [
    ("swing", Kind::Smooth, 2.0, "swing"),
    ("fall_90_120", Kind::Whipping, 1.0, "fall_90_120"),
    ("fall_90_120", Kind::Whipping, 2.0, "fall_90_120"),
    ("paper_torque", Kind::Whipping, 0.5, "torque"),
    ("paper_torque_gravity", Kind::Whipping, 1.0, "paper_torque_gravity"),
    // The symmetric motion of this scene is unstable: by 2 s round-off has grown to 1e-8 m, and staying below 1e-9 m is luck.
    ("paper_free_fall", Kind::Whipping, 1.0, "paper_free_fall"),
    ("flat_table", Kind::Whipping, 3.0, "flat_table"),
    ("singular_crossing", Kind::Whipping, 0.4, "singular_crossing"),
    ("spring_payload", Kind::Effects, 1.0, "spring_payload"),
    ("friction_fall", Kind::Effects, 1.0, "friction_fall"),
    ("run_down", Kind::Effects, 1.0, "run_down"),
    ("servo_friction", Kind::Effects, 2.0, "servo_friction"),
    ("end_stops", Kind::Impacts, 1.0, "end_stops"),
    ("bounce", Kind::Impacts, 1.0, "bounce"),
    ("stiff_servo", Kind::Stiff, 0.5, "stiff_servo"),
    ("servo_step", Kind::Stiff, 1.0, "servo_step"),
    ("pick_and_place", Kind::Driven, 1.6, "pick_and_place"),
    ("haptic", Kind::Driven, 2.0, "haptic"),
    ("friction_fall_stick", Kind::Effects, 1.0, "friction_fall_stick"),
    ("run_down_stick", Kind::Effects, 1.0, "run_down_stick"),
    ("haptic_stick", Kind::Driven, 2.0, "haptic_stick"),
    ("stick_slip", Kind::Driven, 4.0, "stick_slip"),
];

/// Scenes of a quick run: one of each kind, except the smooth one, which is the longest.
const QUICK: [&str; 5] = ["fall_90_120", "spring_payload", "bounce", "stiff_servo", "pick_and_place"];

impl Scene {
    /// The scenes that have a reference; `Quick`: one of each kind, except the smooth one.
    pub fn judged(extent: Extent) -> Result<Vec<Self>> {
        let wanted = |(name, _, end, _): &&Judged| extent == Extent::Full || (QUICK.contains(name) && *end < 2.0);
        JUDGED.iter().filter(wanted).map(Self::with_reference).collect()
    }

    fn with_reference(&(name, kind, end, reference): &Judged) -> Result<Self> {
        let (parameters, inputs) = load(name, end)?;
        Ok(Self { name, kind, end, parameters, inputs, reference: Reference::read(reference, end)? })
    }

    /// Reason for not measuring a choice, if any: a longer step would keep inputs constant for longer, which gives a different motion; and
    /// not every method supports friction that sticks.
    pub fn leaves_out(&self, choice: &Choice) -> Option<String> {
        let mut parameters = self.parameters.clone();
        choice.setting.apply(&mut parameters);
        if let Err(refusal) = Model::new(&parameters) {
            return Some(format!("left out: {}", refusal.0));
        }
        let longer = choice.knob == "step" && choice.value > COMMUNICATION;
        (longer && self.inputs.len() > 1).then(|| {
            let held = 1e3 * COMMUNICATION;
            format!("left out: inputs are held for {held} ms, a longer step would be another motion")
        })
    }

    /// Name and duration, which identify the scene.
    pub fn title(&self) -> String {
        format!("{}, {} s", self.name, self.end)
    }
}

/// Parameters of a file of `scenes/`, and the inputs of each millisecond up to `end` s, as the references use them. Without signals there
/// is a single entry.
pub(crate) fn load(name: &str, end: f64) -> Result<(Parameters, Rc<[Inputs]>)> {
    let file = File::read(name)?;
    let mut now = (default_parameters(), default_inputs());
    for &setting in &file.values {
        write(&mut now, setting)?;
    }
    let last = if file.signals.is_empty() { 1 } else { (1e3 * end).round() as u32 };
    let each = (0..last).map(|millisecond| {
        file.signals_held(millisecond).try_for_each(|setting| write(&mut now, setting))?;
        Ok(now.1)
    });
    let held = each.collect::<Result<_>>()?;
    Ok((now.0, held))
}

/// Writes a value of a scene into the library's parameters or inputs.
fn write((parameters, inputs): &mut (Parameters, Inputs), (variable, value): (&scenes::Variable, scenes::Value)) -> Result<()> {
    let (name, value) = (&variable.name.full, value.fold(Value::Real, Value::Integer, Value::Boolean));
    let variable = Variable::named(name).with_context(|| format!("the library has no variable {name}"))?;
    ensure!(bindings::write(parameters, inputs, variable, value), "{name} cannot be set to {value}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use fivebar::simulation::{Method, Simulation};

    /// Every scene by every method with checked steps, at loose to tight tolerances; the conserving one at two steps.
    #[test]
    fn no_check_stops_a_shipped_scene() {
        let nightly = std::env::var_os("FIVEBAR_NIGHTLY").is_some();
        let (milliseconds, every) = if nightly { (1000, 1) } else { (200, 4) };
        let tolerances = (0..=8).step_by(every).map(|digits| 1e-3 * 10_f64.powi(-digits));
        let by_tolerance = |method| tolerances.clone().map(move |tolerance| (method, tolerance, 1e-3));
        let mut ways: Vec<(Method, f64, f64)> =
            [Method::I3alp, Method::Dop853, Method::Automatic].into_iter().flat_map(by_tolerance).collect();
        ways.extend([1e-3, 2.5e-4].map(|step| (Method::I3alpConserving, 3e-9, step)));
        let names: Vec<String> = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes"))
            .expect("a folder")
            .filter_map(|file| Some(file.ok()?.file_name().to_str()?.strip_suffix(".json")?.to_owned()))
            .collect();
        assert!(names.len() > 20);
        for name in names {
            for &(method, tolerance, step) in &ways {
                let (mut parameters, inputs) = load(&name, 1e-3 * f64::from(milliseconds)).expect("a shipped scene");
                let settings = &mut parameters.settings;
                (settings.method, settings.error_tolerance, settings.step_size) = (method, tolerance, step);
                // A fixed step cannot end at the instant when friction sticks.
                let Ok(mut simulation) = Simulation::new(&parameters, &inputs[0]) else {
                    assert_eq!(method, Method::I3alpConserving, "{name}");
                    continue;
                };
                for millisecond in 0..milliseconds as usize {
                    let input = inputs[millisecond.min(inputs.len() - 1)];
                    let done = simulation.advance(&input, step, (1e-3 / step).round() as u64);
                    assert!(
                        done.is_ok(),
                        "{name}, {method:?}, {tolerance:e} rad, {step} s, {millisecond} ms: {}",
                        done.unwrap_err()
                    );
                }
            }
        }
    }

    #[test]
    fn a_scene_is_what_its_file_says() {
        let (parameters, inputs) = load("stiff_servo", 0.5).expect("a shipped scene");
        assert!(parameters.effects.servo.enabled && inputs.len() == 1);
        assert_eq!((parameters.effects.servo.kp, inputs[0].servo_theta[0]), ([1e6, 0.0], std::f64::consts::FRAC_PI_2));
        assert_eq!(parameters.geometry, default_parameters().geometry);
    }

    /// As doubles 0.2 and 0.7 differ from the decimal numbers by round-off; so does the middle of the first path.
    #[test]
    fn signals_are_held() {
        let (_, inputs) = load("pick_and_place", 0.5).expect("a shipped scene");
        assert!(inputs.len() == 500 && inputs[0].servo_theta == [2.7567, 1.345]);
        assert!((inputs[450].servo_theta[0] - (2.7567 + 1.7966) / 2.0).abs() < 1e-15);
    }
}
