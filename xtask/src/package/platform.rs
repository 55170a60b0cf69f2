//! The platforms for which a library is built, and the cargo that builds for each.

use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::env;
use std::env::consts::{ARCH, DLL_EXTENSION, OS};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The newest glibc that a library for other machines may need: from 2012, older than any supported Linux.
const GLIBC_FLOOR: [u32; 2] = [2, 17];

/// Platforms of `--all-platforms`: folder in `binaries/`, Rust's target triple, file ending, flags for rustc. The two libraries for macOS
/// go into one file.
const SHIPPED: [(&str, &str, &str, &[&str]); 5] = [
    ("linux64", "x86_64-unknown-linux-gnu", "so", &[]),
    ("win64", "x86_64-pc-windows-gnu", "dll", &[WINDOWS_THREAD_LOCALS, NO_TIME, WINDOWS_LIBRARIES]),
    ("aarch64-linux", "aarch64-unknown-linux-gnu", "so", &[]),
    ("darwin64", "x86_64-apple-darwin", "dylib", MAC_FLAGS),
    ("darwin64", "aarch64-apple-darwin", "dylib", MAC_FLAGS),
];

/// Uses the thread locals of the Windows loader, which frees them with the library. This target's default uses up one of the
/// process's 1,088 indexes each time the library is loaded and unloaded. After some 1,000 runs the host would abort.
const WINDOWS_THREAD_LOCALS: &str = "-Zhas-thread-local=yes";

/// Folder of Debian's cargo and rustc from the packages cargo-web and rustc-web.
const DEBIAN: &str = "/usr/bin";

/// A file that exists if the sources of the standard library are installed.
const STANDARD_LIBRARY: &str = "/usr/lib/rustlib/src/rust/library/Cargo.lock";

/// The triple of WebAssembly without an operating system.
const WEB: &str = "wasm32-unknown-unknown";

/// The linker for WebAssembly.
const WEB_LINKER: &str = "wasm-ld-14";

/// Instructions on two lanes, which every browser has since 2023. A stack four times as deep as ever needed, because a page pays for
/// all of it. A table of functions to which a page can add its logger.
const WEB_FLAGS: &[&str] = &[
    "-Ctarget-feature=+simd128",
    "-Clinker-flavor=wasm-ld",
    "-Clink-arg=-zstack-size=262144",
    "-Clink-arg=--export-table",
    "-Clink-arg=--growable-table",
];

/// The linker for macOS. The one in zig exports names beyond Rust's list; lld 14 loses the tables needed to catch a panic.
const MAC_LINKER: &str = "ld64.lld-19";

/// Install name of the library for hosts that link it; an ad-hoc signature, which Apple processors need; no unused libraries; no debug
/// or local symbols.
const MAC_FLAGS: &[&str] = &[
    "-Clinker-flavor=ld64.lld",
    "-Clink-arg=-install_name",
    "-Clink-arg=@rpath/FiveBar.dylib",
    "-Clink-arg=-adhoc_codesign",
    "-Clink-arg=-dead_strip_dylibs",
    "-Clink-arg=-S",
    "-Clink-arg=-x",
];

/// Install name of a library built on a Mac; the linker's default would be its path.
const MAC_NAME: &[&str] = &["-Clink-arg=-Wl,-install_name,@rpath/FiveBar.dylib"];

/// The oldest supported macOS: the first one for Apple processors.
pub(super) const MAC_FLOOR: &str = "11.0";

/// Names under which Rust links parts of macOS's single system library. Our library needs no function from the last two.
const MAC_SYSTEM: [&str; 5] = ["System", "c", "m", "iconv", "charset"];

/// The linker for Windows.
const WINDOWS_LINKER: &str = "x86_64-w64-mingw32-gcc";

/// By default the linker for Windows writes the time into a library. Without it the same sources give the same bytes.
const NO_TIME: &str = "-Clink-arg=-Wl,--no-insert-timestamp";

/// The linker for Windows orders imports by the paths of the files. The system's files are in a folder with a relative path, and so come
/// before the files of the standard library in every checkout.
const WINDOWS_LIBRARIES: &str = "-Clink-arg=-Ltarget/cross/windows";

/// Names under which Rust links parts of Windows.
const WINDOWS_SYSTEM: [&str; 3] = ["kernel32", "msvcrt", "ntdll"];

/// Platforms to pack for.
#[derive(Clone, Copy)]
pub(crate) enum Scope {
    /// This machine, with the Rust in use: quick.
    Here,
    /// All shipped platforms; the standard library is built from source for each.
    All,
}

impl Scope {
    pub(super) fn platforms(self) -> Vec<Platform> {
        match self {
            Self::Here => vec![Platform::here()],
            Self::All => Platform::all(),
        }
    }

    /// The compiler of the linked standard library, asked first: fails if anything it needs is missing.
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

    /// The newest glibc that a library may need; `None`: this machine's.
    pub(super) fn glibc_floor(self) -> Option<&'static [u32]> {
        match self {
            Self::Here => None,
            Self::All => Some(&GLIBC_FLOOR),
        }
    }

    /// Licences of linked parts that the licence of the compiler's own project does not cover: name in the folder of licences, and file.
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

    /// The packed unit `name`.
    pub(super) fn file(self, name: &str) -> PathBuf {
        match self {
            Self::Here => paths::fmu(name),
            Self::All => paths::fmu_for_all_platforms(name),
        }
    }
}

/// A platform for which a library is built.
pub(super) struct Platform {
    /// Folder in `binaries/`: FMI 2.0's name if it has one (section 2.3), otherwise the tuple of FMI 3.0 (section 2.5.1.1).
    pub(super) folder: String,
    /// Ending of the library's file name.
    pub(super) extension: &'static str,
    /// Rust's target triple if built with Debian's Rust and zig; `None`: built with the cargo that runs this, for this machine.
    pub(super) cross: Option<&'static str>,
    /// Further flags for rustc.
    pub(super) flags: &'static [&'static str],
}

impl Platform {
    /// This machine.
    fn here() -> Self {
        let folder = match (OS, ARCH) {
            ("linux", "x86_64") => "linux64".into(),
            ("linux", "x86") => "linux32".into(),
            ("windows", "x86_64") => "win64".into(),
            ("windows", "x86") => "win32".into(),
            // One file contains the libraries for both processors.
            ("macos", _) => "darwin64".into(),
            (os, arch) => format!("{arch}-{os}"),
        };
        let flags = if OS == "macos" { MAC_NAME } else { &[] };
        Self { folder, extension: DLL_EXTENSION, cross: None, flags }
    }

    /// Every platform of `--all-platforms`.
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

    /// `cargo rustc --release` for this platform; the caller adds the target to build.
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

/// The compiler for the browser; fails if anything it needs is missing.
pub(super) fn web_rustc() -> Result<Command> {
    debian_rustc("cargo xtask page", ".ci/setup-page", &[(WEB_LINKER, "lld")])
}

/// Debian's compiler; fails if it, the sources of its standard library or a linker is missing. `script` installs them.
fn debian_rustc(command: &str, script: &str, linkers: &[(&str, &str)]) -> Result<Command> {
    let rust = [("/usr/bin/rustc", "rustc-web"), ("/usr/bin/cargo", "cargo-web"), (STANDARD_LIBRARY, "rust-web-src")];
    process::need(command, script, &[&rust, linkers].concat())?;
    Ok(process::program(Path::new(DEBIAN).join("rustc")))
}

/// Licences of third-party code in Debian's standard library: name in the folder of licences, and file.
pub(super) fn standard_library_license() -> (&'static str, PathBuf) {
    ("rust-standard-library/copyright.txt", "/usr/share/doc/rust-web-src/copyright".into())
}

/// An optimised cargo command for `triple`. Debian's Rust brings the sources of its standard library, which cargo builds for any machine.
/// zig brings the linker and the C library of any Linux, for a chosen glibc, and the list of names in macOS's system library. The linker
/// for Windows is Debian's, because Debian's Rust needs a library there that zig lacks.
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
        // Keeps the files that zig and its helper write beside the output in this folder.
        .env("CARGO_ZIGBUILD_CACHE_DIR", folder.join("cargo-zigbuild"))
        .env("ZIG_GLOBAL_CACHE_DIR", folder.join("zig"));
    if triple.ends_with("windows-gnu") {
        windows_libraries(&folder)?;
    }
    if triple.ends_with("apple-darwin") {
        // The linker strips before it signs; Debian lacks the program that rustc would strip with.
        cargo
            .env("SDKROOT", mac_libraries(&folder)?)
            .env("MACOSX_DEPLOYMENT_TARGET", MAC_FLOOR)
            .env("CARGO_PROFILE_RELEASE_STRIP", "none");
    }
    Ok(cargo)
}

/// A folder in the form that the linker for macOS expects, with zig's list of names in the system library.
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

/// An optimised cargo command for the browser; a panic is a trap there.
fn web(command: &str) -> Result<Command> {
    let mut cargo = process::program(Path::new(DEBIAN).join("cargo"));
    cargo.args([command, "--release", "--target", WEB]);
    build_standard_library(&mut cargo, "panic_abort", "optimize_for_size");
    cargo
        .env("PATH", env::join_paths([DEBIAN, "/bin"]).context("the path of programs")?)
        .env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER", WEB_LINKER);
    Ok(cargo)
}

/// Makes a cargo command build the standard library as well; returns its target folder.
///
/// The sources must match the compiler, hence not the Rust in use; `RUSTC_BOOTSTRAP` lets a stable compiler build them. The standard
/// library has no backtraces, because a stripped library cannot show any. Formatting and sorting are optimised for size; no step uses them.
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
