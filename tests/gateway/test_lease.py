"""The lease: who moves the machine, for how long, and what happens at its end. In virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from canopen_gateway import GatewayService, GatewaySession, LeaseError, NotAllowedError
from canopen_gateway.lease import LEASE_TIME
from canopen_master import Chain, ChainHaltedError, ChainState, Host, open_master
from canopen_master.simulation.host import standard_drives
from canopen_proto import LocalNode, SdoAborted
from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.objects import VELOCITY_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import POWERED, State, state_of
from canopen_proto.machine import MILLISECOND
from canopen_proto.multiplexer import index_of
from canopen_proto.nmt import NmtCommand
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_transports import open_transport
from tests.core.devices import io_device
from tests.gateway.gateway_world import TextClient, gateway
from tests.master.test_several_axes import SHOULDER, TWO, chain_of, two_axes
from tests.master.world import BUS, arm_of, assert_all_halted, assert_all_stand, drives, position_of, value, virtual_time


@asynccontextmanager
async def machine(allow: str = "motion") -> AsyncIterator[tuple[Host, GatewayService, Chain]]:
    """An arm of two joints that nobody has given power, and its gateway."""
    async with gateway(3, 4, allow=allow) as (host, service):
        yield host, service, arm_of(service.master, 3, 4)


class Owner:
    """A client that moves the machine, and shows that it lives."""

    def __init__(self, service: GatewayService, session: GatewaySession) -> None:
        self.lease = service.lease
        self.session = session
        self.number = 0

    def next(self) -> int:
        self.number += 1
        return self.number

    async def hold(self, seconds: float) -> None:
        """Renew the lease for so long."""
        end = trio.current_time() + seconds
        while trio.current_time() < end:
            self.lease.renew(self.session, self.next())
            await trio.sleep(0.1)

    async def ready(self, arm: Chain) -> None:
        """Take the lease, and give the arm power."""
        self.lease.take(self.session)
        self.lease.enable(self.session, self.next(), arm.name)
        while self.lease.doing:
            await self.hold(0.1)
        assert arm.state is ChainState.FOLLOWING, self.lease.problem


def is_moving(host: Host) -> bool:
    for node in drives(host):
        node.drive.refresh(host.now())
    return any(value(node, VELOCITY_ACTUAL_VALUE) for node in drives(host))


@virtual_time
async def test_a_jog_moves_while_it_is_renewed_and_the_lease_ends_by_itself() -> None:
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            await owner.ready(arm)
            before = position_of(host, drives(host)[0])
            for _ in range(10):
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
                await trio.sleep(0.1)
            assert is_moving(host)
            assert position_of(host, drives(host)[0]) > before
            await trio.sleep(LEASE_TIME - 0.1 - 0.001)  # the last message is 0.1 s old
            assert owner.lease.owner is session
            await trio.sleep(0.002)
            assert owner.lease.left == 0
            await trio.sleep(2)
            assert owner.lease.owner is None
            assert arm.state is ChainState.HALTED
            assert_all_halted(host)
            await assert_all_stand(host)
            assert owner.lease.problem == "the lease is over"


@virtual_time
async def test_the_chain_brakes_by_its_own_switch_if_the_lease_is_renewed_and_the_jog_is_not() -> None:
    """Two switches: signs of life alone move nothing."""
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            await owner.ready(arm)
            owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            await owner.hold(0.2)
            assert is_moving(host)
            await owner.hold(3)
            assert not is_moving(host)
            assert owner.lease.owner is session


@virtual_time
@pytest.mark.parametrize("renewed", [False, True])
async def test_however_long_the_joints_need_to_begin_a_jog_that_was_let_go_moves_nothing(renewed: bool) -> None:
    """The lease is renewed meanwhile: somebody is there, and holds no button."""
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            await Owner(service, session).ready(arm)
            service.lease.leave(session)
            await trio.sleep(3)
            assert arm.state is ChainState.HALTED
            owner = Owner(service, session)
            owner.lease.take(session)
            drives(host)[0].answer(0x6060, 0, Answer(delay=400 * MILLISECOND))
            before = position_of(host, drives(host)[0])
            owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            while arm.state is not ChainState.FOLLOWING:
                if renewed:
                    owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
                    await trio.sleep(0.1)
                else:
                    await owner.hold(0.1)
            await owner.hold(0.5)
            assert (position_of(host, drives(host)[0]) > before) is renewed


@virtual_time
async def test_a_move_goes_on_while_it_is_renewed_and_brakes_when_its_owner_is_gone() -> None:
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            await owner.ready(arm)
            owner.lease.move(session, owner.next(), "arm", [1.0, 0.5], speed=0.3)
            await owner.hold(0.5)
            assert is_moving(host)
            with pytest.raises(LeaseError, match="under way: move"):
                owner.lease.move(session, owner.next(), "arm", [0.0, 0.0])
        await trio.sleep(3)  # its connection has ended
        assert service.lease.owner is None
        assert arm.state is ChainState.HALTED
        assert_all_halted(host)
        await assert_all_stand(host)


@virtual_time
async def test_a_move_comes_to_its_target() -> None:
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            await owner.ready(arm)
            target = [each + 0.05 for each in arm.positions]
            owner.lease.move(session, owner.next(), "arm", target)
            while owner.lease.doing:
                await owner.hold(0.1)
            assert owner.lease.problem == ""
            assert arm.positions == pytest.approx(target, abs=1e-3)
            owner.lease.disable(session, owner.next(), "arm")
            while owner.lease.doing:
                await owner.hold(0.1)
            assert arm.state is ChainState.OFF
            assert all(node.drive.state is not State.OPERATION_ENABLED for node in drives(host))


@virtual_time
async def test_one_owner_at_a_time() -> None:
    async with machine("motion,write") as (_, service, _):
        with service.open_session("hand") as one, service.open_session("other") as other:
            service.lease.take(one)
            service.lease.take(one)
            for refused in (
                lambda: service.lease.take(other),
                lambda: service.lease.renew(other, 1),
                lambda: service.lease.enable(other, 1, "arm"),
                lambda: service.lease.jog(other, 1, "arm", [0, 0]),
                lambda: service.lease.move(other, 1, "arm", [0, 0]),
                lambda: service.lease.stop(other, 1),
                lambda: service.lease.disable(other, 1, "arm"),
            ):
                with pytest.raises(LeaseError):
                    refused()
            service.lease.leave(other)  # not its own
            assert service.lease.owner is one
            # single writes that move something are refused, too; others are not
            client = TextClient(other)
            assert (await client.say("[1] 3 w 0x6040 0 u16 6")).startswith(
                "[1] ERROR:102 #writing 0x6040:00 was refused: hand moves"
            )
            assert await client.say("[2] 3 w 0x1017 0 u16 100") == "[2] OK"
            service.lease.leave(one)
            await trio.sleep(0.01)
            assert await client.say("[3] 3 w 0x6040 0 u16 6") == "[3] OK"
            service.lease.take(other)


@virtual_time
async def test_an_old_message_moves_nothing() -> None:
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session, service.open_session("another") as other:
            owner = Owner(service, session)
            await owner.ready(arm)
            owner.lease.jog(session, 1000, "arm", [0.0, 0.0])
            for client, number in ((session, 1000), (session, 999), (session, 1), (other, 1001)):
                with pytest.raises(LeaseError, match="old message|does not have the lease"):
                    owner.lease.jog(client, number, "arm", [0.1, 0.0])  # while the jog begins, too
            left = owner.lease.left
            await trio.sleep(0.05)
            with pytest.raises(LeaseError, match="old message"):
                owner.lease.renew(session, 1000)
            assert owner.lease.left == pytest.approx(left - 0.05)  # an old one is no sign of life
            await trio.sleep(0.15)
            assert owner.lease.doing == "jog"
            assert not is_moving(host)


@virtual_time
async def test_a_lease_that_is_over_takes_no_messages() -> None:
    async with machine() as (_, service, _):
        with service.open_session("hand") as session:
            service.lease.take(session)
            await trio.sleep(LEASE_TIME)
            with pytest.raises(LeaseError, match="not any more"):
                service.lease.renew(session, 1)
            await trio.sleep(0.01)
            service.lease.take(session)  # and may be taken again
            service.lease.renew(session, 1)


@virtual_time
async def test_without_permission_nobody_has_it_and_everybody_may_halt() -> None:
    async with machine(allow="write") as (host, service, arm):
        with service.open_session("hand") as session:
            with pytest.raises(NotAllowedError, match="--allow motion"):
                service.lease.take(session)
            await arm.initialise()
            await arm.follow()

            async def moved() -> None:
                with pytest.raises(ChainHaltedError):
                    await arm.move([2.0, 2.0], speed=0.2)

            async with trio.open_nursery() as nursery:
                nursery.start_soon(moved)
                await trio.sleep(0.5)
                assert is_moving(host)
                assert await TextClient(session).say("[1] _halt") == "[1] OK"
                assert not is_moving(host)
            assert arm.state is ChainState.HALTED
            assert_all_halted(host)


@virtual_time
@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.2, 0.3])
async def test_a_halt_ends_what_a_program_beside_the_gateway_is_about_to_begin(seconds: float) -> None:
    """Whoever halts is told that all stands: the program gives its chain no power behind that."""
    async with machine() as (host, service, arm), trio.open_nursery() as nursery:
        answers_in_5_ms(host)

        async def program() -> None:
            begun.set()
            with pytest.raises(ChainHaltedError):
                await arm.initialise()

        begun = trio.Event()
        nursery.start_soon(program)
        await begun.wait()
        await trio.sleep(seconds)
        assert arm.state is ChainState.OFF
        assert await service.halt() == []
        await trio.sleep(3)
        assert all(node.drive.state not in POWERED for node in drives(host))


@virtual_time
async def test_a_drive_that_single_writes_have_enabled_is_halted_too() -> None:
    async with gateway(3, 4, allow="motion,nmt") as (host, service):
        with service.open_session("hand") as session:
            client = TextClient(session)
            for word in ("0x80", "6", "7", "0xF"):
                await client.say(f"[1] 3 w 0x6040 0 u16 {word}")
                await trio.sleep(0.6)
            assert drives(host)[0].drive.state is State.OPERATION_ENABLED
            assert await client.say("[2] 4 _halt") == "[2] OK"  # another node
            assert not value(drives(host)[0], 0x6040_00) & 0x100
            assert await client.say("[3] _halt") == "[3] OK"
            assert value(drives(host)[0], 0x6040_00) & 0x100
            assert (await client.say("[4] 9 _halt")).startswith("[4] ERROR:102 #node 9 on")


@virtual_time
async def test_a_gateway_that_ends_halts_what_its_client_moves() -> None:
    from canopen_gateway import open_gateway, parse_permissions
    from canopen_master import open_master
    from tests.master.world import BUS, simulated

    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        async with open_gateway(master, allow=parse_permissions("motion")) as service:
            with service.open_session("hand") as session:
                owner = Owner(service, session)
                await owner.ready(arm)
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.1])
                await owner.hold(0.2)
                assert is_moving(host)
        assert arm.state is ChainState.HALTED
        assert_all_halted(host)
        await assert_all_stand(host)


@virtual_time
@pytest.mark.parametrize("way", ["leaves", "stops", "is silent"])
@pytest.mark.parametrize("state", [State.SWITCHED_ON, State.OPERATION_ENABLED])
async def test_whenever_the_owner_goes_away_no_drive_is_left_with_power_and_without_a_halt(way: str, state: State) -> None:
    """Its joints were on their way to power; the chain is not initialised yet."""
    async with machine() as (host, service, arm):
        answers_in_5_ms(host)
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            owner.lease.take(session)
            owner.lease.enable(session, owner.next(), "arm")
            while drives(host)[0].drive.state is not state:
                owner.lease.renew(session, owner.next())
                await trio.sleep(0.001)
            assert arm.state is ChainState.OFF
            if way == "leaves":
                owner.lease.leave(session)
            elif way == "stops":
                owner.lease.stop(session, owner.next())
            await trio.sleep(3)
            assert owner.lease.owner is None
            assert owner.lease.problem == "the lease is over"
            assert_all_halted(host)


@virtual_time
async def test_of_two_drives_on_one_node_each_is_halted_though_the_other_refuses() -> None:
    async with gateway(allow="motion", makers=[two_axes]) as (host, service):
        arm = chain_of(service.master, *SHOULDER)
        (node,) = drives(host)
        for index in (0x6040, 0x6041, 0x6840, 0x6841):
            node.answer(index, 0, Answer(delay=5 * MILLISECOND))
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            owner.lease.take(session)
            owner.lease.enable(session, owner.next(), "arm")
            while any(state_of(value(node, key)) is not State.OPERATION_ENABLED for key in (0x6041_00, 0x6841_00)):
                owner.lease.renew(session, owner.next())
                await trio.sleep(0.001)
            assert arm.state is ChainState.OFF
            node.answer(0x6040, 0, Answer(abort=AbortCode.GENERAL_ERROR))
            owner.lease.leave(session)
            await trio.sleep(8)
            assert value(node, 0x6840_00) & 0x100
            assert owner.lease.problem.startswith("the lease is over; node 3 on")
        node.answer(0x6040, 0, Answer())


@virtual_time
async def test_what_did_not_confirm_that_it_stands_is_told_until_it_is_moved_itself() -> None:
    async with gateway(3, 4, allow="motion") as (host, service):
        arm = arm_of(service.master, 3)
        leg = service.master.load_chains(text=f"leg joint4 {service.nets[0]} 4")["leg"]
        lease = service.lease
        with service.open_session("hand") as session, service.open_session("other") as other:
            owner, next_owner = Owner(service, session), Owner(service, other)
            node = drives(host)[0]
            for index in (0x6040, 0x6041):
                node.answer(index, 0, Answer(delay=5 * MILLISECOND))
            lease.take(session)
            lease.enable(session, owner.next(), "arm")
            while state_of(value(node, 0x6041_00)) is not State.OPERATION_ENABLED:
                lease.renew(session, owner.next())
                await trio.sleep(0.001)
            assert arm.state is ChainState.OFF
            node.answer(0x6040, 0, Answer(abort=AbortCode.GENERAL_ERROR))
            lease.leave(session)
            await trio.sleep(8)
            assert lease.problem.startswith("the lease is over; node 3 on"), lease.problem
            told = lease.problem.removeprefix("the lease is over; ")
            await next_owner.ready(leg)  # another chain
            assert lease.problem == told
            lease.jog(other, next_owner.next(), "leg", [0.0])
            assert lease.problem == told
            await next_owner.hold(0.2)
            lease.stop(other, next_owner.next())
            await next_owner.hold(0.5)
            with pytest.raises(LeaseError, match="no chain 'tail'"):
                lease.move(other, next_owner.next(), "tail", [0.0])
            lease.move(other, next_owner.next(), "leg", [0.0, 0.0])  # which fails
            await next_owner.hold(0.1)
            assert lease.problem.endswith(f"; {told}")
            assert not lease.problem.startswith("node 3")
            lease.leave(other)
            await trio.sleep(3)
            assert lease.problem == f"the lease is over; {told}"
            node.answer(0x6040, 0, Answer())
            await next_owner.ready(arm)
            assert lease.problem == ""


@virtual_time
async def test_a_motion_that_fails_is_told_and_ends_nothing_else() -> None:
    async with machine() as (_, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            owner.lease.take(session)
            with pytest.raises(LeaseError, match="no chain 'leg'"):
                owner.lease.move(session, owner.next(), "leg", [0, 0])
            owner.lease.move(session, owner.next(), "arm", [0, 0])  # it has no power
            await owner.hold(0.1)
            assert owner.lease.problem
            assert owner.lease.owner is session
            await owner.ready(arm)
            owner.lease.jog(session, owner.next(), "arm", [0.1, 0.1])
            await owner.hold(0.1)
            with pytest.raises(LeaseError, match="does not jog"):
                owner.lease.jog(session, owner.next(), "arm", [0.1])
            owner.lease.stop(session, owner.next())
            await owner.hold(1)
            assert owner.lease.doing == ""
            assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_somebodys_halt_holds_though_the_owner_goes_on_sending() -> None:
    """Whoever halts is told that all stands. It stays so, until the machine is taken, and given power, anew."""
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session, service.open_session("somebody") as somebody:
            owner = Owner(service, session)
            await owner.ready(arm)
            for _ in range(10):
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
                await trio.sleep(0.05)
            assert is_moving(host)
            problems: list[str] = []

            async def halt() -> None:
                problems.extend(await somebody.service.halt())

            async with trio.open_nursery() as nursery:
                nursery.start_soon(halt)
                for _ in range(60):
                    await trio.sleep(0.05)
                    with pytest.raises(LeaseError):
                        owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
                    with pytest.raises(LeaseError):
                        owner.lease.move(session, owner.next(), "arm", [1.0, 0.0])
            assert problems == []
            assert not is_moving(host)
            assert_all_halted(host)
            assert service.lease.owner is None
            assert service.lease.problem == "somebody has halted the machine"
            service.lease.take(session)
            owner.number = 0
            with pytest.raises(LeaseError, match="was halted"):
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            await owner.ready(arm)
            owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            await owner.hold(0.2)
            assert is_moving(host)


@virtual_time
async def test_power_that_was_only_asked_for_ends_nobodys_halt() -> None:
    """A halted chain has power still: who ends `enable` at once has not looked whether it may move again."""
    async with machine() as (host, service, arm):
        with service.open_session("hand") as session:
            owner = Owner(service, session)
            await owner.ready(arm)
            await service.halt()
            await trio.sleep(1)
            service.lease.take(session)
            owner.number = 0
            owner.lease.enable(session, owner.next(), "arm")
            owner.lease.stop(session, owner.next())
            await owner.hold(0.3)
            assert owner.lease.doing == ""
            with pytest.raises(LeaseError, match="was halted"):
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            await owner.hold(0.5)
            assert not is_moving(host)
            assert_all_halted(host)


async def sends(session: GatewaySession, command: NmtCommand, node_id: int) -> bool:
    """Whether an NMT command is sent."""
    try:
        await session.nmt(session.service.nets[0], command, node_id)
    except LeaseError as refused:
        assert "halt" in " ".join(refused.tries)
        return False
    return True


@virtual_time
@pytest.mark.parametrize("command", list(NmtCommand))
async def test_nobody_else_takes_the_ground_from_what_the_owner_moves(command: NmtCommand) -> None:
    heard: list[str] = []
    async with gateway(3, 4, 5, allow="motion,nmt", heard=heard) as (_, service):
        arm = arm_of(service.master, 3, 4)
        with service.open_session("hand") as one, service.open_session("other") as other:
            owner = Owner(service, one)
            owner.lease.take(one)
            owner.lease.enable(one, owner.next(), "arm")
            assert not await sends(other, command, 3)  # on its way to power
            while owner.lease.doing:
                await owner.hold(0.1)
            owner.lease.jog(one, owner.next(), "arm", [0.1, 0.0])
            heard.clear()
            assert not await sends(other, command, 3)
            assert not await sends(other, command, 0)  # of all
            assert not [each for each in heard if each.startswith("000#")]
            assert await sends(other, command, 5)  # which is no joint of it
            owner.lease.stop(one, owner.next())
            await owner.hold(1)
            assert arm.state is ChainState.FOLLOWING
            assert await sends(one, command, 3)  # the owner may


@virtual_time
async def test_a_drive_with_power_takes_nmt_commands_from_the_owner_of_the_lease_only() -> None:
    async with gateway(3, 4, allow="motion,nmt,program,lss") as (_, service):
        with service.open_session("hand") as one, service.open_session("other") as other:
            client = TextClient(one)
            for word in ("0x80", "6", "7", "0xF"):
                assert await client.say(f"[1] 3 w 0x6040 0 u16 {word}") == "[1] OK"
                await trio.sleep(0.6)
            assert (await client.say("[2] 3 reset node")).startswith("[2] ERROR:102 #NMT reset node of node 3")
            assert (await client.say("[2] 0 reset node")).startswith("[2] ERROR:102")
            assert (await client.say("[2] lss_activate_bitrate 100")).startswith("[2] ERROR:102 #another bit rate of node 3")
            for index in (0x1F51, 0x1F82):  # which do the same by another way
                assert (await client.say(f"[3] 3 w {index:#x} 1 u8 0")).startswith(f"[3] ERROR:102 #writing 0x{index:04X}:01")
            assert await sends(one, NmtCommand.STOP, 4)
            assert not await sends(other, NmtCommand.STOP, 3)
            await service.halt()
            assert not await sends(other, NmtCommand.STOP, 3)  # it stands, and has power: an axis may fall
            service.lease.take(other)
            assert not await sends(one, NmtCommand.STOP, 3)
            await trio.sleep(1)  # the lease is over
            assert await client.say("[4] 3 w 0x6040 0 u16 6") == "[4] OK"
            await trio.sleep(0.6)
            assert await client.say("[5] lss_activate_bitrate 100") == "[5] OK"
            assert await sends(other, NmtCommand.STOP, 3)


@virtual_time
async def test_nobody_elses_node_guarding_stops_a_chain() -> None:
    """Its joints send heartbeats, so they do not answer it, and would count as lost."""
    async with machine("motion,nmt") as (host, service, arm):
        await service.master.node(3).write_bytes(0x1017, 0, b"\x64\0")
        with service.open_session("hand") as session, service.open_session("other") as other:
            owner = Owner(service, session)
            await owner.ready(arm)
            owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
            answer = await TextClient(other).say("[1] 3 enable guarding 10 1")
            await owner.hold(0.25)
            assert is_moving(host)
            assert answer.startswith("[1] ERROR:102 #node guarding of node 3 on")


@pytest.mark.parametrize("by_gateway", [True, False])
@virtual_time
async def test_node_guarding_that_a_client_has_begun_before_stops_no_chain(by_gateway: bool) -> None:
    """It ends when a chain begins to use the node, and all that wanted it are told."""
    async with machine("motion,nmt") as (host, service, arm):
        remote = service.master.node(3).remote
        await service.master.node(3).write_bytes(0x1017, 0, b"\x64\0")  # so it does not answer
        with service.open_session("hand") as session, service.open_session("one") as one, service.open_session("other") as other:
            clients = [TextClient(one), TextClient(other)]
            for client in clients:
                assert await client.say("[1] 3 enable guarding 1000 3") == "[1] OK"
            owner = Owner(service, session)
            if by_gateway:
                await owner.ready(arm)
            else:  # a program beside the gateway
                await arm.initialise()
                await arm.follow()
                owner.lease.take(session)
                owner.lease.enable(session, owner.next(), "arm")
                await owner.hold(1)
            for client in clients:
                assert await client.event() == "1 3 ERROR 200 (Lost guarding message.)"
            for _ in range(40):
                owner.lease.jog(session, owner.next(), "arm", [0.1, 0.0])
                await trio.sleep(0.1)
            assert is_moving(host)
            assert not remote.guarding.guard_time
            assert (await clients[0].say("[2] 3 disable guarding")).startswith("[2] ERROR:102")
        assert not service.sessions


@virtual_time
async def test_no_client_ends_the_node_guarding_that_this_master_does_for_itself() -> None:
    async with machine("nmt") as (_, service, _):
        guarding = service.master.node(4).remote.guarding
        service.master.node(4).start_guarding(0.1)
        with service.open_session("other") as other:
            client = TextClient(other)
            for line in ("4 disable guarding", "4 enable guarding 60000 255"):
                assert (await client.say(f"[1] {line}")).startswith("[1] ERROR:102 #node guarding of node 4 on")
        assert guarding.guard_time == 100 * MILLISECOND


@virtual_time
async def test_node_guarding_ends_with_the_last_client_that_wants_it() -> None:
    async with machine("nmt") as (_, service, _):
        guarding = service.master.node(4).remote.guarding
        with service.open_session("one") as one:
            with service.open_session("other") as other:
                for session in (one, other):
                    session.guard_node(service.nets[0], 4, 0.1, 3)
            assert guarding.guard_time
        assert not guarding.guard_time


@virtual_time
async def test_the_owner_of_the_lease_may_reset_a_drive_with_power() -> None:
    async with machine("motion,nmt") as (_, service, arm):
        with service.open_session("hand") as one:
            owner = Owner(service, one)
            await owner.ready(arm)
            assert await sends(one, NmtCommand.RESET_NODE, 3)
            assert await sends(one, NmtCommand.RESET_NODE, 0)


@virtual_time
async def test_a_drive_with_a_fault_may_be_reset_by_everybody() -> None:
    async with machine("motion,nmt") as (host, service, arm):
        with service.open_session("hand") as one, service.open_session("other") as other:
            owner = Owner(service, one)
            await owner.ready(arm)
            drives(host)[0].raise_fault(0x2310, host.now())
            owner.lease.leave(one)
            await trio.sleep(3)
            assert arm.state is ChainState.FAULT
            assert await sends(other, NmtCommand.RESET_NODE, 3)


@virtual_time
@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("node_id", [0, 3])
async def test_a_drive_to_which_another_program_has_given_power_is_asked(node_id: int, lost: bool) -> None:
    """This gateway was started beside it, and has never heard of the drive's state. lost: the first answer is."""
    async with gateway(3, 4, allow="nmt") as (host, service), open_master(await open_transport(BUS)) as program:
        await service.find_nodes(service.nets[0])
        for word in (0x80, 0x6, 0x7, 0xF):
            await program.node(3).write("controlword", word)
            await trio.sleep(0.6)
        assert drives(host)[0].drive.state is State.OPERATION_ENABLED
        with service.open_session("other") as other, service.master.events(SdoAborted) as failed:
            if lost:
                drives(host)[0].answer(0x6041, 0, Answer(delay=30_000 * MILLISECOND))
            async with trio.open_nursery() as nursery:

                async def reset() -> None:
                    assert not await sends(other, NmtCommand.RESET_NODE, node_id)

                nursery.start_soon(reset)
                await trio.sleep(0.1)
                drives(host)[0].answer(0x6041, 0, Answer())
            assert [each.abort_code for each in failed.take() if each.node_id == 3] == [AbortCode.TIMED_OUT] * lost
            assert await sends(other, NmtCommand.RESET_NODE, 4)


@virtual_time
async def test_each_axis_that_a_node_may_have_is_asked_for_its_power() -> None:
    """This gateway knows from the node's dictionary that it has two, and uses neither."""
    async with gateway(allow="nmt", makers=[two_axes]) as (host, service), open_master(await open_transport(BUS)) as program:
        service.master.node(3, TWO)
        for word in (0x80, 0x6, 0x7, 0xF):
            await program.node(3, TWO).write((0x6840, 0), word)
            await trio.sleep(0.6)
        (node,) = drives(host)
        assert state_of(value(node, 0x6841_00)) is State.OPERATION_ENABLED
        with service.open_session("other") as other:
            assert not await sends(other, NmtCommand.RESET_NODE, 3)


# ---- drives that nobody here has given power ----

POWER = (0x6, 0x7, 0xF)


@asynccontextmanager
async def beside_another_program(*words: int, velocity: int = 0) -> AsyncIterator[tuple[DriveNode, GatewayService, TextClient]]:
    """A drive in mode pv (node 5), a device that is no drive (node 7), and their gateway. words: controlwords that another
    program has given the drive. velocity: its target, by that program."""
    makers = [*standard_drives(5, settings=DriveSettings(track=Track(-1e9, 1e9))), lambda out: LocalNode(out, 7, io_device())]
    async with gateway(allow="motion,nmt", makers=makers) as (host, service), open_master(await open_transport(BUS)) as program:
        node = program.node(5)
        await node.write_bytes(0x6060, 0, b"\3")
        await program.nmt_start(5)
        await node.write_bytes(0x60FF, 0, velocity.to_bytes(4, "little"))
        for word in (0x80, *words):
            await node.write("controlword", word)
            await trio.sleep(0.6)
        await service.find_nodes(service.nets[0])
        drive = host.nodes[0]
        assert isinstance(drive, DriveNode)
        with service.open_session("hand") as session:
            yield drive, service, TextClient(session)


async def moves(drive: DriveNode) -> bool:
    await trio.sleep(0.6)
    return value(drive, VELOCITY_ACTUAL_VALUE) != 0


@virtual_time
async def test_whoever_gave_a_drive_power_a_halt_stops_what_a_client_has_set_moving() -> None:
    async with beside_another_program(*POWER) as (drive, service, client):
        await service.halt()
        assert not value(drive, 0x6040_00) & 0x100  # nobody here has commanded it
        assert await client.say("[1] 5 w 0x60FF 0 i32 20000") == "[1] OK"
        assert await moves(drive)
        assert await service.halt() == []
        assert not await moves(drive)


@virtual_time
async def test_a_halt_stops_what_a_client_has_set_moving_by_a_pdo() -> None:
    async with beside_another_program(velocity=20_000) as (drive, service, client):
        assert await client.say("[1] set tpdo 1 0x205 event 1 u16") == "[1] OK"
        for word in POWER:
            assert await client.say(f"[2] w pdo 1 1 {word}") == "[2] OK"
            await trio.sleep(0.6)
        assert await moves(drive)
        assert await service.halt(service.nets[0]) == []  # and node 7 is no drive
        assert not await moves(drive)


@virtual_time
async def test_what_a_client_has_set_moving_and_is_silent_is_named_by_a_halt() -> None:
    async with beside_another_program(*POWER) as (drive, service, client):
        assert await client.say("[1] 5 w 0x60FF 0 i32 20000") == "[1] OK"
        drive.answer(0x6041, 0, Answer(delay=60_000 * MILLISECOND))
        (problem,) = await service.halt()
        assert problem.startswith("node 5 on")
        drive.answer(0x6041, 0, Answer())


# ---- beside clients that do not wait ----


def answers_in_5_ms(host: Host) -> None:
    """As real drives do: more than the shortest time-out of a client, and far less than the master's."""
    for node in drives(host):
        for key in (objects.CONTROLWORD, objects.STATUSWORD, objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY):
            node.answer(index_of(key), 0, Answer(delay=5 * MILLISECOND))


@asynccontextmanager
async def impatient_reader(service: GatewayService, node_id: int) -> AsyncIterator[None]:
    """A client that may only read asks a drive for its state while the block runs, and waits 1 ms for each answer."""
    with service.open_session("a reader") as session:
        client = TextClient(session)
        assert await client.say("[1] set sdo_timeout 1") == "[1] OK"

        async def read() -> None:
            while True:
                await client.say(f"[2] {node_id} r 0x6041 0 u16")
                await trio.sleep(0.001)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(read)
            yield
            nursery.cancel_scope.cancel()


@asynccontextmanager
async def running_drive(**options: Any) -> AsyncIterator[tuple[Host, GatewayService]]:
    """A gateway, and a drive on node 5 that runs at a velocity (pv): a client has said so, by single writes."""
    makers = standard_drives(5, settings=DriveSettings(track=Track(-1e9, 1e9)))
    async with gateway(allow="motion,nmt", makers=makers, **options) as (host, service):
        with service.open_session("hand") as session:
            client = TextClient(session)
            await client.say("[1] 5 w 0x6060 0 i8 3")
            for word in ("0x80", "6", "7", "0xF"):
                assert await client.say(f"[1] 5 w 0x6040 0 u16 {word}") == "[1] OK"
                await trio.sleep(0.6)
            assert await client.say("[1] 5 w 0x60FF 0 i32 20000") == "[1] OK"
            await trio.sleep(0.6)
        assert is_moving(host)
        yield host, service


@virtual_time
async def test_however_little_a_reader_waits_a_halt_stops_the_drive_and_is_confirmed() -> None:
    async with running_drive() as (host, service):
        answers_in_5_ms(host)
        async with impatient_reader(service, 5):
            await trio.sleep(0.1)
            assert await service.halt() == []
            assert not is_moving(host)


@virtual_time
async def test_however_little_a_reader_waits_the_owner_gives_power() -> None:
    async with machine() as (host, service, arm):
        answers_in_5_ms(host)
        with service.open_session("hand") as session:
            async with impatient_reader(service, 3):
                await Owner(service, session).ready(arm)


@virtual_time
async def test_however_little_a_client_waits_the_drive_is_asked_whether_it_has_power() -> None:
    async with gateway(3, allow="program") as (host, service), open_master(await open_transport(BUS)) as program:
        await service.find_nodes(service.nets[0])
        for word in (0x80, 0x6, 0x7, 0xF):
            await program.node(3).write("controlword", word)
            await trio.sleep(0.6)
        answers_in_5_ms(host)
        with service.open_session("other") as session:
            client = TextClient(session)
            await client.say("[1] set sdo_timeout 1")
            assert (await client.say("[2] 3 w 0x1F51 1 u8 0")).startswith("[2] ERROR:102 #writing 0x1F51:01 of node 3")


# ---- a halt, and what waits ----

SLOW = 0x1018, 4
"""An object that a device takes half a minute to tell, for a client that waits so long."""


@asynccontextmanager
async def slow_read(host: Host, service: GatewayService) -> AsyncIterator[None]:
    """A client that may only read has asked node 5 for SLOW, and waits for it."""
    node = host.nodes[0]
    assert isinstance(node, DriveNode)
    node.answer(*SLOW, Answer(delay=30_000 * MILLISECOND))
    with service.open_session("a reader") as session:
        reader = TextClient(session)
        assert await reader.say("[1] set sdo_timeout 60000") == "[1] OK"
        async with trio.open_nursery() as nursery:
            nursery.start_soon(reader.say, "[2] 5 r 0x1018 4 u32")
            await trio.sleep(0.1)
            yield
            nursery.cancel_scope.cancel()


@virtual_time
async def test_a_read_that_takes_long_holds_up_no_halt() -> None:
    async with running_drive() as (host, service), slow_read(host, service):
        before = trio.current_time()
        assert await service.halt() == []
        assert not is_moving(host)
        assert trio.current_time() - before < 2


@virtual_time
async def test_a_read_that_takes_long_holds_up_no_halt_of_what_another_program_has_given_power() -> None:
    async with beside_another_program(*POWER) as (drive, service, client):
        assert await client.say("[1] 5 w 0x60FF 0 i32 20000") == "[1] OK"
        assert await moves(drive)
        async with slow_read(SimpleNamespace(nodes=[drive]), service):  # type: ignore[arg-type]
            assert await service.halt() == []
            assert not await moves(drive)


@virtual_time
async def test_a_controlword_that_waited_while_its_drive_was_halted_is_not_sent_behind_the_halt() -> None:
    async with running_drive() as (host, service), slow_read(host, service):
        answers: list[str] = []

        async def say(client: TextClient) -> None:
            answers.append(await client.say("[3] 5 w 0x6040 0 u16 0xF"))

        with service.open_session("late") as session:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(say, TextClient(session))
                await trio.sleep(0.1)
                await service.halt(service.nets[0], 4)  # another node, which is not there
                assert answers == []
                assert await service.halt() == []
            assert "was dropped: somebody has halted it" in answers[0], answers
            await trio.sleep(1)
            assert not is_moving(host)
            assert value(drives(host)[0], 0x6040_00) & 0x100
            assert await TextClient(session).say("[4] 5 w 0x6040 0 u16 0xF") == "[4] OK"  # whoever says so now means it


@pytest.mark.parametrize("seconds", [0.001, 0.1, 0.25])
@pytest.mark.parametrize("halt", ["_halt", "1 5 _halt"])
@virtual_time
async def test_a_halt_ends_a_controlword_that_waits_until_its_drive_watches_the_master(halt: str, seconds: float) -> None:
    makers = standard_drives(5, settings=DriveSettings(track=Track(-1e9, 1e9)))
    async with gateway(allow="motion", makers=makers) as (host, service):
        with service.open_session("hand") as session, service.open_session("other") as other:
            client, answers = TextClient(session), list[str]()
            for line in ("0x6060 0 i8 3", "0x60FF 0 i32 20000", "0x6040 0 u16 6", "0x6040 0 u16 7"):
                assert await client.say(f"[1] 5 w {line}") == "[1] OK"

            async def enable() -> None:
                answers.append(await client.say("[2] 5 w 0x6040 0 u16 0xF"))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(enable)
                await trio.sleep(seconds)
                assert await TextClient(other).say(f"[3] {halt}") == "[3] OK"
            await trio.sleep(2)
            assert answers[0].startswith("[2] ERROR:0x08000000 #a stop of its drive went before it"), answers
            assert drives(host)[0].drive.state is State.SWITCHED_ON
            assert not is_moving(host)


@virtual_time
async def test_a_controlword_of_another_client_that_waits_is_not_sent_once_somebody_has_the_lease() -> None:
    async with machine() as (host, service, _):
        with service.open_session("hand") as hand, service.open_session("owner") as owner:
            client, answers = TextClient(hand), list[str]()
            for word in ("6", "7"):
                assert await client.say(f"[1] 3 w 0x6040 0 u16 {word}") == "[1] OK"

            async def enable() -> None:
                answers.append(await client.say("[2] 3 w 0x6040 0 u16 0xF"))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(enable)
                await trio.sleep(0.05)
                service.lease.take(owner)
            assert answers[0].startswith("[2] ERROR:0x08000000"), answers
            assert drives(host)[0].drive.state is State.SWITCHED_ON
            service.lease.leave(owner)
