//! Checks the finished archive with other code than the packer's.

use super::library::contains;
use super::macos;
use super::platform::Scope;
use anyhow::{Context, Result, bail, ensure};
use object::elf::FileHeader64;
use object::read::elf::FileHeader;
use object::{Endianness, Object};
use std::collections::BTreeSet;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use zip::{CompressionMethod, ZipArchive};

/// Size limits of libraries for all platforms, bytes, by folder. Contents: five methods, two of them in a form for the bare mechanism and
/// one for any scene; stick-slip friction, the corrector and model exchange, some 100 kB each; learning 180 kB (filter and flow again,
/// for 24 errors instead of six); causes of an alarm 30 kB; doubt about a start 25 kB; reader of own start values 40 kB; checks of each
/// step 40 kB; commands that act late 50 kB. The file for macOS is for two processors and contains the names of its functions.
const LARGEST_SHIPPED: [(&str, usize); 4] =
    [("linux64", 1_640_000), ("win64", 1_710_000), ("aarch64-linux", 1_340_000), ("darwin64", 3_080_000)];

/// Size limit of a library by the Rust in use. Its standard library is optimised for speed and prints backtraces, some 240 kB.
const LARGEST_HERE: usize = 1_930_000;

/// Largest stack frame of a function, bytes, in a library for x86-64, as found by [`largest_frame`]: the reader of a stored estimate with
/// learning, and a page more because compilers differ. `docs/fmi.md` states the stack that a host must provide.
const LARGEST_FRAME: u32 = 0xe000;

/// All exports of a library for both kinds: FMI 2.0.4, sections 2.1 (common functions), 3.2 (model exchange) and 4.2 (co-simulation).
#[rustfmt::skip]
const EXPORTS: [&str; 44] = [
    "fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2SetDebugLogging",
    "fmi2Instantiate", "fmi2FreeInstance", "fmi2SetupExperiment",
    "fmi2EnterInitializationMode", "fmi2ExitInitializationMode", "fmi2Terminate", "fmi2Reset",
    "fmi2GetReal", "fmi2GetInteger", "fmi2GetBoolean", "fmi2GetString",
    "fmi2SetReal", "fmi2SetInteger", "fmi2SetBoolean", "fmi2SetString",
    "fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate",
    "fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate", "fmi2DeSerializeFMUstate",
    "fmi2GetDirectionalDerivative",
    "fmi2EnterEventMode", "fmi2NewDiscreteStates", "fmi2EnterContinuousTimeMode", "fmi2CompletedIntegratorStep",
    "fmi2SetTime", "fmi2SetContinuousStates", "fmi2GetDerivatives", "fmi2GetEventIndicators",
    "fmi2GetContinuousStates", "fmi2GetNominalsOfContinuousStates",
    "fmi2SetRealInputDerivatives", "fmi2GetRealOutputDerivatives", "fmi2DoStep", "fmi2CancelStep",
    "fmi2GetStatus", "fmi2GetRealStatus", "fmi2GetIntegerStatus", "fmi2GetBooleanStatus", "fmi2GetStringStatus",
];

/// System libraries that a shipped library may need: glibc's, those of every Windows since 8, and macOS's single one.
#[rustfmt::skip]
const SYSTEM: [&str; 9] = [
    "ld-linux-x86-64.so.2", "libc.so.6", "libdl.so.2", "libpthread.so.0",
    "api-ms-win-core-synch-l1-2-0.dll", "kernel32.dll", "msvcrt.dll", "ntdll.dll",
    "/usr/lib/libsystem.b.dylib",
];

/// Files of every .fmu of this project.
const REQUIRED: [&str; 4] = ["modelDescription.xml", "model.png", "documentation/index.html", "documentation/licenses/license.txt"];

/// Findings, as text.
pub(super) struct Report {
    archive: u64,
    guid: String,
    libraries: Vec<Library>,
}

struct Library {
    name: String,
    size: usize,
    needs: Needs,
}

/// Requirements of a library on the system.
#[derive(Default)]
struct Needs {
    /// Libraries from which it takes symbols, in lower case.
    libraries: BTreeSet<String>,
    /// The newest version of their glibc symbols.
    glibc: Option<Vec<u32>>,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "verified, {} kB, GUID {}", self.archive / 1000, self.guid)?;
        for library in &self.libraries {
            let libraries = library.needs.libraries.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
            write!(f, "\n  {}: {} bytes, needs {libraries}", library.name, library.size)?;
            if let Some(version) = &library.needs.glibc {
                write!(f, " of glibc {}", dotted(version))?;
            }
        }
        Ok(())
    }
}

/// Size limit of the library in a folder of `binaries/`, bytes.
fn limit(folder: &str, scope: Scope) -> usize {
    match scope {
        Scope::Here => LARGEST_HERE,
        Scope::All => LARGEST_SHIPPED.iter().find(|(shipped, _)| *shipped == folder).map_or(0, |(_, most)| *most),
    }
}

/// Opens the archive and checks the properties that a host relies on. No library may need a glibc newer than the scope allows.
pub(super) fn verify(fmu: &Path, scope: Scope) -> Result<Report> {
    let file = File::open(fmu)?;
    let size = file.metadata()?.len();
    let mut archive = ZipArchive::new(file)?;
    let names = archive.file_names().map(|name| Ok(name?.into_owned())).collect::<Result<Vec<_>>>()?;
    for required in REQUIRED {
        ensure!(names.iter().any(|name| name == required), "{required} is missing");
    }
    let (guid, identifier) = identity(&String::from_utf8(read(&mut archive, "modelDescription.xml")?)?)?;
    let mut libraries = Vec::new();
    for name in names.iter().filter(|name| name.starts_with("binaries/")) {
        let stem = Path::new(name).file_stem().unwrap_or_default();
        ensure!(stem == identifier.as_str(), "{name} is not named after the modelIdentifier {identifier}");
        let bytes = read(&mut archive, name)?;
        libraries.push(library(name, &bytes, &guid, scope).with_context(|| name.clone())?);
    }
    ensure!(!libraries.is_empty(), "binaries/ is empty");
    Ok(Report { archive: size, guid, libraries })
}

fn read(archive: &mut ZipArchive<File>, name: &str) -> Result<Vec<u8>> {
    let mut entry = archive.by_name(name)?;
    ensure!(entry.compression() == CompressionMethod::Deflated, "{name} is not packed with deflate");
    let mut bytes = Vec::new();
    entry.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// GUID and modelIdentifier from the finished modelDescription.xml.
fn identity(xml: &str) -> Result<(String, String)> {
    let document = roxmltree::Document::parse(xml).context("modelDescription.xml is not well-formed")?;
    let root = document.root_element();
    ensure!(
        root.has_tag_name("fmiModelDescription") && root.attribute("fmiVersion") == Some("2.0"),
        "modelDescription.xml is not one of FMI 2.0"
    );
    let guid = root.attribute("guid").unwrap_or_default();
    ensure!(!guid.is_empty(), "modelDescription.xml has no guid");
    let identifier = |kind: &str| {
        let element = root.children().find(|child| child.has_tag_name(kind));
        let identifier = element.and_then(|element| element.attribute("modelIdentifier"));
        identifier.with_context(|| format!("modelDescription.xml has no modelIdentifier under {kind}"))
    };
    let (exchange, simulation) = (identifier("ModelExchange")?, identifier("CoSimulation")?);
    ensure!(exchange == simulation, "the modelIdentifier is {exchange} for model exchange and {simulation} for co-simulation");
    Ok((guid.to_owned(), simulation.to_owned()))
}

fn library(name: &str, bytes: &[u8], guid: &str, scope: Scope) -> Result<Library> {
    let limit = limit(name.split('/').nth(1).unwrap_or_default(), scope);
    ensure!(bytes.len() < limit, "{} bytes are too many: the limit is {limit}", bytes.len());
    let mut needs = Needs::default();
    match object::FileKind::parse(bytes)? {
        object::FileKind::MachOFat32 => {
            for part in macos::parts(bytes)? {
                needs.libraries.extend(check_part(name, part, guid, scope)?.libraries);
            }
        }
        _ => needs = check_part(name, bytes, guid, scope)?,
    }
    Ok(Library { name: name.to_owned(), size: bytes.len(), needs })
}

/// Checks a library for one processor; returns its requirements.
fn check_part(name: &str, bytes: &[u8], guid: &str, scope: Scope) -> Result<Needs> {
    ensure!(contains(bytes, guid.as_bytes()), "the library does not know the GUID {guid} of modelDescription.xml");
    check_exports(exports(bytes)?)?;
    let frame = largest_frame(bytes);
    ensure!(frame <= LARGEST_FRAME, "a function has a frame of {frame} bytes on the stack: the limit is {LARGEST_FRAME}");
    let needs = match object::FileKind::parse(bytes)? {
        object::FileKind::Elf64 => elf_needs(bytes)?,
        object::FileKind::MachO64 => {
            macos::check(name, bytes, scope)?;
            imports(bytes)?
        }
        _ => imports(bytes)?,
    };
    if let Some(library) = needs.libraries.iter().find(|library| library.starts_with("libm.")) {
        bail!(
            "it needs {library}, whose functions have other last bits on other systems: those of the crate libm are the same everywhere"
        );
    }
    if let Some(floor) = scope.glibc_floor() {
        check_needs(&needs, floor)?;
    }
    Ok(needs)
}

/// Refuses libraries that the system lacks; the .fmu would have to ship them.
fn check_needs(needs: &Needs, glibc_floor: &[u32]) -> Result<()> {
    for library in &needs.libraries {
        ensure!(SYSTEM.contains(&library.as_str()), "it needs {library}, which the system does not bring");
    }
    if let Some(version) = &needs.glibc {
        let (asked, floor) = (dotted(version), dotted(glibc_floor));
        ensure!(version.as_slice() <= glibc_floor, "it asks for glibc {asked}, and must run with glibc {floor}");
    }
    Ok(())
}

fn exports(bytes: &[u8]) -> Result<BTreeSet<String>> {
    let file = object::File::parse(bytes)?;
    // Mach-O puts an underscore before every C name.
    let prefix = if file.format() == object::BinaryFormat::MachO { "_" } else { "" };
    let mut names = BTreeSet::new();
    for export in file.exports()? {
        match export?.name() {
            object::read::NameOrOrdinal::Name(name) => {
                let name = String::from_utf8_lossy(name);
                names.insert(name.strip_prefix(prefix).unwrap_or(&name).to_owned());
            }
            object::read::NameOrOrdinal::Ordinal(ordinal) => bail!("export {ordinal} has no name"),
        }
    }
    Ok(names)
}

/// Largest frame of a function that probes its frame page by page in a loop, as compiled code for x86-64 does for large frames; 0 if
/// there is none.
fn largest_frame(code: &[u8]) -> u32 {
    // mov %rsp,%r11; sub $frame,%r11; sub $0x1000,%rsp
    const BEGIN: [u8; 6] = [0x49, 0x89, 0xe3, 0x49, 0x81, 0xeb];
    const PAGE: [u8; 7] = [0x48, 0x81, 0xec, 0x00, 0x10, 0x00, 0x00];
    let probes = code.windows(BEGIN.len() + 4 + PAGE.len()).filter_map(|window| {
        let (frame, page) = window.strip_prefix(&BEGIN)?.split_first_chunk()?;
        (page == PAGE).then(|| u32::from_le_bytes(*frame))
    });
    probes.max().unwrap_or(0)
}

fn check_exports(found: BTreeSet<String>) -> Result<()> {
    let wanted = BTreeSet::from(EXPORTS.map(String::from));
    let list = |names: Vec<&String>| names.into_iter().cloned().collect::<Vec<_>>().join(", ");
    let missing = list(wanted.difference(&found).collect());
    ensure!(missing.is_empty(), "not exported: {missing}");
    let extra = list(found.difference(&wanted).collect());
    ensure!(extra.is_empty(), "exported, but no function of FMI 2.0: {extra}");
    Ok(())
}

/// Imports of a library for Windows or macOS.
fn imports(bytes: &[u8]) -> Result<Needs> {
    let mut needs = Needs::default();
    for import in object::File::parse(bytes)?.imports()? {
        needs.libraries.insert(String::from_utf8_lossy(import?.library()).to_lowercase());
    }
    Ok(needs)
}

/// Libraries and symbol versions required by an ELF library.
fn elf_needs(bytes: &[u8]) -> Result<Needs> {
    let header = FileHeader64::<Endianness>::parse(bytes)?;
    let endian = header.endian()?;
    let sections = header.sections(endian, bytes)?;
    let mut needs = Needs::default();
    let Some((mut files, link)) = sections.gnu_verneed(endian, bytes)? else {
        return Ok(needs);
    };
    let strings = sections.strings(endian, bytes, link)?;
    while let Some((file, mut versions)) = files.next()? {
        needs.libraries.insert(String::from_utf8_lossy(file.file(endian, strings)?).into_owned());
        while let Some(version) = versions.next()? {
            let name = String::from_utf8_lossy(version.name(endian, strings)?);
            needs.glibc = needs.glibc.max(name.strip_prefix("GLIBC_").and_then(numbers));
        }
    }
    Ok(needs)
}

/// Formats `[2, 17]` as `2.17`.
fn dotted(version: &[u32]) -> String {
    version.iter().map(u32::to_string).collect::<Vec<_>>().join(".")
}

/// Parses `2.34` as numbers, so that 2.4 comes before 2.34; `None` for names such as GLIBC_PRIVATE.
fn numbers(version: &str) -> Option<Vec<u32>> {
    version.split('.').map(|part| part.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exports_must_be_the_list_and_nothing_else() {
        let all = BTreeSet::from(EXPORTS.map(String::from));
        assert_eq!(all.len(), EXPORTS.len());
        assert!(check_exports(all.clone()).is_ok());

        let mut fewer = all.clone();
        fewer.remove("fmi2DoStep");
        let error = check_exports(fewer).unwrap_err().to_string();
        assert_eq!(error, "not exported: fmi2DoStep");

        let mut more = all;
        more.insert("rust_panic".into());
        let error = check_exports(more).unwrap_err().to_string();
        assert!(error.ends_with(": rust_panic"), "{error}");
    }

    #[test]
    fn frames_are_read_from_probes() {
        let probe = |frame: u32| {
            let [a, b, c, d] = frame.to_le_bytes();
            [0x90, 0x49, 0x89, 0xe3, 0x49, 0x81, 0xeb, a, b, c, d, 0x48, 0x81, 0xec, 0x00, 0x10, 0x00, 0x00]
        };
        assert_eq!(largest_frame(&[probe(0x6000), probe(0xd000)].concat()), 0xd000);
        assert_eq!(largest_frame(&probe(0x6000)[..17]), 0);
    }

    #[test]
    fn identity_is_read_from_the_xml() {
        let xml = r#"<fmiModelDescription fmiVersion="2.0" guid="{1}"><ModelExchange modelIdentifier="M"/><CoSimulation modelIdentifier="M"/></fmiModelDescription>"#;
        assert_eq!(identity(xml).unwrap(), ("{1}".into(), "M".into()));
        let error = identity(&xml.replace("{1}", "")).unwrap_err().to_string();
        assert_eq!(error, "modelDescription.xml has no guid");
        let error = identity(&xml.replacen("\"M\"", "\"N\"", 1)).unwrap_err().to_string();
        assert_eq!(error, "the modelIdentifier is N for model exchange and M for co-simulation");
    }

    #[test]
    fn a_library_may_need_the_system_and_nothing_else() {
        let needs = |library: &str, version: &[u32]| Needs { libraries: [library.into()].into(), glibc: Some(version.into()) };
        assert!(check_needs(&needs("libc.so.6", &[2, 17]), &[2, 17]).is_ok());
        let error = check_needs(&needs("libc.so.6", &[2, 18]), &[2, 17]).unwrap_err().to_string();
        assert_eq!(error, "it asks for glibc 2.18, and must run with glibc 2.17");
        let error = check_needs(&needs("libgcc_s.so.1", &[2, 17]), &[2, 17]).unwrap_err().to_string();
        assert_eq!(error, "it needs libgcc_s.so.1, which the system does not bring");
    }

    #[test]
    fn glibc_versions_compare_as_numbers() {
        assert!(numbers("2.34") > numbers("2.4"));
        assert!(numbers("2.2.5") < numbers("2.3"));
        assert_eq!(numbers("PRIVATE"), None);
    }
}
