"""The embedded broker: amqtt, on the loopback interface only. On a network, use another broker such as mosquitto, with users, roles and TLS."""

import asyncio
import logging
import sys
import time
from pathlib import Path
from typing import Any

from amqtt.broker import Broker

from fivebar.twin import priority, process
from fivebar.twin.config import Config, is_loopback
from fivebar.twin.errors import TwinError


def run(file: Path) -> int:
    """Serves until the process is asked to stop."""
    config = process.read_config(file)
    if not is_loopback(config.broker.host):
        raise TwinError(
            f"the embedded broker serves only this machine, not {config.broker.host}: for others use a broker with TLS"
        )
    process.set_up_log()
    priority.take("broker")
    logging.getLogger("amqtt").setLevel(logging.ERROR)
    logging.getLogger("amqtt.broker").addFilter(_is_trouble)
    if sys.platform != "win32":
        import uvloop

        return uvloop.run(_serve(config))
    return asyncio.run(_serve(config))


def _is_trouble(record: logging.LogRecord) -> bool:
    """False for messages to a client that has just disconnected: uvloop refuses its closed connection, and amqtt reports each as an error."""
    error = record.exc_info[1] if record.exc_info else None
    return not (isinstance(error, RuntimeError) and "handler is closed" in str(error))


async def _serve(config: Config) -> int:
    host, port = config.broker.host, config.broker.port
    settings: dict[str, Any] = {
        "listeners": {"default": {"type": "tcp", "bind": f"{f'[{host}]' if ':' in host else host}:{port}"}},
        "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
    }
    broker = Broker(settings)
    await broker.start()
    stop, disk = process.Stop(), process.Disk()
    status = process.Status(config, "broker", disk)
    process.spare_collector()
    begin = time.monotonic()
    while not stop.wait(0):
        if status.due(True):
            status.write(
                {"name": "broker", "ready": True, "seconds": time.monotonic() - begin, "memory_kb": process.memory_kb()}
            )
        await asyncio.sleep(process.TICK)
    await broker.shutdown()
    disk.close()
    return 0
