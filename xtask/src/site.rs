//! `cargo xtask site`: the documentation as a site that works from a folder, `target/site/`.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;
use clap::Args;
use std::path::Path;

/// Folder of the settings, hooks and generators.
const SOURCES: &str = "xtask/python/site";

#[derive(Args)]
pub(crate) struct Options {
    /// First run the notebooks of examples/ and store their outputs in them
    #[arg(long)]
    notebooks: bool,
}

/// Packs the unit, from which variables and pictures of scenes come, and builds the site. A broken link is an error.
pub(crate) fn site(options: &Options) -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    if options.notebooks {
        process::run(venv::python(Packages::Site)?.arg(Path::new(SOURCES).join("run_notebooks.py")).env("FIVEBAR_FMU", &fmu))?;
    }
    if let Some(sentence) = missing(&paths::page()) {
        println!("{sentence}");
    }
    let mut build = venv::python(Packages::Site)?;
    build.args(["-m", "mkdocs", "build", "--quiet", "--config-file"]).arg(Path::new(SOURCES).join("mkdocs.yml"));
    process::run(build.env("FIVEBAR_FMU", &fmu).env("SOURCE_DATE_EPOCH", "0").env("NO_MKDOCS_2_WARNING", "1"))?;
    println!("{}", paths::short(&paths::in_root("target/site/index.html")));
    Ok(())
}

/// A message if the live page for the front page is missing.
fn missing(page: &Path) -> Option<String> {
    (!page.is_file()).then(|| {
        format!(
            "the front page shows a picture, for there is no {}: `cargo xtask page`, which needs `.ci/setup-page`, makes it",
            paths::short(page)
        )
    })
}
