"""Drives that a user's own words have enabled: halted when the master is left, held meanwhile, put back as they were."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress

import pytest

from canopen_master import (
    HaltNotConfirmedError,
    Host,
    Master,
    MasterError,
    Node,
    NodeIdTakenError,
    SdoGivenUpError,
    Watchdog,
    open_master,
    standard_drives,
)
from canopen_master.watchdog import LOGGER
from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.watchdog import NotHeldError
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import download
from canopen_proto.sdo.client import SdoDownloaded
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_transports import open_transport
from tests.loops import loop
from tests.master.motions import FAR
from tests.master.world import BUS, Link, arm_of, drives, simulated, value, virtual_time

NODE = 3
ENABLE = (0x06, 0x07, 0x0F)
SPEED = 20_000
CONSUMERS, REACTION, ENTRY = mux(0x1016, 1), mux(0x6007), 127 << 16 | 500
Command = Callable[[Master, Node, int], Awaitable[None]]


def one_drive() -> object:
    return simulated(makers=standard_drives(NODE, settings=FAR))


def speed(host: Host) -> int:
    """Of the drive, counts per second."""
    node = drives(host)[0]
    node.drive.refresh(host.now())
    return abs(value(node, objects.VELOCITY_DEMAND_VALUE))


async def by_name(master: Master, node: Node, word: int) -> None:
    await node.write("controlword", word)


async def by_bytes(master: Master, node: Node, word: int) -> None:
    await node.write_bytes(0x6040, 0, word.to_bytes(2, "little"))


async def by_stream(master: Master, node: Node, word: int) -> None:
    await node.write_stream(0x6040, 0, [word.to_bytes(2, "little")])


async def by_the_core(master: Master, node: Node, word: int) -> None:
    await master.run(download(node.remote.sdo, 0x6040, 0, word.to_bytes(2, "little")))


async def by_the_cores_node(master: Master, node: Node, word: int) -> None:
    with node.events(SdoDownloaded) as confirmed:
        node.remote.write("controlword", word, node.now())
        await confirmed.receive()


async def by_rpdo(master: Master, node: Node, word: int) -> None:
    if not node.remote.rpdos:
        await master.run(use_device_pdo(node.remote, Direction.RPDO, 1))
        await node.nmt(NmtCommand.START)
        node.enable_rpdo(1)
        await loop.sleep(1)
    node.remote.values.store[objects.CONTROLWORD] = word
    node.remote.rpdos[1].send(node.now())
    master.pump.pump()
    await loop.sleep(0.05)


COMMANDS = [by_name, by_bytes, by_stream, by_the_core, by_the_cores_node, by_rpdo]


async def moving(master: Master, command: Command = by_name) -> Node:
    """The drive in profile velocity mode, at its speed."""
    node = master.node(NODE, drive_dictionary(), pdos=False)
    await node.write("modes_of_operation", 3)
    await node.write("target_velocity", SPEED)
    for word in ENABLE:
        await command(master, node, word)
    await loop.sleep(1)
    return node


@pytest.mark.parametrize("command", COMMANDS)
@virtual_time
async def test_whatever_brought_the_controlword_the_drive_is_held_and_stands_when_the_master_is_left(command: Command) -> None:
    async with one_drive() as host:
        node = drives(host)[0]
        async with open_master(BUS) as master:
            await moving(master, command)
            assert speed(host) == SPEED
            assert (value(node, CONSUMERS), value(node, REACTION)) == (ENTRY, 3)
        assert speed(host) == 0
        assert (value(node, CONSUMERS), value(node, REACTION)) == (0, 0)


@pytest.mark.parametrize("later", [0.05, 1.0])
@pytest.mark.parametrize("is_drive", [True, False])
@virtual_time
async def test_the_drive_is_halted_though_it_does_not_answer_any_more(is_drive: bool, later: float) -> None:
    """later: s from the last answer to the way out. is_drive: as its dictionary says."""
    async with one_drive() as host:
        cable = Link()
        with pytest.raises(HaltNotConfirmedError):
            async with open_master(cable) as master:
                node = await moving(master)
                if is_drive:
                    await master.run(drive.read_statusword(master.device(node).axis))
                cable.copies = lambda frame, is_sent: int(is_sent)
                await loop.sleep(later)
                begun = loop.current_time()
        told = [time for time, is_sent, frame in cable.log if is_sent and str(frame) == "603#2B4060000F010000"]
        assert told[0] - begun <= (0.15 if is_drive else 1.2)
        assert speed(host) == 0


@pytest.mark.thorough(3)
@pytest.mark.parametrize("command", COMMANDS)
@virtual_time
async def test_what_was_enabled_and_disabled_by_hand_has_what_it_had_before(command: Command) -> None:
    async with one_drive() as host:
        async with open_master(BUS) as master:
            for word in (0x06, 0x00):
                await command(master, await moving(master, command), word)
                await loop.sleep(0.5)
        node = drives(host)[0]
        assert node.drive.state is State.SWITCH_ON_DISABLED
        assert (value(node, CONSUMERS), value(node, REACTION)) == (0, 0)


@pytest.mark.parametrize("bad", ["refused", "not answered"])
@virtual_time
async def test_a_drive_that_did_not_confirm_to_be_disabled_counts_as_enabled(bad: str) -> None:
    async with one_drive() as host:
        cable = Link()
        with suppress(MasterError):
            async with open_master(cable) as master:
                node = await moving(master, by_bytes)
                if bad == "refused":
                    await node.write_bytes(0x6040, 0, b"\x06")  # a byte is missing
                else:
                    cable.copies = lambda frame, is_sent: 0 if is_sent and frame.data[1:3] == b"\x40\x60" else 1
                    with suppress(MasterError):
                        await node.write_bytes(0x6040, 0, b"\x06\x00")
                    cable.copies = lambda frame, is_sent: 1
        assert speed(host) == 0


@virtual_time
async def test_a_drive_that_brakes_and_no_longer_answers_is_told_and_stays_held() -> None:
    async with one_drive() as host:
        with pytest.raises(HaltNotConfirmedError, match="node 3"):
            async with open_master(BUS) as master:
                node = await moving(master)
                device = master.device(node)
                await node.write("quick_stop_deceleration", 5_000)
                await node.write("controlword", 0x02)
                await node.read("statusword")
                assert device.state is State.QUICK_STOP_ACTIVE
                assert speed(host) > SPEED // 2
                host.nodes[0].sdo.disable()
        assert value(drives(host)[0], CONSUMERS) == ENTRY


@virtual_time
async def test_an_enabling_word_that_was_not_confirmed_is_not_forgotten() -> None:
    async with one_drive() as host:
        cable = Link()
        with pytest.raises(HaltNotConfirmedError, match="node 3"):
            async with open_master(cable) as master:
                axis = master.device(master.node(NODE)).axis
                await master.run(drive.change_state(axis, State.SWITCHED_ON))
                cable.copies = lambda frame, is_sent: int(is_sent)  # it hears us, and we hear nothing from now on
                with loop.move_on_after(0.3):
                    await master.run(write(axis.node, "controlword", 0x0F))
        assert drives(host)[0].drive.state is State.OPERATION_ENABLED


# ---- the watchdog ----


@virtual_time
async def test_a_drive_that_booted_unheard_is_taken_hold_of_again() -> None:
    async with one_drive() as host:
        cable = Link()
        node = drives(host)[0]
        async with open_master(cable) as master:
            axis = master.device(master.node(NODE)).axis
            await master.run(drive.enable(axis))
            cable.copies = lambda frame, is_sent: int(frame.can_id != 0x700 + NODE)  # its boot-up frame is lost
            async with await open_transport(BUS) as other:
                await other.send(Frame(0x000, bytes([NmtCommand.RESET_NODE, NODE])))
            await loop.sleep(1)
            assert value(node, CONSUMERS) == 0
            await master.run(drive.enable(axis))
            assert (value(node, CONSUMERS), value(node, REACTION)) == (ENTRY, 3)


@virtual_time
async def test_guarding_that_is_the_users_goes_on() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3)
        node = arm.devices[0].node
        node.start_guarding(0.1)
        await arm.initialise()
        await arm.shut_down()
        assert node.remote.guarding.guard_time == 100_000_000
        assert drives(host)[0] is host.nodes[0]


@virtual_time
async def test_who_insists_on_a_watchdog_has_it_before_an_rpdo_is_sent() -> None:
    async with one_drive() as host, open_master(BUS, watchdog=Watchdog(required=True)) as master:
        node = master.node(NODE, drive_dictionary(), pdos=False)
        await master.run(use_device_pdo(node.remote, Direction.RPDO, 1))
        with pytest.raises(NotHeldError, match=r"try `await node.hold\(\)` before"):
            node.enable_rpdo(1)
        await node.hold()
        node.enable_rpdo(1)
        assert value(drives(host)[0], CONSUMERS) == ENTRY


@virtual_time
async def test_a_watchdog_that_fails_beside_an_rpdo_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async with one_drive() as host:
        async with open_master(BUS) as master, await open_transport(BUS) as other:
            await other.send(Frame(0x77F, b"\x05"))
            with pytest.raises(NodeIdTakenError):
                await master.node(NODE, drive_dictionary(), pdos=False).hold()
            await moving(master, by_rpdo)
            assert speed(host) == SPEED
        assert speed(host) == 0
        assert value(drives(host)[0], CONSUMERS) == 0
    assert any("another node 127 was heard" in each.getMessage() for each in caplog.records if each.name == LOGGER.name)


@virtual_time
async def test_names_in_a_warning_are_fit_to_be_shown(caplog: pytest.LogCaptureFixture) -> None:
    async with simulated(3), open_master(BUS) as master:
        with caplog.at_level(logging.WARNING, LOGGER.name):
            await master.run(drive.enable(master.device(master.node(3), "j\x1b[2J").axis))
    messages = [each.getMessage() for each in caplog.records if each.name == LOGGER.name]
    assert messages
    assert all(each.isprintable() for each in messages)


@pytest.mark.parametrize("command", [by_name, by_bytes])
@virtual_time
async def test_a_stop_ends_a_word_that_enables_and_waits_until_the_drive_watches(command: Command) -> None:
    async with one_drive() as host, open_master(BUS) as master:
        node = master.node(NODE)
        for word in ENABLE[:2]:
            await command(master, node, word)
        async with loop.open_nursery() as nursery:

            async def enable() -> None:
                with pytest.raises(SdoGivenUpError, match="a stop of its drive went before it"):
                    await command(master, node, ENABLE[2])

            nursery.start_soon(enable)
            await loop.sleep(0.05)
            await master.run(drive.halt(master.device(node).axis))
        await loop.sleep(1)
        assert drives(host)[0].drive.state is State.SWITCHED_ON
        await command(master, node, ENABLE[2])  # behind the stop it is a new one
        assert drives(host)[0].drive.state is State.OPERATION_ENABLED
