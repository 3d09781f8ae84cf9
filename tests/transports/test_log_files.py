"""Log files: what each kind keeps, and what it loses."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import REMOTE, Frame
from canopen_testing.strategies import random_frames
from canopen_transports.conformance.frames import EVERY_KIND
from canopen_transports.log_files import LOSSES, CandumpWriter, LogFileError, LogReader, kind_of, log_writer
from canopen_transports.record import Record
from tests.examples import examples
from tests.interop.recorded import FOLDER, needs_recordings

NOW = 1_795_225_377_712_132_000


def written(path: Path, records: list[Record]) -> list[Record]:
    writer = log_writer(path)
    for record in records:
        writer.write(record)
    writer.close()
    assert writer.left_out == len(records) - len(list(LogReader(path)))
    return list(LogReader(path))


RECORDS = [
    Record(NOW + number * 1_234_567_000, f"can{number % 2}", frame, number % 3 == 0) for number, frame in enumerate(EVERY_KIND)
]


@pytest.mark.parametrize("kind", LOSSES)
def test_what_comes_back(kind: str, tmp_path: Path) -> None:
    back = written(tmp_path / f"a{kind}", RECORDS)
    expected = [record for record in RECORDS if kind != ".trc" or not record.frame.flags & REMOTE]
    assert ("remote frames are left out" in LOSSES[kind]) == (kind == ".trc")
    assert [record.frame for record in back] == [record.frame for record in expected]
    assert [record.sent for record in back] == [record.sent and kind != ".pcap" for record in expected]
    cut = NOW % 1_000_000 if kind == ".asc" else 0  # the date is kept to the millisecond
    assert [record.time + cut for record in back] == [record.time for record in expected]


@pytest.mark.parametrize("kind", LOSSES)
def test_names_of_buses_become_numbers(kind: str, tmp_path: Path) -> None:
    records = [Record(NOW, "vcan7", EVERY_KIND[3]), Record(NOW, "lab", EVERY_KIND[4]), Record(NOW, "vcan7", EVERY_KIND[5])]
    names = [record.channel for record in written(tmp_path / f"a{kind}", records)]
    if kind in (".log", ".pcapng"):
        assert names == ["vcan7", "lab", "vcan7"]
    elif kind == ".pcap":
        assert LOSSES[kind].startswith("names of buses; ")
        assert names == ["can0"] * 3
    else:
        assert "names of buses become numbers" in LOSSES[kind]
        assert names == (["can1", "can2", "can1"] if kind == ".trc" else ["can0", "can1", "can0"])


MILLISECOND = 10**6
YEAR_1990 = 631_152_000 * 10**9


def after_the_losses(kind: str, times: list[int]) -> list[int]:
    """What LOSSES says of times."""
    first = times[0]
    if kind == ".asc":
        assert (
            "the date is kept to the millisecond, and without its time zone; frames earlier than the first one get its time"
            in (LOSSES[kind])
        )
        return [max(time, first) - first % MILLISECOND for time in times]
    if kind == ".blf":
        assert "times without a date (before 1990) are counted from the first frame's millisecond" in LOSSES[kind]
        assert "frames earlier than the first one get its time" in LOSSES[kind]
        dated = 0 if first >= YEAR_1990 else first - first % MILLISECOND
        return [max(time, first) - dated for time in times]
    return times


@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize(
    "times",
    [
        [NOW, NOW + 1000, NOW + 2000, NOW + 86_400 * 10**9],
        [NOW // 10**9 * 10**9 + 7 * MILLISECOND, NOW + 3 * 10**9],  # 7 ms of a second: not ".7"
        [NOW + 5 * 10**9, NOW, NOW + 6 * 10**9],  # two buses: one was told late
        [0, 1000, 1_500_000_000],
        [1_234_567_000, 2_000_000_000],
        [YEAR_1990 - 1000, YEAR_1990 + 10**9],
        [YEAR_1990, YEAR_1990 + 10**9],
    ],
)
def test_times(kind: str, times: list[int], tmp_path: Path) -> None:
    back = written(tmp_path / f"a{kind}", [Record(time, "can0", EVERY_KIND[3]) for time in times])
    assert [record.time for record in back] == after_the_losses(kind, times)


@pytest.mark.parametrize("kind", LOSSES)
def test_an_empty_recording(kind: str, tmp_path: Path) -> None:
    assert written(tmp_path / f"a{kind}", []) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("kind", LOSSES)
def test_a_file_that_cannot_be_ended_is_closed_all_the_same(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"full{kind}"
    path.symlink_to("/dev/full")
    writer = log_writer(path)
    failures = []
    for step in (lambda: writer.write(RECORDS[0]), writer.close):
        try:
            step()
        except OSError as error:
            failures.append(error.errno)
    assert failures[0] == errno.ENOSPC
    assert writer._file.closed  # type: ignore[attr-defined]


def test_a_name_that_is_no_text_does_not_disturb(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"k\xe4n.trc")  # PEAK's format has the file's name in it
    assert [record.frame for record in written(path, RECORDS[:3])] == [record.frame for record in RECORDS[:3]]


@given(
    st.lists(
        st.tuples(st.integers(0, 4 * 10**18), st.sampled_from(["", "can0", "tcp0"]), random_frames(), st.booleans()), max_size=9
    )
)
@examples(40)
def test_a_log_of_ours_keeps_all(entries: list[tuple[int, str, Frame, bool]]) -> None:
    path = Path(os.environ["PYTEST_LOG_FILE"])
    records = [Record(time // 1000 * 1000, channel, frame, sent) for time, channel, frame, sent in entries]
    assert written(path, records) == [each._replace(channel=each.channel or "can0") for each in records]


@pytest.fixture(autouse=True, scope="module")
def _one_file(tmp_path_factory: pytest.TempPathFactory) -> None:
    os.environ["PYTEST_LOG_FILE"] = str(tmp_path_factory.mktemp("logs") / "any.log")


def test_what_candump_and_python_can_write_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(
        "(1436509053.850870) vcan0 601#40\n\n"
        "(1436509053.850871) vcan0 18FF0001#R3 T\n"
        "(0.000000001) can1 123#1122334455667788_E R\n"
        "(1.5) can1 20000080#0000000000000000\n"
        "(1.5) can1 123##1AABB\n"
    )
    reader = LogReader(path)
    assert list(reader) == [
        Record(1436509053_850870_000, "vcan0", Frame.parse("601#40")),
        Record(1436509053_850871_000, "vcan0", Frame.parse("18FF0001#R3"), True),
        Record(1, "can1", Frame.parse("123#1122334455667788")),
    ]
    assert (reader.skipped, reader.last_skip) == (2, "a CAN FD frame")


def test_python_can_reads_ours(tmp_path: Path) -> None:
    written(tmp_path / "a.log", RECORDS)
    messages = list(can.CanutilsLogReader(str(tmp_path / "a.log")))
    assert [message.dlc for message in messages] == [record.frame.dlc for record in RECORDS]
    assert [message.is_remote_frame for message in messages] == [bool(record.frame.flags & REMOTE) for record in RECORDS]
    assert [message.is_rx for message in messages] == [not record.sent for record in RECORDS]


def test_python_can_would_lose_a_remote_frames_length(tmp_path: Path) -> None:
    writer = can.CanutilsLogWriter(str(tmp_path / "a.log"))
    writer.on_message_received(can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True, dlc=1))
    writer.stop()
    assert "701#R R" in (tmp_path / "a.log").read_text()  # which is why we write these files ourselves


def test_what_is_no_frame_of_ours_is_counted_in_a_blf(tmp_path: Path) -> None:
    writer = can.BLFWriter(str(tmp_path / "a.blf"))
    writer.on_message_received(can.Message(arbitration_id=1, is_error_frame=True, timestamp=1.0))
    writer.on_message_received(can.Message(arbitration_id=1, is_fd=True, data=bytes(12), timestamp=1.0))
    writer.on_message_received(can.Message(arbitration_id=1, is_extended_id=False, data=b"\1", timestamp=1.0))
    writer.stop()
    reader = LogReader(tmp_path / "a.blf")
    assert [str(record.frame) for record in reader] == ["001#01"]
    assert reader.skipped == 2
    assert "CAN FD" in reader.last_skip


def test_no_such_file(tmp_path: Path) -> None:
    for kind in LOSSES:
        with pytest.raises(LogFileError, match="No such file"):
            list(LogReader(tmp_path / f"a{kind}"))
        with pytest.raises(LogFileError, match="No such file"):
            log_writer(tmp_path / "nowhere" / f"a{kind}")


def test_kinds() -> None:
    assert kind_of(Path("A.LOG")) == ".log"
    for name, seen in (("trace.txt", "it ends in '.txt'"), ("trace", "it has no ending")):
        with pytest.raises(LogFileError) as caught:
            kind_of(Path(name))
        assert caught.value.seen == seen
        assert caught.value.tries == ("one of .log, .asc, .blf, .trc, .pcap, .pcapng, such as trace.log",)


def test_each_line_is_there_at_once(tmp_path: Path) -> None:
    writer = log_writer(tmp_path / "a.log")
    assert isinstance(writer, CandumpWriter)
    writer.write(RECORDS[0])
    assert list(LogReader(tmp_path / "a.log")) == RECORDS[:1]
    writer.close()


@needs_recordings
def test_recorded_sessions_are_read(tmp_path: Path) -> None:
    paths = sorted(FOLDER.glob("*.log"))
    assert paths
    for path in paths:
        reader = LogReader(path)
        records = list(reader)
        assert [str(record.frame) for record in records] == [line.split()[2] for line in path.read_text().splitlines()]
        assert not reader.skipped
        for kind in LOSSES:
            back = written(tmp_path / f"{path.stem}{kind}", records)
            assert [record.frame for record in back] == [
                record.frame for record in records if kind != ".trc" or not record.frame.flags & REMOTE
            ]


def test_the_documentation_says_what_is_lost() -> None:
    page = Path(__file__).parents[2] / "docs" / "buses.md"
    rows = {row.split("|")[1].strip(" `"): row.split("|")[2] for row in page.read_text().splitlines() if row.startswith("| `.")}
    assert list(rows) == list(LOSSES)
    for kind, losses in LOSSES.items():
        for loss in filter(None, losses.split("; ")):
            assert loss.removesuffix(" are left out").replace(", and without", ", without") in rows[kind]
