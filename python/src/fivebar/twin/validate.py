"""`fivebar validate RECORD --scene SCENE`: judges the twin's predictions of a recording, without a broker and faster than real time."""

import json
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from fivebar.colours import LEFT, RIGHT
from fivebar.drawing import ABOVE, FAINT, INK, RUN_COLOURS, STYLE, WRONG, panels, save
from fivebar.errors import FiveBarError
from fivebar.library import Library
from fivebar.plain import plain
from fivebar.twin import figures, held_out, scene, setup, starter, summary, torque_scale
from fivebar.twin.ahead import Ahead
from fivebar.twin.config import Config
from fivebar.twin.errors import TwinError
from fivebar.twin.figures import Story
from fivebar.twin.follow import Twin
from fivebar.twin.held_out import Errors, HeldOut
from fivebar.twin.machine import Player
from fivebar.twin.messages import INPUTS, encode
from fivebar.twin.process import Worker
from fivebar.twin.recorder import Recorder
from fivebar.twin.soak import BEGIN, Wire
from fivebar.twin.torque_scale import Advice, Needed
from fivebar.twin.watch import STARTING, Watch

TICK_EVERY: Final = 100
"""Number of samples between two ticks of the workers."""

LEVELS: Final = np.linspace(0.5, 0.99, 50)
"""Probabilities of the bands in the picture of the coverage."""


@dataclass(frozen=True)
class Options:
    """Input and output of a validation."""

    record: Path
    scene: str | Path
    fmu: Path
    out: Path
    known_commands: bool = False
    """Whether forecasts know the commands that the record has for their time."""


def run(options: Options) -> int:
    """Returns 0 if all promises are kept, 1 if not or if the machine was not followed; the figures are in OUT/validation.json."""
    with tempfile.TemporaryDirectory() as folder:
        config = starter.configure(_of_recording(options), Path(folder))
        starter.check_followed(config, True)
        content, judged = follow(config, options.known_commands)
    content = {"record": str(options.record)} | content
    options.out.mkdir(parents=True, exist_ok=True)
    files = _write(options.out, content, judged)
    _tell(content, files)
    return 1 if content["missed"] else 0


def _of_recording(options: Options) -> starter.Options:
    """Options of a twin that plays this recording."""
    return starter.Options(
        seconds=math.inf,
        scene=options.scene,
        fmu=options.fmu,
        out=options.out,
        unit=Config.unit,
        broker=None,
        user="",
        ca_file="",
        machine="none",
        csv=options.record,
        hidden=None,
        faults="",
        learn=False,
        exact=False,
        open=False,
    )


def follow(config: Config, known_commands: bool = False) -> tuple[dict[str, Any], HeldOut]:
    """Plays the recording to twin, forecasts and watch; returns the figures, and the errors from which they are computed.

    With `known_commands`, forecasts follow the recorded commands of their time. Otherwise they know the plan of the scene or none."""
    library = Library(Path(config.fmu))
    try:
        ahead, watch, source = Ahead(config, library, at_once=True), Watch(config), Player(config)
        commanded = [name for name in INPUTS if name in source.recording.columns]
        if known_commands:
            if not commanded:
                raise TwinError(
                    f"{config.machine.csv} has no commands for the forecasts to use; it needs a column servo.theta, servo.omega or tau"
                )
            ahead.forecaster.known = source.commands(scene.read(Path(config.scene)))
        workers = _play(config, library, source, ahead, watch)
        story = figures.read(config.record)
        judged = held_out.judge(config, story, known_commands)
        advice = _advice(config, library, story, judged)
    finally:
        library.close()
    status = {worker.name: [{"refused": worker.refused, **worker.status()}] for worker in workers}
    whole = figures.summarise(config, story, figures.judge(story), status, {})
    part = judged.content()
    if not commanded:
        part["not_judged"].append(
            "the drives: the record has no commands, so that all drive torques are unknown forces for the twin"
        )
    content = {
        "scene": whole["scene"],
        "description": scene.read(Path(config.scene)).description,
        "period_s": config.period,
        "notes": source.recording.notes,
        "samples": whole["samples"],
        "held_out": part,
        "unknown_torque": advice.content(),
        "alarms": whole["alarms"],
        "causes": whole["causes"],
        "tip_error_mm": whole["tip_error_mm"],
        "tip_forecasts": whole["forecasts"]["by_ahead"] if whole["forecasts"]["judged"] else None,
    }
    unfollowed = figures.unfollowed(whole)
    return content | {"missed": [*([unfollowed] if unfollowed else []), *part["missed"], *whole["missed"]]}, judged


def _play(config: Config, library: Library, source: Player, *others: Worker) -> list[Worker]:
    """Plays a recording to a twin, its recorder and other workers; returns all of them. The record is in the folder of the configuration."""
    twin, recorder = Twin(config, library), Recorder(config)
    recorder.about = twin.setup.to_message(config.unit, BEGIN)
    wire = Wire(config, twin, *others, recorder)
    source.start_ns = BEGIN
    count = 0
    while (sample := source.next()) is not None:
        wire.send("meas", encode(sample))
        count += 1
        if count % TICK_EVERY == 0:
            wire.tick()
    wire.end()
    return list(wire.workers)


def _advice(config: Config, library: Library, story: Story, judged: HeldOut) -> Advice:
    """Measures the unknown torques. If another `estimator.torqueScale` may remove alarms or misses, a second twin follows with it.

    An error of the second run is printed; the results of the first one remain."""
    now = _needed(config, library, story, judged)
    if (other := now.to_try()) is None:
        return Advice(now)
    again = replace(config, folder=str(config.path / "again"), twin=config.twin | {torque_scale.NAME: other})
    again.path.mkdir(mode=0o700)
    try:
        _play(again, library, Player(again))
        tried = figures.read(again.record)
        return Advice(now, _needed(again, library, tried, held_out.judge(again, tried)))
    except FiveBarError as error:
        print(f"the second run, with {torque_scale.NAME} = {other:g}, failed: {error}")
        return Advice(now)


def _needed(config: Config, library: Library, story: Story, judged: HeldOut) -> Needed:
    values = setup.of_run(config, scene.read(Path(config.scene)), library.guid).values
    return torque_scale.measure(story, torque_scale.effective(library, values), judged.innovations.coverage())


def _write(out: Path, content: dict[str, Any], judged: HeldOut) -> list[Path]:
    """Writes figures, page and pictures into a folder; returns the files."""
    figures_file, page = out / "validation.json", out / "index.html"
    figures_file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    with plt.rc_context(STYLE):
        pictures = {
            "errors": (_errors(judged), "Readings minus their predictions in the held-out part; areas: 95 % bands"),
            "coverage": (
                _coverage(judged),
                "Counted coverage of the bands of each probability, and errors of all predictors",
            ),
        }
        page.write_text(
            summary.page_of(
                f"{content['scene']}: the twin judged by a recording",
                [content["description"], content["unknown_torque"]["advice"]],
                _cards(content),
                pictures,
                content,
            ),
            encoding="utf-8",
        )
        return [figures_file, page, *(save(figure, out / f"{name}.png") for name, (figure, _) in pictures.items())]


def _tell(content: dict[str, Any], files: list[Path]) -> None:
    samples, error = content["samples"], content["tip_error_mm"]
    print(
        f"{samples['recorded']} samples, every {1e3 * content['period_s']:.3g} ms; {samples['estimated']} estimates, {samples['followed']} within "
        f"{figures.NEAR:g} rad of their readings"
    )
    for note in content["notes"]:
        print(f"  {note}")
    print("\n".join(held_out.lines(content["held_out"])))
    if error["rms"] is not None:
        print(f"tip: estimates {error['rms']:.3g} mm off (rms), {error['max']:.3g} mm at most")
    for ahead, given in (content["tip_forecasts"] or {}).items():
        if given["coverage95"] is not None and float(ahead) == max(map(float, content["tip_forecasts"])):
            print(
                f"tip: forecasts {ahead} s ahead {given['error_mm']:.3g} mm off (rms), {plain(100 * given['coverage95'])} % inside their circles"
            )
    print(_alarms(content))
    print("\n".join(torque_scale.lines(content["unknown_torque"])))
    for sentence in content["missed"]:
        print(f"promise not kept: {sentence}")
    print(f"written: {', '.join(map(str, files))}")


def _alarms(content: dict[str, Any]) -> str:
    """Number, causes and duration of the alarms; an alarm that is on from the start has no count."""
    of = f", of {', '.join(content['causes'])}" if content["causes"] else ""
    share = _on(content)
    if share is None:
        return f"alarms: {content['alarms']}{of}; not judged: no series is longer than {STARTING:g} s"
    return f"alarms: {content['alarms']}{of}; on {plain(share)} % of the time (without the first {STARTING:g} s of each series)"


def _on(content: dict[str, Any]) -> float | None:
    """Share of the time with an alarm, %; None if no series is long enough."""
    return _percent(content["unknown_torque"]["alarm_share"])


def _cards(content: dict[str, Any]) -> str:
    part = content["held_out"]
    cards = [
        summary.card(part["samples"], "d", "", "samples held out"),
        summary.card(_percent(part["innovations"]["coverage95"]), ".1f", "%", "of the innovations inside 95 %"),
    ]
    for ahead, given in part["forecasts"].items():
        cards += [
            *(
                summary.card(given["rms_mrad"][i], ".3g", "mrad", f"encoder {i + 1}, {ahead} s ahead, rms")
                for i in range(2)
            ),
            summary.card(_percent(given["coverage95"]), ".1f", "%", f"of the forecasts of {ahead} s inside 95 %"),
        ]
    cards.append(summary.card(content["unknown_torque"]["size99_nm"], ".3g", "N·m", "unknown torque, 99 % quantile"))
    cards.append(summary.card(content["alarms"], "d", "", "alarms"))
    return "".join([*cards, summary.card(_on(content), ".3g", "%", "of the time with an alarm")])


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _errors(judged: HeldOut) -> Figure:
    """Innovations and forecast errors of each encoder over time, with the bands of the forecasts."""
    shown: list[tuple[str, Errors, np.ndarray | None]] = [("innovations", judged.innovations, None)]
    shown += [(f"{each.ahead:.3g} s ahead", each.errors, each.half_width) for each in judged.forecasts]
    figure, rows = panels(2, len(shown), figsize=(11, 5), sharex=True, squeeze=False)
    for i, colour in enumerate((LEFT, RIGHT)):
        for axes, (name, errors, half_width) in zip(rows[i], shown, strict=True):
            error = 1e3 * errors.error[:, i]
            if half_width is not None:
                band = 1e3 * half_width[:, i]
                axes.fill_between(
                    errors.time, -band, band, where=_unbroken(errors.time), color=FAINT, alpha=0.4, linewidth=0
                )
            outside = errors.distance[:, min(i, errors.distance.shape[1] - 1)] > 1
            axes.plot(errors.time[~outside], error[~outside], ".", markersize=2.5, color=colour)
            axes.plot(errors.time[outside], error[outside], "x", markersize=4, color=WRONG)
            axes.set_title(f"encoder {i + 1}, {name}")
        rows[i, 0].set_ylabel("error  (mrad)")
    for axes in rows[1]:
        axes.set_xlabel("time  (s)")
    return figure


def _unbroken(time: np.ndarray) -> np.ndarray:
    """Mask of the points after which a band continues; it is interrupted between two series."""
    steps = np.diff(time, append=np.inf)
    usual = float(np.median(steps[:-1])) if len(steps) > 1 else math.inf
    return np.asarray(steps <= 10 * usual)


def _coverage(judged: HeldOut) -> Figure:
    """Counted coverage of the bands by their probability, and rms errors of all predictors."""
    figure, (share, size) = panels(1, 2, figsize=(11, 4), width_ratios=(1, 1.3))
    share.plot([50, 100], [50, 100], color=FAINT, linewidth=1)
    shown = [("innovations", judged.innovations)]
    shown += [(f"{each.ahead:.3g} s ahead", each.errors) for each in judged.forecasts]
    for (name, errors), colour in zip(shown, RUN_COLOURS, strict=False):
        share.plot(100 * LEVELS, [100 * errors.coverage(level) for level in LEVELS], color=colour, label=name)
    share.set(
        xlabel="probability of the band  (%)", ylabel="errors inside, counted  (%)", xlim=(50, 100), ylim=(0, 102)
    )
    share.legend(ncols=len(shown), **ABOVE)
    bars: list[tuple[str, list[float | None]]] = []
    for each in judged.forecasts:
        bars.append((f"{each.ahead:.3g} s: the twin", held_out.sizes(each.errors.error)["rms_mrad"]))
        bars += [(name, held_out.sizes(error)["rms_mrad"]) for name, error in each.others.items()]
    for i, colour in enumerate((LEFT, RIGHT)):
        places = np.arange(len(bars)) + 0.4 * i - 0.2
        size.barh(places, [rms[i] or math.nan for _, rms in bars], 0.36, color=colour, label=f"encoder {i + 1}")
    size.set_yticks(np.arange(len(bars)), [name for name, _ in bars])
    size.invert_yaxis()
    size.set(xlabel="error, rms  (mrad)", xscale="log")
    size.tick_params(axis="y", colors=INK)
    if bars:
        size.legend(ncols=2, **ABOVE)
    return figure
