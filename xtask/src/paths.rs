//! Paths relative to the workspace root.

use std::path::{Path, PathBuf};

/// The workspace root: the parent of this crate's folder.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in a folder of the workspace")
}

pub(crate) fn in_root(path: impl AsRef<Path>) -> PathBuf {
    root().join(path)
}

/// A path for messages: relative to the workspace root if it lies below it.
pub(crate) fn short(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

/// The packed unit `name`, for this machine.
pub(crate) fn fmu(name: &str) -> PathBuf {
    in_root("target/fmu").join(name).with_extension("fmu")
}

/// The packed unit `name`, with a library for every shipped platform.
pub(crate) fn fmu_for_all_platforms(name: &str) -> PathBuf {
    in_root("target/fmu/all-platforms").join(name).with_extension("fmu")
}

/// The live page as a single file.
pub(crate) fn page() -> PathBuf {
    in_root("target/page/fivebar.html")
}

/// Installation folder of the master fmi-sim.
pub(crate) fn fmi_sim() -> PathBuf {
    in_root("target/fmi-sim")
}

/// The folder with one JSON file per scene.
pub(crate) fn scenes() -> PathBuf {
    in_root("scenes")
}
