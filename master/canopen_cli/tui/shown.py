"""What the view shows at one moment: made on trio's side, looked at by the view, never changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from canopen_gateway import WatchedObject
from canopen_gateway.plain_data import Plain
from canopen_gateway.traffic import FeedRow


class NodePlace(NamedTuple):
    """A node. net: the name of its bus."""

    net: str
    node_id: int


class ReadObject(NamedTuple):
    """An object as it was read last. text: its value; "" if it could not be read. problem: why not."""

    text: str
    problem: str = ""


@dataclass(frozen=True)
class ValueShown:
    """A watched object. least, most: of the numbers so far. age: seconds since the value came; None: never. curve: its last
    numbers, oldest first."""

    place: WatchedObject
    name: str
    text: str = ""
    problem: str = ""
    least: float | None = None
    most: float | None = None
    age: float | None = None
    curve: tuple[float, ...] = ()


@dataclass(frozen=True)
class DriveShown:
    """A drive. data: as plain_data.view_data has it; None if it does not answer, for which `problem` says why."""

    place: NodePlace
    axis: int
    data: Plain | None
    problem: str = ""


@dataclass(frozen=True)
class MachineShown:
    """All that is shown. mode: what is allowed. nets, events, lease: as plain_data has them. names: of the devices, as far as
    they were read (0x1008). frames, findings: so far. rate: frames each second. load: the busiest net's share of its bit rate,
    0 to 1; None if no bit rate is known."""

    mode: str = "read-only"
    nets: tuple[Plain, ...] = ()
    names: Mapping[NodePlace, str] = field(default_factory=dict)
    events: tuple[Plain, ...] = ()
    lease: Plain = field(default_factory=dict)
    traffic: tuple[FeedRow, ...] = ()
    frames: int = 0
    findings: int = 0
    rate: float = 0.0
    load: float | None = None
    values: tuple[ValueShown, ...] = ()
    objects: Mapping[WatchedObject, ReadObject] = field(default_factory=dict)
    drives: tuple[DriveShown, ...] = ()
