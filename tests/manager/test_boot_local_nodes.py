"""The boot-up of our own devices: LocalNodes with PDOs, stored parameters, and defaults that can be restored."""

from __future__ import annotations

from canopen_proto.dictionary.concise import from_concise, pack_concise
from canopen_proto.dictionary.download_order import download_order
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import BootEntry, NetworkEntry
from canopen_proto.manager.boot.network_boot import BootReport, NetworkBoot
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtState
from canopen_proto.testing import World
from tests.core.devices import INPUT, LIMITED, TEXT, whole_device

NODES = (2, 3, 4)
DICTIONARY = whole_device().with_objects([standard_object(0x1020, highest=2)])
LONG = "a name that takes a block transfer, or nine segments of seven bytes"
SETTINGS = {
    mux(0x1017): 100,
    mux(LIMITED): 17,
    mux(TEXT): LONG,
    mux(0x1801, 2): 2,
    mux(0x1A01): 1,
    mux(0x1A01, 1): INPUT << 16 | 0x10,
}


class Plant:
    """Three devices that store what they are told to, and their master."""

    def __init__(self) -> None:
        self.world = World()
        self.devices = {node_id: self.world.device(DICTIONARY, node_id) for node_id in NODES}
        self.master = self.world.master()
        self.remotes = {node_id: self.master.node(node_id) for node_id in NODES}

    def start(self, *, restore: bool = False) -> BootReport:
        self.before = len(self.world.bus().trace)
        order = download_order(DICTIONARY, SETTINGS, 0)
        entries = {
            node_id: BootEntry(
                node_id,
                Assignment(is_mandatory=True, restore=restore),
                device_type=0x191,
                vendor=0x29C,
                product=7,
                consumer_time=300 * MILLISECOND,
                restore_subindex=1,
                configuration=tuple(from_concise(pack_concise(order.writes))),
                date=(15000, 3_600_000),
                save=True,
            )
            for node_id in NODES
        }
        network = NetworkEntry(Startup(start_all=True), entries)
        boot = NetworkBoot(self.master.runs, self.master.nmt, network, self.remotes)
        report = self.master.run(boot.start(), SECOND)
        self.world.advance(MILLISECOND)  # the last command arrives
        return report

    def writes(self) -> int:
        frames = [each.frame for each in self.world.bus().trace[self.before :]]
        return sum(frame.can_id >> 7 == 0x600 >> 7 and frame.data[0] >> 5 == 1 for frame in frames)


def test_our_devices_are_booted_and_keep_their_configuration() -> None:
    plant = Plant()
    report = plant.start()
    assert report.running == NODES, [str(each) for each in report.outcomes.values()]
    assert [device.state for device in plant.devices.values()] == [NmtState.OPERATIONAL] * 3
    for device in plant.devices.values():
        assert {key: device.values[key] for key in SETTINGS} == SETTINGS
        assert (device.values[mux(0x1020, 1)], device.values[mux(0x1020, 2)]) == (15000, 3_600_000)
    assert plant.writes() > 3 * len(SETTINGS)

    plant.start()
    assert plant.writes() == 0, "they have kept it, and show its date"


def test_defaults_are_restored_before_another_configuration() -> None:
    plant = Plant()
    for device in plant.devices.values():
        device.values[mux(0x1007)] = 12345
    report = plant.start(restore=True)
    assert report.running == NODES, [str(each) for each in report.outcomes.values()]
    for device in plant.devices.values():
        assert device.values[mux(0x1007)] == 0
        assert {key: device.values[key] for key in SETTINGS} == SETTINGS
