"""The unit through FMPy's calls, by names of variables: shared by the examples that go beyond one `simulate_fmu`."""

import shutil
from typing import Self

from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

import fivebar

FMU = str(fivebar.unit())


class Unit:
    """One instance. `values` are set before each start; frees itself as a `with` block ends."""

    def __init__(self, **values: float | bool):
        self.folder = extract(FMU)
        model = read_model_description(self.folder)
        self.variables = {
            v.name: (v.type.replace("Enumeration", "Integer"), v.valueReference) for v in model.modelVariables
        }
        self.slave = instantiate_fmu(self.folder, model, "CoSimulation")
        self.values, self.time = values, 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, values: dict[str, float | bool], time: float = 0.0) -> Self:
        """Through initialisation at a time, s; after `slave.reset()` as well."""
        self.set(self.values | values)
        self.slave.setupExperiment(startTime=time)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.time = time
        return self

    def set(self, values: dict[str, float | bool]) -> None:
        """Sets variables."""
        for name, value in values.items():
            kind, reference = self.variables[name]
            getattr(self.slave, f"set{kind}")([reference], [value])

    def get(self, *names: str) -> list[float]:
        """Reads variables."""
        kinds = [self.variables[name] for name in names]
        return [getattr(self.slave, f"get{kind}")([reference])[0] for kind, reference in kinds]

    def step(self, size: float) -> None:
        """A communication step of `size` seconds."""
        self.slave.doStep(self.time, size)
        self.time += size
