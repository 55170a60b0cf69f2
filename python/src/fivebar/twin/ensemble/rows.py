"""Members as rows of tables: computed in chunks in this process, or on workers and collected in order."""

import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Protocol

import pyarrow as pa

from fivebar.library import Library
from fivebar.twin.ensemble.member import KINDS, SHOWN, Plan, Runner

CHUNK: Final = 200
"""Number of members in one task, which is a row group of the results; independent of the number of workers."""

WINDOW: Final = 8
"""Maximum number of chunks per worker that are running or waiting to be written."""


def table(plan: Plan, results: list[dict[str, Any]]) -> pa.Table:
    """Members as rows of a table."""
    shown = {
        name: pa.FixedSizeListArray.from_arrays(
            pa.array([x for r in results for x in r["shown"][:, k].tolist()], pa.float32()), plan.points
        )
        for k, name in enumerate(SHOWN)
    }
    drawn = {f"drawn.{name}": pa.array([r["drawn"].get(name) for r in results], pa.float64()) for name in plan.spreads}
    return pa.table({
        "member": pa.array([r["member"] for r in results], pa.int64()),
        **drawn,
        "singular.time": pa.array([r["singular.time"] for r in results], pa.float64(), from_pandas=True),
        "singular.kind": pa.array([KINDS[r["singular.kind"]] for r in results]),
        "failed": pa.array([r["failed"] for r in results]),
        **shown,
    })  # fmt: skip


def library_of(fmu: bytes) -> Library:
    """Extracts and loads the FMU from its bytes."""
    folder = Path(tempfile.mkdtemp(prefix="fivebar-"))
    try:
        (folder / "unit.fmu").write_bytes(fmu)
        return Library(folder / "unit.fmu")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def alone(fmu: bytes, plan: Plan, members: int) -> Iterator[pa.Table]:
    """Tables of the members, computed in this process from the FMU's bytes."""
    library = library_of(fmu)
    try:
        yield from here(library, plan, members)
    finally:
        library.close()


def here(library: Library, plan: Plan, members: int) -> Iterator[pa.Table]:
    """Tables of the members, computed in this process with a loaded library."""
    runner = Runner(library, plan)
    try:
        for first in range(0, members, CHUNK):
            yield table(plan, [runner.run(member) for member in range(first, min(first + CHUNK, members))])
    finally:
        runner.close()


class Submitted(Protocol):
    """A submitted chunk."""

    def result(self) -> bytes:
        """Waits for the chunk; returns its table as Arrow bytes."""


def in_order(submit: Callable[[int, int], Submitted], workers: Callable[[], int], members: int) -> Iterator[pa.Table]:
    """Tables of the members in order; `submit` takes the first member of a chunk and the number of members.

    At most `WINDOW` chunks per worker are running or waiting, so that memory is bounded for any number of members.
    """
    under_way: deque[Submitted] = deque()
    first = written = most = 0
    while first < members or under_way:
        if written % 16 == 0:
            most = WINDOW * max(1, workers())
        while first < members and len(under_way) < most:
            under_way.append(submit(first, min(CHUNK, members - first)))
            first += CHUNK
        yield pa.ipc.open_stream(under_way.popleft().result()).read_all()
        written += 1


def chunk(runner: Runner, first: int, count: int) -> bytes:
    """Runs some members; returns their table as Arrow bytes."""
    content = table(runner.plan, [runner.run(member) for member in range(first, first + count)])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, content.schema) as writer:
        writer.write_table(content)
    return sink.getvalue().to_pybytes()
