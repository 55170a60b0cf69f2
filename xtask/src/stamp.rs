//! Stamps of made files: the hash of the sources that they were made from. A wheel takes the site and the live page only if they are current.

use crate::{paths, process};
use anyhow::{Context, Result};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// Name of the stamp in the folder of the made files.
const NAME: &str = "sources.sha256";

/// What became of a made file.
#[derive(Debug, PartialEq)]
pub(crate) enum State {
    Missing,
    /// Made from other sources than the present ones, or without a stamp.
    Old,
    Current,
}

/// Writes the stamp of sources into the folder of the files that were made from them.
pub(crate) fn write(folder: &Path, sources: &str) -> Result<()> {
    let file = folder.join(NAME);
    fs::write(&file, sources).with_context(|| paths::short(&file))
}

/// Compares the stamp beside a made file with the present sources.
pub(crate) fn state(made: &Path, sources: &str) -> State {
    if !made.is_file() {
        return State::Missing;
    }
    match fs::read_to_string(made.with_file_name(NAME)) {
        Ok(stamp) if stamp == sources => State::Current,
        _ => State::Old,
    }
}

/// The hash of all files of the repository below `folders` (`.` is all), with those that git does not know yet and without ignored ones, and
/// of more files, which may be missing.
pub(crate) fn sources(folders: &[&str], more: &[&Path]) -> Result<String> {
    let mut list = process::program("git");
    list.args(["ls-files", "-z", "--cached", "--others", "--exclude-standard", "--"]).args(folders);
    let listed = process::output(&mut list)?;
    let names: BTreeSet<&str> = listed.split_terminator('\0').collect();
    hash(names.into_iter().map(Path::new).chain(more.iter().copied()), paths::root())
}

/// The hash of names and contents of files in a folder. A missing file counts as absent: git lists deleted ones until a commit.
fn hash<'a>(names: impl Iterator<Item = &'a Path>, root: &Path) -> Result<String> {
    let mut hasher = Sha256::new();
    for name in names {
        let content = match fs::read(root.join(name)) {
            Ok(content) => content,
            Err(error) if error.kind() == ErrorKind::NotFound => continue,
            Err(error) => return Err(error).with_context(|| name.display().to_string()),
        };
        for part in [name.as_os_str().as_encoded_bytes(), &content] {
            hasher.update(u64::try_from(part.len())?.to_le_bytes());
            hasher.update(part);
        }
    }
    let mut digits = String::new();
    for byte in hasher.finalize() {
        write!(digits, "{byte:02x}").expect("writing to a string does not fail");
    }
    digits.push('\n');
    Ok(digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_made_file_is_current_until_its_sources_change() {
        let folder = tempfile::tempdir().unwrap();
        let made = folder.path().join("index.html");
        assert_eq!(state(&made, "a"), State::Missing);
        fs::write(&made, "").unwrap();
        assert_eq!(state(&made, "a"), State::Old, "without a stamp");
        write(folder.path(), "a").unwrap();
        assert_eq!(state(&made, "a"), State::Current);
        assert_eq!(state(&made, "b"), State::Old);
    }

    #[test]
    fn the_hash_has_names_contents_and_absence() {
        let folder = tempfile::tempdir().unwrap();
        let of = |names: &[&str]| hash(names.iter().map(Path::new), folder.path()).unwrap();
        fs::write(folder.path().join("a"), "bc").unwrap();
        let first = of(&["a", "b"]);
        assert_eq!((first.len(), of(&["a"])), (65, first.clone()), "a missing file is absent");
        fs::write(folder.path().join("b"), "").unwrap();
        let second = of(&["a", "b"]);
        fs::write(folder.path().join("a"), "b").unwrap();
        let third = of(&["a", "b"]);
        assert!(first != second && second != third);
    }

    #[test]
    fn the_sources_of_the_repository_are_listed() {
        let all = sources(&["."], &[]).unwrap();
        assert_eq!(sources(&["."], &[Path::new("no such file")]).unwrap(), all);
        assert_ne!(sources(&["docs"], &[]).unwrap(), all);
    }
}
