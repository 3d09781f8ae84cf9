"""`Axis`: the master's side of one CiA 402 drive. It holds what is known of the drive.

An Axis stands on a `RemoteNode` and adds meaning to its values: state, mode, position in the user's unit. Its sequences (enable,
homing, interpolation) are procedures, in `canopen_proto.drives.axis`.

Its user's units are those of `scale` (scale.py). What it is given at each SYNC is in `set_points` (set_points.py).

**Kind of drive.** A drive is a CiA 402 drive unless the user or its vendor-ID (0x1018:01) says Schunk.
`drive.identity.identify` reads the vendor-ID once, and fills in the settings that are None. 0x6502 decides nothing.

**Reference.** A drive that boots after this master homed it counts as not homed: it may have lost its power, and its positions
may mean something else. It `has_lost_reference` until it is homed again. Until then absolute set-points are refused
(`drive.ReferenceLostError`), unless the settings say that the drive keeps its reference. A drive that this master never homed
has no reference to lose.

**A drive may act late.** A command that was not answered in time may still act at any later moment. The axis remembers that
(`unanswered`), and `settle` ends it: the drive is led to another state, and has to show it. A drive obeys its commands in their
order, so none is left from before then. While none is left, `answer_time` is the time that the drive took to show the state that
it was last led to, and a drive that takes long is given more time: `reaction_time`. It keeps that time while something is left.

Events: `AxisStateChanged` when a statusword shows another state, or when the node boots (the state is UNKNOWN then).

Source: IEC 61800-7-201 (CiA 402-2).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from canopen_proto.drives.axis.axis_node import AxisWatchdog, node_of_axis
from canopen_proto.drives.axis.occupancy import Occupancy
from canopen_proto.drives.axis.scale import Scale
from canopen_proto.drives.axis.set_points import AxisSetPoints
from canopen_proto.drives.axis.settings import MILLIDEGREES_PER_RADIAN as MILLIDEGREES_PER_RADIAN
from canopen_proto.drives.axis.settings import OPEN_SETTINGS
from canopen_proto.drives.axis.settings import SCHUNK_POWERBALL as SCHUNK_POWERBALL
from canopen_proto.drives.axis.settings import AxisSettings as AxisSettings
from canopen_proto.drives.axis.settings import HomingStyle as HomingStyle
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import COMMAND_BITS, FAULT_STATES, ControlBit, State, enables_operation, state_of
from canopen_proto.machine import NEVER, Event, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.remote_node import FRESH, RemoteNode

_STATUSWORD: Final = objects.STATUSWORD
OBEYED: Final = -NEVER
"""`Axis.started_at` of a drive that has obeyed every start."""


class AxisStateChanged(Event):
    """The drive's statusword shows another state than before (UNKNOWN: its node booted). statusword: as last heard. axis: of the
    node, 0 for the first one. previous, state: by CiA 402, see `State`."""

    __match_args__ = ("node_id", "previous", "state", "statusword", "axis")

    def __init__(self, node_id: int, previous: State, state: State, statusword: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.previous = previous
        self.state = state
        self.statusword = statusword


class Axis:
    """One drive as its master sees it; see this module's text. Properties show what was heard; they send nothing.

    number: of the axis, 0 for the first one of a node. node: as this axis sees it, with the numbers of the first axis
    (axis_node.py); remote: the node itself. settings: those in force; open ones are filled in once `is_identified`; may be set.
    scale: between the user's units and the wire. set_points: what the drive is given at each SYNC. watchdog: takes hold before
    the drive is enabled, and lets go once it is shut down. started_at: when the drive last got a rising bit 4 of the controlword,
    which starts a motion; OBEYED once the drive has shown that it took it. selected_mode: the mode of operation that this master
    selected last; None: none since the drive's last boot. unanswered: what the drive was told and did not answer in time, in
    words; "": nothing. answer_time: ns, see above; None: not known. commanded_at, selected_at: when this master last sent a
    controlword, and a mode; None: not since then. commanded: that controlword.
    has_opened_brake: whether this master holds the brake open by an output, see digital_io.py. occupancy: the motion under way,
    see exclusive_motion.py; motion_began: when the last one began. was_enabled: since then it was seen in Operation enabled.
    was_taken_down: it has left that state afterwards, though this master had commanded it: somebody has disabled it.
    """

    def __init__(self, node: RemoteNode, settings: AxisSettings = OPEN_SETTINGS, number: int = 0) -> None:
        """Make axis `number` (0..7) of a node. Raises LocalProtocolError if its dictionary lacks an object that it needs."""
        self.number = number
        self.remote = node
        self.node = node_of_axis(node, number)
        for key in (objects.CONTROLWORD, objects.STATUSWORD, objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY):
            if key not in self.node.dictionary:
                failed = f"{self.title.replace('drive', 'node', 1)} is no drive by {node.dictionary.source or 'its dictionary'}"
                raise LocalProtocolError(f"{failed}: that has no {mux_text(key)}; a drive needs the file of its device")
        self._store, self._heard_at = self.node.values.store, self.node.heard_at  # as near as can be: looked at for each PDO
        self._settings = self._given = settings
        self.scale = Scale(self.title, settings)
        self.set_points = AxisSetPoints(self.node, self.scale, self.title)
        self.is_identified = False
        self.state = State.UNKNOWN
        self._shown: int | None = None  # the statusword that `state` was taken from
        self._is_homed = self._was_homed = False
        self.watchdog: AxisWatchdog | None = None
        self.started_at: Time = OBEYED
        self.unanswered = ""
        self.answer_time: Time | None = None
        self._was_answer_time: Time = 0  # the last one that was known
        self.selected_mode: int | None = None
        self.commanded_at: Time | None = None
        self.commanded = 0
        self.selected_at: Time | None = None
        self.has_opened_brake = False
        self.occupancy = Occupancy()
        self.motion_began: Time = NEVER
        self.was_enabled = self.was_taken_down = False
        self.node.keep_commanded(objects.CONTROLWORD)
        heard = [self.node.on_device(mux) for mux in (objects.CONTROLWORD, objects.MODES_OF_OPERATION)]
        node.foreign_writes.listen(heard, self._on_foreign)
        self.node.add_listener(self._on_values, self._on_boot)

    @property
    def title(self) -> str:
        """The drive for messages: "drive 5", and "drive 5, axis 1" for a further axis of a node."""
        return f"drive {self.node.node_id}" + (f", axis {self.number}" if self.number else "")

    @property
    def settings(self) -> AxisSettings:
        """See the class."""
        return self._settings

    @settings.setter
    def settings(self, settings: AxisSettings) -> None:
        self._settings = settings
        self.scale.use(settings)

    @property
    def reaction_time(self) -> Time:
        """ns until what the drive shows answers the last command: that of the settings, or more for a drive that answers late."""
        return max(self._settings.reaction_time, 2 * (self.answer_time or self._was_answer_time))

    def leave_unanswered(self, what: str) -> None:
        """Remember that the drive did not answer this in time. What was left before counts on."""
        self._was_answer_time = self.answer_time or self._was_answer_time
        self.unanswered, self.answer_time = self.unanswered or what, None

    @property
    def statusword(self) -> int:
        """0x6041 as last heard; 0 if it never was: `state` is UNKNOWN then."""
        return self._int(objects.STATUSWORD)

    @property
    def controlword(self) -> int:
        """The image of 0x6040: what the drive was last commanded."""
        return self._int(objects.CONTROLWORD)

    @property
    def mode(self) -> int | None:
        """0x6061, the active mode of operation, as last heard; None if it never was."""
        return self.heard(objects.MODES_OF_OPERATION_DISPLAY)

    @property
    def error_code(self) -> int:
        """0x603F as last heard, 0 for none."""
        return self._int(objects.ERROR_CODE)

    @property
    def position(self) -> float | None:
        """0x6064 as last heard, in the user's unit (counts without a scale); None if it never was since the node's last boot."""
        counts = self.position_counts
        return None if counts is None else self.scale.from_counts(counts)

    @property
    def position_counts(self) -> int | None:
        """0x6064 as last heard, in counts; None if it never was since the node's last boot."""
        return self.heard(objects.POSITION_ACTUAL_VALUE)

    @property
    def velocity(self) -> float | None:
        """0x606C as last heard, in the user's unit per second; None if it never was."""
        counts = self.velocity_counts
        return None if counts is None else self.scale.velocity_from_wire(counts)

    @property
    def velocity_counts(self) -> int | None:
        """0x606C as last heard, in the drive's own unit; None if it never was since the node's last boot."""
        return self.heard(objects.VELOCITY_ACTUAL_VALUE)

    @property
    def torque(self) -> float | None:
        """0x6077 as last heard, as a share of the rated torque (0.5 is half of it); None if it never was.

        Its sign is that of the user's direction, as that of positions and velocities.
        """
        per_mille = self.heard(objects.TORQUE_ACTUAL_VALUE)
        return None if per_mille is None else self.scale.torque_from_wire(per_mille)

    @property
    def has_fault(self) -> bool:
        """Whether the drive is in Fault or on its way there."""
        return self.state in FAULT_STATES

    @property
    def is_homed(self) -> bool:
        """Whether this master homed the drive since it was switched on; `drive.home` sets it."""
        return self._is_homed

    @is_homed.setter
    def is_homed(self, is_homed: bool) -> None:
        self._is_homed = is_homed
        self._was_homed = self._was_homed or is_homed

    @property
    def has_lost_reference(self) -> bool:
        """Whether this master homed the drive, and the reference is lost: a reset, or a later homing that failed."""
        return self._was_homed and not self._is_homed and not self.settings.keeps_reference

    def is_told_by(self, report: Event) -> bool:
        """Return whether an event with a field `axis`, such as AxisStateChanged, is about this axis."""
        return report.node_id == self.node.node_id and getattr(report, "axis", None) == self.number

    def fresh_statusword(self, now: Time) -> int | None:
        """Return 0x6041 if it is not older than FRESH (100 ms), else None."""
        heard = self.node.heard_at.get(objects.STATUSWORD)
        return None if heard is None or now - heard > FRESH else self._int(objects.STATUSWORD)

    def identify(self, vendor_id: int | None) -> None:
        """Fill in open settings (None) by the drive's vendor-ID. Later calls change nothing. vendor_id: None: it has none."""
        if not self.is_identified:
            self.settings, self.is_identified = self._given.of_vendor(vendor_id), True

    def check_settings(self, wanted: AxisSettings) -> None:
        """Raise LocalProtocolError, naming the differences, unless these settings are those in force or those first given."""
        if wanted not in (self.settings, self._given):
            difference = self.settings.difference(wanted)
            raise LocalProtocolError(f"{self.title} is in use with other settings: {difference}")

    def heard(self, key: Mux) -> int | None:
        """Return the value of an object of integers as last heard; None if it never was since the node's last boot."""
        if key not in self._heard_at:
            return None
        value = self._store.get(key)
        return value if isinstance(value, int) else 0

    def _int(self, key: Mux) -> int:
        value = self._store.get(key, 0)
        return value if isinstance(value, int) else 0

    def _on_values(self, muxes: Collection[Mux], now: Time) -> None:
        if _STATUSWORD in muxes and (word := self._int(_STATUSWORD)) != self._shown:
            self._shown = word
            self._enter(state_of(word))

    def _on_foreign(self, now: Time) -> None:
        """Another master has written: an RPDO of ours, sent or held for a SYNC, does not enable a drive that it has disabled."""
        if not enables_operation(self.controlword) or self.node.rpdo_of(objects.CONTROLWORD) is None:
            return
        word = self.remote.foreign_writes.last(self.node.on_device(objects.CONTROLWORD))
        if word is not None and word.time == now and isinstance(word.value, int) and not enables_operation(word.value):
            stays = word.value & COMMAND_BITS & ~ControlBit.FAULT_RESET
            self._store[objects.CONTROLWORD] = stays
            self.node.replace_held(objects.CONTROLWORD, stays, now)

    def _on_boot(self) -> None:
        if not self.settings.keeps_reference:
            self.is_homed = False
        self._shown = self.selected_mode = self.commanded_at = self.selected_at = None
        self.has_opened_brake = False
        self.unanswered, self.answer_time, self._was_answer_time = "", None, 0
        self._enter(State.UNKNOWN)

    def _enter(self, state: State) -> None:
        if state is not self.state:
            previous, self.state = self.state, state
            if previous is State.OPERATION_ENABLED and self.was_enabled and enables_operation(self.commanded):
                self.was_taken_down = True
            self.node.out.events.append(AxisStateChanged(self.node.node_id, previous, state, self.statusword, self.number))
