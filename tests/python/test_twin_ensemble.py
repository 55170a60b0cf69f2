"""`fivebar ensemble` and `what-if`: the same members wherever they run, also where workers die; commands compared from a state."""

import base64
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed.comm import CommClosedError

from conftest import PATIENCE
from fivebar.twin.ensemble import cluster, command, results, rows, what_if
from fivebar.twin.ensemble.member import Plan, Runner
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import Message, decode, encode
from fivebar.twin.starter import free_port
from fivebar.twin.unit import Library, Unit

FALL = {"init.theta[2]": 2.0943951023931953}
PLAN = Plan(values=FALL, seconds=0.5, points=10, seed=3, spreads={"theta[1]": 2e-3, "link[1,4].mass": 0.01})


def test_members_do_not_depend_on_others(fmu: Path) -> None:
    """A member is the same after others and alone, and its singularity is where the unit counts it."""
    library = Library(fmu)
    first, second = Runner(library, PLAN), Runner(library, PLAN)
    first.run(4)
    a, b = first.run(7), second.run(7)
    assert (
        a["drawn"] == b["drawn"] and a["singular.time"] == b["singular.time"] and np.array_equal(a["shown"], b["shown"])
    )
    unit = Unit(library)
    values = {"init.theta[1]": a["drawn"]["theta[1]"], "solver.method": 4, **FALL}
    for leg in (1, 4):
        values |= {
            f"link[{leg}].mass": 0.017 * a["drawn"]["link[1,4].mass"],
            f"link[{leg}].inertia": 6.23e-5 * a["drawn"]["link[1,4].mass"],
        }
    unit.start(values)
    # Within half a thousandth of a step of 50 ms.
    for time, passed in ((a["singular.time"] - 5e-5, 0), (a["singular.time"] + 5e-5, 1)):
        unit.step_to(time)
        assert (
            unit.get(["singular.passes.inverse[2]"])["singular.passes.inverse[2]"] == passed and a["singular.kind"] == 3
        )
    unit.close()
    first.close()
    second.close()
    library.close()


def test_draws_below_the_least_value_are_counted(fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A standard deviation of 60 % brings one mass of twenty below 0; these were raised to 0.02 in silence."""
    options = command.Options(200, "fall_90_120", None, ("link.mass=60%",), 0.05, 2, 0, 0, None, False, fmu, tmp_path)
    assert command.run(options) == 0
    drawn = pq.read_table(tmp_path / "members.parquet")["drawn.link.mass"].to_numpy()
    count = int((drawn == 0.02).sum())
    assert (
        3 <= count <= 25 and f"link.mass: {count} of 200 draws were below 0.02 of the value" in capsys.readouterr().out
    )


def test_a_killed_worker_loses_nothing(fmu: Path, tmp_path: Path) -> None:
    """Two workers, one of which is killed on the way, give the bytes of one process."""
    content, members = fmu.read_bytes(), 1000
    results.write(tmp_path / "alone.parquet", PLAN, rows.alone(content, PLAN, members), lambda _: None)
    client, own = cluster.client(None, 2)
    killed: list[int] = []

    def kill(done: int) -> None:
        if done >= 300 and not killed:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    try:
        results.write(
            tmp_path / "workers.parquet", PLAN, cluster.tables(client, content, PLAN, members, "killed"), kill
        )
    finally:
        client.close()
        own.close()
    assert killed and (tmp_path / "workers.parquet").read_bytes() == (tmp_path / "alone.parquet").read_bytes()
    file = pq.ParquetFile(tmp_path / "alone.parquet")
    assert file.metadata.num_rows == members and file.metadata.num_row_groups == members // rows.CHUNK
    story = results.read(tmp_path / "alone.parquet", PLAN)
    assert story.failed == 0 and story.summary()["singular"]["probability"] == 1.0
    assert len(results.draw(tmp_path, story)) == 2


def test_a_worker_that_dies_after_the_last_chunk_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scheduler reaches a worker no more that it asks to remove the unit: the tables are complete."""

    def broken(name: str) -> None:
        raise CommClosedError(f"removal of {name}: connection reset by peer")

    content = pa.table({"member": [0, 1]})
    monkeypatch.setattr(cluster, "_in_order", lambda of, members, name: iter([content]))
    of = SimpleNamespace(register_plugin=lambda plugin, name: None, unregister_worker_plugin=broken)
    assert list(cluster.tables(of, b"", PLAN, 2, "broken")) == [content]


@pytest.mark.full
def test_a_scheduler_of_ones_own(fmu: Path, tmp_path: Path) -> None:
    """Scheduler and worker as processes of their own, started by Dask's commands, give the bytes of one process."""
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
    """From a state at rest each command leads where it says, and the goal decides."""
    library = Library(fmu)
    unit = Unit(library)
    told = {"servo.theta[1]": 2.2, "servo.theta[2]": 0.94, "servo.omega[1]": 0.0, "servo.omega[2]": 0.0}
    values = {
        "base.distance": 0.1,
        "gravity.enabled": False,
        "servo.enabled": True,
        "init.theta[1]": 2.2,
        "init.theta[2]": 0.94,
    }
    unit.start(values | {f"servo.{k}[{i}]": v for i in (1, 2) for k, v in (("kp", 20.0), ("kd", 0.5))} | told)
    unit.step_to(0.1)
    stored = unit.store()
    state = base64.b64encode(unit.to_bytes(stored)).decode()
    message = Message("state", "bench", 0, 20, {}, {"state": state, "clock": 0.1, "book": {"told": told}})
    options = what_if.Options(Path("twin.json"), None, members=4, seconds=0.4, seed=0, times=1, scheduler=None)
    begin = unit.get(["tip.x", "tip.y"])
    unit.free(stored)
    unit.close()
    library.close()
    answer = what_if.compare(fmu, message, None, [begin["tip.x"], begin["tip.y"]], options)
    names = [one["name"] for one in answer["candidates"]]
    assert names[0] == "stay" and len(names) == 5 and answer["candidates"][0]["end"]["within95"] < 1e-3
    # A turn of 0.15 rad on a link of 0.21 m.
    assert all(0.01 < one["end"]["within95"] < 0.1 for one in answer["candidates"][1:])
    sent = decode("fivebar/bench/whatif", encode(Message("whatif", "bench", 0, 20, {}, answer)))
    assert [one["rank"] for one in sent.extra["candidates"]] == [1, 2, 3, 4, 5]


def test_knots_are_joined_as_in_scenes() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3])
    assert what_if.way(times, [(0.2, 2.0)], 1.0).tolist() == pytest.approx([1.0, 1.5, 2.0, 2.0])


def test_a_scheduler_elsewhere_needs_tls() -> None:
    with pytest.raises(TwinError, match="TLS is required"):
        cluster.client("tcp://192.0.2.1:8786", 0)


def test_a_state_that_is_none(fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("{}", encoding="utf-8")
    with pytest.raises(TwinError, match="not a stored state"):
        command.stored(tmp_path / "state.json")
