//! A stored state as bytes (FMI 2.0.4, section 2.1.8).
//!
//! ```text
//! offset  bytes  what
//!      0      8  "FiveBar\0"
//!      8      4  FORMAT, the version of this layout
//!     12     38  GUID of the unit
//!     50      8  length n of the content
//!     58      n  the content: `Content` in the Borsh format (https://borsh.io)
//! 58 + n      4  Adler-32 of all before it
//! ```
//!
//! `Followed` comes after `Content` where samples have been set or a machine is followed; elsewhere the file ends with `Content`.
//! Numbers are little-endian, reals IEEE 754 doubles; there are no pointers, and nothing depends on the process or the platform.
//! Parameters are stored as values of variables, so that restored values pass the same checks as values set by a master.

use std::io::{self, Read, Write};

use borsh::{BorshDeserialize, BorshSerialize};

use super::bindings::{self, Field};
use super::clock::Clock;
use super::derivatives::check_reach;
use super::snapshot::{Next, Scene};
use super::values::{check_value, lookup};
use super::{CallError, Guid, Kind, Snapshot, Stage};
use crate::estimator::Measured;
use crate::mechanism::SceneError;
use crate::simulation::{Estimate, Following, Inputs, ORDERS, Parameters, Run, Signal, Simulation};
use crate::variables::{Value, Variable, VariableId};

const MAGIC: [u8; 8] = *b"FiveBar\0";
/// Version of the layout; changes with every change of the stored data.
const FORMAT: u32 = 16;
const HEAD: usize = MAGIC.len() + size_of::<u32>() + size_of::<Guid>() + size_of::<u64>();
const CHECKSUM: usize = size_of::<u32>();

/// Bytes still to be read. A type of its own keeps the reader of slices from being inlined into some hundred fields.
struct ByteReader<'a>(&'a [u8]);

impl Read for ByteReader<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into)
    }

    #[inline(never)]
    fn read_exact(&mut self, into: &mut [u8]) -> io::Result<()> {
        self.0.read_exact(into)
    }
}

/// Bytes written so far. A type of its own keeps the growth of a vector from being inlined into every field.
struct ByteWriter(Vec<u8>);

impl Write for ByteWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    #[inline(never)]
    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Stored state of an instance, without samples and estimate.
#[derive(BorshSerialize, BorshDeserialize)]
struct Content {
    stage: Stage,
    kind: Kind,
    clock: Option<Clock>,
    /// Parameters in force.
    values: Values,
    run: Option<Run>,
    /// Values and derivatives of [`Next::signal`].
    signal: Option<(Inputs, [Inputs; ORDERS])>,
    /// Values of [`Next::parameters`].
    tuned: Option<Values>,
    warned_of_references: bool,
    warned_of_stiffness: bool,
}

/// Samples and estimate, stored after the content where a machine is followed.
#[derive(BorshDeserialize)]
struct Followed {
    measured: Measured,
    /// Boxed, so that a state without an estimate does not move its size.
    estimate: Option<Box<Estimate>>,
}

/// Values of parameters by ascending value reference, without those at their start values.
type Values = Vec<(u32, Value)>;

impl Snapshot {
    /// Serialises the state.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CallError> {
        // Order of the fields of `Followed`.
        let estimate = self.scene.following().map(Following::estimate);
        let content = Content {
            stage: self.stage,
            kind: self.kind,
            clock: self.clock.clone(),
            values: values(self.scene.parameters()),
            run: self.scene.simulation().map(|simulation| simulation.run().clone()),
            signal: self.next.signal.map(|signal| (signal.value, signal.derivatives())),
            tuned: self.next.parameters.as_ref().map(values),
            warned_of_references: self.warned_of_references,
            warned_of_stiffness: self.warned_of_stiffness,
        };
        let mut written = ByteWriter(Vec::new());
        let all = content.serialize(&mut written).and_then(|()| match is_default(&self.measured, estimate.is_some()) {
            true => Ok(()),
            false => (self.measured, estimate).serialize(&mut written),
        });
        all.map_err(|error| CallError::error(format!("the state cannot be serialised: {error}.")))?;
        let ByteWriter(content) = written;
        let length = content.len() as u64;
        let mut bytes = [&MAGIC[..], &FORMAT.to_le_bytes(), &self.guid, &length.to_le_bytes(), &content].concat();
        bytes.extend(adler2::adler32_slice(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// Restores a state of the unit with this GUID, or refuses it in one sentence. A forged state is refused, or is some motion that closes
    /// the loop and can be continued.
    #[cold]
    pub fn from_bytes(guid: &Guid, bytes: &[u8]) -> Result<Self, CallError> {
        let (content, followed) = parse_content(content(guid, bytes)?)
            .map_err(|error| not_a_state(&format!("their content cannot be decoded: {error}")))?;
        let Content { stage, kind, clock, values, run, signal, tuned, warned_of_references, warned_of_stiffness } = content;
        let parameters = restored(&values)?;
        let next = Next { signal: signal.map(restored_signal).transpose()?, parameters: restored_tuned(tuned, &parameters)? };
        if let Some(clock) = &clock {
            clock.check(kind)?;
        }
        let scene = match (stage, run) {
            (Stage::Instantiated | Stage::InitializationMode, None) if next.parameters.is_none() && followed.estimate.is_none() => {
                Scene::Draft(parameters)
            }
            (
                Stage::StepComplete | Stage::StepFailed | Stage::EventMode | Stage::ContinuousTimeMode | Stage::Terminated,
                Some(run),
            ) if stage.belongs_to(kind) && run.is_model_exchange() == (kind == Kind::ModelExchange) => {
                let refusal = |error: SceneError| not_a_state(&error.to_string());
                match (parameters.estimator.enabled, followed.estimate) {
                    (false, None) => Scene::Ready(Box::new(Simulation::restored(&parameters, run).map_err(refusal)?)),
                    (true, Some(estimate)) => {
                        let following = Following::restored(&parameters, run, *estimate);
                        Scene::Following(Box::new(following.map_err(refusal)?))
                    }
                    (false, Some(_)) => return Err(not_a_state("they hold an estimate, but estimator.enabled is false")),
                    (true, None) => return Err(not_a_state("estimator.enabled is true, but the estimate is missing")),
                }
            }
            _ => return Err(not_a_state(&format!("their state is \"{stage}\", but they hold data of another state"))),
        };
        if clock.is_none() && stage != Stage::Instantiated {
            return Err(not_a_state(&format!("their state is \"{stage}\", but the clock is missing")));
        }
        let measured = followed.measured;
        Ok(Self { kind, guid: *guid, stage, clock, scene, next, measured, warned_of_references, warned_of_stiffness })
    }
}

/// Whether no sample has been set and nothing is estimated, so that `Followed` is not stored.
fn is_default(measured: &Measured, estimates: bool) -> bool {
    !estimates && measured.same(&Measured::default())
}

/// Parses the content and, where there is one, `Followed`.
fn parse_content(bytes: &[u8]) -> io::Result<(Content, Followed)> {
    let mut rest = ByteReader(bytes);
    let content = Content::deserialize_reader(&mut rest)?;
    if rest.0.is_empty() {
        return Ok((content, Followed { measured: Measured::default(), estimate: None }));
    }
    let followed = Followed::deserialize_reader(&mut rest)?;
    if !rest.0.is_empty() {
        return Err(io::Error::other("bytes follow the last field"));
    }
    if is_default(&followed.measured, followed.estimate.is_some()) {
        return Err(io::Error::other("samples at their start values, which are never stored"));
    }
    Ok((content, followed))
}

fn not_a_state(what: &str) -> CallError {
    CallError::error(format!("the bytes are not a state of this FMU: {what}."))
}

/// The content, after head, length and checksum have been checked.
fn content<'a>(of: &Guid, bytes: &'a [u8]) -> Result<&'a [u8], CallError> {
    if bytes.len() < HEAD + CHECKSUM {
        return Err(not_a_state(&format!("there are {}, fewer than the {} of head and checksum", bytes.len(), HEAD + CHECKSUM)));
    }
    let (magic, rest) = bytes.split_at(MAGIC.len());
    let (format, rest) = rest.split_at(size_of::<u32>());
    let (guid, rest) = rest.split_at(size_of::<Guid>());
    let (length, _) = rest.split_at(size_of::<u64>());
    if magic != MAGIC {
        return Err(not_a_state("they do not begin with FiveBar"));
    }
    if format != FORMAT.to_le_bytes() {
        return Err(not_a_state(&format!("their format is not {FORMAT}: another version has written them")));
    }
    if guid != of {
        return Err(not_a_state("they belong to another GUID: another unit or version has written them"));
    }
    if length != ((bytes.len() - HEAD - CHECKSUM) as u64).to_le_bytes() {
        return Err(not_a_state(&format!("there are {}, which is not the length in their head", bytes.len())));
    }
    let (checked, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
    if checksum != adler2::adler32_slice(checked).to_le_bytes() {
        return Err(not_a_state("their checksum is wrong"));
    }
    Ok(&checked[HEAD..])
}

/// Values of parameters that are not at their start values.
fn values(parameters: &Parameters) -> Values {
    let all = bindings::parameters().map(|(variable, id)| (variable, bindings::parameter(parameters, id).value()));
    all.filter(|(variable, value)| !is_start(variable, *value)).map(|(variable, value)| (variable.reference, value)).collect()
}

/// Whether a value is the start value of its variable, to the bit.
fn is_start(variable: &Variable, value: Value) -> bool {
    match (variable.start, value) {
        (Some(Value::Real(start)), Value::Real(value)) => start.to_bits() == value.to_bits(),
        (start, value) => start == Some(value),
    }
}

/// Parameters with these values, each within its bounds; the others at their start values.
fn restored(values: &[(u32, Value)]) -> Result<Parameters, CallError> {
    if !values.is_sorted_by(|(before, _), (after, _)| before < after) {
        return Err(not_a_state("their parameters are not in ascending order"));
    }
    let mut parameters = bindings::default_parameters();
    for &(reference, value) in values {
        let variable = lookup(reference, value.fmi_type())?;
        check_value(variable, value)?;
        let VariableId::Parameter(id) = variable.id else { return Err(not_a_state(&format!("{} is no parameter", variable.name))) };
        if is_start(variable, value) || !bindings::parameter_mut(&mut parameters, id).set(value) {
            return Err(not_a_state(&format!("{} = {value} is not allowed", variable.name)));
        }
    }
    Ok(parameters)
}

/// Parameters that differ from those in force in tunable ones only.
fn restored_tuned(tuned: Option<Values>, in_force: &Parameters) -> Result<Option<Parameters>, CallError> {
    let Some(values) = tuned else { return Ok(None) };
    let tuned = restored(&values)?;
    for (variable, id) in bindings::parameters().filter(|(variable, _)| !variable.tunable) {
        let [before, after] = [in_force, &tuned].map(|parameters| bindings::parameter(parameters, id).value());
        if before != after {
            return Err(not_a_state(&format!(
                "{} = {after} is not allowed during the run: it is fixed at {before}",
                variable.name
            )));
        }
    }
    Ok(Some(tuned))
}

/// Input signal with finite values within the bounds.
fn restored_signal((value, derivatives): (Inputs, [Inputs; ORDERS])) -> Result<Signal, CallError> {
    for (variable, input) in bindings::inputs() {
        check_value(variable, bindings::input(&value, input).value())?;
    }
    let signal = Signal::new(value, derivatives);
    check_reach(&signal, 1.0)?;
    Ok(signal)
}
