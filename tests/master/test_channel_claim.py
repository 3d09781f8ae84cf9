"""Who uses the SDO channel of a node: one program of ours at a time, and its name (channel_claim.py)."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest
import trio
import trio.testing

from canopen_master.claims.channel_claim import LONG, SHORT, ChannelTakenError, channel_claim, state_claim
from tests.loops import loop

pytestmark = pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="only Linux has abstract sockets with a name behind")
BUS = f"tcp:127.0.0.1:{os.getpid()}"
"""No bus: only its name counts. Of this process alone, since tests run side by side."""


async def channel_free(locator: str, node_id: int, patience: float = SHORT) -> None:
    """Wait as a short command does."""
    async with channel_claim(locator, node_id, patience, brief=True):
        pass


def in_virtual_time(function: object) -> None:
    trio.run(function, clock=trio.testing.MockClock(autojump_threshold=0))  # type: ignore[arg-type]


def test_a_second_transfer_waits_and_is_then_refused_with_the_name_of_the_first() -> None:
    async def main() -> None:
        async with channel_claim(BUS, 5):
            for enter, patience in ((lambda: channel_free(BUS, 5), SHORT), (lambda: channel_claim(BUS, 5).__aenter__(), LONG)):
                begun = loop.current_time()
                with pytest.raises(ChannelTakenError) as refused:
                    await enter()
                assert patience <= loop.current_time() - begun < patience + 0.1
                assert f"process {os.getpid()} (" in refused.value.seen
                assert refused.value.node_id == 5
            await channel_free(BUS, 6)
            await channel_free(BUS.replace("tcp:", "udp_multicast:"), 5)
        await channel_free(BUS, 5, 0)

    in_virtual_time(main)


def test_it_goes_on_once_the_first_is_done() -> None:
    async def main() -> None:
        async def first() -> None:
            async with channel_claim(BUS, 5):
                await loop.sleep(1)

        async with loop.open_nursery() as nursery:
            nursery.start_soon(first)
            await loop.sleep(0.1)
            await channel_free(BUS, 5)
            assert 1 <= loop.current_time() - begun < 1.1

    begun = 0.0

    async def timed() -> None:
        nonlocal begun
        begun = loop.current_time()
        await main()

    in_virtual_time(timed)


@pytest.mark.parametrize(("one", "other"), [("can0", "socketcan:can0"), ("/dev/pcan32", "pcan:PCAN_USBBUS1@500k"),
                                            ("tcp:localhost:20999", "tcp:127.0.0.1:20999")])  # fmt: skip
def test_two_names_of_one_bus_are_one_bus(one: str, other: str) -> None:
    async def main() -> None:
        async with channel_claim(one, 99):
            with pytest.raises(ChannelTakenError):
                await channel_free(other, 99)

    in_virtual_time(main)


def test_a_bus_in_the_process_and_a_log_need_no_claim() -> None:
    async def main() -> None:
        for locator in ("virtual:demo", "file:trace.log", "nonsense::"):
            async with channel_claim(locator, 5):
                await channel_free(locator, 5, 0)

    in_virtual_time(main)


def test_the_kernel_releases_the_claim_of_a_process_that_is_killed() -> None:
    script = f"""
import trio
from canopen_master.claims.channel_claim import channel_claim
async def main():
    async with channel_claim({BUS!r}, 7):
        print("claimed", flush=True)
        await trio.sleep_forever()
trio.run(main)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"claimed\n"

        async def refused() -> None:
            with pytest.raises(ChannelTakenError, match=f"process {other.pid} "):
                await channel_free(BUS, 7, 0)

        in_virtual_time(refused)
        other.kill()
        other.wait()

        async def free() -> None:
            await channel_free(BUS, 7, 0)

        in_virtual_time(free)


def test_one_program_alone_has_the_nmt_state_of_a_node_and_nobody_is_kept_from_its_channels() -> None:
    async def main() -> None:
        async with state_claim(BUS, [5, 6]):
            await channel_free(BUS, 5, 0)
            async with channel_claim(BUS, 5, writes=True), state_claim(BUS, [7]):
                pass
            with pytest.raises(ChannelTakenError, match="another program resets and starts node 6") as refused:
                await state_claim(BUS, [7, 6]).__aenter__()
            assert f"process {os.getpid()} (" in refused.value.seen
            async with state_claim(BUS, [7], 0):
                pass
        async with state_claim(BUS, [5, 6], 0):
            pass

    in_virtual_time(main)
