"""The boot-up of a network, as the machine file has it: entries of nodes, made of their files, DCFs and settings."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data import DataError
from canopen_data.configured import with_configured
from canopen_data.description import Commissioning
from canopen_data.descriptions import load_description
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_master.machine_file import read_machine
from canopen_master.machine_file.boot_entries import BusNetwork, Program, network_of, stamp_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import BootEntry, NetworkEntry
from canopen_proto.multiplexer import mux

HEAD = "[buses.can0]\n[nodes.lamp]\nid = 5\n"
FILTER, OUTPUT = mux(0x2000), mux(0x6200, 1)


def network(folder: Path, text: str) -> BusNetwork:
    path = folder / "cell.toml"
    path.write_text(text)
    machine = read_machine(path)
    return network_of(machine, "can0", Dictionaries(machine))


def entry(folder: Path, boot: str, file: str = "") -> BootEntry:
    file = f"file = '{file}'\n" if file else ""
    return network(folder, f"{HEAD}{file}boot = {{ {boot} }}\n").entry.nodes[5]


def write_dcf(folder: Path, values: dict[int, int], node_id: int = 5) -> None:
    description = load_description("sample_io.eds")
    configured = with_configured(description, values, Commissioning(node_id))  # type: ignore[arg-type]
    (folder / "lamp.dcf").write_bytes(encode_eds(write_eds(configured), "utf-8"))


def test_the_shortest_entry_checks_that_somebody_is_there(tmp_path: Path) -> None:
    assert entry(tmp_path, "") == BootEntry(5)
    assert network(tmp_path, HEAD).entry.nodes == {}
    assert network(tmp_path, f"{HEAD}boot = {{}}\n") == BusNetwork(
        "can0", NetworkEntry(Startup(), {5: BootEntry(5)}, 10 * SECOND), {5: "lamp"}, {}, ()
    )


def test_the_identity_is_that_of_the_file_unless_the_machine_says_another_one(tmp_path: Path) -> None:
    made = entry(tmp_path, "", "sample_io.eds")
    assert (made.device_type, made.identity) == (0x00070191, (0xFFFFFF01, 0x401, None, None))
    made = entry(tmp_path, "device_type = 0, vendor = 7, product = 0, revision = 8, serial = 9", "sample_io.eds")
    assert (made.device_type, made.identity) == (None, (7, None, 8, 9))


def test_the_network_and_the_assignment(tmp_path: Path) -> None:
    text = HEAD + "boot = { mandatory = true, keep_alive = true, start = false, restore = 1, software = 7, program = 'a.bin' }\n"
    (tmp_path / "a.bin").write_bytes(b"program")
    made = network(
        tmp_path, text + "[network]\nstart = 'all'\nmandatory_lost = 'stop all'\nnmt_pause = '2ms'\nboot_time = '1s'\n"
    )
    assert made.entry.startup == Startup(start_all=True, stop_all_on_loss=True)
    assert (made.entry.boot_time, made.entry.pause) == (SECOND, 2 * MILLISECOND)
    assert made.programs == {5: Program(str(tmp_path / "a.bin"), b"program")}
    assignment = Assignment(
        boots=False, is_mandatory=True, keep_alive=True, check_software=True, update_software=True, restore=True
    )
    assert made.entry.nodes == {5: BootEntry(5, assignment, restore_subindex=1, software=7)}
    made = network(tmp_path, HEAD + "boot = {}\n[network]\nstart = 'none'\nmandatory_lost = 'reset all'\n")
    assert made.entry.startup == Startup(application_starts=True, reset_all_on_loss=True)


@pytest.mark.parametrize(
    ("boot", "writes", "consumer_time"),
    [
        ("heartbeat = '200ms'", ((0x1017, 0, b"\xc8\x00"),), 600),
        ("heartbeat = '200ms', heartbeat_timeout = '250ms'", ((0x1017, 0, b"\xc8\x00"),), 250),
        ("heartbeat = '0'", ((0x1017, 0, b"\x00\x00"),), 0),
        ("heartbeat = '30s'", ((0x1017, 0, b"\x30\x75"),), 65535),
        ("heartbeat_timeout = '2s'", (), 2000),
        ("", (), 1500),  # the file's own heartbeat
        ("heartbeat_timeout = '0'", (), 0),
        ("guard_time = '100ms'", (), 0),  # its file has no 0x100C
    ],
)
def test_error_control(tmp_path: Path, boot: str, writes: tuple[tuple[int, int, bytes], ...], consumer_time: int) -> None:
    made = entry(tmp_path, boot, "sample_io.eds")
    assert (made.configuration, made.consumer_time) == (writes, consumer_time * MILLISECOND)
    assert made.assignment.guards is ("guard" in boot)


def test_guarding_is_told_to_a_node_that_may_know_it(tmp_path: Path) -> None:
    made = entry(tmp_path, "guard_time = '100ms'")
    assert made.configuration == ((0x100C, 0, b"\x64\x00"), (0x100D, 0, b"\x03"))


def test_the_settings_of_a_dcf_are_written_but_no_outputs(tmp_path: Path) -> None:
    write_dcf(tmp_path, {FILTER: 20, OUTPUT: 255, mux(0x1017): 100})
    made = network(tmp_path, f"{HEAD}boot = {{ configuration = 'lamp.dcf', store = true }}\n")
    writes = ((0x1017, 0, b"\x64\x00"), (0x2000, 0, b"\x14\x00"))
    assert made.entry.nodes[5].configuration == writes
    assert made.entry.nodes[5].consumer_time == 300 * MILLISECOND
    assert (made.entry.nodes[5].date, made.entry.nodes[5].save) == (stamp_of(writes), True)
    path = tmp_path / "lamp.dcf"
    assert made.notes == (f"lamp: 0x6200:01 of {path} is not written: a set-point, an output or an actual value",)


def test_a_concise_dcf_is_written_as_it_is_and_links_come_behind_it(tmp_path: Path) -> None:
    writes = [(0x2000, 2, b"\x01"), (0x2000, 0, b"\x14\x00")]
    (tmp_path / "lamp.bin").write_bytes(pack_concise(writes))
    path = tmp_path / "cell.toml"
    path.write_text(f"{HEAD}boot = {{ configuration = 'lamp.bin', heartbeat = '1s' }}\n")
    machine = read_machine(path)
    link = (0x1800, 1, b"\x85\x01\x00\x80")
    made = network_of(machine, "can0", Dictionaries(machine), {"lamp": [link]})
    assert made.entry.nodes[5].configuration == (*writes, link, (0x1017, 0, b"\xe8\x03"))


def test_a_stamp_takes_the_place_of_the_date_of_a_dcf(tmp_path: Path) -> None:
    dated = (0x1020, 1, b"\x01\0\0\0")
    (tmp_path / "lamp.bin").write_bytes(pack_concise([dated, (0x2000, 0, b"\x14\0")]))
    kept = entry(tmp_path, "configuration = 'lamp.bin', store = true")
    assert (kept.configuration, kept.date) == (((0x2000, 0, b"\x14\0"),), stamp_of(kept.configuration))
    assert entry(tmp_path, "configuration = 'lamp.bin'").configuration[0] == dated


def test_another_configuration_has_another_stamp() -> None:
    stamps = {stamp_of([(0x2000, 1, bytes([number]))]) for number in range(100)}
    assert len(stamps) == 100
    assert all(0 < days <= 1 << 15 and 0 < ms < 86_400_000 for days, ms in stamps)
    assert stamp_of([]) == stamp_of(())


@pytest.mark.parametrize(
    ("boot", "file", "said"),
    [
        ("store = true", "sample_io.eds", "store needs 0x1020, which its file does not have"),
        (
            "heartbeat_timeout = '500ms'",
            "sample_io.eds",
            "its heartbeat comes each 500 ms, which is not within heartbeat_timeout",
        ),
        ("configuration = 'sample_io.eds'", "", "sets nothing: it has no ParameterValue"),
        ("configuration = 'other.dcf'", "", "is of node 6, not of node 5"),
        ("configuration = 'lost.dcf'", "", "lost.dcf:6:16: error: in [2000]: ParameterValue '70000' is outside 0..65535"),
        ("configuration = 'cut.bin'", "", "is no concise DCF"),
        ("software = 5, program = 'empty'", "", "is no program"),
    ],
)
def test_settings_that_a_node_cannot_have(tmp_path: Path, boot: str, file: str, said: str) -> None:
    write_dcf(tmp_path, {FILTER: 20}, 6)
    (tmp_path / "lamp.dcf").rename(tmp_path / "other.dcf")
    (tmp_path / "lost.dcf").write_text(
        "[2000]\nParameterName=x\nObjectType=7\nDataType=6\nAccessType=rw\nParameterValue=70000\n"
        "[2001]\nParameterName=y\nObjectType=7\nDataType=6\nAccessType=rw\nParameterValue=1\n"
    )
    (tmp_path / "cut.bin").write_bytes(b"\x01")
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "sample_io.eds").write_text(write_eds(load_description("sample_io.eds")))
    with pytest.raises(DataError) as raised:
        entry(tmp_path, boot, file)
    assert said in raised.value.failed
    assert "cell.toml: nodes.lamp.boot: " in raised.value.failed
