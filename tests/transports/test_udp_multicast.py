"""udp_multicast: two terminals of one computer, over real sockets."""

from __future__ import annotations

import functools
import socket

import can
import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import PythonCanTransport, Transport, TransportError, open_transport
from tests.transports.conformance import EVERY_KIND, TransportConformance
from tests.transports.support import trio_test


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port


@functools.cache
def _why_not() -> str:
    """Why multicast does not work on this host; empty where it does."""

    async def probe() -> str:
        locator = f"udp_multicast?port={_free_port()}"
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


@pytest.fixture(autouse=True)
def _multicast() -> None:
    if _why_not():
        pytest.skip(_why_not())


class TestConformance(TransportConformance):
    unopenable = (
        "udp_multicast:192.0.2.1",
        "udp_multicast:here",
        "udp_multicast?port=port",
        "udp_multicast?hop_limit",
        "udp_multicast?fd=true",
        "udp_multicast?receive_own_messages=1",
    )

    def setup_method(self) -> None:
        self.locator = f"udp_multicast?port={_free_port()}"

    async def join(self) -> Transport:
        return await open_transport(self.locator)


@trio_test(real_time=True)
async def test_nonsense_from_the_network_stops_at_the_edge() -> None:
    port = _free_port()
    async with await open_transport(f"udp_multicast?port={port}") as transport:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            for datagram in (b"", b"hello", b"\x81\xa1x\x01", bytes(2000)):
                stranger.sendto(datagram, ("239.74.163.2", port))
        with can.Bus("239.74.163.2", interface="udp_multicast", port=port, hop_limit=0, ignore_config=True) as other:
            other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        assert (await transport.receive())[0] == Frame.parse("080#")
        assert isinstance(transport, PythonCanTransport)
        assert transport.refused == 4
        assert "could not unpack" in transport.last_refusal


@trio_test(real_time=True)
async def test_a_plain_python_can_program_understands_us() -> None:
    port = _free_port()
    with can.Bus("239.74.163.2", interface="udp_multicast", port=port, hop_limit=0, ignore_config=True) as other:
        async with await open_transport(f"udp_multicast:239.74.163.2?port={port}") as transport:
            for frame in EVERY_KIND:
                await transport.send(frame)
                message = await trio.to_thread.run_sync(other.recv, 10)
                assert message is not None
                assert (message.arbitration_id, bytes(message.data), message.dlc) == (frame.can_id, frame.data, frame.dlc)
            assert isinstance(transport, PythonCanTransport)
            assert transport.refused == 0  # our own frames did come back, and were known as such
