"""Both readers of scenes, the package and the crate `scenes` of the measuring programs, give the same values and errors."""

import json
import random
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import REPOSITORY
from fivebar import scene
from fivebar.errors import FiveBarError
from fivebar.variables import of_unit

MADE = 80
"""Number of mutated files."""

ODD = (
    None, True, False, 0, -0.0, 1, -1, 3, 1.5, 1e-300, 1e300, -1e17, 2**31, 2**63, 2**64, 10**30, 0.30000000000000004, "", " ", "plus", "minus",
    "rk4", "stick", "ü 𝛼", "two\nlines", "a\u2028b", [], {}, [[0, 1]], [[0, 0], [1, 1]], {"linear": [[0, 0], [0.7, 1e-3]]},
    {"steps": [[0, 0], [0.1, 2]]}, {"minimumJerk": [[0.1, 0], [0.2, 1], [1, 0.3]]}, {"rateOf": "servo.theta[1]"}, {"stopTime": 0.3},
    {"stopTime": 1, "stepSize": 0.3}, {"stepSize": 1e-9, "stopTime": 50}, [{"label": "a"}], [{"label": "a", "tau[1]": 1}, {"label": "a"}],
)  # fmt: skip

TEXTS = (
    "", " ", "{}", "[]", "3", "null", '"a"', "{", '{"description": "a"', '{"description": "a"}}', '{"description": "a",}', "{'description': 'a'}",
    '{"description": "a"} ', '\ufeff{"description": "a"}', '{"description": "a", "tau[1]": NaN}', '{"description": "a", "tau[1]": Infinity}',
    '{"description": "a", "tau[1]": 1e400}', '{"description": "a", "tau[1]": -0}', '{"description": "a", "tau[1]": 01}',
    '{"description": "a", "tau[1]": 1.}', '{"description": "a", "tau[1]": .5}', '{"description": "a", "tau[1]": +1}',
    '{"description": "a", "tau[1]": 1' + 400 * "0" + "}", '{"description": "a", "tau[1]": 0.' + 400 * "3" + "}",
    '{"description": "a", "solver.maxIterations": 20.0}', '{"description": "a", "solver.maxIterations": -0}',
    '{"description": "a", "solver.maxIterations": 18446744073709551616}', '{"description": "a", "tau[1]": 1, "tau[1]": 1}',
    '{"description": "a", "overlay": [{"label": "b", "label": "c"}]}', '{"description": "a\\ud800"}', '{"description": "\\ud83d\\ude00"}',
    '{"description": "a\tb"}', '{"description": "a\\tb"}', '{"description": "a\\u0000b"}', '{"description": "\\uffff"}', '{"description": "\\u0085"}',
    '{"description": "\\u00a0"}', '{"description": "a", "signals": ' + 9 * "[" + 9 * "]" + "}", '{"description": "a", "signals": ' + 100_000 * "[",
    '{"description": "a", "link[2].length": 0.1, "link[2].Length": 0.1}', '{"description": "a", "": 1}', '{"description": "a", "tip.vx": 1}',
    '{"description": "a", "tip.x": 1}', '{"description": "a", "encoder.offset[1]": 4}', '{"description": "a", "signals": {"tip.y": {"linear": [[0, 0], [1, 1]]}}}',
    '{"description": "a", "signals": {"tau[1]": {"linear": [[0, 0], [1e9, 1]]}}, "experiment": {"stopTime": 1e9, "stepSize": 1e-9}}',
    '{"description": "a", "signals": {"tau[1]": {"minimumJerk": [[0, 0], [1e-320, 1], [1, 0]]}}}',
    '{"description": "a", "signals": {"tau[1]": {"linear": [[0, 0], [0.3, 1e308], [0.7, -1e308]]}}, "experiment": {"stopTime": 1, "stepSize": 0.07}}',
    '{"description": "a", "signals": {"tau[1]": {"linear": [[0, 0], [0.7, 1e-3]]}, "tau[2]": {"minimumJerk": [[0, 0], [1.3, 1e-3]]}}}',
    '{"description": "a", "signals": {"payload.mass": {"steps": [[0, 0], [0.1, 0.05]]}}, "experiment": {"stepSize": 0.01}}',
    '{"description": "a", "signals": {"tau[1]": {"linear": [[-2, 0], [-1, 1e-3]]}}}',
    '{"description": "a", "signals": {"servo.theta[1]": {"linear": [[0, 1], [0.4, 2]]}, "servo.omega[1]": {"rateOf": "servo.theta[1]"}}}',
    '{"$schema": "./a.json", "description": "a"}', '{"$schema": 3, "description": "a"}', '{"$schema": " ", "description": "a"}',
    '{"description": "a", "x": "' + 4_000_000 * "a" + '"}',
)  # fmt: skip


OF_THE_PACKAGE = ", which the Python package fivebar reads and this reader does not"
"""End of the sentence with which measuring programs refuse forms of scenes that only users need."""


def sentences() -> Iterator[str]:
    """Contents that scenes/src/tests.rs expects to be refused."""
    text = (REPOSITORY / "scenes" / "src" / "tests.rs").read_text(encoding="utf-8")
    for content in re.findall(r"\(json!\((\{.*\})\), &?\[", text):
        if "knots" not in content and "_u64" not in content and "\\u{" not in content:
            yield json.dumps({"description": "trial"} | json.loads(content))


def accident(text: str, seed: int) -> str:
    """A shipped scene with a random mutation of a value, a key, an object or a letter."""
    chance = random.Random(seed)
    if seed % 4 == 0:
        at = chance.randrange(len(text))
        return (
            text[:at]
            + chance.choice(["", "", '"', "}", "[", ",", "0", "e", "\\", "\u00e9", text[at] * 2])
            + text[at + 1 :]
        )
    content = json.loads(text)
    holders: list[Any] = [content]
    for holder in holders:
        holders += [
            value
            for value in (holder.values() if isinstance(holder, dict) else holder)
            if isinstance(value, (dict, list)) and value
        ]
    holder = chance.choice(holders)
    key = chance.choice(list(holder)) if isinstance(holder, dict) else chance.randrange(len(holder))
    if seed % 4 == 1 and isinstance(holder, dict):
        holder[
            chance.choice([key + "x", key.upper(), "signals", "overlay", "experiment", "label", "servo.theta[2]"])
        ] = holder.pop(key)
    elif seed % 4 == 2:
        del holder[key]
    else:
        holder[key] = chance.choice(ODD)
    return json.dumps(content, ensure_ascii=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, scenes: Path) -> list[Path]:
    """Shipped scenes, unusual scenes, and mutated scenes."""
    shipped = [file.read_text(encoding="utf-8") for file in sorted(scenes.glob("*.json"))]
    texts = [*shipped, *TEXTS, *sentences(), *(accident(shipped[seed % len(shipped)], seed) for seed in range(MADE))]
    folder = tmp_path_factory.mktemp("scenes")
    made = [folder / f"s{i}.json" for i in range(len(texts))]
    for file, text in zip(made, texts):
        file.write_text(text, encoding="utf-8")
    binary, missing, itself = folder / "binary.json", folder / "missing.json", folder / "folder.json"
    binary.write_bytes(b'{"description": "\xff"}')
    itself.mkdir()
    return [*made, binary, missing, itself]


def test_both_readers_give_the_same_answers(files: list[Path]) -> None:
    """Scenes are equal to the bit; errors except for the parser's own words and suggested names."""
    known = of_unit()
    answers = subprocess.run(
        ["cargo", "run", "--quiet", "--locked", "--package", "scenes", "--example", "answers", "--", *map(str, files)],
        cwd=REPOSITORY, capture_output=True, text=True, encoding="utf-8", check=True,
    ).stdout.removesuffix("\n").split("\n")  # fmt: skip
    good = refused = elsewhere = 0
    for file, line in zip(files, answers, strict=True):
        theirs = json.loads(line)
        if isinstance(theirs, str) and OF_THE_PACKAGE in theirs:
            elsewhere += 1
            continue
        try:
            ours: Any = scene.of_file(file, known).resolved()
        except FiveBarError as error:
            ours = str(error)
        if isinstance(theirs, str) and isinstance(ours, str):
            assert plain(ours) == plain(theirs), file.read_bytes()[:300] if file.is_file() else file
            refused += 1
        else:
            assert json.dumps(ours) == json.dumps(theirs), file.read_bytes()[:300]
            good += 1
    assert good > 40 and refused > 100 and 1 < elsewhere < 6, (good, refused, elsewhere)


def plain(sentence: str) -> str:
    """A sentence without the parser's words and suggestions, with numbers parsed."""
    for words in ("it is not valid JSON", "it cannot be read"):
        if words in sentence:
            return sentence[: sentence.index(words) + len(words)]
    sentence = re.split(r"; (?:did you mean|known are) ", sentence)[0]
    assert "\n" not in sentence
    return re.sub(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", lambda found: repr(float(found[0])), sentence)[:200]
