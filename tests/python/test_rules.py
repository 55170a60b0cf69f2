"""docs/notes/fmi.md lists every rule once, and every test that it names exists."""

import re
from pathlib import Path

import pytest

from conftest import REPOSITORY

DOCS = REPOSITORY / "docs" / "notes" / "fmi.md"
ROW = re.compile(r"^\| (\d+) \| .+ \| (.+) \|$", re.MULTILINE)
TEST = re.compile(r"`([\w/]+\.(?:rs|py))::(\w+)`")
FOLDERS = ("modelDescription", "src", "tests", "xtask")


def sources(suffix: str) -> list[Path]:
    """Files of the repository with paths that end in `suffix`."""
    found = (path for folder in FOLDERS for path in (REPOSITORY / folder).rglob(Path(suffix).name))
    return [path for path in found if f"/{path.relative_to(REPOSITORY).as_posix()}".endswith(f"/{suffix}")]


def has_test(text: str, file: str, name: str) -> bool:
    """Whether the text defines a test of this name that runs."""
    form = rf"^def {name}\(" if file.endswith(".py") else rf"#\[test\]\n\s*fn {name}\("
    return re.search(form, text, re.MULTILINE) is not None


ROWS = [(int(number), TEST.findall(tests)) for number, tests in ROW.findall(DOCS.read_text(encoding="utf-8"))]


def test_every_rule_is_there_once() -> None:
    assert [number for number, _ in ROWS] == list(range(1, 58))


@pytest.mark.parametrize(("number", "tests"), ROWS, ids=[f"rule {number}" for number, _ in ROWS])
def test_every_test_exists(number: int, tests: list[tuple[str, str]]) -> None:
    assert tests, f"rule {number} has no test"
    for file, name in tests:
        found = sources(file)
        assert len(found) == 1, f"{file} is {len(found)} files"
        assert has_test(found[0].read_text(encoding="utf-8"), file, name), f"{file} has no test {name}"
