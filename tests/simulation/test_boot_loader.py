"""The simulated device with a boot loader: what it refuses, and that nothing whatever makes it raise."""

from __future__ import annotations

import random

import pytest

from canopen_proto import indices
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Outbox
from canopen_proto.manager.programs.identity import FlashError, FlashStatus, ProgramControl, flash_status
from canopen_proto.nmt import NmtCommand
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings, ProgramMemory, Slot
from tests.core.block_pair import pattern
from tests.core.bus import Bus
from tests.data.subjects import BootLoaderSubject

STOP, START, RESET, CLEAR = (bytes((each,)) for each in range(4))


class Bench:
    """The device and an SDO client."""

    def __init__(self, settings: BootLoaderSettings | None = None, memory: ProgramMemory | None = None) -> None:
        self.bus = Bus()
        self.client = self.bus.attach(SdoClient(Outbox(), 5))
        self.device = self.bus.attach(BootLoader(Outbox(), 5, settings, memory))
        self.device.boot(0)
        self.bus.run(MILLISECOND)

    def write(self, index: int, data: bytes, subindex: int = 1) -> int:
        """Return the abort code, or 0."""
        self.client.download(index, subindex, data, self.bus.now, block="auto")
        self.bus.run_until(lambda: not self.client.busy)
        self.bus.run(SECOND)
        aborted = self.bus.take_events(SdoAborted)
        assert aborted or self.bus.take_events(SdoDownloaded)
        return aborted[0].abort_code if aborted else 0

    def command(self, *commands: bytes) -> list[int]:
        return [self.write(indices.PROGRAM_CONTROL, each) for each in commands]

    def read(self, index: int, subindex: int = 1) -> int:
        self.client.upload(index, subindex, self.bus.now)
        self.bus.run_until(lambda: not self.client.busy)
        (read,) = self.bus.take_events(SdoUploaded)
        return int.from_bytes(read.data, "little")

    @property
    def status(self) -> FlashStatus:
        return flash_status(self.read(indices.FLASH_STATUS))


def test_what_the_objects_show() -> None:
    bench = Bench()
    for index in (indices.PROGRAM_DATA, indices.PROGRAM_CONTROL, indices.PROGRAM_SOFTWARE, indices.FLASH_STATUS):
        assert bench.read(index, 0) == 1
    assert bench.read(indices.PROGRAM_CONTROL) == ProgramControl.START
    assert bench.command(STOP) == [0]
    assert bench.read(indices.PROGRAM_CONTROL) == ProgramControl.STOP
    assert bench.command(CLEAR) == [0]
    assert (bench.read(indices.PROGRAM_CONTROL), bench.read(indices.PROGRAM_SOFTWARE)) == (ProgramControl.CLEAR, 0)
    assert bench.write(indices.PROGRAM_DATA, pattern(50)) == 0
    assert bench.read(indices.PROGRAM_SOFTWARE) == bench.device.identification != 0
    assert bench.command(START) == [0]
    assert bench.read(indices.PROGRAM_CONTROL) == ProgramControl.START


@pytest.mark.parametrize(
    ("before", "command"), [((), CLEAR), ((), START), ((STOP, CLEAR), START), ((STOP, CLEAR), RESET), ((STOP, CLEAR), CLEAR)]
)
def test_commands_out_of_turn(before: tuple[bytes, ...], command: bytes) -> None:
    bench = Bench()
    bench.command(*before)
    assert bench.command(command) == [0x08000022]


def test_commands_that_it_does_not_have() -> None:
    bench = Bench()
    assert bench.command(b"\x04", b"\x80") == [0x06090030, 0x06090030]
    assert bench.write(indices.PROGRAM_CONTROL, b"\0\0") == 0x06070012
    assert bench.command(RESET) == [0]


@pytest.mark.parametrize("size", [1, 4, 5, 100])
@pytest.mark.parametrize("before", [(), (STOP,)])
def test_data_are_refused_before_the_flash_is_cleared(before: tuple[bytes, ...], size: int) -> None:
    bench = Bench()
    bench.command(*before)
    assert bench.write(indices.PROGRAM_DATA, pattern(size)) == 0x08000022
    assert bench.status.error == FlashError.NOT_CLEARED


def test_everything_is_refused_while_it_is_operational() -> None:
    bench = Bench()
    bench.device.execute(NmtCommand.START, bench.bus.now)
    assert bench.command(STOP) == [0x08000022]
    assert bench.write(indices.PROGRAM_DATA, pattern(50)) == 0x08000022


def test_a_program_that_is_too_large() -> None:
    bench = Bench(BootLoaderSettings(size=100))
    bench.command(STOP, CLEAR)
    assert bench.write(indices.PROGRAM_DATA, pattern(101)) == 0x06070012
    assert bench.status.error == FlashError.ADDRESS_ERROR


def test_it_is_busy_while_it_erases_and_refuses_then() -> None:
    bench = Bench(BootLoaderSettings(erase_time=10 * SECOND))
    bench.command(STOP, CLEAR)
    assert bench.status.is_busy
    assert (bench.command(STOP), bench.write(indices.PROGRAM_DATA, pattern(50))) == ([0x08000022], 0x08000022)
    bench.bus.run(10 * SECOND)
    assert not bench.status.is_busy


def test_a_reset_in_the_middle_leaves_no_program() -> None:
    bench = Bench(BootLoaderSettings(erase_time=10 * SECOND))
    bench.command(STOP, CLEAR)
    bench.bus.send("000#8105")
    bench.bus.run(SECOND)
    assert (bench.device.memory.slot, bench.status.error) == (Slot.TORN, FlashError.NO_PROGRAM)
    assert bench.command(START) == [0x08000022]


def test_a_device_that_comes_without_a_program() -> None:
    bench = Bench(memory=ProgramMemory(None))
    assert (bench.read(indices.PROGRAM_CONTROL), bench.status.error) == (ProgramControl.CLEAR, FlashError.NO_PROGRAM)
    assert bench.write(indices.PROGRAM_DATA, pattern(50)) == 0


def test_a_server_without_block_transfer_refuses_both_directions() -> None:
    bench = Bench(BootLoaderSettings(blocks=False))
    bench.client.upload(0x1008, 0, bench.bus.now, block=True)
    bench.client.download(indices.PROGRAM_DATA, 1, pattern(50), bench.bus.now, block=True)
    bench.bus.run(SECOND)
    assert [each.abort_code for each in bench.bus.take_events(SdoAborted)] == [0x05040001, 0x05040001]


@pytest.mark.parametrize("value", [0, 1, 2, 0x0E, 0x7E, 0xFE, 0x12340004])
def test_a_flash_status_is_taken_apart_and_put_together(value: int) -> None:
    assert flash_status(value).value == value
    assert flash_status(value).text


SETTINGS = [
    BootLoaderSettings(),
    BootLoaderSettings(is_deaf=True, jumps=(0, 1, 2), blocks=False),
    BootLoaderSettings(trial=True, erase_time=0, program_time=0, boot_time=0),
]


@pytest.mark.parametrize("settings", SETTINGS, ids=["usual", "deaf", "trial"])
def test_nothing_raises_and_nothing_grows(settings: BootLoaderSettings) -> None:
    source = random.Random(1)
    subject = BootLoaderSubject(settings)
    of_segments = [bytes((command,)) + source.randbytes(7) for command in (0x00, 0x10, 0x01, 0x11, 0x81, 0x82, 0xC1, 0xD5)]
    likely = [bytes.fromhex(f"2F511F01{command:02X}000000") for command in (0, 0, 3, 3, 1, 2, 0x80)] + [
        bytes.fromhex(each) for each in ("21501F0114000000", "C6501F0114000000", "23501F0101020304", "40571F0100000000")
    ]
    written = 0
    for number in range(3000):
        frame = Frame(0x605, source.choice(likely if source.random() < 0.6 else of_segments))
        subject.receive(Frame(0, source.choice((b"\x81\x05", b"\x80\x05", b"\x01\x05"))) if number % 50 == 49 else frame)
        if number % 2:
            subject.pass_time(source.choice((1, 20, 100, 400)) * MILLISECOND)
        written += subject.node.memory.program not in (None, b"the program of the factory")
        if number % 300 == 0:
            subject.forget_trace()
            subject.check()
    assert written, "else it never came far"
