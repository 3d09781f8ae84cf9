"""`ChainView`: what is known of a chain; it may be read at any time and sends nothing. `ChainState`: which commands it takes."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence

import trio

from canopen_master.errors import CHAIN_NOT_READY, ChainError
from canopen_master.motion.chain_settings import ChainSettings
from canopen_master.motion.cycles import SetPoints
from canopen_master.motion.device import Device
from canopen_master.motion.path_motion import Motion


class ChainState(enum.Enum):
    """The state of a chain: which commands it can take."""

    OFF = "off"
    """Not initialised, or shut down."""
    READY = "ready"
    """All joints are in Operation enabled."""
    FOLLOWING = "following"
    """Set-points are sent behind each SYNC; a slow joint is given the newest one as its target."""
    STOPPING = "stopping"
    """It brakes along its path; HALTED or FAULT follows."""
    HALTED = "halted"
    """Halted; it follows no set-points."""
    FAULT = "fault"
    """Stopped because a joint failed."""


class ChainView:
    """See this module's text. name: of the chain. devices: its joints, in the order of the file.

    changed: woken when `state` or `motion` changes. interruptions: how often it was initialised, homed, halted, shut down or
    stopped by a fault: once this number has changed, set-points that were thought of before may be far from the joints.
    """

    def __init__(self, name: str, devices: Sequence[Device], settings: ChainSettings) -> None:
        self.name = name
        self.devices = tuple(devices)
        self.settings = settings
        self.changed = trio.lowlevel.ParkingLot()
        self.interruptions = 0
        self._state = ChainState.OFF
        self._motion: Motion | None = None
        self._set_points = SetPoints(self.devices, settings.cycle_time, settings.max_step)

    def __repr__(self) -> str:
        return f"<Chain {self.name}: {', '.join(device.name for device in self.devices)}; {self.state.value}>"

    @property
    def state(self) -> ChainState:
        """The state of a chain decides which commands it takes."""
        return self._state

    @state.setter
    def state(self, state: ChainState) -> None:
        if state is not self._state:
            self._state = state
            self.changed.unpark_all()

    @property
    def motion(self) -> Motion | None:
        """That along a path, or by a stream of targets, at present; None: it stands, or a loop gives the set-points."""
        return self._motion

    @motion.setter
    def motion(self, motion: Motion | None) -> None:
        if motion is not self._motion:
            self._motion = motion
            self.changed.unpark_all()

    @property
    def joints(self) -> Mapping[str, Device]:
        """The joints by their names."""
        return {device.name: device for device in self.devices}

    @property
    def positions(self) -> list[float]:
        """The actual positions, as last heard. Raises ChainError for a joint that was not heard since its last boot."""
        return self._known("position", [device.position for device in self.devices])

    @property
    def desired_positions(self) -> list[float]:
        """The positions that the next PDOs command."""
        return [device.desired_position for device in self.devices]

    @property
    def velocities(self) -> list[float]:
        """The actual velocities, per second. Raises ChainError for a joint of which none is known yet."""
        return self._known("velocity", [device.velocity for device in self.devices])

    @property
    def is_homed(self) -> bool:
        """Whether all joints are homed."""
        return all(device.is_homed for device in self.devices)

    @property
    def is_on_path(self) -> bool:
        """Whether its joints are sent where they are wanted; behind a gap of SYNC they come back to their path (late_sync.py)."""
        return self._set_points.is_on_path

    @property
    def sync_cycles(self) -> int:
        """SYNCs sent while it followed set-points."""
        return self._set_points.sync_cycles

    @property
    def missed_cycles(self) -> int:
        """How many of these cycles brought no new set-point, though a loop over `cycles` was running."""
        return self._set_points.missed_cycles

    @property
    def skipped_cycles(self) -> int:
        """Periods in which no SYNC was sent while it followed set-points, because this process was late."""
        return self._set_points.skipped_cycles

    @property
    def desired(self) -> list[float]:
        """The set-points that the next SYNC takes along; empty while it follows none."""
        return self._set_points.desired

    @property
    def without_torque(self) -> list[Device]:
        """The joints that take no torque beside their set-points."""
        return self._set_points.without_torque

    def _known(self, what: str, values: Sequence[float | None]) -> list[float]:
        """The values, one for each joint. Raises ChainError if one is not known."""
        known = []
        for device, value in zip(self.devices, values, strict=True):
            if value is None:
                failed = f"chain {self.name} has no {what} of {device.where}"
                seen = f"{device.name} was not heard since its last boot" if device.position is None else "it was heard once"
                raise ChainError(CHAIN_NOT_READY, self.name, failed, seen=seen, tries=("await chain.initialise()",))
            known.append(value)
        return known
