"""`Axis`: the master's side of one CiA 402 drive. What it knows of the drive, and the one image of its controlword.

Theory of operation
-------------------
An Axis stands on a `RemoteNode` and adds meaning to its values: state, mode, position in the user's unit. Its sequences (enable,
homing, interpolation) are procedures, in `canopen_proto.procedures.drive`.

**One controlword image per axis.** It is the node's own image of 0x6040, the one that an RPDO is built from. While a live RPDO
carries 0x6040, a command goes into the image and out by that PDO; otherwise by SDO, and a confirmed SDO write sets the image too,
or the next RPDO would send a stale 0 and drop the drive.

Units: positions outside are in the user's unit (radians for an arm), on the wire in counts (the Schunk arm's are millidegrees).
counts = round(direction * unit * counts_per_unit) + offset.

Events: `AxisStateChanged` whenever a statusword shows another state, or the node boots: then nothing is known of the drive, and
it counts as not homed, since it may have lost its power.

Source: IEC 61800-7-201 (CiA 402-2).
"""

from __future__ import annotations

import enum
import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from canopen_proto.cia402.modes import describe_status
from canopen_proto.cia402.objects import (
    CONTROLWORD,
    ERROR_CODE,
    INTERPOLATION_SET_POINT,
    MODES_OF_OPERATION,
    MODES_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL_VALUE,
    STATUSWORD,
    TARGET_POSITION,
    TORQUE_ACTUAL_VALUE,
    VELOCITY_ACTUAL_VALUE,
)
from canopen_proto.cia402.states import State, state_of
from canopen_proto.machine import NEVER, SECOND, Event, LocalProtocolError, Time, event
from canopen_proto.remote_node import FRESH, RemoteNode

MILLIDEGREES_PER_RADIAN: Final = 180_000 / math.pi


class HomingStyle(enum.Enum):
    """How a drive homes."""

    STANDARD = "standard"
    """CiA 402: mode 6, method in 0x6098, bits 13, 12 and 10 of the statusword tell."""
    SCHUNK = "schunk"
    """Schunk Powerball firmware of 2012: mode 6 though 0x6502 lacks it, no 0x6098; done when bit 8 (moving) has come and gone and
    bit 15 (referenced) is set."""


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """What differs from axis to axis.

    counts_per_unit: counts on the wire per user's unit; direction: 1, or -1 for a motor that is mounted the other way round;
    offset: counts at position 0. homing_method: written to 0x6098, None leaves what the drive has. homing_timeout, state_timeout:
    ns for a whole homing, for one change of state or mode.
    """

    counts_per_unit: float = MILLIDEGREES_PER_RADIAN
    direction: int = 1
    offset: int = 0
    homing: HomingStyle = HomingStyle.STANDARD
    homing_method: int | None = None
    homing_timeout: Time = 60 * SECOND
    state_timeout: Time = 3 * SECOND

    def __post_init__(self) -> None:
        if self.counts_per_unit <= 0 or self.direction not in (1, -1):
            raise LocalProtocolError("counts_per_unit must be positive, and direction 1 or -1")


SCHUNK_POWERBALL: Final = AxisSettings(homing=HomingStyle.SCHUNK)
"""The manual's arm: millidegrees on the wire, radians outside."""


@event
class AxisStateChanged(Event):
    """The drive's statusword shows another state than before (UNKNOWN: it has booted). statusword: as last heard."""

    previous: State
    state: State
    statusword: int


class Axis:
    """One drive as its master sees it; see this module's text. Getters only show what was heard: they send nothing."""

    __slots__ = ("is_homed", "node", "settings", "state")

    def __init__(self, node: RemoteNode, settings: AxisSettings = AxisSettings()) -> None:
        """node: its dictionary must have controlword, statusword and modes of operation, else LocalProtocolError."""
        for key in (CONTROLWORD, STATUSWORD, MODES_OF_OPERATION, MODES_OF_OPERATION_DISPLAY):
            node.dictionary.variable((key >> 8, key & 0xFF))
        self.node = node
        self.settings = settings
        self.state = State.UNKNOWN
        self.is_homed = False
        node.commanded.add(CONTROLWORD)
        node.add_listener(self._on_values, self._on_boot)

    # ---- what is known of the drive ----

    @property
    def statusword(self) -> int:
        """0x6041 as last heard."""
        return self._int(STATUSWORD)

    @property
    def controlword(self) -> int:
        """The image of 0x6040: what the drive was last commanded."""
        return self._int(CONTROLWORD)

    @property
    def mode(self) -> int:
        """0x6061, the active mode of operation, as last heard."""
        return self._int(MODES_OF_OPERATION_DISPLAY)

    @property
    def error_code(self) -> int:
        """0x603F as last heard, 0 for none."""
        return self._int(ERROR_CODE)

    @property
    def position(self) -> float:
        """0x6064 as last heard, in the user's unit."""
        return self.from_counts(self._int(POSITION_ACTUAL_VALUE))

    @property
    def velocity(self) -> float:
        """0x606C as last heard, in the user's unit per second."""
        return self.settings.direction * self._int(VELOCITY_ACTUAL_VALUE) / self.settings.counts_per_unit

    @property
    def torque(self) -> float:
        """0x6077 as last heard, as a share of the rated torque (0.5 is half of it)."""
        return self._int(TORQUE_ACTUAL_VALUE) / 1000

    @property
    def has_fault(self) -> bool:
        """Whether the drive is in Fault or on its way there."""
        return self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE)

    def fresh_statusword(self, now: Time, not_before: Time = -NEVER) -> int | None:
        """0x6041 if it was heard at `not_before` or later and is not older than FRESH (100 ms), else None."""
        heard = self.node.heard_at.get(STATUSWORD)
        if heard is None or heard < not_before or now - heard > FRESH:
            return None
        return self._int(STATUSWORD)

    def describe(self) -> str:
        """State, statusword and what else explains it, in one line for people."""
        words = ", ".join(describe_status(self.statusword, self.mode))
        parts = [f"statusword 0x{self.statusword:04X}: {words}"]
        if self.error_code:
            parts.append(f"error code 0x{self.error_code:04X}")
        last_emcy = self.node.emcy.last
        if last_emcy is not None and last_emcy.code:
            parts.append(f"last EMCY 0x{last_emcy.code:04X} {last_emcy.text}")
        return "; ".join(parts)

    # ---- units and set-points ----

    def to_counts(self, position: float) -> int:
        """A position in the user's unit as counts on the wire."""
        return round(self.settings.direction * position * self.settings.counts_per_unit) + self.settings.offset

    def from_counts(self, counts: int) -> float:
        """Counts on the wire as a position in the user's unit."""
        return self.settings.direction * (counts - self.settings.offset) / self.settings.counts_per_unit

    @property
    def set_point(self) -> float:
        """The position that the next RPDO commands, in the user's unit."""
        has_own = INTERPOLATION_SET_POINT in self.node.values.store
        return self.from_counts(self._int(INTERPOLATION_SET_POINT if has_own else TARGET_POSITION))

    def set_position(self, position: float) -> None:
        """Give the next set-point of interpolated and cyclic synchronous position mode; the RPDO behind the next SYNC carries it.

        Raises ValueRangeError where the drive's object cannot hold it; then the last set-point stays.
        """
        self.set_position_counts(self.to_counts(position))

    def set_position_counts(self, counts: int) -> None:
        """As `set_position`, in counts."""
        for key in (INTERPOLATION_SET_POINT, TARGET_POSITION):
            variable = self.node.dictionary.get(key >> 8, key & 0xFF)
            if variable is not None:
                variable.encode(counts)
                self.node.values.store[key] = counts

    def set_controlword(self, word: int, now: Time) -> None:
        """Put a command into the image; an event-driven RPDO takes it along at once, a synchronous one behind the next SYNC.

        Without a live RPDO of 0x6040 it is only noted: `procedures.drive.command` sends it in every case.
        """
        self.node.values.store[CONTROLWORD] = word & 0xFFFF
        producer = self.node.rpdo_of(0x6040)
        if producer is not None:
            producer.trigger(now)

    def _int(self, key: int) -> int:
        value = self.node.values.store.get(key, 0)
        return value if isinstance(value, int) else 0

    def _on_values(self, muxes: Collection[int], now: Time) -> None:
        if STATUSWORD in muxes:
            self._enter(state_of(self.statusword))

    def _on_boot(self) -> None:
        """Perhaps it lost its power, and so its reference."""
        self.is_homed = False
        self._enter(State.UNKNOWN)

    def _enter(self, state: State) -> None:
        if state is not self.state:
            previous, self.state = self.state, state
            self.node.out.events.append(AxisStateChanged(self.node.node_id, previous, state, self.statusword))
