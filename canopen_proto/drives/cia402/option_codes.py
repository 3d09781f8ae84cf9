"""CiA 402 option codes: how a drive stops on a quick stop, a shutdown, a disable, a halt, a fault, a lost connection.

Each object holds one value of its table. A drive refuses the others, except those below 0, which are the manufacturer's.

Drives disagree about 2 and 3 of 6007h: some have them the other way round. The table is the standard's.

Source: IEC 61800-7-201 (CiA 402-2), option codes; 6007h: abort connection option code.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux

STAYS_FROM: Final = 5
"""605Ah: 5 to 8 stop as 1 to 4 do, and the drive stays in Quick stop active."""

_RAMPS: Final = {1: "slow_down_ramp", 2: "quick_stop_ramp", 3: "current_limit", 4: "voltage_limit"}

OPTION_CODES: Final[dict[Mux, dict[int, str]]] = {
    objects.ABORT_CONNECTION_OPTION_CODE: {0: "no_action", 1: "fault_signal", 2: "disable_voltage", 3: "quick_stop"},
    objects.QUICK_STOP_OPTION_CODE: {
        0: "disable_drive_function",
        **_RAMPS,
        **{value + STAYS_FROM - 1: f"{name}_and_stay" for value, name in _RAMPS.items()},
    },
    objects.SHUTDOWN_OPTION_CODE: {0: "disable_drive_function", 1: "slow_down_ramp"},
    objects.DISABLE_OPERATION_OPTION_CODE: {0: "disable_drive_function", 1: "slow_down_ramp"},
    objects.HALT_OPTION_CODE: _RAMPS,
    objects.FAULT_REACTION_OPTION_CODE: {0: "disable_drive_function", **_RAMPS},
}
"""Object -> its standard values, by their names. slow_down_ramp: 6084h; in homing mode some drives take 609Ah.
quick_stop_ramp: 6085h. current_limit, voltage_limit: as hard as the drive can."""
