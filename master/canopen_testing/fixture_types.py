"""The types of the fixtures that are functions: `def test(sim_node: SimNode) -> None`."""

from __future__ import annotations

from os import PathLike
from typing import Protocol

from canopen_proto.declared import DeclaredDevice
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings


class SimNode(Protocol):
    """The fixture `sim_node`."""

    def __call__(self, file: str | PathLike[str] | type[DeclaredDevice], node_id: int = 0, *, bus: str = "can0") -> LocalNode:
        """Switch on a simulated device of a file, or of a class. See ProgramWorld.device."""


class SimDrive(Protocol):
    """The fixture `sim_drive`."""

    def __call__(
        self,
        node_id: int,
        settings: DriveSettings | None = None,
        *,
        dictionary: ObjectDictionary | None = None,
        bus: str = "can0",
    ) -> DriveNode:
        """Switch on a simulated drive of CiA 402. See World.drive."""
