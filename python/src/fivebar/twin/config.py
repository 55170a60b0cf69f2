"""The configuration file of a run, shared by all of its processes. The starter writes it, the processes read it."""

import ipaddress
import json
import math
import os
import re
import socket
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final, TypeVar

from fivebar import encoding
from fivebar.errors import FiveBarError
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import UNIT_NAME

LARGEST_FILE: Final = 4_000_000
"""Maximum size of a configuration, a scene or a stored state, bytes."""

SHORTEST_PERIOD: Final = 1e-4
"""Shortest sampling period, s."""

FEWEST_AHEAD: Final = 10
"""Minimum number of sampling periods in a forecast's horizon."""

T = TypeVar("T")


@dataclass(frozen=True)
class Broker:
    """Address and credentials of the broker. A broker on another machine needs user, password and TLS."""

    host: str = "127.0.0.1"
    port: int = 1883
    embedded: bool = True
    user: str = ""
    password: str = ""
    ca_file: str = ""
    """Trusted certificates for TLS: a file, or "system" for the system's certificates; "" is plain TCP."""


@dataclass(frozen=True)
class Faults:
    """Injected faults between the machine and its broker, as shares of the samples. The default is no faults."""

    lost: float = 0.0
    doubled: float = 0.0
    late: float = 0.0
    malformed: float = 0.0
    clock_jump: float = 0.0
    """Jump of the machine's clock at sample 2000, s."""


@dataclass(frozen=True)
class Machine:
    """The stand-in for the real machine: properties unknown to the twin, and the encoders."""

    hidden: dict[str, float | int | bool] = field(default_factory=dict)
    """Start values that differ from the scene, and `encoder.offset[1..2]`, rad: encoder reading minus true angle."""

    quantum: float = 2 * math.pi / 2**16
    """Resolution of the encoders, rad; 0 is exact."""

    sigma: float = 0.0
    """Standard deviation of the encoders' white noise, rad."""

    delay: float = 0.0
    """Delay between sampling and sending, s."""

    drop_outs: float = 0.0
    """Share of samples in which an encoder has no reading."""

    csv: str = ""
    """A recording to play instead of the stand-in."""

    seed: int = 1
    faults: Faults = field(default_factory=Faults)


@dataclass(frozen=True)
class Config:
    """Configuration of a run. Times in s, angles in rad."""

    folder: str
    """Folder for all files of the run."""

    fmu: str
    scene: str
    """Scene file, written by `fivebar.twin.scene.resolve`."""

    unit: str = "bench"
    """Name of the machine in topics."""

    broker: Broker = field(default_factory=Broker)
    machine: Machine = field(default_factory=Machine)
    dashboard_port: int = 0
    period: float = 0.005
    """Sampling period."""

    forecast_rate: float = 20.0
    horizon: float = 0.5
    twin: dict[str, float | int | bool] = field(default_factory=dict)
    """Start values of the twin that differ from the scene."""

    @property
    def path(self) -> Path:
        return Path(self.folder)

    @property
    def record(self) -> Path:
        """Folder of the record's parts."""
        return self.path / "record"


def write(config: Config, file: Path) -> None:
    """Writes the configuration, readable by its owner only, because it may contain a password."""
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    file.touch(mode=0o600)
    file.write_text(json.dumps(asdict(config), indent=2) + "\n", encoding="utf-8")


def read(file: Path) -> Config:
    """Reads and checks a configuration."""
    content = read_json(file)
    broker, machine = content.pop("broker", {}), content.pop("machine", {})
    faults = machine.pop("faults", {})
    config = _of(
        Config,
        content,
        file,
        broker=_of(Broker, broker, file),
        machine=_of(Machine, machine, file, faults=_of(Faults, faults, file)),
    )
    check(config)
    return config


def _of(kind: type[T], content: Any, file: Path, **parts: Any) -> T:
    if not isinstance(content, dict):
        raise TwinError(f"{file}: {kind.__name__} is {content!r:.60}, not an object")
    known = {f.name: f.type for f in fields(kind)}  # type: ignore[arg-type]  # every T is a dataclass
    if unknown := content.keys() - known.keys():
        raise TwinError(f"{file}: {min(unknown)!r} is not known; {kind.__name__} has {', '.join(known)}")
    try:
        return kind(**content, **parts)
    except TypeError as error:
        raise TwinError(f"{file}: {error}") from None


def read_json(file: Path, largest: int = LARGEST_FILE) -> dict[str, Any]:
    """Reads a JSON object from a file of limited size."""
    try:
        text = encoding.read(file, largest)
    except FiveBarError as error:
        raise TwinError(f"{file}: {error}") from None
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise TwinError(f"{file} is not JSON: {str(error)[:100]}") from None
    if not isinstance(content, dict):
        raise TwinError(f"{file} is not an object")
    return content


def check(config: Config) -> None:
    """Raises `TwinError` for settings that are out of range or unsafe."""
    if UNIT_NAME.fullmatch(config.unit) is None:
        raise TwinError(f"unit is {config.unit!r:.80}; letters, digits, - and _ are allowed, at most 64")
    for name, value, lowest, highest in (
        ("period", config.period, SHORTEST_PERIOD, 1.0),
        ("horizon", config.horizon, FEWEST_AHEAD * config.period, 10.0),
        ("forecast_rate", config.forecast_rate, 0.1, 1000.0),
    ):
        if type(value) not in (int, float) or not lowest <= value <= highest:
            raise TwinError(f"{name} is {value!r}; {lowest:g} to {highest:g} are allowed")
    check_broker(config.broker)


def check_broker(broker: Broker) -> None:
    """Raises `TwinError` for a broker beyond the loopback interface without user, password and TLS."""
    if is_loopback(broker.host):
        return
    missing = [name for name in ("user", "password", "ca_file") if not getattr(broker, name)]
    if missing:
        raise TwinError(
            f"broker {broker.host} is not on this machine: user, password and TLS (ca_file) are required there; not given: {', '.join(missing)}"
        )


def other_broker(given: str, user: str, ca_file: str) -> Broker:
    """The broker at HOST:PORT; its password is in the environment."""
    host, port = host_and_port(given)
    return Broker(host, port, False, user, os.environ.get("FIVEBAR_PASSWORD", ""), ca_file)


def is_loopback(host: str) -> bool:
    """Whether every address of a host name is on the loopback interface."""
    try:
        found = {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
    except OSError:
        # An unknown name is not this machine.
        return False
    return bool(found) and all(ipaddress.ip_address(address.split("%")[0]).is_loopback for address in found)


def host_and_port(text: str) -> tuple[str, int]:
    """Parses HOST:PORT, with [ ] around an IPv6 address."""
    found = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:\[\]]+)):(\d{1,5})", text)
    if found is None or not 0 < int(found[3]) < 65536:
        raise TwinError(f"broker is {text!r:.80}; HOST:PORT is expected, with a port from 1 to 65535")
    return found[1] or found[2], int(found[3])
