"""udp_multicast: two terminals of one computer, over real sockets."""

from __future__ import annotations

import socket

import can
import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import PythonCanTransport, open_transport
from canopen_transports.conformance.frames import EVERY_KIND
from tests.transports.multicast import free_locator, need_multicast
from tests.transports.support import trio_test


@pytest.fixture(autouse=True)
def _multicast() -> None:
    need_multicast()


@trio_test(real_time=True)
async def test_nonsense_from_the_network_stops_at_the_edge() -> None:
    locator = free_locator()
    port = int(locator.rpartition("=")[2])
    async with await open_transport(locator) as transport:
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
    port = int(free_locator().rpartition("=")[2])
    with can.Bus("239.74.163.2", interface="udp_multicast", port=port, hop_limit=0, ignore_config=True) as other:
        async with await open_transport(f"udp_multicast:239.74.163.2?port={port}") as transport:
            for frame in EVERY_KIND:
                await transport.send(frame)
                message = await trio.to_thread.run_sync(other.recv, 10)
                assert message is not None
                assert (message.arbitration_id, bytes(message.data), message.dlc) == (frame.can_id, frame.data, frame.dlc)
            assert isinstance(transport, PythonCanTransport)
            assert transport.refused == 0  # our own frames did come back, and were known as such
