"""The unit's variables by name, from its model description: types, units, start values, bounds, and checks of given values."""

import difflib
import json
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fivebar import shipped
from fivebar.errors import FiveBarError

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription, ScalarVariable

Value = float | int | bool
"""A value in calls of the unit: enumerations are integers (FMI 2.0.4, section 2.2.7)."""

Values = dict[str, Value]

MOST_ALIKE = 3
"""Largest number of suggestions for an unknown name."""

MOST_KNOWN = 6
"""Largest number of known names in a message if none is similar."""

INDEX = re.compile(r"\[\d+\]")
"""The index in a name."""

INTEGERS = -(2**31), 2**31 - 1
"""Range of integers in FMI."""


@dataclass(frozen=True)
class Variable:
    """A variable of the unit."""

    name: str
    type: str
    """`Real`, `Integer`, `Boolean` or `Enumeration`."""

    causality: str
    variability: str
    unit: str
    """"1" if the variable has no unit."""

    start: Value | None
    least: float | None
    most: float | None
    items: Mapping[str, int]
    """Names and numbers of the items of an enumeration."""

    description: str

    @property
    def can_be_set(self) -> bool:
        return self.causality in ("parameter", "input")

    def value(self, given: Any) -> Value:
        """Checks a number, a Boolean or the name of an item, also of NumPy, and converts it to a value for calls."""
        given = plain(given)
        if self.type == "Real":
            wanted = f"a number in {self.unit}{self._limits(self.least, self.most)}"
            if is_number(given) and self._within(float(given)):
                return float(given)
        elif self.type == "Integer":
            least = INTEGERS[0] if self.least is None else int(self.least)
            most = INTEGERS[1] if self.most is None else int(self.most)
            wanted = f"a whole number{self._limits(least, most)}"
            if is_number(given) and isinstance(given, int) and least <= given <= most:
                return given
        elif self.type == "Boolean":
            wanted = "true or false"
            if isinstance(given, bool):
                return given
        else:
            wanted = f"one of {', '.join(self.items)}"
            if isinstance(given, str) and given in self.items:
                return self.items[given]
        raise FiveBarError(f"'{self.name}' must be {wanted}, not {shown(given)}")

    def number(self, given: Any) -> Value:
        """Converts a value of Python or NumPy to a value for calls. An enumeration may be a number; the unit checks bounds of Reals."""
        single = given.item() if hasattr(given, "item") and getattr(given, "size", 1) == 1 else given
        if self.type == "Real" and is_number(single):
            return float(single)
        if self.type == "Enumeration" and is_number(single) and single in self.items.values():
            return int(single)
        return self.value(single)

    def item(self, number: int) -> str:
        """The name of an item of an enumeration."""
        return next(name for name, value in self.items.items() if value == number)

    def given(self, value: Value) -> Value | str:
        """A value of a call as users give it: enumerations by the names of their items."""
        return self.item(int(value)) if self.type == "Enumeration" else value

    def _within(self, value: float) -> bool:
        return (
            not math.isnan(value)
            and (self.least is None or self.least <= value)
            and (self.most is None or value <= self.most)
        )

    @staticmethod
    def _limits(least: float | None, most: float | None) -> str:
        low, high = (None if bound is None else repr(bound).removesuffix(".0") for bound in (least, most))
        if low is not None and high is not None:
            return f" from {low} to {high}"
        return f" of at least {low}" if low is not None else f" of at most {high}" if high is not None else ""


class Variables(Mapping[str, Variable]):
    """All variables of a unit, in its order."""

    def __init__(self, model: "ModelDescription"):
        self._by_name = {v.name: _variable(v) for v in model.modelVariables}
        experiment = model.defaultExperiment
        self.stop_time, self.step_size = float(experiment.stopTime), float(experiment.stepSize)
        """Stop time and step size of the unit's default experiment, s."""

    def __getitem__(self, name: str) -> Variable:
        return self._by_name[name]

    def __iter__(self) -> Any:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    @cached_property
    def start(self) -> Mapping[str, Value]:
        """Start values of all settable variables by name."""
        return {v.name: v.start for v in self.values() if v.can_be_set and v.start is not None}

    @cached_property
    def computed(self) -> tuple[str, ...]:
        """Names of computed variables: outputs and local variables, without `der(...)`, which are aliases."""
        return tuple(v.name for v in self.values() if not v.can_be_set and not v.name.startswith("der("))

    @cached_property
    def arrays(self) -> dict[str, tuple[Variable, ...]]:
        """Elements of each array by its name without index: `theta` has `theta[1]` and `theta[2]`."""
        found: dict[str, tuple[Variable, ...]] = {}
        for name, variable in self.items():
            if INDEX.search(name) and not name.startswith("der("):
                array = INDEX.sub("", name)
                found[array] = (*found.get(array, ()), variable)
        return found

    @cached_property
    def effects(self) -> frozenset[str]:
        """Effects of the machine with a switch: `gravity` has `gravity.enabled`."""
        switched = (name.removesuffix(".enabled") for name in self if name.endswith(".enabled"))
        return frozenset(name for name in switched if name.partition(".")[0] != "estimator")

    def flat(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Values by name, arrays split into their elements: `tau` becomes `tau[1]` and `tau[2]`. Other names stay."""
        found: dict[str, Any] = {}
        for name, value in given.items():
            if (elements := self.arrays.get(name)) is None:
                found[name] = value
            else:
                found |= zip((v.name for v in elements), _split(name, elements, value), strict=True)
        return found

    def settable(self, name: str, others: Iterable[str] = ()) -> Variable:
        """The parameter or input of this name; `others` are further suggestions for a misspelt name."""
        if (found := self.get(name)) is None:
            raise FiveBarError(f"there is no variable '{name}'{similar(name, [*self.start, *others])}")
        if not found.can_be_set:
            raise FiveBarError(f"'{name}' is computed by the FMU and cannot be set")
        return found

    def input(self, name: str) -> Variable:
        """The input of this name."""
        found = self.get(name)
        if found is not None and found.causality == "parameter":
            what = (
                "tunable parameter: if it is Real, it takes 'steps'"
                if found.variability == "tunable"
                else "fixed parameter: it keeps its start value"
            )
            raise FiveBarError(f"'{name}' is a {what}")
        if found is None or found.causality != "input":
            raise FiveBarError(
                f"'{name}' is not an input of the FMU{similar(name, [v.name for v in self.values() if v.causality == 'input'])}"
            )
        return found


def of_unit(fmu: Path | None = None) -> Variables:
    """The variables of a packed unit, by default the shipped one."""
    file = shipped.unit() if fmu is None else fmu
    if not file.is_file():
        raise FiveBarError(f"there is no .fmu at {file}")
    stat = file.stat()
    return _read(file.resolve(), stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4)
def _read(file: Path, _changed: int, _size: int) -> Variables:
    return Variables(description(file))


def description(fmu: Path) -> "ModelDescription":
    """FMPy's model description of an .fmu. Raises FiveBarError if the file is something else."""
    import fmpy

    try:
        return fmpy.read_model_description(str(fmu), validate=False)
    except OSError:
        raise
    except Exception:  # noqa: BLE001 -- FMPy raises this class itself
        raise FiveBarError(f"{fmu} is not an .fmu: a ZIP archive with a modelDescription.xml is needed") from None


def _variable(variable: "ScalarVariable") -> Variable:
    kind: Callable[[str], Value] = {"Real": float, "Integer": int, "Enumeration": int}.get(
        variable.type, lambda text: text == "true"
    )
    declared = variable.declaredType
    items = (
        {item.name: int(item.value) for item in (declared.items or ())}
        if declared is not None and variable.type == "Enumeration"
        else {}
    )
    least, most = (
        None if bound is None or variable.type == "Enumeration" else float(bound)
        for bound in (variable.min, variable.max)
    )
    start = None if variable.start is None else kind(variable.start)
    return Variable(
        variable.name,
        variable.type,
        variable.causality,
        variable.variability or "continuous",
        unit(variable),
        start,
        least,
        most,
        items,
        variable.description or "",
    )


def unit(variable: "ScalarVariable") -> str:
    """The unit of a variable, "1" if it has none."""
    return variable.unit or getattr(variable.declaredType, "unit", None) or "1"


def _split(name: str, elements: Sequence[Variable], given: Any) -> list[Any]:
    """The values for the elements of an array."""
    given = plain(given)
    values = None if isinstance(given, (str, AbstractSet, Mapping)) or not isinstance(given, Iterable) else list(given)
    if values is None or len(values) != len(elements):
        found = "one" if values is None else len(values)
        raise FiveBarError(
            f"'{name}' has {len(elements)} elements, {elements[0].name} to {elements[-1].name}, but is given {found}"
        )
    return values


def plain(given: Any) -> Any:
    """A scalar of NumPy, also an array without dimensions, as a value of Python; all others as they are."""
    return given.item() if isinstance(given, (np.generic, np.ndarray)) and given.ndim == 0 else given


def is_number(given: Any) -> bool:
    """Whether a value is an int or a float, and no Boolean; ints beyond all floats are none."""
    is_whole = isinstance(given, int) and not isinstance(given, bool)
    return isinstance(given, float) or is_whole and abs(given) <= sys.float_info.max


def shown(value: Any) -> str:
    """A value for a message: JSON if it can be, in one line of limited length."""
    try:
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=repr)
    except (TypeError, ValueError):
        # Keys that JSON does not have, or a list that contains itself.
        text = json.dumps(repr(value), ensure_ascii=False)
    return text if len(text) <= 200 else f"{text[:200]}…"


def chosen(given: Iterable[str], known: Sequence[str]) -> list[str]:
    """The columns of `known` selected by names or prefixes; each text in `given` may have several, separated by commas."""
    found: set[str] = set()
    for name in (part.strip() for text in given for part in text.split(",")):
        meant = [name] if name in known else [other for other in known if name and other.startswith(name)]
        if not meant:
            raise FiveBarError(f"there is no column '{name}'{similar(name, [*groups(known), *known])}")
        found.update(meant)
    return [name for name in known if name in found]


def groups(names: Iterable[str]) -> dict[str, int]:
    """Prefixes of structured names, and the number of names with each prefix."""
    return dict(Counter(re.split(r"[.[]", name, maxsplit=1)[0] for name in names))


def similar(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: similar names, or else some known names."""
    names = list(known)
    more = len(names) - MOST_KNOWN
    some = f"; known are {', '.join(names[:MOST_KNOWN])}" + (f" and {more} more" if more > 0 else "")
    return meant(name, {each: each for each in names}) or some


def meant(name: str, known: Mapping[str, str]) -> str:
    """The end of a message about an unknown name: similar names, replaced by their values in `known`; "" if none is similar."""
    near = difflib.get_close_matches(str(name), known, MOST_ALIKE)
    return f"; did you mean {' or '.join(repr(known[other]) for other in near)}?" if near else ""
