"""`ValueStream`: the values of objects, again and again, for one client.

An object that a PDO brings anyway is taken from what the master has heard of it; any other is read by SDO, one after the other,
once in each period. A value that is late is late: periods that were missed are left out.
"""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import trio

from canopen_gateway.errors import GatewayError
from canopen_master import MasterError, Node
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.machine import SECOND
from canopen_proto.multiplexer import mux


@dataclass(frozen=True)
class WatchedObject:
    """An object that a client watches. net: the name of the bus."""

    net: str
    node_id: int
    index: int
    subindex: int = 0


class ValueSeen(NamedTuple):
    """A value of a watched object. value: as the dictionary has it, else bytes; None if it could not be read. problem: why not;
    "" if it could. time: trio's clock, when it was heard."""

    place: WatchedObject
    value: Value | None
    problem: str
    time: float


class ValueStream:
    """Made by `GatewaySession.watch_values`: `async with session.watch_values(...) as values: async for seen in values: ...`."""

    def __init__(
        self,
        objects: Sequence[WatchedObject],
        period: float,
        node_of: Callable[[str, int], Node],
        read: Callable[[WatchedObject], Coroutine[Any, Any, bytes]],
        count: Callable[[int], None],
    ) -> None:
        """period: seconds. node_of: the node on a net. read: reads an object. count: told how many more objects are watched."""
        self._objects = objects
        self._period = period
        self._node_of = node_of
        self._read = read
        self._count = count

    async def __aenter__(self) -> AsyncIterator[ValueSeen]:
        self._count(len(self._objects))
        self._running = self._values()
        return self._running

    async def __aexit__(self, *exc: object) -> None:
        self._count(-len(self._objects))
        await self._running.aclose()

    async def _values(self) -> AsyncGenerator[ValueSeen, None]:
        due = trio.current_time()
        while True:
            for place in self._objects:
                yield await self._value(place)
            due += self._period
            missed = math.ceil((trio.current_time() - due) / self._period)
            due += max(0, missed) * self._period
            await trio.sleep_until(due)

    async def _value(self, place: WatchedObject) -> ValueSeen:
        node = self._node_of(place.net, place.node_id)
        key = mux(place.index, place.subindex)
        heard = node.remote.heard_at.get(key)
        comes_by_itself = any(key in pdo.mapping.muxes for pdo in node.remote.tpdos.values())
        if comes_by_itself and heard is not None and node.now() - heard <= self._period * SECOND:
            await trio.lowlevel.checkpoint()
            return ValueSeen(place, node.remote.values.store[key], "", heard / SECOND)
        try:
            data = await self._read(place)
        except (MasterError, GatewayError) as error:
            return ValueSeen(place, None, str(error).splitlines()[0], trio.current_time())
        value = decoded(node.dictionary, place.index, place.subindex, data)
        return ValueSeen(place, value, "", trio.current_time())


def decoded(dictionary: ObjectDictionary, index: int, subindex: int, data: bytes) -> Value:
    """Return the value of an object by its type; its bytes if it has none, or another length than its type has."""
    variable = dictionary.get(index, subindex)
    try:
        return data if variable is None else variable.decode(data)
    except ValueError:
        return data
