"""Members on processes of this machine.

Tasks depend on nothing but their numbers, so what a process has lost when it dies is done again by its successor.
"""

import multiprocessing
import os
import pickle
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow as pa

from fivebar.library import Library
from fivebar.twin.ensemble import rows
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.errors import TwinError

RETRIES: Final = 3
"""Times that a chunk is begun again after the process that had it has died."""

UNIT, PLAN = "unit.fmu", "plan"
"""Files that all processes read."""


class Done(NamedTuple):
    """A chunk that a process has done."""

    content: bytes
    seconds: float
    """Processor time that it took."""


class Processes:
    """So many processes of this machine; all are replaced when one dies."""

    def __init__(self, count: int):
        self.processes = count
        self.seconds = 0.0
        # What processes extract lies there as well: one that is killed leaves nothing.
        self.folder = tempfile.TemporaryDirectory(prefix="fivebar-")
        self.pool = self._pool()
        # They begin with the first task; the first that has done one is ready.
        self.pool.submit(os.getpid).result()

    def _pool(self) -> ProcessPoolExecutor:
        # Not forked: threads of Arrow would not go on in the copy.
        return ProcessPoolExecutor(self.processes, multiprocessing.get_context("spawn"), initializer=_begin)

    def submit(self, folder: str, first: int, count: int) -> "Future[Done]":
        """A chunk to whichever process is free."""
        try:
            return self.pool.submit(_chunk, folder, first, count)
        except BrokenProcessPool:
            self.pool.shutdown()
            self.pool = self._pool()
            return self.pool.submit(_chunk, folder, first, count)

    def tables(self, fmu: bytes, plan: Plan, members: int) -> Iterator[pa.Table]:
        """The members in their order, a table for each chunk."""
        folder = tempfile.mkdtemp(dir=self.folder.name)
        Path(folder, UNIT).write_bytes(fmu)
        Path(folder, PLAN).write_bytes(pickle.dumps(plan))
        return rows.in_order(lambda first, count: Chunk(self, folder, first, count), self.count, members)

    def count(self) -> int:
        """Number of processes."""
        return self.processes

    def spent(self) -> float:
        """Processor time of the chunks, s."""
        return self.seconds

    def close(self) -> None:
        """Ends the processes."""
        self.pool.shutdown(cancel_futures=True)
        self.folder.cleanup()


class Chunk:
    """A chunk under way, begun again if its process dies."""

    def __init__(self, processes: Processes, folder: str, first: int, count: int):
        self.processes, self.work = processes, (folder, first, count)
        self.future = processes.submit(*self.work)

    def result(self) -> bytes:
        """Its table as bytes of Arrow."""
        for _ in range(RETRIES + 1):
            try:
                done = self.future.result()
            except BrokenProcessPool:
                self.future = self.processes.submit(*self.work)
            else:
                self.processes.seconds += done.seconds
                return done.content
        raise TwinError(
            f"the process that ran members from {self.work[1]} on has died {RETRIES + 1} times: is there too little memory?"
        )


# --- in a process -------------------------------------------------------------------------------------------------------------------


def _begin() -> None:
    """Ctrl-C is for the parent; a process whose parent was killed ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "a process of a pool has a parent"
    parent.join()
    os._exit(1)


@cache
def _runner(folder: str) -> Runner:
    tempfile.tempdir = folder
    return Runner(Library(Path(folder, UNIT)), pickle.loads(Path(folder, PLAN).read_bytes()))


def _chunk(folder: str, first: int, count: int) -> Done:
    begun = time.process_time()
    return Done(rows.chunk(_runner(folder), first, count), time.process_time() - begun)
