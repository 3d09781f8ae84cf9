"""MQTT against Mosquitto, the broker that most have: certificates on both sides, retained values, and the last will after a kill.
Skipped where there is none (Debian's `mosquitto`)."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.gateway.mqtt_world import Subscriber, free_port, wait_for_port
from tests.gateway.test_fleet_access import certify
from tests.gateway.test_mqtt import wait

pytest.importorskip("paho.mqtt.client", reason="the extra mqtt is not installed")
MOSQUITTO = shutil.which("mosquitto", path=os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin")))
if MOSQUITTO is None:
    pytest.skip("no mosquitto here", allow_module_level=True)

ONLINE, VALUE = "canopen/v1/hall/online", "canopen/v1/hall/virtual-demo/3/values/statusword"


@contextmanager
def mosquitto(folder: Path, port: int, plain: int) -> Iterator[None]:
    """The broker, with a listener that asks for certificates, and one for those of this computer who only listen."""
    config = folder / "mosquitto.conf"
    config.write_text(
        f"persistence false\nallow_anonymous true\n"
        f"listener {plain} 127.0.0.1\n"
        f"listener {port} 127.0.0.1\ncafile {folder}/ca.pem\ncertfile {folder}/bridge.pem\nkeyfile {folder}/bridge.key\n"
        f"require_certificate true\n"
    )
    with subprocess.Popen([str(MOSQUITTO), "-c", str(config)], stderr=subprocess.DEVNULL) as process:
        try:
            wait_for_port(port, process)
            yield
        finally:
            process.terminate()


@contextmanager
def served(port: int, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    start = "import sys; from canopen_cli.entry import main; sys.exit(main())"
    command = [
        sys.executable,
        "-c",
        start,
        "serve",
        "mqtt",
        "--site",
        "hall",
        "-b",
        "demo",
        "--broker",
        f"mqtts://localhost:{port}",
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen([*command, *options], stderr=subprocess.PIPE, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def is_online(subscriber: Subscriber) -> bool | None:
    """What the broker last said of the program; None for nothing yet."""
    return (subscriber.last(ONLINE) or {}).get("online")


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_certificates_of_both_sides_retained_values_and_the_last_will(tmp_path: Path) -> None:
    certify(tmp_path)
    for file in tmp_path.iterdir():
        file.chmod(0o644)
    for folder in (tmp_path, *tmp_path.parents[:3]):  # started by root it becomes a user of its own, who has to read them
        folder.chmod(0o755)
    port, plain = free_port(), free_port()
    authority = ("--ca", str(tmp_path / "ca.pem"))
    ours = ("--cert", str(tmp_path / "viewer.pem"), "--key", str(tmp_path / "viewer.key"))
    with mosquitto(tmp_path, port, plain):
        with Subscriber(plain) as first, served(port, *authority, *ours, "--read", "statusword", "--every", "1s") as process:
            wait(lambda: is_online(first) is True)
            wait(lambda: first.last(VALUE) is not None)
            process.send_signal(signal.SIGKILL)
            wait(lambda: is_online(first) is False)
        with Subscriber(plain) as later:  # who comes later has the last of each at once
            wait(lambda: later.last(VALUE) is not None and later.last(ONLINE) is not None)
            assert (later.told[VALUE][0][1], later.told[ONLINE][0][1], is_online(later)) == (True, True, False)
            with served(port, *authority, "--seconds", "3") as stranger:  # shows no certificate
                stranger.wait(60)
            with served(port, *ours, "--seconds", "3") as unbelieving:  # does not know the authority of the broker
                unbelieving.wait(60)
            assert len(later.told[ONLINE]) == 1
            with served(port, *authority, *ours):
                wait(lambda: is_online(later) is True)
