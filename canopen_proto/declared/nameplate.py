"""What a device says about itself: in its objects (0x1000, 0x1008 to 0x100A, 0x1018), and in its file."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nameplate:
    """Who made a device, and what it is.

    product_name: 0x1008. vendor_id: 0x1018:01, given by CAN in Automation; 0 = none. product_code, revision, serial_number:
    0x1018:02 to 04. LSS tells devices apart by these four. device_type: 0x1000, with the number of the device profile in its low
    16 bits; 0 = none. hardware_version, software_version: 0x1009 and 0x100A. vendor_name, order_code, description and bit_rates
    (kbit/s) are in the file only.
    """

    product_name: str
    vendor_name: str = ""
    vendor_id: int = 0
    product_code: int = 0
    revision: int = 0x0001_0000
    serial_number: int = 0
    device_type: int = 0
    hardware_version: str = "1"
    software_version: str = "1"
    order_code: str = ""
    description: str = ""
    bit_rates: frozenset[int] = frozenset({125, 250, 500, 1000})
