"""`PdoSamples`: every value of some objects that PDOs bring, for one client: nothing is asked for, and none is left out.

A PDO comes a hundred times a second. A client is served some twenty times a second, and takes what came meanwhile together. If it
does not take it, the oldest samples go, and are counted: the pump never waits for a client.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Final, NamedTuple

from canopen_gateway.values import WatchedObject
from canopen_master import Master
from canopen_proto.datatypes import Value
from canopen_proto.machine import SECOND
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.pdo.consumer import PdoReceived

MOST_SAMPLES: Final = 2000
"""Samples that wait for one client: six objects at 100 Hz for three seconds."""


class PdoSample(NamedTuple):
    """A value that a PDO brought. number: its place among the objects that are sampled. time: the master's clock, seconds."""

    number: int
    time: float
    value: Value


class PdoSamples:
    """See this module's text; made by `GatewaySession.sample_pdos`: `with session.sample_pdos([...]) as samples: samples.take()`.
    dropped: samples that nobody took in time."""

    def __init__(self, master: Master, objects: Sequence[WatchedObject], count: Callable[[int], None]) -> None:
        """count: is told how many more objects are watched."""
        self.dropped = 0
        self._master = master
        self._count = count
        self._wanted: dict[tuple[str, int], list[tuple[int, Mux]]] = {}
        for number, place in enumerate(objects):
            self._wanted.setdefault((place.net, place.node_id), []).append((number, mux(place.index, place.subindex)))
        self._size = len(objects)
        self._samples: deque[PdoSample] = deque()

    def __enter__(self) -> PdoSamples:
        self._count(self._size)
        self._watchers = [
            self._master.watch((PdoReceived,), partial(self._hear, wanted), self._master.bus(net), node_id)
            for (net, node_id), wanted in self._wanted.items()
        ]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._count(-self._size)
        for watcher in self._watchers:
            self._master.unwatch(watcher)

    def take(self) -> list[PdoSample]:
        """Return what has come since the last call, oldest first."""
        taken = list(self._samples)
        self._samples.clear()
        return taken

    def _hear(self, wanted: Sequence[tuple[int, Mux]], event: PdoReceived) -> None:
        """Take a PDO, in the pump's turn."""
        muxes = event.mapping.muxes
        for number, place in wanted:
            if place in muxes:
                if len(self._samples) >= MOST_SAMPLES:
                    self._samples.popleft()
                    self.dropped += 1
                self._samples.append(PdoSample(number, self._master.now() / SECOND, event.components[muxes.index(place)]))
