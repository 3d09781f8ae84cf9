"""`Device`: one joint of a chain, with all that is known of it. Its properties may be read at any time; they send nothing.

Their values come from the PDOs that the drive sends, and from objects read by SDO. To get each value at once when it comes, take
the events: `async with joint.events(PdoReceived) as updates: ...`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypeVar

from canopen_master.node import Node
from canopen_master.participant.subscription import Subscription
from canopen_proto.communication_errors import EMCY_CONNECTION_LOST
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.following import Following
from canopen_proto.drives.axis.limits import limits_of
from canopen_proto.drives.axis.motion_plan import MotionPlan
from canopen_proto.drives.axis.occupancy import Occupant
from canopen_proto.drives.axis.view import DriveView, view_of
from canopen_proto.drives.cia402.axes import axes_of
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE, VELOCITY_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import SECOND, Event, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.nmt import NmtState
from canopen_proto.remote_node import FRESH
from canopen_proto.sdo.client import SdoDownloaded, SdoUploaded

E = TypeVar("E", bound=Event)


class Device:
    """A joint; see this module's text. axis: the core's view of the drive. cyclic: the objects that it sends at every n-th SYNC
    (mux -> n), which show that it is alive; without any, only its heartbeat does. plan: how it follows set-points, once
    `Chain.initialise` has made a plan; None with the PDOs of PDOs.csv. modes: 0x6502, as read for it. following: whether it
    follows its set-points. limits: for its set-points; the drive's own are read by `Chain.initialise`, and each time
    that it begins to follow set-points. last_look: what the drive showed when its chain was stopped, if it had no power then.
    entry: its place in a machine file ("joints.arm1") and the name of that file; None if it is made of none. heartbeat_missed_at:
    when it last told (EMCY 0x8130) that a heartbeat, or a guarding request, did not come in time; it takes that back once one
    comes, so `emcy` may not show it.

    Positions are in the user's unit, as its AxisSettings say; without a scale, in counts.
    """

    def __init__(self, name: str, node: Node, axis: Axis) -> None:
        self.node = node
        self.axis = axis
        node.axes[axis.number] = axis
        self._name = ""
        self.name = name
        self.cyclic: Mapping[Mux, int] = {}
        self.plan: MotionPlan | None = None
        self.modes: int | None = None
        self.following = Following(axis)
        self.sdo_round_trips = 0
        self.limits = limits_of(axis)
        node.leave_pdos()  # those of a drive are its chain's business
        self.last_look: DriveView | None = None
        self.entry: tuple[str, str] | None = None
        self._occupant: Occupant | None = None  # while it follows set-points
        self.emcy: EmcyReceived | None = None
        self.emcy_time: Time | None = None
        self.heartbeat_missed_at: Time | None = None
        self._position: tuple[Time, int] | None = None  # when the last one came, in counts
        self._before: tuple[Time, int] | None = None  # the one before it, of an earlier instant
        node.watch((SdoUploaded, SdoDownloaded), self._on_round_trip)
        node.watch((EmcyReceived,), self._on_emcy)
        axis.node.add_listener(self._on_values)

    def __repr__(self) -> str:
        return f"<Device {self.name}: {self._place}>"

    # ---- what is known of it ----

    @property
    def name(self) -> str:
        """Its name in the chain. The only drive of a node gives the node its name."""
        return self._name or self.node.name + (f", axis {self.axis.number}" if self.axis.number else "")

    @name.setter
    def name(self, name: str) -> None:
        self._name = name or self._name
        if self._name and len(axes_of(self.node.dictionary)) < 2:
            self.node.name = self._name

    @property
    def position(self) -> float | None:
        """Actual position, as last heard; None if it never was since the drive's last boot."""
        return self.axis.position

    @property
    def desired_position(self) -> float:
        """The position that the next PDO commands."""
        return self.axis.set_points.position

    @property
    def velocity(self) -> float | None:
        """Actual velocity, per second; None if it is not known. It is the drive's own (0x606C), unless the last position is newer
        by more than 100 ms: then it is computed from the last two positions.
        """
        heard_at = self.axis.node.heard_at.get(VELOCITY_ACTUAL_VALUE)
        if heard_at is not None and (self._position is None or self._position[0] - heard_at <= FRESH):
            return self.axis.velocity
        if self.position is None or self._position is None or self._before is None:
            return None
        time, way = self._position[0] - self._before[0], self._position[1] - self._before[1]
        return self.axis.scale.way_from_counts(way) * SECOND / time

    @property
    def torque(self) -> float | None:
        """Actual torque, as a share of the rated torque, as last heard; None if it never was."""
        return self.axis.torque

    @property
    def state(self) -> State:
        """The CiA 402 state that the last statusword shows; UNKNOWN if none was heard since the drive's last boot."""
        return self.axis.state

    @property
    def statusword(self) -> int:
        """0x6041, as last heard; 0 if it never was: `state` is UNKNOWN then."""
        return self.axis.statusword

    @property
    def mode(self) -> int | None:
        """The active mode of operation (0x6061), as last heard; None if it never was."""
        return self.axis.mode

    @property
    def has_fault(self) -> bool:
        """Whether the drive is in Fault, or on its way there."""
        return self.axis.has_fault

    @property
    def error_code(self) -> int:
        """0x603F as last heard, 0 for none."""
        return self.axis.error_code

    @property
    def nmt_state(self) -> NmtState | None:
        """The NMT state that its heartbeat shows; without a heartbeat, the one that we commanded."""
        return self.node.nmt_state

    @property
    def is_homed(self) -> bool:
        """Whether this master has homed it since it was switched on."""
        return self.axis.is_homed

    @property
    def following_error(self) -> float:
        """Commanded minus actual position, both of the same instant; 0 while no set-points are sent."""
        return self.following.error

    @property
    def largest_following_error(self) -> float:
        """The largest absolute following error so far; `following.largest_error` may be reset."""
        return self.following.largest_error

    @property
    def may_move(self) -> bool:
        """Whether it is known to be in Operation enabled, or was last commanded there."""
        return self.state is State.OPERATION_ENABLED or (self.node.was_axis_enabled(self.axis.number) and not self.has_fault)

    @property
    def may_be_enabled(self) -> bool:
        """Whether a command under way may yet enable it: it was heard, and still answers."""
        return self.state is not State.UNKNOWN and self.nmt_state is not NmtState.STOPPED

    @property
    def where(self) -> str:
        """The joint and its place, for people: "joint1 (node 3 on can0)", or "joint2 (node 3 on can0, axis 1)"."""
        return f"{self.name} ({self._place})"

    @property
    def _place(self) -> str:
        return self.node.where + (f", axis {self.axis.number}" if self.axis.number else "")

    def occupy(self, name: str) -> None:
        """Keep other motion commands from the drive while it follows the set-points of `name`."""
        self._occupant = self.axis.occupancy.occupy(name)

    def release(self) -> None:
        """End that."""
        self.axis.occupancy.release(self._occupant)
        self._occupant = None

    @property
    def taken_over_by(self) -> str:
        """The stop that another task has commanded while the joint followed set-points; "" if there is none."""
        return "" if self._occupant is None else self._occupant.taken_over_by

    def describe(self) -> str:
        """State, statusword, error code and last emergency, in one line for people."""
        text = view_of(self.axis).describe()
        if self.emcy_time is not None:
            text += f" ({(self.node.now() - self.emcy_time) / SECOND:.3g} s ago)"
        return text

    def events(self, *kinds: type[E]) -> Subscription[E]:
        """As `Master.events`, of this joint only."""
        return self.node.events(*kinds)

    # ---- what the bus tells it ----

    def _on_round_trip(self, report: SdoUploaded | SdoDownloaded) -> None:
        self.sdo_round_trips += 1

    def _on_emcy(self, report: EmcyReceived) -> None:
        self.emcy = report
        self.emcy_time = self.node.now()
        if report.code == EMCY_CONNECTION_LOST:
            self.heartbeat_missed_at = self.emcy_time

    def _on_values(self, muxes: Collection[Mux], now: Time) -> None:
        if POSITION_ACTUAL_VALUE not in muxes:
            return
        counts = self.axis.position_counts
        if counts is None:
            return  # it has booted since
        if self._position is not None and now > self._position[0]:
            self._before = self._position
        self._position = now, counts
