"""`fivebar load`: measures how many machines with 200 samples per second a broker can serve; see docs/notes/growth.md."""

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import paho.mqtt.client as mqtt
import psutil
from paho.mqtt.enums import CallbackAPIVersion

from fivebar.twin import config as configuration
from fivebar.twin.config import Broker, Config
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.starter import free_port

RATE: Final = 200.0
LIMIT: Final = 5e-3
"""Maximum latency (p99) at which a number of machines counts as served, s."""

FIELDS: Final = {
    f"{name}[{i}]": 1.2345678901234567 for name in ("measured.theta", "servo.theta", "servo.omega") for i in (1, 2)
}


def run(at: str | None, seconds: float, most: int) -> int:
    """Runs the measurement; returns 0 if the broker serves at least one machine."""
    with tempfile.TemporaryDirectory() as folder:
        if at is not None:
            host, port = configuration.host_and_port(at)
            configuration.check_broker(Broker(host, port, False))
            return _rise(host, port, _listening(port) if configuration.is_loopback(host) else None, seconds, most)
        port = free_port()
        config = replace(Config(folder, "", ""), broker=Broker("127.0.0.1", port, True))
        configuration.write(config, Path(folder) / "twin.json")
        broker = subprocess.Popen(
            [sys.executable, "-m", "fivebar.twin", "broker", "--config", str(Path(folder) / "twin.json")]
        )
        try:
            return _rise("127.0.0.1", port, psutil.Process(broker.pid), seconds, most)
        finally:
            broker.terminate()
            broker.wait(10)


def _rise(host: str, port: int, broker: psutil.Process | None, seconds: float, most: int) -> int:
    carried, machines = 0, 1
    print(
        f"{'machines':>9} {'messages/s':>11} {'lost':>6} {'p50 ms':>8} {'p99 ms':>8} {'µs of the broker a message':>27}"
    )
    while machines <= most:
        before = _cpu(broker)
        sent, latencies = _measure(host, port, machines, seconds)
        if not len(latencies):
            raise TwinError(f"no message came back from the broker at {host}:{port}")
        p50, p99 = (float(np.quantile(latencies, level)) for level in (0.5, 0.99))
        own = f"{1e6 * (_cpu(broker) - before) / sent:27.0f}" if broker else f"{'-':>27}"
        print(
            f"{machines:9} {sent / seconds:11.0f} {sent - len(latencies):6} {1e3 * p50:8.2f} {1e3 * p99:8.2f} {own}",
            flush=True,
        )
        if len(latencies) < sent:
            break
        carried = machines if p99 <= LIMIT else carried
        machines *= 2
    print(f"carried with p99 below {1e3 * LIMIT:g} ms: {carried} machines")
    return 0 if carried else 1


def _listening(port: int) -> psutil.Process | None:
    """The local process that listens on a port; None if the system does not report it."""
    try:
        found = [
            c.pid
            for c in psutil.net_connections("tcp")
            if c.status == psutil.CONN_LISTEN and c.laddr and c.laddr.port == port and c.pid
        ]
    except psutil.AccessDenied:
        return None
    return psutil.Process(found[0]) if found else None


def _cpu(broker: psutil.Process | None) -> float:
    """CPU time of the broker, s."""
    return sum(broker.cpu_times()[:2]) if broker else 0.0


def _measure(host: str, port: int, machines: int, seconds: float) -> tuple[int, np.ndarray]:
    """Number of sent messages, and latencies of the received ones, s."""
    latencies: list[float] = []
    subscribed = threading.Event()
    listener = mqtt.Client(CallbackAPIVersion.VERSION2)

    def message(_client: Any, _data: Any, received: mqtt.MQTTMessage) -> None:
        latencies.append(1e-9 * (time.time_ns() - json.loads(received.payload)["time"]))

    listener.on_message = message
    listener.on_connect = lambda client, *_: client.subscribe("fivebar/+/meas")
    listener.on_subscribe = lambda *_: subscribed.set()
    sender = mqtt.Client(CallbackAPIVersion.VERSION2)
    for client in (listener, sender):
        for _ in range(100):
            try:
                client.connect(host, port)
                break
            except OSError:
                # The embedded broker needs a moment to start.
                time.sleep(0.1)
        client.loop_start()
    if not subscribed.wait(10):
        raise TwinError(f"the broker at {host}:{port} does not answer")
    begin, sent = time.perf_counter(), 0
    steps = math.ceil(seconds * RATE)
    for step in range(steps):
        for machine in range(machines):
            unit = f"load{machine}"
            sender.publish(topic(unit, "meas"), encode(Message("meas", unit, time.time_ns(), step, FIELDS)))
            sent += 1
        time.sleep(max(0.0, begin + (step + 1) / RATE - time.perf_counter()))
    end = time.perf_counter() + 3
    while len(latencies) < sent and time.perf_counter() < end:
        time.sleep(0.02)
    for client in (sender, listener):
        client.disconnect()
        client.loop_stop()
    return sent, np.array(latencies)
