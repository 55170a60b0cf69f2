"""What the tests of the twin's pipeline share: its processes' work in one process, on a wire in the place of a broker."""

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fivebar_twin import scene, setup, starter
from fivebar_twin.config import Config, Machine
from fivebar_twin.follow import Twin
from fivebar_twin.follower import Follower
from fivebar_twin.machine import StandIn
from fivebar_twin.messages import Message, encode, topic
from fivebar_twin.process import Worker
from fivebar_twin.recorder import Recorder
from fivebar_twin.unit import Library
from fivebar_twin.watch import Watch

BEGIN = 1_795_331_400_000_000_000
"""When the machine starts, ns."""


def configured(folder: Path, fmu: Path, library: Library, scenes: Path, name: str = "pick_and_place", **changes: Any) -> Config:
    """A configuration in which the stand-in differs from its twin as in a default run."""
    file = scenes / f"{name}.json"
    machine = Machine(hidden=starter.hidden(library, scene.read(file).values))
    return Config(str(folder), str(fmu), str(file), machine=machine, **changes)


def machine(config: Config, library: Library) -> StandIn:
    """The stand-in at its first sample."""
    made = StandIn(config, library)
    made.start_ns = BEGIN
    return made


def follower(config: Config, library: Library) -> Follower:
    """A twin without its process."""
    return Follower(library, setup.of_run(config, scene.read(Path(config.scene)), library.guid))


class Wire:
    """Brings what one worker sends to those that listen to it, at once."""

    def __init__(self, config: Config, *workers: Worker):
        self.config, self.workers = config, workers
        self.sent: list[tuple[str, bytes]] = []
        for worker in workers:
            worker.begin()
            worker.send = self.send

    def send(self, kind: str, payload: bytes) -> bool:
        self.sent.append((kind, payload))
        for worker in self.workers:
            if kind in worker.kinds:
                worker.received(topic(self.config.unit, kind), payload, time.time_ns())
        return True

    def tick(self) -> None:
        for worker in self.workers:
            worker.tick(time.time_ns())

    def end(self) -> None:
        """The recorder last."""
        for worker in sorted(self.workers, key=lambda worker: isinstance(worker, Recorder)):
            worker.end()


def recorded(config: Config, library: Library, samples: int, mangle: Callable[[Message], list[bytes]] = lambda m: [encode(m)]) -> SimpleNamespace:
    """Machine, twin, watch and recorder for so many samples; what they were, ended."""
    twin, watch, recorder = Twin(config, library), Watch(config), Recorder(config)
    recorder.about = twin.setup.to_message(config.unit, BEGIN)
    wire = Wire(config, twin, watch, recorder)
    source = machine(config, library)
    for _ in range(samples):
        for payload in mangle(source.next()):
            wire.send("meas", payload)
        if source.seq % 100 == 0:
            wire.tick()
    wire.end()
    source.close()
    return SimpleNamespace(twin=twin, watch=watch, recorder=recorder, wire=wire, folder=recorder.folder)
