"""The live page in a real browser: Debian's Chromium, headless, the page opened from disk and from a web server.

Needs the page: `cargo xtask test --page` makes it and runs this.
"""

import json
import math
import shlex
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from fmpy.model_description import ModelDescription

from browser import open_browser
from conftest import PATIENCE, REPOSITORY
from instance import Instance
from made_wheel import build

pytestmark = pytest.mark.page

PAGE = REPOSITORY / "target" / "page"
FILE = PAGE / "fivebar.html"


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    """A browser that has the page open from disk."""
    with open_browser(FILE.as_uri(), tmp_path) as driver:
        wait(driver, lambda: data(driver, "state") == "ready")
        yield driver


def wait(browser: Any, condition: Callable[[], bool]) -> None:
    """Waits for a condition, long enough for a busy machine."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, browser.execute_script("return JSON.stringify({...document.body.dataset})")
        time.sleep(0.05)


def data(browser: Any, name: str) -> str:
    """An attribute of <body> for scripts."""
    return browser.execute_script("return document.body.dataset[arguments[0]]", name)


def number(browser: Any, name: str) -> float:
    """An attribute of <body> as a number."""
    return float(data(browser, name))


def go(browser: Any, link: str) -> None:
    """Reloads the page with the state of a link."""
    browser.get("about:blank")
    browser.get(f"{FILE.as_uri()}#{link}")
    wait(browser, lambda: data(browser, "state") in ("ready", "refused"))


def click(browser: Any, name: str) -> None:
    """Clicks the element with the id `name`, wherever it is on the page."""
    browser.execute_script("document.getElementById(arguments[0]).click()", name)


def pause(browser: Any) -> None:
    """Stops time, wherever it is."""
    if data(browser, "playing") == "true":
        click(browser, "play")


def choose(browser: Any, name: str, value: str) -> None:
    """Chooses an item of a list."""
    script = (
        "const e = document.getElementById(arguments[0]); e.value = arguments[1]; e.dispatchEvent(new Event('change'))"
    )
    browser.execute_script(script, name, value)


def slide(browser: Any, variable: str, value: float) -> None:
    """Moves the slider of a variable."""
    script = """const e = document.querySelector(`input[data-name="${arguments[0]}"]`);
                e.value = arguments[1]; e.dispatchEvent(new Event('input'))"""
    browser.execute_script(script, variable, value)


def keys(browser: Any, *pressed: str) -> None:
    """Types on the page."""
    from selenium.webdriver.common.action_chains import ActionChains

    browser.execute_script("document.activeElement.blur()")
    ActionChains(browser).send_keys(*pressed).perform()


def problem(browser: Any) -> str:
    """The sentence of the error."""
    return browser.execute_script("const e = document.getElementById('problem'); return e.hidden ? '' : e.textContent")


def text(browser: Any, name: str) -> str:
    """Text of an element."""
    return browser.execute_script("return document.getElementById(arguments[0]).textContent", name)


def test_it_moves_from_disk_and_asks_for_nothing(browser: Any) -> None:
    """The page is one file of less than 2 MB, sends no request, and has data for every frame."""
    assert FILE.stat().st_size < 2_000_000
    wait(browser, lambda: number(browser, "time") > 0.2)
    assert data(browser, "scene") == "fall_90_120"
    assert browser.execute_script("return document.getElementById('canvas').dataset.drawn") == "machine"
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    assert problem(browser) == ""
    first = number(browser, "frames"), number(browser, "tipX")
    wait(browser, lambda: number(browser, "frames") > first[0] + 5)
    assert number(browser, "tipX") != first[1]


def test_a_frame_takes_less_than_its_sixtieth_of_a_second(browser: Any) -> None:
    """One core draws 60 frames a second, and the motion begins within a second.

    The CPU time of the page's thread counts, which other programs do not change.
    """

    def computed() -> float:
        metrics = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
        return next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration")

    browser.get("about:blank")
    browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    first, frames, spent = 0.0, 0, 0.0
    for scene in ("fall_90_120", "stiff_servo", "run_down_stick"):
        browser.get("about:blank")
        before = computed()
        browser.get(f"{FILE.as_uri()}#scene={scene}")
        wait(browser, lambda: data(browser, "time") is not None and number(browser, "time") > 0)
        first = max(first, computed() - before)
        wait(browser, lambda: number(browser, "time") > 1)
        begin = number(browser, "frames"), computed()
        wait(browser, lambda begin=begin: number(browser, "frames") > begin[0] + 60)
        frames, spent = frames + number(browser, "frames") - begin[0], spent + computed() - begin[1]
    print(f"a frame takes {1e3 * spent / frames:.1f} ms, the first motion {first:.2f} s of one core")
    assert spent / frames < 1 / 60
    assert first < 1


def test_it_shows_the_bits_of_the_unit(browser: Any, new: Callable[..., Instance]) -> None:
    """After some frames and single steps, tip and energy error equal the library for this machine."""
    wait(browser, lambda: number(browser, "time") > 0.1)
    pause(browser)
    keys(browser, "...", ":")
    time.sleep(0.2)
    reached = round(1000 * number(browser, "time"))
    unit = new().initialise({"init.theta[2]": 2.0943951023931953})
    for i in range(reached):
        unit.steps(1, 0.001, i * 0.001)
    assert (number(browser, "tipX"), number(browser, "tipY")) == unit.tip()
    assert number(browser, "energyError") == unit.get("energy.error")


def test_singularities_are_passed_and_energy_holds(browser: Any) -> None:
    go(browser, "speed=4&solver.method=automatic&solver.errorTolerance=1e-11")
    wait(browser, lambda: number(browser, "time") > 4)
    assert number(browser, "direct") >= 5
    assert number(browser, "inverse") >= 5
    assert abs(number(browser, "energyError")) < 1e-8
    assert "·10⁻" in text(browser, "error")


@pytest.mark.parametrize("kind", ["mouse", "touch"])
def test_the_tip_is_dragged(kind: str, browser: Any) -> None:
    """On a horizontal table at rest, the hand moves the tip and releases it; then the energy is constant."""
    from selenium.webdriver.common.actions.action_builder import ActionBuilder
    from selenium.webdriver.common.actions.pointer_input import PointerInput

    go(
        browser,
        "scene=flat_table&viscous.enabled=true&viscous.b[1]=0.01&viscous.b[5]=0.01&init.omega[1]=0&init.omega[2]=0"
        "&solver.method=automatic&solver.errorTolerance=1e-10",
    )
    start = number(browser, "tipX"), number(browser, "tipY")
    canvas = browser.find_element("id", "canvas")
    hand = ActionBuilder(browser, mouse=PointerInput(kind, "pointer"))
    hand.pointer_action.move_to(canvas, 60, 60).pointer_down().move_to(canvas, 30, 90).pause(0.8).pointer_up()
    hand.perform()
    assert math.dist((number(browser, "tipX"), number(browser, "tipY")), start) > 0.02
    assert browser.execute_script("return document.getElementById('hint').hidden")
    assert not browser.execute_script("return document.getElementById('canvas').classList.contains('held')")
    assert abs(number(browser, "energyError")) < 1e-6
    assert problem(browser) == ""


def test_arrow_keys_push_and_release(browser: Any) -> None:
    go(browser, "scene=flat_table&init.omega[1]=0&init.omega[2]=0")
    start = number(browser, "tipX")
    press = "document.body.dispatchEvent(new KeyboardEvent(arguments[0], { key: 'ArrowRight', bubbles: true }))"
    browser.execute_script(press, "keydown")
    wait(browser, lambda: number(browser, "tipX") > start + 0.01)
    browser.execute_script(press, "keyup")


def test_keys_and_buttons_rule_time(browser: Any) -> None:
    keys(browser, " ")
    assert data(browser, "playing") == "false"
    before = number(browser, "time")
    time.sleep(0.2)
    assert number(browser, "time") == before
    click(browser, "step")
    keys(browser, ".")
    wait(browser, lambda: number(browser, "time") == pytest.approx(before + 0.002, abs=1e-9))
    # A clicked button keeps the focus and takes only its own keys.
    browser.find_element("id", "step").send_keys("r")
    wait(browser, lambda: number(browser, "time") == 0)
    browser.find_element("id", "step").send_keys(" ")
    wait(browser, lambda: number(browser, "time") == 0.001)
    keys(browser, "r")
    wait(browser, lambda: number(browser, "time") == 0)
    started = time.monotonic()
    keys(browser, "s", " ")
    wait(browser, lambda: "speed=0.1" in browser.current_url)
    wait(browser, lambda: number(browser, "time") > 0.02)
    assert number(browser, "time") < 0.2 * (time.monotonic() - started)


def test_a_start_that_cannot_be_closed_is_refused_in_the_units_words(
    browser: Any, new: Callable[..., Instance]
) -> None:
    unit = new()
    unit.set({"base.distance": 2.0, "init.theta[2]": 2.0943951023931953})
    unit.enter()
    _, sentence = unit.refusal(unit.slave.exitInitializationMode)
    go(browser, "base.distance=2")
    assert data(browser, "state") == "refused"
    assert problem(browser) == sentence
    click(browser, "original")
    wait(browser, lambda: data(browser, "state") == "ready" and number(browser, "time") > 0)
    assert problem(browser) == ""
    slide(browser, "link[2].length", 0.05)
    slide(browser, "base.distance", 0.6)
    wait(browser, lambda: data(browser, "state") == "refused")
    assert "cannot be closed" in problem(browser)
    assert (data(browser, "time"), text(browser, "time"), text(browser, "error")) == (None, "–", "–")


def test_bounded_work_is_reported_and_can_be_left(browser: Any) -> None:
    """A step that takes more work than is allowed stops time with the unit's sentence."""
    go(browser, "solver.maxWork=20&solver.errorTolerance=1e-15")
    wait(browser, lambda: "solver.maxWork" in problem(browser))
    assert data(browser, "playing") == "false"


def test_what_a_link_cannot_hold_is_named(browser: Any) -> None:
    go(browser, "scene=fly&gravity.k=1&gravity.g=strong&speed=3&solver.method=constructor&chaos=toString")
    assert data(browser, "scene") == "fall_90_120"
    for part in ("'fly'", "'gravity.k'", "'strong'", "speed is 3", "'constructor'", "'toString'"):
        assert part in problem(browser)


def test_effects_are_switched_in_the_posture(browser: Any) -> None:
    """Switch and slider change the machine in its present posture; link and command contain the changes."""
    wait(browser, lambda: number(browser, "time") > 0.3)
    pause(browser)
    before = number(browser, "time"), number(browser, "tipX"), number(browser, "tipY")
    for effect in ("payload", "viscous", "servo", "friction", "spring", "stop", "contact", "rotor"):
        click(browser, f"effect-{effect}")
        assert problem(browser) == ""
    time.sleep(0.1)
    after = number(browser, "time"), number(browser, "tipX"), number(browser, "tipY")
    assert after == pytest.approx(before, abs=1e-9)
    slide(browser, "payload.mass", 0.123)
    slide(browser, "gravity.g", 3.71)
    wait(browser, lambda: "payload.mass=0.123" in browser.current_url)
    words = shlex.split(text(browser, "command"))
    assert words[:3] == ["fivebar", "run", "fall_90_120"]
    assert {"payload.enabled=true", "payload.mass=0.123", "gravity.g=3.71"} <= set(words)
    click(browser, "play")
    wait(browser, lambda: number(browser, "time") > before[0] + 0.1)
    assert problem(browser) == ""


def test_every_scene_runs(browser: Any, scenes: Path) -> None:
    for name in sorted(path.stem for path in scenes.glob("*.json")):
        choose(browser, "scene", name)
        wait(browser, lambda name=name: data(browser, "scene") == name and number(browser, "time") > 0.03)
        assert problem(browser) == "", name


def test_methods_are_exchanged_in_the_posture(browser: Any, model: ModelDescription) -> None:
    pause(browser)
    posture = number(browser, "tipX")
    for item in next(t for t in model.typeDefinitions if t.name == "Method").items:
        choose(browser, "method", item.name)
        assert problem(browser) == "", item.name
        assert number(browser, "tipX") == pytest.approx(posture, abs=1e-9)
    click(browser, "play")
    wait(browser, lambda: "µs per ms" in text(browser, "cost"))


def test_the_link_holds_the_state(browser: Any) -> None:
    go(browser, "scene=haptic_stick&speed=0.25&solver.method=dop853&contact.mu=0.7&init.theta[1]=2.2")
    assert data(browser, "scene") == "haptic_stick"
    assert browser.execute_script("return document.getElementById('method').value") == "dop853"
    wait(browser, lambda: "%5B1%5D" in browser.current_url)
    link = browser.execute_script("return location.hash.slice(1)")
    go(browser, link)
    time.sleep(0.4)
    assert browser.execute_script("return location.hash.slice(1)") == link
    assert (
        text(browser, "command")
        == 'fivebar run haptic_stick --set contact.mu=0.7 --set "init.theta[1]=2.2" --method dop853'
    )


def saved_scene(browser: Any) -> dict[str, Any]:
    """The scene that the button "Save scene" writes."""
    keep = """const [make, done] = [URL.createObjectURL, arguments[0]];
              URL.createObjectURL = (blob) => { blob.text().then(done); return make.call(URL, blob); };
              HTMLAnchorElement.prototype.click = () => {};
              document.getElementById("save").click();"""
    return json.loads(browser.execute_async_script(keep))


def motion(folder: Path, fmu: Path, *words: str) -> str:
    """The outputs of `fivebar run`, as CSV."""
    done = subprocess.run(
        [sys.executable, "-m", *words, "--fmu", fmu, "--out", folder],
        cwd=folder.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (outputs,) = (file for file in folder.glob("*.csv") if file.name != "singularities.csv")
    return outputs.read_text()


def test_command_and_saved_file_run_alike(browser: Any, tmp_path: Path, fmu: Path) -> None:
    """The command and the saved file give one motion; only the file has values that replace signals. Both name the method even if the
    scene does not, because the commands would choose another one than the page.
    """
    go(browser, "scene=swing")
    assert text(browser, "command") == "fivebar run swing --method i3alp"
    assert saved_scene(browser)["solver.method"] == "i3alp"
    go(browser, "scene=haptic&contact.mu=0.7&init.theta[1]=2.2&solver.method=automatic")
    (tmp_path / "haptic.json").write_text(json.dumps(saved_scene(browser)))
    given = motion(tmp_path / "command", fmu, *shlex.split(text(browser, "command")))
    assert given == motion(tmp_path / "file", fmu, "fivebar", "run", "haptic.json")
    go(browser, "scene=pick_and_place&servo.theta[1]=2.5&solver.method=automatic")
    assert text(browser, "command") == "fivebar run pick_and_place.json  # the saved scene"
    (tmp_path / "pick_and_place.json").write_text(json.dumps(saved_scene(browser)))
    motion(tmp_path / "replaced", fmu, *shlex.split(text(browser, "command"), comments=True))


def test_a_saved_scene_is_one_for_the_commands(browser: Any) -> None:
    """The file has the names, items and signals of scenes/."""
    go(browser, "scene=haptic&contact.law=stick&solver.method=automatic&payload.mass=0.1")
    saved = saved_scene(browser)
    assert saved["contact.law"] == "stick"
    assert saved["solver.method"] == "automatic"
    assert saved["payload.mass"] == 0.1
    assert saved["experiment"] == {"stopTime": 2, "stepSize": 0.001}
    shipped = json.loads((REPOSITORY / "scenes" / "haptic.json").read_text())
    assert saved["signals"] == shipped["signals"]
    assert set(shipped) <= set(saved)


def test_a_posture_becomes_the_start(browser: Any) -> None:
    wait(browser, lambda: number(browser, "time") > 0.3)
    pause(browser)
    time.sleep(0.1)
    posture = number(browser, "tipX"), number(browser, "tipY")
    click(browser, "here")
    wait(browser, lambda: number(browser, "time") == 0)
    assert (number(browser, "tipX"), number(browser, "tipY")) == pytest.approx(posture, abs=1e-9)
    wait(browser, lambda: "init.theta" in browser.current_url)


def test_two_machines_part(browser: Any) -> None:
    click(browser, "chaos")
    choose(browser, "scene", "fall_90_120")
    wait(browser, lambda: number(browser, "time") > 1)
    assert browser.execute_script("return !document.getElementById('apart').hidden")
    wait(browser, lambda: "chaos=true" in browser.current_url)
    go(browser, "scene=swing&chaos=true")
    assert browser.execute_script(
        "return !document.getElementById('apart').hidden && document.getElementById('chaos').checked"
    )
    assert problem(browser) == ""


def test_accuracy_fills_itself(browser: Any) -> None:
    pause(browser)
    wait(browser, lambda: text(browser, "measured").startswith("Largest error"))


def test_licences_are_there(browser: Any) -> None:
    click(browser, "show-licenses")
    wait(
        browser,
        lambda: (
            "Apache License" in browser.execute_script("return document.querySelector('#licenses pre').textContent")
        ),
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone(scheme: str, browser: Any) -> None:
    """At 390 px nothing is wider than the screen, buttons are large enough, the canvas has the screen's pixels and the scheme's background."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    )
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    )
    time.sleep(0.4)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    ratio, paper = browser.execute_script(
        """const c = document.getElementById("canvas");
           return [c.width / c.clientWidth, c.getContext("2d").getImageData(4, c.height / 2, 1, 1).data[0]]"""
    )
    assert ratio == pytest.approx(2, rel=0.01)
    assert (paper > 128) == (scheme == "light")
    browser.execute_script("window.scrollTo(0, 600)")
    top, bottom = browser.execute_script(
        "const r = document.getElementById('stage').getBoundingClientRect(); return [r.top, r.bottom]"
    )
    assert 0 <= top < bottom < 500, "the machine stays in sight while its switches are worked"
    small = """return [...document.querySelectorAll("#transport button")]
                 .filter((b) => b.getBoundingClientRect().height < 36).map((b) => b.textContent)"""
    assert browser.execute_script(small) == []


def test_reduced_motion_begins_paused(browser: Any) -> None:
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
    )
    go(browser, "scene=swing")
    time.sleep(0.2)
    assert (data(browser, "playing"), number(browser, "time")) == ("false", 0)
    click(browser, "play")
    wait(browser, lambda: number(browser, "time") > 0.05)


def test_every_control_has_a_name(browser: Any) -> None:
    """Names for screen readers."""
    nameless = """return [...document.querySelectorAll("button, select, input, canvas[role]")]
                    .filter((e) => !(e.ariaLabel || e.textContent.trim() || e.labels?.length)).map((e) => e.outerHTML)"""
    assert browser.execute_script(nameless) == []


def test_the_site_runs_from_a_web_server(browser: Any) -> None:
    """The page as a folder requests its own files from its own server, and nothing else."""
    asked: list[str] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_request(self, code: Any = "-", size: Any = "-") -> None:
            asked.append(f"{self.path} {int(code)}")

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(PAGE / "site"))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        here = f"http://127.0.0.1:{server.server_port}/"
        browser.get(here)
        wait(browser, lambda: data(browser, "state") == "ready" and number(browser, "time") > 0.05)
        resources = browser.execute_script("return performance.getEntriesByType('resource').map((entry) => entry.name)")
        browser.get("about:blank")
        server.shutdown()
    assert all(name.startswith(here) for name in resources), resources
    assert asked and all(line.endswith(" 200") for line in asked), asked


@pytest.mark.parametrize("what", ["loci", "hand"])
def test_in_node(what: str) -> None:
    """Loci are where the unit passes them; the hand soon brings the tip to the pointer and keeps it there."""
    subprocess.run(["node", REPOSITORY / "tests" / "page" / f"{what}.mjs", PAGE / "site"], check=True)


def test_a_wheel_carries_the_page(fmu: Path, tmp_path: Path) -> None:
    """A wheel made after the page contains it, and `fivebar page` opens it."""
    with zipfile.ZipFile(build(fmu, tmp_path)) as wheel:
        assert wheel.read("fivebar/shipped/fivebar.html") == FILE.read_bytes()
