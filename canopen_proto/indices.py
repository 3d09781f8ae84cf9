"""The indices of the objects of CiA 301 (and a few of CiA 302) that this package uses, by their names in the standard.

CiA 402's objects are in drives/cia402/objects.py. dictionary/standard.py describes all of them: type, access, subindices. Use
them as `indices.GUARD_TIME`; `mux(indices.GUARD_TIME)` is the key of `Values.store`.

Sources: CiA 301 v4.2.0, 7.5.2; from 0x1F20 on CiA 302.
"""

from __future__ import annotations

from typing import Final

DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
MANUFACTURER_STATUS_REGISTER: Final = 0x1002
PREDEFINED_ERROR_FIELD: Final = 0x1003
COB_ID_SYNC: Final = 0x1005
COMMUNICATION_CYCLE_PERIOD: Final = 0x1006
SYNCHRONOUS_WINDOW_LENGTH: Final = 0x1007
MANUFACTURER_DEVICE_NAME: Final = 0x1008
MANUFACTURER_HARDWARE_VERSION: Final = 0x1009
MANUFACTURER_SOFTWARE_VERSION: Final = 0x100A
GUARD_TIME: Final = 0x100C
LIFE_TIME_FACTOR: Final = 0x100D
STORE_PARAMETERS: Final = 0x1010
RESTORE_DEFAULT_PARAMETERS: Final = 0x1011
COB_ID_TIME_STAMP: Final = 0x1012
HIGH_RESOLUTION_TIME_STAMP: Final = 0x1013
COB_ID_EMERGENCY: Final = 0x1014
INHIBIT_TIME_EMERGENCY: Final = 0x1015
CONSUMER_HEARTBEAT_TIME: Final = 0x1016
PRODUCER_HEARTBEAT_TIME: Final = 0x1017
IDENTITY_OBJECT: Final = 0x1018
SYNCHRONOUS_COUNTER_OVERFLOW_VALUE: Final = 0x1019
VERIFY_CONFIGURATION: Final = 0x1020
OS_COMMAND: Final = 0x1023
OS_COMMAND_MODE: Final = 0x1024
OS_DEBUGGER_INTERFACE: Final = 0x1025
OS_PROMPT: Final = 0x1026
EMERGENCY_CONSUMER: Final = 0x1028
ERROR_BEHAVIOR: Final = 0x1029

SDO_SERVER_PARAMETER: Final = 0x1200
"""The record of the first server; the others follow, 128 in all."""
SDO_CLIENT_1_PARAMETER: Final = 0x1280
"""The record of the first client; the others follow, 128 in all."""
RPDO1_COMMUNICATION_PARAMETER: Final = 0x1400
"""The record of the first RPDO; the others follow, 512 in all. So it is with the next three."""
RPDO1_MAPPING_PARAMETER: Final = 0x1600
TPDO1_COMMUNICATION_PARAMETER: Final = 0x1800
TPDO1_MAPPING_PARAMETER: Final = 0x1A00

COMMUNICATION_AREA: Final = range(0x1000, 0x2000)
"""The communication profile area. CiA 301 v4.2.0, table 41; so with the next two."""
MANUFACTURER_AREA: Final = range(0x2000, 0x6000)
PROFILE_AREA: Final = range(0x6000, 0xA000)
"""The objects of the device profiles: eight logical devices (or axes), 0x800 indices each."""
FURTHER_DEVICES: Final = range(0x6800, 0xA000)
"""The objects of the second to eighth logical device of a node. CiA 301 v4.2.0, 7.4.1 (see drives/cia402/axes.py)."""

SDO_SERVERS: Final = range(0x1200, 0x1280)
SDO_CLIENTS: Final = range(0x1280, 0x1300)
RPDO_COMMUNICATION: Final = range(0x1400, 0x1600)
RPDO_MAPPINGS: Final = range(0x1600, 0x1800)
TPDO_COMMUNICATION: Final = range(0x1800, 0x1A00)
TPDO_MAPPINGS: Final = range(0x1A00, 0x1C00)
PDO_RECORDS: Final = range(0x1400, 0x1C00)
"""The four before: all communication and mapping parameters."""

STORE_DCF: Final = 0x1F20
CONCISE_DCF: Final = 0x1F22
CONFIGURATION_DATE: Final = 0x1F26
CONFIGURATION_TIME: Final = 0x1F27
PROGRAM_DATA: Final = 0x1F50
PROGRAM_CONTROL: Final = 0x1F51
PROGRAM_DATE: Final = 0x1F52
EXPECTED_PROGRAM_DATE: Final = 0x1F53
EXPECTED_PROGRAM_TIME: Final = 0x1F54
EXPECTED_SOFTWARE: Final = 0x1F55
PROGRAM_SOFTWARE: Final = 0x1F56
FLASH_STATUS: Final = 0x1F57
NMT_STARTUP: Final = 0x1F80
SLAVE_ASSIGNMENT: Final = 0x1F81
REQUEST_NMT: Final = 0x1F82
REQUEST_GUARDING: Final = 0x1F83
DEVICE_TYPE_IDENTIFICATION: Final = 0x1F84
VENDOR_IDENTIFICATION: Final = 0x1F85
PRODUCT_CODE: Final = 0x1F86
REVISION_NUMBER: Final = 0x1F87
SERIAL_NUMBER: Final = 0x1F88
BOOT_TIME: Final = 0x1F89
RESTORE_CONFIGURATION: Final = 0x1F8A
