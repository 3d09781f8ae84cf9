"""`identify`: find out the kind of a drive by its vendor-ID, unless the user's settings say it.

CiA 402 drives differ in what the standard leaves to the maker. Schunk's Powerball joints differ in more: they home in mode 6
although 0x6502 lacks it, without 0x6098, and bits 8 and 15 of the statusword show the result. A master that takes one kind for
the other waits for bits that never come, or believes bits that mean something else. So the vendor-ID is read before a drive is
used.

Source: CiA 301 v4.2.0, 7.5.2.21 (identity object); CiA's list of vendor-IDs.
"""

from __future__ import annotations

from canopen_proto.cia402.objects import VENDOR_ID
from canopen_proto.drive.axis import Axis
from canopen_proto.multiplexer import split_mux
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoFailed, upload


def identify(axis: Axis) -> Procedure[None]:
    """Fill in the open settings of the axis (None) by the drive's vendor-ID (0x1018:01), read by SDO.

    Reads nothing if no setting is open, or if the drive is identified already. A drive without the object is a CiA 402 drive.
    Raises SdoFailed if the drive does not answer.
    """
    if axis.is_identified or axis.settings.homing is not None:
        return
    try:
        data = yield from upload(axis.node.sdo, *split_mux(VENDOR_ID))
    except SdoFailed as failed:
        if failed.abort_code not in ABSENT:
            raise
        data = b""
    axis.identify(int.from_bytes(data, "little") if data else None)
