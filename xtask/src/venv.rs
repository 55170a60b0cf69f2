//! The private Python environment `target/venv`: the package `fivebar` with all its extras, and groups of packages that commands need.
//!
//! `python/pyproject.toml` names the packages, `python/lock.txt` pins them with their hashes. `uv` installs them; pip, which comes with
//! Python, installs `uv`.

use crate::{paths, process};
use anyhow::{Context, Result, bail};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Name of Python 3 on the path.
const PYTHON: &str = if cfg!(windows) { "python" } else { "python3" };

/// The package, its dependencies and the dependency groups.
const PROJECT: &str = "python/pyproject.toml";

/// Every version that may be installed, with hashes.
const LOCK: &str = "python/lock.txt";

/// The pinned `uv`.
const UV: &str = "xtask/python/uv.txt";

/// Packages whose dependencies conflict with the lock. They are installed in a folder of their own, which one test adds to Python's path.
const APART: &str = "xtask/python/cofmupy.txt";

/// The groups of [`PROJECT`].
const GROUPS: [&str; 8] = ["test", "full", "platforms", "release", "site", "filters", "mujoco", "peers"];

/// Packages that a command needs beside `fivebar`, its extras and the group `test`.
#[derive(Clone, Copy)]
pub(crate) enum Packages {
    /// Nothing.
    Usual,
    /// Driver of browsers, other masters than FMPy.
    Full,
    /// These, and the builder of the site.
    Nightly,
    /// Linker and C libraries of other machines.
    Platforms,
    /// Validator of bills of materials.
    Release,
    /// Builder of the site.
    Site,
    /// Filters for comparison with the estimator.
    Filters,
    /// MuJoCo, which simulates a followed machine.
    Mujoco,
    /// Programs for comparison with the unit: large.
    Peers,
}

impl Packages {
    fn groups(self) -> &'static [&'static str] {
        match self {
            Self::Usual => &["test"],
            Self::Full => &["test", "full"],
            Self::Nightly => &["test", "full", "site"],
            Self::Platforms => &["test", "platforms"],
            Self::Release => &["test", "release"],
            Self::Site => &["test", "site"],
            Self::Filters => &["test", "filters"],
            Self::Mujoco => &["test", "mujoco"],
            Self::Peers => &["test", "peers"],
        }
    }
}

/// Python of the private environment. Makes or completes the environment if packages are missing or pins have changed.
pub(crate) fn python(packages: Packages) -> Result<Command> {
    let pins = pins()?;
    // Serialises commands that run at the same time.
    let guard = File::create(paths::in_root("target/venv.lock"))?;
    guard.lock()?;
    // The environment's Python is a symbolic link, which may dangle after an upgrade of the system.
    let has_python = folder().join(program("python")).exists();
    let is_installed = |group: &str| has_python && fs::read_to_string(stamp(group)).is_ok_and(|text| text == pins);
    for group in packages.groups() {
        if !is_installed(group) {
            if *group == "test" {
                make()?;
            }
            install(group)?;
            if *group == "full" {
                process::run(
                    uv_pip_install()?.args(["--no-deps", "--target"]).arg(apart()).arg("--requirements").arg(paths::in_root(APART)),
                )?;
            }
            fs::write(stamp(group), &pins).with_context(|| paths::short(&stamp(group)))?;
        }
    }
    let mut command = process::program(folder().join(program("python")));
    // The caller's Python settings must not affect the private environment. Without bytecode every process would compile all its imports,
    // one or two seconds of CPU.
    command.env_remove("PYTHONPATH").env_remove("PYTHONHOME").env_remove("PYTHONDONTWRITEBYTECODE");
    command.env("PYTHONPYCACHEPREFIX", paths::in_root("target/pycache"));
    Ok(command)
}

/// A program from a package of the environment.
pub(crate) fn installed(packages: Packages, name: &str) -> Result<Command> {
    python(packages)?;
    Ok(process::program(folder().join(program(name))))
}

/// Pins the newest allowed versions of all packages in [`LOCK`]; versions already pinned stay.
pub(crate) fn lock() -> Result<()> {
    let mut compile = uv()?;
    compile.args(["pip", "compile", "--quiet", "--universal", "--python-version", "3.11", "--generate-hashes", "--no-annotate"]);
    compile.args(["--all-extras", "--no-emit-package", "fivebar", "--custom-compile-command", "cargo xtask lock", PROJECT]);
    for group in GROUPS {
        compile.args(["--group", &format!("{PROJECT}:{group}")]);
    }
    process::run(compile.args(["--output-file", LOCK]).stdout(Stdio::null()))
}

/// The folder of installed packages.
pub(crate) fn site_packages(packages: Packages) -> Result<PathBuf> {
    let ask = "import sysconfig; print(sysconfig.get_path('purelib'))";
    Ok(process::output(python(packages)?.args(["-c", ask]))?.trim().into())
}

/// The folder of the packages in [`APART`].
pub(crate) fn apart() -> PathBuf {
    folder().join("cofmupy")
}

/// The pinned `uv`, installed first if missing. It uses its own Python and the machine's certificates.
pub(crate) fn uv() -> Result<Command> {
    let folder = folder_of_uv();
    let pin = fs::read_to_string(paths::in_root(UV)).context(UV)?;
    let stamp = folder.join("installed");
    if fs::read_to_string(&stamp).ok().as_ref() != Some(&pin) {
        make_for_uv(&folder)?;
        let mut pip = process::program(folder.join(program("python")));
        pip.args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--no-input",
            "--require-hashes",
            "--requirement",
        ]);
        process::run(pip.arg(paths::in_root(UV))).context("uv could not be installed")?;
        fs::write(&stamp, pin).with_context(|| paths::short(&stamp))?;
    }
    let mut uv = process::program(folder.join(program("uv")));
    uv.env("UV_SYSTEM_CERTS", "1").env("UV_PYTHON_DOWNLOADS", "never");
    Ok(uv)
}

fn uv_pip_install() -> Result<Command> {
    let mut uv = uv()?;
    uv.args(["pip", "install", "--quiet", "--python"]).arg(folder().join(program("python")));
    Ok(uv)
}

/// Replaces an old environment by an empty one, so that packages no longer named disappear.
fn make() -> Result<()> {
    println!("making a private Python environment in {}", paths::short(&folder()));
    process::run(uv()?.args(["venv", "--quiet", "--clear", "--python"]).arg(folder_of_uv().join(program("python"))).arg(folder()))
}

/// Installs a group; with the group `test` also the package itself (editable) with all its extras.
fn install(group: &str) -> Result<()> {
    println!("installing the Python packages of the group `{group}` (first run, or the pins have changed)");
    let mut install = uv_pip_install()?;
    install.args(["--constraints", LOCK, "--build-constraints", LOCK, "--group", &format!("{PROJECT}:{group}")]);
    if group == "test" {
        install.args(["--editable", "python[all,cluster]"]);
    }
    process::run(&mut install).context("the Python packages could not be installed")
}

/// Makes the separate environment of `uv`.
fn make_for_uv(folder: &Path) -> Result<()> {
    need_python()?;
    if process::output(process::program(PYTHON).args(["-m", "venv", "--clear"]).arg(folder)).is_err() {
        bail!(
            "`{PYTHON} -m venv` failed: Python's module venv (with ensurepip) is needed; \
             on Debian and Ubuntu `apt-get install python3-venv` brings it"
        );
    }
    Ok(())
}

/// Fails if Python is older than 3.11, the oldest for which the pinned packages exist.
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

fn folder_of_uv() -> PathBuf {
    paths::in_root("target/uv")
}

fn folder() -> PathBuf {
    paths::in_root("target/venv")
}

/// Path of a program inside an environment.
fn program(name: &str) -> PathBuf {
    if cfg!(windows) { Path::new("Scripts").join(name).with_extension("exe") } else { Path::new("bin").join(name) }
}

/// File with the pins of an installed group; missing after an interrupted installation.
fn stamp(group: &str) -> PathBuf {
    folder().join(group).with_extension("installed")
}

/// All inputs of an installation. The package's version is the workspace's; its place is the checkout.
fn pins() -> Result<String> {
    let mut pins = format!("version {} in {}\n", env!("CARGO_PKG_VERSION"), paths::root().display());
    for file in [PROJECT, LOCK, APART, UV] {
        pins += &fs::read_to_string(paths::in_root(file)).context(file)?;
    }
    Ok(pins)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_group_is_one_of_the_project() {
        let project = fs::read_to_string(paths::in_root(PROJECT)).unwrap();
        let all = [
            Packages::Usual,
            Packages::Full,
            Packages::Nightly,
            Packages::Platforms,
            Packages::Release,
            Packages::Site,
            Packages::Filters,
            Packages::Mujoco,
            Packages::Peers,
        ];
        for group in all.iter().flat_map(|packages| packages.groups()) {
            assert!(GROUPS.contains(group) && project.contains(&format!("\n{group} = [")), "{group}");
        }
    }

    #[test]
    fn every_package_of_the_lock_has_a_hash() {
        let lock = fs::read_to_string(paths::in_root(LOCK)).unwrap();
        let packages = lock.lines().filter(|line| line.starts_with(char::is_alphanumeric)).count();
        assert!(packages > 50 && lock.matches(" \\\n    --hash=sha256:").count() >= packages);
    }
}
