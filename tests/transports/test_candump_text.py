"""Lines of candump: as can-utils 2020.11 prints them, seen on a kernel's vcan0."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_testing.strategies import random_frames
from canopen_transports.candump_text import NotAFrameError, parse_line
from canopen_transports.record import Record


@pytest.mark.parametrize(
    ("line", "time", "frame", "sent"),
    [
        ("vcan0  123   [8]  11 22 33 44 55 66 77 88", 0, "123#1122334455667788", False),
        ("vcan0  1F0   [0] ", 0, "1F0#", False),
        ("vcan0  123   [3]  remote request", 0, "123#R3", False),
        ("(000.035899)  vcan0  TX - -  00000123   [0]  remote request", 35_899_000, "00000123#R", True),
        ("(000.000000)  vcan0  RX - -  123   [8]  11 22 33 44 55 66 77 88   '.\"3DUfw.'", 0, "123#1122334455667788", False),
        ("(000.025665)  vcan0  TX - -       1F0   [0]                            ''", 25_665_000, "1F0#", True),
        ("(1436509053.850870)  can0  605   [2]  AB 40   'AB'", 1_436_509_053_850_870_000, "605#AB40", False),
        ("(1436509053.850870) can0 605#AB40 T", 1_436_509_053_850_870_000, "605#AB40", True),
        ("(1436509053.850870) can0 605#0011223344556677_A", 1_436_509_053_850_870_000, "605#0011223344556677", False),
    ],
)
def test_what_candump_prints(line: str, time: int, frame: str, sent: bool) -> None:
    record = parse_line(line.strip())
    assert (record.time, record.frame, record.sent) == (time, Frame.parse(frame), sent)
    assert record.channel.endswith("can0")


def test_dates_are_those_of_this_time_zone() -> None:
    one, other = (parse_line(f"(2026-11-22 06:04:{seconds})  vcan0  1F0   [0]") for seconds in ("26.643791", "27.000000"))
    assert other.time - one.time == 356_209_000
    assert one.time > 1_700_000_000 * 10**9


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("(000.026341)  vcan0  TX - -       123  [12]  11 22 33 44 55 66 77 88 99 AA 00 00", "CAN FD"),
        ("vcan0  123  [08]  11 22 33 44 55 66 77 88", "CAN FD"),
        ("(1436509053.850870) can0 123##0112233", "CAN FD"),
        ("can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME", "error frame"),
        ("(1436509053.850870) can0 20000004#0004000000000000", "error frame"),
    ],
)
def test_what_is_no_frame_of_classical_can(line: str, what: str) -> None:
    with pytest.raises(NotAFrameError, match=what):
        parse_line(line)


@pytest.mark.parametrize(
    "line",
    [
        "can0  123   [8]  11 22",
        "can0  123   [2]  11 2",
        "can0  123   [2]  XX YY",
        "can0  823   [0]",
        "can0  123   [9]  11 22 33 44 55 66 77 88 99",
        "candump - dump CAN bus traffic.",
        "(2026-99-22 06:04:26)  can0  1F0   [0]",
        "(1436509053.850870) can0 605#4",
    ],
)
def test_lines_of_something_else(line: str) -> None:
    with pytest.raises(ValueError, match=r".") as seen:
        parse_line(line)
    assert not isinstance(seen.value, NotAFrameError)


@given(random_frames(), st.booleans(), st.integers(0, 10**10))
def test_a_shown_line_is_the_frame_that_it_shows(frame: Frame, sent: bool, microseconds: int) -> None:
    identifier, _, data = str(frame).partition("#")
    shown = "remote request" if data.startswith("R") else " ".join(f"{byte:02X}" for byte in frame.data)
    seconds, fraction = divmod(microseconds, 10**6)
    line = f"({seconds:03d}.{fraction:06d})  can0  {'TX' if sent else 'RX'} - -  {identifier}   [{frame.dlc}]  {shown}"
    assert parse_line(line.strip()) == Record(microseconds * 1000, "can0", frame, sent)
