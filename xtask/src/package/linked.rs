//! The crates linked into the library, and the toolchain that builds it.

use super::platform::Platform;
use crate::{paths, process};
use anyhow::{Context, Result};
use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, Package, PackageId, TargetKind};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

/// The crate that becomes the library.
pub(super) const LIBRARY_CRATE: &str = "fivebar";

pub(super) struct Linked {
    /// The crates that may be linked into the library, without the library's own, sorted by name and version. They include optional
    /// crates that no enabled feature needs; only the build by cargo shows which ones are linked.
    pub(super) crates: Vec<LinkedCrate>,
    /// Cargo's target folder.
    pub(super) target: PathBuf,
    /// First line of `rustc --version`; this compiler's standard library is linked.
    pub(super) rustc: String,
}

/// A crate that may be linked into the library.
pub(super) struct LinkedCrate {
    /// Name used by cargo.
    pub(super) id: PackageId,
    /// Name and version, e.g. `libm-0.2.16`.
    pub(super) title: String,
    /// SPDX expression of its licence.
    pub(super) license: String,
    /// Folder of its sources.
    pub(super) folder: PathBuf,
}

impl Linked {
    /// Asks cargo, and the compiler that `rustc` returns.
    pub(super) fn read(rustc: impl Fn() -> Result<Command>, platforms: &[Platform]) -> Result<Self> {
        let version = process::output(rustc()?.arg("--version"))?;
        let mut options = vec!["--locked".to_owned()];
        for platform in platforms {
            let triple = match platform.cross {
                Some(triple) => triple.to_owned(),
                None => process::output(rustc()?.args(["--print", "host-tuple"]))?.trim().to_owned(),
            };
            options.extend(["--filter-platform".into(), triple]);
        }
        let metadata = MetadataCommand::new()
            .manifest_path(paths::in_root("Cargo.toml"))
            .other_options(options)
            .exec()
            .context("`cargo metadata` failed")?;
        Ok(Self {
            crates: linked_crates(&metadata)?,
            target: metadata.target_directory.clone().into_std_path_buf(),
            rustc: version.trim().to_owned(),
        })
    }
}

/// Follows the normal dependencies of the library's crate. Procedural macros run in the compiler and are not linked.
fn linked_crates(metadata: &Metadata) -> Result<Vec<LinkedCrate>> {
    let library = metadata
        .workspace_packages()
        .into_iter()
        .find(|package| package.name == LIBRARY_CRATE)
        .with_context(|| format!("the workspace has no crate `{LIBRARY_CRATE}`"))?;
    let mut seen = BTreeSet::from([library.id.clone()]);
    let mut waiting = vec![library.id.clone()];
    let mut crates = Vec::new();
    while let Some(id) = waiting.pop() {
        for next in normal_dependencies(metadata, &id)? {
            let package = &metadata[&next];
            let is_macro = package.targets.iter().any(|target| target.is_kind(TargetKind::ProcMacro));
            if !is_macro && seen.insert(next.clone()) {
                crates.push(linked_crate(package)?);
                waiting.push(next);
            }
        }
    }
    crates.sort_by(|a, b| a.title.cmp(&b.title));
    Ok(crates)
}

fn normal_dependencies(metadata: &Metadata, id: &PackageId) -> Result<Vec<PackageId>> {
    let resolve = metadata.resolve.as_ref().context("`cargo metadata` resolved no dependencies")?;
    Ok(resolve[id]
        .deps
        .iter()
        .filter(|dependency| dependency.dep_kinds.iter().any(|kind| kind.kind == DependencyKind::Normal))
        .map(|dependency| dependency.pkg.clone())
        .collect())
}

fn linked_crate(package: &Package) -> Result<LinkedCrate> {
    let title = format!("{}-{}", package.name, package.version);
    let license = package.license.clone().with_context(|| format!("crate {title} states no licence"))?;
    let folder = package
        .manifest_path
        .parent()
        .with_context(|| format!("crate {title} lies in no folder"))?
        .to_path_buf()
        .into_std_path_buf();
    Ok(LinkedCrate { id: package.id.clone(), title, license, folder })
}
