"""A program download is "done" only if the new program has shown itself, or the caller is told that nothing was verified.

The devices here lie or fail: they drop the data, go back to the old program, say that they run, show no identity or the same one
for ever. What they show of themselves is either true or says nothing, so the oracle is the program that really runs.
"""

from __future__ import annotations

from binascii import crc32
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.manager.programs.download import (
    NOT_VERIFIED,
    DownloadLimits,
    ProgramDownload,
    ProgramDownloadError,
    ProgramStep,
)
from canopen_proto.manager.programs.identity import ProgramControl
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.sdo.access import Pending
from canopen_proto.simulation.boot_loader import FIRST_PROGRAM, BootLoader, BootLoaderSettings, ProgramMemory
from tests.core.block_pair import pattern
from tests.examples import examples
from tests.manager import flash_bench
from tests.manager.flash_bench import FlashBench

IMAGE = pattern(30)
ID = crc32(IMAGE)
QUICK = DownloadLimits(start=SECOND, busy=SECOND)


@dataclass(frozen=True)
class Ways:
    """How a device lies and fails.

    identity: 0x1F56 is the CRC-32 of the program in its memory ("memory"), of the one that runs, 0 if none does ("running"), a
    constant, 0, or not there ("absent"). version: 0x100A, likewise; "loader": of what runs, also if that is the boot loader.
    has_status: it has 0x1F57. falls: what "start" really does. drops: it takes the data and keeps the old program. cut: its power
    is cut after so many frames; what becomes of it after the last look is not for the master to know.
    """

    identity: str = "memory"
    version: str = "absent"
    has_status: bool = True
    falls: str = "new"
    drops: bool = False
    trial: bool = False
    cut: int | None = None


class Liar(BootLoader):
    """See `Ways`."""

    ways = Ways()
    asked: list[tuple[bool, bytes | None]] = []
    """Whether a program ran, and which was there, when its identity was asked for the last time. It outlives a power cut."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        if index in (indices.PROGRAM_SOFTWARE, indices.MANUFACTURER_SOFTWARE_VERSION, indices.IDENTITY_OBJECT):
            self.asked[:] = [(self.runs, self.memory.program)]
        ways, program = self.ways, self.memory.program
        running = program if self.runs else None
        if index == indices.FLASH_STATUS and not ways.has_status:
            return AbortCode.NO_SUCH_OBJECT
        if index == indices.PROGRAM_CONTROL and ways.falls == "stays" and self.has_been_started:
            return bytes((ProgramControl.START,))
        if index == indices.PROGRAM_SOFTWARE:
            shown = {"memory": program, "running": running, "constant": b"same", "zero": None}
            if ways.identity not in shown:
                return AbortCode.NO_SUCH_OBJECT
            content = shown[ways.identity]
            return (0 if content is None else crc32(content)).to_bytes(4, "little")
        if index == indices.MANUFACTURER_SOFTWARE_VERSION:
            shown = {"memory": program, "running": running, "constant": b"same", "loader": running or b"loader"}
            if ways.version not in shown:
                return AbortCode.NO_SUCH_OBJECT
            content = shown[ways.version]
            return b"none" if content is None else b"%08X" % crc32(content)
        return super().read(index, subindex, now)

    has_been_started = False

    def _run(self, command: int, now: Time) -> AbortCode | Pending | None:
        self.has_been_started = True
        if self.ways.falls == "old":
            self.memory.content[:] = FIRST_PROGRAM
        elif self.ways.falls == "stays":
            return None
        return super()._run(command, now)

    def _on_flash_done(self, done, now: Time) -> None:  # type: ignore[no-untyped-def]
        super()._on_flash_done(done, now)
        if self.ways.drops and self.memory.program is not None:
            self.memory.content[:] = FIRST_PROGRAM


@contextmanager
def bench_of(ways: Ways) -> Iterator[FlashBench]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flash_bench, "BootLoader", type("ThisLiar", (Liar,), {"ways": ways, "asked": []}))
        settings = BootLoaderSettings(trial=ways.trial, erase_time=0, program_time=0, boot_time=MILLISECOND)
        yield FlashBench(settings, memory=ProgramMemory(), limits=QUICK)


def ended(bench: FlashBench, ways: Ways, so_far: ProgramDownload, **options: object) -> ProgramDownload | ProgramDownloadError:
    bench.begin(IMAGE, so_far, **options)
    if ways.cut is not None:
        cut = ways.cut
        bench.bus.run_until(lambda: bool(bench.ended) or len(bench.bus.sent) > cut, 60 * SECOND)
        if not bench.ended:
            bench.power_off()
            bench.power_on()
    outcome = bench.outcome()
    if isinstance(outcome, ProcedureFailed):
        assert isinstance(outcome.error, ProgramDownloadError), outcome.error
        return outcome.error
    result: ProgramDownload = outcome.result  # type: ignore[attr-defined]
    return result


def judge(ways: Ways, is_known: bool, unverified: bool, confirm: bool) -> None:
    """Write a program into such a device, and compare what is said with what it does."""
    with bench_of(ways) as bench:
        so_far = ProgramDownload(len(IMAGE))
        result = ended(bench, ways, so_far, expected_id=ID if is_known else None, unverified=unverified, confirm=confirm)
        if not is_known and not ways.has_status and not unverified:
            started = any(line.startswith("606#2F511F0101") for line in bench.to_device())
            assert not started, "nothing has verified it, and nobody has allowed it"
        if isinstance(result, ProgramDownloadError):
            assert not so_far.is_done
            if so_far.fell_back:
                assert bench.memory.program == FIRST_PROGRAM
            return
        assert so_far.is_done
        if so_far.verified_by:
            ((runs, program),) = bench.device.asked  # type: ignore[attr-defined]
            assert program == IMAGE, so_far.verified_by
            runs_by_its_word = ways.falls == "stays" and ways.identity == "memory"  # 0x1F51 lies; nothing can show that
            assert runs or runs_by_its_word, so_far.verified_by
        else:
            assert NOT_VERIFIED in so_far.remark


IDENTITIES = ("memory", "running", "constant", "zero", "absent")
VERSIONS = ("absent", "memory", "running", "constant", "loader")
FALLS = ("new", "old", "stays")
LONGEST = 61
"""Frames: the power is cut before the last of so many."""

WAYS = st.builds(
    Ways,
    identity=st.sampled_from(IDENTITIES),
    version=st.sampled_from(VERSIONS),
    has_status=st.booleans(),
    falls=st.sampled_from(FALLS),
    drops=st.booleans(),
    trial=st.booleans(),
    cut=st.none() | st.integers(0, LONGEST - 1),
)


@examples(1000, least=100)
@given(ways=WAYS, is_known=st.booleans(), unverified=st.booleans(), confirm=st.booleans())
@example(
    ways=Ways(trial=True, cut=26), is_known=False, unverified=False, confirm=False
)  # the old program comes back after the start
@example(ways=Ways(identity="constant", version="loader", falls="stays"), is_known=False, unverified=False, confirm=False)
@example(ways=Ways(has_status=False, trial=True, cut=43), is_known=False, unverified=True, confirm=False)
@example(ways=Ways(identity="absent", has_status=False), is_known=False, unverified=False, confirm=False)
def test_done_means_that_the_new_program_was_seen_or_that_nothing_was_verified(
    ways: Ways, is_known: bool, unverified: bool, confirm: bool
) -> None:
    judge(ways, is_known, unverified, confirm)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize("ways", [Ways(trial=True), Ways(trial=True, identity="absent", version="running")])
def test_the_power_may_fail_at_any_frame_of_the_last_looks(ways: Ways, is_known: bool) -> None:
    """The old program comes back: what was read before that is no evidence."""
    for cut in range(24, 60):
        judge(replace(ways, cut=cut), is_known, True, False)


@pytest.mark.parametrize("identity", ["memory", "running"])
@pytest.mark.parametrize("has_status", [False, True])
@pytest.mark.parametrize("is_known", [False, True])
def test_a_new_program_that_shows_itself_is_verified(identity: str, has_status: bool, is_known: bool) -> None:
    ways = Ways(identity=identity, has_status=has_status)
    if identity == "running" and is_known:
        return  # it shows none before the start, so it is not started
    with bench_of(ways) as bench:
        result = bench.flash(IMAGE, expected_id=ID if is_known else None, unverified=True)
        assert "0x1F56" in result.verified_by
        assert result.remark == ""


@pytest.mark.parametrize("is_known", [False, True])
def test_a_boot_loader_that_goes_back_is_a_failure_though_it_runs(is_known: bool) -> None:
    with bench_of(Ways(falls="old")) as bench:
        with pytest.raises(ProgramDownloadError, match="as before: its boot loader has refused the new program") as caught:
            bench.flash(IMAGE, expected_id=ID if is_known else None)
        assert (caught.value.is_mismatch, caught.value.so_far.fell_back) == (True, True)


def test_a_version_shows_the_new_program_too() -> None:
    with bench_of(Ways(identity="constant", version="loader")) as bench:
        assert bench.flash(IMAGE).verified_by == "the software version (0x100A) has changed"
    with bench_of(Ways(identity="constant", version="loader", falls="old")) as bench:
        assert bench.flash(IMAGE).remark == NOT_VERIFIED


def test_the_same_program_once_more_cannot_be_told_from_the_old_one() -> None:
    bench = FlashBench(memory=ProgramMemory(IMAGE))
    assert bench.flash(IMAGE).remark == NOT_VERIFIED
    assert "0x1F56 is the expected one" in bench.flash(IMAGE, expected_id=ID, force=True).verified_by


def test_what_nothing_has_verified_is_not_started() -> None:
    with bench_of(Ways(has_status=False)) as bench:
        with pytest.raises(ProgramDownloadError, match="not verified.*it has a program that was not started") as caught:
            bench.flash(IMAGE)
        assert (caught.value.so_far.step, bench.device.runs) == (ProgramStep.VERIFY, False)
        assert bench.flash(IMAGE, unverified=True).is_done


def test_a_reset_before_the_confirmation_is_noticed() -> None:
    """The power fails between "check" and "confirm": the old program runs, and its state looks like a confirmed one."""
    bench, so_far = FlashBench(BootLoaderSettings(trial=True)), ProgramDownload(len(IMAGE))
    bench.begin(IMAGE, so_far, expected_id=ID, confirm=True)
    bench.bus.run_until(lambda: so_far.step is ProgramStep.CONFIRM)
    bench.power_off()
    bench.power_on()
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert "as before: its boot loader has refused the new program" in str(outcome.error)
    assert bench.memory.program == FIRST_PROGRAM
    assert so_far.left == "it shows the identification of its old program, and runs"


def test_a_boot_between_the_first_looks_is_no_evidence_for_a_new_program() -> None:
    """It ran a program on trial, and goes back to its old one behind the first look at its version: that is not our doing."""
    with bench_of(Ways(identity="absent", version="running", has_status=False, drops=True)) as bench:
        bench.memory.content[:] = b"on trial"
        so_far = ProgramDownload(len(IMAGE))
        bench.begin(IMAGE, so_far, unverified=True)
        bench.bus.run_until(lambda: "606#4018100300000000" in bench.to_device())
        bench.power_off()
        bench.memory.content[:] = FIRST_PROGRAM
        bench.power_on()
        bench.outcome()
        assert bench.memory.program == FIRST_PROGRAM
        assert so_far.is_done
        assert (so_far.verified_by, NOT_VERIFIED in so_far.remark) == ("", True)


def test_a_master_that_does_not_poll_waits_for_the_answer_to_clear() -> None:
    """Lely's master sends the program as soon as "clear" is answered: the flash has to be erased by then."""
    for holds in (False, True):
        bench = FlashBench(BootLoaderSettings(holds_clear=holds, erase_time=50 * MILLISECOND))
        bench.bus.send("000#8006")
        for request in ("606#2F511F0100000000", "606#2F511F0103000000"):
            bench.bus.send(request)
            bench.bus.run_until(lambda bench=bench: "586#60511F0100000000" in bench.bus.trace()[-1:])  # type: ignore[misc]
            bench.bus.sent.append(bench.bus.sent[0])  # so that the last line is no longer this answer
        bench.bus.send("606#21501F0114000000")
        bench.bus.run(MILLISECOND)
        assert bench.bus.trace()[-1] == ("586#60501F0100000000" if holds else "586#80501F0122000008")
