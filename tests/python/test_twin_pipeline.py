"""The twin's whole pipeline: the processes of `fivebar-twin run` with the broker that comes along."""

import hashlib
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import REPOSITORY

COMMAND = [sys.executable, "-m", "fivebar_twin"]


def started(out: Path, fmu: Path, scenes: Path, *more: str) -> "subprocess.Popen[str]":
    """A run of its own."""
    given = ["run", "--scene", str(scenes / "pick_and_place.json"), "--fmu", str(fmu), "--out", str(out), *more]
    return subprocess.Popen([*COMMAND, *given], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_two_runs_side_by_side_end_with_all_that_is_promised(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """Two starts find ports of their own; each leaves summary, pictures, page and a record that is replayed to the bit."""
    runs = {name: started(tmp_path / name, fmu, scenes, "--seconds", "3", "--unit", name) for name in ("one", "two")}
    for name, run in runs.items():
        text = run.communicate(timeout=90)[0]
        assert run.returncode == 0, text
        out = tmp_path / name
        summary = json.loads((out / "summary.json").read_text())
        samples, forecasts = summary["samples"], summary["forecasts"]
        assert samples["published"] > 500 and samples["lost"] == 0 and samples["estimated"] == samples["published"], text
        assert 0 < summary["latency_ms"]["p50"] <= summary["latency_ms"]["p99"]
        assert summary["tip_error_mm"]["rms"] < 0.1
        # Forecasts come last where cores are busy: sixty are due.
        assert forecasts["count"] > 10 and 0 < forecasts["halfwidth_mm"]["median"] <= 20
        assert summary["alarms"] == 0 and summary["refused"] == 0 and not any(summary["restarts"].values()), text
        page = (out / "index.html").read_text()
        assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page) and page.count("<svg") == 4
        for picture in ("tip", "error", "forecast", "latency"):
            assert (out / f"{picture}.png").read_bytes().startswith(b"\x89PNG")
        replay = subprocess.run([*COMMAND, "replay", summary["record"], "--fmu", str(fmu)], capture_output=True, text=True, check=False)
        assert replay.returncode == 0 and f"{samples['estimated']} estimates" in replay.stdout, replay.stdout + replay.stderr
        for log in Path(summary["record"]).parent.glob("log/*.log"):
            lines = log.read_text().splitlines()
            assert all("INFO connected" in line or "no connection" in line for line in lines), (log.name, lines)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--broker", "192.0.2.1:1883"], "user, password and TLS (ca_file) are required there"),
        (["--broker", "nonsense"], "HOST:PORT is expected"),
        (["--seconds", "0"], "more than 0 are needed"),
        (["--faults", "lost=7"], "NAME=SHARE is expected"),
        (["--unit", "a/b"], "letters, digits, - and _ are allowed"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_starts(tmp_path: Path, fmu: Path, scenes: Path, more: list[str], sentence: str) -> None:
    run = started(tmp_path / "out", fmu, scenes, *more)
    text = run.communicate(timeout=60)[0]
    assert run.returncode == 2 and sentence in text and "Traceback" not in text, text
    assert not (tmp_path / "out").exists()


def test_mqtt_js_is_the_pinned_one() -> None:
    """dist/mqtt.min.js of the npm package mqtt 5.16.0: `npm pack mqtt@5.16.0`."""
    script = (REPOSITORY / "twin" / "fivebar_twin" / "page" / "mqtt.min.js").read_bytes()
    assert hashlib.sha256(script).hexdigest() == "f3cbeae580d3010048938ee370f2db0c15d16e6f7fc147cb32ae5510e571b387"


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    run = subprocess.run([*COMMAND, "replay", str(tmp_path / "none")], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "there is no record" in run.stderr and "Traceback" not in run.stderr


def test_a_machine_of_ones_own_is_ten_lines(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """examples/publish_machine.py in the place of the stand-in; the starter is ended as by Ctrl-C."""
    run = started(tmp_path, fmu, scenes, "--machine", "none", "--seconds", "inf")
    assert run.stdout is not None
    found = re.match(r"broker at ([\d.]+):(\d+)", run.stdout.readline())
    assert found, run.communicate(timeout=30)[0]
    subprocess.run([sys.executable, str(REPOSITORY / "examples" / "publish_machine.py"), *found.groups()], check=True, timeout=30)
    run.send_signal(signal.SIGINT)
    text = run.communicate(timeout=60)[0]
    assert run.returncode == 0, text
    samples = json.loads((tmp_path / "summary.json").read_text())["samples"]
    assert samples == {"published": 400, "lost": 0, "estimated": 400, "recorded": 400, "late": 0}, text
