"""`fivebar what-if`: outcomes of candidate commands from a snapshot of the running twin; ranked and published as `whatif`.

A command is a trajectory of the drive inputs after the snapshot. The path of the tip and its 95 % radius are the twin's own forecast with
this command; it includes all uncertainties of the twin, also of forces, lengths and encoders. The probability of a singularity comes from
an ensemble with the uncertainty of the twin. Its draws are the same for all commands, so that outcomes differ only by the commands. The
best command has the lowest probability of a singularity. Among equals, it is the one with 95 % of tips nearest to the goal or, without a
goal, closest together.
"""

import base64
import math
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from fivebar import shipped
from fivebar.errors import FiveBarError
from fivebar.library import Library
from fivebar.twin import config as configuration
from fivebar.twin import process
from fivebar.twin.bus import Bus
from fivebar.twin.ensemble.command import of_state
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.ensemble.rows import here
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.forecast import RADIUS
from fivebar.twin.messages import INPUTS, Message, decode, encode

PERIOD: Final = 0.005
POINTS: Final = 10
MOST_CANDIDATES: Final = 50
FORECAST: Final = ("tip.x", "tip.y", RADIUS)
TURN: Final = 0.15
"""Amplitude of the default commands, rad."""


@dataclass(frozen=True)
class Options:
    """Options of a comparison of commands."""

    config: Path
    """The configuration of the running twin."""

    candidates: Path | None
    """File with commands and a goal; without a file: staying, and each motor a little to either side."""

    members: int
    """Number of members per command."""

    seconds: float
    """Horizon."""

    seed: int
    times: int
    """Number of snapshots to answer; 0: until Ctrl-C."""

    scheduler: str | None
    """Address of a Dask scheduler; without one, all members run in this process."""


@dataclass(frozen=True)
class Candidate:
    """A command: knots (s after the snapshot, value) of inputs, connected by minimum-jerk trajectories as in scenes."""

    name: str
    knots: dict[str, list[tuple[float, float]]]

    def rows(
        self, setpoints: dict[str, float], names: tuple[str, ...], seconds: float
    ) -> tuple[tuple[float, ...], ...]:
        """Rows of input values every `PERIOD`. An input without knots keeps its value; servo rates are the rates of the servo angles."""
        times = PERIOD * np.arange(math.ceil(seconds / PERIOD - 1e-9) + 1)
        columns = []
        for name in names:
            angle = name.replace("omega", "theta")
            if name in self.knots:
                columns.append(way(times, self.knots[name], setpoints.get(name, 0.0)))
            elif name.startswith("servo.omega"):
                columns.append(
                    np.gradient(way(times, self.knots[angle], setpoints.get(angle, 0.0)), PERIOD)
                    if angle in self.knots
                    else np.zeros(len(times))
                )
            else:
                columns.append(np.full(len(times), setpoints.get(name, 0.0)))
        return tuple(tuple(row) for row in np.column_stack(columns).tolist())


def way(times: np.ndarray, knots: list[tuple[float, float]], begin: float) -> np.ndarray:
    """Minimum-jerk trajectory from `begin` at time 0 through knots, at rest in each: 10u³ − 15u⁴ + 6u⁵ (Flash and Hogan 1985)."""
    found = np.full(len(times), begin)
    last, value = 0.0, begin
    for at, to in knots:
        u = np.clip((times - last) / max(at - last, 1e-9), 0.0, 1.0)
        found = np.where(times >= last, value + (to - value) * u**3 * (10 - 15 * u + 6 * u**2), found)
        last, value = at, to
    return found


def usual(setpoints: dict[str, float], seconds: float) -> list[Candidate]:
    """Default candidates: staying, and each motor a little to either side."""
    kind = "servo.theta" if any(name.startswith("servo.theta") for name in setpoints) else "tau"
    step = TURN if kind == "servo.theta" else 0.01
    found = [Candidate("stay", {})]
    for i in (1, 2):
        for sign, word in ((1, "+"), (-1, "-")):
            name = f"{kind}[{i}]"
            found.append(
                Candidate(f"{name} {word}{step:g}", {name: [(0.8 * seconds, setpoints.get(name, 0.0) + sign * step)]})
            )
    return found


def read(file: Path) -> tuple[list[Candidate], list[float] | None]:
    """Reads candidates and goal from a file: {"goal": [x, y], "candidates": [{"name": …, "knots": {"servo.theta[1]": [[t, v], …]}}]}."""
    content = configuration.read_json(file)
    try:
        goal = [float(x) for x in content["goal"]] if content.get("goal") is not None else None
        found = [
            Candidate(
                str(c["name"]),
                {str(name): [(float(t), float(v)) for t, v in knots] for name, knots in c["knots"].items()},
            )
            for c in content["candidates"]
        ]
    except (KeyError, TypeError, ValueError, AttributeError):
        raise TwinError(f"{file} is not a list of candidates as in docs/ensembles.md") from None
    if not 0 < len(found) <= MOST_CANDIDATES or (goal is not None and len(goal) != 2):
        raise TwinError(
            f"{file} has {len(found)} candidates and a goal of {len(goal or [0, 0])} numbers; 1 to {MOST_CANDIDATES} candidates and a goal of 2 numbers are allowed"
        )
    for candidate in found:
        for name, knots in candidate.knots.items():
            times = [t for t, _ in knots]
            if (
                name not in INPUTS
                or not all(math.isfinite(x) for knot in knots for x in knot)
                or times != sorted(times)
            ):
                raise TwinError(
                    f"{file}: candidate {candidate.name!r:.60} has no rising, finite knots of {name!r:.40}; {', '.join(INPUTS)} are allowed"
                )
    return found, goal


def outcome(name: str, members: pa.Table, ahead: np.ndarray, goal: list[float] | None) -> dict[str, Any]:
    """Outcome of a command: probability of a singularity, path of the tip with its bands, score. `ahead` has rows of x, y and radius, m."""
    failed = sum(sentence != "" for sentence in members["failed"].to_pylist())
    times = members["singular.time"].to_numpy()
    met = times[np.isfinite(times)]
    probability = len(met) / len(times) if failed < len(times) else 1.0
    found = {
        "name": name,
        "failed": failed,
        "singular": {"probability": probability, "time": float(np.median(met)) if len(met) else None},
        "score": math.inf,
    }
    if failed == len(times) or not np.isfinite(ahead).all():
        return found
    x, y, radius = (float(value) for value in ahead[-1])
    far = radius + (math.dist((x, y), goal) if goal is not None else 0.0)
    bands = {
        axis: np.column_stack([middle - ahead[:, 2], middle, middle + ahead[:, 2]]).round(7).tolist()
        for axis, middle in (("tip.x", ahead[:, 0]), ("tip.y", ahead[:, 1]))
    }
    return found | {"end": {"tip.x": x, "tip.y": y, "within95": far}, "bands": bands, "score": far}


def forecast(library: Library, plan: Plan) -> np.ndarray:
    """The twin's forecast with a command, (points, 3): tip and its 95 % radius, m; NaN after a failure."""
    runner = Runner(library, replace(plan, spreads={}), FORECAST)
    try:
        return np.asarray(runner.run(0)["shown"], dtype=float)
    finally:
        runner.close()


def ranked(outcomes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sorts outcomes, the best first: by probability in steps of 5 %, the resolution of a small ensemble, then by score."""
    order = sorted(outcomes, key=lambda o: (round(20 * o["singular"]["probability"]), o["failed"] > 0, o["score"]))
    return [{"rank": rank} | {k: v for k, v in one.items() if k != "score"} for rank, one in enumerate(order, 1)]


def compare(
    fmu: Path, state: Message, candidates: list[Candidate] | None, goal: list[float] | None, options: Options
) -> dict[str, Any]:
    """Ranked outcomes from a stored state of the twin."""
    begun, spent = time.perf_counter(), time.process_time()
    library = Library(fmu)
    try:
        setpoints = {str(name): float(value) for name, value in state.extra["book"]["told"].items()}
        snapshot = base64.b64decode(state.extra["state"], validate=True)
        common = {"seconds": options.seconds, "points": POINTS, "seed": options.seed}
        plan = of_state(snapshot, float(state.extra["clock"]), library, None, common)
        chosen = candidates or usual(setpoints, options.seconds)
        names = tuple(
            name
            for name in INPUTS
            if name in setpoints or any(name in c.knots or name.replace("omega", "theta") in c.knots for c in chosen)
        )
        plans = [
            replace(plan, names=names, commands=c.rows(setpoints, names, options.seconds), period=PERIOD)
            for c in chosen
        ]
        results = _all(fmu, library, plans, options)
        found = [
            outcome(c.name, members, forecast(library, p), goal)
            for c, p, members in zip(chosen, plans, results, strict=True)
        ]
    except FiveBarError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError):
        raise TwinError("the twin's state does not have the format of this version") from None
    finally:
        library.close()
    return {
        "ahead": options.seconds,
        "members": options.members,
        "goal": goal,
        "took_s": round(time.perf_counter() - begun, 4),
        "cpu_s": round(time.process_time() - spent, 4),
        "candidates": ranked(found),
    }


def _all(fmu: Path, library: Library, plans: list[Plan], options: Options) -> Iterator[pa.Table]:
    """Tables of the members of each plan, computed in this process or on workers."""
    if not options.scheduler:
        for plan in plans:
            yield pa.concat_tables(here(library, plan, options.members))
        return
    from fivebar.twin.ensemble.cluster import Cluster

    with closing(Cluster(options.scheduler)) as cluster:
        for plan in plans:
            yield pa.concat_tables(cluster.tables(fmu.read_bytes(), plan, options.members))


def run(options: Options) -> int:
    """Answers snapshots; returns 0 if at least one was answered."""
    if not (math.isfinite(options.seconds) and 0 < options.seconds <= 10) or not 1 <= options.members <= 10000:
        raise TwinError(
            f"seconds are {options.seconds:g} and members are {options.members}; up to 10 s and 1 to 10000 members are allowed"
        )
    config = process.read_config(options.config)
    candidates, goal = read(options.candidates) if options.candidates else (None, None)
    newest: list[Message] = []
    arrived = threading.Event()

    def handle(topic: str, payload: bytes) -> None:
        try:
            newest[:] = [decode(topic, payload)]
            arrived.set()
        except Refused:
            # An invalid state is ignored; the twin's own log gives the reason.
            pass

    bus = Bus(config.broker, config.unit, "what-if", ("state",), handle)
    bus.start()
    stop = process.Stop()
    answered = 0
    try:
        while (options.times == 0 or answered < options.times) and not stop.event.is_set():
            if not arrived.wait(10.0):
                raise TwinError(
                    f"no state of {config.unit} came from {config.broker.host}:{config.broker.port} within 10 s: is the twin running?"
                )
            arrived.clear()
            state = newest[0]
            answer = compare(
                Path(config.fmu) if Path(config.fmu).is_file() else shipped.unit(), state, candidates, goal, options
            )
            bus.publish("whatif", encode(Message("whatif", config.unit, state.time, state.seq, {}, answer)))
            answered += 1
            _print(answer)
    finally:
        bus.stop()
    return 0 if answered else 1


def _print(answer: dict[str, Any]) -> None:
    print(
        f"{answer['ahead']:g} s ahead, {answer['members']} members each, in {answer['took_s']:.2f} s ({answer['cpu_s']:.2f} s of CPU):"
    )
    for one in answer["candidates"]:
        end = one.get("end")
        where = (
            f"tip {1e3 * end['tip.x']:8.2f} {1e3 * end['tip.y']:8.2f} mm, 95 % within {1e3 * end['within95']:.3g} mm"
            if end
            else "end unknown"
        )
        print(
            f"  {one['rank']:2}. {one['name']:24} singularity {one['singular']['probability']:4.0%}  {where}",
            flush=True,
        )
