"""`HeldRpdos`: the RPDOs that a device may hold for its next SYNC, as far as their sender can tell.

The data of a synchronous RPDO wait in the device for a SYNC (CiA 301 v4.2.0, 7.5.2.35). They then overwrite what SDO wrote in the
meantime. No frame tells whether they still wait. The sender knows when it sent them, and when a SYNC passed. A SYNC of its own
comes after all frames that it sent before. A SYNC that it receives may have been on its way for SYNC_TRANSIT.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.producer import PdoProducer

SYNC_TRANSIT: Final = 100 * MILLISECOND
"""Adapters delay frames both ways by 16 ms and more, and so does a busy process."""


class HeldRpdos:
    """The RPDOs that one device may hold; see this module's text."""

    __slots__ = ("_by_hand", "_since")

    def __init__(self) -> None:
        self._by_hand: set[PdoProducer] = set()
        self._since: Time = -NEVER  # the device no longer holds an RPDO that was sent before this time

    def sent_by_hand(self, producer: PdoProducer) -> None:
        """Note an RPDO that was sent once by hand. The `rpdos` of `carrying` do not have it."""
        self._by_hand.add(producer)

    def on_sync(self, now: Time, heard: bool) -> None:
        """Note a SYNC. heard: it was received, not sent."""
        self._since = max(self._since, now - SYNC_TRANSIT if heard else now)
        if self._by_hand:
            self._by_hand = {each for each in self._by_hand if self._may_be_held(each)}

    def on_boot(self, now: Time) -> None:
        """Note that the device has booted: it holds nothing."""
        self._since = now
        self._by_hand.clear()

    def forget(self, number: int) -> None:
        """Forget RPDO `number`: it is no longer exchanged, or gets other settings."""
        self._by_hand = {each for each in self._by_hand if each.number != number}

    def carrying(self, mux: Mux, rpdos: Iterable[PdoProducer]) -> list[PdoProducer]:
        """Return the RPDOs with an object that the device may hold. rpdos: those that are exchanged."""
        return [each for each in (*rpdos, *self._by_hand) if self._may_be_held(each) and mux in each.mapping.muxes]

    def _may_be_held(self, producer: PdoProducer) -> bool:
        sent_at = producer.sent_at
        return producer.is_synchronous and sent_at is not None and sent_at >= self._since
