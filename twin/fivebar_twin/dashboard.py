"""The dashboard's process: one page on the loopback interface, and the way from its WebSocket to the broker, whichever that is.

A page of another site must not reach the broker through the user's browser: the names of host and origin are checked, and the page
may load nothing from elsewhere.
"""

import argparse
import asyncio
import contextlib
import json
import logging
import ssl
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin, Subprotocol

from fivebar_twin import priority, process, scene
from fivebar_twin.config import Config
from fivebar_twin.unit import Library

SCRIPT: Final = "text/javascript; charset=utf-8"
FILES: Final = {
    "/": ("dashboard.html", "text/html; charset=utf-8"),
    "/dashboard.js": ("dashboard.js", SCRIPT),
    "/mqtt.min.js": ("mqtt.min.js", SCRIPT),
}
FOLDER: Final = Path(__file__).with_name("page")
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:"
LARGEST: Final = 1_000_000
"""Bytes of a frame."""

log = logging.getLogger("fivebar")


def about(config: Config) -> dict[str, Any]:
    """What the page has to know: names, geometry, what the tip or the links may run against."""
    content = scene.read(Path(config.scene))
    library = Library(Path(config.fmu))

    def value(name: str) -> Any:
        return content.values.get(name, library.variable(name).start)

    def switched(name: str) -> bool:
        return str(value(name)).lower() == "true"

    try:
        stops = [[float(value(f"stop.{limit}[{i}]")) for limit in ("lower", "upper")] for i in (1, 2)]
        plane = {"normal": [float(value("contact.nx")), float(value("contact.ny"))], "offset": float(value("contact.offset"))}
        return {
            "unit": config.unit,
            "scene": content.name,
            "description": content.description,
            "base": float(value("base.distance")),
            "lengths": [float(value(f"link[{i}].length")) for i in (1, 2, 3, 4)],
            "stops": stops if switched("stop.enabled") else None,
            "plane": plane if switched("contact.enabled") else None,
            "period": config.period,
            "horizon": config.horizon,
            "statuses": {int(item.value): item.description for item in library.variable("estimated.status").declaredType.items},
            "login": bool(config.broker.user),
        }
    finally:
        library.close()


class Server:
    """Files, and the way to the broker."""

    def __init__(self, config: Config):
        self.config = config
        self.contents = {path: ((FOLDER / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}
        self.contents["/about.json"] = json.dumps(about(config)).encode(), "application/json"
        self.hosts = [f"{name}:{config.dashboard_port}" for name in ("127.0.0.1", "localhost")]
        self.origins: list[Origin | None] = [Origin(f"http://{host}") for host in self.hosts]
        self.pages = 0

    def answer(self, _connection: ServerConnection, request: Request) -> Response | None:
        """A file; None for a WebSocket."""
        if request.headers.get("Host") not in self.hosts:
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
        """MQTT between a page and the broker, as it is."""
        broker = self.config.broker
        context = None
        if broker.ca_file:
            context = ssl.create_default_context(cafile=None if broker.ca_file == "system" else broker.ca_file)
        try:
            reader, writer = await asyncio.open_connection(broker.host, broker.port, ssl=context)
        except OSError as error:
            log.warning("no way to the broker: %s", error)
            return
        self.pages += 1
        ways = {asyncio.create_task(_to_broker(page, writer)), asyncio.create_task(_to_page(reader, page))}
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            writer.close()
            self.pages -= 1


async def _to_broker(page: ServerConnection, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(ConnectionClosed, OSError):
        async for frame in page:
            if isinstance(frame, str):
                return
            writer.write(frame)
            await writer.drain()


async def _to_page(reader: asyncio.StreamReader, page: ServerConnection) -> None:
    with contextlib.suppress(ConnectionClosed, OSError):
        while content := await reader.read(65536):
            await page.send(content)


def arguments(parser: argparse.ArgumentParser) -> None:
    process.arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Serves until told to stop."""
    process.set_up_log()
    return asyncio.run(_serve(process.read_config(arguments)))


async def _serve(config: Config) -> int:
    server = Server(config)
    priority.take("dashboard")
    stop, disk = process.Stop(), process.Disk()
    status = process.Status(config, "dashboard", disk)
    async with serve(
        server.relay,
        "127.0.0.1",
        config.dashboard_port,
        origins=server.origins,
        subprotocols=[Subprotocol("mqtt")],
        process_request=server.answer,
        max_size=LARGEST,
        compression=None,
    ):
        while not stop.wait(0):
            if status.due(True):
                status.write({"name": "dashboard", "ready": True, "pages": server.pages, "memory_kb": process.memory_kb()})
            await asyncio.sleep(process.TICK)
    disk.close()
    return 0
