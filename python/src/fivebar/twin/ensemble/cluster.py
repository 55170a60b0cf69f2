"""Members on the user's Dask cluster: the FMU goes to the workers as bytes, tasks are ranges of member numbers.

Tasks depend only on these numbers, so that another worker can repeat the tasks of a dead one.
"""

import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, cast

import pyarrow as pa
from distributed import Client, WorkerPlugin, get_worker

from fivebar.library import Library
from fivebar.twin.config import is_loopback
from fivebar.twin.ensemble import rows
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.errors import TwinError


class UnitOnWorker(WorkerPlugin):
    """The FMU and a plan on a worker: the FMU is extracted once, and each thread has its own instance."""

    def __init__(self, fmu: bytes, plan: Plan, name: str):
        self.fmu, self.plan, self.name = fmu, plan, name

    def setup(self, worker: Any) -> None:
        """Does nothing: the first task creates library and runner in its own thread."""
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
                    self.library = rows.library_of(self.fmu)
            self.own.runner = Runner(self.library, self.plan)
        runner: Runner = self.own.runner
        return runner


def chunk(name: str, first: int, count: int) -> bytes:
    """Runs some members on a worker."""
    return rows.chunk(cast(UnitOnWorker, get_worker().plugins[name]).runner(), first, count)


class Cluster:
    """The workers of a scheduler."""

    def __init__(self, scheduler: str):
        kind, _, rest = scheduler.rpartition("://")
        host = rest.rpartition(":")[0].strip("[]") or rest
        if kind != "tls" and not is_loopback(host):
            raise TwinError(
                f"scheduler {scheduler} is not on this machine: TLS is required there (tls://HOST:PORT, certificates as docs/ensembles.md says)"
            )
        try:
            self.client = Client(scheduler, timeout=10)
        except (OSError, ValueError) as error:
            raise TwinError(f"scheduler {scheduler} cannot be reached: {str(error)[:100]}") from None
        try:
            self.client.wait_for_workers(1, timeout=60)
        except TimeoutError:
            self.close()
            raise TwinError(f"scheduler {scheduler} has had no worker for 60 s") from None
        self.before: dict[str, float] = self.client.run(time.process_time)

    def tables(self, fmu: bytes, plan: Plan, members: int) -> Iterator[pa.Table]:
        """The members in order, one table per chunk."""
        name = f"ensemble-{uuid.uuid4().hex[:12]}"
        self.client.register_plugin(UnitOnWorker(fmu, plan, name), name=name)

        def submit(first: int, count: int) -> rows.Submitted:
            future: rows.Submitted = self.client.submit(
                chunk, name, first, count, key=f"{name}-{first}", pure=False, retries=3
            )
            return future

        try:
            yield from rows.in_order(submit, self.count, members)
        finally:
            # The scheduler removes the plugin before the workers do; if a worker dies in between, there is nothing left to remove.
            with suppress(OSError):
                self.client.unregister_worker_plugin(name)

    def count(self) -> int:
        """Present number of workers."""
        return len(self.client.scheduler_info(n_workers=-1)["workers"])

    def spent(self) -> float:
        """CPU time of the workers since the begin, s. A worker that joined later starts with 0."""
        after: dict[str, float] = self.client.run(time.process_time)
        return sum(seconds - self.before.get(address, 0.0) for address, seconds in after.items())

    def close(self) -> None:
        """Disconnects from the scheduler."""
        self.client.close()
