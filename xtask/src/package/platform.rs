//! The machines that a library is built for, and the cargo that builds for each.

use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::env;
use std::env::consts::{ARCH, DLL_EXTENSION, OS};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The newest glibc that a library for other machines may ask for: that of 2012, older than any Linux in support.
const GLIBC_FLOOR: [u32; 2] = [2, 17];

/// Platforms of `--all-platforms`: folder under `binaries/`, Rust's target triple, ending, flags for rustc. Both libraries for macOS
/// lie in one file.
const SHIPPED: [(&str, &str, &str, &[&str]); 5] = [
    ("linux64", "x86_64-unknown-linux-gnu", "so", &[]),
    ("win64", "x86_64-pc-windows-gnu", "dll", &[WINDOWS_THREAD_LOCALS, NO_TIME, WINDOWS_LIBRARIES]),
    ("aarch64-linux", "aarch64-unknown-linux-gnu", "so", &[]),
    ("darwin64", "x86_64-apple-darwin", "dylib", MAC_FLAGS),
    ("darwin64", "aarch64-apple-darwin", "dylib", MAC_FLAGS),
];

/// Thread locals by the loader of Windows, which frees them with the library. Those that this target has otherwise take one of
/// the process's 1,088 indexes each time that the library is unloaded, and never give it back: some 1,000 runs later the next
/// one would abort the host.
const WINDOWS_THREAD_LOCALS: &str = "-Zhas-thread-local=yes";

/// Folder of Debian's cargo and rustc, of the packages cargo-web and rustc-web.
const DEBIAN: &str = "/usr/bin";

/// A file that exists where the sources of the standard library are installed.
const STANDARD_LIBRARY: &str = "/usr/lib/rustlib/src/rust/library/Cargo.lock";

/// The triple of WebAssembly without a system below.
const WEB: &str = "wasm32-unknown-unknown";

/// The linker for WebAssembly.
const WEB_LINKER: &str = "wasm-ld-14";

/// Two lanes as one instruction, which every browser has since 2023; a stack of four times the depth that was ever seen, because a
/// page pays for all of it; a table of functions in which a page can put its logger.
const WEB_FLAGS: &[&str] = &[
    "-Ctarget-feature=+simd128",
    "-Clinker-flavor=wasm-ld",
    "-Clink-arg=-zstack-size=262144",
    "-Clink-arg=--export-table",
    "-Clink-arg=--growable-table",
];

/// The linker for macOS. The one in zig exports names beyond the list that Rust gives it; lld 14 loses the tables by which a panic is
/// caught.
const MAC_LINKER: &str = "ld64.lld-19";

/// Name of the library for hosts that link it; a signature without a signer, which processors of Apple ask for; no library that
/// nothing comes from; no symbols for debuggers, and no local ones.
const MAC_FLAGS: &[&str] = &[
    "-Clinker-flavor=ld64.lld",
    "-Clink-arg=-install_name",
    "-Clink-arg=@rpath/FiveBar.dylib",
    "-Clink-arg=-adhoc_codesign",
    "-Clink-arg=-dead_strip_dylibs",
    "-Clink-arg=-S",
    "-Clink-arg=-x",
];

/// Name of a library that is built on a Mac, whose linker would write its path there.
const MAC_NAME: &[&str] = &["-Clink-arg=-Wl,-install_name,@rpath/FiveBar.dylib"];

/// The oldest macOS that a library is for: the first one for processors of Apple.
pub(super) const MAC_FLOOR: &str = "11.0";

/// Names under which Rust asks for parts of macOS's one system library. None of ours takes a function from the last two.
const MAC_SYSTEM: [&str; 5] = ["System", "c", "m", "iconv", "charset"];

/// The linker for Windows.
const WINDOWS_LINKER: &str = "x86_64-w64-mingw32-gcc";

/// The linker for Windows writes the time into a library unless it is told not to: the same sources give the same bytes.
const NO_TIME: &str = "-Clink-arg=-Wl,--no-insert-timestamp";

/// The linker for Windows orders what a library takes from others by the files' paths: those of the system lie in a folder with a
/// path that is relative, and so before those of the standard library in every checkout.
const WINDOWS_LIBRARIES: &str = "-Clink-arg=-Ltarget/cross/windows";

/// Names under which Rust asks for parts of Windows.
const WINDOWS_SYSTEM: [&str; 3] = ["kernel32", "msvcrt", "ntdll"];

/// For which machines a unit is packed.
#[derive(Clone, Copy)]
pub(crate) enum Scope {
    /// The one that this runs on, with the Rust that is in use: quick.
    Here,
    /// All that are shipped, each built anew with its standard library.
    All,
}

impl Scope {
    /// The machines.
    pub(super) fn platforms(self) -> Vec<Platform> {
        match self {
            Self::Here => vec![Platform::here()],
            Self::All => Platform::all(),
        }
    }

    /// The compiler whose standard library is linked, and which is asked first: fails where what it needs is missing.
    pub(super) fn rustc(self) -> Result<Command> {
        match self {
            Self::Here => Ok(process::program(env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()))),
            Self::All => debian_rustc(
                "cargo xtask package --all-platforms",
                ".ci/setup-platforms",
                &[(WINDOWS_LINKER, "gcc-mingw-w64-x86-64"), (MAC_LINKER, "lld-19")],
            ),
        }
    }

    /// The newest glibc that a library may ask for; none: that of this machine.
    pub(super) fn glibc_floor(self) -> Option<&'static [u32]> {
        match self {
            Self::Here => None,
            Self::All => Some(&GLIBC_FLOOR),
        }
    }

    /// Licences of parts linked beside the crates that the licence of the compiler's own project does not cover: a name in the
    /// folder of licences and the file, for each.
    pub(super) fn runtime_licenses(self) -> Result<Vec<(&'static str, PathBuf)>> {
        match self {
            Self::Here => Ok(Vec::new()),
            Self::All => {
                let zig = venv::site_packages(Packages::Platforms)?.join("ziglang");
                Ok(vec![
                    standard_library_license(),
                    ("zig/LICENSE.txt", zig.join("LICENSE")),
                    ("llvm-libunwind/LICENSE.txt", zig.join("lib/libunwind/LICENSE.TXT")),
                    ("gcc-mingw-w64/copyright.txt", "/usr/share/doc/gcc-mingw-w64-x86-64/copyright".into()),
                    ("mingw-w64/copyright.txt", "/usr/share/doc/mingw-w64-x86-64-dev/copyright".into()),
                ])
            }
        }
    }

    /// The packed unit of that name.
    pub(super) fn file(self, name: &str) -> PathBuf {
        match self {
            Self::Here => paths::fmu(name),
            Self::All => paths::fmu_for_all_platforms(name),
        }
    }
}

/// A machine that a library is built for.
pub(super) struct Platform {
    /// Name of its folder under `binaries/`: FMI 2.0's own (section 2.3) where it has one, the tuples of FMI 3.0
    /// (section 2.5.1.1) for the rest.
    pub(super) folder: String,
    /// Ending of a library's file.
    pub(super) extension: &'static str,
    /// Rust's target triple where it is built with Debian's Rust and zig; none: with the cargo that runs this, for this
    /// machine.
    pub(super) cross: Option<&'static str>,
    /// Further flags for rustc.
    pub(super) flags: &'static [&'static str],
}

impl Platform {
    /// The machine that this runs on.
    fn here() -> Self {
        let folder = match (OS, ARCH) {
            ("linux", "x86_64") => "linux64".into(),
            ("linux", "x86") => "linux32".into(),
            ("windows", "x86_64") => "win64".into(),
            ("windows", "x86") => "win32".into(),
            // One file has the libraries for both processors.
            ("macos", _) => "darwin64".into(),
            (os, arch) => format!("{arch}-{os}"),
        };
        let flags = if OS == "macos" { MAC_NAME } else { &[] };
        Self { folder, extension: DLL_EXTENSION, cross: None, flags }
    }

    /// Every machine that `--all-platforms` packs a library for.
    fn all() -> Vec<Self> {
        let platform = |(folder, triple, extension, flags): (&str, _, _, _)| Self {
            folder: folder.into(),
            extension,
            cross: Some(triple),
            flags,
        };
        SHIPPED.map(platform).into()
    }

    /// The browser.
    pub(super) fn web() -> Self {
        Self { folder: "wasm32".into(), extension: "wasm", cross: Some(WEB), flags: WEB_FLAGS }
    }

    /// `cargo rustc --release` for this machine; the caller adds the target to be built.
    pub(super) fn cargo_rustc(&self) -> Result<Command> {
        match self.cross {
            None => {
                let mut cargo = process::cargo();
                cargo.args(["rustc", "--release"]);
                Ok(cargo)
            }
            Some(WEB) => web("rustc"),
            Some(triple) => cross("rustc", triple),
        }
    }
}

/// The compiler for the browser; fails where what it needs is missing.
pub(super) fn web_rustc() -> Result<Command> {
    debian_rustc("cargo xtask page", ".ci/setup-page", &[(WEB_LINKER, "lld")])
}

/// Debian's compiler; fails where it, the sources of its standard library or a linker are missing, which `script` installs.
fn debian_rustc(command: &str, script: &str, linkers: &[(&str, &str)]) -> Result<Command> {
    let rust = [("/usr/bin/rustc", "rustc-web"), ("/usr/bin/cargo", "cargo-web"), (STANDARD_LIBRARY, "rust-web-src")];
    process::need(command, script, &[&rust, linkers].concat())?;
    Ok(process::program(Path::new(DEBIAN).join("rustc")))
}

/// Licence of what Debian's standard library has from others: name in the folder of licences, and file.
pub(super) fn standard_library_license() -> (&'static str, PathBuf) {
    ("rust-standard-library/copyright.txt", "/usr/share/doc/rust-web-src/copyright".into())
}

/// A command of cargo, optimised, for `triple`. Debian's Rust brings the sources of its standard library, from which that
/// of any machine is built; zig brings linker and C library of any Linux, with the glibc that is asked for, and the list of
/// what macOS's system library has; the linker for Windows is Debian's, because Debian's Rust links a library there that zig does not
/// have.
fn cross(command: &str, triple: &str) -> Result<Command> {
    let python = venv::python(Packages::Platforms)?;
    let programs = Path::new(python.get_program()).parent().context("Python lies in a folder")?;
    let (program, target) = if triple.ends_with("linux-gnu") {
        let [major, minor] = GLIBC_FLOOR;
        (programs.join("cargo-zigbuild"), format!("{triple}.{major}.{minor}"))
    } else {
        (Path::new(DEBIAN).join("cargo"), triple.to_owned())
    };
    let mut cargo = process::program(program);
    cargo.args([command, "--release", "--target", &target]);
    let folder = build_standard_library(&mut cargo, "panic_unwind", "panic-unwind,optimize_for_size");
    cargo
        .env("PATH", env::join_paths([programs, Path::new(DEBIAN), Path::new("/bin")]).context("the path of programs")?)
        .env("CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER", WINDOWS_LINKER)
        .env("CARGO_TARGET_X86_64_APPLE_DARWIN_LINKER", MAC_LINKER)
        .env("CARGO_TARGET_AARCH64_APPLE_DARWIN_LINKER", MAC_LINKER)
        // Files that zig and its helper keep beside the output stay in this folder as well.
        .env("CARGO_ZIGBUILD_CACHE_DIR", folder.join("cargo-zigbuild"))
        .env("ZIG_GLOBAL_CACHE_DIR", folder.join("zig"));
    if triple.ends_with("windows-gnu") {
        windows_libraries(&folder)?;
    }
    if triple.ends_with("apple-darwin") {
        // The linker leaves out what there is to strip, before it signs; Debian lacks the program that rustc strips with.
        cargo
            .env("SDKROOT", mac_libraries(&folder)?)
            .env("MACOSX_DEPLOYMENT_TARGET", MAC_FLOOR)
            .env("CARGO_PROFILE_RELEASE_STRIP", "none");
    }
    Ok(cargo)
}

/// A folder as the linker for macOS expects it, with zig's list of the names that the system library has.
fn mac_libraries(folder: &Path) -> Result<PathBuf> {
    let names = venv::site_packages(Packages::Platforms)?.join("ziglang/lib/libc/darwin/libSystem.tbd");
    let root = folder.join("macos");
    let libraries = root.join("usr/lib");
    fs::create_dir_all(&libraries)?;
    for name in MAC_SYSTEM {
        let copy = libraries.join(format!("lib{name}.tbd"));
        fs::copy(&names, &copy).with_context(|| format!("{} cannot be copied to {}", names.display(), paths::short(&copy)))?;
    }
    Ok(root)
}

/// The folder [`WINDOWS_LIBRARIES`], with the linker's own lists of names.
fn windows_libraries(folder: &Path) -> Result<()> {
    let libraries = folder.join("windows");
    fs::create_dir_all(&libraries)?;
    for name in WINDOWS_SYSTEM {
        let file = format!("lib{name}.a");
        let names = process::output(process::program(WINDOWS_LINKER).arg(format!("-print-file-name={file}")))?;
        let copy = libraries.join(&file);
        fs::copy(names.trim(), &copy).with_context(|| format!("{} cannot be copied to {}", names.trim(), paths::short(&copy)))?;
    }
    Ok(())
}

/// A command of cargo, optimised, for the browser, where a panic is a trap.
fn web(command: &str) -> Result<Command> {
    let mut cargo = process::program(Path::new(DEBIAN).join("cargo"));
    cargo.args([command, "--release", "--target", WEB]);
    build_standard_library(&mut cargo, "panic_abort", "optimize_for_size");
    cargo
        .env("PATH", env::join_paths([DEBIAN, "/bin"]).context("the path of programs")?)
        .env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER", WEB_LINKER);
    Ok(cargo)
}

/// Lets a command of cargo build the standard library as well, and gives back its target folder.
///
/// The sources must be those of the compiler, hence not the Rust in use; `RUSTC_BOOTSTRAP` lets a stable one build them.
/// Backtraces are left out of the standard library: a stripped library has none to show. Formatting and sorting are optimised for
/// size: no step does either.
fn build_standard_library(cargo: &mut Command, panic: &str, features: &str) -> PathBuf {
    let folder = paths::in_root("target/cross");
    cargo
        .arg("--target-dir")
        .arg(&folder)
        .args([format!("-Zbuild-std=std,{panic}"), format!("-Zbuild-std-features={features}")])
        .env("CARGO", Path::new(DEBIAN).join("cargo"))
        .env("RUSTC", Path::new(DEBIAN).join("rustc"))
        .env("RUSTC_BOOTSTRAP", "1");
    folder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_is_one_of_those_that_are_shipped_or_has_a_name_of_its_own() {
        let here = Platform::here();
        let shipped = Platform::all().into_iter().find(|platform| platform.folder == here.folder);
        assert!(shipped.is_none_or(|platform| platform.extension == here.extension));
    }

    #[test]
    fn the_compiler_that_is_asked_first_names_the_script_that_installs_it() {
        for (rustc, script) in [(web_rustc(), ".ci/setup-page"), (Scope::All.rustc(), ".ci/setup-platforms")] {
            assert!(rustc.is_ok() || rustc.unwrap_err().to_string().ends_with(&format!("which `{script}` installs")));
        }
        let error = debian_rustc("cargo xtask fly", ".ci/setup-fly", &[("no-such-linker", "wings")]).unwrap_err().to_string();
        assert!(error.contains("wings") && error.ends_with("which `.ci/setup-fly` installs"), "{error}");
    }
}
