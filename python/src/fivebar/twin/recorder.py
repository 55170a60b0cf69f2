"""The recorder process: writes all published messages to Parquet, in parts that survive a crash of the process."""

import logging
import time
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import pyarrow as pa
import pyarrow.parquet as pq

from fivebar.twin import process, record, scene, setup
from fivebar.twin.config import Config
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import KINDS, Message, encode, topic
from fivebar.twin.process import Worker
from fivebar.twin.record import Row

FLUSH_EVERY: Final = 0.4
"""Time between two parts, s. SIGKILL loses at most the messages of this time and of the last write."""

MOST_WAITING: Final = 20_000
"""Maximum number of rows that wait for the disk; further ones are lost and reported."""

JOINED: Final = 64
"""Number of parts that are joined into one."""

PATIENCE: Final = 1.0
"""Time after which a missing number is reported, s; it may arrive late."""

log = logging.getLogger("fivebar")


class Gaps:
    """Missing numbers of a kind, reported after `PATIENCE`."""

    def __init__(self, kind: str):
        self.kind, self.newest = kind, -1
        self.waiting: list[tuple[float, int, int, set[int]]] = []

    def see(self, seq: int, now: float) -> None:
        if self.newest >= 0 and self.newest + 1 < seq < self.newest + 1_000_000:
            self.waiting = [*self.waiting[-99:], (now + PATIENCE, self.newest + 1, seq - 1, set())]
        for _, first, last, came in self.waiting:
            if first <= seq <= last:
                came.add(seq)
        # A machine that restarts its count begins a new series.
        self.newest = seq if seq > self.newest or seq < self.newest - 1000 else self.newest

    def due(self, now: float) -> list[tuple[int, int]]:
        """First and last number of each gap that has waited for `PATIENCE`."""
        ranges: list[tuple[int, int]] = []
        for when, first, last, came in self.waiting:
            if when <= now:
                edges = [first - 1, *sorted(came), last + 1]
                ranges += [(a + 1, b - 1) for a, b in pairwise(edges) if b - a > 1]
        self.waiting = [each for each in self.waiting if each[0] > now]
        return ranges


class Recorder(Worker):
    """The worker."""

    name = "record"
    kinds = tuple(kind for kind in KINDS if kind not in ("ahead", "gap", "setup"))

    def __init__(self, config: Config):
        super().__init__(config)
        self.folder = config.record
        self.rows: list[Row] = []
        self.taken: list[Row] = []
        """Rows to write next."""
        self.flushed = time.monotonic()
        self.number = 0
        self.parts: list[tuple[int, int, Path]] = []
        self.gaps = {kind: Gaps(kind) for kind in ("meas", "est")}
        self.counts = dict.fromkeys(("recorded", "written", "gaps", "overrun"), 0)
        self.about: Message | None = None
        self.failing, self.failed, self.why = False, 0.0, ""
        """Whether writing fails, time of the last attempt, s, and its error."""
        self.lost: dict[str, tuple[int, int]] = {}
        """First and last number of the messages of each kind lost because too many rows were waiting."""
        self.now = 0

    def begin(self) -> None:
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = [m for path in self.folder.iterdir() if (m := record.PART.fullmatch(path.name))]
        self.number = 1 + max((int(m[2]) for m in found), default=-1)
        if self.about is not None:
            self._row(self.about)
        if self.number:
            log.info("resuming with part %d", self.number)

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        if len(self.rows) + len(self.taken) >= MOST_WAITING:
            self.counts["overrun"] += 1
            first, _ = self.lost.get(message.kind, (message.seq, 0))
            self.lost[message.kind] = first, message.seq
            if not self.failing and self.counts["overrun"] == 1:
                self.trouble("record", "the disk is too slow: messages are not recorded", now)
            return
        self.rows.append(Row(topic(message.unit, message.kind), message.time, message.seq, payload))
        self.counts["recorded"] += 1
        if message.kind in self.gaps:
            self.gaps[message.kind].see(message.seq, 1e-9 * now)

    def _row(self, message: Message) -> None:
        """Appends a message of the recorder itself."""
        self.rows.append(Row(topic(self.config.unit, message.kind), message.time, message.seq, encode(message)))

    def tick(self, now: int) -> None:
        for kind, gaps in self.gaps.items():
            for first, last in gaps.due(1e-9 * now):
                log.warning("%s %d to %d are missing", kind, first, last)
                self.counts["gaps"] += 1
                fields = {"first": float(first), "last": float(last)}
                begin, end = self.lost.get(kind, (1, 0))
                why = {"why": self.why} if max(begin, first) <= min(end, last) else {}
                self._row(Message("gap", self.config.unit, now, self.counts["gaps"], fields, {"of": kind} | why))
        self.now = now
        if time.monotonic() - self.flushed >= FLUSH_EVERY:
            self._take()

    def _take(self) -> None:
        """Makes the rows so far the next part."""
        self.flushed = time.monotonic()
        self.taken, self.rows = [*self.taken, *self.rows], []

    def write(self) -> None:
        """Writes the waiting rows as a part; after a failure they are written with the next ones."""
        rows = self.taken
        if not rows or (self.failing and time.monotonic() - self.failed < FLUSH_EVERY):
            return
        try:
            path = record.write_part(self.folder, self.number, self.number, rows)
        except (OSError, pa.ArrowException) as error:
            self.failed = time.monotonic()
            if not self.failing:
                self.lost = {}
                self.failing, self.why = True, (getattr(error, "strerror", None) or str(error))[:60]
                self.trouble("record", f"nothing is recorded, {self.why}: {self.folder}", self.now)
            return
        self.taken = []
        if self.failing:
            self.failing = False
            lost = ", ".join(f"{kind} {first} to {last}" for kind, (first, last) in self.lost.items())
            self.trouble(
                "record", f"recording again; {f'not recorded are {lost}' if lost else 'nothing is lost'}", self.now
            )
        self.parts.append((self.number, self.number, path))
        self.number += 1
        self.counts["written"] += len(rows)
        if len(self.parts) % JOINED == 0:
            self._join()

    def _join(self) -> None:
        """Joins many parts into one and deletes them once it is on the disk."""
        table = pa.concat_tables([pq.read_table(path, schema=record.SCHEMA) for _, _, path in self.parts])
        try:
            record.write_table(self.folder, self.parts[0][0], self.parts[-1][1], table)
        except OSError:
            # The disk may have no space for a copy of the parts.
            return
        for _, _, path in self.parts:
            path.unlink(missing_ok=True)
        self.parts = []
        # Returns the memory of the join to the system.
        del table
        pa.default_memory_pool().release_unused()

    def status(self) -> dict[str, Any]:
        return dict(self.counts)

    def end(self) -> None:
        self._take()
        self.failed = 0.0
        self.write()
        if self.taken:
            self.trouble(
                "record", f"{len(self.taken)} messages at the end are not recorded, {self.why}: {self.folder}", self.now
            )


def guid(fmu: Path) -> str:
    """GUID of the FMU, read without FMPy because its import would delay the first part."""
    try:
        with zipfile.ZipFile(fmu) as archive, archive.open("modelDescription.xml") as stream:
            return str(next(ElementTree.iterparse(stream, events=["start"]))[1].attrib["guid"])
    except (OSError, KeyError, zipfile.BadZipFile, ElementTree.ParseError) as error:
        raise TwinError(f"{fmu} is not an .fmu: {error}") from None


def run(file: Path) -> int:
    config = process.read_config(file)
    recorder = Recorder(config)
    recorder.about = setup.of_run(config, scene.read(Path(config.scene)), guid(Path(config.fmu))).to_message(
        config.unit, time.time_ns()
    )
    return process.serve(recorder)
