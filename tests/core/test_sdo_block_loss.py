"""Block transfers over a bus with faults: right bytes or an abort, always an end."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.machine import MICROSECOND, SECOND, Time
from canopen_proto.sdo.client import SdoAborted
from tests.core.block_pair import MAX_DELAY, BlockPair, pattern
from tests.core.bus import CAN_FATES, Bus, Fate
from tests.examples import examples

KINDS = ("upload", "download", "upload stream", "download stream")
BLOCK_SIZE = 4  # three sub-blocks are 9 to 12 segments


def begin(pair: BlockPair, kind: str, content: bytes, *, known_size: bool = True) -> None:
    now = pair.bus.now
    if kind == "upload":
        pair.upload()
    elif kind == "download":
        pair.download(content)
    elif kind == "upload stream":
        pair.client.upload_stream(0x2000, 0, now)
    else:
        pair.to_feed = content
        pair.feed(pair.client.download_stream(0x2000, 0, now, size=len(content) if known_size else None))


def run(kind: str, content: bytes, fates: list[Fate], *, crc: bool, block_size: int = BLOCK_SIZE) -> BlockPair:
    options = {"crc": crc, "block_size": block_size}
    pair = BlockPair(Bus(fates=fates), content, client=options, server=options)
    begin(pair, kind, content)
    pair.settle()
    return pair


def is_segment(frame: str, kind: str) -> bool:
    """Whether a frame of these small transfers is a segment."""
    return frame.startswith("60C" if "download" in kind else "58C") and int(frame[4:6], 16) & 0x7F <= BLOCK_SIZE


@pytest.mark.thorough(3)
@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
@pytest.mark.parametrize("size", [9 * 7, 10 * 7 - 3, 12 * 7 - 1, 12 * 7], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_each_single_loss_in_three_sub_blocks(kind: str, size: int, crc: bool) -> None:
    """A segment that is lost is sent again, wherever it stands: first, middle, end of a sub-block, last one of all."""
    content = pattern(size)
    clean = run(kind, content, [], crc=crc)
    assert clean.is_right(content)
    frames = clean.bus.trace()
    assert sum(is_segment(frame, kind) for frame in frames) == -(-size // 7)
    for position, frame in enumerate(frames):
        pair = run(kind, content, [Fate.DELIVERED] * position + [Fate.LOST], crc=crc)
        ended_well = pair.is_right(content)
        alone_in_its_sub_block = size == 9 * 7 and is_segment(frame, kind) and int(frame[4:6], 16) == 0x81
        if is_segment(frame, kind) and (crc or not alone_in_its_sub_block):
            assert ended_well, f"{position}: {frame}"
            assert len(pair.bus.sent) <= len(frames) + BLOCK_SIZE + 2


@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
@pytest.mark.parametrize("kind", KINDS)
def test_each_single_copy_costs_nothing(kind: str, crc: bool) -> None:
    content = pattern(10 * 7 - 3)
    frames = len(run(kind, content, [], crc=crc).bus.sent)
    for position in range(frames):
        pair = run(kind, content, [Fate.DELIVERED] * position + [Fate.COPIED], crc=crc)
        assert pair.is_right(content), position
        assert not pair.server.busy
    assert run(kind, content, [Fate.COPIED] * 100, crc=crc).is_right(content)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("kind", KINDS)
def test_each_pair_of_losses(kind: str) -> None:
    content = pattern(10 * 7 - 3)
    for first in range(18):
        for second in range(18 - first):
            fates = [Fate.DELIVERED] * first + [Fate.LOST] + [Fate.DELIVERED] * second + [Fate.LOST]
            for crc in (True, False):
                run(kind, content, fates, crc=crc).is_right(content)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_loss_at_the_end_of_a_sub_block_and_another_in_its_repetition(kind: str, crc: bool) -> None:
    """The numbers of the repetition begin with 1: behind that a gap is a loss, whatever number follows."""
    content, first = pattern(70), 2 if "download" in kind else 3
    for received in range(1, 9):
        for lost in range(10 - received):
            fates = [Fate.DELIVERED] * (first + received) + [Fate.LOST] * (10 - received)
            fates += [Fate.DELIVERED] * (1 + lost) + [Fate.LOST]
            pair = run(kind, content, fates, crc=crc, block_size=127)
            could_be_a_pause = (received, lost) == (1, 0)  # number 2 comes next, as it would then
            assert pair.is_right(content) == (not could_be_a_pause), (received, lost)


CONTENTS = st.one_of(st.integers(0, 120).map(pattern), st.binary(max_size=120), st.integers(0, 120).map(bytes))
OPTIONS = st.fixed_dictionaries({"block_size": st.integers(1, 6), "max_burst": st.integers(1, 9)})


@examples(400)
@given(
    kind=st.sampled_from(KINDS),
    content=CONTENTS,
    crc=st.booleans(),
    known_size=st.booleans(),
    client=OPTIONS,
    server=OPTIONS,
    fates=st.lists(st.sampled_from([*CAN_FATES, Fate.DELIVERED, Fate.DELIVERED]), max_size=80),
    seed=st.integers(0, 1000),
)
def test_under_the_faults_of_can_bytes_are_right_or_there_is_an_abort(
    kind: str,
    content: bytes,
    crc: bool,
    known_size: bool,
    client: dict[str, int],
    server: dict[str, int],
    fates: list[Fate],
    seed: int,
) -> None:
    bus = Bus(seed, delay=(0, MAX_DELAY), fates=fates)
    pair = BlockPair(bus, content, client={"crc": crc, **client}, server=server)
    begin(pair, kind, content, known_size=known_size)
    pair.settle()
    assert pair.is_right(content) or isinstance(pair.outcomes[0], SdoAborted)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
@pytest.mark.parametrize("kind", KINDS)
def test_twenty_percent_loss(kind: str, crc: bool) -> None:
    content = pattern(3000)
    ended_well = 0
    for seed in range(30):
        bus = Bus(seed, delay=(0, MAX_DELAY), loss=0.2 if seed % 2 else 0.02, copies=0.1)
        pair = BlockPair(bus, content, client={"crc": crc})
        begin(pair, kind, content)
        pair.settle()
        ended_well += pair.is_right(content)
    assert ended_well >= 8


@examples(300)
@given(
    kind=st.sampled_from(KINDS),
    content=st.integers(0, 300).map(pattern),
    client=OPTIONS,
    server=OPTIONS,
    fates=st.lists(st.sampled_from(list(Fate)), max_size=80),
    seed=st.integers(0, 1000),
)
def test_with_crc_late_copies_and_reordering_never_give_wrong_bytes(
    kind: str, content: bytes, client: dict[str, int], server: dict[str, int], fates: list[Fate], seed: int
) -> None:
    bus = Bus(seed, delay=(0, MAX_DELAY), fates=fates, late=(0, 2 * SECOND))
    pair = BlockPair(bus, content, client=client, server=server)
    begin(pair, kind, content)
    pair.settle()
    pair.is_right(content)


@examples(150)
@given(
    kind=st.sampled_from(KINDS),
    segments=st.integers(1, 30),
    block_size=st.integers(2, 8) | st.just(127),
    place=st.integers(0, 29),
    late=st.sampled_from([50, 150, 300, 500, 1000, 3000, 60_000, 1_050_000]),
    max_burst=st.sampled_from([1, 3, 127]),
    frame_time=st.sampled_from([0, 100 * MICROSECOND]),
)
def test_with_crc_and_size_a_segment_costs_nothing_however_many_others_overtake_it(
    kind: str, segments: int, block_size: int, place: int, late: int, max_burst: int, frame_time: Time
) -> None:
    """late: us. No CAN does that, but gateways do."""
    content = pattern(segments * 7 - 3)
    options = {"block_size": block_size, "max_burst": max_burst}

    def ends(fates: list[Fate]) -> BlockPair:
        bus = Bus(fates=fates, late=(late * MICROSECOND, late * MICROSECOND), frame_time=frame_time)
        pair = BlockPair(bus, content, client=options, server=options)
        begin(pair, kind, content)
        pair.settle()
        return pair

    sender = 0x60C if "download" in kind else 0x58C
    frames = [frame for _, frame in ends([]).bus.sent]
    places = [number for number, frame in enumerate(frames) if number >= 2 and frame.can_id == sender][:segments]
    assert ends([Fate.DELIVERED] * places[place % segments] + [Fate.LATE]).is_right(content)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("rate", [0.02, 0.2])
@pytest.mark.parametrize("kind", KINDS)
def test_long_runs_on_a_bad_bus(kind: str, rate: float) -> None:
    for seed in range(25):
        bus = Bus(
            seed, delay=(0, MAX_DELAY), loss=rate, copies=rate, late_copies=rate, reordering=rate, late=(0, 100 * MAX_DELAY)
        )
        content = pattern(1000 + seed)
        pair = BlockPair(bus, content, client={"block_size": 1 + seed * 5})
        begin(pair, kind, content)
        pair.settle()
        pair.is_right(content)
