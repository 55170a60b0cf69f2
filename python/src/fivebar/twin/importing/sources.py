"""Reads columns and their clocks from files: CSV tables with or without a head, Parquet tables, and ROS bags.

Columns of a bag are named by topic and field, such as `/joint_states/JOINT/position` or `/desired/data[0]`.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fivebar import extras, table
from fivebar.errors import FiveBarError
from fivebar.twin.record import is_of_twin, is_record, table_of
from fivebar.twin.recording import TIME, Array

BAGS: Final = (".db3", ".mcap", ".bag")
"""File extensions of bags; a bag may also be a folder."""

STAMP, RECEIVED = "stamp", "received"
"""Clocks of a bag: the stamp in a message's header, or the time at which the recorder received the message."""

LISTED: Final = 40
"""Maximum number of columns listed in a sentence."""


class MissingColumn(FiveBarError):
    """A file has no column of this name."""


@dataclass(frozen=True)
class Stream:
    """Columns with a common clock: from a table or from a topic."""

    name: str
    clock: Array
    """(n), in the unit of the clock; the origin is common to all streams of a file."""

    columns: dict[str, Array]
    """Columns by name, (n) each; NaN if there is no number."""

    units: dict[str, str]
    """Units in a table's head, by column."""

    is_dated: bool = False
    """Whether the clock of a table has dates."""


def read(file: Path, wanted: Collection[str], clock: str) -> list[Stream]:
    """Reads the columns `wanted` from a file. Raises FiveBarError with one sentence that names the file and missing columns."""
    if _is_bag(file):
        return _bag(file, wanted, clock)
    found = _table(file, wanted, clock)
    for name in (clock, *wanted):
        if name not in found.columns:
            raise MissingColumn(
                f"{file} has no column {name}; its columns are {listed([*found.columns, *found.others])}"
            )
    columns = dict(found.columns)
    return [Stream(file.name, columns.pop(clock), columns, found.units, found.is_dated)]


def names(file: Path, clock: str) -> list[str]:
    """Names of the available columns of a file."""
    if _is_bag(file):
        return sorted({name for message in _messages(file, None) for name in message.numbers})
    found = _table(file, (), clock)
    return [*found.columns, *found.others]


def _is_bag(file: Path) -> bool:
    if not file.exists():
        raise FiveBarError(f"{file}: it cannot be read: No such file or directory")
    return file.suffix.lower() in BAGS or (file / "metadata.yaml").is_file()


def _table(file: Path, wanted: Collection[str], clock: str) -> table.Table:
    if not is_record(file):
        return table.read(file, {clock, *wanted}, clock, numbered=True)
    if file.is_dir():
        raise FiveBarError(f"{file} is a folder: a table, or a bag of ROS with its metadata.yaml, is expected")
    if is_of_twin(file):
        raise FiveBarError(f"{file} is a record of `fivebar twin`, which needs no import")
    return table_of(file, {clock, *wanted}, clock)


@dataclass(frozen=True)
class _Message:
    """A message of a bag."""

    topic: str
    stamp: int | None
    """Time in its header, ns."""

    received: int
    """Time of its reception by the recorder, ns."""

    numbers: dict[str, float]
    """Numbers by column."""


def _bag(file: Path, wanted: Collection[str], clock: str) -> list[Stream]:
    if clock not in (TIME, STAMP, RECEIVED):
        raise FiveBarError(f"{file} is a bag of ROS with the clocks {STAMP} and {RECEIVED}, not {clock}")
    by_topic: dict[str, list[_Message]] = {}
    for message in _messages(file, wanted):
        if any(name in message.numbers for name in wanted):
            by_topic.setdefault(message.topic, []).append(message)
    found = {name for messages in by_topic.values() for message in messages for name in message.numbers}
    if missing := [name for name in wanted if name not in found]:
        raise MissingColumn(f"{file} has no column {missing[0]}; its columns are {listed(names(file, clock))}")
    unstamped = [topic for topic, messages in by_topic.items() if any(not message.stamp for message in messages)]
    if unstamped and clock == STAMP:
        raise FiveBarError(f"{file} has messages without a stamp in {unstamped[0]}: the clock {RECEIVED} is needed")
    # All columns must use the same clock.
    received = clock == RECEIVED or bool(unstamped)
    times = {
        topic: [message.received if received else message.stamp or 0 for message in messages]
        for topic, messages in by_topic.items()
    }
    origin = min(min(each) for each in times.values())
    return [
        Stream(
            f"{topic} by the clock {RECEIVED if received else STAMP}",
            1e-9 * np.array([time - origin for time in times[topic]], dtype=np.float64),
            {
                name: np.array([message.numbers.get(name, np.nan) for message in messages])
                for name in wanted
                if any(name in message.numbers for message in messages)
            },
            {},
        )
        for topic, messages in by_topic.items()
    ]


def _messages(file: Path, wanted: Collection[str] | None) -> Iterator[_Message]:
    """Messages of the topics that may contain the columns `wanted`; without `wanted`, the first message of each topic with numbers."""
    extras.need("ros")
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        # Bags of older ROS versions contain no type definitions.
        with AnyReader([file], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            for connection in bag.connections:
                if wanted is not None and not any(name.startswith(f"{connection.topic}/") for name in wanted):
                    continue
                if connection.msgtype not in bag.typestore.fielddefs:
                    if wanted is not None:
                        raise FiveBarError(
                            f"{file} has no definition of the type {connection.msgtype} of {connection.topic}"
                        )
                    continue
                # Logs and parameters of nodes contain no angles.
                if wanted is None and connection.msgtype.startswith("rcl_interfaces/"):
                    continue
                for _, received, content in bag.messages(connections=[connection]):
                    message = bag.deserialize(content, connection.msgtype)
                    stamp = getattr(getattr(message, "header", None), "stamp", None)
                    time = None if stamp is None else stamp.sec * 10**9 + stamp.nanosec
                    yield _Message(connection.topic, time, received, dict(_fields(connection.topic, message)))
                    if wanted is None:
                        break
    except (AnyReaderError, OSError) as error:
        raise FiveBarError(f"{file} cannot be read as a ROS bag: {str(error)[:120]}") from None


def _fields(path: str, value: Any) -> Iterator[tuple[str, float]]:
    """Numbers in a field of a message, by path. Fields of a JointState are below its joint names."""
    if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
        yield path, float(value)
    elif type(value).__name__ == "sensor_msgs__msg__JointState":
        for what in ("position", "velocity", "effort"):
            for name, number in zip(value.name, getattr(value, what), strict=False):
                yield f"{path}/{name}/{what}", float(number)
    elif is_dataclass(value):
        for each in fields(value):
            if each.name not in ("header", "layout"):
                yield from _fields(f"{path}/{each.name}", getattr(value, each.name))
    elif isinstance(value, (list, np.ndarray)):
        for place, item in enumerate(value):
            yield from _fields(f"{path}[{place}]", item)


def listed(found: list[str]) -> str:
    """A list of names for a sentence."""
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    return (", ".join(found[:LISTED]) or "none") + more
