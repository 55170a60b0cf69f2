"""The site of `cargo xtask site`: it contains every page and works from a folder: it sends no request, search works, nothing is
wider than a telephone."""

import os
import re
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import REPOSITORY, wait_until
from test_docs import tracked

SOURCES = REPOSITORY / "xtask" / "python" / "site"


def test_every_page_is_in_the_site() -> None:
    """Each page of docs/ and each notebook is once in the navigation."""
    listed = re.findall(
        r"^ +- (?:.*: )?([\w/-]+\.md)$", (SOURCES / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE
    )
    pages = [path.relative_to(REPOSITORY / "docs").as_posix() for path in tracked("docs/*.md")]
    notebooks = [f"examples/{path.stem}.md" for path in tracked("examples/*.ipynb")]
    generated = [page for page in listed if page.startswith("reference/") or page == "examples.md"]
    others = ["index.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
    assert sorted(listed) == sorted([*pages, *notebooks, *generated, *others])


@pytest.fixture(scope="module")
def site(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `cargo xtask site` builds it: a broken link or anchor is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", str(SOURCES / "mkdocs.yml")]
    environment = os.environ | {"FIVEBAR_FMU": str(fmu), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [*command, "--site-dir", str(folder)],
        cwd=REPOSITORY,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.nightly
def test_all_markdown_is_read(site: Path) -> None:
    """No mark of Markdown, and no formula, is left as text: lists, tables, blocks, formulas, folded listings."""
    left = re.compile(
        r"^(?:- |\* |\||```|\?\?\? ).*|<code>math\b.*|(?<=<p>)(?:- |```|\?\?\? ).*|\]\([\w/.#-]+\)", re.MULTILINE
    )
    for page in site.rglob("*.html"):
        if "live" not in page.parts:
            text = re.sub(
                r"<(pre|script|style|code(?!>math))\b.*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL
            )
            assert left.findall(text) == [], page.name


@pytest.mark.nightly
def test_links_have_titles_of_pages(site: Path) -> None:
    """A link whose text is the name of a file of docs/ has the title of that page, with the address as it was."""
    front = (site / "index.html").read_text(encoding="utf-8")
    assert '<a href="accuracy.html"><em>Choose a method</em></a>' in front
    notes = (site / "explicit.html").read_text(encoding="utf-8")
    assert '<a href="notes/explicit.html"><em>notes on DOP853 in the link angles</em></a>' in notes
    named = re.compile(r'<a href="[^"]*">(?!README|ARCHITECTURE|CONTRIBUTING|CHANGELOG)[\w/.-]+\.md</a>')
    for page in site.rglob("*.html"):
        if "source" not in page.parts:
            assert named.findall(page.read_text(encoding="utf-8")) == [], page.name


@pytest.mark.nightly
def test_a_screen_reader_finds_names(site: Path) -> None:
    """Each dialog has a name, and no head of a table is empty."""
    for page in site.rglob("*.html"):
        if "live" not in page.parts:
            text = page.read_text(encoding="utf-8")
            dialogs = re.findall(r'<[^>]*role="dialog"[^>]*>', text)
            assert dialogs and all("aria-label" in dialog for dialog in dialogs), page.name
            assert not re.search(r"<th\b[^>]*>\s*</th>", text), page.name


@pytest.mark.nightly
def test_wide_lines_of_a_shell_have_their_comments_above(site: Path) -> None:
    page = (site / "calibration.html").read_text(encoding="utf-8")
    block = re.sub(
        r"<[^>]+>",
        "",
        next(part for part in re.findall(r"<code>(.*?)</code>", page, re.DOTALL) if "viscous" in part and "\n" in part),
    )
    assert block.splitlines()[2:5] == [
        "# a table, and the unknowns",
        "fivebar calibrate bench.csv --scene my_machine.json \\",
        "    --parameters payload.mass --parameters link[1,4].mass --parameters viscous.b",
    ]


@pytest.mark.nightly
def test_a_wheel_has_room_for_it(site: Path) -> None:
    """Packed, it has at most 4 MB, the limit for what a wheel carries along."""
    packed = sum(len(zlib.compress(file.read_bytes())) for file in site.rglob("*") if file.is_file())
    assert 1_000_000 < packed < 4_000_000


@pytest.fixture(scope="module")
def browser(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser; at the end its console must have no warnings."""
    from browser import open_browser

    with open_browser((site / "my-machine.html").as_uri(), tmp_path_factory.mktemp("browser")) as driver:
        yield driver


WIDER = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
FOREIGN = "return performance.getEntriesByType('resource').map((e) => e.name).filter((n) => !n.startsWith('file:'))"
SLIVERS = "return [...document.querySelectorAll('td')].filter((cell) => cell.offsetWidth < 2 * parseFloat(getComputedStyle(cell).fontSize) && cell.textContent.length > 5).map((cell) => cell.textContent)"
BROKEN = (
    "return [...document.images].filter((image) => image.complete && !image.naturalWidth).map((image) => image.src)"
)
NAMELESS = "return [...document.images].filter((image) => !image.alt).map((image) => image.src)"


@pytest.mark.nightly
@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1280, "dark")])
def test_pages_fit(site: Path, browser: Any, width: int, scheme: str) -> None:
    """No page is wider than the window, uses the network, has a missing picture or one without a text alternative, or a column of single letters."""
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    pages = [page for page in sorted(site.rglob("*.html")) if "live" not in page.parts]
    assert len(pages) > 60
    for page in pages:
        browser.get(page.as_uri())
        assert browser.execute_script(WIDER) <= 0, f"{page.name} at {width} px"
        assert browser.execute_script(FOREIGN) == [], page.name
        assert browser.execute_script(NAMELESS) == [], page.name
        assert browser.execute_script(BROKEN) == [], page.name
        assert browser.execute_script(SLIVERS) == [], page.name


@pytest.mark.nightly
@pytest.mark.parametrize("page", ["my-machine.html", "index.html"])
def test_search_works_from_a_folder(site: Path, browser: Any, page: str) -> None:
    """Also on the front page, which has the live page if it has been made."""
    browser.get((site / page).as_uri())
    browser.execute_script("document.querySelector('input[name=query]').focus()")
    browser.switch_to.active_element.send_keys("errorTolerance")
    found = "return [...document.querySelectorAll('.md-search-result__link')].map((link) => link.getAttribute('href'))"
    wait_until(lambda: browser.execute_script(found))
    assert any("reference/variables.html" in link for link in browser.execute_script(found))


@pytest.mark.nightly
def test_variables_are_found_by_name(site: Path, browser: Any) -> None:
    browser.get((site / "reference" / "variables.html").as_uri())
    shown = (
        "return [...document.querySelectorAll('.variable')].filter((row) => row.checkVisibility()).map((row) => row.id)"
    )
    assert len(browser.execute_script(shown)) > 200
    browser.execute_script("document.getElementById('filter').focus()")
    browser.switch_to.active_element.send_keys("servo.kp")
    wait_until(lambda: browser.execute_script(shown) == ["servo.kp[1]", "servo.kp[2]"])
