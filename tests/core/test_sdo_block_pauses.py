"""A party that pauses in a block transfer loses nothing: it queues whole sub-blocks, and its queue stands still for a while.

CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16, says when a sub-block is over, but not how a receiver tells a pause from a loss.
"""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Machine, Time
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, silence_limit
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded
from canopen_proto.sdo.codec import SEQUENCE, pack_expedited
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.block_pair import BY_HOST, INDEX, BlockPair, pattern
from tests.core.bus import Bus, Fate
from tests.examples import examples


class Transfer(NamedTuple):
    """tells_size: or the receiver does not know it."""

    kind: str
    size: int = 100
    crc: bool = False
    tells_size: bool = True
    block_size: int = MAX_BLOCK_SIZE
    timeout: Time = SECOND

    def run(self, place: int, pause: Time) -> BlockPair:
        """Between two parties that put each sub-block into their queues at once. place: the frame that waits for so long."""
        options = {"crc": self.crc, "block_size": self.block_size, "max_burst": MAX_BLOCK_SIZE, "timeout": self.timeout}
        content = pattern(self.size)
        pair = BlockPair(
            Bus(fates=[Fate.DELIVERED] * place + [Fate.PAUSED], pause=pause), content, client=options, server=options
        )
        index = INDEX if self.tells_size else BY_HOST
        if self.kind == "upload":
            pair.upload(index=index)
        elif self.kind == "upload stream":
            pair.client.upload_stream(index, 0, pair.bus.now)
        elif self.tells_size and self.kind == "download":
            pair.download(content)
        else:
            pair.to_feed = content
            size = self.size if self.tells_size else None
            pair.feed(pair.client.download_stream(INDEX, 0, pair.bus.now, size=size))
        pair.settle()
        return pair


TRANSFERS = st.builds(
    Transfer,
    kind=st.sampled_from(["upload", "download", "upload stream", "download stream"]),
    size=st.integers(0, 40) | st.integers(0, 2000),
    crc=st.booleans(),
    tells_size=st.booleans(),
    block_size=st.integers(1, 6) | st.integers(1, MAX_BLOCK_SIZE),
    timeout=st.sampled_from([20 * MILLISECOND, SECOND, 3 * SECOND]),
)
PLACES = st.integers(2, 12) | st.integers(2, 400)
"""The first two frames, the initiation, have the time-out of any request."""


@examples(100)
@given(transfer=TRANSFERS, place=PLACES, percent=st.integers(1, 99))
def test_pauses_below_the_time_out_cost_nothing(transfer: Transfer, place: int, percent: int) -> None:
    pair = transfer.run(place, silence_limit(transfer.timeout) * percent // 100)
    assert pair.is_right(pattern(transfer.size))
    assert pair.bus.trace() == transfer.run(place, 0).bus.trace(), "and no frame is sent that would not have been"


@examples(100)
@given(transfer=TRANSFERS, place=PLACES, percent=st.integers(101, 1000))
def test_longer_ones_end_in_an_abort_never_in_wrong_bytes(transfer: Transfer, place: int, percent: int) -> None:
    pair = transfer.run(place, silence_limit(transfer.timeout) * percent // 100)
    is_right = pair.is_right(pattern(transfer.size))
    assert is_right or isinstance(pair.outcomes[0], SdoAborted)
    frames = [frame for _, frame in transfer.run(place, 0).bus.sent]
    if place >= len(frames) - 1:  # behind the last frame nothing waits
        return
    paused, before = frames[place], frames[place - 1]
    is_inside = paused.can_id == before.can_id and paused.data[0] & SEQUENCE == (before.data[0] & SEQUENCE) + 1
    if is_inside or percent > 400:
        assert not is_right


@pytest.mark.parametrize("kind", ["upload", "download"])
@pytest.mark.parametrize(("timeout", "pause"), [(20, 990), (500, 990), (3000, 2990)])
def test_the_default_inside_a_block_is_a_second_at_least_and_follows_the_time_out(kind: str, timeout: int, pause: int) -> None:
    pair = Transfer(kind, timeout=timeout * MILLISECOND).run(6, pause * MILLISECOND)
    assert pair.is_right(pattern(100))


# ---- the rest of the sender's queue, when the transfer is over ----

OTHER = 0x1017
SPELLS = b"".join(pack_expedited(0, OTHER, 0, number.to_bytes(4, "little"))[1:] for number in range(600))
"""Content of which each segment names another object, as an expedited download does."""


class Host(Machine):
    """It takes each piece `time` after it was asked to."""

    def __init__(self, pair: BlockPair, time: Time) -> None:
        super().__init__(pair.server.out)
        self.pair = pair
        self.time = time
        self.asked: ObjectAccessPending | None = None
        pair.serve = self.serve  # type: ignore[method-assign]

    def can_ids(self) -> tuple[int, ...]:
        return ()

    def serve(self, report: ObjectAccessPending, now: Time) -> None:
        self.asked = report
        self.deadline = now + self.time

    def handle_timeout(self, now: Time) -> None:
        self.deadline = NEVER
        assert self.asked is not None
        BlockPair.serve(self.pair, self.asked, now)


@examples(150)
@given(
    size=st.integers(1, len(SPELLS)),
    crc=st.booleans(),
    index=st.sampled_from([INDEX, BY_HOST]),
    block_size=st.integers(30, 70) | st.just(MAX_BLOCK_SIZE),
    pauses=st.lists(st.integers(2, 140), min_size=1, max_size=2, unique=True),
    lost=st.none() | st.integers(2, 140),
    pause=st.sampled_from([0.05, 0.9, 1.2, 1.9, 2.1, 3.5, 9]),
    frame_time=st.sampled_from([100_000, 4 * MILLISECOND]),
    host_time=st.sampled_from([0, 20 * MILLISECOND, 400 * MILLISECOND, 3 * SECOND]),
)
def test_a_download_writes_its_object_and_no_other_whatever_pause_and_however_full_the_queue(
    size: int,
    crc: bool,
    index: int,
    block_size: int,
    pauses: list[int],
    lost: int | None,
    pause: float,
    frame_time: Time,
    host_time: Time,
) -> None:
    """Number 0x23 of the queue looks like an expedited download."""
    content = SPELLS[:size]
    fates = iter([Fate.LOST if place == lost else Fate.PAUSED if place in pauses else Fate.DELIVERED for place in range(142)])
    bus = Bus(fates=fates, pause=round(pause * SECOND), frame_time=frame_time)
    server = {"block_size": block_size, "max_download": len(SPELLS)}
    pair = BlockPair(bus, client={"crc": crc, "max_burst": MAX_BLOCK_SIZE}, server=server)
    bus.attach(Host(pair, host_time))
    pair.download(content, index=index)
    pair.settle()
    assert pair.store.others == []
    assert set(pair.store.written) <= {content}
    said = [str(frame) for _, frame in bus.sent if frame.can_id == 0x58C]
    assert lost is not None or sum(frame.startswith("58C#80") for frame in said) <= 2, (
        "one for the transfer, one for an end frame behind it"
    )
    list(fates)  # no more of them
    pair.download(b"next", False)
    if isinstance(pair.settle(), SdoAborted):  # it looked like the next segment; who asks again is heard
        pair.download(b"next", False)
        assert isinstance(pair.settle(), SdoDownloaded)
    assert pair.store.written[-1] == b"next"
