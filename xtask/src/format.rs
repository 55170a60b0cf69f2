//! `cargo xtask format`: rustfmt over every .rs file of the repository.
//!
//! `cargo fmt` follows `mod` declarations in the source text and cannot see modules declared inside a macro.

use crate::{paths, process};
use anyhow::{Context, Result, ensure};
use std::path::PathBuf;
use walkdir::{DirEntry, WalkDir};

/// Formats every .rs file; with `check`, only fails if a file is not formatted.
pub(crate) fn format(check: bool) -> Result<()> {
    let files = rust_files()?;
    println!("$ rustfmt {}({} files)", if check { "--check " } else { "" }, files.len());
    let mut rustfmt = process::program("rustfmt");
    rustfmt.args(["--edition", "2024"]).args(check.then_some("--check")).args(&files);
    let status = rustfmt.status().context("`rustfmt` could not be started: `rustup component add rustfmt` installs it")?;
    ensure!(status.success(), "some files are not formatted: `cargo xtask format` formats them");
    Ok(())
}

/// Every .rs file below the workspace root, except in `target/` and hidden folders.
fn rust_files() -> Result<Vec<PathBuf>> {
    let is_source = |entry: &DirEntry| {
        let name = entry.file_name().to_string_lossy();
        entry.depth() == 0 || !name.starts_with('.') && (entry.depth() > 1 || name != "target")
    };
    let mut files = Vec::new();
    for entry in WalkDir::new(paths::root()).sort_by_file_name().into_iter().filter_entry(is_source) {
        let path = entry?.into_path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_modules_declared_by_a_macro_are_found() {
        let files = rust_files().expect("files");
        for file in ["src/effects/viscous.rs", "src/lib.rs", "xtask/src/format.rs"] {
            assert!(files.contains(&paths::in_root(file)), "{file}");
        }
        assert!(!files.iter().any(|file| file.starts_with(paths::in_root("target"))));
    }
}
