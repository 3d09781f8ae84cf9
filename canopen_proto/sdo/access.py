"""What an SDO server serves: `ObjectStore`, and what it says where only the host can answer."""

from __future__ import annotations

from typing import Final, Protocol

from canopen_proto.abort import AbortCode
from canopen_proto.machine import Time


class Pending:
    """The type of PENDING: the host will answer, by `SdoServer.complete`."""

    __slots__ = ()


PENDING: Final = Pending()


class ObjectStore(Protocol):
    """What a server serves. None of these may raise; index is 0..0xFFFF, subindex 0..0xFF."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        """The bytes of an object, or why it cannot be read."""

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        """Why an object cannot be written with so many bytes (None: not known yet), or None if it can. Changes nothing.

        PENDING: it can, and the host takes it in pieces as they come, for it may be large. (What comes in one frame is written.)
        """

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        """Write an object, or say why it cannot be written (`check_write` may not have been asked) or the value is refused."""
