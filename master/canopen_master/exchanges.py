"""The PDOs that a device exchanges in each SYNC cycle, as `Exchange`s (bus_timing.py): by its file, by a motion plan, or by name.

`canopen plan` and a chain count alike: RPDOs and synchronous TPDOs once in each cycle, event-driven TPDOs once per inhibit time,
or event timer. The rest is left out, with a note: an event-driven TPDO without either, and a PDO with a 29-bit identifier.

`room_for` is what a chain asks before it begins: whether SYNC and these PDOs always get through in time, whatever stuff bits they
have, with heartbeats and one SDO transfer beside them. EMCYs do not count: a burst of them delays some cycles, and is over.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from canopen_master.bus_timing import Exchange, OtherTraffic, fits, streams_of
from canopen_proto.dictionary import Direction, ObjectDictionary, PdoDescription
from canopen_proto.drives.axis.motion_plan import MotionPlan
from canopen_proto.frame import COB_ID_EXTENDED
from canopen_proto.machine import Time
from canopen_proto.manager.linking import LinkPlan
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.pdo.slots import interval_of, pdos_on_bus
from canopen_transports.wire import Wire, WireSettings, worst_bits

SYNCHRONOUS: Final = 240
"""The highest transmission type of a TPDO that is sent at a SYNC."""
BESIDE: Final = OtherTraffic(emcy=0)
"""The other traffic that a chain expects on its bus."""


class Counted(NamedTuple):
    """The PDOs of a device, as a plan counts them. left_out: its PDOs that are not counted, and why, for people."""

    exchange: Exchange
    left_out: tuple[str, ...] = ()


def exchange_of_file(name: str, node_id: int, dictionary: ObjectDictionary) -> Counted:
    """Return what a device with this file exchanges: all PDOs that are valid and not empty. name: of the device, for people."""
    return _exchange(name, node_id, dictionary, pdos_on_bus(dictionary, node_id))


def exchange_of_plans(name: str, plans: Sequence[MotionPlan]) -> Counted:
    """Return what a drive exchanges by the plans of its axes: their PDOs, and those TPDOs of its file that they leave alone.
    name: of the device, for people."""
    dictionary, node_id = plans[0].dictionary, plans[0].node_id
    planned = {pdo.place: pdo for plan in plans for pdo in plan.pdos}
    off = {pdo.place for plan in plans for pdo in (*plan.destroyed, *plan.spare)}
    alone = [pdo for pdo in pdos_on_bus(dictionary, node_id) if pdo.direction is Direction.TPDO]
    others = [pdo for pdo in alone if pdo.place not in planned.keys() | off]
    return _exchange(name, node_id, dictionary, [*planned.values(), *others])


def exchange_of_named(name: str, node_id: int, rpdo: PdoDescription, tpdo: PdoDescription) -> Counted:
    """Return what a device exchanges by two PDOs of PDOs.csv. name: of the device, for people."""
    received, sent = (((each.can_id(node_id), (each.bit_length + 7) // 8),) for each in (rpdo, tpdo))
    return Counted(Exchange(name, node_id, received, sent))


def exchange_with_links(counted: Counted, node: str, plan: LinkPlan) -> Counted:
    """Return what a node exchanges with the PDOs that links change, by name of the node. A PDO that another node sends to it is
    counted there. plan: of the links on its bus."""
    exchange = counted.exchange
    pdos = (*plan.pdos_of(node), *(each for each in plan.destroyed if each.node == node))
    gone = {each.slot.pdo.cob_id & 0x7FF for each in pdos if each.slot.pdo.is_valid}
    uncounted = [_without_distance(can_id) for can_id in gone]
    left_out = [each for each in counted.left_out if each not in uncounted]
    received, sent = ([each for each in old if each[0] not in gone] for old in (exchange.rpdo, exchange.tpdo))
    events = [each for each in exchange.events if each[0] not in gone]
    for transfer in plan.transfers:
        pdo, timing, size = transfer.sender, transfer.timing, transfer.size
        if pdo is None and transfer.receivers[0].node == node:
            received.append((transfer.can_id, size))
        elif pdo is None or pdo.node != node or pdo.is_shared:  # a shared one is its chain's
            continue
        elif timing.every:
            sent.append((transfer.can_id, size))
        elif distance := interval_of(pdo.settings, pdo.member.dictionary, pdo.member.node_id):
            events.append((transfer.can_id, size, distance))
        else:
            left_out.append(_without_distance(transfer.can_id))
    changed = replace(exchange, rpdo=tuple(received), tpdo=tuple(sent), events=tuple(events))
    return Counted(changed, tuple(left_out))


def _without_distance(can_id: int) -> str:
    return f"TPDO {can_id:03X} has no inhibit time and no event timer"


def _exchange(name: str, node_id: int, dictionary: ObjectDictionary, pdos: Iterable[PdoSettings]) -> Counted:
    received, sent, events, left_out = [], [], [], []
    for pdo in sorted(pdos, key=lambda pdo: (pdo.direction is Direction.TPDO, pdo.number)):
        can_id, size = pdo.cob_id & 0x7FF, pdo.size
        if pdo.cob_id & COB_ID_EXTENDED:
            left_out.append(f"PDO {pdo.cob_id & 0x1FFFFFFF:08X} has a 29-bit identifier")
        elif pdo.direction is Direction.RPDO:
            received.append((can_id, size))
        elif pdo.transmission_type <= SYNCHRONOUS:
            sent.append((can_id, size))
        elif distance := interval_of(pdo, dictionary, node_id):
            events.append((can_id, size, distance))
        else:
            left_out.append(_without_distance(can_id))
    return Counted(Exchange(name, node_id, tuple(received), tuple(sent), tuple(events)), tuple(left_out))


class Room(NamedTuple):
    """Whether the frames of a cycle fit. fits: they do. needed: the time that they need at worst, ns. rpdos, tpdos: how many."""

    fits: bool
    needed: Time
    rpdos: int
    tpdos: int


def room_for(joints: Sequence[Exchange], cycle_time: Time, bitrate: int, background: OtherTraffic = BESIDE) -> Room:
    """Look whether SYNC and all PDOs fit into each cycle; see this module's text. cycle_time: ns. bitrate: bit/s. background:
    what else is on the bus."""
    wire = Wire(WireSettings(bitrate=bitrate))
    rpdos, tpdos = [each for joint in joints for each in joint.rpdo], [each for joint in joints for each in joint.tpdo]
    sizes = [int(background.sync_counter), *(size for _, size in (*rpdos, *tpdos))]
    needed = sum(wire.time_of(worst_bits(size)) for size in sizes)
    return Room(fits(streams_of(joints, cycle_time, background), bitrate, background), needed, len(rpdos), len(tpdos))
