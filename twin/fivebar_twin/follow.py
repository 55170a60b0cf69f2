"""The twin's process: takes `meas`, `param` and `cmd`; publishes `est` for every sample, `forecast` 20 times a second, `state` once."""

import argparse
import json
import logging
import os
import queue
import sys
import threading
from pathlib import Path
from typing import Any, Final, NamedTuple

from fivebar_twin import process, scene, setup
from fivebar_twin.config import Config, read_json
from fivebar_twin.errors import Refused, TwinError
from fivebar_twin.follower import Book, Follower
from fivebar_twin.forecast import Forecaster
from fivebar_twin.intake import Intake
from fivebar_twin.messages import Message
from fivebar_twin.process import Worker
from fivebar_twin.unit import Library, UnitError

STORE_EVERY: Final = 1_000_000_000
"""Nanoseconds of the machine's clock between two stored states."""

log = logging.getLogger("fivebar")


class _Ahead(NamedTuple):
    """From where the next forecast starts."""

    stored: tuple[Any, float]
    book: Book


class Twin(Worker):
    """The worker. Estimates are made where a message arrives; forecasts in a thread, which has a unit of its own."""

    name = "follow"
    kinds = ("meas", "param", "cmd")

    def __init__(self, config: Config, library: Library):
        super().__init__(config)
        self.setup = setup.of_run(config, scene.read(Path(config.scene)), library.guid)
        self.follower = Follower(library, self.setup)
        self.forecaster = Forecaster(library, self.setup)
        self.intake = Intake(config.period)
        self.file = config.path / "state" / "twin.json"
        self.samples_per_forecast = max(1, round(1 / (config.forecast_rate * config.period)))
        self.counts = dict.fromkeys(("taken", "late", "estimated", "forecasts", "forecasts_left_out", "states", "failures"), 0)
        self.newest_order = -1
        self.stored_at = -1
        self.to_store: bytes | None = None
        self.stopped = threading.Event()
        self.ahead: queue.Queue[_Ahead | None] = queue.Queue(maxsize=1)
        self.thread = threading.Thread(target=self._forecast, name="forecast", daemon=True)

    def begin(self) -> None:
        """Goes on from the last stored state, if there is one."""
        self.thread.start()
        if not self.file.is_file():
            return
        try:
            content = read_json(self.file)
            state = Message("state", "", int(content.pop("time")), int(content.pop("seq")), {}, content)
            self.follower.go_on_from(state)
        except (KeyError, TypeError, ValueError, TwinError) as error:
            log.warning("the stored state cannot be used, starting anew: %s", error)
            return
        self.intake.go_on_from(state.seq, state.time)
        self.stored_at = state.time
        log.info("going on from the state after sample %d", state.seq)

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        if message.kind == "meas":
            self._sample(message)
        else:
            self._order(message)

    def _sample(self, message: Message) -> None:
        kind = self.intake.admit(message)
        follower = self.follower
        if kind == "late" and follower.book is not None and not follower.finds_place(message.seq):
            raise Refused(f"meas {message.seq} came too late")
        if kind == "series" and follower.book is not None:
            log.warning("the machine counts anew from sample %d", message.seq)
            follower.restart(Message("cmd", "", message.time, message.seq, {}))
        self.counts["taken"] += 1
        self.counts["late"] += kind == "late"
        jumps = follower.jumps
        made = follower.meas(message)
        if follower.jumps != jumps:
            log.warning("the machine's clock jumped at sample %d", message.seq)
        if follower.failure:
            self.counts["failures"] += 1
            log.warning("starting anew with the next sample: %s", follower.failure)
            follower.failure = ""
        if not made:
            return
        self.publish(follower.estimate())
        self.counts["estimated"] += 1
        if message.seq % self.samples_per_forecast == 0:
            self._ask_ahead()
        if abs(message.time - self.stored_at) >= STORE_EVERY:
            self._store(message.time)

    def _order(self, message: Message) -> None:
        """A parameter or a command, once, in its order."""
        if message.time <= self.newest_order:
            raise Refused(f"{message.kind} of {message.time} ns is not newer than the last order, of {self.newest_order} ns")
        if message.kind == "cmd":
            if message.extra["command"] == "restart":
                self.follower.restart(message)
                log.info("starting anew with the next sample: asked to")
        else:
            if sentence := self.follower.allowed(message):
                raise Refused(sentence)
            self.follower.param(message)
            log.info("parameters set: %s", ", ".join(f"{name} = {value:g}" for name, value in message.fields.items()))
        self.newest_order = message.time

    def _store(self, time: int) -> None:
        state = self.follower.state()
        self.publish(state)
        content = {"time": state.time, "seq": state.seq} | state.extra
        # Written from `tick`: a disk must not delay an estimate.
        self.to_store = json.dumps(content).encode()
        self.stored_at = time
        self.counts["states"] += 1

    def _ask_ahead(self) -> None:
        """Hands the present state to the forecasts' thread, unless it is still busy."""
        if not self.ahead.empty():
            self.counts["forecasts_left_out"] += 1
            return
        book = self.follower.book
        if book is not None:
            self.ahead.put(_Ahead(self.follower.unit.store(), book))

    def _forecast(self) -> None:
        if sys.platform == "linux":
            # Of this thread alone: estimates go first.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)
        while (ahead := self.ahead.get()) is not None:
            try:
                forecast = self.forecaster.run(ahead.stored, ahead.book, self.stopped.is_set)
            except UnitError as error:
                log.warning("no forecast: %s", error)
                forecast = None
            self.forecaster.unit.free(ahead.stored)
            if forecast is not None:
                self.publish(forecast)
                self.counts["forecasts"] += 1

    def tick(self, now: int) -> None:
        # `handle` waits while this runs, so the file is written without being brought to the disk.
        if self.to_store is not None:
            beside = self.file.with_suffix(".writing")
            beside.parent.mkdir(parents=True, exist_ok=True)
            beside.write_bytes(self.to_store)
            beside.replace(self.file)
            self.to_store = None

    def status(self) -> dict[str, Any]:
        return self.counts | {"missing": self.intake.missing, "jumps": self.follower.jumps}

    def end(self) -> None:
        self.stopped.set()
        self.ahead.put(None)
        self.thread.join(timeout=2)
        if self.follower.book is not None:
            self._store(self.follower.book.time)
            self.tick(0)


def arguments(parser: argparse.ArgumentParser) -> None:
    process.arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    config = process.read_config(arguments)
    # The forecasts' thread hands over quickly when a sample comes.
    sys.setswitchinterval(2e-4)
    library = Library(Path(config.fmu))
    try:
        return process.serve(Twin(config, library))
    finally:
        library.close()
