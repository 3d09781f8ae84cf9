"""Dictionaries of drives that differ from the simulated one: without some objects, with PDOs that cannot be changed."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from canopen_proto.dictionary import Access, ObjectDictionary
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux, index_of, mux, subindex_of
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape

Changes = Mapping[int, Mapping[str, Any]]


STANDARD = drive_dictionary(Shape.STANDARD)
TELLS: Changes = {mux(0x1802, 2): {"default": 1}}
"""TPDO 3, with statusword and position, is sent at each SYNC."""


def changed(changes: Changes, *, without: Collection[int] = (), base: ObjectDictionary = STANDARD) -> ObjectDictionary:
    """A drive's dictionary with other fields of some variables (by mux), and without some objects."""
    described = {index: each for index, each in base.objects.items() if index not in without}
    for key, fields in changes.items():
        index, subindex = index_of(Mux(key)), subindex_of(Mux(key))
        variables = dict(described[index].variables)
        variables[subindex] = replace(variables[subindex], **fields)
        described[index] = replace(described[index], variables=MappingProxyType(variables))
    return ObjectDictionary(described.values(), source="test.eds")


def fixed(first: int, count: int = 4) -> dict[int, dict[str, Any]]:
    """PDOs from a communication record on whose mapping cannot be changed."""
    return {mux(first + 0x200 + number): {"access": Access.RO} for number in range(count)}


def supports(modes: int) -> dict[int, dict[str, Any]]:
    return {objects.SUPPORTED_DRIVE_MODES: {"default": modes}}


def unmappable(*keys: int) -> dict[int, dict[str, Any]]:
    return {key: {"pdo_mappable": False} for key in keys}


NOTHING_MAPPABLE = unmappable(
    *(objects.CONTROLWORD, objects.STATUSWORD, objects.TARGET_POSITION, objects.INTERPOLATION_SET_POINT),
    *(objects.POSITION_ACTUAL_VALUE, objects.MODES_OF_OPERATION_DISPLAY, objects.VELOCITY_ACTUAL_VALUE),
    *(objects.ERROR_CODE, objects.TORQUE_ACTUAL_VALUE, objects.MODES_OF_OPERATION),
)


def without_pdos(*, except_rpdos: Iterable[int] = (), except_tpdos: Iterable[int] = ()) -> set[int]:
    kept = {0x1400 + number - 1 for number in except_rpdos} | {0x1800 + number - 1 for number in except_tpdos}
    first = {0x1400 + number for number in range(4)} | {0x1800 + number for number in range(4)}
    return {index + offset for index in first - kept for offset in (0, 0x200)}


def empty_pdos() -> dict[int, dict[str, Any]]:
    return {mux(first + number): {"default": 0} for first in (0x1600, 0x1A00) for number in range(4)}
