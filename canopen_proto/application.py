"""`Application`: the work of a device apart from communication, as its `LocalNode` calls it.

A `LocalNode` is complete without an application: then its objects are plain memory. An application, such as the simulated drive,
shares them. It reads and writes the node's values. The node asks it before a client changes one of its objects, and calls it for
everything that it has to act on. Only the LocalNode calls these methods, never the host.
"""

from __future__ import annotations

from typing import Protocol

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.machine import Time


class Application(Protocol):
    """The work of a device apart from communication. It shares the node's values.

    It must also be a Machine, made with the node's `inner` outbox, so that time drives it: see `LocalNode.set_application`.
    """

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return None to accept a value, else an abort code. Changes nothing. Type and limits were checked before."""

    def written(self, index: int, subindex: int, now: Time) -> AbortCode | None:
        """Act on a value that was stored, by SDO or PDO (perhaps the same as before).

        Returns None, or an abort code if it cannot: then a client gets it, and the object has the value from before again. A PDO
        has no answer, and its value stays.
        """

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> AbortCode | None:
        """Update the values: they are about to be read. index, subindex: of the one that a client reads; None: those that a PDO
        may carry.

        Returns the abort code with which the read of that one is refused, or None.
        """

    def on_sync(self, now: Time) -> None:
        """Act on a SYNC; the synchronous RPDOs were taken before."""

    def connection_lost(self, now: Time, error_code: int) -> None:
        """Act on a lost connection: a heartbeat or the guarding of the node was lost, or CAN was off the bus (0x8130), or the
        node was taken out of Operational, or out of Pre-operational by a stop or a reset (0x8100), or an RPDO did not come
        within its event time (0x8250). error_code: to report, if this is a fault."""

    def reset(self, now: Time) -> None:
        """Start as at power-on: the values have their defaults again."""


class PlainMemory:
    """The application of a device without one: its objects hold the values written to them, and nothing follows."""

    __slots__ = ()

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        return None

    def written(self, index: int, subindex: int, now: Time) -> None: ...

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> None: ...

    def on_sync(self, now: Time) -> None: ...

    def connection_lost(self, now: Time, error_code: int) -> None: ...

    def reset(self, now: Time) -> None: ...
