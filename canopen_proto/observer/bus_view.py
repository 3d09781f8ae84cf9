"""`BusView`: a bus in figures, for a display: its nodes, their states and rates, load, SYNC and its jitter, errors, findings.

    observer, view = Observer(dictionaries.get), BusView(bitrate=500_000)
    for frame, now in recording:
        view.add(frame, observer.observe(frame, now), now)
    view.figures(now)                # as often as the display is drawn

Rates and load are those of the last whole second, to a tenth of a second. Periods and their jitter are those of the last
MAX_INTERVALS intervals. Memory is bounded, whatever the bus does.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from math import sqrt
from typing import Final, NamedTuple

from canopen_proto.error_codes import error_text
from canopen_proto.frame import (
    BY_THE_NODE,
    EXTENDED,
    FUNCTION,
    MAX_NODE_ID,
    REMOTE,
    Frame,
)
from canopen_proto.frame_bits import frame_bits
from canopen_proto.machine import SECOND, Time
from canopen_proto.nmt import COMMAND_OF_BYTE, STATE_OF_BYTE, NmtState, target_of
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import Observation

MAX_INTERVALS: Final = 256
"""Intervals of a SYNC or a heartbeat that are kept: 2.5 s of SYNC at 10 ms."""
MAX_EMERGENCIES: Final = 16
"""The last emergencies of a node that are kept."""
MAX_ERRORS: Final = 16
"""Errors of a node that are present and kept: of more, the first ones."""
MAX_FINDINGS: Final = 64
"""The last findings that are kept."""

_SLOTS: Final = 10
"""Parts of a second for which frames and bits are counted."""
_SLOT: Final = SECOND // _SLOTS
_ABORT: Final = 0x80
_NOT_OF_A_NODE: Final = EXTENDED | REMOTE
"""Flags of frames that are not of the predefined connection set, or that ask for one of it."""


class Intervals(NamedTuple):
    """Times from one frame to the next, in ns: of `number` intervals the shortest, the mean, the longest, standard deviation."""

    number: int
    least: Time
    mean: float
    most: Time
    deviation: float


class Emergency(NamedTuple):
    """An EMCY frame. code: 0 is "no error", or one error less. register: the error register. data: the vendor's five bytes."""

    time: Time
    code: int
    register: int
    data: bytes

    @property
    def text(self) -> str:
        """Return the error in words."""
        return error_text(self.code)


class NodeFigures(NamedTuple):
    """A node that was heard, or spoken to.

    state: what it has last said, or was told since; None if neither was heard. is_said: it has said so itself. state_at: when
    that was.
    booted: how often it has booted.
    last_heard: when it last sent something; None if others have only spoken to it. heard_by: the service of that frame.
    heartbeat: intervals of its heartbeats, or of its guarding answers; None before the second one.
    frames: those that it has sent, and those to it alone. frames_per_second, bits_per_second: of these, in the last second.
    errors: codes of its errors since its error register was last 0. register: the error register, as it was last told.
    emergencies: the last ones, the newest last.
    transfers: SDO values read or written. aborts: SDO transfers aborted.
    """

    node_id: int
    state: NmtState | int | None
    is_said: bool
    state_at: Time | None
    booted: int
    last_heard: Time | None
    heard_by: str
    heartbeat: Intervals | None
    frames: int
    frames_per_second: int
    bits_per_second: int
    errors: tuple[int, ...]
    register: int
    emergencies: tuple[Emergency, ...]
    transfers: int
    aborts: int


class BusFigures(NamedTuple):
    """A bus and its nodes, in the order of their IDs.

    elapsed: ns since the first frame.
    load, peak, mean_load: shares of the bit rate (0.4 is 40 %): in the last second, the most in any second, and since the first
    frame. They are None if the bit rate is not known.
    syncs: how many SYNCs have come. sync: their intervals; None before the second one. sync_at: when the last one came.
    sync_counter: its counter, if any.
    transfers, aborts: the sums of all nodes.
    findings: the last ones and their times, the newest last. found: how many of each rule.
    """

    nodes: tuple[NodeFigures, ...]
    elapsed: Time
    frames: int
    frames_per_second: int
    bits_per_second: int
    load: float | None
    peak: float | None
    mean_load: float | None
    syncs: int
    sync: Intervals | None
    sync_at: Time | None
    sync_counter: int | None
    transfers: int
    aborts: int
    findings: tuple[tuple[Time, BusFinding], ...]
    found: dict[str, int]


class BusView:
    """See this module's text. bitrate: bit/s; 0 if it is not known: then there is no load."""

    def __init__(self, *, bitrate: int = 0) -> None:
        self.bitrate = bitrate
        self._nodes: dict[int, _NodeView] = {}
        self._rate = _Rate()
        self._peak = 0
        self._begin: Time | None = None
        self._now: Time = 0
        self._syncs = 0
        self._sync = _Pulse()
        self._sync_counter: int | None = None
        self._findings: deque[tuple[Time, BusFinding]] = deque(maxlen=MAX_FINDINGS)
        self._found: Counter[str] = Counter()

    def add(self, frame: Frame, observation: Observation, now: Time) -> None:
        """Take a frame, and what the observer says of it. Frames come in order. now: ns; an earlier one counts as the last."""
        if self._begin is None:
            self._begin = self._now = now
        if now < self._now:
            now = self._now
        self._now = now
        bits, slot, rate, meaning = observation.bits or frame_bits(frame), now // _SLOT, self._rate, observation.meaning
        if 0 <= rate.slot < slot:  # a slot is over
            self._peak = max(self._peak, rate.last_second(rate.slot + 1)[1])
        rate.add(slot, bits)
        if observation.findings:
            for finding in observation.findings:
                self._findings.append((now, finding))
                self._found[finding.rule] += 1
        service, node_id = meaning.service, meaning.node_id
        if service == "SYNC":
            self._syncs += 1
            self._sync.beat(now)
            self._sync_counter = frame.data[0] if frame.data else None
        elif service == "NMT":
            self._command(frame.data, now)
        if node_id:
            node = self._nodes.get(node_id)
            if node is None:
                node = self._nodes[node_id] = _NodeView(node_id)
            node.rate.add(slot, bits)
            if not frame.flags & _NOT_OF_A_NODE and frame.can_id & FUNCTION in BY_THE_NODE:
                node.last_heard, node.heard_by = now, service
            if service == "SDO":
                node.sdo(frame.data, observation)
            elif not frame.flags & REMOTE:
                if service in ("heartbeat", "guarding", "boot-up"):
                    node.error_control(frame.data, now)
                elif service == "EMCY":
                    node.emergency(frame.data, now)

    def figures(self, now: Time) -> BusFigures:
        """Return all figures. now: ns; rates are those of the second before it, whether or not frames have come since."""
        now = max(now, self._now)
        slot = now // _SLOT
        frames, bits = self._rate.last_second(slot)
        peak = max(self._peak, bits)
        elapsed = now - (now if self._begin is None else self._begin)
        mean = self._rate.bits * SECOND / (elapsed * self.bitrate) if elapsed and self.bitrate else None
        nodes = tuple(self._nodes[node_id].figures(slot) for node_id in sorted(self._nodes))
        return BusFigures(
            nodes=nodes,
            elapsed=elapsed,
            frames=self._rate.frames,
            frames_per_second=frames,
            bits_per_second=bits,
            load=bits / self.bitrate if self.bitrate else None,
            peak=peak / self.bitrate if self.bitrate else None,
            mean_load=mean,
            syncs=self._syncs,
            sync=self._sync.intervals(),
            sync_at=self._sync.last,
            sync_counter=self._sync_counter,
            transfers=sum(node.transfers for node in nodes),
            aborts=sum(node.aborts for node in nodes),
            findings=tuple(self._findings),
            found=dict(self._found),
        )

    def _command(self, data: bytes, now: Time) -> None:
        if len(data) != 2:
            return
        command, node_id = COMMAND_OF_BYTE.get(data[0]), data[1]
        if command is None or node_id > MAX_NODE_ID:
            return
        state = target_of(command)
        for node in self._nodes.values():
            if node_id in (0, node.node_id):
                node.state, node.is_said, node.state_at = state, False, now


class _Rate:
    """Frames and bits: all of them, and those of the last second."""

    __slots__ = ("_now_bits", "_now_frames", "_past", "bits", "frames", "slot")

    def __init__(self) -> None:
        self.frames = 0
        self.bits = 0
        self.slot = -1  # the present one; it is not over
        self._now_frames = self._now_bits = 0
        self._past: deque[tuple[int, int, int]] = deque(maxlen=_SLOTS)  # slots with frames: number, frames, bits

    def add(self, slot: int, bits: int) -> None:
        """Count a frame."""
        if slot != self.slot:
            if self.slot >= 0:
                self._past.append((self.slot, self._now_frames, self._now_bits))
            self.slot = slot
            self._now_frames = self._now_bits = 0
        self.frames += 1
        self.bits += bits
        self._now_frames += 1
        self._now_bits += bits

    def last_second(self, slot: int) -> tuple[int, int]:
        """Return the frames and bits of the second that ends where a slot begins."""
        frames = bits = 0
        if slot - _SLOTS <= self.slot < slot:
            frames, bits = self._now_frames, self._now_bits
        for each, each_frames, each_bits in self._past:
            if slot - _SLOTS <= each < slot:
                frames += each_frames
                bits += each_bits
        return frames, bits


class _Pulse:
    """Something that comes again and again: the last intervals."""

    __slots__ = ("_intervals", "last")

    def __init__(self) -> None:
        self.last: Time | None = None
        self._intervals: deque[Time] = deque(maxlen=MAX_INTERVALS)

    def beat(self, now: Time) -> None:
        """Take note that it has come."""
        if self.last is not None:
            self._intervals.append(now - self.last)
        self.last = now

    def intervals(self) -> Intervals | None:
        """Return the figures of the last intervals; None if there is none."""
        count = len(self._intervals)
        if not count:
            return None
        mean = sum(self._intervals) / count
        variance = sum((each - mean) ** 2 for each in self._intervals) / count
        return Intervals(count, min(self._intervals), mean, max(self._intervals), sqrt(variance))


@dataclass(slots=True)
class _NodeView:
    """One node, as it was heard; see `NodeFigures`."""

    node_id: int
    state: NmtState | int | None = None
    is_said: bool = False
    state_at: Time | None = None
    booted: int = 0
    last_heard: Time | None = None
    heard_by: str = ""
    heartbeat: _Pulse = field(default_factory=_Pulse)
    rate: _Rate = field(default_factory=_Rate)
    transfers: int = 0
    aborts: int = 0
    _errors: list[int] = field(default_factory=list)
    _register: int = 0
    _emergencies: deque[Emergency] = field(default_factory=lambda: deque(maxlen=MAX_EMERGENCIES))

    def error_control(self, data: bytes, now: Time) -> None:
        """Take a boot-up, a heartbeat or a guarding answer."""
        if len(data) != 1:
            return
        state, self.is_said, self.state_at = data[0] & 0x7F, True, now
        if state == NmtState.INITIALISING:
            self.booted += 1
            self.heartbeat = _Pulse()
            self._errors.clear()
            self._register = 0
            self.state = NmtState.PRE_OPERATIONAL  # it enters this state by itself (CiA 301 v4.2.0, 7.3.2.2.1)
            return
        known = STATE_OF_BYTE[state]
        if known is not None:  # no conditional expression: in the compiled core it would make an int of both
            self.state = known
        else:
            self.state = state
        self.heartbeat.beat(now)

    def emergency(self, data: bytes, now: Time) -> None:
        """Take an EMCY frame."""
        if len(data) < 3:
            return
        code, self._register = data[0] | data[1] << 8, data[2]
        self._emergencies.append(Emergency(now, code, data[2], data[3:8]))
        if not self._register:
            self._errors.clear()
        if code and code not in self._errors and len(self._errors) < MAX_ERRORS:
            self._errors.append(code)

    def sdo(self, data: bytes, observation: Observation) -> None:
        """Take an SDO frame. A block's segments have the numbers 1 to 127: none of them begins like an abort."""
        if data[:1] == _ABORT_BYTE:
            self.aborts += 1
        elif observation.settled is not None:
            self.transfers += 1

    def figures(self, slot: int) -> NodeFigures:
        """Return its figures. slot: of the present time."""
        frames, bits = self.rate.last_second(slot)
        return NodeFigures(
            node_id=self.node_id,
            state=self.state,
            is_said=self.is_said,
            state_at=self.state_at,
            booted=self.booted,
            last_heard=self.last_heard,
            heard_by=self.heard_by,
            heartbeat=self.heartbeat.intervals(),
            frames=self.rate.frames,
            frames_per_second=frames,
            bits_per_second=bits,
            errors=tuple(self._errors),
            register=self._register,
            emergencies=tuple(self._emergencies),
            transfers=self.transfers,
            aborts=self.aborts,
        )


_ABORT_BYTE: Final = bytes((_ABORT,))
