"""`canopen plan`, and the planning behind it: what fits, what does not, and that the machine never shows more than the bound."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.describing import describe
from canopen_data.eds.writer import write_eds
from canopen_master.bus_timing import Exchange, OtherTraffic, bounds, bus_timing, simulate, streams_of
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, LocalProtocolError
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_transports.wire import QueueOrder
from tests.cli.cli_support import Run, runner
from tests.examples import examples

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
    assert lines[0] == "/dev/pcan32: 6 nodes, 1Mbit/s, cycle 4.00 ms"
    assert sum(line[1:].startswith("PDO arm1.joint") for line in lines) == 12
    assert any(line.startswith("heartbeat, worst of 6") for line in lines)
    assert any(line.startswith("verdict           fits: ") for line in lines)


def test_a_line_for_all_joints_shows_the_worst_of_each_kind(run: Run) -> None:
    command = ("plan", "--chains", "multiple_devices.csv", "--cycle", "2900us", "--bitrate", "1M")
    heartbeats = [each for each in run(*command, "--json").json[0]["streams"] if each["kind"] == "heartbeat"]
    line = next(line for line in run(*command).out.splitlines() if line.startswith("heartbeat, worst of 6"))
    worst, simulated = (max(each[key] for each in heartbeats) for key in ("worst_ms", "simulated_ms"))
    assert f" {worst:.2f} ms  " in line
    assert f" {simulated:.2f} ms  " in line


@pytest.mark.parametrize("width", ["40", "76"])
def test_no_number_is_cut_on_a_narrow_terminal(run: Run, monkeypatch: pytest.MonkeyPatch, width: str) -> None:
    monkeypatch.setenv("COLUMNS", width)
    outcome = run("plan", "--chains", "multiple_devices.csv", "--cycle", "4ms", "--bitrate", "1M")
    assert "…" not in outcome.out
    assert "3.81 ms" in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= int(width)


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


def test_what_never_gets_out_is_not_said_to_be_quick(run: Run) -> None:
    starved = ("plan", "--chains", "multiple_devices.csv", "--cycle", "4ms", "--bitrate", "125k")
    lines = run(*starved).out.splitlines()
    assert next(line for line in lines if line.startswith("SDO answer")).split()[-5:] == ["no", "bound", "not", "seen", "none"]
    (network,) = run(*starved, "--json").json
    (answer,) = [each for each in network["streams"] if each["name"] == "SDO answer"]
    assert (answer["worst_ms"], answer["simulated_ms"], answer["fits"]) == (None, None, False)


def test_the_table_fits_into_80_columns(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    path = tmp_path / "twelve.csv"
    path.write_text("chain1 " + " ".join(f"joint{number} can0 {number}" for number in range(1, 13)) + "\n", encoding="utf-8")
    lines = run("plan", "--chains", str(path), "--cycle", "20ms", "--bitrate", "1M").out.splitlines()
    assert max(map(len, lines)) <= 80
    # One line each: title, head and rule, SYNC, 24 PDOs, 2 of SDO, heartbeats, EMCYs, and 3 facts.
    assert len(lines) == 3 + 1 + 24 + 2 + 2 + 3


def test_a_cycle_of_minutes_is_planned_as_quickly(run: Run, chains: str) -> None:
    outcome = run("plan", "--chains", chains, "--cycle", "10min", "--bitrate", "1M", "--json")
    assert outcome.status == 0
    assert all(each["simulated_ms"] is not None for each in outcome.json[0]["streams"])


def test_errors_and_the_sync_counter_are_counted(run: Run, chains: str) -> None:
    """SYNC waits for 135 bits and takes 55, or 65 with its counter. An error: 31 bits, and those 135 again."""
    plain = ("plan", "--chains", chains, "--cycle", "4ms", "--bitrate", "1M", "--json")
    for options, bits in (((), 190), (("--sync-counter",), 200), (("--errors", "10ms"), 190 + 31 + 135)):
        sync = run(*plain, *options).json[0]["streams"][0]
        assert sync["worst_ms"] == bits / 1000
        assert sync["bytes"] == (1 if "--sync-counter" in options else 0)


def eds_of(path: Path, pdos: dict[int, tuple[int, int, int, int]]) -> Path:
    """A device's file with PDOs of two bytes. Of each: COB-ID, transmission type, inhibit time, event timer."""
    sections = ["[FileInfo]\nFileName=drive.eds\n", "[DeviceInfo]\nVendorName=x\n"]

    def add(index: int, subindex: int, kind: int, value: str) -> None:
        sections.append(
            f"[{index:X}sub{subindex:X}]\nParameterName=x\nObjectType=7\nDataType={kind}\nAccessType=rw\nDefaultValue={value}\n"
        )

    for index, (cob_id, transmission, inhibit, timer) in pdos.items():
        sections.append(f"[{index:X}]\nParameterName=x\nObjectType=9\nSubNumber=5\n")
        for subindex, kind, value in ((0, 5, 5), (2, 5, transmission), (3, 6, inhibit), (5, 6, timer)):
            add(index, subindex, kind, str(value))
        add(index, 1, 7, f"$NODEID+0x{cob_id:X}")
        sections.append(f"[{index + 0x200:X}]\nParameterName=x\nObjectType=9\nSubNumber=2\n")
        add(index + 0x200, 0, 5, "1")
        add(index + 0x200, 1, 7, "0x60400010")
    listed = [each for index in pdos for each in (index, index + 0x200)]
    sections.append(f"[MandatoryObjects]\nSupportedObjects=0\n[OptionalObjects]\nSupportedObjects={len(listed)}\n")
    sections += [f"{number}=0x{index:X}\n" for number, index in enumerate(listed, 1)]
    path.write_text("".join(sections), encoding="utf-8")
    return path


def test_joints_of_a_machine_have_the_pdos_that_their_chain_plans(run: Run, tmp_path: Path) -> None:
    """Two TPDOs at each SYNC, of 7 and 8 bytes, where the bus has room for them; else only the one that is needed, as
    tests/master/test_bus_room.py has it."""
    (tmp_path / "drive.eds").write_text(write_eds(describe(drive_dictionary())), encoding="utf-8")
    nodes = "".join(f'[nodes.n{id}]\nid = {id}\nfile = "drive.eds"\n[joints.j{id}]\nnode = "n{id}"\n' for id in range(1, 13))
    names = ", ".join(f'"j{number}"' for number in range(1, 13))
    cell = tmp_path / "cell.toml"
    bus = '[buses.can0]\nlocator = "virtual:can0"\nbitrate = "1M"\n'
    cell.write_text(f'{bus}{nodes}[chains.arm]\njoints = [{names}]\nmode = "ip"\n', encoding="utf-8")
    for cycle, sizes in (("10ms", [7, 8]), ("4ms", [7])):
        done = run("plan", "-m", str(cell), "--cycle", cycle, "--emcy", "0", "--json")
        assert done.status == 0, done.err
        streams = [each for each in done.json[0]["streams"] if each["node"] == 12]
        assert [each["bytes"] for each in streams if each["kind"] == "RPDO"] == [6]
        assert sorted(each["bytes"] for each in streams if each["kind"] == "TPDO") == sizes
        assert ("arm.j12: TPDO 1, TPDO 3, TPDO 4 would be switched off" in done.err) is (cycle == "4ms")


def test_a_frame_that_comes_too_often_is_no_reason_for_another_cycle(run: Run, tmp_path: Path) -> None:
    eds = eds_of(tmp_path / "drive.eds", {0x1800: (0x180, 255, 2, 0)})
    cell = tmp_path / "cell.toml"
    cell.write_text(f'[buses.can0]\n[nodes.lamp]\nid = 3\nfile = "{eds.name}"\n', encoding="utf-8")
    outcome = run("plan", "-m", str(cell), "--bitrate", "125k", "--cycle", "10ms")
    assert outcome.status == 1
    assert "none fits: a longer inhibit time for TPDO lamp (event), or a faster bus" in outcome.out


def test_a_pdo_is_as_the_configuration_of_its_node_sets_it(run: Run, tmp_path: Path) -> None:
    """What a boot writes counts, not what the file of the device says: here the inhibit time, in 100 us."""
    eds = eds_of(tmp_path / "lamp.eds", {0x1800: (0x180, 255, 2, 0)})
    cell, dcf = tmp_path / "cell.toml", tmp_path / "lamp.dcf"
    assert run("eds", "to-dcf", str(eds), "--id", "3", "--set", "1800:03=100", "-o", str(dcf)).status == 0
    cell.write_text(
        f'[buses.can0]\n[nodes.lamp]\nid = 3\nfile = "{eds.name}"\nboot = {{ configuration = "{dcf.name}" }}\n', encoding="utf-8"
    )
    outcome = run("plan", "-m", str(cell), "--bitrate", "125k", "--cycle", "10ms", "--json")
    assert outcome.status == 0, outcome.err
    (lamp,) = [each for each in outcome.json[0]["streams"] if each["kind"] == "event"]
    assert lamp["period_ms"] == 10


def test_the_devices_own_file_says_which_pdos(run: Run, chains: str, tmp_path: Path) -> None:
    """RPDOs once a cycle, whatever they wait for; synchronous TPDOs at each SYNC; the others as often as they may come."""
    eds = eds_of(
        tmp_path / "drive.eds",
        {
            0x1400: (0x200, 1, 0, 0),
            0x1401: (0x300, 255, 0, 0),
            0x1402: (0x8000_0400, 1, 0, 0),
            0x1800: (0x180, 255, 50, 20),
            0x1801: (0x280, 1, 0, 0),
            0x1802: (0x380, 254, 0, 20),
            0x1803: (0x480, 255, 0, 0),
            0x1804: (0x2000_0480, 1, 0, 0),
        },
    )
    devices = ("-e", f"3={eds}", "-e", f"99={eds}")
    outcome = run("plan", "--chains", chains, "--cycle", "2ms", "--bitrate", "1M", "--json", *devices)
    _, second = outcome.json
    kinds = ("RPDO", "TPDO", "event")
    pdos = [
        (each["kind"], each["can_id"], each["bytes"], each["period_ms"]) for each in second["streams"] if each["kind"] in kinds
    ]
    assert pdos == [
        ("RPDO", 0x203, 2, 2),
        ("RPDO", 0x303, 2, 2),
        ("TPDO", 0x283, 2, 2),
        ("event", 0x183, 2, 5),  # its inhibit time
        ("event", 0x383, 2, 20),  # its event timer
    ]
    assert "arm.joint3: TPDO 483 has no inhibit time and no event timer: it is left out" in outcome.err
    assert "arm.joint3: PDO 00000483 has a 29-bit identifier: it is left out" in outcome.err
    assert "no joint of these chains has node-ID 99: its file is left out" in outcome.err


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


def test_twelve_joints_by_hand() -> None:
    """1 Mbit/s, 4 ms, nothing besides: frames of 135 bits, and a SYNC of 55."""
    none = OtherTraffic(heartbeat=0, sdo=0, emcy=0, reaction=0)
    found = bus_timing("can0", joints(12), 4 * MILLISECOND, MBIT, none)
    assert found.fits
    worst = {each.stream.name: each.worst // MICROSECOND for each in found.streams}
    assert worst["SYNC"] == 135 + 55  # behind a frame that has just begun
    # As late as its SYNC; then behind a frame that has just begun, a SYNC and eleven TPDOs.
    assert worst["TPDO joint12"] == 190 + 135 + 55 + 11 * 135 + 135
    # Behind a SYNC and all that is more urgent, and of the others one that has just begun; of the last one there are none.
    assert worst["RPDO joint11"] == 135 + 55 + 12 * 135 + 10 * 135 + 135
    assert worst["RPDO joint12"] == 55 + 12 * 135 + 11 * 135 + 135
    assert found.load == pytest.approx((24 * 135 + 55) / 4000)


def test_two_pdos_of_one_identifier_are_refused() -> None:
    with pytest.raises(LocalProtocolError, match="RPDO b and TPDO b both have the CAN-ID 0x201"):
        bus_timing("can0", [Exchange("b", 1, ((0x201, 8),), ((0x201, 8),))], MILLISECOND, MBIT)


def test_the_shortest_cycle_fits_and_the_next_shorter_one_does_not() -> None:
    """In tenths of a millisecond, as drives take it (0x60C2)."""
    found = bus_timing("can0", joints(6), 10 * MILLISECOND, MBIT)
    assert found.fits
    assert found.shortest_cycle == 2_800 * MICROSECOND
    assert bus_timing("can0", joints(6), 2_800 * MICROSECOND, MBIT).fits
    assert not bus_timing("can0", joints(6), 2_700 * MICROSECOND, MBIT).fits
    assert bus_timing("can0", joints(12), MILLISECOND, 5_000).shortest_cycle is None


@examples(15)
@given(
    st.integers(1, 8),
    st.sampled_from([2, 3, 4, 10]),
    st.sampled_from([250_000, 500_000, MBIT]),
    st.sampled_from(QueueOrder),
    st.integers(0, 5),
)
def test_the_machine_never_shows_more_than_the_bound(count: int, cycle: int, bitrate: int, order: QueueOrder, seed: int) -> None:
    background = OtherTraffic(order=order, heartbeat=20 * MILLISECOND, sdo=5 * MILLISECOND, emcy=30 * MILLISECOND)
    streams = streams_of(joints(count), cycle * MILLISECOND, background)
    found = bounds(streams, bitrate, order)
    if any(each.worst >= NEVER or (each.worst > each.message.period) for each in found):
        return  # the SYNC to which a TPDO belongs is not known then
    worst, _ = simulate(streams, bitrate, order, cycles=40, seed=seed)
    for stream, each in zip(streams, found, strict=True):
        assert worst[stream.can_id] <= each.worst
