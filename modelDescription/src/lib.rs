//! The FMI model description: parsed, checked and completed.
//!
//! `modelDescription.xml` beside this crate is the only place with a variable's name, reference, unit, start value and text.
//! [`ModelDescription::read`] turns it into plain data and refuses violations of FMI 2.0 and of this project's rules. `build.rs` makes the
//! tables of `src/variables` from the data, and `cargo xtask package` packs the text of [`ModelDescription::to_fmi`].
//!
//! | file | content |
//! | --- | --- |
//! | `data.rs` | the plain data |
//! | `element.rs` | XML text → tree of elements |
//! | `parse.rs` | tree → data |
//! | `names.rs` | the structured naming convention |
//! | `check.rs` | consistency rules |
//! | `fmi.rs` | data + text → modelDescription.xml of the .fmu |
//! | `edit.rs` | edits of the text |

mod check;
mod data;
mod edit;
mod element;
mod fmi;
mod names;
mod parse;

use std::fmt;

pub use data::{
    Bounds, Category, Causality, Enumeration, Experiment, Initial, Item, Kind, ModelDescription, Name, SimpleType, Structure,
    TypeKind, Unit, Unknown, Variability, Variable,
};

/// The text of `modelDescription/modelDescription.xml`.
pub const XML: &str = include_str!("../modelDescription.xml");

/// The first violation in a model description: one sentence with the variable, its value and the values allowed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error(pub String);

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

impl ModelDescription {
    /// Parses and checks [`XML`].
    pub fn read() -> Result<Self, Error> {
        Self::parse(XML)
    }

    /// Parses and checks the text of a model description in this project's form (see the comment at the top of the XML).
    pub fn parse(xml: &str) -> Result<Self, Error> {
        let description = parse::description(xml)?;
        check::check(&description)?;
        Ok(description)
    }

    /// The GUID that ties the .fmu's XML to its binary: a UUID (version 5) of the XML text, in braces. Both sides derive it from the same
    /// text, so neither can change without the other.
    pub fn guid(&self) -> String {
        // The version 5 UUID of "FiveBar" in the namespace of URLs; any constant would do.
        const NAMESPACE: uuid::Uuid = uuid::uuid!("3729f55c-2054-5fb9-9560-16e0a330d502");
        format!("{{{}}}", uuid::Uuid::new_v5(&NAMESPACE, self.xml.as_bytes()))
    }
}
