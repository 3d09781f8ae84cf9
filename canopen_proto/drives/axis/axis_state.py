"""The event by which an `Axis` tells its state, and the grip that it uses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import Event

if TYPE_CHECKING:
    from canopen_proto.procedures.steps import Procedure


class AxisStateChanged(Event):
    """The drive's statusword shows another state than before (UNKNOWN: its node booted). statusword: as last heard. axis: of the
    node, 0 for the first one."""

    __slots__ = ("axis", "previous", "state", "statusword")
    __match_args__ = ("node_id", "previous", "state", "statusword", "axis")

    def __init__(self, node_id: int, previous: State, state: State, statusword: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.previous = previous
        self.state = state
        self.statusword = statusword


class AxisGrip(Protocol):
    """Makes a drive stop by itself if its master is gone; see drives/axis/grip.py."""

    def hold(self) -> Procedure[None]:
        """Take hold of the drive: it is about to be enabled."""

    def let_go(self) -> Procedure[None]:
        """Let go of the drive: it stands and is disabled."""
