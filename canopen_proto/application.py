"""What a device does besides communicating, as its `LocalNode` sees it.

A `LocalNode` is complete without an application: then its objects are plain memory. An application, such as the simulated drive,
shares them: it reads and writes the node's values, is asked before a client changes one of its objects, and is told of whatever
it has to act on. The LocalNode calls these methods; the host never does.
"""

from __future__ import annotations

from typing import Protocol

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.machine import Time


class Application(Protocol):
    """What a device does besides communicating: it shares the node's values, and is told of what concerns it.

    It is a Machine too (made with the node's `inner` outbox), so that time drives it.
    """

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Whether it would take this value, right in type and limits already: None, or the abort code. Changes nothing."""

    def written(self, index: int, subindex: int, now: Time) -> None:
        """A value was stored, by SDO or PDO (perhaps the same as before)."""

    def refresh(self, now: Time) -> None:
        """Bring the values that it shows up to date: they are about to be read."""

    def on_sync(self, now: Time) -> None:
        """A SYNC came; synchronous RPDOs were taken."""

    def connection_lost(self, now: Time, error_code: int) -> None:
        """A heartbeat that the node monitors was lost, nobody guards it any more, CAN was off the bus (0x8130), or the node was
        taken out of Operational (0x8100). error_code: what to report where that is a fault."""

    def reset(self, now: Time) -> None:
        """Power-on: the values are back at their defaults."""


class PlainMemory:
    """The application of a device that has none: its objects hold what is written to them, and nothing follows."""

    __slots__ = ()

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        return None

    def written(self, index: int, subindex: int, now: Time) -> None: ...

    def refresh(self, now: Time) -> None: ...

    def on_sync(self, now: Time) -> None: ...

    def connection_lost(self, now: Time, error_code: int) -> None: ...

    def reset(self, now: Time) -> None: ...
