"""The simulated drive's inputs: two touch probes, and the events by which changed inputs are told.

A touch probe latches the position at an edge of its input. 60B8h arms it; 60B9h shows what was latched, 60BAh to 60BDh where,
60D5h to 60D8h how often. Each probe has a byte in 60B8h and 60B9h, the second one the high byte:

    60B8h  bit 0 enabled   bit 1 0 first edge, 1 each edge   bit 2 0 its input, 1 the index pulse
           bit 4 the positive edge is latched   bit 5 the negative edge is
    60B9h  bit 0 enabled   bit 1 positive edge latched   bit 2 negative edge latched
           bits 6, 7 change with each positive, negative edge, if each edge is latched

A probe is armed again when bit 0 rises; an edge, when its bit 4 or 5 rises. The probes' inputs are active on parts of the track
(`Track.probes`). An index pulse counts as a positive and a negative edge at one place. Edges are latched where they lie on the
track, as the encoder hardware of real drives does: neither the time of the look nor the speed matters. An axis that turns round
between two looks may miss an edge.

The standard leaves bits 6 and 7 of 60B9h to the maker. They are as in Yaskawa's drives; others have only the counters.

Left out: sources by 60D0h.

Source: IEC 61800-7-201 (CiA 402-2), touch probe.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import Outbox
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.events import InputsChanged
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.turns import shown

_ENABLE, _CONTINUOUS, _BY_INDEX = 1 << 0, 1 << 1, 1 << 2
_BYTE: Final = 8
_COUNTER: Final = 1 << 16


class _Edge(NamedTuple):
    """An edge of a probe's input. sample: its bit in 60B8h; stored, toggle: its bits in 60B9h; objects of probes 1 and 2."""

    sample: int
    stored: int
    toggle: int
    positions: tuple[Mux, Mux]
    counters: tuple[Mux, Mux]


_POSITIVE: Final = _Edge(
    1 << 4,
    1 << 1,
    1 << 6,
    (objects.TOUCH_PROBE_1_POSITIVE_EDGE, objects.TOUCH_PROBE_2_POSITIVE_EDGE),
    (objects.TOUCH_PROBE_1_POSITIVE_COUNTER, objects.TOUCH_PROBE_2_POSITIVE_COUNTER),
)
_NEGATIVE: Final = _Edge(
    1 << 5,
    1 << 2,
    1 << 7,
    (objects.TOUCH_PROBE_1_NEGATIVE_EDGE, objects.TOUCH_PROBE_2_NEGATIVE_EDGE),
    (objects.TOUCH_PROBE_1_NEGATIVE_COUNTER, objects.TOUCH_PROBE_2_NEGATIVE_COUNTER),
)
_OF_ONE: Final = [word for word in range(1 << 6) if not word & 1 << 3]
FUNCTIONS: Final = frozenset(one | other << _BYTE for one in _OF_ONE for other in _OF_ONE)
"""The values that 60B8h takes."""


class _Crossing(NamedTuple):
    """Edges of one kind on the way, in order: the first and the last place on the track, and how many."""

    edge: _Edge
    first: float
    last: float
    times: int = 1


class Inputs:
    """The inputs of a drive. `look` after each motion of the servo."""

    def __init__(self, servo: Servo, out: Outbox, node_id: int, axis: int = 0) -> None:
        self._axis = axis
        self._servo = servo
        self._out = out
        self.node_id = node_id
        self._function = 0
        self._position = servo.position
        self._told: dict[Mux, object] = {}

    def look(self) -> None:
        """Latch the edges that the axis has passed since the last look, take over 60B8h, and tell what has changed."""
        servo, store = self._servo, self._servo.store
        begin, self._position = self._position, servo.position
        function = store.get(objects.TOUCH_PROBE_FUNCTION)
        if isinstance(function, int) and (function or self._function):  # else no probe is or was enabled
            status = servo.parameter(objects.TOUCH_PROBE_STATUS)
            for probe in (0, 1):
                shift = probe * _BYTE
                mine = self._latch(probe, begin, status >> shift & 0xFF) if begin != servo.position else status >> shift & 0xFF
                mine = _armed(mine, self._function >> shift, function >> shift)
                status = status & ~(0xFF << shift) | mine << shift
            self._function = function
            store[objects.TOUCH_PROBE_STATUS] = status
        for key in (objects.DIGITAL_INPUTS, objects.TOUCH_PROBE_STATUS):
            value = store.get(key)
            if value != self._told.get(key, value):
                self._out.events.append(InputsChanged(self.node_id, key, self._axis))
            self._told[key] = value

    def _latch(self, probe: int, begin: float, status: int) -> int:
        """Latch what a probe is to latch on the way from `begin`; return its byte of 60B9h."""
        function, servo = self._function >> probe * _BYTE, self._servo
        if not function & _ENABLE:
            return status
        is_continuous = bool(function & _CONTINUOUS)
        for edge, first, last, times in self._crossings(probe, begin, bool(function & _BY_INDEX)):
            if not function & edge.sample or (status & edge.stored and not is_continuous):
                continue
            place, times = (last, times) if is_continuous else (first, 1)
            servo.store[edge.positions[probe]] = shown(servo, place)
            if edge.counters[probe] in servo.store:
                servo.store[edge.counters[probe]] = (servo.parameter(edge.counters[probe]) + times) % _COUNTER
            status |= edge.stored
            if is_continuous and times & 1:
                status ^= edge.toggle
        return status

    def _crossings(self, probe: int, begin: float, by_index: bool) -> list[_Crossing]:
        """Return the edges on the way from `begin` to where the axis is, in order."""
        track, end = self._servo.settings.track, self._servo.position
        upward = end > begin
        if by_index:
            first, last = sorted((begin, end))
            lowest = math.floor((first - track.index_offset) / track.index_distance) + 1
            highest = math.floor((last - track.index_offset) / track.index_distance)
            if highest < lowest:
                return []
            places = [track.index_offset + number * track.index_distance for number in (lowest, highest)]
            if not upward:
                places.reverse()
            return [_Crossing(edge, places[0], places[1], highest - lowest + 1) for edge in (_POSITIVE, _NEGATIVE)]
        low, high = track.probes[probe]
        ways = [(low, _POSITIVE), (high, _NEGATIVE)] if upward else [(high, _POSITIVE), (low, _NEGATIVE)]
        return [_Crossing(edge, place, place) for place, edge in ways if min(begin, end) < place <= max(begin, end)]


def _armed(status: int, before: int, now: int) -> int:
    """Return a probe's byte of 60B9h after its byte of 60B8h has changed."""
    if not now & _ENABLE:
        return 0
    if not before & _ENABLE:
        return _ENABLE
    for edge in (_POSITIVE, _NEGATIVE):
        if not now & edge.sample:
            status &= ~edge.stored
    return status
