"""Which errors of communication a device has at the moment, each with the EMCY that tells of it.

Theory of operation
-------------------
An error of communication lasts until its cause is gone, and two causes are two errors even if they share a code. The additional
information of an entry in 0x1003 tells them apart (`EmcyProducer`). The first vendor bytes of the frame say the same:

    0x8130   a heartbeat that the node monitors was lost        the lost node's ID
    0x8130   life guarding: nobody asks the node any more       0
    0x8210   an RPDO was too short and was not processed        the number of the RPDO, 1..512
    0x8220   an RPDO was too long (where that is to be told)    the same
    0x8230   an MPDO was for an object that we lack             the same
    0x8250   an RPDO did not come within its event time         the same
    0x8240   a SYNC had another length than 0x1019 says (likewise)

`CommunicationErrors` is that bookkeeping, and nothing else: what the node does about an error (0x1029) is the node's business.

Source: CiA 301 v4.2.0, 7.2.7.1 (table 26) and 7.5.2.4.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.emcy import EmcyProducer
from canopen_proto.machine import Time

EMCY_COMMUNICATION: Final = 0x8100
EMCY_CONNECTION_LOST: Final = 0x8130
"""Life guard error or heartbeat error. CiA 301 v4.2.0, 7.2.7.1, table 26."""
COMMUNICATION_ERROR_BIT: Final = 0x10
"""Of the error register: communication error (overrun, error state). CiA 301 v4.2.0, 7.5.2.2."""
EMCY_SYNC_LENGTH: Final = 0x8240
_OUR_MASTER: Final = 0
"""Stands where a lost node's ID would: life guarding does not say who should have asked."""


class CommunicationErrors:
    """The errors of communication that stand now. lost_nodes: IDs of monitored nodes. rpdos: EMCY codes by the RPDO's number.
    sync_length: the last SYNC had a wrong length, and that was told."""

    __slots__ = ("_emcy", "lost_nodes", "rpdos", "sync_length")

    def __init__(self, emcy: EmcyProducer) -> None:
        self._emcy = emcy
        self.lost_nodes: set[int] = set()
        self.rpdos: dict[int, set[int]] = {}
        self.sync_length = False

    def node_lost(self, node_id: int, now: Time) -> None:
        """A monitored heartbeat is lost: EMCY 0x8130, whose first vendor byte is the node-ID."""
        self.lost_nodes.add(node_id)
        self._emcy.raise_error(EMCY_CONNECTION_LOST, COMMUNICATION_ERROR_BIT, bytes((node_id,)), now, node_id)

    def node_back(self, node_id: int, now: Time) -> None:
        """It is back, or monitored no more."""
        self.lost_nodes.discard(node_id)
        self._emcy.clear(EMCY_CONNECTION_LOST, now, node_id)

    def life_guarding_lost(self, now: Time) -> None:
        """Nobody asks us any more: EMCY 0x8130."""
        self._emcy.raise_error(EMCY_CONNECTION_LOST, COMMUNICATION_ERROR_BIT, b"", now, _OUR_MASTER)

    def life_guarding_back(self, now: Time) -> None:
        """We are asked again, or guarding is not used any more."""
        self._emcy.clear(EMCY_CONNECTION_LOST, now, _OUR_MASTER)

    def rpdo_failed(self, number: int, emcy_code: int, now: Time) -> None:
        """An RPDO was of a wrong length, or did not come: the first two vendor bytes of the EMCY are its number."""
        self.rpdos.setdefault(number, set()).add(emcy_code)
        self._emcy.raise_error(emcy_code, COMMUNICATION_ERROR_BIT, number.to_bytes(2, "little"), now, number)

    def rpdo_good(self, number: int, now: Time, *, but: int | None = None) -> None:
        """An RPDO came as it should, or is another one from now on. but: the code of an error that lasts all the same."""
        codes = self.rpdos.pop(number, set())
        if but in codes:
            self.rpdos[number] = {but}
        for emcy_code in sorted(codes - {but}):
            self._emcy.clear(emcy_code, now, number)

    def sync_failed(self, now: Time) -> None:
        """A SYNC had a wrong length."""
        self.sync_length = True
        self._emcy.raise_error(EMCY_SYNC_LENGTH, COMMUNICATION_ERROR_BIT, b"", now)

    def sync_good(self, now: Time) -> None:
        """A SYNC had the right length."""
        self.sync_length = False
        self._emcy.clear(EMCY_SYNC_LENGTH, now)

    def clear(self, now: Time) -> None:
        """All are gone: the communication begins anew."""
        for node_id in sorted(self.lost_nodes):
            self.node_back(node_id, now)
        for number in sorted(self.rpdos):
            self.rpdo_good(number, now)
        self.life_guarding_back(now)
        self.sync_good(now)
