"""A real machine in the place of the stand-in: this loop publishes what its encoders say, and the twin follows it.

Start the rest first, `fivebar twin --machine none ...`, which prints host and port; docs/pipeline.md has the message's rules.
From the root of the repository: target/venv/bin/python examples/publish_machine.py HOST PORT
"""

import json
import sys
import time

import paho.mqtt.client as mqtt

client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
client.connect(sys.argv[1], int(sys.argv[2]))
client.loop_start()
for seq in range(400):
    left, right = 2.7567, 1.345  # rad: read your encoders here
    fields = {"measured.theta[1]": left, "measured.theta[2]": right}
    point = {"measurement": "meas", "time": time.time_ns(), "seq": seq, "tags": {"unit": "bench"}, "fields": fields}
    client.publish("fivebar/bench/meas", json.dumps(point))
    time.sleep(0.005)
client.disconnect()
client.loop_stop()
