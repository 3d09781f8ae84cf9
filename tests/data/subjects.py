"""A device, a drive and a master's view of one that anything may be done to: what is checked after each step is the oracle.

Nothing that a peer sends, and no time that passes, may raise, spin, or make a participant grow without bound.
"""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import replace
from enum import Enum
from typing import Any, Final

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Direction, Object, ObjectDictionary, PdoDescription, Variable
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, Event, LocalProtocolError, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.server import ObjectAccessPending
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.sync import SyncConsumer
from tests.core.devices import INPUT, LIMITED, OUTPUT, TEXT, io_device, whole_device

NODE: Final = 5

LARGEST_TRANSFER: Final = 64
"""What server and client accept here, instead of megabytes: so that MOST_HELD can be small."""

MOST_HELD: Final = 3000
"""What a participant may hold at most, in elements of containers and bytes (`held`), whatever it was sent."""

MOST_REMEMBERED: Final = 11_000
"""Of what was heard last (BusKnowledge): two slots for each of 2048 CAN-IDs, and what is in those that the tests fill."""

WAKES: Final = 40
"""How many deadlines are served on time before the driver oversleeps."""

_DESCRIPTION: Final = (ObjectDictionary, Object, Variable, PdoDescription)  # shared, and never changes


def _look_into(kind: type) -> type | None:
    """How to look into objects of a type: as into a `str`, `dict` or `list`, or (`object`) at its attributes; None: not at all,
    as it holds nothing, or is shared."""
    if issubclass(kind, (*_DESCRIPTION, Enum, type, int, float, type(None))):
        return None
    if issubclass(kind, bytes | bytearray | str):
        return str
    if issubclass(kind, dict):
        return dict
    if issubclass(kind, list | tuple | set | frozenset | deque):
        return list
    return object if kind.__module__.startswith("canopen_proto") else None


class _Looks(dict[type, "type | None"]):
    """`_look_into`, by type."""

    def __missing__(self, kind: type) -> type | None:
        self[kind] = found = _look_into(kind)
        return found


_LOOKS: Final = _Looks()


@functools.cache
def _slots(kind: type) -> tuple[str, ...]:
    return tuple(name for each in kind.__mro__ for name in getattr(each, "__slots__", ()))


def held(root: object, seen: set[int] | None = None) -> int:
    """All that is reachable from an object: the elements of its containers, and the bytes of its buffers and texts.

    seen: the ids of what was counted before and does not count again.
    """
    total = 0
    seen = set() if seen is None else seen
    waiting: list[Any] = [root]
    while waiting:
        item = waiting.pop()
        if id(item) in seen:
            continue
        seen.add(id(item))
        kind = type(item)
        look = _LOOKS[kind]
        if look is object:
            inner = [getattr(item, name, None) for name in _slots(kind)]
            inner += getattr(item, "__dict__", {}).values()
        else:
            total += len(item)
            inner = [] if look is str else item if look is list else [*item.keys(), *item.values()]
        waiting += [each for each in inner if _LOOKS[type(each)] is not None]
    return total


class Subject:
    """A participant on a bus on which anything can happen. trace: all that it sent and reported, in order."""

    def __init__(self) -> None:
        self.network = Network()
        self.now: Time = 0
        self.trace: list[Frame | Event] = []
        self.open: set[RequestId] = set()

    def receive(self, frame: Frame) -> None:
        self.network.receive(frame, self.now)
        self.drain()

    def pass_time(self, duration: Time) -> None:
        """Serve deadlines on time, some of them; then oversleep. A negative duration: the clock ran back, for once."""
        end = self.now + duration
        if duration < 0:
            self.network.handle_timeout(end)
            self.network.receive(Frame(0x705, b"\x05"), end)
            self.drain()
            return
        for _ in range(WAKES):
            deadline = self.network.next_deadline()
            if deadline > end:
                break
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            self.drain()
        self.now = end
        for _ in range(WAKES):  # more than one: an EMCY queue whose inhibit time was taken away goes out one by one
            self.network.handle_timeout(end)
            self.drain()
            if self.network.next_deadline() > end:
                break
        assert self.network.next_deadline() > end, "its time was served, and it wants to be woken all the same"

    def drain(self) -> list[Event]:
        frames, events = self.network.drain(self.now)
        self.trace += frames
        self.trace += events
        for report in events:
            if isinstance(report, Outcome):
                self.open.remove(report.request_id)  # one outcome for each request, and none that nobody asked for
        return events

    def check(self) -> None:
        """What must hold at any time."""
        seen: set[int] = set()
        memory = held(self.network._knowledge, seen)  # of what was heard: as large as its slots from the beginning
        assert memory <= MOST_REMEMBERED, f"it remembers {memory}"
        amount = held(self.network, seen) - len(self.network._lone)  # a list of routes, as long from the beginning
        assert amount <= MOST_HELD, f"it holds {amount}"
        assert self.network.next_deadline() <= NEVER

    def forget_trace(self) -> None:
        self.trace.clear()


class BootLoaderSubject(Subject):
    """A device with a boot loader, whose flash is small."""

    def __init__(self, settings: BootLoaderSettings) -> None:
        super().__init__()
        self.node = BootLoader(self.network.out, NODE, replace(settings, size=LARGEST_TRANSFER))
        self.node.sdo.max_download = LARGEST_TRANSFER
        self.network.attach(self.node)
        self.node.boot(0)
        self.drain()


class LocalSubject(Subject):
    """An I/O device that monitors node 9, with one object that its host serves."""

    def __init__(self) -> None:
        super().__init__()
        self.node = LocalNode(self.network.out, NODE, whole_device())
        for server in self.node.channels.servers.values():
            server.max_download = LARGEST_TRANSFER
        self.node.deferred.add(LIMITED)
        self.pending: list[ObjectAccessPending] = []
        self.network.attach(self.node)
        self.node.boot(0)
        self.node.set_value(0x1016, 1, 9 << 16 | 100, 0)
        self.drain()

    def drain(self) -> list[Event]:
        events = super().drain()
        self.pending += [report for report in events if isinstance(report, ObjectAccessPending)]
        del self.pending[:-2]
        return events

    def act(self, choice: int) -> None:
        """The host does something."""
        more, what = divmod(choice, 6)
        match what:
            case 0:
                self.node.set_value(INPUT, 0, more, self.now)
            case 1:
                self.node.raise_error(0x1000 + more, 0x02, b"\x01", self.now)
            case 2:
                self.node.clear_error(0x1000 + more, self.now)
            case 3:
                self.node.execute(NmtCommand.START, self.now)
            case 4:
                self.node.execute(tuple(NmtCommand)[more % len(NmtCommand)], self.now)
            case _:
                for access in self.pending:
                    kept = None if access.data is not None else bytes(more % 9)
                    self.node.complete(access.access_id, AbortCode.LOCAL_CONTROL if more % 3 == 0 else kept, self.now)
                self.pending.clear()
        self.drain()


class DriveSubject(Subject):
    """A simulated drive that has things happen to it."""

    def __init__(self) -> None:
        super().__init__()
        self.node = DriveNode(self.network.out, NODE, DriveSettings())
        self.node.sdo.max_download = LARGEST_TRANSFER
        self.network.attach(self.node)
        self.node.boot(0)
        self.node.execute(NmtCommand.START, 0)
        self.drain()

    def act(self, choice: int) -> None:
        """The world around the drive does something."""
        more, what = divmod(choice, 8)
        match what:
            case 0:
                self.node.raise_fault((0x2310, 0x7320, 0x8611)[more % 3], self.now)
            case 1:
                self.node.block(more % 4 == 0, self.now)
            case _:
                self.node.execute(NmtCommand.START, self.now)
        self.drain()


class RemoteSubject(Subject):
    """A master's view of such a device, with PDOs both ways, and an NMT master and a SYNC consumer beside it."""

    def __init__(self) -> None:
        super().__init__()
        dictionary = io_device()
        self.node = RemoteNode(self.network.out, NODE, dictionary, heartbeat_timeout=100_000_000)
        self.node.sdo.max_upload = LARGEST_TRANSFER
        self.node.sdo.max_queue = 4
        self.nmt = NmtMaster(self.network.out)
        for machine in (self.node, self.nmt, SyncConsumer(self.network.out)):
            self.network.attach(machine)
        for name, base, direction, index in [("in", 0x180, Direction.TPDO, INPUT), ("out", 0x200, Direction.RPDO, OUTPUT)]:
            self.node.add_pdo(PdoDescription(name, base, direction, 1, (dictionary.variable(index),)), 0)
        self.node.enable_rpdo(1, 0)

    def act(self, choice: int) -> None:
        """The master's user does something."""
        node, now = self.node, self.now
        more, what = divmod(choice, 7)
        try:
            match what:
                case 0:
                    self.open.add(node.read(((INPUT, 0), (TEXT, 0), (0x1018, 2))[more % 3], now, urgent=more % 4 == 0))
                case 1:
                    self.open.add(node.write(OUTPUT, more, now))
                case 2:
                    self.open.add(node.write(TEXT, "x" * (more % 40), now))
                case 3:
                    self.nmt.start(NODE * (more % 2), now)
                case 4:
                    self.nmt.send(tuple(NmtCommand)[more % len(NmtCommand)], NODE, now)
                case 5:
                    node.enable_rpdo(1, now, more % 3 > 0)
                case _:
                    for request_id in sorted(self.open)[more % 2 :: 2]:
                        node.cancel(request_id, now)
        except LocalProtocolError:
            if node.sdo.waiting < node.sdo.max_queue:
                raise  # a full queue is the only fault of ours here
        self.drain()
