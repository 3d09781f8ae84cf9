"""vcan interfaces for tests: the host's own, or those of the kernel that `tests/vcan/run` boots."""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from canopen_transports.locator import parse_locator

if TYPE_CHECKING:
    from canopen_transports.socketcan import SocketCanTransport


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


def run_tool(name: str, *arguments: str) -> None:
    """Run a program; the test is skipped where this user may not, or the kernel cannot, and fails with any other failure."""
    done = subprocess.run([tool(name), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        said = f"{name} {' '.join(arguments)}: {done.stderr.strip()}"
        if any(reason in said for reason in ("not permitted", "not supported", "Unknown device type", "qdisc kind is unknown")):
            pytest.skip(said)
        raise AssertionError(said)


def ip(*arguments: str) -> None:
    run_tool("ip", *arguments)


@contextmanager
def interface(name: str = "vcan7", *, kind: str = "vcan", index: int = 0, more: tuple[str, ...] = ()) -> Iterator[str]:
    """A fresh interface that is up, of a test's own, so that no other test loses its bus. index: 0 for what the kernel gives."""
    ip("link", "add", "dev", name, *(("index", str(index)) if index else ()), "type", kind, *more)
    try:
        ip("link", "set", name, "up")
        yield name
    finally:
        subprocess.run([tool("ip"), "link", "del", name], capture_output=True, check=False)


def slow(name: str, rate: str, room: int = 10) -> None:
    """Let the interface take frames at this rate only, with a queue for so few of them, as a real one has."""
    limits = ["burst", "100", "limit", str(room * 16)]  # bytes, where a frame has 16
    run_tool("tc", "qdisc", "replace", "dev", name, "root", "tbf", "rate", rate, *limits)


def joined(name: str, options: str = "") -> SocketCanTransport:
    from canopen_transports.socketcan import open_socketcan  # Linux's alone

    return open_socketcan(parse_locator(f"socketcan:{name}{options}"))


def error_frame(kinds: int, data: str = "") -> bytes:
    """An error frame as a driver makes it (linux/can/error.h)."""
    return struct.pack("=IB3x8s", 0x2000_0000 | kinds, 8, bytes.fromhex(data))


def raw_socket(name: str) -> socket.socket:
    """A socket that writes whatever it is told to: error frames, CAN FD."""
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.bind((name,))
    return sock
