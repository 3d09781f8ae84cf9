"""Simulated arms on virtual buses in virtual time, for the tests of the master. Nothing here sleeps in earnest."""

from __future__ import annotations

import functools
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

from canopen_master import Chain, ChainSettings, Host, Master, open_master, powerballs, simulate
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE, VELOCITY_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.simulation.drive.node import DriveNode
from canopen_transports import Received, TransportError, VirtualTransport, open_transport
from canopen_transports.loop import Nursery
from tests.master import loops
from tests.master.loops import loop

BUS = "virtual:test"


def virtual_time(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Run an async test on a clock that jumps to whatever is waited for, on the loop that loops.py says; it fails after a day."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        loops.run(functools.partial(test, *args, **kwargs))

    del run.__wrapped__  # type: ignore[attr-defined]  # else pytest would see a coroutine function
    run.__signature__ = inspect.signature(test)  # type: ignore[attr-defined]  # but it has to see the parameters
    return run


@asynccontextmanager
async def simulated(*node_ids: int, bus: str = BUS, makers: Sequence[Any] = ()) -> AsyncIterator[Host]:
    """Powerball joints (or other devices) on a bus, for as long as the block."""
    error: BaseException | None = None
    async with loop.open_nursery() as nursery:
        host: Host = await nursery.start(simulate, await open_transport(bus), [*powerballs(*node_ids), *makers])
        try:
            yield host
        except BaseException as raised:  # noqa: BLE001 - raised below: not through the nursery, which would make a group of it
            error = raised
        nursery.cancel_scope.cancel()
    if error is not None:
        raise error


def chain_text(*node_ids: int, bus: str = "can0") -> str:
    joints = " ".join(f"joint{number} {bus} {node_id}" for number, node_id in enumerate(node_ids, start=1))
    return f"arm {joints}\n"


def arm_of(master: Master, *node_ids: int, axes: Any = None, **settings: Any) -> Chain:
    return master.load_chains(text=chain_text(*node_ids), settings=ChainSettings(**settings), axes=axes)["arm"]


@asynccontextmanager
async def following_arm(*node_ids: int, **settings: Any) -> AsyncIterator[tuple[Host, Master, Chain]]:
    """An arm that is ready to follow set-points."""
    async with simulated(*node_ids) as host, open_master(BUS) as master:
        arm = arm_of(master, *node_ids, **settings)
        await arm.initialise()
        await arm.enable_interpolated_position()
        yield host, master, arm


def drives(host: Host) -> list[DriveNode]:
    found = [node for node in host.nodes if isinstance(node, DriveNode)]
    assert len(found) == len(host.nodes)
    return found


def value(node: DriveNode, mux: int) -> int:
    found = node.values.store[mux]
    assert isinstance(found, int)
    return found


def position_of(host: Host, node: DriveNode) -> int:
    """In counts, now."""
    node.drive.refresh(host.now())
    return value(node, POSITION_ACTUAL_VALUE)


async def assert_all_stand(host: Host) -> None:
    """No drive moves, nor will it by itself."""
    before = [position_of(host, node) for node in drives(host)]
    await loop.sleep(1)
    assert [position_of(host, node) for node in drives(host)] == before
    for node in drives(host):
        if VELOCITY_ACTUAL_VALUE in node.values.store:
            assert value(node, VELOCITY_ACTUAL_VALUE) == 0


def assert_all_halted(host: Host) -> None:
    """Each drive that is enabled was told to halt (bit 8 of its controlword)."""
    for node in drives(host):
        if node.drive.state is State.OPERATION_ENABLED:
            assert value(node, 0x6040_00) & 0x100, f"node {node.node_id} was not halted"


class Link:
    """One participant's line to a virtual bus, on which frames can be lost or doubled, either way.

    copies: how many of a frame get through; is_sent says which way. log: what did, as (time, is_sent, frame).
    """

    def __init__(self, name: str = "test") -> None:
        self._inner = VirtualTransport(name)
        self._again: list[Received] = []
        self.locator = f"link:{name}"
        self.copies: Callable[[Frame, bool], int] = lambda frame, is_sent: 1
        self.log: list[tuple[float, bool, Frame]] = []

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()
        for _ in range(self.copies(frame, True)):
            self.log.append((loop.current_time(), True, frame))
            await self._inner.send(frame)

    async def receive(self) -> Received:
        while not self._again:
            received = await self._inner.receive()
            self._again = [received] * self.copies(received[0], False)
        self.log.append((loop.current_time(), False, self._again[-1][0]))
        return self._again.pop()

    async def aclose(self) -> None:
        await self._inner.aclose()


class Breakable:
    """A virtual bus whose cable can be cut, and that can be made not to take frames. Counts what was sent."""

    def __init__(self, name: str = "test") -> None:
        self._inner = VirtualTransport(name)
        self.locator = f"breakable:{name}"
        self.is_broken = False
        self.is_stuck = False
        self.closed = 0
        self.sent: list[tuple[float, str]] = []
        self._cut = loop.event()

    def cut(self) -> None:
        self.is_broken = True
        self._cut.set()

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()
        if self.is_stuck:
            await loop.sleep_forever()
        if self.is_broken:
            raise self._error("send")
        await self._inner.send(frame)
        self.sent.append((loop.current_time(), str(frame)))

    async def receive(self) -> Received:
        if self.is_broken:
            raise self._error("receive")
        result: list[Received] = []

        async def take(nursery: Nursery) -> None:
            result.append(await self._inner.receive())
            nursery.cancel_scope.cancel()

        async with loop.open_nursery() as nursery:
            nursery.start_soon(take, nursery)
            await self._cut.wait()
            nursery.cancel_scope.cancel()
        if result:
            return result[0]
        raise self._error("receive")

    async def aclose(self) -> None:
        self.closed += 1
        await self._inner.aclose()

    def _error(self, doing: str) -> TransportError:
        return TransportError("CO111", self.locator, f"cannot {doing} on {self.locator}", seen="the cable was cut")
