"""What this project needs of the event loop that runs it: one interface, on trio and on asyncio.

`current_loop()` finds the loop, as httpx does: a running trio, else a running asyncio loop (uvloop is one). On trio each part is
trio's own object, so it costs nothing there. On asyncio it is built here of tasks, futures and timers.

    interface.py    `Loop`, and the parts that it gives
    current.py      `current_loop`; `RunVar`: a value for each run of a loop
    protection.py   `protected`: a Ctrl-C does not interrupt a function in its middle
    on_trio.py      trio
    on_asyncio.py   asyncio; asyncio_scopes.py: cancel scopes and nurseries there; asyncio_left.py: a loop that nobody ends;
                    asyncio_parts.py: the rest

**Cancelling** is that of trio, on both. A scope that is cancelled cancels each await inside it, again and again: a clean-up that
awaits stands in a scope with `shield=True`. What asyncio itself cancels (`Task.cancel`, `asyncio.timeout`, `TaskGroup`) arrives
once, as always there, and waits for the end of a shield.
"""

from canopen_transports.loop.current import NoLoopError, RunVar, current_loop
from canopen_transports.loop.interface import (
    TASK_STATUS_IGNORED,
    AsyncResource,
    BusyResourceError,
    CancelScope,
    ClosedResourceError,
    FairLock,
    Loop,
    LoopToken,
    Nursery,
    OneTimeEvent,
    ParkingLot,
    RunFinishedError,
    StreamSocket,
    TaskStatus,
)
from canopen_transports.loop.protection import protected

__all__ = [
    "TASK_STATUS_IGNORED",
    "AsyncResource",
    "BusyResourceError",
    "CancelScope",
    "ClosedResourceError",
    "FairLock",
    "Loop",
    "LoopToken",
    "NoLoopError",
    "Nursery",
    "OneTimeEvent",
    "ParkingLot",
    "RunFinishedError",
    "RunVar",
    "StreamSocket",
    "TaskStatus",
    "current_loop",
    "protected",
]
