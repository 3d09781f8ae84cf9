"""SocketCAN, on hosts that have a vcan0 (sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up)."""

from __future__ import annotations

import shutil
import socket
import subprocess
from pathlib import Path

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import Transport, TransportError, open_transport
from tests.transports.conformance import END, TransportConformance
from tests.transports.support import trio_test


def _has(name: str) -> bool:
    return name in (interface for _, interface in socket.if_nameindex()) and Path(f"/sys/class/net/{name}/type").exists()


pytestmark = pytest.mark.skipif(not _has("vcan0"), reason="this host has no vcan0: sudo ip link add dev vcan0 type vcan")


class TestConformance(TransportConformance):
    unopenable = ("socketcan:nocan0", "socketcan:vcan99", "socketcan:lo", "vcan98")

    async def join(self) -> Transport:
        return await open_transport("socketcan:vcan0")


def _ip(*arguments: str) -> None:
    ip = shutil.which("ip") or "/sbin/ip"
    if subprocess.run([ip, *arguments], capture_output=True, check=False).returncode:
        pytest.skip("this user may not set network interfaces up and down")


@pytest.fixture
def down() -> str:
    """A vcan interface that is DOWN, so that no other test loses its bus."""
    if not _has("vcan1"):
        _ip("link", "add", "dev", "vcan1", "type", "vcan")
    _ip("link", "set", "vcan1", "down")
    return "vcan1"


@trio_test(real_time=True)
async def _opening_fails(name: str) -> None:
    with pytest.raises(TransportError) as caught:
        await open_transport(f"socketcan:{name}")
    assert caught.value.seen == "vcan1 is there, but it is DOWN"
    assert caught.value.tries == ("sudo ip link set vcan1 up",)


def test_an_interface_that_is_down_is_not_opened(down: str) -> None:
    _opening_fails(down)


@trio_test(real_time=True)
async def _goes_down_and_comes_back(name: str) -> None:
    async with await open_transport(name) as one, await open_transport(name) as other:

        async def notice() -> None:
            with pytest.raises(TransportError) as caught:
                await other.receive()
            assert caught.value.code == "CO111"
            assert "vcan1 is DOWN" in caught.value.seen
            assert caught.value.tries == ("sudo ip link set vcan1 up",)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(notice)
            await trio.testing.wait_all_tasks_blocked()
            _ip("link", "set", name, "down")
        with pytest.raises(TransportError) as caught:
            await one.send(Frame.parse("080#"))
        assert caught.value.code == "CO111"
        _ip("link", "set", name, "up")
        with trio.move_on_after(1):  # the sender too has word of the DOWN pending
            with pytest.raises(TransportError):
                await one.receive()
        await one.send(END)
        assert (await other.receive())[0] == END


def test_an_interface_that_goes_down_is_reported_and_may_come_back(down: str) -> None:
    _ip("link", "set", down, "up")
    _goes_down_and_comes_back(down)
