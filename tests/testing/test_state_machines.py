"""The two state machines of strategies/machines.py: right devices and masters pass, planted bugs are found in few steps."""

from __future__ import annotations

import re
from collections.abc import Collection

import pytest
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test
from hypothesis.strategies import SearchStrategy

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import NodeBooted
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Event, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.procedures.objects import read, write
from canopen_proto.procedures.steps import Procedure, sleep
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.access import Pending
from canopen_proto.testing import World
from canopen_testing.strategies import (
    MasterAgainstDevice,
    MasterAgainstDevices,
    PlannedDevice,
    device_dictionaries,
    networks,
)
from tests.core.devices import OUTPUT, TEXT, io_device
from tests.examples import examples


class OurDevice(MasterAgainstDevice):
    dictionary = io_device(heartbeat_ms=100)
    kept = (OUTPUT, TEXT)


def steps_of_failure(machine: type[RuleBasedStateMachine], match: str) -> list[str]:
    """Run a machine that fails; return the rules of the smallest example."""
    with pytest.raises(AssertionError, match=match) as caught:
        run_state_machine_as_test(machine, settings=examples(100, steps=8, least=100, explain=False))
    notes = "\n".join(caught.value.__notes__)
    return [step for step in re.findall(r"state\.(\w+)\(", notes) if step not in INVARIANTS]


INVARIANTS = ("teardown", "nothing_is_wrong_on_the_bus", "its_state_is_shown", "the_master_did_nothing_wrong")


def test_our_device_does_nothing_wrong() -> None:
    run_state_machine_as_test(OurDevice, settings=examples(50, steps=15))


# ---- devices with bugs ----


class Swapped(LocalNode):
    """Stores what it gets with the bytes the other way round."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return super().write(index, subindex, data[::-1] if index == OUTPUT else data, now)


class TakesAll(LocalNode):
    """Says yes to objects that it does not have."""

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        answer = super().check_write(index, subindex, size)
        return None if answer is AbortCode.NO_SUCH_OBJECT else answer

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        answer = super().write(index, subindex, data, now)
        return None if answer is AbortCode.NO_SUCH_OBJECT else answer


class NeverStarts(LocalNode):
    """Stays pre-operational when it is told to start."""

    def receive(self, frame: Frame, now: Time) -> None:
        is_start = frame.can_id == 0 and frame.data[0] == NmtCommand.START
        if not (is_start and self.state is NmtState.PRE_OPERATIONAL):
            super().receive(frame, now)


class ObeysNeighbour(LocalNode):
    """Takes commands for node 6 as its own."""

    def receive(self, frame: Frame, now: Time) -> None:
        neighbours = frame.can_id == 0 and frame.data[1:] == b"\x06"
        super().receive(Frame(0, frame.data[:1] + b"\x05") if neighbours else frame, now)


class HangsInReset(LocalNode):
    """Boots when it is switched on, and not again."""

    def _start(self, now: Time) -> None:
        if not now:
            super()._start(now)


class Firmware:
    """A device that somebody wrote by hand: one text, read in segments. Its toggle bit stays 0."""

    def __init__(self, world: World) -> None:
        self.text = b"an I/O device"
        self.world = world
        self.place = world.listener(self.on_frame, name="firmware")
        world.send(self.place, Frame(0x705, b"\0"))

    def on_frame(self, frame: Frame, now: Time) -> None:
        data = frame.data
        if frame.can_id == 0 and data[0] in (0x81, 0x82) and data[1] in (0, 5):
            self.world.send(self.place, Frame(0x705, b"\0"))
        if frame.can_id != 0x605:
            return
        if data[0] == 0x40 and data[1:4] == bytes((TEXT & 0xFF, TEXT >> 8, 0)):
            self.left = self.text
            self.answer(bytes((0x41,)) + data[1:4] + len(self.text).to_bytes(4, "little"))
        elif data[0] >> 5 == 3:
            piece, self.left = self.left[:7], self.left[7:]
            self.answer(bytes((7 - len(piece) << 1 | (not self.left),)) + piece.ljust(7, b"\0"))
        elif data[0] != 0x80:
            self.answer(b"\x80" + data[1:4] + AbortCode.NO_SUCH_OBJECT.to_bytes(4, "little"))

    def answer(self, data: bytes) -> None:
        self.world.send(self.place, Frame(0x585, data))


def device(make: type[LocalNode]) -> type[MasterAgainstDevice]:
    class Device(OurDevice):
        def join(self, world: World) -> None:
            world.device(lambda out: make(out, 5, self.dictionary))

    return Device


class ByHand(MasterAgainstDevice):
    dictionary = ObjectDictionary(each for each in io_device().objects.values() if each.index == TEXT)

    def join(self, world: World) -> None:
        Firmware(world)


@pytest.mark.thorough(4)
@pytest.mark.parametrize(
    ("machine", "match", "steps"),
    [
        (ByHand, "toggle", ["read"]),
        (device(Swapped), r"output .*was written with .. .., and is read as", ["write", "read_back"]),
        (device(TakesAll), "it took an object that it does not have", ["write_what_is_not_there"]),
        (device(NeverStarts), "told to be OPERATIONAL, and its heartbeat is 705#7F", ["command", "wait"]),
        (device(ObeysNeighbour), "a command for node 6 has reset the device", ["command_another_node"]),
        (device(HangsInReset), "boot-up of node 5 did not come", ["command"]),
    ],
)
def test_a_bug_of_a_device_is_found_in_the_fewest_steps(machine: type[MasterAgainstDevice], match: str, steps: list[str]) -> None:
    assert steps_of_failure(machine, match) == steps


# ---- masters ----


class Supervisor:
    """A master that starts each device once it has booted and has a heartbeat; it looks at those with errors."""

    stops = False

    def __init__(self, world: World, nodes: Collection[int]) -> None:
        self.world, self.network = world, Network()
        self.nmt = NmtMaster(self.network.out)
        self.network.attach(self.nmt)
        self.nodes = {node_id: RemoteNode(self.network.out, node_id, io_device()) for node_id in nodes}
        for node in self.nodes.values():
            self.network.attach(node)
        world.host(self.network, on_event=self.on_event)
        for node_id in nodes:
            self.begin(node_id)

    def begin(self, node_id: int) -> None:
        self.network.run(self.configure(node_id), self.world.now)

    def configure(self, node_id: int) -> Procedure[None]:
        yield from write(self.nodes[node_id], "producer_heartbeat_time", 100)
        self.nmt.send(NmtCommand.START, node_id, self.world.now)

    def on_event(self, event: Event) -> None:
        if isinstance(event, NodeBooted):
            self.begin(event.node_id)
        if isinstance(event, EmcyReceived) and event.code:
            if self.stops:
                self.nmt.send(NmtCommand.STOP, event.node_id, self.world.now)
            self.network.run(self.look(event.node_id), self.world.now)

    def look(self, node_id: int) -> Procedure[None]:
        yield from sleep(250 * MILLISECOND)
        yield from read(self.nodes[node_id], "error_register")


class Stops(Supervisor):
    """Stops a device with an error, and then wants to read from it."""

    stops = True


class Supervised(MasterAgainstDevices):
    master: type[Supervisor] = Supervisor

    def network(self) -> SearchStrategy[tuple[PlannedDevice, ...]]:
        return networks(max_size=2, dictionaries=device_dictionaries(pdos=False, max_size=0, heartbeats=[0]))

    def start(self, world: World, network: tuple[PlannedDevice, ...]) -> None:
        self.master(world, [each.node_id for each in network])


class StoppedByMaster(Supervised):
    master = Stops


def test_a_right_master_passes() -> None:
    run_state_machine_as_test(Supervised, settings=examples(50, steps=10))


@pytest.mark.thorough
def test_a_bug_of_a_master_is_found_in_the_fewest_steps() -> None:
    assert steps_of_failure(StoppedByMaster, "stopped: node 1") == ["begin", "report", "wait"]


def test_a_promise_of_ones_own_is_checked() -> None:
    class Promise(Supervised):
        def check(self, world: World) -> None:
            assert all(node.state.value == 5 for node in world.nodes.values()), "a device is not operational"

    assert steps_of_failure(Promise, "a device is not operational") == ["begin", "reset"]


def test_a_machine_without_a_master_says_so() -> None:
    with pytest.raises(NotImplementedError, match="put your master into the world in start"):
        run_state_machine_as_test(MasterAgainstDevices, settings=examples(5, explain=False))
