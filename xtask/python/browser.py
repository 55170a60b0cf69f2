"""Debian's Chromium, headless, driven by selenium: a browser that stops answering ends its user within nine minutes."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --window-size=1280,900"
)

COMMAND_LIMIT = 120
"""Seconds after which a browser that does not answer a command hangs: on a busy machine one took more than 25 s to load a page. Reading
commands (GET) are sent four times, by urllib3."""

PROCESS_LIMIT = 60
"""Seconds after which a browser that starts or ends hangs, and is killed."""


@contextmanager
def open_browser(address: str, folder: Path, *flags: str) -> Iterator[Any]:
    """A browser that has the address open, with its profile in `folder`; at the end it must have had nothing to complain about. `flags` come
    after `FLAGS` and win.

    One that stops answering fails within nine minutes: four times the limit of a command and the limit of an end.
    """
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for flag in (*FLAGS.split(), *flags, f"--user-data-dir={folder / 'profile'}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = Service("/usr/bin/chromedriver", popen_kw={"process_group": 0})
    with killed_after(PROCESS_LIMIT, service):
        driver = webdriver.Chrome(options=options, service=service)
    driver.command_executor.client_config.timeout = COMMAND_LIMIT
    try:
        driver.get(address)
        yield driver
        problems = driver.get_log("browser")
    finally:
        # A driver that is killed closes the connection on which it is told to end.
        with killed_after(PROCESS_LIMIT, service), suppress(ConnectionError):
            driver.quit()
    assert problems == []


@contextmanager
def killed_after(seconds: float, service: Any) -> Iterator[None]:
    """Kills the driver and its browser, which are a process group, if the block takes longer."""
    timer = threading.Timer(seconds, lambda: os.killpg(service.process.pid, signal.SIGKILL))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
