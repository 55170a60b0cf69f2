//! Stored states: everything that an instance holds but its log, in memory and as bytes (FMI 2.0.4, section 2.1.8).
//!
//! ```text
//! offset  bytes  what
//!      0      8  "FiveBar\0"
//!      8      4  FORMAT, the version of this layout
//!     12     38  GUID of the model description
//!     50      8  length n of the content
//!     58      n  the content: `Content` in the Borsh format (https://borsh.io)
//! 58 + n      4  Adler-32 of all before it
//! ```
//!
//! Numbers are little-endian, reals IEEE 754 doubles; there are no pointers, and nothing depends on the process or the platform.
//! The parameters are stored as values of variables, so that what is read back passes the same checks as what a master sets.

use borsh::{BorshDeserialize, BorshSerialize};

use super::clock::Clock;
use super::derivatives::check_reach;
use super::values::{check_value, lookup};
use super::{CallError, Stage, bindings};
use crate::simulation::{Inputs, ORDERS, Parameters, Residuals, Run, Signal, Simulation};
use crate::variables::{GUID, Value, Variable, VariableId};

const MAGIC: [u8; 8] = *b"FiveBar\0";
/// Must change with every change of what is stored.
const FORMAT: u32 = 6;
const HEAD: usize = MAGIC.len() + size_of::<u32>() + GUID.len() + size_of::<u64>();
const CHECKSUM: usize = size_of::<u32>();

/// Everything that an instance holds but its log: a stored state.
#[derive(Clone, Debug)]
pub struct Snapshot {
    pub(super) stage: Stage,
    /// Set by fmi2SetupExperiment.
    pub(super) clock: Option<Clock>,
    pub(super) scene: Scene,
    pub(super) next: Next,
    /// Whether the master has been told that no active effect reads the servo references.
    pub(super) warned_of_references: bool,
    /// Whether it has been told that the loads are stiff.
    pub(super) warned_of_stiffness: bool,
}

/// The scene, before and after the end of initialisation.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "to set a parameter allocates nothing")]
pub(super) enum Scene {
    /// Its parameters as the master sets them.
    Draft(Parameters),
    /// Made ready, with parameters and inputs in force.
    Ready(Box<Simulation>),
}

/// What the master has set and what acts from the present communication point on.
#[derive(Clone, Debug, Default)]
pub(super) struct Next {
    /// Inputs, where they are not those that are held.
    pub(super) signal: Option<Signal>,
    /// Parameters, where a tunable one has been set.
    pub(super) parameters: Option<Parameters>,
}

impl Next {
    /// A step of `size` seconds has been made: parameters act, and inputs that have changed are where they have led to.
    #[inline(always)]
    pub(super) fn after_step(&mut self, size: f64) {
        self.parameters = None;
        if self.signal.is_some() {
            self.take_held_inputs();
            if let Some(signal) = &mut self.signal {
                signal.end(size);
            }
        }
    }

    /// The simulation holds these inputs now, unless they change.
    pub(super) fn take_held_inputs(&mut self) {
        self.signal.take_if(|signal| signal.is_held());
    }
}

/// What the bytes hold.
#[derive(BorshSerialize, BorshDeserialize)]
struct Content {
    stage: Stage,
    clock: Option<Clock>,
    /// Parameters in force.
    values: Values,
    run: Option<StoredRun>,
    /// [`Next::signal`]: values and derivatives.
    signal: Option<(Inputs, [Inputs; ORDERS])>,
    /// [`Next::parameters`].
    tuned: Option<Values>,
    warned_of_references: bool,
    warned_of_stiffness: bool,
}

/// Values of parameters by their references.
type Values = Vec<(u32, Value)>;

/// A scene made ready.
#[derive(BorshSerialize, BorshDeserialize)]
struct StoredRun {
    run: Run,
    /// Energies and forces have to add up to them.
    residuals: Residuals,
}

impl Snapshot {
    /// That of an instance just made.
    pub(super) fn fresh() -> Self {
        Self {
            stage: Stage::Instantiated,
            clock: None,
            scene: Scene::Draft(bindings::default_parameters()),
            next: Next::default(),
            warned_of_references: false,
            warned_of_stiffness: false,
        }
    }

    /// Becomes what `other` is. Where both hold a simulation it allocates nothing.
    pub fn copy(&mut self, other: &Self) {
        let Self { stage, clock, scene, next, warned_of_references, warned_of_stiffness } = other;
        self.stage = *stage;
        self.clock.clone_from(clock);
        match (&mut self.scene, scene) {
            (Scene::Ready(own), Scene::Ready(other)) => own.clone_from(other),
            (own, other) => *own = other.clone(),
        }
        self.next.clone_from(next);
        self.warned_of_references = *warned_of_references;
        self.warned_of_stiffness = *warned_of_stiffness;
    }

    /// The inputs from the present communication point on.
    pub(super) fn signal(&self) -> Signal {
        self.next.signal.unwrap_or_else(|| Signal::held(self.inputs()))
    }

    /// Their values there.
    pub(super) fn inputs(&self) -> Inputs {
        match (&self.next.signal, &self.scene) {
            (Some(signal), _) => signal.value,
            (None, Scene::Draft(_)) => bindings::default_inputs(),
            (None, Scene::Ready(simulation)) => *simulation.inputs(),
        }
    }

    /// The parameters as the master has set them.
    fn parameters(&self) -> &Parameters {
        match (&self.next.parameters, &self.scene) {
            (Some(parameters), _) | (None, Scene::Draft(parameters)) => parameters,
            (None, Scene::Ready(simulation)) => simulation.parameters(),
        }
    }

    /// The present value of a parameter or input; `None` for an output.
    pub(super) fn read(&self, variable: &Variable) -> Option<Value> {
        match variable.id {
            VariableId::RealInput(input) => Some(Value::Real(*bindings::real_input(&mut self.inputs(), input))),
            _ if variable.start.is_none() => None,
            _ => bindings::read_parameter(&mut self.parameters().clone(), variable),
        }
    }

    /// Sets a parameter or input to a value that has been checked.
    pub(super) fn set(&mut self, variable: &Variable, value: Value) {
        let written = match (variable.id, value, &mut self.scene) {
            (VariableId::RealInput(input), Value::Real(value), _) => {
                let held = self.inputs();
                let signal = self.next.signal.get_or_insert_with(|| Signal::held(held));
                *bindings::real_input(&mut signal.value, input) = value;
                true
            }
            (_, value, Scene::Draft(parameters)) => bindings::write_parameter(parameters, variable, value),
            (_, value, Scene::Ready(simulation)) => {
                let next = self.next.parameters.get_or_insert_with(|| simulation.parameters().clone());
                bindings::write_parameter(next, variable, value)
            }
        };
        if !written {
            unreachable!("{} = {value} has been checked", variable.name);
        }
    }

    /// The state as bytes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CallError> {
        let (parameters, run) = match &self.scene {
            Scene::Draft(parameters) => (parameters, None),
            Scene::Ready(simulation) => {
                let stored = StoredRun { run: simulation.run().clone(), residuals: simulation.residuals() };
                (simulation.parameters(), Some(stored))
            }
        };
        let content = Content {
            stage: self.stage,
            clock: self.clock.clone(),
            values: values(parameters),
            run,
            signal: self.next.signal.map(|signal| (signal.value, signal.derivatives())),
            tuned: self.next.parameters.as_ref().map(values),
            warned_of_references: self.warned_of_references,
            warned_of_stiffness: self.warned_of_stiffness,
        };
        let content =
            borsh::to_vec(&content).map_err(|error| CallError::error(format!("the state cannot be serialised: {error}.")))?;
        let length = content.len() as u64;
        let mut bytes = [&MAGIC[..], &FORMAT.to_le_bytes(), GUID.as_bytes(), &length.to_le_bytes(), &content].concat();
        bytes.extend(adler2::adler32_slice(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// The state that bytes hold, or one sentence that says what is wrong with them. Whatever in them follows from the parameters has to
    /// be what these give, and the rest has to be a motion that can go on.
    #[cold]
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CallError> {
        let content =
            Content::try_from_slice(content(bytes)?).map_err(|error| wrong(&format!("their content is not a state: {error}")))?;
        let Content { stage, clock, values, run, signal, tuned, warned_of_references, warned_of_stiffness } = content;
        let parameters = restored(&values)?;
        let next = Next { signal: signal.map(restored_signal).transpose()?, parameters: restored_tuned(tuned, &values)? };
        if let Some(clock) = &clock {
            clock.check()?;
        }
        let scene = match (stage, run) {
            (Stage::Instantiated | Stage::InitializationMode, None) if next.parameters.is_none() => Scene::Draft(parameters),
            (Stage::StepComplete | Stage::StepFailed | Stage::Terminated, Some(StoredRun { run, residuals })) => {
                let simulation = Simulation::restored(&parameters, run, &residuals);
                Scene::Ready(Box::new(simulation.map_err(|error| wrong(&error.to_string()))?))
            }
            _ => return Err(wrong(&format!("they say \"{stage}\", and what belongs to it is missing or too much"))),
        };
        if clock.is_none() && stage != Stage::Instantiated {
            return Err(wrong(&format!("they say \"{stage}\", and the clock is missing")));
        }
        Ok(Self { stage, clock, scene, next, warned_of_references, warned_of_stiffness })
    }
}

fn wrong(what: &str) -> CallError {
    CallError::error(format!("the bytes are not a state of this FMU: {what}."))
}

/// The content, where head, length and checksum are right.
fn content(bytes: &[u8]) -> Result<&[u8], CallError> {
    if bytes.len() < HEAD + CHECKSUM {
        return Err(wrong(&format!("there are {}, and the head alone has {HEAD}", bytes.len())));
    }
    let (magic, rest) = bytes.split_at(MAGIC.len());
    let (format, rest) = rest.split_at(size_of::<u32>());
    let (guid, rest) = rest.split_at(GUID.len());
    let (length, _) = rest.split_at(size_of::<u64>());
    if magic != MAGIC {
        return Err(wrong("they do not begin with its name"));
    }
    if format != FORMAT.to_le_bytes() {
        return Err(wrong(&format!("their format is not {FORMAT}, another version has written them")));
    }
    if guid != GUID.as_bytes() {
        return Err(wrong("they belong to another GUID, another version has written them"));
    }
    if length != ((bytes.len() - HEAD - CHECKSUM) as u64).to_le_bytes() {
        return Err(wrong(&format!("there are {}, not as many as their head says", bytes.len())));
    }
    let (checked, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
    if checksum != adler2::adler32_slice(checked).to_le_bytes() {
        return Err(wrong("their checksum is wrong"));
    }
    Ok(&checked[HEAD..])
}

/// The values of all parameters.
fn values(parameters: &Parameters) -> Values {
    let mut parameters = parameters.clone();
    bindings::parameters().filter_map(|v| Some((v.reference, bindings::read_parameter(&mut parameters, v)?))).collect()
}

/// Parameters with these values, each within its bounds, none left out.
fn restored(values: &[(u32, Value)]) -> Result<Parameters, CallError> {
    let mut parameters = bindings::default_parameters();
    if !values.iter().map(|(reference, _)| *reference).eq(bindings::parameters().map(|variable| variable.reference)) {
        return Err(wrong("they do not hold every parameter once"));
    }
    for &(reference, value) in values {
        let variable = lookup(reference, value.fmi_type())?;
        check_value(variable, value)?;
        if !bindings::write_parameter(&mut parameters, variable, value) {
            return Err(wrong(&format!("{} is not {value}", variable.name)));
        }
    }
    Ok(parameters)
}

/// Parameters that differ from those in force in tunable ones only.
fn restored_tuned(tuned: Option<Values>, in_force: &[(u32, Value)]) -> Result<Option<Parameters>, CallError> {
    let Some(values) = tuned else { return Ok(None) };
    for (&(reference, value), &(_, before)) in values.iter().zip(in_force) {
        let variable = lookup(reference, value.fmi_type())?;
        if !variable.tunable && value != before {
            return Err(wrong(&format!("{} = {value} is fixed, and is {before}", variable.name)));
        }
    }
    restored(&values).map(Some)
}

/// Inputs that stay finite, each within its bounds.
fn restored_signal((value, derivatives): (Inputs, [Inputs; ORDERS])) -> Result<Signal, CallError> {
    let mut inputs = value;
    for (variable, input) in bindings::inputs() {
        check_value(variable, Value::Real(*bindings::real_input(&mut inputs, input)))?;
    }
    let signal = Signal::new(value, derivatives);
    check_reach(&signal, 1.0)?;
    Ok(signal)
}
