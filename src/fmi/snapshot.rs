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
use super::{Rejection, Stage, bindings};
use crate::simulation::{self, Inputs, ORDERS, Parameters, Signal, Simulation, Solve};
use crate::variables::{GUID, Value};

const MAGIC: [u8; 8] = *b"FiveBar\0";
/// Must change with every change of what is stored.
const FORMAT: u32 = 3;
const HEAD: usize = MAGIC.len() + size_of::<u32>() + GUID.len() + size_of::<u64>();
const CHECKSUM: usize = size_of::<u32>();

/// Everything that an instance holds but its log: a stored state.
#[derive(Clone, Debug)]
pub struct Snapshot {
    pub(super) stage: Stage,
    pub(super) parameters: Parameters,
    /// The inputs from the present communication point on.
    pub(super) signal: Signal,
    /// Set by fmi2SetupExperiment.
    pub(super) clock: Option<Clock>,
    /// Made at the end of initialisation, or earlier when an output is read there.
    pub(super) simulation: Option<Box<Simulation>>,
    /// Whether a tunable parameter has changed since the last step: the next one makes it act.
    pub(super) tuned: bool,
    /// Whether the master has been told that no active effect reads the servo references.
    pub(super) warned_of_references: bool,
    /// Whether it has been told that the loads are stiff.
    pub(super) warned_of_stiffness: bool,
}

/// What the bytes hold.
#[derive(BorshSerialize, BorshDeserialize)]
struct Content {
    stage: Stage,
    /// Parameters and inputs as the master has set them.
    values: Vec<(u32, Value)>,
    input_derivatives: [Inputs; ORDERS],
    clock: Option<Clock>,
    simulation: Option<Made>,
    tuned: bool,
    warned_of_references: bool,
    warned_of_stiffness: bool,
}

/// A scene made ready.
#[derive(BorshSerialize, BorshDeserialize)]
struct Made {
    /// The parameters that it runs with: tunable ones may have been set since, and act from the next step.
    values: Vec<(u32, Value)>,
    solve: Solve,
    state: simulation::State,
}

impl Snapshot {
    /// That of an instance just made.
    pub(super) fn fresh() -> Self {
        Self {
            stage: Stage::Instantiated,
            parameters: bindings::default_parameters(),
            signal: Signal::held(bindings::default_inputs()),
            clock: None,
            simulation: None,
            tuned: false,
            warned_of_references: false,
            warned_of_stiffness: false,
        }
    }

    /// Becomes what `other` is. Where both hold a simulation it allocates nothing.
    pub fn copy(&mut self, other: &Self) {
        let Self { stage, parameters, signal, clock, simulation, tuned, warned_of_references, warned_of_stiffness } = other;
        self.stage = *stage;
        self.parameters.clone_from(parameters);
        self.signal = *signal;
        self.clock.clone_from(clock);
        self.simulation.clone_from(simulation);
        self.tuned = *tuned;
        self.warned_of_references = *warned_of_references;
        self.warned_of_stiffness = *warned_of_stiffness;
    }

    /// The state as bytes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Rejection> {
        let made = |simulation: &Simulation| Made {
            values: values(simulation.parameters(), &self.signal.value),
            solve: simulation.model().solve,
            state: simulation.stored_state(),
        };
        let content = Content {
            stage: self.stage,
            values: values(&self.parameters, &self.signal.value),
            input_derivatives: self.signal.derivatives(),
            clock: self.clock.clone(),
            simulation: match self.stage {
                // Before the run it is there only if somebody has looked, and looking changes nothing.
                Stage::Instantiated | Stage::InitializationMode => None,
                Stage::StepComplete | Stage::StepFailed | Stage::Terminated => self.simulation.as_deref().map(made),
            },
            tuned: self.tuned,
            warned_of_references: self.warned_of_references,
            warned_of_stiffness: self.warned_of_stiffness,
        };
        let content =
            borsh::to_vec(&content).map_err(|error| Rejection::error(format!("the state cannot be serialised: {error}.")))?;
        let length = content.len() as u64;
        let mut bytes = [&MAGIC[..], &FORMAT.to_le_bytes(), GUID.as_bytes(), &length.to_le_bytes(), &content].concat();
        bytes.extend(adler2::adler32_slice(&bytes).to_le_bytes());
        Ok(bytes)
    }

    /// The state that bytes hold, or one sentence that says what is wrong with them.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let content =
            Content::try_from_slice(content(bytes)?).map_err(|error| wrong(&format!("their content is not a state: {error}")))?;
        let (parameters, value) = restored(&content.values)?;
        let signal = Signal::new(value, content.input_derivatives);
        check_reach(&signal, 1.0)?;
        let simulation = match content.simulation {
            Some(Made { values, solve, state }) => Some(Box::new(Simulation::restored(&restored(&values)?.0, solve, state)?)),
            None => None,
        };
        let Content { stage, clock, tuned, warned_of_references, warned_of_stiffness, .. } = content;
        let whole = match stage {
            Stage::Instantiated => true,
            Stage::InitializationMode => clock.is_some(),
            Stage::StepComplete | Stage::StepFailed | Stage::Terminated => clock.is_some() && simulation.is_some(),
        };
        if !whole {
            return Err(wrong(&format!("they say \"{stage}\", and what belongs to it is missing")));
        }
        Ok(Self { stage, parameters, signal, clock, simulation, tuned, warned_of_references, warned_of_stiffness })
    }
}

fn wrong(what: &str) -> Rejection {
    Rejection::error(format!("the bytes are not a state of this FMU: {what}."))
}

/// The content, where head, length and checksum are right.
fn content(bytes: &[u8]) -> Result<&[u8], Rejection> {
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

/// The values of all parameters and inputs.
fn values(parameters: &Parameters, inputs: &Inputs) -> Vec<(u32, Value)> {
    let (mut parameters, mut inputs) = (parameters.clone(), *inputs);
    bindings::settable().filter_map(|v| Some((v.reference, bindings::read(&mut parameters, &mut inputs, v)?))).collect()
}

/// Parameters and inputs with these values, each within its bounds, none left out.
fn restored(values: &[(u32, Value)]) -> Result<(Parameters, Inputs), Rejection> {
    let (mut parameters, mut inputs) = (bindings::default_parameters(), bindings::default_inputs());
    if !values.iter().map(|(reference, _)| *reference).eq(bindings::settable().map(|variable| variable.reference)) {
        return Err(wrong("they do not hold every parameter and input once"));
    }
    for &(reference, value) in values {
        let variable = lookup(reference, value.access())?;
        check_value(variable, value)?;
        if !bindings::write(&mut parameters, &mut inputs, variable, value) {
            return Err(wrong(&format!("{} is not {value}", variable.name)));
        }
    }
    Ok((parameters, inputs))
}
