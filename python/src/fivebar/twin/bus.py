"""The connection of a process to the broker: reconnects and subscribes again automatically, and passes each message on when it arrives."""

import logging
import os
import socket
import ssl
from collections.abc import Callable, Iterable
from typing import Any, Final

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from fivebar.twin.config import Broker
from fivebar.twin.messages import topic

RELIABLE: Final = ("alarm", "param", "cmd", "state", "whatif")
"""Kinds sent at least once (QoS 1). Samples and messages computed from them are sent at most once (QoS 0), because the next one is newer."""

log = logging.getLogger("fivebar")


class Bus:
    """Calls `handle(topic, payload)` for every message of the subscribed kinds, in its own thread."""

    def __init__(
        self, broker: Broker, unit: str, name: str, kinds: Iterable[str], handle: Callable[[str, bytes], None]
    ):
        self.broker, self.unit, self.handle = broker, unit, handle
        self.topics = {topic(unit, kind): int(kind in RELIABLE) for kind in kinds}
        """Subscribed topics, with their QoS."""
        self.connections = 0
        self.unsent = 0
        """Messages published without a connection."""
        self.client = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            client_id=f"{unit}-{name}-{os.getpid()}",
            clean_session=True,
            reconnect_on_failure=True,
        )
        self.client.reconnect_delay_set(0.2, 1)  # type: ignore[arg-type]  # fractions of a second work as well
        self.client.on_connect, self.client.on_disconnect = self._connected, self._disconnected
        self.client.on_message = self._message
        self.client.on_socket_open = self._opened
        if broker.user:
            self.client.username_pw_set(broker.user, broker.password)
        if broker.ca_file:
            context = ssl.create_default_context(cafile=None if broker.ca_file == "system" else broker.ca_file)
            self.client.tls_set_context(context)

    def start(self) -> None:
        """Connects in the background, as soon as the broker answers."""
        self.client.connect_async(self.broker.host, self.broker.port, keepalive=10)
        self.client.loop_start()

    def ready(self) -> bool:
        """Whether there is a connection."""
        return self.client.is_connected()

    def publish(self, kind: str, payload: bytes) -> bool:
        """Sends a message and returns whether there was a connection. Without one, reliable kinds wait for the next connection."""
        reliable = kind in RELIABLE
        sent = self.client.publish(topic(self.unit, kind), payload, qos=int(reliable)).rc == mqtt.MQTT_ERR_SUCCESS
        self.unsent += not sent
        return sent

    def hear_others(self, on: bool) -> None:
        """Starts or stops listening to the samples of all units."""
        every = topic("+", "meas")
        if on:
            self.topics[every] = 0
            self.client.subscribe(every)
        else:
            self.topics.pop(every, None)
            self.client.unsubscribe(every)

    def stop(self) -> None:
        """Sends waiting messages and disconnects."""
        self.client.disconnect()
        self.client.loop_stop()

    def _connected(self, client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            log.error("the broker refuses the connection: %s", reason)
            return
        self.connections += 1
        log.info(
            "connected to the broker at %s:%d%s",
            self.broker.host,
            self.broker.port,
            " again" if self.connections > 1 else "",
        )
        if self.topics:
            client.subscribe(list(self.topics.items()))

    def _disconnected(self, _client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            log.warning("no connection to the broker: %s; trying again", reason)

    def _message(self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        if message.retain:
            # The broker may have stored this message for days, and a stored command would be executed at every connection.
            log.warning("ignored: a retained message of %r", message.topic[:100])
            return
        try:
            self.handle(message.topic, bytes(message.payload))
        except Exception:
            # An unexpected error ends the process; the starter restarts it from the last stored state.
            log.exception("a message could not be handled")
            os._exit(70)

    def _opened(self, _client: mqtt.Client, _data: Any, opened: Any) -> None:
        # Each message is a sample and must not wait for the next one (Nagle's algorithm).
        if isinstance(opened, socket.socket):
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
