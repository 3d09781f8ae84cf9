"""How the boot-up of a node ended: a letter, and what was seen. Source: CiA 302-2, boot-up of an NMT slave, error status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final, TypeAlias

from canopen_proto.abort import AbortCode, text_of
from canopen_proto.machine import SECOND, Event, Time

Shown: TypeAlias = int | str | None
"""A value that was expected or found; None if there is none."""


class BootLetter(StrEnum):
    """How a boot-up ended. READY is no letter of the standard, which calls success 0."""

    READY = "0"
    NOT_LISTED = "A"
    SILENT = "B"
    DEVICE_TYPE = "C"
    VENDOR = "D"
    NO_HEARTBEAT = "E"
    NO_GUARDING = "F"
    NO_PROGRAM = "G"
    OTHER_PROGRAM = "H"
    UPDATE_FAILED = "I"
    NOT_CONFIGURED = "J"
    NO_ERROR_CONTROL = "K"
    RUNNING = "L"
    PRODUCT = "M"
    REVISION = "N"
    SERIAL_NUMBER = "O"

    @property
    def meaning(self) -> str:
        """The letter in words."""
        return MEANINGS[self]

    @property
    def is_failure(self) -> bool:
        """Whether the node must not be started."""
        return self not in (BootLetter.READY, BootLetter.RUNNING)


MEANINGS: Final[Mapping[BootLetter, str]] = MappingProxyType(
    {
        BootLetter.READY: "booted and checked",
        BootLetter.NOT_LISTED: "is not in the network list",
        BootLetter.SILENT: "does not answer",
        BootLetter.DEVICE_TYPE: "has another device type",
        BootLetter.VENDOR: "has another vendor-ID",
        BootLetter.NO_HEARTBEAT: "is to be kept alive, but sends no heartbeat",
        BootLetter.NO_GUARDING: "is to be kept alive, but does not answer guarding",
        BootLetter.NO_PROGRAM: "does not say which program it has, or the master does not know which one it should have",
        BootLetter.OTHER_PROGRAM: "has another program, and an update is not allowed, or not now",
        BootLetter.UPDATE_FAILED: "has another program, and its update failed",
        BootLetter.NOT_CONFIGURED: "could not be configured",
        BootLetter.NO_ERROR_CONTROL: "is configured, but shows no sign of life",
        BootLetter.RUNNING: "was Operational already, and was left running",
        BootLetter.PRODUCT: "has another product code",
        BootLetter.REVISION: "has another revision number",
        BootLetter.SERIAL_NUMBER: "has another serial number",
    }
)


class BootStep(StrEnum):
    """The steps of a boot-up, in their order."""

    ASSIGNMENT = "assignment"
    DEVICE_TYPE = "device type"
    IDENTITY = "identity"
    STATE = "NMT state"
    SOFTWARE = "software"
    CONFIGURATION = "configuration"
    ERROR_CONTROL = "error control"


_UNREAD: Final[Mapping[BootLetter, str]] = MappingProxyType(
    {
        BootLetter.SILENT: "refuses to tell its device type",
        BootLetter.VENDOR: "does not tell its vendor-ID",
        BootLetter.PRODUCT: "does not tell its product code",
        BootLetter.REVISION: "does not tell its revision",
        BootLetter.SERIAL_NUMBER: "does not tell its serial number",
    }
)


@dataclass(frozen=True, slots=True)
class BootOutcome:
    """How the boot-up of a node ended.

    step: the last one. object: the index and subindex that decided, or None. expected, found: its values. abort_code: of the SDO
    transfer that failed, or None. elapsed: ns since the boot-up of this node began. remark: more about it, for people.
    """

    node_id: int
    letter: BootLetter
    step: BootStep
    object: tuple[int, int] | None = None
    expected: Shown = None
    found: Shown = None
    abort_code: int | None = None
    elapsed: Time = 0
    remark: str = ""

    @property
    def is_failure(self) -> bool:
        """Whether the node must not be started. A node that was left running (L) has not failed."""
        return self.letter.is_failure

    @property
    def meaning(self) -> str:
        """The letter in words. One letter stands for a number that differs, and for one that could not be read: words do not."""
        silent = self.letter is BootLetter.SILENT and self.abort_code == AbortCode.TIMED_OUT
        unread = "" if self.abort_code is None or silent else _UNREAD.get(self.letter, "")
        return unread or self.letter.meaning

    def __str__(self) -> str:
        """Return one sentence with all that is known: words first, the letter and the time at its end."""
        facts = [self._values(), "" if self.abort_code is None else f"abort 0x{self.abort_code:08X}, {text_of(self.abort_code)}"]
        seen = "; ".join(filter(None, (*facts, self.remark)))
        outcome = f"node {self.node_id}: {self.meaning}"
        return f"{outcome}{': ' if seen else ''}{seen} ({self.letter}, {self.elapsed / SECOND:.3g} s)"

    def _values(self) -> str:
        place = "" if self.object is None else "0x{:04X}:{:02X}".format(*self.object)
        found = "" if self.found is None else f"is {_shown(self.found)}"
        expected = "" if self.expected is None else f"expected {_shown(self.expected)}"
        return ", ".join(filter(None, (f"{place} {found}".strip(), expected)))


def _shown(value: int | str) -> str:
    return value if isinstance(value, str) else f"0x{value:08X}"


class BootEnded(Event):
    """The boot-up of a node ended; see `outcome`."""

    __match_args__ = ("node_id", "outcome")

    def __init__(self, node_id: int, outcome: BootOutcome) -> None:
        self.node_id = node_id
        self.outcome = outcome
