"""`Axes`: several simulated drives in one node, as its application. See drives/cia402/axes.py for the numbers of their objects.

A `Drive` knows the objects of the first axis only. That of a further axis has `Values` of its own, in which it finds its objects
there. A write to the node is handed on to the drive that it is for; what a drive shows is copied to the node's values before they
are read or sent. SYNC, power and a lost connection reach all drives.
"""

from __future__ import annotations

from collections.abc import Sequence

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402.axes import axis_of, dictionary_of_axis, swapped
from canopen_proto.machine import Time
from canopen_proto.multiplexer import Mux, mux, split_mux
from canopen_proto.simulation.drive.drive import Drive

_OF_NODE = mux(indices.COMMUNICATION_CYCLE_PERIOD)


class AxisValues:
    """The values of one axis, 1..7. own: as its drive sees them; they are copied from and to the node's."""

    def __init__(self, node: Values, axis: int) -> None:
        self._axis = axis
        self._node = node
        self.own = Values(dictionary_of_axis(node.dictionary, axis), node.node_id)
        self._places: list[tuple[Mux, Mux]] = [
            (swapped(variable.mux, axis), variable.mux) for variable in node.dictionary if axis_of(variable.mux) == axis
        ]
        self._shown: dict[Mux, Value] = dict(self.own.store)  # what both have; the rest is the newer one's to copy

    def take(self, key: Mux) -> tuple[int, int]:
        """Take over an object that was written to the node; return index and subindex as the drive sees them."""
        place = swapped(key, self._axis)
        self.own.store[place] = self._shown[place] = self._node.store[key]
        return split_mux(place)

    def take_all(self) -> None:
        """Take over all objects of the axis."""
        for own, place in self._places:
            self.own.store[own] = self._shown[own] = self._node.store[place]
        self.take_period()

    def take_period(self) -> None:
        """Take over the SYNC period of the node."""
        period = self._node.store.get(_OF_NODE)
        if period is not None:
            self.own.store[_OF_NODE] = period

    def show(self) -> None:
        """Copy what the drive has changed to the node's values. A write to the node that it was not told of yet stays."""
        whole, store, shown = self._node.store, self.own.store, self._shown
        for own, place in self._places:
            value = store[own]
            if value is not shown[own]:
                whole[place] = shown[own] = value


class Axes:
    """The drives of one node, as its application; see this module's text. drives: by the number of their axis."""

    def __init__(self, drives: Sequence[Drive], values: Sequence[AxisValues]) -> None:
        """values: of the further drives."""
        self.drives = tuple(drives)
        self._values = tuple(values)

    def show(self, axis: int) -> None:
        """Copy what the drive of an axis shows to the values of the node."""
        if axis:
            self._values[axis - 1].show()

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        key = mux(index, subindex)
        axis = self._axis_of(key)
        return self.drives[axis].check_write(*split_mux(swapped(key, axis)), value)

    def written(self, index: int, subindex: int, now: Time) -> None:
        key = mux(index, subindex)
        axis = self._axis_of(key)
        place = self._values[axis - 1].take(key) if axis else (index, subindex)
        self.drives[axis].written(*place, now)
        self.show(axis)

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> None:
        for drive in self.drives:
            drive.refresh(now)
            self.show(drive.axis)

    def on_sync(self, now: Time) -> None:
        for values in self._values:
            values.take_period()
        for drive in self.drives:
            drive.on_sync(now)
            self.show(drive.axis)

    def connection_lost(self, now: Time, error_code: int) -> None:
        for drive in self.drives:
            drive.connection_lost(now, error_code)
            self.show(drive.axis)

    def reset(self, now: Time) -> None:
        for values in self._values:
            values.take_all()
        for drive in self.drives:
            drive.reset(now)
            self.show(drive.axis)

    def _axis_of(self, key: Mux) -> int:
        """Return the axis whose drive an object is for; that of the first one for an object that no drive has."""
        axis = axis_of(key) or 0
        return axis if axis < len(self.drives) else 0
