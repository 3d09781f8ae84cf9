"""What a device says about itself: in its objects (0x1000, 0x1008 to 0x100A, 0x1018), and in its file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from canopen_proto.datatypes import DataType, encode
from canopen_proto.machine import LocalProtocolError

_NUMBERS: Final = ("vendor_id", "product_code", "revision", "serial_number", "device_type")
_OBJECTS: Final = ("product_name", "hardware_version", "software_version")
_OF_THE_FILE: Final = ("vendor_name", "order_code", "description")
_MAX: Final = 0xFFFF_FFFF
BIT_RATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
"""kbit/s: those that the file can name (CiA 306-1, DeviceInfo)."""


@dataclass(frozen=True, slots=True)
class Nameplate:
    """Who made a device, and what it is.

    product_name: 0x1008. vendor_id: 0x1018:01, given by CAN in Automation; 0 = none. product_code, revision, serial_number:
    0x1018:02 to 04. LSS tells devices apart by these four. device_type: 0x1000, with the number of the device profile in its low
    16 bits; 0 = none. hardware_version, software_version: 0x1009 and 0x100A. vendor_name, order_code, description and bit_rates
    (kbit/s, of CiA's table: 10 to 1000) are in the file only.

    The numbers are 0..0xFFFFFFFF, the texts of objects Latin-1. Raises LocalProtocolError for others.
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

    def __post_init__(self) -> None:
        for name in _NUMBERS:
            number: object = getattr(self, name)
            if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number <= _MAX:
                raise LocalProtocolError(f"Nameplate: {name}={number!r} is no number of 0..0x{_MAX:X}")
        for name in (*_OBJECTS, *_OF_THE_FILE):
            text: object = getattr(self, name)
            if not isinstance(text, str):
                raise LocalProtocolError(f"Nameplate: {name}={text!r} is not a text")
        for name in _OBJECTS:
            encode(getattr(self, name), DataType.VISIBLE_STRING, f"Nameplate: {name}")
        rates = self.bit_rates
        if not isinstance(rates, Collection) or not all(rate in BIT_RATES for rate in rates):
            told = f"bit_rates={rates!r} is no set of bit rates"
            raise LocalProtocolError(f"Nameplate: {told} in kbit/s: {', '.join(map(str, BIT_RATES))}")
