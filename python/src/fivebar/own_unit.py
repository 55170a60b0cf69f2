"""Writes a custom unit from the shipped one, without a compiler: the same libraries under another name, with the start values,
experiment and description of a scene.

Masters read these values from the model description in the archive. The library reads them from `resources/unit.txt` when it
is instantiated (src/fmi/own.rs). Equal scenes and names give equal bytes and GUIDs.
"""

import html
import os
import re
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args
from xml.etree import ElementTree

from fivebar import shipped
from fivebar.errors import FiveBarError
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.scene import Scene
from fivebar.variables import Value, Variable, Variables, of_unit, shown

Naming = Literal["structured", "flat"]

MODEL, PAGE, START = "modelDescription.xml", "documentation/index.html", "resources/unit.txt"
PLAIN = "FiveBar"
"""Name of the shipped unit."""

LONGEST = 60
"""Largest number of characters in a name: paths in the archive stay below 260 characters, the limit of some Windows programs."""

NAMESPACE = uuid.UUID("3729f55c-2054-5fb9-9560-16e0a330d502")
"""Version 5 UUID of "FiveBar" in the URL namespace, as in the crate model-description."""

# Names that Windows forbids for files, with any extension (Microsoft, Naming Files, Paths, and Namespaces).
DEVICES = frozenset({"CON", "PRN", "AUX", "NUL", *(f"{port}{i}" for port in ("COM", "LPT") for i in range(10))})

# Keywords of C, which cannot be identifiers (C11, section 6.4.1).
KEYWORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register restrict return short "
    "signed sizeof static struct switch typedef union unsigned void volatile while _Alignas _Alignof _Atomic _Bool _Complex _Generic "
    "_Imaginary _Noreturn _Static_assert _Thread_local".split()
)


@dataclass(frozen=True)
class Written:
    """A written unit."""

    file: Path
    notes: list[str]
    """Sentences on parts of the scene that the master must handle, and on checks that were not possible."""


def write_unit(
    folder: Path,
    scene: Scene | None = None,
    name: str | None = None,
    *,
    naming: Naming = "structured",
    plain: Path | None = None,
) -> Written:
    """Writes `NAME.fmu` to `folder`, which is created if needed, with machine and experiment of `scene` or of the plain unit.

    The default `name` is the scene's name in camel case. With `naming="flat"` the model description declares names without
    structure, for masters that would make buses of `tip.x` and `tau[1]`; the names do not change. Without scene and name the
    unit is `FiveBar.fmu` with the plain unit's GUID. `plain` is the unit to start from, by default the shipped one.

    Raises FiveBarError, with one sentence, if a name or value is not allowed, the unit refuses its start, or a file cannot be
    written. Then no file is left in `folder`.
    """
    if not isinstance(naming, str) or naming not in get_args(Naming):
        raise FiveBarError(f"naming is {naming!r:.40}: it must be {' or '.join(get_args(Naming))}")
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
        # Set last, so that it does not change the GUID: the library is the same.
        description.root.set("variableNamingConvention", naming)
        files[MODEL] = description.text().encode()
    target = folder / f"{name}.fmu"
    try:
        if target.exists() and target.samefile(plain):
            raise FiveBarError(f"{target} is the original FMU: choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="fivebar-") as made:
            # The unit is moved to its final name only if it accepts its start.
            whole = Path(made) / target.name
            _pack(whole, files)
            notes += _try_start(whole)
            _move(whole, target)
    except OSError as error:
        raise FiveBarError(f"{target} cannot be written: {error.strerror or error}") from None
    return Written(target, notes)


def check_name(name: str) -> None:
    """Raises FiveBarError if `name` is not allowed for a unit: it names the model, the library's file and the archive."""
    if not isinstance(name, str):
        raise FiveBarError(f"the name of a unit must be a text, not {shown(name)}")
    allowed = re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) and len(name) <= LONGEST and name not in KEYWORDS
    # Case is ignored, since some file systems ignore it.
    if not allowed or name.upper() in DEVICES or name.upper() == PLAIN.upper():
        beginning = name if len(name) <= LONGEST else f"{name[:LONGEST]}…"
        raise FiveBarError(
            f"the name {beginning!r} is not allowed: it must be a letter or _ followed by letters, digits or _ of ASCII, {LONGEST} at most, and "
            f"not a keyword of C, a device of Windows such as AUX or COM1, or {PLAIN}"
        )


def notes_on(scene: Scene) -> list[str]:
    """Sentences on parts of a scene that a unit cannot have, and on a method that the scene does not name."""
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
            f"Time-varying inputs of the scene have their values at 0 s; the master must change them: {', '.join(scene.signals)}."
        )
    if scene.offsets:
        shown = " and ".join(
            f"{offset:.6g} rad for measured.theta{name[-3:]} and servo.theta{name[-3:]}"
            for name, offset in scene.offsets.items()
        )
        sentences.append(
            f"The machine's encoders have offsets, which the master must subtract from readings and commands: {shown}."
        )
    return sentences


def _camel(stem: str) -> str:
    """`pick_and_place` → `PickAndPlace`."""
    return "".join(part[:1].upper() + part[1:] for part in re.split(r"[\W_]+", stem))


@dataclass(frozen=True)
class Start:
    """A custom start value."""

    variable: Variable
    """The variable in the plain unit."""

    value: Value

    @property
    def text(self) -> str:
        """The value as text for XML and `resources/unit.txt`."""
        return repr(self.value).lower()

    def shown(self, value: Value) -> str:
        """A value of the variable as text for users."""
        if self.variable.type == "Enumeration":
            return self.variable.item(int(value))
        return f"{value:.15g}" if self.variable.type == "Real" else repr(value).lower()


def starts_of(scene: Scene, variables: Variables) -> list[Start]:
    """All start values of a scene, and the values of its signals at 0 s. They are checked like values in a scene file."""
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
            raise FiveBarError(f"{plain} is not the plain unit; units of your own can only be made from the plain unit")
        self.library = self.root.get("guid", "")
        """GUID of the plain unit, which is compiled into the library."""

    def own(self, name: str, scene: Scene | None, starts: list[Start]) -> None:
        """Sets name, experiment, description, start values and GUID."""
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
        """The first element with this tag."""
        found = self.root.find(tag)
        assert found is not None, tag
        return found

    @property
    def guid(self) -> str:
        """GUID of the unit."""
        return self.root.get("guid", "")

    def text(self) -> str:
        """The file in the archive."""
        body = ElementTree.tostring(self.root, encoding="unicode", short_empty_elements=True)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- Written by `fivebar unit`: do not edit. -->\n{body}\n'


def _description(scene: Scene) -> str:
    if not (sentences := _left_to_the_master(scene)):
        return scene.description
    end = "" if scene.description.endswith((".", "!", "?", ":", ";")) else "."
    return " ".join([f"{scene.description}{end}", *sentences])


def _start_file(name: str, description: _Description, starts: list[Start]) -> str:
    """The text of `resources/unit.txt`, which src/fmi/own.rs reads."""
    rows = [f"{start.variable.name} {start.text}" for start in starts]
    return "\n".join([f"unit {name} {description.guid} {description.library}", *rows, "end", ""])


def _page(page: str, description: _Description, starts: list[Start]) -> str:
    """The page inside the archive, with a section on differences and with custom start values in the table of variables."""
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
<p>This unit is a FiveBar with the start values of a custom machine, which its library reads from <code>{START}</code>. All of them can still be
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
    """A row of the table of differences."""
    variable, unit = start.variable, "" if start.variable.unit == "1" else start.variable.unit
    here, plain = (start.shown(value) for value in (start.value, variable.start) if value is not None)
    name, *others = (html.escape(text, quote=False) for text in (variable.name, here, plain, unit))
    return f"<tr><td><code>{name}</code></td>{''.join(f'<td>{text}</td>' for text in others)}</tr>"


def _read(plain: Path) -> dict[str, bytes]:
    """The files of a unit by name in the archive."""
    try:
        with zipfile.ZipFile(plain) as archive:
            files = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    except (OSError, zipfile.BadZipFile) as error:
        raise FiveBarError(f"{plain} cannot be read: {error}") from None
    if MODEL not in files or PAGE not in files:
        raise FiveBarError(f"{plain} is not the plain unit; units of your own can only be made from the plain unit")
    return files


def _renamed(file: str, name: str) -> str:
    """Path of a library's file, which is named after the unit (FMI 2.0.4, section 2.3)."""
    folder, _, base = file.rpartition("/")
    stem, dot, ending = base.partition(".")
    return f"{folder}/{name}{dot}{ending}" if folder.startswith("binaries/") and stem == PLAIN else file


def _pack(target: Path, files: dict[str, bytes]) -> None:
    """Packs files; the bytes of the archive depend only on names and content."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, files[name])


def _move(whole: Path, target: Path) -> None:
    """Moves a file atomically, also from another file system: the target is never incomplete."""
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
    """Initialises the unit with its start values: only the library can decide whether the mechanism closes.

    Raises FiveBarError with the unit's message if it refuses. Returns a sentence if the unit has no library for this
    platform.
    """
    library = Library(fmu)
    try:
        shipped.library(library.directory, library.model.coSimulation.modelIdentifier)
    except FiveBarError as sentence:
        return [f"The start was not tried: {sentence}."]
    try:
        with Unit.of(library) as unit:
            unit.reset()
    except FiveBarError as error:
        raise FiveBarError(f"the start is refused: {str(error).removesuffix('.')}") from None
    return []
