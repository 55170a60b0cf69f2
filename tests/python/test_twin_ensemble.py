"""`fivebar ensemble` and `what-if`: members are equal wherever they run, even if workers die; commands are compared from a state."""

import base64
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster
from distributed.comm import CommClosedError

from conftest import PATIENCE, wait_until
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.twin.ensemble import command, results, rows, what_if
from fivebar.twin.ensemble.cluster import Cluster
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.ensemble.processes import Chunk, Done, Processes
from fivebar.twin.errors import TwinError
from fivebar.twin.forecast import Forecaster
from fivebar.twin.messages import Message, decode, encode
from fivebar.twin.soak import configured, machine
from fivebar.twin.starter import free_port
from twin_support import follower

FALL = {"init.theta[2]": 2.0943951023931953}
PLAN = Plan(values=FALL, seconds=0.5, points=10, seed=3, spreads={"theta[1]": 2e-3, "link[1,4].mass": 0.01})


def test_bytes_of_a_unit_have_their_own_time(fmu: Path, tmp_path: Path) -> None:
    """A member that restores the stored state continues from the time of that state."""
    library = Library(fmu)
    with Unit.of(library) as unit:
        unit.reset(**{"payload.enabled": True, "payload.mass": 0.1})
        unit.step_to(0.25)
        (tmp_path / "unit.state").write_bytes(unit.state().to_bytes())
    library.close()
    vary = ("payload.mass=5%",)
    options = command.Options(2, "swing", tmp_path / "unit.state", vary, 0.05, 2, 0, 0, None, False, fmu, tmp_path)
    _, plan, _ = command.plan_of(options)
    assert plan.clock == 0.25
    assert command.run(options) == 0


def test_members_do_not_depend_on_others(fmu: Path) -> None:
    """A member gives the same result alone and after others, and its singularity is at the time at which the unit counts it."""
    library = Library(fmu)
    first, second = Runner(library, PLAN), Runner(library, PLAN)
    first.run(4)
    a, b = first.run(7), second.run(7)
    assert (
        a["drawn"] == b["drawn"] and a["singular.time"] == b["singular.time"] and np.array_equal(a["shown"], b["shown"])
    )
    unit = Unit.of(library)
    values = {"init.theta[1]": a["drawn"]["theta[1]"], "solver.method": 4, **FALL}
    for leg in (1, 4):
        values |= {
            f"link[{leg}].mass": 0.017 * a["drawn"]["link[1,4].mass"],
            f"link[{leg}].inertia": 6.23e-5 * a["drawn"]["link[1,4].mass"],
        }
    unit.reset(**values)
    # Within 50 us, a thousandth of a step of 50 ms.
    for time, passed in ((a["singular.time"] - 5e-5, 0), (a["singular.time"] + 5e-5, 1)):
        unit.step_to(time)
        assert unit["singular.passes.inverse[2]"] == passed and a["singular.kind"] == 3
    unit.close()
    first.close()
    second.close()
    library.close()


def test_draws_below_the_least_value_are_counted(fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A standard deviation of 60 % makes one mass of twenty negative. Such draws are raised to 0.02 and counted."""
    options = command.Options(200, "fall_90_120", None, ("link.mass=60%",), 0.05, 2, 0, 0, None, False, fmu, tmp_path)
    assert command.run(options) == 0
    drawn = pq.read_table(tmp_path / "members.parquet")["drawn.link.mass"].to_numpy()
    count = int((drawn == 0.02).sum())
    assert (
        3 <= count <= 25 and f"link.mass: {count} of 200 draws were below 0.02 of the value" in capsys.readouterr().out
    )


@pytest.fixture
def dask_cluster() -> Iterator[Callable[[], Cluster]]:
    """A Dask scheduler and two workers on this machine."""
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as made:
        yield lambda: Cluster(made.scheduler_address)


MEMBERS = 800


@pytest.fixture(scope="module")
def alone(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The members as one process writes them."""
    file = tmp_path_factory.mktemp("alone") / "alone.parquet"
    results.write(file, PLAN, rows.alone(fmu.read_bytes(), PLAN, MEMBERS), lambda _: None)
    return file


@pytest.mark.parametrize("kind", ["processes", "cluster"])
def test_a_killed_worker_loses_nothing(
    kind: str, fmu: Path, alone: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Two workers, one killed during the run, give the bytes of one process."""
    workers = Processes(2) if kind == "processes" else request.getfixturevalue("dask_cluster")()
    killed: list[int] = []

    def kill(done: int) -> None:
        if done >= MEMBERS // 3 and not killed:
            ids = list(workers.client.run(os.getpid).values()) if kind == "cluster" else list(workers.pool._processes)
            killed.append(ids[0])
            os.kill(killed[0], signal.SIGKILL)

    with closing(workers):
        results.write(tmp_path / "workers.parquet", PLAN, workers.tables(fmu.read_bytes(), PLAN, MEMBERS), kill)
    assert killed and (tmp_path / "workers.parquet").read_bytes() == alone.read_bytes()
    file = pq.ParquetFile(alone)
    assert file.metadata.num_rows == MEMBERS and file.metadata.num_row_groups == MEMBERS // rows.CHUNK
    story = results.read(alone, PLAN)
    assert story.failed == 0 and story.summary()["singular"]["probability"] == 1.0
    assert len(results.draw(tmp_path, story)) == 2


def test_processes_that_die_repeatedly_end_with_one_sentence() -> None:
    broken: Future[Done] = Future()
    broken.set_exception(BrokenProcessPool("killed"))
    chunk = Chunk(SimpleNamespace(submit=lambda *_: broken), "", 200, 100)
    with pytest.raises(TwinError, match="the process that ran members from 200 on has died 4 times"):
        chunk.result()


def ensemble(fmu: Path, folder: Path, *more: str) -> list[str]:
    """Runs the command without Dask."""
    hidden = (
        "import sys; sys.modules['distributed'] = None; from fivebar.commands import main; sys.exit(main(sys.argv[1:]))"
    )
    return [sys.executable, "-c", hidden, "ensemble", "--fmu", str(fmu), "--out", str(folder / "out"), *more]


def test_one_machine_needs_no_cluster(fmu: Path, tmp_path: Path) -> None:
    """Members run in processes of this machine without Dask and leave nothing in the temporary folder."""
    (temporary := tmp_path / "temporary").mkdir()
    done = subprocess.run(
        ensemble(fmu, tmp_path, "--members", "300", "--seconds", "0.1", "--measure"),
        env=os.environ | {"TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert "2 of them" in done.stdout and "the same bytes" in done.stdout
    assert not list(temporary.iterdir())


def test_no_process_outlives_a_command_that_was_killed(fmu: Path, tmp_path: Path) -> None:
    command = ensemble(fmu, tmp_path, "--members", "100000")
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=os.environ | {"TMPDIR": str(tmp_path)}) as run:
        wait_until(lambda: len(psutil.Process(run.pid).children(recursive=True)) >= 2)
        children = psutil.Process(run.pid).children(recursive=True)
        run.kill()
    wait_until(lambda: not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children))


def test_a_worker_that_dies_after_the_last_chunk_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scheduler asks a dead worker to remove the unit: the tables are complete nevertheless."""

    def broken(name: str) -> None:
        raise CommClosedError(f"removal of {name}: connection reset by peer")

    content = pa.table({"member": [0, 1]})
    monkeypatch.setattr(rows, "in_order", lambda submit, workers, members: iter([content]))
    workers = object.__new__(Cluster)
    workers.client = SimpleNamespace(register_plugin=lambda plugin, name: None, unregister_worker_plugin=broken)
    assert list(workers.tables(b"", PLAN, 2)) == [content]


@pytest.mark.full
def test_a_scheduler_of_ones_own(fmu: Path, tmp_path: Path) -> None:
    """A separate scheduler and worker, started by Dask's commands, give the bytes of one process."""
    address = f"tcp://127.0.0.1:{free_port()}"
    dask = [sys.executable, "-m", "dask"]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"],
        cwd=tmp_path,
    )
    worker = subprocess.Popen([*dask, "worker", address, "--no-dashboard", "--nthreads", "1"], cwd=tmp_path)
    try:
        command = [
            sys.executable,
            "-m",
            "fivebar",
            "ensemble",
            "--members",
            "60",
            "--seconds",
            "0.5",
            "--fmu",
            str(fmu),
            "--measure",
        ]
        run = subprocess.run(
            [*command, "--scheduler", address, "--out", str(tmp_path / "out")],
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
    finally:
        for process in (worker, scheduler):
            process.terminate()
            process.wait(PATIENCE)
    assert run.returncode == 0 and "the same bytes" in run.stdout, run.stdout + run.stderr


def test_what_if(fmu: Path) -> None:
    """From a state at rest each command reaches its target, and the goal ranks the commands."""
    library = Library(fmu)
    unit = Unit.of(library)
    setpoints = {"servo.theta[1]": 2.2, "servo.theta[2]": 0.94, "servo.omega[1]": 0.0, "servo.omega[2]": 0.0}
    values = {
        "base.distance": 0.1,
        "gravity.enabled": False,
        "servo.enabled": True,
        "init.theta[1]": 2.2,
        "init.theta[2]": 0.94,
    }
    unit.reset(**values, **setpoints, **{f"servo.{k}[{i}]": v for i in (1, 2) for k, v in (("kp", 20.0), ("kd", 0.5))})
    unit.step_to(0.1)
    state = base64.b64encode(unit.state().to_bytes()).decode()
    message = Message("state", "bench", 0, 20, {}, {"state": state, "clock": 0.1, "book": {"told": setpoints}})
    options = what_if.Options(Path("twin.json"), None, members=4, seconds=0.4, seed=0, times=1, scheduler=None)
    begin = unit.get("tip.x", "tip.y")
    unit.close()
    library.close()
    answer = what_if.compare(fmu, message, None, list(begin), options)
    names = [one["name"] for one in answer["candidates"]]
    assert names[0] == "stay" and len(names) == 5 and answer["candidates"][0]["end"]["within95"] < 1e-3
    # A turn of 0.15 rad on a link of 0.21 m.
    assert all(0.01 < one["end"]["within95"] < 0.1 for one in answer["candidates"][1:])
    sent = decode("fivebar/bench/whatif", encode(Message("whatif", "bench", 0, 20, {}, answer)))
    assert [one["rank"] for one in sent.extra["candidates"]] == [1, 2, 3, 4, 5]


def test_what_if_includes_the_uncertainty_of_the_twin(fmu: Path, tmp_path: Path) -> None:
    """Staying where the plan rests ends like the twin's forecast, with its half-width of 1.6 mm. Members differ only by their start, which stiff
    servos forget, so they alone would give 0.00 mm."""
    library = Library(fmu)
    config = configured(tmp_path, fmu, library, "pick_and_place")
    source, twin = machine(config, library), follower(config, library)
    while twin.book is None or twin.book.seq < 100 or any(twin.book.told[f"servo.omega[{i}]"] for i in (1, 2)):
        twin.meas(source.next())
    state = twin.state()
    expected = Forecaster(library, replace(twin.setup, horizon=0.1)).run(state)
    options = what_if.Options(tmp_path, None, members=2, seconds=0.1, seed=0, times=1, scheduler=None)
    stay = what_if.compare(fmu, state, [what_if.Candidate("stay", {})], None, options)["candidates"][0]
    source.close()
    twin.close()
    library.close()
    assert expected is not None and expected.extra["half_width"] > 5e-4
    # Tolerances: members are stored in single precision; 0.1 micrometres.
    assert stay["end"]["within95"] == pytest.approx(expected.extra["half_width"], rel=1e-6)
    assert stay["end"]["tip.x"] == pytest.approx(expected.fields["tip.x"], rel=1e-6)
    (low, middle, high) = stay["bands"]["tip.x"][-1]
    assert (high - low) / 2 == pytest.approx(stay["end"]["within95"], abs=1e-7) and low < middle < high


def test_knots_are_joined_as_in_scenes() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3])
    assert what_if.way(times, [(0.2, 2.0)], 1.0).tolist() == pytest.approx([1.0, 1.5, 2.0, 2.0])


def test_a_scheduler_elsewhere_needs_tls() -> None:
    with pytest.raises(TwinError, match="TLS is required"):
        Cluster("tcp://192.0.2.1:8786")


def test_a_file_that_is_not_a_state_is_refused(fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("{}", encoding="utf-8")
    with pytest.raises(TwinError, match="not a stored state"):
        command.stored(tmp_path / "state.json")
