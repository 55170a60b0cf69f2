"""fivebar.workspace and fivebar.statics: maps of scenes, their pictures and tables."""

import base64
import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fivebar import map_page, statics, workspace, workspace_pictures
from fivebar.borders import outline, stop_margin
from fivebar.errors import FiveBarError
from fivebar.kinematics import WORKING_MODES, Machine, Working, sines
from fivebar.scene import Scene, Variant
from instance import Instance
from made_scene import UNEVEN

OUT: Working = ("minus", "plus")


def made(values: dict[str, float | bool]) -> Scene:
    """A scene with the given values."""
    return Scene("made", "trial", 1.0, 1e-3, [Variant("made", dict(values))])


def symmetric(distance: float, proximal: float, distal: float) -> dict[str, float | bool]:
    """Lengths of a symmetric machine."""
    lengths = {1: proximal, 2: distal, 3: distal, 4: proximal}
    return {"base.distance": distance} | {f"link[{i}].length": length for i, length in lengths.items()}


STOPPED = symmetric(0.3, 0.2, 0.25) | {
    "stop.enabled": True,
    "stop.lower[1]": 0.8,
    "stop.upper[1]": 3.0,
    "stop.upper[2]": 2.2,
}
MACHINES = {
    "paper": {},
    "dextar": symmetric(0.118, 0.09, 0.09),
    "pantograph": symmetric(0.025, 0.063, 0.075),
    "coaxial": symmetric(0.0, 0.10, 0.12),
    "uneven": UNEVEN,
    "stopped": STOPPED,
}


@pytest.fixture(scope="module", params=MACHINES)
def survey(request: pytest.FixtureRequest) -> workspace.Map:
    """The map of a machine."""
    return workspace.compute(made(MACHINES[request.param]), cells=80, modes=[WORKING_MODES[0], WORKING_MODES[1]])


# Discs


def discs(values: dict[str, float | bool], working: Working) -> list[workspace.Disc]:
    (mode,) = workspace.compute(made(values), modes=[working]).modes
    return mode.discs


def test_known_discs() -> None:
    """Discs match references: exact ones for the paper's machine; DexTAR's disc above the motors touches Watt's curve on the axis."""
    below, above = discs({}, OUT)
    assert (above.assembly, below.assembly) == ("plus", "minus")
    assert [above.x, above.y, above.radius] == pytest.approx([0.21, 0.28, 0.07], abs=1e-6)
    assert [below.x, below.y, below.radius] == pytest.approx([0.21, 0.0, 0.21], abs=1e-6)
    (disc,) = [disc for disc in discs(MACHINES["dextar"], OUT) if disc.y > 0 and disc.assembly == "plus"]
    assert [disc.x, disc.y, disc.radius] == pytest.approx([0.059, 0.125665777, 0.041173174], abs=1e-6)


def test_discs_hold_no_singularity(survey: workspace.Map) -> None:
    """Every place in a disc is reachable in its assembly and within the stops; discs of one mode and assembly do not overlap."""
    random = np.random.default_rng(4)
    for mode in survey.modes:
        few = np.count_nonzero(mode.reached & mode.within_stops) < 50
        assert mode.discs or few or survey.machine.is_degenerate(mode.working)
        for disc in mode.discs:
            radius, angle = disc.radius * np.sqrt(random.uniform(0, 0.9999, 3000)), random.uniform(-np.pi, np.pi, 3000)
            places = np.array([disc.x, disc.y]) + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            posture, reached = survey.machine.field(places, mode.working)
            assert reached.all() and np.all(posture.assembly == disc.assembly)
            assert np.all(stop_margin(survey.scene, posture.motors) >= 0)
        for i, disc in enumerate(mode.discs):
            for other in mode.discs[:i]:
                apart = np.hypot(disc.x - other.x, disc.y - other.y)
                assert other.radius >= disc.radius
                assert apart >= other.radius + disc.radius - 1e-7 or other.assembly != disc.assembly


def test_no_disc_is_larger(survey: workspace.Map) -> None:
    """A disc about any place of the grid that is larger than the largest one meets a singularity or a stop."""
    places = np.stack(np.meshgrid(survey.x, survey.y), axis=-1)[::5, ::5].reshape(-1, 2)
    rim = np.stack([np.cos(angle := np.linspace(-np.pi, np.pi, 721)), np.sin(angle)], axis=-1)
    for mode in survey.modes:
        largest = mode.discs[0].radius if mode.discs else 2 * (survey.x[1] - survey.x[0])
        for place in places:
            disc = place + largest * np.linspace(0, 1.02, 8)[:, None, None] * rim
            posture, reached = survey.machine.field(disc, mode.working)
            sides = sines(posture.theta)[..., 0]
            feet = np.hypot(*(survey.machine.motors - place).T)
            folded = survey.machine.reach[:, 0] == 0
            free = reached.all() and (np.all(sides > 0) or np.all(sides < 0)) and not np.any(folded & (feet < largest))
            assert not free or np.any(stop_margin(survey.scene, posture.motors) < 0), place


def test_rings_take_no_longer() -> None:
    """Coaxial motors with unequal legs have a ring between circles of singularities: all discs of half its width are equally good."""
    lengths = {"link[1].length": 0.5, "link[2].length": 0.2, "link[3].length": 0.3, "link[4].length": 0.4}
    (mode,) = workspace.compute(made({"base.distance": 0.0, **lengths}), cells=40, modes=[OUT]).modes
    radii = sorted({circle.radius for circle in Machine.from_scene(made(lengths)).inverse_singularities()})
    middle = np.hypot(mode.discs[0].x, mode.discs[0].y)
    rims = [np.hypot(*curve.tip.T) for curve in mode.curves] + [np.array([radius]) for radius in radii]
    assert min(np.abs(rim - middle).min() for rim in rims) == pytest.approx(mode.discs[0].radius, abs=1e-6)


# Loci and stops


def test_curves_belong_to_their_mode(survey: workspace.Map) -> None:
    """Postures along a curve belong to the mode, are singular or at a stop, and equal inverse kinematics."""
    for mode in survey.modes:
        for curve in mode.curves:
            posture, reached = survey.machine.field(curve.tip, mode.working)
            inner = np.abs(sines(curve.theta)[:, 1:]).min(axis=-1) > 1e-4
            assert reached[inner].all()
            assert np.abs(np.sin((posture.theta - curve.theta)[inner] / 2)).max(initial=0) < 1e-6
            if curve.kind == "direct":
                assert np.abs(sines(curve.theta)[:, 0]).max() < 1e-9
            else:
                leg = int(curve.detail[-2]) - 1
                assert (
                    np.abs(np.sin((posture.motors[inner, leg] - float(survey.scene[curve.detail])) / 2)).max(initial=0)
                    < 1e-6
                )
                assert stop_margin(survey.scene, posture.motors)[inner].min(initial=0) > -1e-6


def test_stops_count_turns() -> None:
    """A motor may be within its stops in any turn; stops a turn or more apart do not limit it."""
    scene = made(
        {"stop.enabled": True, "stop.lower[1]": 3.0, "stop.upper[1]": 4.0, "stop.lower[2]": -4.0, "stop.upper[2]": 4.0}
    )
    motors = np.array([[-np.pi, 0.0], [3.5 - 2 * np.pi, 1.0], [0.0, 2.0], [2.9, 3.0]])
    assert stop_margin(scene, motors) == pytest.approx(
        [np.pi - 3, 0.5, 0.5 - (3.5 - 0.0 if 3.5 < np.pi else 2 * np.pi - 3.5), -0.1]
    )
    assert np.all(np.isinf(stop_margin(made({}), motors)))


def test_fields_are_those_of_single_postures(survey: workspace.Map) -> None:
    random = np.random.default_rng(6)
    machine = survey.machine
    for mode in survey.modes:
        rows = np.argwhere(mode.reached)
        for row, column in random.choice(rows, 40):
            place = (survey.x[column], survey.y[row])
            if min(np.hypot(*(machine.motors - place).T)) > 1e-6:
                posture = machine.inverse(place, mode.working)
                assert mode.theta[row, column] == pytest.approx(posture.theta, abs=1e-12)
                assert mode.dexterity[row, column] == pytest.approx(machine.dexterity(posture.theta), abs=1e-12)
        assert np.array_equal(mode.reached, machine.is_reachable(np.stack(np.meshgrid(survey.x, survey.y), axis=-1)))
        assert np.count_nonzero(mode.reached) * (survey.x[1] - survey.x[0]) ** 2 == pytest.approx(
            machine.reach_area, rel=0.03
        )


def test_legs_that_never_meet_are_refused() -> None:
    with pytest.raises(
        ValueError,
        match="the left leg reaches from 0 to 0.42 m, the right one from 0 to 0.42 m, so that they never meet",
    ):
        workspace.compute(made({"base.distance": 0.9}))


# Forces

LOADED = UNEVEN | {
    "payload.enabled": True, "payload.mass": 0.3, "spring.enabled": True, "spring.k[1]": 0.2, "spring.theta0[1]": 1.0,
    "spring.k[2]": 0.1, "gravity.tilt": 1.1, "gravity.direction": -1.2, "link[2].mass": 0.05, "link[3].com": 0.07, "link[4].mass": 0.03,
}  # fmt: skip


@pytest.mark.parametrize("values", [{}, LOADED], ids=["start values", "loaded"])
def test_the_unit_stays_at_rest(new: Callable[..., Instance], values: dict[str, float | bool]) -> None:
    """With the holding torques, also under a force at the tip, nothing accelerates."""
    scene, instance = made(values), new()
    machine, random = Machine.from_scene(scene), np.random.default_rng(8)
    for _ in range(30):
        tip = random.uniform((0.1, 0.15), (machine.distance - 0.1, 0.3))
        posture = machine.inverse(tip, OUT)
        force = random.uniform(-2, 2, 2)
        torque = statics.holding_torques(scene, posture.theta) + machine.motor_torques(posture.theta, force)
        instance.slave.reset()
        # Springs count whole turns; statics takes the turn nearest to their rest angle.
        turns = [
            2 * np.pi * np.round((float(scene[f"spring.theta0[{i + 1}]"]) - posture.motors[i]) / (2 * np.pi))
            for i in (0, 1)
        ]
        starts = {f"init.theta[{i + 1}]": posture.motors[i] + turns[i] for i in (0, 1)} | {
            "init.assembly": 1 if posture.assembly == "plus" else 2
        }
        inputs = {"tau[1]": torque[0], "tau[2]": torque[1], "tip.fx": -force[0], "tip.fy": -force[1]}
        instance.initialise({**values, **starts, **inputs})
        # Without these torques the acceleration is some hundred rad/s2.
        assert max(abs(instance.get("alpha[1]")), abs(instance.get("alpha[2]"))) < 1e-8 / abs(sines(posture.theta)[0])


def test_tip_force_is_possible_in_all_directions() -> None:
    """The torques for this force are within the limits in every direction, and at a limit in the worst one."""
    scene, limits = made(LOADED), (1.5, 0.9)
    machine = Machine.from_scene(scene)
    tips = np.random.default_rng(9).uniform((0.0, 0.15), (machine.distance, 0.3), (50, 2))
    theta = machine.inverse(tips, OUT).theta
    held = statics.tip_force(scene, theta, limits)
    assert held.min() < 0 < held.max()
    directions = np.stack([np.cos(angle := np.linspace(-np.pi, np.pi, 20_001)), np.sin(angle)], axis=-1)
    for posture, force in zip(theta, held):
        torques = statics.holding_torques(scene, posture)
        if force >= 0:
            needed = np.abs(
                torques + machine.motor_torques(np.broadcast_to(posture, (len(directions), 4)), force * directions)
            )
            assert (needed / limits).max() == pytest.approx(1.0, abs=1e-6)
        else:
            assert np.any(np.abs(torques) > limits)


def test_tip_force_of_any_shape() -> None:
    scene = made({})
    theta = Machine.from_scene(scene).inverse(np.tile((0.2, 0.25), (2, 3, 1)), OUT).theta
    forces = statics.tip_force(scene, theta, (1.0, 2.0))
    assert forces.shape == (2, 3) and statics.tip_force(scene, theta[0], (1.0, 2.0)).shape == (3,)
    assert (
        np.shape(statics.tip_force(scene, theta[0, 0], (1.0, 2.0))) == ()
        and statics.tip_force(scene, theta[0, 0], (1.0, 2.0)) == forces[0, 0]
    )
    # A stretched left leg puts no load on its motor.
    assert statics.tip_force(scene, (0.0, 0.0, 0.5, 0.7), (1e9, 1e9)) > 0


@pytest.mark.parametrize(
    ("theta", "limits", "sentence"),
    [
        (np.zeros(3), (1.0, 1.0), r"theta has the shape \(3,\): the last axis must have 4 elements"),
        (np.zeros((4, 2)), (1.0, 1.0), r"theta has the shape \(4, 2\): the last axis must have 4 elements"),
        (0.0, (1.0, 1.0), r"theta has the shape \(\): the last axis must have 4 elements"),
        ("left", (1.0, 1.0), "theta = 'left': 4 numbers in rad are expected"),
        (np.zeros(4), (1.0,), r"limits = \(1.0,\): two torques of at least 0 N·m are expected"),
        (np.zeros(4), (1.0, -1.0), r"limits = \(1.0, -1.0\): two torques"),
        (np.zeros(4), 1.0, "limits = 1.0: two torques"),
    ],
)
def test_statics_refuses_other_shapes(theta: object, limits: object, sentence: str) -> None:
    with pytest.raises(FiveBarError, match=f"^{sentence}"):
        statics.tip_force(made({}), theta, limits)  # type: ignore[arg-type]
    if sentence.startswith("theta"):
        with pytest.raises(FiveBarError, match=f"^{sentence}"):
            statics.holding_torques(made({}), theta)  # type: ignore[arg-type]


def test_tip_force_ends_at_direct_singularities() -> None:
    machine = Machine.from_scene(made({}))
    for locus in machine.direct_singularities(200):
        regular = np.abs(sines(locus.theta)[:, 1:]).min(axis=-1) > 1e-6
        assert np.all(statics.tip_force(made({}), locus.theta[regular], (1.0, 1.0)) <= 1e-9)


# Pictures and tables


@pytest.mark.parametrize("again", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_pictures_and_tables(again: int, tmp_path: Path) -> None:
    """All files exist; tables and the pictures of the first `again` modes are equal in a second run; tables have names with units; pictures
    are of modest size."""
    values = MACHINES["stopped"] | {"servo.enabled": True, "payload.enabled": True}
    map_ = workspace.compute(made(values), cells=60, modes=WORKING_MODES[:2])
    repeated = replace(map_, modes=map_.modes[:again])
    for folder, drawn in ((tmp_path / "a", map_), (tmp_path / "b", repeated)):
        files = workspace.write(map_, folder) + workspace_pictures.draw(drawn, folder)
        assert sorted(files) == sorted(folder.iterdir())
    names = {path.name for path in (tmp_path / "a").iterdir()}
    pictures = {
        f"{kind}_{mode.name}.{suffix}"
        for kind in ("condition", "force")
        for mode in map_.modes
        for suffix in ("svg", "png")
    }
    assert names == pictures | {"field.csv", "loci.csv", "discs.csv"} and len(pictures) == 8
    for name in names:
        content = (tmp_path / "a" / name).read_bytes()
        if name not in pictures or any(mode.name in name for mode in repeated.modes):
            assert content == (tmp_path / "b" / name).read_bytes(), name
        assert len(content) < (400_000 if name in pictures else 20_000_000)
    with (tmp_path / "a" / "field.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(int(np.count_nonzero(mode.reached)) for mode in map_.modes)
    assert {row["working"] for row in rows} == {"minusPlus", "plusPlus"}
    assert all(
        np.isfinite(float(row[name]))
        for row in rows
        for name in row
        if name not in ("working", "assembly") and row[name] not in ("inf", "-inf")
    )
    with (tmp_path / "a" / "loci.csv").open(encoding="utf-8") as file:
        assert {row["kind"] for row in csv.DictReader(file)} == {"inverse", "direct", "stop"}


def test_the_command_maps_a_scene(tmp_path: Path, fmu: Path) -> None:
    """A user's command makes pictures that are not empty and show the scene's motion; errors are one sentence."""
    run = lambda *words: subprocess.run(
        [sys.executable, "-m", "fivebar", "map", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"FIVEBAR_FMU": str(fmu)},
    )
    done = run("pick_and_place", "--mode", "minusPlus")
    assert done.returncode == 0, done.stderr
    assert "minusPlus, assembly plus: largest disc" in done.stdout and done.stderr == ""
    for name in ("condition_minusPlus.png", "force_minusPlus.png"):
        with Image.open(tmp_path / "pick_and_place" / name) as picture:
            assert min(picture.size) > 700 and len(picture.convert("RGB").getcolors(1_000_000) or []) > 20
    with (tmp_path / "pick_and_place" / "path.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    machine = Machine.from_scene("pick_and_place")
    theta = np.array([[float(row[name]) for name in workspace.ANGLES] for row in rows])
    tip = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    assert len(rows) == 1601 and np.abs(machine.forward(theta[:, [0, 3]]).tip - tip).max() < 1e-8
    for words, sentence in (
        (["nonsense"], "there is no scene 'nonsense'"),
        (["swing", "--mode", "plus"], "'plus' is not one of"),
    ):
        refused = run(*words)
        assert refused.returncode == 2 and refused.stdout == "" and len(refused.stderr.splitlines()) == 1
        assert sentence in refused.stderr


def test_the_page_holds_the_map(tmp_path: Path) -> None:
    """The page contains fields, loci and discs of every mode, and loads nothing else."""
    values = MACHINES["stopped"] | {"servo.enabled": True}
    survey = workspace.compute(made(values), cells=60)
    map_page.write(survey, tmp_path / "map.html")
    page = (tmp_path / "map.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])  # type: ignore[index]
    assert not re.search(r"https?://|src=|\{\{", page) and [mode["name"] for mode in data["modes"]] == [
        mode.name for mode in survey.modes
    ]
    for packed, mode in zip(data["modes"], survey.modes):
        field = np.frombuffer(base64.b64decode(packed["fields"][0]["values"]), "<f4").reshape(mode.dexterity.shape)
        assert np.abs(field - mode.dexterity).max() < 1e-7
        assert [tuple(disc.values()) for disc in packed["discs"]] == [
            tuple(disc) for disc in mode.discs if disc.radius > 0.3 * mode.discs[0].radius
        ]
        assert packed["stops"] and packed["fields"][1]["unit"] == "N"


@pytest.mark.parametrize("values", MACHINES.values(), ids=MACHINES)
def test_outlines_of_pages_are_the_loci(values: dict[str, float | bool]) -> None:
    """Each point of a mode's curves is a direct singularity of that mode, to the digits on the page."""
    machine = Machine.from_scene(made(values))
    shown = outline(machine)
    assert [[ring["inner"], ring["outer"]] for ring in shown["rings"]] == machine.reach.tolist()
    for working in WORKING_MODES:
        curves = shown["loci"][working[0] + working[1].capitalize()]
        assert curves or machine.is_symmetric
        for curve in curves:
            posture, reached = machine.field(np.array(curve), working)
            inner = reached & (np.abs(sines(posture.theta)[:, 1:]).min(axis=-1) > 0.05)
            # Places are rounded to 1e-5 of the size; the sines change by some 1/0.05 per length.
            assert np.abs(sines(posture.theta)[inner, 0]).max(initial=0) < 2e-3


def test_path_by_modes() -> None:
    """A motion is split by working mode."""
    machine = Machine.from_scene(made({}))
    theta = np.concatenate(
        [machine.inverse([(0.2, 0.3), (0.21, 0.3)], working).theta for working in (OUT, ("plus", "plus"))]
    )
    path = workspace.Path(np.arange(4.0), np.zeros((4, 2)), theta)
    assert (
        path.parts(OUT) == [slice(0, 2)]
        and path.parts(("plus", "plus")) == [slice(2, 4)]
        and path.parts(("minus", "minus")) == []
    )
