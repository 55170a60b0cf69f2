"""`fivebar ensemble`: many runs with random start values and parameters, on processes of this machine or on a cluster."""

import base64
import json
import math
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fivebar import scene as scenes
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.twin import config, scene
from fivebar.twin.calibrate.parameters import Values
from fivebar.twin.calibrate.scenes import KEPT_OUT
from fivebar.twin.ensemble.member import STATE, Plan, Runner, spreads
from fivebar.twin.errors import TwinError

if TYPE_CHECKING:
    from fivebar.twin.ensemble.cluster import Cluster
    from fivebar.twin.ensemble.processes import Processes

USUAL: Final = {"theta[1]": 2e-3, "theta[2]": 2e-3, "link[1,4].mass": 0.01, "link[2,3].mass": 0.01}
"""Default spreads: 2 mrad of the start angles, 1 % of the masses."""

LARGEST_STATE: Final = 4_000_000


@dataclass(frozen=True)
class Options:
    """Number, start and variation of the members."""

    members: int
    scene: str | Path
    """Scene from which members start: name of a shipped scene, or a file."""

    state: Path | None
    """Stored state to start from instead of a scene: bytes of the unit, or a state of the twin."""

    vary: tuple[str, ...]
    """Standard deviations as NAME=SD; the default is `USUAL`."""

    seconds: float
    """Duration of each member."""

    points: int
    """Number of stored points in time."""

    seed: int
    workers: int
    """Number of processes on this machine; 0: only this process."""

    scheduler: str | None
    """Address of a Dask scheduler, instead of processes on this machine."""

    measure: bool
    """Whether to repeat the run in a single process, for comparison."""

    fmu: Path
    out: Path


def run(options: Options) -> int:
    """Runs an ensemble; returns 0 if every member reached its end, 1 if some failed."""
    from fivebar.twin.ensemble import results

    fmu, plan, lowest = plan_of(options)
    members = options.members
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "members.parquet"
    measured: dict[str, Any] = {}
    if options.measure or not (options.workers or options.scheduler):
        from fivebar.twin.ensemble.rows import alone

        begun, cpu = time.perf_counter(), time.process_time()
        results.write(file, plan, alone(fmu, plan, members), Progress("one process", members))
        measured["one_process"] = {"wall_s": time.perf_counter() - begun, "cpu_s": time.process_time() - cpu}
        alone_bytes = file.read_bytes()
    if options.workers or options.scheduler:
        measured["workers"] = _on_workers(options, fmu, plan, file)
        if options.measure:
            one, many = measured["one_process"], measured["workers"]
            measured["efficiency"] = {
                "wall": one["wall_s"] / (many["workers"] * many["wall_s"]),
                "cpu": one["cpu_s"] / many["cpu_s"],
                "same_bytes": file.read_bytes() == alone_bytes,
            }
    story = results.read(file, plan)
    raised = results.raised(file, lowest)
    summary = story.summary() | {
        "raised": raised,
        "seed": plan.seed,
        "seconds": plan.seconds,
        "spreads": plan.spreads,
        "measured": measured,
        "results": str(file),
    }
    (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    files = [file, options.out / "summary.json", *results.draw(options.out, story)]
    _print(summary, files)
    return 1 if story.failed else 0


def plan_of(options: Options) -> tuple[bytes, Plan, dict[str, float]]:
    """The FMU as bytes, the plan, and the lowest allowed draws. Raises errors that would otherwise occur on every worker."""
    for name, least in (("members", 1), ("points", 1), ("workers", 0), ("seed", 0)):
        if getattr(options, name) < least:
            raise TwinError(f"{name} is {getattr(options, name)}; {least} or more is allowed")
    if not (math.isfinite(options.seconds) and options.seconds > 0):
        raise TwinError(f"seconds must be more than 0, not {options.seconds:g}")
    library = Library(options.fmu)
    try:
        given = dict(USUAL) if not options.vary else spreads(dict(part.partition("=")[::2] for part in options.vary))
        common = {"seconds": options.seconds, "points": options.points, "seed": options.seed}
        if options.state is not None:
            plan = from_state(options.state, library, given if options.vary else None, common)
        else:
            plan = from_scene(options.scene, library, given, common)
        runner = Runner(library, plan)
        lowest = {name: parameter.lowest for name, parameter in zip(runner.of_machine, runner.sought, strict=True)}
        runner.close()
        return options.fmu.read_bytes(), plan, lowest
    finally:
        library.close()


def from_scene(given: str | Path, library: Library, spread: dict[str, float], common: dict[str, Any]) -> Plan:
    """A plan with the start and the commands of a scene."""
    content = scene.parse(scenes.read(given, library.known).resolved())
    period = 0.005
    names = tuple(content.signals)
    steps = math.ceil(common["seconds"] / period - 1e-9) + 1 if names else 0
    rows = tuple(tuple(content.at(name, period * k) for name in names) for k in range(steps))
    values = {name: value for name, value in content.values.items() if not name.startswith(KEPT_OUT)}
    return Plan(values=values, spreads=spread, names=names, commands=rows, period=period, **common)


def from_state(file: Path, library: Library, spread: dict[str, float] | None, common: dict[str, Any]) -> Plan:
    """A plan that starts from a stored state; the default spread is the uncertainty in the state."""
    state, clock = stored(file)
    return of_state(state, clock, library, spread, common)


def of_state(
    state: bytes, clock: float | None, library: Library, spread: dict[str, float] | None, common: dict[str, Any]
) -> Plan:
    """A plan that starts from a stored state at the time `clock`; if `clock` is None, at the time in the state."""
    unit = Unit.of(library)
    try:
        unit.restore(state, clock)
        clock = unit.time
        values = everything(unit)
        if spread is None:
            spread = {name: value for name, value in uncertainty(unit).items() if value > 0} or {
                n: v for n, v in USUAL.items() if n in STATE
            }
    finally:
        unit.close()
    # Members run ahead without the estimator, and with the method of the ensemble.
    values = {name: value for name, value in values.items() if not name.startswith(KEPT_OUT)}
    return Plan(values=values, spreads=spread, state=state, clock=clock, **common)


def stored(file: Path) -> tuple[bytes, float | None]:
    """Reads a stored state and the twin's time of it: JSON of the twin, or bytes of the unit, which have their own time."""
    if not file.is_file():
        raise TwinError(f"there is no stored state at {file}")
    if file.stat().st_size > LARGEST_STATE:
        raise TwinError(f"{file} has more than {LARGEST_STATE} bytes")
    if file.suffix != ".json":
        return file.read_bytes(), None
    content = config.read_json(file)
    try:
        return base64.b64decode(content["state"], validate=True), float(content["clock"])
    except (KeyError, TypeError, ValueError):
        raise TwinError(f"{file} is not a stored state of the twin: it has no state and clock") from None


def everything(unit: Unit) -> Values:
    """All parameters and inputs of an instance."""
    known = [v for v in unit.variables.values() if v.can_be_set and not v.name.startswith(("init.", "measured."))]
    numbers = unit.numbers(tuple(v.name for v in known))
    return {v.name: bool(x) if v.type == "Boolean" else x for v, x in zip(known, numbers, strict=True)}


def uncertainty(unit: Unit) -> dict[str, float]:
    """Standard deviations of the state according to the unit's estimator; empty without one."""
    names = {f"{kind}[{i}]": f"estimated.{kind}.sigma[{i}]" for kind in ("theta", "omega") for i in (1, 2)}
    known = {name: other for name, other in names.items() if other in unit.variables}
    values = unit.floats(tuple(known.values()))
    return {name: values[other] for name, other in known.items() if math.isfinite(values[other])}


def _on_workers(options: Options, fmu: bytes, plan: Plan, file: Path) -> dict[str, Any]:
    from fivebar.twin.ensemble import results

    begun = time.perf_counter()
    with closing(_workers(options)) as workers:
        ready, cpu = time.perf_counter(), time.process_time()
        results.write(file, plan, workers.tables(fmu, plan, options.members), Progress("workers", options.members))
        wall, cpu = time.perf_counter() - ready, time.process_time() - cpu
        return {
            "workers": workers.count(),
            "start_s": ready - begun,
            "wall_s": wall,
            "cpu_s": workers.spent() + cpu,
        }


def _workers(options: Options) -> "Cluster | Processes":
    """Workers of the scheduler if one is given, else processes of this machine."""
    if options.scheduler:
        from fivebar.twin.ensemble.cluster import Cluster

        return Cluster(options.scheduler)
    from fivebar.twin.ensemble.processes import Processes

    return Processes(options.workers)


class Progress:
    """Prints members done, rate and remaining time: five times per second on a terminal, otherwise after each 10 %."""

    def __init__(self, label: str, members: int):
        self.label, self.members = label, members
        self.begun = self.shown = time.perf_counter()
        self.next = 0.1

    def __call__(self, done: int) -> None:
        now, share = time.perf_counter(), done / self.members
        terminal = sys.stderr.isatty()
        if (now - self.shown < 0.2 if terminal else share < self.next - 1e-9) and done < self.members:
            return
        self.shown, self.next = now, math.floor(10 * share + 1e-9) / 10 + 0.1
        rate = done / max(now - self.begun, 1e-9)
        bar = "#" * round(20 * share)
        line = f"{self.label}: [{bar:20}] {done:7} of {self.members}  {rate:7.0f} members/s  {(self.members - done) / rate:4.0f} s to go"
        end = "\n" if not terminal or done >= self.members else ""
        print(f"\r\x1b[K{line}" if terminal else line, end=end, file=sys.stderr, flush=True)


def _interval(levels: dict[str, float], digits: int) -> str:
    """Text of the 95 % interval, if known."""
    return f" (95 %: {levels['0.025']:.{digits}f} to {levels['0.975']:.{digits}f})" if "0.025" in levels else ""


def _print(summary: dict[str, Any], files: list[Path]) -> None:
    singular, measured = summary["singular"], summary["measured"]
    print(
        f"{summary['members']} member{'s' * (summary['members'] != 1)} of {summary['seconds']:g} s, seed {summary['seed']}; {summary['failed']} failed"
    )
    print(f"  a singularity within that time: {singular['probability']:.1%}", end="")
    if singular["time_s"]:
        times = singular["time_s"]
        print(f"; the first at {times['0.5']:.3f} s{_interval(times, 3)}", end="")
    print()
    for name, band in summary["end"].items():
        print(f"  {name:9} in the end {band['0.5']:10.5f} {_interval(band, 5)}")
    for name, (count, least) in summary["raised"].items():
        print(f"  {name}: {count} of {summary['members']} draws were below {least:g} of the value and were set to it")
    from fivebar.twin.ensemble.results import FEWEST

    if summary["members"] - summary["failed"] < FEWEST:
        print(f"  no intervals: a 95 % interval needs at least {FEWEST} members")
    for name, label in (("one_process", "one process"), ("workers", "workers")):
        if name in measured:
            part = measured[name]
            extra = f", {part['workers']} of them, ready after {part['start_s']:.1f} s" if name == "workers" else ""
            print(
                f"  {label}: {part['wall_s']:.2f} s, {part['cpu_s']:.2f} s of CPU, {summary['members'] / part['wall_s']:.0f} members/s{extra}"
            )
    if "efficiency" in measured:
        part = measured["efficiency"]
        print(
            f"  efficiency {part['wall']:.2f} by the clock, {part['cpu']:.2f} by CPU; {'the same bytes' if part['same_bytes'] else 'OTHER BYTES'}"
        )
    print(f"written: {', '.join(map(str, files))}")
