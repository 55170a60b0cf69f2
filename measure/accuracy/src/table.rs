//! CSV tables that state their origin.

use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};

/// The folder of the tables.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    /// Machine, compiler, commit, command: the comment line at the head of every table.
    about: String,
}

impl Folder {
    /// Creates the folder.
    pub fn new(path: PathBuf, about: String) -> Result<Self> {
        fs::create_dir_all(&path).with_context(|| format!("{} cannot be made", path.display()))?;
        Ok(Self { path, about: about.replace('\n', " ") })
    }

    /// Creates a file with the comment line, which starts with `#`.
    pub fn file(&self, name: &str) -> Result<File> {
        let path = self.path.join(format!("{name}.csv"));
        let mut file = File::create(&path).with_context(|| format!("{} cannot be written", path.display()))?;
        writeln!(file, "# {}", self.about)?;
        Ok(file)
    }

    /// Writes the table `name`.
    pub fn write<I: IntoIterator<Item = Vec<String>>>(&self, name: &str, head: &[&str], rows: I) -> Result<()> {
        let mut writer = csv::Writer::from_writer(self.file(name)?);
        writer.write_record(head)?;
        for row in rows {
            writer.write_record(row)?;
        }
        writer.flush()?;
        Ok(())
    }
}
