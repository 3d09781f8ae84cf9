"""What the kernel does for us: filters, and cyclic frames by its broadcast manager."""

from __future__ import annotations

import itertools

import pytest
import trio

from canopen_proto.frame import KEY_EXTENDED, KEY_REMOTE, Frame
from canopen_transports import BusState, BusStateChanged, TransportError, open_transport
from canopen_transports.conformance.frames import END, numbered
from tests.transports.support import reported, trio_test
from tests.vcan.support import interface, ip, joined, needs_vcan, raw_socket, tool

pytestmark = needs_vcan

# ---- filters ----


@trio_test(real_time=True)
async def test_the_kernel_filters_what_it_is_told_to() -> None:
    async with joined("vcan0") as one, joined("vcan0", "?filter=ids") as other:
        frames = [Frame.parse(text) for text in ("181#01", "181#R", "182#", "00000181#", "18FF0001#02", "18FF0001#R1", "705#R")]

        async def through() -> list[str]:
            for frame in [*frames, END]:
                await one.send(frame)
            heard = []
            while (frame := (await other.receive())[0]) != END:
                heard.append(str(frame))
            return heard

        assert other.filtered
        assert len(await through()) == 7  # nobody has set one yet
        assert other.set_filters([0x181, 0x18FF0001 | KEY_EXTENDED | KEY_REMOTE, 0x705 | KEY_REMOTE, END.key])
        assert await through() == ["181#01", "18FF0001#R1", "705#R"]
        assert other.set_filters([END.key, END.key, 0x182])
        assert await through() == ["182#"]
        assert not other.set_filters(range(513))
        assert len(await through()) == 7
        assert other.set_filters([END.key])
        assert not other.set_filters(None)
        assert len(await through()) == 7


@trio_test(real_time=True)
async def test_while_filters_are_renewed_no_frame_is_lost_or_doubled() -> None:
    """Without a pause between two of them: each frame, one in a millisecond, comes amid a renewal."""
    count = 1000
    with interface() as name:
        async with joined(name, "?filter=ids") as one, await open_transport(f"socketcan:{name}") as other:
            one.set_filters([0x181, END.key])
            heard: list[int] = []

            async def send() -> None:
                flood = ["-g", "1", "-n", str(count), "-I", "181", "-L", "4", "-D", "i"]
                await trio.run_process([tool("cangen"), name, *flood])
                await other.send(END)

            async def renew() -> None:
                for turn in itertools.count():
                    assert one.set_filters([0x181, END.key, *range(turn % 3)])
                    if turn % 20 == 0:
                        await trio.lowlevel.checkpoint()

            async with trio.open_nursery() as nursery:
                nursery.start_soon(send)
                nursery.start_soon(renew)
                while (frame := (await one.receive())[0]) != END:
                    heard.append(int.from_bytes(frame.data, "little"))
                nursery.cancel_scope.cancel()
            assert heard == list(range(count))


@trio_test(real_time=True)
async def test_filters_that_are_set_while_the_interface_is_away_hold_when_it_is_back() -> None:
    with interface() as name:
        one = joined(name, "?filter=ids")
    async with one:
        assert (await reported(one)).state is BusState.DOWN
        assert one.set_filters([END.key])
        with interface():
            assert (await reported(one)).state is BusState.UP
            async with joined(name) as other:
                for frame in (numbered(1), END):
                    await other.send(frame)
            assert (await one.receive())[0] == END
    assert one.set_filters([END.key])  # closed: nobody to be told


# ---- cyclic frames ----


@trio_test(real_time=True)
async def test_the_kernel_sends_cyclic_frames() -> None:
    with interface() as name:
        async with joined(name, "?sync=bcm") as one, joined(name) as other:
            assert one.sends_sync
            one.start_cyclic([Frame(0x80, bytes((count,))) for count in (1, 2, 3)], 5_000_000)
            for transport in (one, other):  # we hear the kernel's frames ourselves
                assert [str((await transport.receive())[0]) for _ in range(7)] == [f"080#0{n}" for n in (1, 2, 3, 1, 2, 3, 1)]
            one.start_cyclic([Frame(0x80)], 20_000_000)
            while (await other.receive())[0].data:
                pass
            stamps = [(await other.receive())[1] or 0 for _ in range(6)]
            assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
            one.stop_cyclic()
            one.stop_cyclic()
            await one.send(END)
            while (await other.receive())[0] != END:
                pass
            with trio.move_on_after(0.1) as scope:
                await other.receive()
            assert scope.cancelled_caught
            for frames, period in (([], 10**6), ([Frame(0x80)] * 257, 10**6), ([Frame(0x80)], 999), ([Frame(0x800)], 10**6)):
                one.start_cyclic([END], 5_000_000)
                with pytest.raises(ValueError):
                    one.start_cyclic(frames, period)
                for _ in range(3):  # what ran runs on
                    assert (await other.receive())[0] == END
        with pytest.raises(trio.ClosedResourceError):
            one.start_cyclic([END], 10**6)


@trio_test(real_time=True)
async def test_no_cyclic_frames_on_an_interface_that_is_gone() -> None:
    with interface() as name:
        async with joined(name) as one:
            ip("link", "del", name)
            with pytest.raises(TransportError, match="cyclically"):
                one.start_cyclic([END], 10**6)


@trio_test(real_time=True)
async def test_cyclic_frames_go_on_when_the_adapter_is_plugged_in_again() -> None:
    with interface() as name:
        one = joined(name)
        one.start_cyclic([END], 5_000_000)
    async with one:
        states: list[BusState] = []
        with interface():
            while BusState.UP not in states:
                received = await one.receive()
                if isinstance(received, BusStateChanged):
                    states.append(received.state)
            assert (await one.receive())[0] == END
        assert states == [BusState.DOWN, BusState.UP]


@trio_test(real_time=True)
async def test_cyclic_frames_go_on_when_the_interface_is_up_again_and_end_when_it_is_closed() -> None:
    with interface() as name:
        async with joined(name) as one, joined(name) as other:
            one.start_cyclic([END], 5_000_000)
            ip("link", "set", name, "down")
            states: list[BusState] = []

            async def next_end() -> None:
                while True:
                    received = await other.receive()
                    if not isinstance(received, BusStateChanged):
                        assert received[0] == END
                        return
                    states.append(received.state)
                    if received.state is BusState.DOWN:
                        ip("link", "set", name, "up")

            while states != [BusState.DOWN, BusState.UP]:
                await next_end()
            for _ in range(3):
                await next_end()
            await one.aclose()
            with raw_socket(name) as third:
                third.send(b"\x23\x01" + bytes(14))
            while (await other.receive())[0] != Frame(0x123):  # what was sent before
                pass
            with trio.move_on_after(0.1) as scope:
                await other.receive()
            assert scope.cancelled_caught
