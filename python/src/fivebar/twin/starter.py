"""`fivebar twin`: starts the processes of a twin in order, restarts dead ones, shows progress, ends all and writes a summary."""

import contextlib
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import webbrowser
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from fivebar.errors import UnitError
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin import config as configuration
from fivebar.twin import priority, recording, scene, setup
from fivebar.twin.config import Broker, Config, Faults, Machine
from fivebar.twin.errors import TwinError
from fivebar.twin.follower import Follower
from fivebar.twin.machine import Player, StandIn
from fivebar.twin.messages import MEASURED, Message
from fivebar.twin.process import STATUS_EVERY

READY_WITHIN: Final = 20.0
"""Time limit for a process to become ready, s."""

ANSWERS_WITHIN: Final = 5.0
"""Time limit for a broker to accept a connection, s."""

MOST_RESTARTS: Final = 20
"""Maximum number of restarts of one process within a minute; beyond it, the run fails."""

KEPT_RUNS: Final = 5

ORDER: Final = ("broker", "record", "watch", "dashboard", "forecast", "follow", "machine")
"""Order in which the processes start; they end in reverse order, but recorder and broker last."""

SETTLED_WITHIN: Final = 10.0
"""Time limit for the arrival of the last messages, s."""

LARGEST_LOG: Final = 1_000_000
"""Maximum size of a process' log, bytes; a longer one is copied to `.log.1` and emptied."""

TROUBLES: Final = 1000
"""Maximum number of messages from processes in the summary."""

ENDING: Final = ("watch", "machine", "follow", "forecast", "dashboard", "record", "broker")
"""Order in which the processes end. The watch is first, because it would report the missing estimates as silence."""


@dataclass(frozen=True)
class Options:
    """Options of a run."""

    seconds: float
    """Duration in real time; infinite: until Ctrl-C."""

    scene: str | Path
    """Name of a shipped scene, or a file."""

    fmu: Path
    out: Path
    """Folder for summary, pictures, page and record."""

    unit: str
    """Name of the machine in topics."""

    broker: str | None
    """HOST:PORT of any MQTT broker; None: the embedded one."""

    user: str
    ca_file: str
    machine: str
    """`stand-in`, or `none` if a real machine publishes."""

    csv: Path | None
    """A recording to play instead of the stand-in."""

    hidden: Path | None
    """JSON file with properties of the stand-in that the twin does not know."""

    faults: str
    learn: bool
    """Whether the twin learns masses, payload, friction, lengths and mounting angles."""

    exact: bool
    """Whether lengths and encoders of the stand-in are exact, and the twin assumes so."""

    open: bool
    """Whether to show the dashboard and keep running."""

    @property
    def publishes(self) -> bool:
        """Whether this run has its own machine: a recording or the stand-in."""
        return self.csv is not None or self.machine != "none"


@dataclass
class Child:
    """A process of the run."""

    name: str
    command: list[str]
    log: Path
    say: Callable[[str], None]
    """Receives the messages of the process, one line at a time."""

    process: subprocess.Popen[bytes] | None = None
    restarts: int = 0
    recent: tuple[float, ...] = ()

    def start(self) -> None:
        # A process group of its own, so that Ctrl-C only reaches the starter, which ends all in order. Not its own session, because Linux
        # first shares the cores among sessions: low priority would have no effect within this run.
        group = 0 if os.name == "posix" else None
        with open(self.log, "ab", opener=private) as log:
            self.process = subprocess.Popen(
                self.command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, process_group=group
            )
        priority.hurry(self.process.pid)
        threading.Thread(target=self._listen, args=(self.process,), name=self.name, daemon=True).start()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Forwards standard output, which is for users. It needs no disk, so that even a full disk is reported."""
        assert process.stdout is not None
        with process.stdout as lines:
            for line in lines:
                self.say(f"{self.name}: {line.decode(errors='replace').strip()}")

    def look(self) -> bool:
        """Restarts the process if it has died; returns whether it is a machine that has ended."""
        code = None if self.process is None else self.process.poll()
        if code is None:
            return False
        if code == 0 and self.name == "machine":
            return True
        now = time.monotonic()
        self.recent = (*(t for t in self.recent if now - t < 60), now)
        if len(self.recent) > MOST_RESTARTS:
            raise TwinError(
                f"`{self.name}` keeps dying, last with exit code {code}; the end of {self.log}:\n{self.tail()}"
            )
        self.restarts += 1
        self.start()
        return False

    def rotate(self) -> None:
        """Copies a long log to `.log.1` and empties it. The process appends, so that it continues in the emptied file."""
        with contextlib.suppress(OSError):
            if self.log.stat().st_size > LARGEST_LOG:
                with self.log.open("rb") as old, open(self.log.with_suffix(".log.1"), "wb", opener=private) as kept:
                    shutil.copyfileobj(old, kept)
                os.truncate(self.log, 0)

    def end(self, patience: float = 5.0) -> None:
        """Asks the process to end, and kills it if it does not."""
        if self.process is None or self.process.poll() is not None:
            return
        self.process.terminate()
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def tail(self) -> str:
        """The last lines of the log."""
        return "\n".join(self.log.read_text(encoding="utf-8", errors="replace").splitlines()[-8:])


def private(path: str, flags: int) -> int:
    """Opens a file that only its owner can access."""
    return os.open(path, flags, 0o600)


class Run:
    """The processes of one configuration."""

    def __init__(self, config: Config, names: tuple[str, ...]):
        self.config = config
        self.file = config.path / "twin.json"
        configuration.write(config, self.file)
        logs = config.path / "log"
        logs.mkdir(mode=0o700, exist_ok=True)
        command = [sys.executable, "-m", "fivebar.twin"]
        self.troubles: deque[str] = deque(maxlen=TROUBLES)
        self.children = {
            n: Child(n, [*command, n, "--config", str(self.file)], logs / f"{n}.log", self.say)
            for n in ORDER
            if n in names
        }

    def start(self) -> None:
        """Starts all processes, the machine last, after the others listen."""
        for name, child in self.children.items():
            if name == "machine":
                self._wait_for([n for n in self.children if n != "machine"])
            child.start()
            if name == "broker":
                self._wait_for([name])
        self._wait_for(list(self.children))

    def look(self) -> bool:
        """Restarts dead processes; returns whether the machine has ended."""
        ended = [name for name, child in self.children.items() if child.look()]
        for child in self.children.values():
            child.rotate()
        return "machine" in ended

    def say(self, line: str) -> None:
        """Shows a message of a process."""
        self.troubles.append(line)
        print(clear() + line, flush=True)

    def end(self) -> None:
        """Ends all processes: first the senders, then the receivers, after all messages have arrived."""
        for name in ENDING:
            if name in ("follow", "record"):
                self._settle()
            if name in self.children:
                self.children[name].end()

    def _settle(self) -> None:
        """Waits until the recorder receives no more messages; on busy cores, the last ones may still be on their way."""
        begin, changed, before = time.monotonic(), time.monotonic(), -1
        while time.monotonic() - begin < SETTLED_WITHIN:
            lives = self.status()
            count = total(lives.get("record", []), "recorded")
            if count != before:
                before, changed = count, time.monotonic()
            # A killed recorder has not reported all of its messages.
            behind = len(lives.get("record", [])) == 1 and count < sum(
                total(lives.get("follow", []), n) for n in ("taken", "estimated")
            )
            if not behind and time.monotonic() - changed > 1.5 * STATUS_EVERY:
                return
            time.sleep(0.05)

    def status(self) -> dict[str, list[dict[str, Any]]]:
        """The status of all processes by name, with an entry for each start of a process."""
        found: dict[str, list[dict[str, Any]]] = {}
        for file in sorted((self.config.path / "status").glob("*.json"), key=lambda path: path.stat().st_mtime):
            content = json.loads(file.read_text(encoding="utf-8"))
            found.setdefault(str(content["name"]), []).append(content)
        return found

    def _wait_for(self, names: list[str]) -> None:
        begin = time.monotonic()
        while not all(any(life.get("ready") for life in self.status().get(name, [])) for name in names):
            self.look()
            if time.monotonic() - begin > READY_WITHIN:
                late = [n for n in names if not any(life.get("ready") for life in self.status().get(n, []))]
                tails = "\n".join(self.children[n].tail() for n in late if n in self.children)
                raise TwinError(f"{', '.join(late)} not ready after {READY_WITHIN:g} s:\n{tails}")
            time.sleep(0.02)


def clear() -> str:
    """Escape sequence that clears a line on a terminal."""
    return "\r\x1b[K" if sys.stdout.isatty() else ""


def total(lives: list[dict[str, Any]], name: str) -> int:
    """Sum of a count over all starts of a process."""
    return sum(int(life.get(name, 0)) for life in lives)


def hidden(
    library: Library, values: dict[str, float | int | bool], exact: bool = False
) -> dict[str, float | int | bool]:
    """Properties of the stand-in that the twin does not know, with errors like a real machine.

    Masses are up to 5 % off, the payload is a fifth heavier, bearings have friction; lengths are 0.1 % off and encoders 1 mrad, unless
    they are `exact`.
    """

    def value(name: str) -> float:
        return float(values.get(name, library.variable(name).start))

    changed: dict[str, float | int | bool] = {}
    for i, factor in enumerate((1.05, 0.96, 1.03, 0.95), 1):
        for what in ("mass", "inertia"):
            changed[f"link[{i}].{what}"] = factor * value(f"link[{i}].{what}")
    if not exact:
        # With these signs, the tip of pick_and_place is 0.5 mm off; half of all choices of signs give as much or more.
        for i, factor in enumerate((1.001, 0.999, 0.999, 1.001), 1):
            changed[f"link[{i}].length"] = factor * value(f"link[{i}].length")
        changed["base.distance"] = 0.999 * value("base.distance")
        changed |= zip(OFFSETS, (1e-3, 1e-3), strict=True)
    if values.get("payload.enabled"):
        changed["payload.mass"] = 1.2 * value("payload.mass")
    return changed | {"viscous.enabled": True}


def free_port() -> int:
    """A free port of the loopback interface."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def parse_faults(text: str) -> Faults:
    """Parses faults such as `lost=0.05,doubled=0.02`: shares of the samples; clock_jump in s."""
    known = [f.name for f in fields(Faults)]
    given: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        name, _, value = part.partition("=")
        try:
            given[name] = float(value)
        except ValueError:
            given[name] = math.nan
        if name not in known or not math.isfinite(given[name]) or (name != "clock_jump" and not 0 <= given[name] <= 1):
            raise TwinError(
                f"fault {part!r:.60}; NAME=SHARE is expected with a share from 0 to 1, and {', '.join(known)} as names"
            )
    return Faults(**given)


def run_folder(out: Path) -> Path:
    """Makes a folder for this run and deletes old ones, except the last few."""
    runs = out / "runs"
    try:
        runs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TwinError(f"out is {out}; a folder that exists or can be made is needed: {error.strerror}") from None
    finished = sorted(path.parent for path in runs.glob("*/finished"))
    for old in finished[: max(0, len(finished) - KEPT_RUNS + 1)]:
        for file in sorted(old.rglob("*"), reverse=True):
            file.rmdir() if file.is_dir() else file.unlink()
        old.rmdir()
    folder = runs / f"{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}-{os.getpid()}"
    # Only the owner may read records, states and logs.
    folder.mkdir(mode=0o700)
    return folder


def configure(options: Options, folder: Path) -> Config:
    """The configuration of a run with its files in `folder`."""
    if not options.seconds > 0:
        raise TwinError(f"seconds must be more than 0, not {options.seconds:g}")
    if options.hidden is not None and (options.csv or options.machine == "none"):
        raise TwinError(
            f"hidden is {options.hidden}, but only the stand-in has hidden properties: --csv and --machine none are not allowed with it"
        )
    if options.faults and not options.publishes:
        raise TwinError(
            f"faults are {options.faults!r:.60}, but --machine none sends no messages that could have faults"
        )
    if options.broker:
        broker = configuration.other_broker(options.broker, options.user, options.ca_file)
    else:
        broker = Broker("127.0.0.1", free_port(), True)
    library = Library(options.fmu)
    try:
        resolved = scene.resolve(options.scene, library.known, folder)
        values = scene.read(resolved).values
        if options.hidden is not None:
            secret = configuration.read_json(options.hidden)
        else:
            secret = hidden(library, values, options.exact)
        twin = (setup.learning(library, values) if options.learn else {}) | (setup.EXACT if options.exact else {})
        for name in secret.keys() - OFFSETS:
            library.variable(name)
        csv = str(options.csv.resolve()) if options.csv else ""
        period = sampling(options.csv) if options.csv else Config.period
    finally:
        library.close()
    machine = Machine(hidden=secret, csv=csv, faults=parse_faults(options.faults))
    config = Config(
        folder=str(folder.resolve()),
        fmu=str(options.fmu.resolve()),
        scene=str(resolved.resolve()),
        unit=options.unit,
        broker=broker,
        machine=machine,
        dashboard_port=free_port(),
        period=period,
        horizon=max(Config.horizon, configuration.FEWEST_AHEAD * period),
        twin=twin,
    )
    configuration.check(config)
    return config


def sampling(csv: Path) -> float:
    """Median sampling period of a recording, s."""
    period = round(recording.read(csv).period, 9) or Config.period
    if period < configuration.SHORTEST_PERIOD:
        raise TwinError(
            f"{csv} has a sample every {period:g} s (median); {configuration.SHORTEST_PERIOD:g} s or more is expected"
        )
    return period


def check_followed(config: Config, stand_in: bool) -> None:
    """Raises `TwinError` with the FMU's message if the scene cannot run or no twin can follow it, instead of a run without estimates."""
    library = Library(Path(config.fmu))
    try:
        known = scene.read(Path(config.scene))
        begin = {
            name: float(known.values.get(f"init.theta[{i}]", library.variable(f"init.theta[{i}]").start))
            for i, name in enumerate(MEASURED, 1)
        }
        sample: Message | None = Message("meas", config.unit, 0, 0, known.shown(begin | known.commands_at(0.0)))
        if stand_in:
            machine: Player | StandIn
            if config.machine.csv:
                machine = Player(config)
                machine.check({**library.known.start, **known.values})
            else:
                try:
                    machine = StandIn(config, library)
                except UnitError as error:
                    raise TwinError(f"the machine cannot move by {known.name}: {error}") from None
            # The twin starts at the first sample with both angles.
            while (sample := machine.next()) is not None and not all(name in sample.fields for name in MEASURED):
                pass
            machine.close()
        if sample is None:
            raise TwinError(
                f"{config.machine.csv} has no sample with both {MEASURED[0]} and {MEASURED[1]}: no twin can start"
            )
        twin = Follower(library, setup.of_run(config, known, library.guid))
        twin.meas(sample)
        failure = twin.failure
        twin.close()
        if failure:
            raise TwinError(f"the twin cannot follow {config.machine.csv or known.name}: {failure}")
    finally:
        library.close()


def check_broker(broker: Broker) -> None:
    """Raises `TwinError` if the broker does not answer, instead of processes that wait for it."""
    if broker.embedded:
        return
    try:
        socket.create_connection((broker.host, broker.port), ANSWERS_WITHIN).close()
    except OSError as error:
        raise TwinError(f"there is no broker at {broker.host}:{broker.port}: {error.strerror or error}") from None


def run(options: Options) -> int:
    """Returns 0 if the twin followed, 1 if not, 3 if its forecasts were worse than promised; the summary is in OUT/summary.json."""
    # Invalid options are refused before the folder is made.
    with tempfile.TemporaryDirectory() as before:
        config = configure(options, Path(before))
        check_broker(config.broker)
        check_followed(config, options.publishes)
    folder = run_folder(options.out)
    config = configure(options, folder)
    names = tuple(
        n for n in ORDER if (n != "broker" or config.broker.embedded) and (n != "machine" or options.publishes)
    )
    run = Run(config, names)
    asked = Asked()
    try:
        run.start()
        address = f"http://127.0.0.1:{config.dashboard_port}/"
        print(
            f"broker at {config.broker.host}:{config.broker.port}, dashboard at {address}, record in {config.record}",
            flush=True,
        )
        if options.open:
            webbrowser.open(address)
        _watch(run, asked, math.inf if options.open else options.seconds)
    finally:
        run.end()
        with contextlib.suppress(OSError):
            # A full disk usually has space for this empty file. Without it, the run seems active and its folder is never deleted.
            (folder / "finished").touch()
    # The slow import of plot packages waits until no message is urgent.
    from fivebar.twin import summary

    return summary.write(
        run.config,
        run.status(),
        {n: child.restarts for n, child in run.children.items()},
        options.out,
        list(run.troubles),
    )


class Asked:
    """Whether Ctrl-C or SIGTERM has requested the end."""

    def __init__(self) -> None:
        self.end = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, *_: object) -> None:
        self.end = True


def _watch(run: Run, asked: Asked, seconds: float) -> None:
    """Watches the run until the time is over, the recording has ended, or the end is requested."""
    begin = time.monotonic()
    for _ in _progress(run, begin, seconds):
        if asked.end or time.monotonic() - begin >= seconds:
            return
        if run.look():
            return
        time.sleep(0.05)


def _progress(run: Run, begin: float, seconds: float) -> Iterator[None]:
    """Prints progress: twice per second on a terminal, otherwise ten lines in total."""
    terminal = sys.stdout.isatty()
    every = 0.5 if terminal else max(1.0, seconds / 10 if math.isfinite(seconds) else 60.0)
    shown = begin
    while True:
        yield
        now = time.monotonic()
        if now - shown < every:
            continue
        shown = now
        lives = run.status()
        watch = lives.get("watch", [{}])[-1]
        of = f" of {seconds:g}" if math.isfinite(seconds) else ""
        # Only the stand-in reports its number of published samples; for other machines, the watch counts the received ones.
        samples = max(total(lives.get("machine", []), "published"), total(lives.get("watch", []), "samples"))
        line = (
            f"{now - begin:6.1f}{of} s   {samples} samples, "
            f"{total(lives.get('follow', []), 'estimated')} estimates, p99 {watch.get('latency_ms', {}).get('p99', 0):.1f} ms, "
            f"{watch.get('alarms', 0)} alarms"
        )
        print(clear() + line, end="" if terminal else "\n", flush=True)
