"""`fivebar import`: tables, ROS bags and maps; measured steps and noise of encoders; records that calibration and twin read."""

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fivebar import extras, simulate
from fivebar import scene as scenes
from fivebar.commands import main
from fivebar.kinematics import Machine as Kinematics
from fivebar.statics import holding_torques
from fivebar.twin import recording
from fivebar.twin.calibrate import data
from fivebar.twin.config import Config, Machine
from fivebar.twin.importing import assemble, maps, quality
from fivebar.twin.machine import Player
from fivebar.twin.starter import sampling

GRID = 0.005 * np.arange(400)
LEFT, RIGHT = 1.2 + 0.3 * np.sin(3 * GRID), 0.7 - 0.2 * np.sin(5 * GRID)
ROUND = 1e-12
"""Tolerance: factors of units and offsets leave round-off of some 1e-16; the tables of the tests have all digits."""


def write_csv(file: Path, head: str, *columns: Any) -> Path:
    """Writes a table, without a head if `head` is empty."""
    rows = [",".join("" if math.isnan(x) else repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    file.write_text("\n".join([*([head] if head else []), *rows]) + "\n", encoding="utf-8")
    return file


def write_map(folder: Path, **entries: Any) -> Path:
    """Writes a map with the short names t1 and t2 for the encoders."""
    names = {"t1": "measured.theta[1]", "t2": "measured.theta[2]", "s1": "servo.theta[1]", "p1": "passive.theta[1]"}
    file = folder / "map.json"
    file.write_text(json.dumps({names.get(name, name): entry for name, entry in entries.items()}), encoding="utf-8")
    return file


def write_bag(folder: Path, *topics: tuple[str, list[str], Any, Any]) -> Path:
    """Writes a bag of JointStates, received every 5 ms: topic, joint names, stamps in s, positions (n, joints)."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with Writer(folder / "bag", version=8) as bag:
        for topic, names, times, positions in topics:
            connection = bag.add_connection(topic, "sensor_msgs/msg/JointState", typestore=store)
            for k, (time, position) in enumerate(zip(times, positions, strict=True)):
                at = 1_790_000_000 * 10**9 + round(1e9 * time)
                stamp = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
                header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
                message = types["sensor_msgs/msg/JointState"](
                    header, names, np.array(position), np.empty(0), np.empty(0)
                )
                content = store.serialize_cdr(message, "sensor_msgs/msg/JointState")
                bag.write(connection, 1_790_000_000 * 10**9 + 5_000_000 * k, content)
    return folder / "bag"


def imported(tmp_path: Path, *files: Path, given: Path | None = None) -> recording.Recording:
    """Runs the command and reads its record back."""
    options = ["--map", str(given)] if given else []
    assert main(["import", *map(str, files), *options, "-o", str(tmp_path / "record.csv")]) == 0
    return recording.read(tmp_path / "record.csv")


# --- tables ---------------------------------------------------------------------------------------------------------------------------


def test_units_signs_scales_and_offsets(tmp_path: Path) -> None:
    file = write_csv(
        tmp_path / "a.csv",
        "t,enc [counts],q2 [°],i [A]",
        1e3 * GRID,
        -np.round(LEFT * 8192 / (2 * np.pi)),
        np.degrees(RIGHT - 0.5),
        GRID,
    )
    given = write_map(
        tmp_path,
        time={"column": "t", "unit": "ms"},
        t1={"column": "enc", "unit": "counts", "steps": 8192, "sign": -1},
        t2={"column": "q2", "unit": "deg", "offset": 0.5},
        **{"tau[1]": {"column": "i", "scale": 0.05, "offset": "-20 mN.m"}},
    )
    found = imported(tmp_path, file, given=given)
    assert found.time == pytest.approx(GRID, abs=ROUND)
    # Rounding: half a step.
    assert found.columns["measured.theta[1]"] == pytest.approx(LEFT, abs=np.pi / 8192 + ROUND)
    assert found.columns["measured.theta[2]"] == pytest.approx(RIGHT, abs=ROUND)
    assert found.columns["tau[1]"] == pytest.approx(0.05 * GRID - 0.02, abs=ROUND)


def test_a_table_without_a_head_has_numbers_for_names(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "a.csv", "", GRID, RIGHT, LEFT)
    given = write_map(tmp_path, time={"column": 1}, t1={"column": 3}, t2={"column": "2"})
    found = imported(tmp_path, file, given=given)
    assert found.columns["measured.theta[1]"].tolist() == LEFT.tolist() and len(found.time) == 400


@pytest.mark.parametrize(
    "head", ["time [ms],theta[1] [deg],theta[2] [deg]", "time (ms),theta[1] (degrees),theta[2] (°)"]
)
def test_a_head_of_names_and_units_needs_no_map(head: str, tmp_path: Path) -> None:
    file = write_csv(tmp_path / "a.csv", head, 1e3 * GRID, np.degrees(LEFT), np.degrees(RIGHT))
    found = imported(tmp_path, file)
    assert found.columns["measured.theta[1]"] == pytest.approx(LEFT, abs=ROUND)
    assert found.time == pytest.approx(GRID, abs=ROUND)


@pytest.mark.parametrize("kind", ["ns", "s", "timestamp"])
def test_a_table_may_be_parquet(tmp_path: Path, kind: str) -> None:
    """Times since 1970 keep their nanoseconds, which a float would lose."""
    ns = 1_790_000_000_123_456_789 + np.round(1e9 * GRID).astype(np.int64)
    clock = {"ns": pa.array(ns), "s": pa.array(GRID), "timestamp": pa.array(ns, pa.timestamp("ns"))}[kind]
    left = pa.array([None, *LEFT[1:].tolist()])
    pq.write_table(
        pa.table({"clock": clock, "a": left, "b": pa.array(RIGHT.astype(np.float32))}), tmp_path / "a.parquet"
    )
    unit = {} if kind == "timestamp" else {"unit": kind}
    given = write_map(tmp_path, time={"column": "clock"} | unit, t1={"column": "a"}, t2={"column": "b"})
    found = imported(tmp_path, tmp_path / "a.parquet", given=given)
    assert found.time == pytest.approx(GRID, abs=ROUND)
    assert math.isnan(found.columns["measured.theta[1]"][0]) and found.columns["measured.theta[1]"][1] == LEFT[1]


def test_clocks_that_restart_and_several_files_are_series(tmp_path: Path) -> None:
    """Each file is a series too, and no row is left out."""
    head = "time,theta[1],theta[2]"
    first = write_csv(tmp_path / "a.csv", head, [*(100 + GRID), *GRID], [*LEFT, *LEFT], [*RIGHT, *RIGHT])
    second = write_csv(tmp_path / "b.csv", head, 7 + GRID, LEFT, RIGHT)
    found = imported(tmp_path, first, second)
    assert found.begins == (400, 800) and len(found.time) == 1200
    series = data.read(tmp_path / "record.csv", 0.0, 100.0).series
    assert [len(each) for each in series] == [400, 400, 400]
    for each in series:
        assert each.time - each.time[0] == pytest.approx(GRID, abs=ROUND)


def test_files_with_different_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a map, the error lists the columns of all files, and the columns that one file lacks or names differently."""
    first = write_csv(tmp_path / "a.csv", "time,theta[1],theta[2],tau[1]", GRID, LEFT, RIGHT, 0 * GRID)
    second = write_csv(tmp_path / "b.csv", "time,measured.theta[1],theta[2],tau[2]", GRID, LEFT, RIGHT, 0 * GRID)
    imported(tmp_path, first, second)
    printed = capsys.readouterr().out
    for line in (
        "  measured.theta[1] from theta[1]",
        "  measured.theta[2] from theta[2]",
        "  tau[1] from tau[1]",
        "  tau[2] from tau[2]",
        f"  {second} has measured.theta[1] in the column measured.theta[1]",
        f"  {first} has no column for tau[2]",
        f"  {second} has no column for tau[1]",
    ):
        assert f"{line}\n" in printed, line


@pytest.mark.parametrize("has_map", [True, False])
def test_commands_in_another_file_are_refused_with_the_meaning_of_several_files(
    has_map: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In either order of the files."""
    encoders = write_csv(tmp_path / "a.csv", "time,theta[1],theta[2]", GRID, LEFT, RIGHT)
    commands = write_csv(tmp_path / "b.csv", "time,tau[1]", GRID, 0 * GRID)
    given = write_map(
        tmp_path, t1={"column": "theta[1]"}, t2={"column": "theta[2]"}, **{"tau[1]": {"column": "tau[1]"}}
    )
    words = ["--map", str(given)] if has_map else []
    for files in ((encoders, commands), (commands, encoders)):
        assert main(["import", *map(str, files), *words, "-o", str(tmp_path / "c.csv")]) == 2
        error = capsys.readouterr().err
        assert "several files are series with the same columns: commands in a file of their own must" in error
        assert error.count("\n") == 1 and not (tmp_path / "c.csv").exists()


# --- bags -----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["folder", "file"])
def test_a_bag_of_joint_states(tmp_path: Path, which: str) -> None:
    """Joints are found by name, in any order; a distal angle may be relative to its proximal link."""
    positions = np.column_stack([RIGHT, LEFT - 0.1, 0.4 + 0 * LEFT])
    bag = write_bag(tmp_path, ("/joint_states", ["r", "l", "pl"], GRID, positions))
    given = write_map(
        tmp_path,
        t1={"column": "/joint_states/l/position", "offset": 0.1},
        t2={"column": "/joint_states/r/position"},
        p1={"column": "/joint_states/pl/position", "relative": True},
    )
    found = imported(tmp_path, bag if which == "folder" else next(bag.glob("*.db3")), given=given)
    assert found.time == pytest.approx(GRID, abs=ROUND)
    assert found.columns["measured.theta[1]"] == pytest.approx(LEFT, abs=ROUND)
    assert found.notes == ["columns that are not used: passive.theta[1]"]
    kept, _ = assemble.recorded([bag], maps.read(given))
    assert kept.columns["passive.theta[1]"] == pytest.approx(LEFT + 0.4, abs=ROUND)


def test_topics_with_clocks_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Encoder samples keep their times, commands are constant between messages, and each note gives the shift in time."""
    slow = np.arange(0.0, 1.99, 0.03) + 0.001
    bag = write_bag(
        tmp_path,
        ("/left", ["a"], GRID, LEFT[:, None]),
        ("/right", ["a"], GRID + 0.0005, RIGHT[:, None]),
        ("/drive", ["a"], slow, np.sin(slow)[:, None]),
    )
    given = write_map(
        tmp_path,
        t1={"column": "/left/a/position"},
        t2={"column": "/right/a/position"},
        s1={"column": "/drive/a/position"},
    )
    found = imported(tmp_path, bag, given=given)
    text = capsys.readouterr().out
    # The right encoder is late by a tenth of a step: both go into one row.
    assert found.time == pytest.approx(GRID, abs=1e-9) and found.columns["measured.theta[2]"].tolist() == RIGHT.tolist()
    assert (
        "measured.theta[2] is from /right by the clock stamp, 400 values: each is in the nearest row, up to 0.5 ms away"
        in text
    )
    assert (
        "servo.theta[1] is from /drive by the clock stamp, 67 values: each holds until the next one, starting at the next encoder sample"
        in text
    )
    for k in (1, 2, 7, 100, 399):
        assert found.columns["servo.theta[1]"][k] == np.sin(slow[np.searchsorted(slow, GRID[k], side="right") - 1])


def test_an_encoder_half_a_step_late_has_rows_of_its_own(tmp_path: Path) -> None:
    """Nothing is resampled: each row has one encoder, and calibration and twin count the rows."""
    bag = write_bag(tmp_path, ("/left", ["a"], GRID, LEFT[:, None]), ("/right", ["a"], GRID + 0.0025, RIGHT[:, None]))
    given = write_map(tmp_path, t1={"column": "/left/a/position"}, t2={"column": "/right/a/position"})
    found = imported(tmp_path, bag, given=given)
    assert len(found.time) == 800 and found.period == pytest.approx(0.0025)
    for name, values in (("measured.theta[1]", LEFT), ("measured.theta[2]", RIGHT)):
        column = found.columns[name]
        assert column[np.isfinite(column)].tolist() == values.tolist()
    assert [len(each) for each in data.read(tmp_path / "record.csv", 0.0, 10.0).series] == [800]


def test_the_clock_of_a_bag_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stamps that fall back begin a new series. With several topics they are refused; the recorder's clock can be used instead."""
    jumps = np.concatenate([GRID[:200] + 50, GRID[:200]])
    bag = write_bag(tmp_path, ("/a", ["x"], jumps, LEFT[:, None]), ("/b", ["x"], jumps, RIGHT[:, None]))
    a, b = ({"column": f"/{topic}/x/position"} for topic in "ab")
    assert imported(tmp_path, bag, given=write_map(tmp_path, t1=a)).begins == (200,)
    record = ["-o", str(tmp_path / "record.csv")]
    assert main(["import", str(bag), "--map", str(write_map(tmp_path, t1=a, t2=b)), *record]) == 2
    assert "/a by the clock stamp falls back at 50.995 s, so several topics" in capsys.readouterr().err
    found = imported(tmp_path, bag, given=write_map(tmp_path, time={"column": "received"}, t1=a, t2=b))
    assert (
        found.time == pytest.approx(GRID, abs=ROUND) and found.columns["measured.theta[2]"].tolist() == RIGHT.tolist()
    )
    assert main(["import", str(bag), "--map", str(write_map(tmp_path, time={"column": "t"}, t1=a)), *record]) == 2
    assert "with the clocks stamp and received, not t" in capsys.readouterr().err


# --- measured properties of the encoders ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "noise"), [(0.0, 2e-4), (3.1416e-4, 0.0), (1e-3, 0.0), (3.1416e-4, 5e-4), (2 * np.pi / 2**20, 2e-5)]
)
def test_steps_and_noise_are_measured(step: float, noise: float) -> None:
    """The step to 0.1 %; noise to 15 %, four standard deviations for 1,600 samples (windows of 50 have 22 independent differences)."""
    time = 0.005 * np.arange(1600)
    for seed in range(10):
        chance = np.random.default_rng(seed)
        angle = 1.2 + 0.6 * np.sin(3 * time) + noise * chance.standard_normal(len(time))
        seen = np.round(angle / step) * step if step else angle
        found = recording.of("a", time, {"measured.theta[1]": seen}, [])
        [figures] = quality.measure(found)
        assert figures.step == pytest.approx(step, rel=1e-3)
        assert figures.noise == pytest.approx(noise, rel=0.15) if noise else figures.noise < 0.3 * step


def test_coarse_times_are_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The warning has the sentence, and the printed notes do not repeat it."""
    file = write_csv(tmp_path / "a.csv", "time,theta[1],theta[2]", np.floor(40 * GRID + 1e-9) / 40, LEFT, RIGHT)
    imported(tmp_path, file)
    text = capsys.readouterr()
    assert text.err.count("samples are left out, because they repeat the time") == 1
    assert "repeat the time" not in text.out


def test_rate_jitter_and_lost_samples_are_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chance = np.random.default_rng(3)
    kept = np.ones(400, dtype=bool)
    kept[[50, 51, 120]] = False
    kept[200:250] = False
    time = GRID + 1e-4 * chance.standard_normal(400)
    file = write_csv(tmp_path / "a.csv", "time,theta[1],theta[2]", time[kept], LEFT[kept], RIGHT[kept])
    first, second = quality.measure(imported(tmp_path, file))
    assert first.lost == second.lost == 53 and first.gaps[0][:2] == pytest.approx((0.995, 0.255), abs=5e-4)
    # An interval has the jitter of two samples.
    assert first.jitter == pytest.approx(1e-4 * np.sqrt(2), rel=0.2) and first.periods == pytest.approx(
        (0.005,), rel=0.01
    )
    text = capsys.readouterr().out
    assert "measured.theta[1]: 347 samples, 200" in text and "53 lost, longest gap 0.25" in text
    assert "no measured.theta[1] from 0.99" in text and '"estimator.quantum[1]": 0, "estimator.sigma[1]": ' in text


def test_files_of_other_rates_have_no_lost_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each series has its own rate: a slower one is neither full of gaps nor of lost samples, and a real gap is still found in it."""
    fast, slow = 0.001 * np.arange(1500), 0.01 * np.arange(300)
    kept = np.ones(300, dtype=bool)
    kept[100:108] = False
    files = []
    for name, time in (("fast", fast), ("slow", slow[kept])):
        files.append(write_csv(tmp_path / f"{name}.csv", "time,theta[1],theta[2]", time, np.sin(time), np.cos(time)))
    found = imported(tmp_path, *files)
    for each in quality.measure(found):
        assert each.periods == pytest.approx((0.001, 0.01), rel=1e-6) and each.jitter < 1e-9
        assert each.lost == 8 and len(each.gaps) == 1 and each.gaps[0].steps == pytest.approx(9)
    text = capsys.readouterr().out
    # Differences of times have round-off.
    assert "1792 samples, 1000 and 100 Hz, jitter 0 ms" in text and "8 lost, longest gap 0.09 s" in text
    assert text.count("another series") == 2


def test_changes_of_commands_are_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A torque that walks at random, and a command that steps by 0.1 rad each second, so that a tenth of its changes within 0.1 s are 0.1 rad."""
    time = 0.005 * np.arange(20000)
    walk = np.cumsum(np.random.default_rng(7).normal(0, 0.02 * np.sqrt(0.05), len(time)))
    moves = [1.2 + 0.3 * np.sin(3 * time), 0.7 - 0.2 * np.sin(5 * time)]
    head = "time,theta[1],theta[2],tau[1],tau[2],servo.theta[2]"
    file = write_csv(tmp_path / "a.csv", head, time, *moves, walk, np.ones(len(time)), 0.1 * np.floor(time + 0.5))
    torque, reference = quality.changes(imported(tmp_path, file))
    assert (torque.name, reference.name) == ("tau[1]", "servo.theta[2]")
    # 1,000 independent changes: their root mean square has a standard deviation of 2.2 %.
    assert torque.size == pytest.approx(0.02, rel=0.09)
    assert reference.size == pytest.approx(0.1 * np.sqrt(0.1), rel=0.01)
    text = capsys.readouterr().out
    assert f"tau[1]: changes by {torque.size:.3g} N.m (rms) within 0.1 s" in text
    assert f'  "estimator.commandScale.tau[1]": {torque.size:.3g},\n' in text and "tau[2]: changes" not in text
    assert f'  "estimator.commandScale.theta[2]": {reference.size:.3g},\n' in text


def test_no_change_of_a_command_is_counted_across_a_gap(tmp_path: Path) -> None:
    """Changes from one series to the next are not counted either."""
    kept = (GRID < 0.5) | (GRID > 0.9)
    commands = [0.01 * (GRID > 0.7), 5.0 + 0.01 * (GRID > 0.7)]
    head = "time,theta[1],theta[2],tau[1]"
    files = [
        write_csv(tmp_path / f"{k}.csv", head, GRID[kept], LEFT[kept], RIGHT[kept], command[kept])
        for k, command in enumerate(commands)
    ]
    assert quality.changes(imported(tmp_path, *files)) == []


# --- records that others read -------------------------------------------------------------------------------------------------------


def test_a_record_is_calibrated_and_played(tmp_path: Path, fmu: Path) -> None:
    """A run of the unit in the format of another logger: both readers return the angles of the run."""
    result = simulate.run("pick_and_place", fmu=fmu)
    names = [f"{name}[{i}]" for name in ("theta", "servo.theta", "servo.omega") for i in (1, 2)]
    columns = [np.degrees(-result[name]) for name in names]
    file = write_csv(tmp_path / "a.csv", "ms,q1,q2,c1,c2,v1,v2", 1e3 * np.asarray(result["time"]), *columns)
    entries = {
        name.replace("theta", "measured.theta", name.startswith("theta")): {
            "column": column,
            "unit": "deg/s" if column[0] == "v" else "deg",
            "sign": -1,
        }
        for name, column in zip(names, ("q1", "q2", "c1", "c2", "v1", "v2"), strict=True)
    }
    given = write_map(tmp_path, time={"column": "ms", "unit": "ms"}, **entries)
    found = imported(tmp_path, file, given=given)
    assert found.columns["measured.theta[2]"] == pytest.approx(np.asarray(result["theta[2]"]), abs=ROUND)
    record = tmp_path / "record.csv"
    played = Player(Config(str(tmp_path), "", "", machine=Machine(csv=str(record)), period=sampling(record)))
    played.check()
    assert (sample := played.next()) is not None and set(sample.fields) == set(entries)
    words = ["--scene", "pick_and_place", "--commands", "hold", "--no-proposal", "--parameters", "payload.mass"]
    assert main(["calibrate", str(record), *words, "--fmu", str(fmu), "--out", str(tmp_path / "out")]) == 0
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    # As in the table of the run itself: the readers use another step than the run's i3alp.
    assert figures["series"] == 1 and max(figures["residuals_rad"]["encoder"]) < 1e-7


# --- maps guessed from redundant columns ---------------------------------------------------------------------------------------------

LENGTHS = {
    "base.distance": 0.1,
    "link[1].length": 0.11,
    "link[2].length": 0.16,
    "link[3].length": 0.18,
    "link[4].length": 0.09,
}
ALIKE = {
    "base.distance": 0.085,
    "link[1].length": 0.1,
    "link[2].length": 0.165,
    "link[3].length": 0.165,
    "link[4].length": 0.1,
}
MOTION = np.column_stack(
    [
        2.2 + 0.5 * np.sin(3 * GRID) + 0.2 * np.sin(7.1 * GRID),
        0.8 + 0.4 * np.sin(4.3 * GRID + 1) - 0.2 * np.cos(2.2 * GRID),
    ]
)
"""Angles of the motors: both cover a wide range, and neither is a function of the other."""

STEP = 2 * np.pi / 8192


def machine_file(folder: Path, lengths: dict[str, float]) -> Path:
    """Writes a scene that starts at the first angles of `MOTION`."""
    start = {f"init.theta[{i + 1}]": float(MOTION[0, i]) for i in (0, 1)}
    masses = {f"link[{i}].{what}": x for i in range(1, 5) for what, x in (("com", 0.04), ("inertia", 2e-5))}
    file = folder / "machine.json"
    file.write_text(json.dumps({"description": "A machine"} | lengths | start | masses), encoding="utf-8")
    return file


def guessed(
    tmp_path: Path, table: Path, lengths: dict[str, float], text: Any, **entries: Any
) -> tuple[str, recording.Recording]:
    """Returns the output with --guess, and the recording read with the proposed map."""
    given, scene = write_map(tmp_path, **entries), machine_file(tmp_path, lengths)
    record = ["-o", str(tmp_path / "record.csv")]
    assert main(["import", str(table), "--map", str(given), "--guess", str(scene), *record]) == 0
    out = text.readouterr().out
    if "the map may stay as it is" not in out:
        given.write_text(out.partition("proposed map:")[2].partition("\n\nwritten:")[0], encoding="utf-8")
    return out, assemble.recorded([table], maps.read(given))[0]


@pytest.mark.parametrize("redundant", ["passive", "tip", "torque", "commands"])
def test_an_exchange_signs_and_zeros_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], redundant: str
) -> None:
    """Encoders are exchanged, the left one is reversed, both zeros are unknown: the proposed map gives the true angles."""
    machine = scenes.read(machine_file(tmp_path, LENGTHS))
    posture = Kinematics.from_scene(machine).forward(MOTION)
    left, right = np.round((1.3 - MOTION[:, 0]) / STEP) * STEP, np.round((MOTION[:, 1] - 0.7) / STEP) * STEP
    columns = {
        "passive": posture.theta[:, 1:3],
        "tip": posture.tip,
        "torque": holding_torques(machine, posture.theta),
        "commands": MOTION + 0.01 * np.sin(40 * GRID)[:, None],
    }[redundant]
    file = write_csv(tmp_path / "a.csv", "time,a,b,x,y", GRID, right, left, *columns.T)
    names = {"passive": "passive.theta[{}]", "torque": "tau[{}]", "commands": "servo.theta[{}]"}.get(redundant)
    pair = [names.format(1), names.format(2)] if names else ["tip.x", "tip.y"]
    more = {name: {"column": column} for name, column in zip(pair, "xy", strict=True)}
    out, found = guessed(tmp_path, file, LENGTHS, capsys, t1={"column": "a"}, t2={"column": "b"}, **more)
    assert (
        "encoders exchanged and left angle reversed (" in out
        and "not distinguishable" not in out
        and "not identified" not in out
    )
    # Rounding is half a step. Zeros are means over 400 samples of steps of 0.8 mrad and following errors of 7 mrad: 1 mrad is ten times
    # their error.
    for name, column in zip(("measured.theta[1]", "measured.theta[2]"), MOTION.T, strict=True):
        assert found.columns[name] == pytest.approx(column, abs=STEP + 1e-3)


def test_ambiguous_maps_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A machine with equal legs and its mirror image have the same angles; encoders alone do not determine zeros."""
    posture = Kinematics.from_values(ALIKE).forward(MOTION)
    relative = posture.theta[:, 1:3] - posture.theta[:, [0, 3]]
    file = write_csv(tmp_path / "a.csv", "time,a,b,x,y", GRID, *MOTION.T, *relative.T)
    encoders = {"t1": {"column": "a"}, "t2": {"column": "b"}}
    passive = {f"passive.theta[{i}]": {"column": c, "relative": True} for i, c in ((1, "x"), (2, "y"))}
    out, found = guessed(tmp_path, file, ALIKE, capsys, **encoders, **passive)
    assert "the map may stay as it is" in out and found.columns["measured.theta[1]"].tolist() == MOTION[:, 0].tolist()
    mirrored = "encoders exchanged and left angle reversed and right angle reversed"
    assert f"not distinguishable from encoders as in the map: {mirrored}" in out
    out, _ = guessed(tmp_path, file, ALIKE, capsys, **encoders)
    assert (
        out.count("its zero is not identified") == 2
        and "the reach of the machine: encoders as in the map (0 of the samples)" in out
    )


def test_distal_links_and_turns_are_put_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Distal links are exchanged, one is reversed, and one encoder is off by a turn."""
    posture = Kinematics.from_values(LENGTHS).forward(MOTION)
    columns = [MOTION[:, 0] - 2 * np.pi, MOTION[:, 1], 0.3 - posture.theta[:, 2], posture.theta[:, 1]]
    file = write_csv(tmp_path / "a.csv", "time,a,b,x,y", GRID, *columns)
    passive = {f"passive.theta[{i}]": {"column": c} for i, c in ((1, "x"), (2, "y"))}
    _, found = guessed(tmp_path, file, LENGTHS, capsys, t1={"column": "a"}, t2={"column": "b"}, **passive)
    # An offset is printed with six digits.
    assert found.columns["measured.theta[1]"] == pytest.approx(MOTION[:, 0], abs=1e-6)
    for i in (1, 2):
        apart = found.columns[f"passive.theta[{i}]"] - posture.theta[:, i]
        assert np.exp(1j * apart) == pytest.approx(1.0, abs=2e-6)


def test_evidence_of_another_machine_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The distal links are those of a machine twice as wide, and no angle follows the commands: the map stays unchanged."""
    posture = Kinematics.from_values(LENGTHS | {"link[2].length": 0.3, "link[3].length": 0.3}).forward(MOTION)
    commands = np.column_stack([np.sin(11 * GRID), np.cos(13 * GRID)])
    file = write_csv(tmp_path / "a.csv", "time,a,b,x,y,c,d", GRID, *MOTION.T, *posture.theta[:, 1:3].T, *commands.T)
    names = [f"{name}.theta[{i}]" for name in ("passive", "servo") for i in (1, 2)]
    more = {name: {"column": column} for name, column in zip(names, "xycd", strict=True)}
    out, _ = guessed(tmp_path, file, LENGTHS, capsys, t1={"column": "a"}, t2={"column": "b"}, **more)
    assert out.count("this is left out") == 2 and out.count("its zero is not identified") == 2
    assert "the map may stay as it is" in out


def test_a_guess_needs_both_encoders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_csv(tmp_path / "a.csv", "time,theta[1]", GRID, LEFT)
    words = ["--guess", str(machine_file(tmp_path, ALIKE)), "-o", str(tmp_path / "record.csv")]
    assert main(["import", str(file), *words]) == 2
    assert capsys.readouterr().err == "fivebar import: the map has no measured.theta[2]; a guess needs both encoders\n"
    assert not (tmp_path / "record.csv").exists()


# --- refused input --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("[]", "a map must be an object of variables and their columns"),
        ('{"theta[3]": {}}', "'theta[3]' is not a variable of a recording; did you mean"),
        ('{"theta[1]": {"column": "q"}}', "'theta[1]' is not a variable of a recording; did you mean 'measured.theta[1]'?"),
        ('{"tau[1]": {"column": "i"}}', "it has neither measured.theta[1] nor measured.theta[2]"),
        ('{"measured.theta[1]": "q"}', "'measured.theta[1]' must be an object such as {\"column\": \"q1\"}, not \"q\""),
        ('{"measured.theta[1]": {}}', "'measured.theta[1].column' must be the name of a column, or its number from 1 on, not null"),
        ('{"measured.theta[1]": {"column": true}}', "'measured.theta[1].column' must be the name of a column"),
        ('{"measured.theta[1]": {"colum": "q"}}', "'measured.theta[1]' has no key 'colum'; did you mean 'column'?"),
        ('{"measured.theta[1]": {"column": "q", "relative": true}}', "'measured.theta[1]' has no key 'relative'"),
        ('{"measured.theta[1]": {"column": "q", "unit": "m"}}', "'measured.theta[1].unit' must be one of rad, mrad, deg, turns, counts, not \"m\""),
        ('{"measured.theta[1]": {"column": "q", "unit": "counts"}}', "'measured.theta[1].steps' must be the steps of a turn, more than 0, "),
        ('{"measured.theta[1]": {"column": "q", "steps": 4096}}', "'measured.theta[1].steps' must be the steps of a turn, more than 0, "),
        ('{"measured.theta[1]": {"column": "q", "sign": -2}}', "'measured.theta[1].sign' must be 1 or -1, not -2"),
        ('{"measured.theta[1]": {"column": "q", "scale": 0}}', "'measured.theta[1].scale' must be a number other than 0, not 0"),
        ('{"measured.theta[1]": {"column": "q", "offset": "90"}}', "'measured.theta[1].offset' must be a number in rad, or a text such as \"90 deg\" with one of rad, mrad, deg, turns, not \"90\""),
        ('{"measured.theta[1]": {"column": "q", "offset": []}}', "'measured.theta[1].offset' must be a number, not []"),
        ('{"measured.theta[2]": {"column": "q"}, "passive.theta[1]": {"column": "p", "relative": true}}', "'passive.theta[1].relative' needs measured.theta[1]"),
        (
            '{"time": {"column": "t"}, "measured.theta[1]": {"column": "t"}}',
            "'measured.theta[1].column' is t, the column of the time",
        ),
        ('{"time": {"column": "t", "sign": 1}, "measured.theta[1]": {"column": "q"}}', "'time' has no key 'sign'"),
    ],
)  # fmt: skip
def test_a_wrong_map_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, sentence: str
) -> None:
    file = write_csv(tmp_path / "a.csv", "time,q", GRID, LEFT)
    given = tmp_path / "map.json"
    given.write_text(content, encoding="utf-8")
    assert main(["import", str(file), "--map", str(given), "-o", str(tmp_path / "record.csv")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"fivebar import: {given}: {sentence}") and error.count("\n") == 1
    assert not (tmp_path / "record.csv").exists()


@pytest.mark.parametrize("spelling", ["raw.csv", "folder/../raw.csv", "link.csv", "hard.csv"])
def test_an_input_file_is_never_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str], spelling: str) -> None:
    """The recording has columns that the record does not have."""
    first = write_csv(tmp_path / "first.csv", "time,theta[1]", GRID, LEFT)
    raw = write_csv(tmp_path / "raw.csv", "time,theta[1],temperature", GRID, LEFT, RIGHT)
    before = raw.read_bytes()
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.csv").symlink_to(raw)
    os.link(raw, tmp_path / "hard.csv")
    record = tmp_path / spelling
    assert main(["import", str(first), str(raw), "-o", str(record)]) == 2
    sentence = f"the record {record} is the input file {raw}, which it would replace; another name is needed"
    assert capsys.readouterr().err == f"fivebar import: {sentence}\n" and raw.read_bytes() == before


def test_unreadable_recordings_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each error is one sentence and lists what the file has."""
    file = write_csv(tmp_path / "a.csv", "time,q [deg],r [inch]", GRID, LEFT, RIGHT)
    bag = write_bag(tmp_path, ("/j", ["l"], GRID[:3], LEFT[:3, None]))
    (tmp_path / "b.db3").write_bytes(b"no bag" * 100)
    pq.write_table(pa.table({"time": GRID, "q": [str(x) for x in LEFT]}), tmp_path / "a.parquet")
    pq.write_table(pa.table({name: ["x"] for name in ("topic", "time", "seq", "payload")}), tmp_path / "r.parquet")
    q = {"t1": {"column": "q"}}
    dated, stamped = tmp_path / "dated.csv", tmp_path / "dated.parquet"
    dated.write_text("t,q\n2026-11-29T10:00:00,1\n2026-11-29T10:00:01,1\n", encoding="utf-8")
    pq.write_table(pa.table({"t": pa.array([0, 1], pa.timestamp("ms")), "q": [1.0, 1.0]}), stamped)
    asked: list[tuple[Path, dict[str, Any] | None, str]] = [
        (file, None, "has no column measured.theta[1] or measured.theta[2]; without --map these names are needed, and its columns are time, q, r"),
        (bag, None, "its columns are /j/l/position"),
        (file, {"t1": {"column": "p"}}, "has no column p; its columns are time, q, r"),
        (file, {"t1": {"column": "q", "unit": "rad"}}, "'measured.theta[1].unit' is 'rad', but the head of the table says that q is in deg"),
        (dated, q | {"time": {"column": "t", "unit": "ms"}}, "'time.unit' is 'ms', but t has dates, which need no unit"),
        (stamped, q | {"time": {"column": "t", "unit": "ms"}}, "'time.unit' is 'ms', but t has dates, which need no unit"),
        (file, {"t1": {"column": "r"}}, "r is in inch; rad, mrad, deg, turns is allowed for measured.theta[1]"),
        (bag, {"t1": {"column": "/j/m/position"}}, "has no column /j/m/position; its columns are /j/l/position"),
        (tmp_path / "b.db3", q, "cannot be read as a ROS bag"),
        (tmp_path / "none.db3", q, "none.db3: it cannot be read: No such file or directory"),
        (tmp_path / "none.csv", q, "none.csv: it cannot be read: No such file or directory"),
        (tmp_path, q, "is a folder: a table, or a bag of ROS with its metadata.yaml, is expected"),
        (tmp_path / "a.parquet", q, "q has the type string, but numbers are expected"),
        (tmp_path / "r.parquet", q, "is a record of `fivebar twin`, which needs no import"),
    ]  # fmt: skip
    for source, entries, sentence in asked:
        options = [] if entries is None else ["--map", str(write_map(tmp_path, **entries))]
        assert main(["import", str(source), *options, "-o", str(tmp_path / "record.csv")]) == 2
        error = capsys.readouterr().err
        assert sentence in error and error.count("\n") == 1, error
    assert main(["import", str(file), "-o", str(tmp_path / "record.parquet")]) == 2
    assert "a name that ends in .csv is needed" in capsys.readouterr().err
    assert not (tmp_path / "record.csv").exists()


def test_a_bag_without_its_package_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag needs the package; a table does not."""
    bag = write_bag(tmp_path, ("/j", ["l"], GRID, LEFT[:, None]))
    table = write_csv(tmp_path / "a.csv", "time,theta[1]", GRID, LEFT)
    installed = extras._installed
    monkeypatch.setattr(extras, "_installed", lambda name: None if name == "rosbags" else installed(name))
    assert len(imported(tmp_path, table).time) == 400
    capsys.readouterr()
    record = ["-o", str(tmp_path / "record.csv")]
    assert main(["import", str(bag), "--map", str(write_map(tmp_path, t1={"column": "/j/l/position"})), *record]) == 2
    sentence = "rosbags is needed and not installed: pip install 'fivebar[ros]' installs what is needed"
    assert capsys.readouterr().err == f"fivebar import: {sentence}\n"


# --- real machines --------------------------------------------------------------------------------------------------------------------


@pytest.fixture
def recordings() -> Path:
    """The folder with recordings of real machines. Others own these data, so the repository does not contain them."""
    folder = os.environ.get("FIVEBAR_RECORDINGS")
    if not folder:
        pytest.skip("FIVEBAR_RECORDINGS names no folder of recordings of real machines")
    return Path(folder)


PANTOGRAPH = {
    "t1": {"column": "/joint_states/joint1/position", "offset": "147 deg"},
    "t2": {"column": "/joint_states/joint2/position", "offset": "33 deg"},
}


def test_the_haptic_pantograph_of_others(tmp_path: Path, recordings: Path) -> None:
    """The encoders of the pantograph have 20,000 steps a turn; the bag contains steps of 3.14e-4 rad."""
    found = imported(tmp_path, recordings / "haptic_pantograph", given=write_map(tmp_path, **PANTOGRAPH))
    assert len(found.time) == 6055 and not found.begins and found.time[-1] == pytest.approx(60.57, abs=0.01)
    for each in quality.measure(found):
        assert each.step == pytest.approx(3.14e-4, rel=1e-3) and each.period == pytest.approx(0.01, rel=1e-3)
        assert each.lost == 4 and each.noise == 0.0


def test_zeros_of_the_pantograph_are_found(
    tmp_path: Path, recordings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a map without zeros the distal links give 147 and 33 degrees, the values of the authors."""
    raw = {name: {"column": f"/joint_states/joint{i}/position"} for i, name in ((1, "t1"), (2, "t2"))}
    passive = {
        f"passive.theta[{i}]": {"column": f"/joint_states/joint{i + 2}/position", "relative": True} for i in (1, 2)
    }
    scene = tmp_path / "machine.json"
    start = {"init.theta[1]": 2.5, "init.theta[2]": 0.6}
    scene.write_text(json.dumps({"description": "Pantograph"} | ALIKE | start), encoding="utf-8")
    words = ["--map", str(write_map(tmp_path, **raw, **passive)), "--guess", str(scene), "-o", str(tmp_path / "r.csv")]
    assert main(["import", str(recordings / "haptic_pantograph"), *words]) == 0
    proposed = json.loads(capsys.readouterr().out.partition("proposed map:")[2].partition("\n\nwritten:")[0])
    # The zeros are off by 1.2 and 1.3 mrad, well within their standard deviations of 0.5 degrees.
    assert proposed["measured.theta[1]"]["offset"] == pytest.approx(np.radians(147), abs=5e-3)
    assert proposed["measured.theta[2]"]["offset"] == pytest.approx(np.radians(33), abs=5e-3)
