"""Each file of a real device becomes one: it boots, all its readable objects can be read, and its PDOs go out and come in.

Our own client reads, in virtual time. How often their files get something wrong that a device needs is in `NOTICES`.
"""

from __future__ import annotations

from functools import cache

import pytest

from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description
from canopen_data.device_notices import notices_of
from canopen_data.drive_from_file import drive_dictionary_of, drive_obstacle
from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402.names import is_drive
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoUploaded
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.vendor_files import ALL_NAMES, needs_vendor_files, path_of

pytestmark = needs_vendor_files

NODE = 5

DRIVES = {
    "cia-402.eds", "faulhaber-605.3150.51-V.eds", "faulhaber-605.3150.70-B.eds", "inovance-e35.eds", "maxon-epos2.eds",
    "ros2-cia402-slave.eds", "schunk-powerball-lwa4p.dcf",
}  # fmt: skip

NOTICES = {
    "canopen-sample.eds": 8,  # its PDOs carry objects that it has not
    "canopennode-demo-device.eds": 1,  # a text with a euro sign
    "cia-401.eds": 4,  # nothing is mapped
    "cia-402.eds": 4,
    "inovance-e35.eds": 1,
    "oresat-battery.dcf": 6,  # further TPDOs with the CAN-IDs of the first four
    "oresat-gps.xdd": 3,
    "schunk-powerball-lwa4p.dcf": 1,
}


@cache
def description(name: str) -> DeviceDescription:
    return load_description(path_of(name))


class Rig:
    """A device, and a client of it, on a bus that takes no time."""

    def __init__(self, name: str, *, drive: bool = False) -> None:
        self.now: Time = 0
        self.device, self.master = Network(), Network()
        dictionary = description(name).dictionary
        if drive:
            shape = Shape.SCHUNK_POWERBALL if "schunk" in name else Shape.STANDARD
            dictionary, _ = drive_dictionary_of(dictionary, shape)
            self.node: LocalNode = DriveNode(self.device.out, NODE, DriveSettings(shape), dictionary)
        else:
            self.node = LocalNode(self.device.out, NODE, dictionary)
        self.device.attach(self.node)
        self.client = SdoClient(self.master.out, NODE)
        self.master.attach(self.client)
        self.node.boot(0)
        self.heard: list[Frame] = []
        self.turn()

    def turn(self) -> list[object]:
        """Frames to and fro until nobody has more to say; what the client reports."""
        reports: list[object] = []
        while True:
            to_master, _ = self.device.drain(self.now)
            to_device, events = self.master.drain(self.now)
            reports += events
            self.heard += to_master
            if not to_master and not to_device:
                return reports
            for frame in to_master:
                self.master.receive(frame, self.now)
            for frame in to_device:
                self.device.receive(frame, self.now)

    def read(self, index: int, subindex: int) -> bytes | int:
        self.client.upload(index, subindex, self.now)
        (report,) = self.turn()
        if isinstance(report, SdoUploaded):
            return bytes(report.data)
        assert isinstance(report, SdoAborted), report
        return report.abort_code

    def tell(self, frame: str) -> list[str]:
        self.heard.clear()
        self.device.receive(Frame.parse(frame), self.now)
        self.turn()
        return [str(each) for each in self.heard]


@pytest.mark.parametrize("name", ALL_NAMES)
def test_it_boots_and_answers(name: str) -> None:
    rig = Rig(name)
    assert rig.node.state is NmtState.PRE_OPERATIONAL
    assert str(rig.heard[0]) == "705#00"
    for variable in rig.node.dictionary:
        answer = rig.read(variable.index, variable.subindex)
        if not variable.access.readable:
            assert answer == AbortCode.WRITE_ONLY
        elif variable.index == 0x1003 and variable.subindex:
            assert answer == AbortCode.NO_DATA
        else:
            assert answer == rig.node.values.raw(variable.index, variable.subindex), variable
            if variable.index not in (0x1003, 0x1010, 0x1011) and variable not in rig.node.values.unfit:
                assert answer == variable.encode(variable.initial_of(NODE)), variable


@pytest.mark.parametrize("name", ALL_NAMES)
def test_what_is_said_of_it(name: str) -> None:
    notices = notices_of(LocalNode(Outbox(), NODE, description(name).dictionary))
    assert len(notices) == NOTICES.get(name, 0), "\n".join(map(str, notices))


@pytest.mark.parametrize("name", ALL_NAMES)
def test_its_pdos_go_out_and_come_in(name: str) -> None:
    rig = Rig(name)
    assert rig.tell(f"000#01{NODE:02X}") == []
    pdos = rig.node.pdos
    live = [producer for producer in pdos.producers.values() if producer.is_live]
    for producer in live:
        if producer.is_event_driven:
            rig.heard.clear()
            producer.trigger(rig.now)
            rig.turn()
            data = producer.mapping.pack_from(rig.node.values.store)
            assert [(frame.key, frame.data) for frame in rig.heard] == [(producer.key, data)]
            rig.now = max(rig.now, rig.now + producer.inhibit_time)
    heard: list[str] = []
    for _ in range(240):
        heard += rig.tell("080#")
    for producer in live:
        if producer.is_synchronous and producer.transmission_type:
            assert producer.key is not None
            own = [frame for frame in heard if frame.startswith(f"{producer.key:03X}#")]
            others = [each for each in live if each.key == producer.key and each.is_synchronous and each.transmission_type]
            assert len(own) == sum(240 // each.transmission_type for each in others)
    for consumer in pdos.consumers.values():
        if consumer.is_live:
            assert consumer.key is not None
            data = bytes(range(1, consumer.mapping.byte_length + 1))
            rig.device.receive(Frame(consumer.key, data), rig.now)
            rig.turn()
            rig.tell("080#")
            assert consumer.mapping.pack_from(rig.node.values.store) == data
    rig.now += 10_000 * MILLISECOND
    rig.device.handle_timeout(rig.now)


@pytest.mark.parametrize("name", ALL_NAMES)
def test_which_ones_are_drives(name: str) -> None:
    dictionary = description(name).dictionary
    assert is_drive(dictionary) == (name in DRIVES)
    if name in DRIVES:
        assert drive_obstacle(dictionary) == ""


@pytest.mark.parametrize("name", sorted(DRIVES))
def test_the_simulated_drive_runs_behind_it(name: str) -> None:
    rig = Rig(name, drive=True)
    rig.node.execute(NmtCommand.START, rig.now)
    for command, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        rig.client.download(0x6040, 0, command.to_bytes(2, "little"), rig.now)
        rig.turn()
        word = rig.read(0x6041, 0)
        assert isinstance(word, bytes)
        assert int.from_bytes(word, "little") & 0x6F == state


def test_the_arm_has_the_pdos_of_its_dcf() -> None:
    """TPDO1 6041 6061 and TPDO3 6064 606C by the ParameterValues; RPDO1 60C1:01, as the DCF has it."""
    pdos = Rig("schunk-powerball-lwa4p.dcf").node.pdos
    assert [f"{mux >> 8:04X}" for mux in pdos.producers[1].mapping.muxes] == ["6041", "6061"]
    assert [f"{mux >> 8:04X}" for mux in pdos.producers[3].mapping.muxes] == ["6064", "606C"]
