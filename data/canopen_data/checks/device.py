"""Check the facts about the device as a whole and about the file: identity, bit rates, commissioning, dates.

Source: CiA 306-1 v1.4.0, [FileInfo], [DeviceInfo], [DeviceCommissioning]; CiA 301 v4.2.0, 7.5.2.21 (identity).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

from canopen_data.checks.subject import ERROR, NOTICE, WARNING, Rule, Subject
from canopen_data.description import FileKind
from canopen_data.findings import Finding
from canopen_proto import indices
from canopen_proto.frame import MAX_NODE_ID

MAX_GRANULARITY: Final = 64
"""Bits: of the mapping of PDOs."""

RULES: Final = (
    Rule("identity-missing", ERROR, "the identity object has no vendor-ID"),
    Rule("identity-differs", WARNING, "the head of the file and the identity object tell different devices"),
    Rule("vendor-missing", NOTICE, "the file does not say whose device it is"),
    Rule("product-missing", NOTICE, "the file does not say which device it is"),
    Rule("bit-rate-missing", WARNING, "the device supports no bit rate"),
    Rule("granularity", WARNING, "a granularity that no device can have"),
    Rule("commissioning-missing", WARNING, "a DCF that does not tell the node-ID"),
    Rule("node-id", ERROR, "a node-ID that no device can have"),
    Rule("bit-rate-unsupported", WARNING, "the device is commissioned with a bit rate that it does not support"),
    Rule("eds-version", NOTICE, "an EDSVersion that is not of the form 4.0"),
    Rule("file-name", NOTICE, "FileName is not the file's name"),
    Rule("file-date", NOTICE, "a date or time that is not of the form 05-23-2013, 01:33PM"),
)

_DATE: Final = re.compile(r"(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])-[0-9]{4}", re.ASCII)
_TIME: Final = re.compile(r"(0?[0-9]|1[0-2]):[0-5][0-9] ?(AM|PM)", re.ASCII)
_VERSION: Final = re.compile(r"[0-9]\.[0-9]", re.ASCII)


def check_identity(subject: Subject) -> Iterator[Finding]:
    """Check 0x1018 against [DeviceInfo]."""
    info = subject.description.device_info
    if indices.IDENTITY_OBJECT in subject.dictionary.objects and subject.dictionary.get(indices.IDENTITY_OBJECT, 1) is None:
        yield subject.of_object("identity-missing", indices.IDENTITY_OBJECT, "it has no sub 1 (vendor-ID)")
    for subindex, entry, told in (
        (1, "VendorNumber", info.vendor_number),
        (2, "ProductNumber", info.product_number),
        (3, "RevisionNumber", info.revision_number),
    ):
        held = subject.number(indices.IDENTITY_OBJECT, subindex)
        if told is not None and held is not None and held.value and told and held.value != told:
            text = f"it is 0x{held.value:X} here and 0x{told:X} in [DeviceInfo] ({entry})"
            yield subject.of_value("identity-differs", subject.dictionary.variable((indices.IDENTITY_OBJECT, subindex)), text)
    if not info.vendor_name and not info.vendor_number:
        yield subject.of_entry("vendor-missing", "DeviceInfo", "VendorName", "there is neither VendorName nor VendorNumber")
    if not info.product_name and not info.product_number:
        yield subject.of_entry("product-missing", "DeviceInfo", "ProductName", "there is neither ProductName nor ProductNumber")


def check_device(subject: Subject) -> Iterator[Finding]:
    """Check bit rates, granularity and commissioning."""
    description = subject.description
    info, commissioning = description.device_info, description.commissioning
    if not info.bit_rates:
        yield subject.of_entry(
            "bit-rate-missing", "DeviceInfo", "BaudRate_500", "no bit rate is supported: all BaudRate_... are 0"
        )
    if not 0 <= info.granularity <= MAX_GRANULARITY:
        text = f"Granularity={info.granularity} is outside 0..{MAX_GRANULARITY}"
        yield subject.of_entry("granularity", "DeviceInfo", "Granularity", text)
    if commissioning is None or commissioning.node_id is None:
        if description.kind in (FileKind.DCF, FileKind.XDC):
            yield subject.of_entry("commissioning-missing", "DeviceCommissioning", "NodeID", "there is no node-ID")
    elif not 1 <= commissioning.node_id <= MAX_NODE_ID:
        text = f"NodeID={commissioning.node_id} is outside 1..{MAX_NODE_ID}"
        yield subject.of_entry("node-id", "DeviceCommissioning", "NodeID", text)
    if commissioning is not None and commissioning.bit_rate and info.bit_rates and commissioning.bit_rate not in info.bit_rates:
        known = ", ".join(str(each) for each in sorted(info.bit_rates))
        text = f"Baudrate={commissioning.bit_rate}, but the device supports {known} kbit/s"
        yield subject.of_entry("bit-rate-unsupported", "DeviceCommissioning", "Baudrate", text)


def check_file(subject: Subject) -> Iterator[Finding]:
    """Check [FileInfo] of an EDS or DCF; XML has forms of its own."""
    if not subject.has_lists:
        return
    description, info = subject.description, subject.description.file_info
    name = re.split(r"[/\\]", description.source)[-1]
    if info.file_name and name and info.file_name.casefold() != name.casefold():
        yield subject.of_entry("file-name", "FileInfo", "FileName", f"FileName={info.file_name}, but the file is called {name}")
    if info.eds_version and not _VERSION.fullmatch(info.eds_version):
        text = f"EDSVersion={info.eds_version} is not of the form 4.0"
        yield subject.of_entry("eds-version", "FileInfo", "EDSVersion", text)
    for entry, value, form, example in (
        ("CreationDate", info.creation_date, _DATE, "05-23-2013 (month first)"),
        ("CreationTime", info.creation_time, _TIME, "01:33PM"),
        ("ModificationDate", info.modification_date, _DATE, "05-23-2013 (month first)"),
        ("ModificationTime", info.modification_time, _TIME, "01:33PM"),
    ):
        if value and not form.fullmatch(value):
            yield subject.of_entry("file-date", "FileInfo", entry, f"{entry}={value} is not of the form {example}")


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (check_identity, check_device, check_file)
