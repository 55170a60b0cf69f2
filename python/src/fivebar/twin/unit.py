"""One instance of the unit through FMPy: variables by name, many at a time; stored states. The unit does mechanics and estimation."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from ctypes import c_double, c_int
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable

from fivebar.slave import load
from fivebar.twin.errors import TwinError
from fivebar.variables import Variables

Values = Mapping[str, float | int | bool]


class UnitError(TwinError):
    """The unit refused a call; the text is its sentence."""


class Library:
    """An extracted .fmu; `close` removes the extracted files."""

    def __init__(self, fmu: Path):
        if not fmu.is_file():
            raise TwinError(f"there is no .fmu at {fmu}: `cargo xtask package` makes it")
        self.fmu = fmu
        self.directory = fmpy.extract(str(fmu))
        self.model: ModelDescription = fmpy.read_model_description(self.directory)
        self.variables: dict[str, ScalarVariable] = {v.name: v for v in self.model.modelVariables}

    @cached_property
    def known(self) -> Variables:
        """Variables that scenes may set."""
        return Variables(self.model)

    @property
    def guid(self) -> str:
        """GUID of the unit."""
        return str(self.model.guid)

    def variable(self, name: str) -> ScalarVariable:
        """The variable of that name."""
        if name not in self.variables:
            raise TwinError(f"the unit has no variable {name!r}")
        return self.variables[name]

    def close(self) -> None:
        shutil.rmtree(self.directory, ignore_errors=True)


class Reader:
    """Reads the same variables again and again, by at most two calls."""

    def __init__(self, unit: "Unit", names: Sequence[str]):
        variables = [unit.library.variable(name) for name in names]
        self.slave = unit.slave
        self.names = tuple(names)
        reals = [v for v in variables if v.type == "Real"]
        others = [v for v in variables if v.type in ("Integer", "Enumeration")]
        self._order = tuple(v.name for v in reals + others)
        self._reals = (fmi2.fmi2ValueReference * len(reals))(*(v.valueReference for v in reals))
        self._others = (fmi2.fmi2ValueReference * len(others))(*(v.valueReference for v in others))
        self._real_values, self._other_values = (c_double * len(reals))(), (c_int * len(others))()

    def read(self) -> dict[str, float]:
        """The present values, in the order of the names (integers as floats)."""
        slave = self.slave
        if len(self._reals):
            slave.fmi2GetReal(slave.component, self._reals, len(self._reals), self._real_values)
        if len(self._others):
            slave.fmi2GetInteger(slave.component, self._others, len(self._others), self._other_values)
        values = dict(zip(self._order, (*self._real_values, *map(float, self._other_values)), strict=True))
        return {name: values[name] for name in self.names}


class Unit:
    """An instance, and its clock in s."""

    def __init__(self, library: Library, name: str = "twin"):
        self.library, self.time = library, 0.0
        self.log: list[str] = []
        """Sentences of warnings and errors, the last 100."""
        self.news: list[str] = []
        """Those since the last look, as many."""
        self.slave = load(fmi2.FMU2Slave, library.model, library.directory, name)
        self.slave.instantiate(callbacks=self._callbacks())

    def _callbacks(self) -> fmi2.fmi2CallbackFunctions:
        def append(_environment: Any, _instance: bytes, status: int, _category: bytes, text: bytes) -> None:
            if status > fmi2.fmi2OK:
                # The text is a printf format by contract: a percent sign comes doubled.
                sentence = text.decode(errors="replace").replace("%%", "%")
                self.log, self.news = [*self.log[-99:], sentence], [*self.news[-99:], sentence]

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(append)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        return callbacks

    def _call(self, name: str, *arguments: Any, **named: Any) -> Any:
        try:
            return getattr(self.slave, name)(*arguments, **named)
        except FMICallException as error:
            raise UnitError(self.log[-1] if self.log else str(error)) from None

    def start(self, values: Values, time: float = 0.0) -> None:
        """Starts anew with those values, at a time in s."""
        self._call("reset")
        self.set(values)
        self._call("setupExperiment", startTime=time)
        self._call("enterInitializationMode")
        self._call("exitInitializationMode")
        self.time = time

    def set(self, values: Values) -> None:
        """Sets variables by name."""
        for name, value in values.items():
            variable = self.library.variable(name)
            kind = {"Enumeration": "Integer"}.get(variable.type, variable.type)
            self._call(f"set{kind}", [variable.valueReference], [value])

    def get(self, names: Iterable[str]) -> dict[str, float]:
        """Reads variables by name."""
        return Reader(self, list(names)).read()

    def set_reals(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Sets Reals by reference, in one call."""
        self._call("setReal", references, values)

    def set_slopes(self, references: Sequence[int], values: Sequence[float]) -> None:
        """First derivatives of inputs over the step that follows."""
        self._call("setRealInputDerivatives", references, [1] * len(references), values)

    def step_to(self, time: float) -> None:
        """One communication step to a time in s."""
        self._call("doStep", self.time, time - self.time)
        self.time = time

    def store(self) -> tuple[Any, float]:
        """The state and the clock; `free` it."""
        return self._call("getFMUstate"), self.time

    def restore(self, stored: tuple[Any, float]) -> None:
        """Goes on from a stored state of this instance or another one of the same library."""
        self._call("setFMUstate", stored[0])
        self.time = stored[1]

    def free(self, stored: tuple[Any, float]) -> None:
        """Gives a stored state back."""
        self._call("freeFMUstate", stored[0])

    def to_bytes(self, stored: tuple[Any, float]) -> bytes:
        """A stored state for another process."""
        return bytes(self._call("serializeFMUstate", stored[0]))

    def from_bytes(self, content: bytes, time: float) -> None:
        """Goes on from bytes that `to_bytes` gave; the unit refuses bytes that were changed, or come from another unit."""
        stored = self._call("deSerializeFMUstate", content), time
        try:
            self.restore(stored)
        finally:
            self.free(stored)

    def close(self) -> None:
        self.slave.freeInstance()
