"""The content of a device's file: its objects, and the device as a whole.

An EDS describes a type of device, a DCF one device of that type with its node-ID and its settings (CiA 306-1 v1.4.0); an XDD and
an XDC are the same in XML (CiA 311). All four are read into a `DeviceDescription`. Its `ObjectDictionary` is all that the
protocol needs; the other fields are for tools: the file's author, the device's features, its commissioning.

A description never changes once it is read; `dataclasses.replace` makes another one. `document` keeps the original file (order,
spelling, the form of each number), so that a writer rewrites only what has changed, and a finding about an object can name its
line. Apart from sections that no standard knows, it holds no facts of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Protocol

from canopen_data.findings import LOST_SETTING, Finding, Severity
from canopen_proto.dictionary.model import ObjectDictionary

__all__ = ["DeviceDescription", "DeviceInfo", "FileInfo", "FileKind"]

BIT_RATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
"""kbit/s: the bit rates that an EDS can name (CiA 306-1, DeviceInfo)."""


_LOSSES: Final = (LOST_SETTING, "too-long", "too-many")
"""The two others: a part of the file was not read, or its findings are not all listed."""


class FileKind(StrEnum):
    """The kind of file that a description came from."""

    EDS = "EDS"
    DCF = "DCF"
    XDD = "XDD"
    XDC = "XDC"
    CSV = "CSV"


@dataclass(frozen=True, slots=True)
class FileInfo:
    """[FileInfo]: the file itself. Times and dates are the file's text ("01:33PM", "05-23-2013"). last_eds: only in a DCF."""

    file_name: str = ""
    file_version: int = 0
    file_revision: int = 0
    eds_version: str = ""
    description: str = ""
    creation_time: str = ""
    creation_date: str = ""
    created_by: str = ""
    modification_time: str = ""
    modification_date: str = ""
    modified_by: str = ""
    last_eds: str = ""


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """[DeviceInfo]: the type of device. bit_rates: kbit/s, from BIT_RATES. compact_pdo: a bit field of the sub-objects that the
    file leaves out of its PDO records. None: not in the file."""

    vendor_name: str = ""
    vendor_number: int | None = None
    product_name: str = ""
    product_number: int | None = None
    revision_number: int | None = None
    order_code: str = ""
    bit_rates: frozenset[int] = frozenset()
    simple_boot_up_master: bool = False
    simple_boot_up_slave: bool = False
    granularity: int = 0
    dynamic_channels_supported: int = 0
    group_messaging: bool = False
    rpdo_count: int | None = None
    tpdo_count: int | None = None
    lss_supported: bool = False
    compact_pdo: int = 0


@dataclass(frozen=True, slots=True)
class Commissioning:
    """[DeviceCommissioning] of a DCF: one device in its network. bit_rate: kbit/s. None: not in the file."""

    node_id: int | None = None
    node_name: str = ""
    bit_rate: int | None = None
    net_number: int | None = None
    network_name: str = ""
    canopen_manager: bool = False
    lss_serial_number: int | None = None


@dataclass(frozen=True, slots=True)
class DynamicChannel:
    """One segment of [DynamicChannels]: the indices where a programmable device creates objects of one type. direction: ro, wo,
    rww...

    first, last: indices; pp_offset: offset of the first object in the process picture.
    """

    data_type: int
    direction: str
    first: int
    last: int
    pp_offset: int


@dataclass(frozen=True, slots=True)
class Module:
    """A module of a modular device: [MnModuleInfo] and what it adds (CiA 306-1, modular devices).

    fixed_objects: indices of whole objects that come with it; sub_extensions: by index, the file's keys and values that each
    module of this type adds to that object.
    """

    number: int
    product_name: str = ""
    product_version: int | None = None
    product_revision: int | None = None
    order_code: str = ""
    comments: tuple[str, ...] = ()
    fixed_objects: tuple[int, ...] = ()
    sub_extensions: Mapping[int, Mapping[str, str]] = field(default_factory=dict)


class Document(Protocol):
    """The original file."""

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Return line and column, from 1, of an object (subindex None), a sub-object, or one field by its name in the file.

        The column of a field ("DefaultValue") is that of its value. If the file lacks the field, the place of its object is
        returned, and (0, 0) if it lacks that, too.
        """


@dataclass(frozen=True, slots=True)
class DeviceDescription:
    """The whole content of a device's file. source: the file's name, for people.

    dummies: whether a data type (by index) may be a dummy entry of a mapping; None: not in the file. comments: lines. mandatory,
    optional, manufacturer: the three lists of objects, in the file's order. connected_modules: numbers of `modules`, in the order
    of their slots. findings: everything wrong with the file; `encoding`: how its bytes were read.
    """

    dictionary: ObjectDictionary
    kind: FileKind
    source: str = ""
    file_info: FileInfo = FileInfo()
    device_info: DeviceInfo = DeviceInfo()
    commissioning: Commissioning | None = None
    dummies: Mapping[int, bool] | None = None
    comments: tuple[str, ...] = ()
    mandatory: tuple[int, ...] = ()
    optional: tuple[int, ...] = ()
    manufacturer: tuple[int, ...] = ()
    modules: tuple[Module, ...] = ()
    connected_modules: tuple[int, ...] = ()
    dynamic_channels: tuple[DynamicChannel, ...] = ()
    findings: tuple[Finding, ...] = field(default=(), compare=False)
    encoding: str = field(default="utf-8", compare=False)
    document: Document | None = field(default=None, compare=False, repr=False)

    @property
    def node_id(self) -> int | None:
        """The node-ID of the device, None if the file names none."""
        return None if self.commissioning is None else self.commissioning.node_id

    @property
    def lost_settings(self) -> tuple[Finding, ...]:
        """The errors that say which configured values of the file are missing here. A program that writes the settings to a
        device has to look: the device would keep another value."""
        return tuple(each for each in self.findings if each.severity is Severity.ERROR and each.code in _LOSSES)

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Return line and column of an object in the file; see Document.place_of. (0, 0) if there is no file. field: its name
        in the file; "" for the object."""
        return (0, 0) if self.document is None else self.document.place_of(index, subindex, field)
