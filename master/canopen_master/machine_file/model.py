"""`MachineFile`: what a machine file says, as plain data. Nothing here is opened or sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from canopen_master.machine_file.booting import BootSettings, NetworkSettings
from canopen_master.motion.chain import ChainSettings
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.drives.axis.grip import DEFAULT_GRIP, Grip
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.manager.linking import Link
from canopen_transports.realtime import Realtime


@dataclass(frozen=True, slots=True)
class MasterEntry:
    """`[master]`. cycle: ns between two SYNCs, on all buses. timeout: ns for one answer of a device. heartbeat_timeout: ns after
    which a node whose heartbeat stops is lost; 0 = no supervision. grip: None = none. realtime: what to ask the operating system
    for; None = nothing."""

    cycle: Time = 10 * MILLISECOND
    timeout: Time = 500 * MILLISECOND
    heartbeat_timeout: Time = 0
    grip: Grip | None = DEFAULT_GRIP
    realtime: Realtime | None = None


@dataclass(frozen=True, slots=True)
class BusEntry:
    """`[buses.NAME]`. bitrate: bit/s, if the entry tells it."""

    name: str
    locator: str
    bitrate: int | None = None


@dataclass(frozen=True, slots=True)
class NodeEntry:
    """`[nodes.NAME]`: a device. bus: the name of its bus. device: its file, and how it is simulated; paths are as written. boot:
    None = no command of `canopen net` is about it."""

    name: str
    bus: str
    device: DeviceEntry
    boot: BootSettings | None = None

    @property
    def node_id(self) -> int:
        """1..127."""
        return self.device.node_ids[0]


@dataclass(frozen=True, slots=True)
class JointEntry:
    """`[joints.NAME]`: a drive. node: the name of its node. axis: of the node, 0 for its first one."""

    name: str
    node: str
    settings: AxisSettings = field(default_factory=AxisSettings)
    axis: int = 0

    @property
    def has_unit(self) -> bool:
        """Whether its positions have another unit than that of its drive."""
        return self.settings.unit is not None or self.settings.counts_per_unit is not None


@dataclass(frozen=True, slots=True)
class ChainEntry:
    """`[chains.NAME]`: joints that move as one, by name. settings: `cycle_time` is that of `[master]`."""

    name: str
    joints: tuple[str, ...]
    settings: ChainSettings = field(default_factory=ChainSettings)


@dataclass(frozen=True, slots=True)
class MachineFile:
    """A machine. Entries are by name, in the order of the file. state: the file for what simulated devices store, "" for none.

    source: the file, for messages; folder: where it stands: its paths are relative to it.
    """

    buses: Mapping[str, BusEntry]
    nodes: Mapping[str, NodeEntry] = field(default_factory=dict)
    joints: Mapping[str, JointEntry] = field(default_factory=dict)
    chains: Mapping[str, ChainEntry] = field(default_factory=dict)
    master: MasterEntry = MasterEntry()
    state: str = ""
    network: NetworkSettings = field(default_factory=NetworkSettings)
    links: tuple[Link, ...] = ()
    source: str = field(default="", compare=False)
    folder: Path | None = field(default=None, compare=False)

    def path(self, name: str) -> str:
        """Return the path of a file that the machine file names; a sample's name, and "", stay as they are."""
        beside = None if self.folder is None or not name else self.folder / name
        return str(beside) if beside is not None and beside.exists() else name

    def beside(self, name: str) -> str:
        """Return the path of a file that may not be there yet; "" stays as it is."""
        return name if self.folder is None or not name else str(self.folder / name)

    def node_of(self, name: str) -> NodeEntry | None:
        """Return the node of this name, or that of the joint of this name; None if there is neither."""
        joint = self.joints.get(name)
        return self.nodes.get(name if joint is None else joint.node)

    def joint_on(self, node: NodeEntry | None, axis: int = 0) -> JointEntry | None:
        """Return the joint whose drive is an axis of a node, or None."""
        name = None if node is None else node.name
        return next((each for each in self.joints.values() if (each.node, each.axis) == (name, axis)), None)

    def node_at(self, bus: str, node_id: int) -> NodeEntry | None:
        """Return the node with this node-ID on a bus, or None."""
        return next((each for each in self.nodes.values() if (each.bus, each.node_id) == (bus, node_id)), None)
