"""Common frame of the processes of a run: signals, log, connection, status file, and an end when the starter has died."""

import contextlib
import gc
import json
import logging
import math
import os
import re
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Final

from fivebar.twin import config as configuration
from fivebar.twin import priority
from fivebar.twin.bus import Bus
from fivebar.twin.config import Config
from fivebar.twin.errors import Refused
from fivebar.twin.messages import Message, decode, encode

STATUS_EVERY: Final = 0.5
AGAIN: Final = 5.0
"""Time after which the same problem is reported again, s; the log contains each."""

NUMBER: Final = re.compile(r"\d[-+.e\d]*")
TICK: Final = 0.05

log = logging.getLogger("fivebar")


class Worker(ABC):
    """The work of one process. `handle` and `tick` never run at the same time."""

    name: ClassVar[str]
    kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds of messages that the worker listens to."""

    def __init__(self, config: Config):
        self.config = config
        self.send: Callable[[str, bytes], bool] = self._not_yet
        self.decode: Callable[[str, bytes], Message] = decode
        """Decodes and checks a message."""
        self.keep: Callable[[Path, bytes], None] = replace_file
        """Replaces a file."""
        self.hear_others: Callable[[bool], None] = self._nobody
        """Starts or stops listening to the samples of all units."""
        self.refused = 0
        self.when_told: dict[str, float] = {}

    @staticmethod
    def _not_yet(_kind: str, _payload: bytes) -> bool:
        return False

    @staticmethod
    def _nobody(_on: bool) -> None:
        pass

    def received(self, topic: str, payload: bytes, now: int) -> None:
        """Handles a received message at a time in ns, or refuses it with one line in the log."""
        try:
            message = self.decode(topic, payload)
            if message.kind not in self.kinds:
                raise Refused(f"{topic[:100]!r} is not for this process")
            if message.unit != self.config.unit:
                raise Refused(f"{message.kind} is of the unit {message.unit!r}, not of {self.config.unit!r} (--unit)")
            self.handle(message, payload, now)
        except Refused as error:
            self.refuse(topic, error, now)

    def refuse(self, topic: str, error: Refused, now: int) -> None:
        """Logs a message refused at a time in ns."""
        self.refused += 1
        log.warning("refused: %s", error)

    def publish(self, message: Message) -> bool:
        """Sends a message of this unit."""
        message = Message(message.kind, self.config.unit, message.time, message.seq, message.fields, message.extra)
        return self.send(message.kind, encode(message))

    def trouble(self, cause: str, sentence: str, now: int, seq: int = 0, every: float = AGAIN, **more: Any) -> None:
        """Reports a problem that keeps the twin from its work."""
        self.tell("trouble", cause, sentence, now, seq, every, **more)

    def tell(
        self, state: str, cause: str, sentence: str, now: int, seq: int = 0, every: float = AGAIN, **more: Any
    ) -> None:
        """Reports an event at a time in ns. Each report goes to the log. It also goes to an alarm and to standard output, which the starter
        shows, unless the same sentence (apart from numbers) was reported within the last `every` seconds."""
        log.warning("%s", sentence)
        key = f"{cause} {NUMBER.sub('#', sentence)}"
        moment = time.monotonic()
        if moment - self.when_told.get(key, -math.inf) < every:
            return
        self.when_told = {k: when for k, when in self.when_told.items() if moment - when < AGAIN} | {key: moment}
        with contextlib.suppress(OSError):
            # If the starter has died, nobody reads standard output.
            print(sentence, flush=True)
        self.publish(
            Message(
                "alarm",
                "",
                now,
                seq,
                {},
                {"state": state, "cause": cause, "from": self.name, "sentence": sentence[:1000]} | more,
            )
        )

    def begin(self) -> None:
        """Called before the first message, to read a stored state."""

    @abstractmethod
    def handle(self, message: Message, payload: bytes, now: int) -> None:
        """Handles a checked message. May raise `Refused`."""

    def tick(self, now: int) -> None:
        """Called about 20 times per second, with the time in ns."""

    def write(self) -> None:
        """Called after each `tick`, in parallel with `handle`: for disk access."""

    def status(self) -> dict[str, Any]:
        """Figures since the start of this process, all of fixed size."""
        return {}

    def finished(self) -> bool:
        """Whether the work is complete."""
        return False

    def end(self) -> None:
        """Called at the end, to store results."""


def set_up_log() -> None:
    """Configures the log: one line per event on standard error, with the time in UTC."""
    handler = logging.StreamHandler(sys.stderr)
    formatter = logging.Formatter("%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%S")
    formatter.converter = time.gmtime
    handler.setFormatter(formatter)
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    # Processes publish the unit's messages where they matter; forecasts would repeat its warnings.
    logging.getLogger("fivebar.unit").setLevel(logging.ERROR)


class Stop:
    """Stop event, set by SIGTERM, by Ctrl-C, and after the death of the parent process."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.parent = os.getppid()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self.event.set())

    def wait(self, seconds: float) -> bool:
        """Waits for at most `seconds` and returns whether to stop."""
        if os.getppid() != self.parent:
            self.event.set()
        return self.event.wait(max(seconds, 0.0))


class Disk:
    """Writes files in its own thread, so that urgent work never waits for a disk. Only the newest content of each file is written."""

    def __init__(self) -> None:
        self.waiting: dict[Path, tuple[bytes, bool]] = {}
        self.come = threading.Condition()
        self.ended = False
        self.failing: set[Path] = set()
        self.thread = threading.Thread(target=self._work, name="disk", daemon=True)
        self.thread.start()

    def put(self, file: Path, content: bytes, safe: bool = False) -> None:
        """Queues the replacement of a file; with `safe`, it survives a power failure."""
        with self.come:
            self.waiting[file] = content, safe
            self.come.notify()

    def _work(self) -> None:
        while True:
            with self.come:
                self.come.wait_for(lambda: self.waiting or self.ended)
                if not self.waiting:
                    return
                file, (content, safe) = self.waiting.popitem()
            try:
                replace_file(file, content, safe)
                self.failing.discard(file)
            except OSError as error:
                # The next content comes soon, and the disk may work again by then.
                if file not in self.failing:
                    log.warning("%s is not written: %s", file, error.strerror)
                self.failing.add(file)

    def close(self) -> None:
        """Writes all waiting files."""
        with self.come:
            self.ended = True
            self.come.notify()
        self.thread.join()


class Status:
    """A small file with the figures of a process; it is replaced as a whole, never half written."""

    def __init__(self, config: Config, name: str, disk: Disk):
        self.file, self.disk = config.path / "status" / f"{name}-{os.getpid()}.json", disk
        self.ready: bool | None = None
        self.written = 0.0

    def due(self, ready: bool) -> bool:
        """Whether it is time to write the file; immediately when the process becomes ready."""
        return ready != self.ready or time.monotonic() - self.written >= STATUS_EVERY

    def write(self, content: dict[str, Any]) -> None:
        """Queues new content for the file."""
        self.ready, self.written = content["ready"], time.monotonic()
        self.disk.put(self.file, json.dumps(content).encode())


def serve(worker: Worker) -> int:
    """Runs a worker until the process is asked to stop."""
    set_up_log()
    priority.take(worker.name)
    config = worker.config
    stop, disk, lock = Stop(), Disk(), threading.Lock()
    status = Status(config, worker.name, disk)

    def handle(topic: str, payload: bytes) -> None:
        with lock:
            worker.received(topic, payload, time.time_ns())

    worker.keep = disk.put
    worker.begin()
    bus = Bus(config.broker, config.unit, worker.name, worker.kinds, handle)
    worker.send, worker.hear_others = bus.publish, bus.hear_others
    bus.start()
    spare_collector()

    def report() -> None:
        own = {"name": worker.name, "pid": os.getpid(), "ready": bus.ready(), "connections": bus.connections}
        status.write(
            own | {"unsent": bus.unsent, "refused": worker.refused, "memory_kb": memory_kb()} | worker.status()
        )

    while not stop.wait(TICK) and not worker.finished():
        with lock:
            worker.tick(time.time_ns())
            if status.due(bus.ready()):
                report()
        worker.write()
    with lock:
        worker.end()
        report()
    bus.stop()
    disk.close()
    return 0


def spare_collector() -> None:
    """Makes garbage collection rare. Present objects are exempt because they live to the end; later ones have no reference cycles."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def memory_kb() -> int:
    """Resident memory of the process, kB; 0 if the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def replace_file(file: Path, content: bytes, safe: bool = False) -> None:
    """Replaces a file atomically: a reader finds the old or the new content. With `safe`, also after a power failure."""
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_suffix(".writing")
    try:
        with beside.open("wb") as stream:
            stream.write(content)
            if safe:
                stream.flush()
                os.fsync(stream.fileno())
        beside.replace(file)
    except OSError:
        # An incomplete file would take disk space that others need.
        beside.unlink(missing_ok=True)
        raise


def read_config(file: Path) -> Config:
    """Reads the configuration of a process. From then on, files of the process are accessible to their owner only."""
    os.umask(0o077)
    return configuration.read(file)
