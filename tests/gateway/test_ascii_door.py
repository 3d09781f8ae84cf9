"""The text door on real sockets: several clients, and hostile ones. The clock is virtual, and jumps when it is quiet."""

from __future__ import annotations

import functools
import gc
import inspect
import socket
import stat
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio
import trio.testing

from canopen_gateway import DoorError, GatewayService, Limits, NoGatewayError
from canopen_gateway.ascii import AsciiDoor, bind_ascii_door, open_remote_gateway, parse_gateway_address
from canopen_gateway.ascii.connection import AsciiConnection
from canopen_gateway.ascii.door import SILENT, SILENT_FIRST
from canopen_gateway.errors import GatewayRefusedError
from canopen_proto import NmtCommand
from canopen_proto.gateway import CANOPENNODE, LELY, GatewayAnswer
from tests.gateway.gateway_world import gateway

QUIET = 0.02
"""Seconds without any news of a socket: then the clock jumps. Bytes within one computer need far less."""


def with_sockets(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """As `virtual_time`, but the clock waits for sockets."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        async def limited() -> None:
            with trio.fail_after(600):
                await test(*args, **kwargs)

        trio.run(limited, clock=trio.testing.MockClock(autojump_threshold=QUIET))

    del run.__wrapped__  # type: ignore[attr-defined]  # else pytest would see a coroutine function
    run.__signature__ = inspect.signature(test)  # type: ignore[attr-defined]
    return run


class Client:
    """A client with its socket."""

    def __init__(self, stream: trio.SocketStream) -> None:
        self.stream = stream
        self._waiting = b""

    async def say(self, text: str) -> str:
        await self.stream.send_all(text.encode() + b"\n")
        return await self.line()

    async def line(self) -> str:
        """The next line, without its end; "" at the end of the connection."""
        while b"\n" not in self._waiting:
            try:
                data = await self.stream.receive_some(65536)
            except trio.BrokenResourceError:
                return ""
            if not data:
                return ""
            self._waiting += bytes(data)
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode().rstrip("\r")

    async def ended(self) -> bool:
        """Whether the door ends the connection, whatever it says before."""
        while True:
            try:
                if not await self.stream.receive_some(65536):
                    return True
            except trio.BrokenResourceError:
                return True


CONNECTED: list[Client] = []
"""The clients of the present door, which are closed with it."""


@asynccontextmanager
async def open_door(
    *node_ids: int, allow: str = "", limits: Limits | None = None, unix: Path | None = None, **options: Any
) -> AsyncIterator[tuple[AsciiDoor, GatewayService]]:
    door = await bind_ascii_door(tcp=None if unix else ("127.0.0.1", 0), unix=unix, **options)
    async with gateway(*node_ids, allow=allow, limits=limits) as (_, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        yield door, service
        for client in CONNECTED:
            await trio.aclose_forcefully(client.stream)
        CONNECTED.clear()
        nursery.cancel_scope.cancel()


async def connect(door: AsciiDoor) -> Client:
    host, _, port = door.addresses[0].rpartition(":")
    client = Client(
        await (trio.open_tcp_stream(host, int(port)) if port.isdecimal() else trio.open_unix_socket(door.addresses[0]))
    )
    CONNECTED.append(client)
    return client


@with_sockets
async def test_several_clients_are_served_at_a_time() -> None:
    async with open_door(3, 4) as (door, _):
        clients = [await connect(door) for _ in range(5)]
        for number, client in enumerate(clients):
            assert await client.say(f"[1] set node {3 + number % 2}") == "[1] OK"
        for client in clients:
            assert await client.say("[2] r 0x1000 0 u32") == "[2] 131474"
            assert await client.say("") == ""
            assert await client.say("# comment") == ""
        assert door.clients == 5
        await clients[0].stream.aclose()
        assert await clients[1].say("[3] 3 r 0x1000 0 u32") == "[3] 131474"


@with_sockets
async def test_lines_however_they_are_cut_and_many_at_once() -> None:
    async with open_door(3) as (door, _):
        client = await connect(door)
        for byte in b"[1] 3 r 0x1000 0 u32\r\n":
            await client.stream.send_all(bytes([byte]))
        assert await client.line() == "[1] 131474"
        await client.stream.send_all(b"".join(b"[%d] 3 r 0x1000 0 u32\n" % number for number in range(300)))
        assert [await client.line() for _ in range(300)] == [f"[{number}] 131474" for number in range(300)]


@with_sockets
async def test_a_client_that_half_closes_has_its_answers() -> None:
    async with open_door(3) as (door, _):
        client = await connect(door)
        await client.stream.send_all(b"[1] 3 r 0x1000 0 u32\n[2] 3 r 0x1018 1 u32\n[3] half")
        await client.stream.send_eof()
        assert await client.line() == "[1] 131474"
        assert await client.line() == "[2] 818"
        assert await client.ended()


@with_sockets
async def test_events_come_between_answers_only_to_those_who_asked() -> None:
    async with open_door(3, allow="nmt") as (door, _):
        one, other = await connect(door), await connect(door)
        assert await one.say("[1] boot_up_indication enable") == "[1] OK"
        assert await other.say("[1] 3 reset node") == "[1] OK"
        assert await one.line() == "1 3 BOOT_UP"
        assert await other.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"


@with_sockets
async def test_a_line_that_is_too_long_ends_its_connection_alone() -> None:
    async with open_door(3, limits=Limits(line_bytes=100)) as (door, _):
        hostile, good = await connect(door), await connect(door)
        assert await hostile.say("[1] 3 r 0x1000 0 u32" + " " * 80) == "[1] 131474"
        await hostile.stream.send_all(b"x" * 200)
        assert await hostile.line() == "[0] ERROR:600 #a line has 100 bytes at most"
        assert await hostile.ended()
        assert await good.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"


@with_sockets
async def test_bytes_that_are_no_text_are_told_so_and_tls_ends() -> None:
    async with open_door(3) as (door, _):
        client, secure = await connect(door), await connect(door)
        await client.stream.send_all(b"\0\x01\x02[1] 3 reset node\n")
        assert await client.line() == "[0] ERROR:101 #these bytes are no text: a line of CiA 309-3 is"
        assert await client.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"  # a burst on a line ends nobody
        await secure.stream.send_all(b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03")  # without the end of a line
        assert await secure.line() == "[0] ERROR:100 #this gateway has no TLS: its lines are plain text"
        assert await secure.ended()


@pytest.mark.parametrize("first", ["POST / HTTP/1.1\r", "GET /chat HTTP/1.0", "PRI * HTTP/2.0\r"])
@with_sockets
async def test_a_page_in_a_browser_commands_nothing(first: str) -> None:
    """A page from anywhere may let the browser of this computer send what it likes to a port of this computer."""
    async with open_door(3, allow="nmt") as (door, service):
        client, other = await connect(door), await connect(door)
        assert await other.say("[1] 3 enable heartbeat 60000") == "[1] OK"
        await client.stream.send_all(f"{first}\nHost: localhost\r\n\r\n[1] 3 reset node\n".encode())
        assert await client.line() == "[0] ERROR:100 #this is no web server"
        assert await client.ended()
        assert await other.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"
        assert not service.log  # no boot-up
        told = {await other.say("[3] 3 reset node"), await other.line()}
        assert told == {"[3] OK", "1 3 BOOT_UP"}  # a device in this process boots at once


@with_sockets
async def test_a_client_that_takes_no_answers_is_cut_off_and_the_others_are_served() -> None:
    async with open_door(3, limits=Limits(send_seconds=2.0)) as (door, service):
        hostile, good = await connect(door), await connect(door)
        hostile.stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)

        async def flood() -> None:
            with pytest.raises(trio.BrokenResourceError):
                while True:
                    await hostile.stream.send_all(b"[1] help\n" * 100)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(flood)
            await trio.sleep(1)
            assert await good.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
            await trio.sleep(5)
            assert len(service.sessions) == 1
        assert await good.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"


@with_sockets
async def test_a_full_gateway_says_so_and_a_silent_client_makes_room() -> None:
    async with open_door(3, limits=Limits(sessions=3)) as (door, _):
        mute, idle, busy = await connect(door), await connect(door), await connect(door)
        assert await idle.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        assert await busy.say("[1] boot_up_indication enable") == "[1] OK"
        late = await connect(door)
        assert await late.line() == "[0] ERROR:600 #this gateway has no place for another client"
        assert await late.ended()
        await trio.sleep(SILENT_FIRST)
        welcome = await connect(door)  # in the place of the one that has said nothing
        assert await welcome.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        assert await mute.ended()
        assert (door.refused, door.cut_off) == (1, 1)
        await trio.sleep(SILENT)
        assert await welcome.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"
        another = await connect(door)  # in the place of the one that was silent longest; who waits for events stays
        assert await another.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        assert await idle.ended()
        assert await busy.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"


@with_sockets
async def test_a_client_with_a_request_under_way_keeps_its_place() -> None:
    async with open_door(3, limits=Limits(sessions=1)) as (door, _):
        slow = await connect(door)
        assert await slow.say("[1] set sdo_timeout 60000") == "[1] OK"
        await slow.stream.send_all(b"[2] 99 r 0x1000 0\n")
        await trio.sleep(SILENT + 1)
        late = await connect(door)
        assert (await late.line()).startswith("[0] ERROR:600")
        assert (await slow.line()).startswith("[2] ERROR:0x05040000")


@with_sockets
async def test_clients_that_went_away_while_a_node_is_silent_keep_nobody_out() -> None:
    async with open_door(3, limits=Limits(sessions=3)) as (door, service):
        waiting = await connect(door)  # this one waits, and keeps its place
        await waiting.stream.send_all(b"[1] set sdo_timeout 60000\n[2] 99 r 0x1000 0 u32\n")
        assert await waiting.line() == "[1] OK"
        for _ in range(5):  # a program that gives up before the gateway does, and tries again
            client = await connect(door)
            assert await client.say("[1] set sdo_timeout 60000") == "[1] OK"
            await client.stream.send_all(b"[2] 98 r 0x1000 0 u32\n")
            await trio.sleep(0.1)
            await client.stream.aclose()
        assert await (await connect(door)).say("[3] _halt") == "[3] OK"
        assert door.refused == 0
        assert (await waiting.line()).startswith("[2] ERROR:0x05040000")
        assert len(service.sessions) == door.clients <= 3


@with_sockets
async def test_a_thousand_connections_leave_the_first_ones_served_and_the_memory_bounded() -> None:
    async with open_door(3, limits=Limits(sessions=4)) as (door, service):
        good = await connect(door)
        assert await good.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        before = counted()
        open_ones = []
        for number in range(1000):
            client = await connect(door)
            if number % 3 == 0:
                await client.stream.send_all(b"[1")  # a line without an end
            open_ones.append(client)
            if len(open_ones) > 100:
                await open_ones.pop(0).stream.aclose()
            if number % 100 == 0:
                assert await good.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"
        assert len(service.sessions) <= 4
        assert door.clients <= 4
        for client in open_ones:
            await client.stream.aclose()
        open_ones.clear()
        CONNECTED[:] = [good]
        await trio.sleep(SILENT_FIRST + 1)
        assert await good.say("[3] 3 r 0x1000 0 u32") == "[3] 131474"
        assert door.refused >= 900
        assert counted() - before < 200  # a fifth of an object for each


def counted() -> int:
    """Objects that the garbage collector knows of."""
    gc.collect()
    return len(gc.get_objects())


@with_sockets
async def test_a_client_that_says_nothing_for_too_long_is_let_go_on_request() -> None:
    async with open_door(3, limits=Limits(idle_seconds=5.0)) as (door, _):
        client = await connect(door)
        await trio.sleep(4)
        assert await client.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        assert await client.ended()


@with_sockets
async def test_a_mistake_of_ours_ends_one_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = AsciiConnection.answer

    async def broken(self: AsciiConnection, line: bytes) -> GatewayAnswer | None:
        if b"boom" in line:
            raise RuntimeError("boom")
        return await answer(self, line)

    monkeypatch.setattr(AsciiConnection, "answer", broken)
    async with open_door(3) as (door, service):
        one, other = await connect(door), await connect(door)
        await one.stream.send_all(b"boom\n")
        assert await one.ended()
        assert await other.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        assert door.failure is None
        assert len(service.sessions) == 1


@with_sockets
async def test_a_door_that_fails_is_closed_and_the_master_goes_on() -> None:
    async with open_door(3) as (door, service):
        client = await connect(door)
        assert await client.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"

        async def fails() -> trio.SocketStream:
            raise OSError(5, "input/output error")

        door._listeners[0].accept = fails  # type: ignore[method-assign]
        await (await connect(door)).stream.aclose()  # the accept under way
        await trio.sleep(1)
        assert isinstance(door.failure, OSError)
        assert await service.node(service.nets[0], 3).read_int(0x1000) == 131474


# ---- addresses ----


@with_sockets
async def test_only_this_computer_may_reach_it_without_a_word() -> None:
    for host in ("0.0.0.0", "::", "192.0.2.1", "example.org"):
        with pytest.raises(DoorError, match="can be reached from other computers"):
            await bind_ascii_door(tcp=(host, 0))
    door = await bind_ascii_door(tcp=("0.0.0.0", 0), reachable=True)
    async with door:
        assert door.addresses[0].startswith("0.0.0.0:")
    with pytest.raises(DoorError, match="needs an address"):
        await bind_ascii_door()


@with_sockets
async def test_a_port_in_use_is_told_before_anything_is_opened() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(DoorError, match=f"port {port}") as refused:
            await bind_ascii_door(tcp=("127.0.0.1", port))
        assert "another gateway?" in refused.value.cause


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="there are no Unix sockets here")
@with_sockets
async def test_a_unix_socket_for_its_user_alone(tmp_path: Path) -> None:
    path = tmp_path / "gw"
    async with open_door(3, unix=path) as (door, _):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        client = await connect(door)
        assert await client.say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
        with pytest.raises(DoorError, match="cannot listen"):
            await bind_ascii_door(unix=path)
        assert await client.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"
    assert not path.exists()
    left_over = socket.socket(socket.AF_UNIX)
    left_over.bind(str(path))
    left_over.close()  # as after a kill
    async with await bind_ascii_door(unix=path):
        assert path.exists()
    async with await bind_ascii_door(unix=path) as first:
        path.unlink()  # somebody tidies up, and starts another door
        second = await bind_ascii_door(unix=path)
        assert first.addresses == second.addresses
    assert path.is_socket()
    async with second:
        assert path.is_socket()
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(DoorError, match="what is there is no socket"):
        await bind_ascii_door(unix=path)
    assert path.read_text() == "mine"


# ---- the client of other gateways ----


@with_sockets
async def test_the_client_reads_writes_and_commands_over_our_own_door() -> None:
    for dialect in (CANOPENNODE, LELY):
        async with open_door(3, allow="write,nmt", dialect=dialect) as (door, service):
            locator = f"gw:{door.addresses[0]}?dialect={dialect.name}"
            async with open_remote_gateway(locator) as remote:
                assert await remote.read(3, 0x1000) == bytes.fromhex("92010200")
                assert await remote.read(3, 0x1008) == b"Simulated Schunk Powerball joint"
                await remote.write(3, 0x1017, 0, b"\xc8\0")
                assert await remote.read(3, 0x1017) == b"\xc8\0"
                await remote.nmt(NmtCommand.START, 3)
                await remote.set_sdo_timeout(0.05)
                with pytest.raises(GatewayRefusedError) as silent:
                    await remote.read(99, 0x1000)
                assert (silent.value.is_silence, silent.value.node_id, silent.value.index) == (True, 99, 0x1000)
                with pytest.raises(GatewayRefusedError, match="0x06020000") as refused:
                    await remote.read(3, 0x2FFF)
                assert not refused.value.is_silence
                with pytest.raises(GatewayRefusedError, match="--allow motion") as forbidden:
                    await remote.write(3, 0x6040, 0, b"\x06\0")
                assert forbidden.value.gateway_code == 100
                with trio.move_on_after(0.001):
                    await remote.read(98, 0x1000)
                await trio.sleep(1)
                assert await remote.read(3, 0x1000) == bytes.fromhex("92010200")  # not the late answer
            assert service.nets


async def serve_lines(answers: list[bytes], task_status: trio.TaskStatus[int] = trio.TASK_STATUS_IGNORED) -> None:
    """A gateway that answers whatever it is told to, one for each request, and then closes."""

    async def handle(stream: trio.SocketStream) -> None:
        async with stream:
            for answer in answers:
                await stream.receive_some(4096)
                await stream.send_all(answer)

    listeners = await trio.open_tcp_listeners(0, host="127.0.0.1")
    task_status.started(listeners[0].socket.getsockname()[1])
    await trio.serve_listeners(handle, listeners)


@pytest.mark.parametrize(
    ("answers", "error"),
    [
        ([b"[7] 5\r\n"], "closed the connection"),
        ([b"HTTP/1.1 400 Bad Request\r\n\r\n"], "closed the connection"),
        ([b"1 3 BOOT_UP\r\n[1] kgECAA==\r\n"], None),
        ([b"[1] !!!!\r\n"], "has not answered with a value"),
        ([b"[1] OK\r\n"], None),
        ([b"[1] kgEC\n...ERROR:0x05040000 #late\r\n"], "0x05040000"),
        ([], "closed the connection"),
    ],
)
def test_a_gateway_that_answers_strangely(answers: list[bytes], error: str | None) -> None:
    @with_sockets
    async def strange() -> None:
        async with trio.open_nursery() as nursery:
            port = await nursery.start(serve_lines, answers)
            async with open_remote_gateway(f"gw:127.0.0.1:{port}") as remote:
                if error is None:
                    assert len(await remote.read(3, 0x1000)) in (0, 4)
                else:
                    with pytest.raises((NoGatewayError, GatewayRefusedError), match=error):
                        await remote.read(3, 0x1000)
            nursery.cancel_scope.cancel()

    strange()


@with_sockets
async def test_a_gateway_that_never_answers() -> None:
    async with trio.open_nursery() as nursery:
        port = await nursery.start(serve_lines, [b"\r\n", b"\r\n", b"\r\n"])
        async with open_remote_gateway(f"gw:127.0.0.1:{port}") as remote:
            with pytest.raises(NoGatewayError, match="did not answer in time"):
                await remote.read(3, 0x1000)
        nursery.cancel_scope.cancel()


@with_sockets
async def test_nobody_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(NoGatewayError, match=f"there is no text gateway at 127.0.0.1 port {port}"):
        async with open_remote_gateway(f"gw:127.0.0.1:{port}"):
            pass


@pytest.mark.parametrize(
    ("text", "host", "port", "path", "net", "dialect"),
    [
        ("gw:", "127.0.0.1", 60000, "", 1, CANOPENNODE),
        ("gw:plc:1234", "plc", 1234, "", 1, CANOPENNODE),
        ("gw:[::1]:1234?net=2", "::1", 1234, "", 2, CANOPENNODE),
        ("gw:/tmp/x?dialect=lely&net=3", "127.0.0.1", 60000, "/tmp/x", 3, LELY),
    ],
)
def test_an_address(text: str, host: str, port: int, path: str, net: int, dialect: object) -> None:
    address = parse_gateway_address(text)
    assert (address.host, address.port, address.path, address.net, address.dialect) == (host, port, path, net, dialect)


@pytest.mark.parametrize("text", ["gw:a:b", "gw:a:0", "gw:a:70000", "gw:a b", "gw:x?net=0", "gw:x?dialect=french", "gw:x?y"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(NoGatewayError, match="no address of a text gateway"):
        parse_gateway_address(text)
