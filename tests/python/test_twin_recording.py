"""Recordings: one reader for calibration and twin, clocks that restart, units, playback."""

import math
import re
import warnings
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fivebar import simulate
from fivebar import table as tables
from fivebar.errors import MachineWarning
from fivebar.library import Library
from fivebar.own_unit import write_unit
from fivebar.scene import Scene, Variant
from fivebar.twin import recording, turn
from fivebar.twin.calibrate import data
from fivebar.twin.config import Config, Machine
from fivebar.twin.errors import TwinError
from fivebar.twin.follower import LONGEST_GAP
from fivebar.twin.importing import assemble, maps
from fivebar.twin.machine import Player
from fivebar.twin.messages import MEASURED
from fivebar.twin.soak import configured
from fivebar.twin.starter import sampling
from twin_support import follower


def table(folder: Path, times: np.ndarray, head: str = "time,measured.theta[1],measured.theta[2]") -> Path:
    """A table with angles of k mrad and 1 rad + k mrad in row k."""
    file = folder / "a.csv"
    rows = [f"{round(t, 6)!r},{1e-3 * k!r},{1 + 1e-3 * k!r}" for k, t in enumerate(times.tolist())]
    file.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return file


def player(file: Path, period: float = 0.005) -> Player:
    return Player(Config(str(file.parent), "", "", machine=Machine(csv=str(file)), period=period))


GRID = 0.005 * np.arange(200)


@pytest.mark.parametrize(("begin", "other"), [(0.0, 0.0), (0.0, 0.0012), (100.0, 7.0), (3.0, 3.5)])
def test_a_clock_that_restarts_makes_series(tmp_path: Path, begin: float, other: float) -> None:
    """Rows stay in order and none is left out: series are not merged by time, and rows with equal times are kept."""
    file = table(tmp_path, np.concatenate([begin + GRID, other + GRID]))
    found = data.read(file, 0.0, 10.0)
    assert [len(series) for series in found.series] == [200, 200]
    assert np.concatenate([series.angles[:, 0] for series in found.series]) == pytest.approx(1e-3 * np.arange(400))
    first, second = (series.time for series in found.series)
    assert first == pytest.approx(GRID) and second - second[0] == pytest.approx(GRID) and second[0] > first[-1]
    assert found.notes == ["1 gaps or jumps of the clock; 0 series of less than 20 samples are left out"]


def test_a_series_of_another_rate_is_used(tmp_path: Path) -> None:
    """Gaps are measured in periods of the own series; a gap in the slower one splits it."""
    slow = np.delete(0.05 * np.arange(60), range(30, 36))
    found = data.read(table(tmp_path, np.concatenate([GRID, slow])), 0.0, math.inf)
    assert [len(series) for series in found.series] == [200, 30, 24] and not found.left_out
    assert [series.period for series in found.series] == pytest.approx([0.005, 0.05, 0.05])


def test_a_rate_that_changes_within_a_series_is_named(tmp_path: Path) -> None:
    """Samples that are left out are named by a warning, not only by a note."""
    file = table(tmp_path, np.concatenate([GRID, 1.0 + 0.05 * np.arange(60)]))
    with pytest.warns(MachineWarning, match="a.csv: 59 of 260 samples are left out, because there are fewer than 20 "):
        found = data.read(file, 0.0, math.inf)
    assert [len(series) for series in found.series] == [201]


def test_a_part_is_counted_over_all_series(tmp_path: Path) -> None:
    file = table(tmp_path, np.concatenate([GRID, GRID, GRID]))
    found = data.read(file, 0.5, 1.0)
    assert [len(series) for series in found.series] == [100, 101]
    rest = data.read(file, 0.5, math.inf)
    assert [len(series) for series in rest.series] == [100, 200, 200]
    assert rest.notes[-1] == "used are 500 of 600 samples: all from 0.5 s on"


def test_rows_without_a_time_of_their_own_are_left_out(tmp_path: Path) -> None:
    file = table(tmp_path, GRID)
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join([head, *(row for row in rows for _ in range(2))]) + "\n", encoding="utf-8")
    found = recording.read(file)
    assert found.time == pytest.approx(GRID) and found.columns["measured.theta[1]"] == pytest.approx(
        1e-3 * np.arange(200)
    )
    assert found.notes == ["200 rows without a time of their own left out"] and found.begins == ()
    assert found.coarse == ""


def test_a_coarse_clock_is_named(tmp_path: Path) -> None:
    """Stamps of 10 ms at 1 kHz: nine of ten samples have the time of the row above, with other readings. A few such rows are no coarse clock."""
    file = table(tmp_path, np.floor(0.1 * np.arange(1000) + 1e-9) / 100)
    with pytest.warns(MachineWarning, match="a.csv: 900 of 1000 samples are left out, because they repeat the time"):
        found = data.read(file, 0.0, 10.0)
    assert [len(series) for series in found.series] == [100] and found.notes == [found.coarse]
    # A player warns, too; it needs a record of more than 1 s.
    file = table(tmp_path, np.floor(0.1 * np.arange(1200) + 1e-9) / 100)
    with pytest.warns(MachineWarning, match="a.csv: 1080 of 1200 samples are left out") as warned:
        player(file).check()
    assert len(warned) == 1
    few = recording.read(table(tmp_path, np.concatenate([GRID, [GRID[-1]]])))
    assert few.coarse == "" and few.notes == ["1 rows without a time of their own left out"]


def test_a_row_per_encoder_is_no_coarse_clock(tmp_path: Path) -> None:
    """Rows of one time that complete each other have no other readings."""
    file = tmp_path / "a.csv"
    rows = [row for k, t in enumerate(GRID.tolist()) for row in (f"{t!r},{1e-3 * k!r},", f"{t!r},,{1 + 1e-3 * k!r}")]
    file.write_text("\n".join(["time,measured.theta[1],measured.theta[2]", *rows]) + "\n", encoding="utf-8")
    found = recording.read(file)
    assert found.coarse == "" and found.notes == ["200 rows without a time of their own left out"]


@pytest.mark.parametrize(
    ("time", "count"),
    [(np.full(200, 1.7953314e9), "1 different time;"), (1e9 + 10.0 * (GRID > 0.5), "2 different times;")],
)
def test_times_with_too_few_digits_are_refused(tmp_path: Path, time: np.ndarray, count: str) -> None:
    """Times since 1970 that were printed with eight digits."""
    with pytest.raises(
        TwinError, match=f"a.csv: 200 rows with a time have {count} 20 or more are needed: the time column has too few"
    ):
        recording.read(table(tmp_path, time))


@pytest.mark.parametrize(
    ("head", "sentence"),
    [
        ("time [ms],theta[1],theta[2]", "time is in ms, but s is expected"),
        ("time,theta[1] [deg],theta[2]", "theta[1] is in deg, but rad is expected"),
        ("time,theta[1],theta[2] (deg)", "theta[2] is in deg, but rad is expected"),
        ("time (ms),theta[1],theta[2]", "time is in ms, but s is expected"),
        (
            "t,theta[1],theta[2]",
            "has no column time (s); its head is theta[1], theta[2], t; commas, semicolons or tabs",
        ),
        ("time theta[1] theta[2],a,b", "has no column time (s)"),
        (
            "time,angle1,angle2",
            "has no column measured.theta[1] or measured.theta[2]; its columns are time, angle1, angle2; `fivebar import --map` reads columns",
        ),
    ],
)
def test_a_head_that_does_not_fit_is_refused(tmp_path: Path, head: str, sentence: str) -> None:
    """Both commands refuse such a head with the same sentence."""
    file = table(tmp_path, GRID, head)
    for reads in (player, lambda file: data.read(file, 0.0, 10.0)):
        with pytest.raises(TwinError) as refused:
            reads(file)
        assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ("", "has no column time (s); its head is nothing"),
        ("0,1,2\n0.1,1,2\n", "has no column time (s); its head is 0, 1, 2"),
        ("time,theta[1]\n", "has no number in measured.theta[1] or measured.theta[2]"),
        ("time,theta[1]\n0,nan\n", "has no number in measured.theta[1] or measured.theta[2]"),
        ("time,theta[1]\n,1\nnan,2\n", "has no row with a time"),
    ],
)
def test_a_table_without_samples_is_refused(tmp_path: Path, rows: str, sentence: str) -> None:
    (tmp_path / "a.csv").write_text(rows, encoding="utf-8")
    for reads in (player, lambda file: data.read(file, 0.0, 10.0)):
        with pytest.raises(TwinError) as refused:
            reads(tmp_path / "a.csv")
        assert sentence in str(refused.value)


def test_a_missing_encoder_is_named(tmp_path: Path) -> None:
    file = table(tmp_path, 2 * GRID, "time,theta[1],measured.theta[2] (raw)")
    sentence = f"{file} has no number in measured.theta[2]; both encoders are needed; columns that are not used: measured.theta[2] (raw)"
    with pytest.warns(MachineWarning), pytest.raises(TwinError, match=f"^{re.escape(sentence)}$"):
        data.check(data.read(file, 0.0, 10.0))


@pytest.mark.parametrize(
    ("other", "name"),
    [
        ("tau1", "tau[1]"),
        ("Tau_1 (mNm)", "tau[1]"),
        ("theta2", "measured.theta[2]"),
        ("measured.theta[2] (deg)", "measured.theta[2]"),
        ("servo.theta 1", "servo.theta[1]"),
        ("current", None),
        ("theta1", None),
    ],
)
def test_a_column_that_is_probably_misspelt_is_warned_of(other: str, name: str | None) -> None:
    """The record has an angle of encoder 1."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording.of_columns({"time": GRID, "theta[1]": GRID, other: GRID})
    sentence = f"the record: the column {other} is not used, and there is no {name}: is this column meant?"
    assert [str(each.message) for each in caught] == ([sentence] if name else [])


@pytest.mark.parametrize("order", ["shuffled", "from last to first"])
def test_rows_that_are_not_sorted_are_not_taken_for_another_unit(order: str) -> None:
    rows = np.random.default_rng(0).permutation(200) if order == "shuffled" else np.arange(200)[::-1]
    backs = int(np.count_nonzero(np.diff(rows) < 0))
    sentence = f"the record: time falls back in {backs} of 200 rows, too often for restarts of a clock: rows sorted by time are needed"
    with pytest.raises(TwinError, match=f"^{sentence}$"):
        recording.of_columns({"time": GRID[rows], "theta[1]": 1 + GRID[rows]})


@pytest.mark.parametrize("kind", ["timestamp", "zone", "duration", "index", "datetime", "datetime64", "timedelta64"])
def test_times_may_be_dates_and_durations(kind: str) -> None:
    """The first time is since 1970 and keeps its nanoseconds."""
    ns = 1_790_000_000_123_456_789 + np.round(1e9 * GRID).astype(np.int64)
    dates = pandas.Series(pandas.to_datetime(ns))
    frame = pandas.DataFrame({"theta[1]": GRID})
    if kind == "index":
        frame.index = pandas.DatetimeIndex(dates, name="time")
    else:
        frame["time"] = {
            "timestamp": dates,
            "zone": dates.dt.tz_localize("Europe/Berlin"),
            "duration": dates - dates[0],
        }.get(kind, GRID)
    given: Any = {
        "datetime": {"time": [datetime(2026, 11, 29) + timedelta(seconds=t) for t in GRID.tolist()], "theta[1]": GRID},
        "datetime64": {"time": ns.astype("datetime64[ns]"), "theta[1]": GRID},
        "timedelta64": {"time": [np.timedelta64(5 * k, "ms") for k in range(200)], "theta[1]": GRID},
    }.get(kind, frame)
    assert recording.of_columns(given).time == pytest.approx(GRID, abs=1e-12)


def test_dates_with_a_zone_are_taken_without_a_warning() -> None:
    """Clocks were changed in Berlin between these two: one hour passes."""
    zone = ZoneInfo("Europe/Berlin")
    dates = [datetime(2026, 10, 25, 2, 30, tzinfo=zone, fold=fold) for fold in (0, 1)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert recording._seconds([*dates, None])[:2].tolist() == [0.0, 3600.0]


@pytest.mark.parametrize("times", [[[0], [0, 1]], [datetime(2026, 11, 29), "x", 5], [datetime(2026, 11, 29), 5, 5]])
def test_times_that_are_no_column_are_one_sentence(times: Any) -> None:
    with pytest.raises(TwinError, match=r"^the record: time must be a column of numbers, not .*$"):
        recording.of_columns({"time": times, "theta[1]": np.arange(3.0)})


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "there is no record at FILE: a Parquet file or a folder of parts is expected"),
        ({"topic": ["a"], "time": [1], "seq": [1], "payload": [b""]}, "FILE is a record of `fivebar twin`, but a table (CSV or Parquet) is expected"),
        ({"t": [1.0]}, "FILE has no column time (s); its head is t"),
        ({"time [ms]": [1.0]}, "FILE: time is in ms, but s is expected"),
        ({"time": [1.0], "time [s]": [1.0]}, "FILE has two columns time; each name must be unique"),
        ({"time": pa.array([10**13], pa.timestamp("ms"))}, "FILE: time of the type timestamp[ms] has values that are too large: dates from 1678 to 2262 are allowed"),
        ({"time": pa.array([2**63], pa.uint64())}, "FILE: time of the type uint64 has values that are too large: numbers below 2^63 are allowed"),
    ],
)  # fmt: skip
def test_a_parquet_file_that_is_no_table_is_named(tmp_path: Path, content: Any, sentence: str) -> None:
    file = tmp_path / "a.parquet"
    if content is not None:
        pq.write_table(pa.table(content), file)
    with pytest.raises(TwinError, match=f"^{re.escape(sentence.replace('FILE', str(file)))}$"):
        recording.read(file)


def test_a_folder_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(TwinError, match=r"is a folder, but a table \(CSV or Parquet\) is expected$"):
        recording.read(tmp_path)


def test_units_and_empty_columns_of_parquet_are_taken_as_in_csv(tmp_path: Path) -> None:
    columns = {"time (s)": GRID, "theta[1] [rad]": GRID, "theta[2]": pa.nulls(len(GRID))}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    found = recording.read(tmp_path / "a.parquet")
    assert found.columns["measured.theta[1]"].tolist() == GRID.tolist()
    assert np.isnan(found.columns["measured.theta[2]"]).all()


@pytest.mark.parametrize("clock", ["s", "timestamp", "duration"])
def test_a_table_in_parquet_is_read_as_its_csv(tmp_path: Path, clock: str) -> None:
    """Calibration and twin read it; errors are the same too."""
    frame = pandas.read_csv(table(tmp_path, GRID, "time,theta[1],theta[2]")).assign(note="x")
    if clock == "timestamp":
        frame["time"] = pandas.to_datetime(1_790_000_000_000_000_000 + (1e9 * GRID).round().astype(np.int64))
    if clock == "duration":
        frame["time"] = pandas.to_timedelta((1e9 * GRID).round().astype(np.int64))
    file = tmp_path / "a.parquet"
    frame.to_parquet(file)
    found, (series,) = player(file).recording, data.read(file, 0.0, 10.0).series
    assert found.time == pytest.approx(GRID, abs=1e-12) and series.time == pytest.approx(GRID, abs=1e-12)
    assert found.columns["measured.theta[2]"].tolist() == series.angles[:, 1].tolist() == frame["theta[2]"].tolist()
    assert found.notes == ["columns that are not used: note"]
    frame.drop(columns="time").to_parquet(file)
    for reads in (player, lambda file: data.read(file, 0.0, 10.0)):
        with pytest.raises(TwinError, match=r"has no column time \(s\); its head is theta\[1\], theta\[2\], note"):
            reads(file)


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_dates_in_a_csv_are_taken_as_in_parquet(zone: str | None, tmp_path: Path) -> None:
    """As pandas writes them: `recording`, with all decimals; calibration, twin and import read them."""
    ns = 1_790_000_000_123_456_789 + np.round(1e9 * GRID).astype(np.int64)
    dates = pandas.Series(pandas.to_datetime(ns)).dt.tz_localize(zone)
    frame = pandas.DataFrame({"time": dates, "theta[1]": GRID, "theta[2]": GRID})
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert recording.read(tmp_path / "a.csv").time == pytest.approx(GRID, abs=1e-12)
    assert assemble.recorded([tmp_path / "a.csv"], maps.Map())[0].time == pytest.approx(GRID, abs=1e-12)
    frame.to_csv(tmp_path / "b.csv", index=False, header=False)
    given = {"time": {"column": 1}, "measured.theta[1]": {"column": 2}, "measured.theta[2]": {"column": 3}}
    assert assemble.recorded([tmp_path / "b.csv"], maps.parse(given))[0].time == pytest.approx(GRID, abs=1e-12)


def test_a_missing_date_is_a_row_without_a_time() -> None:
    dates = pandas.Series(pandas.to_datetime([None, 1_790_000_000_000, None, 1_790_000_000_005], unit="ms"))
    found = recording.of_columns({"time": dates, "theta[1]": np.arange(4.0)})
    assert found.columns["measured.theta[1]"].tolist() == [1.0, 3.0]


def test_units_may_stand_in_the_head(tmp_path: Path) -> None:
    for head in ("time [s],theta[1] [rad],tau[1] [N·m]", "time (s),theta[1] (rad),tau[1] (N·m)"):
        found = recording.read(table(tmp_path, GRID, head))
        assert set(found.columns) == {"measured.theta[1]", "tau[1]"} and found.notes == []


def test_series_are_played_with_a_pause_and_lost_samples_are_counted(tmp_path: Path) -> None:
    """A machine also counts lost samples; after the pause the twin restarts."""
    times = np.concatenate([GRID[:30], GRID[130:160], GRID[:30]])
    played = player(table(tmp_path, times))
    samples = [played.next() for _ in range(90)]
    assert played.next() is None
    numbers, at = [sample.seq for sample in samples], [sample.time for sample in samples]
    assert numbers[:60] == [*range(30), *range(130, 160)] and at[:60] == [5_000_000 * k for k in numbers[:60]]
    assert at[60] - at[59] > 1e9 * LONGEST_GAP and 0.005 * (numbers[60] - numbers[59]) > LONGEST_GAP
    assert np.diff(numbers[60:]).tolist() == [1] * 29 and np.diff(at[60:]).tolist() == [5_000_000] * 29
    assert samples[60].fields["measured.theta[1]"] == 0.06


def test_a_row_without_an_angle_is_a_lost_sample(tmp_path: Path) -> None:
    """Such a row is not sent, because the message would be invalid. The row's commands take effect."""
    file = tmp_path / "a.csv"
    file.write_text("time,theta[1],theta[2],tau[1],tau[2]\n0,1,2,,\n0.005,,nan,1,\n0.01,1,,,\n", encoding="utf-8")
    played = player(file)
    sent = [played.next(), played.next(), played.next()]
    assert [(each.seq, each.fields) for each in sent if each is not None] == [
        (0, {"measured.theta[1]": 1.0, "measured.theta[2]": 2.0, "tau[1]": 1.0}),
        (2, {"measured.theta[1]": 1.0, "tau[1]": 1.0}),
    ]


def test_the_twin_has_the_period_of_the_recording(tmp_path: Path) -> None:
    """Samples of 1 ms are not counted as 5 ms apart."""
    assert sampling(table(tmp_path, 0.2 * GRID)) == 0.001
    assert sampling(table(tmp_path, np.concatenate([20 * GRID, 20 * GRID]))) == 0.1
    with pytest.raises(TwinError, match=r"has a sample every 5e-05 s \(median\); 0.0001 s or more is expected"):
        sampling(table(tmp_path, 0.01 * GRID))


def test_the_table_of_a_run_is_a_recording(tmp_path: Path, fmu: Path) -> None:
    """The head, with units, needs no change."""
    result = simulate.run("pick_and_place", fmu=fmu)
    file = result.to_csv(tmp_path / "run.csv")
    found = data.read(file, 0.0, 10.0)
    (series,) = found.series
    assert series.names == ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")
    assert series.time.tolist() == result.time.tolist() and series.angles[:, 1].tolist() == result["theta[2]"].tolist()
    played = player(file, 0.001)
    played.check()
    assert (sample := played.next()) is not None and sample.fields["servo.theta[1]"] == result["servo.theta[1]"][0]


def test_each_series_begins_in_a_turn_of_its_own(tmp_path: Path, fmu: Path) -> None:
    """In calibration and twin, the encoders' counts restart with the clock; the servos' commands do not."""
    result = simulate.run("pick_and_place", fmu=fmu)
    columns = {
        name: np.tile(result[name][:100], 2)
        for name in ("time", "theta[1]", "theta[2]", "servo.theta[1]", "servo.theta[2]")
    }
    columns["theta[1]"][100:] -= turn.TURN
    columns["theta[2]"][:100] += turn.TURN
    file = tmp_path / "a.csv"
    tables.write(file, columns, zip(*(column.tolist() for column in columns.values()), strict=True))
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, "pick_and_place")
    twin = follower(config, library)
    first, second = data.turned(data.read(file, 0.0, 10.0), library, twin.setup.values).series
    # Adding and subtracting a turn leaves round-off.
    assert first.angles == pytest.approx(second.angles, abs=1e-14)
    assert first.angles[:, 0] == pytest.approx(result["theta[1]"][:100], abs=1e-14)
    played, turns = player(file, config.period), []
    while (sample := played.next()) is not None:
        twin.meas(sample)
        assert twin.book is not None and not (turns and twin.book.turns == turns[-1] and twin.begun)
        if twin.begun:
            turns.append(twin.book.turns)
            twin.begun = ""
    assert turns == [{MEASURED[1]: -1.0}, {MEASURED[0]: 1.0}]
    twin.close()
    library.close()


def test_a_unit_of_ones_own_has_its_effects_enabled(tmp_path: Path, fmu: Path) -> None:
    """A calibration without a scene takes the unit's start values: its springs decide the turn, not the start."""
    values = {"spring.enabled": True} | {
        f"spring.{name}[{i}]": x for i in (1, 2) for name, x in (("k", 0.5), ("theta0", 8.0))
    }
    own = write_unit(tmp_path, Scene("mine", "Mine", 1.0, 0.01, [Variant("", values)]), plain=fmu).file
    library = Library(own)
    begins = turn.begins(library, {}, {}, [8.0 - turn.TURN, math.nan])
    library.close()
    assert [begin.turns for begin in begins] == [1, 0] and "spring.theta0[1] = 8 rad" in begins[0].sentence
