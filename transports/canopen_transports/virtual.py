"""`virtual:NAME`: a CAN bus inside this process, for any number of participants.

It is pure trio, without thread, socket or clock, so tests and demonstrations run in virtual time (trio's MockClock). Every frame
reaches every member but its sender, in one order for all. Members of one name meet only within one `trio.run`; another run, even
in another thread of this process, has its own buses. (For two processes, use `udp_multicast`.)

Bit rate, arbitration and acknowledge are left out. A frame that is sent with nobody else on the bus vanishes, where a real
controller would repeat it for ever. With options (`virtual:NAME?bitrate=500k&loss=0.001&seed=7`) the bus has all of these, and
faults: see virtual_wire.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import trio

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_transports.errors import Report, bad_locator
from canopen_transports.locator import Option
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame
from canopen_transports.virtual_wire import WireTransport, open_wire

MAX_PUSHED: Final = 64
"""Frames that are pushed in a row. Later ones wait in the queues, so that other tasks have their turn."""

_buses: trio.lowlevel.RunVar[dict[str, VirtualLine]] = trio.lowlevel.RunVar("canopen_transports virtual buses")
_stand_in: trio.lowlevel.RunVar[Callable[[str], VirtualLine] | None] = trio.lowlevel.RunVar("stand-in for all buses", None)


class VirtualLine:
    """The part of a bus that its members share: the list of members, and the frames under way."""

    def __init__(self) -> None:
        self.members: tuple[VirtualTransport, ...] = ()
        self._under_way: list[tuple[VirtualTransport, Frame, Time]] = []

    def join(self, member: VirtualTransport) -> None:
        """Add a member."""
        self.members += (member,)

    def leave(self, member: VirtualTransport) -> None:
        """Remove a member."""
        self.members = tuple(each for each in self.members if each is not member)

    def carry(self, sender: VirtualTransport, frame: Frame, now: Time) -> None:
        """Hand a frame to all members but its sender, then the frames that their receivers send meanwhile: one order for all."""
        under_way = self._under_way
        under_way.append((sender, frame, now))
        if len(under_way) > 1:
            return  # a receiver sends: the loop of the outer call hands its frame over
        try:
            for sender, frame, now in under_way:
                for member in self.members:
                    if member is not sender:
                        member.take(frame, now, len(under_way) <= MAX_PUSHED)
        finally:
            under_way.clear()


class VirtualTransport(trio.abc.AsyncResource):
    """A member of the in-process bus of this name until `aclose`. Must be made inside a `trio.run`.

    queue_size: how many frames can wait for this member; if more come, they are lost, with a ReceiveOverrun. Time stamps are
    trio's clock in ns, the same for all members.
    """

    def __init__(self, name: str, queue_size: int = RECEIVE_QUEUE_SIZE) -> None:
        self.locator = f"virtual:{name}"
        self._name = name
        self._closed = False
        self._clock = trio.lowlevel.current_clock()
        self._queue = ReceiveQueue(self.locator, queue_size)
        self._receiver: Callable[[Frame, Time], None] | None = None
        names = _names()
        if name not in names:
            names[name] = (_stand_in.get() or _new_line)(name)
        self._line = names[name]
        self._line.join(self)

    async def send(self, frame: Frame) -> None:
        """Queue the frame for every other member. Never waits: CAN has no back-pressure."""
        check_frame(frame)
        await trio.lowlevel.checkpoint_if_cancelled()
        self._hand_over(frame)
        # The frame is sent, so a cancel must not be reported here: it would tell the caller that it is not.
        await trio.lowlevel.cancel_shielded_checkpoint()

    def send_nowait(self, frame: Frame) -> bool:
        """Queue the frame for every other member, without letting other tasks run. Always True: there is always room."""
        check_frame(frame)
        self._hand_over(frame)
        return True

    def _hand_over(self, frame: Frame) -> None:
        if self._closed:
            raise trio.ClosedResourceError(f"{self.locator} was closed")
        self._line.carry(self, frame, round(self._clock.current_time() * 1e9))

    def take(self, frame: Frame, now: Time, at_once: bool) -> None:
        """Push a frame to the receiver, or queue it if there is no receiver or earlier frames wait."""
        if at_once and self._receiver is not None and self._queue.is_empty():
            self._receiver(frame, now)
        else:
            self._queue.put((frame, now))
            self._queue.wake()

    def push_to(self, receiver: Callable[[Frame, Time], None] | None) -> None:
        """Call `receiver` with each frame, MAX_PUSHED in a row, until None is given."""
        self._receiver = receiver

    async def receive(self) -> Received | Report:
        return await self._queue.get()

    async def receive_many(self, limit: int) -> list[Received | Report]:
        return await self._queue.get_many(limit)

    def receive_nowait(self, limit: int) -> list[Received | Report]:
        """Return what other members have sent."""
        return self._queue.take_many(limit)

    async def aclose(self) -> None:
        """Leave the bus. The last member to leave ends it."""
        if not self._closed:
            self._closed = True
            self._receiver = None
            self._line.leave(self)
            if not self._line.members:
                del _buses.get()[self._name]
            self._queue.close()
        await trio.lowlevel.checkpoint()


async def open_virtual(
    locator: str, name: str, bitrate: int | None, options: Mapping[str, Option]
) -> VirtualTransport | WireTransport:
    """Open one more member of the bus of this name: with physics if there are options, or if the bus has it already.

    Raises TransportError (CO100) for options that are not valid, or that come when the bus is open without any.
    """
    plain = _names()
    if name in plain and (options or bitrate is not None):
        seen = f"a bus virtual:{name} without options is open already"
        raise bad_locator(locator, seen, ("the same options for its first member", "another name"))
    member = await open_wire(locator, name, bitrate, options)
    return VirtualTransport(name) if member is None else member


def stand_in(line: Callable[[str], VirtualLine]) -> None:
    """Let every bus that is opened from now on in this `trio.run`, whatever its locator, be one in this process, of such lines;
    but not a recording (`file:`).

    For simulations of the world around a program: no adapter is touched. line: makes the line of a bus by its name, which is the
    channel of its locator.
    """
    _stand_in.set(line)


def has_stand_in() -> bool:
    """Whether `stand_in` was called in this `trio.run`."""
    return _stand_in.get() is not None


def _new_line(name: str) -> VirtualLine:
    return VirtualLine()


def _names() -> dict[str, VirtualLine]:
    """Return the buses of this run that have no physics."""
    try:
        return _buses.get()
    except LookupError:
        _buses.set({})
        return _buses.get()
