"""Program download (CiA 302-3) with the masters and devices of others: Lely, Zephyr; and in the boot-up of a network."""

from __future__ import annotations

from binascii import crc32
from itertools import pairwise
from typing import Any

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.manager.boot.assignment import Assignment
from canopen_proto.manager.boot.entry import BootEntry
from canopen_proto.manager.boot.node_boot import NmtCommands, boot_node
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome
from canopen_proto.manager.programs.download import (
    ProgramDownloadError,
    ProgramStep,
    updating,
)
from canopen_proto.manager.programs.identity import FlashError, FlashStatus, ProgramControl
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFinished
from canopen_proto.sdo.access import Pending
from canopen_proto.sdo.events import SdoServerAborted
from canopen_proto.simulation.boot_loader import FIRST_PROGRAM, BootLoader, BootLoaderSettings, ProgramMemory, Slot
from tests.core.block_pair import pattern
from tests.manager import flash_bench
from tests.manager.flash_bench import NODE, FlashBench

IMAGE = pattern(100)
ID = crc32(IMAGE)


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
QUESTION = "606#4000100000000000"
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
    """It sends Lely's requests; before them one that looks, and NMT Pre-operational; no blocks for 20 bytes.

    Between "stop" and "clear", two writes of one object, it asks a question: the answer to "stop" may come twice.
    """
    bench = FlashBench(lely_settings())
    assert bench.flash(LELY_IMAGE, expected_id=0x12345678).is_done
    reads = [each for each in LELY if each.startswith("606#4")]
    sent = bench.to_device()
    assert sent[0] == "606#40571F0100000000"
    assert [each for each in sent if not each.startswith("606#4")] == [
        "000#8006", *(each for each in LELY if each.startswith("606") and each[4] not in "4C")
    ]  # fmt: skip
    more = {"606#400A100000000000", "606#4018100300000000"}  # whether the program has changed
    assert {each for each in sent if each.startswith("606#4")} == {*reads, *more, QUESTION}
    assert sent[sent.index(QUESTION) - 1 : sent.index(QUESTION) + 2] == ["606#2F511F0100000000", QUESTION, "606#2F511F0103000000"]
    assert sent.count(QUESTION) == 1
    polls = [time for time, frame in bench.bus.sent if str(frame) == "606#40571F0100000000"]
    assert [later - first for first, later in pairwise(polls)][-2:] == [100 * MILLISECOND + 200 * MICROSECOND] * 2


def test_a_write_error_of_the_device_that_lely_met() -> None:
    bench = FlashBench(lely_settings(judge=lambda image: FlashError.WRITE_ERROR))
    with pytest.raises(ProgramDownloadError, match="0x0000000A: the flash could not be written"):
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


def test_a_transfer_that_breaks_in_zephyr_is_repaired_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flash_bench, "BootLoader", LikeZephyr)
    bench = FlashBench(BootLoaderSettings(blocks=False))
    bench.begin(pattern(5000))
    bench.bus.run_until(lambda: len(bench.memory.content) > 800)
    begun, bench.bus.lose = bench.bus.now, frozenset((bench.bus.count,))
    assert isinstance(bench.outcome(), ProcedureFinished)
    assert bench.bus.now - begun < 10 * SECOND


def test_a_program_on_trial_is_told_and_comes_back_unless_it_is_confirmed() -> None:
    bench = FlashBench(BootLoaderSettings(trial=True))
    result = bench.flash(IMAGE, expected_id=ID)
    assert (bench.device.control, "confirm it (0x80 in 0x1F51)" in result.remark) == (ProgramControl.CONFIRM, True)
    with pytest.raises(ProgramDownloadError, match="0x08000022.*confirm it"):
        bench.flash(pattern(50))
    bench.power_off()
    bench.power_on()
    assert bench.memory.program == FIRST_PROGRAM


def test_confirm_keeps_the_program() -> None:
    bench = FlashBench(BootLoaderSettings(trial=True))
    assert bench.flash(IMAGE, expected_id=ID, confirm=True).remark == ""
    assert (bench.device.control, bench.steps[-1]) == (ProgramControl.START, ProgramStep.CONFIRM)
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
    with pytest.raises(ProgramDownloadError, match="canopen nmt preop"):
        bench.flash(IMAGE)


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


def test_the_boot_up_starts_a_program_that_an_update_before_has_left_stopped() -> None:
    bench = FlashBench(memory=ProgramMemory(IMAGE))
    bench.device.runs = False
    assert boot_up(bench, {NODE: IMAGE}).letter is BootLetter.READY
    assert bench.device.runs
    assert not any(each.startswith("606#2F511F0103") for each in bench.to_device())
