"""The stand-in for the machine: an FMU instance with properties unknown to the twin, encoders, and drives that follow a scene; publishes `meas`.

Like a real machine, it keeps moving without a connection, and while its process restarts. A real machine replaces it by publishing the
same message; docs/pipeline.md has the ten lines of Python.
"""

import base64
import json
import logging
import math
import random
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fivebar.errors import FiveBarError, warn
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin import priority, process, recording, scene, setup
from fivebar.twin.bus import Bus
from fivebar.twin.config import Config, Faults, read_json
from fivebar.twin.errors import TwinError
from fivebar.twin.follower import LONGEST_GAP, Book, Rider
from fivebar.twin.messages import INPUTS, MEAS_FIELDS, MEASURED, TRACKED, Message, encode
from fivebar.twin.setup import Setup
from fivebar.variables import Value

STORE_EVERY: Final = 200
"""Number of samples between two stored states."""

LEAD_NS: Final = 100_000_000
"""Time between the start of a machine and its first sample, ns."""

PAUSE: Final = LONGEST_GAP + 1.0
"""Pause between two series of a played recording, s: long enough for the twin to restart."""

SHOWN: Final = ("theta[1]", "theta[2]", *TRACKED)
"""Outputs of the unit that go into a sample."""

log = logging.getLogger("fivebar")


class StandIn:
    """Generates the samples of a simulated machine in order."""

    def __init__(self, config: Config, library: Library):
        self.config = config
        self.scene = scene.read(Path(config.scene))
        secret = dict(config.machine.hidden)
        self.offsets = [float(secret.pop(name, 0.0)) for name in OFFSETS]
        """Encoder reading minus true angle, rad. The drives close their loops on the encoders, so that commands are encoder readings, too."""

        self.encoders = setup.encoders(config.machine, self.scene.values)
        # Until the first commands act, after `servo.delay`, the drives hold the commands of the start, unless the scene has start values.
        values = self.scene.commands_at(0.0) | self.scene.values | secret
        for i, offset in enumerate(self.offsets, 1):
            for name in (f"init.theta[{i}]", f"servo.theta[{i}]"):
                shown = self.scene.shown({name: float(values.get(name, library.variable(name).start))})
                values[name] = shown[name] - offset
        self.rider = Rider(library, Setup(library.guid, self.scene, values, config.period), "machine")
        self.rider.unit.reset(**values)
        self.surroundings = [name for name in self.scene.signals if name not in INPUTS]
        self.continuous = [name for name in self.surroundings if library.variable(name).variability == "continuous"]
        self.seq = 0
        self.start_ns = 0
        """Time of the first sample, ns since 1970."""

    def next(self) -> Message:
        """Returns the next sample and moves the machine one period further."""
        seq, period, machine = self.seq, self.config.period, self.config.machine
        truth = self.rider.unit.floats(SHOWN)
        commands = self.scene.shown(self.scene.commands_at(seq * period))
        # A generator for each sample, so that a restarted machine has the same noise.
        chance = random.Random(f"{machine.seed} {seq}")
        fields: dict[str, float] = {}
        for i, (name, offset) in enumerate(zip(MEASURED, self.offsets, strict=True), 1):
            sigma, quantum = (self.encoders[f"estimator.{what}[{i}]"] for what in ("sigma", "quantum"))
            angle = truth[f"theta[{i}]"] + offset + (chance.gauss(0.0, sigma) if sigma else 0.0)
            if quantum:
                angle = round(angle / quantum) * quantum
            if not machine.drop_outs or chance.random() >= machine.drop_outs:
                fields[name] = angle
        self._move(commands)
        at = self.start_ns + round(1e9 * period) * seq
        return Message("meas", self.config.unit, at, seq, fields | commands | {name: truth[name] for name in TRACKED})

    def _move(self, commands: dict[str, float]) -> None:
        """Moves the machine to the next sample."""
        now = self.rider.unit.time
        period = self.config.period
        true = {f"servo.theta[{i}]": offset for i, offset in enumerate(self.offsets, 1)}
        book = Book(
            0,
            round(1e9 * period) * self.seq,
            self.seq,
            {name: value - true.get(name, 0.0) for name, value in commands.items()},
            True,
            1,
        )
        self.rider.hold(book)
        # Other inputs than drive commands, such as the force of a hand, are unknown to the twin.
        begin, end = (
            {name: self.scene.at(name, k * period) for name in self.surroundings} for k in (self.seq, self.seq + 1)
        )
        self.rider.unit.update(begin)
        self.rider.unit.ramp({name: (end[name] - begin[name]) / period for name in self.continuous})
        self.seq += 1
        self.rider.unit.step_to(max(self.seq * period, now + 1e-9))

    def store(self) -> bytes:
        """The stored state, from which the machine resumes with the same bits."""
        content = base64.b64encode(self.rider.unit.state().to_bytes()).decode("ascii")
        return json.dumps(
            {"seq": self.seq, "clock": self.rider.unit.time, "start": self.start_ns, "state": content}
        ).encode()

    def go_on_from(self, file: Path) -> None:
        """Resumes from a stored state."""
        content = read_json(file)
        try:
            self.rider.unit.restore(base64.b64decode(content["state"], validate=True), float(content["clock"]))
            self.seq, self.start_ns = int(content["seq"]), int(content["start"])
        except FiveBarError:
            raise
        except (KeyError, TypeError, ValueError):
            raise TwinError(f"{file} is not a stored state of the machine") from None

    def close(self) -> None:
        """Frees the unit."""
        self.rider.unit.close()


class Player:
    """Plays the samples of a recording at their times, with a pause between two series in which the twin restarts."""

    def __init__(self, config: Config):
        self.config, self.start_ns = config, 0
        self.recording = recording.read(Path(config.machine.csv))
        steps = np.diff(self.recording.time)
        steps[np.array(self.recording.begins, dtype=int) - 1] = PAUSE
        self.times = np.round(1e9 * np.concatenate([[0.0], np.cumsum(steps)])).astype(np.int64)
        """Times since the first sample, ns."""

        counts = np.maximum(1, np.round(steps / config.period).astype(np.int64))
        self.numbers = np.concatenate([[0], np.cumsum(counts)])
        """Number of each sample; lost samples count, too."""

        self.row = 0

    @property
    def seq(self) -> int:
        """Number of the next sample; at the end, one more than the last."""
        return int(self.numbers[self.row]) if self.row < len(self.numbers) else int(self.numbers[-1]) + 1

    def check(self, values: Mapping[str, Value] | None = None) -> None:
        """Raises `TwinError` for a recording that no twin can follow, by the checks of a calibration.

        It warns of coarse times and, with `values`, all start values of the scene, of servos without recorded commands.
        """
        # Imported here because the machine process does not need the packages of a calibration.
        from fivebar.twin.calibrate import data

        if self.recording.coarse:
            warn(f"{self.recording.source}: {self.recording.coarse}")
        samples = data.split(self.recording)
        data.check(samples)
        if values is not None and (doubt := data.unled(samples, values)):
            warn(doubt)

    def store(self) -> bytes:
        """The stored state."""
        return json.dumps({"seq": self.seq, "start": self.start_ns}).encode()

    def go_on_from(self, file: Path) -> None:
        """Resumes at the place that the recording would have reached by now."""
        self.start_ns = int(read_json(file)["start"])

    def next(self) -> Message | None:
        """The next sample with an angle, or None at the end."""
        while self.row < len(self.times):
            row, seq = self.row, self.seq
            self.row += 1
            values = {name: float(column[row]) for name, column in self.recording.columns.items()}
            fields = {name: values[name] for name in MEAS_FIELDS if math.isfinite(values.get(name, math.nan))}
            if any(name in fields for name in MEASURED):
                return Message("meas", self.config.unit, self.start_ns + int(self.times[row]), seq, fields)
        return None

    def commands(self, about: scene.Scene) -> Callable[[int], dict[str, float]]:
        """Commands of each sample by its number, as true angles. A command holds until the next sample, and after the last sample of a series."""
        columns = {name: column for name, column in self.recording.columns.items() if name in INPUTS}

        def told(seq: int) -> dict[str, float]:
            row = max(0, int(np.searchsorted(self.numbers, seq, side="right")) - 1)
            return about.true({name: float(column[row]) for name, column in columns.items()})

        return told

    def close(self) -> None:
        """Does nothing: a player has no open resources."""


class Mangler:
    """Injected faults of the transport: turns each sample into the payloads to send."""

    def __init__(self, faults: Faults, seed: int):
        self.faults, self.chance = faults, random.Random(f"faults {seed}")
        self.held: deque[tuple[int, bytes]] = deque()

    def send(self, message: Message) -> list[bytes]:
        """Payloads to send instead of the sample."""
        faults, chance = self.faults, self.chance
        if faults.clock_jump and message.seq >= 2000:
            message = replace(message, time=max(0, message.time + round(1e9 * faults.clock_jump)))
        payload = encode(message)
        sent = [held for due, held in self.held if due <= message.seq]
        self.held = deque((due, held) for due, held in self.held if due > message.seq)
        draw = chance.random()
        if draw < faults.lost:
            return sent
        draw -= faults.lost
        if 0 <= draw < faults.late:
            self.held.append((message.seq + chance.randint(1, 3), payload))
            return sent
        draw -= faults.late
        if 0 <= draw < faults.doubled:
            return [payload, payload, *sent]
        draw -= faults.doubled
        if 0 <= draw < faults.malformed:
            broken = payload[: chance.randint(0, len(payload) - 1)]
            return [broken, payload, *sent]
        return [payload, *sent]


def run(file: Path) -> int:
    """Publishes samples at their times until the process is asked to stop or the recording ends."""
    config = process.read_config(file)
    process.set_up_log()
    priority.take("machine")
    stop, disk = process.Stop(), process.Disk()
    status = process.Status(config, "machine", disk)
    library = None if config.machine.csv else Library(Path(config.fmu))
    source: StandIn | Player = Player(config) if library is None else StandIn(config, library)
    file = config.path / "state" / "machine.json"
    mangler = Mangler(config.machine.faults, config.machine.seed)
    bus = Bus(config.broker, config.unit, "machine", (), lambda *_: None)
    bus.start()
    while not bus.ready() and not stop.wait(0.01):
        pass
    delay, period = round(1e9 * config.machine.delay), round(1e9 * config.period)
    if file.is_file():
        source.go_on_from(file)
        # The samples between the stored state and now are skipped, as nobody could receive them.
        while source.start_ns + source.seq * period + delay < time.time_ns() and source.next() is not None:
            pass
        log.info("resuming with sample %d", source.seq)
    else:
        source.start_ns = time.time_ns() + LEAD_NS
        process.replace_file(file, source.store(), safe=True)
    published = 0
    while not stop.event.is_set():
        # Each sample is computed before its time, so that the computation does not delay it.
        message = source.next()
        if message is None:
            break
        wait = 1e-9 * (message.time + delay - time.time_ns())
        if wait > 0 and stop.wait(wait):
            break
        for payload in mangler.send(message):
            bus.publish("meas", payload)
        published += 1
        if source.seq % STORE_EVERY == 0:
            disk.put(file, source.store(), safe=True)
        if status.due(bus.ready()):
            status.write(_status(published, message.seq, bus))
    status.write(_status(published, source.seq - 1, bus))
    bus.stop()
    disk.close()
    source.close()
    if library is not None:
        library.close()
    return 0


def _status(published: int, seq: int, bus: Bus) -> dict[str, Any]:
    own = {"name": "machine", "ready": bus.ready(), "connections": bus.connections, "unsent": bus.unsent}
    return own | {"published": published, "seq": seq, "memory_kb": process.memory_kb()}
