"""`virtual:NAME`: a CAN bus inside this process, for any number of participants.

It has no thread, socket or clock, so tests and demonstrations run in virtual time (trio's MockClock). Every frame reaches every
member but its sender, in one order for all. Members of one name meet only within one run of trio or asyncio; another run, even in
another thread of this process, has its own buses. (For two processes, use `udp_multicast`.)

Bit rate, arbitration and acknowledge are left out. A frame that is sent with nobody else on the bus vanishes, where a real
controller would repeat it for ever. With options (`virtual:NAME?bitrate=500k&loss=0.001&seed=7`) the bus has all of these, and
faults: see virtual_wire.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_transports.errors import Report, bad_locator
from canopen_transports.locator import Option
from canopen_transports.loop import AsyncResource, RunVar, current_loop
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame
from canopen_transports.virtual_wire import WireTransport, open_wire

MAX_PUSHED: Final = 64
"""Frames that are pushed in a row. Later ones wait in the queues, so that other tasks have their turn."""

_StandIn: TypeAlias = "Callable[[str], VirtualLine]"

_buses: RunVar[dict[str, VirtualLine]] = RunVar(dict)  # those of this run that have no physics
_stand_in: RunVar[_StandIn | None] = RunVar(lambda: None)


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


class VirtualTransport(AsyncResource):
    """A member of the in-process bus of this name until `aclose`. Must be made where trio or asyncio runs.

    queue_size: how many frames can wait for this member; if more come, they are lost, with a ReceiveOverrun. Time stamps are
    the loop's clock in ns, the same for all members.
    """

    def __init__(self, name: str, queue_size: int = RECEIVE_QUEUE_SIZE) -> None:
        self.locator = f"virtual:{name}"
        self._name = name
        self._closed = False
        self._loop = current_loop()
        self._clock = self._loop.clock()
        self._queue = ReceiveQueue(self.locator, queue_size)
        self._receiver: Callable[[Frame, Time], None] | None = None
        names = _buses.get()
        if name not in names:
            stands_in = _stand_in.get()
            names[name] = VirtualLine() if stands_in is None else stands_in(name)
        self._line = names[name]
        self._line.join(self)

    async def send(self, frame: Frame) -> None:
        """Queue the frame for every other member. Never waits: CAN has no back-pressure."""
        check_frame(frame)
        await self._loop.checkpoint_if_cancelled()
        self._hand_over(frame)
        # The frame is sent, so a cancel must not be reported here: it would tell the caller that it is not.
        await self._loop.cancel_shielded_checkpoint()

    def send_nowait(self, frame: Frame) -> bool:
        """Queue the frame for every other member, without letting other tasks run. Always True: there is always room."""
        check_frame(frame)
        self._hand_over(frame)
        return True

    def _hand_over(self, frame: Frame) -> None:
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        self._line.carry(self, frame, round(self._clock() * 1e9))

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
        await self._loop.checkpoint()


async def open_virtual(
    locator: str, name: str, bitrate: int | None, options: Mapping[str, Option]
) -> VirtualTransport | WireTransport:
    """Open one more member of the bus of this name: with physics if there are options, or if the bus has it already.

    Raises TransportError (CO100) for options that are not valid, or that come when the bus is open without any.
    """
    if name in _buses.get() and (options or bitrate is not None):
        seen = f"a bus virtual:{name} without options is open already"
        raise bad_locator(locator, seen, ("the same options for its first member", "another name"))
    member = await open_wire(locator, name, bitrate, options)
    return VirtualTransport(name) if member is None else member


def stand_in(line: Callable[[str], VirtualLine]) -> None:
    """Let every bus that is opened from now on in this run, whatever its locator, be one in this process, of such lines; but not
    a recording (`file:`).

    For simulations of the world around a program: no adapter is touched. line: makes the line of a bus by its name, which is the
    channel of its locator.
    """
    _stand_in.set(line)


def has_stand_in() -> bool:
    """Whether `stand_in` was called in this run."""
    return _stand_in.get() is not None
