"""Chapter 2, continued: SDO block transfer and further SDO channels (CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16)."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_BLOCKS: Final = "SDO block transfer in a device"
_CHANNELS: Final = "further SDO channels in a device"

CASES: Final = (
    Case("2.19", "SDO 19", "Read 0x1000:00 with a block transfer without CRC", None, waits_for=_BLOCKS),
    Case("2.20", "SDO 20", "Write 0x100C:00 with a block transfer without CRC, if there is guarding", None, waits_for=_BLOCKS),
    Case("2.21", "SDO 21", "Write 0x1017:00 with a block transfer without CRC, if there is a heartbeat", None, waits_for=_BLOCKS),
    Case("2.22", "SDO 22", "Read a segmented object with a block transfer", None, waits_for=_BLOCKS),
    Case("2.23", "SDO 23", "Read an object with a block transfer and CRC", None, waits_for=_BLOCKS),
    Case("2.24", "SDO 24", "Write 0x100C:00 with a block transfer and CRC, if there is guarding", None, waits_for=_BLOCKS),
    Case("2.25", "SDO 25", "Write 0x1017:00 with a block transfer and CRC, if there is a heartbeat", None, waits_for=_BLOCKS),
    Case("2.26", "SDO 26", "Perform a block read with a wrong block size (128)", None, waits_for=_BLOCKS),
    Case("2.27", "SDO 27", "Perform a block read with a wrong sequence number (128)", None, waits_for=_BLOCKS),
    Case("2.28", "SDO 28", "Read 0x1201 and following objects", None, waits_for=_CHANNELS),
    Case("2.29", "SDO 29", "Read 0x1201 and following objects after reset communication", None, waits_for=_CHANNELS),
    Case("2.30", "SDO 30", "Read 0x1280 and following objects after save and reset communication", None, waits_for=_CHANNELS),
)
