"""Results of runs: a dictionary of columns, tables of other libraries, parts in time, events, notebooks."""

import copy
import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import xarray
from pyarrow import parquet

from fivebar import extras, simulate
from fivebar.errors import FiveBarError
from fivebar.result import Result
from fivebar.scene import Variant
from made_scene import METHODS, made_scene

STICK = 2
SLIDE = 0.01
"""N·m: dry friction of the left motor."""


@pytest.fixture(scope="module")
def stopped(fmu: Path) -> Result:
    """A run against end stops, with a run to compare with."""
    values = {"stop.enabled": True, "stop.upper[1]": 2.4, "init.theta[2]": 2.0944}
    finer = Variant("finer", values | {"solver.errorTolerance": 1e-11})
    return simulate.run(made_scene(values, 0.5, 1e-3, finer), fmu=fmu, overlays=True)


def test_a_result_is_a_dictionary_of_columns(stopped: Result) -> None:
    assert isinstance(stopped, Mapping) and list(stopped) == stopped.names and stopped.names[0] == "time"
    frame = pandas.DataFrame(stopped)
    assert frame.shape == (501, len(stopped)) and frame["tip.x"].tolist() == dict(stopped)["tip.x"].tolist()
    with pytest.raises(KeyError, match=r"there is no column 'tip\.z'; did you mean 'tip\.[xy]'"):
        stopped["tip.z"]
    assert stopped.get("tip.z") is None and "tip.z" not in stopped


def test_columns_of_ones_own_are_in_plots_and_tables(stopped: Result, tmp_path: Path) -> None:
    made = replace(
        stopped, outputs=["time", "tip.x"], runs=[replace(run, columns=dict(run.columns)) for run in stopped.runs]
    )
    made["tip.r"] = np.hypot(made["tip.x"], made["tip.y"])
    made.units["tip.r"] = "m"
    part = made.between(0.1, 0.3)
    again = pickle.loads(pickle.dumps(part))
    assert again.outputs == ["time", "tip.x", "tip.r"] and again["tip.r"].tolist() == made["tip.r"][100:301].tolist()
    assert list(again.to_dataframe()) == ["tip.x", "tip.r"] and made.to_xarray()["tip.r"].units == "m"
    assert made.to_csv(tmp_path / "own.csv").read_text(encoding="utf-8").startswith("time,tip.x,tip.r\n")
    assert [line.get_label() for line in made.plot("tip.r", "tip.x").axes[0].lines] == ["tip.r", "tip.x"]
    made._write(tmp_path / "overlay.csv", made.runs[1])
    part["more"] = part.time
    assert "more" not in made.outputs
    with pytest.raises(
        FiveBarError, match="the column 'short' must have 501 numbers, one for each communication point, not 1"
    ):
        made["short"] = 1


def test_columns_of_ones_own_are_in_one_result_only(stopped: Result) -> None:
    names = stopped.names
    for made in (copy.copy(stopped), stopped.between(0.1, 0.3), replace(stopped)):
        made.update({"u": made.time}, v=made.time)
        made |= {"w": made.time}
        assert made.setdefault("x", made.time) is made.setdefault("x", None)
        assert made.names == list(made) == [*names, *"uvwx"] and made.outputs[-4:] == [*"uvwx"]
        assert [line.get_label() for line in made.plot("u", "w").axes[0].lines] == ["u", "w"]
        assert pickle.loads(pickle.dumps(made))["w"].tolist() == made.time.tolist()
    for known in (stopped, stopped.names, stopped.units, stopped.descriptions, stopped.outputs):
        assert not {*known} & {*"uvwx"}
    with pytest.raises(TypeError, match="a column is chosen by its name, not by 1"):
        stopped[1] = stopped.time  # type: ignore[index]
    assert list(stopped) == names


def test_columns_are_chosen_by_array_prefix_or_list(stopped: Result) -> None:
    assert stopped["theta"].tolist() == np.column_stack([stopped["theta[1]"], stopped["theta[2]"]]).tolist()
    for names in (("omega[2]", "omega[1]"), (["omega[2]", "omega[1]"],), ("omega[2]", "omega")):
        assert [line.get_label() for line in stopped.plot(*names).axes[0].lines] == ["omega[2]", "omega[1]"]
    with pytest.raises(FiveBarError, match="there is no column 'tipp'; did you mean 'tip'"):
        stopped.plot("tipp")


def test_a_result_equals_only_itself(stopped: Result) -> None:
    """Comparing columns gives no single truth value."""
    again = pickle.loads(pickle.dumps(stopped))
    assert stopped in [stopped] and stopped != again and len({stopped, again, stopped}) == 2
    assert again["tip.x"].tolist() == stopped["tip.x"].tolist() and again.events == stopped.events


def test_a_result_is_shown_in_a_line_or_as_html(stopped: Result) -> None:
    assert repr(stopped) == (
        f"<fivebar.Result of trial by automatic: {len(stopped)} columns at 501 communication points, 0 to 0.5 s>"
    )
    page = stopped._repr_html_()
    assert "tip at the end" in page and page.count("<img ") == 1 and "image/png;base64,iVBOR" in page


def test_frames_have_units(stopped: Result) -> None:
    frame = stopped.to_dataframe()
    assert frame.index.name == "time" and frame.index.tolist() == stopped.time.tolist()
    assert list(frame.columns) == stopped.outputs[1:] and frame["tip.x"].tolist() == stopped["tip.x"].tolist()
    assert frame.attrs["units"]["omega[1]"] == "rad/s" and frame.attrs["units"]["time"] == "s"
    assert frame.attrs["descriptions"]["tip.x"] == "Position of the tip, x"


def test_datasets_have_units_descriptions_and_items(stopped: Result) -> None:
    data = stopped.to_xarray()
    assert isinstance(data, xarray.Dataset) and list(data.data_vars) == stopped.outputs[1:]
    assert data["tip.x"].attrs == {"units": "m", "description": "Position of the tip, x"}
    assert data["time"].attrs["units"] == "s" and float(data["tip.x"].sel(time=0.2)) == stopped["tip.x"][200]
    kinds = data["singular.type"].attrs
    assert dict(zip(kinds["flag_values"], kinds["flag_meanings"].split()))[2] == "direct"


def test_parquet_has_units_and_descriptions(fmu: Path, tmp_path: Path) -> None:
    few = simulate.run(made_scene({}, 0.01), fmu=fmu, outputs=["tip.x", "solver.steps"])
    table = parquet.read_table(few.to_parquet(tmp_path / "run.parquet"))
    assert table.column_names == ["time", "tip.x", "solver.steps"] == few.outputs
    assert table.schema.field("tip.x").metadata == {b"unit": b"m", b"description": b"Position of the tip, x"}
    assert table["tip.x"].to_pylist() == few["tip.x"].tolist()
    assert table["solver.steps"].to_pylist() == few["solver.steps"].tolist()


@pytest.mark.parametrize(
    ("call", "package"),
    [
        (lambda result: result.to_dataframe(), "pandas"),
        (lambda result: result.to_xarray(), "xarray"),
        (lambda result: result.to_parquet("run.parquet"), "pyarrow"),
    ],
)
def test_a_package_that_is_missing_is_one_sentence(
    call: Callable[[Result], Any], package: str, stopped: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table asks only for the packages that it needs."""
    installed = extras._installed
    monkeypatch.setattr(extras, "_installed", lambda name: None if name == package else installed(name))
    with pytest.raises(FiveBarError) as refusal:
        call(stopped)
    assert (
        str(refusal.value)
        == f"{package} is needed and not installed: pip install 'fivebar[data]' installs what is needed"
    )


def test_a_part_in_time(stopped: Result, tmp_path: Path) -> None:
    """Both ends are included; typed times match the times of the run; pictures, tables and page work for a part."""
    part = stopped.between(0.1, 0.3)
    assert len(part.time) == 201 and (part.time[0], part.time[-1]) == (stopped.time[100], stopped.time[300])
    assert part["tip.x"].tolist() == stopped["tip.x"][100:301].tolist() and len(part.runs[1].time) == 201
    assert part.scene is stopped.scene and len(stopped.time) == 501
    assert part.events == [row for row in stopped.events if 0.1 <= row.time <= 0.3] != []
    # The time spent in calls is kept for the whole run.
    assert "wall time" in stopped.summary() and "wall time" not in part.summary()
    files = {file.name for file in part.save(tmp_path)}
    assert {
        "trial.html",
        "trial.csv",
        "trial.finer.csv",
        "path.png",
        "stop.png",
    } < files and "animation.svg" not in files
    assert all(axes.get_xlim() == pytest.approx((0.1, 0.3)) for axes in part.plot("tip.x", "omega[1]").axes)
    with pytest.raises(FiveBarError, match=r"^no communication point is between 0\.6 and 0\.7 s: .* from 0 to 0\.5 s$"):
        stopped.between(0.6, 0.7)


def test_only_the_part_with_the_end_has_the_failure(fmu: Path) -> None:
    hopeless = made_scene({"tau[1]": 50.0, "solver.adaptive": False, "solver.maxIterations": 3}, 0.2)
    short = simulate.run(hopeless, fmu=fmu, on_failure="return")
    assert short.failure and 2 < len(short.time) < 200 and repr(short).endswith("s, ended early of 0.2 s>")
    assert short.between(0, short.time[-2]).failure is None and short.between(0, 1).failure == short.failure


def test_events_are_a_table(stopped: Result) -> None:
    """Singularities, and contacts with stops as theta shows them."""
    frame = pandas.DataFrame(stopped.events)
    assert list(frame.columns) == ["time", "event", "where"] and frame["time"].is_monotonic_increasing
    singular = frame[frame["event"].isin(["direct", "inverse", "combined", "constraint"])]
    assert singular["time"].tolist() == [event.time for event in stopped.singularities]
    inside = np.flatnonzero(np.diff((stopped["theta[1]"] > 2.4).astype(int)))
    moves = frame[frame["where"] == "left motor, stop.upper[1]"]
    assert moves["time"].tolist() == stopped.time[inside + 1].tolist() and len(moves) > 0
    assert moves["event"].tolist()[:2] == ["stop reached", "stop left"]


def test_sticking_and_slipping_are_events(fmu: Path) -> None:
    """A motor with a torque below its breakaway, then above, then at rest again after friction has taken its energy."""
    values = {
        "gravity.enabled": False,
        "friction.enabled": True,
        "friction.law": STICK,
        "solver.method": METHODS["automatic"],
    }
    rubs = {
        f"friction.{bound}[{i}]": SLIDE if i == 1 else 0.0 for i in range(1, 6) for bound in ("coulomb", "breakaway")
    }
    scene = made_scene(values | rubs, 1.0)
    push = np.where((scene.time > 0.1) & (scene.time < 0.15), 2 * SLIDE, 0.5 * SLIDE)
    result = simulate.run(replace(scene, signals={"tau[1]": push}), fmu=fmu)
    frame = pandas.DataFrame(result.events)
    motor = frame[frame["where"] == "left base joint"]
    assert motor["event"].tolist()[:2] == ["sticks", "slips"]
    # The push acts from 0.101 s on and moves the motor within the next step.
    assert motor["time"].tolist()[:2] == pytest.approx([0, 0.102])
    # The other joints have no friction and cannot stick.
    assert set(frame[frame["event"].isin(["sticks", "slips"])]["where"]) == {"left base joint"}


def test_a_plot_shows_itself(stopped: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """A notebook asks for a PNG; a script opens a window, through pyplot, which keeps no figure that is not shown."""
    import matplotlib.pyplot as plt

    plt.close("all")
    plot = stopped.plot("tip.x", "tip.y")
    assert plot._repr_png_().startswith(b"\x89PNG") and plt.get_fignums() == []
    shown: list[list[int]] = []
    monkeypatch.setattr(plt, "show", lambda: shown.append(plt.get_fignums()))
    plot.show()
    assert shown == [[1]] and plt.figure(1) is plot
    plt.close(plot)
    with pytest.raises(FiveBarError, match=r"there is no column 'y'"):
        stopped.plot("y")
