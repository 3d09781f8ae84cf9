"""An object is read and written by its name, through whole nodes on both sides; the read ends with the decoded value.

Both sides have a view of the node (our RemoteNode, the peer's) and a device (our LocalNode, the peer's), each behind a network,
coupled by a function call. Ours is driven as a driver would do it: drained, and asked for its deadline, after every frame. The
peer is read and written by `node.sdo["Statusword"].raw`, ours by `RemoteNode.read` and `value_of`, and `RemoteNode.write`.
The two objects are an UNSIGNED16 by its own name, and an INTEGER32 that is a field of a record. Both devices have the device type
too, as every device does: our client asks for it between two writes of one object.

Ours does more, and all of it is counted: it keeps what was read in the node's image of the device, checks the access and the
limits before it writes, and has time-outs at both ends. The peer has a queue with a time-out at the client.
"""

from __future__ import annotations

from collections.abc import Callable

from canopen import ObjectDictionary as TheirDictionary
from canopen import RemoteNode as TheirNode
from direct import coupled_networks, record, variable
from measure import Case

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.indices import DEVICE_TYPE
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Event, Time
from canopen_proto.network import Network
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoDownloaded, SdoUploaded

NODE_ID = 12
STATUSWORD, LIMITS = 0x6041, 0x607D
VALUES: dict[str, int] = {"Statusword": 0x0237, "Software position limit:Min position limit": -70_000}


class OurNodes:
    """A RemoteNode and the LocalNode that it is the view of."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self.now: Time = 0
        self.master, self.slave = Network(), Network()
        self.remote = RemoteNode(self.master.out, NODE_ID, dictionary)
        self.local = LocalNode(self.slave.out, NODE_ID, dictionary)
        self.master.attach(self.remote)
        self.slave.attach(self.local)
        self.local.boot(self.now)
        self.slave.drain(self.now)

    def exchange(self) -> list[Event]:
        """Let the frames go to and fro until there are none; what the master reported."""
        master, slave, now = self.master, self.slave, self.now
        reported: list[Event] = []
        while True:
            frames, events = master.drain(now)
            master.next_deadline()
            reported += events
            if not frames:
                return reported
            for frame in frames:
                slave.receive(frame, now)
            for frame in slave.drain(now)[0]:
                master.receive(frame, now)
            slave.next_deadline()

    def read(self, name: str, count: int) -> Value:
        """Read an object so many times; its value."""
        value: Value = 0
        for _ in range(count):
            self.now += MILLISECOND
            self.remote.read(name, self.now)
            (outcome,) = self.exchange()
            assert isinstance(outcome, SdoUploaded)
            value = self.remote.value_of(outcome)
        return value

    def write(self, name: str, count: int) -> Value:
        """Write an object so many times; the value that the device then has."""
        for _ in range(count):
            self.now += MILLISECOND
            self.remote.write(name, VALUES[name], self.now)
            (outcome,) = self.exchange()
            assert isinstance(outcome, SdoDownloaded)
        return self.local.values.read(name)


def our_dictionary() -> ObjectDictionary:
    """The device type, an UNSIGNED16, and a record of two INTEGER32."""
    device_type = Variable(DEVICE_TYPE, 0, "Device type", DataType.UNSIGNED32)
    limits = [
        Variable(LIMITS, 1, "Min position limit", DataType.INTEGER32),
        Variable(LIMITS, 2, "Max position limit", DataType.INTEGER32),
    ]
    statusword = Variable(STATUSWORD, 0, "Statusword", DataType.UNSIGNED16)
    return ObjectDictionary(
        [
            Object.of("Device type", [device_type]),
            Object.of("Statusword", [statusword]),
            Object.of("Software position limit", limits),
        ]
    )


class TheirNodes:
    """The same with the peer."""

    def __init__(self) -> None:
        dictionary = TheirDictionary()
        dictionary.add_object(variable("Device type", DEVICE_TYPE, 0, int(DataType.UNSIGNED32)))
        dictionary.add_object(variable("Statusword", STATUSWORD, 0, int(DataType.UNSIGNED16)))
        members = [
            variable("Min position limit", LIMITS, 1, int(DataType.INTEGER32)),
            variable("Max position limit", LIMITS, 2, int(DataType.INTEGER32)),
        ]
        dictionary.add_object(record("Software position limit", LIMITS, *members))
        self.master, slave = coupled_networks()
        self.local = slave.create_node(NODE_ID, dictionary)
        self.remote = TheirNode(NODE_ID, dictionary)
        self.master[NODE_ID] = self.remote

    def read(self, name: str, count: int) -> Value:
        """Read an object so many times; its value."""
        value: Value = 0
        first, _, field = name.partition(":")
        sdo = self.remote.sdo
        for _ in range(count):
            value = (sdo[first][field] if field else sdo[first]).raw
        return value

    def write(self, name: str, count: int) -> Value:
        """Write an object so many times; the value that the device then has."""
        first, _, field = name.partition(":")
        sdo = self.remote.sdo
        for _ in range(count):
            (sdo[first][field] if field else sdo[first]).raw = VALUES[name]
        held: Value = (self.local.sdo[first][field] if field else self.local.sdo[first]).raw
        return held


def _case(title: str, ours: Callable[[int], Value], theirs: Callable[[int], Value], expected: Value) -> Case:
    def check() -> None:
        assert ours(2) == theirs(2) == expected

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """Write, then read, each object; the read finds what was written."""
    ours, theirs = OurNodes(our_dictionary()), TheirNodes()
    found = []
    for name, value in VALUES.items():
        kind = "field of a record" if ":" in name else "object"
        for verb in ("write", "read"):
            mine, peers = getattr(ours, verb), getattr(theirs, verb)
            title = f"{verb} by name, {kind} (RemoteNode)"
            found.append(_case(title, lambda n, f=mine, k=name: f(k, n), lambda n, f=peers, k=name: f(k, n), value))
    return found
