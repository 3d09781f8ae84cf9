"""Whether UDP multicast works on this host, and a bus of a test's own there."""

from __future__ import annotations

import functools
import socket

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import TransportError, open_transport


def free_locator() -> str:
    """Of a bus that nobody else is on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udp_multicast?port={probe.getsockname()[1]}"


@functools.cache
def _why_not() -> str:
    """Why multicast does not work on this host; empty where it does."""

    async def probe() -> str:
        locator = free_locator()
        try:
            async with await open_transport(locator) as one, await open_transport(locator) as other:
                await one.send(Frame.parse("080#"))
                with trio.move_on_after(2):
                    await other.receive()
                    return ""
                return "multicast datagrams do not arrive on this host"
        except TransportError as error:
            return f"no multicast on this host: {error.seen}"

    return trio.run(probe)


def need_multicast() -> None:
    """Skip the test where there is none."""
    if _why_not():
        pytest.skip(_why_not())
