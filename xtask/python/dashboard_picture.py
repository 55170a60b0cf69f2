"""The picture of the dashboard in docs/pipeline.md: a run with --learn --exact in Chromium, 26 s after its start.

python dashboard_picture.py --fmu target/fmu/FiveBar.fmu --folder target/twin-picture --out docs/images/dashboard.svg
"""

import argparse
import base64
import io
import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from PIL import Image
from selenium.webdriver.support.wait import WebDriverWait

from browser import open_browser

AFTER = 26.0
"""Time of the machine in the picture, s; the charts show the last 20 s."""

WIDTH = 1224
"""Width of the page, pixels."""

MARGIN = 7
"""Height shown below the last panel, pixels."""

COLOURS = 256
"""Colours of the picture, which takes 0.4 of the bytes. Of the docs' pixels one in a thousand is off by more than 9 of 255, none by more than 33."""

TITLE = "The dashboard in Chromium during a run of fivebar twin --learn --exact"


def main(arguments: list[str] | None = None) -> int:
    """Runs the twin until the picture has been taken."""
    parser = argparse.ArgumentParser(description="The dashboard of a run that learns.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--folder", type=Path, required=True, help="the folder of the run, which is replaced")
    parser.add_argument("--out", type=Path, required=True, help="the SVG file to write")
    options = parser.parse_args(arguments)
    shutil.rmtree(options.folder, ignore_errors=True)
    given = [
        "twin",
        "--seconds",
        "600",
        "--learn",
        "--exact",
        "--fmu",
        str(options.fmu),
        "--out",
        str(options.folder / "twin"),
    ]
    twin = subprocess.Popen([sys.executable, "-m", "fivebar", *given], stdout=subprocess.PIPE, text=True)
    try:
        # The first line appears after all processes have started.
        twin.stdout.readline()
        [run] = (options.folder / "twin" / "runs").iterdir()
        port = json.loads((run / "twin.json").read_text(encoding="utf-8"))["dashboard_port"]
        shot = shown(f"http://127.0.0.1:{port}/", options.folder)
    finally:
        twin.send_signal(signal.SIGINT)
        twin.communicate()
    options.out.write_text(drawing(shot), encoding="utf-8", newline="\n")
    return 0


def shown(address: str, folder: Path) -> Image.Image:
    """The page from the top to the learned values, at the time `AFTER`; the browser's profile is in `folder`."""
    with open_browser(address, folder, "--hide-scrollbars", f"--window-size={WIDTH},1400") as driver:
        WebDriverWait(driver, 4 * AFTER).until(lambda d: float(d.find_element("id", "clock").text) > AFTER)
        shot = Image.open(io.BytesIO(driver.get_screenshot_as_png()))
        last = driver.find_element("id", "learned").rect
        return shot.crop((0, 0, WIDTH, round(last["y"] + last["height"]) + MARGIN))


def drawing(shot: Image.Image) -> str:
    """The picture inside an SVG of the same size, reduced to `COLOURS` colours."""
    file = io.BytesIO()
    few = shot.convert("RGB").quantize(COLOURS, kmeans=1, dither=Image.Dither.NONE)
    few.save(file, "png", optimize=True)
    data, size = base64.b64encode(file.getvalue()).decode("ascii"), f'width="{shot.width}" height="{shot.height}"'
    namespaces = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    image = f'<image {size} xlink:href="data:image/png;base64,{data}"/>'
    return f'<svg {namespaces} viewBox="0 0 {shot.width} {shot.height}"><title>{TITLE}</title>{image}</svg>\n'


if __name__ == "__main__":
    sys.exit(main())
