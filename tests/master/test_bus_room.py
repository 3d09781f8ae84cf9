"""A chain looks whether its PDOs fit on the bus before it sets anything up; see canopen_master.motion.bus_room."""

from __future__ import annotations

import logging
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from canopen_master import (
    AxisSettings,
    Chain,
    ChainError,
    ChainFaultError,
    ChainSettings,
    Host,
    Master,
    open_master,
    standard_drives,
)
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.nmt import NmtState
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from tests.loops import loop
from tests.master.path_world import AXIS, DRIVE, RAMPS, swing
from tests.master.world import drives, simulated, value, virtual_time

MBIT = 1_000_000
TPDOS = (0x1800_01, 0x1801_01, 0x1802_01, 0x1803_01)


@asynccontextmanager
async def standing(count: int, bitrate: int | None = MBIT) -> AsyncIterator[tuple[Host, Master]]:
    """So many drives with the usual four TPDOs each: two at each SYNC once one is remapped, two event-driven."""
    async with (
        simulated(bus="virtual:room", makers=standard_drives(*range(1, count + 1))) as host,
        open_master(buses={"can0": "virtual:room"}, dictionary=drive_dictionary()) as master,
    ):
        master.bus("can0").bitrate = bitrate  # as a machine file would tell it
        yield host, master


def chain_of(master: Master, name: str, first: int, last: int, cycle_time: float, axis: AxisSettings | None = None) -> Chain:
    text = f"{name} " + " ".join(f"{name}{node} can0 {node}" for node in range(first, last + 1))
    return master.load_chains(text=text, settings=ChainSettings(cycle_time=cycle_time, own_pdos=True), axes=axis)[name]


def switched_off(host: Host) -> list[list[bool]]:
    return [[bool(value(node, mux) & COB_ID_INVALID) for mux in TPDOS] for node in drives(host)]


@virtual_time
async def test_with_room_all_tpdos_stay() -> None:
    async with standing(2) as (host, master):
        await chain_of(master, "arm", 1, 2, 0.004).initialise()
        assert switched_off(host) == [[False] * 4] * 2


@pytest.mark.parametrize("is_known", [True, False])
def test_without_room_the_joints_send_only_what_is_needed(is_known: bool, caplog: pytest.LogCaptureFixture) -> None:
    """12 RPDOs of 6 bytes, 12 TPDOs of 7, 12 of 8 and SYNC: 12 x (115 + 125 + 135) + 55 bits with all stuff bits. Without a bit
    rate nobody knows that."""

    @virtual_time
    async def run() -> None:
        async with standing(12, MBIT if is_known else None) as (host, master):
            arm = chain_of(master, "arm", 1, 12, 0.004)
            with caplog.at_level(logging.WARNING):
                await arm.initialise()
            assert switched_off(host) == [[is_known, False, is_known, is_known]] * 12
            for device in arm.devices:
                assert device.plan is not None
                assert ("TPDO 4: is to be switched off" in device.plan.describe()) is is_known

    run()
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == is_known
    for message in said:
        assert "SYNC, 12 RPDOs and 24 TPDOs need up to 4.55 ms of a cycle of 4.00 ms on can0 at 1Mbit/s" in message
        assert "TPDO 1, TPDO 3, TPDO 4 of its joints are switched off" in message
        assert "2.94 ms remain" in message


@virtual_time
async def test_what_never_fits_is_refused_before_anything_is_set_up() -> None:
    async with standing(20) as (host, master):
        before = [dict(node.values.store) for node in drives(host)]
        with pytest.raises(ChainError) as refused:
            await chain_of(master, "arm", 1, 20, 0.004).initialise()
        assert refused.value.code == "CO404"
        assert "its PDOs do not fit on the bus" in str(refused.value)
        assert "20 RPDOs and 20 TPDOs need up to 4.86 ms of a cycle of 4.00 ms" in refused.value.seen
        assert "a cycle_time of 0.0052 s or more" in refused.value.tries
        assert [dict(node.values.store) for node in drives(host)] == before
        assert all(node.state is NmtState.PRE_OPERATIONAL for node in drives(host))
        await chain_of(master, "slower", 1, 20, 0.0052).initialise()  # the advice is good


@virtual_time
async def test_other_chains_on_the_bus_count() -> None:
    async with standing(20) as (_, master):
        first, second = (chain_of(master, name, *nodes, 0.004) for name, nodes in (("left", (1, 10)), ("right", (11, 20))))
        await first.initialise()
        with pytest.raises(ChainError, match="do not fit"):
            await second.initialise()
        await first.shut_down()
        await second.initialise()


@virtual_time
async def test_a_bus_with_physics_tells_its_bit_rate() -> None:
    for locator, bitrate in (("virtual:rated?bitrate=250k", 250_000), ("virtual:plain", None)):
        async with open_master(locator) as master:
            assert master.bus().bitrate == bitrate


@virtual_time
async def test_a_full_bus_is_the_cause_when_positions_come_late() -> None:
    """SYNC and the PDOs of two joints need 10.3 ms of 10 ms with all stuff bits, and nobody has looked. (The joints
    are not homed, either, which is no reason.)"""
    bus = "virtual:full?bitrate=78k"
    async with (
        simulated(bus=bus, makers=standard_drives(1, 2, settings=DRIVE)) as host,
        open_master(buses={"can0": bus}, dictionary=drive_dictionary()) as master,
    ):
        for node in drives(host):
            node.values.store.update(RAMPS)
        master.bus("can0").bitrate = None
        arm = chain_of(master, "arm", 1, 2, 0.01, AXIS)
        await arm.initialise()
        await arm.follow()
        with pytest.raises(ChainFaultError, match="off its path") as stopped:
            await arm.follow(swing(0.8, -0.8, duration=4.0))
        late = re.match(r"its positions come (\d+) ms late \((\d+) cycles of 10 ms", stopped.value.cause)
        assert late is not None
        assert int(late[1]) == 10 * int(late[2]) >= 50  # how many have gathered: by what was read before on that bus
        assert "`canopen plan`" in stopped.value.tries[0]
        master.sync_stop()  # then there is room for SDO, and the halt can be confirmed
        await loop.sleep(1)


@virtual_time
async def test_the_machine_file_tells_the_bit_rate(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text('[buses.can0]\nlocator = "virtual:rated"\nbitrate = "125k"\n', encoding="utf-8")
    async with open_master(machine=path) as master:
        assert master.bus("can0").bitrate == 125_000
