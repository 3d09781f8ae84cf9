"""Read the facts about the device as a whole: all sections of an EDS or DCF except those of objects.

Each function reads one kind of section into a part of `DeviceDescription`, by the tables of keys.py.

Lists count from 1, and a key gives the number of entries; the entries present decide.

Source: CiA 306-1 v1.4.0, 4.4 (file and device information), 4.5 (lists), 4.7 (modules), 5 (DCF).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import MappingProxyType
from typing import Final

from canopen_data.description import BIT_RATES, Commissioning, DeviceInfo, DynamicChannel, FileInfo, Module
from canopen_data.eds.ini import EdsDocument, Findings, Section
from canopen_data.eds.keys import COMMISSIONING, FEATURES, FILE_INFO, MODULE_INFO, NUMBERED, PRODUCT, Fields, taken
from canopen_data.eds.numbers import read_number
from canopen_data.findings import Severity

MAX_MODULES: Final = 1000
"""Types of modules in one file; catalogues of modular devices have some dozens."""

_DUMMY: Final = re.compile(r"dummy([0-9a-f]{4})", re.ASCII)
_RANGE: Final = re.compile(r"\s*([^-]+?)\s*-\s*([^-]+?)\s*")
_MODULE: Final = re.compile(r"m([0-9]{1,6})moduleinfo", re.ASCII)
_EXTENSION: Final = re.compile(r"m([0-9]{1,6})subext([0-9a-f]{1,4})", re.ASCII)


def file_info(document: EdsDocument, findings: Findings) -> FileInfo:
    """Return the contents of [FileInfo]."""
    return FileInfo(**taken(FILE_INFO, Fields(document.named.get("fileinfo"), findings)))


def device_info(document: EdsDocument, findings: Findings) -> DeviceInfo:
    """Return the contents of [DeviceInfo]."""
    fields = Fields(document.named.get("deviceinfo"), findings)
    product = taken(PRODUCT, fields)
    bit_rates = frozenset(rate for rate in BIT_RATES if fields.flag(f"BaudRate_{rate}"))
    return DeviceInfo(**product, bit_rates=bit_rates, **taken(FEATURES, fields))


def commissioning(document: EdsDocument, findings: Findings) -> Commissioning | None:
    """Return the contents of [DeviceCommissioning], in either spelling; None if there is none."""
    section = document.named.get("devicecomissioning")
    return None if section is None else Commissioning(**taken(COMMISSIONING, Fields(section, findings)))


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

    info = taken(MODULE_INFO, fields("moduleinfo"))
    listed = fields("subextends").indices("NrOfEntries")
    in_order = {**dict.fromkeys(index for index in listed if index in extensions), **dict.fromkeys(sorted(extensions))}
    return Module(
        number,
        **info,
        comments=fields("comments").comments(),
        fixed_objects=fields("fixedobjects").indices("NrOfEntries"),
        sub_extensions=MappingProxyType({index: MappingProxyType(_as_spelt(extensions[index])) for index in in_order}),
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
    numbers = sorted({int(key[4:]) for key in fields.values if key.startswith("type") and NUMBERED.fullmatch(key[4:])})
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
