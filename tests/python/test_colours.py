"""Each part of the mechanism and each kind of singularity has one colour in all pictures and pages; legends cover no curve; figures are closed."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import fivebar
from fivebar import animated_page, drawing, map_page, pictures
from fivebar.colours import COLOURS, STYLE_SHEET
from fivebar.twin import dashboard, summary
from fivebar.twin.ensemble import results

SOURCES = Path(fivebar.__file__).parent
LIVE = Path(__file__).parents[2] / "page" / "style.css"
DARK = {"animation.html": "#1c2025", "style.css": "#151c24"}
"""Dark backgrounds of canvases."""

PARTS = "left|right|tip|direct|inverse|combined|constraint"


def contrast(one: str, other: str) -> float:
    """Contrast of two colours by WCAG 2."""
    luminances = []
    for colour in (one, other):
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        luminances.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    low, high = sorted(luminances)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("paper", ["#ffffff", *DARK.values()])
def test_colours_are_seen_on_white_and_on_dark_pages(paper: str) -> None:
    """WCAG 2 requires a contrast of 3:1 for graphics."""
    for name, colour in COLOURS.items():
        assert contrast(colour, paper) >= 3, (name, colour)


def test_only_one_file_defines_the_colours() -> None:
    """The live page repeats these colours, because it is a separate file; other pages and modules define none."""
    assert set(COLOURS) == set(PARTS.split("|"))
    defined = re.findall(rf"--({PARTS}): (#[0-9a-fA-F]{{6}})", LIVE.read_text(encoding="utf-8"))
    assert len(defined) == len(dict(defined)), "a part with two colours"
    assert set(dict(defined)) >= {"left", "right", "tip", "direct", "inverse"}
    for name, colour in defined:
        assert colour == COLOURS[name], name
    for file in [*SOURCES.rglob("*.html"), *SOURCES.rglob("*.js")]:
        if file.name != "mqtt.min.js":
            assert not re.search(rf"--({PARTS}): *#", file.read_text(encoding="utf-8")), file
    for file in SOURCES.rglob("*.py"):
        assert not re.search(
            r"^.*\b(LEFT|RIGHT|TIP|KIND_COLOURS)\b.*=.*#[0-9a-fA-F]{6}", file.read_text(encoding="utf-8"), re.MULTILINE
        ), file


def test_every_page_takes_them() -> None:
    for module in (animated_page, map_page):
        assert module.TEMPLATE.read_text(encoding="utf-8").count("{{colours}}") == 1
    assert dashboard.FILES["/colours.css"][0] == STYLE_SHEET
    assert 'href="/colours.css"' in (SOURCES / "twin/page/dashboard.html").read_text(encoding="utf-8")
    assert "style-src 'self'" in dashboard.POLICY, "the page may load them"


def test_motor_angles_and_working_modes_have_one_name() -> None:
    """The motor angles are theta[1] and theta[2] of the unit; working modes have the names of its `mode.working`."""
    for file in [*SOURCES.rglob("*.html"), *SOURCES.rglob("*.js"), *SOURCES.rglob("*.py"), *LIVE.parent.glob("*")]:
        if file.name != "mqtt.min.js":
            text = file.read_text(encoding="utf-8")
            assert "θ₄" not in text and "θ₃" not in text, file
            assert "+ −" not in text, file


def test_no_legend_lies_on_its_axes() -> None:
    for draw, rows in ((drawing.legend_above, 2), (drawing.legend_below, 1)):
        with matplotlib.rc_context(drawing.STYLE):
            figure, grid = drawing.panels(rows, figsize=(10, 5), squeeze=False)
            axes = grid[0, 0]
            for i in range(3):
                axes.plot([0, 1], [i, -i], label=f"curve {i}")
            draw(axes)
            with drawing.laid_out(figure):
                figure.draw_without_rendering()
            [legend] = [*figure.legends, *filter(None, [axes.get_legend()])]
            assert not legend.get_window_extent().overlaps(axes.get_window_extent()), draw.__name__


def test_pictures_of_runs_and_ensembles_place_legends_outside() -> None:
    """Every legend is made by a function of `drawing`, or stands outside by its anchor."""
    for module in (pictures, results):
        text = Path(module.__file__).read_text(encoding="utf-8")
        assert not re.findall(r"axes\.legend\(|right\.legend\(|\]\.legend\(", text), module.__name__


def test_a_page_of_a_run_has_ten_figures_in_front_and_folds_the_others() -> None:
    text = summary.TEMPLATE.read_text(encoding="utf-8")
    folded = text[text.index("<details>") : text.index("</details>")]
    assert "{{rows}}" in folded and "{{cards}}" not in folded and "<details open" not in text
    content = {
        "samples": {"estimated": 1, "lost": 0},
        "latency_ms": {"p50": 1.0, "p99": 2.0},
        "tip_error_mm": {"rms": 0.1, "max": None},
        "forecasts": {"count": 3, "ahead_s": 0.5, "coverage95": 0.95, "halfwidth_mm": {"median": 1.0}},
        "alarms": 0,
    }
    assert summary._cards(content).count("<b>") == 10
