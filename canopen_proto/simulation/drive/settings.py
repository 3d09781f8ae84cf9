"""The settings of a simulated drive: what is not in its dictionary."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.homing_methods import HomingMethod
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.plant import Mechanics


class Shape(Enum):
    """The kind of drive that is simulated."""

    STANDARD = "standard"
    """A drive as in CiA 402, with all its modes."""
    SCHUNK_POWERBALL = "schunk"
    """A Powerball joint as in the manual: 6502h = 43h (pp, vl, ip), but it homes by mode 6, without 6098h. Bit 8 of the
    statusword shows that it moves, bit 15 that it is referenced."""


_NO_PROBES: Final = ((math.inf, math.inf), (math.inf, math.inf))


@dataclass(frozen=True, slots=True)
class Track:
    """The switches and index pulses of an axis, in track positions.

    A limit switch is active at and beyond its position (infinite: there is none), the home switch from home_switch[0] to
    home_switch[1] (either may be infinite: a switch that stays active to the end of the track). Index pulses are at
    index_offset + n * index_distance. probes: the parts on which the inputs of touch probe 1 and 2 are active. ends: hard stops,
    at which the axis stands although it is driven on; infinite: there is none.
    """

    negative_limit: float = -180_000.0
    positive_limit: float = 180_000.0
    home_switch: tuple[float, float] = (-10_000.0, 10_000.0)
    index_offset: float = 1_000.0
    index_distance: float = 36_000.0
    probes: tuple[tuple[float, float], tuple[float, float]] = _NO_PROBES
    ends: tuple[float, float] = (-math.inf, math.inf)

    def moved(self, way: float) -> Track:
        """Return the same track, so much further along, without its probes. way: units, with its sign."""
        begin, end = self.home_switch
        return Track(
            self.negative_limit + way,
            self.positive_limit + way,
            (begin + way, end + way),
            self.index_offset + way,
            self.index_distance,
            ends=(self.ends[0] + way, self.ends[1] + way),
        )

    def inputs_at(self, position: float) -> int:
        """Return 60FDh at a position: bit 0 negative limit switch, 1 positive limit switch, 2 home switch, 16 and 17 probes."""
        low, high = self.home_switch
        inputs = (position <= self.negative_limit) | (position >= self.positive_limit) << 1 | (low <= position <= high) << 2
        if self.probes is not _NO_PROBES:
            for bit, (begin, end) in enumerate(self.probes, start=16):
                inputs |= (begin <= position <= end) << bit
        return inputs


SYNC_TOLERANCE: Final = 100 * MILLISECOND
STO_OF_AX8000: Final = DriveBit(objects.DIGITAL_INPUTS, 31)


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """The properties of a simulated drive that are not in its dictionary.

    position: on the track at power-on; also the position it shows before it is homed. lag: time constant with which the actual
    position follows, ns; 0 follows at once. load: torque that it always needs while powered, per mille of the rated torque.
    sync_tolerance: in ip and csp, a SYNC that stays away for less, in ns, is late and not lost: the axis brakes until it comes,
    then goes on. Three periods of SYNC (1006h, 60C2h) count if they are more. waits_for_sync: it does not brake then, and stands
    at its set-point until SYNC comes.
    self_test: from power-on to Switch on disabled, ns. homing_method: the homing method of a Schunk Powerball, whose 6098h is
    constant. reaction: from the arrival of a controlword or a mode (6060h) until the drive acts on it, ns; real drives take 1 ms
    to 1 s. unset: muxes of objects that count as not set if they are 0. mechanics: the mass that moves, in place of `lag` and
    `load`.

    set_points: how many set-points of profile position can wait behind the one that runs; 0: none, and each has to come with bit
    5, as in Synapticon's drives. mode_change_state: the highest state in which it takes another mode (6060h), of Switch on
    disabled, Ready to switch on, Switched on, Operation enabled. changes_mode_halted: whether it does so while bit 8 of the
    controlword is set; Engel's drives do not. own_modes: modes of its maker, below 0; the axis stands still in them.

    torque_is_off: the STO input is active at power-on, as with an emergency stop that is pressed. sto_bit: the bit that shows it,
    by default that of Beckhoff's AX8000. sto_fault: error code of the fault that STO makes in a drive with power; 0: none, it
    goes to Switch on disabled. brake_bit: the bit that shows a closed brake. overload_fault: error code of the fault that an
    overload makes (I²t of `mechanics`), such as 0x2310; 0: none, the torque is limited to the rated one. coasts: whether
    bit 8 only takes the torque away in tq and cst, so that a mass without friction moves on.
    own_homing: homing methods of its maker, below 0, each with its picture, such as `MAXON_HOMING.items()`. stop_torque: per
    mille of the rated torque; a homing onto a hard stop has found it when it pushes so hard. second_encoder: counts of a second
    encoder (60E4h:01) for one of the first; it has the zero of the track. stops_at_switches: whether the limit switches stop the
    axis; False: they only matter for homing, as in a drive whose track is not known.
    further_axes: the drives of axis 1, 2 ... in the same node (7 at most); see axes.py. Their shape and answers do not count.
    answers: objects that are answered wrongly, late or not at all, for tests.
    """

    shape: Shape = Shape.STANDARD
    position: float = 3_000.0
    track: Track = field(default_factory=Track)
    lag: Time = 5 * MILLISECOND
    load: int = 30
    sync_tolerance: Time = SYNC_TOLERANCE
    waits_for_sync: bool = False
    self_test: Time = 0
    homing_method: int = 19
    unset: frozenset[Mux] = frozenset()
    reaction: Time = 0
    mechanics: Mechanics | None = None
    set_points: int = 1
    mode_change_state: State = State.OPERATION_ENABLED
    changes_mode_halted: bool = True
    own_modes: frozenset[int] = frozenset()
    torque_is_off: bool = False
    sto_bit: DriveBit = STO_OF_AX8000
    sto_fault: int = 0
    brake_bit: DriveBit | None = None
    overload_fault: int = 0
    coasts: bool = False
    own_homing: tuple[tuple[int, HomingMethod], ...] = ()
    stop_torque: int = 500
    second_encoder: float = 1.0
    stops_at_switches: bool = True
    further_axes: tuple[DriveSettings, ...] = ()
    answers: tuple[tuple[Mux, Answer], ...] = ()
