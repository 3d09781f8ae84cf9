"""python-can's socketcand backend against a server of its protocol, one that goes away, and one that is none."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import BusState, ReceiveOverrun, Transport, TransportError, open_transport, python_can
from tests.transports.support import reported, trio_test

END = Frame.parse("7E5#0E")


class Server:
    """It says "< ok >" to what it is told, and takes one client at a time."""

    def __init__(self, port: int = 0) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self.client: socket.socket | None = None
        self.heard: list[str] = []

    @property
    def locator(self) -> str:
        return f"socketcand:can0?host=127.0.0.1&port={self.port}"

    def take(self) -> None:
        """Take the next client that stays, and answer it. In a thread."""
        while True:
            client, _ = self._listener.accept()
            client.settimeout(10)
            try:
                client.sendall(b"< hi >")
                heard = []
                for _ in range(2):
                    heard.append(client.recv(100).decode())
                    client.sendall(b"< ok >")
            except OSError:
                heard = []
            if all(heard) and heard:
                self.client, self.heard = client, heard
                return
            client.close()  # it only looked whether somebody is here

    def say(self, text: str) -> None:
        assert self.client is not None
        self.client.sendall(text.encode())

    def hang_up(self) -> None:
        if self.client is not None:
            self.client.close()
        self._listener.close()


async def joined(server: Server) -> Transport:
    transports: list[Transport] = []

    async def join() -> None:
        transports.append(await open_transport(server.locator))

    async with trio.open_nursery() as nursery:
        nursery.start_soon(join)
        await trio.to_thread.run_sync(server.take)
    return transports[0]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(python_can, "REOPEN_PAUSE", 0.02)
    server = Server()
    yield server
    server.hang_up()


@trio_test(real_time=True)
async def test_frames_both_ways(server: Server) -> None:
    async with await joined(server) as transport:
        assert server.heard == ["< open can0 >", "< rawmode >"]
        server.say("< frame 7E5 23.424242 0E >< frame 12345678 23.5 0102 >")
        assert await transport.receive() == (END, 23_424_242_000)
        assert (await transport.receive())[0] == Frame.parse("12345678#0102")
        await transport.send(Frame.parse("60C#4041"))
        assert server.client is not None
        assert await trio.to_thread.run_sync(server.client.recv, 100) == b"< send 60C 2 40 41 >"


@trio_test(real_time=True)
async def test_a_server_that_goes_away_and_comes_back(server: Server) -> None:
    async with await joined(server) as transport:
        server.hang_up()  # of that, python-can says nothing
        down = await reported(transport)
        assert (down.state, down.seen) == (BusState.DOWN, "the server has closed the connection")
        with trio.move_on_after(0.1):  # some tries are in vain
            await transport.receive()
        again = Server(server.port)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(trio.to_thread.run_sync, again.take)
            assert (await reported(transport)).state is BusState.UP
        again.say("< frame 7E5 1.0 0E >")
        assert (await transport.receive())[0] == END
    again.hang_up()


@trio_test(real_time=True)
async def test_what_is_no_frame_is_told_in_one_line(server: Server) -> None:
    async with await joined(server) as transport:
        server.say("< frame 7E5 noon 0E >")
        garbage = await reported(transport, ReceiveOverrun, match="not a valid frame")
        assert "Traceback" not in str(garbage)
        server.say("< frame 7E5 1.0 0E >")
        assert (await transport.receive())[0] == END


@trio_test(real_time=True)
async def test_no_server(server: Server) -> None:
    locator = server.locator
    server.hang_up()
    with pytest.raises(TransportError) as caught:
        await open_transport(locator)
    assert caught.value.cause == "no server of socketcand runs there, or a firewall is between"
    assert caught.value.tries[0] == "socketcand -v -i can0   (on the computer that has the adapter)"


@trio_test(real_time=True)
async def test_a_server_that_says_nothing_does_not_keep_us(server: Server) -> None:
    with trio.move_on_after(0.1) as scope:
        await open_transport(server.locator)
    assert scope.cancelled_caught
