"""`fivebar check`: its findings about a record, and fixes that a second check accepts."""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
import pytest

from conftest import wait_until
from fivebar import scene as scenes
from fivebar.commands import main
from fivebar.kinematics import Machine as Kinematics
from fivebar.statics import holding_torques
from fivebar.twin import config as configuration
from fivebar.twin import listen, record
from fivebar.twin.config import Broker, Config
from fivebar.twin.errors import TwinError
from fivebar.twin.importing import check
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.starter import free_port

GRID = 0.005 * np.arange(400)
MOTION = np.column_stack([2.2 + 0.3 * np.sin(3 * GRID), 0.9 - 0.25 * np.sin(5 * GRID)])
STEP = 2 * np.pi / 2**16
"""Step of the encoders that a twin assumes by default, rad."""

SCENE: dict[str, Any] = {
    "description": "A machine of unequal legs.",
    "base.distance": 0.08,
    **{f"link[{i}].length": length for i, length in enumerate((0.10, 0.12, 0.13, 0.11), 1)},
    **{f"link[{i}].com": 0.05 for i in (1, 2, 3, 4)},
    **{f"link[{i}].inertia": 1e-5 for i in (1, 2, 3, 4)},
    "init.theta[1]": 2.2,
    "init.theta[2]": 0.9,
}
TIP = (
    Kinematics.from_values({name: value for name, value in SCENE.items() if name.endswith(("distance", "length"))})
    .forward(MOTION)
    .tip
)
BEGIN = 1_795_331_400_000_000_000


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmu: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    write_scene()


def write_scene(**more: Any) -> None:
    Path("machine.json").write_text(json.dumps(SCENE | more), encoding="utf-8")


def rounded(angles: np.ndarray) -> np.ndarray:
    return np.round(angles / STEP) * STEP


def write_csv(time: Any, angles: np.ndarray, **more: Any) -> None:
    """Writes bench.csv; NaN becomes an empty cell."""
    columns = {"time": time, "theta[1]": angles[:, 0], "theta[2]": angles[:, 1], **more}
    rows = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)]
    Path("bench.csv").write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="utf-8")


def checked(text: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, list[tuple[str, str]]], str]:
    """Returns the exit code, the findings (state, sentence) by question, and the blocks to copy."""
    code = main(["check", "machine.json", *(words or ["bench.csv"])])
    out = text.readouterr().out
    report, _, blocks = out.partition("\n\n")
    found: dict[str, list[tuple[str, str]]] = {}
    for line in report.splitlines()[1:]:
        state, question, sentence = line.split(maxsplit=2)
        found.setdefault(question, []).append((state, sentence))
    return code, found, blocks


def test_coarse_times_are_to_be_fixed(capsys: pytest.CaptureFixture[str]) -> None:
    """Four of five samples have the time of the row above, with other readings."""
    write_csv(np.floor(40 * GRID + 1e-9) / 40, rounded(MOTION))
    code, found, _ = checked(capsys)
    [(state, sentence), *_] = found["record"]
    assert code == 1 and state == "fix"
    assert sentence.startswith("320 of 400 samples are left out, because they repeat the time of the row above, ")


def test_a_good_record_needs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    write_csv(GRID, rounded(MOTION), **{"tip.x": TIP[:, 0], "tip.y": TIP[:, 1]})
    code, found, blocks = checked(capsys)
    assert code == 0 and not blocks
    assert {state for each in found.values() for state, _ in each} == {"ok"}
    assert {"units", "clock", "rate", "encoders", "signs", "reach", "zeros"} <= set(found)


def test_units_signs_and_zeros_are_put_right_by_the_map_that_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """The head names no units (ms, deg, mm); the left angle is reversed; both zeros are off, the right one also by a turn."""
    angles = np.degrees(rounded((MOTION - [0.4, -0.3]) * [-1, 1])) - [0.0, 360.0]
    write_csv(1e3 * GRID, angles, **{"tip.x": 1e3 * TIP[:, 0], "tip.y": 1e3 * TIP[:, 1]})
    code, found, blocks = checked(capsys)
    assert code == 1 and [state for state, _ in found["units"]] == ["fix"] * 4
    assert [sentence.rpartition("Taken as ")[2] for _, sentence in found["units"]] == ["ms.", "deg.", "deg.", "mm."]
    assert ("fix", "left angle reversed") in found["signs"]
    Path("map.json").write_text(blocks.partition("the map:")[2].partition("\n\n")[0], encoding="utf-8")
    code, found, blocks = checked(capsys, "bench.csv", "--map", "map.json")
    assert code == 0 and not blocks, found


def test_counts_need_the_counts_of_a_turn(capsys: pytest.CaptureFixture[str]) -> None:
    """A record cannot show the counts of a turn: it is refused with the line that the map needs."""
    write_csv(GRID, np.round(MOTION * 8192 / (2 * np.pi)))
    assert main(["check", "machine.json", "bench.csv"]) == 2
    error = capsys.readouterr().err
    assert "are these counts of an encoder?" in error
    assert '"unit": "counts", "steps": N, with N counts in a turn' in error and error.count("\n") == 1


def test_a_wrong_unit_in_the_map_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """A unit that the user wrote in the map is not replaced."""
    write_csv(GRID, MOTION * 100)
    Path("map.json").write_text(
        json.dumps({f"measured.theta[{i}]": {"column": f"theta[{i}]", "unit": "rad"} for i in (1, 2)}), encoding="utf-8"
    )
    assert main(["check", "machine.json", "bench.csv", "--map", "map.json"]) == 2
    assert "are these degrees?" in capsys.readouterr().err


def test_limits_of_a_record_with_encoders_only(capsys: pytest.CaptureFixture[str]) -> None:
    write_csv(GRID, rounded(MOTION))
    code, found, blocks = checked(capsys)
    assert code == 0 and not blocks
    assert any(state == "?" and "not distinguishable" in sentence for state, sentence in found["signs"])
    assert [state for state, _ in found["zeros"]] == ["?"] * 3
    assert found["zeros"][2][1].startswith("to see signs, exchanges and zeros, record one of passive.theta[1..2], ")


def test_a_dead_encoder_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """An encoder that never moves, one that stops while its command moves, and one without readings."""
    angles = rounded(MOTION)
    dead = angles.copy()
    dead[:, 1] = dead[0, 1]
    write_csv(GRID, dead)
    code, found, _ = checked(capsys)
    assert code == 1
    assert any(
        state == "fix" and sentence.startswith("measured.theta[2] stands at") for state, sentence in found["encoders"]
    )
    stuck = angles.copy()
    stuck[100:200, 0] = stuck[100, 0]
    write_csv(GRID, stuck, **{f"servo.theta[{i + 1}]": MOTION[:, i] for i in (0, 1)})
    code, found, _ = checked(capsys)
    assert code == 1 and any("while servo.theta[1] moves by" in sentence for _, sentence in found["encoders"])
    # Without commands, a motor at rest looks the same.
    write_csv(GRID, stuck)
    code, found, _ = checked(capsys)
    assert code == 0 and all(state == "ok" for state, _ in found["encoders"])
    dead[:, 1] = np.nan
    write_csv(GRID, dead)
    code, found, _ = checked(capsys)
    assert code == 1 and ("fix", "measured.theta[2] has no reading") in found["encoders"]


def test_a_clock_that_is_uneven_or_falls_back_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    uneven = GRID + 0.004 * np.random.default_rng(1).random(len(GRID))
    write_csv(uneven, rounded(MOTION))
    code, found, _ = checked(capsys)
    assert code == 1 and all("stamp a sample where the encoder is read" in sentence for _, sentence in found["jitter"])
    write_csv(np.concatenate([GRID[:200], GRID[:200]]), rounded(MOTION))
    code, found, _ = checked(capsys)
    assert code == 0 and found["clock"][0][0] == "?" and found["clock"][0][1].startswith("falls back 1 times")
    gap = np.concatenate([GRID[:200], GRID[200:] + 1.0])
    write_csv(gap, rounded(MOTION))
    code, found, _ = checked(capsys)
    assert code == 1 and all(state == "fix" and "longest gap 1" in sentence for state, sentence in found["rate"])


def test_whole_turns_and_counter_overflows_are_distinguished(capsys: pytest.CaptureFixture[str]) -> None:
    jumps = rounded(MOTION)
    jumps[200:, 0] -= 2 * np.pi
    write_csv(GRID, jumps)
    code, found, _ = checked(capsys)
    assert code == 0 and found["turns"][0][1].startswith("measured.theta[1] jumps by whole turns 1 times")
    jumps[200:, 0] += 2 * np.pi - 4.0
    write_csv(GRID, jumps)
    code, found, _ = checked(capsys)
    assert code == 1 and "which is no whole turn" in found["turns"][0][1]


def test_a_machine_beyond_its_reach_or_away_from_its_start_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(**{"base.distance": 0.6})
    write_csv(GRID, rounded(MOTION))
    code, found, _ = checked(capsys)
    assert code == 1 and found["reach"][0] == (
        "fix",
        "100 % of the samples are beyond the machine's reach: are lengths, zeros and signs right?",
    )
    write_scene()
    write_csv(GRID, rounded(MOTION - [0.3, 0.0]))
    code, found, blocks = checked(capsys)
    assert code == 0 and not blocks and '"encoder.offset[1]": -0.3' in found["start"][0][1]
    # Only exchanged encoders are within reach. The zeros are unknown, so this is a guess.
    write_csv(GRID, rounded(MOTION + [0.3, 0.0]))
    code, found, blocks = checked(capsys)
    assert code == 0 and ("?", "encoders exchanged") in found["signs"]
    assert blocks.startswith("the map, one of several that fit:")
    write_scene(**{"init.theta[1]": 1.7})
    write_csv(GRID, rounded(MOTION), **{"tip.x": TIP[:, 0], "tip.y": TIP[:, 1]})
    code, found, blocks = checked(capsys)
    # One step of the encoder.
    assert code == 1 and float(blocks.rpartition(": ")[2].rstrip(",\n")) == pytest.approx(2.2, abs=2e-4)


def test_errors_of_the_encoders_that_the_twin_does_not_take(capsys: pytest.CaptureFixture[str]) -> None:
    """The check of a coarse encoder prints lines for the scene; with these lines the next check passes."""
    coarse = 2 * np.pi / 2000
    write_csv(GRID, np.round(MOTION / coarse) * coarse)
    code, found, blocks = checked(capsys)
    assert code == 1 and len(found["noise"]) == 2
    write_scene(**json.loads("{" + blocks.partition("for the scene:")[2].rstrip().rstrip(",") + "}"))
    code, found, _ = checked(capsys)
    assert code == 0 and "noise" not in found


def samples(angles: np.ndarray, **more: Any) -> list[tuple[str, bytes, int]]:
    """Messages of a machine with their arrival times."""
    found = []
    for k, row in enumerate(angles):
        at = BEGIN + 5_000_000 * k
        fields = {f"measured.theta[{i + 1}]": float(row[i]) for i in (0, 1)}
        fields |= {name: float(column[k]) for name, column in more.items()}
        found.append((topic("bench", "meas"), encode(Message("meas", "bench", at, k, fields)), at))
    return found


def test_a_machine_at_a_broker_gets_mounting_angles(capsys: pytest.CaptureFixture[str]) -> None:
    """A live machine has no map: its publisher corrects signs and exchanges; the scene has the zeros."""
    tip = {"tip.x": TIP[:, 0], "tip.y": TIP[:, 1]}
    heard = samples(rounded(np.column_stack([MOTION[:, 1] + 0.2, -MOTION[:, 0]])), **tip)
    given = check.of_recording(listen.recorded("the broker", heard, ""))
    assert check.run("machine.json", given) == 1
    out = capsys.readouterr().out
    assert "  as measured.theta[1]: -measured.theta[2]\n  as measured.theta[2]: measured.theta[1]\n" in out
    # The lengths are exact, so zeros found from the tip are off by half a step of the encoder at most.
    offset = float(out.partition('"encoder.offset[2]": ')[2].partition(",")[0])
    assert offset == pytest.approx(0.2, abs=1e-3)
    write_scene(**{"encoder.offset[2]": 0.2})
    better = samples(rounded(np.column_stack([MOTION[:, 0], MOTION[:, 1] + 0.2])), **tip)
    assert check.run("machine.json", check.of_recording(listen.recorded("the broker", better, ""))) == 0


@pytest.mark.parametrize(
    ("servo", "commands", "named"),
    [
        (True, ["tau[1]", "tau[2]"], "tau[1] and tau[2] and no servo.theta[1] and servo.theta[2]"),
        (True, ["tau[1]", "tau[2]", "servo.theta[1]"], "tau[2] and no servo.theta[2]"),
        (True, ["tau[1]", "tau[2]", "servo.theta[1]", "servo.theta[2]"], ""),
        (False, ["tau[1]", "tau[2]"], ""),
    ],
)
def test_servos_that_are_on_without_commands_are_named(
    servo: bool, commands: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene's servos would hold, while the record has torques only."""
    write_scene(**{"servo.enabled": servo, "servo.kp[1]": 1.5, "servo.kp[2]": 1.5})
    write_csv(GRID, rounded(MOTION), **{name: MOTION[:, int(name[-2]) - 1] for name in commands})
    _, found, _ = checked(capsys)
    (line,) = found.get("drives", [("", "")])
    assert line[0] == ("?" if named else "") and f"the record has {named}" in line[1] if named else not line[1]


def test_a_zero_from_commands_is_without_the_deflection_of_the_servos(capsys: pytest.CaptureFixture[str]) -> None:
    """Encoder 2 is off by 50 mrad, and the servos give way to the weight by 5 mrad or more, on average."""
    write_scene(**{"servo.enabled": True, "servo.kp[1]": 1.5, "servo.kp[2]": 1.0})
    machine = scenes.read("machine.json")
    deflections = holding_torques(machine, Kinematics.from_scene(machine).forward(MOTION).theta) / [1.5, 1.0]
    assert np.all(np.abs(deflections.mean(axis=0)) > 5e-3)
    commands = {f"servo.theta[{i + 1}]": MOTION[:, i] for i in (0, 1)}
    write_csv(GRID, rounded(MOTION - deflections + [0.0, 0.05]), **commands)
    _, found, _ = checked(capsys)
    for (state, sentence), expected, zero, mean in zip(
        found["zeros"], ("ok", "fix"), (0.0, -0.05), deflections.mean(axis=0), strict=True
    ):
        # The means of 400 rounded angles are within the last of four printed decimals.
        assert state == expected and float(sentence.split()[2]) == pytest.approx(zero, abs=1.1e-4)
        assert f"without the servo's mean deflection of {1e3 * mean:.2g} mrad under load" in sentence
    write_scene()
    _, found, _ = checked(capsys)
    for (_, sentence), zero in zip(found["zeros"], deflections.mean(axis=0) - [0.0, 0.05], strict=True):
        assert float(sentence.split()[2]) == pytest.approx(zero, abs=1.1e-4)
        assert "the drive's deflection under load is part of it, since the scene has no gain" in sentence


@pytest.mark.parametrize(
    ("more", "shift", "words"),
    [
        ({"gravity.enabled": False}, 0.0, ""),
        ({"servo.kp[1]": 0.05, "servo.kp[2]": 0.05}, 0.0, ", without the servo's mean deflection of "),
        # The elbows are 0.28 m apart, the distal links together are 0.25 m long.
        ({}, 0.9, ", and the drive's deflection under load is part of it, since the commands are out of reach"),
    ],
)
def test_a_deflection_of_the_servos_is_named_if_it_is_not_zero(
    more: dict[str, Any], shift: float, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Deflections beyond 100 mrad have no exponent, and commands out of reach are no lack of gains."""
    write_scene(**{"servo.enabled": True, "servo.kp[1]": 1.5, "servo.kp[2]": 1.0} | more)
    commands = MOTION + [shift, -shift]
    deflections = np.zeros((len(GRID), 2))
    if "mean" in words:
        machine = scenes.read("machine.json")
        deflections = holding_torques(machine, Kinematics.from_scene(machine).forward(MOTION).theta) / 0.05
        assert np.all(np.abs(deflections.mean(axis=0)) > 0.1)
    write_csv(GRID, rounded(commands - deflections), **{f"servo.theta[{i + 1}]": commands[:, i] for i in (0, 1)})
    _, found, _ = checked(capsys)
    for _, sentence in found["zeros"]:
        _, _, said = sentence.partition(" rad relative to the map")
        assert said.startswith(words) if words else not said, sentence
        assert "e+" not in said and "no gain" not in said, sentence


def test_a_record_of_the_twin_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [record.Row(where, at, k, payload) for k, (where, payload, at) in enumerate(samples(rounded(MOTION)))]
    Path("record").mkdir()
    record.write_part(Path("record"), 0, 0, rows)
    code, found, _ = checked(capsys, "record")
    assert code == 0 and found["rate"][0][1].startswith("measured.theta[1]: 400 samples, 200 Hz")
    assert main(["check", "machine.json", "record", "--map", "map.json"]) == 2
    assert "it needs none" in capsys.readouterr().err


def test_messages_that_a_twin_would_refuse_are_named() -> None:
    """Times in milliseconds, a misspelt field, and no messages at all."""
    slow = [
        (where, payload.replace(f'"time":{at}'.encode(), f'"time":{at // 10**6}'.encode()), at)
        for where, payload, at in samples(MOTION)
    ]
    with pytest.raises(TwinError, match=r"a twin would refuse 400 of 400 samples.*are these milliseconds\?"):
        listen.recorded("the broker", slow, "")
    odd = [(where, payload.replace(b"measured.", b"mesured."), at) for where, payload, at in samples(MOTION)]
    with pytest.raises(
        TwinError, match=r"the broker has no message meas; 400 are malformed: meas: fields has neither measured"
    ):
        listen.recorded("the broker", odd, "")
    with pytest.raises(TwinError, match="the broker has no message meas of unit 'arm'"):
        listen.recorded("the broker", samples(MOTION), "arm")


@pytest.mark.nightly
def test_it_listens_to_a_broker(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A machine publishes until the check ends. Times and counts come from the machine, so a busy computer changes nothing."""
    port = free_port()
    configuration.write(Config(str(tmp_path), "", "", broker=Broker(port=port)), tmp_path / "twin.json")
    command = [sys.executable, "-m", "fivebar.twin", "broker", "--config", str(tmp_path / "twin.json")]
    broker = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)

    def answers() -> bool:
        try:
            return client.connect("127.0.0.1", port) == mqtt.MQTT_ERR_SUCCESS
        except OSError:
            return False

    ended = threading.Event()

    def publish() -> None:
        begin, k = time.time_ns(), 0
        while not ended.wait(0.002):
            angles = rounded(MOTION[k % 400])
            fields = {f"measured.theta[{i + 1}]": float(angles[i]) for i in (0, 1)}
            client.publish(topic("bench", "meas"), encode(Message("meas", "bench", begin + 5_000_000 * k, k, fields)))
            k += 1

    try:
        wait_until(answers)
        client.loop_start()
        machine = threading.Thread(target=publish)
        machine.start()
        words = ["check", "machine.json", "--broker", f"127.0.0.1:{port}", "--seconds"]
        # A busy computer may need longer to connect.
        seconds = 2
        while main([*words, str(seconds)]) == 2:
            assert broker.poll() is None, broker.communicate()[1]
            seconds *= 2
            assert seconds < 300
        assert "measured.theta[1]: " in capsys.readouterr().out
    finally:
        ended.set()
        client.disconnect()
        client.loop_stop()
        broker.terminate()
        broker.communicate()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "one is needed: a FILE, or --broker"),
        (["bench.csv", "--broker", "127.0.0.1:1"], "one is needed: a FILE, or --broker"),
        (["--broker", "127.0.0.1:1"], "there is no broker at 127.0.0.1:1: "),
        (["--broker", "192.0.2.1:1883"], "broker 192.0.2.1 is not on this machine: user, password and TLS"),
        (["--broker", "127.0.0.1:1", "--seconds", "0"], "seconds must be more than 0, not 0"),
        (["--broker", "127.0.0.1:1", "--map", "map.json"], "--map is map.json, but samples from a broker have no columns"),
        (["none.csv"], "none.csv: it cannot be read: No such file"),
    ],
)  # fmt: skip
def test_refusals_are_one_sentence(words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "machine.json", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"fivebar check: {sentence}") and error.count("\n") == 1
