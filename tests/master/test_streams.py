"""Reading and writing what nobody holds whole, and leaving it at any point."""

from __future__ import annotations

import gc
from collections.abc import AsyncIterator, Iterator
from functools import partial
from typing import Any

import pytest

from canopen_master import (
    BusError,
    MasterClosedError,
    Node,
    SdoError,
    SdoGivenUpError,
    SdoNotConfirmedError,
    SdoRefusedError,
    SdoTimeoutError,
    open_master,
    streams,
)
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.model import Object, Variable
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import LocalProtocolError, Outbox, Time
from canopen_proto.nmt import NmtCommand
from canopen_proto.sdo.block import SUB_BLOCK_SIZE
from canopen_proto.sdo.block_client import MAX_FED
from canopen_transports import Transport, open_transport
from tests.core.block_pair import pattern
from tests.core.devices import io_device
from tests.loops import fail_after, loop
from tests.master.world import BUS, Breakable, simulated, virtual_time

IMAGE = 0x1F50
ABORTED = "605#80501F0100000008"


def dictionary() -> ObjectDictionary:
    image = Object.of("image", [Variable(IMAGE, 1, "image:1", DataType.DOMAIN)])
    return io_device().with_objects([image])


def device(out: Outbox, kind: type[LocalNode] = LocalNode) -> LocalNode:
    return kind(out, 5, dictionary())


class MuteNode(LocalNode):
    """A device that answers only the first frame of a block upload."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == 0x605 and frame.data[0] & 0xE3 == 0xA0:
            self.out.frames.append(Frame(0x585, b"\xc6" + frame.data[1:4] + bytes.fromhex("64000000")))


class OldNode(LocalNode):
    """A device that knows no block transfer."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == 0x605 and frame.data[0] & 0xE0 in (0xA0, 0xC0):
            self.out.frames.append(Frame(0x585, b"\x80" + frame.data[1:4] + bytes.fromhex("01000405")))
            return
        super().receive(frame, now)


MAKERS = [device]
OLD = [partial(device, kind=OldNode)]


def content_of(node: LocalNode) -> Any:
    return node.values.store.get(IMAGE << 8 | 1)


async def said_on(spy: Transport) -> list[str]:
    """What the master has said until now."""
    frames = []
    with loop.move_on_after(0.2):
        while True:
            frames.append(str((await spy.receive())[0]))
    return [frame for frame in frames if frame.startswith("605")]


def cut(content: bytes, size: int) -> Iterator[bytes]:
    return (content[start : start + size] for start in range(0, len(content), size))


async def slowly(content: bytes, size: int, pause: float = 0.01) -> AsyncIterator[bytes]:
    for piece in cut(content, size):
        await loop.sleep(pause)
        yield piece


async def read_all(node: Node, **options: Any) -> bytes:
    return b"".join([piece async for piece in node.read_stream(IMAGE, 1, **options)])


async def works(node: Node) -> None:
    """The next request is served at once."""
    with fail_after(0.1):
        assert await node.read_bytes(0x1000) == b"\x91\x01\x00\x00"


# ---- there and back ----


@pytest.mark.thorough(3)
@pytest.mark.parametrize("block", ["auto", True, False])
@pytest.mark.parametrize("makers", [MAKERS, OLD])
@virtual_time
async def test_there_and_back(makers: Any, block: Any) -> None:
    content = pattern(5000)
    async with simulated(makers=makers) as host, open_master(BUS) as master:
        node = master.node(5, dictionary())
        if makers is OLD and block is True:
            with pytest.raises(SdoRefusedError):
                await node.write_stream(IMAGE, 1, cut(content, 1024), block=block)
            with pytest.raises(SdoRefusedError):
                await read_all(node, block=block)
            return
        for pieces, size in (
            (cut(content, 1024), None),
            (cut(content, 1024), 5000),
            (slowly(content, 1000), 5000),
            (slowly(content, 7, 0.0001), None) if block == "auto" else (slowly(content, 4999), None),
            ([memoryview(content)], None),
            (bytearray(content), 5000),
        ):
            host.nodes[0].values.store[IMAGE << 8 | 1] = b""
            await node.write_stream(IMAGE, 1, pieces, size, block=block)
            assert content_of(host.nodes[0]) == content
        assert await read_all(node, block=block) == content


@virtual_time
async def test_nothing_at_all() -> None:
    async with simulated(makers=MAKERS) as host, open_master(BUS) as master:
        node = master.node(5, dictionary())
        for block in (True, False, "auto"):
            await node.write_stream(IMAGE, 1, [], block=block)
            await node.write_stream(IMAGE, 1, [b""], 0, block=block)
            assert content_of(host.nodes[0]) == b""
            assert await read_all(node, block=block) == b""


@virtual_time
async def test_block_transfer_of_what_is_held() -> None:
    async with simulated(makers=MAKERS), open_master(BUS) as master, await open_transport(BUS) as spy:
        node = master.node(5, dictionary())
        await node.write((IMAGE, 1), pattern(50), block=True)
        assert await node.read((IMAGE, 1), block=True) == pattern(50)
        await node.write_bytes(IMAGE, 1, pattern(60), block="auto")
        assert await node.read_bytes(IMAGE, 1, block="auto") == pattern(60)
        assert await node.read_bytes(IMAGE, 1) == pattern(60)
        kinds = [frame[4] for frame in await said_on(spy) if "501F01" in frame]
        assert kinds == ["C", "A", "C", "A", "4"]
        with pytest.raises(SdoRefusedError, match="writing 60 bytes to"):
            await node.write_bytes(0x5000, 1, pattern(60))


@virtual_time
async def test_what_is_long_is_never_held() -> None:
    async with simulated(makers=MAKERS) as host, open_master(BUS) as master:
        node = master.node(5, dictionary())
        most = 0

        def pieces() -> Iterator[bytes]:
            nonlocal most
            for _ in range(100):
                transfer = node.remote.sdo._transfer
                most = max(most, len(transfer._content))  # type: ignore[union-attr]
                yield bytes(1024)

        await node.write_stream(IMAGE, 1, pieces())
        assert content_of(host.nodes[0]) == bytes(100 * 1024)
        assert 0 < most <= MAX_FED
        longest = 0
        stream = node.read_stream(IMAGE, 1)
        async for piece in stream:
            longest = max(longest, len(piece))
        assert longest == SUB_BLOCK_SIZE
        assert stream.size == 100 * 1024


# ---- what goes wrong ----


@virtual_time
async def test_what_the_producer_raises_aborts_and_comes_out_as_it_is() -> None:
    async def failing_late() -> AsyncIterator[bytes]:
        yield bytes(5000)
        await loop.sleep(0.1)
        raise ZeroDivisionError("the file is gone")

    def failing() -> Iterator[bytes]:
        yield bytes(5000)
        raise ZeroDivisionError("the file is gone")

    for pieces in (failing_late(), failing()):
        async with simulated(makers=MAKERS) as host, open_master(BUS) as master, await open_transport(BUS) as spy:
            node = master.node(5, dictionary())
            with pytest.raises(ZeroDivisionError, match="the file is gone"):
                await node.write_stream(IMAGE, 1, pieces)
            await works(node)
            said = await said_on(spy)
            assert ABORTED in said
            assert not any(frame[4:6] in ("C1", "C5", "C9", "CD", "D1", "D5", "D9") for frame in said), "no end frame"
            assert not content_of(host.nodes[0])


@pytest.mark.parametrize("block", [True, False])
@pytest.mark.parametrize("given", [99, 101, 5000])
@virtual_time
async def test_another_size_than_announced(given: int, block: Any) -> None:
    async with simulated(makers=MAKERS) as host, open_master(BUS) as master:
        node = master.node(5, dictionary())
        with pytest.raises(LocalProtocolError):
            await node.write_stream(IMAGE, 1, cut(pattern(given), 50), 100, block=block)
        assert not content_of(host.nodes[0])
        await works(node)


@virtual_time
async def test_more_than_can_be_held_for_a_device_without_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "MAX_WHOLE", 1000)
    async with simulated(makers=OLD), open_master(BUS) as master:
        node = master.node(5, dictionary())
        with pytest.raises(LocalProtocolError, match="without block transfer"):
            await node.write_stream(IMAGE, 1, cut(pattern(1001), 100))
        await node.write_stream(IMAGE, 1, cut(pattern(1000), 100))


@virtual_time
async def test_refusals_and_silence() -> None:
    async with simulated(makers=MAKERS), open_master(BUS) as master:
        node = master.node(5, dictionary())
        with pytest.raises(SdoRefusedError, match="5000:01"):
            await node.write_stream(0x5000, 1, [bytes(100)])
        for block in ("auto", False):
            with pytest.raises(SdoRefusedError, match="reading 5000:01"):
                async for _ in node.read_stream(0x5000, 1, block=block):
                    pytest.fail("there is nothing")
        with pytest.raises(SdoRefusedError):
            await node.write_stream(0x1000, 0, [bytes(4)], 4)
        silent = master.node(6, dictionary())
        with pytest.raises(SdoTimeoutError):
            await silent.write_stream(IMAGE, 1, [bytes(100)])
        with pytest.raises(SdoTimeoutError):
            await read_all(silent)
        with pytest.raises(SdoNotConfirmedError):
            await silent.write_stream(IMAGE, 1, [bytes(4)], 4)


@virtual_time
async def test_a_time_out_names_the_time_that_was_waited() -> None:
    async with simulated(makers=[partial(device, kind=MuteNode)]), open_master(BUS, sdo_timeout=0.25) as master:
        node = master.node(5, dictionary())
        for block, seconds in [(True, 2), (False, 0.25)]:
            started = loop.current_time()
            with pytest.raises(SdoTimeoutError, match=f"did not answer reading 1F50:01 .image:1. in {seconds:g} s"):
                await node.read_bytes(IMAGE, 1, block=block)
            assert loop.current_time() - started == pytest.approx(seconds, abs=0.01)


@virtual_time
async def test_a_node_that_boots_ends_a_stream_whatever_its_producer_does() -> None:
    async def forever() -> AsyncIterator[bytes]:
        yield bytes(100)
        await loop.sleep_forever()

    async with simulated(makers=MAKERS), open_master(BUS) as master, loop.open_nursery() as nursery:
        node = master.node(5, dictionary())

        async def writing() -> None:
            with pytest.raises(SdoGivenUpError, match="given up") as caught:
                await node.write_stream(IMAGE, 1, forever())
            assert not isinstance(caught.value, SdoNotConfirmedError)

        nursery.start_soon(writing)
        await loop.sleep(0.1)
        await node.nmt(NmtCommand.RESET_NODE)


@virtual_time
async def test_who_is_too_slow_is_told_so() -> None:
    async with simulated(makers=MAKERS), open_master(BUS) as master:
        node = master.node(5, dictionary())
        node.remote.sdo.stream_timeout = 10**8
        with pytest.raises(SdoGivenUpError, match="given up") as caught:
            await node.write_stream(IMAGE, 1, slowly(bytes(5000), 500, pause=1))
        assert "too slow" in caught.value.cause
        await node.write_stream(IMAGE, 1, [bytes(5000)])
        with pytest.raises(SdoError, match="given up|refused"):
            async for _ in node.read_stream(IMAGE, 1):
                await loop.sleep(1)


# ---- leaving it ----


@pytest.mark.parametrize("after", [0.0, 0.0001, 0.001, 0.02, 0.045])
@virtual_time
async def test_a_cancelled_write_is_aborted_and_the_next_request_works_at_once(after: float) -> None:
    async with simulated(makers=MAKERS) as host, open_master(BUS) as master, await open_transport(BUS) as spy:
        node = master.node(5, dictionary())
        with loop.move_on_after(after) as scope:
            await node.write_stream(IMAGE, 1, slowly(pattern(5000), 1000))
        assert scope.cancelled_caught
        await works(node)
        assert ABORTED in await said_on(spy)
        assert not content_of(host.nodes[0])


@pytest.mark.thorough(3)
@pytest.mark.parametrize("how", ["break", "raise", "aclose", "with", "cancel"])
@virtual_time
async def test_a_read_that_is_left_is_aborted_and_the_next_request_works_at_once(how: str) -> None:
    gc.freeze()  # of what was there before, nothing is to be collected: half a second, where other tests ran before
    async with simulated(makers=MAKERS), open_master(BUS) as master, await open_transport(BUS) as spy:
        node = master.node(5, dictionary())
        await node.write_stream(IMAGE, 1, [pattern(5000)])
        if how == "break":
            async for _ in node.read_stream(IMAGE, 1):
                break
        elif how == "raise":
            with pytest.raises(ZeroDivisionError):
                async for _ in node.read_stream(IMAGE, 1):
                    raise ZeroDivisionError
        elif how == "aclose":
            stream = node.read_stream(IMAGE, 1)
            await anext(stream)
            await stream.aclose()
            assert [piece async for piece in stream] == []
        elif how == "with":
            async with node.read_stream(IMAGE, 1) as stream:
                await anext(stream)
        else:
            with loop.move_on_after(0.01):
                async for _ in node.read_stream(IMAGE, 1):
                    await loop.sleep(1)
        gc.collect()
        await works(node)
        assert ABORTED in await said_on(spy)


@virtual_time
async def test_a_read_that_is_cancelled_while_it_waits() -> None:
    async with open_master(BUS) as master, await open_transport(BUS) as spy:
        with loop.move_on_after(0.1) as scope:
            await read_all(master.node(5, dictionary()))
        assert scope.cancelled_caught
        assert (await said_on(spy))[-1] == ABORTED


def test_a_stream_that_outlives_everything() -> None:
    left: list[Any] = []
    gc.freeze()

    @virtual_time
    async def leave() -> None:
        async with simulated(makers=MAKERS), open_master(BUS) as master:
            node = master.node(5, dictionary())
            await node.write_stream(IMAGE, 1, [pattern(5000)])
            stream = node.read_stream(IMAGE, 1)
            await anext(stream)
            left.append(stream)

    leave()
    left.clear()  # nobody runs any more who could be told
    gc.collect()


@virtual_time
async def test_the_end_of_the_master_and_of_the_bus_end_streams() -> None:
    async with simulated(makers=MAKERS):
        async with open_master(BUS) as master:
            node = master.node(5, dictionary())
            await node.write_stream(IMAGE, 1, [pattern(5000)])
            stream = node.read_stream(IMAGE, 1)
            await anext(stream)
        with pytest.raises(MasterClosedError):
            await anext(stream)
        with pytest.raises(MasterClosedError):
            await node.write_stream(IMAGE, 1, [b"\x00"])
        cable = Breakable()

        def pieces() -> Iterator[bytes]:
            yield bytes(2000)
            cable.cut()
            yield bytes(100_000)

        with pytest.raises(BusError):
            async with open_master(cable) as master:
                await master.node(5, dictionary()).write_stream(IMAGE, 1, pieces())


@virtual_time
async def test_a_device_that_wants_the_size_first_says_so() -> None:
    async with await open_transport(BUS) as device, open_master(BUS) as master, loop.open_nursery() as nursery:
        nursery.start_soon(_refuse, device)
        with pytest.raises(SdoRefusedError) as caught:
            await master.node(5).write_stream(0x1F50, 1, [b"firmware"], block=True)
        assert caught.value.cause == "the device wants to know the size before the first byte"
        nursery.start_soon(_refuse, device)
        with pytest.raises(SdoRefusedError) as caught:
            await master.node(5).write_stream(0x1F50, 1, [b"firmware"], 8, block=True)
        assert "size" not in caught.value.cause


async def _refuse(device: Transport) -> None:
    await device.receive()
    await device.send(Frame.parse("585#80501F0110000706"))
