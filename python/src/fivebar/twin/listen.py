"""Receives the samples that a machine publishes at a broker, for some seconds."""

import threading
import time
from typing import Final

from fivebar.twin import starter
from fivebar.twin.bus import Bus
from fivebar.twin.calibrate import data
from fivebar.twin.config import Broker, Config, check_broker
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.intake import Intake
from fivebar.twin.messages import decode
from fivebar.twin.recording import Recording

ANY: Final = "+"
"""All units, as a topic has it."""


def hear(broker: Broker, unit: str, seconds: float) -> Recording:
    """The samples of `unit` ("": of the only one) that come within `seconds`. Raises `TwinError` if none do, or if a twin would refuse most of them."""
    if not 0 < seconds < threading.TIMEOUT_MAX:
        raise TwinError(f"seconds must be more than 0, not {seconds:g}")
    check_broker(broker)
    starter.check_broker(broker)
    heard: list[tuple[str, bytes, int]] = []
    bus = Bus(
        broker, unit or ANY, "check", ("meas",), lambda topic, payload: heard.append((topic, payload, time.time_ns()))
    )
    bus.start()
    try:
        threading.Event().wait(seconds)
    finally:
        bus.stop()
    return recorded(f"what came from {broker.host}:{broker.port} in {seconds:g} s", heard, unit)


def recorded(source: str, heard: list[tuple[str, bytes, int]], unit: str) -> Recording:
    """The samples among messages: topic, payload, and time of arrival in ns."""
    found = data.of_messages(source, ((topic, payload) for topic, payload, _ in heard), unit)
    intake, refused = Intake(Config.period), []
    for topic, payload, arrival in heard:
        try:
            intake.admit(decode(topic, payload), arrival)
        except Refused as error:
            refused.append(str(error))
    # A machine with another clock is taken after some samples.
    if 2 * len(refused) > len(heard):
        raise TwinError(
            f"{source}: a twin would refuse {len(refused)} of {len(heard)} samples, the first one because {refused[0]}"
        )
    return found
