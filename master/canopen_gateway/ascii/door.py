"""`AsciiDoor`: the text door on TCP and on a Unix socket, for clients that may be slow, broken, or hostile.

    door = await bind_ascii_door(tcp=("127.0.0.1", 60000))       # before drives boot: a port in use stops nothing that moves
    async with open_master(...) as master, open_gateway(master) as service:
        await door.serve(service)

- It listens on this computer only, unless it is told otherwise. There is no password: whoever reaches it may do what is allowed.
- A client has one request under way at a time; more wait in its socket. One that takes no answers is cut off after
  `Limits.send_seconds`; events that it does not take are dropped, and counted.
- A line that is too long is answered by 600, and ends the connection. So does a request of HTTP: a page from anywhere may let the
  browser of this computer send what it likes to a port of this computer, and the lines of its body would be commands.
- When all places are taken, the client that has been silent longest makes room for a new one: after SILENT_FIRST seconds if it
  has never said anything, after SILENT seconds else. One that waits for events, or for an answer, keeps its place, unless it has
  closed its end meanwhile. If nobody makes room, the new one is told 600.
- Whatever happens to a connection, the others are served on. If the door itself fails, it is closed, and says why (`failure`);
  the master goes on.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import socket
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

import trio

from canopen_gateway.ascii.connection import AsciiConnection
from canopen_gateway.errors import DoorError, GatewayFullError
from canopen_gateway.limits import Limits
from canopen_gateway.listening import BACKLOG, SEND_BUFFER, address_of, open_listeners
from canopen_gateway.service import GatewayService
from canopen_master.whole_file import file_at
from canopen_proto.gateway import CANOPENNODE, Dialect, GatewayAnswer, GatewayCode, GatewayLines, print_answer
from canopen_transports.loop.beside import beside
from canopen_transports.tcp.address import is_loopback

READ_SIZE: Final = 4096
SILENT_FIRST: Final = 1.0
SILENT: Final = 30.0
MAX_REFUSED: Final = 64
"""Clients that are being told that there is no room; more are closed without a word."""
FAREWELL: Final = 1.0
"""Seconds that a client may take for its last answer."""
LOGGER: Final = logging.getLogger("canopen_gateway")
TLS_HELLO: Final = b"\x16\x03"
"""How a client begins that expects TLS; RFC 8446, 5.1."""
_HTTP: Final = re.compile(rb" HTTP/\d\.\d\r?\Z")
_BINARY: Final = re.compile(rb"[\0-\x08\x0e-\x1a\x1c-\x1f]")
"""Control characters that no text has."""


class _Client:
    """A connection, from its beginning to its end."""

    def __init__(self, stream: trio.SocketStream, name: str) -> None:
        self.stream = stream
        self.name = name
        self.scope = trio.CancelScope()
        self.gone = trio.Event()
        self.has_spoken = False
        self.is_busy = False
        self.waits_for_events = False
        self.last_heard = trio.current_time()
        self._sending = trio.Lock()

    async def send(self, data: bytes, seconds: float) -> None:
        """Send bytes, whole and in order. A client that does not take them in time is cut off."""
        async with self._sending:
            with trio.move_on_after(seconds) as limit:
                await self.stream.send_all(data)
            if limit.cancelled_caught:
                LOGGER.info("%s is cut off: it took nothing for %g s", self.name, seconds)
                self.scope.cancel()
                await trio.lowlevel.checkpoint_if_cancelled()

    def silence(self, now: float) -> float:
        """Return by how much it has been silent longer than it may, in seconds; below 0: it keeps its place. One that waits
        for an answer, and has closed its end, does not: it may still take the answer, but most such clients are gone."""
        if self.is_busy and self._has_ended():
            return float("inf")
        if self.is_busy or self.waits_for_events:
            return -1.0
        return now - self.last_heard - (SILENT if self.has_spoken else SILENT_FIRST)

    def _has_ended(self) -> bool:
        """Return whether the client has closed its end, or is gone: nobody reads its socket while a request is under way."""
        sock = self.stream.socket
        try:
            with socket.fromfd(sock.fileno(), sock.family, sock.type) as peeked:
                peeked.setblocking(False)
                return not peeked.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True


class AsciiDoor:
    """See this module's text; made by `bind_ascii_door`. addresses: where it listens, as people type it. failure: why it was
    closed, or None. refused: connections that found no room. cut_off: clients that had to make room."""

    def __init__(
        self, listeners: Iterable[trio.SocketListener], addresses: Iterable[str], unix: Path | None, dialect: Dialect
    ) -> None:
        self.addresses = tuple(addresses)
        self.failure: Exception | None = None
        self.refused = 0
        self.cut_off = 0
        self._listeners = list(listeners)
        self._unix = unix
        self._unix_file = None if unix is None else file_at(unix)
        self._dialect = dialect
        self._clients: set[_Client] = set()
        self._refusing = 0

    @property
    def clients(self) -> int:
        """How many clients are connected."""
        return len(self._clients)

    async def serve(self, service: GatewayService, begun: Callable[[], object] | None = None) -> None:
        """Serve clients until cancelled. begun: called once the door serves. Returns early only if the door itself fails; see
        `failure`."""
        async with self:
            if begun is not None:
                begun()
            try:
                async with trio.open_nursery() as connections:
                    for listener in self._listeners:
                        connections.start_soon(self._accept, listener, service, connections)
            except* OSError as failed:
                self.failure = failed.exceptions[0]
                LOGGER.warning("the text door is closed: %s", self.failure)

    async def __aenter__(self) -> AsciiDoor:
        return self

    async def __aexit__(self, *exc: object) -> None:
        with trio.CancelScope(shield=True):
            for listener in self._listeners:
                await listener.aclose()
        if self._unix is not None and file_at(self._unix) == self._unix_file:  # else another door has its socket there now
            self._unix.unlink(missing_ok=True)

    async def _accept(self, listener: trio.SocketListener, service: GatewayService, connections: trio.Nursery) -> None:
        while True:
            try:
                stream = await listener.accept()
            except OSError as error:
                if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS):
                    raise
                await trio.sleep(0.1)  # as trio.serve_listeners does: others will end
                continue
            connections.start_soon(self._handle, stream, service)

    async def _handle(self, stream: trio.SocketStream, service: GatewayService) -> None:
        """Serve one client. Nothing leaves this function: neither the door nor other clients suffer."""
        client = _Client(stream, _name_of(stream))
        try:
            with client.scope:
                async with stream:
                    await self._admit(client, service)
        except* (trio.BrokenResourceError, trio.ClosedResourceError):
            pass  # it is gone
        except* Exception:
            LOGGER.exception("the connection of %s failed", client.name)
        finally:
            self._clients.discard(client)
            client.gone.set()

    async def _admit(self, client: _Client, service: GatewayService) -> None:
        most = service.limits.sessions
        if len(self._clients) >= most:
            await self._make_room()
        if len(self._clients) >= most:
            await self._refuse(client)
            return
        self._clients.add(client)
        try:
            with service.open_session(client.name) as session:
                await self._serve(client, AsciiConnection(session, self._dialect), service.limits)
        except GatewayFullError:  # another door has taken the last place
            await self._refuse(client)

    async def _make_room(self) -> None:
        """Cut off the client that has been silent longest, if it has been so for too long."""
        now = trio.current_time()
        silent = max(self._clients, key=lambda client: client.silence(now))
        if silent.silence(now) < 0:
            return
        self.cut_off += 1
        silent.scope.cancel()
        await silent.gone.wait()

    async def _refuse(self, client: _Client) -> None:
        self.refused += 1
        if self._refusing >= MAX_REFUSED:
            return
        self._refusing += 1
        try:
            await self._part(client, GatewayCode.OUT_OF_MEMORY, "this gateway has no place for another client")
        finally:
            self._refusing -= 1

    async def _part(self, client: _Client, code: GatewayCode, remark: str) -> None:
        """Say why the connection ends; its end follows."""
        await client.send(print_answer(GatewayAnswer(0, code=code, remark=remark), self._dialect), FAREWELL)

    async def _serve(self, client: _Client, connection: AsciiConnection, limits: Limits) -> None:
        async with beside(trio.open_nursery()) as tasks:
            tasks.start_soon(self._tell, client, connection, limits)
            await self._requests(client, connection, limits)

    async def _requests(self, client: _Client, connection: AsciiConnection, limits: Limits) -> None:
        lines = GatewayLines(limit=limits.line_bytes)
        while True:
            with trio.move_on_after(limits.idle_seconds or float("inf")) as idle:
                data = await client.stream.receive_some(READ_SIZE)
            if idle.cancelled_caught or not data:
                return
            client.last_heard = trio.current_time()
            if not client.has_spoken and data.startswith(TLS_HELLO):
                await self._part(client, GatewayCode.NOT_SUPPORTED, "this gateway has no TLS: its lines are plain text")
                return
            for line in lines.feed(bytes(data)):
                if _HTTP.search(line):
                    LOGGER.warning("%s sent a web request, and was cut off", client.name)
                    await self._part(client, GatewayCode.NOT_SUPPORTED, "this is no web server")
                    return
                if _BINARY.search(line):
                    odd = GatewayAnswer(0, code=GatewayCode.SYNTAX, remark="these bytes are no text: a line of CiA 309-3 is")
                    await client.send(print_answer(odd, self._dialect), limits.send_seconds)
                    continue
                client.is_busy = client.has_spoken = True
                try:
                    answer = await connection.answer(line)
                finally:
                    client.is_busy = False
                client.waits_for_events = connection.wants_events
                client.last_heard = trio.current_time()
                if answer is not None:
                    await client.send(print_answer(answer, self._dialect), limits.send_seconds)
                elif self._dialect.answers_blank:
                    await client.send(self._dialect.line_end, limits.send_seconds)
            if lines.too_long:
                await self._part(client, GatewayCode.OUT_OF_MEMORY, f"a line has {limits.line_bytes} bytes at most")
                return

    async def _tell(self, client: _Client, connection: AsciiConnection, limits: Limits) -> None:
        """Send the events that the client has asked for, as fast as it takes them."""
        while True:
            text = connection.event_text(await connection.next_event())
            if text is not None:
                await client.send(text, limits.send_seconds)


async def bind_ascii_door(
    *,
    tcp: tuple[str, int] | None = None,
    unix: Path | None = None,
    dialect: Dialect = CANOPENNODE,
    reachable: bool = False,
) -> AsciiDoor:
    """Bind the sockets of a text door; `AsciiDoor.serve` then serves clients.

    tcp: host and port; port 0: any free one. unix: the path of a Unix socket; one that nobody listens at any more is replaced.
    dialect: how it writes. reachable: other computers may reach it; without that an address that is not this computer's own is
    refused. Raises DoorError, with nothing bound.
    """
    if tcp is None and unix is None:
        raise DoorError("a text door needs an address", tries=("--port 60000", "--unix /tmp/CO_command_socket"))
    listeners: list[trio.SocketListener] = []
    addresses: list[str] = []
    try:
        if tcp is not None:
            listeners += await _tcp_listeners(*tcp, reachable)
            addresses += [address_of(listener) for listener in listeners]
        if unix is not None:
            listeners.append(await _unix_listener(unix))
            addresses.append(str(unix))
    except BaseException:
        for listener in listeners:
            await trio.aclose_forcefully(listener)
        raise
    return AsciiDoor(listeners, addresses, unix, dialect)


async def _tcp_listeners(host: str, port: int, reachable: bool) -> list[trio.SocketListener]:
    if not reachable and not is_loopback(host):
        raise DoorError(
            f"{host} can be reached from other computers, and this door has no password",
            cause="a text gateway knows no users: whoever reaches it may do what is allowed",
            tries=("--bind 127.0.0.1, and ssh -L 60000:localhost:60000 from elsewhere", "--reachable, if that is meant"),
        )
    return await open_listeners(host, port)


async def _unix_listener(path: Path) -> trio.SocketListener:
    if not hasattr(socket, "AF_UNIX"):
        raise DoorError("this system has no Unix sockets", tries=("--port 60000",))
    sock = trio.socket.socket(trio.socket.AF_UNIX, trio.socket.SOCK_STREAM)
    try:
        await _remove_left_over(path)
        mask = os.umask(0o177)  # for this user alone
        try:
            await sock.bind(str(path))
        finally:
            os.umask(mask)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        sock.listen(BACKLOG)
    except OSError as error:
        sock.close()
        there = "another gateway listens there" if path.is_socket() else "what is there is no socket, and is left alone"
        cause = there if error.errno == errno.EADDRINUSE else ""
        raise DoorError(f"cannot listen at {path}", seen=str(error), cause=cause, tries=("--unix with another path",)) from error
    except BaseException:
        sock.close()
        raise
    return trio.SocketListener(sock)


async def _remove_left_over(path: Path) -> None:
    """Remove the socket of a program that is gone. Anything else at this path stays, and to bind there then fails."""
    try:
        if not stat.S_ISSOCK(path.stat().st_mode):
            return
    except OSError:
        return
    try:
        await (await trio.open_unix_socket(str(path))).aclose()
    except ConnectionRefusedError:
        path.unlink(missing_ok=True)
    except OSError:
        return


def _name_of(stream: trio.SocketStream) -> str:
    """Return a client's name for people."""
    try:
        peer = stream.socket.getpeername()
    except OSError:
        return "a client that is gone"
    return f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else "a client on the Unix socket"
