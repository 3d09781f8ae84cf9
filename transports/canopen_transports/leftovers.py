"""What python-can leaves behind where something failed, and we clear away.

- A bus whose making failed complains on stderr when it is collected ("Exception ignored in BusABC.__del__", with a traceback),
  since it then tries to shut down what it never opened.
- A serial line stays open, if telling its adapter to close failed: an unplugged adapter cannot be told anything.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import can


def clear_away(error: BaseException) -> None:
    """Lay the buses to rest whose making ended in this error."""
    trace = error.__traceback__
    while trace is not None:
        bus = trace.tb_frame.f_locals.get("self")
        if isinstance(bus, can.BusABC) and trace.tb_frame.f_code.co_name == "__init__":
            bus._is_shutdown = True
            close_serial_line(bus)
        trace = trace.tb_next


def close_serial_line(bus: can.BusABC) -> None:
    """Close a serial line that its bus may have left open. Twice does no harm."""
    port: Any = getattr(bus, "serialPortOrig", None)
    if port is not None:
        with suppress(OSError):
            port.close()
