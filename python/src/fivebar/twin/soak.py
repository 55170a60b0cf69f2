"""`fivebar soak`: runs machine, twin, watch and recorder over hours of samples, without broker and clock; nothing may be lost or grow."""

import re
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from fivebar.library import Library
from fivebar.twin import figures, process, scene, setup, starter
from fivebar.twin.ahead import Ahead
from fivebar.twin.config import Config, Machine
from fivebar.twin.errors import TwinError
from fivebar.twin.follow import Twin
from fivebar.twin.machine import Mangler, StandIn
from fivebar.twin.messages import decode, topic
from fivebar.twin.process import Worker
from fivebar.twin.recorder import Recorder
from fivebar.twin.watch import Watch

BEGIN: Final = 1_795_331_400_000_000_000
"""Start time of the machine, ns."""

SETTLED: Final = 360.0
"""Minimum duration for a judgement of the memory, s: by half of it, all bounded buffers are full. The memory of shorter runs still grows."""

LOOKS: Final = 20
"""Number of memory measurements, evenly spaced over the samples."""


class Wire:
    """Delivers the messages of each worker immediately to the workers that listen to them."""

    def __init__(self, config: Config, *workers: Worker):
        self.config, self.workers = config, workers
        # Each worker of a process of its own decodes each message once; here the first one does it for all.
        decoded = lru_cache(maxsize=16)(decode)
        self.now = BEGIN
        """Clock of the workers, ns: the time of the newest sample."""
        for worker in workers:
            worker.begin()
            worker.send, worker.decode = self.send, decoded

    def send(self, kind: str, payload: bytes) -> bool:
        """Delivers a message."""
        if kind == "meas" and (found := re.search(rb'"time":(\d{19})\b', payload)):
            self.now = max(self.now, int(found[1]))
        for worker in self.workers:
            if kind in worker.kinds:
                worker.received(topic(self.config.unit, kind), payload, self.now)
        return True

    def tick(self) -> None:
        """Runs the periodic work of all workers."""
        for worker in self.workers:
            worker.tick(self.now)
            worker.write()

    def end(self) -> None:
        """Ends all workers, the recorder last."""
        for worker in sorted(self.workers, key=lambda worker: isinstance(worker, Recorder)):
            worker.end()


@dataclass(frozen=True)
class Options:
    """Options of a soak: scenes and duration."""

    hours: float
    """Duration, with 200 samples per second."""

    scene: str | Path
    """Name of a shipped scene, or a file."""

    fmu: Path
    faults: str
    learn: bool
    exact: bool


def configured(
    folder: Path, fmu: Path, library: Library, given: str | Path, learn: bool = False, exact: bool = False
) -> Config:
    """A configuration with the same differences between stand-in and twin as `fivebar twin` with these options."""
    folder.mkdir(parents=True, exist_ok=True)
    file = scene.resolve(given, library.known, folder)
    values = scene.read(file).values
    machine = Machine(hidden=starter.hidden(library, values, exact))
    twin = (setup.learning(library, values) if learn else {}) | (setup.EXACT if exact else {})
    return Config(str(folder), str(fmu), str(file), machine=machine, twin=twin)


def machine(config: Config, library: Library) -> StandIn:
    """The stand-in at its first sample."""
    made = StandIn(config, library)
    made.start_ns = BEGIN
    return made


def run(options: Options) -> int:
    """Returns 0 if every sample has an estimate and the memory has stopped growing, 3 if forecasts were worse than promised, else 1."""
    if not 0 < options.hours <= 1000:
        raise TwinError(f"hours are {options.hours:g}; more than 0 and at most 1000 are allowed")
    faults = starter.parse_faults(options.faults)
    library = Library(options.fmu)
    try:
        with tempfile.TemporaryDirectory() as folder:
            config = configured(Path(folder), options.fmu, library, options.scene, options.learn, options.exact)
            starter.check_followed(config, True)
            twin, ahead, watch, recorder = (
                Twin(config, library),
                Ahead(config, library, at_once=True),
                Watch(config),
                Recorder(config),
            )
            recorder.about = twin.setup.to_message(config.unit, BEGIN)
            wire, source, mangler = (
                Wire(config, twin, ahead, watch, recorder),
                machine(config, library),
                Mangler(faults, 1),
            )
            samples = round(options.hours * 3600 / config.period)
            memory = []
            begin = time.process_time()
            for i in range(samples):
                for payload in mangler.send(source.next()):
                    wire.send("meas", payload)
                if i % 100 == 99:
                    wire.tick()
                if i % max(1, samples // LOOKS) == 0:
                    memory.append(process.memory_kb() / 1024)
                    speed = config.period * i / max(time.process_time() - begin, 1e-9)
                    print(
                        f"{i:8d} of {samples} samples, {memory[-1]:.1f} MB, {speed:.1f} x real time by CPU time",
                        file=sys.stderr,
                        flush=True,
                    )
            wire.end()
            source.close()
            story = figures.read(config.record)
            content = figures.summarise(config, story, figures.judge(story), {}, {})
    finally:
        library.close()
    counts = twin.counts
    # By half-time, all bounded buffers are full and parts have been joined.
    half = memory[len(memory) // 2]
    growth = memory[-1] - half
    print(
        f"{samples} samples, {counts['taken']} taken, {counts['late']} late, {counts['estimated']} estimated, {recorder.counts['written']} rows"
    )
    print(f"memory {half:.1f} MB after a half, {memory[-1]:.1f} MB at the end; {watch.alarms} alarms")
    forecasts = content["forecasts"]
    width, covered = forecasts["halfwidth_mm"]["median"], forecasts["coverage95"]
    if covered is not None:
        off = forecasts["by_ahead"][f"{config.horizon:g}"]
        print(
            f"{forecasts['count']} forecasts: {100 * covered:.3g} % inside, half-width {width:.3g} mm (median), error {off['error_median_mm']:.2g} mm (median), {off['error_mm']:.2g} mm (rms)"
        )
        print(
            "error of the estimated tip {median:.2g} mm (median), {rms:.2g} mm (rms)".format(**content["tip_error_mm"])
        )
    for sentence in content["missed"]:
        print(sentence)
    lost = 0 if options.faults else samples - counts["estimated"]
    if lost or (growth > 5 and samples * config.period >= SETTLED):
        return 1
    return figures.MISSED if content["missed"] else 0
