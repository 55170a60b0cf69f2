"""Messages of the twin's pipeline: valid ones pass unchanged, all others are refused with one sentence."""

import json
import logging
import random
from pathlib import Path
from typing import Any

import pytest

from fivebar.twin.config import Config
from fivebar.twin.errors import Refused
from fivebar.twin.intake import CONSISTENT, Intake
from fivebar.twin.messages import Message, decode, encode, topic
from fivebar.twin.process import Worker

MEAS = Message(
    "meas",
    "bench",
    1_795_331_400_000_000_000,
    17,
    {"measured.theta[1]": 1.57, "measured.theta[2]": 0.1, "servo.theta[1]": 1.5},
)
TOPIC = topic("bench", "meas")
PERIOD_NS = 5_000_000


def changed(**changes: Any) -> bytes:
    """A sample with fields replaced; None removes a field."""
    content = json.loads(encode(MEAS)) | changes
    return json.dumps({name: value for name, value in content.items() if value is not None}).encode()


def test_a_message_comes_back_to_the_bit() -> None:
    fields = {f"tau[{i}]": x for i, x in ((1, 0.1 + 0.2), (2, -5e-324))}
    message = Message("meas", "bench", 2**63 - 1, 2**53 - 1, MEAS.fields | fields)
    assert decode(TOPIC, encode(message)) == message
    assert encode(decode(TOPIC, encode(message))) == encode(message)


@pytest.mark.parametrize(
    ("payload", "sentence"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[" * 10_000, "not JSON"),
        (b"1" * 5_000, "not JSON"),
        (b" " * 16_001, "16001 bytes; at most 16000"),
        (b"[1]", "not an object"),
        (encode(MEAS).replace(b"1.57", b"NaN"), "NaN is not a JSON number"),
        (encode(MEAS).replace(b"1.57", b"-Infinity"), "-Infinity is not a JSON number"),
        (encode(MEAS).replace(b"1.57", b"1e999"), "not a finite number"),
        (encode(MEAS).replace(b"1.57", b"1" + b"0" * 400), "not a finite number"),
        (encode(MEAS).replace(b'"seq":17', b'"seq":17,"seq":18'), "stands twice"),
        (changed(measurement="est"), "measurement is 'est', not meas"),
        (changed(tags={"unit": "other"}), "the unit of this topic is 'bench'"),
        (changed(tags=None), "has no tags"),
        (changed(time=1.5), "time is 1.5, not an integer"),
        (changed(time=-1), "time is -1; 0 to 9223372036854775807 is allowed"),
        (changed(time=2**63), "time is"),
        (changed(seq=True), "seq is True, not an integer"),
        (changed(seq="17"), "seq is '17', not an integer"),
        (changed(seq=10**4000), "an integer of very many digits"),
        (changed(fields=[1]), "not an object"),
        (changed(fields={"measured.theta[1]": "1.57"}), "measured.theta[1] is '1.57', not a number"),
        (changed(fields={"measured.theta[1]": True}), "measured.theta[1] is True, not a number"),
        (changed(fields={"measured.theta[1]": 1e5}), "-10000.0 to 10000.0 is allowed"),
        (changed(fields={"measured.theta[1]": 1.0, "payload.mass": 1.0}), "'payload.mass', which it may not have"),
        (changed(fields={"servo.theta[1]": 1.0}), "neither measured.theta[1] nor measured.theta[2]"),
        (changed(note="x"), "'note', which it may not have"),
        (changed(time=1795331400000000000.0), "not an integer"),
    ],
)
def test_invalid_samples_are_refused(payload: bytes, sentence: str) -> None:
    with pytest.raises(Refused) as refusal:
        decode(TOPIC, payload)
    assert sentence in str(refusal.value)
    assert len(str(refusal.value)) < 300 and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "wrong",
    [
        "fivebar/bench",
        "fivebar/bench/meas/more",
        "other/bench/meas",
        "fivebar//meas",
        "fivebar/a b/meas",
        "fivebar/bench/x",
    ],
)
def test_other_topics_are_refused(wrong: str) -> None:
    with pytest.raises(Refused):
        decode(wrong, encode(MEAS))


def test_a_command_has_bounds() -> None:
    def order(kind: str, fields: dict[str, float], **extra: Any) -> Message:
        return decode(topic("bench", kind), encode(Message(kind, "bench", 1, 1, fields, extra)))

    assert order("cmd", {}, command="restart").extra == {"command": "restart"}
    assert order("param", {"payload.mass": 0.1}).fields == {"payload.mass": 0.1}
    for kind, fields, extra in (
        ("cmd", {}, {"command": "rm -rf /"}),
        ("cmd", {"a": 1.0}, {"command": "restart"}),
        ("cmd", {}, {}),
        ("param", {}, {}),
    ):
        with pytest.raises(Refused):
            order(kind, fields, **extra)


GOOD: dict[str, dict[str, Any]] = {
    "meas": {"fields": {"measured.theta[1]": 1.0, "servo.theta[1]": 1.0}},
    "est": {"fields": {f"{n}[{i}]": 1.0 for n in ("theta", "passive.theta") for i in (1, 2)} | {"tip.x": 0.1, "tip.y": 0.3, "estimated.status": 2.0}}
    | {"after": -1, "inputs": [["meas", 1, 5], ["cmd", 2, 6]]},
    "forecast": {"fields": {"tip.x": 0.1}, "ahead": 0.5, "half_width": 0.01}
    | {"path": {name: [0.1] * 10 for name in ("ahead", "tip.x", "tip.y", "estimated.forecast.radius95")}}
    | {"singular": {"probability": 0.5, "time": None, "type": "none"}, "stop": {"probability": 0.0, "time": 5, "at": "lower[1]"}},
    "alarm": {"fields": {}, "state": "anomaly", "cause": "force", "named": "force at the tip", "probability": 0.9, "figures": {"estimated.nis": 40.0}, "reason": "acknowledged"},
    "param": {"fields": {"servo.kp[1]": 20.0}},
    "cmd": {"fields": {}, "command": "restart"},
    "state": {"fields": {}, "state": "AAAA", "clock": 0.1, "parameters": {"servo.kp[1]": 20.0}}
    | {"book": {"offset": -5, "time": 5, "seq": 1, "told": {}, "on_plan": True, "assembly": 1, "turns": {"measured.theta[1]": -1.0}}},
    "learned": {"fields": {"estimated.mass[1]": 0.2, "estimated.mass.sigma[1]": 0.01}, "values": {"link[1].mass": 0.2}},
    "whatif": {"fields": {}, "ahead": 0.5, "members": 50, "goal": [0.1, 0.2], "took_s": 0.1, "cpu_s": 0.1}
    | {"candidates": [{"rank": 1, "name": "stay", "failed": 0, "singular": {"probability": 0.0, "time": None}, "bands": {"tip.x": [[0.0, 0.1, 0.2]]}}]},
    "gap": {"fields": {"first": 3.0, "last": 5.0}, "of": "meas", "why": "the disk was full"},
}  # fmt: skip
"""A valid message of each kind."""


@pytest.mark.parametrize("cause", [8.0, -1.0, 0.5])
def test_a_cause_without_a_name_is_refused(cause: float) -> None:
    """The watch looks its name up."""
    fields = GOOD["est"]["fields"] | {"estimated.cause": cause}
    with pytest.raises(Refused):
        decode("fivebar/bench/est", json.dumps(of_kind("est", fields=fields)).encode())
    assert (
        decode(
            "fivebar/bench/est", json.dumps(of_kind("est", fields=fields | {"estimated.cause": 7.0})).encode()
        ).fields["estimated.cause"]
        == 7
    )


def of_kind(kind: str, **changes: Any) -> dict[str, Any]:
    """The valid message of a kind with changes."""
    return {"measurement": kind, "time": 5, "seq": 1, "tags": {"unit": "bench"}} | GOOD[kind] | changes


def wrong_ones(kind: str) -> list[Any]:
    """The valid message of a kind with one entry removed, added or of another type, for every entry."""
    found: list[Any] = []
    content = of_kind(kind)

    def place(path: list[Any], value: Any) -> Any:
        copy = json.loads(json.dumps(content))
        at = copy
        for step in path[:-1]:
            at = at[step]
        if value is None:
            del at[path[-1]]
        else:
            at[path[-1]] = value
        return copy

    def walk(path: list[Any], value: Any) -> None:
        nested = {"valueOf": "x", "toString": [1]}
        for other in (nested, [nested], "x" * 2000) if path else ():
            if path[-1] != "state" or isinstance(other, dict):
                found.append(place(path, other))
        if isinstance(value, dict):
            found.append(place([*path, "surplus"], nested))
        for step, each in (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        ):
            walk([*path, step], each)

    walk([], content)
    return found


@pytest.mark.parametrize("kind", GOOD)
def test_every_kind_has_its_schema(kind: str) -> None:
    """The schema accepts the valid message and refuses every variant of `wrong_ones`, as Python does."""
    good = of_kind(kind)
    assert decode(topic("bench", kind), json.dumps(good).encode()).kind == kind
    wrong = wrong_ones(kind)
    assert len(wrong) > 15
    for content in wrong:
        with pytest.raises(Refused) as refusal:
            decode(topic("bench", kind), json.dumps(content).encode())
        assert len(str(refusal.value)) < 300 and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("kind", "changes", "sentence"),
    [
        (
            "forecast",
            {"path": {name: xs for name, xs in GOOD["forecast"]["path"].items() if name != "tip.y"}},
            "path has no tip.y",
        ),
        ("forecast", {"path": GOOD["forecast"]["path"] | {"tip.y": [0.1] * 9}}, "path.tip.y"),
        ("forecast", {"singular": 5}, "singular is 5, not an object"),
        (
            "alarm",
            {"figures": {"a": {"valueOf": 1, "toString": 1}}},
            "figures.a is {'valueOf': 1, 'toString': 1}, not a number",
        ),
        ("est", {"inputs": [["meas", 1]]}, "inputs"),
        ("state", {"book": {}}, "book has no offset"),
        ("whatif", {"candidates": []}, "candidates"),
    ],
)
def test_malformed_messages_are_refused_with_a_reason(kind: str, changes: dict[str, Any], sentence: str) -> None:
    """Each of these once stopped the dashboard or ended the summary with a KeyError."""
    with pytest.raises(Refused) as refusal:
        decode(topic("bench", kind), json.dumps(of_kind(kind, **changes)).encode())
    assert sentence in str(refusal.value)


class Listener(Worker):
    """A process that accepts samples in order and ignores them."""

    name, kinds = "listener", ("meas",)

    def __init__(self, config: Config):
        super().__init__(config)
        self.intake, self.taken = Intake(config.period), 0

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        self.intake.admit(message, now)
        self.taken += 1


def fuzzed(chance: random.Random, good: bytes) -> tuple[str, bytes]:
    """Returns a topic and payload that must be refused."""
    kind = chance.randrange(8)
    if kind == 0:
        return TOPIC, chance.randbytes(chance.randrange(200))
    if kind == 1:
        return TOPIC, good[: chance.randrange(len(good))]
    if kind == 2:
        return TOPIC, good + b" " * 16_000
    if kind == 3:
        return TOPIC, good.replace(
            b"1.57", chance.choice([b"NaN", b"Infinity", b"1e400", b"null", b'"1.57"', b"[1.57]", b"true", b"{}"])
        )
    if kind == 4:
        return topic(chance.choice(["other", "bench2", "x" * 80]), "meas"), good
    if kind == 5:
        return TOPIC, good.replace(b'"bench"', chance.choice([b'"other"', b"1", b"null", b'["bench"]']))
    if kind == 6:
        return TOPIC, good.replace(
            b'"time":', chance.choice([b'"time":-', b'"time":1.', b'"time":"', b'"time":99', b'"tim":'])
        )
    # An old message again.
    return TOPIC, encode(
        Message("meas", "bench", MEAS.time + PERIOD_NS * (old := chance.randrange(100)), old, MEAS.fields)
    )


def test_ten_thousand_fuzzed_messages_are_refused_with_one_line_each(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    listener = Listener(Config(str(tmp_path), "", ""))
    for seq in range(200):
        listener.received(
            TOPIC, encode(Message("meas", "bench", MEAS.time + PERIOD_NS * seq, seq, MEAS.fields)), MEAS.time
        )
    assert (listener.taken, listener.refused) == (200, 0)
    chance = random.Random(20)
    caplog.set_level(logging.WARNING, logger="fivebar")
    for _ in range(10_000):
        listener.received(*fuzzed(chance, encode(MEAS)), MEAS.time)
    assert listener.refused == len(caplog.records) == 10_000
    assert listener.taken == 200 and listener.intake.series is not None and listener.intake.series.seq == 199
    assert all(
        record.getMessage().startswith("refused: ") and "\n" not in record.getMessage() for record in caplog.records
    )


# --- which samples are taken ----------------------------------------------------------------------------------------------------------


def sample(seq: int, time: int | None = None) -> Message:
    return Message("meas", "bench", PERIOD_NS * seq + 10**9 if time is None else time, seq, {})


def admit(intake: Intake, *messages: Message, now: int | None = None) -> list[str]:
    """Classes of the messages (new, late, series, refused) at a time of the pipeline's clock, or at the time of each message."""
    results = []
    for message in messages:
        try:
            results.append(intake.admit(message, message.time if now is None else now))
        except Refused:
            results.append("refused")
    return results


def test_samples_are_put_in_order() -> None:
    intake = Intake(0.005)
    assert admit(intake, sample(0), sample(1), sample(4), sample(3), sample(3), sample(4), sample(5)) == [
        "series", "new", "new", "late", "refused", "refused", "new",
    ]  # fmt: skip
    assert intake.missing == 1
    assert admit(intake, sample(5 + 64), sample(2), sample(69 - 63)) == ["new", "refused", "late"]


def test_a_jump_of_the_clock_is_no_new_series() -> None:
    for jump in (3600 * 10**9, -3600 * 10**9):
        intake = Intake(0.005)
        begin = 10**13
        assert admit(intake, *(sample(i, begin + PERIOD_NS * i) for i in range(3))) == ["series", "new", "new"]
        assert admit(intake, *(sample(i, begin + jump + PERIOD_NS * i) for i in range(3, 6))) == ["new"] * 3


def test_a_machine_that_restarts_its_count_is_accepted_after_some_samples() -> None:
    intake = Intake(0.005)
    admit(intake, *(sample(i) for i in range(1000, 1100)))
    later = sample(1100).time + 10**9
    results = admit(intake, *(sample(i, later + PERIOD_NS * i) for i in range(CONSISTENT + 5)))
    assert results == ["refused"] * (CONSISTENT - 1) + ["series"] + ["new"] * 5


def test_one_forged_sample_ends_no_series_and_old_ones_start_none() -> None:
    intake = Intake(0.005)
    admit(intake, *(sample(i) for i in range(1000)))
    forged = sample(10**9, sample(1000).time)
    assert admit(intake, forged, sample(1000), forged, sample(1001)) == ["refused", "new", "refused", "new"]
    assert set(admit(intake, *(sample(i) for i in range(900)))) == {"refused"}
    assert admit(intake, sample(1002)) == ["new"]
