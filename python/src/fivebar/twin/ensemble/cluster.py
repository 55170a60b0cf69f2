"""Members on Dask's workers: the unit goes to them as bytes, tasks are numbers of members, results come back in the members' order.

Tasks depend on nothing but their numbers, so what a worker has lost when it dies is done again by another one. No more than `WINDOW`
chunks for each worker are under way or waiting for their turn: memory is bounded however many members there are.
"""

import shutil
import tempfile
import threading
import weakref
from collections.abc import Hashable, Iterator
from contextlib import suppress
from typing import Any, Final, cast

import dask
import pyarrow as pa
from distributed import Client, LocalCluster, WorkerPlugin, as_completed, get_worker

from fivebar.twin.config import is_loopback
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.ensemble.rows import CHUNK, library_of, table
from fivebar.twin.errors import TwinError
from fivebar.twin.unit import Library

WINDOW: Final = 8
"""Chunks a worker may have under way or waiting to be written."""


class UnitOnWorker(WorkerPlugin):
    """The unit and a plan on a worker: extracted once, one instance for each of its threads."""

    def __init__(self, fmu: bytes, plan: Plan, name: str):
        self.fmu, self.plan, self.name = fmu, plan, name

    def setup(self, worker: Any) -> None:
        """Nothing yet: the first task makes library and runner, in its own thread."""
        self.lock, self.own = threading.Lock(), threading.local()
        self.library: Library | None = None

    def teardown(self, worker: Any) -> None:
        """Removes the extracted library."""
        if self.library is not None:
            self.library.close()

    def runner(self) -> Runner:
        """The runner of the calling thread."""
        if not hasattr(self.own, "runner"):
            with self.lock:
                if self.library is None:
                    self.library = library_of(self.fmu)
            self.own.runner = Runner(self.library, self.plan)
        runner: Runner = self.own.runner
        return runner


def chunk(name: str, first: int, count: int) -> bytes:
    """Some members on a worker, as Arrow's bytes."""
    runner = cast(UnitOnWorker, get_worker().plugins[name]).runner()
    return to_bytes(table(runner.plan, [runner.run(member) for member in range(first, first + count)]))


def to_bytes(content: pa.Table) -> bytes:
    """A table as a stream of Arrow."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, content.schema) as writer:
        writer.write_table(content)
    return sink.getvalue().to_pybytes()


def client(scheduler: str | None, workers: int) -> tuple[Client, LocalCluster | None]:
    """A client of that scheduler, or of a cluster on this machine."""
    if scheduler is None:
        # Nothing of it is reachable from outside; a worker that dies is replaced.
        scratch = tempfile.mkdtemp(prefix="fivebar-")
        # Its scheduler, which takes no folder of its own, finds it in the configuration.
        with dask.config.set({"temporary-directory": scratch}):
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=0,
                local_directory=scratch,
            )
        weakref.finalize(cluster, shutil.rmtree, scratch, ignore_errors=True)
        return Client(cluster, direct_to_workers=True), cluster
    kind, _, rest = scheduler.rpartition("://")
    host = rest.rpartition(":")[0].strip("[]") or rest
    if kind != "tls" and not is_loopback(host):
        raise TwinError(
            f"scheduler {scheduler} is not on this machine: TLS is required there (tls://HOST:PORT, certificates as docs/ensembles.md says)"
        )
    try:
        return Client(scheduler, timeout=10), None
    except (OSError, ValueError) as error:
        raise TwinError(f"scheduler {scheduler} cannot be reached: {str(error)[:100]}") from None


def tables(of: Client, fmu: bytes, plan: Plan, members: int, name: str) -> Iterator[pa.Table]:
    """The members in their order, a table for each chunk."""
    of.register_plugin(UnitOnWorker(fmu, plan, name), name=name)
    try:
        yield from _in_order(of, members, name)
    finally:
        # The scheduler forgets the plugin before it asks the workers to; a worker that dies meanwhile has nothing left to remove.
        with suppress(OSError):
            of.unregister_worker_plugin(name)


def _in_order(of: Client, members: int, name: str) -> Iterator[pa.Table]:
    chunks = -(-members // CHUNK)
    waiting: dict[int, bytes] = {}
    numbers: dict[Hashable, int] = {}
    done = as_completed()
    submitted = written = most = 0
    while written < chunks:
        if submitted % 16 == 0:
            most = WINDOW * max(1, len(of.scheduler_info(n_workers=-1)["workers"]))
        while submitted < chunks and submitted - written < most:
            first = submitted * CHUNK
            future = of.submit(
                chunk, name, first, min(CHUNK, members - first), key=f"{name}-{submitted}", pure=False, retries=3
            )
            numbers[future.key] = submitted
            done.add(future)
            submitted += 1
        finished = next(done)
        waiting[numbers.pop(finished.key)] = finished.result()
        finished.release()
        while written in waiting:
            yield pa.ipc.open_stream(waiting.pop(written)).read_all()
            written += 1
