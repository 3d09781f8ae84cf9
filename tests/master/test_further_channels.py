"""Two programs on one node at once, by a further SDO channel of the device: further_channels.py, channel_claim.py.

The bus is inside this process; only the claims have the name of a bus between processes.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import pytest

from canopen_data.configured import configure
from canopen_data.describing import describe
from canopen_data.descriptions import load_description
from canopen_data.eds.writer import write_eds
from canopen_master import Master, Node, open_master
from canopen_master.claims.channel_claim import LONG, ChannelTakenError, channel_claim
from canopen_master.claims.further_channels import FurtherChannels
from canopen_master.errors import SdoTimeoutError
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_transports import open_transport
from tests.core.devices import LIMITED, TEXT, io_device
from tests.master.loops import loop
from tests.master.world import BUS, simulated, virtual_time

pytestmark = pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="only Linux has abstract sockets with a name behind")
CLAIMS = f"tcp:127.0.0.1:{os.getpid()}"
INVALID = 1 << 31
LONG_TEXT = "a text of many segments " * 100


def device(*servers: dict[int, int]) -> ObjectDictionary:
    """An I/O device with these further SDO servers: COB-IDs and client by subindex."""
    own = [standard_object(0x1201 + number, defaults=defaults) for number, defaults in enumerate(servers)]
    return io_device().with_objects([standard_object(0x1200), *own])


ONE = device({1: 0x6A1, 2: 0x6A2})
TWO = device({1: 0x6A1, 2: 0x6A2}, {1: 0x6B1, 2: 0x6B2})


def served(dictionary: ObjectDictionary, node_id: int = 5) -> list[Callable[..., LocalNode]]:
    return [lambda out: LocalNode(out, node_id, configure(dictionary, {TEXT << 8: LONG_TEXT}, node_id))]


class Program:
    """One of our programs. told: its lines for people."""

    def __init__(self, master: Master, file: ObjectDictionary) -> None:
        self.node: Node = master.node(5, file)
        self.told: list[str] = []
        self.further = FurtherChannels(self.node, [file], self.told.append)

    @asynccontextmanager
    async def channel(self, patience: float = LONG) -> AsyncIterator[None]:
        async with channel_claim(CLAIMS, 5, patience, further=self.further):
            yield


@asynccontextmanager
async def programs(
    count: int, file: ObjectDictionary, real: ObjectDictionary | None = None
) -> AsyncIterator[tuple[list[Program], list[Frame]]]:
    """Programs on a device. real: what the device is, where the file is wrong. Also: all frames on the bus."""
    frames: list[Frame] = []
    async with simulated(makers=served(file if real is None else real)), loop.open_nursery() as nursery:
        async with open_master(BUS) as one, open_master(BUS) as two, open_master(BUS) as three:
            bus = await open_transport(BUS)

            async def listen() -> None:
                while True:
                    frames.append((await bus.receive())[0])

            nursery.start_soon(listen)
            yield [Program(master, file) for master in (one, two, three)[:count]], frames
        nursery.cancel_scope.cancel()


async def busy(program: Program, channel: int, texts: list[object]) -> None:
    async with program.channel():
        assert program.node.remote.sdo.can_id == channel
        texts.append(await program.node.read(TEXT))
    assert program.node.remote.sdo.can_id == 0x605


@virtual_time
async def test_two_programs_read_at_once_each_over_a_channel_of_its_own() -> None:
    async with programs(2, ONE) as ((one, two), frames):
        texts: list[object] = []
        async with one.channel(), loop.open_nursery() as nursery:
            nursery.start_soon(busy, two, 0x6A1, texts)
            while not texts:
                assert await one.node.read(TEXT) == LONG_TEXT
        assert texts == [LONG_TEXT]
        assert one.told == []
        (line,) = two.told
        assert line.startswith(f"the first SDO channel of node 5 is in use by process {os.getpid()} (")
        assert line.endswith("): 0x1201 is used")
        await loop.sleep(0.1)  # for the frames
        segments = {frame.can_id for frame in frames if frame.can_id & 0x600 == 0x600 and frame.data[0] & 0xE0 == 0x60}
        assert segments == {0x605, 0x6A1}
        assert one.node.remote.sdo.other.count == 0  # the first one was not disturbed


@virtual_time
async def test_a_third_program_has_the_third_channel_or_waits() -> None:
    async with programs(3, TWO) as ((one, two, three), _), one.channel(), two.channel(), three.channel():
        assert [each.node.remote.sdo.can_id for each in (one, two, three)] == [0x605, 0x6A1, 0x6B1]
        assert three.told[0].endswith("0x1202 is used")
    async with programs(3, ONE) as ((one, two, three), _):
        async with one.channel(), two.channel():
            with pytest.raises(ChannelTakenError, match="nothing was sent over it"):
                async with three.channel():
                    raise AssertionError
            assert three.further.unusable == {}
        async with three.channel():
            assert three.node.remote.sdo.can_id == 0x605


@virtual_time
async def test_a_channel_of_the_file_that_the_device_does_not_have_is_told_and_the_first_one_is_not_touched() -> None:
    real = device({1: INVALID | 0x6A1, 2: INVALID | 0x6A2})
    async with programs(2, ONE, real) as ((one, two), frames), one.channel():
        with pytest.raises(ChannelTakenError) as refused:
            async with two.channel():
                raise AssertionError
        assert "its further channel 0x1201 of the file did not answer" in refused.value.seen
        assert {frame.can_id for frame in frames} <= {0x6A1, 0x705, 0x085}
        assert [frame.data[0] for frame in frames if frame.can_id == 0x6A1] == [0x40, 0x80]  # asked once, and given up
        assert two.told == []
        assert two.node.remote.sdo.can_id == 0x605


@virtual_time
async def test_after_a_channel_that_does_not_answer_the_first_one_is_used_once_it_is_free() -> None:
    real = device({1: INVALID | 0x6A1, 2: INVALID | 0x6A2})
    async with programs(2, ONE, real) as ((one, two), _), loop.open_nursery() as nursery:

        async def first() -> None:
            async with one.channel():
                await loop.sleep(3)

        nursery.start_soon(first)
        await loop.sleep(0.1)
        async with two.channel():
            assert await two.node.read(TEXT) == LONG_TEXT


@pytest.mark.parametrize(
    ("file", "real", "why"),
    [
        (device({1: 0x6A1, 2: 0x6A2, 3: 9}), None, "is for the client with node-ID 9, says the file"),
        (ONE, device({1: 0x6A1, 2: 0x6A2, 3: 9}), "is for the client with node-ID 9, says the device"),
        (device({1: 0x6A1, 2: 0x6A2}, {1: INVALID, 2: INVALID}), device({1: INVALID, 2: INVALID}, {1: 0x6A1, 2: 0x6A2}),
         "is another one in the device than in the file"),
        (device({1: 0x306, 2: 0x286}), None, "has CAN-ID 0x306 in the file, of the predefined PDOs, SYNC, TIME or EMCY"),
        (device({1: INVALID | 0x6A1, 2: 0x6A2}), None, ""),
        (device({1: 1 << 30 | 0x6A1, 2: 1 << 30 | 0x6A2}), None, ""),
    ],
)  # fmt: skip
def test_a_channel_of_somebody_else_or_of_an_sdo_manager_is_not_used(
    file: ObjectDictionary, real: ObjectDictionary | None, why: str
) -> None:
    @virtual_time
    async def main() -> None:
        async with programs(2, file, real) as ((one, two), frames), one.channel():
            with pytest.raises(ChannelTakenError) as refused:
                async with two.channel():
                    raise AssertionError
            assert refused.value.seen.endswith(f"its further channel 0x1201 {why}" if why else "10 s at least")
            assert 0x605 not in {frame.can_id for frame in frames}
            assert 0x306 not in {frame.can_id for frame in frames}

    main()


@virtual_time
async def test_another_node_with_the_same_cob_ids_is_not_taken_for_this_one() -> None:
    async with simulated(makers=served(ONE, 6)), open_master(BUS) as master:
        program = Program(master, ONE)
        async with channel_claim(CLAIMS, 5):
            with pytest.raises(ChannelTakenError) as refused:
                async with program.channel():
                    raise AssertionError
        assert refused.value.seen.endswith("answered, but its 0x1200 is not that of node 5")


@pytest.mark.parametrize("whose", [True, False])
def test_a_file_that_adds_the_node_id_is_trusted_where_a_constant_is_not(tmp_path: object, whose: bool) -> None:
    bare = ObjectDictionary(
        [each for index, each in device({1: 0x685, 2: 0x6A5}).objects.items() if index not in (0x1200, 0x1014)]
    )
    text = write_eds(describe(bare))
    if whose:
        text = text.replace("0x00000685", "$NODEID+0x680").replace("0x000006A5", "$NODEID+0x6A0")
    path = f"{tmp_path}/device.eds"
    with open(path, "w", encoding="utf-8") as file:
        file.write(text)
    dictionary = load_description(path).dictionary

    @virtual_time
    async def main() -> None:
        async with programs(2, dictionary) as ((one, two), _), one.channel():
            if whose:
                async with two.channel():
                    assert two.node.remote.sdo.can_id == 0x685
                    assert await two.node.read(TEXT) == LONG_TEXT
                return
            with pytest.raises(ChannelTakenError) as refused:
                async with two.channel():
                    raise AssertionError
            assert refused.value.seen.endswith("the device has neither 0x1200 nor 0x1014")

    main()


@virtual_time
async def test_a_program_that_writes_has_the_node_for_itself() -> None:
    async with programs(3, ONE) as ((one, two, three), _):
        async with channel_claim(CLAIMS, 5, writes=True):
            for each in (one, two):
                with pytest.raises(ChannelTakenError):
                    async with each.channel():
                        raise AssertionError
        async with loop.open_nursery() as nursery:
            order: list[str] = []

            async def reading() -> None:
                async with two.channel():
                    await loop.sleep(3)
                    order.append("read")

            async def writing() -> None:
                async with channel_claim(CLAIMS, 5, writes=True, further=three.further):
                    order.append("written")
                    await three.node.write(LIMITED, 12)

            async with one.channel():
                nursery.start_soon(reading)
                await loop.sleep(1)
            nursery.start_soon(writing)  # the first channel is free, and a reader is on the further one
        assert order == ["read", "written"]
        async with two.channel(), pytest_refuses(channel_claim(CLAIMS, 5, 0, writes=True)) as seen:
            pass
        assert f"process {os.getpid()} (" in seen[0]


@asynccontextmanager
async def pytest_refuses(claim: object) -> AsyncIterator[list[str]]:
    with pytest.raises(ChannelTakenError) as refused:
        await claim.__aenter__()  # type: ignore[attr-defined]
    yield [refused.value.seen]


@virtual_time
async def test_a_claim_of_a_further_channel_is_released_when_the_process_is_killed() -> None:
    script = f"""
import time
from canopen_master.claims.channel_claim import _Claims, _name_of
claims = _Claims(_name_of({CLAIMS!r}, 5))
assert claims.take("") and claims.take("/1201")
print("claimed", flush=True)
time.sleep(1000)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"claimed\n"
        async with programs(2, ONE) as ((one, two), _):
            with pytest.raises(ChannelTakenError, match=f"process {other.pid} "):
                async with one.channel(0):
                    raise AssertionError
            other.kill()
            other.wait()
            async with one.channel(0), two.channel(0):
                assert [each.node.remote.sdo.can_id for each in (one, two)] == [0x605, 0x6A1]


@virtual_time
async def test_a_program_that_fails_or_is_cancelled_gives_its_channel_back() -> None:
    async with programs(3, ONE) as ((one, two, three), _), one.channel():
        with suppress(ZeroDivisionError):
            async with two.channel():
                raise ZeroDivisionError
        with loop.move_on_after(1) as scope:
            async with two.channel():
                await loop.sleep_forever()
        assert scope.cancelled_caught
        assert two.node.remote.sdo.can_id == 0x605
        async with three.channel(0):
            assert three.node.remote.sdo.can_id == 0x6A1


@virtual_time
async def test_a_missing_answer_on_a_further_channel_is_not_blamed_on_the_program_on_the_first() -> None:
    async with simulated(makers=served(ONE)) as host, open_master(BUS) as a, open_master(BUS) as b:
        one, two = Program(a, ONE), Program(b, ONE)
        async with one.channel(), two.channel():
            await one.node.read(LIMITED)
            (device_node,) = host.nodes
            assert isinstance(device_node, LocalNode)
            device_node.channels.servers[2].set_channel(None)
            with pytest.raises(SdoTimeoutError) as missing:
                await two.node.read(LIMITED)
            assert "another" not in missing.value.seen + missing.value.cause
