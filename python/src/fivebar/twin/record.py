"""Records: Parquet with the columns topic, time, seq, payload, one file or a folder of parts. Written by the recorder, read by many.

A part is written under a temporary name, flushed to disk and renamed, so that a part with its final name is complete.
`part-FIRST-LAST.parquet` contains the messages of flushes FIRST to LAST. A joined part replaces its parts, whether or not they are deleted.
"""

import os
import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fivebar import table
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.messages import Message, decode

TYPES: Final[dict[str, pa.DataType]] = {
    "topic": pa.string(),
    "time": pa.int64(),
    "seq": pa.int64(),
    "payload": pa.binary(),
}
SCHEMA: Final = pa.schema(TYPES)
PART: Final = re.compile(r"part-(\d{8})-(\d{8})\.parquet")
MAGIC: Final = b"PAR1"
"""First bytes of a Parquet file."""

LARGEST_RECORD: Final = 64_000_000_000
"""Maximum size of a record, bytes."""

COLUMNS: Final = {
    "topic": (pa.types.is_string, pa.types.is_large_string),
    "time": (pa.types.is_integer,),
    "seq": (pa.types.is_integer,),
} | {"payload": (pa.types.is_binary, pa.types.is_large_binary, pa.types.is_string, pa.types.is_large_string)}
"""Allowed Arrow types of each column."""


class Row(NamedTuple):
    """A message as it was received."""

    topic: str
    time: int
    seq: int
    payload: bytes


def write_part(folder: Path, first: int, last: int, rows: list[Row]) -> Path:
    """Writes a part; once it has its name, it is complete and on the disk."""
    columns = zip(*rows, strict=True) if rows else ((), (), (), ())
    return write_table(folder, first, last, pa.table([list(column) for column in columns], schema=SCHEMA))


def write_table(folder: Path, first: int, last: int, content: pa.Table) -> Path:
    """Writes a table as a part."""
    path = folder / f"part-{first:08d}-{last:08d}.parquet"
    beside = path.with_suffix(".writing")
    try:
        with beside.open("wb") as stream:
            pq.write_table(content, stream, compression="zstd")
            stream.flush()
            os.fsync(stream.fileno())
        beside.rename(path)
    except OSError:
        # An incomplete part would take disk space that the next one needs.
        beside.unlink(missing_ok=True)
        raise
    return path


def is_record(file: Path) -> bool:
    """Whether a file or folder is a record or a table in Parquet, not a text."""
    if file.is_dir() or file.suffix.lower() == ".parquet":
        return True
    try:
        with file.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def is_of_twin(file: Path) -> bool:
    """Whether a file or folder is a record of `fivebar twin`, not a table of numbers in Parquet."""
    if file.is_dir():
        return any(PART.fullmatch(path.name) for path in file.iterdir())
    return is_record(file) and set(SCHEMA.names) <= set(_file(file).schema_arrow.names)


def table_of(file: Path, wanted: Collection[str], counted: str) -> table.Table:
    """Reads columns of a table of numbers in Parquet, as `table.read` does from CSV, with units in brackets or parentheses after the names too.

    Columns of dates and durations have the unit ns.
    """
    schema = _file(file).schema_arrow
    heads: dict[str, tuple[str, str]] = {}
    for column, (name, unit) in zip(schema.names, table.heads(schema.names, {*wanted, counted}), strict=True):
        if name in heads:
            raise TwinError(f"{file} has two columns {name:.60}; each name must be unique")
        heads[name] = column, unit
    used = [name for name in heads if name in wanted or name == counted]
    try:
        content = pq.read_table(file, columns=[heads[name][0] for name in used])
    except (OSError, pa.ArrowException) as error:
        raise TwinError(f"{file} cannot be read to its end: {str(error)[:120]}") from None
    columns, units = {}, {name: heads[name][1] for name in used if heads[name][1]}
    for name in used:
        found = content[heads[name][0]]
        columns[name] = _numbers(file, name, found, name == counted)
        if _is_timed(found.type):
            units[name] = "ns"
    is_dated = counted in used and pa.types.is_timestamp(schema.field(heads[counted][0]).type)
    return table.Table(columns, units, [name for name in heads if name not in columns], is_dated)


def _is_timed(kind: pa.DataType) -> bool:
    """Whether a column has dates or durations."""
    return pa.types.is_timestamp(kind) or pa.types.is_duration(kind)


def _numbers(file: Path, name: str, column: "pa.ChunkedArray[Any]", counted: bool) -> np.ndarray:
    """A column as floats; a clock is counted from its first reading before the conversion, so that it keeps its precision."""
    kind = column.type
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if not (_is_timed(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise TwinError(f"{file}: {name} has the type {kind}, but numbers are expected")
    try:
        if _is_timed(kind):
            in_ns = pa.timestamp("ns") if pa.types.is_timestamp(kind) else pa.duration("ns")
            column = column.cast(in_ns).cast(pa.int64())
        elif counted and pa.types.is_integer(kind):
            column = column.cast(pa.int64())
    except pa.ArrowException:
        limits = "dates from 1678 to 2262" if _is_timed(kind) else "numbers below 2^63"
        raise TwinError(
            f"{file}: {name} of the type {kind} has values that are too large: {limits} are allowed"
        ) from None
    known = np.asarray(column.is_valid())
    origin = column[int(np.argmax(known))].as_py() if counted and known.any() else 0
    found = np.full(len(known), np.nan)
    found[known] = np.asarray(column.drop_null()) - origin
    found[~np.isfinite(found)] = np.nan
    return found


def parts(record: Path) -> list[Path]:
    """The files of a record in order: the file itself, or the parts in the folder that no joined part replaces."""
    if record.is_file():
        return [record]
    if not record.is_dir():
        raise TwinError(f"there is no record at {record}: a Parquet file or a folder of parts is expected")
    found = sorted((int(m[1]), -int(m[2]), path) for path in record.iterdir() if (m := PART.fullmatch(path.name)))
    kept, reached = [], -1
    for _, minus_last, path in found:
        if -minus_last > reached:
            kept.append(path)
            reached = -minus_last
    if not kept:
        raise TwinError(f"{record} has no part-*.parquet")
    if sum(path.stat().st_size for path in kept) > LARGEST_RECORD:
        raise TwinError(f"{record} has more than {LARGEST_RECORD} bytes")
    return kept


def setup(record: Path) -> Message:
    """The message `setup` about the recorded run, which the recorder writes first."""
    for message in messages(record, "setup", refused=lambda _: None):
        return message
    raise TwinError(f"{record} does not describe its run: it has no message `setup`")


def rows(record: Path) -> Iterator[Row]:
    """Iterates over all rows in order of arrival, with some thousands in memory at a time."""
    for path in parts(record):
        file = _file(path)
        missing = [name for name in SCHEMA.names if name not in file.schema_arrow.names]
        if missing:
            raise TwinError(f"{path} has no column {', '.join(missing)}; a record has topic, time, seq, payload")
        for name, allowed in COLUMNS.items():
            found = file.schema_arrow.field(name).type
            if not any(is_one(found) for is_one in allowed):
                raise TwinError(f"{path} has {found} in the column {name}, not {SCHEMA.field(name).type}")
        try:
            for batch in file.iter_batches(batch_size=4096, columns=SCHEMA.names):
                for topic, time, seq, payload in zip(*(column.to_pylist() for column in batch.columns), strict=True):
                    # A missing payload becomes an empty message, which `decode` refuses.
                    payload = payload.encode() if isinstance(payload, str) else payload or b""
                    yield Row(topic or "", time or 0, seq or 0, payload)
        except (OSError, pa.ArrowException) as error:
            raise TwinError(f"{path} cannot be read to its end: {str(error)[:120]}") from None


def messages(record: Path, *kinds: str, refused: Callable[[str], None]) -> Iterator[Message]:
    """Iterates over the messages of some kinds (default: all) in order of arrival. For each invalid row, `refused` gets a sentence."""
    for row in rows(record):
        if kinds and row.topic.rpartition("/")[2] not in kinds:
            continue
        try:
            message = decode(row.topic, row.payload)
        except Refused as error:
            refused(str(error))
            continue
        yield message


def _file(path: Path) -> pq.ParquetFile:
    if not path.exists():
        raise TwinError(f"there is no record at {path}: a Parquet file or a folder of parts is expected")
    try:
        return pq.ParquetFile(path)
    except (OSError, pa.ArrowException) as error:
        raise TwinError(f"{path} is not a Parquet file: {str(error)[:120]}") from None
