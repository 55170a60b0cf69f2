"""The forecast process: receives the twin's states as `ahead`, runs ahead of time from them and publishes `forecast`.

It is a separate process with the lowest priority: an estimate never waits for a forecast.
"""

import logging
import threading
from pathlib import Path
from typing import Any

from fivebar.library import Library
from fivebar.twin import process, scene, setup
from fivebar.twin.config import Config
from fivebar.twin.forecast import Forecaster
from fivebar.twin.intake import Newest
from fivebar.twin.messages import Message
from fivebar.twin.process import Worker

log = logging.getLogger("fivebar")


class Ahead(Worker):
    """The worker. A thread computes each forecast from the newest state and skips states that arrived in the meantime.

    With `at_once`, each state gets its forecast immediately, for callers that control the clock.
    """

    name = "forecast"
    kinds = ("ahead",)

    def __init__(self, config: Config, library: Library, at_once: bool = False):
        super().__init__(config)
        self.at_once = at_once
        self.forecaster = Forecaster(library, setup.of_run(config, scene.read(Path(config.scene)), library.guid))
        self.counts = dict.fromkeys(("forecasts", "left_out"), 0)
        self.order = Newest()
        self.newest: Message | None = None
        """Newest stored state that the thread has not taken yet."""
        self.come = threading.Condition()
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self._work, name="forecast", daemon=True)

    def begin(self) -> None:
        if not self.at_once:
            self.thread.start()

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        self.order.admit(message, now)
        if self.at_once:
            self._make(message)
            return
        with self.come:
            self.counts["left_out"] += self.newest is not None
            self.newest = message
            self.come.notify()

    def _work(self) -> None:
        while True:
            with self.come:
                self.come.wait_for(lambda: self.newest is not None or self.stopped.is_set())
                state, self.newest = self.newest, None
            if state is None or self.stopped.is_set():
                return
            self._make(state)

    def _make(self, state: Message) -> None:
        try:
            forecast = self.forecaster.run(state, self.stopped.is_set)
        except (KeyError, TypeError, ValueError) as error:
            # One bad state must not end the process: the next one may be good.
            log.warning("no forecast: %s", error)
            return
        if forecast is not None:
            self.publish(forecast)
            self.counts["forecasts"] += 1

    def status(self) -> dict[str, Any]:
        return dict(self.counts)

    def end(self) -> None:
        with self.come:
            self.stopped.set()
            self.come.notify()
        if not self.at_once:
            self.thread.join(timeout=2)


def run(file: Path) -> int:
    config = process.read_config(file)
    library = Library(Path(config.fmu))
    try:
        return process.serve(Ahead(config, library))
    finally:
        library.close()
