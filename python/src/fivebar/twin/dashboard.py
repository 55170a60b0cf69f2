"""The dashboard process: one page on the loopback interface, and a relay between its WebSocket and any broker.

The relay understands just enough MQTT to separate packets. A page sends `drawn N` when it has drawn the first N messages of the
frequent kinds (`SKIPPED`). Until then it gets no more of them, and then only the newest: a slow page skips messages, but is not late. Each
sample is sent together with its estimate. For skipped estimates the page gets the tip positions, so that its path has all points.

Pages of other sites must not reach the broker through the user's browser: the relay checks the names of host and origin, and the page
may load nothing from other servers.
"""

import asyncio
import contextlib
import json
import logging
import math
import ssl
from collections import deque
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, NamedTuple

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin, Subprotocol

from fivebar.borders import REACH, outline
from fivebar.colours import STYLE_SHEET
from fivebar.errors import UnitError
from fivebar.instance import Unit
from fivebar.kinematics import GEOMETRY, Machine
from fivebar.library import Library
from fivebar.twin import priority, process, scene, setup
from fivebar.twin.config import Config
from fivebar.twin.errors import Refused
from fivebar.twin.follower import LEARNED
from fivebar.twin.messages import SCHEMA_FILE, TRACKED, Message, decode
from fivebar.twin.scene import Scene
from fivebar.twin.watch import CAUSES

SCRIPT: Final = "text/javascript; charset=utf-8"
FOLDER: Final = Path(__file__).with_name("page")
FILES: Final = {
    "/": (FOLDER / "dashboard.html", "text/html; charset=utf-8"),
    "/messages.schema.json": (SCHEMA_FILE, "application/json"),
    **{f"/{name}": (FOLDER / name, SCRIPT) for name in ("dashboard.js", "mqtt.min.js")},
    "/reach.js": (REACH, SCRIPT),
    "/colours.css": (STYLE_SHEET, "text/css; charset=utf-8"),
    **{f"/json-schema/{file.name}": (file, SCRIPT) for file in sorted(FOLDER.glob("json-schema/*.js"))},
}
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data:"
)
LARGEST: Final = 1_000_000
"""Maximum size of a WebSocket frame and of an MQTT packet, bytes."""

SKIPPED: Final = ("meas", "est", "forecast")
"""Kinds of which a slow page gets only the newest message."""

KEPT: Final = 8
"""Maximum number of estimates (with their samples) and of forecasts that wait while a page draws: as many as arrive between two frames of a fast page."""

TRAIL: Final = 1.5
"""Length of the tip's path on the page, s."""

WAITING: Final = 1000
"""Maximum number of other packets that wait for a blocked page; beyond it the page is disconnected."""

PUBLISH: Final = 3
"""MQTT packet type of a message (PUBLISH)."""

log = logging.getLogger("fivebar")


def about(config: Config) -> dict[str, Any]:
    """First message to a page: names, geometry, and the end stops and contact planes."""
    content = scene.read(Path(config.scene))
    library = Library(Path(config.fmu))

    try:
        known = {**library.known.start, **content.values}
        stops = [[float(known[f"stop.{limit}[{i}]"]) for limit in ("lower", "upper")] for i in (1, 2)]
        plane = {
            "normal": [float(known["contact.nx"]), float(known["contact.ny"])],
            "offset": float(known["contact.offset"]),
        }
        return {
            "unit": config.unit,
            "scene": content.name,
            "description": content.description,
            "base": float(known["base.distance"]),
            "lengths": [float(known[f"link[{i}].length"]) for i in (1, 2, 3, 4)],
            "outline": outline(Machine.from_values({name: float(known[name]) for name in GEOMETRY})),
            "stops": stops if known["stop.enabled"] else None,
            "plane": plane if known["contact.enabled"] else None,
            "period": config.period,
            "trail": TRAIL,
            "horizon": config.horizon,
            "statuses": {
                int(item.value): item.description for item in library.variable("estimated.status").declaredType.items
            },
            "causes": CAUSES,
            "login": bool(config.broker.user),
            "learned": learned(config, content, library),
        }
    finally:
        library.close()


def learned(config: Config, content: Scene, library: Library) -> list[dict[str, Any]]:
    """Name, label and unit of each learned parameter, and its prior standard deviation."""
    values = setup.of_run(config, content, library.guid).values
    if not values.get("estimator.learn.enabled"):
        return []
    unit = Unit.of(library, "before")
    try:
        unit.reset(**values)
        seen = unit.floats((*LEARNED, *LEARNED.values()))
    except UnitError as error:
        log.warning("no panel for learned parameters: the scene's start is refused: %s", error)
        return []
    finally:
        unit.close()
    return [
        {
            "name": name,
            "sigma": sigma,
            "label": library.variable(name).description.replace(" as learned", ""),
            "unit": library.known[name].unit,
            "start": seen[name],
            "width": seen[sigma],
        }
        for name, sigma in LEARNED.items()
        if seen[sigma] > 0
    ]


class Server:
    """HTTP server for the page's files, and the relay to the broker."""

    def __init__(self, config: Config):
        self.config = config
        self.contents = {path: (file.read_bytes(), kind) for path, (file, kind) in FILES.items()}
        self.contents["/about.json"] = json.dumps(about(config)).encode(), "application/json"
        self.hosts = [f"{name}:{config.dashboard_port}" for name in ("127.0.0.1", "localhost")]
        self.origins: list[Origin | None] = [Origin(f"http://{host}") for host in self.hosts]
        self.pages = 0

    def listening(self) -> serve:
        """Starts the server, as a context manager."""
        return serve(
            self.relay,
            "127.0.0.1",
            self.config.dashboard_port,
            origins=self.origins,
            subprotocols=[Subprotocol("mqtt")],
            process_request=self.answer,
            max_size=LARGEST,
            compression=None,
        )

    def answer(self, _connection: ServerConnection, request: Request) -> Response | None:
        """Returns a file; None for a WebSocket."""
        if request.headers.get_all("Host") not in [[host] for host in self.hosts]:
            return self._response(HTTPStatus.FORBIDDEN, b"this page is for this machine only\n", "text/plain")
        if request.path == "/mqtt":
            return None
        content = self.contents.get(request.path.partition("?")[0])
        if content is None:
            return self._response(HTTPStatus.NOT_FOUND, b"there is no such page\n", "text/plain")
        return self._response(HTTPStatus.OK, *content)

    @staticmethod
    def _response(status: HTTPStatus, body: bytes, kind: str) -> Response:
        headers = Headers(
            {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Content-Security-Policy": POLICY,
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
                "Cache-Control": "no-store",
            }
        )
        return Response(status.value, status.phrase, headers, body)

    async def relay(self, page: ServerConnection) -> None:
        """Relays MQTT packets between a page and the broker, unchanged."""
        broker = self.config.broker
        context = None
        if broker.ca_file:
            context = ssl.create_default_context(cafile=None if broker.ca_file == "system" else broker.ca_file)
        try:
            reader, writer = await asyncio.open_connection(broker.host, broker.port, ssl=context)
        except OSError as error:
            log.warning("no connection to the broker: %s", error)
            return
        self.pages += 1
        pace = Pace(math.ceil(TRAIL / self.config.period))
        ways = {
            asyncio.create_task(way)
            for way in (_to_broker(page, writer, pace), _from_broker(reader, pace), _to_page(page, pace))
        }
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            writer.close()
            self.pages -= 1


class Waiting(NamedTuple):
    """Packets that are sent to a page together."""

    number: int
    """Number of the last packet in the count of all packets."""

    packets: tuple[bytes, ...]
    message: Message | None
    """The message in the last packet; None if it is invalid, which the page reports."""


class Pace:
    """Queue of a page: packets in order, but only the newest of skipped kinds. `points` is the number of points in the tip's path."""

    def __init__(self, points: int) -> None:
        self.come = asyncio.Event()
        self.others: deque[tuple[int, bytes]] = deque()
        self.newest: dict[str, deque[Waiting]] = {}
        self.points = points
        self.samples: dict[int, bytes] = {}
        """Packets of samples without an estimate so far, by sample number."""

        self.trail: deque[tuple[float, ...]] = deque(maxlen=points)
        """Times, s, and tip positions of the estimates skipped since the last ones were sent."""

        self.count = 0
        self.sent = self.drawn = 0
        """Number of messages of skipped kinds that were sent to the page, and that it has drawn."""

        self.says = False
        """Whether this page reports what it has drawn; other pages get every message."""

    def put(self, packet: bytes) -> bool:
        """Queues a packet from the broker and returns whether there was room for it."""
        self.count += 1
        subject = topic_of(packet) or b""
        kind = subject.rpartition(b"/")[2].decode("ascii", "replace")
        if kind in SKIPPED and self.says:
            self._wait(kind, subject, packet)
        else:
            self.sent += kind in SKIPPED
            self.others.append((self.count, packet))
        self.come.set()
        return len(self.others) <= WAITING

    def _wait(self, kind: str, subject: bytes, packet: bytes) -> None:
        try:
            message = decode(subject.decode("ascii", "replace"), packet[packet.index(subject) + len(subject) :])
        except Refused:
            message = None
        if kind == "meas" and message is not None:
            self.samples[message.seq] = packet
            if len(self.samples) > self.points:
                del self.samples[next(iter(self.samples))]
            return
        sample = self.samples.pop(message.seq, None) if kind == "est" and message is not None else None
        waiting = self.newest.setdefault(kind, deque())
        waiting.append(Waiting(self.count, (packet,) if sample is None else (sample, packet), message))
        if len(waiting) > KEPT and (left := waiting.popleft().message) is not None and kind == "est":
            self.trail.append((1e-9 * left.time, *(left.fields[name] for name in TRACKED)))

    def tell(self, drawn: int) -> None:
        """Records how many messages the page has drawn."""
        self.says, self.drawn = True, drawn
        self.come.set()

    async def next(self) -> tuple[list[tuple[float, ...]], bytes]:
        """Waits for packets; returns the skipped tip positions before them, and the packets."""
        while True:
            self.come.clear()
            taken = list(self.others)
            self.others.clear()
            trail: list[tuple[float, ...]] = []
            if self.drawn >= self.sent:
                held = [each for kind in self.newest.values() for each in kind]
                self.newest.clear()
                trail = list(self.trail)
                self.trail.clear()
                self.sent += sum(len(each.packets) for each in held)
                taken += [(each.number, b"".join(each.packets)) for each in held]
            if taken:
                return trail, b"".join(packet for _, packet in sorted(taken))
            await self.come.wait()


def topic_of(packet: bytes) -> bytes | None:
    """The topic of a message with QoS 0; None for any other packet."""
    if packet[0] >> 4 != PUBLISH or packet[0] & 0b110:
        return None
    begin = 2 + next(i for i, byte in enumerate(packet[1:5]) if byte < 0x80)
    return packet[begin + 2 : begin + 2 + int.from_bytes(packet[begin : begin + 2])]


async def packet_from(reader: asyncio.StreamReader) -> bytes:
    """Reads the broker's next packet: a byte, the length in one to four bytes with seven bits each, and the content."""
    head = await reader.readexactly(2)
    while head[-1] >= 0x80 and len(head) < 5:
        head += await reader.readexactly(1)
    length = sum((byte & 0x7F) << 7 * place for place, byte in enumerate(head[1:]))
    if length > LARGEST:
        raise OSError(f"a packet of {length} bytes; at most {LARGEST} are allowed")
    return head + await reader.readexactly(length)


async def _to_broker(page: ServerConnection, writer: asyncio.StreamWriter, pace: Pace) -> None:
    with contextlib.suppress(ConnectionClosed, OSError):
        async for frame in page:
            if isinstance(frame, str):
                word, _, count = frame.partition(" ")
                if word != "drawn" or not (count.isascii() and count.isdigit() and len(count) < 16):
                    return
                pace.tell(int(count))
                continue
            writer.write(frame)
            await writer.drain()


async def _from_broker(reader: asyncio.StreamReader, pace: Pace) -> None:
    with contextlib.suppress(asyncio.IncompleteReadError, OSError):
        while pace.put(await packet_from(reader)):
            pass


async def _to_page(page: ServerConnection, pace: Pace) -> None:
    with contextlib.suppress(ConnectionClosed, OSError):
        while True:
            trail, packets = await pace.next()
            if trail:
                await page.send(json.dumps(trail))
            await page.send(packets)


def run(file: Path) -> int:
    """Serves until the process is asked to stop."""
    process.set_up_log()
    quiet()
    return asyncio.run(_serve(process.read_config(file)))


def quiet() -> None:
    """Reduces the log entry of websockets about a refused page to one line without a traceback."""
    of_library = logging.getLogger("websockets")
    of_library.setLevel(logging.WARNING)
    of_library.propagate = False
    of_library.addHandler(OneLine())


class OneLine(logging.Handler):
    """Forwards a message to the log `fivebar`, with the cause of an exception appended."""

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        causes: list[str] = []
        while error is not None and len(causes) < 4:
            causes.append(" ".join(str(error).split())[:200])
            error = error.__cause__
        log.warning("%s", ": ".join([record.getMessage(), *filter(None, causes)]))


async def _serve(config: Config) -> int:
    server = Server(config)
    priority.take("dashboard")
    stop, disk = process.Stop(), process.Disk()
    status = process.Status(config, "dashboard", disk)
    async with server.listening():
        while not stop.wait(0):
            if status.due(True):
                status.write(
                    {"name": "dashboard", "ready": True, "pages": server.pages, "memory_kb": process.memory_kb()}
                )
            await asyncio.sleep(process.TICK)
    disk.close()
    return 0
