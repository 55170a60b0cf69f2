"""`fivebar export`: messages become series, a scene and a log; nightly, the libraries of both formats read the files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fivebar import extras
from fivebar.commands import main
from fivebar.kinematics import Machine
from fivebar.library import Library
from fivebar.twin import record
from fivebar.twin.exporting import work
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.soak import configured
from twin_support import recorded

SAMPLES = 100


@pytest.fixture(scope="module")
def story(fmu: Path, scenes: Path, library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of half a second of samples and estimates, one message of each other kind, and one malformed row."""
    config = configured(tmp_path_factory.mktemp("run"), fmu, library, scenes / "pick_and_place.json", exact=True)
    folder = Path(recorded(config, library, SAMPLES).folder)
    last = list(record.messages(folder, "est", refused=pytest.fail))[-1]
    tips = np.linspace(0.0, 0.01, 10)
    path = {name: (last.fields[name] + tips).tolist() for name in ("tip.x", "tip.y")}
    path |= {"ahead": np.linspace(0.05, 0.5, 10).tolist(), "estimated.forecast.radius95": [0.002] * 10}
    chance = {"probability": 0.25, "time": None}
    extra = {"ahead": 0.5, "path": path, "half_width": 0.002}
    extra |= {"singular": chance | {"type": "none"}, "stop": chance | {"at": "none"}}
    more = [
        Message("forecast", "bench", last.time, 1, {name: path[name][-1] for name in ("tip.x", "tip.y")}, extra),
        Message("alarm", "bench", last.time, 1, {}, {"state": "anomaly", "cause": "force", "named": "push"}),
        Message("alarm", "bench", last.time + 1, 2, {}, {"state": "calibrating", "cause": "force"}),
        Message("learned", "bench", last.time, 1, {"payload.mass": 0.05}, {"values": {"payload.mass": 0.05}}),
        Message("gap", "bench", last.time, 1, {"first": 7, "last": 9}, {"of": "meas", "why": "lost"}),
        Message("meas", "bench", last.time, 10**6, {"measured.theta[1]": 1.0, "tip.x": 0.1, "tip.y": 0.2}),
    ]
    rows = [record.Row(topic("bench", each.kind), each.time, each.seq, encode(each)) for each in more]
    rows.append(record.Row(topic("bench", "est"), last.time, 0, b"{"))
    record.write_part(folder, 10**6, 10**6, rows)
    return folder


class Kept:
    """A writer that stores all calls."""

    def __init__(self) -> None:
        self.series: dict[str, list[tuple[int, dict[str, float]]]] = {}
        self.scene: dict[str, list[tuple[int, list[work.Line]]]] = {}
        self.log: list[tuple[int, str, bool]] = []
        self.is_closed = False

    def numbers(self, topic: str, time: int, values: Mapping[str, float]) -> None:
        self.series.setdefault(topic, []).append((time, dict(values)))

    def lines(self, name: str, time: int, lines: list[work.Line]) -> None:
        self.scene.setdefault(name, []).append((time, lines))

    def sentence(self, time: int, text: str, is_alarm: bool) -> None:
        self.log.append((time, text, is_alarm))

    def close(self) -> None:
        self.is_closed = True


def test_every_kind_of_message_is_passed_on(story: Path) -> None:
    """Legs have the lengths of their links, the band surrounds the tip, and a forecast has its own time."""
    kept, machine = Kept(), work.machine(story)
    written = work.write(story, machine, kept)
    assert kept.is_closed and written.refused == 1
    # The samples of the stand-in and one added sample.
    assert len(kept.series["meas"]) == SAMPLES + 1 and len(kept.series["est"]) == len(kept.scene["twin"]) > SAMPLES / 2
    for (_, fields), (_, legs) in zip(kept.series["est"], kept.scene["twin"], strict=True):
        for leg, proximal, distal in zip(legs, (0, 3), (1, 2), strict=True):
            motor, elbow, tip = leg.points
            assert abs(elbow - motor) == pytest.approx(machine.lengths[proximal], abs=1e-12)
            # The twin's posture closes the loop to 1e-9.
            assert abs(tip - elbow) == pytest.approx(machine.lengths[distal], abs=1e-8)
            assert tip == complex(fields["tip.x"], fields["tip.y"])
    (at, fields), (_, [circle]) = kept.series["est"][-1], kept.scene["band"][-1]
    radii = np.abs(np.array(circle.points) - complex(fields["tip.x"], fields["tip.y"]))
    assert radii == pytest.approx(np.full(33, fields["band"]), rel=1e-9)
    [(time, forecast)] = kept.series["forecast"]
    assert time == at + 500_000_000 and forecast["half_width"] == 0.002
    assert kept.series["risk"] == [(at, {"singular.probability": 0.25, "stop.probability": 0.25})]
    assert [values["anomaly"] for _, values in kept.series["alarm"]] == [1.0, 0.0]
    assert kept.log == [
        (at, "anomaly: push", True),
        (at + 1, "calibrating: force", False),
        (at, "meas 7 to 9 are missing: lost", False),
    ]
    assert kept.series["learned"] == [(at, {"payload.mass": 0.05})] and len(kept.scene["tracked"]) == SAMPLES + 1


def test_several_writers_share_one_reading(story: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each gets all messages, and is closed also if another one fails."""
    machine = work.machine(story)
    readings, read = [], record.messages

    def counted(*given: Any, **named: Any) -> Any:
        readings.append(given)
        return read(*given, **named)

    monkeypatch.setattr(record, "messages", counted)
    alone, first, second = Kept(), Kept(), Kept()
    written = work.write(story, machine, alone)
    assert work.write(story, machine, first, second) == written and len(readings) == 2
    assert alone.__dict__ == first.__dict__ == second.__dict__

    class Failing(Kept):
        def close(self) -> None:
            raise OSError("the disk is full")

    before, after = Kept(), Kept()
    with pytest.raises(OSError, match="the disk is full"):
        work.write(story, machine, before, Failing(), after)
    assert before.is_closed and after.is_closed


@pytest.mark.parametrize(("format_", "package"), [("mcap", "foxglove-sdk"), ("rerun", "rerun-sdk")])
def test_a_missing_library_is_named(
    story: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    format_: str,
    package: str,
) -> None:
    installed = extras._installed
    monkeypatch.setattr(extras, "_installed", lambda name: None if name == package else installed(name))
    assert main(["export", str(story), f"--{format_}", "-o", str(tmp_path / "out")]) == 2
    sentence = f"{package} is needed and not installed: pip install 'fivebar[{format_}]' installs what is needed"
    assert capsys.readouterr().err == f"fivebar export: {sentence}\n"
    assert not (tmp_path / "out").exists()


def test_a_format_is_needed(story: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(story)]) == 2
    assert "a format is needed: --mcap, --rerun or both" in capsys.readouterr().err


@pytest.fixture
def kept(story: Path) -> Kept:
    """The series, scene and log that both files must contain."""
    found = Kept()
    work.write(story, work.machine(story), found)
    return found


@pytest.mark.nightly
def test_foxglove_s_file_in_the_reader_of_mcap(story: Path, kept: Kept, tmp_path: Path) -> None:
    """Series and times are equal to the bit; legs, bands and log are messages of Foxglove's types."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    assert main(["export", str(story), "--mcap", "-o", str(tmp_path)]) == 0
    found: dict[str, list[tuple[int, Any]]] = {}
    schemas = {}
    with (tmp_path / "record.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            schemas[channel.topic] = schema.name
            if channel.message_encoding == "json":
                decoded = json.loads(message.data)
            else:
                decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
                assert decode is not None
                decoded = decode(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    assert schemas["/scene"] == "foxglove.SceneUpdate" and schemas["/log"] == "foxglove.Log"
    for name, points in kept.series.items():
        expected = [(time, {work.plain(key): value for key, value in values.items()}) for time, values in points]
        assert found[f"/{name}"] == expected
    twin = [(time, update.entities[0]) for time, update in found["/scene"] if update.entities[0].id == "twin"]
    for (time, entity), (at, legs) in zip(twin, kept.scene["twin"], strict=True):
        assert time == at and entity.frame_id == "machine"
        assert [[complex(p.x, p.y) for p in line.points] for line in entity.lines] == [leg.points for leg in legs]
    assert [(time, log.message) for time, log in found["/log"]] == [(time, text) for time, text, _ in kept.log]


@pytest.mark.nightly
def test_rerun_s_file_in_the_reader_of_rerun(story: Path, kept: Kept, tmp_path: Path) -> None:
    """Rerun's own reader finds in the file the record's series and times, equal to the bit, and each change of the scene."""
    from rerun.chunk import RrdReader

    assert main(["export", str(story), "--rerun", "-o", str(tmp_path)]) == 0
    rows: dict[str, dict[int, Any]] = {}
    for chunk in RrdReader(tmp_path / "record.rrd").stream():
        batch = chunk.to_record_batch()
        if "time" not in batch.schema.names:
            continue
        times = np.asarray(batch.column("time").cast("int64")).tolist()
        [values] = [
            batch.column(i)
            for i, name in enumerate(batch.schema.names)
            if name.endswith((":scalars", ":strips", ":text"))
        ]
        part = rows.setdefault(chunk.entity_path.strip("/"), {})
        for time, value in zip(times, values.to_pylist(), strict=True):
            part.setdefault(time, []).append(value)
    for name, points in kept.series.items():
        for key in points[-1][1]:
            expected = [(time, values[key]) for time, values in points if key in values]
            got = rows[f"{name}/{work.plain(key)}"]
            assert [(time, value) for time in sorted(got) for [value] in got[time]] == sorted(expected)
    assert sum(map(len, rows["scene/twin"].values())) == len(kept.scene["twin"])
    assert sum(map(len, rows["log"].values())) == len(kept.log)


def test_the_machine_is_the_scene_s(story: Path, scenes: Path) -> None:
    assert work.machine(story) == Machine.from_scene(scenes / "pick_and_place.json")
