"""A microcontroller at a serial port as a machine of the twin: its lines of text become `meas`, and commands go back as lines.

The board sends `SEQ MICROS LEFT RIGHT*CHECK` for each sample: a count of samples (16 bits), its clock in µs (32 bits), and the counters of
both encoders (16 bits), which are 0 at the stops. CHECK is the exclusive or of all bytes before `*`, in hexadecimal digits. A command on
the topic `bench/command`, such as {"servo.theta[1]": 2.2, "servo.theta[2]": 0.9}, becomes the line `LEFT RIGHT*CHECK` in counts.

docs/hardware.md explains the figures of `AXES`. It needs pyserial and fivebar[twin]: python examples/serial_bridge.py PORT HOST PORT
"""

import argparse
import json
import math
import time
from functools import reduce
from operator import xor
from typing import NamedTuple

import paho.mqtt.client as mqtt
import serial


class Axis(NamedTuple):
    steps: float  # counts in a turn of the joint: 4 x lines of the encoder x gear ratio
    sign: int  # 1 if the counter rises as the angle does
    stop: float  # angle of the joint at its stop, rad


AXES = {"theta[1]": Axis(4 * 500 * 20, -1, math.radians(170)), "theta[2]": Axis(4 * 500 * 20, 1, math.radians(10))}


def check(text: bytes) -> bytes:
    return b"%02X" % reduce(xor, text, 0)


class Bridge:
    def __init__(self) -> None:
        self.commands, self.micros, self.counts = {}, None, [0, 0]  # clock and counters without overflows
        self.seq, self.raw, self.epoch = (
            -1,
            0,
            0,
        )  # samples so far, the board's count of the last one, ns at 0 of its clock

    def sample(self, line: bytes, now: int) -> dict | None:
        """The message of a line that came at `now`, ns since 1970; None for a line that noise has changed."""
        text, _, found = line.strip().rpartition(b"*")
        words = text.split()
        if found != check(text) or len(words) != 4:
            return None
        seq, micros, *counts = map(int, words)
        more, passed = (seq - self.raw) % 2**16, (micros - (self.micros or 0)) % 2**32
        # A board that begins again stands at its stops; its clock or its count falls back.
        if self.micros is None or passed > 5e6 or more >= 2**15:
            more, passed, self.micros, self.counts, self.epoch = 1, 0, micros, [0, 0], now - 1000 * micros
        self.seq, self.raw, self.micros = self.seq + more, seq, self.micros + passed
        self.counts = [last + (new - last + 2**15) % 2**16 - 2**15 for last, new in zip(self.counts, counts)]
        fields = {
            f"measured.{name}": axis.stop + axis.sign * count * 2 * math.pi / axis.steps
            for (name, axis), count in zip(AXES.items(), self.counts)
        }
        about = {"measurement": "meas", "time": self.epoch + 1000 * self.micros, "seq": self.seq}
        return about | {"tags": {"unit": "bench"}, "fields": fields | self.commands}

    def command(self, payload: bytes) -> bytes:
        """The line to the board for a command; the samples after it carry the command."""
        angles = [float(json.loads(payload)[f"servo.{name}"]) for name in AXES]
        turns = [axis.sign * (angle - axis.stop) / (2 * math.pi) for angle, axis in zip(angles, AXES.values())]
        text = b"%d %d" % tuple(round(turn * axis.steps) for turn, axis in zip(turns, AXES.values()))
        self.commands = {f"servo.{name}": angle for name, angle in zip(AXES, angles)}
        return text + b"*" + check(text) + b"\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Connects a board at a serial port to the twin.")
    parser.add_argument("serial", help="serial port, such as /dev/ttyACM0")
    parser.add_argument("host", help="host of the broker")
    parser.add_argument("port", type=int, help="port of the broker")
    options = parser.parse_args()
    bridge, client = Bridge(), mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    with serial.Serial(options.serial, 115200) as board:
        client.on_connect = lambda *_: client.subscribe("bench/command")
        client.on_message = lambda *given: board.write(bridge.command(given[2].payload))
        client.suppress_exceptions = True  # a command that cannot be read goes nowhere
        client.connect(options.host, options.port)
        client.loop_start()
        while True:
            if message := bridge.sample(board.readline(), time.time_ns()):
                client.publish("fivebar/bench/meas", json.dumps(message))
