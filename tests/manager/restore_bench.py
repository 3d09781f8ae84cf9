"""A master and a device whose settings are read and written, for the tests of backup and restore, in virtual time."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, Time
from canopen_proto.manager.parameters.restore import Restoration, plan_restore, restore
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster, NmtState
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import ObjectAccessPending
from canopen_proto.sdo.server import PENDING, Pending
from tests.core.bus import Bus, Ended, Fate, result_of
from tests.core.devices import LIMITED, TEXT, whole_device

T = TypeVar("T")
SECRET, IMAGE, GAIN, HIDDEN, FACTORY = 0x2010, 0x2011, 0x2012, 0x2013, 0x2014
HEARTBEAT_MS = 200


def device(heartbeat_ms: int = HEARTBEAT_MS, *more: Object) -> ObjectDictionary:
    """An I/O device with objects of all kinds that a backup treats in ways of their own, and more."""
    return _device(heartbeat_ms).with_objects(more) if more else _device(heartbeat_ms)


@functools.cache
def _device(heartbeat_ms: int) -> ObjectDictionary:
    def own(index: int, name: str, data_type: DataType, **fields: Any) -> Object:
        return Object.of(name, [Variable(index, 0, name, data_type, **fields)])

    return whole_device().with_objects(
        [
            standard_object(0x1017, heartbeat_ms),
            own(SECRET, "secret", DataType.UNSIGNED16, access=Access.WO),
            own(IMAGE, "image", DataType.DOMAIN, default=b"firmware"),
            own(GAIN, "gain", DataType.REAL32, default=1.5),
            own(HIDDEN, "hidden", DataType.UNSIGNED8, object_flags=2),
            own(FACTORY, "factory", DataType.UNSIGNED8, object_flags=1, default=3),
        ]
    )


CHANGES: dict[int, Value] = {
    0x1006_00: 10_000,
    0x1401_01: 0x80000000 | 0x315,
    0x1401_02: 255,
    0x1600_00: 2,
    0x1600_02: 0x00050008,
    0x1801_01: 0x295,
    0x1801_02: 254,
    0x1A01_00: 0,
    LIMITED << 8: 17,
    TEXT << 8: "another text that takes several segments",
    GAIN << 8: -2.25,
    0x2100_02: -300,
}
"""What somebody has changed in that device, as far as a restore puts it back. Two PDOs with their mappings are among it."""


class Strict(LocalNode):
    """A device that can be told which frames reach it (`takes`), and how to take each write, by its count from 1 on.

    It notes in which NMT state it was written.
    """

    def __init__(self, out: Outbox, node_id: int, dictionary: ObjectDictionary) -> None:
        super().__init__(out, node_id, dictionary)
        self.refuse: Callable[[int], AbortCode | None] = lambda count: None
        self.is_silent: Callable[[int], bool] = lambda count: False
        self.writes: list[tuple[int, int, NmtState]] = []
        self.takes: Callable[[Frame], bool] = lambda frame: True

    def receive(self, frame: Frame, now: Time) -> None:
        if self.takes(frame):
            super().receive(frame, now)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        self.writes.append((index, subindex, self.state))
        refusal = self.refuse(len(self.writes))
        if refusal is not None:
            return refusal
        result = super().write(index, subindex, data, now)
        return PENDING if self.is_silent(len(self.writes)) else result


class Bench:
    """A master, its RemoteNode and NMT master, and a `Strict` device, Operational. host_stores: whether "save" is answered."""

    def __init__(
        self,
        dictionary: ObjectDictionary | None = None,
        *,
        start: bool = True,
        fates: Iterable[Fate] = (),
        known: ObjectDictionary | None = None,
    ) -> None:
        self.dictionary = device() if dictionary is None else dictionary
        self.bus = Bus()
        self.master = self.bus.attach(Network())
        self.remote = RemoteNode(self.master.out, 5, self.dictionary if known is None else known)
        self.nmt = NmtMaster(self.master.out)
        self.master.attach(self.remote)
        self.master.attach(self.nmt)
        self.network = self.bus.attach(Network())
        self.device = Strict(self.network.out, 5, self.dictionary)
        self.network.attach(self.device)
        self.host_stores = True
        self._ended: list[Ended] = []
        self.bus.on_event = self._serve
        self.device.boot(0)
        if start:
            self.bus.pump()
            self.bus.run(MILLISECOND)
            self.nmt.start(5, self.bus.now)
        self.bus.run(SECOND)
        self.clear()
        self.bus._fates = iter(fates)

    def clear(self) -> None:
        self.bus.events.clear()
        self.bus.sent.clear()
        self.device.writes.clear()

    def _serve(self, event: Event) -> None:
        if isinstance(event, Ended):
            self._ended.append(event)
        if isinstance(event, ObjectAccessPending) and event.index == 0x1010 and self.host_stores:
            self.device.complete(event.access_id, None, self.bus.now)

    def change(self) -> None:
        """Set the device to CHANGES by the very procedures that are tested, which are believed here."""
        self.restore(CHANGES)
        self.clear()

    def plan(self, values: dict[int, Value], **options: Any) -> Any:
        return self.run(plan_restore(self.remote, self.dictionary, values, **options))

    def restore(self, values: dict[int, Value], **options: Any) -> Restoration:
        return self.run(restore(self.remote, self.nmt, self.plan(values), **options))

    def start(self, procedure: Procedure[Any]) -> int:
        return self.master.run(procedure, self.bus.now)

    def outcome(self, limit: Time = 600 * SECOND) -> Ended:
        self.bus.run_until(lambda: bool(self._ended), limit)
        (outcome,) = self._ended
        self._ended.clear()
        self.bus.run(100 * MILLISECOND)
        return outcome

    def run(self, procedure: Procedure[T]) -> T:
        self.start(procedure)
        return result_of(self.outcome())  # type: ignore[no-any-return]

    def held(self, keys: Iterable[int]) -> dict[int, Value]:
        """What the device has now."""
        return {key: self.device.values.store[key] for key in keys}


def changed(**options: object) -> tuple[Bench, dict[int, Value]]:
    """A device whose settings were changed after a backup of it."""
    bench = Bench(**options)  # type: ignore[arg-type]
    before = bench.held(CHANGES)
    bench.change()
    assert bench.held(CHANGES) == CHANGES
    return bench, before


def nmt_commands(bench: Bench) -> list[str]:
    return [line for line in bench.bus.trace() if line.startswith("000#")]
