"""Texts for people about a device description: types, limits, defaults, PDOs. For `eds show` and `eds doc`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_cli.shared.values import value_text
from canopen_data.checks.mappings import entries_of
from canopen_data.checks.structure import field_name
from canopen_data.checks.subject import Number, Subject
from canopen_data.description import DeviceDescription
from canopen_master.device_types import device_type_text
from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.model import Direction, Object, ObjectType, Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.mapping import DUMMY_TYPES, LAST_DUMMY_INDEX
from canopen_proto.pdo.multiplexed import MpdoMode
from canopen_proto.pdo.settings import COB_ID, EVENT_TIMER, INHIBIT_TIME, TRANSMISSION_TYPE, mapping_index, place_of

AREAS: Final = (
    ("Data types", range(0x0001, 0x1000)),
    ("Communication", indices.COMMUNICATION_AREA),
    ("Manufacturer", indices.MANUFACTURER_AREA),
    ("Device profile", indices.PROFILE_AREA),
    ("Interface profile", range(0xA000, 0xC000)),
    ("Reserved", range(0xC000, 0x10000)),
)
"""Of the object dictionary (CiA 301 v4.2.0, table 41)."""

MAX_TEXT: Final = 60
"""Characters shown of a default value: some files contain certificates."""


@dataclass(frozen=True)
class PdoEntry:
    """One entry of a PDO. place: "6041:00"; name: of the object, "" if the file does not have it; bits: in the PDO."""

    place: str
    name: str
    bits: int
    is_dummy: bool = False


@dataclass(frozen=True)
class PdoText:
    """A PDO as it is after start-up. name: "TPDO1". cob_id, transmission, times: for people. exists: it is sent or received."""

    name: str
    direction: Direction
    cob_id: str
    exists: bool
    transmission: str
    times: str
    entries: tuple[PdoEntry, ...]
    note: str = ""

    @property
    def bits(self) -> int:
        """The bits of all entries together."""
        return sum(entry.bits for entry in self.entries)


def pdos_of(description: DeviceDescription) -> list[PdoText]:
    """Return all PDOs of a description: RPDOs, then TPDOs, by number."""
    subject = Subject(description, ())
    found = []
    for index in description.dictionary.objects:
        place = place_of(index)
        if place is None or place.is_mapping:
            continue
        cob_id = subject.number(index, COB_ID)
        mapping = mapping_index(place.direction, place.number)
        count = subject.number(mapping)
        is_multiplexed = count is not None and count.value in (MpdoMode.SOURCE, MpdoMode.DESTINATION)
        found.append(
            PdoText(
                f"{place.direction}{place.number}",
                place.direction,
                "not given" if cob_id is None else _can_id_text(cob_id),
                cob_id is not None and not cob_id.value & COB_ID_INVALID,
                transmission_text(subject.number(index, TRANSMISSION_TYPE)),
                _times(subject, index),
                () if is_multiplexed else tuple(_entry(subject, entry) for _, entry in entries_of(subject, mapping)),
                "multiplexed" if is_multiplexed else "",
            )
        )
    return found


def _can_id_text(cob_id: Number) -> str:
    can_id = Number(cob_id.value & 0x1FFF_FFFF, cob_id.adds_node_id)
    if cob_id.adds_node_id:
        return str(can_id)
    return f"0x{can_id.value:03X}"


def _times(subject: Subject, index: int) -> str:
    inhibit, event = subject.number(index, INHIBIT_TIME), subject.number(index, EVENT_TIMER)
    parts = [f"at most every {inhibit.value / 10:g} ms"] if inhibit is not None and inhibit.value else []
    parts += [f"at least every {event.value} ms"] if event is not None and event.value else []
    return ", ".join(parts)


def transmission_text(number: Number | None) -> str:
    """Return the text of a transmission type (CiA 301 v4.2.0, 7.5.2.35 and 7.5.2.37)."""
    if number is None:
        return "not given"
    named = {0: "at SYNC, when changed", 1: "at each SYNC", 252: "on request, sampled at SYNC", 253: "on request"}
    value = number.value
    if value in named:
        return named[value]
    if value in (254, 255):
        return f"event-driven ({value})"
    return f"every {value} SYNCs" if value <= 240 else f"reserved ({value})"


def _entry(subject: Subject, entry: Number) -> PdoEntry:
    index, subindex, bits = mapped(entry.value)
    if index <= LAST_DUMMY_INDEX:
        dummy = DUMMY_TYPES.get(index)
        return PdoEntry(f"{index:04X}", "" if dummy is None else dummy.name, bits, True)
    variable = subject.dictionary.get(index, subindex)
    name = "" if variable is None else full_name(subject.dictionary.objects[index], variable)
    return PdoEntry(f"{index:04X}:{subindex:02X}", name, bits)


# ---- objects ----


def kind_text(each: Object) -> str:
    """Return the data type of an object that is one variable, else ARRAY, RECORD ... with the number of sub-objects."""
    if is_one(each):
        return each.variables[0].data_type.name
    return f"{each.object_type.name} ({len(each.variables)})"


def is_one(each: Object) -> bool:
    """Return whether an object is one variable at subindex 0."""
    return list(each.variables) == [0] and each.object_type not in (ObjectType.ARRAY, ObjectType.RECORD)


def full_name(each: Object, variable: Variable) -> str:
    """Return the name of a sub-object with its object's name before it: "channel 1" alone is not clear."""
    own = field_name(each, variable.name)
    return own if is_one(each) or own == each.name else f"{each.name}: {own}"


def cells_of(variable: Variable) -> tuple[str, str, str, str, str, str]:
    """Return the cells of a sub-object in a table: type, access, PDO, default, limits, configured value."""
    return (
        variable.data_type.name,
        str(variable.access),
        "yes" if variable.pdo_mappable else "",
        default_text(variable),
        limits_text(variable),
        configured_text(variable),
    )


def limits_text(variable: Variable) -> str:
    """Return a text such as "0..100"; "" if only the type limits it."""
    if variable.low_limit is None and variable.high_limit is None:
        return ""
    low, high = (number_text(variable, each) for each in (variable.low_limit, variable.high_limit))
    return f"{low}..{high}"


def default_text(variable: Variable) -> str:
    """Return the default value as text, "" if the file has none."""
    return _initial(variable, variable.default, variable.adds_node_id)


def configured_text(variable: Variable) -> str:
    """Return the value that a DCF sets, as text; "" if it sets none."""
    return _initial(variable, variable.configured, variable.configured_adds_node_id)


def _initial(variable: Variable, value: Value | None, adds_node_id: bool) -> str:
    if adds_node_id and isinstance(value, int):
        return str(Number(value, True))
    return number_text(variable, value)


def number_text(variable: Variable, value: Value | None) -> str:
    """Return a value as text; COB-IDs and mappings as hexadecimal numbers, since nobody can read them in decimal."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if (
        isinstance(value, int)
        and variable.index in indices.COMMUNICATION_AREA
        and variable.data_type is DataType.UNSIGNED32
        and value > 9
    ):
        return f"0x{value:X}"
    text = value_text(variable, value)
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}..."


def head_of(description: DeviceDescription) -> list[tuple[str, str]]:
    """Return what the file says about the device as a whole, as (label, text)."""
    info, file, commissioning = description.device_info, description.file_info, description.commissioning
    subject = Subject(description, ())
    device_type = subject.number(indices.DEVICE_TYPE)
    rows = [
        ("device", info.product_name),
        ("vendor", _named(info.vendor_name, info.vendor_number)),
        ("product", "" if info.product_number is None else f"0x{info.product_number:X}"),
        ("revision", "" if info.revision_number is None else f"0x{info.revision_number:X}"),
        ("order code", info.order_code),
        ("type", "" if device_type is None else f"{device_type_text(device_type.value)}, 0x{device_type.value:08X}"),
        ("bit rates", f"{', '.join(str(each) for each in sorted(info.bit_rates))} kbit/s" if info.bit_rates else ""),
        ("objects", _counts(description)),
        ("LSS", "supported" if info.lss_supported else ""),
    ]
    if commissioning is not None:
        node_id, bit_rate = commissioning.node_id, commissioning.bit_rate
        rows += [
            ("node", _named(commissioning.node_name, None) + ("" if node_id is None else f" {node_id} (0x{node_id:02X})")),
            ("commissioned at", "" if bit_rate is None else f"{bit_rate} kbit/s"),
            ("network", _named(commissioning.network_name, commissioning.net_number)),
        ]
    version = f"{file.file_version}.{file.file_revision}" if file.file_version or file.file_revision else ""
    rows += [
        ("file", f"{description.kind}{f', version {version}' if version else ''}"),
        ("about", file.description),
        ("changed", " ".join(each for each in (file.modification_date, file.modification_time, file.modified_by) if each)),
    ]
    return [(label, text.strip()) for label, text in rows if text.strip()]


def _named(name: str, number: int | None) -> str:
    return f"{name} (0x{number:X})".strip() if number is not None else name


def _counts(description: DeviceDescription) -> str:
    objects, variables = len(description.dictionary.objects), len(description.dictionary)
    return f"{objects}, with {variables} values"
