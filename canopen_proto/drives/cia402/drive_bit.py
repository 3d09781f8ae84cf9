"""`DriveBit`: where a maker's drive shows what CiA 402 has no object for: safe torque off, a brake that holds."""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux, mux_text

_BITS: Final = 64


class DriveBit(NamedTuple):
    """A bit of a drive's object by which its maker shows something: mux and number of the bit; value: what the bit is then.

    "Safe torque off" is 0x60FD bit 31 = 1 in Beckhoff's AX8000, 0x5007:02 bit 0 = 1 in Kollmorgen's AKD2G, and 0x251A bit 4 = 0
    in Novanta's Summit. Bit 3 of 0x60FD, the interlock, has no level that all makers agree on.
    """

    mux: Mux
    bit: int
    value: int = 1

    def check(self, name: str) -> None:
        """Raise LocalProtocolError, with the name of the setting, for a bit that no object can have."""
        if not 0 <= self.bit < _BITS or self.value not in (0, 1):
            raise LocalProtocolError(f"{name}: bit {self.bit!r} = {self.value!r} is no bit of an object: 0..63, and 0 or 1")

    def is_shown_by(self, value: int) -> bool:
        """Return whether the object shows it by this value."""
        return value >> self.bit & 1 == self.value

    def __str__(self) -> str:
        return f"bit {self.bit} of {mux_text(self.mux)} is {self.value}"
