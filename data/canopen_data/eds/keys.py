"""The keys of the sections about the device as a whole: which field of a `DeviceDescription` each is, and how it is read and
written.

There is one table for each section, in the order in which its keys are written. The reader (device.py) and the writer
(writer_sections.py) go by them. `Fields` has the values of one section of a file.

A missing key gives the field's default, without a finding: files differ much here, and the linter asks for the keys that are
needed. A number or flag that cannot be read gives the default, with a warning. What the description does not have gets no key.

Source: CiA 306-1 v1.4.0, 4.4 (file and device information), 4.7 (modules), 5 (DCF).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, TypeAlias

from canopen_data.eds.ini import Findings, Section, quoted
from canopen_data.eds.numbers import read_number
from canopen_data.eds.writer_values import one_line
from canopen_data.findings import Severity
from canopen_proto.frame import MAX_NODE_ID

UNSIGNED32: Final = 0xFFFF_FFFF
NO_NODE_ID: Final = 0xFF
"""The node-ID of a device until LSS gives it one (CiA 305 v3.0.0, 3.6)."""

_FLAGS: Final = {"0": False, "1": True, "": False}
_FLAG_WORDS: Final = {"true": True, "yes": True, "false": False, "no": False}
NUMBERED: Final = re.compile(r"[1-9][0-9]{0,5}", re.ASCII)
"""A key of a list, or the number at its end."""
_COMMENT: Final = re.compile(r"line([0-9]{1,6})", re.ASCII)


class Fields:
    """The values of one section, which may be missing, as texts, numbers and flags."""

    def __init__(self, section: Section | None, findings: Findings) -> None:
        self._section = section
        self._findings = findings
        self.values = {} if section is None else section.values

    def warn(self, code: str, message: str, key: str = "", severity: Severity = Severity.WARNING) -> None:
        """Add a finding about the section, or about one of its values. code: of the finding. message: for people. key: of the
        value, "" for the section."""
        if self._section is not None:
            self._findings.in_section(self._section, key, severity, code, message)

    def text(self, key: str) -> str:
        """Return a text; "" if there is none. key: in any case of letters."""
        return self.values.get(key.lower(), "")

    def number(self, key: str, *, most: int = UNSIGNED32) -> int | None:
        """Return a number 0..most; None if there is none."""
        text = self.text(key)
        if not text:
            return None
        number, remark = read_number(text)
        if number is None or not 0 <= number <= most:
            fault = remark if number is None else f"is outside 0..{most}"
            self.warn("number", f"{key}={quoted(text)} {fault}; left out", key)
            return None
        if remark:
            self.warn("number", f"{key}={quoted(text)}: {remark}", key)
        return number

    def flag(self, key: str) -> bool:
        """Return a flag; False if there is none."""
        text = self.text(key)
        flag = _FLAGS.get(text)
        if flag is None and (flag := _FLAG_WORDS.get(text.lower())) is None:
            number = self.number(key)
            flag = bool(number)
            if number is not None and number > 1:
                self.warn("number", f"{key}={quoted(text)} is neither 0 nor 1; taken as 1", key)
        return flag

    def numbered(self, count_key: str) -> list[tuple[int, str]]:
        """Return a list: its entries with their numbers, in the order of the numbers. A wrong count is a warning. count_key: of
        the entry that says how many there are."""
        found = [(int(key), text) for key, text in self.values.items() if NUMBERED.fullmatch(key)]
        found.sort()
        self._check(count_key, len(found))
        return found

    def indices(self, count_key: str) -> tuple[int, ...]:
        """Return a list of objects. count_key: of the entry that says how many there are."""
        found = []
        for number, text in self.numbered(count_key):
            index, remark = read_number(text)
            if index is None or not 0 <= index <= 0xFFFF:
                self.warn("number", f"{number}={quoted(text)} is not the index of an object; left out", str(number))
                continue
            if remark:
                self.warn("number", f"{number}={quoted(text)}: {remark}", str(number))
            found.append(index)
        return tuple(found)

    def comments(self) -> tuple[str, ...]:
        """Return the lines of comments."""
        lines = sorted((int(found[1]), text) for key, text in self.values.items() if (found := _COMMENT.fullmatch(key)))
        self._check("Lines", len(lines))
        return tuple(text for _, text in lines)

    def _check(self, count_key: str, count: int) -> None:
        if self._section is None:
            return
        if not self.text(count_key):
            if count:
                self.warn("count", f"{count_key} is missing; there are {count} entries")
            return
        told = self.number(count_key)
        if told is not None and told != count:
            self.warn("count", f"{count_key} is {told}, but there are {count} entries", count_key)


# ---- kinds of keys ----


class KeyKind(NamedTuple):
    """How a key is read, and how the value of its field is written; "" for no key."""

    read: Callable[[Fields, str], Any]
    write: Callable[[Any], str]


def flag_text(value: bool) -> str:
    """Return a flag as a file has it."""
    return "1" if value else "0"


def _if_known(number: int | None) -> str:
    return "" if number is None else str(number)


def _node_id(fields: Fields, key: str) -> int | None:
    node_id = fields.number(key)
    if node_id == NO_NODE_ID:
        message = f"{key}={fields.text(key)}: the device has no node-ID yet (LSS); left out"
        fields.warn("number", message, key, Severity.NOTICE)
        return None
    if node_id is not None and not 1 <= node_id <= MAX_NODE_ID:
        fields.warn("number", f"{key}={node_id} is outside 1..{MAX_NODE_ID}; left out", key)
        return None
    return node_id


TEXT: Final = KeyKind(Fields.text, one_line)
FLAG: Final = KeyKind(Fields.flag, flag_text)
NUMBER: Final = KeyKind(Fields.number, _if_known)
"""None: not in the file."""
COUNT: Final = KeyKind(lambda fields, key: fields.number(key) or 0, str)
"""0 where the file does not have it."""
IDENTITY: Final = KeyKind(Fields.number, lambda number: "" if number is None else f"0x{number:08X}")
NODE_ID: Final = KeyKind(_node_id, _if_known)
BIT_RATE: Final = KeyKind(lambda fields, key: fields.number(key) or None, _if_known)

# ---- the tables ----

SectionKeys: TypeAlias = Mapping[str, tuple[str, KeyKind]]
"""By the key: the field, and the kind."""

FILE_INFO: Final[SectionKeys] = {
    "FileName": ("file_name", TEXT),
    "FileVersion": ("file_version", COUNT),
    "FileRevision": ("file_revision", COUNT),
    "LastEDS": ("last_eds", TEXT),
    "EDSVersion": ("eds_version", TEXT),
    "Description": ("description", TEXT),
    "CreationTime": ("creation_time", TEXT),
    "CreationDate": ("creation_date", TEXT),
    "CreatedBy": ("created_by", TEXT),
    "ModificationTime": ("modification_time", TEXT),
    "ModificationDate": ("modification_date", TEXT),
    "ModifiedBy": ("modified_by", TEXT),
}
PRODUCT: Final[SectionKeys] = {
    "VendorName": ("vendor_name", TEXT),
    "VendorNumber": ("vendor_number", IDENTITY),
    "ProductName": ("product_name", TEXT),
    "ProductNumber": ("product_number", IDENTITY),
    "RevisionNumber": ("revision_number", IDENTITY),
    "OrderCode": ("order_code", TEXT),
}
"""Of [DeviceInfo]; the bit rates follow, then FEATURES."""
FEATURES: Final[SectionKeys] = {
    "SimpleBootUpMaster": ("simple_boot_up_master", FLAG),
    "SimpleBootUpSlave": ("simple_boot_up_slave", FLAG),
    "Granularity": ("granularity", COUNT),
    "DynamicChannelsSupported": ("dynamic_channels_supported", COUNT),
    "CompactPDO": ("compact_pdo", COUNT),
    "GroupMessaging": ("group_messaging", FLAG),
    "NrOfRXPDO": ("rpdo_count", NUMBER),
    "NrOfTXPDO": ("tpdo_count", NUMBER),
    "LSS_Supported": ("lss_supported", FLAG),
}
COMMISSIONING: Final[SectionKeys] = {
    "NodeID": ("node_id", NODE_ID),
    "NodeName": ("node_name", TEXT),
    "Baudrate": ("bit_rate", BIT_RATE),
    "NetNumber": ("net_number", NUMBER),
    "NetworkName": ("network_name", TEXT),
    "CANopenManager": ("canopen_manager", FLAG),
    "LSS_SerialNumber": ("lss_serial_number", NUMBER),
}
MODULE_INFO: Final[SectionKeys] = {
    "ProductName": ("product_name", TEXT),
    "ProductVersion": ("product_version", NUMBER),
    "ProductRevision": ("product_revision", NUMBER),
    "OrderCode": ("order_code", TEXT),
}


def taken(keys: SectionKeys, fields: Fields) -> dict[str, Any]:
    """Return the values of a section, by field. fields: of the section."""
    return {name: kind.read(fields, key) for key, (name, kind) in keys.items()}


def written(keys: SectionKeys, facts: object) -> dict[str, str]:
    """Return the keys and texts for the fields of a part of a description."""
    texts = {key: kind.write(getattr(facts, name)) for key, (name, kind) in keys.items()}
    return {key: text for key, text in texts.items() if text}
