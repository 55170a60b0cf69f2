//! The .fmu: a zip archive with bytes that depend only on its content.

use super::Files;
use crate::paths;
use anyhow::{Context, Result};
use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Packs files into the archive `file`.
pub(super) fn write(file: &Path, files: &Files) -> Result<()> {
    let bytes = pack(files).with_context(|| format!("{} cannot be packed", paths::short(file)))?;
    fs::write(file, bytes).with_context(|| format!("{} cannot be written", paths::short(file)))
}

fn pack(files: &Files) -> Result<Vec<u8>> {
    // Fixed values for all fields that zip would take from the clock, the umask and the operating system.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(9))
        .last_modified_time(DateTime::DEFAULT)
        .unix_permissions(0o644)
        .system(System::Unix);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        archive.start_file(name.as_str(), options)?;
        archive.write_all(content)?;
    }
    Ok(archive.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    fn files() -> Files {
        Files::from([("b/text.txt".to_owned(), b"text ".repeat(100)), ("a.bin".to_owned(), (0..=255).collect())])
    }

    #[test]
    fn same_content_gives_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("1.fmu"), folder.path().join("2.fmu"));
        write(&one, &files()).unwrap();
        // Times in a zip archive have a resolution of 2 s.
        std::thread::sleep(std::time::Duration::from_millis(2100));
        write(&two, &files()).unwrap();
        assert_eq!(fs::read(one).unwrap(), fs::read(two).unwrap());
    }

    #[test]
    fn entries_are_sorted_and_come_back() {
        let mut archive = zip::ZipArchive::new(Cursor::new(pack(&files()).unwrap())).unwrap();
        let names: Vec<_> = archive.file_names().map(Result::unwrap).collect();
        assert_eq!(names, ["a.bin", "b/text.txt"]);
        let mut text = String::new();
        let mut entry = archive.by_name("b/text.txt").unwrap();
        entry.read_to_string(&mut text).unwrap();
        assert_eq!(text, "text ".repeat(100));
        assert_eq!(entry.compression(), CompressionMethod::Deflated);
        assert_eq!(entry.unix_mode(), Some(0o100_644));
    }
}
