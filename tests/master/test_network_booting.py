"""`boot_network` on an open master."""

from __future__ import annotations

import pytest

from canopen_master import open_master, powerballs, simulate
from canopen_master.errors import ChainError
from canopen_master.machine_file import parse_machine
from canopen_master.motion.chain import ChainState
from canopen_master.network_booting import boot_network
from canopen_transports import open_transport
from tests.master.loops import loop
from tests.master.world import virtual_time

MACHINE = parse_machine("""
[buses.can0]
locator = "virtual:booting"

[nodes]
shoulder = { id = 3, boot = { mandatory = true, heartbeat = "200ms" } }

[joints]
shoulder = { node = "shoulder" }

[chains.arm]
joints = ["shoulder"]
""")


@virtual_time
async def test_the_drives_of_a_chain_in_use_are_not_reset() -> None:
    async with loop.open_nursery() as nursery:
        await nursery.start(simulate, await open_transport("virtual:booting"), powerballs(3))
        async with open_master(machine=MACHINE) as master:
            (arm,) = master.chains.values()
            assert (await boot_network(master, MACHINE))["can0"].is_started
            await arm.initialise()
            boots = arm.devices[0].node.remote.boots
            with pytest.raises(ChainError, match=r"chain arm cannot be booted now\n.*it is ready"):
                await boot_network(master, MACHINE)
            assert (arm.state, arm.devices[0].node.remote.boots) == (ChainState.READY, boots)
            await arm.shut_down()
            assert (await boot_network(master, MACHINE))["can0"].is_started
        nursery.cancel_scope.cancel()
