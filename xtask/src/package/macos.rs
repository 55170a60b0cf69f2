//! A library for macOS: one file for the processors of Intel and of Apple, its name and its signature.

use super::platform::{MAC_FLOOR, Scope};
use anyhow::{Context, Result, bail, ensure};
use fat_macho::FatWriter;
use object::macho::{self, DylibCommand, LinkeditDataCommand};
use object::read::NameOrOrdinal;
use object::read::macho::{FatArch, MachOFatFile32, MachOFile64};
use object::{Architecture, Endianness, Object, ObjectSection};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Constants of a code signature: magic numbers of the signature and of its list of hashes, type of the list, flag for "ad hoc", type
/// of SHA-256. Source: `cs_blobs.h` of Apple's xnu.
const SIGNATURE: u32 = 0xfade_0cc0;
const CODE_DIRECTORY: u32 = 0xfade_0c02;
const CODE_DIRECTORY_SLOT: u32 = 0;
const AD_HOC: u32 = 0x2;
const SHA256: u8 = 2;

/// Functions of macOS's system library that round differently elsewhere; on Linux they are in a separate library (libm).
#[rustfmt::skip]
const ELEMENTARY: [&str; 22] = [
    "_acos", "_asin", "_atan", "_atan2", "_cbrt", "_cos", "_cosh", "_exp", "_exp2", "_expm1", "_hypot",
    "_log", "_log10", "_log1p", "_log2", "_pow", "_sin", "_sinh", "_tan", "_tanh", "___powidf2", "___sincos_stret",
];

/// The function of macOS's system library with which Rust resumes in a panic handler. Some linkers drop Rust's personality
/// function, which calls it, and the table of handlers.
const CATCH: &str = "__Unwind_SetIP";

/// One file from two libraries for different processors.
pub(super) fn universal(one: Vec<u8>, other: Vec<u8>) -> Result<Vec<u8>> {
    let mut writer = FatWriter::new();
    let mut bytes = Vec::new();
    writer
        .add(one)
        .and_then(|()| writer.add(other))
        .and_then(|()| writer.write_to(&mut bytes))
        .context("a file for two processors")?;
    Ok(bytes)
}

/// The libraries in a file for both processors.
pub(super) fn parts(bytes: &[u8]) -> Result<[&[u8]; 2]> {
    let file = MachOFatFile32::parse(bytes)?;
    let part = |architecture| -> Result<&[u8]> {
        let part = file.arches().iter().find(|part| part.architecture() == architecture);
        Ok(part.with_context(|| format!("it has no library for {architecture:?}"))?.data(bytes)?)
    };
    Ok([part(Architecture::X86_64)?, part(Architecture::Aarch64)?])
}

/// Checks a library's install name, its oldest macOS, its signature and its panic tables, and that its elementary functions are its own.
pub(super) fn check(file: &str, bytes: &[u8], scope: Scope) -> Result<()> {
    let library = MachOFile64::<Endianness>::parse(bytes)?;
    let endian = library.endian();
    let name = Path::new(file).file_name().and_then(|name| name.to_str()).context("a library has a name")?;
    let (mut called, mut oldest, mut signed) = (None, None, false);
    let mut commands = library.macho_load_commands()?;
    while let Some(command) = commands.next()? {
        match command.cmd() {
            macho::LC_ID_DYLIB => {
                let id: &DylibCommand<_> = command.data()?;
                called = Some(String::from_utf8_lossy(command.string(endian, id.dylib.name)?).into_owned());
            }
            macho::LC_BUILD_VERSION => oldest = command.build_version(endian)?.map(|(version, _)| version.minos.get(endian)),
            macho::LC_CODE_SIGNATURE => {
                let place: &LinkeditDataCommand<_> = command.data()?;
                let code = bytes.get(..place.dataoff.get(endian) as usize).context("its signature lies outside of it")?;
                check_signature(code, place.data(endian, bytes)?)?;
                signed = true;
            }
            _ => (),
        }
    }
    let (called, wanted) = (called.unwrap_or_default(), format!("@rpath/{name}"));
    ensure!(called == wanted, "its install name is {called:?}, and must be {wanted}");
    ensure!(
        signed || library.architecture() != Architecture::Aarch64,
        "it has no signature, without which no processor of Apple runs it"
    );
    let handlers = library.section_by_name("__gcc_except_tab").map_or(0, |section| section.size());
    let mut catches = false;
    for import in library.imports()? {
        let NameOrOrdinal::Name(import) = import?.name() else { bail!("it takes a function without a name from macOS") };
        let import = String::from_utf8_lossy(import);
        ensure!(!ELEMENTARY.contains(&&*import), "it takes {import} from macOS, whose last bits are other ones on other systems");
        catches |= import == CATCH;
    }
    ensure!(catches && handlers > 0, "it has no tables by which a panic is caught");
    if matches!(scope, Scope::All) {
        let oldest = oldest.context("it does not say which macOS it is for")?;
        let oldest = format!("{}.{}", oldest.major(), oldest.minor());
        ensure!(oldest == MAC_FLOOR, "it is for macOS {oldest} or newer, and must be for {MAC_FLOOR}");
    }
    Ok(())
}

/// Checks that an ad-hoc signature has the hash of each page of the code before it, and no others.
fn check_signature(code: &[u8], signature: &[u8]) -> Result<()> {
    ensure!(word(signature, 0)? == SIGNATURE, "its signature is none");
    let places = (0..word(signature, 8)? as usize).map(|i| (word(signature, 12 + 8 * i), word(signature, 16 + 8 * i)));
    let mut directory = None;
    for (slot, place) in places {
        if slot? == CODE_DIRECTORY_SLOT {
            directory = signature.get(place? as usize..);
        }
    }
    let directory = directory.context("its signature has no list of hashes")?;
    ensure!(word(directory, 0)? == CODE_DIRECTORY, "its signature's list of hashes is none");
    ensure!(word(directory, 12)? & AD_HOC != 0, "its signature is not ad hoc");
    let (hashes, count, end) = (word(directory, 16)?, word(directory, 28)? as usize, word(directory, 32)? as usize);
    let Some(&[size, kind, _, page]) = directory.get(36..40) else { bail!("its signature's list of hashes ends early") };
    ensure!((size, kind) == (32, SHA256), "its signature has hashes of kind {kind} with {size} bytes, and must have SHA-256");
    ensure!(end == code.len(), "its signature is for {end} bytes, and must be for {}", code.len());
    ensure!((12..=14).contains(&page), "its signature has pages of 2^{page} bytes, and must have 2^12 to 2^14");
    let pages = code.chunks(1 << page);
    ensure!(count == pages.len(), "its signature has {count} hashes, and must have {}", pages.len());
    let hashes = directory.get(hashes as usize..).unwrap_or_default().chunks_exact(32);
    ensure!(hashes.len() >= count, "its signature's list of hashes ends early");
    for (i, (page, hash)) in pages.zip(hashes).enumerate() {
        ensure!(Sha256::digest(page)[..] == *hash, "page {i} of it is not the one that was signed");
    }
    Ok(())
}

/// Big-endian number at a place of a signature.
fn word(bytes: &[u8], at: usize) -> Result<u32> {
    let word = bytes.get(at..at + 4).context("its signature ends early")?;
    Ok(u32::from_be_bytes(word.try_into()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An ad-hoc signature of the code, with pages of 4096 bytes.
    fn sign(code: &[u8]) -> Vec<u8> {
        let pages = code.chunks(4096);
        let mut directory =
            [CODE_DIRECTORY, 0, 0x20400, AD_HOC, 40, 0, 0, pages.len() as u32, code.len() as u32].map(u32::to_be_bytes).concat();
        directory.extend([32, SHA256, 0, 12]);
        directory.extend(pages.flat_map(Sha256::digest));
        let mut signature = [SIGNATURE, 0, 1, CODE_DIRECTORY_SLOT, 20].map(u32::to_be_bytes).concat();
        signature.extend(directory);
        signature
    }

    #[test]
    fn a_signature_covers_exactly_the_code() {
        let code: Vec<u8> = (0..10_000).map(|i| (i % 251) as u8).collect();
        let signature = sign(&code);
        assert!(check_signature(&code, &signature).is_ok());
        for at in [0, 4_096, 9_999] {
            let mut other = code.clone();
            other[at] ^= 1;
            let error = check_signature(&other, &signature).unwrap_err().to_string();
            assert_eq!(error, format!("page {} of it is not the one that was signed", at / 4096));
        }
        let error = check_signature(&code[..9_999], &signature).unwrap_err().to_string();
        assert_eq!(error, "its signature is for 10000 bytes, and must be for 9999");
        for end in 0..signature.len() {
            let error = check_signature(&code, &signature[..end]).unwrap_err().to_string();
            assert!(error.contains("ends early") || error.contains("no list of hashes"), "{error}");
        }
    }

    #[test]
    fn libraries_for_two_processors_come_back_from_one_file() {
        let header = |processor: u32, sub: u32| {
            let words = [macho::MH_MAGIC_64, processor, sub, 6, 0, 0, 0, 0];
            words.map(u32::to_le_bytes).concat()
        };
        let (intel, apple) = (header(macho::CPU_TYPE_X86_64.0, 3), header(macho::CPU_TYPE_ARM64.0, 0));
        let both = universal(intel.clone(), apple.clone()).unwrap();
        assert_eq!(parts(&both).unwrap(), [intel.clone(), apple]);
        assert!(universal(intel.clone(), intel).is_err(), "one processor twice");
    }
}
