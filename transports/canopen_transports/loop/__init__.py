"""What this project needs of the event loop that runs it: one interface, on trio and on asyncio.

`current_loop()` finds the loop, as httpx does: a running trio, else a running asyncio loop (uvloop is one). On trio each part is
trio's own object, so it costs nothing there; but for the parking lot, which is a slimmer one. On asyncio it is built here of
tasks, futures and timers.

    interface.py    `Loop`, and the parts that it gives
    current.py      `current_loop`; `RunVar`: a value for each run of a loop
    protection.py   `protected`: a Ctrl-C does not interrupt a function in its middle
    beside.py       `beside`: tasks that serve a block while it runs
    on_trio.py      trio
    on_asyncio.py   asyncio; asyncio_scopes.py: cancel scopes and nurseries there; asyncio_left.py: a loop that nobody ends;
                    asyncio_parts.py: the rest

**Cancelling** is that of trio, on both. A scope that is cancelled cancels each await inside it, again and again: a clean-up that
awaits stands in a scope with `shield=True`. What asyncio itself cancels (`Task.cancel`, `asyncio.timeout`, `TaskGroup`) arrives
once, as always there, and waits for the end of a shield.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_transports.loop.current import NoLoopError as NoLoopError
    from canopen_transports.loop.current import RunVar as RunVar
    from canopen_transports.loop.current import current_loop as current_loop
    from canopen_transports.loop.interface import TASK_STATUS_IGNORED as TASK_STATUS_IGNORED
    from canopen_transports.loop.interface import AsyncResource as AsyncResource
    from canopen_transports.loop.interface import BusyResourceError as BusyResourceError
    from canopen_transports.loop.interface import CancelScope as CancelScope
    from canopen_transports.loop.interface import ClosedResourceError as ClosedResourceError
    from canopen_transports.loop.interface import FairLock as FairLock
    from canopen_transports.loop.interface import Loop as Loop
    from canopen_transports.loop.interface import LoopToken as LoopToken
    from canopen_transports.loop.interface import Nursery as Nursery
    from canopen_transports.loop.interface import OneTimeEvent as OneTimeEvent
    from canopen_transports.loop.interface import ParkingLot as ParkingLot
    from canopen_transports.loop.interface import RunFinishedError as RunFinishedError
    from canopen_transports.loop.interface import StreamSocket as StreamSocket
    from canopen_transports.loop.interface import TaskStatus as TaskStatus
    from canopen_transports.loop.protection import protected as protected
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
