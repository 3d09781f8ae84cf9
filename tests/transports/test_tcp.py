"""`tcp:HOST:PORT` and the bus server, over this computer's loopback."""

from __future__ import annotations

import errno
import socket
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import cast

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import ReceiveOverrun, TcpTransport, Transport, TransportError, open_transport
from canopen_transports.conformance.frames import END
from canopen_transports.tcp import BusServer, client, serve_bus
from canopen_transports.tcp.address import DEFAULT_PORT, cannot_connect, cannot_listen, is_loopback, no_bus_server, parse_address
from canopen_transports.tcp.client import ROOM_TIME
from canopen_transports.tcp.framing import LineSplitter
from tests.transports.support import reported, trio_test


@asynccontextmanager
async def bus() -> AsyncIterator[str]:
    """A bus server's locator."""
    async with trio.open_nursery() as nursery:
        (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
        yield locator
        nursery.cancel_scope.cancel()


@asynccontextmanager
async def peer(talk: Callable[[trio.SocketStream], Awaitable[None]]) -> AsyncIterator[str]:
    """The locator of something that listens and is no bus server of ours."""
    async with trio.open_nursery() as nursery:
        (listener,) = await trio.open_tcp_listeners(0, host="127.0.0.1")
        nursery.start_soon(trio.serve_listeners, talk, [listener])
        yield f"tcp:127.0.0.1:{listener.socket.getsockname()[1]}"
        nursery.cancel_scope.cancel()


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
    return port


async def _hello_then_close(stream: trio.SocketStream) -> None:
    async with stream:
        await stream.send_all(b"canopen-bus 1\n605#40\nlost 17\n605#41\n")


@trio_test(real_time=True)
async def test_a_loss_is_an_overrun_at_its_place() -> None:
    async with peer(_hello_then_close) as locator, await open_transport(locator) as transport:
        assert (await transport.receive())[0] == Frame(0x605, b"\x40")
        caught = await reported(transport, ReceiveOverrun, match="17 received frames lost on tcp:")
        assert caught.seen == "the bus server's queue for us was full"
        assert (await transport.receive())[0] == Frame(0x605, b"\x41")


@trio_test(real_time=True)
async def test_a_server_that_ends_says_so() -> None:
    async def listen(transport: Transport) -> None:
        with pytest.raises(TransportError, match="cannot receive on tcp:") as caught:
            await transport.receive()
        assert caught.value.code == "CO111"
        assert caught.value.seen == "the bus server says: the bus server was ended"
        assert f"canopen bus serve --port {transport.locator.rpartition(':')[2]} " in caught.value.tries[0]

    async with trio.open_nursery() as nursery, bus() as locator:
        transport = await open_transport(locator)
        nursery.start_soon(listen, transport)
        await trio.testing.wait_all_tasks_blocked()
    for _ in range(2):
        with pytest.raises(TransportError, match="CO111"):
            await transport.send(END)
    await transport.aclose()


async def _only_hello(stream: trio.SocketStream) -> None:
    async with stream:
        await stream.send_all(b"canopen-bus 1\n")


@trio_test(real_time=True)
async def test_a_server_that_vanishes() -> None:
    async with peer(_only_hello) as locator, await open_transport(locator) as transport:
        with pytest.raises(TransportError, match="was closed|reset") as caught:
            await transport.receive()
        assert "was ended" in caught.value.cause


@trio_test(real_time=True)
async def test_a_sender_learns_of_it_too() -> None:
    async with peer(_only_hello) as locator, await open_transport(locator) as transport:
        with pytest.raises(TransportError, match="CO111: cannot send on"):
            while True:
                await transport.send(END)


async def _nonsense(stream: trio.SocketStream) -> None:
    await stream.send_all(b"canopen-bus 1\nHTTP/1.1 400 Bad Request\n")
    await trio.sleep_forever()


@trio_test(real_time=True)
async def test_a_server_that_talks_nonsense() -> None:
    async with peer(_nonsense) as locator, await open_transport(locator) as transport:
        for _ in range(2):
            with pytest.raises(TransportError, match="'HTTP/1.1 400 Bad Request' has no meaning"):
                await transport.receive()


@pytest.mark.parametrize(
    ("answer", "seen"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "says 'HTTP/1.1 400 Bad Request', not hello"),
        (b"bye enough\n", "the bus server says: enough"),
        (b"", "says nothing"),
    ],
)
def test_what_is_no_bus_server(answer: bytes, seen: str) -> None:
    async def talk(stream: trio.SocketStream) -> None:
        async with stream:
            await stream.receive_some()
            await stream.send_all(answer)

    @trio_test(real_time=True)
    async def body() -> None:
        async with peer(talk) as locator:
            with pytest.raises(TransportError, match="CO101: cannot open tcp:") as caught:
                await open_transport(locator)
            assert seen in caught.value.seen
            assert "canopen bus serve --port" in caught.value.tries[0]

    body()


@trio_test(real_time=True)
async def test_a_connection_that_is_reset_is_no_bus_server() -> None:
    async def talk(stream: trio.SocketStream) -> None:
        stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        await stream.receive_some(1)
        await stream.aclose()

    async with peer(talk) as locator:
        with pytest.raises(TransportError, match="says nothing"):
            await open_transport(locator)


class Narrow:
    """The system's socket where there is little room: takes so many bytes at each turn, and then nothing more."""

    cancelled_when_taking: trio.CancelScope | None = None

    def __init__(self, *room: int) -> None:
        self.taken = b""
        self._room = deque(room)
        self._closed = trio.Event()

    async def send(self, data: bytes) -> int:
        await trio.lowlevel.checkpoint()
        if not self._room:
            await self._closed.wait()
            raise trio.ClosedResourceError
        size = self._room.popleft()
        self.taken += data[:size]
        if self.cancelled_when_taking is not None:
            self.cancelled_when_taking.cancel()
        return min(size, len(data))

    def close(self) -> None:
        self._closed.set()


def narrow(*room: int) -> tuple[TcpTransport, Narrow]:
    sock = Narrow(*room)
    return TcpTransport("tcp", cast(trio.socket.SocketType, sock), LineSplitter(), []), sock


@trio_test()
async def test_a_server_that_is_stopped_is_told_and_nothing_was_sent() -> None:
    transport, sock = narrow(100)
    await transport.send(END)
    for _ in range(2):
        start = trio.current_time()
        with pytest.raises(TransportError, match="CO110: cannot send 7E5#0E on tcp") as caught:
            await transport.send(END)
        assert trio.current_time() - start == pytest.approx(ROOM_TIME)
        assert "has taken nothing for 1 s" in caught.value.seen
        assert "Ctrl-Z" in caught.value.cause
    assert sock.taken == b"7E5#0E\n"


@trio_test()
async def test_a_line_that_was_begun_is_ended_even_if_cancelled() -> None:
    transport, sock = narrow(3, 2, 2)
    with trio.CancelScope() as sock.cancelled_when_taking:
        await transport.send(END)
    assert sock.taken == b"7E5#0E\n"


@trio_test()
async def test_half_a_line_that_does_not_get_out_ends_the_connection() -> None:
    transport, _ = narrow(3)
    for _ in range(2):
        with pytest.raises(TransportError, match="CO111: cannot send 7E5#0E on tcp") as caught:
            await transport.send(END)
        assert "took only a part of the frame" in caught.value.seen


@trio_test()
async def test_closing_wakes_who_waits_for_room() -> None:
    transport, _ = narrow()

    async def send() -> None:
        with pytest.raises(trio.ClosedResourceError):
            await transport.send(END)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(send)
        await trio.testing.wait_all_tasks_blocked()
        await transport.aclose()


@trio_test(real_time=True)
async def test_an_opening_that_is_cancelled_leaves_nothing_open() -> None:
    ended = trio.Event()

    async def talk(stream: trio.SocketStream) -> None:
        while await stream.receive_some():
            scope.cancel()
        ended.set()

    async with peer(talk) as locator:
        with trio.CancelScope() as scope:
            await open_transport(locator)
        assert scope.cancelled_caught
        await ended.wait()


def test_nobody_listens() -> None:
    error = cannot_connect("tcp", "127.0.0.1", DEFAULT_PORT, ConnectionRefusedError(errno.ECONNREFUSED, "refused"))
    assert error.seen == "nobody listens at 127.0.0.1 port 20301"
    assert error.tries == ("canopen bus serve    (in another terminal)",)
    error = cannot_connect("tcp:lab:5000", "lab", 5000, ConnectionRefusedError(errno.ECONNREFUSED, "refused"))
    assert error.tries[0].startswith("canopen bus serve --port 5000 --bind 0.0.0.0 --yes    (on lab; ")


@pytest.mark.parametrize(
    ("problem", "seen"),
    [
        (TimeoutError(), "did not answer"),
        (socket.gaierror(-2, "Name or service not known"), "the name 'lab' is not known"),
        (OSError(errno.EHOSTUNREACH, "No route to host"), "No route to host"),
    ],
)
def test_other_ways_not_to_get_there(problem: OSError, seen: str) -> None:
    assert seen in cannot_connect("tcp:lab", "lab", DEFAULT_PORT, problem).seen


@pytest.mark.parametrize("host", ["a..b", "a" * 64, "\N{SNOWMAN}" * 64])
def test_names_that_no_computer_can_have(host: str) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        with pytest.raises(TransportError, match="CO101: cannot open tcp:") as caught:
            await open_transport(f"tcp:{host}")
        assert f"the name {host!r} is not known: " in caught.value.seen
        with pytest.raises(TransportError, match="CO101: cannot serve a bus on tcp:") as caught:
            await serve_bus(host, 0, BusServer())
        assert f"the name {host!r} is not known: " in caught.value.seen

    body()


@trio_test(real_time=True)
async def test_a_computer_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "CONNECT_TIME", 0.02)
    with socket.socket() as full, socket.socket() as guest, socket.socket() as second:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        port = full.getsockname()[1]
        for each in (guest, second):  # nobody takes them, and the queue is full: what comes next is dropped
            each.setblocking(False)
            each.connect_ex(("127.0.0.1", port))
        with pytest.raises(TransportError, match="CO101") as caught:
            await open_transport(f"tcp:127.0.0.1:{port}")
    assert caught.value.seen == f"127.0.0.1 port {port} did not answer"
    assert "firewall" in caught.value.cause


@pytest.mark.parametrize(
    ("number", "code", "advice"),
    [
        (errno.EADDRINUSE, "CO101", "-b tcp:127.0.0.1:20301    (to join it)"),
        (errno.EACCES, "CO102", "canopen bus serve --port 20301"),
        (errno.EADDRNOTAVAIL, "CO101", "canopen bus serve --bind 127.0.0.1"),
    ],
)
def test_where_no_server_can_listen(number: int, code: str, advice: str) -> None:
    error = cannot_listen("127.0.0.1", DEFAULT_PORT, OSError(number, "no"))
    assert (error.code, error.tries[0]) == (code, advice)
    assert "canopen bus serve" in str(error)


def test_behind_the_last_port_comes_ours() -> None:
    assert cannot_listen("127.0.0.1", 65535, OSError(errno.EADDRINUSE, "no")).tries[1] == "canopen bus serve --port 20301"
    assert no_bus_server("tcp::65535", "127.0.0.1", 65535, "?").tries[0].startswith("canopen bus serve    (")
    assert no_bus_server("tcp::5000", "127.0.0.1", 5000, "?").tries[0].startswith("canopen bus serve --port 5001    (")


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as sock:
            sock.bind(("::1", 0))
    except OSError:
        return False
    return True


@pytest.mark.skipif(not has_ipv6(), reason="this computer has no IPv6")
def test_ipv6() -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        async with trio.open_nursery() as nursery:
            (locator,) = await nursery.start(serve_bus, "::1", 0, BusServer())
            assert locator.startswith("tcp:[::1]:")
            async with await open_transport(locator) as one, await open_transport(locator) as other:
                await one.send(END)
                assert (await other.receive())[0] == END
            nursery.cancel_scope.cancel()

    body()


@trio_test(real_time=True)
async def test_two_servers_at_one_port() -> None:
    async with bus() as locator:
        port = int(locator.rpartition(":")[2])
        with pytest.raises(TransportError, match="a bus server runs there already"):
            await serve_bus("127.0.0.1", port, BusServer())


@pytest.mark.parametrize(
    ("channel", "address"),
    [
        ("", ("127.0.0.1", 20301)),
        ("lab", ("lab", 20301)),
        ("10.0.0.7:5000", ("10.0.0.7", 5000)),
        ("[::1]:5000", ("::1", 5000)),
        ("[::1]", ("::1", 20301)),
    ],
)
def test_addresses(channel: str, address: tuple[str, int]) -> None:
    assert parse_address(f"tcp:{channel}", channel) == address


@pytest.mark.parametrize("channel", [":5000", "lab:", "lab:0", "lab:65536", "::1", "lab:x", "a b"])
def test_no_addresses(channel: str) -> None:
    with pytest.raises(TransportError, match="HOST:PORT"):
        parse_address(f"tcp:{channel}", channel)


def test_what_is_loopback() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "127.8.8.8")] == [True] * 4
    assert [is_loopback(host) for host in ("0.0.0.0", "::", "lab", "10.0.0.7")] == [False] * 4


@trio_test(real_time=True)
async def test_a_connection_that_is_reset() -> None:
    async def reset(stream: trio.SocketStream) -> None:
        stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        await stream.send_all(b"canopen-bus 1\n")
        await stream.receive_some()
        await go_on.wait()
        await stream.aclose()

    go_on = trio.Event()
    async with peer(reset) as locator:
        broken = await open_transport(locator)
        go_on.set()
        with pytest.raises(TransportError, match="CO111: cannot receive") as caught:
            await broken.receive()
        assert "reset" in caught.value.seen
