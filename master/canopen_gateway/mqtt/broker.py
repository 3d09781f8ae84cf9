"""`BrokerLink`: the connection to a broker, in threads of its own: paho's, and one that hands messages over to it.

paho-mqtt is Eclipse's own client, without dependencies. It does what MQTT asks for (keep-alive, will, a new connection by
itself), and nothing of it runs in the loop of the master: a broker that is away, hangs or refuses costs the bus nothing.

The link only publishes. It never subscribes, so a broker has no way to tell it anything.
"""

from __future__ import annotations

import logging
import secrets
import ssl
import sys
import urllib.parse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_gateway.errors import DoorError
from canopen_master.errors import PackageMissingError
from canopen_transports.tcp.address import is_loopback

if TYPE_CHECKING:
    import paho.mqtt.client as paho

PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
KEEP_ALIVE: Final = 10
"""Seconds. A broker that says nothing for one and a half of them counts as hung; so do we, and it publishes our will."""
RETRY: Final = (1, 30)
"""Seconds from one try to the next: the first, and the longest."""
MOST_UNDER_WAY: Final = 256
"""Messages that paho may hold for a broker that takes nothing; further ones are not handed over."""
LOGGER: Final = logging.getLogger("canopen_gateway")


class BrokerAddress(NamedTuple):
    """Where a broker is. is_secure: by TLS."""

    host: str
    port: int
    is_secure: bool

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"mqtt{'s' if self.is_secure else ''}://{host}:{self.port}"


class BrokerLogin(NamedTuple):
    """What a broker may ask for. user, password: "" for none. authority: a file (PEM) of whom to believe; None: the system's.
    certificate, key: files (PEM) by which we prove ourselves."""

    user: str = ""
    password: str = ""
    authority: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __repr__(self) -> str:
        return f"BrokerLogin(user={self.user!r}, password={'...' if self.password else ''!r})"


def parse_broker(text: str) -> BrokerAddress:
    """Return what "mqtts://broker.lan:8883" means; the port may be left out. Raises ValueError, also for a password in it:
    whoever lists the processes of a computer would see it."""
    parts = urllib.parse.urlsplit(text)
    if parts.password is not None or parts.username is not None:
        raise ValueError("a broker's address has no user and no password: others see it in the list of processes")
    try:
        port = parts.port
    except ValueError:
        port = -1
    if parts.scheme not in PORTS or not parts.hostname or port == -1 or parts.path not in ("", "/") or parts.query:
        raise ValueError(f"{text!r} is no broker: it is mqtt://HOST, or mqtts://HOST for TLS, with :PORT where it is another one")
    return BrokerAddress(parts.hostname, PORTS[parts.scheme] if port is None else port, parts.scheme == "mqtts")


class BrokerLink:
    """See this module's text. is_connected: now. connections: how many there were. problem: why there is none."""

    def __init__(self, address: BrokerAddress, login: BrokerLogin, name: str, will: tuple[str, bytes]) -> None:
        """name: for the broker's lists. will: topic and payload, which the broker publishes, retained, when it has lost us.
        Raises DoorError for files that cannot be used, PackageMissingError without the extra `mqtt`."""
        try:
            import paho.mqtt.client as paho
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as missing:
            raise PackageMissingError("paho-mqtt", "mqtt", "telemetry to a broker", missing) from missing
        self.address = address
        self.is_connected = False
        self.connections = 0
        self.problem = ""
        self._handed_over = 0
        self._done = 0
        self._client = paho.Client(CallbackAPIVersion.VERSION2, client_id=f"{name}-{secrets.token_hex(4)}")
        self._client.will_set(*will, qos=1, retain=True)
        if login.user:
            self._client.username_pw_set(login.user, login.password or None)
        if address.is_secure:
            self._client.tls_set_context(_tls(login))
        self._client.reconnect_delay_set(*RETRY)
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_publish = self._on_publish

    def start(self) -> None:
        """Begin to connect, and go on until `close`. Does not wait for it."""
        self._client.connect_async(self.address.host, self.address.port, keepalive=KEEP_ALIVE)
        self._client.loop_start()

    def send(self, messages: Iterable[tuple[str, bytes]]) -> int:
        """Hand over messages, retained; in a thread. Returns how many were taken: fewer if the broker is away, or does not take
        what it was given before."""
        count = 0
        for topic, payload in messages:
            if not self.is_connected or self._handed_over - self._done >= MOST_UNDER_WAY:
                break
            if self._client.publish(topic, payload, qos=0, retain=True).rc != 0:
                break
            self._handed_over += 1
            count += 1
        return count

    def close(self, last: tuple[str, bytes]) -> None:
        """Say a last word, and leave; in a thread, which may have to wait for paho's."""
        if self.is_connected:
            self._client.publish(*last, qos=1, retain=True).wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()

    # ---- in paho's thread ----

    def _on_connect(self, _client: paho.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self.problem = f"the broker refused: {reason}"
            LOGGER.warning("%s: %s", self.address, self.problem)
            return
        self._done = self._handed_over  # what was under way is gone
        self.problem = ""
        self.connections += 1
        self.is_connected = True

    def _on_connect_fail(self, _client: paho.Client, _data: Any) -> None:
        error = sys.exception()
        self.problem = str(error) if error is not None else "it does not answer"

    def _on_disconnect(self, _client: paho.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if self.is_connected:
            self.problem = f"the connection ended: {reason}"
        self.is_connected = False

    def _on_publish(self, _client: paho.Client, _data: Any, _number: int, _reason: Any, _properties: Any) -> None:
        self._done += 1


def check_secret(address: BrokerAddress, login: BrokerLogin, *, clear_text: bool) -> None:
    """Raise DoorError if a password would cross a network as it is. clear_text: that is meant."""
    if login.password and not address.is_secure and not clear_text and not is_loopback(address.host):
        raise DoorError(
            f"the password would go to {address} unencrypted",
            seen="mqtt:// is without TLS",
            tries=(f"mqtts://{address.host}", "--clear-text, if that is meant"),
        )
    if not address.is_secure and (login.authority or login.certificate):
        raise DoorError(f"{address} is without TLS, so certificates are of no use", tries=(f"mqtts://{address.host}",))


def _tls(login: BrokerLogin) -> ssl.SSLContext:
    """Return what is asked of a broker's certificate, and ours."""
    try:
        context = ssl.create_default_context(cafile=None if login.authority is None else str(login.authority))
        if login.certificate is not None:
            context.load_cert_chain(str(login.certificate), None if login.key is None else str(login.key))
    except OSError as error:  # ssl.SSLError is one
        files = ", ".join(str(each) for each in (login.authority, login.certificate, login.key) if each is not None)
        raise DoorError(f"the certificates cannot be used: {files}", seen=str(error), tries=("files in PEM",)) from error
    return context
