"""`DriveView`: what a drive shows, and what it was commanded: the facts from which reasons.py finds why it does not move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import describe_command, describe_status, mode_name
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtState

RECENT: Final = 5 * SECOND
"""A command of another master that is older than this explains nothing."""


class ForeignCommand(NamedTuple):
    """A command of another master. words: such as "commanded 0x0006 (shutdown)". age: ns before the drive was last heard.
    source: "SDO", or "RPDO 0x203"."""

    words: str
    age: Time
    source: str

    def __str__(self) -> str:
        return f"another master {self.words} {self.age / MILLISECOND:.0f} ms ago by {self.source}"


@dataclass(frozen=True, slots=True)
class DriveView:
    """A drive as it is known, by the values of its objects of CiA 402. None: it lacks the object, or it was not heard.

    statusword: 0 if it was never heard, and `is_heard` is False. controlword, wanted_mode: 0x6040 and 0x6060 as the drive has
    them. commanded, selected_mode: as this master sent them last. rpdo: number of the live RPDO that carries the controlword.
    emcy: the last emergency. nmt_state: None: it was never heard. safe_torque_off, brake: the bit of the settings that shows
    that torque is off, or that the brake holds; None if it does not show it. is_homed: None if it does not matter. foreign: a
    command of another master that contradicts ours.
    """

    statusword: int = 0
    controlword: int | None = None
    mode: int | None = None
    wanted_mode: int | None = None
    supported_modes: int | None = None
    error_code: int | None = None
    position: int | None = None
    inputs: int | None = None
    nmt_state: NmtState | None = None
    commanded: int | None = None
    selected_mode: int | None = None
    rpdo: int | None = None
    emcy: EmcyReceived | None = None
    safe_torque_off: DriveBit | None = None
    brake: DriveBit | None = None
    is_homed: bool | None = None
    has_lost_reference: bool = False
    foreign: ForeignCommand | None = None
    is_heard: bool = True

    @property
    def state(self) -> State:
        """The state of the drive, by its statusword."""
        return state_of(self.statusword) if self.is_heard else State.UNKNOWN

    def describe(self) -> str:
        """Return one line for people: statusword by its bits, the command, the mode, error code and last emergency."""
        parts = ["its statusword was not heard yet"]
        if self.is_heard:
            parts = [f"statusword 0x{self.statusword:04X}: {', '.join(describe_status(self.statusword, self.mode))}"]
        if self.commanded is not None:
            parts.append(f"commanded {command_text(self.commanded, self.mode)}")
        parts.extend(self._modes())
        if self.error_code:
            parts.append(f"error code 0x{self.error_code:04X}")
        if self.emcy is not None and self.emcy.code:
            parts.append(f"last EMCY 0x{self.emcy.code:04X} {self.emcy.text}")
        return "; ".join(parts)

    def _modes(self) -> list[str]:
        wanted = self.wanted_mode if self.selected_mode is None else self.selected_mode
        if not wanted or wanted == self.mode:
            return [] if self.mode is None else [f"mode {mode_name(self.mode)}"]
        return [f"mode {mode_name(wanted)} wanted, {'none' if self.mode is None else mode_name(self.mode)} shown"]


def command_text(controlword: int, mode: int | None = None) -> str:
    """Return a controlword in words: "0x010F (enable operation, halt)"."""
    return f"0x{controlword:04X} ({', '.join(describe_command(controlword, mode))})"
