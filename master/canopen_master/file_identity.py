"""Whether a node is the device that a file describes: one rule for `canopen info -e` and `canopen net init --files`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from canopen_data.description import DeviceDescription, FileKind
from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Variable

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
