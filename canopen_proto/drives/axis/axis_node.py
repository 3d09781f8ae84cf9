"""The node as one of its axes sees it. An `Axis` and its procedures know the objects of the first axis only: 0x6040, 0x6041 ...

The first axis stands on the RemoteNode itself. A further axis stands on a `FurtherAxis`: a view of the same node in which the
objects of the first axis (0x6000 to 0x67FF) and those of this axis have changed places. Keys that go in, and dictionary, values,
images and news that come out, have the numbers of the first axis. Objects of the whole node are shared, and have the device's
numbers: PDOs with their mappings, SDO clients, events, errors of SDO. `on_device` translates between the two.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, MutableMapping
from typing import Protocol, TypeAlias, TypeVar

from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, Variable
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import MAX_AXES, axes_of, dictionary_of_axis, swapped
from canopen_proto.machine import LocalProtocolError, RequestId, Time
from canopen_proto.multiplexer import Mux, mux_text, split_mux
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import FRESH, RemoteNode
from canopen_proto.sdo.client import Block, SdoUploaded

V = TypeVar("V")
Listener = Callable[[Collection[Mux], Time], None]


AxisNode: TypeAlias = "RemoteNode | FurtherAxis"
"""A node as one of its axes sees it; see this module's text."""


class AxisWatchdog(Protocol):
    """Makes a drive stop by itself if its master is gone; see drives/axis/watchdog.py."""

    def hold(self) -> Procedure[None]:
        """Take hold of the drive: it is about to be enabled."""

    def let_go(self) -> Procedure[None]:
        """Let go of the drive: it stands and is disabled."""


def node_of_axis(node: RemoteNode, axis: int) -> AxisNode:
    """Return a node as its axis (0..7) sees it. Raises LocalProtocolError if the dictionary has no objects of this axis."""
    if not axis:
        return node
    return FurtherAxis(node, axis)


def rpdos_with(node: AxisNode, muxes: Collection[Mux]) -> list[int]:
    """Return the numbers of the RPDOs, live or not, that are exchanged with the node and carry one of these objects."""
    places = [node.on_device(mux) for mux in muxes]
    return [number for number, rpdo in node.rpdos.items() if any(mux in rpdo.mapping.muxes for mux in places)]


class FurtherAxis:
    """A node as its axis 1..7 sees it; see this module's text. Each member is as in RemoteNode."""

    def __init__(self, node: RemoteNode, axis: int) -> None:
        """Raises LocalProtocolError for an axis outside 1..7, and for one that the dictionary does not describe."""
        if not 0 < axis < MAX_AXES:
            raise LocalProtocolError(f"a node has the axes 0 to {MAX_AXES - 1}, not {axis!r}")
        axes = axes_of(node.dictionary)
        if axis not in axes:
            source = node.dictionary.source or "its dictionary"
            known = f"it has axis {', '.join(map(str, axes))}" if axes else "it has no axis"
            missing = mux_text(swapped(objects.CONTROLWORD, axis))
            raise LocalProtocolError(
                f"node {node.node_id} has no axis {axis} by {source}: no {missing} with a statusword; {known}"
            )
        self._node = node
        self._axis = axis
        self.out = node.out
        self.node_id = node.node_id
        self.sdo, self.rpdos, self.emcy = node.sdo, node.rpdos, node.emcy
        self.dictionary = dictionary_of_axis(node.dictionary, axis)
        self.heard_at: Mapping[Mux, Time] = Swapped(node.heard_at, axis)
        self.values = SwappedImages(node.values.store, axis)
        self._news: dict[Collection[Mux], tuple[Mux, ...]] = {}  # the objects of each PDO, translated once

    def on_device(self, mux: Mux) -> Mux:
        """Return the number that an object of this axis has on the device; the other way round for a number of the device."""
        return swapped(mux, self._axis)

    @property
    def nmt_state(self) -> NmtState | None:
        return self._node.nmt_state

    def read(self, key: Key, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        return self._node.read(self._key(key), now, urgent=urgent, block=block)

    def write(self, key: Key, value: Value, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        return self._node.write(self._key(key), value, now, urgent=urgent, block=block)

    def value_of(self, uploaded: SdoUploaded, variable: Variable) -> Value:
        return self._node.value_of(uploaded, variable)

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        return self._node.cancel(request_id, now)

    def make_way(self, now: Time) -> None:
        self._node.make_way(now)

    def encode(self, key: Key, value: Value) -> tuple[Variable, Value, bytes]:
        return self._node.encode(self._key(key), value)

    def fresh(self, mux: Mux, now: Time, max_age: Time = FRESH) -> Value | None:
        return self._node.fresh(self.on_device(mux), now, max_age)

    def rpdo_of(self, key: Mux) -> PdoProducer | None:
        return self._node.rpdo_of(self.on_device(key))

    def enable_rpdo(self, number: int, now: Time, enabled: bool = True) -> None:
        self._node.enable_rpdo(number, now, enabled)

    def keep_commanded(self, mux: Mux) -> None:
        self._node.keep_commanded(self.on_device(mux))

    def may_hold(self, mux: Mux) -> set[Value | None]:
        return self._node.may_hold(self.on_device(mux))

    def replace_held(self, mux: Mux, value: Value, now: Time) -> bool:
        return self._node.replace_held(self.on_device(mux), value, now)

    def drop_waiting(self, mux: Mux, now: Time) -> None:
        self._node.drop_waiting(self.on_device(mux), now)

    def add_listener(
        self,
        listener: Listener | None = None,
        on_boot: Callable[[], None] | None = None,
        on_sync: Callable[[Time], None] | None = None,
    ) -> None:
        if listener is None:
            self._node.add_listener(None, on_boot, on_sync)
            return
        heard, news = listener, self._news

        def translated(muxes: Collection[Mux], now: Time) -> None:
            key = tuple(muxes)
            own = news.get(key)
            if own is None:
                own = news[key] = tuple(map(self.on_device, key))
            heard(own, now)

        self._node.add_listener(translated, on_boot, on_sync)

    def _key(self, key: Key) -> Variable:
        """Return the node's own variable for a key of this axis."""
        variable = self.dictionary.variable(key)
        return self._node.dictionary.at(*split_mux(self.on_device(variable.mux)))


class Swapped(MutableMapping[Mux, V]):
    """A mapping by mux, as an axis sees it. It holds nothing itself."""

    __slots__ = ("_axis", "_whole")

    def __init__(self, whole: dict[Mux, V], axis: int) -> None:
        self._whole = whole
        self._axis = axis

    def __getitem__(self, key: Mux) -> V:
        return self._whole[swapped(key, self._axis)]

    def __setitem__(self, key: Mux, value: V) -> None:
        self._whole[swapped(key, self._axis)] = value

    def __delitem__(self, key: Mux) -> None:
        del self._whole[swapped(key, self._axis)]

    def __contains__(self, key: object) -> bool:
        return isinstance(key, int) and swapped(Mux(key), self._axis) in self._whole

    def __iter__(self) -> Iterator[Mux]:
        return (swapped(key, self._axis) for key in self._whole)

    def __len__(self) -> int:
        return len(self._whole)


class SwappedImages:
    """The values of a node as an axis sees them."""

    def __init__(self, store: dict[Mux, Value], axis: int) -> None:
        self.store: MutableMapping[Mux, Value] = Swapped(store, axis)
