"""Brokers for tests: a real one (amqtt) in a process of its own, and one of sockets that hears packets, or hangs."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

CONNECT, PUBLISH, PINGREQ, DISCONNECT = 1, 3, 12, 14
"""Types of packets; MQTT 3.1.1, 2.2.1."""


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def wait_for_port(port: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until somebody listens."""
    while process.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise AssertionError("the broker did not start")


@contextmanager
def broker(folder: Path, port: int, **listener: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A real broker while the block runs. listener: more settings of its listener, and `auth` for plugins of its own."""
    auth = listener.pop("auth", {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}})
    config = {"listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}", **listener}}, "plugins": auth}
    file = folder / f"broker-{port}.yaml"
    file.write_text(json.dumps(config))  # which is YAML, too
    start = "import sys; from amqtt.scripts.broker_script import main; sys.argv = ['amqtt', *sys.argv[1:]]; main()"
    with subprocess.Popen([sys.executable, "-W", "ignore", "-c", start, "-c", str(file)], stderr=subprocess.DEVNULL) as process:
        try:
            wait_for_port(port, process)
            yield process
        finally:
            process.kill()


class Subscriber:
    """Somebody who has subscribed to all topics. told: by topic, what was told, oldest first, with whether it was retained."""

    def __init__(self, port: int) -> None:
        import paho.mqtt.client as paho
        from paho.mqtt.enums import CallbackAPIVersion

        self.told: dict[str, list[tuple[Any, bool]]] = {}
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe("canopen/v1/#", 0)
        self._client.on_message = self._take
        self._client.connect_async("127.0.0.1", port)
        self._client.loop_start()

    def _take(self, _client: Any, _data: Any, message: Any) -> None:
        self.told.setdefault(message.topic, []).append((json.loads(message.payload), message.retain))

    def last(self, topic: str) -> Any:
        """The last that a topic said; None for nothing."""
        return self.told[topic][-1][0] if topic in self.told else None

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *exc: object) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class BareBroker:
    """A broker of sockets, which greets each client, and then hears its packets; or hangs, and reads nothing more. packets: the
    type of each packet. connections: how many there were."""

    def __init__(self, *, hangs: bool = False) -> None:
        self.packets: list[int] = []
        self.connections = 0
        self._hangs = hangs
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._open: list[socket.socket] = []
        self._hearing: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            self.connections += 1
            self._open.append(client)
            hearing = threading.Thread(target=self._hear, args=(client,), daemon=True)
            self._hearing.append(hearing)
            hearing.start()

    def _hear(self, client: socket.socket) -> None:
        with suppress(OSError, ValueError), client.makefile("rb") as stream:  # it was cut
            while head := stream.read(1):
                length, shift = 0, 0
                while True:
                    (byte,) = stream.read(1)  # ValueError at its end
                    length |= (byte & 0x7F) << shift
                    shift += 7
                    if not byte & 0x80:
                        break
                stream.read(length)
                self.packets.append(head[0] >> 4)
                if self.packets[-1] == CONNECT:
                    client.sendall(b"\x20\x02\x00\x00")
                    if self._hangs:
                        return
                elif self.packets[-1] == PINGREQ:
                    client.sendall(b"\xd0\x00")

    def drop_all(self) -> None:
        """Cut all connections."""
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._open.clear()

    def __enter__(self) -> BareBroker:
        return self

    def __exit__(self, *exc: object) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread
        self._listener.close()
        self.drop_all()
        self._thread.join(5)
        for each in self._hearing:
            each.join(5)
