"""Writes a unit of one's own from the shipped one, without a compiler: the same libraries under another name, with start values,
experiment and description of a scene.

The model description in the archive has them for masters, and `resources/unit.txt` for the library, which reads it when it is
instantiated (src/fmi/own.rs). Equal scenes and names give equal bytes and GUIDs.
"""

import html
import os
import re
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import fmpy

from fivebar import shipped
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.slave import Log, instantiate
from fivebar.variables import Value, Variable, Variables, of_unit

Naming = Literal["structured", "flat"]

MODEL, PAGE, START = "modelDescription.xml", "documentation/index.html", "resources/unit.txt"
PLAIN = "FiveBar"
"""Name of the shipped unit."""

LONGEST = 60
"""Letters that a name may have: with its folders and endings it stays below 260 characters, which is all that some programs on Windows take."""

NAMESPACE = uuid.UUID("3729f55c-2054-5fb9-9560-16e0a330d502")
"""Version 5 UUID of "FiveBar" in the namespace of URLs, as in the crate model-description."""

# Names that no file of Windows can have, with any ending (Microsoft, Naming Files, Paths, and Namespaces).
DEVICES = frozenset({"CON", "PRN", "AUX", "NUL", *(f"{port}{i}" for port in ("COM", "LPT") for i in range(10))})

# C11, section 6.4.1: words that are no identifiers.
KEYWORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register restrict return short "
    "signed sizeof static struct switch typedef union unsigned void volatile while _Alignas _Alignof _Atomic _Bool _Complex _Generic "
    "_Imaginary _Noreturn _Static_assert _Thread_local".split()
)


@dataclass(frozen=True)
class Written:
    """A unit that has been written."""

    file: Path
    notes: list[str]
    """Sentences on what the unit leaves to the master, and on what could not be tried."""


def write_unit(
    folder: Path,
    scene: Scene | None = None,
    name: str | None = None,
    *,
    naming: Naming = "structured",
    plain: Path | None = None,
) -> Written:
    """Writes `NAME.fmu` to `folder`, which is made if it is not there: the machine and experiment of `scene`, or those of the plain unit.

    `name` is by default the scene's in camel case. With `naming="flat"` the model description says that names have no structure, for
    masters that make buses of `tip.x` and `tau[1]`; the names are the same. Without scene and name the unit is `FiveBar.fmu`, of the plain
    unit's GUID. `plain` is the unit that is taken, by default the shipped one.

    Raises FiveBarError, with one sentence, if a name or value is not allowed, the unit refuses its start, or a file cannot be written; then
    nothing is left in `folder`.
    """
    plain = shipped.unit() if plain is None else plain
    is_own = scene is not None or name is not None
    name = name if name is not None else _camel(scene.name) if scene is not None else PLAIN
    if is_own:
        check_name(name)
    files = _read(plain)
    if scene is not None:
        scene = scene.with_method()
    notes = notes_on(scene) if scene is not None else []
    if is_own or naming != "structured":
        description = _Description(files[MODEL].decode("utf-8"), plain)
        if is_own:
            starts = [] if scene is None else starts_of(scene, of_unit(plain))
            description.own(name, scene, starts)
            files = {_renamed(file, name): content for file, content in files.items()}
            files[START] = _start_file(name, description, starts).encode()
            files[PAGE] = _page(files[PAGE].decode("utf-8"), description, starts).encode()
        # Last, so that it leaves the GUID alone: the library is the same.
        description.root.set("variableNamingConvention", naming)
        files[MODEL] = description.text().encode()
    target = folder / f"{name}.fmu"
    try:
        if target.exists() and target.samefile(plain):
            raise FiveBarError(f"{target} is the plain unit itself: the folder must be another one")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="fivebar-") as made:
            # Only a unit that accepts its start gets the name under which one is looked for.
            whole = Path(made) / target.name
            _pack(whole, files)
            notes += _try_start(whole)
            _move(whole, target)
    except OSError as error:
        raise FiveBarError(f"{target} cannot be written: {error.strerror or error}") from None
    return Written(target, notes)


def check_name(name: str) -> None:
    """Raises FiveBarError, with the rule, if `name` cannot be that of a unit: of the model, the library's file and the archive."""
    allowed = re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) and len(name) <= LONGEST and name not in KEYWORDS
    # Names of files differ by more than capitals, or some machines take them for the same.
    if not allowed or name.upper() in DEVICES or name.upper() == PLAIN.upper():
        shown = name if len(name) <= LONGEST else f"{name[:LONGEST]}…"
        raise FiveBarError(
            f"the name {shown!r} is not allowed: it must be a letter or _ followed by letters, digits or _ of ASCII, {LONGEST} at most, and "
            f"no word of C, no device of Windows such as AUX or COM1, and not {PLAIN}"
        )


def notes_on(scene: Scene) -> list[str]:
    """Parts of a scene that a unit cannot have, and a method that it does not name, in sentences."""
    sentences = _left_to_the_master(scene)
    if overlays := [variant.label for variant in scene.variants[1:]]:
        sentences.append(f"The scene's further runs are left out: {'; '.join(overlays)}.")
    if note := scene.assumed.get("method"):
        sentences.append(f"The scene's method is {note}.")
    return sentences


def _left_to_the_master(scene: Scene) -> list[str]:
    sentences = []
    if scene.signals:
        sentences.append(
            f"Inputs that the scene changes with time begin at its values at 0 s and are for the master to change: {', '.join(scene.signals)}."
        )
    if scene.offsets:
        shown = " and ".join(
            f"{offset:.6g} rad for measured.theta{name[-3:]} and servo.theta{name[-3:]}"
            for name, offset in scene.offsets.items()
        )
        sentences.append(
            f"The machine's encoders show more than true angles, which the master takes off samples and orders: {shown}."
        )
    return sentences


def _camel(stem: str) -> str:
    """`pick_and_place` → `PickAndPlace`."""
    return "".join(part[:1].upper() + part[1:] for part in re.split(r"[\W_]+", stem))


@dataclass(frozen=True)
class Start:
    """A start value of one's own."""

    variable: Variable
    """As the plain unit has it."""

    value: Value

    @property
    def text(self) -> str:
        """The value as XML and `resources/unit.txt` write it."""
        return repr(self.value).lower()

    def shown(self, value: Value) -> str:
        """A value of the variable for people."""
        if self.variable.type == "Enumeration":
            return self.variable.item(int(value))
        return f"{value:.15g}" if self.variable.type == "Real" else repr(value).lower()


def starts_of(scene: Scene, variables: Variables) -> list[Start]:
    """Every start value that a scene gives, signals with theirs at 0 s, checked as those of a scene's file are."""
    starts = []
    for name, value in (scene.values | {name: float(course[0]) for name, course in scene.signals.items()}).items():
        variable = variables.settable(name)
        names: dict[Value, str] = {number: item for item, number in variable.items.items()}
        starts.append(
            Start(variable, variable.value(names.get(value, value) if variable.type == "Enumeration" else value))
        )
    return starts


class _Description:
    """The model description of a unit."""

    def __init__(self, text: str, plain: Path):
        parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
        try:
            self.root = ElementTree.fromstring(text, parser)
        except ElementTree.ParseError:
            self.root = ElementTree.Element("")
        if self.root.get("modelName") != PLAIN:
            raise FiveBarError(f"{plain} is not the plain unit, from which others are written")
        self.library = self.root.get("guid", "")
        """GUID of the plain unit, which the library knows."""

    def own(self, name: str, scene: Scene | None, starts: list[Start]) -> None:
        """Puts in name, experiment, description, start values and GUID."""
        self.root.set("modelName", name)
        self.root.set("generationTool", "fivebar unit")
        for kind in ("ModelExchange", "CoSimulation"):
            self.element(kind).set("modelIdentifier", name)
        if scene is not None:
            self.root.set("description", _description(scene))
            self.element("DefaultExperiment").set("stopTime", repr(float(scene.stop_time)))
            self.element("DefaultExperiment").set("stepSize", repr(float(scene.step_size)))
        values = {
            v.get("name"): value
            for v in self.element("ModelVariables")
            for value in v
            if value.get("start") is not None
        }
        for start in starts:
            values[start.variable.name].set("start", start.text)
        self.root.set("guid", f"{{{uuid.uuid5(NAMESPACE, self.text())}}}")

    def element(self, tag: str) -> ElementTree.Element:
        """A part of it."""
        found = self.root.find(tag)
        assert found is not None, tag
        return found

    @property
    def guid(self) -> str:
        """GUID of the unit."""
        return self.root.get("guid", "")

    def text(self) -> str:
        """As it lies in the archive."""
        body = ElementTree.tostring(self.root, encoding="unicode", short_empty_elements=True)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- Written by `fivebar unit`: do not edit. -->\n{body}\n'


def _description(scene: Scene) -> str:
    if not (sentences := _left_to_the_master(scene)):
        return scene.description
    end = "" if scene.description.endswith((".", "!", "?", ":", ";")) else "."
    return " ".join([f"{scene.description}{end}", *sentences])


def _start_file(name: str, description: _Description, starts: list[Start]) -> str:
    """`resources/unit.txt`, which src/fmi/own.rs reads."""
    rows = [f"{start.variable.name} {start.text}" for start in starts]
    return "\n".join([f"unit {name} {description.guid} {description.library}", *rows, "end", ""])


def _page(page: str, description: _Description, starts: list[Start]) -> str:
    """The page inside the archive, with a section on what is different, and with one's own start values in the table of variables."""
    root, experiment = description.root, description.element("DefaultExperiment")
    cell = re.compile(r"(<tr><td><code>([^<]*)</code></td>(?:<td>[^<]*</td>){3}<td>)[^<]*(?=</td>)")
    own = {
        html.escape(start.variable.name, quote=False): html.escape(start.shown(start.value), quote=False)
        for start in starts
    }
    page = cell.sub(lambda row: row[1] + own[row[2]] if row[2] in own else row[0], page)
    rows = "\n".join(_row(start) for start in starts if start.value != start.variable.start)
    lasts, step = (f"{float(experiment.get(key, '0')):g}" for key in ("stopTime", "stepSize"))
    section = f"""<h2>{html.escape(root.get("modelName", ""))}</h2>
<p>{html.escape(root.get("description", ""), quote=False)}</p>
<p>This unit is a FiveBar with the start values of one's own machine, which its library reads from <code>{START}</code>; all of them can still be
set. Its default experiment lasts {lasts} s, in steps of {step} s.</p>
<div class="table">
<table>
<thead><tr><th>Variable</th><th>Start</th><th>Start in FiveBar.fmu</th><th>Unit</th></tr></thead>
<tbody>
{rows}
</tbody>
</table>
</div>
"""
    title, place = f"<title>{PLAIN}</title>", "<!-- own -->"
    assert page.count(title) == page.count(place) == 1
    return page.replace(title, f"<title>{html.escape(root.get('modelName', ''))}</title>").replace(place, section)


def _row(start: Start) -> str:
    """A row of the table of what is different."""
    variable, unit = start.variable, "" if start.variable.unit == "1" else start.variable.unit
    here, plain = (start.shown(value) for value in (start.value, variable.start) if value is not None)
    name, *others = (html.escape(text, quote=False) for text in (variable.name, here, plain, unit))
    return f"<tr><td><code>{name}</code></td>{''.join(f'<td>{text}</td>' for text in others)}</tr>"


def _read(plain: Path) -> dict[str, bytes]:
    """The files of a unit, by their names in the archive."""
    try:
        with zipfile.ZipFile(plain) as archive:
            files = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    except (OSError, zipfile.BadZipFile) as error:
        raise FiveBarError(f"{plain} cannot be read: {error}") from None
    if MODEL not in files or PAGE not in files:
        raise FiveBarError(f"{plain} is not the plain unit, from which others are written")
    return files


def _renamed(file: str, name: str) -> str:
    """A library's file after the unit's name: FMI 2.0.4, section 2.3."""
    folder, _, base = file.rpartition("/")
    stem, dot, ending = base.partition(".")
    return f"{folder}/{name}{dot}{ending}" if folder.startswith("binaries/") and stem == PLAIN else file


def _pack(target: Path, files: dict[str, bytes]) -> None:
    """Packs files whose bytes in the archive depend on nothing but their content."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, files[name])


def _move(whole: Path, target: Path) -> None:
    """Brings a file to its place at once, also from another file system: whoever looks there finds a whole one or none."""
    handle, beside = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with open(handle, "wb") as file:
            file.write(whole.read_bytes())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)
        os.replace(beside, target)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise


def _try_start(fmu: Path) -> list[str]:
    """Initialises the unit with nothing set: only the library knows whether its start closes.

    Raises FiveBarError with the unit's own sentence if it refuses. Returns a sentence if there is no library for this machine to ask.
    """
    log = Log()
    # A library that gives no instance stays loaded, which keeps its file on Windows.
    with tempfile.TemporaryDirectory(prefix="fivebar-", ignore_cleanup_errors=True) as directory:
        fmpy.extract(str(fmu), unzipdir=directory)
        model = fmpy.read_model_description(directory, validate=False)
        try:
            shipped.library(directory, model.coSimulation.modelIdentifier)
        except FiveBarError as sentence:
            return [f"The start was not tried: {sentence}."]
        slave = None
        try:
            slave = instantiate(model, directory, log)
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        except Exception as error:  # noqa: BLE001 -- FMPy raises this class itself if there is no instance
            raise FiveBarError(f"the start is refused: {(log.last() or str(error)).removesuffix('.')}") from None
        finally:
            if slave is not None:
                slave.freeInstance()
    return []
