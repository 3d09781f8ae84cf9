"""What a node says it is: its identity in words, and whether a file is that of such a device.

Whether it is has one rule, for `canopen info -e` and `canopen net init --files`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple, TypeAlias

from canopen_data.description import DeviceDescription, FileKind
from canopen_master.device_types import device_type_text
from canopen_master.errors import SdoRefusedError
from canopen_master.node import Node
from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, text_for_people
from canopen_proto.dictionary import Variable
from canopen_proto.dictionary.standard import find_standard

DEVICE_TYPE: Final = "device type"
VENDOR_ID, PRODUCT_CODE, REVISION, SERIAL_NUMBER = "vendor-ID", "product code", "revision", "serial number"
IDENTITY: Final = ((1, VENDOR_ID), (2, PRODUCT_CODE), (3, REVISION), (4, SERIAL_NUMBER))


class Different(NamedTuple):
    """A number of the identity that the node and the file do not share."""

    field: str
    node: int
    file: int

    def __str__(self) -> str:
        return f"{self.field} 0x{self.node:08X} (file: 0x{self.file:08X})"


def identity_in(description: DeviceDescription, node_id: int) -> dict[str, int]:
    """Return the numbers of a file's identity that it knows, by their names.

    0 says nothing, for a vendor-ID too: the file does not know it. A serial number counts only in the file of a single device.
    """
    device = description.device_info
    said = {VENDOR_ID: device.vendor_number, PRODUCT_CODE: device.product_number, REVISION: device.revision_number}
    for subindex, name in IDENTITY:
        variable = description.dictionary.get(indices.IDENTITY_OBJECT, subindex)
        if variable is not None and isinstance(value := _said(variable, node_id), int) and value:
            said[name] = value
    if description.kind not in (FileKind.DCF, FileKind.XDC):
        said.pop(SERIAL_NUMBER, None)
    known = {name: number for name, number in said.items() if number}
    device_type = description.dictionary.get(indices.DEVICE_TYPE)
    if device_type is not None and isinstance(value := _said(device_type, node_id), int):
        known = {DEVICE_TYPE: value} | known
    return known


def differences(known: Mapping[str, int], shown: Mapping[str, int]) -> list[Different]:
    """Return where a node (`shown`) contradicts a file (`known`). A number that one of them lacks contradicts nothing."""
    return [Different(name, shown[name], number) for name, number in known.items() if name in shown and shown[name] != number]


def is_identified(known: Mapping[str, int], shown: Mapping[str, int]) -> bool:
    """Return whether file and node share a vendor-ID and a product code that both know. Less would be no evidence."""
    return all(known.get(name) and known[name] == shown.get(name) for name in (VENDOR_ID, PRODUCT_CODE))


def _said(variable: Variable, node_id: int) -> Value | None:
    """Return the value of an object after start-up, or None if the file does not say."""
    return None if variable.default is None and variable.configured is None else variable.initial_of(node_id)


Facts: TypeAlias = "dict[str, tuple[Any, str]]"
"""Facts about a node: a name for people -> (value for programs, text for people)."""


async def identity_facts(node: Node, description: DeviceDescription | None) -> Facts:
    """Return what a node says it is, and whether its own file is that of such a device. description: of that file; None: none.
    Raises what reading an object raises."""
    # Every device has this object: if the node does not answer, it is not there, and the error says so.
    device_type = int.from_bytes(await node.read_bytes(indices.DEVICE_TYPE), "little")
    facts: Facts = {"device type": (device_type, f"{device_type_text(device_type)}  (0x{device_type:08X})")}
    for name, index in (
        ("name", indices.MANUFACTURER_DEVICE_NAME),
        ("hardware version", indices.MANUFACTURER_HARDWARE_VERSION),
        ("software version", indices.MANUFACTURER_SOFTWARE_VERSION),
    ):
        text = await read_standard(node, index)
        if isinstance(text, str) and (shown := text_for_people(text, DataType.VISIBLE_STRING).rstrip("\0 ")):
            facts[name] = (shown, shown)
    for subindex, name in IDENTITY:
        number = await read_standard(node, indices.IDENTITY_OBJECT, subindex)
        if isinstance(number, int):
            facts[name] = (number, f"0x{number:08X}")
    if description is not None:
        facts["file"] = _compared(description, facts, node.node_id)
    return facts


def _compared(description: DeviceDescription, facts: Facts, node_id: int) -> tuple[dict[str, Any], str]:
    """Compare the identity of the node with its file. A number that the file lacks, or has as 0, fits every node."""
    known = identity_in(description, node_id)
    different = differences(known, {name: raw for name, (raw, _) in facts.items() if isinstance(raw, int)})
    is_compared = any(name in facts for name in known)
    raw = {
        "name": description.source,
        "matches": not different if is_compared else None,
        "different": [each._asdict() for each in different],
    }
    if not is_compared:
        return raw, f"{description.source}: it gives no identity of the device"
    if not different:
        return raw, f"{description.source}: MATCH"
    return raw, f"{description.source}: ANOTHER DEVICE by {', '.join(map(str, different))}"


async def read_standard(node: Node, index: int, subindex: int = 0) -> Value | None:
    """Read an object with the type of the standard; None if the device refuses."""
    try:
        data = await node.read_bytes(index, subindex)
    except SdoRefusedError:
        return None
    variable = find_standard(index, subindex)
    data_type = variable.data_type if variable is not None else DataType.OCTET_STRING
    try:
        return decode(data, data_type)
    except ValueRangeError:
        return None
