"""Units of one's own written by `fivebar.own_unit`: names, values, bytes; and how their library finds or refuses its start values."""

import os
import platform
import shutil
import sys
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import quote

import fmpy
import fmpy.validation
import numpy as np
import pytest
from fmpy import fmi2, simulate_fmu
from fmpy.model_description import ModelDescription, read_model_description

from conftest import Unit
from fivebar.errors import FiveBarError
from fivebar.own_unit import write_unit
from fivebar.scene import Scene, Variant
from instance import Instance, Log, Values, get_values

New = Callable[..., Instance]

# Values of every type.
MINE: Values = {
    "base.distance": 0.1,
    "init.theta[1]": 2.2,
    "init.theta[2]": 0.9,
    "solver.method": 4,
    "solver.maxIterations": 12,
    "payload.enabled": True,
    "gravity.enabled": False,
    "tau[1]": 0.01,
}


def scene(values: Values, name: str = "my_machine", description: str = "Mine") -> Scene:
    """A scene with one run."""
    return Scene(name, description, 1.0, 0.01, [Variant("dop853", dict(values))])


@pytest.fixture(scope="module")
def mine(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Unit:
    """A unit of MINE, extracted."""
    folder = tmp_path_factory.mktemp("mine")
    file = write_unit(folder, scene(MINE), plain=fmu).file
    directory = fmpy.extract(str(file), unzipdir=str(folder / "unpacked"))
    return Unit(file, directory, read_model_description(directory))


@pytest.fixture
def copy(mine: Unit, tmp_path: Path) -> Path:
    """A folder with the extracted unit, for tests that damage it."""
    return Path(shutil.copytree(mine.directory, tmp_path / "unit"))


class Refused(Exception):
    """The library gave no instance."""


def started(unit: Unit, directory: Path, location: bytes | None, kind: int = fmi2.fmi2CoSimulation) -> Values:
    """Values of MINE in an instance of the library in `directory`, with resources at `location`.

    Raises Refused with the log if there is no instance.
    """
    log = Log()
    slave = fmi2.FMU2Slave(
        guid=unit.model.guid,
        unzipDirectory=str(directory),
        modelIdentifier=unit.model.coSimulation.modelIdentifier,
        instanceName="one",
    )
    callbacks = log.callbacks()
    instantiate = slave.fmi2Instantiate
    slave.component = instantiate(b"one", kind, unit.model.guid.encode(), location, callbacks, 0, 0)
    if slave.component is None:
        slave.freeLibrary()
        raise Refused("\n".join(message.text for message in log.messages))
    slave.setupExperiment()
    slave.enterInitializationMode()
    values = get_values(slave, unit.model, list(MINE))
    slave.freeInstance()
    return values


def test_the_same_scene_gives_the_same_bytes(fmu: Path, tmp_path: Path) -> None:
    first = write_unit(tmp_path / "a", scene(MINE), plain=fmu)
    second = write_unit(tmp_path / "b", scene(MINE), plain=fmu)
    assert first.file.name == "MyMachine.fmu" and first.notes == []
    assert first.file.read_bytes() == second.file.read_bytes()
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["MyMachine.fmu"]
    assert fmpy.validation.validate_fmu(str(first.file)) == []
    assert not first.file.stat().st_mode & 0o111


def test_the_guid_follows_from_the_values(fmu: Path, tmp_path: Path) -> None:
    """Another value, name, description or experiment gives another GUID; another folder does not."""

    def guid(made: Scene, name: str | None = None) -> str:
        return str(read_model_description(str(write_unit(tmp_path, made, name, plain=fmu).file)).guid)

    guids = [
        guid(scene(MINE)),
        guid(scene(MINE | {"tau[1]": 0.011})),
        guid(scene(MINE), "Other"),
        guid(scene(MINE, description="Yours")),
    ]
    guids.append(guid(Scene("my_machine", "Mine", 2.0, 0.01, [Variant("", dict(MINE))])))
    assert len({*guids, read_model_description(str(fmu)).guid}) == 6
    assert guid(scene(MINE)) == guids[0]


def test_nothing_set_is_the_plain_unit_with_the_values_set(mine: Unit, new: New) -> None:
    """All values are equal bit for bit, also after a reset, which restores the unit's own values."""
    plain, own = new().initialise(MINE), Instance(mine.model, mine.directory).initialise()
    for _ in range(2):
        for step in range(50):
            assert own.bits() == plain.bits(), f"after {step} steps"
            for instance in (plain, own):
                instance.slave.doStep(step * 0.01, 0.01)
        assert {name: own.get(name) for name in MINE} == MINE
        own.set({"tau[1]": 0.5})
        for instance in (plain, own):
            instance.slave.reset()
        plain.initialise(MINE)
        own.initialise()
    own.slave.freeInstance()


def test_in_model_exchange(mine: Unit, fmu: Path) -> None:
    settings = {"fmi_type": "ModelExchange", "stop_time": 0.5, "output_interval": 0.01, "output": ["tip.x", "tip.y"]}
    own = simulate_fmu(str(mine.fmu), **settings)
    plain = simulate_fmu(str(fmu), start_values=MINE, **settings)
    assert own.tolist() == plain.tolist() and max(own["tip.x"]) - min(own["tip.x"]) > 1e-3
    assert started(mine, Path(mine.directory), None, fmi2.fmi2ModelExchange) == MINE


def test_units_of_one_process_have_values_of_their_own(fmu: Path, new: New, tmp_path: Path) -> None:
    """Five machines, alternating and in threads, behave as each does alone."""
    angles = [1.7 + 0.1 * i for i in range(5)]
    units = [
        write_unit(tmp_path, scene({"init.theta[2]": angle, "solver.method": 1}), f"Unit{i}", plain=fmu).file
        for i, angle in enumerate(angles)
    ]
    directories = [fmpy.extract(str(file), unzipdir=str(tmp_path / file.stem)) for file in units]
    models = [read_model_description(folder) for folder in directories]

    def loaded() -> list[Instance]:
        return [Instance(model, folder) for model, folder in zip(models, directories, strict=True)]

    def run(instance: Instance) -> dict[str, bytes]:
        instance.initialise()
        instance.steps(50, 0.01)
        return instance.bits()

    first = loaded()
    alone = [run(instance) for instance in first]
    assert len({values["tip.x"] for values in alone}) == 5
    second = loaded()
    with ThreadPoolExecutor() as pool:
        assert list(pool.map(run, second)) == alone

    third = [instance.initialise() for instance in loaded()]
    for step in range(20):
        for instance in third:
            instance.slave.doStep(step * 0.01, 0.01)
    for angle, instance in zip(angles, third, strict=True):
        plain = new().initialise({"init.theta[2]": angle})
        plain.steps(20, 0.01)
        assert instance.bits() == plain.bits()
    for instance in first + second + third:
        instance.slave.freeInstance()


@pytest.mark.parametrize(
    "form",
    [
        "file://{uri}",
        "file:{uri}",
        "file://localhost{uri}",
        "FILE://{uri}/",
        "file://{path}",
        "{path}",
        "{path}/",
        "{uri}",
        "file://{lower}",
    ],
)
def test_resource_locations_as_masters_give_them(mine: Unit, tmp_path: Path, form: str) -> None:
    """In a folder with a space, an umlaut and a percent sign. The library is elsewhere, so that only this location leads to the file."""
    resources = tmp_path / "zwei Wörter, 100 %" / "resources"
    shutil.copytree(Path(mine.directory) / "resources", resources)
    shutil.copytree(Path(mine.directory) / "binaries", tmp_path / "library" / "binaries")
    uri = quote(str(resources))
    lower = uri.replace("%C3%B6", "%c3%b6")
    location = form.format(uri=uri, path=resources, lower=lower)
    assert started(mine, tmp_path / "library", location.encode()) == MINE


@pytest.mark.parametrize(
    "location",
    [
        None,
        b"",
        b"file:///nowhere",
        b"http://there/resources",
        b"file://server/share",
        b"nowhere",
        b"file:///%ff%00",
        b"x" * 5000,
    ],
)
def test_without_a_location_the_archive_of_the_library_is_searched(
    mine: Unit, tmp_path: Path, location: bytes | None
) -> None:
    """If a master gives no location, or a missing one; in a folder with a space and an umlaut."""
    folder = Path(shutil.copytree(mine.directory, tmp_path / "zwei Wörter"))
    assert started(mine, folder, location) == MINE


def test_without_a_file_there_is_no_instance(mine: Unit, copy: Path) -> None:
    """The unit never silently uses other values: the message has both GUIDs and the searched place."""
    shutil.rmtree(copy / "resources")
    for location in (None, b"file:///nowhere"):
        with pytest.raises(Refused) as refusal:
            started(mine, copy, location)
        sentence = str(refusal.value)
        assert sentence.startswith(f"fmi2Instantiate: fmuGUID is {mine.model.guid}, this library belongs to ")
        assert str(copy / "resources" / "unit.txt") in sentence and "\n" not in sentence


def text(change: Callable[[str], str]) -> Callable[[Path], None]:
    """Damages the text of a file."""
    return lambda file: file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")


def folder(file: Path) -> None:
    """Replaces a file by a folder."""
    file.unlink()
    file.mkdir()


def pipe(file: Path) -> None:
    """Replaces a file by a pipe, on which opening would block."""
    file.unlink()
    os.mkfifo(file)


def endless(file: Path) -> None:
    """Replaces a file by a device without end."""
    file.unlink()
    file.symlink_to("/dev/zero")


FORM = 'there must be a line "unit NAME GUID LIBRARY"'
BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "empty": (text(lambda _: ""), FORM),
    "cut short": (text(lambda all: all[: len(all) // 2]), ""),
    "cut before the last line": (text(lambda all: all.removesuffix("end\n")), FORM),
    "of another form": (text(lambda _: "{}"), FORM),
    "not UTF-8": (lambda file: file.write_bytes(b"unit \xff"), "cannot be read: stream did not contain valid UTF-8"),
    "oversized": (text(lambda all: all + " " * 70_000), "at most 65536 bytes"),
    "of many units": (text(lambda all: all.partition("\n")[0].join(["", "\n"]) * 300), FORM),
    "of another unit": (
        text(lambda all: all.replace("{", "{0", 1)),
        "these start values belong to the unit MyMachine with {0",
    ),
    "of another library": (text(lambda all: all.replace("} {", "} {0")), "was made for the library {0"),
    "a value below its bound": (
        text(lambda all: all.replace(" 0.1\n", " -0.1\n")),
        "base.distance = -0.1 m is not allowed: it must be at least 0 m",
    ),
    "a value that is no number": (
        text(lambda all: all.replace(" 0.1\n", " nan\n")),
        "base.distance = NaN m is not allowed: it must be finite",
    ),
    "a value of another type": (
        text(lambda all: all.replace("true", "yes")),
        'payload.enabled = "yes" is not allowed: it must be of type Boolean',
    ),
    "no item of an enumeration": (
        text(lambda all: all.replace("method 4", "method 99")),
        "solver.method = 99 is not allowed: it must be one of 1",
    ),
    "an unknown variable": (
        text(lambda all: all.replace("base.distance", "base.width")),
        "there is no variable base.width",
    ),
    "an output": (text(lambda all: all.replace("base.distance", "tip.x")), "tip.x is computed and cannot be set"),
    "a value twice": (
        text(lambda all: all.replace("init.theta[2]", "init.theta[1]")),
        "init.theta[1] has two start values",
    ),
    "a folder": (folder, "cannot be read: it is no file"),
    "a pipe": (pipe, "cannot be read: it is no file"),
    "a device": (endless, "cannot be read: it is no file"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices are files elsewhere only")
@pytest.mark.parametrize("what", BROKEN)
def test_a_file_that_is_broken_is_refused_in_one_sentence(mine: Unit, copy: Path, what: str) -> None:
    spoil, expected = BROKEN[what]
    spoil(copy / "resources" / "unit.txt")
    with pytest.raises(Refused) as refusal:
        started(mine, copy, (copy / "resources").as_uri().encode())
    sentence = str(refusal.value)
    assert sentence.startswith(f"fmi2Instantiate: {copy / 'resources' / 'unit.txt'}: ") and expected in sentence, (
        sentence
    )
    assert "\n" not in sentence and sentence.endswith(".") and len(sentence) < 600


def test_a_unit_with_another_unit_s_file_is_refused(mine: Unit, own: Unit, copy: Path) -> None:
    shutil.copy(Path(own.directory) / "resources" / "unit.txt", copy / "resources")
    with pytest.raises(Refused, match="these start values belong to the unit OwnMachine with "):
        started(mine, copy, None)


def test_the_plain_unit_reads_no_file(model: ModelDescription, directory: str, tmp_path: Path) -> None:
    """A file that would be refused is ignored."""
    folder = Path(shutil.copytree(directory, tmp_path / "plain"))
    (folder / "resources").mkdir(exist_ok=True)
    (folder / "resources" / "unit.txt").write_text("broken")
    values = started(Unit(tmp_path, str(folder), model), folder, (folder / "resources").as_uri().encode())
    assert values["base.distance"] == 0.42 and values["solver.method"] == 1


GOOD_NAMES = [
    "A",
    "_",
    "_1",
    "my_machine",
    "MyMachine2",
    "Console",
    "COM",
    "Com10",
    "Nullify",
    "Int",
    "FiveBar2",
    "x" * 60,
]
BAD_NAMES = [
    *(
        "",
        " ",
        "2bars",
        "my machine",
        "my.machine",
        "my-machine",
        "a/b",
        "..",
        r"a\b",
        "C:",
        "führung",
        "ﬁve",
        "a\nb",
        "a\0b",
        "x" * 61,
    ),
    *(
        "con",
        "NUL",
        "Aux",
        "PRN",
        "com1",
        "LPT9",
        "FiveBar",
        "FIVEBAR",
        "int",
        "while",
        "_Bool",
        "$",
        "%s",
        "<a>",
        "名",
    ),
]


@pytest.mark.parametrize("name", GOOD_NAMES)
def test_a_good_name_makes_a_unit(fmu: Path, tmp_path: Path, name: str) -> None:
    file = write_unit(tmp_path, scene({"init.theta[2]": 2.0}), name, plain=fmu).file
    assert file == tmp_path / f"{name}.fmu"
    with zipfile.ZipFile(file) as archive:
        libraries = [entry for entry in archive.namelist() if entry.startswith("binaries/")]
    assert libraries and all(Path(library).stem == name for library in libraries)
    model = read_model_description(str(file))
    assert model.modelName == model.coSimulation.modelIdentifier == model.modelExchange.modelIdentifier == name


@pytest.mark.parametrize("name", BAD_NAMES, ids=[ascii(name[:9]) for name in BAD_NAMES])
def test_a_bad_name_is_refused_with_the_rule(fmu: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(
        ValueError,
        match="is not allowed: it must be a letter or _ followed by letters, digits or _ of ASCII, 60 at most",
    ):
        write_unit(tmp_path / "out", scene({}), name, plain=fmu)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("pick_and_place", "PickAndPlace"),
        ("fall_90_120", "Fall90120"),
        ("my-robot 2", "MyRobot2"),
        ("myRobot", "MyRobot"),
        (".x", "X"),
    ],
)
def test_a_scene_without_a_name_gives_its_own(fmu: Path, tmp_path: Path, stem: str, name: str) -> None:
    assert write_unit(tmp_path, scene({}, stem), plain=fmu).file.name == f"{name}.fmu"


@pytest.mark.parametrize("stem", ["", "führung", "2bars", "con", "five_bar", "a" * 200, "機械"])
def test_a_scene_whose_own_name_is_bad_is_refused(fmu: Path, tmp_path: Path, stem: str) -> None:
    with pytest.raises(ValueError, match="is not allowed: it must be a letter"):
        write_unit(tmp_path, scene({}, stem), plain=fmu)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"base.width": 1.0}, "there is no variable 'base.width'"),
        ({"tip.x": 1.0}, "'tip.x' is computed by the FMU and cannot be set"),
        ({"base.distance": "wide"}, "'base.distance' must be a number in m from 0 to 1000000, not"),
        ({"base.distance": float("nan")}, "'base.distance' must be a number in m from 0 to 1000000, not NaN"),
        ({"base.distance": True}, "'base.distance' must be a number in m from 0 to 1000000, not true"),
        ({"base.distance": -1.0}, "'base.distance' must be a number in m from 0 to 1000000, not -1.0"),
        ({"solver.method": 1.5}, "'solver.method' must be one of i3alp, "),
        ({"solver.method": 99}, "'solver.method' must be one of i3alp, "),
        ({"solver.maxIterations": 2**40}, "'solver.maxIterations' must be a whole number from "),
        ({"gravity.enabled": 1}, "'gravity.enabled' must be true or false, not 1"),
        ({"tau[1]": float("inf")}, "tau[1] = inf N.m is not allowed: it must be finite"),
        ({"base.distance": 5.0}, "the start is refused: fmi2ExitInitializationMode: "),
    ],
)
def test_a_bad_value_is_one_sentence_and_leaves_nothing(
    fmu: Path, tmp_path: Path, values: Values, sentence: str
) -> None:
    with pytest.raises(ValueError) as refusal:
        write_unit(tmp_path, scene(values), plain=fmu)
    assert sentence in str(refusal.value) and "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_text_of_every_kind_comes_through(fmu: Path, tmp_path: Path) -> None:
    description = 'Links of "10 & 12 cm" < 1 m,\n führung; %s 名'
    file = write_unit(tmp_path, scene({}, description=description), plain=fmu).file
    assert read_model_description(str(file)).description == description
    with zipfile.ZipFile(file) as archive:
        page = archive.read("documentation/index.html").decode()
    assert 'Links of "10 &amp; 12 cm" &lt; 1 m' in page


def test_a_scene_that_names_no_method_gives_a_unit_by_automatic(fmu: Path, tmp_path: Path) -> None:
    """Like `fivebar run`; a unit without a scene keeps the plain unit's method."""
    written = write_unit(tmp_path, scene({}), plain=fmu)
    plain = write_unit(tmp_path, name="Second", plain=fmu)
    assert written.notes == ["The scene's method is automatic: it has no 'solver.method'."] and plain.notes == []
    for file, number in ((written.file, "6"), (plain.file, "1")):
        (start,) = [v.start for v in read_model_description(str(file)).modelVariables if v.name == "solver.method"]
        assert start == number


def test_what_a_unit_leaves_to_the_master_is_said(fmu: Path, tmp_path: Path) -> None:
    made = scene(MINE)
    made.variants.append(Variant("fine", {}))
    made.signals["servo.theta[1]"] = np.linspace(1.25, 2.0, 101)
    written = write_unit(tmp_path, made, plain=fmu)
    assert written.notes[0].endswith("the master must change them: servo.theta[1].")
    assert written.notes[1] == "The scene's further runs are left out: fine."
    assert len(written.notes) == 2
    (start,) = [v.start for v in read_model_description(str(written.file)).modelVariables if v.name == "servo.theta[1]"]
    assert float(start) == 1.25


def test_a_name_alone_makes_a_copy(fmu: Path, tmp_path: Path, model: ModelDescription, new: New) -> None:
    """The plain unit's machine with another name and GUID."""
    file = write_unit(tmp_path, name="Second", plain=fmu).file
    copied = read_model_description(str(file))
    assert (copied.modelName, copied.description) == ("Second", model.description) and copied.guid != model.guid
    directory = fmpy.extract(str(file), unzipdir=str(tmp_path / "unpacked"))
    second = Instance(copied, directory).initialise()
    assert second.bits() == new().initialise().bits()
    second.slave.freeInstance()


def test_flat_names_are_the_same_names(fmu: Path, own: Unit, tmp_path: Path, model: ModelDescription, new: New) -> None:
    """Only the naming convention differs: the plain unit keeps GUID and library, so that states can be exchanged."""
    flat = write_unit(tmp_path, naming="flat", plain=fmu).file
    assert flat.name == "FiveBar.fmu" and fmpy.validation.validate_fmu(str(flat)) == []
    with zipfile.ZipFile(flat) as one, zipfile.ZipFile(fmu) as other:
        assert [name for name in other.namelist() if one.read(name) != other.read(name)] == ["modelDescription.xml"]
        assert 'variableNamingConvention="flat"' in one.read("modelDescription.xml").decode()
    mine = read_model_description(str(flat))
    assert mine.guid == model.guid
    assert [(v.name, v.valueReference, v.start) for v in mine.modelVariables] == [
        (v.name, v.valueReference, v.start) for v in model.modelVariables
    ]
    both = [
        write_unit(tmp_path / naming, scene(MINE), naming=naming, plain=fmu).file for naming in ("flat", "structured")
    ]
    assert len({read_model_description(str(file)).guid for file in both}) == 1


def test_a_unit_is_not_written_over_the_one_that_it_is_made_of(fmu: Path, tmp_path: Path) -> None:
    plain = Path(shutil.copy(fmu, tmp_path))
    with pytest.raises(ValueError, match="is the original FMU: choose another folder"):
        write_unit(tmp_path, naming="flat", plain=plain)
    assert plain.read_bytes() == fmu.read_bytes()


def test_what_is_no_plain_unit_is_refused(own: Unit, tmp_path: Path) -> None:
    (tmp_path / "no.fmu").write_bytes(b"no archive")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as other:
        other.writestr("modelDescription.xml", "<fmiModelDescription/>")
    for plain, sentence in (
        (own.fmu, "is not the plain unit"),
        (tmp_path / "no.fmu", "cannot be read"),
        (tmp_path / "other.fmu", "is not the plain"),
    ):
        with pytest.raises(ValueError, match=sentence):
            write_unit(tmp_path / "out", scene(MINE), plain=plain)
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(
    os.geteuid() == 0 if hasattr(os, "geteuid") else True, reason="for root every folder can be written"
)
def test_a_folder_that_cannot_be_written_is_one_sentence(fmu: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(ValueError, match="cannot be written"):
        write_unit(tmp_path, scene(MINE), plain=fmu)


def test_a_file_in_the_place_of_the_folder_is_one_sentence(fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be written: "):
        write_unit(tmp_path / "file", scene(MINE), plain=fmu)


def test_without_a_library_for_this_machine_the_start_is_not_tried(
    fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    written = write_unit(tmp_path, scene(MINE), plain=fmu)
    assert written.file.is_file()
    assert len(written.notes) == 1
    assert written.notes[0].startswith(
        "The start was not tried: MyMachine has no library for this machine, linux riscv64; it has "
    )


def test_other_namings_are_refused(fmu: Path, tmp_path: Path) -> None:
    with pytest.raises(FiveBarError, match="naming is 'foo': it must be structured or flat"):
        write_unit(tmp_path, naming="foo", plain=fmu)  # type: ignore[arg-type]
