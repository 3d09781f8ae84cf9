"""TCP addresses of the doors: opened before anything moves, with an error that says what to do."""

from __future__ import annotations

import errno
import ipaddress
import socket
from typing import Final

import trio

from canopen_gateway.errors import DoorError

SEND_BUFFER: Final = 1 << 16
"""Bytes that the system keeps for a client that takes nothing."""
BACKLOG: Final = 64


async def open_listeners(host: str, port: int) -> list[trio.SocketListener]:
    """Listen at a TCP address of this computer. port: 0 for any free one. Raises DoorError."""
    try:
        listeners = await trio.open_tcp_listeners(port, host=host, backlog=BACKLOG)
    except (OSError, UnicodeError) as error:
        in_use = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        raise DoorError(
            f"cannot listen at {host} port {port}",
            seen=str(error),
            cause="another program listens there: another gateway?" if in_use else "it is no address of this computer",
            tries=(f"--port {port + 1 if port < 65535 else 0}",),
        ) from error
    for listener in listeners:
        listener.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    return listeners


def is_loopback(host: str) -> bool:
    """Return whether only this computer reaches an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def address_of(listener: trio.SocketListener) -> str:
    """Return where a listener listens, as people type it."""
    host, port = listener.socket.getsockname()[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
