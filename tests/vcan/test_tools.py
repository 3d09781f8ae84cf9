"""Our transport among can-utils: what the kernel's own tools say and hear."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import ReceiveOverrun, open_transport
from canopen_transports.conformance.frames import END, EVERY_KIND
from tests.transports.support import trio_test
from tests.vcan.support import joined, needs_vcan, tool

pytestmark = needs_vcan


@contextmanager
def running(*command: str, stdout: int = subprocess.DEVNULL) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([tool(command[0]), *command[1:]], stdout=stdout, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def listeners() -> int:
    """Sockets that receive whatever comes on vcan0."""
    return sum(line.split()[:1] == ["vcan0"] for line in Path("/proc/net/can/rcvlist_all").read_text().splitlines())


@trio_test(real_time=True)
async def test_candump_reads_what_we_send() -> None:
    frames = [*EVERY_KIND, END]
    async with joined("vcan0") as one:
        before = listeners()
        with running("candump", "-L", "-n", str(len(frames)), "vcan0", stdout=subprocess.PIPE) as dump:
            while listeners() == before:
                await trio.sleep(0.01)
            for frame in frames:
                await one.send(frame)
            text, _ = await trio.to_thread.run_sync(dump.communicate)
    assert [str(Frame.parse(line.split()[2])) for line in text.splitlines()] == [str(frame) for frame in frames]


@trio_test(real_time=True)
async def test_cansend_and_canplayer_are_heard(tmp_path: Path) -> None:
    log = tmp_path / "trace.log"
    frames = [str(Frame(0x180 + number, bytes((number,)))) for number in range(100)]
    log.write_text("".join(f"(1700000000.{number:06}) vcan0 {frame}\n" for number, frame in enumerate(frames)))
    async with joined("vcan0") as one:
        for frame in EVERY_KIND:
            await trio.run_process([tool("cansend"), "vcan0", str(frame)])
            assert (await one.receive())[0] == frame
        await trio.run_process([tool("canplayer"), "-I", str(log)])
        assert [str((await one.receive())[0]) for _ in frames] == frames


@trio_test(real_time=True)
async def test_of_a_flood_of_cangen_nothing_is_lost_silently() -> None:
    count = 20_000
    async with joined("vcan0") as one, await open_transport("pythoncan:socketcan:vcan0") as other:
        command = [tool("cangen"), "vcan0", "-g", "0", "-n", str(count), "-I", "i", "-L", "8", "-D", "i", "-i"]
        heard = lost = 0
        last = -1

        async def send() -> None:
            await trio.run_process(command)
            await other.send(END)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(send)
            while True:
                received = await one.receive()
                if isinstance(received, ReceiveOverrun):
                    lost += received.lost
                    continue
                frame = received[0]
                if frame == END:
                    break
                number = int.from_bytes(frame.data, "little")
                assert number > last
                last = number
                heard += 1
    assert heard + lost == count
    assert heard > 0


@trio_test(real_time=True)
async def test_under_a_flood_others_run_and_closing_is_quick() -> None:
    with running("cangen", "vcan0", "-g", "0", "-i"):
        async with joined("vcan0") as one:
            ended = False

            async def read() -> None:
                nonlocal ended
                with pytest.raises(trio.ClosedResourceError):
                    while True:
                        await one.receive()
                ended = True

            async with trio.open_nursery() as nursery:
                nursery.start_soon(read)
                start = time.monotonic()
                for _ in range(20):
                    await trio.sleep(0.005)
                await one.aclose()
            assert ended
            assert time.monotonic() - start < 10
