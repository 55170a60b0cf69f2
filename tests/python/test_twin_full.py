"""Tests of the twin's pipeline that need Debian packages: mosquitto with users, roles and TLS, killed processes, Chromium."""

import csv
import itertools
import json
import os
import shutil
import signal
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from browser import open_browser
from conftest import PATIENCE, REPOSITORY, settle, started, wait_until
from fivebar.colours import COLOURS
from fivebar.commands import main
from fivebar.library import Library
from fivebar.twin import figures
from fivebar.twin.dashboard import KEPT, SKIPPED
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.soak import configured, machine
from fivebar.twin.starter import ENDING, free_port
from test_twin_messages import GOOD, of_kind, wrong_ones

pytestmark = pytest.mark.full

COMMAND = [sys.executable, "-m", "fivebar"]
EXAMPLES = REPOSITORY / "python" / "mosquitto"


class Run:
    """A running pipeline."""

    def __init__(self, out: Path, fmu: Path, scenes: Path, *more: str, environment: dict[str, str] | None = None):
        self.out = out
        given = ["twin", "--scene", str(scenes / "pick_and_place.json"), "--fmu", str(fmu), "--out", str(out), *more]
        self.process = subprocess.Popen(
            [*COMMAND, *given], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        started(self.process)
        (self.folder,) = (out / "runs").iterdir()
        self.config = json.loads((self.folder / "twin.json").read_text())

    @property
    def page(self) -> str:
        return f"http://127.0.0.1:{self.config['dashboard_port']}/"

    def pids(self, name: str) -> list[int]:
        """Process ids of all starts of a process that reported ready so far."""
        files = (self.folder / "status").glob(f"{name}-*.json")
        ready = [path for path in files if json.loads(path.read_text()).get("ready")]
        return [int(path.stem.rpartition("-")[2]) for path in sorted(ready, key=lambda path: path.stat().st_ctime)]

    def stored(self) -> int:
        """Time of the older of both stored states, ns; 0 before the first."""
        return min((path.stat().st_mtime_ns for path in (self.folder / "state").glob("*.json")), default=0)

    def stop(self) -> None:
        """Asks the run to end, as by Ctrl-C."""
        self.process.send_signal(signal.SIGINT)

    def finish(self) -> dict[str, Any]:
        """Waits for the end; returns the summary.

        Code 3 says that the forecasts were wider than promised: a busy machine makes only some of them, perhaps the widest.
        """
        text = self.process.communicate(timeout=PATIENCE)[0]
        assert self.process.returncode in (0, 3), text
        return json.loads((self.out / "summary.json").read_text())

    def replayed(self, fmu: Path) -> None:
        """Replays the record, which must agree."""
        assert main(["replay", str(self.folder / "record"), "--fmu", str(fmu)]) == 0


@contextmanager
def running(out: Path, fmu: Path, scenes: Path, *more: str, environment: dict[str, str] | None = None) -> Iterator[Run]:
    """A run that ends with the test, also if the test fails: its processes have priority over tests and browsers."""
    run = Run(out, fmu, scenes, *more, environment=environment)
    try:
        yield run
    finally:
        if run.process.poll() is None:
            run.stop()
            run.process.communicate(timeout=PATIENCE)


class Ear:
    """Collects published messages with their arrival times."""

    def __init__(
        self,
        port: int,
        *kinds: str,
        host: str = "127.0.0.1",
        login: tuple[str, str, Path] | None = None,
        unit: str = "bench",
    ):
        self.unit = unit
        self.heard: list[tuple[float, str, dict[str, Any]]] = []
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self.client.reconnect_delay_set(0.1, 0.1)
        self.failures: list[str] = []
        self.client.on_connect = self._connected
        self.client.on_disconnect = lambda _c, _d, _f, reason, _p: self.failures.append(str(reason))
        self.client.on_message = lambda _c, _d, m: self.heard.append(
            (time.monotonic(), m.topic.rpartition("/")[2], json.loads(m.payload))
        )
        self.kinds = kinds
        if login is not None:
            user, password, authority = login
            self.client.username_pw_set(user, password)
            self.client.tls_set_context(ssl.create_default_context(cafile=authority))
        self.client.connect_async(host, port)
        self.client.loop_start()
        wait_until(lambda: self.client.is_connected() or self.failures)

    def _connected(self, client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self.failures.append(str(reason))
        elif self.kinds:
            client.subscribe([(topic(self.unit, kind), 1) for kind in self.kinds])

    def say(self, message: Message) -> None:
        self.client.publish(topic(self.unit, message.kind), encode(message), qos=1).wait_for_publish(PATIENCE)

    def last(self, kind: str) -> float:
        """Arrival time of the last message of a kind; 0 if there is none."""
        return max((when for when, of, _ in self.heard if of == kind), default=0.0)

    def close(self) -> None:
        self.client.loop_stop()
        self.client.disconnect()


# --- killing --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "names", [("follow", "record"), pytest.param(ENDING, marks=pytest.mark.nightly)], ids=["two", "all"]
)
def test_killed_processes_are_restarted(names: tuple[str, ...], tmp_path: Path, fmu: Path, scenes: Path) -> None:
    with running(tmp_path / "out", fmu, scenes, "--seconds", "inf") as run:
        ear = Ear(run.config["broker"]["port"], "est", "forecast")
        wait_until(lambda: ear.last("forecast"))
        for name in names:
            # Wait for at least one stored state after the last kill.
            before = run.stored()
            wait_until(lambda before=before: run.stored() > before)
            (pid,) = run.pids(name)
            subprocess.run(["kill", "-9", str(pid)], check=True)
            killed = time.monotonic()
            work = "forecast" if name == "forecast" else "est"
            wait_until(
                lambda name=name, work=work, killed=killed: len(run.pids(name)) == 2 and ear.last(work) > killed + 0.05
            )
        before = run.stored()
        wait_until(lambda: run.stored() > before)
        run.stop()
        summary = run.finish()
    ear.close()
    assert summary["restarts"] == {name: int(name in names) for name in summary["restarts"]}
    run.replayed(fmu)
    # After each kill the estimates agree with the machine within their bands.
    story = figures.read(run.folder / "record")
    judged = figures.judge(story)
    known = np.isfinite(judged.error)
    assert known.mean() > 0.9 and judged.error[known].max() < 1e-3
    assert (judged.error[known] < story.estimated["band"][known]).mean() > 0.85
    # All processes have ended.
    for name in ENDING:
        for pid in run.pids(name):
            assert subprocess.run(["kill", "-0", str(pid)], capture_output=True, check=False).returncode != 0, (
                f"{name} {pid} lives"
            )


# --- mosquitto ------------------------------------------------------------------------------------------------------------------------


def mosquitto(folder: Path, file: Path) -> "subprocess.Popen[bytes]":
    """A broker with the given configuration."""
    log = (folder / "mosquitto.log").open("ab")
    return subprocess.Popen(["/usr/sbin/mosquitto", "-c", str(file)], cwd=folder, stdout=log, stderr=log)


@pytest.mark.parametrize("seconds", [1, pytest.param(5, marks=pytest.mark.nightly)])
def test_a_broker_that_is_gone_for_a_while(seconds: int, tmp_path: Path, fmu: Path, scenes: Path) -> None:
    port = free_port()
    file = tmp_path / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nuser root\n")
    broker = mosquitto(tmp_path, file)
    try:
        with running(tmp_path / "out", fmu, scenes, "--seconds", "inf", "--broker", f"127.0.0.1:{port}") as run:
            ear = Ear(port, "est")
            wait_until(lambda: len(ear.heard) > 200)
            broker.terminate()
            broker.wait()
            gone = time.monotonic()
            time.sleep(seconds)
            broker = mosquitto(tmp_path, file)
            wait_until(lambda: ear.last("est") > gone + seconds)
            back, before = time.monotonic() - gone, len(ear.heard)
            wait_until(lambda: len(ear.heard) > before + 300)
            run.stop()
            summary = run.finish()
            ear.close()
    finally:
        broker.kill()
    assert not any(summary["restarts"].values()), "nothing crashed"
    (lost,) = (gap for gap in summary["gaps"] if gap["of"] == "meas")
    missing = lost["last"] - lost["first"] + 1
    # Messages lost while the broker is away and until all clients have reconnected.
    assert 200 * seconds <= missing < 200 * (back + 1)
    assert summary["samples"]["estimated"] > 450
    assert summary["tip_error_mm"]["max"] < 1
    run.replayed(fmu)


def certificates(folder: Path) -> None:
    """Makes a certificate authority and a broker's certificate for this machine."""

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    (folder / "names").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
    new = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-noenc"]
    openssl("req", "-x509", *new, "-keyout", "ca.key", "-out", "ca.crt", "-subj", "/CN=test authority", "-days", "2")
    openssl("req", *new, "-keyout", "server.key", "-out", "server.csr", "-subj", "/CN=localhost")
    openssl(
        "x509",
        "-req",
        "-in",
        "server.csr",
        "-CA",
        "ca.crt",
        "-CAkey",
        "ca.key",
        "-CAcreateserial",
        "-out",
        "server.crt",
        "-extfile",
        "names",
        "-days",
        "2",
    )


@pytest.fixture
def secured(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """The example broker with users, roles and TLS on a free port; returns folder and port."""
    folder = tmp_path / "broker"
    shutil.copytree(EXAMPLES, folder)
    certificates(folder)
    passwords = folder / "passwords"
    passwords.touch()
    for user in ("pipeline", "machine", "operator", "viewer"):
        subprocess.run(
            ["mosquitto_passwd", "-b", str(passwords), user, f"{user}-secret"], check=True, capture_output=True
        )
    port = free_port()
    text = (folder / "mosquitto.conf").read_text()
    assert "listener 8883\n" in text
    file = folder / "mosquitto.conf"
    file.write_text(text.replace("listener 8883\n", f"listener {port} 127.0.0.1\n") + "user root\n")
    broker = mosquitto(folder, file)
    yield folder, port
    broker.kill()
    broker.wait()


def test_roles_and_tls(secured: tuple[Path, int], tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """The pipeline runs on the example; commands are accepted from operators only; other users cannot connect."""
    folder, port = secured
    authority = folder / "ca.crt"
    environment = os.environ | {"FIVEBAR_PASSWORD": "pipeline-secret"}
    broker = ["--broker", f"127.0.0.1:{port}", "--user", "pipeline", "--ca-file", str(authority)]
    with running(tmp_path / "out", fmu, scenes, "--seconds", "inf", *broker, environment=environment) as run:
        ears = {
            user: Ear(port, "est", "cmd", login=(user, f"{user}-secret", authority))
            for user in ("pipeline", "machine", "operator", "viewer")
        }
        wait_until(lambda: ears["viewer"].last("est"))
        now = time.time_ns()
        for i, user in enumerate(("viewer", "machine", "pipeline", "operator")):
            ears[user].say(Message("cmd", "bench", now + i, i, {}, {"command": "restart"}))
        wait_until(lambda: ears["viewer"].last("cmd"))
        ears["viewer"].say(Message("est", "bench", now, 1, {"theta[1]": 0.0}, {"inputs": []}))
        assert not Ear(port, login=("viewer", "wrong", authority)).client.is_connected()
        wait_until(lambda: len(ears["viewer"].heard) > 400)
        run.stop()
        summary = run.finish()
    assert [m["seq"] for _, kind, m in ears["viewer"].heard if kind == "cmd"] == [3], "the operator's"
    assert not [m for _, kind, m in ears["viewer"].heard if kind == "est" and m["seq"] == 1 and m["time"] == now]
    assert not ears["machine"].heard
    for ear in ears.values():
        ear.close()
    assert summary["samples"]["lost"] == 0 and summary["samples"]["estimated"] > 300 and summary["refused"] == 0
    log = (run.folder / "log" / "follow.log").read_text()
    assert log.count("restarting with the next sample: requested") >= 1
    run.replayed(fmu)
    # Without TLS no client connects, and no password is sent in the clear.
    plain = Ear(port)
    assert not plain.client.is_connected()
    plain.close()


# --- DTaaS ---------------------------------------------------------------------------------------------------------------------------


def test_the_lifecycle_of_dtaas(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    out = tmp_path / "out"
    venv = Path(sys.executable).parents[1]
    environment = os.environ | {"FIVEBAR_VENV": str(venv), "FIVEBAR_FMU": str(fmu), "FIVEBAR_OUT": str(out)}
    environment["FIVEBAR_SCENE"] = str(scenes / "pick_and_place.json")

    def stage(name: str, code: int = 0) -> str:
        run = subprocess.run(
            [REPOSITORY / "python" / "lifecycle" / name],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        assert run.returncode == code, run.stdout + run.stderr
        return run.stdout + run.stderr

    assert "created" in stage("create")
    try:
        assert "dashboard at" in stage("execute")
        assert "running already" in stage("execute", 1) and "terminate it first" in stage("clean", 1)
        time.sleep(1)
    finally:
        ended = stage("terminate")
    assert "ended" in ended
    assert json.loads((out / "summary.json").read_text())["samples"]["estimated"] > 0
    assert "not running" in stage("terminate")
    stage("clean")
    assert not out.exists()


# --- the dashboard --------------------------------------------------------------------------------------------------------------------


RESTART = "document.getElementById('restart').click()"


def order(browser: Any, script: str, answered: Callable[[], bool]) -> None:
    """Repeats a command until it is answered: a busy machine may pass it on too late; a page waits 3 s for an answer."""

    def given() -> bool:
        browser.execute_script(script)
        with suppress(AssertionError):
            wait_until(answered, 5)
            return True
        return False

    wait_until(given)


def drawn(browser: Any, canvas: Any) -> bool:
    """Whether a canvas shows anything."""
    return browser.execute_script(
        "const c = arguments[0]; return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v)",
        canvas,
    )


@pytest.mark.nightly
def test_the_dashboard_shows_what_is_learned(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """Ten parameters, each as text and as a band over the prior band, for the eye and for screen readers."""
    with running(tmp_path / "out", fmu, scenes, "--seconds", "inf", "--learn", "--exact") as run:
        with open_browser(run.page, tmp_path) as browser:
            wait_until(lambda: browser.find_element("id", "connection").text == "live")
            items = browser.find_elements("css selector", "#parameters li")
            assert len(items) == 10
            payload = next(item for item in items if "payload" in item.text)
            value, canvas = payload.find_element("tag name", "b"), payload.find_element("tag name", "canvas")
            assert "before: 50 ± 20 g" in payload.text

            def is_found() -> bool:
                """Whether text and band show the stand-in's payload, 60 g, to 2.5 g. Each value shown before, however wide its band, must agree
                with 60 g too. Text and band are read at once: they change every second."""
                text, said = browser.execute_script(
                    "return [arguments[0].textContent, arguments[1].getAttribute('aria-label')]", value, canvas
                )
                if "±" not in text:
                    return False
                found, half = map(float, text.removesuffix(" g").split(" ± "))
                assert said.startswith(f"Mass of the payload: {text}, a band "), said
                assert abs(found - 60) < 2 * half, text
                return 2 * half < 5 and float(said.split()[-9]) < 20

            wait_until(is_found)
            wait_until(lambda: drawn(browser, canvas))
            assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        run.stop()
        assert (
            run.finish()["learned"]["values"]["payload.mass"]
            == json.loads((run.out / "learned.json").read_text())["payload.mass"]
        )


def frozen(folder: Path, fmu: Path, scenes: Path) -> Path:
    """A recording of 60 s of the stand-in; its first encoder freezes after 3 s."""
    library = Library(fmu)
    source = machine(configured(folder, fmu, library, scenes / "pick_and_place.json", exact=False), library)
    samples = [source.next().fields for _ in range(12_000)]
    source.close()
    library.close()
    stuck = samples[600]["measured.theta[1]"]
    file = folder / "frozen.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["time", *samples[0]])
        for k, fields in enumerate(samples):
            table.writerow([k / 200, *(fields | ({"measured.theta[1]": stuck} if k > 600 else {})).values()])
    return file


@pytest.mark.nightly
def test_the_dashboard_names_an_encoder_that_has_frozen(tmp_path: Path, fmu: Path, scenes: Path) -> None:
    """The cause is shown beside the status, and the run's summary counts one alarm of the encoder."""
    with running(tmp_path / "out", fmu, scenes, "--seconds", "inf", "--csv", str(frozen(tmp_path, fmu, scenes))) as run:
        with open_browser(run.page, tmp_path) as browser:
            shown_text = "An encoder repeats its value while the machine moves · encoder 1 (100 %)"
            wait_until(lambda: browser.find_element("id", "status").text == shown_text)
        run.stop()
        assert run.finish()["causes"] == ["encoder 1"]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, fmu: Path, scenes: Path) -> Iterator[Run]:
    """A run for several tests."""
    with running(tmp_path_factory.mktemp("live"), fmu, scenes, "--seconds", "inf") as run:
        yield run
        run.stop()
        summary = run.finish()
    assert summary["samples"]["lost"] == 0


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser for several tests."""
    with open_browser("about:blank", tmp_path_factory.mktemp("browser")) as made:
        yield made


@pytest.fixture
def browser(driver: Any, live: Run) -> Iterator[Any]:
    """The browser with the page of the live run newly opened; at the end the console has no warnings, and the browser is as before."""
    driver.get(live.page)
    yield driver
    settle(driver)


def test_the_dashboard_shows_machine_twin_and_forecast(live: Run, browser: Any) -> None:
    """On a busy machine each text may for a while say how old the last message is: the test waits for the text of a live run."""
    from PIL import Image

    def shown(name: str) -> str:
        return browser.find_element("id", name).text

    def is_near() -> bool:
        """Whether the error of the tip is shown and small."""
        error = shown("value-error")
        return error.endswith("mm") and float(error.split()[0]) < 0.8

    wait_until(lambda: shown("connection") == "live")
    wait_until(lambda: "mm in 0.5 s" in shown("value-ahead"))
    first = float(shown("clock"))
    wait_until(lambda: float(shown("clock")) > first + 1)
    wait_until(is_near)
    wait_until(lambda: shown("status") == "Samples of both encoders are used")

    def is_drawn() -> bool:
        """Whether the picture has links, tip and the forecast's fan; on a busy machine a picture may be taken before they are drawn."""
        picture = Image.open(BytesIO(browser.find_element("id", "canvas").screenshot_as_png)).convert("RGB")
        shot = np.asarray(picture).astype(int)
        colours = {part: [int(COLOURS[part][i : i + 2], 16) for i in (1, 3, 5)] for part in ("left", "right", "tip")}
        seen = {part: (np.abs(shot - colour).sum(axis=2) < 30).sum() for part, colour in colours.items()}
        # The fan of the forecast has the tip's colour, thin over the page.
        red, green, blue = np.moveaxis(shot, 2, 0)
        fan = (green >= red) & (green > blue + 2) & (shot.min(axis=2) > 180)
        return bool(seen["left"] > 800 and seen["right"] > 800 and seen["tip"] > 60 and fan.sum() > 40)

    wait_until(is_drawn)
    # The machine moves: the picture changes.
    before = browser.find_element("id", "canvas").screenshot_as_png
    wait_until(lambda: browser.find_element("id", "canvas").screenshot_as_png != before)
    assert not browser.find_element("id", "learned").is_displayed(), "a panel of what is not learned"
    for chart in ("error", "torque", "nis"):
        wait_until(lambda chart=chart: drawn(browser, browser.find_element("id", chart)))
    log = live.folder / "log" / "follow.log"
    order(browser, RESTART, lambda: "requested" in log.read_text())


@pytest.mark.parametrize(("headers", "code"), [({"Host": "evil.example"}, 403), ({}, 200)])
def test_the_dashboard_is_for_this_machine_only(live: Run, headers: dict[str, str], code: int) -> None:
    try:
        with urllib.request.urlopen(urllib.request.Request(live.page, headers=headers), timeout=PATIENCE) as answer:
            found, policy = answer.status, answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
    except urllib.error.HTTPError as error:
        found = error.code
    assert found == code


def test_the_dashboard_withstands_malformed_messages(live: Run, browser: Any) -> None:
    """Each of these once froze the page while it showed "live". Python and the page refuse the same messages by the same schema."""
    port = live.config["broker"]["port"]
    ear = Ear(port)
    # A small screen: drawing takes most of the time, and this test judges no picture.
    small = {"width": 390, "height": 300, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", small)
    wait_until(lambda: browser.find_element("id", "connection").text == "live")
    path = {name: xs for name, xs in GOOD["forecast"]["path"].items() if name != "tip.y"}
    wrong = [
        ("forecast", {"path": path}),
        ("forecast", {"singular": 5}),
        ("alarm", {"figures": {"a": {"valueOf": 1, "toString": 1}}}),
        ("est", {"inputs": 5}),
    ]

    def reason() -> str:
        """Kind and reason of the last refused message."""
        return browser.find_element("id", "refused").text.partition("refused, the last: ")[2]

    for kind, changes in wrong:
        # A slow page receives only the newest message of a kind, and late: a skipped message is sent again. No two of these reasons are equal.
        def refused(kind: str = kind, changes: dict[str, Any] = changes, before: str = reason()) -> bool:
            ear.client.publish(topic("bench", kind), json.dumps(of_kind(kind, **changes)), qos=1).wait_for_publish(
                PATIENCE
            )
            time.sleep(0.3)
            now = reason()
            return now != before and now.startswith(f"{kind}: ")

        wait_until(refused)
    before = float(browser.find_element("id", "clock").text)
    wait_until(lambda: float(browser.find_element("id", "clock").text) > before + 0.3)
    wait_until(lambda: browser.find_element("id", "connection").text == "live")
    assert not browser.find_element("id", "undrawn").is_displayed()
    # A command from a clock that is ahead is answered in words.
    ahead = f"const now = Date.now; Date.now = () => now() + 90000; {RESTART}; Date.now = now;"
    order(browser, ahead, lambda: "ahead of the pipeline's own" in browser.find_element("id", "order").text)
    order(browser, RESTART, lambda: browser.find_element("id", "order").text.startswith("restarting"))
    corpus = [[kind, content] for kind in GOOD for content in (of_kind(kind), *wrong_ones(kind))]
    accepted = browser.execute_async_script(
        """const [corpus, done] = arguments;
        Promise.all([import("/json-schema/validator.js"), fetch("/messages.schema.json").then((r) => r.json())]).then(([{ Validator }, { definitions }]) => {
          const of = (kind) => new Validator({ definitions, allOf: [{ $ref: `#/definitions/${kind}` }] }, "7");
          done(corpus.map(([kind, content]) => of(kind).validate(content).valid));
        });""",
        corpus,
    )
    assert accepted == [content == of_kind(kind) for kind, content in corpus]
    ear.close()


@pytest.mark.parametrize("width", [390, pytest.param(1280, marks=pytest.mark.nightly)])
def test_nothing_is_green_while_the_twin_is_dead(width: int, live: Run, browser: Any) -> None:
    """Pill and status turn grey, on a telephone too. Old estimates that still arrive do not turn them green."""
    ear = Ear(live.config["broker"]["port"], "est")
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 400},
    )
    pill = browser.find_element("id", "connection")
    wait_until(lambda: pill.text == "live")
    pid = live.pids("follow")[-1]
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_until(lambda: pill.text.startswith("no estimate for"))
        wait_until(lambda: float(pill.text.split()[3]) >= 1.5)
        status = browser.find_element("id", "status")
        wait_until(lambda: status.text.startswith("The twin has said nothing for"))
        assert "bad" in pill.get_attribute("class") and status.get_attribute("class") == "bad"
        last, later, shown = ear.heard[-1][2], itertools.count(1), []

        def behind() -> bool:
            ear.client.publish(topic("bench", "est"), json.dumps(last | {"time": last["time"] + next(later)}))
            # All at once: after a second without estimates the page would report it.
            script = "return ['connection', 'status'].flatMap((id) => [document.getElementById(id).textContent, document.getElementById(id).className])"
            shown[:] = browser.execute_script(script)
            return shown[0].endswith("s behind")

        wait_until(behind)
        assert float(shown[0].split()[0]) >= 1.5 and "bad" in shown[1]
        assert shown[2].startswith("What you see is ") and shown[3] == "bad"
        assert browser.execute_script(
            "const r = arguments[0].getBoundingClientRect(); return r.top >= 0 && r.right <= innerWidth", pill
        )
        assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    finally:
        os.kill(pid, signal.SIGCONT)
    wait_until(lambda: pill.text == "live")
    ear.close()


@pytest.mark.nightly
def test_a_slow_page_is_not_late(live: Run, browser: Any) -> None:
    """On a processor a twentieth as fast, the page skips messages; drawing all of them, it was 7.3 s behind and fell further back."""
    listen = """
        const send = WebSocket.prototype.send;
        window.reports = [];
        WebSocket.prototype.send = function (data) {
          if (typeof data === "string") reports.push([performance.now(), Number(data.split(" ")[1])]);
          send.call(this, data);
        };"""

    delay = browser.find_element("id", "value-delay")
    wait_until(lambda: delay.text.endswith("ms"))
    usual = float(delay.text.split()[0])
    browser.execute_script(listen)
    browser.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 20})
    wait_until(lambda: browser.execute_script("return reports.length") > 12)
    script = "return [reports, performance.now(), parseFloat(document.getElementById('value-delay').textContent)]"
    reports, now, late = browser.execute_script(script)
    browser.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})
    times, drawn = np.array(reports).T
    longest = np.diff([*times, now]).max()
    handled, came = drawn[-1] - drawn[0], 0.4 * (times[-1] - times[0])
    print(
        f"a page on a processor a twentieth as fast: {late:.0f} ms from sample to page, {usual:.0f} ms before; pictures up to {longest:.0f} ms apart"
    )
    print(f"of {came:.0f} samples and estimates it got {handled:.0f}, at most {np.diff(drawn).max():.0f} for a picture")
    # No more messages wait for a picture, however long it takes; the rest of the 400 a second are skipped.
    assert np.diff(drawn).max() <= KEPT * len(SKIPPED) and handled < came
    # A message waits for one picture, and is shown with the next.
    assert late < usual + 2 * longest + 100


def test_a_page_of_another_site_does_not_reach_the_broker(live: Run) -> None:
    address = live.page.replace("http", "ws") + "mqtt"
    with pytest.raises(InvalidStatus, match="403"):
        connect(address, origin="http://evil.example", subprotocols=["mqtt"], open_timeout=PATIENCE)
    with connect(address, origin=live.page.rstrip("/"), subprotocols=["mqtt"], open_timeout=PATIENCE) as socket:
        assert socket.subprotocol == "mqtt"
