"""What pictures of calibrations and ensembles have in common: colours and style, those of the pictures of `cargo xtask run`."""

from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")  # no display needed

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

LEFT, RIGHT, TIP, INK, FAINT, WRONG = "#1864ab", "#2b8a3e", "#e8590c", "#212529", "#adb5bd", "#c2255c"

STYLE: Final[dict[str, Any]] = {
    "figure.dpi": 120,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#868e96",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "xtick.color": "#495057",
    "ytick.color": "#495057",
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "svg.hashsalt": "fivebar",
}


def save(figure: Figure, file: Path) -> Path:
    """Writes the picture and closes it: the same figure, the same bytes."""
    # What stands beside the axes, as names of unknowns do, may need more room.
    figure.savefig(file, bbox_inches="tight", pad_inches=0.1, metadata={"Date": None} if file.suffix == ".svg" else {"Software": None})
    plt.close(figure)
    return file
