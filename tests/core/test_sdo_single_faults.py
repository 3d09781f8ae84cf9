"""One frame of a transfer is lost, comes twice or late: every frame of every kind of transfer, and the next transfer works.

On CAN the frames of one CAN-ID keep their order: a late frame holds up those behind it. Gateways may break that order.
"""

from __future__ import annotations

from itertools import product

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, Outcome, Time
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from tests.core.block_pair import INDEX, BlockPair, pattern
from tests.core.bus import Bus, Fate

BLOCK_SIZE = 2
SIZES = (0, 4, 7, 40)
KINDS = ("upload", "download", "block upload", "block download", "upload stream", "download stream")


class Case:
    """One transfer with one fault, and another behind it."""

    def __init__(
        self, kind: str, size: int, crc: bool = True, place: int = 0, fate: Fate = Fate.DELIVERED, late: Time = 0
    ) -> None:
        self.kind = kind
        self.content = pattern(size)
        self.late = late
        options = {"block_size": BLOCK_SIZE, "crc": crc}
        bus = Bus(fates=[Fate.DELIVERED] * place + [fate], late=(late, late), pause=late)
        self.pair = pair = BlockPair(bus, self.content, client=options, server=options)
        block = kind.startswith("block")
        if kind.endswith("upload"):
            pair.upload(block)
        elif kind.endswith("download"):
            pair.download(self.content, block)
        elif kind == "upload stream":
            pair.client.upload_stream(INDEX, 0, bus.now)
        else:
            pair.to_feed = self.content
            pair.feed(pair.client.download_stream(INDEX, 0, bus.now, size=size))
        bus.run_until(lambda: bool(pair.outcomes))
        self.frames = [frame for _, frame in bus.sent]
        self.outcome = pair.outcomes[0]

    def ended_well(self) -> bool:
        """Whether it succeeded. Whatever is said of it is true."""
        outcome, written = self.outcome, self.pair.store.written
        match outcome:
            case SdoUploaded():
                assert outcome.data == self.content
            case SdoStreamUploaded():
                assert self.pair.chunks == self.content
            case SdoDownloaded():
                assert written
            case SdoAborted():
                assert not written or outcome.not_confirmed, "executed is never called refused"
                assert "upload" not in self.kind or not outcome.not_confirmed
                assert self.late or outcome.abort_code == AbortCode.TIMED_OUT, outcome
        assert set(written) <= {self.content}
        return not isinstance(outcome, SdoAborted)

    def check_next(self, *, is_settled: bool) -> None:
        """Read and write another way, at once or when nothing is on its way any more."""
        pair = self.pair
        if is_settled:
            pair.settle()
        for block in (False, True):
            pair.outcomes.clear()
            pair.store.written.clear()
            read, write = pair.upload(block), pair.download(b"something else", block)
            outcomes: list[Outcome] = pair.outcomes
            pair.bus.run_until(lambda: len(outcomes) == 2)  # noqa: B023
            assert outcomes == [SdoUploaded(12, read, INDEX, 0, self.content), SdoDownloaded(12, write, INDEX, 0)]
            assert pair.store.written == [b"something else"]
        pair.settle()


def is_segment(case: Case, place: int) -> bool:
    """Whether a frame of a block transfer's sender is a segment."""
    frame = case.frames[place]
    is_of_sender = (frame.can_id == 0x60C) == ("download" in case.kind)
    return case.kind not in ("upload", "download") and is_of_sender and 1 <= frame.data[0] & 0x7F <= BLOCK_SIZE


@pytest.mark.thorough(2)
@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_that_is_lost(kind: str) -> None:
    for size, crc in product(SIZES, (True, False)):
        clean = Case(kind, size, crc)
        for place in range(len(clean.frames)):
            case = Case(kind, size, crc, place, Fate.LOST)
            ended_well = case.ended_well()
            is_alone = size <= 7  # in its sub-block: without CRC it is not asked for
            if is_segment(clean, place) and (crc or not is_alone):
                assert ended_well, (size, place)
            case.check_next(is_settled=False)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_that_comes_twice(kind: str) -> None:
    for size, crc in product(SIZES, (True, False)):
        for place in range(len(Case(kind, size, crc).frames)):
            case = Case(kind, size, crc, place, Fate.COPIED)
            assert case.ended_well(), (size, place)
            case.check_next(is_settled=False)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("late", [300_000, 60 * MILLISECOND, 450 * MILLISECOND])
@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_that_is_late(kind: str, late: Time) -> None:
    for size, crc in product(SIZES, (True, False)):
        for place in range(len(Case(kind, size, crc).frames)):
            case = Case(kind, size, crc, place, Fate.PAUSED, late)
            assert case.ended_well(), (size, place)
            case.check_next(is_settled=False)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("late", [300_000, 60 * MILLISECOND])
@pytest.mark.parametrize("fate", [Fate.LATE, Fate.COPIED_LATE])
@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_that_others_overtake(kind: str, fate: Fate, late: Time) -> None:
    """With CRC and size a segment that is overtaken costs nothing; any other frame may cost the transfer, and never its truth."""
    clean = Case(kind, 40)
    for place in range(len(clean.frames)):
        case = Case(kind, 40, True, place, fate, late)
        if kind not in ("upload", "download"):
            ended_well = case.ended_well()
            assert ended_well or not is_segment(clean, place), place
        case.check_next(is_settled=True)
