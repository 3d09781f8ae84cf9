"""Nodes that are tables of objects, and an NMT master that boots them, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias, TypeVar

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import ERROR_CONTROL, KEY_REMOTE, REMOTE, Frame, routing_key
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Machine, Outbox, Time
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import BootEntry, NetworkEntry
from canopen_proto.manager.boot.network_boot import NetworkBoot
from canopen_proto.manager.boot.node_boot import NmtCommands
from canopen_proto.manager.boot.outcome import BootEnded
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from tests.core.bus import Bus, result_of

T = TypeVar("T")
Object: TypeAlias = tuple[int, int]
Answer: TypeAlias = bytes | int | None
"""The answer of a node for an object: its bytes; an abort code; or nothing at all."""

DEVICE_TYPE, HEARTBEAT, PROGRAM, DATE, TIME = (0x1000, 0), (0x1017, 0), (0x1F56, 1), (0x1020, 1), (0x1020, 2)
PROGRAM_DATE, PROGRAM_TIME = (0x1F52, 1), (0x1F52, 2)
VENDOR, PRODUCT, REVISION, SERIAL = ((0x1018, subindex) for subindex in range(1, 5))
LOAD, SAVE = (0x1011, 1), (0x1010, 1)
SETTING = (0x2002, 0)

IDENTITY = (0x360, 0x1234, 0x10002, 0x4D)
KIND = 0x10191
OPTIONAL, MANDATORY, KEPT = 0x05, 0x0D, 0x1D
"""Values of 0x1F81: a node that the master boots; one that the network needs; one that is needed and kept alive."""
HEARTBEAT_TIME = 200 * MILLISECOND
WRITES = ((*HEARTBEAT, b"\xc8\x00"), (*SETTING, b"\x34\x12"))


def u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def objects() -> dict[Object, Answer]:
    """A node as `entry` expects it."""
    identity = {(0x1018, subindex): u32(number) for subindex, number in enumerate(IDENTITY, start=1)}
    own: dict[Object, Answer] = {
        DEVICE_TYPE: u32(KIND), HEARTBEAT: bytes(2), SETTING: bytes(2), DATE: bytes(4), TIME: bytes(4),
        LOAD: u32(1), (0x1011, 2): u32(1), SAVE: u32(1), PROGRAM: u32(1),
    }  # fmt: skip
    return {**own, **identity}


def entry(node_id: int = 6, assignment: int = 5, **fields: object) -> BootEntry:
    """A node, as the master knows it, with the value of its 0x1F81."""
    known = {"consumer_time": 500 * MILLISECOND, "configuration": WRITES, "device_type": KIND}
    identity = dict(zip(("vendor", "product", "revision", "serial"), IDENTITY, strict=True))
    return BootEntry(node_id, Assignment.from_value(assignment), **{**known, **identity, **fields})  # type: ignore[arg-type]


class TableNode(Machine):
    """A node whose objects are a table. It obeys NMT commands, and sends heartbeats as its 0x1017 says.

    after: what the table gets at a reset. boot_delay: ns from a reset to the boot-up; NEVER: none comes. delay: ns to an answer.
    """

    def __init__(self, out: Outbox, node_id: int = 6, table: dict[Object, Answer] | None = None) -> None:
        super().__init__(out)
        self.node_id = node_id
        self.table = objects() if table is None else table
        self.defaults = dict(self.table)
        self.state = 0
        self.boot_delay: Time = 12 * MILLISECOND
        self.answer_delay: Time = 0
        self.guarded = False
        self.on_write: Callable[[Object, bytes], object] = lambda place, data: None
        self.writes: list[tuple[Object, bytes]] = []
        self._boots_at: Time = NEVER
        self._beats_at: Time = NEVER
        self._answers: list[tuple[Time, Frame]] = []
        self._toggle = 0

    def can_ids(self) -> Iterable[int]:
        return 0, 0x600 + self.node_id, routing_key(ERROR_CONTROL + self.node_id, REMOTE)

    def boot(self, now: Time) -> None:
        self.state, self._boots_at, self._toggle = 0x7F, NEVER, 0
        self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, b"\0"))
        self._begin_heartbeat(now)
        self._rearm()

    def switch_off(self) -> None:
        self.state, self._boots_at, self._beats_at = 0, NEVER, NEVER
        self._answers.clear()
        self._rearm()

    def receive(self, frame: Frame, now: Time) -> None:
        if self.state == 0:
            return
        if frame.can_id == 0:
            if frame.data[1] in (0, self.node_id):
                self._obey(NmtCommand(frame.data[0]), now)
        elif frame.key & KEY_REMOTE:
            if self.guarded:
                self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, bytes([self.state | self._toggle])))
                self._toggle ^= 0x80
        elif self.state != 4:
            self._serve(frame.data, now)
        self._rearm()

    def _obey(self, command: NmtCommand, now: Time) -> None:
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.switch_off()
            self.table = dict(self.defaults)
            self._boots_at = NEVER if self.boot_delay == NEVER else now + self.boot_delay
        else:
            self.state = {1: 5, 2: 4, 0x80: 0x7F}[command]

    def _serve(self, request: bytes, now: Time) -> None:
        place = int.from_bytes(request[1:3], "little"), request[3]
        mine = self.table.get(place, AbortCode.NO_SUCH_OBJECT)
        command = request[0] >> 5
        if mine is None or command not in (1, 2):
            return
        if isinstance(mine, int):
            answer = b"\x80" + request[1:4] + u32(mine)
        elif command == 2:
            answer = bytes([0x43 | (4 - len(mine)) << 2]) + request[1:4] + mine.ljust(4, b"\0")
        else:
            data = request[4 : 8 - (request[0] >> 2 & 3)]
            self.table[place] = data
            self.writes.append((place, data))
            if place == HEARTBEAT:
                self._begin_heartbeat(now)
            answer = b"\x60" + request[1:4] + bytes(4)
            self.on_write(place, data)
        if self.answer_delay:
            self._answers.append((now + self.answer_delay, Frame(0x580 + self.node_id, answer)))
        elif self.state:
            self.out.frames.append(Frame(0x580 + self.node_id, answer))

    def _begin_heartbeat(self, now: Time) -> None:
        period = self.table.get(HEARTBEAT)
        self._beats_at = now + self._period if isinstance(period, bytes) and any(period) else NEVER

    @property
    def _period(self) -> Time:
        period = self.table[HEARTBEAT]
        assert isinstance(period, bytes)
        return int.from_bytes(period, "little") * MILLISECOND

    def handle_timeout(self, now: Time) -> None:
        if now >= self._boots_at:
            self.boot(now)
        if now >= self._beats_at:
            self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, bytes([self.state])))
            self._beats_at = now + self._period
        while self._answers and self._answers[0][0] <= now:
            self.out.frames.append(self._answers.pop(0)[1])
        self._rearm()

    def _rearm(self) -> None:
        self._arm(min(self._boots_at, self._beats_at, *(time for time, _ in self._answers), NEVER))


class BootBench:
    """A master, and nodes that are on and have booted; all of them do what `entry` expects.

    together: the nodes share one connection to the bus, which is quicker; none can be disconnected then.
    """

    def __init__(self, node_ids: Iterable[int] = (6,), *, pause: Time = 0, together: bool = False) -> None:
        self.bus = Bus()
        self.master = self.bus.attach(Network())
        self.nmt = NmtMaster(self.master.out)
        self.master.attach(self.nmt)
        self.commands = NmtCommands(self.nmt, pause)
        self.nodes: dict[int, TableNode] = {}
        self.remotes: dict[int, RemoteNode] = {}
        shared = self.bus.attach(Network()) if together else None
        for node_id in node_ids:
            self.nodes[node_id] = TableNode(Outbox() if shared is None else shared.out, node_id)
            (self.bus if shared is None else shared).attach(self.nodes[node_id])
            self.remotes[node_id] = RemoteNode(self.master.out, node_id, ObjectDictionary([]))
            self.master.attach(self.remotes[node_id])
        for node in self.nodes.values():
            node.boot(self.bus.now)
        self.bus.run(10 * MILLISECOND)
        self.bus.sent.clear()
        self.bus.events.clear()

    @property
    def node(self) -> TableNode:
        return self.nodes[6]

    @property
    def remote(self) -> RemoteNode:
        return self.remotes[6]

    def run(self, procedure: Procedure[T], limit: Time = 120 * SECOND) -> T:
        """Run a procedure to its end: its result, or what it raised."""
        return self.outcome(self.master.run(procedure, self.bus.now), limit)

    def outcome(self, request_id: int, limit: Time = 120 * SECOND) -> T:  # type: ignore[type-var]
        return result_of(self.bus.outcome(request_id, limit))  # type: ignore[no-any-return]

    def network_boot(self, startup: int = 1, *entries: BootEntry, boot_time: Time = 0, **others: Any) -> NetworkBoot:
        """The boot-up of the network with a value of 0x1F80; by default of all nodes, all mandatory."""
        described = entries or tuple(entry(node_id, MANDATORY) for node_id in self.nodes)
        nodes = {each.node_id: each for each in described}
        network = NetworkEntry(Startup.from_value(startup), nodes, boot_time, self.commands.pause)
        return NetworkBoot(self.master, self.nmt, network, self.remotes, **others)

    def supervise(self, boot: NetworkBoot, duration: Time = 0) -> int:
        """Start the network, and go on supervising it; return the id of the procedure."""
        self.run(boot.start())
        request_id = self.master.run(boot.supervise(), self.bus.now)
        self.bus.run(duration)
        return request_id

    def letters(self) -> str:
        """The outcomes so far, in the order in which they were reported."""
        return "".join(event.outcome.letter for event in self.bus.events if isinstance(event, BootEnded))

    def commands_sent(self) -> list[str]:
        """The NMT commands that were sent, as candump shows them."""
        return [str(frame) for _, frame in self.bus.sent if frame.can_id == 0]


def beating(bench: BootBench, node_id: int, state: int = 5) -> None:
    """Let a node run already, with a heartbeat."""
    node = bench.nodes[node_id]
    node.table[HEARTBEAT] = node.defaults[HEARTBEAT] = b"\x64\0"
    node.boot(bench.bus.now)
    node.state = state
    bench.bus.run(MILLISECOND)
    bench.bus.sent.clear()
