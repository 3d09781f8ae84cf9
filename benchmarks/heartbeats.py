"""Heartbeat handling: a frame comes in, and the node's state is known. The weakest row of all: the peer does little here.

Both sides watch six nodes, begin with CAN-ID and data (no python-can message, no bus), give them to the library by the entry that
it has for that, and end with reading the node's state by its public name:

- alone: our HeartbeatConsumer, the peer's NmtMaster (`on_heartbeat`); no dispatch on either side;
- in bursts: `Network.receive` for the six frames that came together, then one `drain` and one `next_deadline`; the peer's
  `Network.notify` for each;
- one by one: the same with `drain` and `next_deadline` after each frame: our worst case, and what a driver does on a quiet bus;
- RemoteNode: one by one, with the whole view of a node behind the network, as the peer has it in all cases but the first.
  Nobody
  asks for heartbeats: the peer has no callback, and ours has set `Network.quiet`, as the master does then.
- each told: the same, and a function of the user is called with each heartbeat: the peer's callback, and for ours each event.

Ours does more, and all of it is counted: it makes the Frame, and supervises the time (the peer has no heartbeat time-out). In the
cases without a RemoteNode it makes an event of each frame, which the peer's user would get by a callback (none is set). A
RemoteNode also compares each heartbeat with what was commanded. Both note who was heard: the peer's scanner keeps the node-IDs,
our Network the last frame of every CAN-ID and when it came. A driver of ours drains where there is something: as the pump of the
master does, it looks at the outbox first.
"""

from __future__ import annotations

from collections.abc import Callable

import canopen
from direct import coupled_networks
from measure import Case

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatConsumer
from canopen_proto.machine import MILLISECOND, Outbox
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.remote_node import RemoteNode

NODES = range(1, 7)
TIMEOUT = 500 * MILLISECOND
NAMES = {NmtState.OPERATIONAL: "OPERATIONAL", NmtState.PRE_OPERATIONAL: "PRE-OPERATIONAL"}
TRAFFIC = [(0x700 + node_id, node_id, bytes((state,))) for state in NAMES for _ in range(20) for node_id in NODES]
"""Twenty heartbeats of each node in one state, then twenty in the other: a change of state now and then."""

Heard = Callable[[int], NmtState | str | None]
"""Handle so many frames of TRAFFIC, over and over; the state of the last one's node."""


def theirs_alone() -> Heard:
    """The peer's NmtMaster of each node."""
    masters = {node_id: canopen.nmt.NmtMaster(node_id) for node_id in NODES}

    def heard(count: int) -> str:
        state = ""
        for number in range(count):
            can_id, node_id, data = TRAFFIC[number % len(TRAFFIC)]
            masters[node_id].on_heartbeat(can_id, data, 0.0)
            state = masters[node_id].state
        return state

    return heard


def ignore(_: object) -> None:
    """What a user does with each heartbeat."""


def theirs(told: bool = False) -> Heard:
    """The peer's Network with six RemoteNodes. told: each heartbeat is handed to `ignore`."""
    network, _ = coupled_networks()
    remote = {node_id: network.add_node(node_id, canopen.ObjectDictionary()) for node_id in NODES}
    if told:
        for each in remote.values():
            each.nmt.add_heartbeat_callback(ignore)

    def heard(count: int) -> str:
        state = ""
        for number in range(count):
            can_id, node_id, data = TRAFFIC[number % len(TRAFFIC)]
            network.notify(can_id, data, 0.0)
            state = remote[node_id].nmt.state
        return state

    return heard


def ours_alone() -> Heard:
    """Six HeartbeatConsumers; the events are taken and thrown away after each frame."""
    out = Outbox()
    consumers = {node_id: HeartbeatConsumer(out, node_id, TIMEOUT) for node_id in NODES}

    def heard(count: int) -> NmtState | None:
        now, state = 0, None
        for number in range(count):
            can_id, node_id, data = TRAFFIC[number % len(TRAFFIC)]
            now += MILLISECOND
            consumers[node_id].receive(Frame(can_id, data), now)
            state = consumers[node_id].state
            out.events.clear()
        return state

    return heard


def ours(burst: int, whole_nodes: bool, told: bool = False) -> Heard:
    """A Network with six HeartbeatConsumers, or six RemoteNodes; drained after every `burst` frames. told: each event is handed
    to `ignore`."""
    network = Network()
    network.quiet = whole_nodes and not told
    out = network.out
    consumers: dict[int, HeartbeatConsumer] = {}
    for node_id in NODES:
        if whole_nodes:
            node = RemoteNode(network.out, node_id, ObjectDictionary([]), heartbeat_timeout=TIMEOUT)
            network.attach(node)
            consumers[node_id] = node.heartbeat
        else:
            consumers[node_id] = HeartbeatConsumer(network.out, node_id, TIMEOUT)
            network.attach(consumers[node_id])
    clock = 0

    def heard(count: int) -> NmtState | None:
        nonlocal clock
        now, state = clock, None
        for number in range(count):
            can_id, node_id, data = TRAFFIC[number % len(TRAFFIC)]
            now += MILLISECOND
            network.receive(Frame(can_id, data), now)
            state = consumers[node_id].state
            if number % burst == burst - 1:
                if out.frames or out.events:
                    _, events = network.drain(now)
                    if told:
                        for event in events:
                            ignore(event)
                if network.next_deadline() <= now:
                    network.handle_timeout(now)
        clock = now
        return state

    return heard


def _case(how: str, ours: Heard, theirs: Heard) -> Case:
    def check() -> None:
        for count in (1, 121, 240):
            state = ours(count)
            assert isinstance(state, NmtState)
            assert NAMES[state] == theirs(count)

    return Case(f"heartbeat, frame to state ({how})", ours, theirs, check)


def cases() -> list[Case]:
    """See this module's text."""
    dispatched = theirs()
    return [
        _case("alone", ours_alone(), theirs_alone()),
        _case("in bursts of 6", ours(len(NODES), whole_nodes=False), dispatched),
        _case("one by one", ours(1, whole_nodes=False), dispatched),
        _case("RemoteNode, one by one", ours(1, whole_nodes=True), dispatched),
        _case("RemoteNode, one by one, each told", ours(1, whole_nodes=True, told=True), theirs(told=True)),
    ]
