"""Members as rows of tables, and as many as one likes in this process."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from fivebar.twin.ensemble.member import KINDS, SHOWN, Plan, Runner
from fivebar.twin.unit import Library

CHUNK: Final = 200
"""Members in one task: a row group of the results, whatever the number of workers."""


def table(plan: Plan, results: list[dict[str, Any]]) -> pa.Table:
    """Members as rows."""
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
    """The unit of those bytes, extracted."""
    folder = Path(tempfile.mkdtemp(prefix="fivebar-"))
    try:
        (folder / "unit.fmu").write_bytes(fmu)
        return Library(folder / "unit.fmu")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def alone(fmu: bytes, plan: Plan, members: int) -> Iterator[pa.Table]:
    """Tables of the members, computed in this process without Dask."""
    library = library_of(fmu)
    try:
        yield from here(library, plan, members)
    finally:
        library.close()


def here(library: Library, plan: Plan, members: int) -> Iterator[pa.Table]:
    """Tables of the members by a unit that is extracted."""
    runner = Runner(library, plan)
    try:
        for first in range(0, members, CHUNK):
            yield table(plan, [runner.run(member) for member in range(first, min(first + CHUNK, members))])
    finally:
        runner.close()
