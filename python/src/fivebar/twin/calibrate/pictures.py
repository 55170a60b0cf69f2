"""Pictures of a calibration: residuals, and error bars of the unknowns."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from fivebar.colours import LEFT, RIGHT, TIP
from fivebar.drawing import FAINT, INK, STYLE, WRONG, save
from fivebar.plain import plain
from fivebar.twin.calibrate.fit import Fit
from fivebar.twin.calibrate.identify import Judgement, interval
from fivebar.twin.calibrate.parameters import Parameter


def draw(out: Path, fit: Fit, judgement: Judgement, sought: Sequence[Parameter]) -> list[Path]:
    """Draws all pictures into a folder; returns the files."""
    with plt.rc_context(STYLE):
        return [
            save(_residuals(fit), out / "residuals.png"),
            save(_unknowns(fit, judgement, sought), out / "unknowns.png"),
        ]


def _residuals(fit: Fit) -> Figure:
    """Residuals of both encoders, measured minus computed, with the outliers, and their distribution."""
    figure, rows = plt.subplots(2, 2, figsize=(11, 5.6), width_ratios=(4, 1), sharex="col")
    for i, colour in enumerate((LEFT, RIGHT)):
        axes, side = rows[i]
        sigma = 1e3 * fit.sigma[i]
        kept = []
        for piece, gap in zip(fit.pieces, fit.residuals, strict=True):
            time, values, mask = piece.path.samples.time, 1e3 * gap[:, i], piece.mask[:, i]
            axes.plot(time[mask], values[mask], ".", markersize=2, color=colour)
            out = ~mask & np.isfinite(values)
            axes.plot(time[out], np.clip(values[out], -6 * sigma, 6 * sigma), "x", markersize=4, color=WRONG)
            kept.append(values[mask])
        axes.axhspan(-2 * sigma, 2 * sigma, color=FAINT, alpha=0.25, linewidth=0)
        axes.set_ylim(-6.5 * sigma, 6.5 * sigma)
        axes.set_ylabel("measured − computed  (mrad)")
        axes.set_title(f"Encoder {i + 1}: σ = {plain(sigma)} mrad; band: ±2 σ; crosses: not compared")
        values = np.concatenate(kept)
        edges = np.linspace(-5 * sigma, 5 * sigma, 61)
        side.hist(values, edges, orientation="horizontal", color=colour, alpha=0.6)
        bell = np.exp(-((edges / sigma) ** 2) / 2) / np.sqrt(2 * np.pi) / sigma * len(values) * (edges[1] - edges[0])
        side.plot(bell, edges, color=INK, linewidth=1)
        side.set_ylim(axes.get_ylim())
        side.set_title("spread; line: normal")
    rows[1, 0].set_xlabel("time  (s)")
    rows[1, 1].set_xlabel("samples")
    return figure


def _unknowns(fit: Fit, judgement: Judgement, sought: Sequence[Parameter]) -> Figure:
    """Change of each unknown from the scene's value, with error bar and bound, and the correlations."""
    count = len(sought)
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 1.6 + 0.34 * count), width_ratios=(3, 2))
    rows = np.arange(count)
    origin = np.array([p.origin for p in sought])
    for k, parameter in enumerate(sought):
        change = 100 * (fit.x[k] - origin[k])
        if not judgement.identified[k]:
            # A white background, so that grid lines do not cross the text.
            ground = {"facecolor": "white", "edgecolor": "none", "pad": 1}
            left.text(
                0.01,
                k,
                "not identified",
                transform=left.get_yaxis_transform(),
                color=WRONG,
                va="center",
                fontsize=8,
                bbox=ground,
            )
            continue
        left.errorbar(change, k, xerr=100 * interval(judgement.sigma[k]), fmt="o", color=LEFT, capsize=4, markersize=4)
        left.errorbar(
            change, k + 0.22, xerr=100 * interval(judgement.bound[k]), fmt="none", color=TIP, capsize=2, linewidth=1
        )
    left.axvline(0, color=INK, linewidth=0.8)
    left.set_yticks(rows, [p.name for p in sought])
    left.set_ylim(count - 0.4, -0.6)
    left.set_xlabel("change against the scene, % of its size")
    left.set_title("95 % error bars (blue) and Cramér-Rao bound (orange)")
    known = [k for k in range(count) if judgement.identified[k]]
    right.set_title("correlations of the identified unknowns" if known else "nothing is identified")
    if not known:
        right.set_axis_off()
        return figure
    names = [sought[k].name for k in known]
    image = right.imshow(judgement.correlation[np.ix_(known, known)], cmap="RdBu_r", vmin=-1, vmax=1)
    right.set_yticks(range(len(known)), names, fontsize=8)
    right.set_xticks(range(len(known)), names, rotation=90, fontsize=8)
    right.grid(False)
    figure.colorbar(image, ax=right, shrink=0.8)
    return figure
