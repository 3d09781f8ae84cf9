"""The bus server of `canopen bus serve`: a frame of one member goes to all the others, in one order for all.

It trusts nobody. A connection becomes a member by its hello (see `framing`), which must come within HELLO_TIME. Then:

- A line that is not a frame ends the connection; so does a line that is not ended within HALF_LINE_TIME.
- A member that takes its frames too slowly loses some; the server tells it how many and where (`lost`). A member that takes none
  for STALL_TIME is cut off.
- The server tells a member why it is cut off (`bye`), if the member takes that within FAREWELL_TIME.
- At most MAX_CONNECTIONS exist at a time, each with a bounded queue. As many more are told so; others are closed at once.

Left out: names and passwords (it listens on loopback unless its user decides otherwise), bit rate and arbitration.

`Outgoing` is the bounded queue of lines for one member; it marks lost lines at their place.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Final

import trio

from canopen_proto.frame import Frame
from canopen_transports.tcp.address import address_text, cannot_listen
from canopen_transports.tcp.client import keep_alive
from canopen_transports.tcp.framing import HELLO, FramingError, LineSplitter, bye_line, checked, decode, lost_line, shown

QUEUE_SIZE: Final = 8192
"""Lines, as many as a receive queue has frames: one second of a fully loaded 1 Mbit/s bus. The system's own buffers come on top;
on Linux they hold some megabytes."""
BATCH: Final = 512
"""Lines that are written at once: some 10 KB."""


class Outgoing:
    """Lines for one member. One `lost` line marks a loss at its place, however many lines are missing there. size: how many lines
    it holds."""

    def __init__(self, size: int = QUEUE_SIZE) -> None:
        self._size = size
        self._lines: deque[bytes] = deque()
        self._lost = 0

    def __bool__(self) -> bool:
        return bool(self._lines or self._lost)

    def put(self, line: bytes) -> None:
        """Add a line with its end, or count it as lost."""
        if len(self._lines) >= self._size:
            self._lost += 1
            return
        if self._lost:
            self._lines.append(lost_line(self._lost))
            self._lost = 0
        self._lines.append(line)

    def end(self, reason: str) -> None:
        """Replace what waits by the reason why the member is cut off."""
        self._lines.clear()
        self._lost = 0
        self._lines.append(bye_line(reason))

    def take(self) -> bytes:
        """Return the bytes to write next."""
        lines = self._lines
        taken = list(islice(lines, BATCH))
        for _ in taken:
            lines.popleft()
        if self._lost and not lines:
            taken.append(lost_line(self._lost))
            self._lost = 0
        return b"".join(taken)


MAX_CONNECTIONS: Final = 64
"""More processes than anyone runs on one bus; with full queues they take some 16 MB."""
HELLO_TIME: Final = 20.0
"""Seconds. A program says hello at once, a person with `nc` types it."""
HALF_LINE_TIME: Final = 5.0
"""Seconds. A terminal sends whole lines."""
STALL_TIME: Final = 5.0
"""Seconds in which a member takes nothing at all, though the system's buffers are full."""
FAREWELL_TIME: Final = 3.0
"""Seconds in which a member must take the reason."""
READ_SIZE: Final = 4096
"""Bytes: at most some 800 frames; then the other members have their turn."""

Tell = Callable[[str], object]


class _Member:
    def __init__(self, name: str, queue_size: int) -> None:
        self.name = name
        self.out = Outgoing(queue_size)
        self.work = trio.lowlevel.ParkingLot()
        self.scope = trio.CancelScope()  # of all its tasks
        self.reading = trio.CancelScope()
        self.deadline = math.inf  # for its hello, or for the end of a line
        self.writing_since = math.inf
        self.reason = ""
        """Why it is cut off; "" as long as it is not."""

    def put(self, line: bytes) -> None:
        self.out.put(line)
        self.work.unpark_all()

    def cut_off(self, reason: str) -> None:
        """Send the reason and nothing else, and do not read from the member any longer."""
        if not self.reason:
            self.reason = reason
            self.out.end(reason)
            self.work.unpark_all()
            self.reading.cancel()
            self.scope.deadline = trio.current_time() + FAREWELL_TIME


class BusServer:
    """One bus. tell: called with news for people. on_frame: called with each frame. queue_size: lines for each member."""

    def __init__(
        self, tell: Tell = lambda text: None, on_frame: Callable[[Frame], object] | None = None, *, queue_size: int = QUEUE_SIZE
    ) -> None:
        self._tell = tell
        self._on_frame = on_frame
        self._queue_size = queue_size
        self._connections: set[_Member] = set()
        self._members: dict[_Member, None] = {}  # in the order in which they came

    @property
    def members(self) -> int:
        """How many members the bus has."""
        return len(self._members)

    async def watch(self) -> None:
        """Cut off members that stall. Runs beside `serve`; never returns."""
        while True:
            await trio.sleep(1.0)
            now = trio.current_time()
            for member in self._connections:
                if now >= member.writing_since + STALL_TIME:
                    member.cut_off(f"you have taken no frame for {STALL_TIME:g} s, though many wait for you")
                elif now >= member.deadline:
                    what = "the line that you began has no end" if member in self._members else _expected(None)
                    member.cut_off(what)

    async def serve(self, stream: trio.abc.HalfCloseableStream, name: str) -> None:
        """Serve one connection until it ends. name: what the news calls it."""
        if len(self._connections) >= 2 * MAX_CONNECTIONS:
            await trio.aclose_forcefully(stream)
            return
        member = _Member(name, self._queue_size)
        member.deadline = trio.current_time() + HELLO_TIME
        if len(self._connections) >= MAX_CONNECTIONS:
            member.cut_off(f"the bus server has {MAX_CONNECTIONS} connections already")
        self._connections.add(member)
        try:
            with member.scope:
                async with stream, trio.open_nursery() as nursery:
                    nursery.start_soon(self._write, member, stream)
                    await self._read(member, stream)
                    if not member.reason:  # it left
                        nursery.cancel_scope.cancel()
        finally:
            self._connections.discard(member)
            self._leave(member)

    def end(self, reason: str) -> None:
        """Cut all members off. Their connections end within FAREWELL_TIME. reason: they are told."""
        for member in self._connections:
            member.cut_off(reason)

    def _leave(self, member: _Member) -> None:
        if member in self._members:
            del self._members[member]
            self._tell(f"{member.name} left" + (f", cut off: {member.reason}" if member.reason else ""))
        elif member.reason:
            self._tell(f"{member.name} turned away: {member.reason}")

    async def _read(self, member: _Member, stream: trio.abc.HalfCloseableStream) -> None:
        lines = LineSplitter()
        with member.reading:
            while not member.reason:
                try:
                    chunk = await stream.receive_some(READ_SIZE)
                except trio.BrokenResourceError:
                    return
                if not chunk:
                    return
                self._take(member, lines.feed(bytes(chunk)))
                if member in self._members:
                    if not lines.pending:
                        member.deadline = math.inf
                    elif b"\n" in chunk or member.deadline == math.inf:
                        member.deadline = trio.current_time() + HALF_LINE_TIME

    def _take(self, member: _Member, lines: list[bytes]) -> None:
        for line in lines:
            if member not in self._members:
                if line != HELLO:
                    member.cut_off(_expected(line))
                    return
                self._members[member] = None
                member.put(HELLO + b"\n")
                self._tell(f"{member.name} joined: {len(self._members)} on the bus")
                continue
            try:
                good = checked(line)
            except FramingError as error:
                member.cut_off(str(error))
                return
            for other in self._members:
                if other is not member and not other.reason:
                    other.put(good)
            if self._on_frame is not None:
                frame = decode(good[:-1])
                assert isinstance(frame, Frame)
                self._on_frame(frame)

    async def _write(self, member: _Member, stream: trio.abc.HalfCloseableStream) -> None:
        try:
            while True:
                while not member.out:
                    if member.reason:
                        await self._see_off(stream)
                        return
                    await member.work.park()
                member.writing_since = trio.current_time()
                await stream.send_all(member.out.take())
                member.writing_since = math.inf
        except trio.BrokenResourceError:
            member.reading.cancel()

    async def _see_off(self, stream: trio.abc.HalfCloseableStream) -> None:
        """Read to the end: closing a connection with unread bytes would discard the reason."""
        await stream.send_eof()
        while await stream.receive_some(READ_SIZE):
            pass


def _expected(line: bytes | None) -> str:
    seen = "nothing" if line is None else f"the line {shown(line)}"
    return f"this is a CAN bus: expected {HELLO.decode()!r} first, got {seen}"


async def serve_bus(
    host: str,
    port: int,
    server: BusServer,
    task_status: trio.TaskStatus[list[str]] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Listen until cancelled, then tell the members. Raises TransportError (CO101, CO102). host: the address to listen at.

    Started in a nursery it returns the locators; for port 0 they have the port that the system chose.
    """
    try:
        listeners = await trio.open_tcp_listeners(port, host=host)
    except (OSError, UnicodeError) as error:
        raise cannot_listen(host, port, error) from error

    async def handle(stream: trio.SocketStream) -> None:
        try:
            keep_alive(stream.socket)
            peer = stream.socket.getpeername()
        except OSError:  # it is gone already
            await stream.aclose()
            return
        await server.serve(stream, address_text(peer[0], peer[1]))

    over = trio.Event()
    async with trio.open_nursery() as nursery:
        connections: trio.Nursery = await nursery.start(_hold, over)
        nursery.start_soon(server.watch)
        try:
            task_status.started([f"tcp:{address_text(*each.socket.getsockname()[:2])}" for each in listeners])
            await trio.serve_listeners(handle, listeners, handler_nursery=connections)
        finally:
            server.end("the bus server was ended")
            over.set()


async def _hold(over: trio.Event, task_status: trio.TaskStatus[trio.Nursery]) -> None:
    """Hold the connections open after a cancel until their members were told; `cut_off` limits that time."""
    with trio.CancelScope(shield=True):
        async with trio.open_nursery() as connections:
            task_status.started(connections)
            await over.wait()
