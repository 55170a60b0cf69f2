"""Records of the twin's pipeline: surviving parts, order, gaps, limits; states of the watch; remote brokers."""

import csv
import json
import math
import os
import socket
import stat
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fivebar.twin import config as configuration
from fivebar.twin import figures, record
from fivebar.twin.bus import Bus
from fivebar.twin.config import Broker, Config, Faults, Machine
from fivebar.twin.errors import TwinError
from fivebar.twin.machine import Mangler, Player
from fivebar.twin.messages import Message, decode, encode, topic
from fivebar.twin.recorder import JOINED, Gaps, Recorder
from fivebar.twin.starter import check_broker, free_port, parse_faults
from fivebar.twin.watch import CAUSES, Anomalies, Histogram

TOPIC = topic("bench", "meas")


def sample(seq: int) -> Message:
    return Message("meas", "bench", 10**18 + 5_000_000 * seq, seq, {"measured.theta[1]": 1.0 + seq})


def rows(*numbers: int) -> list[record.Row]:
    return [record.Row(TOPIC, sample(n).time, n, encode(sample(n))) for n in numbers]


def seqs(path: Path) -> list[int]:
    return [row.seq for row in record.rows(path)]


def test_a_record_has_the_promised_columns(tmp_path: Path) -> None:
    path = record.write_part(tmp_path, 0, 0, rows(1, 2))
    assert pq.read_schema(path).names == ["topic", "time", "seq", "payload"]
    assert [m.fields for m in record.messages(path, "meas", refused=pytest.fail)] == [
        sample(1).fields,
        sample(2).fields,
    ]


def test_a_joined_part_replaces_others_even_if_they_still_exist(tmp_path: Path) -> None:
    for number in range(4):
        record.write_part(tmp_path, number, number, rows(number))
    record.write_part(tmp_path, 0, 2, rows(0, 1, 2))
    # A half-written file after a kill is not a part.
    (tmp_path / "part-00000004-00000004.writing").write_bytes(b"PAR1 half")
    assert seqs(tmp_path) == [0, 1, 2, 3]
    (tmp_path / "part-00000001-00000001.parquet").unlink()
    assert seqs(tmp_path) == [0, 1, 2, 3]


def test_a_restarted_recorder_continues(tmp_path: Path) -> None:
    def recorder() -> Recorder:
        made = Recorder(Config(str(tmp_path), "", ""))
        made.begin()
        return made

    first = recorder()
    for number in range(JOINED + 2):
        first.received(TOPIC, encode(sample(number)), 0)
        first.end()
    # Killed: none of its functions is called any more.
    second = recorder()
    second.received(TOPIC, encode(sample(100)), 10**9)
    second.tick(10**9)
    second.end()
    assert seqs(tmp_path / "record") == [*range(JOINED + 2), 100]
    assert len(record.parts(tmp_path / "record")) == 4


def test_a_recorder_reports_missing_samples(tmp_path: Path) -> None:
    recorder = Recorder(Config(str(tmp_path), "", ""))
    recorder.begin()
    for number in (0, 1, 5, 3, 6):
        recorder.received(TOPIC, encode(sample(number)), 10**9)
    recorder.tick(10**9)
    recorder.tick(3 * 10**9)
    recorder.end()
    gaps = [
        (m.extra["of"], m.fields["first"], m.fields["last"])
        for m in record.messages(recorder.folder, "gap", refused=pytest.fail)
    ]
    assert gaps == [("meas", 2, 2), ("meas", 4, 4)]


def test_a_machine_that_restarts_its_count_leaves_no_gap() -> None:
    gaps = Gaps("meas")
    for seq in (*range(5000, 5010), *range(10)):
        gaps.see(seq, 0.0)
    assert gaps.due(10.0) == []


def test_other_files_than_records_are_refused_with_one_sentence(tmp_path: Path) -> None:
    text = tmp_path / "x.parquet"
    text.write_text("PAR1")
    other = tmp_path / "y.parquet"
    pq.write_table(pa.table({"topic": ["a"], "time": [1]}), other)
    for path, sentence in (
        (tmp_path / "none", "no record"),
        (text, "not a Parquet file"),
        (other, "no column seq, payload"),
        (tmp_path, "no part-"),
    ):
        with pytest.raises(TwinError, match=sentence):
            list(record.rows(path))


# --- the watch ------------------------------------------------------------------------------------------------------------------------


def states(anomalies: Anomalies, alarm: list[tuple[float, float]], until: float) -> list[tuple[float, str]]:
    """Messages of a watch at 200 Hz; the unit's alarm is on in the given intervals."""
    said = []
    for i in range(round(until / 0.005)):
        now = 0.005 * i
        on = any(begin <= now < end for begin, end in alarm)
        for each in anomalies.see({"estimated.alarm": float(on), "estimated.tau[1]": 0.5}, now):
            said.append((round(now, 3), each["state"]))
    return said


def test_the_watch_goes_through_its_states() -> None:
    said = states(Anomalies(), [(5.0, 6.0)], 20.0)
    assert [state for _, state in said] == ["anomaly", "calibrating", "cooling down", "listening"]
    # The alarm counts after 40 ms and as gone after 0.5 s; 2 s of calibrating and 5 s of cooling down follow.
    assert [time for time, _ in said] == pytest.approx([5.04, 6.5, 8.5, 13.5], abs=0.011)


def test_the_watch_reports_the_cause_that_the_twin_names() -> None:
    """At the beginning and, with more certainty, at the end of the anomaly; the next anomaly does not inherit it."""
    anomalies, said = Anomalies(), []
    for i in range(6000):
        now = 0.005 * i
        number, probability = (3.0, 0.6) if now < 5.5 else (1.0, 0.9)
        on = 5 <= now < 6 or 20 <= now < 21
        fields = {
            "estimated.alarm": float(on),
            "estimated.cause": number if 5 <= now < 7 else 0.0,
            "estimated.cause.probability": probability,
        }
        said += [(each["state"], each.get("named"), each.get("probability")) for each in anomalies.see(fields, now)]
    assert said[:3] == [
        ("anomaly", "force at the tip", 0.6),
        ("calibrating", "torque at motor 1", 0.9),
        ("cooling down", None, None),
    ]
    assert said[4:] == [
        ("anomaly", None, None),
        ("calibrating", None, None),
        ("cooling down", None, None),
        ("listening", None, None),
    ]


def test_the_watch_has_hysteresis_and_keeps_quiet_at_the_start() -> None:
    assert states(Anomalies(), [(0.0, 1.9)], 5.0) == []
    assert states(Anomalies(), [(5.0 + 0.1 * i, 5.02 + 0.1 * i) for i in range(3)], 6.0) == []
    flicker = states(Anomalies(), [(5.0 + 0.2 * i, 5.15 + 0.2 * i) for i in range(10)], 8.5)
    assert [state for _, state in flicker] == ["anomaly", "calibrating"]


def faults(
    anomalies: Anomalies,
    begin: float,
    until: float,
    cause: Callable[[float], float],
    alarm: Callable[[float], bool] = lambda _: False,
) -> list[tuple[Any, ...]]:
    """Messages of a watch at 200 Hz; `cause` and `alarm` give the unit's cause and its alarm of forces at a time."""
    said = []
    for i in range(round((until - begin) / 0.005)):
        now = begin + 0.005 * i
        fields = {
            "estimated.alarm": float(alarm(now)),
            "estimated.status": 12.0,
            "estimated.cause": cause(now),
            "estimated.cause.probability": 1.0,
        }
        said += [(now, each["state"], each["cause"], each.get("named")) for each in anomalies.see(fields, now)]
    return said


@pytest.mark.parametrize("number", [4, 5, 7])
def test_the_watch_raises_an_alarm_for_encoders_and_clocks(number: int) -> None:
    """A frozen encoder raises an alarm although no force acts: once while it stays frozen, again if it fails again."""
    anomalies = Anomalies()
    said = faults(anomalies, 0.0, 60.0, lambda now: number if now >= 5 else 0)
    assert [each[1:] for each in said] == [("anomaly", "fault", CAUSES[number])] and said[0][0] == pytest.approx(
        5.04, abs=0.011
    )
    said = faults(anomalies, 60.0, 100.0, lambda now: number if now >= 80 else 0)
    assert [state for _, state, _, _ in said] == ["calibrating", "cooling down", "listening", "anomaly"]
    assert [time for time, *_ in said] == pytest.approx([60.5, 62.5, 67.5, 80.04], abs=0.011)


def test_an_acknowledged_dead_encoder_is_not_reported_again() -> None:
    anomalies = Anomalies()
    faults(anomalies, 0.0, 10.0, lambda now: 4 if now >= 5 else 0)
    assert [each["state"] for each in anomalies.acknowledge(10.0)] == ["cooling down"]
    # An intermittent contact is one fault until it has been good for 5 s.
    assert faults(anomalies, 10.0, 30.0, lambda now: 4) == []
    said = faults(anomalies, 30.0, 60.0, lambda now: 4 if now % 4 < 2 else 0)
    assert [state for _, state, _, _ in said if state == "anomaly"] == []


def test_an_anomaly_has_the_cause_of_its_end_or_if_cut_off_of_its_beginning() -> None:
    """A message of trouble does not end an anomaly; an operator, another anomaly or the end of the run cuts it off."""
    ended = [
        (1.0, "anomaly", "force"),
        (1.1, "trouble", "trouble"),
        (1.5, "calibrating", "torque at motor 1"),
        (3.5, "cooling down", "force"),
    ]
    cut_off = [
        (9.0, "anomaly", "encoder 1"),
        (9.5, "cooling down", "fault"),
        (20.0, "anomaly", "force"),
        (20.2, "anomaly", "timing"),
    ]
    assert figures.causes([]) == []
    assert figures.causes(ended + cut_off) == ["torque at motor 1", "encoder 1", "force", "timing"]


def test_another_fault_is_reported_during_other_faults() -> None:
    """An encoder fails while a hand pushes, while the watch cools down, or while the other encoder is dead; then all is silent."""
    anomalies = Anomalies()
    said = faults(
        anomalies, 0.0, 20.0, lambda now: 4 if 7 <= now < 12 else 5 if now >= 12 else 3, alarm=lambda now: 5 <= now < 6
    )
    raised = [(cause, named) for _, state, cause, named in said if state == "anomaly"]
    assert raised == [("force", "force at the tip"), ("fault", "encoder 1"), ("fault", "encoder 2")]
    assert [(each["cause"], each.get("named")) for now in (20.6, 21.0) for each in anomalies.quiet(now)] == [
        ("silence", None)
    ]


def test_faults_at_the_start_count_once_the_state_is_found() -> None:
    """Faults that end before are not reported, nor are apparent faults while a restarted twin finds its state."""
    assert faults(Anomalies(), 0.0, 5.0, lambda now: 4 if now < 1.9 else 0) == []
    assert [time for time, *_ in faults(Anomalies(), 0.0, 60.0, lambda _: 4)] == pytest.approx([2.0], abs=0.011)
    anomalies = Anomalies()
    faults(anomalies, 0.0, 5.0, lambda _: 0)
    assert [each["cause"] for each in anomalies.quiet(5.6)] == ["silence"]
    assert "anomaly" not in [
        state for _, state, _, _ in faults(anomalies, 6.0, 20.0, lambda now: 4 if now < 7.9 else 0)
    ]


def test_the_watch_reports_silence_once_and_can_be_acknowledged() -> None:
    anomalies = Anomalies()
    states(anomalies, [], 4.0)
    assert anomalies.quiet(4.3) == []
    assert [each["cause"] for now in (4.6, 4.7, 9.0) for each in anomalies.quiet(now)] == ["silence"]
    assert [each["state"] for each in anomalies.acknowledge(9.0)] == ["cooling down"]
    assert anomalies.acknowledge(9.0) == []


def test_the_histogram_is_right_within_its_bins() -> None:
    histogram = Histogram()
    for i in range(1, 10_001):
        histogram.add(1e-6 * i)
    assert histogram.quantile(0.5) == pytest.approx(5e-3, rel=0.021)
    assert histogram.quantile(0.99) == pytest.approx(9.9e-3, rel=0.021)
    histogram.add(1e9)
    assert histogram.count == 10_001


# --- recordings and faults ------------------------------------------------------------------------------------------------------------


def test_a_csv_is_played(tmp_path: Path) -> None:
    file = tmp_path / "recording.csv"
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", "measured.theta[1]", "measured.theta[2]", "note"])
        writer.writerows([[10.0, 1.5, 1.6, "a"], [10.005, 1.51, "", "b"]])
    player = Player(Config(str(tmp_path), "", "", machine=Machine(csv=str(file))))
    player.start_ns = 10**18
    first, second, after = player.next(), player.next(), player.next()
    assert first is not None and second is not None and after is None
    assert (first.time, first.seq, first.fields) == (10**18, 0, {"measured.theta[1]": 1.5, "measured.theta[2]": 1.6})
    assert (second.time - first.time, second.fields) == (5_000_000, {"measured.theta[1]": 1.51})
    file.write_text("time,measured.theta[1]\n1,x\n")
    with pytest.raises(TwinError, match=r"measured.theta\[1\] in row 1 is 'x', which is not a number"):
        Player(Config(str(tmp_path), "", "", machine=Machine(csv=str(file))))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda rows: rows[::-1],
            "time falls back in 320 of 321 rows, too often for restarts of a clock: rows sorted by time are needed",
        ),
        (lambda rows: [[1000 * at, *rest] for at, *rest in rows], "are these milliseconds?"),
        (lambda rows: [[at, *(57.3 * x for x in rest)] for at, *rest in rows], "are these degrees?"),
        (lambda rows: [[at, b, a, *rest] for at, a, b, *rest in rows], "are the encoders swapped?"),
        (lambda rows: rows[:3], "no series of 20 samples or more"),
    ],
)
def test_a_recording_that_no_twin_can_follow_is_refused(
    tmp_path: Path, change: Callable[[list[list[float]]], list[list[float]]], sentence: str
) -> None:
    """Each of these would be played to its end without an estimate."""
    rows = [
        [
            0.005 * k,
            2.7 + 0.1 * math.sin(0.03 * k),
            1.3 + 0.1 * math.cos(0.02 * k),
            2.7 + 0.1 * math.sin(0.03 * k),
            1.3 + 0.1 * math.cos(0.02 * k),
        ]
        for k in range(321)
    ]
    file = tmp_path / "recording.csv"
    config = Config(str(tmp_path), "", "", machine=Machine(csv=str(file)))

    def check(rows: list[list[float]]) -> None:
        head = "time,measured.theta[1],measured.theta[2],servo.theta[1],servo.theta[2]"
        file.write_text(
            "\n".join([head, *(",".join(repr(round(x, 9)) for x in row) for row in rows)]) + "\n", encoding="utf-8"
        )
        Player(config).check()

    check(rows)
    with pytest.raises(TwinError, match=sentence.replace("?", r"\?")):
        check(change(rows))


def test_a_run_that_hardly_followed_reports_it() -> None:
    """An estimate a radian away from its sample does not count as following."""
    samples = {"published": 321, "lost": 0, "recorded": 321, "refused": 0, "estimated": 321}
    assert figures.unfollowed({"samples": samples | {"followed": 300}}) == ""
    assert figures.unfollowed({"samples": samples | {"followed": 9}}).startswith("not followed: 9 of 321 samples")
    none = dict.fromkeys((*samples, "followed"), 0)
    assert figures.unfollowed({"unit": "bench", "samples": none}) == (
        "not followed: no sample has come on the topic fivebar/bench/meas"
    )


def test_a_broker_that_is_not_there_is_named_at_once() -> None:
    """The start does not wait 20 s in every process."""
    port = free_port()
    with pytest.raises(TwinError, match=f"there is no broker at 127.0.0.1:{port}: Connection refused"):
        check_broker(Broker("127.0.0.1", port, False))


def test_faults_come_as_often_as_asked_and_none_by_default() -> None:
    def sent(faults: Faults) -> list[list[bytes]]:
        mangler = Mangler(faults, 1)
        return [mangler.send(sample(i)) for i in range(4000)]

    assert sent(Faults()) == [[encode(sample(i))] for i in range(4000)]
    # 4,000 draws of 5 %: 200 on average, standard deviation 14.
    assert 140 < sum(not each for each in sent(Faults(lost=0.05))) < 260
    assert 140 < sum(len(each) == 2 for each in sent(Faults(doubled=0.05))) < 260
    arrived = [decode(TOPIC, payload).seq for each in sent(Faults(late=0.05)) for payload in each]
    assert 140 < sum(a > b for a, b in pairwise(arrived)) < 260 and len(arrived) > 3990
    assert parse_faults("lost=0.05,clock_jump=-3") == Faults(lost=0.05, clock_jump=-3.0)
    for text in ("lost", "lost=2", "lost=nan", "gone=0.1"):
        with pytest.raises(TwinError):
            parse_faults(text)


# --- the configuration ----------------------------------------------------------------------------------------------------------------


def test_a_configuration_comes_back_and_is_private(tmp_path: Path) -> None:
    config = Config(
        str(tmp_path),
        "a.fmu",
        "b.json",
        broker=Broker(password="secret"),
        machine=Machine(hidden={"payload.mass": 0.1}),
    )
    file = tmp_path / "twin.json"
    configuration.write(config, file)
    assert configuration.read(file) == config
    assert os.name == "nt" or stat.S_IMODE(file.stat().st_mode) == 0o600
    text = file.read_text(encoding="utf-8")
    for encoding in ("utf-8-sig", "utf-16"):
        file.write_text(text, encoding=encoding)
        assert configuration.read(file) == config
    configuration.write(config, file)
    for wrong in (
        {"period": 0.0},
        {"unit": "a/b"},
        {"typo": 1},
        {"broker": [1]},
        {"horizon": True},
        {"period": "fast"},
    ):
        file.write_text(json.dumps(json.loads(file.read_text()) | wrong))
        with pytest.raises(TwinError):
            configuration.read(file)
        configuration.write(config, file)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1"])
def test_loopback_needs_no_password(host: str) -> None:
    configuration.check_broker(Broker(host))


@pytest.mark.parametrize(
    "broker",
    [Broker("192.0.2.1"), Broker("192.0.2.1", user="a", password="b"), Broker("broker.invalid"), Broker("0.0.0.0")],
)
def test_beyond_loopback_user_password_and_tls_are_required(broker: Broker) -> None:
    with pytest.raises(TwinError, match="is not on this machine: user, password and TLS"):
        configuration.check_broker(broker)
    configuration.check_broker(Broker(broker.host, user="a", password="b", ca_file="system"))


def test_ports_are_free() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port := free_port()))
        assert free_port() != port


def test_sending_without_a_broker_does_not_crash() -> None:
    bus = Bus(Broker(port=free_port()), "bench", "test", ("meas",), lambda *_: None)
    bus.start()
    assert not bus.publish("meas", b"{}") and bus.unsent == 1 and not bus.ready()
    bus.stop()
