"""The notes of live displays: what has happened beside the values, each in one line, by what it is about."""

from __future__ import annotations

from typing import Final

from canopen_cli.live.clocks import FrameClock
from canopen_cli.live.source import LiveSource, jumps_text, skipped_text
from canopen_cli.shared.screen import counted
from canopen_transports.errors import BusState

_WELL: Final = (BusState.ACTIVE, BusState.UP)


def note_state(notes: dict[str, str], state: BusState, reason: str) -> None:
    """Note the state of the bus; take the note away when all is well again."""
    notes.pop("bus", None)
    if state not in _WELL:
        notes["bus"] = f"the bus is {state.name.lower().replace('_', '-')}: {reason}"


def note_lost(notes: dict[str, str], lost: int) -> None:
    """Note how many frames were lost."""
    if lost:
        notes["lost"] = f"{counted(lost, 'frame')} lost before they were seen: this computer is too slow"


def note_source(notes: dict[str, str], source: LiveSource | None, clock: FrameClock) -> None:
    """Note what a source could not hand over, and that its clock went back."""
    if source is not None:
        note_lost(notes, source.lost)
        if source.skipped:
            notes["skipped"] = skipped_text(source)
    if clock.jumps:
        notes["clock"] = jumps_text(clock.jumps)
