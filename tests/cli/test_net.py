"""`canopen net`: what is checked, booted and watched, what is never sent, and what is said when it fails."""

from __future__ import annotations

import signal
from binascii import crc32
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import trio

from canopen_cli.app import CLOSED_PIPE
from canopen_cli.net import boot as net_boot
from canopen_cli.net import support as net_support
from canopen_cli.shared.frames_shown import frames_of
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.screen import Screen
from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning
from canopen_data.descriptions import load_description
from canopen_data.eds.writer import write_eds
from canopen_master.machine_file import BootSettings, read_machine
from canopen_master.network_booting import network_boot
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import SimulatedDevices, simulated_devices
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.boot.network_boot import NetworkBoot
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.nmt import NmtCommand
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings, ProgramMemory
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record
from tests.cli.cli_support import Alarm, Run, runner_in_folder
from tests.cli.command_examples import fit_their_schema
from tests.core.full_device import full_device

DEMO = ("-b", "demo")
CELL = """
[buses.can0]

[defaults.nodes]
boot = { mandatory = true, heartbeat = "100ms" }

[nodes]
left = { id = 3 }
right = { id = 4 }
lamp = { id = 9, file = "sample_io.eds", boot = { mandatory = false } }
"""
SERIAL_OF_LEFT = "left = { id = 3, boot = { serial = 99 } }"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


class Sent(NamedTuple):
    """The frames that passed on the bus while a command ran."""

    frames: list[Frame]

    @property
    def nmt(self) -> list[str]:
        return [frame.data.hex() for frame in self.frames if frame.can_id == 0]

    @property
    def downloads(self) -> list[tuple[int, int]]:
        """Node-ID and index of each SDO download that was begun."""
        sdo = (frame for frame in self.frames if 0x600 < frame.can_id < 0x680 and frame.data[0] >> 5 in (1, 6))
        return [(frame.can_id - 0x600, int.from_bytes(frame.data[1:3], "little")) for frame in sdo]


def cell(old: str = "", new: str = "") -> str:
    """Write the machine file, with something else in place of a part of it; return its name."""
    assert old in CELL
    Path("cell.toml").write_text(CELL.replace(old, new, 1))
    return "cell.toml"


def sent(trace: str = "trace.log") -> Sent:
    return Sent([record.frame for record in LogReader(Path(trace))])


TRACE = ("--trace", "trace.log", "--force")


def without(monkeypatch: pytest.MonkeyPatch, *node_ids: int) -> None:
    """Let simulated devices be away: they are not made."""
    made = net_support.devices_of_machine

    def fewer(*arguments: Any) -> dict[str, tuple[str, list[DeviceMaker]]]:
        from canopen_proto.machine import Outbox

        return {
            bus: (locator, [maker for maker in makers if maker(Outbox()).node_id not in node_ids])
            for bus, (locator, makers) in made(*arguments).items()
        }

    monkeypatch.setattr(net_support, "devices_of_machine", fewer)


@pytest.fixture
def rung(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> Alarm:
    """An alarm that rings while a command has simulated devices."""

    @asynccontextmanager
    async def watched(*arguments: Any, **options: Any) -> AsyncIterator[SimulatedDevices]:
        async with simulated_devices(*arguments, **options) as simulation:
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            yield simulation

    monkeypatch.setattr(net_support, "simulated_devices", watched)
    return alarm


# ---- check ----


def test_check_writes_nothing_and_tells_what_differs(run: Run) -> None:
    outcome = run("net", "check", cell("right = { id = 4 }", "right = { id = 4, boot = { serial = 99 } }"), *DEMO, *TRACE)
    assert outcome.status == ExitCode.DIFFERENT
    assert "   4  right  0x1018:04 identity_object:serial_number  0x00000063  0x00000002" in outcome.out
    assert "   3  left   0x1017:00 producer_heartbeat_time        0x0064      0x01F4" in outcome.out
    assert "0 of 3 nodes as in the file, 1 another device, 2 with other settings" in outcome.err
    master = [frame for frame in sent().frames if frame.can_id < 0x80 or 0x600 < frame.can_id < 0x680]
    assert len(master) > 10
    assert {frame.data[0] & 0xE0 for frame in master if frame.can_id > 0x600} <= {0x40, 0x60}  # initiate upload, its segments
    assert [frame for frame in master if frame.can_id < 0x80] == []  # no NMT, no SYNC, no LSS


def test_check_in_json_and_only_the_identity(run: Run) -> None:
    outcome = run("net", "check", cell(), "--identity", "--json", *DEMO)
    assert outcome.status == ExitCode.OK
    assert [(each["name"], each["answers"], each["right"]) for each in outcome.json] == [
        ("left", True, True), ("right", True, True), ("lamp", True, True),
    ]  # fmt: skip
    assert [each["index"] for each in outcome.json[0]["objects"]] == [0x1000, *[0x1018] * 4]


def test_check_of_nodes_that_are_away(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, 3)
    outcome = run("net", "check", cell(), "--identity", *DEMO)
    assert outcome.status == ExitCode.DIFFERENT
    assert outcome.out.splitlines()[2].split() == ["3", "left", "silent"]
    assert "2 of 3 nodes as in the file, 1 silent" in outcome.err
    without(monkeypatch, 4, 9)
    outcome = run("net", "check", cell(), *DEMO)
    assert (outcome.status, "CO201: no node of cell.toml answers" in outcome.err) == (ExitCode.NO_ANSWER, True)


# ---- boot ----


def test_boot_resets_configures_and_starts_each_node(run: Run) -> None:
    outcome = run("net", "boot", cell(), "--yes", "--json", *DEMO, *TRACE)
    assert outcome.status == ExitCode.OK
    assert [(each["node"], each["letter"], each["running"]) for each in outcome.json] == [
        (3, "0", True),
        (4, "0", True),
        (9, "0", True),
    ]
    assert sent().nmt[0] == "8200"
    assert sorted(sent().nmt[1:]) == ["0103", "0104", "0109"]
    assert sorted(sent().downloads) == [(3, 0x1017), (4, 0x1017), (9, 0x1017)]
    assert "3 nodes ready" in outcome.err


def test_boot_must_be_confirmed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run("net", "boot", cell(), *DEMO)
    assert (outcome.status, "nothing was sent" in outcome.err) == (ExitCode.USAGE, True)
    assert "reset all nodes of can0" in outcome.err
    assert run("net", "watch", cell(), *DEMO).status == ExitCode.USAGE
    kept = cell("mandatory = false", "keep_alive = true")
    assert "reset the nodes that are not kept alive of can0" in run("net", "boot", kept, *DEMO).err


def test_a_mandatory_node_that_fails_is_not_started(run: Run) -> None:
    outcome = run("net", "boot", cell("left = { id = 3 }", SERIAL_OF_LEFT), "--yes", *DEMO, *TRACE)
    assert outcome.status == ExitCode.PARTIAL
    assert "CO215: 1 mandatory node not ready (left): 2 of 3 nodes run, 1 failed" in outcome.err
    assert 'start = "each" in [network], the default: each node that is ready runs' in outcome.err
    assert 'start = "all" in [network], if no node may run without this one' in outcome.err
    assert "0x1018:04 is 0x00000001, expected 0x00000063" in outcome.err
    assert "canopen net check -m cell.toml -b demo" in outcome.err
    assert sorted(sent().nmt) == ["0104", "0109", "8200"]
    assert "   3  left   has another serial number  O  " in outcome.out


def test_nobody_is_started_by_all_if_a_mandatory_node_fails(run: Run) -> None:
    cell("left = { id = 3 }", SERIAL_OF_LEFT)
    path = Path("cell.toml")
    path.write_text(path.read_text() + "[network]\nstart = 'all'\n")
    outcome = run("net", "boot", "cell.toml", "--yes", "--json", *DEMO, *TRACE)
    assert (outcome.status, outcome.error["code"], outcome.error["node"]) == (ExitCode.PARTIAL, "CO215", 3)
    assert "1 mandatory node not ready (left): no node runs, 2 ready and not started, 1 failed" in outcome.error["message"]
    assert [each["state"] for each in outcome.json] == ["failed", "ready, not started", "ready, not started"]
    assert [each["mandatory"] for each in outcome.json] == [True, True, False]
    assert sent().nmt == ["8200"]
    assert [each["running"] for each in outcome.json] == [False, False, False]


def test_an_optional_node_that_fails_stops_nobody(run: Run) -> None:
    outcome = run("net", "boot", cell("mandatory = false", "mandatory = false, serial = 9"), "--yes", *DEMO)
    assert outcome.status == ExitCode.PARTIAL
    assert "CO216: 1 node not ready (lamp): 2 of 3 nodes run, 1 failed" in outcome.err


def test_a_mandatory_node_that_is_away(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    without(monkeypatch, 4)
    outcome = run("net", "boot", cell(), "--yes", *DEMO)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "CO215" in outcome.err
    assert "canopen scan -m cell.toml -b demo    (which nodes are there?)" in outcome.err


def test_ctrl_c_says_the_state_of_each_node(run: Run, rung: Alarm) -> None:
    rung.set((0.06, signal.SIGINT))  # after the first heartbeat of one node, before that of the others
    outcome = run("net", "boot", cell(), "--yes", *DEMO, *TRACE)
    assert outcome.status == ExitCode.INTERRUPTED
    started = {command[2:] for command in sent().nmt if command.startswith("01")}
    told = dict(line.strip().split(": ", 1) for line in outcome.err.splitlines() if ": " in line and "node " not in line)
    names = {"03": "left", "04": "right", "09": "lamp"}
    assert set(filter(None, told.get("running", "").split(", "))) == {names[each] for each in started}
    assert started != set(names)
    assert "not finished: reset, perhaps configured, or its program written, in part; not started" in outcome.err


# ---- a configuration that is stored ----


def keeping_device() -> str:
    """Write the file of a device with 0x1010 and 0x1020, and a DCF for it; return the machine file."""
    description = describe(full_device())
    Path("device.eds").write_text(write_eds(description))
    configured = with_configured(description, {mux(0x1017): 100}, Commissioning(5))
    Path("device.dcf").write_text(write_eds(configured))
    Path("cell.toml").write_text(
        "[buses.can0]\n[simulation]\nstate = 'state.json'\n[nodes.a]\nid = 5\nfile = 'device.eds'\n"
        "boot = { mandatory = true, configuration = 'device.dcf', store = true }\n"
    )
    return "cell.toml"


def test_a_stored_configuration_is_not_written_again(run: Run) -> None:
    machine = keeping_device()
    first = run("net", "boot", machine, "--yes", *DEMO, *TRACE)
    assert first.status == ExitCode.OK, first.err
    assert [index for _, index in sent().downloads] == [0x1017, 0x1020, 0x1020, 0x1010]
    assert run("net", "boot", machine, "--yes", *DEMO, *TRACE).status == ExitCode.OK
    assert sent().downloads == []
    description = load_description("device.dcf")
    Path("device.dcf").write_text(write_eds(with_configured(description, {mux(0x1017): 200})))
    assert run("net", "boot", machine, "--yes", *DEMO, *TRACE).status == ExitCode.OK
    assert len(sent().downloads) == 4


# ---- a program ----


def test_a_node_with_another_program_gets_the_right_one(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    memory, image = ProgramMemory(), bytes(range(200))
    Path("new.bin").write_bytes(image)
    loader = partial(BootLoader, node_id=5, settings=BootLoaderSettings(trial=True), memory=memory)
    monkeypatch.setattr(net_support, "devices_of_machine", lambda *arguments: {"can0": ("virtual:demo", [loader])})
    boot = f"boot = {{ mandatory = true, software = {crc32(image)}, program = 'new.bin', confirm_program = true }}"
    Path("cell.toml").write_text(f"[buses.can0]\n[nodes.a]\nid = 5\n{boot}\n")
    assert "a may get another program" in run("net", "boot", "cell.toml", *DEMO).err
    outcome = run("net", "boot", "cell.toml", "--yes", "--json", *DEMO)
    assert outcome.status == ExitCode.OK, outcome.err
    assert (memory.program, memory.previous) == (image, None)
    assert run("net", "boot", "cell.toml", "--yes", *DEMO, *TRACE).status == ExitCode.OK
    assert sent().downloads == []


# ---- watch ----


def test_watch_boots_a_node_that_comes_back(run: Run, rung: Alarm) -> None:
    async def reset(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(3, lambda drive, now: drive.execute(NmtCommand.RESET_NODE, now))

    rung.task = reset
    rung.set((4, signal.SIGINT))
    outcome = run("net", "watch", cell(), "--yes", *DEMO, *TRACE)
    assert outcome.status == ExitCode.OK
    lines = [line.strip().split("  ", 1)[1] for line in outcome.out.splitlines()]
    assert sum(line.startswith("left: node 3: booted") for line in lines) == 2
    assert sent().nmt.count("0103") == 2
    assert sent().nmt.count("0104") == 1
    assert "the nodes are left as they are, and nobody watches them now" in outcome.err


def test_watch_tells_in_json_lines_who_is_lost(run: Run, rung: Alarm) -> None:
    async def silence(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(4, lambda drive, now: drive.set_value(0x1017, 0, 0, now))

    rung.task = silence
    rung.set((4, signal.SIGINT))
    outcome = run("net", "watch", cell(), "--yes", "--json", *DEMO)
    fit_their_schema("net watch", outcome.out)
    assert '"event": "lost", "node": 4, "reaction": "the master has sent it a reset"' in outcome.out


@pytest.mark.parametrize("answers", [False, True])
def test_watch_watches_the_heartbeats_that_nodes_send_of_their_own_and_names_the_others(
    run: Run, rung: Alarm, answers: bool
) -> None:
    """answers: the node has only ended its heartbeats, and answers SDO. Else it is silent, until it is reset."""

    async def silence(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(4, lambda drive, now: drive.set_value(0x1017, 0, 0, now))
        if not answers:
            simulation.change(4, lambda drive, now: drive.execute(NmtCommand.STOP, now))

    rung.task = silence
    rung.set((4, signal.SIGINT))
    text = CELL.replace(', heartbeat = "100ms"', "").replace("mandatory = false", 'mandatory = false, heartbeat = "0ms"')
    Path("cell.toml").write_text(text)
    outcome = run("net", "watch", "cell.toml", "--yes", *DEMO)
    assert (
        "right: node 4 has shown no sign of life in time, and is lost; the master has sent it a reset" in outcome.out
    ) is not answers
    assert ("right: it answers, but sends no heartbeats: it is not supervised now" in outcome.out) is answers
    assert "not supervised: lamp. No heartbeat and no guarding: a loss is not noticed" in " ".join(outcome.err.split())
    assert ("running: left, right\n" in outcome.err) is not answers
    unknown = "right, lamp" if answers else "lamp"
    told = f"was started, and is not supervised, so whether it still runs is not known: {unknown}"
    assert told in " ".join(outcome.err.split())
    rung.set((1, signal.SIGINT))
    rung.task = None
    outcome = run("net", "watch", "cell.toml", "--yes", "--json", *DEMO)
    fit_their_schema("net watch", outcome.out)
    assert '{"event": "unsupervised", "bus": "can0", "nodes": [9]}' in outcome.out


@pytest.mark.parametrize("returns", [True, False])
def test_watch_tells_of_the_bus_and_not_of_its_nodes_while_it_is_away(
    run: Run, rung: Alarm, monkeypatch: pytest.MonkeyPatch, returns: bool
) -> None:
    boots: list[NetworkBoot] = []

    def kept(*arguments: Any) -> NetworkBoot:
        boots.append(network_boot(*arguments))
        return boots[-1]

    async def unplug(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        boots[-1].network.outage = "can0 is down: unplugged"
        for node_id in (3, 4):
            simulation.change(node_id, lambda drive, now: drive.set_value(0x1017, 0, 0, now))
        await trio.sleep(2)
        if returns:
            for node_id in (3, 4):
                simulation.change(node_id, lambda drive, now: drive.set_value(0x1017, 0, 100, now))
            boots[-1].network.outage = ""

    monkeypatch.setattr(net_boot, "network_boot", kept)
    rung.task = unplug
    rung.set((6, signal.SIGINT))
    outcome = run("net", "watch", cell(), "--yes", *DEMO, *TRACE)
    told = [line.strip().split("  ", 1)[1] for line in outcome.out.splitlines() if "booted" not in line and "ready" not in line]
    assert told == ["can0 is down: unplugged. No node is taken for lost meanwhile"] + returns * [
        "can0: the bus is back; each node has its full time again"
    ]
    assert len(sent().nmt) == 4  # the reset of all, and three starts
    assert ("what its nodes do is not known" in outcome.err) is not returns


def test_watch_that_is_interrupted_says_what_is_half_done(run: Run, rung: Alarm) -> None:
    rung.set((0.06, signal.SIGINT))
    outcome = run("net", "watch", cell(), "--yes", *DEMO)
    assert "not finished: reset, perhaps configured, or its program written, in part; not started" in outcome.err


def test_a_node_that_is_lost_while_others_boot_does_not_count_as_running(
    run: Run, rung: Alarm, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def silence(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(3, lambda drive, now: drive.set_value(0x1017, 0, 0, now))

    rung.task = silence
    without(monkeypatch, 4)
    outcome = run("net", "boot", cell(), "--yes", *DEMO)
    assert "was ready, and is lost or has booted again" in next(line for line in outcome.out.splitlines() if "left" in line)


def test_watch_of_two_buses_tells_at_its_end_that_one_was_stopped(run: Run, rung: Alarm) -> None:
    async def silence(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(3, lambda drive, now: drive.set_value(0x1017, 0, 0, now))

    rung.task = silence
    rung.set((4, signal.SIGINT))
    nodes = CELL.replace("id = 3", "bus = 'can1', id = 3").replace("id = 4", "bus = 'can0', id = 4")
    nodes = nodes.replace("id = 9", "bus = 'can0', id = 9")
    Path("two.toml").write_text(f"[buses.can1]\n[network]\nmandatory_lost = 'stop all'\n{nodes}")
    outcome = run("net", "watch", "two.toml", "--yes", *DEMO)
    assert (outcome.status, "node 3 is mandatory and was lost" in outcome.err) == (ExitCode.NO_ANSWER, True), outcome.err
    assert "all nodes of its bus were stopped: 2 of 3 nodes run, 1 lost or booted again" in outcome.err
    assert "running: right on can0, lamp on can0" in outcome.err


def test_watch_calls_stopped_what_was_stopped(run: Run, rung: Alarm) -> None:
    """Not "not finished: perhaps configured"."""

    async def silence(simulation: SimulatedDevices) -> None:
        await trio.sleep(2)
        simulation.change(3, lambda drive, now: drive.set_value(0x1017, 0, 0, now))

    rung.task = silence
    Path(cell()).write_text(f"{CELL}[network]\nmandatory_lost = 'stop all'\n")
    outcome = run("net", "watch", "cell.toml", "--yes", *DEMO)
    assert "was stopped, since a mandatory node of its bus was lost: right, lamp" in outcome.err
    assert "no node runs, 1 lost or booted again, 2 stopped" in outcome.err
    assert "not finished" not in outcome.err


def test_watch_ends_with_its_reader(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(*arguments: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(Screen, "data", closed)
    assert run("net", "watch", cell(), "--yes", *DEMO).status == CLOSED_PIPE


# ---- init ----


def test_init_writes_what_a_scan_finds(run: Run) -> None:
    outcome = run("net", "init", "-o", "new.toml", "--serials", *DEMO)
    assert outcome.status == ExitCode.OK
    machine = read_machine("new.toml")
    assert [node.node_id for node in machine.nodes.values()] == [3, 4, 5, 6, 7, 8]
    assert machine.nodes["node4"].boot == BootSettings(
        mandatory=True, device_type=0x20192, vendor=0x332, product=0x43, serial=2, heartbeat=500 * MILLISECOND
    )
    assert "vendor = 0x00000332\n" in Path("new.toml").read_text()
    assert run("net", "check", "new.toml", *DEMO).status == ExitCode.OK
    assert "CO135" in run("net", "init", "-o", "new.toml", *DEMO).err


def test_init_takes_the_file_with_the_identity(run: Run) -> None:
    Path("eds").mkdir()
    description = load_description("sample_io.eds")
    identity: dict[Mux, Value] = {mux(0x1000): 0x20192, mux(0x1018, 1): 0x332, mux(0x1018, 2): 0x43}
    Path("eds/own.dcf").write_text(write_eds(with_configured(description, identity, Commissioning(4))))
    Path("eds/other.eds").write_text(write_eds(description))
    Path("eds/broken.eds").write_text("nothing")
    outcome = run("net", "init", "-o", "new.toml", "--files", "eds", "--ids", "3", "-e", "3=sample_drive.eds", *DEMO, "--json")
    assert outcome.json["nodes"] == [{"node": 3, "name": "node3", "file": "sample_drive.eds", "heartbeat_ms": 500}]
    run("net", "init", "-o", "new.toml", "--files", "eds", "--ids", "4", *DEMO, "--force")
    node = read_machine("new.toml").nodes["node4"]
    assert (node.device.file, node.boot) == ("eds/own.dcf", BootSettings(mandatory=True, heartbeat=500 * MILLISECOND))


def a_file(name: str, device_type: int = 0x20192, **numbers: int) -> None:
    """Write the file of a device with these numbers in 0x1018, by their names in `SUBS`."""
    own: dict[Mux, Value] = {mux(0x1000): device_type, **{mux(0x1018, SUBS[key]): value for key, value in numbers.items()}}
    Path("eds").mkdir(exist_ok=True)
    bare = load_description("sample_io.eds")
    info = replace(bare.device_info, vendor_number=None, product_number=None, revision_number=None)
    Path("eds", name).write_text(write_eds(with_configured(replace(bare, device_info=info), own, Commissioning(3))))


SUBS = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}


@pytest.mark.thorough(6)
@pytest.mark.parametrize("vendor", [0, 0x332, 0x29C])
@pytest.mark.parametrize("product", [0, 0x43, 0x44])
@pytest.mark.parametrize("device_type", [0x20192, 0x191])
def test_init_takes_a_file_only_if_info_calls_it_a_match(run: Run, vendor: int, product: int, device_type: int) -> None:
    """The nodes of the demo: vendor-ID 0x332, product code 0x43. A vendor-ID of 0 in a file is unknown, and no evidence."""
    a_file("its.dcf", device_type, vendor=vendor, product=product, serial=0)
    outcome = run("net", "init", "-o", "new.toml", "--files", "eds", "--ids", "3", *DEMO, "--force", "--json")
    ((file,),) = ([each["file"] for each in outcome.json["nodes"]],)
    said = run("info", "3", "-e", "3=eds/its.dcf", *DEMO, "--json").json["file"]
    assert file in (None, "eds/its.dcf")
    assert (file is not None) == (said["matches"] is True and (vendor, product) == (0x332, 0x43))
    if file is None and said["matches"] and product:
        assert "is not taken by its product code alone: the file gives no vendor-ID" in outcome.err
        assert "-e 3=eds/its.dcf" in outcome.err


def test_a_file_of_another_device_type_is_named_with_the_words_of_info(run: Run) -> None:
    a_file("its.dcf", 0x191, vendor=0x332, product=0x43)
    told = run("net", "init", "-o", "new.toml", "--files", "eds", "--ids", "3", *DEMO).err
    words = "ANOTHER DEVICE by device type 0x00020192 (file: 0x00000191)"
    assert words in told
    assert words in run("info", "3", "-e", "3=eds/its.dcf", *DEMO).out


def test_files_without_an_identity_are_named_where_no_other_fits(run: Run) -> None:
    a_file("bare.dcf", vendor=0, product=0, revision=0, serial=0)
    a_file("other.dcf", 0x191)
    outcome = run("net", "init", "-o", "new.toml", "--files", "eds", "--ids", "3", *DEMO)
    assert "node 3: these have its device type, and no product code to go by: eds/bare.dcf. Try: -e 3=FILE" in outcome.err


# ---- mistakes ----


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("check",), "CO121", "no machine file was named"),
        (("check", "bus.yml"), "CO123", "canopen machine import bus.yml -o cell.toml"),
        (("boot", "bare.toml"), "CO322", "bare.toml has no node with boot"),
        (("check", "two.toml", "-b", "can9"), "CO121", "the nodes are on the buses can0, can1"),
        (("check", "two.toml", "-b", "can2"), "CO322", "no node on can2 has boot"),
    ],
)
def test_mistakes(run: Run, arguments: tuple[str, ...], code: str, text: str) -> None:
    Path("bare.toml").write_text("[buses.can0]\n[nodes.a]\nid = 5\n")
    nodes = "".join(f"[nodes.n{number}]\nid = 5\nbus = 'can{number}'\nboot = {{}}\n" for number in (0, 1))
    Path("two.toml").write_text(f"[buses.can0]\n[buses.can1]\n[buses.can2]\n{nodes}")
    outcome = run("net", *arguments)
    assert outcome.status == ExitCode.USAGE
    assert code in outcome.err
    assert text in outcome.err


def test_a_check_of_the_machine_file_reads_what_a_boot_needs(run: Run) -> None:
    cell("right = { id = 4 }", "right = { id = 4, boot = { configuration = 'cut.bin' } }")
    Path("cut.bin").write_bytes(b"1")
    outcome = run("machine", "check", "cell.toml")
    assert outcome.status == ExitCode.BAD_FILE
    assert "cell.toml: nodes.right.boot: cut.bin is no concise DCF" in outcome.err


def test_a_frame_of_a_dry_run_is_understood_by_the_dictionary_of_its_bus() -> None:
    """Both have a node 5, whose objects have other names on each."""
    named = {
        bus: ObjectDictionary([Object.of(name, [Variable(0x2000, 0, name, DataType.UNSIGNED8)])])
        for bus, name in (("can0", "Filter time"), ("can1", "Smoothing"))
    }
    write = Frame(0x605, bytes.fromhex("2F00200007000000"))
    records = [Record(0, bus, write, sent=True) for bus in named]
    rows, _ = frames_of(records, lambda bus, node_id: named[bus] if node_id == 5 else None)
    assert [(row.bus, row.text) for row in rows] == [
        ("can0", "write 2000:00 Filter time = 7"),
        ("can1", "write 2000:00 Smoothing = 7"),
    ]


def test_a_dry_run_on_two_buses_names_the_bus_of_each_frame(run: Run) -> None:
    nodes = "a = { id = 5, bus = 'can0' }\nb = { id = 5, bus = 'can1' }\n"
    defaults = "[defaults.nodes]\nboot = { heartbeat = '100ms' }\n"
    Path("two.toml").write_text(f"[buses.can0]\n[buses.can1]\n{defaults}[nodes]\n{nodes}")
    frames = run("net", "boot", "two.toml", "--dry-run", "--json", *DEMO).json
    beats = [each["bus"] for each in frames if each["frame"].startswith("605#2B171000")]
    assert sorted(beats) == ["can0", "can1"]
    lines = run("net", "boot", "two.toml", "--dry-run", *DEMO).out.splitlines()
    assert lines[0].split() == ["ms", "bus", "frame", "meaning"]
    assert {line.split()[1] for line in lines[2:]} == {"can0", "can1"}
    Path("one.toml").write_text(f"[buses.can0]\n{defaults}[nodes]\na = {{ id = 5 }}\n")
    assert "bus" not in run("net", "boot", "one.toml", "--dry-run", *DEMO).out.splitlines()[0]


def test_two_buses_are_booted_at_once(run: Run) -> None:
    nodes = "a = { id = 5, bus = 'can0' }\nb = { id = 5, bus = 'can1' }\n"
    Path("two.toml").write_text(f"[buses.can0]\n[buses.can1]\n[defaults.nodes]\nboot = {{}}\n[nodes]\n{nodes}")
    outcome = run("net", "boot", "two.toml", "--yes", *DEMO)
    assert outcome.status == ExitCode.OK, outcome.err
    assert "can0     5  a" in outcome.out
    assert "can1     5  b" in outcome.out
    assert [each["bus"] for each in run("net", "check", "two.toml", *DEMO, "--json").json] == ["can0", "can1"]
