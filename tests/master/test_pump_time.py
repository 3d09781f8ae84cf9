"""The pump's timekeeper: what is already there counts before a timeout does."""

from __future__ import annotations

import pytest
import trio
import trio.testing

from canopen_master import BusError, open_master
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived
from canopen_transports import Received, Report, TransportError, open_transport
from tests.master.loops import jump, loop, settled
from tests.master.world import BUS, virtual_time


def test_a_heartbeat_that_came_while_the_process_was_stalled_counts() -> None:
    clock = trio.testing.MockClock()  # time goes on only where we say so

    async def main() -> None:
        async with open_master(BUS) as master, await open_transport(BUS) as device:
            node = master.node(5)
            node.supervise_heartbeat(0.5)
            with master.events(HeartbeatLost) as lost:
                await device.send(Frame(0x705, b"\x05"))
                await settled()
                jump(2.0)  # and meanwhile came:
                for _ in range(500):
                    await device.send(Frame(0x184, b"\x00\x00"))
                await device.send(Frame(0x705, b"\x05"))
                await settled()
                jump(0.4)
                await settled()
                assert lost.take() == []
                jump(0.2)
                assert (await lost.receive()).node_id == 5

    trio.run(main, clock=clock)


class Prompt:
    """A transport whose frames reach no receiver: only `receive_nowait` has them. `came` is what it returns or raises."""

    def __init__(self) -> None:
        self.came: list[Received | Report] | TransportError = []

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()

    async def receive(self) -> Received | Report:
        await loop.sleep_forever()
        raise AssertionError

    def receive_nowait(self, limit: int) -> list[Received | Report]:
        if isinstance(self.came, TransportError):
            raise self.came
        taken, self.came = self.came[:limit], self.came[limit:]
        return taken

    async def aclose(self) -> None:
        await loop.checkpoint()


@virtual_time
async def test_a_transport_that_can_tell_is_asked_what_has_come_before_a_timeout_counts() -> None:
    bus = Prompt()
    async with open_master(bus) as master:
        node = master.node(5)
        node.supervise_heartbeat(0.5)
        with master.events(HeartbeatReceived, HeartbeatLost) as told:
            bus.came = [(Frame(0x705, b"\x05"), None)]
            master.sync_start(0.1)  # at each of whose deadlines it is asked
            assert isinstance(await told.receive(), HeartbeatReceived)
            await loop.sleep(0.45)
            bus.came = [(Frame(0x181), None)] * 30 + [(Frame(0x705, b"\x05"), None)]
            assert isinstance(await told.receive(), HeartbeatReceived)


class Stalled(Prompt):
    """The process stands still for `stall` seconds right behind a look at what has come; meanwhile `meanwhile` comes."""

    def __init__(self) -> None:
        super().__init__()
        self.stall = 0.0
        self.meanwhile: list[Received | Report] = []

    def receive_nowait(self, limit: int) -> list[Received | Report]:
        taken = super().receive_nowait(limit)
        if self.stall:
            jump(self.stall)
            self.stall, self.came = 0.0, self.meanwhile
        return taken


@virtual_time
async def test_a_stall_between_the_look_at_what_has_come_and_the_timeouts_loses_no_node() -> None:
    bus = Stalled()
    async with open_master(bus) as master:
        node = master.node(5)
        node.supervise_heartbeat(0.5)
        with master.events(HeartbeatReceived, HeartbeatLost) as told:
            bus.came = [(Frame(0x705, b"\x05"), None)]
            master.sync_start(0.1)
            assert isinstance(await told.receive(), HeartbeatReceived)
            bus.meanwhile = [(Frame(0x705, b"\x05"), None)]
            bus.stall = 0.6
            assert isinstance(await told.receive(), HeartbeatReceived)
            assert isinstance(await told.receive(), HeartbeatLost)  # 0.5 s later: nothing came any more


@virtual_time
async def test_a_bus_that_fails_when_it_is_asked_has_failed() -> None:
    bus = Prompt()
    with pytest.raises(BusError, match="broken"):
        async with open_master(bus) as master:
            bus.came = TransportError("CO111", "prompt", "broken")
            master.sync_start(0.01)
            await loop.sleep_forever()
