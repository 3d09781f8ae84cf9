"""Any frames whatever, at any times, into a device, into a simulated drive, and into a master's view of a device."""

from __future__ import annotations

import random
from typing import TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_testing.strategies import near_valid_frames, random_frames
from tests.builds import sees_inside
from tests.data.subjects import DriveSubject, LocalSubject, RemoteSubject, Subject, held
from tests.examples import examples

YEAR = 365 * 24 * 3600 * SECOND

OWN_CAN_IDS = [0x000, 0x080, 0x085, 0x185, 0x205, 0x285, 0x305, 0x585, 0x605, 0x6A1, 0x705, 0x709]

INDICES = [
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1014, 0x1015, 0x1016, 0x1017, 0x1018, 0x1019, 0x1029, 0x1201, 0x1280, 0x1400,
    0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1A00, 0x1A01, 0x2000, 0x2001, 0x2002, 0x2003, 0x2004,
]  # fmt: skip

COMMANDS = [
    0x00, 0x01, 0x0D, 0x0E, 0x10, 0x11, 0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x30, 0x40, 0x41, 0x42, 0x43, 0x4B, 0x4F, 0x60,
    0x70, 0x80, 0xA0, 0xA4, 0xC0, 0xC6, 0xE0,
]  # fmt: skip

VALUES = [
    0, 1, 2, 5, 240, 255, 1000, 0x80, 0x85, 0x205, 0x305, 0x40000080, 0x80000205, 0x80000185, 0x800006A1, 0x6A2,
    0x00090064, 0x20010010, 0x20000010, 0x20020008, 0x00050008, 0x20030040, 0xFFFFFFFF,
]  # fmt: skip


DRIVE_OBJECTS = list(drive_dictionary())


def sdo(command: int, index: int, subindex: int, value: int) -> bytes:
    return bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex,)) + value.to_bytes(4, "little")


SDO_DATA = st.builds(sdo, st.sampled_from(COMMANDS), st.sampled_from(INDICES), st.integers(0, 6), st.sampled_from(VALUES))
NMT_DATA = st.builds(lambda *two: bytes(two), st.sampled_from([1, 2, 0x80, 0x81, 0x82, 3]), st.sampled_from([0, 5, 6]))
STATES = st.sampled_from([b"\x00", b"\x04", b"\x05", b"\x7f", b"\x85", b"\x01"])
ANY_DATA = st.binary(max_size=8)

FRAMES = st.one_of(
    st.builds(Frame, st.sampled_from([0x605, 0x585, 0x6A1]), SDO_DATA),
    st.builds(Frame, st.just(0), NMT_DATA),
    st.builds(Frame, st.sampled_from([0x705, 0x709]), STATES),
    st.builds(Frame, st.sampled_from([0x080, 0x185, 0x205, 0x305]), st.sampled_from([b"", b"\x05", b"\x01\x00"])),
    st.builds(Frame, st.sampled_from(OWN_CAN_IDS), ANY_DATA),
    near_valid_frames(nodes=st.sampled_from([5, 9])),
    random_frames(),
)

TIMES = st.one_of(
    st.sampled_from([0, 1, MILLISECOND, 100 * MILLISECOND, 501 * MILLISECOND, 6 * SECOND, YEAR, -SECOND]),
    st.integers(0, 10 * SECOND),
)

STEPS = st.lists(
    st.one_of(
        FRAMES,
        FRAMES,
        FRAMES,
        st.tuples(st.just("time"), TIMES),
        st.tuples(st.just("act"), st.integers(0, 499)),
    ),
    max_size=60,
)


AnySubject: TypeAlias = LocalSubject | DriveSubject | RemoteSubject


def run(subject: AnySubject, steps: list[Frame | tuple[str, int]]) -> Subject:
    for step in steps:
        if isinstance(step, Frame):
            subject.receive(step)
        elif step[0] == "time":
            subject.pass_time(step[1])
        else:
            subject.act(step[1])
    subject.check()
    return subject


@pytest.mark.parametrize("kind", [LocalSubject, DriveSubject, RemoteSubject])
@examples(50)
@given(steps=STEPS)
def test_nothing_raises_and_equal_runs_are_equal(kind: type[AnySubject], steps: list[Frame | tuple[str, int]]) -> None:
    first, second = run(kind(), steps), run(kind(), steps)
    assert first.trace == second.trace
    assert [str(each) for each in first.trace] == [str(each) for each in second.trace]


@examples(50)
@given(steps=STEPS)
def test_every_request_of_a_master_has_its_outcome(steps: list[Frame | tuple[str, int]]) -> None:
    subject = RemoteSubject()
    run(subject, steps)
    while subject.open:
        before = len(subject.open)
        for _ in range(5):  # nobody answers: each times out in turn; after a stranger's request, a read is made again for 3 s
            subject.pass_time(SECOND)
        assert len(subject.open) < before
    assert not subject.node.sdo.busy
    assert subject.node._writes == {}


def some_frame(source: random.Random) -> Frame:
    kind = source.randrange(10)
    if kind < 4:
        data = sdo(source.choice(COMMANDS), source.choice(INDICES), source.randrange(7), source.choice(VALUES))
        return Frame(source.choice((0x605, 0x585)), data)
    if kind < 6:
        return Frame(source.choice((0x080, 0x185, 0x205, 0x305, 0x705, 0x709)), source.choice((b"", b"\x05", b"\x01\x00")))
    if kind < 8:
        return Frame(source.choice(OWN_CAN_IDS), source.randbytes(source.randrange(9)))
    if kind == 8:
        return Frame(source.getrandbits(29), source.randbytes(source.randrange(9)), EXTENDED)
    return Frame(source.choice(OWN_CAN_IDS), b"", REMOTE, source.randrange(9))


def some_drive_frame(source: random.Random) -> Frame:
    """What a drive is sent: controlwords, modes, any of its objects, PDOs, SYNC."""
    kind = source.randrange(20)
    if kind < 6:
        word = source.choice((0x02, 0x06, 0x07, 0x0B, 0x0F, 0x0F, 0x1F, 0x1F, 0x3F, 0x5F, 0x80, 0x10F))
        return Frame(0x605, sdo(0x2B, 0x6040, 0, word))
    if kind < 8:
        return Frame(0x605, sdo(0x2F, 0x6060, 0, source.choice((0, 1, 2, 3, 6, 7, 8))))
    if kind < 12:
        variable = source.choice(DRIVE_OBJECTS)
        size = min(variable.size or 4, 4)
        value = source.choice((0, 1, 6, 1000, 0xFFFFFFFF, source.getrandbits(32))) & (1 << 8 * size) - 1
        return Frame(0x605, sdo(0x23 | 4 - size << 2, variable.index, variable.subindex, value))
    if kind < 14:
        word = source.choice((b"\x0f\x00", b"\x1f\x00", b"\x07\x00"))
        return Frame(source.choice((0x205, 0x305, 0x405, 0x505)), word + source.randbytes(source.choice((0, 1, 4))))
    return Frame(0x080) if kind < 19 else some_frame(source)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seed", range(6))
def test_nothing_raises_in_a_drive(seed: int) -> None:
    source = random.Random(seed)
    subject = DriveSubject()
    for number in range(1500):
        subject.receive(some_drive_frame(source))
        if number % 5 == 0:
            subject.pass_time(source.choice((1, 10, 100, 1000)) * MILLISECOND)
        if number % 60 == 0:
            subject.act(source.randrange(500))
            subject.forget_trace()
            subject.check()


def test_a_mode_that_is_chosen_while_the_drive_is_on_its_way_down() -> None:
    """Found by random frames: such a mode was asked for its status before it had one."""
    subject = DriveSubject()
    for index, size, value in [(0x6060, 1, 3), (0x60FF, 4, 10_000), (0x6040, 2, 6), (0x6040, 2, 7), (0x6040, 2, 15)]:
        subject.receive(Frame(0x605, sdo(0x23 | 4 - size << 2, index, 0, value)))
    subject.pass_time(500 * MILLISECOND)
    subject.receive(Frame(0x605, sdo(0x2B, 0x6040, 0, 7)))  # disable operation: down a ramp first
    assert subject.node.drive.state is State.OPERATION_ENABLED
    subject.receive(Frame(0x605, sdo(0x2F, 0x6060, 0, 1)))
    subject.receive(Frame(0x605, sdo(0x40, 0x6041, 0, 0)))
    subject.pass_time(SECOND)
    assert subject.node.drive.state is State.SWITCHED_ON


@pytest.mark.thorough(5)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [LocalSubject, DriveSubject, RemoteSubject])
def test_memory_is_bounded_after_many_frames(kind: type[AnySubject], seed: int) -> None:
    source = random.Random(seed)
    subject = kind()
    for number in range(6000):
        subject.receive(some_frame(source))
        if number % 7 == 0:
            subject.pass_time(source.randrange(50 * MILLISECOND))
        if number % 11 == 0:
            subject.act(source.randrange(500))
        if number % 500 == 0:
            subject.forget_trace()
            subject.check()
    subject.check()


@pytest.mark.thorough(5)
@pytest.mark.parametrize("kind", [LocalSubject, DriveSubject, RemoteSubject])
def test_memory_is_bounded_though_nobody_takes_what_is_reported(kind: type[AnySubject]) -> None:
    subject = kind()
    network = subject.network
    for number in range(30_000):
        network.receive(Frame(0x705, b"\x05"), number)
        network.receive(Frame(0x709, b"\x05"), number)
    assert len(network.out.events) <= 10_000
    _, events = network.drain(30_000)
    assert len(events) <= 10_001
    assert events == [] or events[0].node_id == 0  # EventsDropped


@sees_inside
def test_the_measure_sees_what_grows() -> None:
    subject = LocalSubject()
    before = held(subject.network)
    subject.node.sdo.last += bytes(1000)
    assert held(subject.network) == before + 1000
    subject.network.out.frames += [Frame(1), Frame(2, b"12345678")]
    assert held(subject.network) == before + 1000 + 2 + 8
