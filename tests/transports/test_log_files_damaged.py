"""Log files that are none, that end in the middle, or that come from elsewhere: a clear error, behind what can be read."""

from __future__ import annotations

import io
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_transports.log_files import LOSSES, LogFileError, LogReader, log_writer
from canopen_transports.record import Record
from tests.examples import examples

NOW = 1_795_225_377_712_000_000
ASC = """\
date Sat Nov 21 23:16:17.712 2026
base hex  timestamps absolute
internal events logged
Begin Triggerblock Sat Nov 21 23:16:17.712 2026
 0.000000 Start of measurement
 0.000000 1  181             Rx   d 3 00 01 02
 0.500000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.01%
 1.000000 1  18FF0001x       Tx   d 3 01 01 02
End TriggerBlock
"""
LOG = "(1.5) can0 181#000102 R\n(2.5) can0 18FF0001#010102 T\n"
TRC = """\
;$FILEVERSION=2.1
;$STARTTIME=46347.9696
;$COLUMNS=N,O,T,B,I,d,R,L,D
;---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --
      1         0.000 DT  1     0181 Rx -  3    00 01 02
      2       500.000 ST  1          Rx -  4    00 00 00 08
      3      1000.000 DT  1 18FF0001 Tx -  3    01 01 02
"""
FRAMES = ["181#000102", "18FF0001#010102"]


def read(path: Path, content: bytes) -> tuple[list[str], LogReader, LogFileError | None]:
    """The frames in a file of this content, who read them, and the error behind them."""
    path.write_bytes(content)
    reader = LogReader(path)
    frames: list[str] = []
    try:
        frames.extend(str(record.frame) for record in reader)
    except LogFileError as error:
        assert error.seen
        assert error.tries
        assert str(path) in error.failed
        return frames, reader, error
    return frames, reader, None


@pytest.mark.parametrize("kind", [".log", ".asc", ".trc"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["ascii", "utf-8-sig", "utf-16"])
def test_text_as_other_systems_write_it(kind: str, line_end: str, encoding: str, tmp_path: Path) -> None:
    text = {".log": LOG, ".asc": ASC, ".trc": TRC}[kind].replace("\n", line_end)
    frames, _, error = read(tmp_path / f"a{kind}", text.encode(encoding))
    assert (frames, error) == (FRAMES, None)


def test_the_code_page_of_a_german_computer(tmp_path: Path) -> None:
    reference = LogReader(tmp_path / "a.asc")
    for march in (b"Mar", b"M\xe4r", "M\u00e4r".encode()):
        (tmp_path / "a.asc").write_bytes(ASC.encode().replace(b"Nov", march))
        assert list(LogReader(tmp_path / "a.asc")) == list(reference)
    (tmp_path / "a.log").write_bytes(b"(1.5) k\xe4n0 601#40\n")
    assert list(LogReader(tmp_path / "a.log")) == [Record(1_500_000_000, "k\u00e4n0", Frame.parse("601#40"))]


@pytest.mark.parametrize("encoding", ["ascii", "utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_a_stream_is_read_as_a_file_is(encoding: str, tmp_path: Path) -> None:
    channel = "can0" if encoding == "ascii" else "k\u00e4n0"
    content = LOG.replace("can0", channel).encode(encoding)
    (tmp_path / "a.log").write_bytes(content)
    records = list(LogReader(Path("standard input"), io.BufferedReader(io.BytesIO(content))))  # type: ignore[arg-type]
    assert [(record.channel, str(record.frame)) for record in records] == [(channel, frame) for frame in FRAMES]
    assert records == list(LogReader(tmp_path / "a.log"))


@examples(50)
@given(
    st.binary(max_size=60), st.sampled_from([b"", b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf", LOG.encode(), LOG.encode("utf-16")])
)
def test_whatever_a_stream_holds_never_another_error(tail: bytes, head: bytes) -> None:
    try:
        list(LogReader(Path("standard input"), io.BufferedReader(io.BytesIO(head + tail))))  # type: ignore[arg-type]
    except LogFileError as error:
        assert error.failed.startswith("standard input:")


def test_what_is_no_frame_is_counted(tmp_path: Path) -> None:
    for kind, text, last in ((".asc", ASC, "0.500000 1 Statistic: D 1"), (".trc", TRC, "2 500.000 ST 1 Rx")):
        frames, reader, _ = read(tmp_path / f"a{kind}", text.encode())
        assert (frames, reader.skipped) == (FRAMES, 1)
        assert last in reader.last_skip
    _, reader, _ = read(tmp_path / "a.asc", b"base hex\n\n 0.5 1  ErrorFrame\n")
    assert (reader.skipped, reader.last_skip, reader.overruns) == (1, "an error frame", 0)


@pytest.mark.parametrize(
    ("line", "overruns"),
    [
        ("(1.5) can0 20000004#0001000000000000", 1),
        ("(1.5) can0 20000004#0004000000000000", 0),  # it warns of errors
        ("(1.5) can0 20000080#0001", 0),  # a bus error: its second byte says nothing
        ("(1.5) can0 20000004#0", 0),
        ("can0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME", 1),
    ],
)
def test_a_recorder_that_was_overrun_says_so(tmp_path: Path, line: str, overruns: int) -> None:
    _, reader, _ = read(tmp_path / "a.log", f"{line}\n".encode())
    assert (reader.skipped, reader.last_skip, reader.overruns) == (1, "an error frame", overruns)


@pytest.mark.parametrize(
    ("line", "overruns"),
    [
        ("      2       500.000 ST  1          Rx -  4    00 00 00 02", 1),  # OVERRUN
        ("      2       500.000 ST  1          Rx -  4    00 00 00 48", 1),  # QOVERRUN, and BUSHEAVY
        ("      2       500.000 ST  1          Rx -  4    00 00 00 08", 0),
        ("      2       500.000 EC  1          Rx -  2    02 02", 0),
    ],
)
def test_peak_s_recorder_that_was_overrun_says_so(tmp_path: Path, line: str, overruns: int) -> None:
    at = TRC.splitlines()
    at[5] = line
    frames, reader, _ = read(tmp_path / "a.trc", "\n".join(at).encode())
    assert (frames, reader.skipped, reader.overruns) == (FRAMES, 1, overruns)


@pytest.mark.parametrize(
    ("version", "line"),
    [
        ("", "2) 1843 FFFFFFFF 4 00 00 00 02 ------OVERRUN"),
        (";$FILEVERSION=1.1\n", "2) 1843.0 Warng FFFFFFFF 4 00 00 00 02 OVERRUN"),
    ],
)
def test_older_files_of_peak_say_it_in_the_place_of_a_frame(tmp_path: Path, version: str, line: str) -> None:
    _, reader, _ = read(tmp_path / "a.trc", f"{version}; a comment\n{line}\n".encode())
    assert (reader.skipped, reader.overruns) == (1, 1)


def test_a_second_block_of_an_asc_has_its_own_date(tmp_path: Path) -> None:
    """Two recordings that were put together."""
    (tmp_path / "a.asc").write_text(ASC + ASC.replace("Nov 21", "Nov 22"))
    times = [record.time for record in LogReader(tmp_path / "a.asc")]
    day = 24 * 3600 * 10**9
    assert times[2:] == [time + day for time in times[:2]]
    headers = "\n".join(line for line in ASC.splitlines() if "Trigger" not in line)
    (tmp_path / "b.asc").write_text(f"{headers}\n{headers}".replace("Nov 21", "Nov 22", 2).replace("Nov 22", "Nov 21", 1))
    (tmp_path / "b.asc").write_text((tmp_path / "b.asc").read_text().replace(" timestamps absolute", "", 1))
    assert [record.time for record in LogReader(tmp_path / "b.asc")] == times


def test_a_second_block_of_an_asc_that_counts_otherwise_is_damage(tmp_path: Path) -> None:
    frames, _, error = read(tmp_path / "a.asc", (ASC + ASC.replace("hex", "dec")).encode())
    assert frames == FRAMES
    assert error is not None
    assert "a second header has other numbers or times: base dec timestamps absolute" in str(error)


@pytest.mark.parametrize(
    ("name", "content", "seen", "line"),
    [
        ("a.log", b"(1.5) can0 601#40\nhello\n", "'hello' is not a line of candump", 2),
        ("a.log", b"(1.5) can0 9FF#40\n", "identifier out of range", 1),
        ("a.log", b"(1.5) can0 601#R9\n", "not a classical CAN frame", 1),
        ("a.log", b"\xff\xfe\x00", "is not a line of candump", 1),
        ("a.log", b" (2026-11-21 23:00:00.000000)  can0  601   [1]  4\n", "the line announces 1 bytes", 1),
        ("a.blf", b"LOGG nonsense", "unpack requires", 0),
        ("a.blf", b"", "unpack requires", 0),
        ("a.blf", bytes(range(256)), "Unexpected file format", 0),
        ("a.blf", b"LOGG" + bytes(range(256)), "ends in the middle, after 260 of", 0),
        ("a.asc", b"hello\nworld\n", "neither a header nor frames", 0),
        ("a.asc", bytes(range(256)), "neither a header nor frames", 0),
        ("a.asc", ASC.replace("absolute", "relative").encode(), "counts from the line before", 0),
        ("a.asc", ASC.replace("Nov", "Foo").encode(), "Incompatible datetime", 1),
        ("a.trc", b"hello\nworld\n", "neither a header nor frames", 0),
        ("a.trc", b";$FILEVERSION=2.1\n;$STARTTIME=x\n", "could not convert", 2),
    ],
)
def test_files_that_are_none(name: str, content: bytes, seen: str, line: int, tmp_path: Path) -> None:
    _, _, error = read(tmp_path / name, content)
    assert error is not None
    assert seen in error.seen
    assert error.line == line
    assert (f"{tmp_path / name}:{line} is not" in error.failed) == bool(line)


@given(st.binary(max_size=300), st.sampled_from([b"", b"LOGG", ASC[:180].encode(), TRC[:180].encode(), b"\xff\xfe"]))
@examples(60)
def test_any_bytes_are_a_log_or_a_clear_error(tmp_path_factory: pytest.TempPathFactory, content: bytes, begin: bytes) -> None:
    for kind in LOSSES:
        read(tmp_path_factory.getbasetemp() / f"any{kind}", begin + content)


def cut_blf(tmp_path: Path) -> tuple[bytes, list[str]]:
    """A file of two compressed containers, and what is in it."""
    path = tmp_path / "whole.blf"
    frames = [Frame(0x181, number.to_bytes(2, "big")) for number in range(3000)]
    writer = log_writer(path)
    for number, frame in enumerate(frames):
        writer.write(Record(NOW + number * 1_000_000, "can0", frame))
    writer.close()
    return path.read_bytes(), [str(frame) for frame in frames]


def test_a_blf_that_ends_in_the_middle_says_so_behind_what_is_there(tmp_path: Path) -> None:
    whole, frames = cut_blf(tmp_path)
    counts = []
    for size in (80, 144, 150, 165, 180, len(whole) // 2, len(whole) - 300, len(whole) - 1):
        found, _, error = read(tmp_path / "a.blf", whole[:size])
        assert error is not None
        assert error.seen == f"the file ends in the middle, after {size} of {len(whole)} bytes"
        assert found == frames[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert 0 < counts[5] < len(frames)


def test_a_blf_that_is_damaged(tmp_path: Path) -> None:
    whole, frames = cut_blf(tmp_path)
    damaged = bytearray(whole)
    damaged[len(whole) * 3 // 4] ^= 0xFF
    found, _, error = read(tmp_path / "a.blf", bytes(damaged))
    assert error is not None
    assert "decompressing" in error.seen
    assert found == frames[: len(found)]


@pytest.mark.parametrize("kind", [".log", ".asc", ".trc"])
def test_a_line_that_ends_in_the_middle_is_told(kind: str, tmp_path: Path) -> None:
    text = {".log": LOG, ".asc": ASC.removesuffix("End TriggerBlock\n"), ".trc": TRC}[kind]
    last = text.rstrip("\n").rfind("\n") + 1
    blank = len(text[last:]) - len(text[last:].lstrip())
    for end in range(last + blank + (0 if kind == ".log" else 14) + 1, len(text) - 1 - (3 if kind == ".log" else 0)):
        frames, reader, error = read(tmp_path / f"a{kind}", text[:end].encode())
        assert frames[:1] == FRAMES[:1]
        whole = reader.skipped + len(frames) + (error is not None)
        assert whole == 2 if kind == ".log" else 3
        if error is not None:
            assert error.line == text.count("\n", 0, last) + 1


def test_python_can_itself_says_nothing_of_a_blf_that_ends_in_the_middle(tmp_path: Path) -> None:
    whole, frames = cut_blf(tmp_path)
    (tmp_path / "a.blf").write_bytes(whole[: len(whole) // 2])
    assert 0 < len(list(can.BLFReader(tmp_path / "a.blf"))) < len(frames)  # which is why we look at its length ourselves
