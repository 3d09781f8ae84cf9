"""Several axes on one node: which object belongs to which axis.

A node has up to MAX_AXES axes (logical devices). The objects of the first one are at 0x6000 to 0x67FF, those of each further one
0x800 higher: the controlword is 0x6040, 0x6840, 0x7040 ... Axes are numbered from 0, so that an index of axis k is that of axis 0
plus k * 0x800. By default its PDOs are 64 * k + 1 and on; only the mapping tells for certain, since makers differ.

NMT, heartbeat, SYNC, EMCY and the SDO channels belong to the node, and so do all objects outside of 0x6000 to 0x9FFF.

Source: CiA 301 v4.2.0, 7.4.1 (object dictionary structure) and 7.5.2.1 (device type; 0x67FF + k * 0x800 is that of axis k), and
IEC 61800-7-201 (CiA 402-2), both from memory. The manuals of TG Drives (TGZ, two axes) and Kollmorgen (AKD2G) have the same
ranges; Turck's of the BL20 has 67FFh and 6FFFh as the types of its first two logical devices.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux, index_of, mapping_entry, mux, split_mux

MAX_AXES: Final = 8
PDOS_PER_AXIS: Final = 64
"""How many PDO numbers each axis has by default: axis k has the PDOs from 64 * k + 1 on."""
DEVICE_TYPE: Final = Mux(0x67FF00)
"""Of the first axis; device type of a logical device."""

_MAPPINGS: Final = (indices.RPDO1_MAPPING_PARAMETER, indices.TPDO1_MAPPING_PARAMETER)
_RECORDS: Final = 512
_SHIFT: Final = 19  # a mux is index << 8, and 0x800 << 8 is 1 << 19
_FIRST: Final = 0x600000 >> _SHIFT


def axis_of(mux: Mux) -> int | None:
    """Return the axis (0..7) that an object belongs to; None for an object of the node, or of its maker."""
    axis = (mux >> _SHIFT) - _FIRST
    return axis if 0 <= axis < MAX_AXES else None


def swapped(mux: Mux, axis: int) -> Mux:
    """Exchange the objects of the first axis for those of another one, and those for the first one's. All others stay.

    It is its own inverse: swapped(0x6041:00, 1) is 0x6841:00, and the other way round.
    """
    place = (mux >> _SHIFT) - _FIRST
    if place == 0:
        return Mux(mux + (axis << _SHIFT))
    if place == axis:
        return Mux(mux - (axis << _SHIFT))
    return mux


def usual_axis_of_pdo(number: int) -> int:
    """Return the axis to which a PDO (1..512) belongs by its number."""
    return (number - 1) // PDOS_PER_AXIS


def axes_of(dictionary: ObjectDictionary) -> tuple[int, ...]:
    """Return the axes (0..7) that a dictionary describes: those with a controlword and a statusword."""
    found = []
    for axis in range(MAX_AXES):
        words = (swapped(objects.CONTROLWORD, axis), swapped(objects.STATUSWORD, axis))
        if all(dictionary.get(*split_mux(each)) is not None for each in words):
            found.append(axis)
    return tuple(found)


def profile_of(dictionary: ObjectDictionary, axis: int) -> int | None:
    """Return the number of the device profile that a dictionary gives an axis: the lower half of 0x67FF + axis * 0x800.

    None if it has no such object, or no value for it.
    """
    variable = dictionary.get(*split_mux(swapped(DEVICE_TYPE, axis)))
    value = None if variable is None else variable.initial_of(0)
    return value & 0xFFFF if isinstance(value, int) and value else None


def dictionary_of_axis(dictionary: ObjectDictionary, axis: int) -> ObjectDictionary:
    """Return a dictionary in which the objects of the first axis and those of another one have changed places (`swapped`).

    The entries of PDO mappings change with them. Names stay at their places: "controlword" is 0x6040 here, too. The descriptions
    of PDOs in CSV files are left out: they are of the first axis.
    """
    if not axis:
        return dictionary
    kept = [_named(moved(each, axis), dictionary) for each in dictionary.objects.values()]
    constants = {variable.mux: dictionary.constants_of(swapped(variable.mux, axis)) for each in kept for variable in _of(each)}
    fillers = dictionary.fillers.values()
    return ObjectDictionary(kept, constants=constants, fillers=fillers, source=dictionary.source)


def with_names_of_axes(dictionary: ObjectDictionary) -> ObjectDictionary:
    """Return a dictionary with names for the objects of further axes: 0x6840 is "controlword_axis_1" if 0x6040 is "controlword".

    They keep their own names as further ones, and get the constants of the first axis's objects if they have none.
    """
    if len(axes_of(dictionary)) < 2:
        return dictionary
    renamed, constants = [], {variable.mux: found for variable in dictionary if (found := dictionary.constants_of(variable))}
    for each in dictionary.objects.values():
        axis = axis_of(mux(each.index))
        if not axis:
            continue
        first = dictionary.objects.get(index_of(swapped(mux(each.index), axis)))
        variables = {}
        for variable in _of(each):
            there = None if first is None else first.variables.get(variable.subindex)
            if there is not None:
                field = there.name.partition(":")
                name = f"{field[0]}_axis_{axis}{field[1]}{field[2]}" if field[1] or len(each.variables) == 1 else there.name
                aliases = tuple(dict.fromkeys(known for known in variable.names if known != name))
                constants.setdefault(variable.mux, dictionary.constants_of(there))
                variable = replace(variable, name=name, aliases=aliases)
            variables[variable.subindex] = variable
        name = each.name if first is None else f"{first.name}_axis_{axis}"
        renamed.append(replace(each, name=name, variables=MappingProxyType(variables)))
    named = dictionary.with_objects(renamed)
    return named.with_names_of(ObjectDictionary([], constants=constants))


def with_axis(dictionary: ObjectDictionary, axis: int) -> ObjectDictionary:
    """Return a dictionary that also has the objects of a further axis: those of the first one, 0x800 * axis higher.

    For a device that is known to have this axis, without a file that says so. A dictionary that has it is returned as it is.
    """
    if axis in axes_of(dictionary):
        return dictionary
    firsts = [each for each in dictionary.objects.values() if axis_of(mux(each.index)) == 0]
    return with_names_of_axes(dictionary.with_objects(moved(each, axis) for each in firsts))


def swapped_entry(entry: int, axis: int) -> int:
    """Return the entry of a PDO mapping with the object of `swapped`."""
    return mapping_entry(swapped(Mux(entry >> 8), axis), entry & 0xFF)


def moved(each: Object, axis: int) -> Object:
    """Return an object, or the record of a PDO mapping, as `dictionary_of_axis` has it."""
    index = index_of(swapped(mux(each.index), axis))
    is_mapping = any(begin <= index < begin + _RECORDS for begin in _MAPPINGS)
    if index == each.index and not is_mapping:
        return each
    variables: dict[int, Variable] = {}
    for subindex, variable in each.variables.items():
        moved = replace(variable, index=index)
        if is_mapping and subindex:
            default, configured = _entry(variable.default, axis), _entry(variable.configured, axis)
            moved = replace(moved, default=default, configured=configured)
        variables[subindex] = moved
    return replace(each, index=index, variables=MappingProxyType(variables))


def _named(each: Object, dictionary: ObjectDictionary) -> Object:
    """Return an object with the names that its place has in a dictionary."""
    there = dictionary.objects.get(each.index)
    if there is None or axis_of(mux(each.index)) is None:
        return each
    variables = {}
    for variable in _of(each):
        at = there.variables.get(variable.subindex)
        variables[variable.subindex] = variable if at is None else replace(variable, name=at.name, aliases=at.aliases)
    return replace(each, name=there.name, variables=MappingProxyType(variables))


def _of(each: Object) -> Collection[Variable]:
    return each.variables.values()


def _entry(value: Value | None, axis: int) -> Value | None:
    return swapped_entry(value, axis) if isinstance(value, int) and value else value
