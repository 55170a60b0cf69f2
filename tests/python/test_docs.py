"""Consistency of the documentation: links work, equations are numbered in order, named things exist."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from conftest import REPOSITORY

DERIVATION = ("method", "vertices", "explicit", "derivatives", "conserving", "automatic")
"""The pages of docs/ that derive the mathematics, in the order of their equation numbers."""

ELSEWHERE = {"license.md", "LICENSE-MIT.md", "dual-encoders.md"}
"""Names of documents that are not in this repository: other projects have them, and the packer looks for them."""

IN_THE_SITE = {
    "index.md",
    "examples.md",
    "commands.md",
    "messages.md",
    "modules.md",
    "python.md",
    "schema.md",
    "variables.md",
}
"""Pages that only the site has: its front page and its reference, made by xtask/python/site."""

LINK = re.compile(r"\]\(([^)\s]+)\)")
POINTER = re.compile(
    r"docs/(\w[\w-]*)\.md[`)]*, (?:section (?P<section>[\d.]*\d)|equation \((?P<equation>\d+)\)|\"(?P<title>[^\"]+)\")"
)


def tracked(*patterns: str) -> list[Path]:
    """The files of the repository that match, including new ones that git does not track yet."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    names = subprocess.run(listed, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.split()
    return [REPOSITORY / name for name in names if (REPOSITORY / name).is_file()]


PAPERS = tracked("*.md")
SOURCES = tracked("*.rs", "*.py", "*.c", "*.h", "*.toml", "*.json", "*.html")


def prose(text: str) -> str:
    """The text without blocks of code and of mathematics."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def headings(text: str) -> list[str]:
    """The headings, without their marks."""
    return re.findall(r"^#+ (.+)$", prose(text), re.MULTILINE)


def anchor(heading: str) -> str:
    """GitHub's anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def short(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


@pytest.mark.parametrize("paper", PAPERS, ids=short)
def test_links_lead_somewhere(paper: Path) -> None:
    for link in LINK.findall(prose(paper.read_text(encoding="utf-8"))):
        if "://" in link:
            continue
        name, _, place = link.partition("#")
        target = (paper.parent / name).resolve() if name else paper
        assert target.exists(), f"{short(paper)} links to {link}, which does not exist"
        if place:
            assert place in map(anchor, headings(target.read_text(encoding="utf-8"))), (
                f"{short(paper)}: {link} has no such heading"
            )


def test_equations_are_numbered_in_order() -> None:
    texts = [(REPOSITORY / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in DERIVATION]
    numbers = [int(number) for text in texts for number in re.findall(r"\\tag\{(\d+)\}", text)]
    assert numbers == list(range(1, len(numbers) + 1))
    named = {int(number) for text in texts for number in re.findall(r"(?<![\w$\\])\((\d+)\)", prose(text))}
    assert named <= set(numbers)


def test_references_to_sections_are_right() -> None:
    """References such as `docs/method.md`, section 5, in documents and comments."""
    for file in [*PAPERS, *SOURCES]:
        if file == Path(__file__):
            continue
        for found in POINTER.finditer(file.read_text(encoding="utf-8")):
            text = (REPOSITORY / "docs" / f"{found[1]}.md").read_text(encoding="utf-8")
            titles = headings(text)
            if section := found["section"]:
                there = any(re.match(rf"{re.escape(section)}\.? ", title) for title in titles)
            elif equation := found["equation"]:
                there = f"\\tag{{{equation}}}" in text
            else:
                there = any(re.sub(r"^[\d.]+ ", "", title) == found["title"] for title in titles)
            assert there, f"{short(file)} refers to {found[0]}, which does not exist"


def test_no_paper_is_named_that_is_not_there() -> None:
    there = {paper.name for paper in PAPERS} | ELSEWHERE | IN_THE_SITE
    for file in [*PAPERS, *SOURCES]:
        if file != Path(__file__):
            missing = set(re.findall(r"[\w-]+\.md\b", file.read_text(encoding="utf-8"))) - there
            assert not missing, f"{short(file)} names {sorted(missing)}"


def test_files_named_in_the_architecture_exist() -> None:
    """Paths in backticks. A name without a folder is in the folder of the path before it, or anywhere in the sources."""
    names = {path.name for path in SOURCES}
    for name in re.findall(
        r"`([\w./-]+(?:\.(?:rs|py|xml)|/))`", (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
    ):
        assert (REPOSITORY / name).exists() or name in names, f"ARCHITECTURE.md names {name}, which does not exist"


def test_tests_named_in_documents_exist() -> None:
    """Names with underscores in docs/scope.md and CONTRIBUTING.md: a test, a scene, or something else that a source defines."""
    code = "\n".join(source.read_text(encoding="utf-8") for source in SOURCES if source.suffix in (".rs", ".py"))
    known = set(re.findall(r"\b(?:fn|def) (\w+)", code)) | {
        path.stem for path in (REPOSITORY / "scenes").glob("*.json")
    }
    for paper in ("docs/scope.md", "CONTRIBUTING.md"):
        names = set(re.findall(r"`([a-z][a-z0-9]*_[a-z0-9_]+)`", (REPOSITORY / paper).read_text(encoding="utf-8")))
        assert names and names <= known, f"{paper} names {sorted(names - known)}"


def test_the_machine_of_the_docs_runs(fmu: Path) -> None:
    """The scene in docs/my-machine.md runs: its motion is finite, and its energies balance."""
    (block,) = re.findall(
        r"^```json\n(.*?)^```$",
        (REPOSITORY / "docs" / "my-machine.md").read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    values = json.loads(block)
    stop = values.pop("experiment")["stopTime"]
    assert values.pop("description")
    result = simulate_fmu(str(fmu), stop_time=stop, start_values=values, output=["tip.x", "energy.error"])
    assert np.ptp(result["tip.x"]) > 0.001
    # The energies of this machine are some mJ.
    assert np.max(np.abs(result["energy.error"])) < 1e-6
