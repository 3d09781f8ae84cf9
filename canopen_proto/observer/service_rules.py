"""Look whether SYNC, TIME, EMCY and LSS keep to the standard, by listening only: their lengths, the counter of SYNC and its
producers, the inhibit time of emergencies.

CAN does not tell who has sent a SYNC. Two producers show by frames with a counter between frames without one, or by their own
objects: bit 30 of 0x1005 and a period in 0x1006, once the recording has shown both.

Source: CiA 301 v4.2.0, 7.2.5 to 7.2.7, 7.5.2.5, 7.5.2.6, 7.5.2.18, 7.5.2.22; CiA 305 for LSS.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_NO_RTR, MAX_NODE_ID
from canopen_proto.indices import (
    COB_ID_SYNC,
    COMMUNICATION_CYCLE_PERIOD,
    INHIBIT_TIME_EMERGENCY,
    SYNCHRONOUS_COUNTER_OVERFLOW_VALUE,
)
from canopen_proto.lss.messages import LssService
from canopen_proto.machine import NEVER, Time
from canopen_proto.observer.finding import BusFinding, Gaps, ms_text
from canopen_proto.observer.pdo_rules import BURST, EARLY
from canopen_proto.pdo.settings import INHIBIT_UNIT
from canopen_proto.sync import MAX_COUNTER

_PRODUCES_SYNC: Final = COB_ID_NO_RTR  # bit 30: of a SYNC it has this meaning
_LENGTHS: Final = {"TIME": 6, "EMCY": 8, "LSS": 8}
_IDENTIFIED: Final = bytes((LssService.IDENTIFIED,))
_WORDS: Final = {"TIME": "a time stamp", "EMCY": "an emergency", "LSS": "an LSS frame"}


_TURNS: Final = 4
"""Changes between SYNCs with a counter and without one that only two producers make: one that is configured makes fewer."""


class ServiceRules:
    """See this module's text."""

    def __init__(self, gaps: Gaps) -> None:
        self._gaps = gaps
        self._counter: int | None = None  # of the last SYNC
        self._lengths: list[int] = []  # of SYNCs, where they change; the last three
        self._producers: set[int] = set()  # nodes with bit 30 in 0x1005
        self._periods: set[int] = set()  # nodes with a period in 0x1006
        self._told = False  # that two nodes produce SYNC
        self._inhibit: dict[int, Time] = {}
        self._emergencies = [-NEVER] * (MAX_NODE_ID + 1)
        self._early = [0] * (MAX_NODE_ID + 1)  # emergencies in a row that came too soon
        self._lss = (b"", 0)  # the last LSS answer, and how many came to one request
        self._lss_rivals = 0

    def settle(self, node_id: int, index: int, value: int) -> list[BusFinding]:
        """Take note of a value that a node holds; returns what is wrong with it on this bus: nothing for an object
        without a rule."""
        if index == COB_ID_SYNC:
            _keep(self._producers, node_id, bool(value & _PRODUCES_SYNC))
        elif index == COMMUNICATION_CYCLE_PERIOD:
            _keep(self._periods, node_id, value != 0)
        elif index == INHIBIT_TIME_EMERGENCY:
            self._inhibit[node_id] = value * INHIBIT_UNIT
            return []
        elif index != SYNCHRONOUS_COUNTER_OVERFLOW_VALUE:
            return []
        self._lengths.clear()  # a producer has changed
        self._counter = None
        both = sorted(self._producers & self._periods)
        if len(both) < 2:
            self._told = False
            return []
        if self._told:
            return []
        self._told = True
        return [
            BusFinding(
                "two sync",
                node_id,
                f"nodes {', '.join(map(str, both))} produce SYNC: bit 30 of 0x1005, and 0x1006 > 0",
                is_certain=False,
            )
        ]

    def booted(self, node_id: int) -> None:
        """Take note of a boot-up: the node has its power-on values again, which are not known."""
        if node_id in self._producers:
            self._lengths.clear()
            self._counter = None
        self._producers.discard(node_id)
        self._periods.discard(node_id)
        self._inhibit.pop(node_id, None)
        self._emergencies[node_id] = -NEVER

    def lost(self) -> None:
        """Take note that frames were not heard: the next number of a SYNC's counter is not known."""
        self._counter = None

    def sync(self, data: bytes, now: Time, found: list[BusFinding]) -> None:
        """Take a SYNC. found: takes what is wrong with it."""
        size = len(data)
        if size > 1:
            found.append(BusFinding("length", 0, f"a SYNC of {counted(size, 'byte')}; it has one for the counter, or none"))
            return
        if not self._lengths or self._lengths[-1] != size:
            self._lengths.append(size)
            if len(self._lengths) > _TURNS:
                found.append(BusFinding("two sync", 0, "SYNCs with a counter and without one in turn: two nodes produce SYNC"))
                del self._lengths[:-1]
        if size:
            last, self._counter = self._counter, data[0]
            if not 1 <= data[0] <= MAX_COUNTER:
                found.append(
                    BusFinding("sync counter", 0, f"the counter of SYNC is {data[0]}; it runs from 1 to {MAX_COUNTER} at most")
                )
            elif last is not None and data[0] not in (1, last + 1):
                text = f"the counter of SYNC is {data[0]} behind {last}"
                if data[0] == last:
                    self._gaps.copied(0, f"{text}: it is there twice, or two nodes produce SYNC", now, found)
                else:
                    self._gaps.missing(0, text, now, found)

    def length(self, service: str, node_id: int, data: bytes) -> list[BusFinding]:
        """Return whether a frame of TIME, EMCY or LSS has a wrong length."""
        size, due = len(data), _LENGTHS[service]
        return (
            [] if size == due else [BusFinding("length", node_id, f"{_WORDS[service]} of {counted(size, 'byte')}; it has {due}")]
        )

    def lss(self, data: bytes, now: Time, found: list[BusFinding], *, by_master: bool) -> None:
        """Look whether one device answers an LSS request. Only an identification may have several answers (CiA 305)."""
        if by_master:
            self._lss = (b"", 0)
            return
        last, count = self._lss
        self._lss = (data, count + 1)
        if not count or data[:1] == _IDENTIFIED:
            return
        if data == last:
            self._gaps.copied(0, "the same LSS answer is there twice, or two devices give it", now, found)
            return
        text = "two answers to one LSS request: two devices are in LSS configuration state"
        is_same_service = data[:1] == last[:1]  # else its own request is missing
        self._lss_rivals += is_same_service
        if is_same_service and self._lss_rivals == EARLY:
            self._lss_rivals = 0
            found.append(BusFinding("double id", 0, text, is_certain=False))
        else:
            self._gaps.missing(0, f"{text}, or a request is missing", now, found)

    def emergency(self, node_id: int, now: Time) -> list[BusFinding]:
        """Return whether an emergency came sooner than the inhibit time of its node allows.

        A frame may wait for the bus, and the next one not: only less than half of the time is a fault.
        """
        last, self._emergencies[node_id] = self._emergencies[node_id], now
        inhibit = self._inhibit.get(node_id, 0)
        if (now - last) * 2 >= inhibit or now - last <= BURST:
            self._early[node_id] = 0
            return []
        self._early[node_id] += 1
        if self._early[node_id] != EARLY:
            return []
        text = f"an emergency {ms_text(now - last)} behind the last one; 0x1015 allows one in {ms_text(inhibit)}"
        return [BusFinding("inhibit time", node_id, text)]


def _keep(nodes: set[int], node_id: int, is_in: bool) -> None:
    if is_in:
        nodes.add(node_id)
    else:
        nodes.discard(node_id)
