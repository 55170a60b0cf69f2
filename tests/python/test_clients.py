"""Every available master runs the same fall with the unit and must end with the same bits as FMPy.

The communication step is on the unit's grid, so that a master's clock does not matter. Each test imports its master, because only the
full form of the tests installs them.
"""

import csv
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest
from fmpy.model_description import ModelDescription

from conftest import Unit
from instance import Instance, Log, Values, computed, get_values, instantiate, set_values

New = Callable[..., Instance]

SIZE, STEPS = 0.01, 100
STOP = SIZE * STEPS
FALL: Values = {"init.theta[2]": 2.0943951023931953}

# The partner of two robots: its servo holds the posture of the other.
FOLLOWER: Values = {**FALL, "servo.enabled": True, "servo.kp[1]": 20.0, "servo.kp[2]": 20.0}
WIRES = [(f"{sent}[{leg}]", f"servo.{sent}[{leg}]") for sent in ("theta", "omega") for leg in (1, 2)]


@pytest.fixture(scope="module")
def reals(model: ModelDescription) -> list[str]:
    """Names of all computed Reals."""
    return [v.name for v in computed(model) if v.type == "Real"]


@pytest.fixture(scope="module")
def references(model: ModelDescription) -> dict[str, int]:
    """The value reference of every variable."""
    return {v.name: v.valueReference for v in model.modelVariables}


@pytest.fixture
def expected(new: New, reals: list[str]) -> list[float]:
    """Their values at the end of the fall, through FMPy."""
    instance = new().initialise(FALL)
    instance.steps(STEPS, SIZE)
    return [instance.get(name) for name in reals]


@pytest.fixture
def expected_outputs(reals: list[str], expected: list[float], outputs: list[str]) -> list[float]:
    """The outputs among them."""
    values = dict(zip(reals, expected, strict=True))
    return [values[name] for name in outputs]


def program(name: str) -> str:
    """A program of this Python environment."""
    return str(Path(sys.executable).parent / name)


@pytest.mark.full
def test_fmuloader(
    directory: str,
    model: ModelDescription,
    references: dict[str, int],
    reals: list[str],
    expected: list[float],
) -> None:
    """Every call by hand, without memory callbacks; a second run after a reset."""
    from fmuloader.fmi2 import Fmi2Slave, Fmi2Type

    with Fmi2Slave(directory, model_identifier=model.coSimulation.modelIdentifier) as slave:
        assert (slave.get_version(), slave.get_types_platform()) == ("2.0", "default")
        slave.instantiate(
            "fmuloader", Fmi2Type.CO_SIMULATION, guid=model.guid, cannot_use_memory_management_functions=True
        )
        for _ in range(2):
            slave.set_real([references[name] for name in FALL], list(FALL.values()))
            slave.setup_experiment(0.0, STOP)
            slave.enter_initialization_mode()
            slave.exit_initialization_mode()
            for i in range(STEPS):
                slave.do_step(i * SIZE, SIZE)
            assert slave.get_real([references[name] for name in reals]) == expected
            slave.terminate()
            slave.reset()


@pytest.mark.full
def test_libcosim(fmu: Path, references: dict[str, int], reals: list[str], expected: list[float]) -> None:
    """A C++ master with time as a whole number of nanoseconds."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(SIZE * 1e9))
    slave = execution.add_local_slave(CosimLocalSlave(str(fmu), "fall"))
    for name, value in FALL.items():
        assert execution.real_initial_value(slave, references[name], value)
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    assert execution.step(STEPS)
    assert list(observer.last_real_values(slave, [references[name] for name in reals])) == expected


@pytest.mark.full
def test_two_robots_in_one_libcosim_system(fmu: Path, references: dict[str, int], reals: list[str], new: New) -> None:
    """One robot falls, a servo-driven partner follows it. Reference: two instances connected by a loop in Python, bit for bit."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    size, steps = 0.001, 300
    execution = CosimExecution.from_step_size(round(size * 1e9))
    leader, follower = (execution.add_local_slave(CosimLocalSlave(str(fmu), name)) for name in ("leader", "follower"))
    for slave, values in ((leader, FALL), (follower, FOLLOWER)):
        for name, value in values.items():
            setter = execution.boolean_initial_value if isinstance(value, bool) else execution.real_initial_value
            assert setter(slave, references[name], value)
    for source, sink in WIRES:
        assert execution.connect_real_variables(leader, references[source], follower, references[sink]) == 0
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    assert execution.step(steps)
    found = [
        list(observer.last_real_values(slave, [references[name] for name in reals])) for slave in (leader, follower)
    ]

    first, second = new("leader"), new("follower")
    for instance, values in ((first, FALL), (second, FOLLOWER)):
        instance.set(values)
        instance.enter()
    for step in range(steps + 1):
        second.set({sink: first.get(source) for source, sink in WIRES})
        for instance in (first, second):
            if step == 0:
                instance.slave.exitInitializationMode()
            else:
                instance.slave.doStep((step - 1) * size, size)
    assert found == [[instance.get(name) for name in reals] for instance in (first, second)]
    # The partner follows its setpoint with a lag, because its gain is finite: 0.05 rad, while the fall moves 1 rad.
    for leg in (1, 2):
        assert abs(second.get(f"theta[{leg}]") - first.get(f"theta[{leg}]")) < 0.05
        assert abs(first.get(f"theta[{leg}]") - first.get("init.theta[1]")) > 0.5


@pytest.mark.full
def test_two_units_of_different_names_in_one_libcosim_system(
    fmu: Path, own: Unit, new: New, new_own: New, outputs: list[str]
) -> None:
    """The plain unit and a custom unit push each other; libcosim cannot set method and assembly of the custom unit, which are enumerations.
    Reference: two instances connected by a loop in Python, bit for bit."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    size, steps = 0.002, 200
    wires = [("tip.x", "tip.fx"), ("tip.y", "tip.fy")]
    reference = {v.name: v.valueReference for v in own.model.modelVariables}
    execution = CosimExecution.from_step_size(round(size * 1e9))
    slaves = [execution.add_local_slave(CosimLocalSlave(str(file), file.stem)) for file in (fmu, own.fmu)]
    for here, there in (slaves, slaves[::-1]):
        for source, sink in wires:
            assert execution.connect_real_variables(here, reference[source], there, reference[sink]) == 0
    assert execution.real_initial_value(slaves[0], reference["init.theta[2]"], FALL["init.theta[2]"])
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    assert execution.step(steps)
    found = [list(observer.last_real_values(slave, [reference[name] for name in outputs])) for slave in slaves]

    pair = (new(), new_own())
    pair[0].set(FALL)
    for instance in pair:
        instance.enter()
    for step in range(steps + 1):
        passed = [{sink: instance.get(source) for source, sink in wires} for instance in pair]
        for instance, values in zip(pair, passed[::-1], strict=True):
            instance.set(values)
            if step == 0:
                instance.slave.exitInitializationMode()
            else:
                instance.slave.doStep((step - 1) * size, size)
    assert found == [[instance.get(name) for name in outputs] for instance in pair]


@pytest.mark.full
@pytest.mark.parametrize("which", ["plain", "own"])
def test_pathsim(which: str, fmu: Path, own: Unit, new: New, new_own: New, outputs: list[str]) -> None:
    """A block diagram in Python, which reads every output as a Real and plots it."""
    import pathsim

    size = 0.01
    with warnings.catch_warnings():
        # PathSim warns that the block will move to a package of its own.
        warnings.simplefilter("ignore", DeprecationWarning)
        unit = pathsim.blocks.CoSimulationFMU(str(fmu if which == "plain" else own.fmu), start_values=FALL, dt=size)
    torque, scope = pathsim.blocks.Constant(0.02), pathsim.blocks.Scope(labels=["tip.x"])
    connections = [pathsim.Connection(torque, unit["tau[1]"]), pathsim.Connection(unit["tip.x"], scope)]
    simulation = pathsim.Simulation([torque, unit, scope], connections, dt=size, log=False)
    simulation.run(0.5)
    time, (drawn,) = scope.read()
    found = dict(zip(unit.fmu_wrapper.output_refs, unit.outputs.to_array(), strict=True))

    instance = (new if which == "plain" else new_own)().initialise(FALL)
    inputs = {v.name: 0.0 for v in instance.model.modelVariables if v.causality == "input"}
    course = []
    # The master already steps at 0 s, and sets every input, to 0 if not connected.
    for step in range(51):
        instance.set(inputs | {"tau[1]": 0.02})
        instance.slave.doStep(step * size, size)
        course.append(instance.get("tip.x"))
    assert found == {name: instance.get(name) for name in outputs}
    assert len(time) == 51 and list(drawn) == course


COFMUPY = """
import json, sys
from cofmupy import Coordinator
coordinator = Coordinator()
coordinator.start(sys.argv[1])
for _ in range(int(sys.argv[2])):
    coordinator.do_step(float(sys.argv[3]))
results = coordinator.get_results()
print(json.dumps({unit: {name: values[-1] for (of, name), values in ((k, v) for k, v in results.items() if k != "time") if of == unit}
                  for unit in ("plain", "own")}))
"""


@pytest.mark.full
def test_cofmupy(fmu: Path, own: Unit, new: New, new_own: New, outputs: list[str], tmp_path: Path) -> None:
    """In a master for digital twins, which sets and reads only Reals, the plain unit pushes the tip of a custom unit."""
    steps, size = 50, 0.01
    unit = {"plain": (fmu, FALL), "own": (own.fmu, {})}
    wire = {"source": {"id": "plain", "variable": "tip.x"}, "target": {"id": "own", "variable": "tip.fx"}}
    configuration = {
        "fmus": [{"id": name, "path": str(path), "initialization": values} for name, (path, values) in unit.items()],
        "connections": [wire],
        "cosim_method": "jacobi",
        "iterative": False,
    }
    (tmp_path / "system.json").write_text(json.dumps(configuration))
    command = [sys.executable, "-c", COFMUPY, str(tmp_path / "system.json"), str(steps), repr(size)]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.environ["COFMUPY"]},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])

    # The master starts with 0 at every input, and steps the pushed unit after the pushing one.
    inputs = {v.name: 0.0 for v in own.model.modelVariables if v.causality == "input"}
    plain, mine = new().initialise(FALL | inputs), new_own().initialise(inputs)
    for step in range(steps):
        plain.slave.doStep(step * size, size)
        mine.set({"tip.fx": plain.get("tip.x")})
        mine.slave.doStep(step * size, size)
    for name, instance in (("plain", plain), ("own", mine)):
        assert found[name] == {output: instance.get(output) for output in outputs}, name


@pytest.mark.full
def test_ecos(fmu: Path, reals: list[str], expected: list[float]) -> None:
    """A C++ master with an accumulating clock, and with reset."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        structure.add_model("fall", fmu)
        assert structure.add_parameter_set("start", {f"fall::{name}": value for name, value in FALL.items()})
        with EcosSimulation(structure=structure, step_size=SIZE) as simulation:
            for _ in range(2):
                assert simulation.init(parameter_set="start")
                simulation.step(STEPS)
                assert [simulation.get_real(f"fall::{name}") for name in reals] == expected
                simulation.reset()
            simulation.terminate()


@pytest.mark.full
def test_ecos_runs_a_unit_of_one_s_own_with_nothing_set(own: Unit, new_own: New, reals: list[str]) -> None:
    """This master cannot set enumerations, but the unit has its own; the run is repeated after a reset."""
    from ecospy import EcosSimulation, EcosSimulationStructure

    instance = new_own().initialise()
    instance.steps(STEPS, SIZE)
    with EcosSimulationStructure() as structure:
        structure.add_model("mine", own.fmu)
        with EcosSimulation(structure=structure, step_size=SIZE) as simulation:
            for _ in range(2):
                assert simulation.init()
                simulation.step(STEPS)
                assert [simulation.get_real(f"mine::{name}") for name in reals] == [
                    instance.get(name) for name in reals
                ]
                simulation.reset()
            simulation.terminate()


@pytest.mark.full
def test_fmutool_finds_no_problem(fmu: Path) -> None:
    done = subprocess.run(
        [program("fmutool"), "-input", str(fmu), "-check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.full
def test_fmucontainer(fmu: Path, tmp_path: Path, outputs: list[str], expected_outputs: list[float]) -> None:
    """A container with the unit inside, with a master in C, is a unit with the same results."""
    container = {
        "name": "container.fmu",
        "fmu": [fmu.name],
        "step_size": SIZE,
        "start": [[fmu.name, name, value] for name, value in FALL.items()],
    }
    (tmp_path / "container.json").write_text(json.dumps(container))
    (tmp_path / fmu.name).symlink_to(fmu)
    command = [program("fmucontainer"), "-fmu-directory", str(tmp_path), "-container", "container.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout

    directory = fmpy.extract(str(tmp_path / "container.fmu"), unzipdir=str(tmp_path / "container"))
    model = fmpy.read_model_description(directory)
    slave = instantiate(model, directory, Log(), "container")
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i in range(STEPS):
        slave.doStep(i * SIZE, SIZE)
    assert list(get_values(slave, model, outputs).values()) == expected_outputs
    slave.terminate()
    slave.freeInstance()


def fall_from(directory: str, angle: float) -> list[float]:
    """Tip and energy after a fall from `angle`: a complete task for a scheduler."""
    model = fmpy.read_model_description(directory)
    slave = instantiate(model, directory, Log(), f"fall from {angle}")
    set_values(slave, model, {"init.theta[2]": angle})
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i in range(STEPS):
        slave.doStep(i * SIZE, SIZE)
    values = get_values(slave, model, ["tip.x", "tip.y", "energy.kinetic"])
    slave.terminate()
    slave.freeInstance()
    return list(values.values())


@pytest.mark.full
@pytest.mark.parametrize("scheduler", ["threads", "processes"])
def test_dask(directory: str, scheduler: str) -> None:
    """Parallel instances do not influence each other."""
    import dask

    angles = [1.6 + 0.1 * i for i in range(16)]
    tasks = [dask.delayed(fall_from)(directory, angle) for angle in angles]
    assert list(dask.compute(*tasks, scheduler=scheduler, num_workers=4)) == [
        fall_from(directory, angle) for angle in angles
    ]


def by_fmi_sim(fmu: Path, folder: Path, outputs: list[str], values: Values) -> list[float]:
    """Outputs at the end of a run by a master in Rust with its own XML reader; its table has the shortest text of each number."""
    command = [os.environ["FMI_SIM"], "--model", str(fmu), "--output-file", "out.csv", "co-simulation"]
    command += ["-s", "0", "-f", repr(STOP), "--step", repr(SIZE), "--output-interval", repr(SIZE)]
    command += [f"--init-values={name}={value!r}" for name, value in values.items()]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with (folder / "out.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    return [float(last[name]) for name in outputs]


@pytest.mark.fmi_sim
def test_fmi_sim(fmu: Path, tmp_path: Path, outputs: list[str], expected_outputs: list[float]) -> None:
    assert by_fmi_sim(fmu, tmp_path, outputs, FALL) == expected_outputs


@pytest.mark.fmi_sim
def test_fmi_sim_runs_a_unit_of_one_s_own_with_nothing_set(
    own: Unit, tmp_path: Path, outputs: list[str], new_own: New
) -> None:
    instance = new_own().initialise()
    instance.steps(STEPS, SIZE)
    assert by_fmi_sim(own.fmu, tmp_path, outputs, {}) == [instance.get(name) for name in outputs]
