"""A bus for many networks in virtual time: one frame after the other, at all of them at once, as copper does it.

`tests/core/bus.py` gives each receiver a delay and faults of its own, which costs a step per frame and receiver; this one is
for a hundred nodes. A frame takes `frame_time` plus a jitter from the seed (as if other traffic came between); the order in which
networks want to send is the order in which they were attached.
"""

from __future__ import annotations

import random
from collections import deque

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, Event, Time
from canopen_proto.network import Network


class Copper:
    """See this module's text. sent: each frame, with the time of its arrival. events: those of `listener`, a network."""

    def __init__(self, seed: int, *, frame_time: Time = 130 * MICROSECOND, jitter: Time = 70 * MICROSECOND) -> None:
        self.now: Time = 0
        self.networks: list[Network] = []
        self.listener: Network | None = None
        self.sent: list[tuple[Time, Frame]] = []
        self.events: list[Event] = []
        self._random = random.Random(seed)
        self._frame_time = frame_time
        self._jitter = jitter
        self._waiting: deque[tuple[Network, Frame]] = deque()
        self._idle_at: Time = 0

    def run(self, duration: Time) -> None:
        """Run for so long."""
        end = self.now + duration
        while True:
            self._drain()
            deadline = min(network.next_deadline() for network in self.networks)
            arrival = self._arrival() if self._waiting else end + 1
            now = min(arrival, max(deadline, self.now))
            if now > end:
                self.now = end
                return
            self.now = now
            if now == arrival:
                self._deliver()
            else:
                for network in self.networks:
                    if network.next_deadline() <= now:
                        network.handle_timeout(now)

    def _arrival(self) -> Time:
        """When the frame at the head of the queue has gone over the bus; decided once for each."""
        if self._idle_at <= self.now:
            self._idle_at = self.now + self._frame_time + self._random.randrange(self._jitter + 1)
        return self._idle_at

    def _deliver(self) -> None:
        sender, frame = self._waiting.popleft()
        self.sent.append((self.now, frame))
        for network in self.networks:
            if network is not sender:
                network.receive(frame, self.now)

    def _drain(self) -> None:
        for network in self.networks:
            frames, events = network.drain(self.now)
            self._waiting.extend((network, frame) for frame in frames)
            if network is self.listener:
                self.events += events
