"""The dashboard's server without a browser: who is let in, what a slow page gets, and colours that everybody can tell apart."""

import asyncio
import hashlib
import itertools
import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from conftest import PATIENCE
from fivebar.twin import dashboard, scene
from fivebar.twin.config import Broker, Config
from fivebar.twin.dashboard import FILES, KEPT, Pace, Server, topic_of
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.starter import free_port
from fivebar.variables import of_unit


def packet(kind: str, seq: int, qos: int = 0) -> bytes:
    """MQTT's packet with a message."""
    name = topic("bench", kind).encode()
    body = len(name).to_bytes(2) + name + (b"\0\1" if qos else b"") + encode(Message(kind, "bench", 5, seq, {}))
    return bytes([0x30 | qos << 1, len(body) & 0x7F | 0x80, len(body) >> 7]) + body


def seqs(sent: bytes) -> list[int]:
    return [int(found) for found in re.findall(rb'"seq":(\d+)', sent)]


def test_topics_of_packets() -> None:
    assert topic_of(packet("est", 1)) == b"fivebar/bench/est"
    assert topic_of(packet("alarm", 1, qos=1)) is None and topic_of(b"\xd0\x00") is None


def test_a_page_that_draws_slowly_gets_the_newest() -> None:
    """A slow page was 2.3 s behind: everything waited for it. Messages that come once, such as alarms, reach it nevertheless, and at once."""

    async def told() -> None:
        pace = Pace()
        assert pace.put(packet("est", 0))
        assert seqs(await pace.next()) == [0], "a page that does not say what it has drawn gets everything"
        pace.tell(1)
        pace.put(packet("est", 1))
        assert seqs(await pace.next()) == [1]
        for seq in range(2, 500):
            pace.put(packet("est", seq))
            pace.put(packet("meas", seq))
        pace.put(packet("alarm", 500, qos=1))
        assert seqs(await pace.next()) == [500]
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(pace.next(), 0.05)
        pace.tell(1)
        with pytest.raises(asyncio.TimeoutError):
            # Not before it has handled all of what it got.
            await asyncio.wait_for(pace.next(), 0.05)
        pace.tell(2)
        assert seqs(await pace.next()) == [seq for seq in range(500 - KEPT, 500) for _ in (0, 1)], "and in their order"

    asyncio.run(told())


@pytest.fixture
def config(tmp_path: Path, fmu: Path) -> Config:
    return Config(
        str(tmp_path),
        str(fmu),
        str(scene.resolve("pick_and_place", of_unit(fmu), tmp_path)),
        broker=Broker(port=free_port()),
        dashboard_port=free_port(),
    )


def test_a_slow_page_over_its_sockets(config: Config) -> None:
    """Through server and sockets: 3 s of samples while a page draws nothing, then it draws, and what it gets is the newest."""

    async def through() -> None:
        pages: list[asyncio.StreamWriter] = []

        async def broker(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            pages.append(writer)

        server = Server(config)
        async with await asyncio.start_server(broker, "127.0.0.1", config.broker.port), server.listening():
            address = f"ws://127.0.0.1:{config.dashboard_port}/mqtt"
            async with connect(address, origin=server.origins[0], subprotocols=["mqtt"]) as page:
                await page.send("drawn 0")
                while not pages:
                    await asyncio.sleep(0.01)
                pages[0].write(packet("est", 0))
                assert seqs(await page.recv()) == [0]
                for seq in range(1, 600):
                    pages[0].write(packet("est", seq))
                await pages[0].drain()
                pages[0].write(packet("alarm", 600, qos=1))
                assert seqs(await page.recv()) == [600]
                await page.send("drawn 1")
                assert seqs(await page.recv()) == list(range(600 - KEPT, 600))

    asyncio.run(asyncio.wait_for(through(), PATIENCE))


async def asked(port: int, *lines: str) -> bytes:
    """Answer of the server to a request of those lines."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write("\r\n".join([*lines, "", ""]).encode())
    content = await asyncio.wait_for(reader.read(), PATIENCE)
    writer.close()
    return content


def test_what_is_refused_is_one_line_in_the_log(
    config: Config, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """A page of another site, and two Host headers: both were tracebacks."""
    caplog.set_level(logging.INFO, logger="fivebar")
    dashboard.quiet()
    host = f"127.0.0.1:{config.dashboard_port}"

    async def through() -> None:
        server = Server(config)
        async with server.listening():
            with pytest.raises(InvalidStatus, match="403"):
                await connect(f"ws://{host}/mqtt", origin="http://evil.example", subprotocols=["mqtt"])
            assert (
                b"403"
                in (await asked(config.dashboard_port, "GET / HTTP/1.1", f"Host: {host}", "Host: evil.example"))[:20]
            )
            assert (
                b"403" in (await asked(config.dashboard_port, "GET / HTTP/1.1", f"Host: {host}", f"Host: {host}"))[:20]
            )
            assert b"200" in (await asked(config.dashboard_port, "GET / HTTP/1.1", f"Host: {host}"))[:20]
            await asked(config.dashboard_port, "nonsense")

    asyncio.run(through())
    lines = [record.getMessage() for record in caplog.records]
    assert any("evil.example" in line for line in lines)
    assert all("\n" not in line for line in lines) and not any(record.exc_info for record in caplog.records)
    shown = capfd.readouterr()
    assert "Traceback" not in shown.out + shown.err


def test_the_page_has_all_that_it_loads() -> None:
    """Every module of the validator, unchanged from npm (@cfworker/json-schema 4.1.1), and nothing from elsewhere."""
    page = Path(dashboard.__file__).with_name("page")
    for path, (file, _) in FILES.items():
        text = file.read_text(encoding="utf-8")
        for other in re.findall(r"""^import .* from ["'](.*)["'];""", text, re.MULTILINE):
            assert str(Path(path).parent / other) in FILES, other
    together = b"".join(file.read_bytes() for file in sorted(page.glob("json-schema/*.js")))
    assert hashlib.sha256(together).hexdigest() == "ca355def8a8edb71cc59323d07341e442009f2ad4294ffb04cb4b5b3b75b6528"


# --- colours --------------------------------------------------------------------------------------------------------------------------

SEEN = {
    "all cones": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""How linear RGB looks to those who lack a kind of cones: Machado, Oliveira and Fernandes 2009, severity 1."""


def lab(colour: str, cones: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of a colour as it is seen."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = cones @ np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )
    xyz = to_xyz @ np.clip(linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("cones", SEEN)
def test_colours_of_the_page_are_told_apart(cones: str) -> None:
    """Right leg, direct singularity and "live" were one olive to those without green cones: 15 apart, where 2 is just seen beside each other."""
    text = (Path(dashboard.__file__).with_name("page") / "dashboard.html").read_text(encoding="utf-8")
    light, dark = (
        dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block)) for block in re.findall(r":root \{(.*?)\}", text, re.DOTALL)
    )
    for colours in (light, dark):
        seen = {name: lab(colours[name], SEEN[cones]) for name in ("left", "right", "tip", "direct", "inverse", "ink")}
        for (a, one), (b, other) in itertools.combinations(seen.items(), 2):
            assert np.linalg.norm(one - other) > 20, (a, b, colours[a], colours[b])
        for state in ("good", "bad"):
            assert np.linalg.norm(lab(colours[state], SEEN[cones]) - lab(colours["warn"], SEEN[cones])) > 15, state
        assert np.linalg.norm(lab(colours["good"], SEEN[cones]) - lab(colours["bad"], SEEN[cones])) > 20


def test_the_schema_is_what_the_page_reads() -> None:
    file, kind = FILES["/messages.schema.json"]
    assert kind == "application/json" and json.loads(file.read_text(encoding="utf-8"))["definitions"]["meas"]
