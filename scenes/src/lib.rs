//! Scenes for Rust programs: values of variables by name, checked against `modelDescription.xml`.
//!
//! A file is an object from variable names to start values, with enumerations by the names of their items, and four other keys;
//! `docs/scenes.md` describes them. A misspelt name, a value out of bounds or a value of the wrong type is refused in one sentence. The
//! crate does not link the library: programs that do write the values into its parameters themselves. Users read scenes with the package
//! `fivebar`, which also takes tip coordinates and encoder offsets; they are refused here. `tests/python/test_scene_readers.py` checks that
//! both readers agree in everything else.
//!
//! | file | content |
//! | --- | --- |
//! | `parse.rs` | keys, runs and experiment of a file |
//! | `json.rs` | text → JSON without duplicate keys |
//! | `names.rs` | variables by name, and suggestions for misspelt names |
//! | `value.rs` | a value of the type of its variable |
//! | `signal.rs` | inputs that change with time |
//! | `resolved.rs` | a scene with all names and units resolved |

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

/// Largest size of a file, bytes.
const LARGEST: u64 = 4_000_000;

/// Values that a run sets, by variable.
pub type Values = Vec<(&'static Variable, Value)>;

/// A scene: a file of `scenes/` or of a user.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the file without its extension.
    pub name: String,
    /// Description, one sentence.
    pub description: String,
    /// Length of the run, s.
    pub stop_time: f64,
    /// Communication step, s.
    pub step_size: f64,
    /// Values of the scene, in the order of the file.
    pub values: Values,
    /// Further runs for comparison.
    pub overlays: Vec<Overlay>,
    /// Inputs that change with time.
    pub signals: Vec<Signal>,
}

/// A further run of a scene.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// Label in pictures.
    pub label: String,
    /// Values of the run: the scene's values, with some of them replaced.
    pub values: Values,
}

impl Scene {
    /// Reads the scene of this name from `scenes/`; refuses a file that cannot be read or is not a scene.
    pub fn read(name: &str) -> Result<Self> {
        Self::from_file(name, &folder().join(name).with_extension("json")).with_context(|| format!("scenes/{name}.json"))
    }

    /// Reads a scene from any file, and names it after the file; refuses a file that cannot be read or is not a scene.
    pub fn read_file(file: &Path) -> Result<Self> {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        Self::from_file(&name, file).with_context(|| file.display().to_string())
    }

    fn from_file(name: &str, file: &Path) -> Result<Self> {
        let mut text = String::new();
        File::open(file).and_then(|file| file.take(LARGEST + 1).read_to_string(&mut text)).context("it cannot be read")?;
        ensure!(text.len() as u64 <= LARGEST, "it has more than {LARGEST} bytes");
        // Editors on Windows put a byte order mark before the text.
        Self::parse(name, text.strip_prefix('\u{feff}').unwrap_or(&text))
    }

    /// Reads all scenes of `scenes/`, sorted by name.
    pub fn all() -> Result<Vec<Self>> {
        let entries = fs::read_dir(folder()).context("scenes/")?;
        let mut files: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
        files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
        files.sort();
        files.iter().filter_map(|file| file.file_stem()).map(|name| Self::read(&name.to_string_lossy())).collect()
    }

    /// Values of the changing inputs at a time, s.
    pub fn signals_at(&self, time: f64) -> impl Iterator<Item = (&'static Variable, Value)> {
        self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.at(time))))
    }

    /// Values of the changing inputs that the reference trajectories keep constant over a millisecond, counted from 0: the doubles nearest
    /// to the values at its beginning.
    pub fn signals_held(&self, millisecond: u32) -> impl Iterator<Item = (&'static Variable, Value)> {
        self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.nearest(millisecond))))
    }
}

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
