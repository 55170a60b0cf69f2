//! Runs other programs: prints each command first, and names it in the error if it fails.

use crate::paths;
use anyhow::{Context, Result, bail, ensure};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

/// Makes cargo tell on its standard output which files it builds.
pub(crate) const MESSAGES: &str = "--message-format=json-render-diagnostics";

/// The cargo that runs this xtask, so that a toolchain chosen on the command line stays chosen.
pub(crate) fn cargo() -> Command {
    program(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Command of a program in the workspace root.
pub(crate) fn program(name: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(name);
    command.current_dir(paths::root());
    command
}

/// Prints the command, runs it with this process's input and output, and fails if it fails.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    println!("$ {}", short_form(command));
    let status = command.status().with_context(|| format!("`{}` could not be started", short_form(command)))?;
    check(&short_form(command), status)
}

/// Prints the command and replaces this process by it, if the system can, so that it alone gets Ctrl-C and the terminal; elsewhere runs it.
pub(crate) fn become_program(command: &mut Command) -> Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt;
        println!("$ {}", short_form(command));
        Err(command.exec()).with_context(|| format!("`{}` could not be started", short_form(command)))
    }
    #[cfg(not(unix))]
    run(command)
}

/// A command that runs in the background; killed when dropped.
pub(crate) struct Beside {
    child: Child,
    command: String,
    log: PathBuf,
}

/// Prints the command and starts it. Its output goes to a file `name` and is shown after the end.
pub(crate) fn start(name: &str, command: &mut Command) -> Result<Beside> {
    let (text, log) = (short_form(command), paths::in_root("target").join(name).with_extension("log"));
    println!("$ {text} &");
    let file = File::create(&log).with_context(|| paths::short(&log))?;
    command.stdout(file.try_clone()?).stderr(file);
    let child = command.spawn().with_context(|| format!("`{text}` could not be started"))?;
    Ok(Beside { child, command: text, log })
}

impl Beside {
    /// Waits for the end, shows the output, and fails if the command failed.
    pub(crate) fn finish(mut self) -> Result<()> {
        let status = self.child.wait()?;
        print!("{}", fs::read_to_string(&self.log)?);
        check(&self.command, status)
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // Killing a command that has already ended fails; this is no error.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Prints the command, runs it and returns its standard output.
pub(crate) fn run_for_output(command: &mut Command) -> Result<String> {
    println!("$ {}", short_form(command));
    output(command)
}

/// Runs the command without printing it and returns its standard output; its errors stay visible.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    let output =
        command.stderr(Stdio::inherit()).output().with_context(|| format!("`{}` could not be started", short_form(command)))?;
    check(&short_form(command), output.status)?;
    String::from_utf8(output.stdout).with_context(|| format!("`{}` wrote no UTF-8", short_form(command)))
}

/// Fails if one of the programs is not on the path (or a file, given with its whole path, is missing); names the Debian packages and the
/// script that installs them.
pub(crate) fn need(command: &str, script: &str, programs: &[(&str, &str)]) -> Result<()> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let missing: Vec<&str> = programs
        .iter()
        .filter(|(program, _)| !std::env::split_paths(&path).any(|folder| folder.join(program).is_file()))
        .map(|(_, package)| *package)
        .collect();
    ensure!(missing.is_empty(), "`{command}` needs the Debian packages {}, which `{script}` installs", missing.join(", "));
    Ok(())
}

fn check(command: &str, status: ExitStatus) -> Result<()> {
    match status.code() {
        Some(0) => Ok(()),
        Some(code) => bail!("`{command}` failed with exit code {code}"),
        None => bail!("`{command}` was ended by a signal"),
    }
}

/// The command as typed in the workspace root.
fn short_form(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = match program.strip_prefix(paths::root()) {
        Ok(own) => own.display().to_string(),
        Err(_) => program.file_name().map_or_else(|| program.display().to_string(), |name| name.to_string_lossy().into_owned()),
    };
    let arguments = command.get_args().map(|argument| paths::short(Path::new(argument)));
    std::iter::once(name).chain(arguments).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_relative_to_the_root() {
        let mut command = program(paths::in_root("target/venv/bin/python"));
        command.arg("run.py").arg(paths::fmu("FiveBar"));
        assert_eq!(short_form(&command), "target/venv/bin/python run.py target/fmu/FiveBar.fmu");
    }

    #[test]
    fn a_missing_program_is_named_by_its_package() {
        let error = need("cargo xtask fly", ".ci/setup", &[("cargo", "cargo"), ("no-such-program", "wings")]).unwrap_err();
        assert_eq!(error.to_string(), "`cargo xtask fly` needs the Debian packages wings, which `.ci/setup` installs");
    }

    #[test]
    fn a_failure_names_the_command_and_its_exit_code() {
        let error = run(cargo().arg("no-such-command-of-cargo").stderr(Stdio::null())).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("cargo no-such-command-of-cargo"), "{text}");
        assert!(text.contains("exit code 101"), "{text}");
    }
}
