"""The code of tutorials and how-to pages. Python and `json` blocks are used in every run. Lines of a shell are checked against the commands' own
options; `--nightly` runs them, page by page, in the order of the page.

A block that is not run stands after a line *Not run by us.*, which may have a reason.
"""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import fivebar
from conftest import PATIENCE, REPOSITORY, started, wait_until
from fivebar.commands import COMMANDS
from fivebar.scene import read
from fivebar.twin.ensemble import what_if
from fivebar.twin.importing import maps
from fivebar.twin.messages import decode
from fivebar.twin.starter import free_port

DOCS = REPOSITORY / "docs"

MARK = re.compile(r"^\*Not run by us(?::[^*\n]*)?\.\*$")

FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)\n(?P<text>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL)

NO_CODE = {"text", "math"}
"""Output and formulas."""

OURS = ("fivebar", "fmpy")
"""Commands of the package and of what it needs."""

DEBIAN = ("openssl", "mosquitto", "mosquitto_passwd", "touch", "chmod", "echo", "export")
"""Programs of Debian packages, and of every shell."""


class Block(NamedTuple):
    page: str
    line: int
    language: str
    text: str
    marked: bool


def pages() -> list[str]:
    """The pages of docs/ among the tutorials and how-to pages of the site."""
    settings = (REPOSITORY / "xtask" / "python" / "site" / "mkdocs.yml").read_text(encoding="utf-8")
    [parts] = re.findall(r"^  - Tutorials:\n(.*?)^  - Reference:\n", settings, re.MULTILINE | re.DOTALL)
    return [name for name in re.findall(r"([\w/-]+\.md)$", parts, re.MULTILINE) if (DOCS / name).is_file()]


def blocks(page: str) -> Iterator[Block]:
    text = (DOCS / page).read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        before = text[: found.start()].rstrip().rpartition("\n")[2]
        content = re.sub(f"^{found['indent']}", "", found["text"], flags=re.MULTILINE)
        yield Block(
            page, text[: found.start()].count("\n") + 1, found["language"], content, bool(MARK.match(before.strip()))
        )


ALL = [block for page in pages() for block in blocks(page)]
RUN = [block for block in ALL if not block.marked and block.language not in NO_CODE]


def place(block: Block) -> str:
    return f"{block.page}:{block.line}"


def of(language: str) -> list[Block]:
    return [block for block in RUN if block.language == language]


def lines(block: Block) -> list[list[str]]:
    """The words of each command of a shell, without comments."""
    joined = block.text.replace("\\\n", " ")
    return [words for line in joined.splitlines() if (words := shlex.split(line, comments=True))]


def test_every_block_is_run_or_marked() -> None:
    """Blocks in other languages are marked; a line of a shell is a command of the package, of Debian or of this repository."""
    assert len(pages()) > 20 and len(RUN) > 30
    for block in RUN:
        assert block.language in ("python", "sh", "json"), (
            f"{place(block)}: nobody runs {block.language!r}; is it marked?"
        )
        for words in lines(block) if block.language == "sh" else ():
            known = words[0] in (*OURS, *DEBIAN) or words[:2] == ["cargo", "xtask"] or words[0].startswith(".ci/")
            assert known, f"{place(block)}: nobody runs {words[0]!r}; is it marked?"


def test_marks_stand_before_blocks_that_nobody_can_run() -> None:
    """A mark in front of a block that needs the package alone would hide it from the tests."""
    for block in ALL:
        if block.marked:
            alone = block.language == "sh" and all(words[0] in OURS for words in lines(block))
            assert not alone or "--scheduler" in block.text, place(block)


@pytest.mark.parametrize("block", of("sh"), ids=place)
def test_options_are_those_of_the_commands(block: Block) -> None:
    """`fivebar` by click's parsers; commands of the repository by their list in xtask."""
    known = {command.name: command for command in COMMANDS}
    xtask = (REPOSITORY / "xtask" / "src" / "main.rs").read_text(encoding="utf-8")
    for words in lines(block):
        if words[0] == "fivebar":
            command = known[words[1]]
            command.make_parser(command.context_class(command)).parse_args(words[2:])
        elif words[0] == "cargo":
            name = "".join(part.capitalize() for part in words[2].split("-"))
            assert re.search(rf"^    {name}\b", xtask, re.MULTILINE), words
        elif words[0].startswith(".ci/"):
            assert (REPOSITORY / words[0]).is_file(), words


KINDS: dict[str, Callable[[Any, Path], object]] = {
    "my-machine.md": lambda _, file: read(file),
    "hardware.md": lambda content, _: maps.parse(content),
    "recordings.md": lambda content, file: read(file) if "description" in content else maps.parse(content),
    "ensembles.md": lambda _, file: what_if.read(file),
    "pipeline.md": lambda content, file: decode(f"fivebar/bench/{content['measurement']}", file.read_bytes()),
}
"""What a block of JSON is on a page: a scene, a map, commands to compare, a message."""


@pytest.mark.parametrize("block", of("json"), ids=place)
def test_files_of_pages_are_read(block: Block, tmp_path: Path) -> None:
    file = tmp_path / "block.json"
    file.write_text(block.text, encoding="utf-8")
    assert KINDS[block.page](json.loads(block.text), file)


def prepared(page: str, folder: Path, fmu: Path) -> None:
    """The files that a page takes as given: its reader's machine, the unit, a record of the machine."""
    [machine] = [block.text for block in of("json") if block.page == "my-machine.md"]
    (folder / "my_machine.json").write_text(machine, encoding="utf-8")
    shutil.copy(fmu, folder / "FiveBar.fmu")
    if page == "first-master.md":
        command(["fivebar", "unit", "--scene", "my_machine.json"], folder, fmu)
    if page in ("calibration.md", "recordings.md", "validation.md"):
        run = fivebar.run(str(folder / "my_machine.json"), **{"payload.enabled": True, "payload.mass": 0.004})
        angles = [run[f"theta[{i}]"] for i in (1, 2)]
        columns = {"time": run["time"], "theta[1]": angles[0], "theta[2]": angles[1], "tau[1]": run["time"] * 0 + 0.01}
        if page == "recordings.md":
            text = next(block.text for block in of("json") if block.page == page)
            (folder / "map.json").write_text(text, encoding="utf-8")
            counts = [round(-(angle - 1.5707963267948966) * 8192 / 6.283185307179586) for angle in angles[0]]
            columns = {"t": 1e3 * run["time"], "enc_left": counts, "enc_right": angles[1] * 57.29577951308232}
            columns["current_left"] = run["time"] * 0 + 0.2
        rows = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
        (folder / "bench.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def surroundings(fmu: Path) -> dict[str, str]:
    """Programs of this environment first; browsers and windows do not open."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}{os.pathsep}/usr/sbin"
    return os.environ | {"PATH": path, "FIVEBAR_FMU": str(fmu), "MPLBACKEND": "Agg", "BROWSER": "true"}


def command(words: list[str], folder: Path, fmu: Path) -> "subprocess.CompletedProcess[str]":
    done = subprocess.run(
        words, cwd=folder, env=surroundings(fmu), capture_output=True, text=True, check=False, timeout=4 * PATIENCE
    )
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    return done


LONG = {"calibration.md"}
"""Pages whose Python takes half a minute on a busy machine."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.nightly) if page in LONG else page
        for page in sorted({block.page for block in of("python")})
    ],
)
def test_python_runs(page: str, fmu: Path, tmp_path: Path) -> None:
    """The blocks of a page one after the other, as a reader runs them who follows the page."""
    prepared(page, tmp_path, fmu)
    for block in of("python"):
        if block.page != page:
            continue
        if "libcosimpy" in block.text:
            pytest.importorskip("libcosimpy")  # of the group `full`
        done = command([sys.executable, "-c", block.text], tmp_path, fmu)
        assert done.returncode == 0, f"{place(block)}: {done.stderr}"


CODES = {"twin": (0, 1, 3), "check": (0, 1), "calibrate": (0, 1), "validate": (0, 1)}
"""Exit codes that judge a result and not the use of a command. A busy machine makes a twin late."""


@pytest.mark.nightly
@pytest.mark.parametrize("page", sorted({block.page for block in of("sh")}))
def test_shells_run(page: str, fmu: Path, tmp_path: Path) -> None:
    """The package's own lines of a page; of docs/deploy.md all."""
    prepared(page, tmp_path, fmu)
    mine = [block for block in of("sh") if block.page == page]
    if page == "deploy.md":
        deployed(mine, tmp_path, fmu)
        return
    for block in mine:
        for words in lines(block):
            if words[0] in OURS:
                run_line(words, tmp_path, fmu)


def run_line(words: list[str], folder: Path, fmu: Path) -> None:
    """A line, with the name of the last run in the place of RUN. Twins run for some seconds."""
    if "RUN" in " ".join(words) and not (folder / "twin" / "runs").exists():
        # The page takes a run as given.
        succeed(["fivebar", "twin", "--seconds", "8"], folder, fmu)
    with ExitStack() as stack:
        if words[:2] == ["fivebar", "twin"]:
            if "--open" in words:
                stack.enter_context(running(words, folder, fmu))
                return
            if "--seconds" in words:
                words = words[: words.index("--seconds")] + words[words.index("--seconds") + 2 :]
            words = [*words, "--seconds", "8"]
            if "--broker" in words:
                words[words.index("--broker") + 1] = stack.enter_context(
                    mosquitto(folder, "listener {port} 127.0.0.1\nallow_anonymous true\n")
                )
        elif "--broker" in words:
            words[words.index("--broker") + 1] = stack.enter_context(running(TWIN, folder, fmu))
        elif "--config" in words:
            stack.enter_context(running(TWIN, folder, fmu))
        words = [re.sub(r"\bRUN\b", newest(folder) if "RUN" in word else "", word) for word in words]
        succeed(words, folder, fmu)


TWIN = ["fivebar", "twin", "--scene", "my_machine.json", "--seconds", "inf"]


def succeed(words: list[str], folder: Path, fmu: Path) -> None:
    done = command(words, folder, fmu)
    allowed = CODES.get(words[1], (0,)) if words[0] == "fivebar" else (0,)
    assert done.returncode in allowed, f"{shlex.join(words)}: {done.stdout}{done.stderr}"


def newest(folder: Path) -> str:
    """The last run of the twin."""
    return max(path.name for path in (folder / "twin" / "runs").iterdir())


@contextmanager
def running(words: list[str], folder: Path, fmu: Path) -> Iterator[str]:
    """A twin until Ctrl-C; the address of its broker. Its machine moves and its state is stored."""
    process = subprocess.Popen(
        words, cwd=folder, env=surroundings(fmu), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        address = re.findall(r"broker at (\S+:\d+)", started(process))[0]
        wait_until(lambda: (folder / "twin" / "runs" / newest(folder) / "state" / "twin.json").is_file())
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode in CODES["twin"] and "Traceback" not in output, output


@contextmanager
def mosquitto(folder: Path, settings: str) -> Iterator[str]:
    """A broker at a free port, in a folder; its address."""
    port = free_port()
    (folder / "mosquitto.conf").write_text(settings.replace("{port}", str(port)))
    broker = subprocess.Popen(["/usr/sbin/mosquitto", "-c", "mosquitto.conf"], cwd=folder, stderr=subprocess.DEVNULL)
    try:
        yield f"127.0.0.1:{port}"
    finally:
        broker.terminate()
        broker.wait()


def deployed(mine: list[Block], folder: Path, fmu: Path) -> None:
    """Certificates and passwords as the page makes them, then the broker of its settings at a free port, then the twin at it."""
    for name in ("mosquitto.conf", "acl"):
        shutil.copy(REPOSITORY / "python" / "mosquitto" / name, folder)
    certificates, users, broker, twin = (block.text for block in mine)
    for text in (certificates, users):
        done = command(["bash", "-euc", text], folder, fmu)
        assert done.returncode == 0, done.stderr
    assert broker == "mosquitto -c mosquitto.conf\n"
    settings = (folder / "mosquitto.conf").read_text(encoding="utf-8")
    assert "listener 8883\n" in settings
    # Not as root, mosquitto would become another user, who reads no key of a test.
    settings = settings.replace("listener 8883\n", "listener {port} 127.0.0.1\n") + "user root\n"
    with mosquitto(folder, settings) as address:
        done = command(["bash", "-euc", twin.replace("127.0.0.1:8883", address)], folder, fmu)
    assert done.returncode in CODES["twin"] and "published" in done.stdout, done.stdout + done.stderr
