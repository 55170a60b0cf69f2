"""Members on processes of this machine.

Tasks depend only on member numbers, so that the successor of a dead process can repeat its tasks.
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
"""Maximum number of retries of a chunk after the death of its process."""

UNIT, PLAN = "unit.fmu", "plan"
"""Names of the files that all processes read."""


class Done(NamedTuple):
    """A finished chunk."""

    content: bytes
    seconds: float
    """CPU time of the chunk, s."""


class Processes:
    """A pool of processes on this machine; if one dies, all are replaced."""

    def __init__(self, count: int):
        self.processes = count
        self.seconds = 0.0
        # Processes extract the FMU into this folder, so that killed processes leave no files behind.
        self.folder = tempfile.TemporaryDirectory(prefix="fivebar-")
        self.pool = self._pool()
        # The processes start with the first task; its result shows that the pool is ready.
        self.pool.submit(os.getpid).result()

    def _pool(self) -> ProcessPoolExecutor:
        # No fork: the threads of Arrow would not exist in the copy.
        return ProcessPoolExecutor(self.processes, multiprocessing.get_context("spawn"), initializer=_begin)

    def submit(self, folder: str, first: int, count: int) -> "Future[Done]":
        """Submits a chunk to any free process."""
        try:
            return self.pool.submit(_chunk, folder, first, count)
        except BrokenProcessPool:
            self.pool.shutdown()
            self.pool = self._pool()
            return self.pool.submit(_chunk, folder, first, count)

    def tables(self, fmu: bytes, plan: Plan, members: int) -> Iterator[pa.Table]:
        """The members in order, one table per chunk."""
        folder = tempfile.mkdtemp(dir=self.folder.name)
        Path(folder, UNIT).write_bytes(fmu)
        Path(folder, PLAN).write_bytes(pickle.dumps(plan))
        return rows.in_order(lambda first, count: Chunk(self, folder, first, count), self.count, members)

    def count(self) -> int:
        """Number of processes."""
        return self.processes

    def spent(self) -> float:
        """CPU time of all chunks, s."""
        return self.seconds

    def close(self) -> None:
        """Ends the processes."""
        # A killed process may still hold the lock of the task queue, so that the others never read a request to stop.
        for process in [*(self.pool._processes or {}).values()]:
            process.terminate()
        self.pool.shutdown(cancel_futures=True)
        self.folder.cleanup()


class Chunk:
    """A submitted chunk, which is repeated if its process dies."""

    def __init__(self, processes: Processes, folder: str, first: int, count: int):
        self.processes, self.work = processes, (folder, first, count)
        self.future = processes.submit(*self.work)

    def result(self) -> bytes:
        """Waits for the chunk; returns its table as Arrow bytes."""
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
    """Starts a process of the pool, which ignores Ctrl-C (meant for the parent) and ends if the parent is killed."""
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
