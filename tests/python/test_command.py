"""The command `fivebar` and the functions of the package: output, errors, exit codes, no partial files."""

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import fivebar
from fivebar import extras, shipped
from fivebar.commands import fivebar as group
from fivebar.commands import main
from fivebar.errors import FiveBarError

FALL = {"description": "A short fall.", "experiment": {"stopTime": 0.05}, "init.theta[2]": 2.0944}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmu: Path) -> Path:
    """An empty working directory with a space and an umlaut in its name."""
    folder = tmp_path / "in der Übung"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    return folder


@pytest.mark.parametrize("name", list(group.commands))
def test_help_teaches(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The help begins with the purpose, as the list of subcommands does, and explains every option; it needs no packages."""
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    first = text.split("\n\n")[1].strip()
    assert text.startswith(f"Usage: fivebar {name}") and first.endswith(".")
    for option in group.commands[name].params:
        assert getattr(option, "help", None) or option.param_type_name == "argument", option.name
    assert main(["--help"]) == 0
    assert first in capsys.readouterr().out


def test_without_a_subcommand_there_is_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "fivebar run fall_90_120 --open" in capsys.readouterr().err
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"fivebar {fivebar.__version__}\n"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["fly"], "fivebar: No such command 'fly'; `fivebar --help` shows the usage"),
        (["run"], "fivebar run: Missing argument 'SCENE|FILE'; `fivebar run --help` shows the usage"),
        (["run", "--fast"], "fivebar run: No such option '--fast'"),
        (["run", "fly"], "fivebar run: there is no scene 'fly'; there are bounce, "),
        (["run", ""], "fivebar run: there is no scene ''; there are"),
        (["run", ".."], "fivebar run: there is no scene '..'; there are"),
        (["run", "../swing"], "fivebar run: there is no scene '../swing'; did you mean 'swing'?"),
        (["run", "swing\0"], "fivebar run: there is no scene 'swing\\x00'; did you mean 'swing'?"),
        (["run", "Swing.json"], "fivebar run: Swing.json: it cannot be read: No such file or directory; did you mean 'swing'?"),
        (["map", "pick_place"], "fivebar map: there is no scene 'pick_place'; did you mean 'pick_and_place'"),
        (["unit", "--scene", "haptik"], "fivebar unit: there is no scene 'haptik'; did you mean 'haptic'"),
        (["ensemble", "--scene", "fall_90_12"], "fivebar ensemble: there is no scene 'fall_90_12'; did you mean 'fall_90_120'"),
        (["run", "none.json"], "fivebar run: none.json: it cannot be read: No such file or directory"),
        (["run", "swing", "--method", "euler"], "fivebar run: 'solver.method' must be one of i3alp, i3alpPrinted, "),
        (["run", "swing", "--set", "tau[1]"], "fivebar run: --set 'tau[1]' is not of the form NAME=VALUE"),
        (["run", "swing", "--set", "tau[1]=much"], "fivebar run: 'tau[1]' must be a number in N.m"),
        (["run", "swing", "--set", "tau[1]=NaN"], "fivebar run: 'tau[1]' must be a number in N.m"),
        (["run", "swing", "--set", "tau[1]=[1]"], "fivebar run: 'tau[1]' must be a number in N.m"),
        (["run", "swing", "--set", "tau[3]=1"], "fivebar run: there is no variable 'tau[3]'; did you mean"),
        (["run", "swing", "--set", "gravity.enabled=1"], "fivebar run: 'gravity.enabled' must be true or false, not 1"),
        (["run", "swing", "--set", "tip.x=1"], "fivebar run: 'tip.x' is computed by the FMU and cannot be set"),
        (["run", "swing", "--set", "init.theta[1]=3.2", "--set", "init.theta[2]=0"], "fivebar run: "),
        (["run", "swing", "--fmu", "none.fmu"], "fivebar run: there is no .fmu at none.fmu"),
        (["run", "swing", "--fmu", __file__], f"fivebar run: {__file__} is not an .fmu: a ZIP archive with"),
        (["ensemble", "--vary", "foo=1"], "fivebar ensemble: foo cannot be varied: foo is not a parameter of the machine; "),
        (["run", "swing", "--out", "/proc/nowhere"], "fivebar run: out is /proc/nowhere; a folder that exists or can be made is needed: "),
        (["run", "swing", "--out", ""], "fivebar run: Invalid value for '--out' / '-o': '' names no file or folder; "),
        (["replay", "none"], "fivebar replay: there is no record at none"),
        (["calibrate"], "fivebar calibrate: a FILE is needed"),
        (["ensemble", "--scene", "swing", "--state", "x"], "fivebar ensemble: --scene and --state are both given; one start is needed"),
        (["ensemble", "--members", "many"], "fivebar ensemble: Invalid value for '--members': 'many' is not a valid integer"),
        (["what-if"], "fivebar what-if: Missing option '--config'"),
        (["soak", "--hours", "0"], "fivebar soak: hours are 0; more than 0"),
        (["twin", "--scene", "fly"], "fivebar twin: there is no scene 'fly'"),
        (["twin", "--csv", "none.csv"], "fivebar twin: none.csv: it cannot be read: No such file"),
        (["twin", "--machine", "none", "--csv", "none.csv"], "fivebar twin: none.csv: it cannot be read: No such file"),
        (["twin", "--csv", "a.csv", "--hidden", "b.json"], "fivebar twin: hidden is b.json, but only the stand-in has hidden properties"),
        (["twin", "--machine", "none", "--hidden", "b.json"], "fivebar twin: hidden is b.json, but only the stand-in has hidden properties"),
        (["twin", "--machine", "none", "--faults", "lost=0.1"], "fivebar twin: faults are 'lost=0.1', but --machine none sends no messages"),
        (["calibrate", "none.csv"], "fivebar calibrate: none.csv: it cannot be read: No such file"),
        (["twin", "--scene", "bounse"], "fivebar twin: there is no scene 'bounse'; did you mean 'bounce'?"),
    ],
)  # fmt: skip
def test_refusals_are_one_sentence(
    words: list[str], sentence: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sentence is on standard error, the exit code is 2, and no file is written."""
    assert main(words) == 2
    [line] = [line for line in capsys.readouterr().err.splitlines() if "real time" not in line]
    assert line.startswith(sentence)
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_scene_may_have_a_byte_order_mark(encoding: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Editors on Windows write one."""
    text = '{"description": "größer", "experiment": {"stopTime": 0.01}, "tau[1]": 0.5}'
    Path("own.json").write_text(text, encoding=encoding)
    assert main(["run", "own.json"]) == 0
    assert capsys.readouterr().out.startswith("own: größer")


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("empty", "", "it is not valid JSON: "),
        ("blank", " \n ", "it is not valid JSON: "),
        (
            "binary",
            b"\x7fELF\xff",
            "it cannot be read: it is not valid UTF-8 at byte 4; text in UTF-8, or in UTF-16 with",
        ),
        ("huge", b" " * 4_000_001, "it has more than 4000000 bytes"),
        ("deep", "[" * 100_000, "it is not valid JSON: "),
        ("list", "[]", "a scene must be an object of variable names and values"),
        ("text", '"a"', "a scene must be an object of variable names and values"),
        ("doubled", '{"description": "a", "tau[1]": 1, "tau[1]": 2}', "it is not valid JSON: 'tau[1]' is given twice"),
        ("untold", "{}", "it has no text 'description'"),
        ("number", '{"description": 5}', "'description' must be a text, not 5"),
        ("control", '{"description": "a\\u0007"}', "'description' must be a text without control characters"),
        (
            "typed",
            '{"description": "a", "gravity.enabled": "yes"}',
            "'gravity.enabled' must be true or false, not \"yes\"",
        ),
        ("beyond", '{"description": "a", "base.distance": -1}', "'base.distance' must be a number in m from 0 to"),
        ("infinite", '{"description": "a", "tau[1]": 1e999}', "it is not valid JSON: number 1e999 is out of range"),
        ("dots", '{"description": "a", "link..length": 1}', "there is no variable 'link..length'"),
        ("slash", '{"description": "a", "../tau[1]": 1}', "there is no variable '../tau[1]'"),
        ("überlang", '{"description": "a", "τ": 1}', "there is no variable 'τ'"),
        (
            "endless",
            '{"description": "a", "experiment": {"stopTime": 1e12}}',
            "1000000000000.0 s in steps of 0.001 s are too many",
        ),
        (
            "never",
            '{"description": "a", "experiment": {"stopTime": 0}}',
            "'experiment.stopTime' must be a positive number of seconds, not 0",
        ),
        ("resolved", '{"name": "a", "description": "a", "variants": []}', "there is no variable 'name'"),
        (".", '{"description": "a"}', "a scene has the name of its file, which must not consist of dots only"),
        (" . ", '{"description": "a"}', "a scene has the name of its file, which must not consist of dots only"),
    ],
)
def test_odd_files_are_refused(
    name: str, content: str | bytes, sentence: str, tmp_path: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence names the file, and no file is written."""
    file = tmp_path / f"{name}.json"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["run", str(file)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert sentence in line and (name == "endless" or line.startswith(f"fivebar run: {file}: "))
    assert list(here.iterdir()) == []


def test_a_file_with_an_odd_name_is_run(
    tmp_path: Path, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder of the results and the results are named after the file."""
    shown: list[str] = []

    def show(address: str) -> None:
        """The page is written before tables and pictures, which take longer."""
        assert [written.name for written in here.rglob("*.*") if written.is_file()] == [f"{file.stem}.html"]
        shown.append(address)

    monkeypatch.setattr("webbrowser.open", show)
    file = tmp_path / "CON .. ü%s.json"
    file.write_text(json.dumps(FALL), encoding="utf-8")
    assert main(["run", str(file), "--set", "gravity.g=0", "--open"]) == 0
    [folder] = here.iterdir()
    assert (
        folder.name == file.stem
        and (folder / f"{file.stem}.csv").is_file()
        and f"{file.stem}/{file.stem}.html" in capsys.readouterr().out
    )
    assert shown == [(folder / f"{file.stem}.html").as_uri()]


def test_a_unit_without_a_library_for_this_machine_is_told(
    fmu: Path, tmp_path: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with zipfile.ZipFile(fmu) as whole, zipfile.ZipFile(tmp_path / "other.fmu", "w") as other:
        other.writestr("modelDescription.xml", whole.read("modelDescription.xml"))
        other.writestr("binaries/vms64/FiveBar.exe", "")
    assert main(["run", "swing", "--fmu", str(tmp_path / "other.fmu")]) == 2
    sentence = capsys.readouterr().err
    assert re.fullmatch(r"fivebar run: FiveBar has no library for this machine, \S+; it has vms64\n", sentence), (
        sentence
    )
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("code", ["import fivebar", "from fivebar.commands import main; main(['scenes'])"])
def test_commands_that_neither_compute_nor_draw_load_no_packages_for_it(code: str) -> None:
    """The package answers at once: packages for numbers, pictures and units are loaded only by functions that need them."""
    code += "; import sys; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.splitlines()[-1].split()
    assert "fivebar" in loaded and not {"numpy", "matplotlib", "pandas", "fmpy"} & set(loaded)


def test_an_error_of_this_program_is_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The traceback of an unforeseen error is shown only if asked for."""

    def broken() -> None:
        raise KeyError("surprise")

    monkeypatch.setattr(fivebar, "scenes", broken)
    assert main(["scenes"]) == 1
    assert (
        capsys.readouterr().err
        == "fivebar scenes: an error of this program, KeyError: 'surprise'; FIVEBAR_TRACEBACK=1 shows the traceback\n"
    )
    monkeypatch.setenv("FIVEBAR_TRACEBACK", "1")
    with pytest.raises(KeyError):
        main(["scenes"])


@pytest.mark.parametrize(("command", "source"), [("page", "page"), ("docs", "site")])
def test_shipped_pages_open(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, source: str
) -> None:
    """The live page and the documentation open; if the package lacks them, a sentence says how to make them."""
    shown: list[str] = []
    monkeypatch.setattr("webbrowser.open", shown.append)
    monkeypatch.setattr(shipped, source, lambda: tmp_path / "index.html")
    assert main([command]) == 0 and shown == [(tmp_path / "index.html").as_uri()]
    monkeypatch.setattr(shipped, source, lambda: None)
    assert main([command]) == 2 and f"cargo xtask {source}` makes it" in capsys.readouterr().err


def test_missing_extras_are_one_sentence(
    monkeypatch: pytest.MonkeyPatch, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sentence names all missing packages and the command that installs them; help needs none."""
    calibrate, everything = (
        {requirement.name for requirement in extras.requirements(extra)} for extra in ("calibrate", "all")
    )
    assert {"pyarrow", "scipy"} < calibrate < everything
    installed = extras._installed
    monkeypatch.setattr(
        extras, "_installed", lambda name: None if name in ("pyarrow", "scipy", "paho-mqtt") else installed(name)
    )
    asks = {"calibrate": ["calibrate", "x"], "ensemble": ["what-if", "--config", "x"], "twin": ["soak"]}
    for extra, words in asks.items():
        assert main(words) == 2
        sentence = capsys.readouterr().err
        assert (
            re.match(rf"fivebar {words[0]}: \S.* (?:is|are) needed and not installed: ", sentence)
            and sentence.count("\n") == 1
        )
        assert "pyarrow" in sentence and sentence.endswith(f"pip install 'fivebar[{extra}]' installs what is needed\n")
    # Only a cluster needs these packages.
    monkeypatch.setattr(extras, "_installed", lambda name: None if name == "distributed" else installed(name))
    for words in (["ensemble"], ["what-if", "--config", "x"]):
        assert main([*words, "--scheduler", "127.0.0.1:8786"]) == 2
        sentence = "distributed is needed and not installed: pip install 'fivebar[cluster]' installs what is needed\n"
        assert capsys.readouterr().err == f"fivebar {words[0]}: {sentence}"
    assert list(here.iterdir()) == []


def test_extras_that_are_too_old_are_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message names missing packages first, then each old one with its version and the required one; the oldest allowed version passes."""
    oldest = {requirement.name: next(iter(requirement.specifier)).version for requirement in extras.requirements("all")}
    monkeypatch.setattr(extras, "_installed", oldest.get)
    extras.need("all")
    monkeypatch.setattr(extras, "_installed", (oldest | {"paho-mqtt": "1.6.1"}).get)
    assert main(["soak"]) == 2
    sentence = "paho-mqtt 1.6.1 is installed, but >= 2 is needed"
    assert capsys.readouterr().err == f"fivebar soak: {sentence}: pip install 'fivebar[twin]' installs what is needed\n"
    monkeypatch.setattr(
        extras, "_installed", (oldest | {"paho-mqtt": "1.6.1", "websockets": "12.0", "psutil": None}).get
    )
    with pytest.raises(
        FiveBarError,
        match=f"^psutil is needed and not installed; {sentence}; websockets 12.0 is installed, but >= 13.1 is needed: pip",
    ):
        extras.need("twin")


ALONE = """
import sys
from importlib import metadata, import_module
from packaging.requirements import Requirement
def closure(texts, extra, found):
    for requirement in map(Requirement, texts):
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": each}) for each in extra.split()):
            name = requirement.name.lower().replace("_", "-")
            if name not in found:
                found.add(name)
                closure(metadata.requires(name) or (), "none", found)
    return found
allowed = closure(metadata.requires("fivebar"), sys.argv[1], {"fivebar"})
blocked = {top for top, owners in metadata.packages_distributions().items()
           if not any(owner.lower().replace("_", "-") in allowed for owner in owners)}
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"{name} is not among the packages of this extra")
sys.meta_path.insert(0, Block())
for module in sys.argv[2:]:
    import_module(module)
print(len(blocked))
"""


@pytest.mark.parametrize(
    ("extra", "folder"),
    [
        ("none", "."),
        ("twin", "twin"),
        ("calibrate", "twin/calibrate"),
        ("calibrate", "twin/importing"),
        ("ensemble", "twin/ensemble"),
        ("ensemble cluster", "twin/ensemble"),
    ],
)
def test_an_extra_alone_imports_what_it_names(extra: str, folder: str) -> None:
    """All modules of its subcommands load although the packages of other extras are hidden."""
    root = Path(fivebar.__file__).parent
    files = [file for file in sorted((root / folder).glob("*.py")) if file.stem != "cluster" or "cluster" in extra]
    if extra == "none":
        files += sorted((root / "commands").glob("*.py"))
    modules = [
        ".".join(("fivebar", *file.relative_to(root).with_suffix("").parts)).removesuffix(".__init__") for file in files
    ]
    modules = [module for module in modules if not module.endswith("__main__")]
    done = subprocess.run([sys.executable, "-c", ALONE, extra, *modules], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr.splitlines()[-1]
    assert len(modules) > 4 and int(done.stdout) > 5


@pytest.mark.parametrize(
    ("signals", "stop", "why"),
    [
        ({"tau[1]": {"linear": [[0, 0], [0.2, 0.01]]}}, 0.2, "0.2 s, the last knot of its signals: "),
        ({}, 50.0, "50 s, the unit's own: "),
    ],
)
def test_a_run_without_a_stop_time_says_when_it_ends(
    signals: dict[str, Any], stop: float, why: str, here: Path
) -> None:
    """The run lasts 50 s although the motion ends after 0.2 s; a line says so."""
    given = {"description": "a", "experiment": {"stepSize": 0.1}, "gravity.enabled": False, "signals": signals}
    Path("mine.json").write_text(json.dumps(given), encoding="utf-8")
    done = fivebar.run("mine.json")
    assert done.time[-1] == stop
    assert f"\n  stop time                   {why}it has no 'experiment.stopTime'" in done.summary()
    with pytest.raises(FiveBarError, match=r"^there is no scene 'mime'; did you mean .*'mine\.json'"):
        fivebar.run("mime")
    given["experiment"] = {"stopTime": 0.1}
    Path("mine.json").write_text(json.dumps(given), encoding="utf-8")
    assert "stop time" not in fivebar.run("mine.json").summary()


def test_a_run_in_python(here: Path) -> None:
    """A result has named columns with units, pictures, page and table; a run may change values and method."""
    fall = fivebar.run("fall_90_120", method="automatic", **{"gravity.g": 0, "init.omega[1]": 0.1})
    assert (
        fall.failure is None and fall.time[-1] == 2.0 and fall["tip.x"].shape == (2001,) and fall.units["tip.x"] == "m"
    )
    assert (
        fall.own.parameters["solver.method"] == 6
        and fall["energy.kinetic"][0] > 0
        and np.ptp(fall["energy.potential"]) == 0
    )
    assert {"time", "tip.x", "theta[1]"} < set(fall.names)
    assert isinstance(fall.plot(), Figure) and [
        len(axes.lines) for axes in fall.plot("tip.x", "tip.y", "theta[1]").axes
    ] == [2, 1]
    header, first, *_ = fall.to_csv("fall.csv").read_text(encoding="utf-8").splitlines()
    assert header.split(",")[:1] == ["time"] and len(first.split(",")) == len(fall.names)
    assert fall.animate("fall.html").stat().st_size > 20_000
    assert sorted(file.name for file in here.iterdir()) == ["fall.csv", "fall.html"]
    assert fivebar.unit().is_file() and fivebar.scenes()["swing"]
    short = fivebar.run("fall_90_120", outputs=["tip", "energy.error"])
    head, *_ = short.to_csv("fall.csv").read_text(encoding="utf-8").splitlines()
    assert head == "time,tip.x,tip.y,tip.vx,tip.vy,tip.ax,tip.ay,energy.error" and "alpha[1]" not in short
    assert fivebar.run("fall_90_120", outputs="alpha").outputs == ["time", "alpha[1]", "alpha[2]"]
    for call in (
        lambda: fivebar.run("fly"),
        lambda: fivebar.run("swing", "euler"),
        lambda: fivebar.run("swing", tau=1),
        lambda: fall.plot("y"),
    ):
        with pytest.raises(ValueError) as refusal:
            call()
        assert isinstance(refusal.value, FiveBarError) and "\n" not in str(refusal.value)
