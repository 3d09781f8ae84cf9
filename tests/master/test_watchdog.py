"""The watchdog of a master: whatever it was doing when it died, its drives stand soon; nobody else keeps them alive."""

from __future__ import annotations

import logging
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from itertools import pairwise

import pytest

from canopen_master import (
    ChainError,
    ChainFaultError,
    HaltNotConfirmedError,
    Host,
    MasterError,
    NodeIdTakenError,
    NotHeld,
    Watchdog,
    open_master,
    powerballs,
    simulate,
    standard_drives,
)
from canopen_master.direct.drive import DirectDrive
from canopen_master.watchdog import LOGGER
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, NotHeldError
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import ForeignHeartbeat
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.simulation.drive.node import DriveNode
from canopen_transports import open_transport
from canopen_transports.loop import CancelScope
from tests.loops import loop
from tests.master.motions import FAR, MOTIONS, SPEED
from tests.master.world import BUS, Link, arm_of, drives, following_arm, simulated, value, virtual_time

NODE = 3
CONSUMERS, REACTION, ENTRY = mux(0x1016, 1), mux(0x6007), 127 << 16 | 500
QUICK_STOP_SECONDS = 30_000 / 400_000
"""From the fastest of the motions below to standstill, by the 0x6085 of the standard drive."""


@asynccontextmanager
async def one_drive() -> AsyncIterator[tuple[Host, DriveNode]]:
    async with simulated(makers=standard_drives(NODE, settings=FAR)) as host:
        yield host, drives(host)[0]


# ---- a master that dies ----


@pytest.mark.thorough(4)
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("sync_goes_on", [False, True])
@virtual_time
async def test_a_drive_whose_master_dies_stands_within_the_timeout_and_its_ramp(motion: str, sync_goes_on: bool) -> None:
    async with one_drive() as (host, node):
        cable = Link()

        async def live() -> None:
            with suppress(MasterError, ProcedureError):
                async with open_master(cable) as master:
                    await MOTIONS[motion](master, NODE)

        async with loop.open_nursery() as nursery, await open_transport(BUS) as other:
            nursery.start_soon(live)
            await loop.sleep(3)
            node.drive.refresh(host.now())
            assert abs(value(node, objects.VELOCITY_DEMAND_VALUE)) >= SPEED
            assert (value(node, CONSUMERS), value(node, REACTION)) == (ENTRY, 3)
            cable.copies = lambda frame, is_sent: 0  # kill -9
            limit = loop.current_time() + DEFAULT_WATCHDOG.timeout / SECOND + QUICK_STOP_SECONDS + 0.02
            while loop.current_time() < limit:
                if sync_goes_on:
                    await other.send(Frame(0x080, b""))
                await loop.sleep(0.01)
            node.drive.refresh(host.now())
            assert value(node, objects.VELOCITY_DEMAND_VALUE) == 0
            stood = value(node, objects.POSITION_ACTUAL_VALUE)
            await loop.sleep(5)
            node.drive.refresh(host.now())
            assert value(node, objects.POSITION_ACTUAL_VALUE) == pytest.approx(stood, abs=2)
            assert node.drive.state is State.SWITCH_ON_DISABLED
            nursery.cancel_scope.cancel()


@virtual_time
async def test_a_second_master_that_reads_keeps_no_drive_alive() -> None:
    async with one_drive() as (_, node):
        cable = Link()
        async with loop.open_nursery() as nursery, open_master(BUS) as reader:

            async def live() -> None:
                with suppress(MasterError, ProcedureError):
                    async with open_master(cable) as master:
                        await MOTIONS["pv"](master, NODE)

            nursery.start_soon(live)
            await loop.sleep(3)
            cable.copies = lambda frame, is_sent: 0
            for _ in range(20):
                await reader.node(NODE).read("statusword")
                await loop.sleep(0.05)
            assert value(node, objects.VELOCITY_DEMAND_VALUE) == 0
            assert node.drive.state is State.SWITCH_ON_DISABLED
            nursery.cancel_scope.cancel()


# ---- a heartbeat that comes late ----


async def beat_until(scope: CancelScope) -> None:
    with scope:
        async with await open_transport(BUS) as other:
            while True:
                await other.send(Frame(0x700 + 99, b"\x05"))
                await loop.sleep(0.02)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("missing", [0.103, 0.2])
@pytest.mark.parametrize("watchdog", [None, Watchdog(period=20 * MILLISECOND, timeout=100 * MILLISECOND)])
@virtual_time
async def test_a_joint_that_missed_our_heartbeat_is_not_just_called_silent(missing: float, watchdog: Watchdog | None) -> None:
    """A drive leaves Operational when a heartbeat is late. It clears its emergency with the next one, perhaps before we judge."""
    beating = loop.cancel_scope()
    async with simulated(3, 4):
        cable = Link()
        async with open_master(cable, watchdog=watchdog) as master, loop.open_nursery() as nursery:
            arm = arm_of(master, 3, 4)
            await arm.initialise()
            if watchdog is None:  # it watches another node's
                await arm.devices[0].node.write(CONSUMERS, 99 << 16 | 100)
                nursery.start_soon(beat_until, beating)
            await arm.follow()
            lost_at = loop.current_time()

            def copies(frame: Frame, is_sent: bool) -> int:
                return 0 if frame.can_id == 0x77F and loop.current_time() - lost_at < missing else 1

            cable.copies = copies
            beating.cancel()
            with pytest.raises(ChainFaultError, match="is silent: no PDO") as caught:
                async for _ in arm.cycles():
                    arm.hold()
        whose = "our heartbeat" if watchdog else "a heartbeat, or a guarding request, that it watches,"
        said = rf"{whose} came late: it sent EMCY 0x8130 \(life guard error or heartbeat error\) \d+ ms ago: this program, .*"
        assert re.fullmatch(said, caught.value.cause)
        judged_at = lost_at + 0.13
        codes = [frame.data[:2] for at, _, frame in cable.log if frame.can_id == 0x080 + 3 and at < judged_at]
        assert codes == [b"\x30\x81"] + [b"\0\0"] * (missing < 0.12 and watchdog is not None)


@pytest.mark.parametrize(("seconds", "is_named"), [(0.9, True), (1.1, False)])
@virtual_time
async def test_a_heartbeat_that_came_late_long_ago_is_not_the_reason(seconds: float, is_named: bool) -> None:
    async with following_arm(3, 4) as (host, _, arm):
        drives(host)[0].raise_error(0x8130, 0x11, b"\x7f", host.now())
        host.pump()
        await loop.sleep(seconds)
        drives(host)[0].execute(NmtCommand.ENTER_PRE_OPERATIONAL, host.now())
        with pytest.raises(ChainFaultError) as caught:
            async for _ in arm.cycles():
                arm.hold()
    assert ("heartbeat came late" in caught.value.cause) is is_named


@virtual_time
async def test_so_does_the_blocking_api_name_a_heartbeat_that_came_late() -> None:
    async with simulated(3):
        cable = Link()
        async with open_master(cable) as master:
            device = master.device(master.node(3), "joint")
            joint = DirectDrive(master, device, "schunk_default_rPDO", "schunk_default_tPDO", in_counts=False)
            await master.nmt_start(3)
            await joint.change_state(State.OPERATION_ENABLED)
            await joint.follow()
            cable.copies = lambda frame, is_sent: 0 if frame.can_id == 0x77F else 1
            with pytest.raises(MasterError, match=r"CO210.*is silent(.|\n)*cause: +our heartbeat came late: it sent EMCY 0x8130"):
                for _ in range(200):
                    await joint.send_position(joint.axis.set_points.position)
                    await master.send_sync()
                    await loop.sleep(0.01)


# ---- a master that lives, and leaves ----


@pytest.mark.parametrize("shut_down", [False, True])
@pytest.mark.parametrize("by_hand", [False, True])
@virtual_time
async def test_whoever_is_left_in_good_order_has_what_it_had_before(shut_down: bool, by_hand: bool) -> None:
    async with one_drive() as (_, node):
        cable = Link()
        node.values.store[REACTION] = 1
        async with open_master(cable) as master:
            joint = master.node(NODE)
            await joint.read("statusword")
            await loop.sleep(1)
            assert heartbeats(cable) == []
            if by_hand:
                for word in (0x06, 0x07, 0x0F):
                    await joint.write("controlword", word)
            else:
                await master.run(drive.enable(master.device(joint).axis))
            assert node.drive.state is State.OPERATION_ENABLED
            assert (value(node, CONSUMERS), value(node, REACTION)) == (ENTRY, 3)
            await loop.sleep(10)
            assert node.drive.state is State.OPERATION_ENABLED
            if shut_down:
                await master.run(drive.shut_down(master.device(joint).axis))
                assert (value(node, CONSUMERS), value(node, REACTION)) == (0, 1)
                ended = len(heartbeats(cable))
                await loop.sleep(1)
                assert len(heartbeats(cable)) == ended
        assert (value(node, CONSUMERS), value(node, REACTION)) == (0, 1)
        assert 90 <= len(heartbeats(cable)) <= 110
        await loop.sleep(2)
        assert not any(frame.can_id == 0x080 + NODE for _, _, frame in cable.log)


def heartbeats(cable: Link) -> list[Frame]:
    return [frame for _, is_sent, frame in cable.log if is_sent and frame.can_id == 0x77F]


@virtual_time
async def test_a_drive_that_does_not_confirm_its_halt_keeps_watching_and_stops_by_itself() -> None:
    async with one_drive() as (host, node):
        cable = Link()
        with pytest.raises(HaltNotConfirmedError):
            async with open_master(cable) as master:
                with loop.move_on_after(2):
                    await MOTIONS["pv"](master, NODE)
                cable.copies = lambda frame, is_sent: frame.can_id == 0x77F  # SDO is lost, heartbeats pass
        assert value(node, CONSUMERS) == ENTRY
        await loop.sleep(1)
        node.drive.refresh(host.now())
        assert value(node, objects.VELOCITY_DEMAND_VALUE) == 0


@virtual_time
async def test_a_drive_that_booted_is_taken_hold_of_again() -> None:
    async with one_drive() as (_, node), open_master(BUS) as master:
        device = master.device(master.node(NODE))
        await master.run(drive.enable(device.axis))
        await device.node.reset()
        assert value(node, CONSUMERS) == 0
        await master.run(drive.enable(device.axis))
        assert (value(node, CONSUMERS), value(node, REACTION)) == (ENTRY, 3)


@virtual_time
async def test_a_chain_holds_its_joints_and_lets_them_go() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        assert [value(node, CONSUMERS) for node in drives(host)] == [ENTRY, ENTRY]
        await arm.shut_down()
        assert [value(node, CONSUMERS) for node in drives(host)] == [0, 0]
        await arm.initialise()
        assert [value(node, CONSUMERS) for node in drives(host)] == [ENTRY, ENTRY]


@virtual_time
async def test_there_is_one_heartbeat_in_each_period_however_many_drives_are_enabled() -> None:
    cable = Link()
    async with simulated(3, 4, makers=standard_drives(5)), open_master(cable) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        await loop.sleep(0.03)
        await master.run(drive.enable(master.device(master.node(5)).axis))
        await arm.recover()
        await loop.sleep(0.5)
    times = [at for at, is_sent, frame in cable.log if is_sent and frame.can_id == 0x77F]
    gaps = [later - earlier for earlier, later in pairwise(times)]
    assert len(gaps) >= 5
    assert gaps == pytest.approx([DEFAULT_WATCHDOG.period / SECOND] * len(gaps), abs=0.002)


@virtual_time
async def test_a_drive_that_boots_while_it_is_taken_hold_of_is_enabled_only_when_it_watches() -> None:
    async with one_drive() as (_, node), loop.open_nursery() as nursery, open_master(BUS) as master:
        device = master.device(master.node(NODE))
        await device.node.read("statusword")
        async with await open_transport(BUS) as other:
            nursery.start_soon(master.run, drive.enable(device.axis))
            while value(node, CONSUMERS) == 0:
                await loop.sleep(0.001)
            await loop.sleep(0.03)
            assert node.drive.state is State.SWITCH_ON_DISABLED
            await other.send(Frame(0, bytes((0x81, NODE))))
            await loop.sleep(0.01)
            assert value(node, CONSUMERS) == 0
        while node.drive.state is not State.OPERATION_ENABLED:
            await loop.sleep(0.001)
        assert value(node, CONSUMERS) == ENTRY


@virtual_time
async def test_without_a_watchdog_nothing_is_sent_or_written() -> None:
    async with one_drive() as (_, node):
        cable = Link()
        async with open_master(cable, watchdog=None) as master:
            await master.run(drive.enable(master.device(master.node(NODE)).axis))
            assert (value(node, CONSUMERS), value(node, REACTION)) == (0, 0)
        assert heartbeats(cable) == []


# ---- whose node-ID ----


async def beat(node_id: int) -> None:
    async with await open_transport(BUS) as transport:
        while True:
            await transport.send(Frame(0x700 + node_id, b"\x05"))
            await loop.sleep(0.1)


@virtual_time
async def test_a_foreign_heartbeat_with_our_node_id_is_an_error_before_anything_is_enabled() -> None:
    async with simulated(3, 4) as host, loop.open_nursery() as nursery:
        nursery.start_soon(beat, 127)
        async with open_master(BUS) as master:
            with pytest.raises(NodeIdTakenError, match="another node 127 was heard .* Try: .*--master-id"):
                await master.run(drive.enable(master.device(master.node(3)).axis))
            with pytest.raises(ChainError, match="node-ID"):
                await arm_of(master, 3, 4).initialise()
            assert {node.drive.state for node in drives(host)} == {State.SWITCH_ON_DISABLED}
            assert {value(node, CONSUMERS) for node in drives(host)} == {0}
        async with open_master(BUS, watchdog=Watchdog(node_id=126)) as master:
            await arm_of(master, 3, 4).initialise()
            assert {value(node, CONSUMERS) for node in drives(host)} == {126 << 16 | 500}
        nursery.cancel_scope.cancel()


@virtual_time
async def test_two_masters_with_one_node_id_do_not_both_enable_drives() -> None:
    async with simulated(3, 4), open_master(BUS) as first, open_master(BUS) as second:
        await first.run(drive.enable(first.device(first.node(3)).axis))
        with pytest.raises(NodeIdTakenError):
            await second.run(drive.enable(second.device(second.node(4)).axis))


@virtual_time
async def test_a_node_of_our_node_id_that_was_used_is_an_error() -> None:
    async with simulated(3, 127), open_master(BUS) as master:
        await master.node(127).read("statusword")
        with pytest.raises(NodeIdTakenError):
            await master.run(drive.enable(master.device(master.node(3)).axis))


@virtual_time
async def test_a_foreign_heartbeat_that_comes_later_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async with simulated(makers=standard_drives(3)), loop.open_nursery() as nursery, open_master(BUS) as master:
        with master.events(ForeignHeartbeat) as foreign:
            await master.run(drive.enable(master.device(master.node(3)).axis))
            nursery.start_soon(beat, 127)
            assert (await foreign.receive()).node_id == 127
        await loop.sleep(1)
        assert [each.getMessage() for each in caplog.records if each.name == LOGGER.name] == [
            f"another node on {BUS} sends heartbeats as node 127 too: the drives there will not notice if this program ends"
        ]
        nursery.cancel_scope.cancel()


@virtual_time
async def test_each_bus_has_a_heartbeat_of_its_own() -> None:
    one, other = Link("one"), Link("two")
    async with loop.open_nursery() as nursery:
        for name, node_id in (("one", 3), ("two", 4)):
            await nursery.start(simulate, await open_transport(f"virtual:{name}"), standard_drives(node_id))
        async with open_master(buses={"a": one, "b": other}) as master:
            await master.run(drive.enable(master.device(master.node(3, bus="a")).axis))
            await loop.sleep(1)
            assert heartbeats(one)
            assert heartbeats(other) == []
            await master.run(drive.enable(master.device(master.node(4, bus="b")).axis))
            assert heartbeats(other)
        nursery.cancel_scope.cancel()


# ---- what is told ----

NO_REACTION = "no 0x6007 (abort connection option code)"


@virtual_time
async def test_drives_that_will_not_stop_by_themselves_are_told_once_by_name(caplog: pytest.LogCaptureFixture) -> None:
    async with simulated(3, 4, makers=standard_drives(5)), open_master(BUS) as master:
        with master.events(NotHeld) as told:
            arm = arm_of(master, 3, 4, 5)
            await arm.initialise()
            await arm.recover()
            await arm.shut_down()
            await arm.initialise()
            assert [await told.receive() for _ in range(2)] == [
                NotHeld(3, "joint1", NO_REACTION),
                NotHeld(4, "joint2", NO_REACTION),
            ]
            with loop.move_on_after(1):
                pytest.fail(f"{await told.receive()} was told again")
    messages = [each for each in caplog.records if each.name == LOGGER.name]
    assert [each.getMessage() for each in messages] == [
        f"joint1, joint2 will not stop by themselves if this program dies: {NO_REACTION}"
    ]
    assert messages[0].levelno == logging.WARNING


@virtual_time
async def test_a_master_may_insist_on_it() -> None:
    async with simulated(makers=powerballs(3)) as host, open_master(BUS, watchdog=Watchdog(required=True)) as master:
        for _ in range(2):
            with pytest.raises(NotHeldError, match=r"drive 3 would not stop by itself .* no 0x6007"):
                await master.run(drive.enable(master.device(master.node(3)).axis))
        with pytest.raises(ChainError, match=r"no 0x6007") as caught:
            await arm_of(master, 3).initialise()
        assert caught.value.tries == ("open_master(..., watchdog=Watchdog()) enables it all the same, and names it",)
        assert drives(host)[0].drive.state is State.SWITCH_ON_DISABLED


@virtual_time
async def test_what_cannot_be_put_back_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async with one_drive() as (_, node), open_master(BUS) as master:
        axis = master.device(master.node(NODE), "joint1").axis
        await master.run(drive.enable(axis))
        node.deferred.add(0x1016)  # nobody serves it: it is not answered in time
        await master.run(drive.shut_down(axis))
    messages = [each.getMessage() for each in caplog.records if each.name == LOGGER.name]
    assert messages
    assert messages[0].startswith("joint1: 0x1016:01 could not be put back as it was: ")
