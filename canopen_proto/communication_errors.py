"""The present communication errors of a device, each with the EMCY that reports it.

A communication error lasts until its cause is gone. Two causes are two errors even if they share a code. The additional
information of an entry in 0x1003 tells them apart (`EmcyProducer`). The first vendor bytes of the frame say the same:

    0x8130   a heartbeat that the node monitors was lost        the lost node's ID
    0x8130   life guarding: the master stopped asking           0
    0x8210   an RPDO was too short and was not processed        the number of the RPDO, 1..512
    0x8220   an RPDO was too long (reported only if wanted)     the same
    0x8230   an MPDO was for an object that the node lacks      the same
    0x8250   an RPDO did not come within its event time         the same
    0x8240   a SYNC had another length than 0x1019 says         none (reported only if wanted)

`CommunicationErrors` only keeps this account. The node itself reacts to an error (0x1029).

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
"""The communication error bit of the error register (overrun, error state). CiA 301 v4.2.0, 7.5.2.2."""
EMCY_SYNC_LENGTH: Final = 0x8240
_OUR_MASTER: Final = 0
"""The node-ID in the EMCY of life guarding, which does not know the master's."""


class CommunicationErrors:
    """The present communication errors. lost_nodes: node-IDs of lost monitored nodes. rpdos: EMCY codes by the RPDO's number.
    sync_length: the last SYNC had a wrong length, and this was reported."""

    __slots__ = ("_emcy", "lost_nodes", "rpdos", "sync_length")

    def __init__(self, emcy: EmcyProducer) -> None:
        self._emcy = emcy
        self.lost_nodes: set[int] = set()
        self.rpdos: dict[int, set[int]] = {}
        self.sync_length = False

    def node_lost(self, node_id: int, now: Time) -> None:
        """Report that a monitored heartbeat is lost: EMCY 0x8130, whose first vendor byte is the node-ID."""
        self.lost_nodes.add(node_id)
        self._emcy.raise_error(EMCY_CONNECTION_LOST, COMMUNICATION_ERROR_BIT, bytes((node_id,)), now, node_id)

    def node_back(self, node_id: int, now: Time) -> None:
        """Clear the error of a lost node: its heartbeat is back, or no longer monitored."""
        self.lost_nodes.discard(node_id)
        self._emcy.clear(EMCY_CONNECTION_LOST, now, node_id)

    def life_guarding_lost(self, now: Time) -> None:
        """Report that the master stopped guarding the node: EMCY 0x8130."""
        self._emcy.raise_error(EMCY_CONNECTION_LOST, COMMUNICATION_ERROR_BIT, b"", now, _OUR_MASTER)

    def life_guarding_back(self, now: Time) -> None:
        """Clear the error of life guarding: the master guards the node again, or guarding is no longer used."""
        self._emcy.clear(EMCY_CONNECTION_LOST, now, _OUR_MASTER)

    def rpdo_failed(self, number: int, emcy_code: int, now: Time) -> None:
        """Report that an RPDO had a wrong length, or did not come: the first two vendor bytes of the EMCY are its number. number:
        1..512. emcy_code: 0x8210 and the like."""
        self.rpdos.setdefault(number, set()).add(emcy_code)
        self._emcy.raise_error(emcy_code, COMMUNICATION_ERROR_BIT, number.to_bytes(2, "little"), now, number)

    def rpdo_good(self, number: int, now: Time, *, but: int | None = None) -> None:
        """Clear the error of an RPDO: it came as it should, or got other settings. but: the code of an error that still lasts.
        number: 1..512."""
        codes = self.rpdos.pop(number, set())
        if but in codes:
            self.rpdos[number] = {but}
        for emcy_code in sorted(codes - {but}):
            self._emcy.clear(emcy_code, now, number)

    def sync_failed(self, now: Time) -> None:
        """Report that a SYNC had a wrong length."""
        self.sync_length = True
        self._emcy.raise_error(EMCY_SYNC_LENGTH, COMMUNICATION_ERROR_BIT, b"", now)

    def sync_good(self, now: Time) -> None:
        """Clear the error of SYNC: it had the right length again."""
        self.sync_length = False
        self._emcy.clear(EMCY_SYNC_LENGTH, now)

    def clear(self, now: Time) -> None:
        """Clear all errors: the communication starts again."""
        for node_id in sorted(self.lost_nodes):
            self.node_back(node_id, now)
        for number in sorted(self.rpdos):
            self.rpdo_good(number, now)
        self.life_guarding_back(now)
        self.sync_good(now)
