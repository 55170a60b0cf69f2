//! The release library, built without paths of the building machine inside it.

use super::linked::{LIBRARY_CRATE, Linked};
use super::platform::Platform;
use crate::{paths, process};
use anyhow::{Context, Result, bail};
use cargo_metadata::{Message, PackageId};
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

pub(super) struct Library {
    /// Content of the file.
    pub(super) bytes: Vec<u8>,
    /// Every crate that cargo built, including build scripts and macros.
    pub(super) built: HashSet<PackageId>,
}

/// Builds the library for a machine.
pub(super) fn build(platform: &Platform, linked: &Linked) -> Result<Library> {
    let mut cargo = platform.cargo_rustc()?;
    // Only as cdylib: cargo skips link-time optimisation if it also builds an rlib.
    cargo
        .args(["--locked", "--package", LIBRARY_CRATE])
        .args(["--lib", "--crate-type", "cdylib"])
        .arg(process::MESSAGES)
        .env("CARGO_ENCODED_RUSTFLAGS", flags(platform, linked)?.join("\u{1f}"));
    let messages = process::run_for_output(&mut cargo)?;
    let (file, built) = artifacts(&messages, platform.extension)?;
    let bytes = fs::read(&file).with_context(|| format!("{} cannot be read", file.display()))?;
    for path in [paths::root(), &linked.target, &cargo_home()?] {
        if contains(&bytes, path.as_os_str().as_encoded_bytes()) {
            bail!("the library contains the path {} of this machine, although it was to be remapped", path.display());
        }
    }
    Ok(Library { bytes, built })
}

/// The caller's flags, then the platform's, then those that remove this machine's paths from the library.
fn flags(platform: &Platform, linked: &Linked) -> Result<Vec<String>> {
    let mut flags = match std::env::var("CARGO_ENCODED_RUSTFLAGS") {
        Ok(flags) if flags.is_empty() => Vec::new(),
        Ok(flags) => flags.split('\u{1f}').map(String::from).collect(),
        Err(_) => std::env::var("RUSTFLAGS").unwrap_or_default().split_whitespace().map(String::from).collect(),
    };
    flags.extend(platform.flags.iter().map(|&flag| flag.to_owned()));
    // Order matters if several prefixes match: rustc takes the last, so the most specific comes last.
    let mut remap = |from: &Path, to: &str| {
        flags.push(format!("--remap-path-prefix={}={to}", from.display()));
    };
    remap(&cargo_home()?, "/cargo");
    remap(paths::root(), "/fivebar");
    remap(&linked.target, "/fivebar/target");
    for crate_ in &linked.crates {
        // The parent folder is named after the registry's address, which may be a mirror.
        remap(&crate_.folder, &format!("/crates/{}", crate_.title));
    }
    Ok(flags)
}

fn cargo_home() -> Result<PathBuf> {
    std::env::var_os("CARGO_HOME")
        .map(PathBuf::from)
        .or_else(|| std::env::home_dir().map(|home| home.join(".cargo")))
        .context("neither CARGO_HOME nor a home folder is known")
}

/// The library file and all crates built, from cargo's messages.
fn artifacts(messages: &str, extension: &str) -> Result<(PathBuf, HashSet<PackageId>)> {
    let mut library = None;
    let mut built = HashSet::new();
    for message in Message::parse_stream(messages.as_bytes()) {
        let Message::CompilerArtifact(artifact) = message? else {
            continue;
        };
        built.insert(artifact.package_id);
        if artifact.target.name == LIBRARY_CRATE && artifact.target.is_cdylib() {
            library = artifact.filenames.into_iter().find(|file| file.extension() == Some(extension));
        }
    }
    let library = library.with_context(|| format!("cargo built no .{extension} of `{LIBRARY_CRATE}`"))?;
    Ok((library.into(), built))
}

/// Whether `bytes` contains `part`.
pub(super) fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}
