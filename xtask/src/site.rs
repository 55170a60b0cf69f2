//! `cargo xtask site`: the documentation as a site that works from a folder, `target/site/`.

use crate::package::{self, Scope};
use crate::stamp::{self, State};
use crate::venv::{self, Packages};
use crate::{page, paths, process};
use anyhow::{Context, Result};
use clap::Args;
use std::path::Path;

/// Folder of the settings, hooks and generators.
const SOURCES: &str = "xtask/python/site";

/// The front page.
const INDEX: &str = "target/site/index.html";

#[derive(Args, Default)]
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
    if let Some(sentence) = of_page(page::state()?, &paths::page()) {
        println!("{sentence}");
    }
    let sources = sources()?;
    let mut build = venv::python(Packages::Site)?;
    build.args(["-m", "mkdocs", "build", "--quiet", "--config-file"]).arg(Path::new(SOURCES).join("mkdocs.yml"));
    process::run(build.env("FIVEBAR_FMU", &fmu).env("SOURCE_DATE_EPOCH", "0").env("NO_MKDOCS_2_WARNING", "1"))?;
    let index = paths::in_root(INDEX);
    stamp::write(index.parent().context("the site lies in a folder")?, &sources)?;
    println!("{}", paths::short(&index));
    Ok(())
}

/// Makes a site again that was made from other sources, as a wheel would carry it. If there is none, says how to make one.
pub(crate) fn refresh() -> Result<()> {
    match stamp::state(&paths::in_root(INDEX), &sources()?) {
        State::Current => Ok(()),
        State::Missing => {
            println!("the package comes without the site, for there is no {INDEX}: `cargo xtask site` makes it");
            Ok(())
        }
        State::Old => {
            println!("{INDEX} was made from other sources and is made again");
            site(&Options::default())
        }
    }
}

/// What the site is made from: any file of the repository, because pages show docs, docstrings, sources and runs of the unit; and the live
/// page.
fn sources() -> Result<String> {
    stamp::sources(&["."], &[&paths::page()])
}

/// A message if the live page for the front page is missing or old.
fn of_page(state: State, page: &Path) -> Option<String> {
    let page = paths::short(page);
    let make = "`cargo xtask page`, which needs `.ci/setup-page`,";
    match state {
        State::Current => None,
        State::Missing => Some(format!("the front page shows a picture, for there is no {page}: {make} makes it")),
        State::Old => Some(format!("the front page has a live page from other sources, {page}: {make} makes it again")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_live_page_that_is_missing_or_old_is_reported() {
        let page = paths::in_root("target/no/fivebar.html");
        assert_eq!(of_page(State::Current, &page), None);
        for state in [State::Missing, State::Old] {
            let sentence = of_page(state, &page).unwrap();
            assert!(sentence.contains("target/no/fivebar.html: `cargo xtask page`"), "{sentence}");
        }
    }
}
