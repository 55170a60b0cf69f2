"""The twin's whole pipeline: the processes of `fivebar twin` with the included broker."""

import hashlib
import json
import re
import signal
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import paho.mqtt.client as mqtt
import pytest

from conftest import PATIENCE, REPOSITORY
from conftest import started as addresses
from fivebar import simulate
from fivebar.commands import main
from fivebar.library import Library
from fivebar.twin import config as configuration
from fivebar.twin import figures, starter
from fivebar.twin.ahead import Ahead
from fivebar.twin.config import Broker, Config
from fivebar.twin.follow import Twin
from fivebar.twin.messages import encode
from fivebar.twin.recorder import Recorder
from fivebar.twin.soak import BEGIN, Wire, configured, machine
from fivebar.twin.starter import free_port
from fivebar.twin.watch import Watch
from twin_support import recorded

COMMAND = [sys.executable, "-m", "fivebar"]


def started(out: Path, fmu: Path, scenes: Path, *more: str) -> "subprocess.Popen[str]":
    """Starts a run in a folder of its own."""
    given = ["twin", "--scene", str(scenes / "pick_and_place.json"), "--fmu", str(fmu), "--out", str(out), *more]
    return subprocess.Popen([*COMMAND, *given], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, umask=0)


def assert_private(folder: Path) -> None:
    """Only the owner may read records, states, logs and configuration of a run: 0600 in folders of 0700, whatever the umask."""
    found = {path: stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.rglob("*"))}
    kept = {path.relative_to(folder).parts[0] for path in found if path != folder}
    assert {"record", "state", "log", "status", "twin.json"} <= kept
    shown = {
        "summary.json",
        "index.html",
        "finished",
        *(f"{name}.png" for name in ("tip", "error", "forecast", "latency")),
    }
    assert not [(path, oct(mode)) for path, mode in found.items() if path.is_dir() and mode != 0o700]
    assert not [
        (path, oct(mode)) for path, mode in found.items() if path.is_file() and path.name not in shown and mode != 0o600
    ]


def test_two_runs_side_by_side_end_with_all_promised_files(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """Two starts find different ports; each writes summary, pictures, page and a private record that is replayed to the bit."""
    runs = {name: started(tmp_path / name, fmu, scenes, "--seconds", "2", "--unit", name) for name in ("one", "two")}
    for name, run in runs.items():
        text = run.communicate(timeout=PATIENCE)[0]
        assert run.returncode == 0, text
        out = tmp_path / name
        summary = json.loads((out / "summary.json").read_text())
        samples, forecasts = summary["samples"], summary["forecasts"]
        # The load decides how many samples two seconds have, how late estimates come and how many forecasts are made, so the test
        # judges none of these. The results do not depend on the load.
        # A broker on a busy machine may drop messages: these are counted, and all others are estimated.
        assert samples["published"] > 0 and samples["estimated"] == samples["published"] - samples["lost"], text
        assert 0 < summary["latency_ms"]["p50"] <= summary["latency_ms"]["p99"]
        # Lengths off by 0.1 % and encoders off by 1 mrad leave 0.5 mm.
        assert summary["tip_error_mm"]["rms"] < 0.8
        assert forecasts["due"] == samples["estimated"] // 10 and 0 <= forecasts["count"] <= forecasts["due"] + 1
        assert summary["refused"] == 0 and not any(summary["restarts"].values()), text
        assert not [
            sentence
            for sentence in summary["troubles"]["last"]
            if "disk" not in sentence and " s behind" not in sentence and "missing" not in sentence
        ], text
        page = (out / "index.html").read_text()
        assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page) and page.count("<svg") == 4
        for picture in ("tip", "error", "forecast", "latency"):
            assert (out / f"{picture}.png").read_bytes().startswith(b"\x89PNG")
        replay = subprocess.run(
            [*COMMAND, "replay", summary["record"], "--fmu", str(fmu)], capture_output=True, text=True, check=False
        )
        assert replay.returncode == 0 and f"{samples['estimated']} estimates" in replay.stdout, (
            replay.stdout + replay.stderr
        )
        assert_private(Path(summary["record"]).parent)
        for log in Path(summary["record"]).parent.glob("log/*.log"):
            lines = log.read_text().splitlines()
            expected = ("INFO connected", "no connection", " s behind", "are missing")
            assert all(any(each in line for each in expected) for line in lines), (log.name, lines)


def test_the_broker_survives_clients_that_leave_while_messages_come(tmp_path: Path) -> None:
    """Thirty clients leave while messages come as fast as the broker accepts them: the broker continues, and its log stays empty."""
    port = free_port()
    configuration.write(Config(str(tmp_path), "", "", broker=Broker(port=port)), tmp_path / "twin.json")
    command = [sys.executable, "-m", "fivebar.twin", "broker", "--config", str(tmp_path / "twin.json")]
    broker = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    sender = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            sender.connect("127.0.0.1", port)
            break
        except OSError:
            assert time.monotonic() < deadline, "the broker does not listen"
            time.sleep(0.05)
    sender.loop_start()
    for _ in range(30):
        heard = threading.Event()
        leaver = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        leaver.on_message = lambda *_, heard=heard: heard.set()
        leaver.connect("127.0.0.1", port)
        leaver.subscribe([("a", 0), ("b", 1)])
        leaver.loop_start()
        while not heard.wait(1e-3):
            assert time.monotonic() < deadline, "no message came"
            sender.publish("a", b"x" * 300)
            sender.publish("b", b"x" * 300, qos=1)
        for _ in range(20):
            sender.publish("a", b"x" * 300)
            sender.publish("b", b"x" * 300, qos=1)
        leaver.disconnect()
        leaver.loop_stop()
    sender.disconnect()
    sender.loop_stop()
    broker.terminate()
    assert broker.communicate(timeout=PATIENCE)[1] == "" and broker.returncode == 0


@pytest.mark.parametrize(("exact", "widest", "error"), [(False, 2.1, 1), (True, 0.6, 0.1)])
def test_all_forecasts_are_made_on_a_clock_that_waits_for_them(
    exact: bool, widest: float, error: float, tmp_path: Path, fmu: Path, scenes: Path
) -> None:
    """Machine, twin, forecasts, watch and recorder run in turn: the pipeline's results without the influence of load.

    Lengths off by 0.1 % and encoders off by 1 mrad put the tip off by 0.5 mm. The twin allows for both, and for eccentric encoders: its
    median half-width is 2.04 mm (1.98 mm without eccentricity).
    """
    library = Library(fmu)
    config = configured(tmp_path, fmu, library, scenes / "pick_and_place.json", exact=exact)
    twin, ahead, watch, recorder = (
        Twin(config, library),
        Ahead(config, library, at_once=True),
        Watch(config),
        Recorder(config),
    )
    recorder.about = twin.setup.to_message(config.unit, BEGIN)
    wire, source = Wire(config, twin, ahead, watch, recorder), machine(config, library)
    for _ in range(800):
        wire.send("meas", encode(source.next()))
        wire.tick()
    wire.end()
    source.close()
    library.close()
    story = figures.read(recorder.folder)
    summary = figures.summarise(config, story, figures.judge(story), {}, {})
    forecasts = summary["forecasts"]
    assert forecasts["count"] == forecasts["due"] == ahead.counts["forecasts"] == 80 and forecasts["judged"] == 70
    assert (
        forecasts["coverage95"] > 0.95 and 0 < forecasts["halfwidth_mm"]["median"] <= widest and summary["missed"] == []
    )
    assert summary["alarms"] == 0 and summary["tip_error_mm"]["max"] < error and summary["samples"]["estimated"] == 800


def test_forecasts_worse_than_promised_change_the_exit_code(
    fmu: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In `haptic` a hand pushes, which no forecast knows: fewer than nine of ten tips are inside, and the exit code is 3."""
    words = ["soak", "--hours", str(4 / 3600), "--scene", str(scenes / "haptic.json"), "--fmu", str(fmu)]
    assert main(words) == 3 and "90 % are promised" in capsys.readouterr().out
    content = {
        "scene": "pick_and_place",
        "forecasts": {"judged": 40, "coverage95": 0.89, "ahead_s": 0.5, "halfwidth_mm": {"median": 21.0}},
    }
    assert len(figures.missed(content)) == 2
    assert figures.missed(content | {"scene": "swing"}) == figures.missed(content)[:1]
    assert figures.missed({"scene": "pick_and_place", "forecasts": content["forecasts"] | {"judged": 19}}) == []


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--broker", "192.0.2.1:1883"], "user, password and TLS (ca_file) are required there"),
        (["--broker", "nonsense"], "HOST:PORT is expected"),
        (["--seconds", "0"], "seconds must be more than 0, not 0"),
        (["--faults", "lost=7"], "NAME=SHARE is expected"),
        (["--unit", "a/b"], "letters, digits, - and _ are allowed"),
    ],
)
def test_impossible_options_are_refused_before_any_process_starts(
    tmp_path: Path, fmu: Path, scenes: Path, more: list[str], sentence: str
) -> None:
    run = started(tmp_path / "out", fmu, scenes, *more)
    text = run.communicate(timeout=PATIENCE)[0]
    assert run.returncode == 2 and sentence in text and "Traceback" not in text, text
    assert not (tmp_path / "out").exists()


def test_mqtt_js_is_the_pinned_one() -> None:
    """The file is dist/mqtt.min.js of the npm package mqtt 5.16.0 (`npm pack mqtt@5.16.0`)."""
    script = (REPOSITORY / "python" / "src" / "fivebar" / "twin" / "page" / "mqtt.min.js").read_bytes()
    assert hashlib.sha256(script).hexdigest() == "f3cbeae580d3010048938ee370f2db0c15d16e6f7fc147cb32ae5510e571b387"


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    run = subprocess.run([*COMMAND, "replay", str(tmp_path / "none")], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "there is no record" in run.stderr and "Traceback" not in run.stderr


def test_a_machine_of_ones_own_is_ten_lines(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """examples/publish_machine.py replaces the stand-in; the starter is ended as by Ctrl-C."""
    run = started(tmp_path, fmu, scenes, "--machine", "none", "--seconds", "inf")
    try:
        found = re.match(r"broker at ([\d.]+):(\d+)", addresses(run))
        assert found
        subprocess.run(
            [sys.executable, str(REPOSITORY / "examples" / "publish_machine.py"), *found.groups()],
            check=True,
            timeout=PATIENCE,
        )
    finally:
        run.send_signal(signal.SIGINT)
        text = run.communicate(timeout=PATIENCE)[0]
    assert run.returncode == 0, text
    samples = json.loads((tmp_path / "summary.json").read_text())["samples"]
    counts = {"published": 400, "lost": 0, "estimated": 400, "recorded": 400, "late": 0, "followed": 400}
    assert samples == counts | {"refused": 0, "why_refused": ""}, text


def test_a_recording_replaces_any_machine(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """The table of a run is played to its end with its own period, also with `--machine none`."""
    file = simulate.run(scenes / "pick_and_place.json", fmu=fmu).to_csv(tmp_path / "run.csv")
    run = started(tmp_path / "out", fmu, scenes, "--machine", "none", "--csv", str(file), "--seconds", "inf")
    text = run.communicate(timeout=PATIENCE)[0]
    assert run.returncode == 0, text
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    samples, part = content["samples"], content["held_out"]
    # A communication point each ms for 1.6 s.
    assert samples["published"] == samples["estimated"] == samples["followed"] == 1601 and samples["lost"] == 0, text
    # A third of 1,600 ms is held out.
    assert part["samples"] == part["innovations"]["count"] == 534 and part["innovations"]["coverage95"] > 0.9, text
    # The held-out part is shorter than a forecast of 0.5 s; on a busy machine no forecast of 0.1 s begins in it either.
    assert "not judged: forecasts" in text


def test_samples_of_any_machine_are_counted(
    tmp_path: Path, fmu: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The summary counts the samples of publish_machine.py, not only those of the stand-in."""
    library = Library(fmu)
    done = recorded(configured(tmp_path, fmu, library, "pick_and_place"), library, 40)
    library.close()
    lives = {"follow": [done.twin.status()], "watch": [done.watch.status()]}
    monkeypatch.setattr(time, "monotonic", lambda: 1.5)
    next(lines := starter._progress(SimpleNamespace(status=lambda: lives), 0.0, 10.0))
    next(lines)
    assert "1.5 of 10 s   40 samples, 40 estimates" in capsys.readouterr().out
