"""Reads the CSV tables of the measurements."""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path

Row = dict[str, str]

LEFT_OUT = "left out: "
"""Prefix of the ending of a run that was deliberately not measured."""


@dataclass
class Table:
    """A table and its head line."""

    file: Path
    about: str = ""
    rows: list[Row] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.rows)


def read(file: Path) -> Table:
    """The table; empty if there is no such file. The page then states the omission."""
    if not file.is_file():
        return Table(file)
    lines = file.read_text(encoding="utf-8").splitlines()
    about = " ".join(line[1:].strip() for line in lines if line.startswith("#"))
    return Table(file, about, list(csv.DictReader(line for line in lines if not line.startswith("#"))))


def read_bench(folder: Path, name: str) -> Table:
    """A table of the benchmarks; bench.json states machine and compiler."""
    table, made_on = read(folder / f"{name}.csv"), folder / "bench.json"
    if table and made_on.is_file():
        facts = json.loads(made_on.read_text(encoding="utf-8"))
        changed = " with changes" if facts["changed"] else ""
        table.about = (
            f"{facts['machine']}, {facts['cores']} cores, {facts['system']}; {facts['compiler']}; "
            f"commit {facts['commit'][:12]}{changed}; {facts['command']}"
        )
    return table


@dataclass(frozen=True)
class Marker:
    """A method with its step or tolerance on a scene; one marker of a work-precision diagram."""

    scene: str
    kind: str
    method: str
    knob: str
    value: float
    unit: str
    error: float
    """Largest distance of the tip from the reference, m."""
    cost: float
    """Median of the repeats, microseconds per simulated millisecond."""
    spread: float
    """Ratio of worst to best of the repeats."""
    substeps: int
    stiff: bool
    """Whether stability limited the steps of an explicit method."""
    ending: str

    @property
    def complete(self) -> bool:
        """Whether the run reached its end."""
        return self.ending == "complete"

    @property
    def left_out(self) -> str:
        """Why it was not measured; empty if it was."""
        return self.ending.removeprefix(LEFT_OUT) if self.ending.startswith(LEFT_OUT) else ""

    @property
    def setting(self) -> str:
        """Step or tolerance as readable text."""
        return setting(self.knob, self.value)


def setting(knob: str, value: float) -> str:
    """`1e-08 rad` or `0.1 ms`."""
    return f"{1e3 * value:g} ms" if knob == "step" else f"{value:.0e} rad".replace("e-0", "e-")


def markers(table: Table) -> list[Marker]:
    """The rows of precision.csv."""
    return [
        Marker(
            row["scene"],
            row["kind"],
            row["method"],
            row["knob"],
            float(row["value"]),
            row["unit"],
            float(row["error [m]"]),
            float(row["us per simulated ms"]),
            float(row["worst us per simulated ms"]) / max(float(row["best us per simulated ms"]), 1e-9),
            int(row["sub-steps"]),
            row["stiff"] == "yes",
            row["ending"],
        )
        for row in table.rows
    ]


@dataclass(frozen=True)
class Reference:
    """Reference of a scene."""

    scene: str
    kind: str
    own_error: float
    source: str


def by_kind(references: list[Reference]) -> dict[str, list[Reference]]:
    """Kinds of motion in order, with their scenes."""
    kinds = dict.fromkeys(r.kind for r in references)
    return {kind: [r for r in references if r.kind == kind] for kind in kinds}


def references(table: Table) -> list[Reference]:
    """The rows of references.csv."""
    return [Reference(row["scene"], row["kind"], float(row["own error [m]"]), row["source"]) for row in table.rows]


@dataclass
class Measurements:
    """All inputs of the page."""

    precision: Table
    references: Table
    energy: Table
    horizon: Table
    growth: Table
    steps: Table
    effects: Table
    calls: Table
    step_times: Table
    hard_cases: Table
    peers: Table

    @classmethod
    def read(cls, data: Path, bench: Path, hard_cases: Path, peers: Path) -> "Measurements":
        """Reads the tables that exist."""
        own = {
            name: read(data / f"{name}.csv")
            for name in ("precision", "references", "energy", "horizon", "growth", "steps")
        }
        return cls(
            **own,
            effects=read_bench(bench, "effects"),
            calls=read_bench(bench, "scenes"),
            step_times=read_bench(bench, "step-times"),
            hard_cases=read(hard_cases / "hard-cases.csv"),
            peers=read(peers / "peers.csv"),
        )
