"""Make a description around a dictionary that has none: one from CSV files, of a simulated device, or made by hand.

The objects give the three lists, the number of PDOs and the identity. The caller adds the rest (vendor, bit rates, boot-up);
nothing is made up.

Source: CiA 306-1 v1.4.0, 4.4 to 4.6.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from canopen_data.description import DeviceDescription, DeviceInfo, FileInfo, FileKind
from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import ObjectDictionary

EDS_VERSION: Final = "4.0"
"""EDSVersion of the files that are written, as CiA 306 names it."""
MANDATORY: Final = (indices.DEVICE_TYPE, indices.ERROR_REGISTER, indices.IDENTITY_OBJECT)
"""The objects that every device has. CiA 301 v4.2.0, 7.5.1."""
_PDO_GRANULARITY: Final = 8
"""Bits: mapping entries are whole bytes. CiA 306-1: 0 means no mapping at all, 1 single bits."""


def describe(
    dictionary: ObjectDictionary, *, device_info: DeviceInfo | None = None, file_info: FileInfo | None = None
) -> DeviceDescription:
    """Return the description of a device with these objects; its kind is CSV, "no file of the standard".

    device_info: taken as given; identity, number of PDOs and granularity that it lacks come from the dictionary.
    """
    info = device_info or DeviceInfo()
    places = sorted(dictionary.objects)
    names = (info.vendor_number, info.product_number, info.revision_number)
    identity = [_identity(dictionary, subindex) if given is None else given for subindex, given in enumerate(names, start=1)]
    rpdos = sum(index in indices.RPDO_COMMUNICATION for index in places)
    tpdos = sum(index in indices.TPDO_COMMUNICATION for index in places)
    info = replace(
        info,
        vendor_number=identity[0],
        product_number=identity[1],
        revision_number=identity[2],
        granularity=info.granularity or (_PDO_GRANULARITY if rpdos or tpdos else 0),
        rpdo_count=rpdos if info.rpdo_count is None else info.rpdo_count,
        tpdo_count=tpdos if info.tpdo_count is None else info.tpdo_count,
    )
    mandatory, optional, manufacturer = lists_of(places)
    return DeviceDescription(
        dictionary,
        FileKind.CSV,
        source=dictionary.source,
        file_info=file_info or FileInfo(file_version=1, eds_version=EDS_VERSION),
        device_info=info,
        mandatory=mandatory,
        optional=optional,
        manufacturer=manufacturer,
    )


def lists_of(places: Iterable[int]) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Split these indices into the three lists of a file: mandatory, optional, manufacturer's. The order stays."""
    lists: tuple[list[int], list[int], list[int]] = ([], [], [])
    for index in places:
        lists[0 if index in MANDATORY else 2 if index in indices.MANUFACTURER_AREA else 1].append(index)
    return tuple(lists[0]), tuple(lists[1]), tuple(lists[2])


def identified(description: DeviceDescription) -> ObjectDictionary:
    """Return the dictionary with the identity (0x1018:01 to 03) from the file's device information, if the object itself has
    none. Many files leave it out there, and a device made of them would have no identity."""
    dictionary, info = description.dictionary, description.device_info
    identity = dictionary.objects.get(indices.IDENTITY_OBJECT)
    if identity is None:
        return dictionary
    variables = dict(identity.variables)
    for subindex, number in enumerate((info.vendor_number, info.product_number, info.revision_number), start=1):
        variable = variables.get(subindex)
        if variable is not None and number and not variable.initial_of(0):
            variables[subindex] = replace(variable, default=number, configured=None)
    return dictionary.with_objects([replace(identity, variables=MappingProxyType(variables))])


def _identity(dictionary: ObjectDictionary, subindex: int) -> int | None:
    """Return a number of the identity object (0x1018), where the dictionary says it."""
    variable = dictionary.get(indices.IDENTITY_OBJECT, subindex)
    value: Value | None = None if variable is None else variable.default
    return value if isinstance(value, int) else None
