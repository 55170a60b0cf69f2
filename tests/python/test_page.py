"""The pages of a run and of a map in a real browser: Debian's Chromium, headless, the page opened from disk."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser import open_browser
from conftest import settle, wait_until
from fivebar import simulate
from made_scene import made_scene, write

pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def page(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a shipped scene."""
    return simulate.run("fall_90_120", fmu=fmu).animate(tmp_path_factory.mktemp("page") / "fall_90_120.html")


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser for all tests: its start takes longer than most of them."""
    with open_browser("about:blank", tmp_path_factory.mktemp("browser")) as made:
        yield made


def opened(driver: Any, page: Path) -> Iterator[Any]:
    """The browser with a page newly opened; at the end the console has no warnings, and the browser is as before."""
    driver.get(page.as_uri())
    yield driver
    settle(driver)


@pytest.fixture
def browser(driver: Any, page: Path) -> Iterator[Any]:
    """A browser that has the page open."""
    yield from opened(driver, page)


def clock(browser: object) -> float:
    """The simulated time shown on the page."""
    return float(browser.find_element("id", "clock").text)


def click(browser: object, name: str) -> None:
    """Clicks the element with the id `name`."""
    browser.find_element("id", name).click()


def picture(browser: object) -> str:
    """The canvas as a data URL; "" if nothing is drawn on it."""
    return browser.execute_script(
        """const canvas = document.getElementById("canvas"), blank = document.createElement("canvas");
           [blank.width, blank.height] = [canvas.width, canvas.height];
           return canvas.toDataURL() === blank.toDataURL() ? "" : canvas.toDataURL();"""
    )


def test_opens_and_draws(browser: object) -> None:
    assert "fall_90_120" in browser.title
    assert clock(browser) == 0.0
    assert picture(browser)


def test_play_and_pause(browser: object) -> None:
    before = picture(browser)
    # Slow playback: 20 s remain to click before the end.
    browser.execute_script('document.getElementById("speed").value = "0.1"')
    click(browser, "play")
    wait_until(lambda: clock(browser) > 0.03)
    click(browser, "play")
    # A busy machine draws the stopped picture a little later.
    time.sleep(0.5)
    reached = clock(browser)
    assert 0 < reached < 2.0
    assert picture(browser) != before
    time.sleep(0.3)
    assert clock(browser) == reached


def test_it_stops_at_the_end_and_plays_again(browser: object) -> None:
    browser.execute_script('document.getElementById("speed").value = "4"')
    click(browser, "play")
    wait_until(lambda: browser.find_element("id", "play").get_attribute("aria-label") != "Pause")
    assert clock(browser) == pytest.approx(2.0)
    # Slow playback: 20 s of real time remain to see the run before its end again, also on a busy machine.
    browser.execute_script('document.getElementById("speed").value = "0.1"')
    click(browser, "play")
    wait_until(lambda: clock(browser) != 2.0)
    assert clock(browser) < 2.0


def test_scrub(browser: object) -> None:
    browser.execute_script(
        'const s = document.getElementById("scrub"); s.value = 1.25; s.dispatchEvent(new Event("input", { bubbles: true }))'
    )
    assert clock(browser) == pytest.approx(1.25, abs=1e-3)


def test_marks_jump(browser: object) -> None:
    marks = browser.find_elements("css selector", ".mark")
    kinds = {kind for kind in ("direct", "inverse") for mark in marks if kind in mark.get_attribute("class")}
    assert kinds == {"direct", "inverse"}
    mark = browser.find_element("css selector", ".mark.direct")
    met = float(mark.get_attribute("title").split(" ")[0])
    mark.click()
    assert clock(browser) == pytest.approx(met, abs=1e-3)
    assert "direct singularity" in browser.find_element("id", "event").text
    click(browser, "next")
    assert clock(browser) > met


def test_what_the_marks_rest_on(browser: object) -> None:
    assert "seen at communication points, every 1 ms" in browser.find_element("id", "sampling").text


def test_the_graver_kinds_have_a_lane(browser: object, fmu: Path, tmp_path: Path) -> None:
    """A start with all links in line is a constraint singularity, and the page names it so."""
    scene = write(tmp_path / "in_line.json", made_scene({"init.theta[1]": 0.0, "init.theta[2]": 0.0}, 0.3))
    browser.get(simulate.run(scene, fmu=fmu).animate(tmp_path / "in_line.html").as_uri())
    mark = browser.find_element("css selector", ".lane.grave .mark.constraint")
    browser.execute_script("arguments[0].click()", mark)
    assert clock(browser) == 0.0
    assert browser.find_element("id", "event").text.startswith("constraint singularity at the start")


def test_steps_and_keys(browser: object) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    click(browser, "forward")
    click(browser, "forward")
    click(browser, "back")
    assert clock(browser) == pytest.approx(1 / 60, abs=1e-3)
    browser.execute_script("document.activeElement.blur()")
    ActionChains(browser).send_keys(Keys.ARROW_RIGHT).perform()
    assert clock(browser) == pytest.approx(2 / 60, abs=1e-3)
    ActionChains(browser).send_keys(Keys.END).perform()
    assert clock(browser) == pytest.approx(2.0)
    browser.execute_script('document.getElementById("speed").value = "0.1"')
    ActionChains(browser).send_keys(Keys.HOME).send_keys(Keys.SPACE).perform()
    wait_until(lambda: 0 < clock(browser) < 2.0)
    ActionChains(browser).send_keys(Keys.SPACE).perform()
    assert 0 < clock(browser) < 2.0


def test_small_dark_screen(browser: object) -> None:
    """A phone in dark mode: nothing is wider than the screen, the canvas follows the screen's pixels."""
    light = picture(browser)
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    )
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    )
    time.sleep(0.3)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    assert browser.execute_script(
        'const c = document.getElementById("canvas"); return c.width / c.clientWidth'
    ) == pytest.approx(2, rel=0.01)
    assert picture(browser) not in ("", light)


def resized(browser: object, width: int, height: int) -> None:
    """Gives the page a window of the given size in pixels, however small."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    wait_until(
        lambda: (
            browser.execute_script("return [innerWidth, view.width > 0 && view.width < innerWidth]") == [width, True]
        )
    )


def fills_its_card(browser: object) -> bool:
    """Whether the canvas fills its card, and the card fits on the screen."""
    return browser.execute_script(
        """const card = document.querySelector(".stage").getBoundingClientRect(), canvas = document.getElementById("canvas");
           return canvas.clientHeight >= card.height - 2 && card.bottom <= innerHeight;"""
    )


def test_the_canvas_fills_its_card(browser: object) -> None:
    """Also beside a panel that is higher than the canvas needs to be: all energies, and the key of another run."""
    resized(browser, 1280, 800)
    assert fills_its_card(browser)
    browser.execute_script('document.querySelector(".panel").style.minHeight = "560px"')
    wait_until(lambda: browser.execute_script('return document.querySelector(".stage").clientHeight') >= 550)
    assert (
        browser.execute_script(
            'return document.querySelector(".stage").clientHeight - document.getElementById("canvas").clientHeight'
        )
        == 0
    )


def test_the_path_of_the_tip_stays(browser: object) -> None:
    """At the end of 2 s the strong trail of 1.5 s has left the first 0.4 s of the path; the path is still there."""
    share = browser.execute_script(
        """seek(main.time[main.time.length - 1]);
           const [, end] = locate(main, 0.4), ratio = devicePixelRatio;
           // Read once: the browser complains of many small reads.
           const { data: red, width } = pen.getImageData(0, 0, canvas.width, canvas.height), at = (x, y) => red[4 * (y * width + x)];
           let seen = 0;
           for (let i = 0; i < end; i++) {
             const x = Math.round(ratio * toX(main.path.tip[2 * i])), y = Math.round(ratio * toY(main.path.tip[2 * i + 1]));
             seen += [-1, 0, 1].some((k) => [-1, 0, 1].some((l) => at(x + k, y + l) < at(x - 12, y + 12) - 40));
           }
           return seen / end;"""
    )
    # A quarter also contains the machine or other parts of the path, which are as dark; without the path 0.16 is dark.
    assert share > 0.5


# The map's page


@pytest.fixture(scope="module")
def map_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a robot with stops and servos."""
    from fivebar import map_page, scene, workspace

    table = scene.read("pick_and_place").replace({"stop.enabled": True, "stop.upper[1]": 2.8})
    return map_page.write(
        workspace.compute(table, path=workspace.follow(table)), tmp_path_factory.mktemp("map") / "map.html"
    )


@pytest.fixture
def map_browser(driver: Any, map_page: Path) -> Iterator[Any]:
    """A browser that has the map open."""
    yield from opened(driver, map_page)


def test_the_machine_follows_the_pointer(map_browser: object) -> None:
    """In each mode the page shows the angles and condition number of the package, and says so if a place cannot be reached."""
    from fivebar.kinematics import WORKING_MODES, Machine

    machine = Machine.from_scene("pick_and_place")
    seen = set()
    for number, working in enumerate(WORKING_MODES):
        click(map_browser, f"modes-{number}")
        seen.add(picture(map_browser))
        map_browser.execute_script("go([0.05, 0.25])")
        shown = dict(
            zip(
                *(
                    map_browser.execute_script(
                        f'return [...document.querySelectorAll("#values {kind}")].map((e) => e.textContent)'
                    )
                    for kind in ("dt", "dd")
                )
            )
        )
        posture = machine.inverse((0.05, 0.25), working)
        assert [shown["θ₁, left motor"], shown["θ₂, right motor"]] == [
            f"{np.degrees(angle):.2f}°" for angle in posture.motors
        ]
        assert float(shown["condition number"]) == pytest.approx(float(machine.condition(posture.theta)), abs=5e-3)
        assert shown["assembly"] == posture.assembly and shown["force held in every direction"].endswith(" N")
    assert len(seen) == 4 and "" not in seen
    map_browser.execute_script("go([0.05, 0.5])")
    assert map_browser.find_element("id", "refusal").text == "82.5 mm too far for the left leg"
    map_browser.execute_script("mode = data.modes[0]; update(); go([-0.15, 0.05])")
    assert "beyond its stops" in map_browser.find_element("id", "refusal").text


def test_the_map_fits_a_screen_and_a_telephone(map_browser: object) -> None:
    resized(map_browser, 1280, 800)
    assert fills_its_card(map_browser)
    for width in (390, 1280):
        resized(map_browser, width, 800)
        end = map_browser.execute_script(
            """let end = 0;
               const write = CanvasRenderingContext2D.prototype.fillText;
               CanvasRenderingContext2D.prototype.fillText = function (text, x, y) { end = Math.max(end, x + this.measureText(text).width); };
               background = null;
               draw();
               CanvasRenderingContext2D.prototype.fillText = write;
               return end / view.width;"""
        )
        # A quarter for the bar, and its label.
        assert 0 < end < 0.6, f"the scale bar with its label takes {end:.0%} of the canvas at {width} px"


def test_the_pointer_the_keys_and_the_fields(map_browser: object) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    canvas = map_browser.find_element("id", "canvas")
    ActionChains(map_browser).move_to_element(canvas).perform()
    before = map_browser.execute_script("return tip")
    canvas.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_UP, Keys.ARROW_UP)
    after = map_browser.execute_script("return tip")
    assert [after[0] - before[0], after[1] - before[1]] == pytest.approx([1e-3, 2e-3], abs=1e-9)
    condition = picture(map_browser)
    click(map_browser, "fields-1")
    assert picture(map_browser) != condition and "(N)" in map_browser.find_element("id", "scaleName").text
