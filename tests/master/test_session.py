"""How a master comes and goes: the block's own exception, cancels, Ctrl-C; drives stand in each case."""

import signal
import types
from collections.abc import Awaitable, Callable, Coroutine, Generator
from pathlib import Path
from typing import Any

import pytest

from canopen_master import (
    BusError,
    Chain,
    HaltNotConfirmedError,
    Master,
    MasterClosedError,
    Node,
    boot_network,
    open_master,
    standard_drives,
)
from canopen_master.machine_file import parse_machine
from canopen_master.session import SHUTDOWN_TIME
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402.states import State
from canopen_proto.manager.parameters.walk import back_up_by_names
from canopen_transports import VirtualTransport
from canopen_transports.log_files import log_writer
from canopen_transports.loop import CancelScope
from canopen_transports.tracing import Trace
from tests.loops import beside, is_interrupt, loop, settled
from tests.master.world import (
    BUS,
    Breakable,
    arm_of,
    assert_all_halted,
    assert_all_stand,
    drives,
    simulated,
    virtual_time,
)


class OurError(Exception):
    pass


@virtual_time
async def test_the_blocks_own_exception_comes_out_as_it_is() -> None:
    error = OurError()
    with pytest.raises(OurError) as caught:
        async with open_master(BUS):
            raise error
    assert caught.value is error
    assert not hasattr(error, "__notes__")


class Gateway(VirtualTransport):
    unheard = "the gateway forwards only answers"


@virtual_time
async def test_a_transport_that_may_not_hear_other_clients_is_named_once(
    caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    trace = Trace(log_writer(tmp_path / "trace.log"))
    async with Gateway("gate") as gateway, VirtualTransport("open") as whole:
        recorded = trace.wrap(gateway)
        async with open_master(buses={"arm": recorded, "gripper": recorded, "whole": whole}) as master:
            for bus in ("arm", "gripper", "whole"):
                master.node(3, bus=bus)
    trace.close()
    said = [each.getMessage() for each in caplog.records if "may not be heard" in each.getMessage()]
    (warning,) = said
    assert warning.startswith("arm: frames of others may not be heard here, as the gateway forwards only answers: ")


@virtual_time
async def test_a_group_of_the_blocks_own_nursery_stays_a_group() -> None:
    async def fail() -> None:
        raise OurError

    with pytest.raises(ExceptionGroup) as caught:
        async with open_master(BUS), loop.open_nursery() as nursery:
            nursery.start_soon(fail)
    assert [type(error) for error in caught.value.exceptions] == [OurError]


@virtual_time
async def test_a_bus_error_in_a_nursery_of_the_block_comes_out_plain() -> None:
    cable = Breakable()
    with pytest.raises(BusError):
        async with open_master(cable) as master, loop.open_nursery() as outer, loop.open_nursery() as nursery:
            nursery.start_soon(master.node(3).read, "statusword")
            outer.start_soon(master.node(4).read, "statusword")
            await settled()
            cable.cut()


@virtual_time
async def test_other_errors_in_a_nursery_are_not_lost_when_the_bus_fails() -> None:
    cable = Breakable()

    async def fail_in_the_end() -> None:
        try:
            await loop.sleep_forever()
        finally:
            raise OurError

    with pytest.raises(BaseExceptionGroup) as caught:
        async with open_master(cable), loop.open_nursery() as nursery:
            nursery.start_soon(fail_in_the_end)
            await settled()
            cable.cut()
    assert caught.group_contains(OurError)


@virtual_time
async def test_a_failed_bus_does_not_hide_the_blocks_own_exception() -> None:
    cable = Breakable()
    with pytest.raises(OurError):
        async with open_master(cable):
            cable.cut()
            with loop.cancel_scope(shield=True):
                await loop.sleep(0.1)
            raise OurError


@virtual_time
async def test_an_outer_cancel_is_the_outer_scopes_business() -> None:
    with loop.move_on_after(1) as scope:
        async with open_master(BUS):
            await loop.sleep_forever()
    assert scope.cancelled_caught
    assert loop.current_time() == 1


@virtual_time
async def test_a_bus_that_cannot_be_opened_closes_those_that_were() -> None:
    cable = Breakable()
    with pytest.raises(BusError, match="nonsense"):
        async with open_master(cable, "nonsense:x"):
            pytest.fail("opened")
    assert cable.closed == 1


@virtual_time
async def test_tasks_that_outlive_the_block_are_told() -> None:
    async with simulated(3) as host, loop.open_nursery() as nursery:
        host.nodes[0].sdo.disable()

        async def read(master: Master) -> None:
            with pytest.raises(MasterClosedError):
                await master.node(3).read("statusword")

        async with open_master(BUS) as master:
            nursery.start_soon(read, master)
            await settled()


# ---- the way out while drives move ----


async def _home(master: Master, arm: Chain) -> None:
    await arm.initialise()
    await arm.home()
    await loop.sleep_forever()


async def _follow(master: Master, arm: Chain) -> None:
    await arm.initialise()
    await arm.enable_interpolated_position()
    start = arm.positions
    async for cycle in arm.cycles():
        arm.set_positions([position + 0.002 * cycle.number for position in start])


async def _by_hand(master: Master, arm: Chain) -> None:
    await _begin_by_hand(master.node(5))
    await loop.sleep_forever()


async def _begin_by_hand(node: Node) -> None:
    await node.write("modes_of_operation", 6)
    for word in (6, 7, 15, 31):
        await node.write("controlword", word)


async def _shut_down(master: Master, arm: Chain) -> None:
    await arm.initialise()
    await arm.enable_interpolated_position()
    await arm.shut_down()


MACHINE = parse_machine("""
[buses."virtual:test"]
locator = "virtual:test"

[nodes]
shoulder = { id = 3, boot = { mandatory = true, heartbeat = "200ms" } }
elbow = { id = 4, boot = { mandatory = true } }
""")


async def _boot(master: Master, arm: Chain) -> None:
    node = master.node(5)
    await _begin_by_hand(node)
    await boot_network(master, MACHINE)
    await loop.sleep_forever()


async def _back_up(master: Master, arm: Chain) -> None:
    node = master.node(5)
    await _begin_by_hand(node)
    await master.run(back_up_by_names(node.remote, node.remote.dictionary))
    await loop.sleep_forever()


Scenario = Callable[[Master, Chain], Awaitable[None]]


async def _leave(scenario: Scenario, scope: CancelScope) -> None:
    """Run a scenario until it is cancelled; then no drive may move, whatever was under way."""
    async with simulated(3, 4, 5) as host:
        with scope:
            async with open_master(BUS) as master:
                await scenario(master, arm_of(master, 3, 4))
        assert_all_halted(host)
        await assert_all_stand(host)
        # the master has left the bus, the devices are still there
        async with open_master(BUS) as again:
            await again.nmt_enter_pre_operational()
            assert isinstance(await again.node(3).read("device_type"), int)


BEGINNING = [*range(0, 100, 7), 150, 333]
"""In milliseconds. Nothing new comes behind them, but for homing, which ends."""
HOMING = [640, 1300, 1640, 1670, 2500]


@pytest.mark.thorough(8)
@pytest.mark.parametrize(
    ("scenario", "milliseconds"),
    [
        *((scenario, each) for scenario in (_home, _follow, _by_hand) for each in BEGINNING),
        *((_home, each) for each in HOMING),
        *((scenario, each) for scenario in (_boot, _back_up) for each in (84, 333, 700)),
    ],
)
def test_cancelled_at_any_time_the_drives_stand(scenario: Scenario, milliseconds: int) -> None:
    @virtual_time
    async def test() -> None:
        scope = loop.cancel_scope(deadline=milliseconds / 1000)
        await _leave(scenario, scope)
        assert scope.cancelled_caught
        assert loop.current_time() <= milliseconds / 1000 + SHUTDOWN_TIME + 1

    test()


@types.coroutine
def step_by_step(work: Coroutine[Any, Any, None], step: int, scope: CancelScope) -> Generator[Any, Any, int]:
    """Do some work, and cancel a scope when it goes on for the n-th time: at each await in turn. Returns the steps left."""
    value, error = None, None
    while True:
        step -= 1
        if step == 0:
            scope.cancel()
        try:
            asked = work.send(value) if error is None else work.throw(error)
        except StopIteration:
            return step
        try:
            value, error = (yield asked), None
        except BaseException as raised:  # noqa: BLE001 - handed to the work
            value, error = None, raised


@pytest.mark.thorough(5)
@pytest.mark.both_loops
@pytest.mark.parametrize("scenario", [_home, _follow, _shut_down, _boot, _back_up])
def test_cancelled_at_each_await_the_drives_stand(scenario: Scenario) -> None:
    tested = 0

    def all_steps_were_tested() -> bool:
        left: list[int] = []

        @virtual_time
        async def test() -> None:
            scope = loop.cancel_scope(deadline=4)
            left.append(await step_by_step(_leave(scenario, scope), tested, scope))

        test()
        return left[0] > 0

    while tested < 60:
        tested += 3
        if all_steps_were_tested():
            break
    assert tested > 10


def test_ctrl_c_in_the_middle_of_a_move_halts_the_drives() -> None:
    hosts = []

    async def press() -> None:
        await loop.sleep(0.5)
        signal.raise_signal(signal.SIGINT)

    @virtual_time
    async def test() -> None:
        async with simulated(3, 4) as host:
            hosts.append(host)
            try:
                async with open_master(BUS) as master, loop.open_nursery() as nursery:
                    nursery.start_soon(press)
                    await _home(master, arm_of(master, 3, 4))
            finally:
                assert_all_halted(host)
                await assert_all_stand(host)

    with pytest.raises((BaseExceptionGroup, KeyboardInterrupt)) as caught:
        test()
    assert is_interrupt(caught.value)
    assert all(node.drive.state is State.OPERATION_ENABLED for node in drives(hosts[0]))


@pytest.mark.thorough(6)
@pytest.mark.parametrize("gap", [0.0, 0.0005, 0.009])
@pytest.mark.parametrize(
    ("scenario", "at"), [*((scenario, at) for scenario in (_home, _follow, _by_hand) for at in (0.012, 0.5)), (_home, 1.64)]
)
def test_further_ctrl_c_come_out_when_the_drives_stand(scenario: Scenario, at: float, gap: float) -> None:
    async def press() -> None:
        await loop.sleep(at)
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
            await loop.sleep(gap)

    @virtual_time
    async def test() -> None:
        async with simulated(3, 4, 5) as host:
            try:
                async with open_master(BUS) as master:
                    beside(press)
                    await scenario(master, arm_of(master, 3, 4))
            finally:
                assert_all_halted(host)
                with loop.cancel_scope(shield=True):  # on asyncio a further Ctrl-C cancels the next await
                    await assert_all_stand(host)

    with pytest.raises(KeyboardInterrupt):
        test()


def test_ctrl_c_in_the_users_own_code_halts_the_drives() -> None:
    @virtual_time
    async def test() -> None:
        async with simulated(3) as host:
            try:
                async with open_master(BUS) as master:
                    arm = arm_of(master, 3)
                    await arm.initialise()
                    await arm.enable_interpolated_position()
                    (start,) = arm.positions
                    async for cycle in arm.cycles():
                        arm.set_positions([start + 0.1 * cycle.time])
                        if cycle.number == 20:
                            signal.raise_signal(signal.SIGINT)
            finally:
                assert_all_halted(host)

    with pytest.raises(KeyboardInterrupt):
        test()


@virtual_time
async def test_a_drive_that_does_not_answer_is_told_and_holds_up_nobody() -> None:
    async with simulated(3, 4) as host:
        with pytest.raises(HaltNotConfirmedError, match="joint1 .node 3 on virtual:test.: node 3 did not answer") as caught:
            async with open_master(BUS) as master:
                await arm_of(master, 3, 4).initialise()
                master.sync_stop()
                await loop.sleep(1)  # what the PDOs told is old now
                host.nodes[0].sdo.disable()
                started = loop.current_time()
        assert loop.current_time() - started <= SHUTDOWN_TIME
        assert caught.value.code == "CO131"
        assert "emergency stop" in str(caught.value)
        assert drives(host)[1].values.store[0x6040_00] == 0x10F


@virtual_time
async def test_a_drive_that_its_dictionary_does_not_describe_is_halted_by_number_and_told() -> None:
    async with simulated(makers=standard_drives(3)) as host:
        with pytest.raises(HaltNotConfirmedError, match="node 3 on virtual:test: its dictionary describes no drive"):
            async with open_master(BUS) as master:
                node = master.node(3, ObjectDictionary([standard_object(0x1000)]))
                await node.write_bytes(0x6060, 0, b"\x03")
                await node.write_bytes(0x60FF, 0, (20_000).to_bytes(4, "little"))
                for word in (6, 7, 15):
                    await node.write_bytes(0x6040, 0, word.to_bytes(2, "little"))
                await loop.sleep(1)
        assert_all_halted(host)


@virtual_time
async def test_an_exception_that_is_under_way_gets_a_note_of_such_drives() -> None:
    async with simulated(3) as host:
        with pytest.raises(OurError) as caught:
            async with open_master(BUS) as master:
                await arm_of(master, 3).initialise()
                master.sync_stop()
                await loop.sleep(1)
                host.nodes[0].sdo.disable()
                raise OurError
        assert "not confirmed to stand: joint1" in caught.value.__notes__[0]


@virtual_time
async def test_drives_of_a_failed_bus_are_told_and_those_of_another_are_halted() -> None:
    async with simulated(3, bus="virtual:one"), simulated(3, bus="virtual:two") as other:
        cable = Breakable("one")
        with pytest.raises(BusError) as caught:
            async with open_master(buses={"can0": cable, "can1": "virtual:two"}) as master:
                arm = master.load_chains(text="arm j1 can0 3 j2 can1 3")["arm"]
                await arm.initialise()
                await arm.enable_interpolated_position()
                start = arm.positions
                async for cycle in arm.cycles():
                    arm.set_positions([position + 0.1 * cycle.time for position in start])
                    if cycle.number == 50:
                        cable.cut()
        assert caught.value.bus == "can0"
        assert caught.value.__notes__ == ["not confirmed to stand: j1 (node 3 on can0): its bus has failed"]
        assert_all_halted(other)
        await assert_all_stand(other)


@virtual_time
async def test_the_way_out_ends_in_time_when_the_bus_takes_no_frames() -> None:
    async with simulated(3):
        cable = Breakable()
        with pytest.raises(HaltNotConfirmedError):
            async with open_master(cable) as master:
                await arm_of(master, 3).initialise()
                cable.is_stuck = True
                started = loop.current_time()
        assert loop.current_time() - started == pytest.approx(SHUTDOWN_TIME)


@virtual_time
async def test_transports_are_closed_in_any_case() -> None:
    cable, given = Breakable(), VirtualTransport("given")
    async with open_master(cable, given):
        pass
    assert cable.closed == 1
    with pytest.raises(loop.ClosedResourceError):
        await given.receive()
