"""Debian's Chromium, headless, driven by selenium. If the browser stops answering, the caller fails within nine minutes."""

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
"""Seconds until an unanswered command counts as hung. On a busy machine loading a page took more than 25 s. urllib3 sends commands that
read (GET) four times."""

PROCESS_LIMIT = 60
"""Seconds until a browser that starts or ends counts as hung and is killed."""


@contextmanager
def open_browser(address: str, folder: Path, *flags: str) -> Iterator[Any]:
    """Opens the address in a browser with its profile in `folder`, and checks at the end that the console has no warnings. `flags` come
    after `FLAGS` and override them.

    A browser that stops answering fails within nine minutes: four times the limit of a command, plus the limit of the end.
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
        # A killed driver closes the connection through which it gets the command to quit.
        with killed_after(PROCESS_LIMIT, service), suppress(ConnectionError):
            driver.quit()
    assert problems == []


@contextmanager
def killed_after(seconds: float, service: Any) -> Iterator[None]:
    """Kills the driver and its browser, which share a process group, if the block takes too long."""
    timer = threading.Timer(seconds, lambda: os.killpg(service.process.pid, signal.SIGKILL))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
