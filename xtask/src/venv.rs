//! The private Python environments under `target/`, made from pinned requirements.

use crate::{paths, process};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The name under which a Python 3 is on the path.
const PYTHON: &str = if cfg!(windows) { "python" } else { "python3" };

/// Packages that need another version of one of the others: in a folder of their own within the environment, which only those see who
/// put it on Python's path.
const APART: &str = "xtask/python/requirements-cofmupy.txt";

/// The package that users have in Python: installed where it lies, so that a change of it needs no new installation.
const OWN: &str = "python/pyproject.toml";

/// Sets of packages in the environment; each file is a pinned closure, but that of the package `fivebar`.
#[derive(Clone, Copy)]
pub(crate) enum Packages {
    /// The package `fivebar` with its extras, and packages of the Python tests.
    Usual,
    /// Also packages of the tests in a browser and with other masters.
    Full,
    /// Also packages that build libraries for other machines.
    Platforms,
    /// Also the package that judges a bill of materials.
    Release,
    /// Also the filters that the estimator is compared with.
    Filters,
    /// Also MuJoCo, which simulates a machine that is followed.
    Mujoco,
    /// The package `fivebar` and packages of the comparison with peers: large, and in an environment of its own.
    Peers,
}

impl Packages {
    fn files(self) -> &'static [&'static str] {
        const USUAL: &str = "xtask/python/requirements.txt";
        const TWIN: &str = "xtask/python/requirements-twin.txt";
        match self {
            Self::Usual => &[USUAL, TWIN, OWN],
            Self::Full => &[USUAL, TWIN, OWN, "xtask/python/requirements-full.txt", APART],
            Self::Platforms => &[USUAL, TWIN, OWN, "xtask/python/requirements-platforms.txt"],
            Self::Release => &[USUAL, TWIN, OWN, "xtask/python/requirements-release.txt"],
            Self::Filters => &[USUAL, TWIN, OWN, "xtask/python/requirements-filters.txt"],
            Self::Mujoco => &[USUAL, TWIN, OWN, "xtask/python/requirements-mujoco.txt"],
            Self::Peers => &["xtask/python/requirements-peers.txt", OWN],
        }
    }

    fn folder(self) -> PathBuf {
        match self {
            Self::Usual | Self::Full | Self::Platforms | Self::Release | Self::Filters | Self::Mujoco => {
                paths::in_root("target/venv")
            }
            Self::Peers => paths::in_root("target/venv-peers"),
        }
    }
}

/// Python of the private environment, which is made, renewed or completed first where the requirements ask for it.
pub(crate) fn python(packages: Packages) -> Result<Command> {
    let folder = packages.folder();
    let python = folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let requirements = packages.files().iter().map(|file| Requirements::read(file, &folder)).collect::<Result<Vec<_>>>()?;
    let outdated = requirements.iter().any(|file| file.state() == State::Changed);
    if outdated || requirements[0].state() == State::Missing {
        make(&folder)?;
    }
    for file in requirements.iter().filter(|file| file.state() == State::Missing) {
        file.install(&python)?;
    }
    let mut command = process::program(python);
    // Python's own settings of the caller must not reach into the private environment. Without bytecode every process would compile all
    // that it imports, a second of CPU or two.
    command.env_remove("PYTHONPATH").env_remove("PYTHONHOME").env_remove("PYTHONDONTWRITEBYTECODE");
    command.env("PYTHONPYCACHEPREFIX", paths::in_root("target/pycache"));
    Ok(command)
}

/// The folder that the packages are installed in.
pub(crate) fn site_packages(packages: Packages) -> Result<PathBuf> {
    let ask = "import sysconfig; print(sysconfig.get_path('purelib'))";
    Ok(process::output(python(packages)?.args(["-c", ask]))?.trim().into())
}

/// The folder of the packages that are kept apart.
pub(crate) fn apart() -> PathBuf {
    Packages::Full.folder().join("cofmupy")
}

/// A file of requirements and its copy as installed.
struct Requirements {
    file: &'static str,
    text: String,
    /// Written after the installation: one that was interrupted has none.
    stamp: PathBuf,
}

#[derive(Debug, PartialEq)]
enum State {
    Missing,
    Changed,
    Installed,
}

impl Requirements {
    fn read(file: &'static str, folder: &Path) -> Result<Self> {
        let path = Path::new(file);
        let mut text = fs::read_to_string(paths::in_root(file)).with_context(|| format!("{file} cannot be read"))?;
        // The package goes by its folder, and is installed anew under a new version, which is the workspace's.
        let name = if file == OWN {
            text += concat!("# version ", env!("CARGO_PKG_VERSION"), "\n");
            path.parent().and_then(Path::file_name)
        } else {
            path.file_stem()
        };
        let name = name.unwrap_or_default();
        Ok(Self { file, text, stamp: folder.join(name).with_extension("installed") })
    }

    fn state(&self) -> State {
        match fs::read_to_string(&self.stamp) {
            Ok(text) if text == self.text => State::Installed,
            Ok(_) => State::Changed,
            Err(_) => State::Missing,
        }
    }

    fn install(&self, python: &Path) -> Result<()> {
        println!("installing the Python packages of {} (first run, or the file changed)", self.file);
        let mut pip = process::program(python);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"])
            // Only packages of the file, for each is a closure; modules that are never imported are not compiled.
            .args(["--no-deps", "--no-compile"]);
        let file = paths::in_root(self.file);
        match self.file {
            // The build backend is among the packages of the pinned closures.
            OWN => pip.args(["--no-build-isolation", "--editable"]).arg(file.parent().context("a package lies in a folder")?),
            APART => pip.arg("--requirement").arg(file).arg("--target").arg(apart()),
            _ => pip.arg("--requirement").arg(file),
        };
        process::run(&mut pip).context("the Python packages could not be installed")?;
        fs::write(&self.stamp, &self.text).with_context(|| format!("{} cannot be written", paths::short(&self.stamp)))
    }
}

/// Makes an empty environment in place of the one there may be: packages that are no longer required go, a broken one is mended.
fn make(folder: &Path) -> Result<()> {
    need_python()?;
    println!("making a private Python environment in {}", paths::short(folder));
    if process::output(process::program(PYTHON).args(["-m", "venv", "--clear"]).arg(folder)).is_err() {
        bail!(
            "`{PYTHON} -m venv` failed: Python's module venv (with ensurepip) is needed; \
             on Debian and Ubuntu `apt-get install python3-venv` brings it"
        );
    }
    Ok(())
}

/// The oldest Python for which the pinned packages exist is 3.11.
fn need_python() -> Result<()> {
    let found = process::program(PYTHON)
        .args(["-c", "import sys; sys.exit(sys.version_info < (3, 11))"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !found {
        bail!("`{PYTHON}` with version 3.11 or newer is needed on the path");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stamp_tells_whether_a_file_is_installed() {
        let folder = tempfile::tempdir().unwrap();
        let requirements = Requirements::read(Packages::Usual.files()[0], folder.path()).unwrap();
        assert_eq!(requirements.state(), State::Missing);
        fs::write(&requirements.stamp, "fmpy==0.0.1\n").unwrap();
        assert_eq!(requirements.state(), State::Changed);
        fs::write(&requirements.stamp, &requirements.text).unwrap();
        assert_eq!(requirements.state(), State::Installed);
    }

    #[test]
    fn each_file_of_requirements_has_a_stamp_of_its_own() {
        let folder = Path::new("venv");
        let stamps: Vec<_> = Packages::Full.files().iter().map(|file| Requirements::read(file, folder).unwrap().stamp).collect();
        let names = ["requirements", "requirements-twin", "python", "requirements-full", "requirements-cofmupy"];
        assert_eq!(stamps, names.map(|name| folder.join(name).with_extension("installed")));
    }
}
