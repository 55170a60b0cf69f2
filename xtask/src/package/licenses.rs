//! `documentation/licenses/` (FMI 2.0.4, section 2.3): licences of the project and of everything linked in.

use super::Files;
use super::linked::{Linked, LinkedCrate};
use crate::paths;
use anyhow::{Context, Result, bail};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const FOLDER: &str = "documentation/licenses";

/// The project's own licence files, in the workspace root.
const OWN: [&str; 2] = ["LICENSE-APACHE", "LICENSE-MIT"];

/// All licence files, including `runtime` (name in the folder of licences, file), and `license.txt`, which lists the parts under each
/// licence.
pub(super) fn collect(linked: &Linked, runtime: &[(&str, PathBuf)]) -> Result<Files> {
    let mut files = Files::new();
    for name in OWN {
        let text = fs::read(paths::in_root(name)).with_context(|| format!("{name} cannot be read"))?;
        files.insert(format!("{FOLDER}/{name}.txt"), text);
    }
    for crate_ in &linked.crates {
        files.extend(of_crate(crate_)?);
    }
    for (name, file) in runtime {
        files.insert(format!("{FOLDER}/{name}"), fs::read(file).with_context(|| format!("{} cannot be read", file.display()))?);
    }
    files.insert(format!("{FOLDER}/license.txt"), summary(linked, runtime).into_bytes());
    Ok(files)
}

/// The licence files in the sources of a crate. A crate without one is refused, because its licence text could not be passed on.
fn of_crate(crate_: &LinkedCrate) -> Result<Files> {
    let mut files = Files::new();
    for entry in fs::read_dir(&crate_.folder).with_context(|| format!("the sources of crate {} cannot be read", crate_.title))? {
        let path = entry?.path();
        if path.is_file() && is_license(&path) {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            files.insert(
                format!("{FOLDER}/{}/{name}", crate_.title),
                fs::read(&path).with_context(|| format!("{name} of crate {} cannot be read", crate_.title))?,
            );
        }
    }
    if files.is_empty() {
        bail!("crate {} ({}) brings no licence file", crate_.title, crate_.license);
    }
    Ok(files)
}

fn is_license(file: &Path) -> bool {
    const STARTS: [&str; 6] = ["LICENSE", "LICENCE", "UNLICENSE", "COPYING", "COPYRIGHT", "NOTICE"];
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
    STARTS.iter().any(|start| name.starts_with(start))
}

fn summary(linked: &Linked, runtime: &[(&str, PathBuf)]) -> String {
    let mut text = String::from(
        "FiveBar is licensed under either of LICENSE-MIT.txt and LICENSE-APACHE.txt, at your choice.\n\
         \n\
         Its library is linked with the crates below; the licence files of each are in the folder of its name.\n\
         Where a crate offers a choice that includes Apache-2.0, it is used under Apache-2.0.\n\
         \n",
    );
    for crate_ in &linked.crates {
        writeln!(text, "    {:24} {}", crate_.title, crate_.license).expect("writing to a string does not fail");
    }
    write!(
        text,
        "\n\
         The standard library of {} is linked as well: copyright the Rust Project contributors,\n\
         licensed under MIT OR Apache-2.0 (the text of Apache-2.0 is LICENSE-APACHE.txt).\n",
        linked.rustc
    )
    .expect("writing to a string does not fail");
    if !runtime.is_empty() {
        text.push_str("\nLicences in it, and of what the linker adds for each machine:\n\n");
        for (name, _) in runtime {
            writeln!(text, "    {name}").expect("writing to a string does not fail");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use cargo_metadata::PackageId;

    #[test]
    fn licence_files_are_recognised_by_name() {
        for name in ["LICENSE", "LICENSE-MIT.md", "license.txt", "COPYING", "NOTICE"] {
            assert!(is_license(Path::new(name)), "{name}");
        }
        for name in ["README.md", "Cargo.toml", "my-license"] {
            assert!(!is_license(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn a_crate_without_a_licence_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let crate_ = LinkedCrate {
            id: PackageId { repr: "bare".into() },
            title: "bare-1.0.0".into(),
            license: "MIT".into(),
            folder: folder.path().into(),
        };
        let error = of_crate(&crate_).unwrap_err().to_string();
        assert_eq!(error, "crate bare-1.0.0 (MIT) brings no licence file");
    }
}
