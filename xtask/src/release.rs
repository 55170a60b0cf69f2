//! `cargo xtask release`: the files of a release, in `target/release-files/`.

use crate::package::{self, Files, Scope};
use crate::venv::{self, Packages};
use crate::{page, paths, process, site, wheel};
use anyhow::{Context, Result, ensure};
use serde_json::{Value as Json, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::{self, File};
use std::io::Read;
use std::path::Path;
use zip::ZipArchive;

/// Heading of the version's part of the change log.
const NOTES: &str = "release-notes.txt";

/// Makes wheel, sdist, the .fmu, licences, notes, a bill of materials, and checksums of all of them.
///
/// With libraries for all platforms the wheel contains the live page and the site, built again: the page would contain another library.
pub(crate) fn release(scope: Scope) -> Result<()> {
    if matches!(scope, Scope::All) {
        page::page()?;
        site::site(&site::Options::default())?;
    }
    let fmu = package::package(scope)?;
    let folder = paths::in_root("target/release-files");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    fs::create_dir_all(&folder)?;
    for file in [&fmu, &paths::in_root("LICENSE-MIT"), &paths::in_root("LICENSE-APACHE")] {
        fs::copy(file, folder.join(file.file_name().context("a file has a name")?)).with_context(|| paths::short(file))?;
    }
    wheel::build(&fmu, &["wheel", "sdist"], &folder)?;
    let licenses = licenses(&fmu).with_context(|| paths::short(&fmu))?;
    fs::write(folder.join("THIRD-PARTY-LICENSES.txt"), page::notices(&licenses))?;
    let changes = fs::read_to_string(paths::in_root("CHANGELOG.md"))?;
    fs::write(folder.join(NOTES), notes(&changes, env!("CARGO_PKG_VERSION"))?)?;
    let bill = bill(&crates(&licenses)?, &python_packages()?, &fs::read_to_string(paths::in_root("Cargo.lock"))?)?;
    let bill_file = folder.join("fivebar.cdx.json");
    fs::write(&bill_file, serde_json::to_string_pretty(&bill)?)?;
    process::run(venv::python(Packages::Release)?.arg("xtask/python/check_bill.py").arg(bill_file))?;
    let sums = checksums(&folder)?;
    fs::write(folder.join("SHA256SUMS"), &sums)?;
    print!("{}:\n{sums}", paths::short(&folder));
    Ok(())
}

/// Licence files of everything in a unit, by name.
fn licenses(fmu: &Path) -> Result<Files> {
    let mut archive = ZipArchive::new(File::open(fmu)?)?;
    let mut files = Files::new();
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index)?;
        let name = entry.name()?.into_owned();
        if name.starts_with("documentation/licenses/") {
            let mut text = Vec::new();
            entry.read_to_end(&mut text)?;
            files.insert(name, text);
        }
    }
    Ok(files)
}

/// A crate that is linked into a library.
#[derive(Debug, PartialEq)]
struct Crate {
    name: String,
    version: String,
    license: String,
}

/// The crates in the summary of licences; its lines have name, version and licence.
fn crates(licenses: &Files) -> Result<Vec<Crate>> {
    let summary = licenses.get("documentation/licenses/license.txt").context("license.txt is missing")?;
    let listed: Vec<Crate> = String::from_utf8_lossy(summary)
        .lines()
        .filter_map(|line| {
            let (title, license) = line.strip_prefix("    ")?.split_once(' ')?;
            let (name, version) = title.rsplit_once('-')?;
            Some(Crate { name: name.into(), version: version.into(), license: license.trim().into() })
        })
        .collect();
    ensure!(!listed.is_empty(), "license.txt lists no crate");
    Ok(listed)
}

/// The change log's part on a version; an error if missing.
fn notes(changes: &str, version: &str) -> Result<String> {
    let sections = changes.split("\n## ").skip(1);
    let section = sections.into_iter().find(|section| section.split_whitespace().next() == Some(version));
    let section = section.with_context(|| format!("CHANGELOG.md has no section on {version}"))?;
    Ok(format!("# FiveBar {}\n", section.trim_end()))
}

/// The crates linked into the libraries and the Python packages required by the wheel, as a CycloneDX 1.6 document.
///
/// Written by hand: a component has five fields, but the crate cyclonedx-bom brings 60 dependencies and ends at version 1.5.
fn bill(crates: &[Crate], python: &Json, lock: &str) -> Result<Json> {
    let sums = sums_of(lock);
    let mut components = Vec::new();
    for linked in crates {
        let sum = sums.get(&(linked.name.as_str(), linked.version.as_str()));
        let sum = sum.with_context(|| format!("Cargo.lock has no checksum of {} {}", linked.name, linked.version))?;
        components.push(json!({
            "type": "library",
            "bom-ref": format!("pkg:cargo/{}@{}", linked.name, linked.version),
            "purl": format!("pkg:cargo/{}@{}", linked.name, linked.version),
            "name": linked.name,
            "version": linked.version,
            "licenses": [{ "expression": linked.license }],
            "hashes": [{ "alg": "SHA-256", "content": sum }],
        }));
    }
    components.extend(python.as_array().context("the Python packages are a list")?.iter().cloned());
    let version = env!("CARGO_PKG_VERSION");
    let this = format!("pkg:pypi/fivebar@{version}");
    let parts: Vec<&Json> = components.iter().map(|component| &component["bom-ref"]).collect();
    Ok(json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": { "component": {
            "type": "library", "bom-ref": this, "purl": this, "name": "fivebar", "version": version,
            "licenses": [{ "expression": env!("CARGO_PKG_LICENSE") }],
        }},
        "dependencies": [{ "ref": this, "dependsOn": parts }],
        "components": components,
    }))
}

/// Checksums of Cargo.lock by name and version.
fn sums_of(lock: &str) -> BTreeMap<(&str, &str), &str> {
    lock.split("[[package]]")
        .filter_map(|package| {
            let value =
                |key: &str| package.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(" = \"")?.strip_suffix('"'));
            Some(((value("name")?, value("version")?), value("checksum")?))
        })
        .collect()
}

/// The packages required by the wheel, and their own requirements, as installed in the environment of the tests.
fn python_packages() -> Result<Json> {
    let script = paths::in_root("xtask/python/components.py");
    Ok(serde_json::from_str(&process::output(venv::python(Packages::Usual)?.arg(script))?)?)
}

/// Lines of SHA256SUMS, for `sha256sum --check`.
fn checksums(folder: &Path) -> Result<String> {
    let mut files = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    files.sort();
    let mut lines = String::new();
    for file in files {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        ensure!(file.is_file(), "{name} is no file");
        let sum = Sha256::digest(fs::read(&file)?);
        let digits: String = sum.iter().map(|byte| format!("{byte:02x}")).collect();
        writeln!(lines, "{digits}  {name}").expect("writing to a string does not fail");
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_notes_are_those_of_the_version() {
        let changes = "# Changelog\n\n## 0.2.0 (unreleased)\n\nNew.\n\n## 0.1.0\n\nFirst.\n";
        assert_eq!(notes(changes, "0.1.0").unwrap(), "# FiveBar 0.1.0\n\nFirst.\n");
        assert_eq!(notes(changes, "0.2.0").unwrap(), "# FiveBar 0.2.0 (unreleased)\n\nNew.\n");
        assert_eq!(notes(changes, "0.3.0").unwrap_err().to_string(), "CHANGELOG.md has no section on 0.3.0");
        let ours = fs::read_to_string(paths::in_root("CHANGELOG.md")).unwrap();
        assert!(notes(&ours, env!("CARGO_PKG_VERSION")).is_ok(), "this version's");
    }

    #[test]
    fn the_bill_has_each_crate_with_its_checksum_and_each_package() {
        let summary = "The crates:\n\n    libm-0.2.16              MIT\n    num-dual-0.15.1          MIT OR Apache-2.0\n\n    zig/LICENSE.txt\n";
        let listed =
            crates(&Files::from([("documentation/licenses/license.txt".to_owned(), summary.as_bytes().to_vec())])).unwrap();
        assert_eq!(listed.len(), 2);
        assert_eq!((listed[1].name.as_str(), listed[1].version.as_str()), ("num-dual", "0.15.1"));
        let lock = "[[package]]\nname = \"libm\"\nversion = \"0.2.16\"\nchecksum = \"aa\"\n\n[[package]]\nname = \"num-dual\"\nversion = \"0.15.1\"\nchecksum = \"bb\"\n";
        let bill = bill(&listed, &json!([{ "bom-ref": "pkg:pypi/fmpy@1" }]), lock).unwrap();
        assert_eq!(bill["components"][1]["hashes"][0]["content"], "bb");
        assert_eq!(bill["components"][1]["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert_eq!(
            bill["dependencies"][0]["dependsOn"],
            json!(["pkg:cargo/libm@0.2.16", "pkg:cargo/num-dual@0.15.1", "pkg:pypi/fmpy@1"])
        );
    }

    #[test]
    fn checksums_are_as_sha256sum_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("b"), "").unwrap();
        fs::write(folder.path().join("a"), "abc").unwrap();
        let sums = checksums(folder.path()).unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  a\n\
                        e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855  b\n";
        assert_eq!(sums, expected);
    }
}
