"""prices.py: a table of the costs of effects. Scenes, effects and counts are checked, times are not."""

import csv
from pathlib import Path

import pytest

import prices
from made_scene import made_scene, write


def test_prices(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(prices, "REPEATS", 2)
    folder = tmp_path / "scenes"
    folder.mkdir()
    for name, effects in (
        ("bare", {}),
        ("damped", {"viscous.enabled": True, "gravity.enabled": False, "tau[1]": 0.01}),
    ):
        write(folder / f"{name}.json", made_scene({"init.theta[2]": 2.0944} | effects, 0.2))
    out = tmp_path / "run" / "prices.csv"
    assert prices.main(["--fmu", str(fmu), "--scenes", str(folder), "--out", str(out)]) == 0
    with out.open(encoding="utf-8") as file:
        bare, damped = csv.DictReader(file)
    assert (bare["scene"], bare["effects"]) == ("bare", "gravity") and (damped["scene"], damped["effects"]) == (
        "damped",
        "viscous",
    )
    # The scene is bare itself: measured once.
    assert bare["us_per_substep"] == bare["bare_us_per_substep"]
    assert float(damped["substeps_per_step"]) >= 1.0 and float(damped["bare_us_per_step"]) > 0.0
    assert "| `damped` | viscous |" in capsys.readouterr().out


def test_prices_by_one_method(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prices, "REPEATS", 1)
    folder = tmp_path / "scenes"
    folder.mkdir()
    write(folder / "fall.json", made_scene({"init.theta[2]": 2.0944}, 0.2))
    command = ["--fmu", str(fmu), "--scenes", str(folder), "--out", str(tmp_path / "prices.csv"), "--method"]
    assert prices.main([*command, "automatic"]) == 0
    with (tmp_path / "prices.csv").open(encoding="utf-8") as file:
        [row] = csv.DictReader(file)
    # Steps past communication points; the default method makes one and more per ms.
    assert float(row["substeps_per_step"]) < 0.5
    with pytest.raises(SystemExit, match=r"^'solver\.method' must be one of i3alp, "):
        prices.main([*command, "newton"])
