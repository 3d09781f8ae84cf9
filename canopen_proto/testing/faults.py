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
from dataclasses import dataclass
from typing import Final, TypeAlias

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Time, check_node_id
from canopen_proto.testing.patterns import Pattern, any_frame

ANY_FRAME: Final = any_frame()

Positions: TypeAlias = int | Collection[int]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What all faults have; see this module's text. Raises LocalProtocolError for a chance outside 0..1, a position below 1."""

    nth: Positions = ()
    chance: float = 1.0
    when: Callable[[Frame], bool] | None = None
    since: Time = 0
    until: Time = NEVER
    bus: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.chance <= 1:
            raise LocalProtocolError(f"a chance is 0 to 1, not {self.chance}")
        if any(number < 1 for number in self.positions):
            raise LocalProtocolError(f"the first frame is number 1: nth={self.nth}")

    @property
    def positions(self) -> Collection[int]:
        """The numbers of the frames that are hit; empty: all."""
        return (self.nth,) if isinstance(self.nth, int) else self.nth


# ---- what happens to frames ----


@dataclass(frozen=True)
class FrameFault(Fault):
    """Something happens to the frames that are meant. to: only at this receiver, a node-ID; 0: at all of them."""

    on: Pattern = ANY_FRAME
    to: int = 0


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
    """The frame comes late, by so many ns, and those behind it overtake it. Only a gateway does so."""

    by: Time = 10 * MILLISECOND


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


@dataclass(frozen=True)
class Lie(Fault):
    """A device answers the SDO reads of an object with this value, and does not look: it lies about its identity, for one.

    key: the object, of at most four bytes.
    """

    node_id: int
    key: Key
    value: Value


@dataclass(frozen=True, kw_only=True)
class Sudden(Fault):
    """Something that happens at a moment: at the time `at` (ns), or when a frame is on the bus that fits `on`; then `nth`,
    `chance` and `when` count. With neither, it happens at the start."""

    on: Pattern | None = None
    at: Time | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.on is not None and self.at is not None:
            raise LocalProtocolError("a fault happens at a time or on a frame: give `at` or `on`, not both")


@dataclass(frozen=True)
class NodeFault(Sudden):
    """Something that a device does at a moment. node_id: 1..127."""

    node_id: int

    def __post_init__(self) -> None:
        super().__post_init__()
        check_node_id(self.node_id)


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
    """Another master on the bus sends frames. frames: as candump writes them; one each `apart` ns."""

    frames: tuple[str, ...] = ()
    apart: Time = MILLISECOND

    def __post_init__(self) -> None:
        super().__post_init__()
        for text in self.frames:
            Frame.parse(text)
