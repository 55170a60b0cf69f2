"""An instance of the FMU under test in FMPy, addressed by variable names. Unlike `fivebar.Unit` it may make illegal calls."""

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable

from fivebar import shipped
from fivebar.log import Message, callbacks

Values = dict[str, float | int | bool]

CALLS = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean"}
"""Ends of the names of calls that set and read variables, by type."""

LOADING = threading.Lock()
"""FMPy changes the working directory of the process while it loads a library: two threads must not do so at once."""


@dataclass
class Log:
    """All log messages of an instance."""

    messages: list[Message] = field(default_factory=list)

    def callbacks(self) -> fmi2.fmi2CallbackFunctions:
        """Callbacks that append to this log. FMPy keeps them alive as long as the instance."""
        return callbacks(self.messages.append)

    def last(self) -> str:
        """The last warning or error, or "" if there is none."""
        return next((m.text for m in reversed(self.messages) if m.status > fmi2.fmi2OK), "")

    def warnings(self) -> list[str]:
        """All warnings."""
        return [m.text for m in self.messages if m.status == fmi2.fmi2Warning]


def instantiate(
    model: ModelDescription,
    directory: str,
    log: Log,
    name: str = "fivebar",
    logging_on: bool = False,
    guid: str | None = None,
) -> fmi2.FMU2Slave:
    """A new instance of the FMU extracted to `directory`; its messages go to `log`. `guid` replaces the model's GUID."""
    identifier = model.coSimulation.modelIdentifier
    with LOADING:
        slave = fmi2.FMU2Slave(
            guid=model.guid if guid is None else guid,
            unzipDirectory=directory,
            modelIdentifier=identifier,
            instanceName=name,
            libraryPath=shipped.library(directory, identifier),
        )
    slave.instantiate(callbacks=log.callbacks(), loggingOn=logging_on)
    return slave


def computed(model: ModelDescription) -> list[ScalarVariable]:
    """Computed variables: outputs, then local variables, without derivatives, which are aliases."""
    return [v for v in model.modelVariables if v.causality in ("output", "local") and v.derivative is None]


def set_values(slave: fmi2.FMU2Slave, model: ModelDescription, values: Values) -> None:
    """Sets variables by name."""
    variables = {v.name: v for v in model.modelVariables}
    for name, value in values.items():
        getattr(slave, f"set{CALLS[variables[name].type]}")([variables[name].valueReference], [value])


def get_values(slave: fmi2.FMU2Slave, model: ModelDescription, names: list[str]) -> Values:
    """Reads variables by name."""
    variables = {v.name: v for v in model.modelVariables}
    return {
        name: getattr(slave, f"get{CALLS[variables[name].type]}")([variables[name].valueReference])[0] for name in names
    }


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
