"""Answers of a simulated drive that are wrong, late or refused, for tests of a master.

An `Answer` stands for one object, in `DriveSettings.answers` or by `DriveNode.answer`. It concerns the SDO server only: PDOs
carry the true values.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

from canopen_proto.abort import AbortCode
from canopen_proto.machine import NEVER, Event, Machine, Outbox, Time
from canopen_proto.sdo.events import ObjectAccessPending


class Answer(NamedTuple):
    """The answer to each access to an object.

    abort: refuse it with this code; nothing is written then. value: give this in place of the true value to a reader; bytes go as
    they are, of whatever length. delay: ns; a write is executed that late, too. A server gives up after its own time.
    """

    abort: AbortCode | None = None
    value: int | bytes | None = None
    delay: Time = 0


class AnswerDue(Event):
    """The time of a delayed answer has come. access: the one that waits for it."""

    __slots__ = ("access",)

    def __init__(self, access: ObjectAccessPending) -> None:
        self.node_id = access.node_id
        self.access = access


class DelayedAnswers(Machine):
    """The accesses that wait for their answer."""

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self._count = 0
        self._waiting: list[tuple[Time, int, ObjectAccessPending]] = []

    def add(self, access: ObjectAccessPending, due: Time) -> None:
        """Report AnswerDue at `due`."""
        self._count += 1
        heappush(self._waiting, (due, self._count, access))
        self._arm(self._waiting[0][0])

    def handle_timeout(self, now: Time) -> None:
        while self._waiting and self._waiting[0][0] <= now:
            self.out.events.append(AnswerDue(heappop(self._waiting)[2]))
        self._arm(self._waiting[0][0] if self._waiting else NEVER)
