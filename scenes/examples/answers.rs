//! Prints the reader's answer for each file named, as a line of JSON: the resolved scene, or the sentence of its refusal.
//! `tests/python/test_scene_readers.py` compares the reader of the Python package with these answers.

use std::env;
use std::path::Path;

use anyhow::Context;
use scenes::Scene;
use serde_json::Value as Json;

fn main() {
    for file in env::args().skip(1) {
        let answer = Scene::read_file(Path::new(&file)).and_then(|scene| scene.resolved().context(file));
        println!("{}", answer.unwrap_or_else(|error| Json::from(format!("{error:#}"))));
    }
}
