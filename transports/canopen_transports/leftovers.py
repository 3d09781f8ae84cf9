"""What python-can leaves behind where something failed, and we clear away.

- A bus whose making failed complains on stderr when it is collected ("Exception ignored in BusABC.__del__", with a traceback),
  since it then tries to shut down what it never opened.
- A serial line stays open, if telling its adapter to close failed: an unplugged adapter cannot be told anything.
- What slcan and socketcand have read and cannot decode they keep, and stumble over it each time.
- socketcand's bus goes on reading from a connection that its server has closed, and only ever finds nothing.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Any, Final

import can

from canopen_transports.diagnosis import DRIVER_ERRORS

_SOCKETCAND_BUFFER: Final = "_SocketCanDaemonBus__receive_buffer"


def clear_away(error: BaseException) -> None:
    """Lay the buses to rest whose making ended in this error."""
    trace = error.__traceback__
    while trace is not None:
        bus = trace.tb_frame.f_locals.get("self")
        if isinstance(bus, can.BusABC) and trace.tb_frame.f_code.co_name == "__init__":
            bus._is_shutdown = True
            _close_line(bus)
        trace = trace.tb_next


def shut_down(bus: can.BusABC) -> None:
    """Let go of a bus, whatever its driver says to that."""
    with suppress(*DRIVER_ERRORS):  # an unplugged adapter cannot be told that we leave it
        bus.shutdown()
    _close_line(bus)


def drop_garbage(bus: can.BusABC) -> None:
    """Let a bus forget what it has read and could not decode."""
    flush = getattr(bus, "flush", None)
    if flush is not None:
        flush()
    if hasattr(bus, _SOCKETCAND_BUFFER):
        setattr(bus, _SOCKETCAND_BUFFER, "")


def has_hung_up(bus: can.BusABC) -> bool:
    """Whether socketcand's server has closed the connection. False for all other buses."""
    connection = _socketcand_connection(bus)
    if connection is None:
        return False
    try:
        return not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False


def _close_line(bus: can.BusABC) -> None:
    """Close a line that its bus may have left open. Twice does no harm."""
    for line in (getattr(bus, "serialPortOrig", None), _socketcand_connection(bus)):
        if line is not None:
            with suppress(OSError):
                line.close()


def _socketcand_connection(bus: can.BusABC) -> Any:
    return getattr(bus, "_SocketCanDaemonBus__socket", None)
