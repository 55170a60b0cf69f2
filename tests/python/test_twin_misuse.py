"""The twin under misuse: wrong input is named, a full disk does not end estimates, clocks may jump, no error is a traceback."""

import errno
import json
import math
import os
import re
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paho.mqtt.client import MQTTMessage

from conftest import PATIENCE
from fivebar.commands import main
from fivebar.library import Library
from fivebar.twin import config as configuration
from fivebar.twin import figures, record, starter, summary
from fivebar.twin.bus import Bus
from fivebar.twin.config import Config
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.follow import Twin
from fivebar.twin.intake import CONSISTENT, FORGOTTEN, NEAR, Intake, Newest, Orders
from fivebar.twin.messages import TRACKED, Message, decode, encode
from fivebar.twin.process import Disk
from fivebar.twin.recorder import MOST_WAITING, Recorder
from fivebar.twin.replay import replay
from fivebar.twin.soak import BEGIN, Wire, configured, machine
from fivebar.twin.starter import Child, Run
from fivebar.twin.watch import NO_SAMPLE, Watch
from test_twin_messages import of_kind
from twin_support import recorded

COMMAND = [sys.executable, "-m", "fivebar"]
PERIOD_NS = 5_000_000
HOUR = 3_600_000_000_000


@pytest.fixture
def config(tmp_path: Path, fmu: Path, library: Library, scenes: Path) -> Config:
    """A run of `fivebar twin --exact`."""
    return configured(tmp_path / "run", fmu, library, scenes / "pick_and_place.json", exact=True)


def samples(config: Config, library: Library, count: int) -> list[Message]:
    source = machine(config, library)
    taken = [source.next() for _ in range(count)]
    source.close()
    return taken


class Ear:
    """Collects the messages of a worker."""

    def __init__(self, *workers: Any):
        self.heard: list[Message] = []
        for worker in workers:
            worker.send = self.send

    def send(self, kind: str, payload: bytes) -> bool:
        self.heard.append(decode(f"fivebar/bench/{kind}", payload))
        return True

    def alarms(self) -> list[dict[str, Any]]:
        return [message.extra for message in self.heard if message.kind == "alarm"]


def command(*arguments: object, **more: Any) -> "subprocess.CompletedProcess[str]":
    """Runs `fivebar`, which must not end with a traceback."""
    run = subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=PATIENCE, **more
    )
    assert "Traceback" not in run.stdout + run.stderr, run.stdout + run.stderr
    return run


# --- 1: samples and scenes that cannot be followed ------------------------------------------------------------------------------------


def test_a_scene_that_can_never_be_followed_ends_the_start(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """Without this refusal a run published 1,616 samples, estimated none, and reported nothing."""
    run = command(
        "twin", "--scene", scenes / "stick_slip.json", "--fmu", fmu, "--out", tmp_path / "out", "--seconds", 30
    )
    assert run.returncode == 2 and "friction.law = stick is not allowed with estimator.enabled = true" in run.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("what", ["open", "degrees", "lengths"])
def test_a_refused_start_is_reported(
    what: str, tmp_path: Path, fmu: Path, library: Library, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A loop that cannot close, degrees for radians and other lengths each give a log line, a line on the terminal and an alarm."""
    config = configured(tmp_path, fmu, library, scenes / "fall_90_120.json", exact=True)
    taken = samples(config, library, 40)
    if what == "lengths":
        config = replace(config, twin={"link[2].length": 0.01, "link[3].length": 0.01})
    angle: Callable[[float], float] = {
        "open": lambda x: math.pi if x > 1.7 else 0.0,
        "degrees": math.degrees,
        "lengths": lambda x: x,
    }[what]
    twin = Twin(config, library)
    ear = Ear(twin)
    for message in taken:
        fields = {
            name: angle(value) if name.startswith("measured") else value for name, value in message.fields.items()
        }
        if what == "open":
            fields |= {"measured.theta[1]": math.pi, "measured.theta[2]": 0.0}
        twin.received("fivebar/bench/meas", encode(replace(message, fields=fields)), message.time)
    sentences = [alarm["sentence"] for alarm in ear.alarms()]
    assert any("cannot be closed" in sentence for sentence in sentences), sentences
    assert what != "degrees" or any("degrees?" in sentence for sentence in sentences)
    # Each once, although every sample is refused: 40 alarms would hide all others.
    assert len(sentences) <= 3 and capsys.readouterr().out.splitlines() == sentences
    twin.follower.close()


def test_one_encoder_alone_starts_nothing_and_says_so(config: Config, library: Library) -> None:
    twin = Twin(config, library)
    ear = Ear(twin)
    for message in samples(config, library, 5):
        fields = {name: value for name, value in message.fields.items() if name != "measured.theta[2]"}
        twin.received("fivebar/bench/meas", encode(replace(message, fields=fields)), message.time)
    assert [alarm["sentence"] for alarm in ear.alarms()] == [
        "restarting with the next sample: a start needs both angles, but measured.theta[2] is missing"
    ]
    twin.follower.close()


def test_silence_counts_before_the_first_estimate(tmp_path: Path) -> None:
    """The watch reports silence after 2.5 s of samples without estimates, and after half a minute without samples."""
    for send_samples, before, after in ((True, 2.4e9, 2.7e9), (False, NO_SAMPLE + 2.4e9, NO_SAMPLE + 2.7e9)):
        watch = Watch(Config(str(tmp_path), "", ""))
        ear = Ear(watch)
        watch.tick(BEGIN)
        for seq in range(400 if send_samples else 0):
            sample = Message(
                "meas", "bench", BEGIN + 3_600_000_000_000 + PERIOD_NS * seq, seq, {"measured.theta[1]": 1.0}
            )
            watch.received("fivebar/bench/meas", encode(sample), BEGIN + PERIOD_NS * seq)
        watch.tick(BEGIN + int(before))
        assert not ear.alarms()
        for later in (0, 1, 2):
            watch.tick(BEGIN + int(after) + later * 10**9)
        (alarm,) = ear.alarms()
        assert (alarm["state"], alarm["cause"], alarm["figures"]["samples"]) == (
            "anomaly",
            "silence",
            400.0 if send_samples else 0.0,
        )


@pytest.mark.parametrize("off", [0, 3600, -3600])
def test_estimates_that_fall_behind_are_reported(off: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each estimate is a millisecond later than the one before; the clock of the machine is right or an hour off."""
    watch = Watch(Config(str(tmp_path), "", ""))
    ear = Ear(watch)

    def estimated(seq: int, sampled: int, late: float) -> None:
        estimate = of_kind("est", time=sampled + 1_000_000, seq=seq, after=seq - 1, inputs=[["meas", seq, sampled]])
        watch.received("fivebar/bench/est", json.dumps(estimate).encode(), BEGIN + PERIOD_NS * seq + round(1e9 * late))

    for seq in range(4000):
        estimated(seq, BEGIN + 1_000_000_000 * off + PERIOD_NS * seq, 1e-3 * seq)
    troubles = [alarm for alarm in ear.alarms() if alarm["state"] == "trouble"]
    # From 1 s on, every 5 s of 24.
    assert [float(alarm["sentence"].split()[2]) for alarm in troubles] == [1.0, 1.8, 2.7, 3.5]
    assert {(alarm["cause"], alarm["from"]) for alarm in troubles} == {
        ("behind", "watch")
    } and "estimates are 1.0 s behind" in capsys.readouterr().out
    # On time again, also with a clock that was set back.
    for seq in range(4000, 8000):
        estimated(seq, BEGIN + 1_000_000_000 * (off - 40) + PERIOD_NS * seq, 0.0)
    assert len([alarm for alarm in ear.alarms() if alarm["state"] == "trouble"]) == len(troubles)


def sent(twin: Twin, payloads: list[bytes], topic: str = "fivebar/bench/meas", later: int = 0) -> list[dict[str, Any]]:
    """Sends samples every 5 ms to the twin and the record; returns the twin's alarms."""
    recorder = Recorder(twin.config)
    recorder.about = twin.setup.to_message("bench", BEGIN)
    recorder.begin()
    ear = Ear(twin)
    for k, payload in enumerate(payloads):
        now = BEGIN + later + PERIOD_NS * k
        for worker in (twin, recorder):
            worker.received(topic, payload, now)
        if k % 10 == 9:
            twin.tick(now)
    for message in ear.heard:
        recorder.received(f"fivebar/bench/{message.kind}", encode(message), BEGIN)
    recorder.end()
    return ear.alarms()


@pytest.fixture
def plain_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Summaries have empty pictures: drawing takes most of their time."""
    for name in ("_tip", "_error", "_forecast", "_latency"):
        monkeypatch.setattr(summary, name, lambda *_: summary.plt.figure(figsize=(1, 1)))


def summed_up(config: Config, twin: Twin, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and last sentence of the summary of the run."""
    status = {"follow": [json.loads(json.dumps(twin.status()))]}
    code = summary.write(config, status, {}, config.path / "out")
    return code, capsys.readouterr().out.strip().splitlines()[-1]


@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("clock", ["since 1970", "an hour off", "since the machine was switched on"])
@pytest.mark.parametrize(("unit", "ns"), [("microseconds", 10**3), ("milliseconds", 10**6), ("seconds", 10**9)])
def test_times_of_another_unit_are_never_believed(
    unit: str, ns: int, clock: str, config: Config, library: Library, capsys: pytest.CaptureFixture[str]
) -> None:
    """Times in ms must not be accepted, not even after 20 samples: by such a clock the machine stands still."""
    begin = {"since 1970": BEGIN, "an hour off": BEGIN - HOUR, "since the machine was switched on": HOUR}[clock]
    # Whole seconds do not increase from sample to sample unless samples are rare.
    every = 1 if unit != "seconds" else 200
    taken = samples(config, library, 400 // every)
    twin = Twin(config, library)
    changed = [encode(replace(m, seq=k, time=(begin + every * PERIOD_NS * k) // ns)) for k, m in enumerate(taken)]
    raised = sent(twin, [p for p in changed for _ in range(every)])
    assert twin.counts["taken"] == twin.counts["estimated"] == 0
    # Whole seconds of an unknown clock are not recognisable as such.
    question = f"are these {unit}?" if unit != "seconds" or clock != "since the machine was switched on" else ""
    assert raised and all(a["state"] == "trouble" and question in a["sentence"] for a in raised), raised
    code, last = summed_up(config, twin, capsys)
    assert code == 1 and last.startswith("not followed: 400 of 400 samples are refused, ") and question in last


def test_a_unit_that_changes_within_a_series_is_refused(config: Config, library: Library) -> None:
    taken = samples(config, library, 800)
    twin = Twin(config, library)
    raised = sent(twin, [encode(m if m.seq < 400 else replace(m, time=m.time // 10**6)) for m in taken])
    assert twin.counts["taken"] == 400 and twin.refusals.count > 300
    assert [a["sentence"] for a in raised if "are these milliseconds?" in a["sentence"]]
    twin.follower.close()


def test_a_time_in_fractional_seconds_is_named() -> None:
    with pytest.raises(Refused, match=r"ns since 1970 are expected: are these seconds\?"):
        decode("fivebar/bench/meas", json.dumps(of_kind("meas", time=1e-9 * BEGIN)).encode())


@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("what", ["seq", "tags", "text", "topic"])
def test_a_run_with_only_refused_samples_says_so(
    what: str, config: Config, library: Library, capsys: pytest.CaptureFixture[str]
) -> None:
    """Terminal and summary give the reason of the refusals."""
    taken = samples(config, library, 600)
    twin = Twin(config, library)
    heard: list[bool] = []
    twin.hear_others = heard.append
    payloads = [encode(m) for m in taken]
    if what == "seq":
        payloads = [encode(replace(m, seq=0)) for m in taken]
    elif what == "tags":
        payloads = [encode(replace(m, unit="other")) for m in taken]
    elif what == "text":
        payloads = [re.sub(rb'("measured.theta.1.":)([^,]+)', rb'\1"\2"', payload) for payload in payloads]
    elif what == "topic":
        payloads = [encode(replace(m, unit="other")) for m in taken]
        twin.tick(BEGIN - 10**10)
        assert not heard
        twin.tick(BEGIN)
        assert heard == [True], "without samples of this unit, the twin listens to other units"
    raised = sent(twin, payloads, "fivebar/other/meas" if what == "topic" else "fivebar/bench/meas")
    reason = {
        "seq": "meas 0 has been accepted already",
        "tags": "tags are {'unit': 'other'}; the unit of this topic is 'bench'",
        "text": f"meas: measured.theta[1] is '{taken[0].fields['measured.theta[1]']}', not a number",
        "topic": "meas is of the unit 'other', not of 'bench' (--unit)",
    }[what]
    (trouble,) = [a for a in raised if a["cause"] == "samples"]
    assert re.fullmatch(
        rf"no sample is accepted: 2\d\d are refused, the first because: {re.escape(reason)}.*", trouble["sentence"]
    )
    assert trouble["state"] == "trouble" and trouble["sentence"] in capsys.readouterr().out
    code, last = summed_up(config, twin, capsys)
    assert code == 1
    count = 599 if what == "seq" else 600
    assert last == f"not followed: {count} of 600 samples are refused, the first because: {reason}"
    if what == "topic":
        sent(twin, [encode(m) for m in taken[:300]], later=10**10)
        assert heard == [True, False] and twin.counts["estimated"] > 200 and twin.refusals.count == 0
    twin.follower.close()


def test_copies_of_overlapping_subscriptions_are_not_refused(config: Config, library: Library) -> None:
    """A twin whose machine starts late listens to all units as well: a broker then sends the first samples twice."""
    twin = Twin(config, library)
    twin.tick(BEGIN - 10**10)
    twin.tick(BEGIN)
    assert twin.hears_others
    taken = [encode(m) for m in samples(config, library, 40)]
    copies = [taken[k + j] for k in range(0, 10, 2) for j in (0, 1, 0, 1)]
    assert not sent(twin, copies + taken[10:])
    assert twin.refused == 0 and twin.counts["estimated"] == 40
    # Malformed messages are no copies: each is counted.
    for k in range(5):
        twin.received("fivebar/bench/meas", b"{", BEGIN + k)
    assert twin.refused == 5
    twin.follower.close()


def test_a_few_refused_samples_are_no_trouble(config: Config, library: Library) -> None:
    """The first samples of a machine with another clock are refused; later each sample comes twice, with a malformed message."""
    twin = Twin(config, library)
    taken = [encode(replace(m, time=m.time - HOUR)) for m in samples(config, library, 300)]
    raised = sent(twin, [each for payload in taken for each in (payload, payload, b"{")])
    assert not raised and twin.counts["taken"] == 300 - CONSISTENT + 1
    assert twin.refused == CONSISTENT - 1 + 2 * 300 and twin.refusals.count == 0
    twin.follower.close()


def test_retained_messages_are_ignored(tmp_path: Path) -> None:
    """A broker sends retained messages at each connection: old commands and samples must have no effect."""
    came: list[str] = []
    bus = Bus(Config(str(tmp_path), "", "").broker, "bench", "follow", Twin.kinds, lambda topic, _: came.append(topic))
    for retained in (True, False):
        for kind in Twin.kinds:
            message = MQTTMessage(topic=f"fivebar/bench/{kind}".encode())
            message.payload, message.retain = b"{}", retained
            bus._message(bus.client, None, message)
    assert came == [f"fivebar/bench/{kind}" for kind in Twin.kinds]


# --- 2: a full disk -------------------------------------------------------------------------------------------------------------------


def fill(monkeypatch: pytest.MonkeyPatch) -> dict[str, bool]:
    """A simulated full disk."""
    disk = {"full": False}
    write = record.pq.write_table

    def table(*arguments: Any, **named: Any) -> None:
        if disk["full"]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(*arguments, **named)

    monkeypatch.setattr(record.pq, "write_table", table)
    return disk


@pytest.mark.parametrize("waiting", [MOST_WAITING, 100])
@pytest.mark.parametrize(("samples", "least"), [(800, 350), pytest.param(1600, 900, marks=pytest.mark.nightly)])
def test_a_full_disk_ends_nothing(
    samples: int,
    least: int,
    waiting: int,
    config: Config,
    library: Library,
    fmu: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The recorder survives: if the disk is full briefly, nothing is lost; if longer, the summary names the gap."""
    monkeypatch.setattr("fivebar.twin.recorder.MOST_WAITING", waiting)
    monkeypatch.setattr("fivebar.twin.recorder.FLUSH_EVERY", 0.0)
    disk = fill(monkeypatch)
    twin, recorder = Twin(config, library), Recorder(config)
    recorder.about = twin.setup.to_message(config.unit, BEGIN)
    wire, source = Wire(config, twin, recorder), machine(config, library)
    for seq in range(samples):
        disk["full"] = samples // 4 <= seq < samples // 2
        wire.send("meas", encode(source.next()))
        if seq % 20 == 19:
            wire.tick()
    wire.end()
    source.close()
    assert twin.counts["estimated"] == samples, "estimates continue"
    printed = capsys.readouterr().out.splitlines()
    assert (
        len(printed) == 2
        and printed[0].startswith("nothing is recorded, No space left on device")
        and printed[1].startswith("recording again")
    )
    assert not list(recorder.folder.glob("*.writing"))
    story = figures.read(recorder.folder)
    content = figures.summarise(config, story, figures.judge(story), {}, {}, printed)
    assert content["troubles"]["count"] == 2
    result = replay(recorder.folder, fmu)
    assert not result.differing
    if waiting == MOST_WAITING:
        assert printed[1] == "recording again; nothing is lost" and not content["gaps"] and result.compared == samples
        return
    lost = {gap["of"]: gap for gap in content["gaps"]}
    assert set(lost) == {"meas", "est"} and all(gap["why"] == "No space left on device" for gap in lost.values())
    full = samples // 4
    assert full - 100 < lost["est"]["last"] - lost["est"]["first"] < full
    assert f"est {lost['est']['first']} to" in printed[1]
    # After the gap the replay begins at the next stored state, up to 200 samples later: about `samples - full - 200` or more are compared.
    assert any("No space left on device" in gap for gap in result.gaps) and result.compared > least


@pytest.mark.nightly
def test_a_small_disk(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """A whole run on a real full disk has no traceback and estimates to its end; the summary names the missing rows."""
    small = tmp_path / "small"
    small.mkdir()
    if (
        shutil.which("mount") is None
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", small], capture_output=True, check=False
        ).returncode
    ):
        pytest.skip("this test mounts a small disk, which this user may not")
    try:
        (small / "other").write_bytes(bytes(1_500_000))
        run = command("twin", "--scene", scenes / "pick_and_place.json", "--fmu", fmu, "--out", small, "--seconds", 6)
    finally:
        subprocess.run(["umount", "-l", small], check=True)
    assert "record: nothing is recorded, No space left on device" in run.stdout, run.stdout
    assert "not all written" in run.stdout and "restarts               none" in run.stdout and run.returncode == 1


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    disk = Disk()
    for _ in range(5):
        disk.put(tmp_path / "file" / "status.json", b"{}")
        while disk.waiting:
            pass
    disk.close()
    assert len([r for r in caplog.records if "is not written" in r.getMessage()]) == 1


def test_a_summary_that_cannot_be_written_ends_with_one_sentence(
    config: Config, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded(config, library, 50)
    (tmp_path / "file").write_text("")
    assert summary.write(config, {}, {}, tmp_path / "file") == 1
    shown = capsys.readouterr().out
    assert "50 estimated" in shown and "not all written" in shown


# --- 3: clocks ------------------------------------------------------------------------------------------------------------------------


def admit(intake: Intake, seq: int, time: int, now: int) -> str:
    try:
        return intake.admit(Message("meas", "bench", time, seq, {}), now)
    except Refused:
        return "refused"


def test_a_clock_set_ahead_and_back_refuses_no_later_samples() -> None:
    """A machine that restarts its count afterwards was refused for 120,000 of 120,000 samples."""
    intake, now = Intake(0.005), BEGIN
    for seq in range(300):
        now = BEGIN + PERIOD_NS * seq
        jump = HOUR if 100 <= seq < 200 else 0
        assert admit(intake, 1000 + seq, now + jump, now) in ("new", "series")
    again = [admit(intake, seq, now + PERIOD_NS * (seq + 1), now + PERIOD_NS * (seq + 1)) for seq in range(100)]
    assert again[: CONSISTENT + 1] == ["refused"] * (CONSISTENT - 1) + ["series", "new"] and set(
        again[CONSISTENT:]
    ) == {"new"}


@pytest.mark.parametrize("first", [True, False])
def test_one_sample_of_another_century_refuses_no_later_samples(first: bool) -> None:
    """One sample has a time in 2255: the first of all, or a later one. The machine restarts its count afterwards."""
    intake, far = Intake(0.005), 9_000_000_000_000_000_000
    begun = 0 if first else 50
    for seq in range(begun):
        admit(intake, 5000 + seq, BEGIN + PERIOD_NS * seq, BEGIN + PERIOD_NS * seq)
    admit(intake, 5000 + begun, far, BEGIN + PERIOD_NS * begun)
    results = [admit(intake, seq, at, at) for seq in range(100) for at in [BEGIN + PERIOD_NS * (100 + seq)]]
    assert set(results[CONSISTENT:]) == {"new"}, results


def test_a_machine_with_another_clock_is_followed() -> None:
    """The clock is an hour behind from the start, also after a restart of the count; or it falls back by an hour after a minute."""
    intake, now = Intake(0.005), BEGIN
    for series in range(2):
        for seq in range(200):
            now += PERIOD_NS
            admitted = admit(intake, seq, now - HOUR, now)
        assert admitted == "new", series
    results = []
    for seq in range(int(FORGOTTEN / PERIOD_NS) + 100):
        now += PERIOD_NS
        results.append(admit(intake, seq, now - 2 * HOUR, now))
    assert results[-1] == "new" and results.count("refused") < FORGOTTEN / PERIOD_NS + 2 * CONSISTENT


def test_replayed_samples_are_refused() -> None:
    """Samples of this run and of an earlier run are sent again, while the machine continues and after its clock was set back."""
    intake, now = Intake(0.005), BEGIN
    old = [(seq, BEGIN - HOUR + PERIOD_NS * seq) for seq in range(2000)]
    for seq in range(3000):
        now = BEGIN + PERIOD_NS * seq
        time = now + (HOUR if 100 <= seq < 1500 else 0)
        old.append((seq, time))
        assert admit(intake, seq, time, now) in ("new", "series")
        if seq > 2000:
            again = old[seq - 2001 : seq - 1980] if seq % 2 else old[seq : seq + 21]
            assert {admit(intake, s, t, now) for s, t in again} == {"refused"}, seq


def test_estimates_are_accepted_after_a_jump_back() -> None:
    """The machine restarts its count at an earlier time: the watch must accept the estimates at once."""
    newest, now = Newest(), BEGIN
    for seq in range(100):
        newest.admit(Message("est", "bench", now + HOUR, 1000 + seq, {}), now)
    refused = 0
    for seq in range(400):
        now += PERIOD_NS
        try:
            newest.admit(Message("est", "bench", now, seq, {}), now)
        except Refused:
            refused += 1
    assert refused <= 200


def test_a_command_from_another_time_names_the_wrong_clock(config: Config, library: Library) -> None:
    """A command of 2255 is refused with a reason and does not block later ones; the alarm names the command for its sender."""
    orders = Orders()
    with pytest.raises(
        Refused, match=r"cmd is from a time that is 90.000 s ahead of the pipeline's own; up to 10 s are allowed"
    ):
        orders.check(Message("cmd", "bench", BEGIN + 90_000_000_000, 1, {}), BEGIN)
    with pytest.raises(Refused, match="behind the pipeline's own"):
        orders.check(Message("cmd", "bench", BEGIN - 2 * NEAR, 1, {}), BEGIN)
    twin = Twin(config, library)
    ear = Ear(twin)
    for ahead in (90_000_000_000, 9_000_000_000_000_000_000 - BEGIN, 5):
        order = Message("cmd", "bench", BEGIN + ahead, 1, {}, {"command": "restart"})
        twin.received("fivebar/bench/cmd", encode(order), BEGIN)
    answers = ear.alarms()
    assert (
        answers[0]["cause"] == "order"
        and answers[0]["order"] == BEGIN + 90_000_000_000
        and "ahead of the pipeline's own" in answers[0]["sentence"]
    )
    assert [(alarm["state"], alarm["order"] - BEGIN) for alarm in answers][-1] == ("taken", 5)
    assert twin.refused == 2 and twin.follower.inputs == [["cmd", 1, BEGIN + 5]]
    twin.follower.close()


# --- 7, 9: files ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["twin", "calibrate", "ensemble"])
def test_a_folder_that_cannot_be_made_gives_one_sentence(
    name: str, tmp_path: Path, fmu: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """OUT is a file, or a path below a file."""
    file = tmp_path / "file"
    file.write_text("")
    more = {
        "twin": ["--scene", str(scenes / "pick_and_place.json"), "--seconds", "1"],
        "calibrate": ["--trials", "1"],
        "ensemble": ["--members", "1", "--workers", "0"],
    }[name]
    for out in (file, file / "below", Path("/proc/nowhere")):
        assert main([name, *more, "--fmu", str(fmu), "--out", str(out)]) == 2
        sentence = capsys.readouterr().err
        assert len(sentence.strip().splitlines()) == 1 and str(out.parent) in sentence, sentence


def test_an_error_of_the_system_gives_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/some/where")

    monkeypatch.setattr("fivebar.twin.replay.run", full)
    assert main(["replay", "x"]) == 2
    assert capsys.readouterr().err == "fivebar replay: /some/where: No space left on device\n"


def test_a_replay_of_few_estimates_has_its_own_exit_code(
    config: Config, library: Library, fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_folder = recorded(config, library, 400).folder
    rows = [
        row
        for row in record.rows(run_folder)
        if not (row.topic.endswith("meas") and row.seq in range(100, 400)) and not row.topic.endswith("state")
    ]
    (tmp_path / "part").mkdir()
    path = record.write_part(tmp_path / "part", 0, 0, rows)
    assert main(["replay", str(path), "--fmu", str(fmu)]) == 3
    assert "0 differ; 300 left out" in capsys.readouterr().out
    assert main(["replay", str(run_folder), "--fmu", str(fmu)]) == 0


def test_logs_rotate_and_keep_one_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand refused messages a second would be 8 GB a day."""
    monkeypatch.setattr(starter, "LARGEST_LOG", 20_000)
    log = tmp_path / "chatter.log"
    child = Child("chatter", [], log, print)
    largest = 0
    # As in the process: opened once, appended.
    with open(log, "ab", opener=starter.private, buffering=0) as written:
        for i in range(100_000):
            written.write(f"refused: message {i:06d}\n".encode())
            if i % 100 == 99:
                child.rotate()
                largest = max(largest, sum(file.stat().st_size for file in tmp_path.iterdir()))
    assert {file.name for file in tmp_path.iterdir()} == {"chatter.log", "chatter.log.1"}
    # 2.4 MB were written.
    assert largest < 50_000
    assert "message 099999" in child.tail()
    assert os.name == "nt" or {stat.S_IMODE(file.stat().st_mode) for file in tmp_path.iterdir()} == {0o600}


def test_alarms_of_trouble_are_shown_on_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Run(Config(str(tmp_path), "", ""), ())
    child = Child("record", [sys.executable, "-c", "print('nothing is recorded')"], tmp_path / "record.log", run.say)
    child.start()
    assert child.process is not None and child.process.wait(PATIENCE) == 0
    while not run.troubles:
        time.sleep(0.01)
    assert (
        list(run.troubles) == ["record: nothing is recorded"]
        and capsys.readouterr().out == "record: nothing is recorded\n"
    )


def test_forecasts_have_ten_points(tmp_path: Path) -> None:
    """A horizon with fewer samples than a path has points would give messages that no reader accepts."""
    with pytest.raises(TwinError, match="horizon is 0.02; 0.05 to 10 are allowed"):
        configuration.check(Config(str(tmp_path), "", "", horizon=0.02))


# --- 9, 10: pictures ------------------------------------------------------------------------------------------------------------------


def test_one_member_claims_no_interval(tmp_path: Path, fmu: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ensemble", "--members", "1", "--workers", "0", "--seconds", "0.2"]
    assert main([*words, "--fmu", str(fmu), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "95 %:" not in printed and "a 95 % interval needs at least 40 members" in printed
    end = json.loads((tmp_path / "summary.json").read_text())["end"]
    assert all(set(levels) == {"0.5"} for levels in end.values())


def story(first: float) -> tuple[figures.Story, figures.Judged]:
    """A run of forecasts; all half-widths but the first are 9 to 10 mm."""
    made = figures.Story()
    for i in range(400):
        time = 0.05 * i
        made.measured.add({"time": time, "tip.x": 0.1 * math.cos(time), "tip.y": 0.1 * math.sin(time)})
        made.estimated.add({"time": time, "tip.x": 0.1 * math.cos(time), "tip.y": 0.1 * math.sin(time), "band": 1e-5})
        for k in range(10):
            wide = first if i == 0 else 0.009 + 0.001 * math.sin(i)
            made.forecasts.add({"time": time, "ahead": 0.05 * (k + 1), "half_width": wide, "last": float(k == 9)})
    count = len(made.forecasts)
    return made, figures.Judged(np.full(400, 1e-5), np.full(count, 1e-4), np.ones(count))


def test_nothing_lies_on_the_lines_of_a_picture() -> None:
    """Legends overlap neither the path nor a line."""
    made, judged = story(0.0095)
    for figure in (summary._tip(made), summary._error(made, judged), summary._forecast(made, judged)):
        figure.canvas.draw()
        for axes in figure.axes:
            legend = axes.get_legend()
            if legend is not None:
                assert legend.get_window_extent().y0 >= axes.get_window_extent().y1 - 1
        summary.plt.close(figure)


def test_legends_list_what_is_there() -> None:
    """A recording has no tracker: legends must not list the machine's path and errors of forecasts."""
    made, judged = story(0.0095)
    made.measured = figures.Table(("time", *TRACKED))
    unseen = figures.Judged(*(np.full_like(each, np.nan) for each in (judged.error, judged.ahead_error, judged.inside)))
    drawn = summary._tip(made), summary._error(made, unseen), summary._forecast(made, unseen)
    labels = [
        [text.get_text() for axes in figure.axes if (legend := axes.get_legend()) for text in legend.get_texts()]
        for figure in drawn
    ]
    assert labels == [["twin", "x", "y"], ["95 % band"], ["half-width, 95 %", "half-width, median"]]
    for figure in drawn:
        summary.plt.close(figure)


def test_a_first_half_width_does_not_squeeze_the_others() -> None:
    """The first half-width is 115 mm, later ones 10 mm: the later ones fill the picture, the first is written at its edge."""
    made, judged = story(0.115)
    figure = summary._forecast(made, judged)
    axes = figure.axes[0]
    assert 10 < axes.get_ylim()[1] < 20
    assert [text.get_text() for text in axes.texts] == ["1 beyond, up to 115 mm"]
    summary.plt.close(figure)
    figure = summary._forecast(*story(0.0095))
    assert not figure.axes[0].texts
    summary.plt.close(figure)
