//! The scenes as Rust programs read them: values of variables by name, checked against `modelDescription.xml`.
//!
//! A file is an object: variable name → start value, enumerations by the names of their items, and four keys that are no
//! variables; `docs/scenes.md` describes them. A misspelt name, a value out of bounds or of the wrong type is refused in one
//! sentence. The library is not needed: programs that link it write the values into its parameters themselves. Users read scenes by
//! the package `fivebar`, in the tip's coordinates and with mounting angles of encoders too, which are refused here;
//! `tests/python/test_scene_readers.py` holds both readers to the same answers in all else.
//!
//! | file | holds |
//! | --- | --- |
//! | `parse.rs` | a file's keys, runs and experiment |
//! | `json.rs` | text → JSON in which no key stands twice |
//! | `names.rs` | variables by name, and those that a misspelt name may mean |
//! | `value.rs` | a value of the type that its variable has |
//! | `signal.rs` | inputs that change with time |
//! | `resolved.rs` | a scene with nothing left to look up |

mod json;
mod names;
mod parse;
mod resolved;
mod signal;
#[cfg(test)]
mod tests;
mod value;

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

pub use model_description::{Causality, Variable};
pub use signal::Signal;
pub use value::Value;

/// Bytes of a file, at most.
const LARGEST: u64 = 4_000_000;

/// Values that a run sets, by variable.
pub type Values = Vec<(&'static Variable, Value)>;

/// A file of `scenes/`.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Its name without the ending.
    pub name: String,
    /// Description, one sentence.
    pub description: String,
    /// How long it is to be followed, s.
    pub stop_time: f64,
    /// The communication step, s.
    pub step_size: f64,
    /// Values of the scene, in the order of the file.
    pub values: Values,
    /// Further runs, to compare with.
    pub overlays: Vec<Overlay>,
    /// Its inputs that change with time.
    pub signals: Vec<Signal>,
}

/// A further run of a scene.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// How pictures name it.
    pub label: String,
    /// Values of the run: the scene's values, but for those that it replaces.
    pub values: Values,
}

impl Scene {
    /// The scene of this name.
    pub fn read(name: &str) -> Result<Self> {
        Self::from_file(name, &folder().join(name).with_extension("json")).with_context(|| format!("scenes/{name}.json"))
    }

    /// The scene of any file, named after it.
    pub fn read_file(file: &Path) -> Result<Self> {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        Self::from_file(&name, file).with_context(|| file.display().to_string())
    }

    fn from_file(name: &str, file: &Path) -> Result<Self> {
        let mut text = String::new();
        File::open(file).and_then(|file| file.take(LARGEST + 1).read_to_string(&mut text)).context("it cannot be read")?;
        ensure!(text.len() as u64 <= LARGEST, "it has more than {LARGEST} bytes");
        // Editors of Windows put a byte order mark before a text.
        Self::parse(name, text.strip_prefix('\u{feff}').unwrap_or(&text))
    }

    /// All of them, by name.
    pub fn all() -> Result<Vec<Self>> {
        let entries = fs::read_dir(folder()).context("scenes/")?;
        let mut files: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
        files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
        files.sort();
        files.iter().filter_map(|file| file.file_stem()).map(|name| Self::read(&name.to_string_lossy())).collect()
    }

    /// The inputs that change, at a time, s.
    pub fn signals_at(&self, time: f64) -> impl Iterator<Item = (&'static Variable, Value)> {
        self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.at(time))))
    }

    /// The changing inputs, as the reference trajectories hold them over a millisecond, counted from 0: the doubles nearest to
    /// their values at its beginning.
    pub fn signals_held(&self, millisecond: u32) -> impl Iterator<Item = (&'static Variable, Value)> {
        self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.nearest(millisecond))))
    }
}

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
