//! A stored state as bytes (FMI 2.0.4, section 2.1.8).
//!
//! ```text
//! offset  bytes  field
//!      0      8  "FiveBar\0"
//!      8      4  FORMAT, the version of this layout
//!     12     38  GUID of the unit
//!     50      8  length n of the content
//!     58      n  the content: `Content` in the Borsh format (https://borsh.io)
//! 58 + n      4  Adler-32 of all before it
//! ```
//!
//! `Followed` comes after `Content` if samples have been set or a machine is tracked; otherwise the file ends with `Content`. Numbers are
//! little-endian, reals IEEE 754 doubles; there are no pointers, and nothing depends on the process or the platform. Parameters are stored
//! as values of variables, so that restored values pass the same checks as values set by a master.

use std::io::{self, Read, Write};

use borsh::{BorshDeserialize, BorshSerialize};

use super::clock::Clock;
use super::derivatives::check_reach;
use super::snapshot::{Scene, Warned, boxed};
use super::values::{check_value, lookup};
use super::{CallError, Guid, Kind, Snapshot, Stage};
use crate::estimator::Measured;
use crate::mechanism::SceneError;
use crate::simulation::bindings::{self, Field};
use crate::simulation::{Estimate, Following, Parameters, Run, Signal, Simulation};
use crate::variables::{Parameter, Value, Variable, VariableId};

const MAGIC: [u8; 8] = *b"FiveBar\0";
/// Version of the layout; changes with every change of the stored data.
const FORMAT: u32 = 34;

/// Bytes before the content.
#[derive(BorshSerialize, BorshDeserialize)]
struct Head {
    magic: [u8; 8],
    format: u32,
    guid: Guid,
    length: u64,
}

/// Stored state of an instance, without samples and estimate.
#[derive(BorshSerialize, BorshDeserialize)]
struct Content {
    stage: Stage,
    kind: Kind,
    clock: Option<Clock>,
    /// Parameters in force that differ from their start values.
    values: Values,
    /// Boxed to bound the stack of a call: a state is moved several times while it is read.
    run: Option<Box<Run>>,
    signal: Signal,
    /// Parameters set by the master that differ from the parameters in force, if [`Snapshot::is_tuned`].
    tuned: Option<Values>,
    warned: Warned,
}

/// Samples and estimate, stored after the content if there are any.
#[derive(Default, BorshDeserialize)]
struct Followed {
    measured: Measured,
    /// Boxed, so that a state without an estimate stays small when it is moved.
    estimate: Option<Box<Estimate>>,
}

/// Values of parameters by ascending value reference.
type Values = Vec<(u32, Value)>;

impl Snapshot {
    /// Serialises the state.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CallError> {
        self.serialised().map_err(|error| CallError::error(format!("the state cannot be serialised: {error}.")))
    }

    fn serialised(&self) -> io::Result<Vec<u8>> {
        let (simulation, following) = (self.scene.as_ref().map(Scene::simulation), self.scene.as_ref().and_then(Scene::following));
        let in_force = self.scene.as_ref().map_or(&self.parameters, Scene::parameters);
        // Room for a state without an estimate.
        let mut content = Vec::with_capacity(1024);
        // Through a trait object, the writer is not inlined into some hundred fields.
        let mut writer: &mut dyn Write = &mut content;
        Content {
            stage: self.stage,
            kind: self.kind,
            clock: self.clock.clone(),
            values: changed(in_force, |variable, _| variable.start),
            run: simulation.map(|simulation| Box::new(simulation.run().clone())),
            signal: self.signal,
            tuned: self.is_tuned.then(|| changed(&self.parameters, |_, id| Some(bindings::parameter(in_force, id).value()))),
            warned: self.warned,
        }
        .serialize(&mut writer)?;
        let estimate = following.map(Following::estimate);
        if estimate.is_some() || !self.measured.same(&Measured::default()) {
            // In the order of the fields of `Followed`.
            (self.measured, estimate).serialize(&mut writer)?;
        }
        let head = Head { magic: MAGIC, format: FORMAT, guid: self.guid, length: content.len() as u64 };
        let mut bytes = [borsh::to_vec(&head)?, content].concat();
        bytes.extend(adler2::adler32_slice(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// Restores a state of the unit with this GUID, or refuses it in one sentence. A forged state is either refused or a motion that closes
    /// the loop and can be continued.
    #[cold]
    pub fn from_bytes(guid: &Guid, bytes: &[u8]) -> Result<Self, CallError> {
        let (content, Followed { measured, estimate }) = parse_content(content(guid, bytes)?)
            .map_err(|error| not_a_state(&format!("their content cannot be decoded: {error}")))?;
        let Content { stage, kind, clock, values, run, signal, tuned, warned } = content;
        let parameters = restored(bindings::default_parameters(), &values, |_| true)?;
        let tuned = tuned.map(|tuned| restored(parameters.clone(), &tuned, |variable| variable.tunable)).transpose()?;
        let signal = checked(signal)?;
        if let Some(clock) = &clock {
            clock.check(kind)?;
        }
        let scene = match (stage, run) {
            (Stage::Instantiated | Stage::InitializationMode, None) if tuned.is_none() && estimate.is_none() => None,
            (
                Stage::StepComplete | Stage::StepFailed | Stage::EventMode | Stage::ContinuousTimeMode | Stage::Terminated,
                Some(run),
            ) if stage.belongs_to(kind) && run.is_model_exchange() == (kind == Kind::ModelExchange) => {
                let refusal = |error: SceneError| not_a_state(&error.to_string());
                match (parameters.estimator.enabled, estimate) {
                    (false, None) => Some(Scene::Ready(boxed(|| Simulation::restored(&parameters, *run)).map_err(refusal)?)),
                    (true, Some(estimate)) => {
                        let following = boxed(|| Following::restored(&parameters, *run, estimate));
                        Some(Scene::Following(following.map_err(refusal)?))
                    }
                    (false, Some(_)) => return Err(not_a_state("they contain an estimate, but estimator.enabled is false")),
                    (true, None) => return Err(not_a_state("estimator.enabled is true, but the estimate is missing")),
                }
            }
            _ => return Err(not_a_state(&format!("their state is \"{stage}\", but they contain data of another state"))),
        };
        if clock.is_none() && stage != Stage::Instantiated {
            return Err(not_a_state(&format!("their state is \"{stage}\", but the clock is missing")));
        }
        let (is_tuned, parameters) = (tuned.is_some(), tuned.unwrap_or(parameters));
        Ok(Self { kind, guid: *guid, stage, clock, parameters, is_tuned, signal, measured, scene, warned })
    }
}

fn not_a_state(what: &str) -> CallError {
    CallError::error(format!("the bytes are not a state of this FMU: {what}."))
}

/// The content, after head, length and checksum have been checked.
fn content<'a>(of: &Guid, bytes: &'a [u8]) -> Result<&'a [u8], CallError> {
    let mut rest = bytes;
    let head = Head::deserialize(&mut rest).ok();
    let (Some(Head { magic, format, guid, length }), Some((content, checksum))) = (head, rest.split_last_chunk()) else {
        return Err(not_a_state(&format!("there are {}, fewer than head and checksum have", bytes.len())));
    };
    if magic != MAGIC {
        return Err(not_a_state("they do not begin with FiveBar"));
    }
    if format != FORMAT {
        return Err(not_a_state(&format!("their format is {format}, not {FORMAT}: another version has written them")));
    }
    if guid != *of {
        return Err(not_a_state("they belong to another GUID: another unit or version has written them"));
    }
    if length != content.len() as u64 {
        return Err(not_a_state(&format!("there are {}, which is not the length in their head", bytes.len())));
    }
    if u32::from_le_bytes(*checksum) != adler2::adler32_slice(&bytes[..bytes.len() - checksum.len()]) {
        return Err(not_a_state("their checksum is wrong"));
    }
    Ok(content)
}

/// Parses samples and estimate. Not inlined: a state without them needs less stack.
#[inline(never)]
fn parse_followed(bytes: &mut dyn Read) -> io::Result<Followed> {
    Followed::deserialize_reader(&mut { bytes })
}

/// Parses the content and, if present, `Followed`.
fn parse_content(mut bytes: &[u8]) -> io::Result<(Content, Followed)> {
    let content = Content::deserialize_reader(&mut (&mut bytes as &mut dyn Read))?;
    let followed = match bytes {
        [] => Followed::default(),
        _ => parse_followed(&mut bytes)?,
    };
    if bytes.is_empty() { Ok((content, followed)) } else { Err(io::Error::other("bytes follow the last field")) }
}

/// Values of the parameters that differ from `before`.
fn changed(parameters: &Parameters, before: impl Fn(&Variable, Parameter) -> Option<Value>) -> Values {
    let values = bindings::parameters().map(|(variable, id)| (variable, id, bindings::parameter(parameters, id).value()));
    let changed = values.filter(|(variable, id, value)| before(variable, *id).is_none_or(|before| !before.same(*value)));
    changed.map(|(variable, _, value)| (variable.reference, value)).collect()
}

/// The parameters `base` with other `values`. Refuses values out of order or bounds, of variables that may not differ, and values equal to
/// the base.
fn restored(mut base: Parameters, values: &[(u32, Value)], may_differ: fn(&Variable) -> bool) -> Result<Parameters, CallError> {
    if !values.is_sorted_by(|(before, _), (after, _)| before < after) {
        return Err(not_a_state("their parameters are not in ascending order"));
    }
    for &(reference, value) in values {
        let variable = lookup(reference, value.fmi_type())?;
        check_value(variable, value)?;
        let VariableId::Parameter(id) = variable.id else { return Err(not_a_state(&format!("{} is no parameter", variable.name))) };
        let field = bindings::parameter_mut(&mut base, id);
        let before = field.value();
        if !may_differ(variable) || before.same(value) || !field.set(value) {
            return Err(not_a_state(&format!("{} = {value} is no allowed change of {before}", variable.name)));
        }
    }
    Ok(base)
}

/// Returns the signal; refuses values outside their bounds and derivatives that lead to infinite values.
fn checked(signal: Signal) -> Result<Signal, CallError> {
    for (variable, input) in bindings::inputs() {
        check_value(variable, bindings::input(&signal.value, input).value())?;
    }
    let signal = Signal::new(signal.value, signal.derivatives());
    check_reach(&signal, 1.0)?;
    Ok(signal)
}
