"""Program download (CiA 302-3): the order of the steps, and what follows from each answer of a device."""

from __future__ import annotations

from binascii import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.manager.programs.download import (
    DownloadLimits,
    ProgramDownload,
    ProgramDownloadError,
    ProgramStep,
    least_duration,
)
from canopen_proto.manager.programs.identity import FlashError, ProgramControl
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.sdo.codec import ABORT, BLOCK_DOWNLOAD
from canopen_proto.sdo.events import ObjectAccessPending
from canopen_proto.sdo.server import Pending
from canopen_proto.simulation.boot_loader import FIRST_PROGRAM, BootLoader, BootLoaderSettings, ProgramMemory
from tests.core.block_pair import pattern
from tests.examples import examples, takes_all
from tests.manager import flash_bench
from tests.manager.flash_bench import FlashBench

IMAGE = pattern(100)
ID = crc32(IMAGE)
ALL_STEPS = [each for each in ProgramStep if each is not ProgramStep.CONFIRM]


@pytest.mark.parametrize("blocks", [True, False])
@pytest.mark.parametrize("size", [1, 4, 5, 889, 890, 5000])
def test_a_program_is_written_and_runs(size: int, blocks: bool) -> None:
    image = pattern(size)
    bench = FlashBench(BootLoaderSettings(blocks=blocks))
    result = bench.flash(image, expected_id=crc32(image))
    assert (bench.memory.program, bench.device.runs) == (image, True)
    assert (result.is_done, result.is_needed, result.delivered, result.writes) == (True, True, size, 1)
    assert (result.id_before, result.id_after) == (crc32(FIRST_PROGRAM), crc32(image))
    assert bench.steps == ALL_STEPS
    assert bench.progress[-1].done == size
    done = [each.done for each in bench.progress]
    assert done == sorted(done)


def test_nothing_is_written_if_the_device_runs_that_program() -> None:
    bench = FlashBench(memory=ProgramMemory(IMAGE))
    result = bench.flash(IMAGE, expected_id=ID)
    assert not result.is_needed
    assert not any(line.startswith(("606#2", "606#C", "000#")) for line in bench.to_device())
    assert bench.flash(IMAGE, expected_id=ID, force=True).writes == 1
    assert bench.flash(IMAGE).writes == 1


def test_a_program_that_is_there_and_stopped_is_only_started() -> None:
    """The call before ended between the data and the start."""
    bench = FlashBench(memory=ProgramMemory(IMAGE))
    bench.device.runs = False
    result = bench.flash(IMAGE, expected_id=ID)
    assert (result.writes, result.is_needed, bench.device.runs) == (0, True, True)
    assert bench.steps == [ProgramStep.LOOK, ProgramStep.PREPARE, ProgramStep.START, ProgramStep.CHECK]
    bench.device.runs = False
    bench.bus.sent.clear()
    assert bench.flash(IMAGE).writes == 1
    assert "606#2F511F0100000000" not in bench.to_device(), "it stood already"


class Stale(BootLoader):
    """Without a program it still shows the identification of the last one."""

    @property
    def identification(self) -> int:
        return ID


def test_an_identification_counts_only_if_the_flash_status_has_nothing_against_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", Stale)
    bench = FlashBench(memory=ProgramMemory(None))
    assert bench.flash(IMAGE, expected_id=ID).writes == 1


@pytest.mark.parametrize("lost", [{0}, {1}, {0, 1, 2, 3}])
def test_a_device_without_an_answer_at_first(lost: set[int]) -> None:
    assert FlashBench(lose=lost).flash(IMAGE).is_done


class LosesBlocks(BootLoader):
    """No segment of a block transfer reaches it."""

    is_in_blocks = False

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == 0x606:
            command = frame.data[0]
            if self.is_in_blocks and command != ABORT:
                return
            self.is_in_blocks = command & 0xE1 == BLOCK_DOWNLOAD
        super().receive(frame, now)


def test_a_program_that_no_block_transfer_brings_is_written_without_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", LosesBlocks)
    bench, image = FlashBench(), pattern(300)
    assert bench.flash(image, expected_id=crc32(image)).writes == 3
    assert bench.memory.program == image


def test_a_device_that_is_not_there() -> None:
    bench = FlashBench()
    bench.power_off()
    begun = bench.bus.now
    with pytest.raises(ProgramDownloadError, match="does not answer.*nothing was written.*canopen scan") as caught:
        bench.flash(IMAGE)
    assert caught.value.is_silent
    assert bench.bus.now - begun < 5 * SECOND


def test_each_frame_may_get_lost() -> None:
    """Nearly always the download repairs it itself; the next call does in any case. Every day each second frame."""
    bench = FlashBench()
    bench.flash(IMAGE, expected_id=ID)
    total, failures = bench.bus.count, 0
    for number in range(0, total, 1 if takes_all() else 2):
        bench = FlashBench(lose={number})
        try:
            bench.flash(IMAGE, expected_id=ID)
        except ProgramDownloadError:
            failures += 1
            bench.flash(IMAGE, expected_id=ID)
        assert (bench.memory.program, bench.device.runs) == (IMAGE, True), number
    assert failures == 0
    assert total == 66


@examples(20)
@given(seed=st.integers(0, 1 << 32), loss=st.sampled_from([0.02, 0.1]), blocks=st.booleans(), deaf=st.booleans())
def test_however_much_gets_lost_some_call_ends_well(seed: int, loss: float, blocks: bool, deaf: bool) -> None:
    bench = FlashBench(BootLoaderSettings(blocks=blocks, is_deaf=deaf, erase_time=SECOND), seed=seed)
    bench.bus.disturb((MILLISECOND // 10, 3 * MILLISECOND), loss=loss)
    for _ in range(100):  # by segments, with every tenth frame lost, about one call of eight ends well
        try:
            bench.flash(IMAGE, expected_id=ID)
        except ProgramDownloadError:
            continue
        assert (bench.memory.program, bench.device.runs) == (IMAGE, True)
        return
    raise AssertionError("100 calls did not end well")


@examples(20)
@given(seed=st.integers(0, 1 << 32), blocks=st.booleans())
def test_answers_that_come_late(seed: int, blocks: bool) -> None:
    """Up to one and a half time-outs each: a late answer must not count for another request."""
    bench = FlashBench(BootLoaderSettings(blocks=blocks), seed=seed)
    bench.bus.disturb((MILLISECOND, 700 * MILLISECOND))
    for _ in range(20):
        try:
            bench.flash(pattern(30), expected_id=crc32(pattern(30)))
        except ProgramDownloadError:
            continue
        assert (bench.memory.program, bench.device.runs) == (pattern(30), True)
        return
    raise AssertionError("20 calls did not end well")


@pytest.mark.parametrize("settings", [BootLoaderSettings(), BootLoaderSettings(blocks=False), BootLoaderSettings(trial=True)])
def test_the_power_may_be_cut_at_any_moment(settings: BootLoaderSettings) -> None:
    """The flash keeps all that is left; the next call makes it whole."""
    bench = FlashBench(settings)
    begun = bench.bus.now
    bench.flash(IMAGE, expected_id=ID, confirm=settings.trial)
    duration, total = bench.bus.now - begun, len(bench.bus.sent)
    for moment in range(0, total + 24, 1 if takes_all() else 5):
        bench = FlashBench(settings)
        bench.begin(IMAGE, expected_id=ID, confirm=settings.trial, limits=DownloadLimits(start=SECOND, busy=SECOND))
        if moment < total:
            bench.bus.run_until(lambda bench=bench, moment=moment: len(bench.bus.sent) > moment)  # type: ignore[misc]
        else:
            bench.bus.run((moment - total) * duration // 24)
        bench.power_off()
        bench.outcome()
        bench.power_on()
        bench.bus.run(200 * MILLISECOND)
        runs = bench.device.runs
        assert runs == (bench.memory.program is not None)
        assert bench.memory.program in (None, IMAGE, FIRST_PROGRAM)
        assert runs or not settings.trial, "the old program stays as long as the new one is not confirmed"
        bench.flash(IMAGE, expected_id=ID, confirm=settings.trial)
        assert (bench.memory.program, bench.device.runs, bench.device.control) == (IMAGE, True, ProgramControl.START)


def test_a_power_cut_during_the_write_is_survived_by_the_same_call() -> None:
    bench = FlashBench()
    bench.begin(pattern(5000))
    bench.bus.run_until(lambda: len(bench.memory.content) > 800)
    bench.power_off()
    bench.bus.run(100 * MILLISECOND)
    bench.power_on()
    bench.outcome()
    assert (bench.memory.program, bench.device.runs) == (pattern(5000), True)


@pytest.mark.parametrize("error", range(1, 128) if takes_all() else (1, 2, 3, 4, 5, 6, 7, 20, 63, 64, 127))
def test_a_wrong_image_is_refused_and_the_error_named(error: int) -> None:
    bench = FlashBench(BootLoaderSettings(judge=lambda image: error))
    with pytest.raises(ProgramDownloadError, match=f"0x1F57:01. is 0x{error << 1:08X}: ") as caught:
        bench.flash(IMAGE, expected_id=ID)
    assert caught.value.so_far.step is ProgramStep.PROGRAM
    assert not bench.device.runs


def test_a_program_of_no_bytes_is_a_matter_of_the_device() -> None:
    with pytest.raises(ProgramDownloadError, match="0x00000004: the format of the data is unknown"):
        FlashBench().flash(b"")
    bench = FlashBench(BootLoaderSettings(judge=lambda image: FlashError.NONE, identify=lambda image: 7))
    assert bench.flash(b"").is_done
    assert bench.memory.program == b""


def test_an_image_with_another_identification_is_not_started() -> None:
    bench = FlashBench()
    with pytest.raises(ProgramDownloadError, match="should have the identification 0x12345678, and it shows 0x") as caught:
        bench.flash(IMAGE, expected_id=0x12345678)
    assert (caught.value.is_mismatch, caught.value.so_far.step, bench.device.runs) == (True, ProgramStep.VERIFY, False)
    assert bench.flash(IMAGE, expected_id=ID).is_done


def test_a_secured_flash() -> None:
    bench = FlashBench(BootLoaderSettings(is_secured=True))
    with pytest.raises(ProgramDownloadError, match="0x08000022.*secured against writing"):
        bench.flash(IMAGE)


@pytest.mark.parametrize("step", [ProgramStep.CLEAR, ProgramStep.PROGRAM])
def test_a_device_that_stays_busy_ends_in_an_error(step: ProgramStep) -> None:
    long = 10_000 * SECOND
    settings = BootLoaderSettings(erase_time=long) if step is ProgramStep.CLEAR else BootLoaderSettings(program_time=long)
    bench = FlashBench(settings)
    begun = bench.bus.now
    with pytest.raises(ProgramDownloadError, match="flash stays busy .0x1F57:01., for 30 s now") as caught:
        bench.flash(IMAGE, expected_id=ID)
    assert caught.value.so_far.step is step
    assert 30 * SECOND <= bench.bus.now - begun < 32 * SECOND


@pytest.mark.parametrize("jumps", [(0,), (1,), (0, 1)])
def test_stop_and_start_may_have_no_answer(jumps: tuple[int, ...]) -> None:
    bench = FlashBench(BootLoaderSettings(jumps=jumps, boot_time=700 * MILLISECOND))
    assert bench.flash(IMAGE, expected_id=ID).writes == 1
    assert bench.device.runs


def test_a_start_that_nothing_but_the_answer_shows() -> None:
    assert FlashBench(BootLoaderSettings(resets=False)).flash(IMAGE, expected_id=ID).is_done


@pytest.mark.parametrize("erase", [100 * MILLISECOND, 5 * SECOND])
@pytest.mark.parametrize("blocks", [True, False])
def test_late_answers_of_a_device_that_is_deaf_while_it_erases(erase: int, blocks: bool) -> None:
    """The last answer comes after its time-out, and the identification shows that all is there."""
    bench = FlashBench(BootLoaderSettings(is_deaf=True, erase_time=erase, program_time=4 * SECOND, blocks=blocks))
    result = bench.flash(IMAGE, expected_id=ID)
    assert (result.writes, bench.memory.program) == (1, IMAGE)


def test_a_device_that_takes_two_seconds_for_its_last_answer() -> None:
    bench = FlashBench(BootLoaderSettings(is_deaf=True, program_time=2 * SECOND, blocks=False))
    assert bench.flash(IMAGE).writes == 1


def test_after_a_broken_transfer_nobody_says_that_the_old_program_is_there() -> None:
    bench, so_far = FlashBench(BootLoaderSettings(blocks=False)), ProgramDownload(5000)
    bench.begin(pattern(5000), so_far)
    bench.bus.run_until(lambda: len(bench.memory.content) > 800)
    bench.bus.lose = frozenset((bench.bus.count,))
    steps = [so_far.step]
    bench.bus.run_until(lambda: steps.append(so_far.step) or so_far.writes == 2)  # type: ignore[func-returns-value]
    assert set(steps) == {ProgramStep.WRITE, ProgramStep.CLEAR}


def test_a_heartbeat_that_stops_meanwhile_does_not_count() -> None:
    bench = FlashBench(BootLoaderSettings(is_deaf=True, program_time=2 * SECOND), heartbeat=True)
    bench.remote.heartbeat.set_timeout(SECOND, bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.flash(IMAGE).writes == 1
    assert bench.remote.heartbeat.timeout == SECOND


class BadBlocks(BootLoader):
    """It gives up its first transfer, for whatever reason."""

    has_failed = False

    def _take_piece(self, access: ObjectAccessPending, piece: bytes, now: Time) -> None:
        if self.has_failed:
            super()._take_piece(access, piece, now)
        else:
            self.has_failed = True
            self.memory.begin()
            self._is_cleared = False
            self.channels.complete(access.access_id, AbortCode.GENERAL_ERROR, now)


def test_after_a_block_transfer_that_the_device_gave_up_it_goes_in_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", BadBlocks)
    bench = FlashBench()
    assert bench.flash(pattern(2000)).writes == 2
    begins = [each[4:12] for each in bench.to_device() if each[6:12] == "501F01"]
    assert begins == ["C6501F01", "21501F01"]


class GoesBack(BootLoader):
    """It starts no program but that of the factory."""

    def _start(self, now: Time) -> None:
        self.memory.content = bytearray(FIRST_PROGRAM)
        super()._start(now)


def test_a_boot_loader_that_goes_back_to_the_old_program_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", GoesBack)
    with pytest.raises(ProgramDownloadError, match="its boot loader has refused the new program") as caught:
        FlashBench().flash(IMAGE, expected_id=ID)
    assert (caught.value.is_mismatch, caught.value.so_far.step) == (True, ProgramStep.CHECK)


class Dies(BootLoader):
    """Its new program ends right after 0x1F51 has said that it runs; the boot loader stays."""

    started = dead = False

    def _run(self, command: int, now: Time) -> AbortCode | Pending | None:
        self.started = True
        return super()._run(command, now)

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        answer = super().read(index, subindex, now)
        if index == indices.PROGRAM_CONTROL and self.started and self.runs and not self.dead:
            self.dead = self._stays = True
            self.nmt.execute(NmtCommand.RESET_NODE, now)
        return answer


@pytest.mark.parametrize("expected_id", [ID, None])
def test_a_program_that_ends_right_after_its_start_is_no_success(
    monkeypatch: pytest.MonkeyPatch, expected_id: int | None
) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", Dies)
    with pytest.raises(ProgramDownloadError, match="was started, and does not run") as caught:
        FlashBench().flash(IMAGE, expected_id=expected_id)
    assert caught.value.so_far.step is ProgramStep.CHECK


# ---- large programs, and one that is cancelled ----


def test_a_large_program_with_progress() -> None:
    """1 MiB, in part every day; the bus carries a frame in 0.1 ms."""
    image = pattern(1 << 20 if takes_all() else 1 << 16)
    bench = FlashBench(frame_time=100 * MICROSECOND)
    bench.flash(image, expected_id=crc32(image))
    assert bench.memory.program == image
    written = [each for each in bench.progress if each.step is ProgramStep.WRITE]
    assert len(written) > 5
    assert [each.done for each in written] == sorted({each.done for each in written})
    assert (bench.progress[-1].done, bench.progress[-1].total) == (len(image), len(image))


@pytest.mark.parametrize("step", [ProgramStep.LOOK, ProgramStep.CLEAR, ProgramStep.WRITE, ProgramStep.PROGRAM, ProgramStep.START])
def test_a_cancel_leaves_what_the_next_call_repairs(step: ProgramStep) -> None:
    bench, so_far = FlashBench(BootLoaderSettings()), ProgramDownload(5000)
    request_id = bench.begin(pattern(5000), so_far)
    bench.bus.run_until(lambda: so_far.step is step)
    bench.bus.run(50 * MICROSECOND)
    bench.master.cancel(request_id, bench.bus.now)
    assert isinstance(bench.outcome(), ProcedureCancelled)
    assert (so_far.step, so_far.is_done) == (step, False)
    assert bench.remote.sdo.timeout == 500 * MILLISECOND
    bench.bus.run(SECOND)
    bench.flash(pattern(5000), expected_id=crc32(pattern(5000)))
    assert (bench.memory.program, bench.device.runs) == (pattern(5000), True)


@pytest.mark.parametrize(("bit_rate", "blocks", "least"), [(1_000_000, True, 16.8), (125_000, True, 134), (1_000_000, False, 33)])
def test_the_least_time_of_a_mebibyte(bit_rate: int, blocks: bool, least: float) -> None:
    assert least_duration(1 << 20, bit_rate, blocks=blocks) / SECOND == pytest.approx(least, rel=0.02)
