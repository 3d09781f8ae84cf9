"""The station of docs/own-device.md under canopen 2.4.1, which knows it by the EDS that we write, and under the recorded master
of Lely; and a device of durand 0.5."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import canopen
import durand
import pytest
from durand.services.nmt import StateEnum

from canopen_data.declared import describe_device
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_data.findings import Severity
from canopen_master.simulation.device_code import load_device
from canopen_proto.abort import AbortCode
from canopen_proto.declared import DeclaredDevice
from canopen_proto.dictionary import Access
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, Event, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import ObjectAccessPending
from tests.cli.test_device import station
from tests.interop.device_rig import NODE, Rig
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_network
from tests.interop.recorded import load


class Served:
    """The station on a bus, and the peer's view of it by its EDS."""

    def __init__(self, driver: Driver, peer: canopen.Network, kind: type[DeclaredDevice]) -> None:
        self.made: list[Any] = []
        eds = io.StringIO(write_eds(describe_device(kind)))
        theirs = canopen.objectdictionary.eds.import_eds(eds, NODE)  # type: ignore[no-untyped-call]

        def make(out: Outbox) -> Any:
            self.made.append(kind(out, NODE))
            return self.made[0].node

        self.rig = Rig(driver, peer, make, lambda node_id, dictionary: canopen.RemoteNode(node_id, theirs))
        self.remote = self.rig.remote
        self.device = self.made[0]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer, driver:
        yield Served(driver, peer, load_device(str(station(tmp_path))))


def test_the_peer_reads_every_object_by_its_name_in_our_eds(served: Served) -> None:
    count = 0
    for each in served.device.dictionary.objects.values():
        for variable in each.variables.values():
            if variable.access is Access.WO or (variable.index == 0x1003 and variable.subindex):
                continue
            theirs = served.remote.sdo[each.name]
            data = (theirs if len(each.variables) == 1 else theirs[variable.name]).data
            assert data == served.device.node.values.raw(variable.index, variable.subindex)
            count += 1
    assert count > 80


def test_the_peer_exchanges_pdos_with_the_station(served: Served) -> None:
    remote, device = served.remote, served.device
    remote.tpdo.read()
    remote.rpdo.read()
    heard: list[int] = []
    remote.tpdo[1].add_callback(lambda pdo: heard.append(pdo["Read input 8-bit.Inputs 1 to 8"].raw))
    served.rig.start()
    remote.rpdo[1]["Write output 8-bit.Outputs 1 to 8"].raw = 0x81
    remote.rpdo[1].transmit()
    served.rig.wait(lambda: 0x81 in heard)
    assert device.board.bits == {1: 0x81, 2: 0}
    remote.nmt.state = "PRE-OPERATIONAL"
    served.rig.wait(lambda: device.board.bits == {1: 0, 2: 0})


def test_the_peer_is_refused_what_the_station_cannot_do(served: Served) -> None:
    voltage = served.remote.sdo["Write analogue output 16-bit"][1]
    voltage.raw = 5000
    assert served.device.board.voltages[1] == 5000
    with pytest.raises(canopen.SdoAbortedError) as refused:
        voltage.raw = 10_001
    assert refused.value.code == AbortCode.INVALID_VALUE
    assert served.remote.sdo["Read analogue input 16-bit"][1].raw == 5000


def test_the_peer_stores_a_parameter(served: Served) -> None:
    kept: dict[int, bytes] = {}

    def answer(now: Time) -> None:
        for report in served.rig.driver.events:
            if isinstance(report, ObjectAccessPending):
                kept.update(served.device.node.storage.to_keep(report.index, report.subindex))
                served.device.node.complete(report.access_id, None, now)

    served.rig.driver.on_events = lambda: served.rig.driver.do(answer)
    served.remote.sdo["Place"]["Row"].raw = 7
    served.remote.sdo["Write output 8-bit"][1].raw = 3
    served.remote.sdo["Store parameters"]["Save all parameters"].raw = 0x65766173
    assert kept[0x200002] == b"\x07"
    assert 0x620001 not in kept
    served.remote.nmt.state = "RESET"
    served.rig.wait(lambda: served.remote.nmt.state == "PRE-OPERATIONAL")
    assert served.remote.sdo["Place"]["Row"].raw == 7


# ---- the master of Lely, as it was recorded: it boots node 4, a slave of Lely that is an I/O station, too ----

LELY_DIFFERS = {
    "604#4018100200000000": ("584#4318100201040000", "its own product code, 0x401"),
    "604#23001A0220011021": ("584#80001A0200000206", "it has no object 0x2110 to be mapped: 0602 0000"),
    "604#2310210334120000": ("584#8010210300000206", "likewise"),
}
"""What the station answers otherwise than the recorded slave, by the request."""


def test_the_recorded_master_of_lely_configures_the_station_and_exchanges_pdos_with_it(tmp_path: Path) -> None:
    """It waits for the station's boot-up, as for that of its slave. That one then started by itself; ours is started here."""
    network = Network()
    device: Any = load_device(str(station(tmp_path)))(network.out, 4)
    network.attach(device.node)
    lines = load("lely-master-boots-lely-slave")
    configured = max(number for number, line in enumerate(lines) if line.frame.can_id == 0x584)
    sent: list[str] = []

    def tell(frame: Frame, now: Time) -> list[str]:
        network.receive(frame, now)
        told = [str(each) for each in network.drain(now)[0]]
        sent.extend(told)
        return told

    device.node.boot(lines[0].time)
    sent += [str(frame) for frame in network.drain(lines[0].time)[0]]
    assert sent == ["704#00"]
    requests = 0
    differ = dict(LELY_DIFFERS)
    for number, (time, frame) in enumerate(lines):
        while network.next_deadline() <= time:
            network.handle_timeout(network.next_deadline())
            sent += [str(each) for each in network.drain(time)[0]]
        if frame.can_id == 0x604:
            requests += 1
            recorded = next(line.text for line in lines[number:] if line.frame.can_id == 0x584)
            answer, _ = differ.pop(str(frame), (recorded, ""))
            assert [text for text in tell(frame, time) if text.startswith("584#")] == [answer]
        elif frame.can_id not in (0x184, 0x584, 0x704):
            tell(frame, time)
        if number == configured:
            tell(Frame.parse("000#0104"), time)
            assert device.node.state is NmtState.OPERATIONAL
    assert (requests, differ) == (18, {})
    syncs = sum(line.frame.can_id == 0x080 for line in lines[configured:])
    assert sent.count("184#0000") == syncs > 70
    assert sent.count("704#05") >= (lines[-1].time - lines[configured].time) // (200 * MILLISECOND)
    for text in ("204#A55A", "080#"):  # the master has made it a synchronous RPDO
        assert list(device.outputs) == [0, 0]
        tell(Frame.parse(text), lines[-1].time)
    assert list(device.outputs) == [0xA5, 0x5A]


# ---- durand ----


class Coupling(durand.network.NetworkABC):  # type: ignore[misc]
    """What is between a device of durand and a network of ours: a frame is handed over by a call."""

    def __init__(self) -> None:
        self.master = Network()
        self.callbacks: dict[int, Callable[[int, bytes], None]] = {}

    def add_subscription(self, cob_id: int, callback: Callable[[int, bytes], None]) -> None:
        self.callbacks[cob_id] = callback

    def remove_subscription(self, cob_id: int) -> None:
        del self.callbacks[cob_id]

    def send(self, cob_id: int, msg: bytes) -> None:
        self.master.receive(Frame(cob_id, bytes(msg)), 0)

    def exchange(self) -> list[Event]:
        """Hand the frames over until there are none; what our side reports."""
        reported: list[Event] = []
        while True:
            frames, events = self.master.drain(0)
            reported += events
            if not frames:
                return reported
            for frame in frames:
                self.callbacks[frame.can_id](frame.can_id, frame.data)


def test_a_device_of_durand_is_read_and_written_by_its_own_eds() -> None:
    """It has no reader of such files: ours is read by nobody there."""
    coupling = Coupling()
    node = durand.Node(coupling, node_id=NODE)
    record = durand.Record(name="Pump")
    record[1] = durand.Variable(durand.DatatypeEnum.REAL32, access="rw", value=0.5, name="Speed")
    node.object_dictionary[0x2001] = record
    found = read_eds(node.eds.content)
    speed = found.dictionary.variable("Pump:Speed")
    assert (speed.index, speed.subindex, speed.default) == (0x2001, 1, 0.5)
    errors = [each for each in found.findings if each.severity is Severity.ERROR]
    assert [each.message for each in errors] == ["in [1015]: DefaultValue '0.0' is not a number; left out"]

    remote = RemoteNode(coupling.master.out, NODE, found.dictionary)
    coupling.master.attach(remote)
    node.nmt.set_state(StateEnum.PRE_OPERATIONAL)
    remote.write("Pump:Speed", 1.5, 0)
    assert any(isinstance(event, SdoDownloaded) for event in coupling.exchange())
    assert node.object_dictionary.read(0x2001, 1) == 1.5
    remote.read("Pump:Speed", 0)
    (uploaded,) = [event for event in coupling.exchange() if isinstance(event, SdoUploaded)]
    assert remote.value_of(uploaded) == 1.5
