"""`canopen plan`, and the planning behind it: what fits, what does not, and that the machine never shows more than the bound."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canopen_master.planning import Background, Exchange, bounds, plan, simulate, streams_of
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, LocalProtocolError
from canopen_transports.wire import QueueOrder
from tests.master.cli_support import Run, runner

MBIT = 1_000_000


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    own = tmp_path / "own"
    own.mkdir()
    return runner(capsys, monkeypatch, own)


@pytest.fixture
def chains(tmp_path: Path) -> str:
    path = tmp_path / "arm.csv"
    path.write_text("arm joint1 can0 3 joint2 can0 4 joint3 can1 3\n", encoding="utf-8")
    return str(path)


def joints(count: int) -> list[Exchange]:
    return [Exchange(f"joint{number}", number, ((0x200 + number, 8),), ((0x180 + number, 8),)) for number in range(1, count + 1)]


def test_six_joints_fit_into_4_ms(run: Run) -> None:
    outcome = run("plan", "--chains", "multiple_devices.csv", "--cycle", "4ms", "--bitrate", "1M")
    assert outcome.status == 0, outcome.err
    lines = outcome.out.splitlines()
    assert lines[0] == "/dev/pcan32: 6 joints, 1Mbit/s, cycle 4.00 ms"
    assert sum(line[1:].startswith("PDO arm1.joint") for line in lines) == 12
    assert any(line.startswith("heartbeat, the worst of 6") for line in lines)
    assert any(line.startswith("verdict           fits: ") for line in lines)


def test_what_does_not_fit_says_so_and_what_would(run: Run) -> None:
    outcome = run("plan", "--chains", "multiple_devices.csv", "--cycle", "4ms", "--bitrate", "125k", "--emcy", "0")
    assert outcome.status == 1
    assert "does NOT fit" in outcome.out
    assert "no bound" in outcome.out
    shortest = outcome.out.splitlines()[-1].split()[-2]
    again = run("plan", "--chains", "multiple_devices.csv", "--cycle", f"{shortest}ms", "--bitrate", "125k", "--emcy", "0")
    assert again.status == 0


def test_as_json_one_for_each_bus(run: Run, chains: str) -> None:
    outcome = run("plan", "--chains", chains, "--cycle", "2ms", "--bitrate", "500k", "--sdo", "0", "--heartbeat", "0", "--json")
    first, second = outcome.json
    assert (first["bus"], second["bus"]) == ("can0", "can1")
    assert [each["kind"] for each in second["streams"]] == ["SYNC", "RPDO", "TPDO", "EMCY"]
    sync = second["streams"][0]
    assert sync["can_id"] == 0x80
    assert 0 < sync["simulated_ms"] <= sync["worst_ms"] < 2
    assert 0 < second["simulated_load"] <= second["load"] < first["load"] < 1
    assert outcome.status == 0


def test_the_devices_own_file_says_which_pdos(run: Run, chains: str, tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    sections = ["[FileInfo]\nFileName=drive.eds\n", "[DeviceInfo]\nVendorName=x\n"]

    def add(index: int, subindex: int, kind: int, value: str) -> None:
        sections.append(
            f"[{index:X}sub{subindex:X}]\nParameterName=x\nObjectType=7\nDataType={kind}\nAccessType=rw\nDefaultValue={value}\n"
        )

    for index, base, transmission in ((0x1400, 0x200, 1), (0x1800, 0x180, 255), (0x1801, 0x280, 1)):
        sections.append(f"[{index:X}]\nParameterName=x\nObjectType=9\nSubNumber=3\n")
        add(index, 0, 5, "2")
        add(index, 1, 7, f"$NODEID+0x{base:X}")
        add(index, 2, 5, str(transmission))
        sections.append(f"[{index + 0x200:X}]\nParameterName=x\nObjectType=9\nSubNumber=2\n")
        add(index + 0x200, 0, 5, "1")
        add(index + 0x200, 1, 7, "0x60400010")
    sections.append("[MandatoryObjects]\nSupportedObjects=0\n[OptionalObjects]\nSupportedObjects=6\n")
    sections[-1] += "".join(f"{n}=0x{i:X}\n" for n, i in enumerate((0x1400, 0x1600, 0x1800, 0x1A00, 0x1801, 0x1A01), 1))
    eds.write_text("".join(sections), encoding="utf-8")
    outcome = run("plan", "--chains", chains, "--cycle", "2ms", "--bitrate", "1M", "--json", "-e", f"3={eds}")
    _, second = outcome.json
    pdos = [(each["can_id"], each["bytes"]) for each in second["streams"] if each["kind"] in ("RPDO", "TPDO")]
    assert pdos == [(0x203, 2), (0x283, 2)]  # the one of transmission type 255 is no part of the cycle


@pytest.mark.parametrize(
    ("arguments", "seen"),
    [
        (("--cycle", "4ms", "--bitrate", "5M"), "at most 1M"),
        (("--cycle", "4parsec", "--bitrate", "1M"), "not a time"),
        (("--cycle", "1us", "--bitrate", "1M"), "outside"),
        (("--cycle", "4ms", "--bitrate", "1M", "--rpdo", "nothing"), "nothing"),
        (("--bitrate", "1M"), "--cycle"),
    ],
)
def test_bad_input(run: Run, chains: str, arguments: tuple[str, ...], seen: str) -> None:
    outcome = run("plan", "--chains", chains, *arguments)
    assert outcome.status == 2
    assert seen in outcome.err


def test_two_pdos_of_one_identifier_are_refused() -> None:
    with pytest.raises(LocalProtocolError, match="RPDO b and TPDO b both have the CAN-ID 0x201"):
        plan("can0", [Exchange("b", 1, ((0x201, 8),), ((0x201, 8),))], MILLISECOND, MBIT)


def test_the_shortest_cycle_fits_and_the_next_shorter_one_does_not() -> None:
    found = plan("can0", joints(6), 10 * MILLISECOND, MBIT)
    assert found.fits
    assert found.shortest_cycle == 3 * MILLISECOND
    assert plan("can0", joints(6), 3 * MILLISECOND, MBIT).fits
    assert not plan("can0", joints(6), 2_500 * MICROSECOND, MBIT).fits
    assert plan("can0", joints(12), MILLISECOND, 5_000).shortest_cycle is None


@settings(max_examples=15)
@given(
    st.integers(1, 8),
    st.sampled_from([2, 3, 4, 10]),
    st.sampled_from([250_000, 500_000, MBIT]),
    st.sampled_from(QueueOrder),
    st.integers(0, 5),
)
def test_the_machine_never_shows_more_than_the_bound(count: int, cycle: int, bitrate: int, order: QueueOrder, seed: int) -> None:
    background = Background(order=order, heartbeat=20 * MILLISECOND, sdo=5 * MILLISECOND, emcy=30 * MILLISECOND)
    streams = streams_of(joints(count), cycle * MILLISECOND, background)
    found = bounds(streams, bitrate, order)
    if any(each.worst >= NEVER or (each.worst > each.message.period) for each in found):
        return  # the SYNC to which a TPDO belongs is not known then
    worst, _ = simulate(streams, bitrate, order, cycles=40, seed=seed)
    for stream, each in zip(streams, found, strict=True):
        assert worst[stream.can_id] <= each.worst
