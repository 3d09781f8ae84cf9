"""Network management: a master commands the NMT states of nodes, which decide what a node may do (CiA 301 v4.2.0, 7.2.8, 7.3.2).

Every node is in one of four NMT states, and the state decides which services it has (`SERVICES`). One participant, the NMT
master, commands the others by an unconfirmed frame of two bytes on CAN-ID 0: the command, and the node-ID that it is for (0: all
nodes). The node does not answer. Its heartbeat shows the new state (heartbeat.py). Its boot-up frame, 0x700 + node-ID with the
one byte 0, shows that a reset is done; the slave sends it when its initialisation is done.

Roles: `NmtMaster` sends the five commands. `NmtSlave` is a node's own state machine: `TRANSITIONS`, one table.

A reset has two steps here, because the node itself does the initialisation between them. The slave enters INITIALISING and
reports `NmtResetRequested`. The node resets its parameters (all, or those of communication) and calls `boot`, which sends the
boot-up frame and enters PRE-OPERATIONAL. A node that starts itself (0x1F80) then calls `execute(NmtCommand.START, now)`.

The NMT inhibit time (0x102A) and the start-up of a network by CiA 302-2 are procedures (boot/). Left out: a flying master. A node
on CAN does not receive its own frames: a node that is both master and slave must call `execute` for the commands that it sends to
all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Final

from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, NMT, Frame, RoutingKey
from canopen_proto.machine import Event, FrameIgnored, LocalProtocolError, Machine, Outbox, Time, check_node_id

ALL_NODES: Final = 0
"""The node-ID of an NMT command to every node of the network."""


class NmtState(IntEnum):
    """The NMT states, by their number in a heartbeat. CiA 301 v4.2.0, 7.2.8.3.2.2."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """The NMT node control services, by command specifier. CiA 301 v4.2.0, 7.2.8.3.1."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class Service(Enum):
    """The communication services that depend on the NMT state."""

    BOOT_UP = "boot-up"
    NMT = "NMT node control"
    ERROR_CONTROL = "error control"
    SDO = "SDO"
    PDO = "PDO"
    SYNC = "SYNC"
    TIME = "TIME"
    EMCY = "EMCY"


_ALWAYS: Final = frozenset({Service.NMT, Service.ERROR_CONTROL})
_CONFIGURING: Final = _ALWAYS | {Service.SDO, Service.SYNC, Service.TIME, Service.EMCY}

SERVICES: Final[Mapping[NmtState, frozenset[Service]]] = MappingProxyType(
    {
        NmtState.INITIALISING: frozenset({Service.BOOT_UP}),
        NmtState.PRE_OPERATIONAL: _CONFIGURING,
        NmtState.OPERATIONAL: _CONFIGURING | {Service.PDO},
        NmtState.STOPPED: _ALWAYS,
    }
)
"""NMT state -> the services that a node has in it: `Service.SDO in SERVICES[state]`. CiA 301 v4.2.0, 7.3.2.2.5."""

_TARGETS: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}

TRANSITIONS: Final[Mapping[tuple[NmtState, NmtCommand], NmtState]] = MappingProxyType(
    {
        (state, command): target
        for state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
        for command, target in _TARGETS.items()
    }
)
"""(state, command) -> next state. A command leads to the same state from each of the three states. INITIALISING has no rows: a
node in it is not on the bus, and leaves it by itself. CiA 301 v4.2.0, 7.3.2.1"""

_STATE_BY_NUMBER: Final = {int(state): state for state in NmtState}
COMMAND_OF_BYTE: Final = {int(command): command for command in NmtCommand}
"""The first byte of an NMT frame -> its command."""

STATE_OF_BYTE: Final = tuple(_STATE_BY_NUMBER.get(byte & 0x7F) for byte in range(256))
"""The byte of a heartbeat or guarding answer -> its state, whatever its toggle bit (bit 7); None if there is no such state."""


def target_of(command: NmtCommand) -> NmtState:
    """Return the state that a command leads to. After a reset, the node goes from INITIALISING to PRE-OPERATIONAL by itself."""
    return _TARGETS[command]


class NmtCommandSent(Event):
    """A command of our master is in the outbox. node_id 0: it is for all nodes."""

    __slots__ = ("command",)
    __match_args__ = ("node_id", "command")

    def __init__(self, node_id: int, command: NmtCommand) -> None:
        self.node_id = node_id
        self.command = command


class NmtStateChanged(Event):
    """Our own slave (NmtSlave) entered another state. previous: the state that it left."""

    __slots__ = ("previous", "state")
    __match_args__ = ("node_id", "previous", "state")

    def __init__(self, node_id: int, previous: NmtState, state: NmtState) -> None:
        self.node_id = node_id
        self.previous = previous
        self.state = state


class NmtResetRequested(Event):
    """Our own node must reset everything (RESET_NODE) or the communication parameters, 0x1000 to 0x1FFF (RESET_COMMUNICATION).
    command: which of the two.

    The slave is already in INITIALISING (NmtStateChanged came before). The node resets itself, then calls `NmtSlave.boot`.
    """

    __slots__ = ("command",)
    __match_args__ = ("node_id", "command")

    def __init__(self, node_id: int, command: NmtCommand) -> None:
        self.node_id = node_id
        self.command = command


class NmtMaster(Machine):
    """Sends NMT commands to one node or to all. It receives nothing: HeartbeatConsumer reports the nodes' states."""

    __slots__ = ()

    def send(self, command: NmtCommand, node_id: int, now: Time) -> None:
        """Send a command to node 1..127, or to ALL_NODES. Event: NmtCommandSent, at once.

        Raises LocalProtocolError for another node-ID. CiA 301 v4.2.0, 7.2.8.3.1
        """
        if not ALL_NODES <= node_id <= MAX_NODE_ID:
            raise LocalProtocolError(f"NMT {command.name}: node-ID {node_id} is outside 0 (all) to 127")
        self.out.frames.append(Frame(NMT, bytes((command, node_id))))
        self.out.events.append(NmtCommandSent(node_id, command))

    def start(self, node_id: int, now: Time) -> None:
        """Command OPERATIONAL: all services, PDO too. CiA 301 v4.2.0, 7.2.8.2.1.2"""
        self.send(NmtCommand.START, node_id, now)

    def stop(self, node_id: int, now: Time) -> None:
        """Command STOPPED: only NMT and error control. CiA 301 v4.2.0, 7.2.8.2.1.3"""
        self.send(NmtCommand.STOP, node_id, now)

    def enter_pre_operational(self, node_id: int, now: Time) -> None:
        """Command PRE-OPERATIONAL: SDO, but no PDO. CiA 301 v4.2.0, 7.2.8.2.1.4"""
        self.send(NmtCommand.ENTER_PRE_OPERATIONAL, node_id, now)

    def reset_node(self, node_id: int, now: Time) -> None:
        """Command a restart, as after power-on. The node's boot-up frame follows. CiA 301 v4.2.0, 7.2.8.2.1.5"""
        self.send(NmtCommand.RESET_NODE, node_id, now)

    def reset_communication(self, node_id: int, now: Time) -> None:
        """Command a restart of the communication. The node's boot-up frame follows. CiA 301 v4.2.0, 7.2.8.2.1.6"""
        self.send(NmtCommand.RESET_COMMUNICATION, node_id, now)


class NmtSlave(Machine):
    """A node's own NMT state machine. It begins in INITIALISING, and sends nothing before `boot`.

    state: read-only outside.
    """

    __slots__ = ("node_id", "state")

    def __init__(self, out: Outbox, node_id: int) -> None:
        """Make a slave in INITIALISING. node_id: 1..127, else LocalProtocolError."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.state = NmtState.INITIALISING

    def can_ids(self) -> Iterable[RoutingKey]:
        return (NMT,)

    def allows(self, service: Service) -> bool:
        """Return whether the present state allows a service."""
        return service in SERVICES[self.state]

    def boot(self, now: Time) -> None:
        """Send the boot-up frame and enter PRE-OPERATIONAL: initialisation is done. Event: NmtStateChanged, at once.

        Raises LocalProtocolError unless the state is INITIALISING. CiA 301 v4.2.0, 7.2.8.3.3 and 7.3.2.2.1
        """
        if self.state is not NmtState.INITIALISING:
            raise LocalProtocolError(f"boot of node {self.node_id}: it is {self.state.name}, and boots from INITIALISING only")
        self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, b"\x00"))
        self._enter(NmtState.PRE_OPERATIONAL)

    def execute(self, command: NmtCommand, now: Time) -> None:
        """Execute an NMT command for a reason of our own: start by itself (0x1F80), error behaviour (0x1029).

        Events: NmtStateChanged and NmtResetRequested as for a received command; none if the node is already in that state. Does
        nothing in INITIALISING. CiA 301 v4.2.0, 7.3.2.1 ("initiated locally")
        """
        state = TRANSITIONS.get((self.state, command))
        if state is None or state is self.state:
            return
        self._enter(state)
        if state is NmtState.INITIALISING:
            self.out.events.append(NmtResetRequested(self.node_id, command))

    def receive(self, frame: Frame, now: Time) -> None:
        """Obey a command to this node or to all.

        A frame that is not two bytes long, or has an unknown command for this node, is reported as FrameIgnored. CiA 301 v4.2.0,
        7.2.8.3.1
        """
        if self.state is NmtState.INITIALISING:
            return  # not on the bus
        data = frame.data
        if len(data) != 2:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"an NMT command has 2 bytes, not {len(data)}"))
            return
        if data[1] != self.node_id and data[1] != ALL_NODES:
            return
        command = COMMAND_OF_BYTE.get(data[0])
        if command is None:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"0x{data[0]:02X} is not an NMT command"))
            return
        self.execute(command, now)

    def _enter(self, state: NmtState) -> None:
        previous = self.state
        self.state = state
        self.out.events.append(NmtStateChanged(self.node_id, previous, state))
