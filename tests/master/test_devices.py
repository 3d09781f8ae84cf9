"""What a master knows of its drives: one device for each, whose settings nothing changes behind the user's back."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_master import SCHUNK_POWERBALL, AxisSettings, ChainError, ChainSettings, HomingStyle, open_master, standard_drives
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from tests.master.world import BUS, arm_of, chain_text, simulated, virtual_time

GIVEN = AxisSettings(counts_per_unit=1000, direction=-1, homing=HomingStyle.STANDARD)


@virtual_time
async def test_a_device_asked_for_again_is_the_same_and_unchanged() -> None:
    async with open_master(BUS) as master:
        node = master.node(12)
        device = master.device(node, settings=GIVEN)
        assert master.device(node) is device
        assert master.device(node, settings=replace(GIVEN)) is device
        (joint,) = master.load_chains(text=chain_text(12))["arm"].devices
        assert joint is device
        assert device.axis.settings == GIVEN


@pytest.mark.parametrize("other", [AxisSettings(), replace(GIVEN, direction=1), SCHUNK_POWERBALL])
@virtual_time
async def test_other_settings_for_a_known_drive_are_an_error(other: AxisSettings) -> None:
    async with open_master(BUS) as master:
        node = master.node(12)
        device = master.device(node, settings=GIVEN)
        with pytest.raises(LocalProtocolError, match=r"drive 12 is in use with other settings: .*direction -1, not 1"):
            master.device(node, settings=other)
        with pytest.raises(LocalProtocolError, match="other settings"):
            master.load_chains(text=chain_text(12), axes=other)
        assert device.axis.settings == GIVEN


@virtual_time
async def test_the_way_out_changes_no_settings() -> None:
    async with simulated(makers=standard_drives(12)):
        async with open_master(BUS) as master:
            device = master.device(master.node(12), settings=GIVEN)
            for word in (6, 7, 15):
                await device.node.write("controlword", word)
        assert device.axis.settings == GIVEN


@virtual_time
async def test_a_chain_finds_out_what_its_joints_are() -> None:
    async with simulated(3, makers=standard_drives(4)), open_master(BUS) as master:
        arm = arm_of(master, 3, 4, own_pdos=True)
        await arm.initialise()
        assert [joint.axis.settings for joint in arm.devices] == [SCHUNK_POWERBALL, AxisSettings(homing=HomingStyle.STANDARD)]
        text = chain_text(3).replace("arm", "again")
        again = master.load_chains(text=text, axes=SCHUNK_POWERBALL, settings=ChainSettings())["again"]
        assert again.devices[0] is arm.devices[0]


@virtual_time
async def test_a_joint_never_heard_has_no_position_and_no_state() -> None:
    async with simulated(3, 4), open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        joint = arm.devices[0]
        assert (joint.position, joint.velocity, joint.torque, joint.mode, joint.state) == (None, None, None, None, State.UNKNOWN)
        for ask in (lambda: arm.positions, lambda: arm.velocities):
            with pytest.raises(ChainError, match=r"joint1 was not heard") as caught:
                ask()
            assert caught.value.code == "CO404"
        await arm.initialise()
        assert len(arm.positions) == 2
