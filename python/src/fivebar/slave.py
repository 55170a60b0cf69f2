"""An instance of the FMU in FMPy, with its log in a list."""

import threading
from dataclasses import dataclass, field
from typing import TypeVar

from fmpy import fmi2
from fmpy.model_description import ModelDescription, ScalarVariable

from fivebar.log import Message, callbacks
from fivebar.shipped import library


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


Kind = TypeVar("Kind", fmi2.FMU2Slave, fmi2.FMU2Model)

_LOADING = threading.Lock()


def load(kind: type[Kind], model: ModelDescription, directory: str, name: str, guid: str | None = None) -> Kind:
    """The FMU extracted to `directory`, with its library loaded but not yet instantiated; `guid` replaces the model's GUID.

    FMPy changes the working directory of the process while it loads a library, so only one thread may load at a time.
    """
    identifier = model.coSimulation.modelIdentifier
    with _LOADING:
        return kind(
            guid=model.guid if guid is None else guid,
            unzipDirectory=directory,
            modelIdentifier=identifier,
            instanceName=name,
            libraryPath=library(directory, identifier),
        )


def instantiate(
    model: ModelDescription,
    directory: str,
    log: Log,
    name: str = "fivebar",
    logging_on: bool = False,
    guid: str | None = None,
) -> fmi2.FMU2Slave:
    """A new instance of the FMU extracted to `directory`; its messages go to `log`."""
    slave = load(fmi2.FMU2Slave, model, directory, name, guid)
    slave.instantiate(callbacks=log.callbacks(), loggingOn=logging_on)
    return slave


def computed(model: ModelDescription) -> list[ScalarVariable]:
    """Computed variables of the FMU: outputs, then local variables, without derivatives, which are aliases."""
    return [v for v in model.modelVariables if v.causality in ("output", "local") and v.derivative is None]


def set_values(slave: fmi2.FMU2Slave, model: ModelDescription, values: dict[str, float | int | bool]) -> None:
    """Sets variables by name."""
    setters = {
        "Real": slave.setReal,
        "Integer": slave.setInteger,
        "Enumeration": slave.setInteger,
        "Boolean": slave.setBoolean,
    }
    variables = {v.name: v for v in model.modelVariables}
    for name, value in values.items():
        setters[variables[name].type]([variables[name].valueReference], [value])


def get_values(slave: fmi2.FMU2Slave, model: ModelDescription, names: list[str]) -> dict[str, float | int | bool]:
    """Reads variables by name."""
    getters = {
        "Real": slave.getReal,
        "Integer": slave.getInteger,
        "Enumeration": slave.getInteger,
        "Boolean": slave.getBoolean,
    }
    variables = {v.name: v for v in model.modelVariables}
    return {name: getters[variables[name].type]([variables[name].valueReference])[0] for name in names}
