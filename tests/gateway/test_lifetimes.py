"""A machine that runs for weeks: what comes and goes leaves nothing behind; whatever is cancelled, the drives stand."""

from __future__ import annotations

import gc
import random
from collections import Counter
from collections.abc import Awaitable, Callable

import pytest
import trio

from canopen_gateway import GatewayService, open_gateway
from canopen_master import Chain, Host, Master, SdoError, open_master
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import SECOND
from canopen_proto.pdo.consumer import PdoReceived
from tests.gateway.gateway_world import TextClient
from tests.master.world import BUS, arm_of, assert_all_stand, drives, simulated, virtual_time

TIMES = 8

Turn = Callable[[Host, Master, Chain, GatewayService], Awaitable[object]]


async def subscribe(host: Host, master: Master, arm: Chain, service: GatewayService) -> None:
    node = master.node(3)
    with master.events(EmcyReceived), node.events(PdoReceived) as events:
        with trio.move_on_after(0.01):
            await events.receive()
    master.unwatch(master.watch((EmcyReceived,), lambda event: None))


async def transfer(host: Host, master: Master, arm: Chain, service: GatewayService) -> None:
    """Ended, refused, cancelled before and behind the first frame, without an answer."""
    node = master.node(3)
    await node.read_bytes(0x1008)
    for ask in (node.read_bytes(0x5F00), node.write_bytes(0x5F00, 0, bytes(99)), master.node(9).read_bytes(0x1000)):
        with pytest.raises(SdoError):
            await ask
    for seconds in (0.0, 1e-6):
        with trio.move_on_after(seconds):
            await node.read_bytes(0x1008)
    client = node.remote.add_sdo_channel(0x643, 0x5C3)  # type: ignore[arg-type]
    node.remote.remove_sdo_channel(client, master.now())


async def follow(host: Host, master: Master, arm: Chain, service: GatewayService) -> None:
    await arm.initialise()
    await arm.home(if_needed=True)
    await arm.follow()
    await arm.move([0.01])
    await arm.move([0.0])
    await arm.shut_down()


async def fail(host: Host, master: Master, arm: Chain, service: GatewayService) -> None:
    await arm.initialise()
    (node,) = drives(host)
    node.drive.raise_fault(0x4210, host.now())
    host.pump()
    await trio.sleep(0.5)
    await arm.recover()
    await master.node(3).reset()


async def visit(host: Host, master: Master, arm: Chain, service: GatewayService) -> None:
    """A client of a gateway comes, sets things up, and goes without taking them away."""
    with service.open_session("somebody") as session:
        client = TextClient(session)
        for line in ("3 r 0x1018 1 u32", "3 enable guarding 200 3", "3 enable heartbeat 900", "boot_up_indication enable",
                     "set rpdo 1 0x1F0 event 1 u16"):  # fmt: skip
            await client.say(f"[1] 1 {line}")
        await service.find_nodes(service.nets[0])
        with trio.move_on_after(1.0):
            await client.event()


def counted() -> Counter[str]:
    gc.collect()
    kinds = (type(each) for each in gc.get_objects())
    return Counter(kind.__name__ for kind in kinds if str(kind.__module__).startswith("canopen_"))  # of some it is no string


@pytest.mark.parametrize("turn", [subscribe, transfer, follow, fail, visit])
@virtual_time
async def test_what_comes_and_goes_leaves_nothing_behind(turn: Turn) -> None:
    """A leak of one object in each turn is seen."""
    async with simulated(3) as host, open_master(BUS) as master, open_gateway(master, allow=()) as service:
        arm = arm_of(master, 3)
        for _ in range(2):
            await turn(host, master, arm, service)
        before = counted()
        for _ in range(TIMES):
            await turn(host, master, arm, service)
        await trio.sleep(1.0)
        assert {kind: count for kind, count in (counted() - before).items() if count >= TIMES} == {}


class CancelsAt(trio.abc.Instrument):
    """Cancels a scope at the given step of any task of the process."""

    def __init__(self, scope: trio.CancelScope, step: int) -> None:
        self._scope, self._left = scope, step

    def before_task_step(self, task: trio.lowlevel.Task) -> None:
        self._left -= 1
        if not self._left:
            self._scope.cancel()


async def initialise(arm: Chain) -> None:
    await arm.initialise()


async def home(arm: Chain) -> None:
    await arm.home()


async def move(arm: Chain) -> None:
    await arm.follow()
    await arm.move([0.1, -0.1])


async def jog(arm: Chain) -> None:
    await arm.follow()
    async with arm.jog() as given:
        for _ in range(30):
            given.velocity([0.2, 0.1])
            await trio.sleep(0.01)


async def shut_down(arm: Chain) -> None:
    await arm.shut_down()


@pytest.mark.thorough(3)
@pytest.mark.parametrize("command", [initialise, home, move, jog, shut_down])
@virtual_time
async def test_wherever_a_command_is_cancelled_the_drives_stand_and_the_chain_can_go_on(
    command: Callable[[Chain], Awaitable[None]],
) -> None:
    drawn, steps = random.Random(command.__name__), 1
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        is_over = False
        while not is_over:
            await arm.initialise()
            await arm.home(if_needed=True)
            with trio.CancelScope() as scope:
                cancels = CancelsAt(scope, steps)
                trio.lowlevel.add_instrument(cancels)
                await command(arm)
                is_over = True
            trio.lowlevel.remove_instrument(cancels)
            await assert_all_stand(host)
            assert not arm.is_busy
            steps += 1 + drawn.randrange(max(2, steps // 2))
        assert steps > 3
        await arm.initialise()
        await arm.home(if_needed=True)
        await arm.follow()
        await arm.move([0.05, 0.05])
        assert arm.positions == pytest.approx([0.05, 0.05], abs=1e-3)
        assert not any(each.remote.sdo.busy for each in (master.node(3), master.node(4)))
        assert master.now() > SECOND
