"""Find the nodes of a bus: first listen, then ask.

1. Listen for `listen` ns: a heartbeat or a boot-up frame names its node and its NMT state (CiA 301 v4.2.0, 7.2.8.3.2.2). This
   sends nothing, and goes on during step 2.
2. Read, by SDO, from each of `node_ids`: device type (0x1000), identity (0x1018) and name (0x1008, optional). A node that does
   not answer the first request in time is not there, unless it was heard.

A scan does not flood the bus: it asks AT_ONCE nodes side by side, each by one request at a time, and waits PACE between one node
and the next. So 127 node-IDs on an empty bus take about 3.5 s, and there are never more than AT_ONCE requests under way.

A node that was heard gets the full SDO timeout. A Stopped node is not asked: it has no SDO (7.3.2.2.5).

Left out: nodes whose first SDO server has other CAN-IDs, and nodes without a node-ID (lss/scan.py). Two nodes with the same
node-ID show as one, mostly by garbled answers; `Network.heard` tells when a second one has answered (`second_answer`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortOrigin
from canopen_proto.datatypes import DataType, text_for_people
from canopen_proto.frame import ALL_NODE_IDS, ERROR_CONTROL, Frame, RoutingKey, routing_key
from canopen_proto.group import Group
from canopen_proto.machine import MILLISECOND, Event, Machine, Outbox, Time, check_node_id
from canopen_proto.nmt import SERVICES, STATE_OF_BYTE, NmtState, Service
from canopen_proto.procedures.steps import Procedure, SdoTransferError, act, all_of, sleep, upload
from canopen_proto.sdo.client import SdoClient

LISTEN: Final = 1500 * MILLISECOND
"""Longer than the usual heartbeat time of 1 s."""
PROBE_TIMEOUT: Final = 100 * MILLISECOND
"""For the first answer of a node that was not heard. Devices answer 0x1000 from memory, within a few ms."""
ANSWER_TIMEOUT: Final = 500 * MILLISECOND
"""For the answers of a node that is known to be there."""
AT_ONCE: Final = 4
"""Nodes that are asked side by side: a tenth of what a 125 kbit/s bus could carry."""
PACE: Final = 5 * MILLISECOND
"""Between the last request to one node and the first to the next."""
MAX_NAME: Final = 256
"""The longest device name that is accepted, in bytes."""

_IDENTITY_FIELDS: Final = 4


class NodeFound(Event):
    """A node was found. state: as in its last heartbeat, None if none was heard.

    device_type: 0x1000; identity: 0x1018:01 to :04 (vendor-ID, product code, revision, serial number); each None if the node did
    not answer. name: 0x1008 or "". remark: why something is missing, for people.
    """

    __match_args__ = ("node_id", "state", "device_type", "identity", "name", "remark")

    def __init__(
        self,
        node_id: int,
        state: NmtState | None,
        device_type: int | None = None,
        identity: tuple[int | None, int | None, int | None, int | None] = (None, None, None, None),
        name: str = "",
        remark: str = "",
    ) -> None:
        self.node_id = node_id
        self.state = state
        self.device_type = device_type
        self.identity = identity
        self.name = name
        self.remark = remark


class Scanner(Group):
    """Listens to all nodes, and has an SDO client for each node that `scan` asks. Attach it to a Network; detach it afterwards.

    heard: the NMT state of each node that was heard. While a scan runs, nothing else should use the SDO channels of its nodes.
    """

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self._ears = _Ears(self.inner)
        self._members.attach(self._ears)
        self._clients: dict[int, SdoClient] = {}

    @property
    def heard(self) -> dict[int, NmtState]:
        """The last NMT state that each node reported, since the scanner was made."""
        return self._ears.heard

    def client(self, node_id: int) -> SdoClient:
        """Return the SDO client for a node."""
        client = self._clients.get(node_id)
        if client is None:
            client = SdoClient(self.inner, node_id, max_upload=MAX_NAME)
            self._clients[node_id] = client
            self._members.attach(client)
        return client


class _Ears(Machine):
    """Hears every node's heartbeats and boot-ups. It makes no events: other machines on this network may report them."""

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.heard: dict[int, NmtState] = {}

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(ERROR_CONTROL + node_id) for node_id in ALL_NODE_IDS)

    def receive(self, frame: Frame, now: Time) -> None:
        state = STATE_OF_BYTE[frame.data[0]] if len(frame.data) == 1 else None
        if state is not None:
            # After its boot-up frame, which carries the byte 0, a node is Pre-operational (7.2.8.3.3).
            self.heard[frame.can_id - ERROR_CONTROL] = state or NmtState.PRE_OPERATIONAL


def scan(
    scanner: Scanner,
    node_ids: Iterable[int] = ALL_NODE_IDS,
    *,
    listen: Time = LISTEN,
    probe_timeout: Time = PROBE_TIMEOUT,
    answer_timeout: Time = ANSWER_TIMEOUT,
) -> Procedure[list[NodeFound]]:
    """Find the nodes of a bus; return them by node-ID. scanner: attached to the network.

    node_ids: the nodes to ask; empty: only listen. Nodes that are heard are found whether asked or not. listen, probe_timeout,
    answer_timeout: ns. Each node is also reported by NodeFound: at once if it answers, at the end if it was only heard. Raises
    LocalProtocolError for a node-ID outside 1..127, before anything is sent.
    """
    asked = sorted({check_node_id(node_id) for node_id in node_ids})
    yield from sleep(listen)
    found: dict[int, NodeFound] = {}
    # Nodes that were heard go first: they answer soon.
    queue = iter(sorted(asked, key=lambda node_id: node_id not in scanner.heard))
    workers = (_ask_each(scanner, queue, found, probe_timeout, answer_timeout) for _ in range(AT_ONCE))
    yield from all_of(*workers)
    for node_id in sorted(scanner.heard.keys() - found.keys()):
        yield from _report(scanner, found, _only_heard(node_id, scanner.heard[node_id], node_id in asked))
    return [found[node_id] for node_id in sorted(found)]


def _only_heard(node_id: int, state: NmtState, asked: bool) -> NodeFound:
    remark = ""
    if Service.SDO not in SERVICES[state]:
        remark = "Stopped: no SDO in this state"
    elif asked:
        remark = "heard, but does not answer SDO"
    return NodeFound(node_id, state, remark=remark)


def _report(scanner: Scanner, found: dict[int, NodeFound], node: NodeFound) -> Procedure[None]:
    found[node.node_id] = node
    yield from act(lambda now: scanner.out.events.append(node))


def _ask_each(
    scanner: Scanner, queue: Iterator[int], found: dict[int, NodeFound], probe_timeout: Time, answer_timeout: Time
) -> Procedure[None]:
    """Ask one node after the other, each taken from a queue that several of these share."""
    for node_id in queue:
        state = scanner.heard.get(node_id)
        if state is not None and Service.SDO not in SERVICES[state]:
            continue
        client = scanner.client(node_id)
        client.timeout = probe_timeout if state is None else answer_timeout
        node = yield from _ask(scanner, client, answer_timeout)
        if node is not None:
            yield from _report(scanner, found, node)
        yield from sleep(PACE)


def _ask(scanner: Scanner, client: SdoClient, answer_timeout: Time) -> Procedure[NodeFound | None]:
    """Ask one node; return what was found, None if it did not answer."""
    node_id, remark = client.node_id, ""
    device_type: int | None = None
    try:
        device_type = int.from_bytes((yield from upload(client, indices.DEVICE_TYPE)), "little")
    except SdoTransferError as failed:
        if failed.origin is not AbortOrigin.PEER:
            return None
        remark = str(failed)  # a refusal is a sign of life
    client.timeout = answer_timeout
    fields: list[int | None] = []
    while len(fields) < _IDENTITY_FIELDS:
        data = yield from _optional(client, indices.IDENTITY_OBJECT, len(fields) + 1)
        fields.append(None if data is None else int.from_bytes(data, "little"))
    name = yield from _optional(client, indices.MANUFACTURER_DEVICE_NAME, 0)
    return NodeFound(
        node_id,
        scanner.heard.get(node_id),
        device_type,
        (fields[0], fields[1], fields[2], fields[3]),
        text_for_people((name or b"").decode("latin-1"), DataType.VISIBLE_STRING).rstrip("\0 "),
        remark,
    )


def _optional(client: SdoClient, index: int, subindex: int) -> Procedure[bytes | None]:
    """Read an object that a device need not have; return None if it does not give it."""
    try:
        return (yield from upload(client, index, subindex))
    except SdoTransferError:
        return None


def duration_of(count: int, *, listen: Time = LISTEN, probe_timeout: Time = PROBE_TIMEOUT) -> Time:
    """Return how long a scan of `count` absent node-IDs takes, in ns: for progress and time limits. listen, probe_timeout: ns, as
    of `scan`."""
    return listen + -(-count // AT_ONCE) * (probe_timeout + PACE)
