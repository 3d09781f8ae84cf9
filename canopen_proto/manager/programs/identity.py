"""The programs of a device, as CiA 302-3 sees them: what is written to 0x1F51, what is read from 0x1F51 and 0x1F57.

Each subindex of these objects is one program; subindex 0 is their number.

    0x1F50  DOMAIN      the program itself, to be written
    0x1F51  UNSIGNED8   program control: a command is written, a state is read
    0x1F56  UNSIGNED32  software identification: often a checksum; 0 or unreadable without a program
    0x1F57  UNSIGNED32  flash status. Bit 0: busy, all else is void then; bits 1 to 7: an error; 16 to 31: of the manufacturer

Sources: CiA 302-3, as Lely's master, Zephyr's slave and the manuals of two makers of encoders show it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple


class ProgramControl(IntEnum):
    """The commands and states of 0x1F51. 0x80 and up belong to the manufacturer."""

    STOP = 0
    """Stop; or, read: the program is stopped, or there is none."""
    START = 1
    """Start; or, read: the program runs."""
    RESET = 2
    """Stop, then start. Some devices do not have it."""
    CLEAR = 3
    """Erase; or, read: it is erased, and a new one may be written."""
    CONFIRM = 0x80
    """Zephyr with MCUboot: keep the program; or, read: it runs on trial, and the one before comes back at the next reset."""


class FlashError(IntEnum):
    """The errors in bits 1 to 7 of 0x1F57. 64 to 127 belong to the manufacturer, the others are reserved."""

    NONE = 0
    NO_PROGRAM = 1
    UNKNOWN_FORMAT = 2
    FORMAT_OR_CRC = 3
    NOT_CLEARED = 4
    WRITE_ERROR = 5
    ADDRESS_ERROR = 6
    SECURED = 7
    UNSPECIFIED = 63


_TEXTS: Final[dict[int, str]] = {
    FlashError.NONE: "no error",
    FlashError.NO_PROGRAM: "no valid program",
    FlashError.UNKNOWN_FORMAT: "the format of the data is unknown",
    FlashError.FORMAT_OR_CRC: "the data have a wrong format or a wrong CRC",
    FlashError.NOT_CLEARED: "the flash was not cleared before it was written",
    FlashError.WRITE_ERROR: "the flash could not be written",
    FlashError.ADDRESS_ERROR: "wrong address",
    FlashError.SECURED: "the flash is secured against writing",
    FlashError.UNSPECIFIED: "an error that the device does not specify",
}
_OF_MANUFACTURER: Final = range(64, 128)


class FlashStatus(NamedTuple):
    """The value of 0x1F57, taken apart. error: 0 to 127; detail: 16 bits of the manufacturer. Both are 0 while it is busy."""

    is_busy: bool
    error: int = 0
    detail: int = 0

    @property
    def text(self) -> str:
        """The status in words, for people."""
        if self.is_busy:
            return "busy"
        text = _TEXTS.get(self.error)
        if text is None:
            text = f"error {self.error}, {'of the manufacturer' if self.error in _OF_MANUFACTURER else 'reserved'}"
        return f"{text} (detail 0x{self.detail:04X})" if self.detail else text

    @property
    def value(self) -> int:
        """The value of 0x1F57 that says this."""
        return 1 if self.is_busy else self.error << 1 | self.detail << 16


def flash_status(value: int) -> FlashStatus:
    """Return what a value of 0x1F57 says."""
    return FlashStatus(True) if value & 1 else FlashStatus(False, value >> 1 & 0x7F, value >> 16)
