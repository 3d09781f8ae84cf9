"""`identify`: find out the kind of a drive by its vendor-ID, and its scale, unless the user's settings say them.

`learn_units` asks what its other numbers mean.

CiA 402 drives differ in what the standard leaves to the maker. Schunk's Powerball joints differ in more: they home in mode 6
although 0x6502 lacks it, without 0x6098, and bits 8 and 15 of the statusword show the result. A master that takes one kind for
the other waits for bits that never come, or believes bits that mean something else. So the vendor-ID is read before a drive is
used.

If the settings name the user's unit but no scale, the drive's factor group tells the scale (units.py). A drive that does not tell
it is not used: a guess would make every position and every limit wrong.

Source: CiA 301 v4.2.0, 7.5.2.21 (identity object); CiA's list of vendor-IDs.
"""

from __future__ import annotations

from dataclasses import replace

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import DriveError, as_drive_errors
from canopen_proto.drives.axis.units import DriveUnits, read_units
from canopen_proto.drives.cia402.objects import VENDOR_ID
from canopen_proto.multiplexer import split_mux
from canopen_proto.procedures.objects import ABSENT, unless_refused
from canopen_proto.procedures.steps import Procedure, upload


@as_drive_errors
def identify(axis: Axis) -> Procedure[None]:
    """Fill in the open settings of the axis (None): by the drive's vendor-ID (0x1018:01), and the scale of a named unit.

    Reads by SDO, and only what is open and was not read before. A drive without a vendor-ID is a CiA 402 drive. Raises
    SdoTransferError if the drive does not answer, ProcedureError if it does not tell the scale of the unit.
    """
    if not axis.is_identified and axis.settings.homing is None:
        axis.identify((yield from _vendor_id(axis)))
    unit = axis.settings.unit
    if unit is not None and axis.settings.counts_per_unit is None:
        counts = (yield from learn_units(axis)).counts_per(unit)
        if counts is None:
            failed = f"does not tell how many counts a {unit} has (0x60A8, 0x6092, 0x608F)"
            raise DriveError(axis, failed, remedy="counts_per_unit, by its manual", looks=False)
        axis.settings = replace(axis.settings, counts_per_unit=counts)


def _vendor_id(axis: Axis) -> Procedure[int | None]:
    data = yield from unless_refused(upload(axis.node.sdo, *split_mux(VENDOR_ID)), ABSENT)
    return int.from_bytes(data, "little") if data else None


@as_drive_errors
def learn_units(axis: Axis) -> Procedure[DriveUnits]:
    """Read what the drive's numbers mean (its factor group), keep it in `axis.scale.units`, and return it. Raises
    SdoTransferError."""
    axis.scale.units = yield from read_units(axis.node)
    return axis.scale.units
