"""Results of an ensemble: a Parquet file in order of arrival, then bands and distributions from it, with few points in time in memory at once."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, cast

import matplotlib.pyplot as plt
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from fivebar.colours import KIND_COLOURS, LEFT, RIGHT, TIP
from fivebar.drawing import FAINT, INK, STYLE, legend_above, legend_below, save
from fivebar.twin.ensemble.member import KINDS, SHOWN, Plan

LEVELS: Final = (0.025, 0.25, 0.5, 0.75, 0.975)
"""Quantiles of the bands."""

FEWEST: Final = 40
"""Minimum number of members for a 95 % interval; with fewer, less than one member is expected beyond either end."""

IN_MEMORY: Final = 8_000_000
"""Maximum number of values in memory at once."""

Array = np.ndarray


@dataclass(frozen=True)
class Story:
    """Results of an ensemble."""

    time: Array
    bands: dict[str, Array]
    """Quantiles (points, levels) of each output in `SHOWN`."""

    singular_times: dict[str, Array]
    """Times of the first singularity, s, by kind, of the members with one."""

    members: int
    failed: int

    def summary(self) -> dict[str, Any]:
        """Content of the summary file."""
        met = sum(map(len, self.singular_times.values()))
        every = np.concatenate(list(self.singular_times.values())) if met else np.empty(0)
        return {
            "members": self.members,
            "failed": self.failed,
            "singular": {
                "probability": met / max(1, self.members - self.failed),
                "kinds": {kind: len(times) for kind, times in self.singular_times.items()},
                "time_s": {str(level): float(np.quantile(every, level)) for level in LEVELS if level in determined(met)}
                if met
                else {},
            },
            "end": {
                name: {
                    str(level): float(value)
                    for level, value in zip(LEVELS, band[-1], strict=True)
                    if level in determined(self.members - self.failed)
                }
                for name, band in self.bands.items()
            },
        }


def determined(members: int) -> tuple[float, ...]:
    """Quantile levels for a number of members: only the median for few members, which give no 95 % interval."""
    return LEVELS if members >= FEWEST else (0.5,)


def write(file: Path, plan: Plan, tables: Iterator[pa.Table], show: Any) -> int:
    """Writes members as they arrive, one row group per chunk; returns their number. Equal members give equal bytes."""
    content = {k: v for k, v in asdict(plan).items() if k not in ("state", "commands")}
    count = 0
    writer: pq.ParquetWriter | None = None
    beside = file.with_suffix(".writing")
    try:
        for table in tables:
            if writer is None:
                schema = table.schema.with_metadata({b"fivebar.plan": json.dumps(content, sort_keys=True).encode()})
                writer = pq.ParquetWriter(beside, schema, compression="zstd")
            writer.write_table(table, row_group_size=len(table))
            count += len(table)
            show(count)
    finally:
        if writer is not None:
            writer.close()
    if writer is not None:
        beside.replace(file)
    return count


def read(file: Path, plan: Plan) -> Story:
    """Reads the results from a file."""
    parquet = pq.ParquetFile(file)
    members = parquet.metadata.num_rows
    narrow = parquet.read(columns=["singular.time", "singular.kind", "failed"])
    kinds = np.array(narrow["singular.kind"].to_pylist())
    times = narrow["singular.time"].to_numpy()
    failed = sum(bool(text) for text in narrow["failed"].to_pylist())
    at_once = max(1, IN_MEMORY // max(1, members))
    bands = {
        name: np.concatenate(
            [_quantiles(parquet, name, a, min(a + at_once, plan.points)) for a in range(0, plan.points, at_once)]
        )
        for name in SHOWN
    }
    time = plan.seconds * np.arange(1, plan.points + 1) / plan.points
    return Story(time, bands, {kind: times[kinds == kind] for kind in KINDS[1:]}, members, failed)


def raised(file: Path, lowest: dict[str, float]) -> dict[str, tuple[int, float]]:
    """Number of draws that were clipped to the lowest allowed value, and this value as a share, by name."""
    table = pq.ParquetFile(file).read(columns=[f"drawn.{name}" for name in lowest])
    counts = {name: int(np.sum(table[f"drawn.{name}"].to_numpy() == least)) for name, least in lowest.items()}
    return {name: (count, lowest[name]) for name, count in counts.items() if count}


def _quantiles(parquet: pq.ParquetFile, name: str, first: int, last: int) -> Array:
    parts = []
    for batch in parquet.iter_batches(batch_size=4096, columns=[name]):
        column = cast("pa.FixedSizeListArray[Any, Any]", batch.column(0))
        rows = column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1)
        parts.append(np.array(rows[:, first:last]))
    values = np.concatenate(parts)
    values = values[np.isfinite(values).all(axis=1)]
    return np.quantile(values, LEVELS, axis=0).T if len(values) else np.full((last - first, len(LEVELS)), math.nan)


def draw(out: Path, story: Story) -> list[Path]:
    """Draws bands and distribution; returns the files."""
    with plt.rc_context(STYLE):
        return [save(_bands(story), out / "bands.png"), save(_singular(story), out / "singularities.png")]


def _bands(story: Story) -> Figure:
    figure, rows = plt.subplots(2, 2, figsize=(11, 6), sharex=True)
    for axes, name, colour, factor, unit in zip(
        rows.T.flat, SHOWN, (TIP, TIP, LEFT, RIGHT), (1e3, 1e3, 1.0, 1.0), ("mm", "mm", "rad", "rad"), strict=True
    ):
        band = factor * story.bands[name]
        if len(determined(story.members - story.failed)) > 1:
            axes.fill_between(story.time, band[:, 0], band[:, 4], color=colour, alpha=0.18, linewidth=0, label="95 %")
            axes.fill_between(story.time, band[:, 1], band[:, 3], color=colour, alpha=0.35, linewidth=0, label="50 %")
        axes.plot(story.time, band[:, 2], color=colour, label="median")
        axes.set_ylabel(f"{name}  ({unit})")
    legend_above(rows[0, 0])
    rows[0, 0].set_title(f"Where {story.members} members are")
    for axes in rows[1]:
        axes.set_xlabel("time  (s)")
    return figure


def _singular(story: Story) -> Figure:
    figure, axes = plt.subplots(figsize=(10, 4.6))
    latest = max((float(times.max()) for times in story.singular_times.values() if len(times)), default=0.0)
    met = sum(map(len, story.singular_times.values()))
    # Once all members have met a singularity, later bins are empty.
    end = min(float(story.time[-1]), 1.2 * latest) if met + story.failed >= story.members else float(story.time[-1])
    running = max(1, story.members - story.failed)
    edges = np.linspace(0, end, 81)
    below = np.zeros(80)
    for (kind, times), colour in zip(story.singular_times.items(), (KIND_COLOURS["direct"], LEFT, RIGHT), strict=True):
        share = 100 * np.histogram(times, edges)[0] / running
        axes.bar(
            edges[:-1],
            share,
            width=edges[1],
            bottom=below,
            align="edge",
            color=colour,
            alpha=0.75,
            label=f"{kind}: {100 * len(times) / running:.1f} %",
        )
        below += share
    axes.set_xlabel("time of the first singularity  (s)")
    axes.set_ylabel("members  (%)")
    other = axes.twinx()
    every = np.sort(np.concatenate(list(story.singular_times.values())))
    other.step(
        [0, *every, end], 100 * np.array([0, *range(1, len(every) + 1), len(every)]) / running, where="post", color=INK
    )
    other.set_ylim(0, 102)
    other.set_ylabel("have met one  (%)")
    other.grid(False)
    axes.axvline(end, color=FAINT, linewidth=0.8)
    legend_below(axes)
    axes.set_title(
        f"The next singularity of {story.members} members; {100 - 100 * len(every) / running:.1f} % meet none"
    )
    return figure
