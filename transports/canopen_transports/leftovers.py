"""Clear away what python-can leaves behind after a failure.

- A bus that failed to open complains on stderr when it is collected ("Exception ignored in BusABC.__del__", with a traceback),
  because it tries to shut down what it never opened.
- A serial line stays open if its adapter could not be told to close, as with an unplugged adapter.
- slcan and socketcand keep data that they cannot decode, and fail on it each time.
- socketcand's bus continues to read from a connection that its server has closed, and finds nothing.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from canopen_transports.diagnosis import DRIVER_ERRORS

if TYPE_CHECKING:
    import can

_SOCKETCAND_BUFFER: Final = "_SocketCanDaemonBus__receive_buffer"


def clear_away(error: BaseException) -> None:
    """Quiet the buses whose constructor raised this error, and close their lines."""
    from can import BusABC

    trace = error.__traceback__
    while trace is not None:
        bus = trace.tb_frame.f_locals.get("self")
        if isinstance(bus, BusABC) and trace.tb_frame.f_code.co_name == "__init__":
            bus._is_shutdown = True
            _close_line(bus)
        trace = trace.tb_next


def shut_down(bus: can.BusABC) -> None:
    """Shut a bus down, and ignore its driver's errors."""
    with suppress(*DRIVER_ERRORS):  # an unplugged adapter cannot be told
        bus.shutdown()
    _close_line(bus)


def drop_garbage(bus: can.BusABC) -> None:
    """Make a bus drop data that it has read but cannot decode, and no more where that is known."""
    line, flush = getattr(bus, "_buffer", None), getattr(bus, "flush", None)
    if isinstance(line, bytearray):  # of slcan: the one line; its `flush` would drop the frames that wait behind it, too
        line.clear()
    elif flush is not None:
        flush()
    if hasattr(bus, _SOCKETCAND_BUFFER):
        setattr(bus, _SOCKETCAND_BUFFER, "")


def has_hung_up(bus: can.BusABC) -> bool:
    """Return whether socketcand's server has closed the connection. False for all other buses."""
    connection = _socketcand_connection(bus)
    if connection is None:
        return False
    try:
        return not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False


def _close_line(bus: can.BusABC) -> None:
    """Close a line that the bus may have left open. Closing it twice does no harm."""
    for line in (getattr(bus, "serialPortOrig", None), _socketcand_connection(bus)):
        if line is not None:
            with suppress(OSError):
                line.close()


def _socketcand_connection(bus: can.BusABC) -> Any:
    return getattr(bus, "_SocketCanDaemonBus__socket", None)
