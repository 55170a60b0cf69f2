"""Pictures of runs: how often they are drawn, and the labels of their axes."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from fivebar import drawing, pictures, simulate
from fivebar.scene import Variant
from made_scene import made_scene


def test_each_file_is_drawn_once(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a layout engine, matplotlib draws a figure twice for each file."""
    result = simulate.run(made_scene({}, 0.1, 0.002, Variant("finer", {"solver.stepSize": 2e-4})), fmu, overlays=True)
    drawn: list[Figure] = []
    draw = Figure.draw

    def counted(self: Figure, renderer: object) -> None:
        drawn.append(self)
        draw(self, renderer)  # type: ignore[arg-type]

    monkeypatch.setattr(Figure, "draw", counted)
    for runs in (result.runs, result.runs[:1]):
        files: list[str] = []

        def begin(name: str, files: list[str] = files) -> Path:
            files.append(name)
            return tmp_path / name

        drawn.clear()
        pictures.draw_all(begin, result.scene, runs, result.singularities)
        assert len(drawn) == len(files) and {"tip.png", "path.png", "path.svg", "energy.png"} <= set(files)


@pytest.mark.parametrize(
    ("low", "high", "some"),
    [(1e-9, 1e3, ["10⁻⁹", "10³"]), (2e-17, 8e-17, ["2 × 10⁻¹⁷", "6 × 10⁻¹⁷"]), (3, 400, ["10¹", "10²"])],
)
def test_labels_of_decades_are_matplotlibs_in_plain_text(low: float, high: float, some: list[str]) -> None:
    figure = Figure()
    own, theirs = figure.subplots(1, 2)
    drawing.logarithmic(own)
    theirs.set_yscale("log")
    labels = []
    for axes in (own, theirs):
        axes.plot([0, 1], [low, high])
        figure.draw_without_rendering()
        labels.append([label.get_text() for minor in (False, True) for label in axes.get_yticklabels(minor=minor)])
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    for plain, formula in zip(*labels, strict=True):
        assert "$" not in plain and (plain != "") == (formula != "")
        if plain:
            factor, _, power = plain.rpartition(" × ")
            times = rf"{factor}\times" if factor else ""
            assert power[:2] == "10" and formula == rf"$\mathdefault{{{times}10^{{{power[2:].translate(raised)}}}}}$"
    assert set(some) <= set(labels[0])


def test_the_path_has_the_colour_of_its_time(fmu: Path) -> None:
    """The pieces of the path join, and the scale goes from the first communication point to the last one."""
    result = simulate.run(made_scene({}, 0.5), fmu)
    figure = pictures.path(result.scene, result.runs, result.singularities)
    [lines] = figure.axes[1].collections
    pieces, times = [path.vertices for path in lines.get_paths()], lines.get_array()
    assert lines.get_clim() == (0, 0.5) and times is not None and len(times) == len(pieces) == pictures.TIME_COLOURS
    assert np.array_equal(
        np.concatenate([pieces[0][:1], *(piece[1:] for piece in pieces)]).T, [result["tip.x"], result["tip.y"]]
    )
    for piece, time in zip(pieces, times, strict=True):
        row = int(np.searchsorted(result.time, time))
        assert tuple(piece[0]) == (result["tip.x"][row], result["tip.y"][row])
    assert matplotlib.colormaps["viridis"].N == pictures.TIME_COLOURS
