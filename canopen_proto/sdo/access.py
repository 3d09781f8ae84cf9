"""The objects that an SDO server serves: `ObjectStore`, and PENDING, its answer if only the host can give one."""

from __future__ import annotations

from typing import Final, Protocol

from canopen_proto.abort import AbortCode
from canopen_proto.machine import Time


class Pending:
    """The type of PENDING: the host will answer, by `SdoServer.complete`."""

    __slots__ = ()


PENDING: Final = Pending()


class ObjectStore(Protocol):
    """The objects of a server. No method may raise; index is 0..0xFFFF, subindex 0..0xFF."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        """Return the bytes of an object, or why it cannot be read."""

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        """Return why an object cannot be written with so many bytes, or None if it can. Changes nothing.

        size: None if it is not known yet. PENDING: it can, and the host takes it in pieces as they come, because it may be large.
        (An expedited value is written at once.)
        """

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        """Write an object and return None, or return why it is refused. (`check_write` may not have been asked.) data: the bytes
        from the wire, little-endian."""
