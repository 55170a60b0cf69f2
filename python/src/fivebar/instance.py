"""A live instance of the unit, `Unit`, and its stored state, `State`. All code of the package that steps a unit uses them.

>>> from fivebar import Unit
>>> with Unit("fall_90_120", **{"link[1].mass": 0.02}) as unit:
...     unit["tau"] = 0.01, 0.0
...     for _ in range(100):
...         unit.step(0.001)
...     x, y = unit.get("tip.x", "tip.y")
...     print(f"at {unit.time:.3f} s the tip is at {x:.4f}, {y:.4f} {unit.units['tip.x']}")
at 0.100 s the tip is at 0.1494, 0.3183 m
"""

import threading
import weakref
from collections import deque
from collections.abc import Iterable, Mapping
from ctypes import CDLL, byref, c_double, c_size_t, c_void_p, create_string_buffer
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from fmpy import fmi2
from numpy.typing import NDArray

from fivebar import arguments
from fivebar import scene as scenes
from fivebar.errors import FiveBarError, StepFailed, UnitError
from fivebar.library import Block, Library, shared
from fivebar.log import STATUS, Message, callbacks
from fivebar.scene import Scene
from fivebar.variables import Value, Variable, Variables, shown

MESSAGES = 1000
"""Number of newest messages that a log keeps."""


class Instance:
    """An instance of the unit for co-simulation or model exchange: its calls, variables and log."""

    # Without a `__dict__`, `unit.tau = ...` in place of `unit["tau"] = ...` is an AttributeError.
    __slots__ = (
        "__weakref__", "_callbacks", "_component", "_free", "_functions", "_handles", "_lock", "library", "log",
    )  # fmt: skip

    def __init__(self, library: Library, name: str, exchange: bool = False):
        self.library = library
        self.log: deque[Message] = deque(maxlen=MESSAGES)
        self._lock = threading.RLock()
        self._functions = library.model_exchange if exchange else library.co_simulation
        self._callbacks = callbacks(self.log.append)
        self._handles: list[c_void_p] = []
        """Handles of all stored states."""

        component = self._functions.fmi2Instantiate(
            name.encode(),
            fmi2.fmi2ModelExchange if exchange else fmi2.fmi2CoSimulation,
            library.guid.encode(),
            Path(library.directory, "resources").as_uri().encode(),
            byref(self._callbacks),
            fmi2.fmi2False,
            fmi2.fmi2False,
        )
        if component is None:
            raise UnitError(self._sentence("the unit could not be instantiated"))
        self._component: int | None = component
        library.open.add(component)
        self._free = weakref.finalize(self, _free, library, self._functions, component, self._handles, self._callbacks)
        # When the process ends, another thread may still be in a call.
        self._free.atexit = False

    def __reduce__(self) -> str:
        raise TypeError(
            "a live unit cannot be pickled: send its `state().to_bytes()`, and `restore` them in a new unit"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the unit. Later calls raise FiveBarError; a second `close` does nothing.

        Examples
        --------
        >>> from fivebar import Unit
        >>> unit = Unit()
        >>> unit.close()
        """
        with self._lock:
            self._component = None
            self._free()

    def call(self, function: str, *arguments: Any) -> None:
        """Calls a C function of FMI.

        Parameters
        ----------
        function : str
            Name of the function.
        *arguments
            Its arguments after the instance, as ctypes takes them.

        Raises
        ------
        UnitError
            If its status is worse than a warning. The text is the unit's message.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.call("fmi2Terminate")
        """
        with self._lock:
            if self._component is None:
                raise FiveBarError("the unit is closed")
            status = getattr(self._functions, function)(self._component, *arguments)
            if status > fmi2.fmi2Warning:
                discarded = status == fmi2.fmi2Discard and function == "fmi2DoStep"
                raise (StepFailed if discarded else UnitError)(self._sentence(f"{function} failed: {STATUS[status]}"))

    def _sentence(self, otherwise: str) -> str:
        """The unit's newest warning or error, or `otherwise` if there is none."""
        return next((message.text for message in reversed(self.log) if message.status > fmi2.fmi2OK), otherwise)

    def update(self, values: Mapping[str, Any]) -> None:
        """Sets several variables or arrays by name, with one call for each type.

        Parameters
        ----------
        values : mapping of str to float, int, bool, str or sequence
            As for `Unit.set`.

        Raises
        ------
        FiveBarError
            If there is no such variable, or the unit refuses a value. Variables of the same type then keep their values.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.update({"tau": (0.01, 0.02), "tip.fy": -0.1})
        ...     unit.get("tau[2]", "tip.fy")
        (0.02, -0.1)
        """
        # Fast path for the inputs of every step.
        if _are_floats(values) and (reals := self.library.reals(tuple(values))):
            self.write(reals, values.values())
            return
        numbers = self._elements(values)
        given = list(numbers.values())
        for block in self.library.blocks(tuple(numbers)):
            self.write(block, [given[place] for place in block.places])

    def _elements(self, values: Mapping[str, Any]) -> dict[str, Value]:
        """Numbers of variables and of all elements of arrays, by the variable's name."""
        flat = self.library.known.flat(arguments.values("values", values))
        return {name: self.library.elements(name)[0].number(given) for name, given in flat.items()}

    def write(self, block: Block, numbers: Iterable[Value]) -> None:
        """Sets the variables of a block; enumerations are numbers.

        Parameters
        ----------
        block : Block
            Variables of one type, from `library.blocks`.
        numbers : iterable of float, int or bool
            Their values.

        Raises
        ------
        FiveBarError
            If the unit refuses a value.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     (block,) = unit.library.blocks(("tau[1]", "tau[2]"))
        ...     unit.write(block, (0.01, 0.0))
        """
        self.call(block.setter, block.references, len(block.references), block.values(*numbers))

    def read(self, block: Block) -> Any:
        """Reads the variables of a block.

        Parameters
        ----------
        block : Block
            Variables of one type, from `library.blocks`.

        Returns
        -------
        ctypes.Array
            A new array of their values.

        Raises
        ------
        FiveBarError
            If a value is not defined now.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     (block,) = unit.library.blocks(("tau[1]", "tau[2]"))
        ...     list(unit.read(block))
        [0.0, 0.0]
        """
        values = block.values()
        self.call(block.getter, block.references, len(block.references), values)
        return values

    def numbers(self, names: str | Iterable[str]) -> list[Value]:
        """Reads variables as numbers.

        Parameters
        ----------
        names : str or iterable of str
            Variables; a tuple is read fastest.

        Returns
        -------
        list of float, int or bool
            An enumeration is the number of its item, a Boolean 0 or 1.

        Raises
        ------
        FiveBarError
            If there is no such variable, or its value is not defined now.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.numbers(("solver.method", "viscous.enabled", "tau[1]"))
        [1, 0, 0.0]
        """
        if type(names) is not tuple:
            names = arguments.names("names", names)
        blocks = self.library.blocks(names)
        if len(blocks) == 1:
            return list(self.read(blocks[0]))
        found: list[Value] = [0] * len(names)
        for block in blocks:
            for place, value in zip(block.places, self.read(block), strict=True):
                found[place] = value
        return found

    def floats(self, names: str | Iterable[str]) -> dict[str, float]:
        """Reads variables as floats.

        Parameters
        ----------
        names : str or iterable of str
            Variables; a tuple is read fastest.

        Returns
        -------
        dict of str to float
            Values by name; an enumeration is the number of its item.

        Raises
        ------
        FiveBarError
            If there is no such variable, or its value is not defined now.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.floats(("tau[1]", "tau[2]"))
        {'tau[1]': 0.0, 'tau[2]': 0.0}
        """
        if type(names) is not tuple:
            names = arguments.names("names", names)
        return dict(zip(names, map(float, self.numbers(names)), strict=True))

    def initialise(self, time: float) -> None:
        """Initialises a unit that was instantiated or reset by a call; `Unit.reset` does it with start values.

        Parameters
        ----------
        time : float
            Start time, s.

        Raises
        ------
        FiveBarError
            If the unit refuses its start.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.call("fmi2Reset")
        ...     unit.initialise(0.0)
        """
        self.call("fmi2SetupExperiment", fmi2.fmi2False, 0.0, time, fmi2.fmi2False, 0.0)
        self.call("fmi2EnterInitializationMode")
        self.call("fmi2ExitInitializationMode")


class Unit(Instance):
    """A live unit: start it, set inputs, step, read outputs.

    A new unit is initialised at time 0 s. `close` or the end of a `with` block frees it. Names, units, types and enumerations
    are the same as in the model description. A name without index is the whole array: `theta` is `theta[1]` and `theta[2]`.

    Threads: calls of one unit wait for each other, and different units run in parallel. A sequence of calls, such as a step
    and a reading after it, is not guarded. Fork: parent and child continue with separate copies of the unit, if no thread was
    in a call. In a pool of processes, each worker should make its own unit.

    `log` has the newest 1000 messages (`status`, `category`, `text`), the newest last; it may be cleared. Messages also go to
    the logger `fivebar.unit`: warnings with level WARNING, all others with DEBUG, since a failed call raises its message.

    Parameters
    ----------
    scene : str, pathlib.Path or fivebar.scene.Scene, optional
        The name of a shipped scene, the file of a scene, or a scene. The default are the unit's own start values.
        Time-varying inputs of the scene have their first values. A scene that names no method runs by `automatic`, as in `fivebar.run`;
        without a scene the method is the unit's own, `i3alp`.
    **values : float, int, bool, str or sequence
        Start values by name, in the variable's unit; they replace values of the scene. They are set before initialisation.

    Raises
    ------
    FiveBarError
        If the scene or a name is unknown, or the unit refuses a value or the start. The text is one sentence.

    Warns
    -----
    MachineWarning
        If the start values make a link impossible, look like degrees or millimetres, or belong to an effect that is off.

    Examples
    --------
    >>> from fivebar import Unit
    >>> with Unit(**{"init.theta": (1.2, 2.0), "solver.method": "automatic"}) as unit:
    ...     unit.step(0.5)
    ...     unit["theta"].shape, unit["solver.method"]
    ((2,), 'automatic')
    """

    __slots__ = ("_given", "_scene", "_spare", "_time")

    def __init__(self, scene: "str | Path | Scene | None" = None, **values: Any):
        library = shared()
        read = scene if scene is None or isinstance(scene, Scene) else scenes.read(scene, library.known)
        self._open(library, "unit", read, values)
        try:
            if read is not None:
                # Gives the warnings; a later reset is silent.
                read.replace(self._start_values(values))
            self.reset()
        except BaseException:
            self.close()
            raise
        if read is None:
            elements = self._elements(values)
            scenes.warn_of("unit", library.known, [elements], {}, elements)

    @classmethod
    def of(cls, library: "Library | str | Path", name: str = "unit") -> Self:
        """A unit of any .fmu that `fivebar.unit` makes. It is not yet initialised: call `reset` or `restore` first.

        Parameters
        ----------
        library : str, pathlib.Path or Library
            The .fmu, or its extracted library.
        name : str, optional
            Name of the instance in messages.

        Returns
        -------
        Unit
            The unit.

        Raises
        ------
        FiveBarError
            If there is no such .fmu, or it cannot be instantiated.

        Examples
        --------
        >>> import fivebar
        >>> with fivebar.Unit.of(fivebar.unit()) as unit:
        ...     unit.reset()
        """
        if not isinstance(library, (Library, str, Path)):
            raise FiveBarError(f"'library' must be the path of an .fmu or a Library, not {shown(library)}")
        library = library if isinstance(library, Library) else shared(Path(library))
        unit = cls.__new__(cls)
        unit._open(library, name, None, {})
        return unit

    def _open(self, library: Library, name: str, scene: Scene | None, given: Mapping[str, Any]) -> None:
        Instance.__init__(self, library, name)
        self._scene, self._given = scene, given
        self._time = 0.0
        self._spare: list[c_void_p] = []
        """Handles of states that are no longer referenced; new states overwrite them."""

    def __repr__(self) -> str:
        scene = "" if self._scene is None else f" of {self._scene.name}"
        return f"<fivebar.Unit{scene}, {'closed' if self._component is None else f'at {self._time:g} s'}>"

    # --- variables --------------------------------------------------------------------------------------------------------------

    @property
    def variables(self) -> Variables:
        """All variables by name, each with type, causality, unit, start value, bounds and items.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.variables["friction.law"].items
        {'smooth': 1, 'stick': 2}
        """
        return self.library.known

    @property
    def units(self) -> Mapping[str, str]:
        """Units of variables and arrays by name; "1" if a variable has no unit.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.units["tau"], unit.units["tip.vx"]
        ('N.m', 'm/s')
        """
        return self.library.units

    def set(self, name: str, value: Any) -> None:
        """Sets a parameter or an input; `unit[name] = value` is the same.

        Parameters
        ----------
        name : str
            A variable, or an array without its index.
        value : float, int, bool, str or sequence
            The value in the variable's unit. An enumeration is given as name or number of an item, an array as a sequence of
            all elements.

        Raises
        ------
        FiveBarError
            If there is no such variable, the value has the wrong type, or the unit refuses it. For example, fixed parameters
            cannot change after initialisation.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit(**{"viscous.enabled": True}) as unit:
        ...     unit.set("tau[1]", 0.02)
        ...     unit["viscous.b"] = [1e-3] * 5
        """
        self.update({name: value})

    def __setitem__(self, name: str, value: Any) -> None:
        self.update({name: value})

    def get(self, *names: str) -> Any:
        """Reads variables, with one call for each type; `unit[name]` is the same for one name.

        Parameters
        ----------
        *names : str
            Variables, or arrays without their index.

        Returns
        -------
        float, int, bool, str, numpy.ndarray, or a tuple of them
            The value of one name, or a tuple of values in the order of the names, in the variables' units. An enumeration is the
            name of its item; an array of n elements has the shape (n,) and is read-only.

        Raises
        ------
        FiveBarError
            If there is no such variable, or its value is not defined now.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit("fall_90_120") as unit:
        ...     unit.get("tip.x", "singular.type"), unit.get("omega")
        ((0.1697..., 'none'), array([0., 0.]))
        """
        parts = [self.library.elements(name) for name in names]
        numbers = iter(self.numbers(tuple(variable.name for part in parts for variable in part)))
        found: list[Any] = []
        for name, part in zip(names, parts, strict=True):
            if len(part) == 1 and part[0].name == name:
                found.append(_value(part[0], next(numbers)))
            else:
                values = np.array([next(numbers) for _ in part])
                # A change of this copy would not reach the unit.
                values.flags.writeable = False
                found.append(values)
        return found[0] if len(names) == 1 else tuple(found)

    def __getitem__(self, name: str) -> Any:
        return self.get(name)

    def __contains__(self, name: object) -> bool:
        return name in self.library.known or name in self.library.known.arrays

    def ramp(self, rates: Mapping[str, Any]) -> None:
        """Lets inputs change linearly during the next step; after it they are constant again.

        Parameters
        ----------
        rates : mapping of str to float or sequence of float
            First derivatives of inputs by name, in the input's unit per second; of an array the derivatives of all elements.

        Raises
        ------
        FiveBarError
            If a variable is not a Real input: only these have derivatives.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.ramp({"tau[1]": 0.5})
        ...     unit.step(0.01)
        ...     unit["tau[1]"]
        0.005
        """
        # Fast path for the rates of every step.
        if _are_floats(rates) and (inputs := self.library.reals(tuple(rates), inputs=True)):
            self.write_rates(inputs, rates.values())
            return
        numbers = self._elements(rates)
        for name in numbers:
            if (found := self.library.known[name]).type != "Real" or found.causality != "input":
                raise FiveBarError(f"'{name}' is not a Real input: only Real inputs have rates")
        for block in self.library.blocks(tuple(numbers)):
            self.write_rates(block, numbers.values())

    def write_rates(self, block: Block, rates: Iterable[float]) -> None:
        """Sets the first derivatives of a block of inputs for the next step.

        Parameters
        ----------
        block : Block
            Real inputs, from `library.blocks`.
        rates : iterable of float
            Derivatives, in the input's unit per second.

        Raises
        ------
        FiveBarError
            If the unit refuses them.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     (block,) = unit.library.blocks(("tau[1]", "tau[2]"))
        ...     unit.write_rates(block, (0.5, 0.0))
        """
        count = len(block.references)
        self.call("fmi2SetRealInputDerivatives", block.references, count, block.orders, block.values(*rates))

    def derivative(self, unknowns: "str | Iterable[str]", knowns: "str | Iterable[str]") -> NDArray[np.float64]:
        """Directional derivatives of the unit, exact to round-off.

        Parameters
        ----------
        unknowns : str or iterable of str
            Computed variables, or arrays without their index, with n elements in total.
        knowns : str or iterable of str
            Inputs and states (`theta`, `omega`), with m elements in total.

        Returns
        -------
        numpy.ndarray
            Derivative of each unknown with respect to each known, shape (n, m), in the unit of the unknown per unit of the known.

        Raises
        ------
        FiveBarError
            If the unit has no such derivative, or if it is undefined in this state: at a direct singularity the motor angles are
            not coordinates.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.derivative(["alpha", "tip.ax"], "tau").shape
        (3, 2)
        """
        of, by = self._references("unknowns", unknowns), self._references("knowns", knowns)
        found = np.empty((len(of), len(by)))
        one, column = (c_double * 1)(1.0), (c_double * len(of))()
        for j, reference in enumerate(by):
            known = (fmi2.fmi2ValueReference * 1)(reference)
            self.call("fmi2GetDirectionalDerivative", of, len(of), known, 1, one, column)
            found[:, j] = column
        return found

    def _references(self, what: str, names: "str | Iterable[str]") -> Any:
        elements = [v for name in arguments.names(what, names) for v in self.library.elements(name)]
        return (fmi2.fmi2ValueReference * len(elements))(
            *(self.library.variables[v.name].valueReference for v in elements)
        )

    # --- time -------------------------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """The current communication point, s."""
        return self._time

    def step(self, h: float) -> None:
        """Makes one communication step.

        A step is one call of the library, and Ctrl-C acts after it. `fivebar.run` steps from one communication point to the next, so it can
        be interrupted at once.

        Parameters
        ----------
        h : float
            Step length, s. The unit divides it into sub-steps as its method needs.

        Raises
        ------
        StepFailed
            If the step fails. The unit keeps its state before the step.
        FiveBarError
            If the unit refuses the call, for example because the length is not positive.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.step(0.25)
        ...     unit.time
        0.25
        """
        h = arguments.number("h", h)
        with self._lock:
            self._step(h, self._time + h)

    def step_to(self, time: float) -> None:
        """Makes one communication step to a time.

        Parameters
        ----------
        time : float
            The next communication point, s.

        Raises
        ------
        StepFailed, FiveBarError
            As `step`.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.step_to(0.1)
        """
        time = arguments.number("time", time)
        with self._lock:
            self._step(time - self._time, time)

    def _step(self, h: float, end: float) -> None:
        self.call("fmi2DoStep", self._time, h, fmi2.fmi2True)
        self._time = end

    def reset(self, time: float = 0.0, **values: Any) -> None:
        """Restarts the unit from its scene and the values given to its constructor.

        Parameters
        ----------
        time : float, optional
            Start time, s.
        **values : float, int, bool, str or sequence
            Start values for this start only; they replace or complete the others.

        Raises
        ------
        FiveBarError
            If a value or the start is refused. The unit is then not initialised: reset it again.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit(**{"init.theta[1]": 1.2}) as unit:
        ...     unit.step(0.1)
        ...     unit.reset(time=5.0, **{"init.theta[2]": 2.0})
        ...     unit.time, unit["theta"]
        (5.0, array([1.2, 2. ]))
        """
        time = arguments.number("time", time)
        given = {name: value for name, value in self._given.items() if name not in values} | values
        if self._scene is not None:
            given = self._of_scene(self._scene, given)
        with self._lock:
            self.call("fmi2Reset")
            self.update(given)
            self.initialise(time)
            self._time = time

    def _start_values(self, given: Mapping[str, Any]) -> dict[str, Value | str]:
        """Given values by the names of variables, as for a scene."""
        return {name: _value(self.library.known[name], number) for name, number in self._elements(given).items()}

    def _of_scene(self, scene: Scene, given: Mapping[str, Any]) -> dict[str, Value]:
        """Start values of a scene with changed values. If the start is given by the tip position, its angles follow the lengths."""
        changed = scene._changed(self._start_values(given)).with_method()
        return dict(changed.values) | {name: float(column[0]) for name, column in changed.signals.items()}

    # --- states -----------------------------------------------------------------------------------------------------------------

    def state(self) -> "State":
        """Stores the whole state and the time, in a few microseconds.

        Returns
        -------
        State
            The stored state, for `restore` of this unit or, while this unit is open, of another one.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     now = unit.state()
        ...     unit.step(0.5)
        ...     unit.restore(now)
        ...     unit.time
        0.0
        """
        with self._lock:
            handle = self._spare.pop() if self._spare else self._new_handle()
            self.call("fmi2GetFMUstate", byref(handle))
            return State(self, handle, self._time)

    def restore(self, state: "State | bytes", time: float | None = None) -> None:
        """Restores a stored state; the results that follow are the same to the bit.

        Parameters
        ----------
        state : State or bytes
            A state from `state`, or its bytes, also from another process or computer.
        time : float, optional
            Communication point, s; needed if it was not counted by `step`. The default is the time of the state.

        Raises
        ------
        FiveBarError
            If the bytes have changed, or the state belongs to another unit. The unit then keeps its state.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit("haptic") as unit:
        ...     unit.step(0.1)
        ...     content = unit.state().to_bytes()
        >>> with Unit() as another:
        ...     another.restore(content)
        ...     another.time
        0.1
        """
        time = None if time is None else arguments.number("time", time)
        if isinstance(state, State):
            state._check()
            with self._lock:
                self.call("fmi2SetFMUstate", state._handle)
                self._time = state.time if time is None else time
            return
        if not isinstance(state, (bytes, bytearray, memoryview)):
            raise FiveBarError(f"'state' must be a State or its bytes, not {shown(state)}")
        with self._lock:
            handle = self._spare.pop() if self._spare else self._new_handle()
            try:
                stored = bytes(state)
                content = create_string_buffer(stored, len(stored))
                self.call("fmi2DeSerializeFMUstate", content, len(stored), byref(handle))
                self.call("fmi2SetFMUstate", handle)
            finally:
                self._spare.append(handle)
            reached = c_double()
            self.call("fmi2GetRealStatus", fmi2.fmi2LastSuccessfulTime, byref(reached))
            self._time = reached.value if time is None else time

    def _new_handle(self) -> c_void_p:
        handle = c_void_p()
        self._handles.append(handle)
        return handle


class State:
    """A stored state of a unit, made by `Unit.state`. Each takes some kilobytes, and its memory is reused after the last reference.

    It is valid until the unit that made it is closed; its bytes remain valid.

    Examples
    --------
    >>> from fivebar import Unit
    >>> with Unit() as unit:
    ...     state = unit.state()
    ...     state.time, type(state.to_bytes())
    (0.0, <class 'bytes'>)
    """

    def __init__(self, unit: Unit, handle: c_void_p, time: float):
        self._unit, self._handle, self._time = unit, handle, time

    def __del__(self) -> None:
        # The garbage collector may run this during a call of the unit, so it must not call the unit.
        self._unit._spare.append(self._handle)

    def __reduce__(self) -> str:
        raise TypeError("a state cannot be pickled: send its `to_bytes()`, and `restore` them in another unit")

    @property
    def time(self) -> float:
        """Time of the state, s."""
        return self._time

    def _check(self) -> None:
        if self._unit._component is None:
            raise FiveBarError("the unit that stored the state is closed; only bytes made before that remain valid")

    def to_bytes(self) -> bytes:
        """The state as bytes, for a file, another process or another computer. They contain the unit's GUID and a checksum.

        Returns
        -------
        bytes
            The bytes, for `Unit.restore`.

        Raises
        ------
        FiveBarError
            If the unit is closed.

        Examples
        --------
        >>> from fivebar import Unit
        >>> with Unit() as unit:
        ...     unit.restore(unit.state().to_bytes())
        """
        self._check()
        size = c_size_t()
        self._unit.call("fmi2SerializedFMUstateSize", self._handle, byref(size))
        content = create_string_buffer(size.value)
        self._unit.call("fmi2SerializeFMUstate", self._handle, content, size)
        return content.raw


def _are_floats(values: Any) -> bool:
    """Whether these are floats by name, which need no conversion."""
    return type(values) is dict and all(type(value) is float for value in values.values())


def _value(variable: Variable, number: Value) -> Value | str:
    """The Python value of a variable from its number in a call."""
    if variable.type == "Enumeration":
        return variable.item(int(number))
    return bool(number) if variable.type == "Boolean" else number


def _free(
    library: Library, functions: CDLL, component: int, handles: list[c_void_p], _callbacks: fmi2.fmi2CallbackFunctions
) -> None:
    """Frees an instance and its stored states. The argument `_callbacks` keeps the callbacks alive until this call."""
    for handle in handles:
        functions.fmi2FreeFMUstate(component, byref(handle))
    functions.fmi2FreeInstance(component)
    library.open.discard(component)
