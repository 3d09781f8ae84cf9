"""The RPDO for what is fed forward beside the set-points.

    csp    the offsets of velocity and torque (0x60B1, 0x60B2); they are 0 until somebody feeds something forward
    ip     the velocity of a data record (0x60C1:02), for drives whose records have one (sub_modes.py)

A set-point and its controlword leave 16 bits of their PDO, and a velocity has 32: so it needs a PDO of its own.

Source: IEC 61800-7-201 (CiA 402-2): cyclic synchronous position mode, interpolated position mode.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, short_name
from canopen_proto.pdo.described import muxes_of
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.pdo.slots import Slot, as_fit, entry_of, remapped

FED: Final = {
    Mode.CYCLIC_SYNCHRONOUS_POSITION: (objects.VELOCITY_OFFSET, objects.TORQUE_OFFSET),
    Mode.INTERPOLATED_POSITION: (objects.INTERPOLATION_VELOCITY,),
}
"""Mode -> the objects that are fed forward beside its set-points, as far as the drive has them."""


def with_feed_forward(
    dictionary: ObjectDictionary, node_id: int, mode: Mode, slots: list[Slot], own: list[Slot], pdos: list[PdoSettings]
) -> tuple[list[PdoSettings], list[str]]:
    """Return the PDOs and one more for what none of them carries, and notes about what stays without."""
    if mode not in FED:
        return pdos, [f"{short_name(mode)} takes no feed-forward"]
    carried = {key for pdo in pdos if pdo.direction is Direction.RPDO for key in muxes_of(pdo.entries)}
    entries = {key: entry_of(dictionary, key, Direction.RPDO) for key in FED[mode] if key not in carried}
    wanted = as_fit(entry for entry, _ in entries.values() if entry is not None)
    free = [slot for slot in own if (slot.direction, slot.number) not in {(pdo.direction, pdo.number) for pdo in pdos}]
    more, obstacles = remapped(slots, Direction.RPDO, node_id, wanted, is_synchronous=True, beside=pdos, among=free)
    if wanted and more is not None:
        return [*pdos, more], [f"no feed-forward: {why}" for entry, why in entries.values() if entry is None]
    lacking = [why for entry, why in entries.values() if entry is None]
    return pdos, [f"no feed-forward: {why}" for why in lacking + (obstacles or ["no RPDO is left"]) * bool(wanted)]
