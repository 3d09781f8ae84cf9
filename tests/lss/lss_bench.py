"""Devices without a node-ID on a bus in virtual time, and a tool that gives them theirs."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from typing import TypeVar

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import FROM_MASTER, FROM_SLAVE, UNCONFIGURED, LssAddress, LssConfiguration, LssService, LssState
from canopen_proto.lss.scan import LssTool, Pace
from canopen_proto.lss.slave import LssSlave, LssStoreRequested
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.procedures.steps import Procedure
from tests.core.bus import Bus, result_of

T = TypeVar("T")

QUICK = 5 * MILLISECOND
"""A window for tests: their devices answer within 0.2 ms unless they are to be late."""


def device_dictionary(address: LssAddress) -> ObjectDictionary:
    return ObjectDictionary(
        [standard_object(0x1000, 0x191), standard_object(0x1018, highest=4, defaults=dict(enumerate(address, start=1)))]
    )


def random_addresses(count: int, seed: int, given: Sequence[int] = ()) -> list[LssAddress]:
    """Addresses that begin with the numbers of `given`; the rest is random."""
    chance = random.Random(seed)
    rest = 4 - len(given)
    return [LssAddress(*given, *(chance.getrandbits(32) for _ in range(rest))) for _ in range(count)]


class LssBench:
    """A bus with devices and a tool. slaves: of all devices.

    lose: the numbers of frames (of all, in their order) that nobody gets. bare: the devices have nothing but their LSS slaves,
    which is quicker. together: they share one connection, which is quicker still.
    """

    def __init__(
        self,
        addresses: Iterable[LssAddress],
        node_ids: Iterable[int] = (),
        *,
        window: Time = QUICK,
        lose: Iterable[int] = (),
        bare: bool = False,
        together: bool = False,
        **faults: object,
    ) -> None:
        self.bus = _LossyBus(frozenset(lose), **faults)  # type: ignore[arg-type]
        self.network = self.bus.attach(Network())
        self.tool = LssTool(self.network.out)
        self.tool.master.frame_gap = 0
        self.network.attach(self.tool)
        self.pace = Pace(window=window, guard=MILLISECOND)
        self.nodes: list[LocalNode] = []
        self.slaves: list[LssSlave] = []
        self._bare = bare
        self._shared = Outbox() if together else None
        ids = iter(node_ids)
        for address in addresses:
            self.add(address, next(ids, UNCONFIGURED))
        self.bus.on_event = self._on_event
        self.events: list[Event] = []
        self.bus.run(MILLISECOND)

    def add(self, address: LssAddress, node_id: int = UNCONFIGURED) -> None:
        if self._bare:
            self.slaves.append(self.bus.attach(LssSlave(self._shared or Outbox(), address, LssConfiguration(node_id))))
            return
        node = self.bus.attach(LocalNode(Outbox(), node_id, device_dictionary(address)))
        node.boot(self.bus.now)
        self.nodes.append(node)
        self.slaves.append(node.lss)

    def _on_event(self, event: Event) -> None:
        if isinstance(event, LssStoreRequested):
            for node in self.nodes:
                if node.lss.is_storing:
                    node.lss.complete_store(0, self.bus.now)

    def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure to its end; its error is raised."""
        request_id = self.network.run(procedure, self.bus.now)
        return self.end_of(request_id)  # type: ignore[no-any-return]

    def end_of(self, request_id: int):  # type: ignore[no-untyped-def]
        end = self.bus.outcome(request_id, 3600 * SECOND)
        self.bus.run(MILLISECOND)  # what it sent last arrives
        self.events += self.bus.events
        self.bus.events.clear()
        return end if isinstance(end, ProcedureCancelled) else result_of(end)

    @property
    def ids(self) -> list[int]:
        """The node-IDs in use, by device."""
        return [slave.active.node_id for slave in self.slaves]

    @property
    def running(self) -> list[int]:
        """The node-IDs of the devices that have booted."""
        return [node.node_id for node in self.nodes if node.state is not NmtState.INITIALISING]

    def sent(self, service: LssService) -> int:
        """How many requests of a service were sent."""
        return sum(frame.key == FROM_MASTER and frame.data[0] == service for _, frame in self.bus.sent)

    @property
    def none_is_selected(self) -> bool:
        return all(slave.state is LssState.WAITING for slave in self.slaves)


class _LossyBus(Bus):
    def __init__(self, lose: frozenset[int], **faults: object) -> None:
        super().__init__(**faults)  # type: ignore[arg-type]
        self._lose = lose
        self.slow: dict[int, Time] = {}  # answers of the device at that place are so late

    def _deliver(self, receiver: Outbox, frame: Frame) -> None:
        """As the bus does, without asking nodes for their keys each time: they sort out what they do not want."""
        for machine in self.machines:
            if machine.out is receiver and (isinstance(machine, LocalNode | Network) or frame.key in machine.can_ids()):
                machine.receive(frame, self.now)

    def _put(self, frame: Frame, sender: Outbox | None) -> None:
        if len(self.sent) in self._lose:
            self.sent.append((self.now, frame))
            return
        late = 0
        for place, each in self.slow.items():
            if sender is self.machines[place + 1].out and frame.key == FROM_SLAVE:
                late = each
        before = self._delay
        self._delay = (before[0] + late, before[1] + late)
        super()._put(frame, sender)
        self._delay = before
