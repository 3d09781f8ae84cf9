"""A program commissions a drive: the steps in their order, and what they leave in the drive and in the machine file."""

from __future__ import annotations

import pytest

from canopen_master.commissioning import DriveCommissioning, commissioned_machine, commissioned_name
from canopen_master.errors import NodeIsNoDriveError
from canopen_master.machine_file import machine_text, parse_machine
from canopen_master.session import open_master
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.plant import DeviceEntry
from canopen_master.simulation.serving import SimulatedDevices, drive_maker, simulated_devices
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.simulation.drive.settings import Shape
from tests.master.world import BUS, virtual_time


def makers_of(shape: Shape = Shape.STANDARD) -> dict[str, list[object]]:
    return {BUS: [drive_maker(0, 3, shape)]}


def has_no_power(simulation: SimulatedDevices) -> bool:
    return simulation.drives[3].drive.state not in (State.OPERATION_ENABLED, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE)


@virtual_time
async def test_from_the_box_to_the_first_move() -> None:
    async with simulated_devices(makers_of()) as simulation, open_master(BUS) as master:  # type: ignore[arg-type]
        own = simulation.drives[3].values[objects.PROFILE_VELOCITY]
        work = DriveCommissioning(master, master.node(3))
        await work.look()
        await work.read_units()
        work.set_unit(Unit.DEGREE, 1000)
        limits, position = await work.read_limits()
        assert position == pytest.approx(-14, abs=0.1)
        assert limits.speed.value > 0
        work.set_limits(-90, 90, 20)
        before, after = await work.small_move(5)
        assert after - before == pytest.approx(5, abs=0.1)
        assert has_no_power(simulation)
        work.set_homing_method(35)
        assert await work.home() == pytest.approx(0, abs=0.1)
        assert await work.move_to(3, 100) == pytest.approx(3, abs=0.1)
        assert has_no_power(simulation)
        assert simulation.drives[3].values[objects.PROFILE_VELOCITY] == own, "its own is written back"
    assert (work.has_moved, work.is_homed) == (True, True)
    assert [each.partition(":")[0] for each in work.done[2:]] == ["the small move", "homing", "the first move"]
    machine = parse_machine(machine_text(commissioned_machine(None, BUS, 3, "elbow", work.settings, master_id=2)))
    settings = machine.joints["elbow"].settings
    assert (settings.unit, settings.counts_per_unit, settings.homing_method) == (Unit.DEGREE, 1000, 35)
    assert (settings.min_position, settings.max_position, settings.max_speed) == (-90, 90, 20)
    assert machine.master.watchdog is not None
    assert machine.master.watchdog.node_id == 2


@virtual_time
async def test_a_move_before_the_limits_are_set_is_refused() -> None:
    async with simulated_devices(makers_of()) as simulation, open_master(BUS) as master:  # type: ignore[arg-type]
        work = DriveCommissioning(master, master.node(3))
        await work.look()
        with pytest.raises(LocalProtocolError, match="set_limits"):
            await work.small_move(5)
        assert has_no_power(simulation)
        assert not work.has_moved


@virtual_time
async def test_a_node_that_is_no_drive() -> None:
    devices = {BUS: models_of([DeviceEntry("sample_io.eds", (3,))])}
    async with simulated_devices(devices), open_master(BUS) as master:
        with pytest.raises(NodeIsNoDriveError) as caught:
            await DriveCommissioning(master, master.node(3)).look()
    assert str(caught.value).startswith("CO408: node 3 (0x03) is no drive by CiA 402: it has no statusword (0x6041)")


def test_a_machine_with_the_joint_keeps_its_names() -> None:
    machine = parse_machine(
        """
        [buses]
        main = { locator = "virtual:a" }
        [nodes.n3]
        bus = "main"
        id = 3
        [joints.wrist]
        node = "n3"
        """
    )
    settings = machine.joints["wrist"].settings
    made = commissioned_machine(machine, "main", 3, "other", settings, file="drive.eds")
    assert list(made.joints) == ["wrist"]
    assert commissioned_name(machine, "main", 3, "other") == "wrist"
    assert commissioned_name(None, "main", 3, "other") == "other"
    assert made.nodes["n3"].device.file == "drive.eds"
    added = commissioned_machine(machine, "main", 4, "elbow", settings)
    assert list(added.joints) == ["wrist", "elbow"]
    assert added.nodes["elbow"].node_id == 4


def test_a_name_of_another_drive_or_node_leaves_that_one_alone() -> None:
    machine = parse_machine(
        """
        [buses.can0]
        [buses.can1]
        [nodes]
        drive3 = { id = 3, bus = "can0" }
        lamp = { id = 9, bus = "can0" }
        [joints]
        drive3 = { node = "drive3", counts_per_unit = 10 }
        [chains.arm]
        joints = ["drive3"]
        """
    )
    settings = AxisSettings(counts_per_unit=1000.0)
    for name, bus, node_id in (("drive3", "can1", 3), ("lamp", "can0", 4)):
        made = commissioned_machine(machine, bus, node_id, name, settings)
        free = commissioned_name(machine, bus, node_id, name)
        assert free == f"{name}-2"
        assert made.joints[free].settings == settings
        assert {each: made.nodes[each] for each in machine.nodes} == machine.nodes
        assert {each: made.joints[each] for each in machine.joints} == machine.joints
        node = made.node_at(bus, node_id)
        assert node is not None
        joint = made.joint_on(node)
        assert joint is not None
        assert joint.settings == settings
        assert parse_machine(machine_text(made)).chains == machine.chains
