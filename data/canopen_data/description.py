"""What a device's file says: its objects, and the device as a whole.

Theory of operation
-------------------
An EDS describes a type of device, a DCF one device of that type with its node-ID and its settings (CiA 306-1 v1.4.0); an XDD and
an XDC are the same in XML (CiA 311). All four are read into a `DeviceDescription`: the `ObjectDictionary`, which is all that the
protocol needs, and around it what tools need: who made the file, what the device can do, how it is commissioned.

A description never changes once it is read; `dataclasses.replace` makes another one. `document` remembers the file as it stood
(order, spelling, the form of each number), so that a writer changes only what has changed, and a finding about an object can name
its line. It says nothing that the other fields do not, except for sections that no standard knows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Protocol

from canopen_data.findings import Finding
from canopen_proto.dictionary.model import ObjectDictionary

BIT_RATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
"""kbit/s: the ones that an EDS can name (CiA 306-1, DeviceInfo)."""


class FileKind(StrEnum):
    """What sort of file a description came from."""

    EDS = "EDS"
    DCF = "DCF"
    XDD = "XDD"
    XDC = "XDC"
    CSV = "CSV"


@dataclass(frozen=True, slots=True)
class FileInfo:
    """[FileInfo]: the file itself. Times and dates are text as it stands there ("01:33PM", "05-23-2013"). last_eds: of a DCF."""

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
    """[DeviceInfo]: the type of device. bit_rates: kbit/s, of BIT_RATES. compact_pdo: which sub-objects of the PDO records are
    left out of the file, as a bit field. None: the file does not say."""

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
    """[DeviceCommissioning] of a DCF: one device in its network. bit_rate: kbit/s. None: the file does not say."""

    node_id: int | None = None
    node_name: str = ""
    bit_rate: int | None = None
    net_number: int | None = None
    network_name: str = ""
    canopen_manager: bool = False
    lss_serial_number: int | None = None


@dataclass(frozen=True, slots=True)
class DynamicChannel:
    """One segment of [DynamicChannels]: where a programmable device makes objects of a type on request. direction: ro, wo, rww...

    first, last: indices; pp_offset: of its first object in the process picture.
    """

    data_type: int
    direction: str
    first: int
    last: int
    pp_offset: int


@dataclass(frozen=True, slots=True)
class Module:
    """A module of a modular device: [MnModuleInfo] and what it adds (CiA 306-1, modular devices).

    fixed_objects: objects that come with it, whole; sub_extensions: by index, what each module of this type adds to that object,
    as the file's keys and values.
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
    """The file as it stood."""

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Line and column, from 1, of an object (subindex None), a sub-object, or one field by the file's name for it.

        Of a field ("DefaultValue") the column is that of its value. Where the file does not have it, the place of the next larger
        thing; (0, 0) where it has nothing of all this.
        """


@dataclass(frozen=True, slots=True)
class DeviceDescription:
    """All that a file says of a device. source: the file's name, for people.

    dummies: which data types (by index) may stand in a mapping as dummy entries; None: the file does not say. comments: lines.
    mandatory, optional, manufacturer: the three lists of objects, in the file's order. connected_modules: numbers of `modules`,
    in the order of their slots. findings: all that was wrong with the file; `encoding`: how its bytes were read.
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

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Line and column of an object in the file; see Document.place_of. (0, 0) where there is no file."""
        return (0, 0) if self.document is None else self.document.place_of(index, subindex, field)
