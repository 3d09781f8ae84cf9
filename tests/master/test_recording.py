"""Recordings of a chain: a row for each SYNC with what was sent and what came, in CSV and Parquet; and files that are none."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from canopen_master import Chain, open_master
from canopen_master.errors import PackageMissingError
from canopen_master.motion import recording
from canopen_master.motion.record_files import OF_CHAIN, OF_JOINT, CsvFile, RecordedJoint, RecordError, is_whole
from canopen_master.motion.record_reader import MotionRecord, is_record, read_record
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.units import Unit
from tests.loops import jump, loop
from tests.master.world import BUS, arm_of, following_arm, simulated, virtual_time

CYCLES = 30


def pyarrow() -> Any:
    return pytest.importorskip("pyarrow", reason="Parquet needs the extra `parquet`")


async def swing(arm: Chain, cycles: int = CYCLES) -> list[list[float]]:
    """Move the joints; return the set-points that were given."""
    start, given = arm.desired_positions, []
    async for cycle in arm.cycles():
        given.append([position + 0.002 * math.sin(cycle.time * 10) for position in start])
        arm.set_positions(given[-1])
        if cycle.number + 1 == cycles:
            return given
    raise AssertionError


def numbers(record: MotionRecord, column: str) -> list[float | None]:
    return [None if math.isnan(value) else value for value in record[column]]


def wait_for_file() -> None:
    """Wait for the threads that finish recordings, as a process does at its end."""
    for thread in threading.enumerate():
        if thread.name.startswith("recording"):
            thread.join()


@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run"])
def test_what_was_sent_and_what_came(tmp_path: Path, name: str) -> None:
    if name.endswith("parquet"):
        pyarrow()
    path = tmp_path / name

    @virtual_time
    async def test() -> None:
        async with following_arm(3, 4) as (_, _, arm):
            async with arm.record(path) as recorder:
                given = await swing(arm)
                errors = [device.following_error for device in arm.devices]
                words = [device.statusword for device in arm.devices]
            assert (recorder.lost, recorder.failure) == (0, None)
            record = read_record(path)
            assert len(record) == recorder.rows == CYCLES
            assert record.head.joints == (
                RecordedJoint("joint1", "radian", f"node 3 on {BUS}"),
                RecordedJoint("joint2", "radian", f"node 4 on {BUS}"),
            )
            assert (record.head.chain, record.head.cycle_time) == ("arm", 0.01)
            assert numbers(record, "cycle") == list(range(CYCLES))
            assert numbers(record, "time") == pytest.approx([0.01 * number for number in range(CYCLES)], abs=1e-6)
            assert not any(record["skipped"])
            for number, device in enumerate(arm.devices):
                # those given in the first cycle go along with the next SYNC, which begins the second row
                assert numbers(record, f"{device.name}.set_point")[1:] == [point[number] for point in given[: CYCLES - 1]]
                assert record.of(device.name, "following_error")[-1] == errors[number]
                assert record.of(device.name, "statusword")[-1] == words[number]
                assert set(record.of(device.name, "mode")) == {7}
                assert set(record.of(device.name, "controlword")) == {0x1F}
                points, positions = record.of(device.name, "set_point"), record.of(device.name, "position")
                for row in range(3, CYCLES):
                    error = record.of(device.name, "following_error")[row]
                    assert error == pytest.approx(points[row - 2] - positions[row], abs=2e-5)  # as the columns' text says

    test()


@virtual_time
async def test_rows_come_at_each_sync_whether_the_chain_follows_or_not(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3)
        async with arm.record(path):
            master.sync_start(0.01)
            await loop.sleep(0.1)  # not initialised: no rows
            await arm.initialise()
            await loop.sleep(0.0505)
            await arm.enable_interpolated_position()
            await swing(arm)
            await arm.halt()
            host.nodes[0].raise_fault(0x2310, host.now())  # type: ignore[attr-defined]
            await loop.sleep(0.0505)
    record = read_record(path)
    points = numbers(record, "joint1.set_point")
    followed = [number for number, point in enumerate(points) if point is not None]
    assert followed == list(range(followed[0], followed[0] + len(followed)))
    assert followed[0] > 5
    assert followed[-1] < len(points) - 5
    assert [error is None for error in numbers(record, "joint1.following_error")] == [point is None for point in points]
    assert None not in numbers(record, "joint1.position")
    assert int(record["joint1.statusword"][0]) & 0x6F == 0x27
    assert int(record["joint1.statusword"][-1]) & 0x08


@virtual_time
async def test_late_cycles_are_seen(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    async with following_arm(3) as (_, _, arm), arm.record(path):
        async for cycle in arm.cycles():
            arm.set_positions(arm.desired_positions)
            if cycle.number == 5:
                await loop.sleep(0.025)  # the loop is late
            if cycle.number == 10:
                jump(0.0305)  # the whole process is
            if cycle.number == 15:
                break
    record = read_record(path)
    assert sum(record["missed"]) == 1
    assert [skipped for skipped in record["skipped"] if skipped] == [2] == [arm.skipped_cycles]
    assert record["cycle"][-1] == len(record) - 1 + 2
    steps = [b - a for a, b in zip(record["time"], record["time"][1:], strict=False)]
    assert max(steps) > 0.03


@virtual_time
async def test_a_cancelled_block_waits_for_nothing_and_the_file_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, slow = tmp_path / "run.csv", threading.Event()
    written = CsvFile.write

    def late(file: CsvFile, rows: Sequence[Any]) -> None:
        assert slow.wait(30)
        written(file, rows)

    monkeypatch.setattr(CsvFile, "write", late)
    async with following_arm(3) as (_, _, arm):
        with loop.cancel_scope() as scope:
            async with arm.record(path) as recorder:
                await swing(arm)
                scope.cancel()
                await loop.sleep_forever()
        assert len(path.read_text().splitlines()) <= 3  # the disk does nothing yet, and nobody waits for it
        slow.set()
        recorder.wait()
        assert len(read_record(path)) == recorder.rows > CYCLES - 2


@virtual_time
async def test_a_disk_that_is_too_slow_costs_rows_and_not_cycles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, slow = tmp_path / "run.csv", threading.Event()
    written = CsvFile.write

    def late(file: CsvFile, rows: Sequence[Any]) -> None:
        assert slow.wait(30)
        written(file, rows)

    monkeypatch.setattr(CsvFile, "write", late)
    monkeypatch.setattr(recording, "MAX_WAITING", 13 * 10)
    async with following_arm(3) as (_, _, arm):
        with pytest.raises(RecordError, match="came faster than they could be written") as raised:
            async with arm.record(path) as recorder:
                await swing(arm)
                assert arm.missed_cycles == 0
                slow.set()
        assert raised.value.code == "CO343"
        assert recorder.rows == CYCLES
        assert len(read_record(path)) == CYCLES - recorder.lost == 11


@virtual_time
async def test_a_full_disk_ends_the_recording_and_not_the_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: CsvFile, rows: Sequence[Any]) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(CsvFile, "write", full)
    async with following_arm(3) as (_, _, arm):
        with pytest.raises(RecordError, match="No space left on device"):
            async with arm.record(tmp_path / "run.csv"):
                await swing(arm, 250)
                assert arm.missed_cycles == 0
        with pytest.raises(FileNotFoundError):
            async with arm.record(tmp_path / "no folder" / "run.csv"):
                raise AssertionError


@virtual_time
async def test_without_pyarrow_the_older_file_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    path = tmp_path / "run.parquet"
    path.write_text("older")
    async with following_arm(3) as (_, _, arm):
        with pytest.raises(PackageMissingError, match=r"pip install 'canopen-proto\[parquet\]'"):
            async with arm.record(path):
                raise AssertionError
    assert path.read_text() == "older"


@pytest.mark.parametrize(
    ("settings", "unit"),
    [
        (AxisSettings(), "count"),
        (AxisSettings(counts_per_unit=12.5), ""),
        (AxisSettings(unit=Unit.MILLIMETRE), "millimetre"),
        (AxisSettings().of_vendor(0x40054), "count"),
    ],
)
def test_the_unit_of_a_joint(settings: AxisSettings, unit: str) -> None:
    assert recording.unit_of(settings) in (unit, "radian")


HEAD = {"version": 1, "chain": "arm", "cycle_time": 0.01, "begun": "", "joints": [{"name": "a,b", "unit": "degree", "node": ""}]}
NAMES = 'cycle,time,"a,b.set_point"'


def text_of(*rows: str, head: Any = HEAD, names: str = NAMES) -> str:
    return "\n".join(("# canopen recording", f"# {json.dumps(head)}", names, *rows)) + "\n"


def test_columns_may_be_missing_and_values_too(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text_of("0,0.0,1.5", "1,0.01,"))
    record = read_record(path)
    assert is_record(path)
    assert numbers(record, "a,b.set_point") == [1.5, None]
    assert all(map(math.isnan, record.of("a,b", "torque")))
    path.write_text(text_of("0,0.0,1.5") + "1,0.0")
    assert (len(read_record(path)), read_record(path).is_cut) == (1, True)


@pytest.mark.parametrize(
    ("content", "seen"),
    [
        ("time,a\n0,0\n", "it begins neither with '# canopen recording' nor as a Parquet file"),
        (text_of(head={**HEAD, "version": 2}), "it has version 2 of the format, and this program knows version 1"),
        (text_of(head=[]), "its head is damaged"),
        (text_of(names="time,x"), "it has no column cycle"),
        (text_of("0,0,0", "1,0"), "line 5 has 2 cells, and there are 3 columns"),
        (text_of("0,0,0", "1,x,0"), "line 5, column time: 'x' is no number"),
        ("# canopen recording", "its head is damaged"),
        ("# canopen recording\n# \udcff\n", "line 2 is no UTF-8 text"),
        ("PAR1 and no more", "Parquet"),
    ],
)
def test_what_is_no_recording(tmp_path: Path, content: str, seen: str) -> None:
    if content.startswith("PAR1"):
        pyarrow()
    path = tmp_path / "run.csv"
    path.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(RecordError) as raised:
        read_record(path)
    assert seen in raised.value.seen
    assert raised.value.code == "CO344"
    with pytest.raises(RecordError, match="No such file"):
        read_record(tmp_path / "none.csv")


def test_a_parquet_file_of_something_else(tmp_path: Path) -> None:
    pyarrow()
    from pyarrow import parquet

    path = tmp_path / "run.parquet"
    parquet.write_table(pyarrow().table({"time": [1.0]}), path)
    with pytest.raises(RecordError, match="Parquet file of something else"):
        read_record(path)


def test_the_columns_have_a_kind() -> None:
    assert [name for name in (*OF_CHAIN, *OF_JOINT) if is_whole(f"a.{name}")] == [
        "cycle", "skipped", "missed", "controlword", "statusword", "mode",
    ]  # fmt: skip
