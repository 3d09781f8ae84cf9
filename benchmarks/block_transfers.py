"""SDO block transfer with CRC: 64 KiB and 1 MiB each way. The client is ours or the peer's; the server is ours in both cases,
since the peer has none.

It is measured twice. `machines`: our client and server are two bare machines, with a loop that hands frames over and serves the
deadlines that are due. `Networks`: each is in a Network, which is drained and asked for its deadline in each turn, as a driver
does.
The peer's client is in its own Network, which is coupled to our server by a function call: what it sends is in our server before
`send` returns, and our answers are in its queue. Making its `can.Message` is part of what is measured, because `canopen` makes it
itself; our frames go in by its `Network.notify`, without a message.

The device is the same for both clients: server and store of a DOMAIN, bare (`machines`) or in our Network (`Networks`). Its cost
is in both figures, so the clients alone differ by more than the ratio says. The peer's frames come one by one, ours in bursts: so
the device is drained only when it has something to send, which costs the peer nothing more. Both clients give and take bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from canopen import Network as TheirNetwork
from canopen import ObjectDictionary as TheirDictionary
from canopen import RemoteNode as TheirNode
from direct import variable
from measure import Case

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Values, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.sdo.client import SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.store import ValuesStore

NODE_ID = 12
DOMAIN = 0x2001
SIZES = {"64 KiB": 1 << 16, "1 MiB": 1 << 20}

Transfer = Callable[[int], object]


class Device:
    """Our server of one DOMAIN."""

    def __init__(self, out: Outbox, size: int) -> None:
        dictionary = ObjectDictionary([Object.of("domain", [Variable(DOMAIN, 0, "domain", DataType.DOMAIN)])])
        self.values = Values(dictionary, NODE_ID)
        self.values[DOMAIN << 8] = bytes(range(256)) * (size // 256)
        self.server = SdoServer(out, NODE_ID, ValuesStore(self.values))


class Ours:
    """Our client and our server, and how frames go between them."""

    def __init__(self, through_networks: bool, size: int) -> None:
        self.now: Time = 0
        self.master, self.slave = Network(), Network()
        master_out, slave_out = (self.master.out, self.slave.out) if through_networks else (Outbox(), Outbox())
        self.client = SdoClient(master_out, NODE_ID)
        self.device = Device(slave_out, size)
        self.written = bytes(range(255, -1, -1)) * (size // 256)
        self._exchange = self._between_machines
        if through_networks:
            self.master.attach(self.client)
            self.slave.attach(self.device.server)
            self._exchange = self._through_networks

    def upload(self, count: int) -> object:
        """So many times; what was read."""
        data = b""
        for _ in range(count):
            self.now += MILLISECOND
            self.client.upload(DOMAIN, 0, self.now, block=True)
            (outcome,) = self._exchange(self.now)
            assert isinstance(outcome, SdoUploaded)
            data = outcome.data
        return data

    def download(self, count: int) -> object:
        """So many times; what was written."""
        for _ in range(count):
            self.now += MILLISECOND
            self.client.download(DOMAIN, 0, self.written, self.now, block=True)
            (outcome,) = self._exchange(self.now)
            assert isinstance(outcome, SdoDownloaded)
        return self.device.values.raw(DOMAIN, 0)

    def _between_machines(self, now: Time) -> list[Any]:
        client, server = self.client, self.device.server
        requests, responses = client.out.frames, server.out.frames
        while client.busy:
            for frame in requests:
                server.receive(frame, now)
            requests.clear()
            if server.deadline <= now:
                server.handle_timeout(now)
            for frame in responses:
                client.receive(frame, now)
            responses.clear()
            if client.deadline <= now:
                client.handle_timeout(now)
        for frame in requests:  # the last answer of an upload
            server.receive(frame, now)
        requests.clear()
        server.out.events.clear()
        events = client.out.events[:]
        client.out.events.clear()
        return events

    def _through_networks(self, now: Time) -> list[Any]:
        master, slave = self.master, self.slave
        outcome: list[Any] = []
        while True:
            busy = False
            for network, other in ((master, slave), (slave, master)):
                if network.next_deadline() <= now:
                    network.handle_timeout(now)
                frames, events = network.drain(now)
                if network is master:
                    outcome += events
                for frame in frames:
                    other.receive(frame, now)
                busy = busy or bool(frames) or network.next_deadline() <= now
            if not busy:
                return outcome


class Coupling:
    """Stands where the peer has a python-can bus: hands each message to our server, and our server's frames to the peer."""

    channel_info = "our server"

    def __init__(self, network: TheirNetwork, through_networks: bool, size: int) -> None:
        self._network = network
        self._slave = Network()
        self.device = Device(self._slave.out if through_networks else Outbox(), size)
        self._hand_over = self._to_machine
        if through_networks:
            self._slave.attach(self.device.server)
            self._hand_over = self._to_network

    def send(self, message: Any, timeout: float | None = None) -> None:
        for frame in self._hand_over(Frame(message.arbitration_id, bytes(message.data))):
            self._network.notify(frame.can_id, bytearray(frame.data), 0.0)

    def _to_network(self, request: Frame) -> list[Frame]:
        slave = self._slave
        slave.receive(request, 0)
        while slave.next_deadline() <= 0:
            slave.handle_timeout(0)
        return slave.drain(0)[0] if slave.out.frames else []

    def _to_machine(self, request: Frame) -> list[Frame]:
        server = self.device.server
        server.receive(request, 0)
        while server.deadline <= 0:
            server.handle_timeout(0)
        frames = server.out.frames.copy()
        server.out.frames.clear()
        server.out.events.clear()
        return frames


class Theirs:
    """The peer's client and our server."""

    def __init__(self, through_networks: bool, size: int) -> None:
        dictionary = TheirDictionary()
        dictionary.add_object(variable("domain", DOMAIN, 0, int(DataType.DOMAIN)))
        network = TheirNetwork()
        self._coupling = network.bus = Coupling(network, through_networks, size)
        self._remote = TheirNode(NODE_ID, dictionary)
        network[NODE_ID] = self._remote
        self._written = bytes(range(255, -1, -1)) * (size // 256)

    def upload(self, count: int) -> object:
        """So many times; what was read."""
        data = b""
        for _ in range(count):
            with self._remote.sdo.open(DOMAIN, 0, "rb", block_transfer=True) as stream:
                data = stream.read()
        return data

    def download(self, count: int) -> object:
        """So many times; what was written."""
        for _ in range(count):
            size = len(self._written)
            with self._remote.sdo.open(DOMAIN, 0, "wb", size=size, block_transfer=True) as stream:
                stream.write(self._written)
        return self._coupling.device.values.raw(DOMAIN, 0)


def _case(title: str, ours: Transfer, theirs: Transfer) -> Case:
    def check() -> None:
        assert ours(1) == theirs(1)

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """Each size and direction, between machines and between Networks."""
    found = []
    for kind in ("machines", "Networks"):
        for name, size in SIZES.items():
            ours, theirs = Ours(kind == "Networks", size), Theirs(kind == "Networks", size)
            found.append(_case(f"SDO block upload of {name} ({kind})", ours.upload, theirs.upload))
            found.append(_case(f"SDO block download of {name} ({kind})", ours.download, theirs.download))
    return found
