"""Touch probes of a drive: latch its position at an edge of an input, or at the index pulse.

    arm_probe      writes the probe's byte of 0x60B8, waits for "enabled" in 0x60B9
    wait_for_probe waits for the first edge that is latched
    watch_probe    reports each edge that is latched, as `ProbeLatched`
    read_probe     the positions that are latched
    disarm_probe

A drive has two probes; the first has the low bytes of 0x60B8 and 0x60B9, the second the high ones:

    0x60B8   bit 0 enabled, bit 1 each edge (0: the first), bits 2, 3 source, bit 4 positive edge, bit 5 negative edge
    0x60B9   bit 0 enabled, bit 1 positive edge latched, bit 2 negative edge latched; bits 6, 7 the maker's

While each edge is latched, bits 1 and 2 stay set after the first one. A further one shows in the counters 0x60D5 to 0x60D8, in
bits 6 and 7 if the maker lets them change, or in another position. Edges that come faster than `watch_probe` looks are one event;
`missed` tells how many were passed over, if the drive counts.

Source: IEC 61800-7-201 (CiA 402-2), touch probe; from memory, and as the manuals of Yaskawa and Panasonic have it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple, NoReturn

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import DriveTimeoutError, as_drive_errors
from canopen_proto.drives.axis.watching import POLL_INTERVAL
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import SECOND, Event, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_if_present, read_int, write
from canopen_proto.procedures.steps import Procedure, current_time, sleep

_ENABLE, _CONTINUOUS, _POSITIVE, _NEGATIVE = 1 << 0, 1 << 1, 1 << 4, 1 << 5
_SOURCE: Final = 2
_COUNTER: Final = 1 << 16


class ProbeSource(IntEnum):
    """The source that a probe listens to."""

    INPUT = 0
    """The probe's own input."""
    INDEX = 1
    """The index pulse of the position encoder."""
    SELECTED = 2
    """The source that 0x60D0 selects."""


class ProbeLatched(Event):
    """A probe has latched a position, in the user's unit. probe: 1 or 2. missed: edges since the last event that were passed
    over; None: the drive does not count them. axis: of the node. is_positive: at the rising edge of its input; else at the
    falling one."""

    __match_args__ = ("node_id", "probe", "is_positive", "position")

    def __init__(self, node_id: int, probe: int, is_positive: bool, position: float, missed: int | None, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.probe = probe
        self.is_positive = is_positive
        self.position = position
        self.missed = missed


class ProbeReading(NamedTuple):
    """The positions that a probe has latched, in the user's unit; None: not yet."""

    positive: float | None
    negative: float | None


class _Shown(NamedTuple):
    """The values by which one latched edge is told from the next."""

    counter: int | None
    toggle: int
    counts: int | None
    """None: nothing is latched."""


@as_drive_errors
def arm_probe(
    axis: Axis,
    probe: int = 1,
    *,
    positive: bool = True,
    negative: bool = False,
    each: bool = False,
    source: ProbeSource = ProbeSource.INPUT,
) -> Procedure[None]:
    """Arm a probe for these edges, the first or `each`; what it latched before is forgotten.

    probe: 1 or 2. positive, negative: the edges that latch. each: every edge; else the first one. source: of the edges.
    Raises DriveTimeoutError if the drive does not show it as enabled within `state_timeout`, SdoTransferError if it refuses;
    LocalProtocolError for a probe other than 1 and 2, or without an edge.
    """
    if not (positive or negative):
        raise LocalProtocolError("a probe needs an edge to latch: positive, negative or both")
    word = _ENABLE | each * _CONTINUOUS | source << _SOURCE | positive * _POSITIVE | negative * _NEGATIVE
    yield from _command(axis, probe, 0)  # bit 0 has to rise
    yield from _command(axis, probe, word)


@as_drive_errors
def disarm_probe(axis: Axis, probe: int = 1) -> Procedure[None]:
    """Stop latching. Else as `arm_probe`. probe: 1 or 2."""
    yield from _command(axis, probe, 0)


@as_drive_errors
def _command(axis: Axis, probe: int, function: int) -> Procedure[None]:
    """Write a probe's byte of 0x60B8; wait until 0x60B9 shows whether it is enabled."""
    if probe not in (1, 2):
        raise LocalProtocolError(f"a drive has touch probes 1 and 2; {probe!r} is none")
    node, shift = axis.node, _shift(probe)
    word = (yield from read_int(node, objects.TOUCH_PROBE_FUNCTION)) & ~(0xFF << shift) | function << shift
    yield from write(node, objects.TOUCH_PROBE_FUNCTION, word)
    deadline = (yield from current_time()) + axis.settings.state_timeout
    while ((yield from read_int(node, objects.TOUCH_PROBE_STATUS)) >> shift ^ function) & _ENABLE:
        if (yield from current_time()) >= deadline:
            goal = "enabled" if function else "disabled"
            failed = f"did not show touch probe {probe} as {goal} (0x60B9) within {axis.settings.state_timeout / SECOND:g} s"
            raise DriveTimeoutError(axis, failed, remedy="look which input of the drive is its touch probe", looks=False)
        yield from sleep(POLL_INTERVAL)


@as_drive_errors
def read_probe(axis: Axis, probe: int = 1) -> Procedure[ProbeReading]:
    """Return the positions that a probe has latched since it was armed."""
    shown = yield from _look(axis, probe, 0)
    return ProbeReading(*(None if each.counts is None else axis.scale.from_counts(each.counts) for each in shown))


@as_drive_errors
def wait_for_probe(axis: Axis, probe: int = 1, *, timeout: Time) -> Procedure[ProbeReading]:
    """Wait until a probe that is armed has latched an edge, at most `timeout` ns; return what it has latched.

    The axis is not moved by this. Raises DriveTimeoutError, SdoTransferError.
    """
    deadline = (yield from current_time()) + timeout
    while True:
        reading = yield from read_probe(axis, probe)
        if reading != ProbeReading(None, None):
            return reading
        if (yield from current_time()) >= deadline:
            raise DriveTimeoutError(
                axis, f"latched nothing by touch probe {probe} within {timeout / SECOND:g} s", remedy="look at the probe's input"
            )
        yield from sleep(POLL_INTERVAL)


@as_drive_errors
def watch_probe(axis: Axis, probe: int = 1, *, interval: Time = POLL_INTERVAL) -> Procedure[NoReturn]:
    """Report each edge that an armed probe latches from now on, as `ProbeLatched`, until cancelled.

    interval: ns between two looks; a TPDO that carries 0x60B9 saves an SDO read in each.
    """
    node = axis.node
    before = yield from _look(axis, probe, interval)
    while True:
        yield from sleep(interval)
        now = yield from _look(axis, probe, interval, before)
        for is_positive, old, new in zip((True, False), before, now, strict=True):
            if new.counts is not None and new != old:
                missed = _between(old.counter, new.counter)
                position = axis.scale.from_counts(new.counts)
                node.out.events.append(ProbeLatched(node.node_id, probe, is_positive, position, missed, axis.number))
        before = now


def _between(old: int | None, new: int | None) -> int | None:
    return None if old is None or new is None else (new - old - 1) % _COUNTER


def _look(axis: Axis, probe: int, max_age: Time, before: tuple[_Shown, _Shown] | None = None) -> Procedure[tuple[_Shown, _Shown]]:
    """Return what a probe shows of its positive and its negative edge. before: at the last look; an edge that is not latched
    keeps the counter that it had then."""
    node = axis.node
    heard = node.fresh(objects.TOUCH_PROBE_STATUS, (yield from current_time()), max_age) if max_age else None
    status = heard if isinstance(heard, int) else (yield from read_int(node, objects.TOUCH_PROBE_STATUS))
    status >>= _shift(probe)
    found: list[_Shown] = []
    for edge in (0, 1):
        is_latched = status >> 1 + edge & 1
        if not is_latched and before is not None:
            found.append(before[edge]._replace(counts=None))
            continue
        place = (2 * (probe - 1) + edge) << 8  # the four objects follow each other
        counts = (yield from read_int(node, Mux(objects.TOUCH_PROBE_1_POSITIVE_EDGE + place))) if is_latched else None
        counter = yield from read_if_present(node, Mux(objects.TOUCH_PROBE_1_POSITIVE_COUNTER + place))
        found.append(_Shown(counter if isinstance(counter, int) else None, status >> 6 + edge & 1, counts))
    return found[0], found[1]


def _shift(probe: int) -> int:
    return 8 * (probe - 1)
