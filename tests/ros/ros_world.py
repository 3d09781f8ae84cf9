"""Bridges of simulated machines in virtual time, for the tests of the ROS layer without ROS."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Final

import trio

from canopen_master.simulation.host import DeviceMaker, Host, standard_drives
from canopen_master.simulation.serving import simulated_devices
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE, VELOCITY_ACTUAL_VALUE
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_ros.bridge import Bridge, open_bridge
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.parameters import NodeParameters
from canopen_ros.simulated import on_virtual_buses
from tests.master.world import value

START = 1_000_000_000_000_000_000
"""The wall clock when trio's clock shows 0, in ns since 1970."""

AT_HOME: Final = DriveSettings(shape=Shape.SCHUNK_POWERBALL, track=Track(home_switch=(0.0, math.inf)))
"""Joints of Schunk's arm that stand at 0 at power-on, where their home switches begin."""


def wall() -> int:
    return START + round(trio.current_time() * 1e9)


def chain_text(count: int) -> str:
    return "arm " + " ".join(f"joint{number} can0 {number + 2}" for number in range(1, count + 1))


@asynccontextmanager
async def bridge_of(count: int = 2, /, **parameters: object) -> AsyncIterator[tuple[Bridge, ChainBridge]]:
    """A bridge of one simulated arm of Schunk's joints, in radians."""
    given = NodeParameters.from_mapping({"chains": chain_text(count), "simulate": True, **parameters})
    async with open_bridge(given, wall=wall) as bridge:
        yield bridge, bridge.chains["arm"]


@asynccontextmanager
async def ready_arm(count: int = 2, /, **parameters: object) -> AsyncIterator[tuple[Bridge, ChainBridge]]:
    """... that is initialised and homed."""
    async with bridge_of(count, **parameters) as (bridge, arm):
        for service in ("init", "home"):
            reply = await arm.call(service)
            assert reply.success, reply.message
        yield bridge, arm


class Cell:
    """A bridge with its chain and its simulated drives. nursery: for what runs beside the test, inside the
    bridge's block; outer: around it."""

    bridge: Bridge
    arm: ChainBridge
    nursery: trio.Nursery

    def __init__(self, hosts: Sequence[Host], outer: trio.Nursery) -> None:
        self.outer = outer
        self.hosts = tuple(hosts)
        self._is_fed = True
        self._left = trio.Event()
        self.over = trio.Event()

    async def live(self, parameters: NodeParameters, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep the bridge open until `leave`, as a node does."""
        async with open_bridge(parameters, wall=wall) as self.bridge, trio.open_nursery() as self.nursery:
            self.arm = self.bridge.chains["arm"]
            task_status.started()
            await self._left.wait()
            self.nursery.cancel_scope.cancel()
        self.over.set()

    def leave(self) -> None:
        """Leave the bridge's block, with all that runs in it. The drives live on."""
        self._left.set()

    async def ask(self, service: str) -> None:
        """Call a service that has to succeed."""
        reply = await self.arm.call(service)
        assert reply.success, reply.message

    def let_go(self) -> None:
        """Give zeros, as a joystick does that nobody touches: velocities are taken from then on."""
        self.arm.command_velocities([0.0] * len(self.arm.joints))

    def hold(self) -> None:
        """Give the positions where the joints are, as a controller does that has just begun: positions are taken from then on."""
        sample = self.bridge.sample()
        self.arm.command_positions(sample.names, sample.positions)

    async def keep_jogging(self) -> None:
        """Give velocities as a joystick does, until `stop_feeding`."""
        self.let_go()
        while self._is_fed:
            self.arm.command_velocities([0.3, -0.2])
            await trio.sleep(0.05)

    def stop_feeding(self) -> None:
        self._is_fed = False

    @property
    def drives(self) -> list[DriveNode]:
        return [node for host in self.hosts for node in host.nodes if isinstance(node, DriveNode)]

    @property
    def positions(self) -> list[int]:
        """In counts, now, as the drives have them."""
        for host in self.hosts:
            for node in host.nodes:
                if isinstance(node, DriveNode):
                    node.drive.refresh(host.now())
        return [value(node, POSITION_ACTUAL_VALUE) for node in self.drives]

    @property
    def is_moving(self) -> bool:
        self.positions  # noqa: B018 - it refreshes the drives
        return any(value(node, VELOCITY_ACTUAL_VALUE) for node in self.drives)

    def break_down(self, node_id: int, error_code: int = 0x4210) -> None:
        for host in self.hosts:
            for node in host.nodes:
                if isinstance(node, DriveNode) and node.node_id == node_id:
                    node.drive.raise_fault(error_code, host.now())
            host.pump()

    async def assert_all_stand(self) -> None:
        """No drive moves, nor will it by itself."""
        before = self.positions
        await trio.sleep(1.0)
        assert self.positions == before
        assert not self.is_moving


@asynccontextmanager
async def cell(count: int = 2, /, **parameters: object) -> AsyncIterator[Cell]:
    """A bridge of one simulated arm, with its drives in sight. SYNC at 20 ms: it saves time."""
    given = NodeParameters.from_mapping({"chains": chain_text(count), "sync_interval": 20, **parameters})
    given = replace(given, machine=on_virtual_buses(given.machine))
    failure: BaseException | None = None
    made: dict[str, list[DeviceMaker]] = {}
    for node in given.machine.nodes.values():
        made.setdefault(given.machine.buses[node.bus].locator, []).extend(standard_drives(node.node_id, settings=AT_HOME))
    async with simulated_devices(made) as simulation, trio.open_nursery() as nursery:
        world = Cell(simulation.hosts, nursery)
        await nursery.start(world.live, given)
        try:
            yield world
        except BaseException as error:  # noqa: BLE001 - raised below: the nursery would make a group of it
            failure = error
        world.leave()
        await world.over.wait()
        nursery.cancel_scope.cancel()
    if failure is not None:
        raise failure
