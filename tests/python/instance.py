"""An instance of the FMU under test, addressed by variable names."""

import struct
from collections.abc import Callable
from typing import Any

from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription

from fivebar.slave import Log, computed, get_values, instantiate, set_values

Values = dict[str, float | int | bool]


class Instance:
    """One instance and its log."""

    def __init__(self, model: ModelDescription, directory: str, name: str = "fivebar", logging_on: bool = False):
        self.model, self.log = model, Log()
        self.slave = instantiate(model, directory, self.log, name, logging_on)
        self.computed = [v.name for v in computed(model)]

    def enter(self) -> "Instance":
        """Enters initialization mode, the first with values to read."""
        self.slave.setupExperiment()
        self.slave.enterInitializationMode()
        return self

    def initialise(
        self, values: Values | None = None, start_time: float = 0.0, stop_time: float | None = None
    ) -> "Instance":
        """Sets `values` and completes initialisation."""
        self.set(values or {})
        self.slave.setupExperiment(startTime=start_time, stopTime=stop_time)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        return self

    def set(self, values: Values) -> None:
        """Sets variables by name."""
        set_values(self.slave, self.model, values)

    def get(self, name: str) -> Any:
        """Reads a variable by name."""
        return get_values(self.slave, self.model, [name])[name]

    def tip(self) -> tuple[float, float]:
        """Position of the tip, m."""
        return self.get("tip.x"), self.get("tip.y")

    def steps(self, count: int, size: float, begin: float = 0.0) -> None:
        """Makes `count` communication steps of `size` seconds."""
        for i in range(count):
            self.slave.doStep(begin + i * size, size)

    def bits(self) -> dict[str, bytes]:
        """All computed variables, bit by bit."""
        values = get_values(self.slave, self.model, self.computed)
        return {name: struct.pack("<d" if isinstance(v, float) else "<q", v) for name, v in values.items()}

    def refusal(self, call: Callable[..., Any], *arguments: Any) -> tuple[int, str]:
        """Status and logged message of a call that must be refused."""
        before = len(self.log.messages)
        try:
            call(*arguments)
        except FMICallException as error:
            logged = self.log.messages[before:]
            assert logged, f"{error.function} failed without a message"
            assert logged[-1].status == error.status, "the message has another status than the call"
            return error.status, logged[-1].text
        raise AssertionError(f"{call.__name__}{arguments} was accepted")
