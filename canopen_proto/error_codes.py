"""The numbers of an emergency in words: error codes and the error register (CiA 301 v4.2.0, 7.2.7.1 and 7.5.2.2; CiA 402-2).

An error code is read from left to right: the first digit is the class, and each further digit says more. `error_text` uses the
longest prefix that is in the table. So a code that no standard names still gets its class: 0x8613 is read as 0x8600,
"positioning controller", not as "unknown". The table has the codes of CiA 301 and those that CiA 402 adds for drives. 0xFFxx is
the manufacturer's."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntFlag
from typing import Final, TypeVar

# One line per code, with the name of the standards. Each must make sense alone: people read one line, not the table.
_TABLE: Final = """
0000 error reset or no error
1000 generic error
2000 current
2100 current, device input side
2110 short circuit or earth leakage, input side
2120 earth leakage, input side
2121 earth leakage, input phase L1
2122 earth leakage, input phase L2
2123 earth leakage, input phase L3
2130 short circuit, input side
2131 short circuit, input phases L1-L2
2132 short circuit, input phases L2-L3
2133 short circuit, input phases L3-L1
2200 current inside the device
2211 current inside the device, no. 1
2212 current inside the device, no. 2
2213 over-current in ramp function
2214 over-current in the sequence
2220 continuous over-current inside the device
2221 continuous over-current inside the device, no. 1
2222 continuous over-current inside the device, no. 2
2230 short circuit or earth leakage inside the device
2240 earth leakage inside the device
2250 short circuit inside the device
2300 current, device output side
2310 continuous over-current, output side
2311 continuous over-current, output side, no. 1
2312 continuous over-current, output side, no. 2
2320 short circuit or earth leakage, output side
2330 earth leakage, output side
2331 earth leakage, output phase U
2332 earth leakage, output phase V
2333 earth leakage, output phase W
2340 short circuit, output side
2341 short circuit, output phases U-V
2342 short circuit, output phases V-W
2343 short circuit, output phases W-U
3000 voltage
3100 mains voltage
3110 mains over-voltage
3111 mains over-voltage, phase L1
3112 mains over-voltage, phase L2
3113 mains over-voltage, phase L3
3120 mains under-voltage
3121 mains under-voltage, phase L1
3122 mains under-voltage, phase L2
3123 mains under-voltage, phase L3
3130 mains phase failure
3131 mains phase failure, L1
3132 mains phase failure, L2
3133 mains phase failure, L3
3134 mains phase sequence
3140 mains frequency
3141 mains frequency too high
3142 mains frequency too low
3200 voltage inside the device
3210 DC link over-voltage
3211 over-voltage inside the device, no. 1
3212 over-voltage inside the device, no. 2
3220 DC link under-voltage
3221 under-voltage inside the device, no. 1
3222 under-voltage inside the device, no. 2
3230 load error
3300 output voltage
3310 output over-voltage
3311 output over-voltage, phase U
3312 output over-voltage, phase V
3313 output over-voltage, phase W
3320 armature circuit
3321 armature circuit interrupted
3330 field circuit
3331 field circuit interrupted
4000 temperature
4100 ambient temperature
4110 ambient temperature too high
4120 ambient temperature too low
4130 supply air temperature
4140 air outlet temperature
4200 device temperature
4210 device temperature too high
4220 device temperature too low
4300 drive temperature
4310 drive temperature too high
4320 drive temperature too low
4400 supply temperature
4410 supply temperature too high
4420 supply temperature too low
5000 device hardware
5100 supply
5110 supply, low voltage
5111 supply +/-15 V
5112 supply +24 V
5113 supply +5 V
5120 supply, intermediate circuit
5200 control hardware
5210 measurement circuit
5220 computing circuit
5300 operating unit
5400 power section
5410 output stages
5420 chopper
5430 input stages
5440 contacts
5441 contact 1, manufacturer-specific
5442 contact 2, manufacturer-specific
5443 contact 3, manufacturer-specific
5444 contact 4, manufacturer-specific
5445 contact 5, manufacturer-specific
5450 fuses
5451 fuse L1
5452 fuse L2
5453 fuse L3
5500 hardware data storage
5510 working memory (RAM)
5520 program memory (EPROM)
5530 non-volatile memory (EEPROM)
6000 device software
6010 software reset by watchdog
6100 internal software
6200 user software
6300 data set
6310 loss of parameters
6320 parameter error
7000 additional modules
7100 power module
7110 brake chopper
7111 brake chopper failure
7112 brake chopper over-current
7113 brake chopper protective circuit
7120 motor
7121 motor blocked
7122 motor error or commutation malfunction
7123 motor tilted
7200 measurement circuit
7300 sensor
7301 tacho fault
7302 tacho wrong polarity
7303 resolver 1 fault
7304 resolver 2 fault
7305 incremental sensor 1 fault
7306 incremental sensor 2 fault
7307 incremental sensor 3 fault
7310 speed sensor
7320 position sensor
7400 computation circuit
7500 communication module
7510 serial interface no. 1
7520 serial interface no. 2
7600 data storage module
8000 monitoring
8100 communication
8110 CAN overrun, objects lost
8120 CAN in error passive mode
8130 life guard error or heartbeat error
8140 recovered from bus off
8150 CAN-ID collision
8200 protocol error
8210 PDO not processed because of its length
8220 PDO length exceeded
8230 DAM MPDO not processed, destination object not available
8240 unexpected SYNC data length
8250 RPDO timeout
8300 torque control
8311 torque too high
8312 difficult start-up
8313 standstill torque
8321 insufficient torque
8331 torque fault
8400 velocity controller
8500 position controller
8600 positioning controller
8611 following error
8612 reference limit
8700 synchronisation controller
8800 winding controller
8900 process data monitoring
8A00 control
9000 external error
F000 additional functions
F001 deceleration
F002 sub-synchronous run
F003 stroke operation
F004 control function
FF00 device-specific
"""

ERROR_TEXTS: Final[dict[int, str]] = {int(line[:4], 16): line[5:] for line in _TABLE.strip().splitlines()}
ERROR_TEXTS.update({0x6300 + number: f"data set no. {number}" for number in range(1, 16)})

_T = TypeVar("_T")


def _by_longest_prefix(table: Mapping[int, _T], code: int) -> _T | None:
    if 0x0FFF < code <= 0xFFFF or 0 <= code <= 0xFF:  # 0x01xx to 0x0Fxx is not a class, and must not be read as 0x00xx
        for prefix in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
            if code & prefix in table:
                return table[code & prefix]
    return None


def error_text(code: int) -> str:
    """Return an EMCY error code, or a value of 0x603F, in a few words: the nearest name of the standards. Never raises."""
    return _by_longest_prefix(ERROR_TEXTS, code) or "unknown error"


class ErrorRegister(IntFlag):
    """The bits of the error register, 0x1001. Bit 6 is reserved. CiA 301 v4.2.0, 7.5.2.2"""

    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20
    MANUFACTURER = 0x80


_REGISTER_NAMES: Final = (
    (ErrorRegister.GENERIC, "generic"),
    (ErrorRegister.CURRENT, "current"),
    (ErrorRegister.VOLTAGE, "voltage"),
    (ErrorRegister.TEMPERATURE, "temperature"),
    (ErrorRegister.COMMUNICATION, "communication"),
    (ErrorRegister.DEVICE_PROFILE, "device profile"),
    (0x40, "reserved"),
    (ErrorRegister.MANUFACTURER, "manufacturer"),
)

_BITS: Final = {
    0x2000: ErrorRegister.CURRENT,
    0x3000: ErrorRegister.VOLTAGE,
    0x4000: ErrorRegister.TEMPERATURE,
    0x7000: ErrorRegister.DEVICE_PROFILE,
    0x8000: ErrorRegister.DEVICE_PROFILE,
    0x8100: ErrorRegister.COMMUNICATION,
    0x8200: ErrorRegister.COMMUNICATION,
    0xF000: ErrorRegister.DEVICE_PROFILE,
    0xFF00: ErrorRegister.MANUFACTURER,
}


def register_names(error_register: int) -> tuple[str, ...]:
    """Return the names of the bits that are set: 0x11 -> ("generic", "communication"). error_register: 0x1001."""
    return tuple(name for bit, name in _REGISTER_NAMES if error_register & bit)


def register_bits_of(code: int) -> ErrorRegister:
    """Return the bits of the error register for an error code, by its class; always with GENERIC, which any error sets."""
    return ErrorRegister.GENERIC | (_by_longest_prefix(_BITS, code) or ErrorRegister.GENERIC)
