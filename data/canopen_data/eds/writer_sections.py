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
from canopen_data.description import BIT_RATES, Commissioning, DeviceDescription, FileInfo, Module
from canopen_data.eds.writer_values import (
    BYTES_KEY,
    NOT_READ_KEY,
    bytes_text,
    limit_text,
    one_line,
    text_beside,
    value_text,
)
from canopen_proto.dictionary.objects import Object, ObjectType, Variable

Entries: TypeAlias = dict[str, str]
"""Key to text, in the order of the file."""
Sections: TypeAlias = dict[str, Entries]
"""By name, in the order of the file."""

COMMISSIONING: Final = "DeviceComissioning"
OBJECT_LISTS: Final = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
_HAS_SUB_OBJECTS: Final = (ObjectType.ARRAY, ObjectType.RECORD, ObjectType.DEFSTRUCT)


def sections_of(description: DeviceDescription) -> Sections:
    """Return every fact that CiA 306 has a place for, section by section."""
    sections: Sections = {"FileInfo": _file_info(description.file_info), "DeviceInfo": _device_info(description)}
    if description.commissioning is not None:
        sections[COMMISSIONING] = _commissioning(description.commissioning)
    if description.dummies is not None:
        sections["DummyUsage"] = {f"Dummy{index:04X}": _flag(usable) for index, usable in description.dummies.items()}
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
    if single is not None and len(each.variables) == 1 and each.object_type not in _HAS_SUB_OBJECTS:
        called = each.name if each.name in single.names else single.name
        return {name: _variable(single, called, each.object_type, each)}
    whole = {"ParameterName": one_line(each.name)}
    _add(whole, "Denotation", one_line(each.denotation))
    whole["ObjectType"] = f"0x{_object_type(each):X}"
    if each.data_type is not None:
        whole["DataType"] = f"0x{each.data_type:04X}"
    if each.variables or each.object_type in _HAS_SUB_OBJECTS:
        whole["SubNumber"] = str(len(each.variables))
    _add(whole, "ObjFlags", _flags(each.object_flags))
    subs = {
        sub_name(each.index, subindex): _variable(variable, variable.name, ObjectType.VAR)
        for subindex, variable in sorted(each.variables.items())
    }
    return {name: whole, **subs}


def _object_type(each: Object) -> ObjectType:
    """Return the object's type, but RECORD for a VAR-like type with sub-objects: only a faulty compact form gives that."""
    if each.object_type in _HAS_SUB_OBJECTS or not each.variables:
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
    entries["PDOMapping"] = _flag(variable.pdo_mappable)
    _add(entries, "ObjFlags", _flags(variable.object_flags | (whole.object_flags if whole else 0)))
    _add(entries, "UploadFile", one_line(variable.upload_file))
    _add(entries, "DownloadFile", one_line(variable.download_file))
    _add(entries, "Unit", one_line(variable.unit))
    _add(entries, "Factor", "" if variable.factor == 1 else repr(variable.factor))
    _add(entries, "Description", one_line(variable.description))
    return entries


def _file_info(info: FileInfo) -> Entries:
    entries: Entries = {}
    _add(entries, "FileName", one_line(info.file_name))
    entries["FileVersion"] = str(info.file_version)
    entries["FileRevision"] = str(info.file_revision)
    texts = {
        "LastEDS": info.last_eds,
        "EDSVersion": info.eds_version,
        "Description": info.description,
        "CreationTime": info.creation_time,
        "CreationDate": info.creation_date,
        "CreatedBy": info.created_by,
        "ModificationTime": info.modification_time,
        "ModificationDate": info.modification_date,
        "ModifiedBy": info.modified_by,
    }
    for key, text in texts.items():
        _add(entries, key, one_line(text))
    return entries


def _device_info(description: DeviceDescription) -> Entries:
    info = description.device_info
    entries: Entries = {}
    _add(entries, "VendorName", one_line(info.vendor_name))
    _add(entries, "VendorNumber", _identity(info.vendor_number))
    _add(entries, "ProductName", one_line(info.product_name))
    _add(entries, "ProductNumber", _identity(info.product_number))
    _add(entries, "RevisionNumber", _identity(info.revision_number))
    _add(entries, "OrderCode", one_line(info.order_code))
    entries |= {f"BaudRate_{rate}": _flag(rate in info.bit_rates) for rate in BIT_RATES}
    entries["SimpleBootUpMaster"] = _flag(info.simple_boot_up_master)
    entries["SimpleBootUpSlave"] = _flag(info.simple_boot_up_slave)
    entries["Granularity"] = str(info.granularity)
    entries["DynamicChannelsSupported"] = str(info.dynamic_channels_supported)
    entries["CompactPDO"] = str(info.compact_pdo)
    entries["GroupMessaging"] = _flag(info.group_messaging)
    _add(entries, "NrOfRXPDO", _count(info.rpdo_count))
    _add(entries, "NrOfTXPDO", _count(info.tpdo_count))
    entries["LSS_Supported"] = _flag(info.lss_supported)
    return entries


def _commissioning(facts: Commissioning) -> Entries:
    entries: Entries = {}
    _add(entries, "NodeID", _count(facts.node_id))
    _add(entries, "NodeName", one_line(facts.node_name))
    _add(entries, "Baudrate", _count(facts.bit_rate))
    _add(entries, "NetNumber", _count(facts.net_number))
    _add(entries, "NetworkName", one_line(facts.network_name))
    entries["CANopenManager"] = _flag(facts.canopen_manager)
    _add(entries, "LSS_SerialNumber", _count(facts.lss_serial_number))
    return entries


def _module(module: Module) -> Sections:
    prefix = f"M{module.number}"
    info: Entries = {}
    _add(info, "ProductName", one_line(module.product_name))
    _add(info, "ProductVersion", _count(module.product_version))
    _add(info, "ProductRevision", _count(module.product_revision))
    _add(info, "OrderCode", one_line(module.order_code))
    sections = {f"{prefix}ModuleInfo": info}
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


def _flag(value: bool) -> str:
    return "1" if value else "0"


def _flags(value: int) -> str:
    return f"0x{value:X}" if value else ""


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def _identity(value: int | None) -> str:
    return "" if value is None else f"0x{value:08X}"


def _index(value: int) -> str:
    return f"0x{value:04X}"
