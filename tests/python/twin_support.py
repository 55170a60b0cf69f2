"""Helpers for the tests of the twin's pipeline."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

from fivebar.library import Library
from fivebar.twin import scene, setup
from fivebar.twin.config import Config
from fivebar.twin.follow import Twin
from fivebar.twin.follower import Follower
from fivebar.twin.messages import Message, encode
from fivebar.twin.recorder import Recorder
from fivebar.twin.soak import BEGIN, Wire, machine
from fivebar.twin.watch import Watch


def follower(config: Config, library: Library) -> Follower:
    """A twin without a process of its own."""
    return Follower(library, setup.of_run(config, scene.read(Path(config.scene)), library.guid))


def recorded(
    config: Config, library: Library, samples: int, mangle: Callable[[Message], list[bytes]] = lambda m: [encode(m)]
) -> SimpleNamespace:
    """Runs machine, twin, watch and recorder for `samples` samples and ends them."""
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
