"""A master of a machine file: buses, nodes, joints and chains are there by their names; positions are in the joints' units."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from canopen_data.configured import configure
from canopen_data.descriptions import load_description
from canopen_data.findings import DictionaryError
from canopen_master import DeviceModel, open_master
from canopen_master.direct import Session
from canopen_master.errors import ChainError, PathRefusedError, PlanRefusedError, SetPointRefusedError
from canopen_master.machine_file import machine_of_chains, machine_text, parse_machine
from canopen_master.motion.chain_file import parse_chains
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.drives.trajectory import cubic
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.consumer import PdoReceived
from tests.master.direct_world import PATIENT, devices, near_home
from tests.master.world import drives, position_of, simulated, virtual_time

CELL = """
[master]
cycle = "20ms"
timeout = "700ms"
heartbeat_timeout = "2s"
watchdog.node_id = 126

[buses.left]
locator = "virtual:left"

[buses.right]
locator = "virtual:right"

[defaults.joints]
unit = "degree"
max_speed = 40

[nodes.shoulder]
bus = "left"
id = 3

[nodes.wrist_drive]
bus = "right"
id = 3

[nodes.io]
bus = "right"
id = 9
file = "sample_io.eds"
overlay = "units.toml"

[joints.shoulder]

[joints.wrist]
node = "wrist_drive"
direction = -1
max_position = 30

[chains.arm]
joints = ["shoulder", "wrist"]
"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    (tmp_path / "units.toml").write_text("[objects.1017]\naliases = ['beat']\n")
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return path


@virtual_time
async def test_two_arms_on_two_buses_move_in_degrees(cell: Path) -> None:
    left_side, right_side = simulated(3, bus="virtual:left"), simulated(3, bus="virtual:right")
    async with left_side as left, right_side as right, open_master(machine=cell) as master:
        arm = master.chains["arm"]
        assert [device.node.bus for device in arm.devices] == ["left", "right"]
        assert [*arm.joints] == ["shoulder", "wrist"]
        assert master.joints["wrist"].node is master.nodes["wrist_drive"]
        assert master.joints["wrist"].where == "wrist (node 3 on right)"
        assert arm.settings.cycle_time == 0.02
        await arm.initialise()
        await arm.home()
        await arm.enable_interpolated_position()
        start = arm.positions
        async for cycle in arm.cycles():
            arm.set_positions([start[0] + 10 * min(1, cycle.time), start[1] + 5 * min(1, cycle.time)])
            if cycle.time >= 1.1:
                break
        assert arm.positions == pytest.approx([start[0] + 10, start[1] + 5], abs=0.01)
        with pytest.raises(SetPointRefusedError, match=r"wrist was refused\n.*more than 40: the settings") as fast:
            arm.set_positions([start[0] + 10, start[1] + 10])
        assert f"if it may go as fast as that: joints.wrist.max_speed in {cell}" in str(fast.value)
        moved = [position_of(host, drives(host)[0]) for host in (left, right)]
        assert moved == pytest.approx([1000 * (start[0] + 10), -1000 * (start[1] + 5)], abs=10)
        await arm.shut_down()


@virtual_time
async def test_what_a_limit_refuses_names_its_key_in_the_file_and_no_longer_path_for_a_position(cell: Path) -> None:
    left_side, right_side = simulated(3, bus="virtual:left"), simulated(3, bus="virtual:right")
    async with left_side, right_side, open_master(machine=cell) as master:
        arm = master.chains["arm"]
        await arm.initialise()
        await arm.home()
        await arm.follow()
        (here, there), up = arm.desired_positions, 30.0
        for path, kind, words in (
            (cubic([0, 20], [[here, there], [here, 31.0]]), "position", f"go there: joints.wrist.max_position in {cell}"),
            (cubic([0, 1], [[here, there], [here, up]]), "acceleration", f"do more: joints.wrist.max_acceleration in {cell}"),
        ):
            with pytest.raises(PathRefusedError) as refused:
                await arm.follow(path)
            assert refused.value.kind == kind
            assert words in str(refused.value)
            assert ("takes longer" in str(refused.value)) == (kind == "acceleration")
        with pytest.raises(PlanRefusedError, match=r"position 31, its highest is 30: the settings \(max_position\)"):
            await arm.move([here, 31.0])


@virtual_time
async def test_settings_of_the_file_and_what_goes_before_them(cell: Path) -> None:
    async with open_master(machine=str(cell)) as master:
        node = master.nodes["io"]
        assert node.remote.sdo.timeout == 700_000_000
        assert node.remote.heartbeat.timeout == 2_000_000_000
        assert node.dictionary.variable("beat").index == 0x1017
        assert master.watchdogs.settings == Watchdog(node_id=126)
        assert master.joints["shoulder"].axis.settings.unit is Unit.DEGREE
        assert (str(node.name), node.node_id) == ("io", 9)
    machine = parse_machine(CELL.replace('file = "sample_io.eds"\noverlay = "units.toml"', ""))
    buses = {"right": "virtual:other"}
    watchdog = Watchdog(node_id=5)
    async with open_master(machine=machine, buses=buses, sdo_timeout=1, heartbeat_timeout=0, watchdog=watchdog) as master:
        assert master.buses["right"].transport.locator == "virtual:other"  # type: ignore[attr-defined]
        assert master.nodes["io"].remote.sdo.timeout == 1_000_000_000
        assert master.nodes["io"].remote.heartbeat.timeout == 0
        assert master.watchdogs.settings == Watchdog(node_id=5)
        with pytest.raises(LocalProtocolError, match="has a chain 'arm' already"):
            master.load_chains(text="arm shoulder left 3")
    with pytest.raises(LocalProtocolError, match=r"has no bus 'rihgt'; did you mean right\?"):
        open_master(machine=machine, buses={"rihgt": "virtual"})


def test_a_faulty_file_is_an_error_before_anything_is_opened(cell: Path) -> None:
    cell.write_text(CELL + "joint = 5\n")
    with pytest.raises(
        DictionaryError, match=r"cell.toml:41:1: error: chains.arm: there is no entry 'joint'; did you mean joints\?"
    ):
        open_master(machine=cell)


@virtual_time
async def test_pdos_of_a_device_that_is_no_joint_come_by_themselves(cell: Path) -> None:
    device = DeviceModel(configure(load_description("sample_io.eds").dictionary, {mux(0x1017): 100}, 9), 9)
    async with simulated(bus="virtual:right", makers=[device]), open_master(machine=cell) as master:
        io = master.nodes["io"]
        await io.start()
        with io.events(PdoReceived) as pdos:
            async for pdo in pdos:
                assert pdo.node_id == 9
                break


@virtual_time
async def test_a_machine_of_a_chain_file_moves_as_the_chain_file_does() -> None:
    machine = parse_machine(machine_text(machine_of_chains(parse_chains("arm j1 virtual:test 3 j2 virtual:test 4"))))
    async with simulated(3, 4), open_master(machine=machine) as master:
        arm = master.chains["arm"]
        await arm.initialise()
        await arm.enable_interpolated_position()
        assert all(device.axis.settings.counts_per_unit == pytest.approx(57_295.78, rel=1e-6) for device in arm.devices)


@virtual_time
async def test_a_joint_whose_drive_does_not_tell_its_scale_is_not_initialised(cell: Path) -> None:
    cell.write_text(CELL.replace("direction = -1", 'unit = "millimetre"'))
    async with simulated(3, bus="virtual:left"), simulated(3, bus="virtual:right"), open_master(machine=cell) as master:
        with pytest.raises(ChainError, match=r"wrist .*does not tell how many counts a millimetre has"):
            await master.chains["arm"].initialise()


def patient_cell() -> str:
    """CELL without its device, for real time: late answers and a late master are waited for."""
    text = CELL.replace('file = "sample_io.eds"\noverlay = "units.toml"', "").replace("700ms", f"{PATIENT:g}s")
    return text.replace("watchdog.node_id = 126", 'watchdog = { node_id = 126, timeout = "60s" }')


def test_blocking_calls_take_names_and_units() -> None:
    with contextlib.ExitStack() as stack:
        left = stack.enter_context(devices(makers=near_home(3)))
        right = stack.enter_context(devices(makers=near_home(3)))
        text = CELL.replace('file = "sample_io.eds"\noverlay = "units.toml"', "").replace(
            "700ms", f'{PATIENT:g}s"\nwatchdog.timeout = "60s'
        )
        text = text.replace("virtual:left", left.bus).replace("virtual:right", right.bus)
        session = stack.enter_context(Session())
        assert session.open_connection(machine=parse_machine(text)), session.last_error()
        assert session.init_device("wrist"), session.last_error()
        assert session.homing("wrist"), session.last_error()
        assert session.get_pos("wrist") == pytest.approx(-right.node(3).values.store[mux(0x6064)] / 1000)  # type: ignore[operator]
        assert session.send_sdo("wrist_drive", "statusword").node_id == 3
        assert left.node(3).drive.state is not right.node(3).drive.state
        assert session.enable_ip_mode("wrist"), session.last_error()
        position = session.get_pos("wrist")
        session.send_pos("wrist", position + 0.25)
        with pytest.raises(SetPointRefusedError, match=r"more than 40: the settings"):
            session.send_pos("wrist", 31)
        with pytest.raises(LocalProtocolError, match=r"has no joint or node 'rist'; did you mean wrist"):
            session.init_device("rist")
        with pytest.raises(LocalProtocolError, match="says the cycle"):
            session.using_master_thread = True
            session.init_master_thread(10)
        assert session.shutdown_device("wrist"), session.last_error()


def test_blocking_chains_of_a_machine_are_in_units() -> None:
    with contextlib.ExitStack() as stack:
        left = stack.enter_context(devices(makers=near_home(3)))
        right = stack.enter_context(devices(makers=near_home(3)))
        text = CELL.replace('file = "sample_io.eds"\noverlay = "units.toml"', "").replace(
            "700ms", f'{PATIENT:g}s"\nwatchdog.timeout = "60s'
        )
        text = text.replace("virtual:left", left.bus).replace("virtual:right", right.bus).replace("20ms", "100ms")
        session = stack.enter_context(Session())
        assert session.open_connection(machine=parse_machine(text.replace("heartbeat_timeout", "#"))), session.last_error()
        session.using_master_thread = True
        session.init_master_thread()
        arm = session.chain_map["arm"]
        assert arm.joints == ("shoulder", "wrist")
        assert arm.init(), session.last_error()
        shown = [node.node(3).values.store[mux(0x6064)] / 1000 for node in (left, right)]  # type: ignore[operator]
        assert arm.get_current_pos() == pytest.approx([shown[0], -shown[1]], abs=0.01)
        assert arm.shut_down(), session.last_error()


def test_a_connection_needs_a_bus_or_a_machine() -> None:
    with Session() as session, pytest.raises(LocalProtocolError, match="needs a bus"):
        session.open_connection()
    assert Watchdog() == DEFAULT_WATCHDOG
