"""`TrafficFeed`: the frames of a bus in words, for one who looks at them: chosen, bounded, never in anybody's way.

A bus brings thousands of frames a second, and a person reads some. So a feed keeps those that fit its wish until they are taken,
`most` at most; further ones are left out, and counted. What is wrong on the bus goes before frames: it has room of its own,
and passes each choice of services.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final, NamedTuple

from canopen_master.monitor_words import finding_text, is_of_service, service_word
from canopen_master.plain_text import clean
from canopen_proto.frame import ALL_NODE_IDS, Frame
from canopen_proto.machine import SECOND, Time
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import Observation
from canopen_proto.observer.sequences import Summary

MOST_ROWS: Final = 40
"""Frames that wait for one who looks, unless he wants more; as many findings and sums besides."""
MOST_TEXT: Final = 400
"""Characters of a frame in words."""
MOST_SERVICES: Final = 20


class FrameWish(NamedTuple):
    """Which frames are looked at. nodes: node-IDs; none: all. services: words of `canopen monitor --service`; none: all."""

    nodes: frozenset[int] = frozenset()
    services: tuple[str, ...] = ()

    @classmethod
    def of(cls, nodes: Iterable[int], services: Iterable[str]) -> FrameWish:
        """Return a wish. Raises ValueError for a node-ID or a service that there is not."""
        chosen = frozenset(nodes)
        if unknown := [each for each in chosen if each not in ALL_NODE_IDS]:
            raise ValueError(f"{str(unknown[0])[:20]} is no node-ID: they are 1 to 127")
        words = tuple(dict.fromkeys(map(service_word, services)))
        if len(words) > MOST_SERVICES:
            raise ValueError(f"{MOST_SERVICES} services are named at most")
        return cls(chosen, words)

    def fits(self, service: str, *node_ids: int) -> bool:
        """Return whether a frame of this service is looked at. node_ids: of whoever it is from, for, or about."""
        if self.nodes and self.nodes.isdisjoint(node_ids):
            return False
        return not self.services or any(is_of_service(service.lower(), word) for word in self.services)


class FeedRow(NamedTuple):
    """A line of a monitor. kind: "frame", "finding" for what is wrong, "sum" for a sequence of frames in one line. seconds: since
    the monitor has begun. frame: in candump's notation; "" for none. text: what it means, or what is wrong."""

    kind: str
    seconds: float
    frame: str
    service: str
    node_id: int
    text: str


class TrafficFeed:
    """See this module's text; made by `NetTraffic.watch`. seen: frames that have passed. fitting: those that fit the wish.
    left_out: those of these, and of the findings, that found no room."""

    def __init__(self, wish: FrameWish, most: int = MOST_ROWS) -> None:
        self.wish = wish
        self._most = most
        self.seen = self.fitting = self.left_out = 0
        self._frames: deque[tuple[Time, Frame, Observation]] = deque()
        self._others: deque[FeedRow] = deque()

    def take(self) -> list[FeedRow]:
        """Return what waits, in order, and forget it."""
        rows = [_frame_row(*each) for each in self._frames] + list(self._others)
        self._frames.clear()
        self._others.clear()
        rows.sort(key=lambda row: row.seconds)
        return rows

    # ---- for the one who fills it ----

    def add(self, time: Time, frame: Frame, observation: Observation) -> None:
        """Take a frame, and what is known of it. time: ns since the monitor has begun."""
        self.seen += 1
        for summary in observation.summaries:
            self.add_sum(time, summary)
        meaning, findings = observation.meaning, observation.findings
        is_part = observation.is_part and meaning.service == "LSS" and not findings  # its sum follows
        if not is_part and self.wish.fits(meaning.service, meaning.node_id, *(each.node_id for each in findings)):
            self.fitting += 1
            if len(self._frames) < self._most:
                self._frames.append((time, frame, observation))
            else:
                self.left_out += 1
        for finding in findings:
            self.add_finding(time, finding)

    def add_finding(self, time: Time, finding: BusFinding) -> None:
        """Take what is wrong; it is shown whatever services are looked at."""
        if not self.wish.nodes or finding.node_id in self.wish.nodes or not finding.node_id:
            self._add_other(finding_row(time, finding))

    def add_sum(self, time: Time, summary: Summary) -> None:
        """Take the sum of a sequence of frames."""
        if self.wish.fits(summary.service, summary.node_id):
            text = clean(summary.text, MOST_TEXT)
            self._add_other(FeedRow("sum", time / SECOND, "", summary.service, summary.node_id, text))

    def _add_other(self, row: FeedRow) -> None:
        if len(self._others) < self._most:
            self._others.append(row)
        else:
            self.left_out += 1


def finding_row(time: Time, finding: BusFinding) -> FeedRow:
    """Return the line of what is wrong. time: ns since the monitor has begun."""
    return FeedRow("finding", time / SECOND, "", finding.rule, finding.node_id, finding_text(finding)[:MOST_TEXT])


def _frame_row(time: Time, frame: Frame, observation: Observation) -> FeedRow:
    meaning = observation.meaning
    text = clean(meaning.text, MOST_TEXT)
    return FeedRow("frame", time / SECOND, str(frame), clean(meaning.service), meaning.node_id, text)
