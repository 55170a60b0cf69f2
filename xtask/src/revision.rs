//! Units of other revisions, packed from their own sources, for comparisons of two builds.

use crate::{paths, process};
use anyhow::{Context, Result};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Folder with the builds of other revisions; they are kept.
const FOLDER: &str = "target/compare";

/// The unit of a revision. Packs it from its own sources if this was not done before.
pub(crate) fn packed(revision: &str) -> Result<PathBuf> {
    pack(revision).with_context(|| format!("revision {revision} could not be packed"))
}

fn pack(revision: &str) -> Result<PathBuf> {
    let commit = format!("{revision}^{{commit}}");
    let hash = process::output(process::program("git").args(["rev-parse", "--short=12", "--verify", "--end-of-options", &commit]))?;
    let folder = paths::in_root(FOLDER).join(hash.trim());
    let fmu = folder.join("target/fmu/FiveBar.fmu");
    if !fmu.is_file() {
        if !folder.is_dir() {
            check_out(hash.trim(), &folder)?;
        }
        let packed = process::run(
            process::cargo()
                .args(["run", "--quiet", "--locked", "--package", "xtask", "--", "package"])
                .current_dir(&folder)
                // One folder for all revisions, so that external crates are built once.
                .env("CARGO_TARGET_DIR", paths::in_root(FOLDER).join("cargo")),
        );
        // A revision may refuse its own unit, such as for the size that another compiler gives its library. It runs all the same.
        let refused = fmu.with_extension("unverified");
        if packed.is_err() && refused.is_file() {
            println!("revision {revision} refuses its own unit, which is used all the same");
            return Ok(refused);
        }
        packed?;
    }
    Ok(fmu)
}

/// Writes the files of a commit to `folder`, without a worktree in `.git`.
fn check_out(commit: &str, folder: &Path) -> Result<()> {
    let unfinished = folder.with_extension("unfinished");
    let archive = folder.with_extension("zip");
    fs::create_dir_all(paths::in_root(FOLDER))?;
    process::run(process::program("git").args(["archive", "--format=zip", "--output"]).arg(&archive).arg(commit))?;
    unpack(&archive, &unfinished)?;
    fs::remove_file(&archive)?;
    // The folder gets its final name last, so that an interrupted checkout is never used.
    fs::rename(&unfinished, folder).with_context(|| format!("{} cannot be written", paths::short(folder)))
}

/// Writes the files of a zip archive, such as a .fmu, to a folder, which is emptied before.
pub(crate) fn unpack(archive: &Path, folder: &Path) -> Result<()> {
    let file = File::open(archive).with_context(|| format!("{} cannot be read", paths::short(archive)))?;
    if folder.is_dir() {
        fs::remove_dir_all(folder).with_context(|| format!("{} cannot be emptied", paths::short(folder)))?;
    }
    ZipArchive::new(file)?.extract(folder).with_context(|| format!("{} cannot be unpacked", paths::short(archive)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    /// A folder has the files of the last archive alone, such as the one library of the last unit.
    #[test]
    fn unpacking_leaves_nothing_of_another_archive() {
        let folder = tempfile::tempdir().unwrap();
        let packed = |name: &str| {
            let file = folder.path().join(name).with_extension("zip");
            let mut archive = ZipWriter::new(File::create(&file).unwrap());
            archive.start_file(format!("binaries/{name}"), SimpleFileOptions::default()).unwrap();
            archive.write_all(name.as_bytes()).unwrap();
            archive.finish().unwrap();
            file
        };
        let (one, two, out) = (packed("one"), packed("two"), folder.path().join("out"));
        unpack(&one, &out).unwrap();
        unpack(&two, &out).unwrap();
        assert_eq!(fs::read_to_string(out.join("binaries/two")).unwrap(), "two");
        assert!(!out.join("binaries/one").exists());
        assert!(unpack(&folder.path().join("three.zip"), &out).unwrap_err().to_string().contains("three.zip cannot be read"));
    }
}
