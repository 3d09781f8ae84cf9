"""Read the facts about the device as a whole: all sections of an EDS or DCF except those of objects.

Each function reads one kind of section into a part of `DeviceDescription`. A missing key gives the field's default, without a
finding: files differ much here, and the linter asks for the keys that are needed. A number or flag that cannot be read gives the
default, with a warning.

Lists count from 1, and a key gives the number of entries; the entries present decide.

Source: CiA 306-1 v1.4.0, 4.4 (file and device information), 4.5 (lists), 4.7 (modules), 5 (DCF).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import MappingProxyType
from typing import Final

from canopen_data.description import BIT_RATES, Commissioning, DeviceInfo, DynamicChannel, FileInfo, Module
from canopen_data.eds.ini import EdsDocument, Findings, Section, quoted
from canopen_data.eds.numbers import read_number
from canopen_data.findings import Severity
from canopen_proto.frame import MAX_NODE_ID

UNSIGNED32: Final = 0xFFFF_FFFF
NO_NODE_ID: Final = 0xFF
"""The node-ID of a device until LSS gives it one (CiA 305 v3.0.0, 3.6)."""
MAX_MODULES: Final = 1000
"""Types of modules in one file; catalogues of modular devices have some dozens."""

_FLAGS: Final = {"0": False, "1": True, "": False}
_FLAG_WORDS: Final = {"true": True, "yes": True, "false": False, "no": False}
_NUMBERED: Final = re.compile(r"[1-9][0-9]{0,5}", re.ASCII)
_COMMENT: Final = re.compile(r"line([0-9]{1,6})", re.ASCII)
_DUMMY: Final = re.compile(r"dummy([0-9a-f]{4})", re.ASCII)
_RANGE: Final = re.compile(r"\s*([^-]+?)\s*-\s*([^-]+?)\s*")
_MODULE: Final = re.compile(r"m([0-9]{1,6})moduleinfo", re.ASCII)
_EXTENSION: Final = re.compile(r"m([0-9]{1,6})subext([0-9a-f]{1,4})", re.ASCII)


class Fields:
    """The values of one section, which may be missing, as texts, numbers and flags."""

    __slots__ = ("_findings", "_section", "values")

    def __init__(self, section: Section | None, findings: Findings) -> None:
        self._section = section
        self._findings = findings
        self.values = {} if section is None else section.values

    def warn(self, code: str, message: str, key: str = "", severity: Severity = Severity.WARNING) -> None:
        """Add a finding about the section, or about one of its values. code: of the finding. message: for people. key: of the
        value, "" for the section."""
        if self._section is not None and not self._findings.full(severity):
            line, column = self._section.place_of(key)
            message = f"in [{quoted(self._section.name)}]: {message}"
            self._findings.add(severity, code, message, line, column)

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
        found = [(int(key), text) for key, text in self.values.items() if _NUMBERED.fullmatch(key)]
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


def file_info(document: EdsDocument, findings: Findings) -> FileInfo:
    """Return the contents of [FileInfo]."""
    fields = Fields(document.named.get("fileinfo"), findings)
    return FileInfo(
        fields.text("FileName"),
        fields.number("FileVersion") or 0,
        fields.number("FileRevision") or 0,
        fields.text("EDSVersion"),
        fields.text("Description"),
        fields.text("CreationTime"),
        fields.text("CreationDate"),
        fields.text("CreatedBy"),
        fields.text("ModificationTime"),
        fields.text("ModificationDate"),
        fields.text("ModifiedBy"),
        fields.text("LastEDS"),
    )


def device_info(document: EdsDocument, findings: Findings) -> DeviceInfo:
    """Return the contents of [DeviceInfo]."""
    fields = Fields(document.named.get("deviceinfo"), findings)
    return DeviceInfo(
        fields.text("VendorName"),
        fields.number("VendorNumber"),
        fields.text("ProductName"),
        fields.number("ProductNumber"),
        fields.number("RevisionNumber"),
        fields.text("OrderCode"),
        frozenset(rate for rate in BIT_RATES if fields.flag(f"BaudRate_{rate}")),
        fields.flag("SimpleBootUpMaster"),
        fields.flag("SimpleBootUpSlave"),
        fields.number("Granularity") or 0,
        fields.number("DynamicChannelsSupported") or 0,
        fields.flag("GroupMessaging"),
        fields.number("NrOfRXPDO"),
        fields.number("NrOfTXPDO"),
        fields.flag("LSS_Supported"),
        fields.number("CompactPDO") or 0,
    )


def commissioning(document: EdsDocument, findings: Findings) -> Commissioning | None:
    """Return the contents of [DeviceCommissioning], in either spelling; None if there is none."""
    section = document.named.get("devicecomissioning")
    if section is None:
        return None
    fields = Fields(section, findings)
    node_id = fields.number("NodeID")
    if node_id == NO_NODE_ID:
        message = f"NodeID={fields.text('NodeID')}: the device has no node-ID yet (LSS); left out"
        fields.warn("number", message, "NodeID", Severity.NOTICE)
        node_id = None
    if node_id is not None and not 1 <= node_id <= MAX_NODE_ID:
        fields.warn("number", f"NodeID={node_id} is outside 1..{MAX_NODE_ID}; left out", "NodeID")
        node_id = None
    return Commissioning(
        node_id,
        fields.text("NodeName"),
        fields.number("Baudrate") or None,
        fields.number("NetNumber"),
        fields.text("NetworkName"),
        fields.flag("CANopenManager"),
        fields.number("LSS_SerialNumber"),
    )


def dummies(document: EdsDocument, findings: Findings) -> MappingProxyType[int, bool] | None:
    """Return the contents of [DummyUsage], by data type; None if there is none. Types that it does not name are left out."""
    section = document.named.get("dummyusage")
    if section is None:
        return None
    fields = Fields(section, findings)
    usable = {int(found[1], 16): fields.flag(key) for key in reversed(list(section.values)) if (found := _DUMMY.fullmatch(key))}
    return MappingProxyType(usable)


def modules(document: EdsDocument, findings: Findings) -> tuple[Module, ...]:
    """Return the modules of [SupportedModules], each from its sections."""
    numbers = sorted({int(found[1]) for name in document.named if (found := _MODULE.fullmatch(name))})
    section = document.named.get("supportedmodules")
    told = Fields(section, findings).number("NrOfEntries")
    if section is not None and told is not None and told != len(numbers):
        message = f"NrOfEntries is {told}, but there are {len(numbers)} modules"
        Fields(section, findings).warn("count", message, "NrOfEntries")
    extensions = module_extensions(document)
    if len(numbers) > MAX_MODULES:
        findings.add(Severity.ERROR, "too-long", f"there are {len(numbers)} modules; only the first {MAX_MODULES} were read")
    return tuple(_module(number, document, extensions.get(number, {}), findings) for number in numbers[:MAX_MODULES])


def module_extensions(document: EdsDocument) -> dict[int, dict[int, Section]]:
    """Return the sections [MxSubExt6000], by module and index."""
    extensions: dict[int, dict[int, Section]] = {}
    for name, section in document.named.items():
        if found := _EXTENSION.fullmatch(name):
            extensions.setdefault(int(found[1]), {})[int(found[2], 16)] = section
    return extensions


def _module(number: int, document: EdsDocument, extensions: dict[int, Section], findings: Findings) -> Module:
    def fields(name: str) -> Fields:
        return Fields(document.named.get(f"m{number}{name}"), findings)

    info = fields("moduleinfo")
    listed = fields("subextends").indices("NrOfEntries")
    in_order = {**dict.fromkeys(index for index in listed if index in extensions), **dict.fromkeys(sorted(extensions))}
    return Module(
        number,
        info.text("ProductName"),
        info.number("ProductVersion"),
        info.number("ProductRevision"),
        info.text("OrderCode"),
        fields("comments").comments(),
        fields("fixedobjects").indices("NrOfEntries"),
        MappingProxyType({index: MappingProxyType(_as_spelt(extensions[index])) for index in in_order}),
    )


def _as_spelt(section: Section) -> dict[str, str]:
    """Return the entries, with the keys spelt as in the file."""
    spelt: dict[str, str] = {}
    seen: set[str] = set()
    for entry in section.entries:
        if entry.key.lower() not in seen:
            spelt[entry.key] = entry.value
            seen.add(entry.key.lower())
    return spelt


def connected_modules(document: EdsDocument, findings: Findings) -> tuple[int, ...]:
    """Return [ConnectedModules]: the module's number for each slot."""
    fields = Fields(document.named.get("connectedmodules"), findings)
    return tuple(
        number for key, _ in fields.numbered("NrOfEntries") if (number := fields.number(str(key), most=0xFFFF)) is not None
    )


def dynamic_channels(document: EdsDocument, findings: Findings) -> tuple[DynamicChannel, ...]:
    """Return the segments of [DynamicChannels]."""
    section = document.named.get("dynamicchannels")
    return () if section is None else tuple(_channels(Fields(section, findings)))


def _channels(fields: Fields) -> Iterator[DynamicChannel]:
    numbers = sorted({int(key[4:]) for key in fields.values if key.startswith("type") and _NUMBERED.fullmatch(key[4:])})
    told = fields.number("NrOfSeg")
    if told is not None and told != len(numbers):
        fields.warn("count", f"NrOfSeg is {told}, but there are {len(numbers)} segments", "NrOfSeg")
    for number in numbers:
        data_type = fields.number(f"Type{number}", most=0xFFFF)
        parts = _RANGE.fullmatch(fields.text(f"Range{number}"))
        first, last = (read_number(part)[0] for part in parts.groups()) if parts is not None else (None, None)
        if data_type is None or first is None or last is None or not 0 <= first <= last <= 0xFFFF:
            fields.warn("number", f"segment {number} has no type and range of indices; left out", f"Range{number}")
            continue
        offset = fields.number(f"PPOffset{number}") or 0
        yield DynamicChannel(data_type, fields.text(f"Dir{number}"), first, last, offset)
