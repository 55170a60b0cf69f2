"""A real machine instead of the stand-in: this loop publishes its encoder readings, and the twin follows them.

First start the other processes with `fivebar twin --machine none ...`, which prints host and port. docs/pipeline.md
describes the message.
Run with `fivebar[twin]` installed (in a checkout: `target/venv`): python examples/publish_machine.py HOST PORT
"""

import argparse
import json
import time

import paho.mqtt.client as mqtt

parser = argparse.ArgumentParser(description="Publishes samples of a machine's encoders, for the twin to follow.")
parser.add_argument("host", help="host of the broker")
parser.add_argument("port", type=int, help="port of the broker")
options = parser.parse_args()

client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
client.connect(options.host, options.port)
client.loop_start()
for seq in range(400):
    left, right = 2.7567, 1.345  # rad: read your encoders here
    fields = {"measured.theta[1]": left, "measured.theta[2]": right}
    point = {"measurement": "meas", "time": time.time_ns(), "seq": seq, "tags": {"unit": "bench"}, "fields": fields}
    client.publish("fivebar/bench/meas", json.dumps(point))
    time.sleep(0.005)
client.disconnect()
client.loop_stop()
