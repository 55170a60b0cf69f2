"""examples/serial_bridge.py with a simulated board on a pseudo-terminal: noise, overflows, a reset, lost lines, commands."""

import importlib
import json
import math
import os
import random
import re
import select
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest

from conftest import PATIENCE, REPOSITORY, wait_until
from fivebar.twin import config as configuration
from fivebar.twin.config import Broker, Config
from fivebar.twin.importing import maps
from fivebar.twin.intake import Intake
from fivebar.twin.messages import Message, decode
from fivebar.twin.starter import free_port

EXAMPLE = REPOSITORY / "examples" / "serial_bridge.py"
STEPS = 4 * 500 * 20
STOPS = (math.radians(170), math.radians(10))
SIGNS = (-1, 1)


@pytest.fixture
def bridge(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    return importlib.import_module("serial_bridge")


def line(seq: int, micros: int, counts: tuple[int, int]) -> bytes:
    """A line of the board, with counters of 16 and 32 bits."""
    text = b"%d %d %d %d" % (seq % 2**16, micros % 2**32, *(count % 2**16 for count in counts))
    check = 0
    for byte in text:
        check ^= byte
    return text + b"*%02X\n" % check


class Board:
    """Samples every 5 ms of the board's clock, which soon overflows, and the true values."""

    def __init__(self) -> None:
        self.seq, self.micros, self.phase = 0, 2**32 - 700_000, 0

    def next(self) -> tuple[bytes, int, tuple[float, float]]:
        """Returns a line, the board's time without overflows, and the angles, rad."""
        # Up to ±40,000 counts: more than 16 bits, in increments that a 16-bit counter can follow.
        turns = (-math.sin(0.05 * self.phase), 1 - math.cos(0.03 * self.phase))
        counts = (round(40_000 * turns[0]), round(20_000 * turns[1]))
        found = line(self.seq, self.micros, counts)
        angles = [
            stop + sign * count * 2 * math.pi / STEPS for stop, sign, count in zip(STOPS, SIGNS, counts, strict=True)
        ]
        self.seq, self.phase, at = self.seq + 1, self.phase + 1, self.micros
        self.micros += 5_000
        return found, at, (angles[0], angles[1])

    def reset(self) -> None:
        """Restarts at the stops with another clock."""
        self.seq, self.micros, self.phase = 0, 900_000, 0


def admitted(intake: Intake, message: dict[str, Any], now: int) -> str:
    """Whether the twin accepts a message that arrives now."""
    return intake.admit(decode("fivebar/bench/meas", json.dumps(message).encode()), now)


def test_overflows_noise_and_lost_lines_change_no_value(bridge: Any) -> None:
    """Samples have the board's times and counts, however late the lines arrive; a damaged line is skipped. The twin accepts every sample."""
    board, found, chance, intake = Board(), bridge.Bridge(), random.Random(1), Intake(Config.period)
    first = board.micros
    left_out = begin = 0
    for k in range(2000):
        text, micros, angles = board.next()
        now = 10**18 + 1000 * (micros - first) + chance.randrange(30_000_000)
        begin = now if k == 0 else begin
        kind = chance.random() if k else 1.0
        if kind < 0.05:
            continue
        if kind < 0.1:
            place = chance.randrange(len(text) - 1)
            noisy = text[:place] + bytes([text[place] ^ chance.randrange(1, 256)]) + text[place + 1 :]
            assert found.sample(noisy, now) is None
            left_out += 1
            continue
        message = found.sample(text, now)
        assert admitted(intake, message, now) == ("new" if k else "series")
        assert message["seq"] == k and message["time"] == begin + 1000 * (micros - first)
        fields = message["fields"]
        assert (fields["measured.theta[1]"], fields["measured.theta[2]"]) == pytest.approx(angles, abs=1e-12)
    assert left_out > 50 and board.micros > 2**32


@pytest.mark.parametrize("samples", [3, 400, 40_000])
def test_a_board_that_restarts_continues_the_count(bridge: Any, samples: int) -> None:
    """After 15 ms the board's clock is ahead and its count behind; after 200 s the reverse, modulo 16 bits."""
    board, found, intake = Board(), bridge.Bridge(), Intake(Config.period)
    board.micros = 0
    for _ in range(samples):
        text, micros, _ = board.next()
        last = found.sample(text, 10**18 + 1000 * micros)
    admitted(intake, last, last["time"])
    board.reset()
    text, _, angles = board.next()
    now = 10**18 + 1000 * micros + 10**9
    message = found.sample(text, now)
    assert message["seq"] == last["seq"] + 1 and message["time"] == now and admitted(intake, message, now) == "new"
    assert message["fields"]["measured.theta[1]"] == pytest.approx(angles[0], abs=1e-12)


@pytest.mark.parametrize("text", [b"", b"\n", b"*00\n", b"ready\n", b"1 2 3*30\n", b"\xff\xfe*01\n", b"00"])
def test_malformed_lines_are_skipped(bridge: Any, text: bytes) -> None:
    assert bridge.Bridge().sample(text, 10**18) is None


def test_the_page_has_the_figures_of_the_example(bridge: Any) -> None:
    """The code on the page prints the stated output, its map is valid, and both use the axes of the example."""
    page = (REPOSITORY / "docs" / "hardware.md").read_text(encoding="utf-8")
    [code] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert code.rstrip().endswith("# " + done.stdout.rstrip())
    [text] = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    entries = maps.parse(json.loads(text)).entries
    for name, axis in bridge.AXES.items():
        entry = entries[f"measured.{name}"]
        assert (entry.steps, entry.sign, entry.offset) == (axis.steps, axis.sign, axis.stop)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    port = free_port()
    configuration.write(Config(str(tmp_path), "", "", broker=Broker(port=port)), tmp_path / "twin.json")
    command = [sys.executable, "-m", "fivebar.twin", "broker", "--config", str(tmp_path / "twin.json")]
    process = subprocess.Popen(command)
    yield port
    process.terminate()
    process.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
def test_a_board_at_a_pseudo_terminal(broker: int) -> None:
    """A command reaches the board; then each valid line arrives once, in order, with the board's times. The test does not wait for a clock."""
    got: list[Message] = []
    subscribed = threading.Event()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_subscribe = lambda *_: subscribed.set()
    client.on_message = lambda _client, _data, message: got.append(decode(message.topic, message.payload))

    def answers() -> bool:
        try:
            return client.connect("127.0.0.1", broker) == mqtt.MQTT_ERR_SUCCESS
        except OSError:
            return False

    wait_until(answers)
    client.subscribe("fivebar/bench/meas")
    client.loop_start()
    assert subscribed.wait(PATIENCE)
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    command = [sys.executable, str(EXAMPLE), os.ttyname(theirs), "127.0.0.1", str(broker)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        # Unreadable commands are dropped. Commands repeat until the program has opened its port and subscribed.
        angles = {"servo.theta[1]": STOPS[0] - 0.5, "servo.theta[2]": STOPS[1] + 0.25}
        text = b"%d %d*" % tuple(round(angle * STEPS / (2 * math.pi)) for angle in (0.5, 0.25))
        heard = b""

        def obeyed() -> bool:
            nonlocal heard
            assert process.poll() is None, process.communicate()[1]
            client.publish("bench/command", b"{")
            client.publish("bench/command", json.dumps(angles))
            while select.select([ours], [], [], 0)[0]:
                heard += os.read(ours, 1000)
            return text in heard

        wait_until(obeyed)
        board, expected = Board(), []
        for k in range(300):
            line, micros, truth = board.next()
            if k % 7 == 3:
                # Noise: half a line, and bytes that are not text.
                line = line[: len(line) // 2] + b"\x00\xff\n"
            elif k % 11 == 5:
                continue
            else:
                expected.append((k, micros, truth))
            os.write(ours, line)
        wait_until(lambda: len(got) >= len(expected))
        assert [message.seq for message in got] == [k for k, _, _ in expected]
        assert [message.time - got[0].time for message in got] == [
            1000 * (at - expected[0][1]) for _, at, _ in expected
        ]
        for message, (_, _, truth) in zip(got, expected, strict=True):
            measured = [message.fields[f"measured.theta[{i}]"] for i in (1, 2)]
            assert measured == pytest.approx(truth, abs=1e-12)
            assert {name: message.fields[name] for name in angles} == angles
    finally:
        process.terminate()
        process.communicate()
        client.disconnect()
        client.loop_stop()
        os.close(ours)
        os.close(theirs)
