"""Tables: written ones are read to the bit, by FMPy too; tables of spreadsheets and loggers are read or refused with one sentence."""

from pathlib import Path

import fmpy
import numpy as np
import pytest

from fivebar import table
from fivebar.errors import FiveBarError
from fivebar.twin.importing import maps

WANTED = ("theta[1]", "tau[1]")


def read(tmp_path: Path, content: str | bytes) -> table.Table:
    file = tmp_path / "a.csv"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return table.read(file, WANTED, "time")


HEAD = "time,theta[1],tau[1]\n"
ROWS = "0,1.5,0.25\n0.001,-1e-3,2\n"


@pytest.mark.parametrize(
    "content",
    [
        HEAD + ROWS,
        (HEAD + ROWS).replace("\n", "\r\n"),
        (HEAD + ROWS).replace("\n", "\r"),
        "\n" + HEAD + "\n" + ROWS.replace("\n", "\n\n"),
        (HEAD + ROWS).replace(",", " , "),
        (HEAD + ROWS).replace(",", ";"),
        (HEAD + ROWS).replace(",", "\t"),
        (HEAD + ROWS).replace(",", ";").replace(".", ","),
        (HEAD + ROWS).replace(",", "\t").replace(".", ","),
        '"time","theta[1]","tau[1]"\n"0","1,5","0,25"\n"0,001","-1e-3","2"\n',
        "time [s],theta[1] [rad],tau[1] [N.m]\n" + ROWS,
        "time (s),theta[1] (rad),tau[1] (N.m)\n" + ROWS,
        "time( s ),theta[1](rad),tau[1] ( N·m )\n" + ROWS,
        "time,time (ms),theta[1],theta[1] (deg),tau[1],tau[1] (filtered)\n0,0,1.5,86,.25,x\n1e-3,1,-.001,0,2,x\n",
        "time[s],theta[1][rad],tau[1] [ N.m ]\n" + ROWS,
        b"\xef\xbb\xbf" + (HEAD + ROWS).encode(),
        (HEAD + ROWS).encode("utf-16"),
        b"\xfe\xff" + (HEAD + ROWS).encode("utf-16-be"),
        "Größe,tau[1],time,theta[1],\nx,.25,0,1.5,\ny,2,1e-3,-.001,\n",
        "sep=;\n" + (HEAD + ROWS).replace(",", ";"),
        '"sep=|"\r\n' + (HEAD + ROWS).replace(",", "|"),
        "# bench, 2026; it's warm \"\n#\n" + HEAD + ROWS,
        "sep=\t\n" + (HEAD + ROWS).replace(",", "\t").replace(".", ","),
        '# "Bench" 3\n' + HEAD + ROWS,
        "# bench\n# " + HEAD + ROWS,
        "# 1,2,3\n" + HEAD + ROWS,
        "#,time,theta[1],tau[1],note\n1,0,1.5,.25,x\n2,1e-3,-.001,2,\n",
        HEAD + "2026-11-29 10:00:00.000+00:00,1.5,0.25\n2026-11-29 10:00:00.001+00:00,-1e-3,2\n",
        HEAD + "2026-11-29T10:00:59.9995Z,1.5,0.25\n2026-11-29T12:01:00.0005+0200,-1e-3,2\n",
        HEAD + "2026-11-29 10:00:00,1.5,0.25\n2026-11-29 10:00:00.001000000,-1e-3,2\n",
        "time [s];theta[1];tau[1]\n2026-12-31 23:59:59,999;1,5;0,25\n2027-01-01 00:00:00,000;-1e-3;2\n",
        HEAD + "1700000000,1.5,0.25\n1700000000.001,-1e-3,2\n",
    ],
)
def test_tables_of_other_programs_are_read(tmp_path: Path, content: str | bytes) -> None:
    """Other separators, decimal commas, units in the head and encodings make the same numbers, to the bit."""
    found = read(tmp_path, content)
    assert {name: column.tolist() for name, column in found.columns.items()} == {
        "time": [0.0, 0.001],
        "theta[1]": [1.5, -1e-3],
        "tau[1]": [0.25, 2.0],
    }


def test_a_cell_without_a_finite_number_is_none(tmp_path: Path) -> None:
    cells = ["", " ", "nan", "NaN", "NA", "null", "inf", "-Infinity", "1e999"]
    found = read(tmp_path, "time,theta[1]\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells)) + ",7\nnan,8\n")
    assert np.isnan(found.columns["theta[1]"][:-2]).all() and found.columns["theta[1]"][-2:].tolist() == [7.0, 8.0]
    assert found.columns["time"][:-2].tolist() == list(range(len(cells))) and np.isnan(found.columns["time"][-2:]).all()


def test_units_in_parentheses_are_units_of_the_head_unless_the_name_is_wanted_with_them(tmp_path: Path) -> None:
    head = "time (ms),theta[1] (deg),tau[1] (at rest),theta(2)\n"
    found = read(tmp_path, head + "0,1,2,3\n")
    assert found.units == {"time": "ms", "theta[1]": "deg"} and found.others == ["tau[1] (at rest)", "theta(2)"]
    found = table.read(tmp_path / "a.csv", ("theta[1] (deg)",), "time (ms)")
    assert set(found.columns) == {"time (ms)", "theta[1] (deg)"} and not found.units


def test_names_that_differ_only_in_their_units_keep_them_if_they_are_not_read(tmp_path: Path) -> None:
    found = read(tmp_path, "time (s),temp (deg),temp (rad)\n0,1,2\n")
    assert found.units == {"time": "s"} and found.others == ["temp (deg)", "temp (rad)"]


def test_spellings_of_units_are_those_of_the_maps(tmp_path: Path) -> None:
    """Each unit that is recognised in parentheses is one of a map, except um, which is refused by name."""
    known = {unit for units in maps.UNITS.values() for unit in units} | {maps.COUNTS, "um"}
    assert known == table.WORDS and {*table.SPELLINGS.values()} <= known
    spellings = {"seconds": "s", "rev": "turns", "rev/s": "turns/s", "°/s": "deg/s", "N·m": "N.m", "m N m": "mN.m"}
    for unit, plain in spellings.items():
        assert table.heads([f"a ({unit})"]) == [("a", unit)] and table.spelled(unit) == plain


def test_dates_without_a_value_are_none_and_keep_nanoseconds(tmp_path: Path) -> None:
    rows = ["", "2026-11-29T10:00:00.123456789", "NaT", "2026-11-29T10:00:00.123456790"]
    found = read(tmp_path, "time,theta[1]\n" + "".join(f"{row},{k}\n" for k, row in enumerate(rows)))
    assert np.isnan(found.columns["time"][[0, 2]]).all() and found.columns["time"][[1, 3]].tolist() == [0.0, 1e-9]
    assert found.units == {"time": "s"}


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("time,tau[1],tau[1]\n0,1,2\n", "it has 2 columns tau[1]; each name must be unique"),
        ("time,tau[1],tau[1] [N.m]\n0,1,2\n", "it has 2 columns tau[1]; each name must be unique"),
        ("time,tau[1] (N.m),tau[1] (mN.m)\n0,1,2\n", "it has 2 columns tau[1]; each name must be unique"),
        ("time,note,note\n0,1,2\n", "it has 2 columns note; each name must be unique"),
        ("time,tau[1]\n0,1\n1,x\n", "tau[1] in row 2 is 'x', which is not a number"),
        ("time;tau[1]\n0;1.000,5\n", "tau[1] in row 1 is '1.000,5', which is not a number"),
        ("time,tau[1]\n0,1\n12:03,1\n", "time in row 2 is '12:03', which is not a number or a date such as 2026-11-29T10:00:00.005"),
        ("time,tau[1]\n2026-11-29T10:00:00,1\n0.005,1\n", "time in row 2 is '0.005', which is not a date such as 2026-11-29T10:00:00.005"),
        ("time,tau[1]\n0,1\n2026-11-29T10:00:00,1\n", "time in row 2 is '2026-11-29T10:00:00', which is not a number"),
        ("time,tau[1]\n2026-11-29T10:00.5,1\n", "time in row 1 is '2026-11-29T10:00.5', which is not a number or a date"),
        ("time,tau[1]\n2026-13-29T10:00:00,1\n", "time in row 1 is '2026-13-29T10:00:00', which is not a date"),
        ("time,tau[1]\n0,2026-11-29T10:00:00\n", "tau[1] in row 1 is '2026-11-29T10:00:00', which is not a number"),
        ("time,tau[1]\n0,5,1,5\n", "row 1 has 4 cells, but the head 2; a decimal comma needs semicolons or tabs"),
        ("time,tau[1]\n0,5\n1\n", "row 2 has 1 cells, but the head 2"),
        ('time,tau[1]\n0,"5\n', "it is no CSV: unexpected end of data"),
        ("time,tau[1],Größe\n".encode("latin-1"), "it cannot be read: it is not valid UTF-8 at byte 14; text in UTF-8, or in"),
        ("time,tau[1]\n".encode("utf-16-le"), "it cannot be read: it has the character 0, which no text has; text in UTF-8"),
        (b"\xff\xfe" + b"t\0i\0m\0e", "it cannot be read: it is not valid UTF-16 at byte 8"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused(tmp_path: Path, content: str | bytes, sentence: str) -> None:
    with pytest.raises(FiveBarError) as refused:
        read(tmp_path, content)
    assert str(refused.value).startswith(f"{tmp_path / 'a.csv'}: {sentence}")
    assert "\n" not in str(refused.value)


def test_a_table_that_is_written_is_read_to_the_bit(tmp_path: Path) -> None:
    """This package and FMPy read it; FMPy needs the exact name in the head."""
    columns = {"time": np.arange(3) * 0.1, "theta[1]": np.array([np.pi, 5e-324, -0.1]), "tau[1]": np.array([1, 2, 3])}
    table.write_columns(tmp_path / "a.csv", columns)
    own, theirs = table.read(tmp_path / "a.csv", WANTED, "time"), fmpy.read_csv(tmp_path / "a.csv")
    for name, column in columns.items():
        assert own.columns[name].tolist() == column.tolist() == theirs[name].tolist()


def test_columns_are_written_as_their_values(tmp_path: Path) -> None:
    """Each value has its shortest digits, whether the column changes or not: 0 and -0 differ, and NaN equals NaN."""
    columns = {
        "time": np.zeros(3),
        "signed": np.array([0.0, -0.0, 0.0]),
        "none": np.full(3, np.nan),
        "third": np.full(3, 1 / 3),
        "count": np.array([7, 7, 7]),
    }
    table.write_columns(tmp_path / "a.csv", columns)
    head, *rows = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    assert head == "time,signed,none,third,count"
    assert rows == [f"0.0,{signed},nan,{1 / 3!r},7" for signed in ("0.0", "-0.0", "0.0")]
    for count in (0, 1):
        table.write_columns(tmp_path / "a.csv", {name: column[:count] for name, column in columns.items()})
        assert (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines() == [head, *rows[:count]]
