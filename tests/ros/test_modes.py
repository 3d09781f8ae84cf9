"""Mode services: those that a chain can have; any other one is refused with the reason."""

from __future__ import annotations

from canopen_ros.names import MODE_SERVICES, OTHER_MODES
from tests.master.world import virtual_time
from tests.ros.ros_world import bridge_of, cell

DRIVES = {"eds": "sample_drive.eds", "defaults": {"unit": "degree", "counts_per_turn": 36_000.0}}


@virtual_time
async def test_joints_without_files_have_ip() -> None:
    async with cell() as world:
        await world.ask("init")
        offered = set(world.arm.services)
        assert offered & {"IPmode", *MODE_SERVICES} == {"IPmode", "interpolated_position_mode"}
        for service in ("IPmode", "interpolated_position_mode"):
            await world.ask(service)
            assert world.arm.state == "following"
        refused = await world.arm.call("cyclic_position_mode")
        assert 'its mode is ip. Try: mode = "csp" in the machine file' in refused.message
        for service in OTHER_MODES:
            refused = await world.arm.call(service)
            assert not refused.success
            assert "a chain leads its joints by positions" in refused.message
        assert "has no service 'dance'" in (await world.arm.call("dance")).message


@virtual_time
async def test_joints_with_files_have_the_mode_that_their_drives_choose() -> None:
    async with bridge_of(1, **DRIVES) as (_, arm):
        assert set(MODE_SERVICES) <= set(arm.services)  # not known yet
        reply = await arm.call("init")
        assert reply.success, reply.message
        offered = [service for service in MODE_SERVICES if service in arm.services]
        assert len(offered) == 1
        assert (await arm.call(offered[0])).success
        assert arm.state == "following"
        for service in set(MODE_SERVICES) - set(offered):
            assert not (await arm.call(service)).success
