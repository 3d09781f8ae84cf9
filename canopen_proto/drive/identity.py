"""`identify`: what a drive is, by its vendor-ID, as far as the user has not said it.

CiA 402 drives differ in what the standard leaves to the maker, and Schunk's Powerball joints in more than that: they home in mode
6 although 0x6502 lacks it, without 0x6098, and bits 8 and 15 of the statusword tell how it went. Who treats one as the other
waits for bits that never come, or believes bits that mean something else. So a drive is asked who made it before it is used.

Source: CiA 301 v4.2.0, 7.5.2.21 (identity object); CiA's list of vendor-IDs.
"""

from __future__ import annotations

from canopen_proto.cia402.objects import VENDOR_ID
from canopen_proto.drive.axis import Axis
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoFailed, upload


def identify(axis: Axis) -> Procedure[None]:
    """Fill in what the axis' settings leave open, by the drive's vendor-ID (0x1018:01), read by SDO.

    Nothing is read where they leave nothing open, or a second time. A drive without the object is a CiA 402 drive. Raises
    SdoFailed for a drive that does not answer.
    """
    if axis.is_identified or axis.settings.homing is not None:
        return
    try:
        data = yield from upload(axis.node.sdo, VENDOR_ID >> 8, VENDOR_ID & 0xFF)
    except SdoFailed as failed:
        if failed.abort_code not in ABSENT:
            raise
        data = b""
    axis.identify(int.from_bytes(data, "little") if data else None)
