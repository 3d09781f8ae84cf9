"""What travels on `tcp:`, without a socket."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_testing.strategies import random_frames
from canopen_transports.conformance.frames import EVERY_KIND
from canopen_transports.tcp.framing import (
    MAX_LINE,
    Bye,
    FramingError,
    LineSplitter,
    Lost,
    bye_line,
    checked,
    decode,
    encode,
    lost_line,
    shown,
)
from canopen_transports.tcp.server import Outgoing


def in_chunks(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    return [data[low:high] for low, high in itertools.pairwise(places)]


def lines_of(chunks: list[bytes]) -> list[bytes]:
    splitter = LineSplitter()
    lines = [line for chunk in chunks for line in splitter.feed(chunk)]
    assert all(len(line) <= MAX_LINE + 1 for line in lines)
    return lines


@pytest.mark.parametrize("frame", EVERY_KIND, ids=str)
def test_every_kind_of_frame_comes_out_as_it_went_in(frame: Frame) -> None:
    line = encode(frame)
    assert line == checked(line[:-1])
    assert decode(line[:-1]) == frame


@given(st.lists(random_frames(), max_size=20), st.lists(st.integers(0, 600), max_size=20))
def test_frames_survive_any_cutting(sent: list[Frame], cuts: list[int]) -> None:
    assert [decode(line) for line in lines_of(in_chunks(b"".join(map(encode, sent)), cuts))] == sent


@given(st.binary(max_size=1500) | st.lists(st.sampled_from([b"\n", b"\r", b"6" * 100, b"605#"])).map(b"".join), st.data())
def test_any_bytes_in_any_chunks_are_the_same_lines(data: bytes, draw: st.DataObject) -> None:
    cuts = draw.draw(st.lists(st.integers(0, len(data)), max_size=30))
    lines = lines_of(in_chunks(data, cuts))
    assert lines == lines_of([data])
    for line in lines:
        try:
            good = checked(line)
        except FramingError as error:
            assert len(str(error)) < 240
        else:
            frame = decode(good[:-1])
            assert isinstance(frame, Frame)
            assert encode(frame) == good.replace(b"#R0", b"#R")
            assert Frame.parse(good.decode()) == frame


@given(st.binary(max_size=300))
def test_a_client_makes_something_or_nothing_of_any_line(line: bytes) -> None:
    try:
        item = decode(line)
    except FramingError:
        return
    assert isinstance(item, Frame | Lost | Bye)


def test_a_line_without_end_is_given_up() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"605#40\n" + b"A" * MAX_LINE) == [b"605#40"]
    assert splitter.pending
    assert splitter.feed(b"A" * 1000) == [b"A" * (MAX_LINE + 1)]
    assert not splitter.pending
    assert splitter.feed(b"\n605#40\n") == []


def test_nothing_follows_a_line_that_is_one_byte_too_long() -> None:
    assert LineSplitter().feed(b"A" * MAX_LINE + b"\n605#40\n") == [b"A" * MAX_LINE, b"605#40"]
    assert LineSplitter().feed(b"A" * (MAX_LINE + 1) + b"\n605#40\n") == [b"A" * (MAX_LINE + 1)]


def test_what_a_person_types_is_understood() -> None:
    (line,) = LineSplitter().feed(b"60c#40aabb\r\n")
    assert checked(line) == b"60C#40AABB\n"


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"605",
        b"605#4",
        b"605##40",
        b"805#40",
        b"20000000#",
        b"605#R9",
        b"605#112233445566778899",
        b" 605#40",
        b"lost 3",
        b"hi",
    ],
)
def test_what_is_no_frame_is_refused(line: bytes) -> None:
    with pytest.raises(FramingError, match="is no CAN frame"):
        checked(line)


def test_the_words_beside_frames() -> None:
    assert decode(lost_line(17)[:-1]) == Lost(17)
    assert decode(lost_line(10**12)[:-1]) == Lost(10**9 - 1)
    assert decode(bye_line("too\nslow \N{SNOWMAN}")[:-1]) == Bye("too slow \\u2603")
    assert len(bye_line("x" * 1000)) == MAX_LINE + 1
    for line in (b"lost 0", b"lost", b"lost 99999999999", b"bye", b"bye " + b"x" * 300):
        with pytest.raises(FramingError, match="has no meaning"):
            decode(line)
    assert shown(b"\xff" * 50).endswith("'...")


def test_a_full_queue_says_where_it_lost_what() -> None:
    out = Outgoing(2)
    assert not out
    for number in range(5):
        out.put(b"%d\n" % number)
    assert out.take() == b"0\n1\nlost 3\n"
    assert not out
    for number in range(3):
        out.put(b"%d\n" % number)
    out._lines.popleft()
    out.put(b"9\n")
    assert out.take() == b"1\nlost 1\n9\n"


def test_an_end_leaves_nothing_but_the_reason() -> None:
    out = Outgoing(1)
    out.put(b"1\n")
    out.put(b"2\n")
    out.end("enough")
    assert out.take() == b"bye enough\n"
    assert not out


def test_much_is_taken_in_pieces() -> None:
    out = Outgoing(2000)
    for number in range(2001):
        out.put(b"%d\n" % number)
    taken = []
    while out:
        taken.append(out.take())
    assert len(taken) == 4
    assert b"".join(taken).splitlines() == [*(b"%d" % number for number in range(2000)), b"lost 1"]
