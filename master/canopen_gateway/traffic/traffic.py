"""`NetTraffic`: what passes on one bus: the last frames, what each means, what is wrong, how much each node says.

    traffic = service.traffic(net)                  # listens from now on
    feed = traffic.watch(FrameWish.of([3], ["sdo"]))
    feed.take()                                     # as often as somebody looks

In the turn of the pump a frame is only put into the ring (ring.py), which costs a microsecond. A task of its own understands it
later, SLICE frames at a time, and lets all others run between two slices: a cycle never waits for an observer. If it comes too
late for a frame, because the ring is full, the frame is counted (`dropped`), and the observer is told that some are missing.
"""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

import trio

from canopen_gateway.traffic.feed import MOST_ROWS, FeedRow, FrameWish, TrafficFeed, finding_row
from canopen_gateway.traffic.pdos import exchanged_pdos, nodes_of
from canopen_gateway.traffic.ring import CAPACITY, FrameRing, PassedFrame
from canopen_master import Master
from canopen_master.pdo_reading import PdoRead
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.explained import counted
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.frame_bits import frame_bits
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.bus_view import BusFigures, BusView
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import Observation, Observer
from canopen_proto.pdo.settings import COB_ID, PdoSettings, communication_index, mapping_index
from canopen_transports.errors import DEAF
from canopen_transports.stamp_clock import StampClock

SLICE: Final = 32
"""Frames that are understood at a time: some 0.3 ms."""
LOOK: Final = 0.05
"""Seconds between two looks at what has come."""
LEARN: Final = 1.0
"""Seconds between two looks at which PDOs the devices have."""
LATE: Final = 250 * MILLISECOND
"""Longer than a frame is on its way from the bus to us: what has not come until then does not come."""
MOST_KEYS: Final = 4096
"""CAN-IDs whose frames are counted each for itself: more than all with 11 bits."""
MOST_FINDINGS: Final = 40
"""The last findings that are kept, for those who look later."""
MOST_LOSSES: Final = 1000
"""The last places where frames were lost that are kept, for a trace."""
LOGGER: Final = logging.getLogger("canopen_gateway")


class KeyRate(NamedTuple):
    """The frames with one CAN-ID in the last whole second. frames, bits: of that second. is_sent: whether the last one was ours.
    service, node_id: what the last one was."""

    frames: int
    bits: int
    is_sent: bool
    service: str
    node_id: int


class ReadPdos(NamedTuple):
    """The PDOs of a node as the device itself tells them. time: when it was asked, on the master's clock."""

    time: Time
    pdos: tuple[PdoRead, ...]


class NetTraffic:
    """See this module's text. ring: the last frames; their times are on the master's clock. system: the clock of the system, ns
    since 1970. lost: frames that were lost before they came here, by the receiver's word; losses: before which frame of the ring,
    and how many. dropped: those that were not looked at in time. found: findings so far, by rule. findings: the last ones.
    failure: why nothing is understood any more, or None. pdos_read: by node-ID."""

    def __init__(self, master: Master, net: str, *, capacity: int = CAPACITY) -> None:
        """master: an open one. capacity: of the ring, frames."""
        bus = master.bus(net)
        self.ring = FrameRing(capacity)
        self.system: Callable[[], Time] = time.time_ns
        self.lost = self.dropped = 0
        self.found: Counter[str] = Counter()
        self.findings: deque[FeedRow] = deque(maxlen=MOST_FINDINGS)
        self.failure: Exception | None = None
        self.pdos_read: dict[int, ReadPdos] = {}
        self._master = master
        self._net = net
        self._begin = master.now()
        self._clock = StampClock()
        self._observer = Observer(self._dictionary_of, bitrate=bus.bitrate or 0)
        self._view = BusView(bitrate=bus.bitrate or 0)
        self._next = 0
        self._gaps: deque[tuple[int, str]] = deque(maxlen=MOST_FINDINGS)
        self.losses: deque[tuple[int, int]] = deque(maxlen=MOST_LOSSES)
        self._feeds: list[TrafficFeed] = []
        self._rates = _KeyRates()
        self._learnt: dict[tuple[int, Direction, int], PdoSettings] = {}
        self._learn_at = 0.0
        self._bus = bus
        self._end_listening = bus.listen(self._hear, self._hear_loss)

    def close(self) -> None:
        """Listen no longer."""
        self._end_listening()

    @contextmanager
    def watch(self, wish: FrameWish, most: int = MOST_ROWS) -> Iterator[TrafficFeed]:
        """Fill a feed while the block runs. most: frames that wait in it; as many findings and sums besides."""
        feed = TrafficFeed(wish, most)
        self._feeds.append(feed)
        try:
            yield feed
        finally:
            self._feeds.remove(feed)

    @property
    def zero(self) -> Time:
        """ns from the master's clock to the time since 1970. The system's clock may be set while a gateway runs: so it is read
        each time."""
        return self.system() - self._master.now()

    def now(self) -> Time:
        """Return the present on the clock of the ring, ns."""
        return self._master.now()

    def figures(self) -> BusFigures:
        """Return the bus in figures; rates and load are those of the last second."""
        return self._view.figures(self._master.now())

    def rates(self) -> dict[RoutingKey, KeyRate]:
        """Return the frames of the last whole second, by CAN-ID; with those CAN-IDs that were heard before."""
        return self._rates.all(self._master.now())

    async def run(self) -> None:
        """Understand what comes, until cancelled. An error in an observer ends this alone; see `failure`."""
        try:
            while True:
                if self.look() == SLICE:
                    await trio.lowlevel.checkpoint()
                else:
                    self._look_at_silence()
                    self._learn()
                    await trio.sleep(LOOK)
        except Exception as error:
            self.failure = error
            LOGGER.exception("what passes on %s is not understood any more", self._net)

    def look(self) -> int:
        """Understand up to SLICE frames that have come; return how many."""
        ring = self.ring
        if self._next < ring.first:
            missing = ring.first - self._next
            self.dropped += missing
            self._next = ring.first
            self._tell_gap(f"{counted(missing, 'frame')} not looked at: this computer is too slow", ring.at(self._next).time)
        count = min(SLICE, ring.count - self._next)
        for number in range(self._next, self._next + count):
            while self._gaps and self._gaps[0][0] <= number:
                self._tell_gap(self._gaps.popleft()[1], ring.at(number).time)
            self._understand(ring.at(number))
        self._next += count
        return count

    # ---- in the turn of the pump ----

    def _hear(self, frame: Frame, now: Time, stamp: int | None, is_sent: bool) -> None:
        self.ring.add(self._clock.time_of(stamp, now), frame, is_sent)

    def _hear_loss(self, lost: int, reason: str) -> None:
        self.lost += lost
        self.losses.append((self.ring.count, lost))
        self._gaps.append((self.ring.count, reason))

    # ---- later ----

    def _understand(self, passed: PassedFrame) -> None:
        frame, now = passed.frame, passed.time
        observation = self._observer.observe(frame, now)
        self._view.add(frame, observation, now)
        self._rates.add(passed, observation)
        if observation.meaning.service == "boot-up":  # the observer forgets what it has learnt of this node
            for place in [each for each in self._learnt if each[0] == observation.meaning.node_id]:
                del self._learnt[place]
        for finding in observation.findings:
            self._keep(now, finding)
        for feed in self._feeds:
            feed.add(now - self._begin, frame, observation)

    def _look_at_silence(self) -> None:
        """Tell what is wrong because nothing came."""
        now = self._master.now() - LATE
        if self._bus.state in DEAF:
            now += LATE
            self._observer.lost("the bus is away", now)  # that nothing comes says nothing about a node
        findings, summaries = self._observer.idle(now)
        for finding in findings:
            self._tell(now, finding)
        for summary in summaries:
            for feed in self._feeds:
                feed.add_sum(now - self._begin, summary)

    def _learn(self) -> None:
        """Tell the observer which PDOs the devices have, as far as they were asked, or the master exchanges them."""
        if trio.current_time() < self._learn_at:
            return
        self._learn_at = trio.current_time() + LEARN
        for node_id, pdo in self.pdos_known():
            place = node_id, *pdo.place
            if self._learnt.get(place) != pdo:
                self._learnt[place] = pdo
                for index, subindex, data in _parameters_of(pdo):
                    self._observer.learn(node_id, index, subindex, data)

    def pdos_known(self) -> Iterator[tuple[int, PdoSettings]]:
        """Yield the PDOs that the master exchanges, then those that devices were asked for, each with its node-ID."""
        for node in nodes_of(self._master, self._net).values():
            for pdo in exchanged_pdos(node):
                yield node.node_id, pdo
        for node_id, read in self.pdos_read.items():
            for each in read.pdos:
                if each.settings is not None:
                    yield node_id, each.settings

    def _tell_gap(self, text: str, now: Time) -> None:
        self._tell(now, self._observer.lost(text, now))

    def _tell(self, now: Time, finding: BusFinding) -> None:
        self._keep(now, finding)
        for feed in self._feeds:
            feed.add_finding(now - self._begin, finding)

    def _keep(self, now: Time, finding: BusFinding) -> None:
        self.found[finding.rule] += 1
        self.findings.append(finding_row(now - self._begin, finding))

    def _dictionary_of(self, node_id: int) -> ObjectDictionary:
        """Return the dictionary of a node of the machine; of others, the names of the data files."""
        node = nodes_of(self._master, self._net).get(node_id)
        return self._master.dictionary if node is None else node.dictionary


class _KeyRates:
    """Counts frames by their CAN-IDs, second by second."""

    def __init__(self) -> None:
        self._second = 0
        self._now: dict[RoutingKey, tuple[int, int]] = {}
        self._last: dict[RoutingKey, tuple[int, int]] = {}
        self._what: dict[RoutingKey, tuple[bool, str, int]] = {}

    def add(self, passed: PassedFrame, observation: Observation) -> None:
        self._roll(passed.time)
        key = passed.frame.key
        if key not in self._what and len(self._what) >= MOST_KEYS:
            return
        frames, bits = self._now.get(key, (0, 0))
        self._now[key] = frames + 1, bits + (observation.bits or frame_bits(passed.frame))
        self._what[key] = passed.is_sent, observation.meaning.service, observation.meaning.node_id

    def all(self, now: Time) -> dict[RoutingKey, KeyRate]:
        self._roll(now - LATE)
        found = {}
        for key, (is_sent, service, node_id) in self._what.items():
            frames, bits = self._last.get(key, (0, 0))
            found[key] = KeyRate(frames, bits, is_sent, service, node_id)
        return found

    def _roll(self, time: Time) -> None:
        second = time // SECOND
        if second > self._second:
            self._last = self._now if second == self._second + 1 else {}
            self._now = {}
            self._second = second


def _parameters_of(pdo: PdoSettings) -> Iterator[tuple[int, int, bytes]]:
    """Yield what a device holds that has this PDO: index, subindex, bytes. Its times and its type are left out."""
    index = mapping_index(*pdo.place)
    yield index, 0, bytes((len(pdo.entries),))
    for subindex, entry in enumerate(pdo.entries, 1):
        yield index, subindex, entry.to_bytes(4, "little")
    yield communication_index(*pdo.place), COB_ID, pdo.cob_id.to_bytes(4, "little")
