"""A procedure that runs beside its owner may end, or be taken back, while its first frames are sent: nobody loses sight of it.

On a virtual bus a drive answers within the turn of the pump that asks it.
"""

from __future__ import annotations

import pytest

from canopen_master import ChainHaltedError, ChainState, DeviceModel, Master, open_master
from canopen_master.direct.drive import DirectDrive
from canopen_master.motion.supervision import Supervision
from canopen_master.participant.dispatch import ProcedureTakenBackError
from canopen_master.participant.participant import ProcedureSlot
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.axis.following import FollowingLost
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import Event
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import Procedure, act, sleep
from tests.master.loops import fail_after, loop
from tests.master.world import BUS, following_arm, simulated, virtual_time


class Told(Event):
    """Something that a procedure tells while it is begun."""

    __slots__ = ()


def tell_and_wait(master: Master) -> Procedure[str]:
    yield from act(lambda now: master.bus().network.out.events.append(Told(3)))
    yield from sleep(10**9)
    return "waited"


def answer(value: str) -> Procedure[str]:
    """End within the call that begins it."""
    yield from act(lambda now: None)
    return value


@virtual_time
async def test_a_procedure_that_ends_at_once_has_ended() -> None:
    async with open_master(BUS) as master:
        slot = ProcedureSlot(master)
        assert not slot.is_running
        await slot.ended()
        assert slot.result() is None
        slot.begin(answer("at once"))
        assert not slot.is_running
        await slot.ended()
        assert (slot.result(), await slot.outcome()) == ("at once", "at once")
        slot.take_back()
        assert slot.result() == "at once"


@virtual_time
async def test_a_procedure_may_be_taken_back_or_followed_by_another_while_it_is_begun() -> None:
    async with open_master(BUS) as master:
        slot = ProcedureSlot(master)
        watcher = master.watch((Told,), lambda told: slot.take_back())
        slot.begin(tell_and_wait(master))
        assert not slot.is_running
        with pytest.raises(ProcedureTakenBackError):
            slot.result()
        master.unwatch(watcher)
        watcher = master.watch((Told,), lambda told: slot.begin(answer("the second")))
        slot.begin(tell_and_wait(master))
        assert slot.result() == "the second"
        master.unwatch(watcher)
        slot.begin(tell_and_wait(master))
        assert slot.is_running
        await slot.ended()
        assert slot.result() == "waited"


@virtual_time
async def test_a_node_whose_file_has_no_pdos_is_started() -> None:
    dictionary = ObjectDictionary([standard_object(index) for index in (0x1000, 0x1001, 0x1018)])
    async with simulated(makers=[DeviceModel(dictionary, 5)]) as host, open_master(BUS) as master:
        node = master.node(5, dictionary)
        with fail_after(1):
            assert await node.exchange_pdos() == ()
            await node.start()
            assert await node.exchange_pdos() == ()
        assert host.nodes[0].state is NmtState.OPERATIONAL


@virtual_time
async def test_a_chain_that_is_stopped_while_it_begins_to_follow_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """No set-point is taken, and nothing more is read beside the cycle, although the stop came before `begin_following` ended."""
    async with following_arm(3, 4) as (_, master, arm):
        await arm.halt()
        begin = Supervision.begin_following

        def and_lose(self: Supervision, *args: object) -> None:
            arm.devices[0].node.remote.out.events.append(FollowingLost(3, "does not follow"))
            begin(self, *args)  # type: ignore[arg-type]

        monkeypatch.setattr(Supervision, "begin_following", and_lose)
        await arm.enable_interpolated_position()
        assert arm.state is ChainState.FAULT
        with pytest.raises(ProcedureTakenBackError):  # the reading was taken back
            arm.members[0].supervision._beside.result()
        await loop.sleep(2)
        assert arm.state is ChainState.FAULT
        assert not master.runner.busy


@virtual_time
async def test_a_command_of_a_chain_that_is_stopped_while_it_begins_ends() -> None:
    async with following_arm(3, 4) as (_, master, arm):
        await arm.halt()
        stopped = []

        def stop(told: Told) -> None:
            stopped.append(told)
            arm.members[0].begin_halt()

        watcher = master.watch((Told,), stop)
        with pytest.raises(ChainHaltedError):
            await arm.members[0].for_all("wait", lambda device: tell_and_wait(master))
        assert stopped
        master.unwatch(watcher)
        await arm.members[0].halted()
        assert arm.state is ChainState.HALTED


@virtual_time
async def test_a_command_of_a_chain_that_is_stopped_at_the_moment_of_its_end_has_not_succeeded() -> None:
    async with following_arm(3, 4) as (_, master, arm):
        await arm.halt()
        stopped: list[ProcedureFinished] = []

        def stop(finished: ProcedureFinished) -> None:
            if not stopped:
                stopped.append(finished)
                arm.members[0].begin_halt()

        watcher = master.watch((ProcedureFinished,), stop)
        with pytest.raises(ChainHaltedError):
            await arm.members[0].for_all("wait", lambda device: tell_and_wait(master))
        assert stopped
        master.unwatch(watcher)
        assert arm.state is ChainState.HALTED


@virtual_time
async def test_a_direct_drive_that_is_lost_while_it_begins_to_follow_reads_nothing_more() -> None:
    async with simulated(3), open_master(BUS) as master:
        device = master.device(master.node(3), "joint")
        drive = DirectDrive(master, device, "schunk_default_rPDO", "schunk_default_tPDO")
        await master.nmt_start(3)
        await drive.change_state(State.OPERATION_ENABLED)
        master.watch((Told,), lambda told: drive._on_lost(FollowingLost(3, "does not follow")))

        class Losing(ProcedureSlot):
            def begin(self, procedure: Procedure[object]) -> None:
                device.node.remote.out.events.append(Told(3))
                super().begin(procedure)

        drive._reading = Losing(master)
        await drive.follow()
        assert not drive._reading.is_running
