"""The dashboard's server without a browser: access, messages for a slow page, and colours that everybody can distinguish."""

import asyncio
import hashlib
import itertools
import json
import logging
import re
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from browser import open_browser
from conftest import PATIENCE, wait_until
from fivebar.colours import COLOURS
from fivebar.library import Library
from fivebar.twin import dashboard, scene
from fivebar.twin.config import Broker, Config
from fivebar.twin.dashboard import FILES, KEPT, TRAIL, Pace, Server, packet_from, topic_of
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.soak import machine
from fivebar.twin.starter import free_port
from fivebar.variables import of_unit
from twin_support import follower


def packet(kind: str, seq: int, qos: int = 0, **content: Any) -> bytes:
    """An MQTT packet with a message."""
    name = topic("bench", kind).encode()
    message = encode(Message(kind, "bench", 5_000_000 * seq, seq, content.pop("fields", {}), content))
    body = len(name).to_bytes(2) + name + (b"\0\1" if qos else b"") + message
    return bytes([0x30 | qos << 1, len(body) & 0x7F | 0x80, len(body) >> 7]) + body


def seqs(sent: "bytes | tuple[list[list[float]], bytes]") -> list[int]:
    """Sequence numbers of the messages that a page receives."""
    sent = sent[1] if isinstance(sent, tuple) else sent
    return [int(found) for found in re.findall(rb'"seq":(\d+)', sent)]


def test_topics_of_packets() -> None:
    assert topic_of(packet("est", 1)) == b"fivebar/bench/est"
    assert topic_of(packet("alarm", 1, qos=1)) is None and topic_of(b"\xd0\x00") is None


def test_a_page_that_draws_slowly_gets_the_newest() -> None:
    """A slow page skips samples, so that it is never behind (it was, by 2.3 s). Messages that come once, such as alarms, still arrive at once."""

    async def scenario() -> None:
        pace = Pace(300)
        assert pace.put(packet("est", 0))
        assert seqs(await pace.next()) == [0], "a page that does not report what it has drawn receives everything"
        pace.tell(1)
        pace.put(packet("est", 1))
        assert seqs(await pace.next()) == [1]
        for seq in range(2, 500):
            pace.put(packet("meas", seq))
            pace.put(packet("est", seq))
        pace.put(packet("alarm", 500, qos=1))
        assert seqs(await pace.next()) == [500]
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(pace.next(), 0.05)
        pace.tell(1)
        with pytest.raises(asyncio.TimeoutError):
            # The page has not yet handled all messages that it received.
            await asyncio.wait_for(pace.next(), 0.05)
        pace.tell(2)
        assert seqs(await pace.next()) == [seq for seq in range(500 - KEPT, 500) for _ in (0, 1)], "in their order"

    asyncio.run(scenario())


def test_an_estimate_comes_behind_its_sample_and_the_path_has_all_points() -> None:
    """An estimate that is 20 samples late is sent after its own sample. The path has the tip of each skipped estimate, and of nothing else."""
    angles = {"measured.theta[1]": 2.0, "measured.theta[2]": 1.0}
    names = ("theta[1]", "theta[2]", "passive.theta[1]", "passive.theta[2]", "tip.x", "tip.y", "estimated.status")
    late, last = 20, 299

    async def scenario() -> None:
        pace = Pace(300)
        pace.tell(0)
        for seq in range(last + late + 1):
            pace.put(packet("meas", seq, fields=angles))
            if seq >= late:
                pace.put(
                    packet("est", seq - late, fields=dict.fromkeys(names, 0.001 * (seq - late)), after=0, inputs=[])
                )
        pace.put(packet("est", last + 1))
        trail, sent = await pace.next()
        # The newest of the eight is malformed, and the page reports it.
        kept = range(last + 2 - KEPT, last + 1)
        assert seqs(sent) == [*(seq for seq in kept for _ in "12"), last + 1]
        assert re.findall(rb"fivebar/bench/(\w+)", sent) == [*(b"meas", b"est") * len(kept), b"est"]
        assert np.array(trail) == pytest.approx(np.arange(kept[0])[:, None] * [0.005, 0.001, 0.001])
        pace.put(packet("forecast", 1))
        pace.tell(2 * len(kept) + 1)
        assert (await pace.next())[0] == []

    asyncio.run(scenario())


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
    """Through server and sockets: a page draws nothing during 3 s of samples; then it draws and receives the newest."""

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


# --- drawings -------------------------------------------------------------------------------------------------------------------------

SLOW = """
const busy = () => { const end = performance.now() + 300; while (performance.now() < end); requestAnimationFrame(busy); };
requestAnimationFrame(busy);
const pen = CanvasRenderingContext2D.prototype, { clearRect, beginPath, moveTo, lineTo, stroke } = pen;
let path = [];
window.pictures = [];
pen.clearRect = function (...given) { if (this.canvas.id === "canvas") pictures.push([]); clearRect.apply(this, given); };
pen.beginPath = function () { path = []; beginPath.call(this); };
pen.moveTo = function (x, y) { path.push([x, y]); moveTo.call(this, x, y); };
pen.lineTo = function (x, y) { path.push([x, y]); lineTo.call(this, x, y); };
pen.stroke = function () {
  if (this.canvas.id === "canvas" && pictures.length) pictures.at(-1).push([this.strokeStyle, this.lineWidth, this.getLineDash().length > 0, path]);
  stroke.call(this);
};"""
"""A page that takes 300 ms for a picture and reports its drawing."""

LAG = 8
"""Delay of the estimates, samples."""


async def driven(config: Config, pairs: list[tuple[Message, Message]], stop: asyncio.Event) -> None:
    """A minimal MQTT broker that sends samples in real time, and the estimate of each sample later."""

    async def broker(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet_from(reader)
        writer.write(b"\x20\x02\0\0")
        asked_for = await packet_from(reader)
        writer.write(b"\x90\x07" + asked_for[2:4] + bytes(5))
        begin = time.time_ns()
        for k in range(len(pairs)):
            now = begin + k * 5_000_000
            await asyncio.sleep(max(0.0, 1e-9 * (now - time.time_ns())))
            late = max(k - LAG, 0)
            for message, at in ((pairs[k][0], now), (pairs[late][1], begin + late * 5_000_000 + 1_000_000)):
                body = encode(replace(message, unit=config.unit, time=at))
                subject = topic(config.unit, message.kind).encode()
                content = len(subject).to_bytes(2) + subject + body
                writer.write(bytes([0x30, len(content) & 0x7F | 0x80, len(content) >> 7]) + content)
            await writer.drain()

    async with await asyncio.start_server(broker, "127.0.0.1", config.broker.port), Server(config).listening():
        await stop.wait()


@pytest.mark.full
def test_a_slow_page_draws_the_path_and_the_sample_of_its_estimate(config: Config, tmp_path: Path) -> None:
    """Each picture has all points of the last 1.5 s of the path, although the page received 8 of 60 estimates. The machine is drawn from
    the sample of the estimate; the newest sample would be 8 samples or 26 mm ahead."""
    library = Library(Path(config.fmu))
    source, twin = machine(config, library), follower(config, library)
    pairs = [(sample, twin.estimate()) for sample in (source.next() for _ in range(3000)) if twin.meas(sample)]
    source.close()
    twin.close()
    library.close()
    loop, stop = asyncio.new_event_loop(), asyncio.Event()
    thread = threading.Thread(target=loop.run_until_complete, args=(driven(config, pairs, stop),))
    thread.start()
    try:
        with open_browser(f"http://127.0.0.1:{config.dashboard_port}/", tmp_path) as browser:
            # Now the path has all its points.
            wait_until(lambda: float(browser.find_element("id", "clock").text) > 2)
            colours = browser.execute_script(
                f"{SLOW} const style = getComputedStyle(document.documentElement);"
                "return ['tip', 'ink', 'left'].map((name) => style.getPropertyValue('--' + name).trim())"
            )
            wait_until(lambda: browser.execute_script("return pictures.length") > 13)
            pictures = browser.execute_script("return pictures.slice(1, 14)")
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()
    tip, ink, left = colours
    apart, moved = [], []
    for picture in pictures:
        # Adjacent pieces of the path share a point.
        points = sum(
            len(path) - 1 for colour, _, dashed, path in picture if colour == tip and not dashed and len(path) > 1
        )
        assert points >= 0.98 * TRAIL / config.period, points
        [elbow] = [
            path[1]
            for colour, _, dashed, path in picture
            if colour == left and len(path) == 2 and path[0][1] > path[1][1]
        ][:1]
        [sample] = [path[1] for colour, width, dashed, path in picture if colour == ink and dashed]
        apart.append(np.hypot(*np.subtract(elbow, sample)))
        moved.append(elbow)
    assert np.ptp(moved, axis=0).max() > 30, "pixels"
    # The estimate is 1 ms later than its sample: at most 1 mm, which is a few pixels.
    assert max(apart) < 3, apart


async def asked(port: int, *lines: str) -> bytes:
    """Answer of the server to a request with the given lines."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write("\r\n".join([*lines, "", ""]).encode())
    content = await asyncio.wait_for(reader.read(), PATIENCE)
    writer.close()
    return content


def test_a_refused_connection_is_one_line_in_the_log(
    config: Config, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """A page of another site, and two Host headers, leave one line and no traceback."""
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


def test_the_server_has_every_file_that_the_page_loads() -> None:
    """The page loads no other server. The modules of the validator are unchanged from npm (@cfworker/json-schema 4.1.1)."""
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
"""Maps of linear RGB to its appearance without one kind of cones: Machado, Oliveira and Fernandes 2009, severity 1."""


def lab(colour: str, cones: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of a colour as this eye sees it."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = cones @ np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )
    xyz = to_xyz @ np.clip(linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("cones", SEEN)
def test_colours_of_the_page_are_distinguishable(cones: str) -> None:
    """Right leg, direct singularity and "live" must not look alike without green cones. A distance of 2 is just visible side by side; at least 15 is required."""
    text = (Path(dashboard.__file__).with_name("page") / "dashboard.html").read_text(encoding="utf-8")
    light, dark = (
        dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", block)) for block in re.findall(r":root \{(.*?)\}", text, re.DOTALL)
    )
    for colours in (light | COLOURS, dark | COLOURS):
        names = ("left", "right", "tip", "direct", "inverse", "combined", "ink")
        seen = {name: lab(colours[name], SEEN[cones]) for name in names}
        for (a, one), (b, other) in itertools.combinations(seen.items(), 2):
            assert np.linalg.norm(one - other) > 20, (a, b, colours[a], colours[b])
        for state in ("good", "bad"):
            assert np.linalg.norm(lab(colours[state], SEEN[cones]) - lab(colours["warn"], SEEN[cones])) > 15, state
        assert np.linalg.norm(lab(colours["good"], SEEN[cones]) - lab(colours["bad"], SEEN[cones])) > 20


def test_the_schema_is_what_the_page_reads() -> None:
    file, kind = FILES["/messages.schema.json"]
    assert kind == "application/json" and json.loads(file.read_text(encoding="utf-8"))["definitions"]["meas"]
