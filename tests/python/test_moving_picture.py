"""The moving picture: well-formed, starts by itself, in time with the run; and the picture in the README."""

import xml.etree.ElementTree as xml
from pathlib import Path

import numpy as np
import pytest

from conftest import REPOSITORY
from fivebar import moving_picture, simulate
from fivebar.drive import Run
from fivebar.scene import Scene
from fivebar.singularities import Event

SVG = "{http://www.w3.org/2000/svg}"
TIME = np.linspace(0, 1, 201)
LENGTH = 0.2


def made_up(**parameters: float) -> Run:
    """Both proximal links turn, the left one faster; the distal links have arbitrary angles."""
    left, right = 0.5 * np.pi + 3 * TIME, 0.5 * np.pi + TIME
    columns = {
        "time": TIME,
        "theta[1]": left,
        "theta[2]": right,
        "passive.theta[1]": 0.5 + 0 * TIME,
        "passive.theta[2]": 2 + 0 * TIME,
    }
    for leg, foot, angle in ((1, 0.0, left), (2, LENGTH, right)):
        columns |= {f"elbow[{leg}].x": foot + LENGTH * np.cos(angle), f"elbow[{leg}].y": LENGTH * np.sin(angle)}
    columns |= {
        "tip.x": 0.1 + 0.1 * TIME,
        "tip.y": 0.3 - 0.1 * TIME,
        "singular.detJx": LENGTH**2 * np.cos(np.pi * TIME),
    }
    values = {"base.distance": LENGTH, "contact.enabled": False, "stop.enabled": False}
    values |= {f"link[{link}].length": LENGTH for link in (1, 2, 3, 4)}
    return Run("made up", 1.0, 0.005, {}, columns, values | parameters)


def drawn(folder: Path, run: Run, events: list[Event]) -> xml.Element:
    """The picture of a run, read as XML."""
    file = folder / "animation.svg"
    moving_picture.write(file, Scene("a <b> & c", "", 1.0, 0.005, [], {}), run, events)
    return xml.parse(file).getroot()


def numbers(text: str) -> list[float]:
    return [float(number) for number in text.replace(",", " ").split()]


def test_everything_plays_on_one_clock(tmp_path: Path) -> None:
    root = drawn(tmp_path, made_up(), [Event(0.5, "direct", ("stretched", "", ""), "crossed")])
    animations = list(root.iter(f"{SVG}animate"))
    assert {a.get("dur") for a in animations} == {"4s"} and {a.get("repeatCount") for a in animations} == {"indefinite"}
    for animation in animations:
        keys = [float(key) for key in animation.get("keyTimes").split(";")]
        assert keys == sorted(keys) and (keys[0], keys[-1]) == (0, 1)
        assert len(keys) == len(animation.get("values").split(";")), "a browser leaves out mismatched values"
    assert not list(root.iter(f"{SVG}script"))
    assert root.find(f"{SVG}title").text.startswith("a <b> & c")


def test_links_keep_their_length_and_the_tip_its_time(tmp_path: Path) -> None:
    run = made_up()
    left, right = (line for line in drawn(tmp_path, run, []).iter(f"{SVG}polyline") if line.get("class") == "link")
    poses = [np.reshape(numbers(pose), (3, 2)) for pose in left.find(f"{SVG}animate").get("values").split(";")]
    scale = moving_picture.View.of(run).scale
    for pose in poses:
        assert np.hypot(*(pose[1] - pose[0])) == pytest.approx(scale * LENGTH, abs=0.2)
    others = [np.reshape(numbers(pose), (3, 2)) for pose in right.find(f"{SVG}animate").get("values").split(";")]
    assert all(np.array_equal(one[2], other[2]) for one, other in zip(poses, others)), "both legs hold the tip"
    # The tip moves evenly, and so does its picture.
    keys = [float(key) for key in left.find(f"{SVG}animate").get("keyTimes").split(";")]
    begin, end = keys[1], keys[-2]
    assert (begin, end) == pytest.approx((0.125, 0.625))
    for key, pose in zip(keys[1:-1], poses[1:-1]):
        expected = poses[1][2] + (key - begin) / (end - begin) * (poses[-2][2] - poses[1][2])
        assert pose[2] == pytest.approx(expected, abs=0.1)


def test_singularities_are_marked_where_they_are(tmp_path: Path) -> None:
    run = made_up()
    events = [
        Event(0.5, "direct", ("stretched", "", ""), "crossed"),
        Event(0.25, "combined", ("folded", "", "folded"), "touched"),
    ]
    rings = [circle for circle in drawn(tmp_path, run, events).iter(f"{SVG}circle") if circle.get("fill") == "none"]
    assert len(rings) == 3
    (place,) = moving_picture.View.of(run).points(np.array([0.15]), np.array([0.25]))
    assert [float(rings[0].get(axis)) for axis in ("cx", "cy")] == pytest.approx(place, abs=0.1)
    assert float(rings[0].find(f"{SVG}animate").get("keyTimes").split(";")[1]) == pytest.approx((0.5 + 2 * 0.5) / 4)


def test_surroundings(tmp_path: Path) -> None:
    limits = {f"stop.{limit}[{leg}]": value for limit, value in (("lower", 0.0), ("upper", 3.0)) for leg in (1, 2)}
    run = made_up(
        **limits,
        **{"stop.enabled": True, "contact.enabled": True, "contact.nx": 0, "contact.ny": 2, "contact.offset": 0.1},
    )
    assert len(list(drawn(tmp_path, run, []).iter(f"{SVG}polygon"))) == 3


def test_long_runs_have_none() -> None:
    run = made_up()
    assert moving_picture.wanted(run)
    run.columns["time"] = 50 * TIME
    assert not moving_picture.wanted(run)
    run.columns["time"] = np.zeros(1)
    assert not moving_picture.wanted(run)


def test_the_picture_of_the_readme(fmu: Path, tmp_path: Path) -> None:
    """The picture shows the scene: made by `cargo xtask run --scene fall_90_120`, copied to docs/images/."""
    simulate.run("fall_90_120", fmu=fmu).save(tmp_path)
    shown = REPOSITORY / "docs" / "images" / "fall_90_120.svg"
    assert (tmp_path / "animation.svg").stat().st_size < 300_000
    made, stored = (xml.parse(file).getroot() for file in (tmp_path / "animation.svg", shown))
    for one, other in zip(made.iter(), stored.iter(), strict=True):
        assert one.tag == other.tag
        for name in ("points", "values"):
            if name in one.attrib and "points" in (name, one.get("attributeName")):
                # Places are in tenths of a pixel; rounding may change the last digit.
                ours, theirs = (numbers(element.get(name).replace(";", " ")) for element in (one, other))
                assert ours == pytest.approx(theirs, abs=0.21)
