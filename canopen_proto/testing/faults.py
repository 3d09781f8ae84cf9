"""Faults as values: what goes wrong on a bus, and when. A World takes any number of them, and they work together.

    Lose(sdo_answer(5), nth=3)                        the third SDO answer of node 5 is lost
    Delay(heartbeat(5), by=2 * SECOND, chance=0.1)    one heartbeat in ten comes 2 s late
    Refuse(5, "controlword", AbortCode.LOCAL_CONTROL) node 5 refuses each access to its controlword
    Pause(5, at=1 * SECOND, lasts=300 * MILLISECOND)  node 5 does nothing for 300 ms
    Reset(5, on=nmt("start", 5))                      node 5 starts again as soon as it is started

Which frames or moments: `nth` (the first is 1; one number or several), `chance` (drawn with the seed of the world, and with
numbers of its own for each fault), `when` (a function of the frame), `since` and `until` (times of the world, ns), `bus`. All
that are given must hold. `nth` counts the frames that fit the pattern between `since` and `until`, before `chance` and `when`.

What a CAN bus itself can do to a frame: `Lose` at one receiver, `Copy`, and any `Delay`, which keeps the order of frames with one
identifier. `Corrupt`, `Reorder` and `Copy(later=...)` need a gateway, or a faulty adapter or device: no CAN does so.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, fields
from typing import ClassVar, Final, TypeAlias

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Time, check_node_id
from canopen_proto.testing.patterns import Pattern, any_frame, as_pattern, key_text
from canopen_proto.testing.times import nanoseconds

ANY_FRAME: Final = any_frame()
MAX_DATA: Final = 8
"""Bytes of a frame."""

Positions: TypeAlias = int | Collection[int]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What all faults have; see this module's text. Raises LocalProtocolError for a chance outside 0..1, a position below 1, a
    time below 0."""

    nth: Positions = ()
    chance: float = 1.0
    when: Callable[[Frame], bool] | None = None
    since: Time = 0
    until: Time = NEVER
    bus: str = ""
    _in_subject: ClassVar[Collection[str]] = ()
    """Fields that `subject` says."""

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        for each in fields(self):
            self._check(each.name, optional=each.default is None)
        if not isinstance(self.chance, int | float) or not 0 <= self.chance <= 1:
            raise LocalProtocolError(f"a chance is 0 to 1, not {self.chance!r}")
        if self.when is not None and not callable(self.when):
            raise LocalProtocolError(f"when is a function of a frame, not {self.when!r}")
        if isinstance(self.nth, str | bool) or not isinstance(self.nth, int | Collection):
            raise LocalProtocolError(f"nth is a number from 1 on, or several: nth=3, nth=(1, 3), not nth={self.nth!r}")
        if any(not isinstance(number, int) or number < 1 for number in self.positions):
            raise LocalProtocolError(f"the first frame is number 1: nth={self.nth!r}")

    def __str__(self) -> str:
        """Return the fault for people: "Lose an SDO answer of node 5, nth=3"."""
        more = [
            each.name for each in fields(self) if each.name not in self._in_subject and getattr(self, each.name) != each.default
        ]
        said = [f"{name}={_said(name, getattr(self, name))}" for name in more]
        return ", ".join([f"{type(self).__name__} {self.subject}".strip(), *said])

    @property
    def subject(self) -> str:
        """Return what it is about, for people."""
        return ""

    @property
    def positions(self) -> Collection[int]:
        """The numbers of the frames that are hit; empty: all."""
        return (self.nth,) if isinstance(self.nth, int) else self.nth

    def _check(self, name: str, *, optional: bool) -> None:
        """Check a field whose name tells what it holds: a time (ns), a node-ID, bytes of a frame. optional: it may be None."""
        __tracebackhide__ = True
        value = getattr(self, name)
        if optional and value is None:
            return
        if name in _TIMES:
            object.__setattr__(self, name, nanoseconds(value, f"{name} of {type(self).__name__}"))
        elif name == "node_id":
            check_node_id(value)
        elif name in _BYTES:
            _check_data(name, value)


# ---- what happens to frames ----


@dataclass(frozen=True)
class FrameFault(Fault):
    """Something happens to the frames that are meant. to: only at this receiver, a node-ID; 0: at all of them."""

    on: Pattern | Frame | str = ANY_FRAME
    to: int = 0
    _in_subject = ("on",)

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        super().__post_init__()
        object.__setattr__(self, "on", as_pattern(self.on))
        if self.to != 0:
            check_node_id(self.to)

    @property
    def subject(self) -> str:
        return str(self.on)


@dataclass(frozen=True)
class Lose(FrameFault):
    """The frame does not come. At one receiver, as when its receive buffer was full, or at all, as at a gateway."""


@dataclass(frozen=True)
class Copy(FrameFault):
    """The frame comes once more: right behind itself, or `later` by so many ns.

    A CAN controller repeats a frame whose last bit was disturbed.
    """

    later: Time = 0


@dataclass(frozen=True)
class Delay(FrameFault):
    """The frame comes late, by so many ns, and so do those behind it that have its identifier: an answer that is too late."""

    by: Time = SECOND


@dataclass(frozen=True)
class Reorder(FrameFault):
    """The frame comes late, by so many ns, and those behind it overtake it, also those with its identifier. Only a gateway does
    so, and a CAN bus never: gateway says which one the frame passes, for people."""

    by: Time = 10 * MILLISECOND
    gateway: str = ""

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        super().__post_init__()
        if not self.gateway:
            raise LocalProtocolError(
                "a CAN bus and its controllers keep the order of frames with one identifier, and only a gateway does not. "
                'Which one do the frames pass? Reorder(..., gateway="CAN to Ethernet"). Without one, a late frame is a Delay'
            )


@dataclass(frozen=True)
class Corrupt(FrameFault):
    """The data of the frame are changed. flip: the bits to change, from the first byte on; b"": one bit, drawn with the seed.

    The CRC of CAN finds what a cable does; this is a gateway, or the memory of a device.
    """

    flip: bytes = b""


@dataclass(frozen=True)
class Replace(FrameFault):
    """The frame has other data: the device answers something else. data: 0 to 8 bytes."""

    data: bytes = b""


# ---- what devices do ----


@dataclass(frozen=True)
class Refuse(Fault):
    """A device answers the SDO requests that read or write an object with an abort, and does not execute them.

    key: the object; None: any. code: the abort code, 32 bits.
    """

    node_id: int
    key: Key | None = None
    code: int = AbortCode.GENERAL_ERROR
    _in_subject = ("node_id", "key")

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        super().__post_init__()
        if not isinstance(self.code, int) or not 0 <= self.code < 1 << 32:
            raise LocalProtocolError(f"an abort code is a number of 32 bits, such as AbortCode.LOCAL_CONTROL, not {self.code!r}")

    @property
    def subject(self) -> str:
        return f"{'each object' if self.key is None else key_text(self.key)} of node {self.node_id}"


@dataclass(frozen=True)
class Lie(Fault):
    """A device answers the SDO reads of an object with this value, and does not look: it lies about its identity, for one.

    key: the object, of at most four bytes.
    """

    node_id: int
    key: Key
    value: Value
    _in_subject = ("node_id", "key")

    @property
    def subject(self) -> str:
        return f"about {key_text(self.key)} of node {self.node_id}"


@dataclass(frozen=True, kw_only=True)
class Sudden(Fault):
    """Something that happens at a moment: at the time `at` (ns), or when a frame is on the bus that fits `on`; then `nth`,
    `chance` and `when` count. With neither, it happens at the start."""

    on: Pattern | Frame | str | None = None
    at: Time | None = None

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        super().__post_init__()
        if self.on is not None and self.at is not None:
            raise LocalProtocolError("a fault happens at a time or on a frame: give `at` or `on`, not both")
        if self.on is not None:
            object.__setattr__(self, "on", as_pattern(self.on))


@dataclass(frozen=True)
class NodeFault(Sudden):
    """Something that a device does at a moment. node_id: 1..127."""

    node_id: int
    _in_subject = ("node_id",)

    @property
    def subject(self) -> str:
        return f"node {self.node_id}"


@dataclass(frozen=True)
class Pause(NodeFault):
    """A device does nothing for so many ns: frames wait for it, its own are late. NEVER: for good, as one whose program hangs or
    whose cable is pulled."""

    lasts: Time = NEVER


@dataclass(frozen=True)
class Reset(NodeFault):
    """A device starts again by itself, as by its watchdog: its values are those of power-on, it sends a boot-up."""


@dataclass(frozen=True)
class BusOff(NodeFault):
    """The CAN controller of a device goes bus-off for so many ns: nothing comes in or out, and the device knows it."""

    lasts: Time = SECOND


@dataclass(frozen=True)
class SecondMaster(Sudden):
    """Another master on the bus sends frames. frames: one or several, as candump writes them; one each `apart` ns."""

    frames: str | tuple[str, ...] = ()
    apart: Time = MILLISECOND
    _in_subject = ("frames",)

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        super().__post_init__()
        if not self.frames:
            raise LocalProtocolError('what does the second master send? SecondMaster("000#0200")')
        for text in self.texts:
            Frame.parse(text)

    @property
    def subject(self) -> str:
        return " ".join(self.texts)

    @property
    def texts(self) -> tuple[str, ...]:
        """The frames."""
        return (self.frames,) if isinstance(self.frames, str) else self.frames


_TIMES: Final = ("since", "until", "at", "by", "later", "lasts", "apart")
_BYTES: Final = ("flip", "data")


def _said(name: str, value: object) -> str:
    """Return the value of a field for people."""
    if name in _TIMES and isinstance(value, int):
        return f"{value / SECOND:g} s"
    if name == "code" and isinstance(value, int):
        return f"0x{value:08X}"
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    return str(getattr(value, "__qualname__", value))


def _check_data(name: str, data: bytes) -> None:
    __tracebackhide__ = True
    if not isinstance(data, bytes | bytearray):
        raise LocalProtocolError(f"{name} is bytes, such as {name}=bytes(8), not {data!r}")
    if len(data) > MAX_DATA:
        raise LocalProtocolError(f"{name} has {len(data)} bytes; a CAN frame has {MAX_DATA} at most")
