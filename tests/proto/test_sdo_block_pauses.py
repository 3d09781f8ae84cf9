"""A party that pauses in a block transfer loses nothing: it queues whole sub-blocks, and its queue stands still for a while.

CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16, says when a sub-block is over, but not how a receiver tells a pause from a loss.
"""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, SEQUENCE, silence_limit
from canopen_proto.sdo.client import SdoAborted
from tests.examples import examples
from tests.proto.block_pair import BY_HOST, INDEX, BlockPair, pattern
from tests.proto.bus import Bus, Fate


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
