"""The load of a bus in the diagnostics, against what the simulated bus itself counts bit by bit."""

from __future__ import annotations

import trio

from canopen_master import open_master
from canopen_proto.machine import SECOND
from canopen_ros.diagnostics import Loads
from canopen_transports import WireTransport
from tests.master.world import simulated, virtual_time
from tests.ros.ros_world import ready_arm


@virtual_time
async def test_the_load_is_that_of_the_bus() -> None:
    bus = "virtual:loaded?bitrate=500k"
    async with simulated(bus=bus) as host, open_master(buses={"can0": bus}) as master:
        transport = master.bus().transport
        assert isinstance(transport, WireTransport)
        loads = Loads()
        assert loads.of(master.bus(), master.now()) == "not known yet"
        master.sync_start(0.002)
        transport.bus.wire.begin_load(host.now())
        await trio.sleep(0.9)
        assert loads.of(master.bus(), master.now()) == "not known yet", "a second is the least"
        await trio.sleep(2.1)
        counted = transport.bus.load()
        told = loads.of(master.bus(), master.now())
        assert 0.02 < counted < 0.9
        assert abs(float(told.removesuffix(" %")) / 100 - counted) < 0.1 * counted + 0.005
        master.sync_stop()
        await trio.sleep(0.5)
        assert loads.of(master.bus(), master.now()) == told, "not more often than each second"
        await trio.sleep(1.5)
        assert loads.of(master.bus(), master.now()) != told


@virtual_time
async def test_what_is_not_known_is_said() -> None:
    async with ready_arm() as (bridge, _):
        (found,) = [each for each in bridge.diagnostics() if each.name == "bus: can0"]
        assert found.values["load"] == "unknown: nobody tells the bit rate"
        bus = bridge.master.bus()
        bus.bitrate, bus.network.hears_all = 1_000_000, False
        loads = Loads()
        loads.of(bus, 0)
        bus.network.bits += 250_000
        assert loads.of(bus, SECOND) == "at least 25 %"
