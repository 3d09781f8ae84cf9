"""LSS in a device: it has nothing else while it has no node-ID, boots with the one it gets, and is that node from then on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_proto.dictionary import Object, ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.lss.slave import LssStoreRequested
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtState
from canopen_proto.parameter_storage import SIGNATURES
from canopen_proto.sdo.server import ObjectAccessPending
from canopen_proto.simulation.drive.node import powerball
from tests.core.bus import Bus, take_events


def dictionary() -> ObjectDictionary:
    """A device whose communication objects depend on its node-ID."""

    def depending(index: int, base: int, subindex: int = 0, highest: int = 0) -> Object:
        each = standard_object(index, highest=highest) if highest else standard_object(index)
        fields = dict(each.variables)
        fields[subindex] = replace(fields[subindex], default=base, adds_node_id=True)
        return replace(each, variables=fields)

    return ObjectDictionary(
        [
            standard_object(0x1000, 0x191),
            standard_object(0x1001),
            standard_object(0x1010, highest=1, defaults={1: 1}),
            standard_object(0x1011, highest=1, defaults={1: 1}),
            depending(0x1014, 0x80),
            standard_object(0x1016, highest=1),
            standard_object(0x1017),
            standard_object(0x1018, highest=4, defaults={1: 0x360, 2: 2, 3: 3, 4: 4}),
            depending(0x1800, 0x180, 1, highest=2),
            standard_object(0x1A00, highest=1, defaults={0: 0}),
            standard_object(0x1029, highest=1),
        ]
    )


class Scene:
    """One device on a bus, and a tool that sends frames. `say` returns what the device answers."""

    def __init__(self, node_id: int = UNCONFIGURED) -> None:
        self.bus = Bus()
        self.node = self.bus.attach(LocalNode(Outbox(), node_id, dictionary()))
        self.bus.on_event = self.host
        self.stores = True
        self.node.boot(0)
        self.bus.pump()

    def host(self, event: object) -> None:
        if isinstance(event, LssStoreRequested):
            self.node.lss.complete_store(0 if self.stores else 2, self.bus.now)
        elif isinstance(event, ObjectAccessPending):
            self.node.complete(event.access_id, None, self.bus.now)

    def say(self, *frames: str) -> list[str]:
        before = len(self.bus.sent)
        for frame in frames:
            self.bus.send(frame)
            self.bus.run(MILLISECOND)
        return [text for text in self.bus.trace()[before:] if text not in frames]

    def read(self, node_id: int, index: int, subindex: int = 0) -> int | None:
        """Read an object by SDO; None without an answer."""
        answers = self.say(f"{0x600 + node_id:03X}#40{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}00000000")
        values = [Frame.parse(text) for text in answers]
        return next((int.from_bytes(each.data[4:], "little") for each in values if each.can_id == 0x580 + node_id), None)


def test_an_unconfigured_device_has_lss_and_nothing_else() -> None:
    scene = Scene()
    assert scene.bus.trace() == []  # no boot-up
    assert scene.say("000#0100", "000#8200", "67F#4000100000000000", "6FF#4000100000000000", "000#82FF", "080#", "77F#R") == []
    assert scene.node.state is NmtState.INITIALISING
    assert scene.say("7E5#4C00000000000000") == ["7E4#5000000000000000"]


def test_it_boots_by_itself_when_it_has_its_id_and_configuration_is_left() -> None:
    scene = Scene()
    assert scene.say("7E5#0401000000000000", "7E5#1121000000000000") == ["7E4#1100000000000000"]
    assert scene.say("7E5#5E00000000000000") == ["7E4#5EFF000000000000"]
    assert scene.read(0x21, 0x1000) is None
    assert scene.say("7E5#0400000000000000") == ["721#00"]
    assert (scene.node.node_id, scene.node.state) == (0x21, NmtState.PRE_OPERATIONAL)
    assert scene.read(0x21, 0x1000) == 0x191
    assert scene.read(0x21, 0x1014) == 0xA1
    assert scene.read(0x21, 0x1800, 1) == 0x1A1
    scene.say("000#0121")
    assert scene.node.state is NmtState.OPERATIONAL
    assert scene.say("7E5#4C00000000000000", "7E5#5100000000800000") == []


def test_a_running_node_is_another_node_after_reset_communication() -> None:
    scene = Scene(4)
    scene.say("604#2B17100064000000")  # a heartbeat, which the reset takes back
    assert scene.say("7E5#0401000000000000", "7E5#1121000000000000", "7E5#0400000000000000") == ["7E4#1100000000000000"]
    assert (scene.read(4, 0x1000), scene.read(0x21, 0x1000)) == (0x191, None)
    assert scene.say("000#8204") == ["721#00"]
    assert (scene.read(4, 0x1000), scene.read(0x21, 0x1000)) == (None, 0x191)
    assert scene.read(0x21, 0x1014) == 0xA1
    scene.node.raise_error(0x1000, 1, b"", scene.bus.now)
    scene.bus.run(MILLISECOND)
    assert scene.bus.trace()[-1] == "0A1#0010010000000000"
    assert scene.say("000#8121") == ["704#00"]  # it was not stored


def test_a_stored_id_survives_the_power_and_one_that_was_not_stored_does_not() -> None:
    scene = Scene()
    scene.stores = False
    assert scene.say("7E5#0401000000000000", "7E5#1121000000000000", "7E5#1700000000000000")[-1] == "7E4#1702000000000000"
    scene.stores = True
    assert scene.say("7E5#1700000000000000") == ["7E4#1700000000000000"]
    assert scene.say("7E5#0400000000000000") == ["721#00"]
    assert scene.say("000#8121") == ["721#00"]
    again = LocalNode(Outbox(), UNCONFIGURED, dictionary())
    again.take_stored(scene.node.lss.persistent)
    again.boot(0)
    assert [str(frame) for frame in again.out.frames] == ["721#00"]
    assert again.values.store[mux(0x1014)] == 0xA1


def test_a_node_whose_id_is_taken_away_falls_silent_at_the_reset_and_can_get_another() -> None:
    scene = Scene(4)
    scene.say("604#2B17100064000000", "604#2316100164000500")  # a heartbeat, and one to watch
    scene.say("7E5#0401000000000000", "7E5#11FF000000000000")
    scene.bus.run(SECOND)
    assert scene.bus.trace()[-1].startswith("704#")
    assert scene.say("000#8204") == []
    scene.bus.sent.clear()
    scene.bus.run(SECOND)
    assert scene.bus.trace() == []
    assert scene.read(4, 0x1000) is None
    assert scene.say("7E5#0401000000000000", "7E5#1105000000000000", "7E5#0400000000000000")[-1] == "705#00"
    assert scene.read(5, 0x1014) == 0x85


def test_stored_cob_ids_follow_the_node_id_and_chosen_ones_stay() -> None:
    scene = Scene(4)
    scene.say("604#230018012A020080", f"604#2310100{1}{SIGNATURES[0x1010].to_bytes(4, 'little').hex()}")
    assert scene.node.storage.saved[mux(0x1014)] == 0x84
    scene.say("7E5#0401000000000000", "7E5#1121000000000000", "000#8204")
    assert scene.read(0x21, 0x1014) == 0xA1
    assert scene.read(0x21, 0x1800, 1) == 0x8000022A  # somebody chose it


def test_a_device_says_nothing_while_its_bit_rate_changes() -> None:
    scene = Scene(4)
    scene.say("604#2B17100064000000")
    scene.say("7E5#0401000000000000", "7E5#1300020000000000", "7E5#15F4010000000000")
    start = scene.bus.now
    scene.bus.sent.clear()
    scene.bus.run(400 * MILLISECOND)
    assert scene.read(4, 0x1000) is None
    scene.bus.run(500 * MILLISECOND)
    assert [str(frame) for time, frame in scene.bus.sent if not str(frame).startswith("604#")] == []
    scene.bus.run(300 * MILLISECOND)
    assert scene.bus.trace()[-1] == "704#7F"
    assert min(time for time, frame in scene.bus.sent if str(frame) == "704#7F") >= start + 998 * MILLISECOND
    assert scene.read(4, 0x1000) == 0x191
    assert scene.node.lss.active.bit_rate == 500


def test_a_drive_gets_its_id_too() -> None:
    node = powerball(Outbox(), UNCONFIGURED)
    node.boot(0)
    for text in ("7E5#0401000000000000", "7E5#1107000000000000", "7E5#0400000000000000"):
        node.receive(Frame.parse(text), MILLISECOND)
    assert "707#00" in [str(frame) for frame in node.out.frames]
    assert node.drive.node_id == 7
    take_events(node.out)
    node.raise_fault(0x2310, SECOND)
    assert {event.node_id for event in take_events(node.out)} == {7}


@pytest.mark.parametrize("node_id", [0, 128, 254, 256])
def test_other_node_ids_are_none(node_id: int) -> None:
    with pytest.raises(LocalProtocolError):
        LocalNode(Outbox(), node_id, dictionary())


def test_a_store_that_waits_ends_with_the_reset() -> None:
    scene = Scene(4)
    scene.bus.on_event = None
    scene.say("7E5#0401000000000000", "7E5#1700000000000000")
    assert scene.node.lss.is_storing
    scene.say("000#8204")
    assert not scene.node.lss.is_storing
    scene.node.lss.complete_store(0, scene.bus.now)  # late
    assert scene.node.out.frames == []
