"""SDO: an expedited round trip (request, answer, outcome), and 64 KiB in segments each way. Client and server are both counted.

Nothing lies between the two: no bus, no thread. Ours is measured in three ways:

- machines: the two machines that it takes, frames handed over by a loop;
- Networks: the two machines, each in a Network, which is drained and asked for its deadline after every frame, as a driver does;
- RemoteNode: a RemoteNode and a LocalNode in two such Networks.

The peer is always its RemoteNode and its LocalNode in two of its Networks, coupled by a function call (direct.py): its client and
server send through these. So only `RemoteNode` compares like with like; the other two show what the layers cost. Names and values
are left out here: read_by_name.py.

Both servers serve an object dictionary with the same objects, two UNSIGNED32, a DOMAIN and the device type, which every device
has and which our client asks for between two writes of one object. So "of one object" costs our side two exchanges, and "of two
in turn" one, as it does where a program writes a configuration. They check the access, and hold the value (ours as a Python
value, encoded for each answer; the peer's as bytes). Both clients give bytes. Our RemoteNode also decodes what was read, for
its image of the device. Each outcome is looked at; ours has time-outs set at both ends, the peer a queue with a time-out at the
client.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle, islice

from canopen import ObjectDictionary as TheirDictionary
from canopen import RemoteNode as TheirNode
from direct import coupled_networks, variable
from measure import Case

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Values, Variable
from canopen_proto.indices import DEVICE_TYPE
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Event, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.store import ValuesStore

NODE_ID = 12
NUMBER, DOMAIN, OTHER_NUMBER = 0x2000, 0x2001, 0x2002
KIBIBYTES_64 = bytes(range(256)) * 256

Exchange = Callable[[Time], list[Event]]
Transfers = dict[str, Callable[[int], object]]
"""By name: do it n times; the last value read, or (at the other end) written."""


class Ours:
    """Our client and server, and how frames go between them."""

    def __init__(self, kind: str) -> None:
        """kind: "machines", "Networks" or "RemoteNode"; see this module's text."""
        dictionary = ObjectDictionary(
            [
                Object.of("device_type", [Variable(DEVICE_TYPE, 0, "device_type", DataType.UNSIGNED32)]),
                Object.of("number", [Variable(NUMBER, 0, "number", DataType.UNSIGNED32)]),
                Object.of("other", [Variable(OTHER_NUMBER, 0, "other", DataType.UNSIGNED32)]),
                Object.of("domain", [Variable(DOMAIN, 0, "domain", DataType.DOMAIN)]),
            ]
        )
        self.now = 0
        self.master, self.device = Network(), Network()
        self.exchange: Exchange = self._through_networks
        if kind == "RemoteNode":
            self._make_nodes(dictionary)
        else:
            self._make_machines(dictionary, kind == "Networks")
        self.values.write(NUMBER, 0x12345678)
        self.values.write(DOMAIN, KIBIBYTES_64)

    def _make_machines(self, dictionary: ObjectDictionary, in_networks: bool) -> None:
        self.values = Values(dictionary, NODE_ID)
        master_out, device_out = (self.master.out, self.device.out) if in_networks else (Outbox(), Outbox())
        self.client = SdoClient(master_out, NODE_ID)
        self.server = SdoServer(device_out, NODE_ID, ValuesStore(self.values))
        if in_networks:
            self.master.attach(self.client)
            self.device.attach(self.server)
        else:
            self.exchange = self._between_machines

    def _make_nodes(self, dictionary: ObjectDictionary) -> None:
        remote = RemoteNode(self.master.out, NODE_ID, dictionary)
        local = LocalNode(self.device.out, NODE_ID, dictionary)
        self.master.attach(remote)
        self.device.attach(local)
        local.boot(self.now)
        self.device.drain(self.now)
        self.client, self.values = remote.sdo, local.values

    def _between_machines(self, now: Time) -> list[Event]:
        client, server = self.client, self.server
        requests, responses = client.out.frames, server.out.frames
        while requests:
            for frame in requests:
                server.receive(frame, now)
            requests.clear()
            for frame in responses:
                client.receive(frame, now)
            responses.clear()
        server.out.events.clear()
        events = client.out.events[:]
        client.out.events.clear()
        return events

    def _through_networks(self, now: Time) -> list[Event]:
        master, device = self.master, self.device
        outcome: list[Event] = []
        while True:
            frames, events = master.drain(now)
            outcome += events
            master.next_deadline()
            if not frames:
                return outcome
            for frame in frames:
                device.receive(frame, now)
            frames, _ = device.drain(now)
            device.next_deadline()
            for frame in frames:
                master.receive(frame, now)

    def transfers(self) -> Transfers:
        """What can be done."""
        return {
            "expedited upload": lambda count: self._upload(NUMBER, count),
            "expedited download of one object": lambda count: self._download(bytes(4), count, NUMBER),
            "expedited download of two in turn": lambda count: self._download(bytes(4), count, NUMBER, OTHER_NUMBER),
            "upload of 64 KiB": lambda count: self._upload(DOMAIN, count),
            "download of 64 KiB": lambda count: self._download(KIBIBYTES_64[::-1], count, DOMAIN),
        }

    def _upload(self, index: int, count: int) -> bytes:
        data = b""
        for _ in range(count):
            self.now += MILLISECOND
            self.client.upload(index, 0, self.now)
            (outcome,) = self.exchange(self.now)
            assert isinstance(outcome, SdoUploaded)
            data = outcome.data
        return data

    def _download(self, data: bytes, count: int, *indices: int) -> bytes:
        for index in islice(cycle(indices), count):
            self.now += MILLISECOND
            self.client.download(index, 0, data, self.now)
            (outcome,) = self.exchange(self.now)
            assert isinstance(outcome, SdoDownloaded)
        return self.values.raw(indices[0], 0)


def their_transfers() -> Transfers:
    """The same with the peer."""
    dictionary = TheirDictionary()
    dictionary.add_object(variable("device_type", DEVICE_TYPE, 0, int(DataType.UNSIGNED32)))
    dictionary.add_object(variable("number", NUMBER, 0, int(DataType.UNSIGNED32)))
    dictionary.add_object(variable("other", OTHER_NUMBER, 0, int(DataType.UNSIGNED32)))
    dictionary.add_object(variable("domain", DOMAIN, 0, int(DataType.DOMAIN)))
    master, device = coupled_networks()
    local = device.create_node(NODE_ID, dictionary)
    local.set_data(NUMBER, 0, (0x12345678).to_bytes(4, "little"))
    local.set_data(DOMAIN, 0, KIBIBYTES_64)
    remote = TheirNode(NODE_ID, dictionary)
    master[NODE_ID] = remote

    def upload(index: int, count: int) -> bytes:
        data = b""
        for _ in range(count):
            data = remote.sdo.upload(index, 0)
        return data

    def download(data: bytes, count: int, *indices: int) -> bytes:
        for index in islice(cycle(indices), count):
            remote.sdo.download(index, 0, data)
        return bytes(local.get_data(indices[0], 0))

    return {
        "expedited upload": lambda count: upload(NUMBER, count),
        "expedited download of one object": lambda count: download(bytes(4), count, NUMBER),
        "expedited download of two in turn": lambda count: download(bytes(4), count, NUMBER, OTHER_NUMBER),
        "upload of 64 KiB": lambda count: upload(DOMAIN, count),
        "download of 64 KiB": lambda count: download(KIBIBYTES_64[::-1], count, DOMAIN),
    }


def _case(title: str, ours: Callable[[int], object], theirs: Callable[[int], object]) -> Case:
    def check() -> None:
        assert ours(2) == theirs(2)

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """Each transfer between machines, Networks and nodes."""
    return [
        _case(f"SDO {name} ({kind})", transfer, theirs[name])
        for kind, theirs in ((kind, their_transfers()) for kind in ("machines", "Networks", "RemoteNode"))
        for name, transfer in Ours(kind).transfers().items()
    ]
