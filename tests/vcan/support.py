"""vcan interfaces for tests: the host's own, or those of the kernel that `tests/vcan/run` boots."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def has(name: str) -> bool:
    """Whether there is such an interface, and it is up. Also false where there are no network interfaces to be asked for."""
    try:
        return bool(int(Path(f"/sys/class/net/{name}/flags").read_text(), 16) & 1)
    except OSError:
        return False


needs_vcan = pytest.mark.skipif(
    not has("vcan0"),
    reason="this kernel has no vcan0 (tests/vcan/run pytest tests/vcan boots one that has)",
)


def tool(name: str) -> str:
    """The path of a program; the test is skipped where there is none."""
    path = shutil.which(name, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


def ip(*arguments: str) -> None:
    """Run `ip`; the test is skipped where this user may not."""
    done = subprocess.run([tool("ip"), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"ip {' '.join(arguments)}: {done.stderr.strip()}")


@contextmanager
def interface(name: str = "vcan7") -> Iterator[str]:
    """A fresh vcan interface that is up, of a test's own, so that no other test loses its bus."""
    ip("link", "add", "dev", name, "type", "vcan")
    try:
        ip("link", "set", name, "up")
        yield name
    finally:
        subprocess.run([tool("ip"), "link", "del", name], capture_output=True, check=False)


def raw_socket(name: str) -> socket.socket:
    """A socket that writes whatever it is told to: error frames, CAN FD."""
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.bind((name,))
    return sock
