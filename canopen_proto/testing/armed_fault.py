"""A fault in a world that runs: which frames it has met so far, and what it makes of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from canopen_proto.abort import AbortCode
from canopen_proto.frame import KEY_REMOTE, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import split_mux
from canopen_proto.sdo.codec import (
    ABORT,
    EXPEDITED_BITS,
    INITIATE_UPLOAD_RESPONSE,
    MAX_EXPEDITED,
    REQUESTS,
    SdoFrame,
    is_initiate,
    mux_in,
    pack_expedited,
    pack_initiate,
)
from canopen_proto.testing.draws import Draws
from canopen_proto.testing.faults import (
    Copy,
    Corrupt,
    Delay,
    Fault,
    FrameFault,
    Lie,
    Lose,
    Refuse,
    Reorder,
    Replace,
    Sudden,
)
from canopen_proto.testing.patterns import Names, Pattern, as_pattern, sdo_read, sdo_request, sdo_write


class Transit(NamedTuple):
    """What becomes of a frame on its way. at: when it comes. only: at this receiver; 0: at all. but: not at these ones.

    is_late: those behind it with its identifier wait for it. is_loose: it waits for none. fate: what happened to it, in words.
    """

    frame: Frame
    at: Time
    only: int = 0
    but: frozenset[int] = frozenset()
    is_late: bool = False
    is_loose: bool = False
    fate: str = ""


class ArmedFault:
    """See this module's text. fault: the value. draws: numbers of its own.

    hits: how often it has hit. last: when, for the last time.
    """

    def __init__(self, fault: Fault, draws: Draws) -> None:
        self.fault = fault
        self._draws = draws
        self.hits = 0
        self.last: Time = 0
        self._met = 0
        self._patterns = _patterns_of(fault)

    def meets(self, frame: Frame, bus: str, now: Time, names: Names) -> bool:
        """Whether the fault hits this frame; it counts the frame."""
        fault = self.fault
        if not fault.since <= now < fault.until or fault.bus not in ("", bus):
            return False
        if not any(pattern.fits(frame, names) for pattern in self._patterns) or not self._can_answer(frame):
            return False
        self._met += 1
        if fault.positions and self._met not in fault.positions:
            return False
        if fault.when is not None and not fault.when(frame):
            return False
        return self._draws.happens(fault.chance)

    def hit(self, now: Time) -> None:
        """Take note that it has hit."""
        self.hits += 1
        self.last = now

    def __str__(self) -> str:
        if not self.hits:
            return f"never hit: {self.fault}"
        times = "once" if self.hits == 1 else f"{self.hits} times, last"
        return f"{self.fault}: {times} at {self.last / SECOND:.6f} s"

    def check(self, names: Names) -> None:
        """Look whether the objects that are meant are some of their nodes, as far as these are known.

        Raises ObjectNotFoundError, ValueRangeError; LocalProtocolError for a lie that no frame can carry.
        """
        for pattern in self._patterns:
            pattern.check(names)
        if isinstance(self.fault, Lie) and names(self.fault.node_id) is not None:
            self._told(self.fault, names)

    def _told(self, lie: Lie, names: Names) -> bytes:
        """Return what a device tells in the place of the truth."""
        value = Pattern("sdo write", lie.node_id, lie.key, lie.value).data(names)
        assert value is not None
        if not 0 < len(value) <= MAX_EXPEDITED:
            raise LocalProtocolError(f"{lie}: {len(value)} bytes; an answer of one frame has 1..{MAX_EXPEDITED}")
        return value

    def _can_answer(self, frame: Frame) -> bool:
        """Whether a fault that answers for a device can answer this request: one that begins a transfer."""
        if not isinstance(self.fault, Refuse | Lie):
            return True
        return len(frame.data) >= 4 and is_initiate(frame.data[0])

    def alter(self, transit: Transit) -> list[Transit]:
        """Return what a FrameFault makes of a frame on its way."""
        fault = self.fault
        assert isinstance(fault, FrameFault)
        if not fault.to or transit.only == fault.to:
            return self._altered(fault, transit)
        if transit.only or fault.to in transit.but:
            return [transit]
        return [transit._replace(but=transit.but | {fault.to}), *self._altered(fault, transit._replace(only=fault.to))]

    def _altered(self, fault: FrameFault, transit: Transit) -> list[Transit]:
        frame, at = transit.frame, transit.at
        match fault:
            case Lose():
                return [transit._replace(fate="lost")]
            case Copy(later=later):
                return [transit, transit._replace(at=at + later, is_loose=True, fate="copy")]
            case Delay(by=by):
                return [transit._replace(at=at + by, is_late=True, fate="late")]
            case Reorder(by=by, gateway=gateway):
                return [transit._replace(at=at + by, is_loose=True, fate=f"out of order behind {gateway}")]
            case Corrupt(flip=flip):
                return [transit._replace(frame=self._corrupted(frame, flip), fate="corrupted")]
            case Replace(data=data):
                return [transit._replace(frame=Frame(frame.can_id, data, frame.flags), fate="replaced")]
            case _:
                raise LocalProtocolError(f"{fault} is no fault that a World knows")

    def _corrupted(self, frame: Frame, flip: bytes) -> Frame:
        data = frame.data
        if frame.key & KEY_REMOTE or not data:
            return frame
        bits = int.from_bytes(flip[: len(data)].ljust(len(data), b"\0")) or 1 << self._draws.between(0, 8 * len(data) - 1)
        return Frame(frame.can_id, (int.from_bytes(data) ^ bits).to_bytes(len(data)), frame.flags)

    def answer(self, request: Frame, names: Names) -> Frame:
        """Return what a device answers to an SDO request in the place of its own answer."""
        fault = self.fault
        index, subindex = split_mux(mux_in(request.data))
        if isinstance(fault, Refuse):
            data = pack_initiate(ABORT, index, subindex, fault.code)
        else:
            assert isinstance(fault, Lie)
            if REQUESTS[request.data[0]] is SdoFrame.BLOCK_UPLOAD:
                data = pack_initiate(ABORT, index, subindex, AbortCode.INVALID_COMMAND)  # then it is asked without blocks
            else:
                value = self._told(fault, names)
                data = pack_expedited(INITIATE_UPLOAD_RESPONSE | EXPEDITED_BITS[len(value)], index, subindex, value)
        return Frame(request.can_id - SDO_CLIENT_TO_SERVER + SDO_SERVER_TO_CLIENT, data)


def _patterns_of(fault: Fault) -> Iterable[Pattern]:
    match fault:
        case FrameFault(on=on):
            return (as_pattern(on),)
        case Sudden(on=on):
            return () if on is None else (as_pattern(on),)
        case Refuse(node_id=node_id, key=None):
            return (sdo_request(node_id),)
        case Refuse(node_id=node_id, key=key) if key is not None:
            return (sdo_read(node_id, key), sdo_write(node_id, key))
        case Lie(node_id=node_id, key=key):
            return (sdo_read(node_id, key),)
        case _:
            raise LocalProtocolError(f"{fault} is no fault that a World knows")
