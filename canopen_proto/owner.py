"""`Owner`: the part of a device to which some of its communication objects belong."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.machine import Time


class Owner:
    """Owns communication objects of a `LocalNode`: brings them up to date, rules what may be written, and goes by it.

    By default an object is plain memory: every value that is right in type and limits is taken, and nothing follows.
    """

    __slots__ = ()

    @staticmethod
    def owns(index: int) -> bool:
        """Return whether an object belongs to this part; by default each one that no other part owns."""
        return True

    def refresh(self, index: int, subindex: int) -> AbortCode | None:
        """Bring the stored value up to date before it is read. Returns an abort code if there is nothing to read."""
        return None

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code with which the device refuses this value, or None. Changes nothing.

        value: right in type and limits already.
        """
        return None

    def apply(self, index: int, subindex: int, now: Time) -> None:
        """Go by the value that was just stored there."""
