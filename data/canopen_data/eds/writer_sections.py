"""Turn a description into the sections, keys and texts of an EDS or DCF, for writing and for comparing descriptions.

`sections_of` gives every fact of a description that CiA 306 has a place for, in the standard's order of sections and in its
spelling ("DeviceComissioning" has one m there, and some tools read nothing else). Each fact has exactly one text, whatever form
its file had. So two descriptions say the same if their sections are equal, and a writer that keeps a file's form
(writer_document.py) finds the changes by comparing them.

Numbers have the form of the standard's examples: 0x and all digits for indices, types, identity, COB-IDs and mapping entries;
decimal for the rest. A value relative to the node-ID is "$NODEID+0x180". Sub-objects are written out, never compact.

A fact that the description does not have gets no key. Lists of objects also name each object of the dictionary that they lack,
since other tools do not see an object that no list names.

Unit, Factor and Description are not keys of the standard, but other tools know them, too; they are written if a variable has
them. _ParameterBytes and _NotRead are ours: see writer_values.py, and `Variable.not_read`. Left out, since CiA 306 has no place
for them: aliases, constants, PDO descriptions.

Source: CiA 306-1 v1.4.0 (and the public CiA 306 v1.3.0): 4.4 to 4.8, 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, TypeAlias

from canopen_data.describing import lists_of
from canopen_data.description import BIT_RATES, DeviceDescription, DeviceInfo, Module
from canopen_data.eds.keys import COMMISSIONING, FEATURES, FILE_INFO, MODULE_INFO, PRODUCT, flag_text, written
from canopen_data.eds.writer_values import (
    BYTES_KEY,
    NOT_READ_KEY,
    bytes_text,
    limit_text,
    one_line,
    text_beside,
    value_text,
)
from canopen_proto.dictionary.model import WITH_FIELDS
from canopen_proto.dictionary.objects import Object, ObjectType, Variable

Entries: TypeAlias = dict[str, str]
"""Key to text, in the order of the file."""
Sections: TypeAlias = dict[str, Entries]
"""By name, in the order of the file."""

OBJECT_LISTS: Final = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")


def sections_of(description: DeviceDescription) -> Sections:
    """Return every fact that CiA 306 has a place for, section by section."""
    sections: Sections = {
        "FileInfo": written(FILE_INFO, description.file_info),
        "DeviceInfo": _device_info(description.device_info),
    }
    if description.commissioning is not None:
        sections["DeviceComissioning"] = written(COMMISSIONING, description.commissioning)
    if description.dummies is not None:
        sections["DummyUsage"] = {f"Dummy{index:04X}": flag_text(usable) for index, usable in description.dummies.items()}
    sections["Comments"] = _comments(description.comments)
    for name, found in zip(OBJECT_LISTS, _lists(description), strict=True):
        sections[name] = _counted("SupportedObjects", map(_index, found))
        for index in found:
            each = description.dictionary.objects.get(index)
            if each is not None:
                sections |= object_sections(each)
    if description.modules:
        sections["SupportedModules"] = {"NrOfEntries": str(max(module.number for module in description.modules))}
    for module in description.modules:
        sections |= _module(module)
    if description.connected_modules:
        sections["ConnectedModules"] = _counted("NrOfEntries", map(str, description.connected_modules))
    if description.dynamic_channels:
        sections["DynamicChannels"] = _dynamic_channels(description)
    return sections


def object_sections(each: Object) -> Sections:
    """Return the sections of one object: its own, and one for each sub-object if it has them."""
    name = f"{each.index:04X}"
    single = each.variables.get(0)
    if single is not None and len(each.variables) == 1 and each.object_type not in WITH_FIELDS:
        called = each.name if each.name in single.names else single.name
        return {name: _variable(single, called, each.object_type, each)}
    whole = {"ParameterName": one_line(each.name)}
    _add(whole, "Denotation", one_line(each.denotation))
    whole["ObjectType"] = f"0x{_object_type(each):X}"
    if each.data_type is not None:
        whole["DataType"] = f"0x{each.data_type:04X}"
    if each.variables or each.object_type in WITH_FIELDS:
        whole["SubNumber"] = str(len(each.variables))
    _add(whole, "ObjFlags", _flags(each.object_flags))
    subs = {
        sub_name(each.index, subindex): _variable(variable, variable.name, ObjectType.VAR)
        for subindex, variable in sorted(each.variables.items())
    }
    return {name: whole, **subs}


def _object_type(each: Object) -> ObjectType:
    """Return the object's type, but RECORD for a VAR-like type with sub-objects: only a faulty compact form gives that."""
    if each.object_type in WITH_FIELDS or not each.variables:
        return each.object_type
    if each.object_type is ObjectType.VAR and each.variables.keys() <= {0, 0xFF}:
        return ObjectType.VAR
    return ObjectType.RECORD


def sub_name(index: int, subindex: int) -> str:
    """Return the name of a sub-object's section: "1018sub1", "1A00subF"."""
    return f"{index:04X}sub{subindex:X}"


def _variable(variable: Variable, name: str, object_type: ObjectType, whole: Object | None = None) -> Entries:
    """Return the keys in the standard's order. whole: the object, if the variable is all of it."""
    entries = {"ParameterName": one_line(name)}
    _add(entries, "Denotation", one_line(variable.denotation or (whole.denotation if whole else "")))
    entries["ObjectType"] = f"0x{object_type:X}"
    entries["DataType"] = f"0x{variable.data_type:04X}"
    _add(entries, "LowLimit", limit_text(variable, variable.low_limit))
    _add(entries, "HighLimit", limit_text(variable, variable.high_limit))
    entries["AccessType"] = variable.access.value
    if variable.default is not None:
        _add(entries, "DefaultValue", value_text(variable, variable.default, variable.adds_node_id))
    if variable.configured is not None:
        octets = bytes_text(variable, variable.configured)
        if octets is None:
            _add(entries, "ParameterValue", value_text(variable, variable.configured, variable.configured_adds_node_id))
        else:
            _add(entries, "ParameterValue", text_beside(variable.configured, variable.data_type))
            entries[BYTES_KEY] = octets
    _add(entries, NOT_READ_KEY, one_line(variable.not_read))
    entries["PDOMapping"] = flag_text(variable.pdo_mappable)
    _add(entries, "ObjFlags", _flags(variable.object_flags | (whole.object_flags if whole else 0)))
    _add(entries, "UploadFile", one_line(variable.upload_file))
    _add(entries, "DownloadFile", one_line(variable.download_file))
    _add(entries, "Unit", one_line(variable.unit))
    _add(entries, "Factor", "" if variable.factor == 1 else repr(variable.factor))
    _add(entries, "Description", one_line(variable.description))
    return entries


def _device_info(info: DeviceInfo) -> Entries:
    bit_rates = {f"BaudRate_{rate}": flag_text(rate in info.bit_rates) for rate in BIT_RATES}
    return written(PRODUCT, info) | bit_rates | written(FEATURES, info)


def _module(module: Module) -> Sections:
    prefix = f"M{module.number}"
    sections = {f"{prefix}ModuleInfo": written(MODULE_INFO, module)}
    if module.comments:
        sections[f"{prefix}Comments"] = _comments(module.comments)
    if module.fixed_objects:
        sections[f"{prefix}FixedObjects"] = _counted("NrOfEntries", map(_index, module.fixed_objects))
    if module.sub_extensions:
        sections[f"{prefix}SubExtends"] = _counted("NrOfEntries", map(_index, module.sub_extensions))
        for index, keys in module.sub_extensions.items():
            sections[f"{prefix}SubExt{index:04X}"] = {key: one_line(text) for key, text in keys.items()}
    return sections


def _dynamic_channels(description: DeviceDescription) -> Entries:
    entries = {"NrOfSeg": str(len(description.dynamic_channels))}
    for number, channel in enumerate(description.dynamic_channels, start=1):
        entries[f"Type{number}"] = f"0x{channel.data_type:04X}"
        entries[f"Dir{number}"] = one_line(channel.direction)
        entries[f"Range{number}"] = f"0x{channel.first:04X}-0x{channel.last:04X}"
        entries[f"PPOffset{number}"] = str(channel.pp_offset)
    return entries


def _lists(description: DeviceDescription) -> Iterator[tuple[int, ...]]:
    """Return the three lists, with the objects that no list names added."""
    lists = description.mandatory, description.optional, description.manufacturer
    named = {index for each in lists for index in each}
    lost = lists_of(sorted(index for index in description.dictionary.objects if index not in named))
    return (listed + more for listed, more in zip(lists, lost, strict=True))


def _comments(lines: tuple[str, ...]) -> Entries:
    return {"Lines": str(len(lines))} | {f"Line{number}": one_line(line) for number, line in enumerate(lines, start=1)}


def _counted(key: str, texts: Iterable[str]) -> Entries:
    """Return a list: the count, then each entry by its number."""
    numbered = {str(number): text for number, text in enumerate(texts, start=1)}
    return {key: str(len(numbered)), **numbered}


def _add(entries: Entries, key: str, text: str) -> None:
    if text:
        entries[key] = text


def _flags(value: int) -> str:
    return f"0x{value:X}" if value else ""


def _index(value: int) -> str:
    return f"0x{value:04X}"
