"""An extracted .fmu: its model description and loaded library, shared by any number of instances."""

import os
import shutil
import threading
import weakref
from collections.abc import Iterable, Sequence
from ctypes import CDLL, Array, c_double, c_int, c_uint
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import fmpy
from fmpy import fmi2
from fmpy.model_description import ModelDescription, ScalarVariable

from fivebar import shipped
from fivebar.errors import FiveBarError
from fivebar.variables import Variable, Variables, description, shown, similar

TYPES: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int}
"""C types of values by FMI type."""

_LOADING = threading.Lock()


@dataclass(frozen=True)
class Block:
    """Variables of one type, read or set by one call."""

    getter: str
    setter: str
    """C functions that read and set variables of this type; enumerations are integers."""

    references: "Array[c_uint]"
    places: Sequence[int]
    """Index of each variable in the whole list of names."""

    values: Any
    """C array type of the values."""

    orders: "Array[c_int]"
    """Orders of input derivatives: 1 for each variable."""

    @classmethod
    def of(cls, kind: str, references: Sequence[int], places: Sequence[int]) -> "Block":
        """A block of variables of an FMI type, from their value references."""
        count = len(references)
        return cls(
            f"fmi2Get{kind}",
            f"fmi2Set{kind}",
            (fmi2.fmi2ValueReference * count)(*references),
            places,
            TYPES[kind] * count,
            (c_int * count)(*([1] * count)),
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Unpickling makes new C arrays."""
        return Block.of, (self.getter.removeprefix("fmi2Get"), list(self.references), self.places)


class Library:
    """An extracted .fmu. Its files are removed by `close`, or when the object is no longer used.

    `model` is FMPy's model description. `variables` has FMPy's variables by name, `known` the package's own.
    """

    def __init__(self, fmu: Path):
        if not fmu.is_file():
            raise FiveBarError(f"there is no .fmu at {fmu}: `cargo xtask package` makes it")
        self.fmu = fmu
        self.model: ModelDescription = description(fmu)
        self.directory = fmpy.extract(str(fmu))
        self.loaded: list[fmi2._FMU2] = []
        self.open: set[int] = set()
        """Addresses of instances that have not been freed yet."""

        self._discard = weakref.finalize(self, _discard, self.directory, os.getpid(), self.loaded, self.open)
        self.variables: dict[str, ScalarVariable] = {v.name: v for v in self.model.modelVariables}
        self._blocks: dict[tuple[str, ...], tuple[Block, ...]] = {}
        self._reals: dict[tuple[tuple[str, ...], bool], Block | None] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Unpickling extracts and loads the unit again."""
        return _again, (self.fmu, self.guid)

    @cached_property
    def known(self) -> Variables:
        """All variables, with types, units, bounds and items."""
        return Variables(self.model)

    @property
    def guid(self) -> str:
        """GUID of the unit."""
        return str(self.model.guid)

    @cached_property
    def co_simulation(self) -> CDLL:
        """C functions for co-simulation."""
        return self._load(fmi2.FMU2Slave)

    @cached_property
    def model_exchange(self) -> CDLL:
        """C functions for model exchange."""
        return self._load(fmi2.FMU2Model)

    def _load(self, kind: type[fmi2._FMU2]) -> CDLL:
        identifier = self.model.coSimulation.modelIdentifier
        path = shipped.library(self.directory, identifier)
        # FMPy changes the working directory of the process while it loads a library, so only one thread may load at a time.
        with _LOADING:
            try:
                loaded = kind(
                    guid=self.guid,
                    unzipDirectory=self.directory,
                    modelIdentifier=identifier,
                    instanceName="",
                    libraryPath=path,
                )
            except Exception as error:  # noqa: BLE001 -- FMPy raises this class itself
                raise FiveBarError(f"the unit's library cannot be loaded: {error}") from None
        self.loaded.append(loaded)
        functions: CDLL = loaded.dll
        return functions

    def variable(self, name: str) -> ScalarVariable:
        """FMPy's description of a variable."""
        if name not in self.variables:
            raise FiveBarError(f"the unit has no variable {name!r}")
        return self.variables[name]

    @cached_property
    def units(self) -> dict[str, str]:
        """Units by name, for variables and arrays."""
        of_arrays = {name: elements[0].unit for name, elements in self.known.arrays.items()}
        return of_arrays | {name: variable.unit for name, variable in self.known.items()}

    def elements(self, name: str) -> tuple[Variable, ...]:
        """The variable of this name, or the elements of the array of this name."""
        if not isinstance(name, str):
            raise FiveBarError(f"a variable is named by a text, not by {shown(name)}")
        if (found := self._elements.get(name)) is None:
            raise FiveBarError(f"there is no variable '{name}'{similar(name, self._elements)}")
        return found

    @cached_property
    def _elements(self) -> dict[str, tuple[Variable, ...]]:
        return {name: (variable,) for name, variable in self.known.items()} | self.known.arrays

    def blocks(self, names: tuple[str, ...]) -> tuple[Block, ...]:
        """The named variables in blocks, one for each type."""
        if (found := self._blocks.get(names)) is None:
            found = self._blocks[names] = tuple(self._by_type(names))
        return found

    def reals(self, names: tuple[str, ...], inputs: bool = False) -> Block | None:
        """The block of these names if all are Real variables, or Real `inputs`, and none is an array, otherwise None."""
        if (names, inputs) not in self._reals:
            found = [self.known.get(name) for name in names]
            fit = [v is not None and v.type == "Real" and (v.causality == "input" or not inputs) for v in found]
            self._reals[names, inputs] = self.blocks(names)[0] if fit and all(fit) else None
        return self._reals[names, inputs]

    def _by_type(self, names: tuple[str, ...]) -> Iterable[Block]:
        variables = [self.variable(name) for name in names]
        for kind in TYPES:
            own = [i for i, v in enumerate(variables) if v.type.replace("Enumeration", "Integer") == kind]
            if own:
                yield Block.of(kind, [variables[i].valueReference for i in own], own)

    def close(self) -> None:
        """Removes the extracted files now; open instances keep working."""
        shutil.rmtree(self.directory, ignore_errors=True)


def _discard(directory: str, process: int, loaded: list[fmi2._FMU2], used: set[int]) -> None:
    """Unloads the library if no instance is open, and removes the files. A forked child leaves them to its parent."""
    if not used:
        for each in loaded:
            each.freeLibrary()
    if os.getpid() == process:
        shutil.rmtree(directory, ignore_errors=True)


def _again(fmu: Path, guid: str) -> Library:
    """The library of a pickled object: from the same file, or the shipped one if it is the same unit."""
    found = shared(fmu if fmu.is_file() else None)
    if found.guid != guid:
        raise FiveBarError(
            f"{found.fmu} is the unit {found.guid}, but the pickled object is of the unit {guid} at {fmu}"
        )
    return found


def shared(fmu: Path | None = None) -> Library:
    """The library of a packed unit, by default the shipped one. It is extracted once per process."""
    file = shipped.unit() if fmu is None else fmu
    if not file.is_file():
        raise FiveBarError(f"there is no .fmu at {file}")
    stat = file.stat()
    return _shared(file.resolve(), stat.st_mtime_ns, stat.st_size, os.getpid())


@lru_cache(maxsize=2)
def _shared(file: Path, _changed: int, _size: int, _process: int) -> Library:
    return Library(file)
