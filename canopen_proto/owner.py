"""`Owner`: the part of a device that owns some of its communication objects."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.machine import Time


class Owner:
    """Owns communication objects of a `LocalNode`: brings them up to date, checks writes, and acts on them.

    By default an object is plain memory: every value with the right type and limits is accepted, and nothing follows.
    """

    __slots__ = ()

    @staticmethod
    def owns(index: int) -> bool:
        """Return whether this part owns an object; by default every object that no other part owns."""
        return True

    def refresh(self, index: int, subindex: int) -> AbortCode | None:
        """Bring the stored value up to date before it is read. Returns an abort code if there is nothing to read."""
        return None

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code with which the device refuses this value, or None. Changes nothing.

        value: its type and limits were checked before.
        """
        return None

    def apply(self, index: int, subindex: int, now: Time) -> None:
        """Act on the value that was just stored."""
