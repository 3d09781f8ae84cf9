"""`HeldRpdos`: what a device may hold for its next SYNC, as the sender of its RPDOs has to assume.

The data of a synchronous RPDO wait in the device for a SYNC (CiA 301 v4.2.0, 7.5.2.35), and then undo what was written by SDO
before it. Nothing on the bus tells whether they still wait. The sender knows when it sent them, and when a SYNC came. A SYNC that
it sent itself is behind all that it sent before. One that it hears may have been on its way for SYNC_TRANSIT.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.producer import PdoProducer

SYNC_TRANSIT: Final = 100 * MILLISECOND
"""Adapters hold frames back on both ways, by 16 ms and more, and so does a process that is busy."""


class HeldRpdos:
    """See this module's text. One for each device."""

    __slots__ = ("_by_hand", "_since")

    def __init__(self) -> None:
        self._by_hand: set[PdoProducer] = set()
        self._since: Time = -NEVER  # what was sent before has been taken

    def sent_by_hand(self, producer: PdoProducer) -> None:
        """Note an RPDO that was sent by hand: it is not among those that follow the SYNC."""
        self._by_hand.add(producer)

    def on_sync(self, now: Time, heard: bool) -> None:
        """A SYNC was sent, or heard."""
        self._since = max(self._since, now - SYNC_TRANSIT if heard else now)
        if self._by_hand:
            self._by_hand = {each for each in self._by_hand if self._may_be_held(each)}

    def on_boot(self, now: Time) -> None:
        """The device has booted: it holds nothing."""
        self._since = now
        self._by_hand.clear()

    def forget(self, number: int) -> None:
        """RPDO `number` is no longer exchanged, or becomes another."""
        self._by_hand = {each for each in self._by_hand if each.number != number}

    def carrying(self, mux: Mux, rpdos: Iterable[PdoProducer]) -> list[PdoProducer]:
        """Those that carry an object, of `rpdos` and of what was sent by hand."""
        return [each for each in (*rpdos, *self._by_hand) if self._may_be_held(each) and mux in each.mapping.muxes]

    def _may_be_held(self, producer: PdoProducer) -> bool:
        sent_at = producer.sent_at
        return producer.is_synchronous and sent_at is not None and sent_at >= self._since
