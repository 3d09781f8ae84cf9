"""`tcp:HOST:PORT`: a member of the bus of `canopen bus serve`, which runs in any process on any computer.

`framing` defines the protocol. Frames have no time stamps: the bus exists only in the server's memory, and the client cannot
measure when a frame was there. If the connection ends, the transport ends with a TransportError (CO111), because frames of the
meantime are lost. To continue, open the bus again and start over.
"""

from __future__ import annotations

import socket
from collections import deque
from typing import Final

from canopen_proto.frame import Frame
from canopen_transports.errors import NOT_ACKNOWLEDGED, ReceiveOverrun, Report, TransportError
from canopen_transports.loop import AsyncResource, StreamSocket, current_loop
from canopen_transports.tcp.address import cannot_connect, connection_lost, no_bus_server, parse_address
from canopen_transports.tcp.framing import HELLO, Bye, FramingError, LineSplitter, Lost, decode, encode, shown
from canopen_transports.transport import Received, check_frame

CONNECT_TIME: Final = 5.0
"""Seconds after which a computer that does not answer counts as missing."""
HELLO_TIME: Final = 3.0
"""Seconds that a server may take to say hello."""
ROOM_TIME: Final = 1.0
"""Seconds that a sender waits while the server takes nothing. The server always reads, so it or the network has stopped."""
READ_SIZE: Final = 1 << 16
KEEP_ALIVE: Final = (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))
"""Seconds, seconds, tries: within half a minute we notice that the other computer was switched off."""

_SERVER_GONE: Final = "the bus server was ended, or it cut us off because we took frames too slowly"


class TcpTransport(AsyncResource):
    """A member of a bus server's bus. Made by `open_tcp`."""

    def __init__(self, locator: str, sock: StreamSocket, lines: LineSplitter, waiting: list[bytes]) -> None:
        self._loop = current_loop()
        self.locator = locator
        self._socket = sock
        self._lines = lines
        self._waiting = deque(waiting)  # lines; bounded, as nothing is read while lines wait
        self._failure: TransportError | None = None
        self._closed = False
        self._send_lock = self._loop.lock()

    async def send(self, frame: Frame) -> None:
        """Hand the frame to the server. Waits up to ROOM_TIME until the server takes it, then raises TransportError (CO110)."""
        check_frame(frame)
        line = encode(frame)
        async with self._send_lock:
            self._check_open()
            try:
                with self._loop.move_on_after(ROOM_TIME) as limit:
                    sent = await self._socket.send(line)  # if cancelled, it has sent nothing
                if limit.cancelled_caught:
                    raise self._stuck(frame)
                if sent < len(line):
                    await self._finish(frame, line[sent:])
            except self._loop.ClosedResourceError:
                raise self._end() from None
            except OSError as error:
                raise self._lose("send", str(error), _SERVER_GONE) from error

    async def receive(self) -> Received | Report:
        """Return the next frame of another member; a ReceiveOverrun if the server had to drop frames for us."""
        await self._read()
        return self._next()

    async def receive_many(self, limit: int) -> list[Received | Report]:
        await self._read()
        taken: list[Received | Report] = []
        while self._waiting and len(taken) < limit:
            try:
                taken.append(self._next())
            except TransportError:
                if not taken:
                    raise
                break  # the connection has ended; the next call raises it again
        return taken

    async def _read(self) -> None:
        """Wait until a line is there."""
        await self._loop.checkpoint()
        while not self._waiting:
            self._check_open()
            try:
                chunk = await self._socket.recv(READ_SIZE)
            except self._loop.ClosedResourceError:
                raise self._end() from None
            except OSError as error:
                raise self._lose("receive", str(error), _SERVER_GONE) from error
            if not chunk:
                raise self._lose("receive", "the connection was closed", _SERVER_GONE)
            self._waiting.extend(self._lines.feed(chunk))
        self._check_open()

    async def aclose(self) -> None:
        if not self._closed:
            self._closed = True
            self._socket.close()
        await self._loop.checkpoint()

    def _next(self) -> Received | Report:
        try:
            item = decode(self._waiting.popleft())
        except FramingError as error:
            raise self._lose(
                "receive", str(error), "the program that listens there is not a bus server of this version"
            ) from error
        if isinstance(item, Frame):
            return item, None
        if isinstance(item, Lost):
            return ReceiveOverrun(self.locator, item.frames, "the bus server's queue for us was full")
        raise self._lose("receive", f"the bus server says: {item.reason}", "")

    async def _finish(self, frame: Frame, rest: bytes) -> None:
        """Send the rest of a line. A line that was begun must be ended, or the server cannot read the next one."""
        with self._loop.cancel_scope(shield=True, deadline=self._loop.current_time() + ROOM_TIME) as limit:
            while rest:
                rest = rest[await self._socket.send(rest) :]
        if limit.cancelled_caught:
            raise self._lose(f"send {frame}", "the bus server took only a part of the frame", "it is stopped, or overloaded")

    def _stuck(self, frame: Frame) -> TransportError:
        return TransportError(
            NOT_ACKNOWLEDGED,
            self.locator,
            f"cannot send {frame} on {self.locator}",
            seen=f"the bus server has taken nothing for {ROOM_TIME:g} s",
            cause="it is stopped (Ctrl-Z, a debugger), or the network is overloaded",
            tries=("look at the terminal with `canopen bus serve`",),
        )

    def _check_open(self) -> None:
        if self._closed or self._failure is not None:
            raise self._end()

    def _end(self) -> Exception:
        """Return why the transport has ended: we closed it, or the connection was lost."""
        if self._closed or self._failure is None:
            return self._loop.ClosedResourceError(f"{self.locator} was closed")
        return self._failure

    def _lose(self, doing: str, seen: str, cause: str) -> Exception:
        """Give up the connection, and return why. Closing is needed: a server that is about to end waits for it."""
        if self._failure is None:
            self._failure = connection_lost(self.locator, doing, seen, cause)
        self._socket.close()
        return self._end()


async def open_tcp(locator: str, channel: str) -> TcpTransport:
    """Join the bus of a bus server. Raises TransportError: CO100, CO101. If cancelled, nothing stays open. channel: host and
    port, as "localhost:20301"."""
    host, port = parse_address(locator, channel)
    try:
        with current_loop().move_on_after(CONNECT_TIME) as limit:
            sock = await current_loop().connect_tcp(host, port)
    except (OSError, UnicodeError) as error:
        raise cannot_connect(locator, host, port, error) from error
    if limit.cancelled_caught:
        raise cannot_connect(locator, host, port, TimeoutError())
    try:
        keep_alive(sock)
        lines = LineSplitter()
        received = await _greet(sock, lines)
        first, *rest = received or [b""]
        if first != HELLO:
            raise no_bus_server(locator, host, port, _greeting_seen(first))
    except BaseException:
        sock.close()
        raise
    return TcpTransport(locator, sock, lines, rest)


async def _greet(sock: StreamSocket, lines: LineSplitter) -> list[bytes]:
    """Say hello; return the first lines of the answer, or none."""
    received: list[bytes] = []
    with current_loop().move_on_after(HELLO_TIME):
        try:
            await sock.send(HELLO + b"\n")
            while not received:
                chunk = await sock.recv(READ_SIZE)
                if not chunk:
                    break
                received = lines.feed(chunk)
        except OSError:  # the server closed the connection: no answer
            pass
    return received


def _greeting_seen(first: bytes) -> str:
    try:
        item = decode(first)
    except FramingError:
        item = None
    if isinstance(item, Bye):
        return f"the bus server says: {item.reason}"
    return (
        f"the program that listens there says {shown(first)}, not hello"
        if first
        else "the program that listens there says nothing"
    )


def keep_alive(sock: StreamSocket) -> None:
    """Make the system notice that the other computer is gone."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEP_ALIVE:
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
