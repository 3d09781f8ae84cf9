"""TCP addresses of the doors: opened before anything moves, with an error that says what to do."""

from __future__ import annotations

import errno
import socket
from typing import Final

import trio

from canopen_gateway.errors import DoorError
from canopen_transports.tcp.address import address_text

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


def address_of(listener: trio.SocketListener) -> str:
    """Return where a listener listens, as people type it."""
    return address_text(*listener.socket.getsockname()[:2])
