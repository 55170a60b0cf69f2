//! The reader's answers, a line of JSON for each file that is named: the scene with nothing left to look up, or the sentence of its
//! refusal. `tests/python/test_scene_readers.py` holds the reader of users to them.

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
