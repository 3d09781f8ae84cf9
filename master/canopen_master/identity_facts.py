"""What a node says it is: its identity in words, and whether a file is that of such a device."""

from __future__ import annotations

from typing import Any, TypeAlias

from canopen_data.description import DeviceDescription
from canopen_master.device_types import device_type_text
from canopen_master.errors import SdoRefusedError
from canopen_master.file_identity import IDENTITY, differences, identity_in
from canopen_master.node import Node
from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, text_for_people
from canopen_proto.dictionary.standard import find_standard

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
