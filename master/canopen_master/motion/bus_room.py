"""Whether the PDOs of a chain fit on its buses: found out before any PDO is set up, and before anything moves.

On a bus without room, set-points and positions come later and later, and SDO (which halts and watches) does not get through. So
`make_room` counts what SYNC and the PDOs of a cycle need at worst, with those of other chains on the bus (exchanges.py). If they
do not fit, joints with a plan of their own do without the TPDOs that only tell what is welcome (a `lean` plan): these TPDOs are
switched off in the drives, until their next reset, and the logger `canopen_master` says so. If that is not enough, the chain does
not begin.

The bit rate is the transport's, else the machine file's (`Bus.bitrate`). If neither is known, nothing is looked at. PDOs of nodes
that are no joints are not counted.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Final, TypeAlias

from canopen_master.bus_timing import Exchange, milliseconds, shortest_cycle
from canopen_master.errors import CHAIN_NOT_READY, ChainError
from canopen_master.exchanges import BESIDE, Room, exchange_of_named, exchange_of_plans, room_for
from canopen_master.motion.chain_settings import ChainSettings
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import named_pdos, plan_joint
from canopen_master.motion.member import Member
from canopen_master.participant.bus import Bus
from canopen_proto.explained import counted
from canopen_proto.machine import SECOND, Time
from canopen_transports.locator import bitrate_text

Joint: TypeAlias = tuple[Device, ChainSettings]
"""A joint, with the settings of its chain."""
LOGGER: Final = logging.getLogger("canopen_master")


def make_room(chain: Member, others: Collection[Member], bus_of: Callable[[str], Bus]) -> None:
    """Give the joints of a chain plans that fit on their buses, or raise ChainError. others: chains that run. bus_of: by its
    name."""
    for bus in dict.fromkeys(bus_of(device.node.bus) for device in chain.devices):
        if bus.bitrate is None:
            continue
        own, *rest = ([each for each in it.devices if bus_of(each.node.bus) is bus] for it in (chain, *others))
        joints = [(device, it.settings) for it, group in zip((chain, *others), (own, *rest), strict=True) for device in group]
        _make_room_on(bus, chain, own, joints)


def _make_room_on(bus: Bus, chain: Member, devices: Sequence[Device], joints: Collection[Joint]) -> None:
    """joints: all on this bus, with `devices`."""
    cycle = round(chain.settings.cycle_time * SECOND)
    full = _room(bus, joints, cycle)
    if full.fits:
        return
    planned = [device for device in devices if device.plan is not None]
    for device in planned:
        plan_joint(device, chain.settings, lean=True)
    lean = _room(bus, joints, cycle)
    if not lean.fits:
        raise _no_room(chain.name, bus, joints, cycle, lean)
    spare = dict.fromkeys(f"TPDO {pdo.number}" for device in planned if device.plan is not None for pdo in device.plan.spare)
    LOGGER.warning(
        "chain %s: %s, too much. So %s of its joints are switched off until the drives are reset; %s remain",
        chain.name,
        _told(bus, cycle, full),
        ", ".join(spare),
        milliseconds(lean.needed),
    )


def _room(bus: Bus, joints: Collection[Joint], cycle: Time) -> Room:
    assert bus.bitrate is not None
    counter = bus.sync is not None and bus.sync.counter_overflow > 0
    return room_for(_exchanges(joints), cycle, bus.bitrate, replace(BESIDE, sync_counter=counter))


def _exchanges(joints: Iterable[Joint]) -> list[Exchange]:
    """Return what the nodes of these joints exchange, one for each node."""
    by_node: dict[int, list[Joint]] = {}
    for joint in joints:
        by_node.setdefault(joint[0].node.node_id, []).append(joint)
    found = []
    for node_id, axes in by_node.items():
        plans = [device.plan for device, _ in axes if device.plan is not None]
        device, settings = axes[0]
        counted = (
            exchange_of_plans(device.name, plans)
            if plans
            else exchange_of_named(device.name, node_id, *named_pdos(device, settings))
        )
        found.append(counted.exchange)
    return found


def _told(bus: Bus, cycle: Time, room: Room) -> str:
    assert bus.bitrate is not None
    frames = f"SYNC, {counted(room.rpdos, 'RPDO')} and {counted(room.tpdos, 'TPDO')} need up to {milliseconds(room.needed)}"
    return f"{frames} of a cycle of {milliseconds(cycle)} on {bus.name} at {bitrate_text(bus.bitrate)}bit/s"


def _no_room(chain: str, bus: Bus, joints: Collection[Joint], cycle: Time, room: Room) -> ChainError:
    assert bus.bitrate is not None
    shortest = shortest_cycle(_exchanges(joints), bus.bitrate, BESIDE)
    tries = ["fewer joints on this bus, fewer or smaller PDOs: `canopen plan` shows each frame"]
    if bus.bitrate < 1_000_000:
        tries.insert(0, "a higher bit rate")
    if shortest is not None:
        tries.insert(0, f"a cycle_time of {shortest / SECOND:g} s or more")
    return ChainError(
        CHAIN_NOT_READY,
        chain,
        f"chain {chain} could not initialise: its PDOs do not fit on the bus, so set-points and positions would come late",
        seen=f"{_told(bus, cycle, room)}, stuff bits included; one frame that has just begun, and SDO, come on top",
        tries=tuple(tries),
    )
