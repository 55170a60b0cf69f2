"""The twin process: receives `meas`, `param` and `cmd`; publishes `est` for every sample, `ahead` 20 times and `state` and `learned` once per second."""

import json
import logging
import math
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from fivebar.library import Library
from fivebar.twin import process, scene, setup
from fivebar.twin.config import Config, read_json
from fivebar.twin.errors import Refused
from fivebar.twin.follower import Follower
from fivebar.twin.intake import Intake, Orders, Refusals
from fivebar.twin.messages import MEASURED, Message, topic
from fivebar.twin.process import Worker

STORE_EVERY: Final = 1_000_000_000
"""Time between two stored states on the machine's clock, ns."""

MUCH: Final = 4 * math.pi
"""Limit of a plausible first reading, rad: larger numbers are probably degrees."""

ALONE: Final = 2_000_000_000
"""Time without a sample of this unit, ns. After it, the process also listens to other units: the machine may have another name."""

COPIES: Final = 64
"""Number of samples among which a copy is recognised: more than a slow broker delivers late."""

AT_BOUND: Final = "has been moved to its bound"
"""Part of the FMU's warning that a learned value has reached its bound: the scene does not match the machine."""

log = logging.getLogger("fivebar")


class Twin(Worker):
    """The worker. It computes each estimate when its sample arrives."""

    name = "follow"
    kinds = ("meas", "param", "cmd")

    def __init__(self, config: Config, library: Library):
        super().__init__(config)
        self.setup = setup.of_run(config, scene.read(Path(config.scene)), library.guid)
        self.follower = Follower(library, self.setup)
        self.intake = Intake(config.period)
        self.file = config.path / "state" / "twin.json"
        self.samples_per_forecast = max(1, round(1 / (config.forecast_rate * config.period)))
        self.counts = dict.fromkeys(("taken", "late", "estimated", "states", "failures"), 0)
        self.orders = Orders()
        self.refusals = Refusals()
        self.own = topic(config.unit, "meas")
        self.waits_since: int | None = None
        """Time at which the wait for the first sample of this unit began, ns."""
        self.heard, self.hears_others = False, False
        """Whether a sample of this unit has arrived, and whether the process has listened to other units."""
        self.recent: deque[bytes] = deque(maxlen=COPIES)
        """The last accepted samples of this unit since the process listened to other units."""
        self.stored_at = -1

    def begin(self) -> None:
        """Resumes from the last stored state, if there is one."""
        if not self.file.is_file():
            return
        try:
            content = read_json(self.file)
            state = Message("state", "", int(content.pop("time")), int(content.pop("seq")), {}, content)
            self.follower.go_on_from(state)
        except (KeyError, TypeError, ValueError) as error:
            log.warning("the stored state cannot be used, starting without it: %s", error)
            return
        self.intake.go_on_from(state.seq, state.time)
        self.stored_at = state.time
        log.info("resuming from the state after sample %d", state.seq)

    def received(self, topic: str, payload: bytes, now: int) -> None:
        if not self.heard and topic == self.own:
            self.heard, self.refusals = True, Refusals()
            if self.hears_others:
                self.hear_others(False)
        is_own = self.hears_others and topic == self.own
        if is_own and payload in self.recent:
            # The broker may send a message once for each of two subscriptions that overlap (MQTT 3.1.1, 3.3.5).
            return
        refused = self.refused
        super().received(topic, payload, now)
        if is_own and self.refused == refused:
            self.recent.append(payload)

    def refuse(self, topic: str, error: Refused, now: int) -> None:
        super().refuse(topic, error, now)
        if topic.endswith("/meas"):
            self.refusals.add(str(error), now)

    def tick(self, now: int) -> None:
        if sentence := self.refusals.lasting(now):
            self.trouble("samples", sentence, now)
        if self.waits_since is None:
            self.waits_since = now
        if not self.heard and not self.hears_others and now - self.waits_since >= ALONE:
            self.hears_others = True
            self.hear_others(True)

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        if message.kind == "meas":
            self._sample(message, now)
        else:
            try:
                self._order(message, now)
            except Refused as error:
                # The sender of a command needs the answer.
                self.trouble("order", f"not taken: {error}", now, every=0.2, order=message.time)
                self.refused += 1

    def _sample(self, message: Message, now: int) -> None:
        kind = self.intake.admit(message, now)
        follower = self.follower
        if kind == "late" and follower.book is not None and not follower.finds_place(message.seq):
            raise Refused(f"meas {message.seq} came too late")
        if kind == "series" and follower.book is not None:
            log.warning("the machine restarted its count at sample %d", message.seq)
            follower.restart(Message("cmd", "", message.time, message.seq, {}))
        if kind == "series":
            for name, angle in message.fields.items():
                if name in MEASURED and abs(angle) > MUCH:
                    self.trouble(
                        "unit",
                        f"{name} begins at {angle:g} rad, more than two turns: degrees?",
                        message.time,
                        message.seq,
                    )
        self.refusals.taken()
        self.counts["taken"] += 1
        self.counts["late"] += kind == "late"
        jumps = follower.jumps
        made = follower.meas(message)
        if follower.begun:
            self.tell("taken", "turn", follower.begun, message.time, message.seq)
            follower.begun = ""
        if follower.jumps != jumps:
            log.warning("the machine's clock jumped at sample %d", message.seq)
        if follower.failure:
            self.counts["failures"] += 1
            self.trouble("unit", f"restarting with the next sample: {follower.failure}", message.time, message.seq)
            follower.failure = ""
        for said in follower.unit.log:
            if AT_BOUND in said.text:
                # The FMU reports each bound only once.
                self.trouble("unit", said.text, message.time, message.seq, every=0.0)
        follower.unit.log.clear()
        if not made:
            return
        self.publish(follower.estimate())
        self.counts["estimated"] += 1
        if message.seq % self.samples_per_forecast == 0:
            self.publish(replace(follower.state(), kind="ahead"))
        if abs(message.time - self.stored_at) >= STORE_EVERY:
            self._store(message.time)

    def _order(self, message: Message, now: int) -> None:
        """Executes a parameter change or a command, once and in the order of their times."""
        self.orders.check(message, now)
        if message.kind == "cmd":
            if message.extra["command"] == "restart":
                self.follower.restart(message)
                self.intake.forget()
                self._answer(message, "restarting with the next sample: requested", now)
        else:
            if sentence := self.follower.allowed(message):
                raise Refused(sentence)
            self.follower.param(message)
            self._answer(
                message,
                "parameters set: " + ", ".join(f"{name} = {value:g}" for name, value in message.fields.items()),
                now,
            )
        self.orders.taken(message)

    def _answer(self, order: Message, sentence: str, now: int) -> None:
        """Publishes the answer to a command, for its sender and for the record."""
        log.info("%s", sentence)
        extra = {
            "state": "taken",
            "cause": "order",
            "from": self.name,
            "sentence": sentence[:1000],
            "order": order.time,
        }
        self.publish(Message("alarm", "", now, order.seq, {}, extra))

    def _store(self, time: int) -> None:
        state = self.follower.state()
        self.publish(state)
        if learned := self.follower.learned():
            self.publish(learned)
        content = {"time": state.time, "seq": state.seq} | state.extra
        self.keep(self.file, json.dumps(content).encode())
        self.stored_at = time
        self.counts["states"] += 1

    def status(self) -> dict[str, Any]:
        refusals = {"refused_samples": self.refusals.count, "why_refused": self.refusals.first}
        return self.counts | refusals | {"missing": self.intake.missing, "jumps": self.follower.jumps}

    def end(self) -> None:
        if self.follower.book is not None:
            self._store(self.follower.book.time)


def run(file: Path) -> int:
    config = process.read_config(file)
    library = Library(Path(config.fmu))
    try:
        return process.serve(Twin(config, library))
    finally:
        library.close()
