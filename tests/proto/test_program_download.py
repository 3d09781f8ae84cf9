"""Program download (CiA 302-3): the order of the steps, and what follows from each answer of a device."""

from __future__ import annotations

from binascii import crc32
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.boot.assignment import Assignment
from canopen_proto.boot.commands import NmtCommands
from canopen_proto.boot.entry import BootEntry
from canopen_proto.boot.node_boot import boot_node
from canopen_proto.boot.outcome import BootLetter, BootOutcome
from canopen_proto.boot_loader import BootLoader, BootLoaderSettings, ProgramMemory, Slot
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.procedures.program_download import (
    Limits,
    ProgramDownload,
    ProgramDownloadFailed,
    Step,
    least_duration,
    updating,
)
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFinished
from canopen_proto.programs import FlashError, FlashStatus, ProgramControl
from canopen_proto.sdo.access import Pending
from canopen_proto.sdo.events import SdoServerAborted
from tests.examples import examples, takes_all
from tests.proto import flash_bench
from tests.proto.block_pair import pattern
from tests.proto.flash_bench import NODE, FlashBench

IMAGE = pattern(100)
ID = crc32(IMAGE)
ALL_STEPS = [Step.LOOK, Step.PREPARE, Step.STOP, Step.CLEAR, Step.WRITE, Step.PROGRAM, Step.VERIFY, Step.START, Step.CHECK]


@pytest.mark.parametrize("blocks", [True, False])
@pytest.mark.parametrize("size", [1, 4, 5, 889, 890, 5000])
def test_a_program_is_written_and_runs(size: int, blocks: bool) -> None:
    image = pattern(size)
    bench = FlashBench(BootLoaderSettings(blocks=blocks))
    result = bench.flash(image, expected_id=crc32(image))
    assert (bench.memory.program, bench.device.runs) == (image, True)
    assert (result.is_done, result.is_needed, result.delivered, result.writes) == (True, True, size, 1)
    assert (result.id_before, result.id_after) == (crc32(b"the program of the factory"), crc32(image))
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
    assert bench.steps == [Step.LOOK, Step.PREPARE, Step.START, Step.CHECK]


@pytest.mark.parametrize("lost", [{0}, {1}, {0, 1, 2, 3}])
def test_a_device_without_an_answer_at_first(lost: set[int]) -> None:
    assert FlashBench(lose=lost).flash(IMAGE).is_done


def test_a_device_that_is_not_there() -> None:
    bench = FlashBench()
    bench.power_off()
    begun = bench.bus.now
    with pytest.raises(ProgramDownloadFailed, match="does not answer.*nothing was written.*canopen scan") as caught:
        bench.flash(IMAGE)
    assert caught.value.is_silent
    assert bench.bus.now - begun < 5 * SECOND


def test_each_frame_may_get_lost() -> None:
    """Nearly always the download repairs it itself; the next call does in any case."""
    bench = FlashBench()
    bench.flash(IMAGE, expected_id=ID)
    total, failures = bench.bus.count, 0
    for number in range(total):
        bench = FlashBench(lose={number})
        try:
            bench.flash(IMAGE, expected_id=ID)
        except ProgramDownloadFailed:
            failures += 1
            bench.flash(IMAGE, expected_id=ID)
        assert (bench.memory.program, bench.device.runs) == (IMAGE, True), number
    assert failures == 0
    assert total == 50


@examples(20)
@given(seed=st.integers(0, 1 << 32), loss=st.sampled_from([0.02, 0.1]), blocks=st.booleans(), deaf=st.booleans())
def test_however_much_gets_lost_some_call_ends_well(seed: int, loss: float, blocks: bool, deaf: bool) -> None:
    bench = FlashBench(BootLoaderSettings(blocks=blocks, is_deaf=deaf, erase_time=SECOND), seed=seed)
    bench.bus.disturb((MILLISECOND // 10, 3 * MILLISECOND), loss=loss)
    for _ in range(20):
        try:
            bench.flash(IMAGE, expected_id=ID)
        except ProgramDownloadFailed:
            continue
        assert (bench.memory.program, bench.device.runs) == (IMAGE, True)
        return
    raise AssertionError("20 calls did not end well")


@examples(20)
@given(seed=st.integers(0, 1 << 32), blocks=st.booleans())
def test_answers_that_come_late(seed: int, blocks: bool) -> None:
    """Up to one and a half time-outs each: a late answer must not count for another request."""
    bench = FlashBench(BootLoaderSettings(blocks=blocks), seed=seed)
    bench.bus.disturb((MILLISECOND, 700 * MILLISECOND))
    for _ in range(20):
        try:
            bench.flash(pattern(30), expected_id=crc32(pattern(30)))
        except ProgramDownloadFailed:
            continue
        assert (bench.memory.program, bench.device.runs) == (pattern(30), True)
        return
    raise AssertionError("20 calls did not end well")


@pytest.mark.parametrize("settings", [BootLoaderSettings(), BootLoaderSettings(blocks=False), BootLoaderSettings(trial=True)])
def test_the_power_may_be_cut_at_any_moment(settings: BootLoaderSettings) -> None:
    """What flash keeps is all that is left; the next call makes it whole."""
    bench = FlashBench(settings)
    begun = bench.bus.now
    bench.flash(IMAGE, expected_id=ID, confirm=settings.trial)
    duration, total = bench.bus.now - begun, len(bench.bus.sent)
    for moment in range(0, total + 24, 1 if takes_all() else 5):
        bench = FlashBench(settings)
        bench.begin(IMAGE, expected_id=ID, confirm=settings.trial, limits=Limits(start=SECOND, busy=SECOND))
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
        assert bench.memory.program in (None, IMAGE, b"the program of the factory")
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


@pytest.mark.parametrize("error", [each for each in range(1, 128) if each in (2, 3, 5, 6, 63, 64, 127, 20)])
def test_a_wrong_image_is_refused_and_the_error_named(error: int) -> None:
    bench = FlashBench(BootLoaderSettings(judge=lambda image: error))
    with pytest.raises(ProgramDownloadFailed, match=f"0x1F57:01. is 0x{error << 1:08X}: ") as caught:
        bench.flash(IMAGE, expected_id=ID)
    assert caught.value.so_far.step is Step.PROGRAM
    assert not bench.device.runs


def test_an_image_with_another_identification_is_not_started() -> None:
    bench = FlashBench()
    with pytest.raises(ProgramDownloadFailed, match="should have the identification 0x12345678, and it shows 0x") as caught:
        bench.flash(IMAGE, expected_id=0x12345678)
    assert (caught.value.is_mismatch, caught.value.so_far.step, bench.device.runs) == (True, Step.VERIFY, False)
    assert bench.flash(IMAGE, expected_id=ID).is_done


def test_a_secured_flash() -> None:
    bench = FlashBench(BootLoaderSettings(is_secured=True))
    with pytest.raises(ProgramDownloadFailed, match="0x08000022.*secured against writing"):
        bench.flash(IMAGE)


@pytest.mark.parametrize("step", [Step.CLEAR, Step.PROGRAM])
def test_a_device_that_stays_busy_ends_in_an_error(step: Step) -> None:
    long = 10_000 * SECOND
    settings = BootLoaderSettings(erase_time=long) if step is Step.CLEAR else BootLoaderSettings(program_time=long)
    bench = FlashBench(settings)
    begun = bench.bus.now
    with pytest.raises(ProgramDownloadFailed, match="flash stays busy .0x1F57:01., for 30 s now") as caught:
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
def test_late_answers_of_a_device_that_is_deaf_while_it_erases(erase: int) -> None:
    bench = FlashBench(BootLoaderSettings(is_deaf=True, erase_time=erase, program_time=4 * SECOND))
    result = bench.flash(IMAGE, expected_id=ID)
    assert (result.writes, bench.memory.program) == (1, IMAGE)


def test_a_heartbeat_that_stops_meanwhile_does_not_count() -> None:
    bench = FlashBench(BootLoaderSettings(is_deaf=True, erase_time=5 * SECOND), heartbeat=True)
    bench.remote.heartbeat.set_timeout(SECOND, bench.bus.now)
    assert bench.flash(IMAGE, expected_id=ID).writes == 1
    assert bench.remote.heartbeat.timeout == SECOND


# ---- the exchange of Lely's master, recorded on a real bus ----

LELY_IMAGE = b"0123456789ABCDEFGHIJ"
RECORDED = """
606#40561F0100000000 586#43561F0101000000
606#40511F0100000000 586#4F511F0101000000
606#2F511F0100000000 586#60511F0100000000
606#2F511F0103000000 586#60511F0100000000
606#C6501F0114000000 586#80501F0101000405
606#21501F0114000000 586#60501F0100000000
606#0030313233343536 586#2000000000000000
606#1037383941424344 586#3000000000000000
606#0345464748494A00 586#2000000000000000
606#40571F0100000000 586#43571F0101000000
+100
606#40571F0100000000 586#43571F0101000000
+100
606#40571F0100000000 586#43571F0100000000
606#40561F0100000000 586#43561F0178563412
606#2F511F0101000000 586#60511F0100000000
606#40511F0100000000 586#4F511F0101000000
"""
LELY = RECORDED.split()
"""Requests and answers; +100: after so many ms. The device refuses blocks, and its flash is busy for two polls."""


def lely_settings(**others: Any) -> BootLoaderSettings:
    identities = {LELY_IMAGE: 0x12345678}
    options = {"erase_time": 0, "program_time": 150 * MILLISECOND, "blocks": False, "resets": False} | others
    return BootLoaderSettings(identify=lambda image: identities.get(image, 1), **options)


def test_the_boot_loader_answers_lelys_master_byte_by_byte() -> None:
    bench = FlashBench(lely_settings())
    bench.power_off()  # our master is not needed
    bench.bus.machines.clear()
    bench.power_on()
    bench.bus.run(MILLISECOND)
    answers = [line for line in LELY if line.startswith("586")]
    bench.bus.sent.clear()
    for line in LELY:
        if line.startswith("606"):
            bench.bus.send(line)
            bench.bus.run(MILLISECOND)
        elif line.startswith("+"):
            bench.bus.run(int(line) * MILLISECOND - MILLISECOND)
    assert [line for line in bench.bus.trace() if line.startswith("586")] == answers


def test_our_master_against_the_device_that_lely_met() -> None:
    """It sends Lely's requests; before them one that looks, and NMT Pre-operational; no blocks for 20 bytes."""
    bench = FlashBench(lely_settings())
    assert bench.flash(LELY_IMAGE, expected_id=0x12345678).is_done
    reads = [each for each in LELY if each.startswith("606#4")]
    sent = bench.to_device()
    assert sent[0] == "606#40571F0100000000"
    assert [each for each in sent if not each.startswith("606#4")] == [
        "000#8006", *(each for each in LELY if each.startswith("606") and each[4] not in "4C")
    ]  # fmt: skip
    assert {each for each in sent if each.startswith("606#4")} == set(reads)
    polls = [time for time, frame in bench.bus.sent if str(frame) == "606#40571F0100000000"]
    assert [later - first for first, later in pairwise(polls)][-2:] == [100 * MILLISECOND + 200 * MICROSECOND] * 2


def test_a_write_error_of_the_device_that_lely_met() -> None:
    bench = FlashBench(lely_settings(judge=lambda image: FlashError.WRITE_ERROR))
    with pytest.raises(ProgramDownloadFailed, match="0x0000000A: the flash could not be written"):
        bench.flash(LELY_IMAGE, expected_id=0x12345678)


def test_a_silent_start_of_the_device_that_lely_met() -> None:
    bench = FlashBench(lely_settings(jumps=(ProgramControl.START,)))
    assert bench.flash(LELY_IMAGE, expected_id=0x12345678).is_done
    assert "706#00" in bench.bus.trace()


# ---- Zephyr ----


class LikeZephyr(BootLoader):
    """After a broken transfer Zephyr stays "cleared" and busy; only "stop" and "clear" get it out of that."""

    is_stuck = False

    def _on_transfer_broken(self, report: SdoServerAborted, now: Time) -> None:
        super()._on_transfer_broken(report, now)
        self._is_cleared = self.is_stuck = self.memory.slot is Slot.TORN

    @property
    def status(self) -> FlashStatus:
        return FlashStatus(True) if self.is_stuck else super().status

    def _clear(self, now: Time) -> AbortCode | Pending | None:
        result = super()._clear(now)
        self.is_stuck = self.is_stuck and result is not None
        return result


def test_a_transfer_that_broke_in_zephyr_is_repaired(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", LikeZephyr)
    bench = FlashBench()
    request_id = bench.begin(pattern(5000))
    bench.bus.run_until(lambda: len(bench.memory.content) > 800)
    bench.master.cancel(request_id, bench.bus.now)
    assert isinstance(bench.outcome(), ProcedureCancelled)
    bench.bus.run(100 * MILLISECOND)
    assert (bench.device.control, bench.device.status.is_busy) == (ProgramControl.CLEAR, True)
    begun = bench.bus.now
    assert bench.flash(IMAGE, expected_id=ID).writes == 1
    assert bench.bus.now - begun < 5 * SECOND


def test_a_program_on_trial_is_told_and_comes_back_unless_it_is_confirmed() -> None:
    bench = FlashBench(BootLoaderSettings(trial=True))
    result = bench.flash(IMAGE, expected_id=ID)
    assert (bench.device.control, "confirm it (0x80 in 0x1F51)" in result.remark) == (ProgramControl.CONFIRM, True)
    with pytest.raises(ProgramDownloadFailed, match="0x08000022.*confirm it"):
        bench.flash(pattern(50))
    bench.power_off()
    bench.power_on()
    assert bench.memory.program == b"the program of the factory"


def test_confirm_keeps_the_program() -> None:
    bench = FlashBench(BootLoaderSettings(trial=True))
    assert bench.flash(IMAGE, expected_id=ID, confirm=True).remark == ""
    assert (bench.device.control, bench.steps[-1]) == (ProgramControl.START, Step.CONFIRM)
    bench.power_off()
    bench.power_on()
    assert bench.memory.program == IMAGE


def test_confirm_alone_where_only_that_is_missing() -> None:
    bench = FlashBench(BootLoaderSettings(trial=True))
    bench.flash(IMAGE, expected_id=ID)
    assert "on trial" in bench.flash(IMAGE, expected_id=ID).remark
    assert bench.flash(IMAGE, expected_id=ID, confirm=True).writes == 0
    assert bench.device.control == ProgramControl.START


def test_a_device_that_is_stopped_is_told_as_such() -> None:
    bench = FlashBench(heartbeat=True)
    bench.nmt.stop(NODE, bench.bus.now)
    bench.bus.run(SECOND)
    with pytest.raises(ProgramDownloadFailed, match="canopen nmt preop"):
        bench.flash(IMAGE)


# ---- large programs, and one that is cancelled ----


def test_a_large_program_with_progress() -> None:
    """1 MiB, in part every day; the bus carries a frame in 0.1 ms."""
    image = pattern(1 << 20 if takes_all() else 1 << 16)
    bench = FlashBench(frame_time=100 * MICROSECOND)
    bench.flash(image, expected_id=crc32(image))
    assert bench.memory.program == image
    written = [each for each in bench.progress if each.step is Step.WRITE]
    assert len(written) > 5
    assert [each.done for each in written] == sorted({each.done for each in written})
    assert (bench.progress[-1].done, bench.progress[-1].total) == (len(image), len(image))


@pytest.mark.parametrize("step", [Step.LOOK, Step.CLEAR, Step.WRITE, Step.PROGRAM, Step.START])
def test_a_cancel_leaves_what_the_next_call_repairs(step: Step) -> None:
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


# ---- the hook of the boot-up ----


def boot_up(bench: FlashBench, images: dict[int, bytes]) -> BootOutcome:
    assignment = Assignment(boots=True, check_software=True, update_software=True)
    entry = BootEntry(NODE, assignment, software=ID)
    update = updating(bench.nmt, images.get)
    bench.master.run(boot_node(bench.remote, NmtCommands(bench.nmt), entry, update=update), bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFinished), outcome
    result: BootOutcome = outcome.result
    return result


def test_the_boot_up_of_a_network_updates_by_it() -> None:
    bench = FlashBench()
    assert boot_up(bench, {NODE: IMAGE}).letter is BootLetter.READY
    assert bench.memory.program == IMAGE


def test_a_boot_up_without_the_file_says_so() -> None:
    outcome = boot_up(FlashBench(), {})
    assert outcome.letter is BootLetter.UPDATE_FAILED
    assert "no program file" in outcome.remark
