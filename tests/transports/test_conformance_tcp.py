"""The conformance kit on `tcp:HOST:PORT`, over this computer's loopback."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import outcome
import pytest
import trio

from canopen_transports import Transport, open_transport
from canopen_transports.conformance import Site, SiteBus, TransportCase, at, openings
from canopen_transports.tcp import BusServer, serve_bus
from tests.transports.support import cases


@asynccontextmanager
async def served() -> AsyncIterator[SiteBus]:
    async with trio.open_nursery() as nursery:
        (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
        async with at(locator)() as bus:
            yield bus
        nursery.cancel_scope.cancel()


async def join_a_stranger() -> Transport:
    """What listens there is no bus server, and hangs up."""

    async def hang_up(stream: trio.SocketStream) -> None:
        async with stream:
            await stream.send_all(b"220 mail.example ESMTP\r\n")

    async with trio.open_nursery() as nursery:
        (listener,) = await trio.open_tcp_listeners(0, host="127.0.0.1")
        nursery.start_soon(trio.serve_listeners, hang_up, [listener])
        opened = await outcome.acapture(open_transport, f"tcp:127.0.0.1:{listener.socket.getsockname()[1]}")
        nursery.cancel_scope.cancel()
    return opened.unwrap()


async def join_nobody() -> Transport:
    """Nobody listens there."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return await open_transport(f"tcp:127.0.0.1:{sock.getsockname()[1]}")


SITE = Site(
    served,
    (
        *openings("tcp:localhost:0", "tcp:a:b:c", "tcp:127.0.0.1:20301@500k", "tcp:127.0.0.1?x=1", "tcp:no.such.host.invalid"),
        join_a_stranger,
        join_nobody,
    ),
)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("case", cases(SITE, optional=("many_at_once",)), ids=str)
def test_conformance(case: TransportCase) -> None:
    case.run(SITE)
