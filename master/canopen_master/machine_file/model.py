"""`MachineFile`: what a machine file says, as plain data. Nothing is opened or sent. docs/network.md explains the boot-up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

from canopen_master.motion.chain import ChainSettings
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.manager.linking import Link
from canopen_transports.realtime import Realtime

MAX_NUMBER: Final = 0xFFFF_FFFF
MAX_MILLISECONDS: Final = 0xFFFF
MAX_FACTOR: Final = 0xFF
MAX_RESTORE: Final = 0x7F


@dataclass(frozen=True, slots=True)
class MasterEntry:
    """`[master]`. cycle: ns between two SYNCs, on all buses. timeout: ns for one answer of a device. heartbeat_timeout: ns after
    which a node whose heartbeat stops is lost; 0 = no supervision. watchdog: None = none. realtime: what to ask the operating
    system for; None = nothing."""

    cycle: Time = 10 * MILLISECOND
    timeout: Time = 500 * MILLISECOND
    heartbeat_timeout: Time = 0
    watchdog: Watchdog | None = DEFAULT_WATCHDOG
    realtime: Realtime | None = None


class StartOrder(StrEnum):
    """The nodes that the master starts, and when (0x1F80, bits 1 and 3)."""

    EACH = "each"
    """Each node as soon as it has booted well."""
    ALL = "all"
    """All at once, when every mandatory node has booted well."""
    NONE = "none"
    """None: they stay pre-operational until somebody starts them."""


class LossReaction(StrEnum):
    """The reaction of the master to the loss of a mandatory node (0x1F80, bits 4 and 6)."""

    NODE = "node"
    """Only that node is reset, and booted again."""
    RESET_ALL = "reset all"
    STOP_ALL = "stop all"


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """`[network]`, the boot-up of each bus by itself (CiA 302-2).

    boot_time: ns within which all mandatory nodes have to boot (0x1F89); 0 = without end. nmt_pause: ns between two NMT commands
    (0x102A).
    """

    start: StartOrder = StartOrder.EACH
    mandatory_lost: LossReaction = LossReaction.NODE
    boot_time: Time = 10 * SECOND
    nmt_pause: Time = 0


@dataclass(frozen=True, slots=True)
class BootSettings:
    """`boot` of a node: the node is in the network list of the master. Raises LocalProtocolError for values that contradict each
    other.

    device_type .. serial: the value that is expected; 0 = any. None: device type, vendor-ID and product code are those of the
    node's file, the others any. heartbeat: ns, written to 0x1017; None: the node's own. heartbeat_timeout: ns after which the
    node is lost; None: three times its heartbeat. guard_time: ns, 0 = no guarding. configuration: the DCF or concise DCF that is
    written. store: the node keeps it, and is not configured again while it has it. restore: subindex of 0x1011, 0 = none.
    software: the number in 0x1F56; None: not checked. program: the image that brings it. confirm_program: it has to be confirmed.
    """

    mandatory: bool = False
    start: bool = True
    keep_alive: bool = False
    device_type: int | None = None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    heartbeat: Time | None = None
    heartbeat_timeout: Time | None = None
    guard_time: Time = 0
    life_time_factor: int = 3
    configuration: str = ""
    store: bool = False
    restore: int = 0
    software: int | None = None
    program: str = ""
    confirm_program: bool = False

    def __post_init__(self) -> None:
        for name in ("device_type", "vendor", "product", "revision", "serial", "software"):
            _check_number(name, getattr(self, name), MAX_NUMBER)
        for name in ("heartbeat", "heartbeat_timeout", "guard_time"):
            _check_time(name, getattr(self, name))
        _check_number("life_time_factor", self.life_time_factor, MAX_FACTOR)
        _check_number("restore", self.restore, MAX_RESTORE)
        if self.heartbeat and self.heartbeat_timeout and self.heartbeat_timeout <= self.heartbeat:
            raise LocalProtocolError("heartbeat_timeout must be longer than heartbeat: three times as long is usual")
        if self.guard_time and (self.heartbeat or self.heartbeat_timeout):
            raise LocalProtocolError("a node has a heartbeat or is guarded, not both: leave out guard_time")
        if self.guard_time and not self.life_time_factor:
            raise LocalProtocolError("guarding needs a life_time_factor above 0")
        if self.program and not self.software:
            raise LocalProtocolError("program needs software: the number in 0x1F56 that the program has")


def _check_number(name: str, value: int | None, most: int) -> None:
    if value is not None and not 0 <= value <= most:
        raise LocalProtocolError(f"{name} is {value}; it has to be in 0..{most}")


def _check_time(name: str, value: Time | None) -> None:
    if value is not None and (value % MILLISECOND or not 0 <= value <= MAX_MILLISECONDS * MILLISECOND):
        raise LocalProtocolError(f"{name} has to be whole milliseconds, {MAX_MILLISECONDS} at most")


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
        """Return the path of a file that may not be there yet; "" stays as it is. name: as the machine file has it."""
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
