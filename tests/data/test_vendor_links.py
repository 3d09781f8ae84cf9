"""Links of real devices: what their files allow is accepted by a device that is made of the file, and arrives."""

from __future__ import annotations

from functools import cache

import pytest

from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Direction, Variable
from canopen_proto.manager.linking import MASTER, End, KnownNode, Link, LinkError, Timing, plan_links
from canopen_proto.pdo.slots import entry_of, slots_of
from tests.manager.linked_devices import OBJECTS, Linked, member
from tests.vendor_files import ALL_NAMES, needs_vendor_files, path_of

pytestmark = needs_vendor_files

EVENT = Timing(every=0)
WITHOUT_SYNC = {"canopen-sample.eds", "cia-401.eds", "cia-402.eds", "sample-node-1.eds", "sample-node-1.xdd"}
FIXED = {"faulhaber-605.3150.51-V.eds"}  # all its PDOs


@cache
def described(name: str) -> DeviceDescription:
    return load_description(path_of(name))


def member_of(description: DeviceDescription) -> KnownNode:
    dummies = frozenset(each for each, usable in (description.dummies or {}).items() if usable)
    return KnownNode("device", 5, description.dictionary, description.device_info.granularity, dummies)


def mappable(device: KnownNode, direction: Direction) -> list[Variable]:
    return [each for each in device.dictionary if entry_of(device.dictionary, each.mux, direction)[0] is not None]


def ends(variables: list[Variable]) -> tuple[End, ...]:
    return tuple(End("device", (each.index, each.subindex)) for each in variables)


@pytest.mark.parametrize("name", ALL_NAMES)
def test_the_master_exchanges_objects_with_each_device(name: str) -> None:
    device = member_of(described(name))
    timing = EVENT if name in WITHOUT_SYNC else Timing()
    sent, received = (mappable(device, direction)[:2] for direction in (Direction.TPDO, Direction.RPDO))
    to_master = Link("to", ends(sent), (End(MASTER),), timing)
    from_master = Link("from", (End(MASTER),), ends(received[::-1]), timing)
    node = Linked(plan_links([device], [to_master, from_master])).nodes["device"]
    sending = {mux for pdo in node.pdos.producers.values() if pdo.key is not None for mux in pdo.mapping.muxes}
    receiving = [mux for pdo in node.pdos.consumers.values() if pdo.key is not None for mux in pdo.mapping.muxes]
    assert {each.mux for each in sent} <= sending
    assert all(receiving.count(each.mux) == 1 for each in received)
    if name in WITHOUT_SYNC:
        with pytest.raises(LinkError, match="does not listen to SYNC"):
            plan_links([device], [Link("to", ends(sent), (End(MASTER),))])


@pytest.mark.parametrize("name", sorted(set(ALL_NAMES) - FIXED))
def test_one_of_our_devices_feeds_each_device(name: str) -> None:
    """An object of each device that is as wide as one of ours; nothing else in the PDO needs a dummy entry."""
    device, source = member_of(described(name)), member("source", 1)
    by_type = {each: index for index, each in OBJECTS.items()}
    target = next(each for each in mappable(device, Direction.RPDO) if each.data_type in by_type)
    linked = Linked(plan_links([device, source], [Link("feed", (End("source", by_type[target.data_type]),), ends([target]))]))
    value = 0.5 if target.data_type is DataType.REAL32 else 3
    linked.nodes["source"].values.store[by_type[target.data_type] << 8] = value
    linked.sync()
    linked.sync()
    assert linked.nodes["device"].values.store[target.mux] == value


@pytest.mark.parametrize("name", sorted(set(ALL_NAMES) - FIXED))
def test_other_pdos_of_the_device_stay(name: str) -> None:
    device = member_of(described(name))
    target = mappable(device, Direction.RPDO)[0]
    plan = plan_links([device], [Link("from", (End(MASTER),), ends([target]))])
    changed = {pdo.settings.place for pdo in (*plan.pdos_of("device"), *plan.destroyed)}
    node = Linked(plan).nodes["device"]
    for slot in slots_of(device.dictionary, 5):
        pdo = slot.pdo
        if slot.is_described and pdo.place not in changed:
            pdos = node.pdos.consumers if pdo.direction is Direction.RPDO else node.pdos.producers
            assert pdos[pdo.number].mapping.parameters == pdo.entries
