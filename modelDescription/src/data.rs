//! A model description as plain data.

/// A checked model description.
#[derive(Clone, Debug)]
pub struct ModelDescription {
    /// Text of the XML file.
    pub xml: String,
    /// Name of the model.
    pub model_name: String,
    /// Description of the model, one sentence.
    pub description: String,
    /// Name of the library file and of the .fmu.
    pub model_identifier: String,
    /// Number of event indicators.
    pub event_indicators: usize,
    /// Default experiment.
    pub experiment: Experiment,
    /// Units, in the order of the file.
    pub units: Vec<Unit>,
    /// Declared types, in the order of the file.
    pub types: Vec<SimpleType>,
    /// Log categories, in the order of the file.
    pub categories: Vec<Category>,
    /// Variables, in the order of the file.
    pub variables: Vec<Variable>,
    /// Model structure: unknowns with their dependencies.
    pub structure: Structure,
}

impl ModelDescription {
    /// Names of the continuous states: variables with a derivative among the other variables.
    pub fn states(&self) -> Vec<&str> {
        self.variables.iter().filter_map(|variable| variable.derivative_of.as_deref()).collect()
    }
}

/// Length and communication step of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Experiment {
    /// End, s.
    pub stop_time: f64,
    /// Communication step, s.
    pub step_size: f64,
}

/// A unit of measurement.
#[derive(Clone, Debug)]
pub struct Unit {
    /// Name, e.g. `rad/s`.
    pub name: String,
    /// Names of the units in which values may be shown, e.g. `deg/s`.
    pub display_units: Vec<String>,
}

/// A type that variables refer to.
#[derive(Clone, Debug)]
pub struct SimpleType {
    /// Name.
    pub name: String,
    /// Description; empty if there is none.
    pub description: String,
    /// Kind of the type.
    pub kind: TypeKind,
}

/// Kind of a declared type.
#[derive(Clone, Debug)]
pub enum TypeKind {
    /// Real, with its unit and display unit.
    Real {
        /// Name of the unit.
        unit: Option<String>,
        /// Name of the display unit.
        display_unit: Option<String>,
    },
    /// Integer.
    Integer,
    /// Boolean.
    Boolean,
    /// Enumeration with its items.
    Enumeration(Enumeration),
}

/// The items of an enumeration.
#[derive(Clone, Debug)]
pub struct Enumeration {
    /// Items, in the order of the file.
    pub items: Vec<Item>,
}

/// One item of an enumeration.
#[derive(Clone, Debug)]
pub struct Item {
    /// Name.
    pub name: String,
    /// Number of the item in calls.
    pub value: i32,
    /// Description; empty if there is none.
    pub description: String,
}

/// A log category.
#[derive(Clone, Debug)]
pub struct Category {
    /// Name.
    pub name: String,
    /// Description; empty if there is none.
    pub description: String,
}

/// A variable.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Name, whole and in parts.
    pub name: Name,
    /// Value reference.
    pub reference: u32,
    /// Description.
    pub description: String,
    /// Role.
    pub causality: Causality,
    /// Variability.
    pub variability: Variability,
    /// How the start value is determined; inputs have none.
    pub initial: Option<Initial>,
    /// Type, start and bounds.
    pub kind: Kind,
    /// Name of the declared type.
    pub declared_type: Option<String>,
    /// Name of the unit of the declared type.
    pub unit: Option<String>,
    /// Name of the state, if this variable is its time derivative.
    pub derivative_of: Option<String>,
}

impl Variable {
    /// Whether the variable is a derivative that shares the value of another variable under a second name.
    pub fn is_alias(&self) -> bool {
        self.derivative_of.is_some()
    }

    /// Whether the library computes the value: outputs and local variables.
    pub fn is_computed(&self) -> bool {
        matches!(self.causality, Causality::Output | Causality::Local)
    }
}

/// A structured name, e.g. `link[2].length`: family `link.length`, index 1 (0-based).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    /// Name as written in the XML.
    pub full: String,
    /// Name without the index.
    pub family: String,
    /// 0-based index, if the name has one.
    pub index: Option<usize>,
}

/// Smallest and largest value allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds<T> {
    /// Smallest value.
    pub min: Option<T>,
    /// Largest value.
    pub max: Option<T>,
}

/// Type of a variable with its start value and bounds.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// Real.
    Real {
        /// Start value.
        start: Option<f64>,
        /// Bounds.
        bounds: Bounds<f64>,
    },
    /// Integer.
    Integer {
        /// Start value.
        start: Option<i32>,
        /// Bounds.
        bounds: Bounds<i32>,
    },
    /// Boolean.
    Boolean {
        /// Start value.
        start: Option<bool>,
    },
    /// Enumeration; the declared type has the items.
    Enumeration {
        /// Start value: the number of an item.
        start: Option<i32>,
    },
}

impl Kind {
    /// Name of the XML element.
    pub fn label(&self) -> &'static str {
        match self {
            Self::Real { .. } => "Real",
            Self::Integer { .. } => "Integer",
            Self::Boolean { .. } => "Boolean",
            Self::Enumeration { .. } => "Enumeration",
        }
    }

    /// Whether a start value is given.
    pub fn has_start(&self) -> bool {
        match self {
            Self::Real { start, .. } => start.is_some(),
            Self::Integer { start, .. } | Self::Enumeration { start } => start.is_some(),
            Self::Boolean { start } => start.is_some(),
        }
    }
}

/// Role of a variable (FMI 2.0.4, section 2.2.7), restricted to the roles of this project.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Causality {
    /// Set before the run.
    Parameter,
    /// Set by the master at communication points.
    Input,
    /// Read by the master and connected.
    Output,
    /// Read by the master, not meant for connections.
    Local,
}

/// Variability of a variable (FMI 2.0.4, section 2.2.7), restricted to the kinds of this project.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variability {
    /// Constant after initialisation.
    Fixed,
    /// Constant between changes by the master.
    Tunable,
    /// Constant between communication points.
    Discrete,
    /// Unrestricted.
    Continuous,
}

/// How the start value is determined (FMI 2.0.4, section 2.2.7), restricted to the kinds of this project.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initial {
    /// The start value is given.
    Exact,
    /// Computed from other variables.
    Calculated,
}

/// `<ModelStructure>`, by names.
#[derive(Clone, Debug)]
pub struct Structure {
    /// Outputs with their dependencies.
    pub outputs: Vec<Unknown>,
    /// Derivatives of the continuous states with their dependencies.
    pub derivatives: Vec<Unknown>,
    /// Outputs, continuous states and derivatives with their dependencies at initialisation.
    pub initial_unknowns: Vec<Unknown>,
}

impl Structure {
    /// The unknowns of an element of `<ModelStructure>`; `None` for any other element.
    pub(crate) fn section(&self, tag: &str) -> Option<&[Unknown]> {
        match tag {
            "Outputs" => Some(&self.outputs),
            "Derivatives" => Some(&self.derivatives),
            "InitialUnknowns" => Some(&self.initial_unknowns),
            _ => None,
        }
    }
}

/// An unknown and the known variables on which it depends.
#[derive(Clone, Debug)]
pub struct Unknown {
    /// Name of the unknown.
    pub name: String,
    /// Names of inputs and continuous states; at initialisation, of parameters and inputs.
    pub dependencies: Vec<String>,
}
