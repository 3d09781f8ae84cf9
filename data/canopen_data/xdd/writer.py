"""Write an XDD or XDC from a description (CiA 311).

Each object says all by itself, in the terms of CiA 306. Unit, factor and description, which an object of CiA 311 cannot have,
stand in a parameter that it refers to. The file is always written whole: comments and the order of an old XDD are not kept.

CiA 311 has no place for the revision number, compact PDOs, modules, the LSS serial number and the files of a DOMAIN: they are
left out.

Source: CiA 311 v1.1 (from memory), and the forms that reader.py reads.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from canopen_data.configured import without_configured
from canopen_data.description import Commissioning, DeviceDescription, FileInfo, FileKind
from canopen_data.eds.numbers import read_value
from canopen_data.eds.writer_values import check_kept, limit_text, one_line, value_text
from canopen_data.xdd.parameters import ELEMENTARY
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary.model import WITH_FIELDS
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable
from canopen_proto.machine import LocalProtocolError

_KINDS: Final = (FileKind.XDD, FileKind.XDC)
_ELEMENTARY: Final = {data_type: name for name, data_type in reversed(ELEMENTARY.items())}
_OTHER_TYPE: Final = "BITSTRING"
"""Of a parameter whose type IEC 61131-3 does not have. The object's own type counts."""
_ACCESS: Final = {
    Access.CONST: "const",
    Access.RO: "read",
    Access.WO: "write",
    Access.RW: "readWrite",
    Access.RWR: "readWriteInput",
    Access.RWW: "readWriteOutput",
}
_DIRECTIONS: Final = {"ro": "readOnly", "wo": "writeOnly", "rww": "readWriteOutput", "rwr": "readWriteInput", "rw": "readWrite"}
_MAPPING: Final = {Access.RW: "optional", Access.WO: "RPDO", Access.RWW: "RPDO"}
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_EDS_DATE: Final = re.compile(r"(\d\d)-(\d\d)-(\d{4})")
_EDS_TIME: Final = re.compile(r"(\d\d):(\d\d)(AM|PM)")


def write_xdd(description: DeviceDescription, kind: FileKind | None = None, *, file_info: FileInfo | None = None) -> str:
    """Return the text of an XDD or an XDC, to be encoded in UTF-8.

    kind: XDD or XDC; None: XDC for a description with a commissioning, else XDD. An XDD has no configured values. file_info: of
    the new file; None: that of the description. Raises LocalProtocolError for another kind, ValueRangeError for a value that the
    file cannot give back: one that the object's type cannot hold; in an XDC, NaN, no octets, and a text that is empty, has
    characters that XML does not have, or begins or ends with a blank. A DCF can hold these.
    """
    if kind is None:
        kind = FileKind.XDD if description.commissioning is None else FileKind.XDC
    if kind not in _KINDS:
        raise LocalProtocolError(f"an XDD or an XDC can be written here, no {kind}")
    if kind == FileKind.XDD and description.commissioning is not None:
        description = without_configured(description)
    for variable in description.dictionary:
        check_kept(variable)
        _check_setting_kept(variable)
    info = description.file_info if file_info is None else file_info
    root = Element("ISO15745ProfileContainer", {"xmlns": _NAMESPACE, "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance"})
    _device_profile(_body(root, "Device", "ProfileBody_Device_CANopen", info, description), description, info)
    network = _body(root, "CommunicationNetwork", "ProfileBody_CommunicationNetwork_CANopen", info, description)
    _network_profile(network, description)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _check_setting_kept(variable: Variable) -> None:
    value = variable.configured
    if value is None:
        return
    text = _clean(_value(variable, value, variable.configured_adds_node_id))
    if read_value(text, variable.data_type)[0] != value:
        raise ValueRangeError(f"{variable.label}: configured {value!r} cannot be kept in an XDC; a DCF can hold it")


_NAMESPACE: Final = "http://www.canopen.org/xml/1.1"


def _body(root: Element, class_id: str, body_type: str, info: FileInfo, description: DeviceDescription) -> Element:
    """Add a profile, and return its body."""
    profile = SubElement(root, "ISO15745Profile")
    header = SubElement(profile, "ProfileHeader")
    _text(header, "ProfileIdentification", description.device_info.product_name)
    _text(header, "ProfileRevision", "1")
    _text(header, "ProfileName", "")
    _text(header, "ProfileSource", "")
    _text(header, "ProfileClassID", class_id)
    reference = SubElement(header, "ISO15745Reference")
    _text(reference, "ISO15745Part", "1")
    _text(reference, "ISO15745Edition", "1")
    _text(reference, "ProfileTechnology", "CANopen")
    attributes = {
        "xsi:type": body_type,
        "fileName": info.file_name,
        "fileCreator": info.created_by,
        "fileCreationDate": _date(info.creation_date),
        "fileCreationTime": _time(info.creation_time),
        "fileModifiedBy": info.modified_by,
        "fileModificationDate": _date(info.modification_date),
        "fileModificationTime": _time(info.modification_time),
        "fileVersion": f"{info.file_version}.{info.file_revision}",
    }
    return _element(profile, "ProfileBody", **attributes)


def _device_profile(body: Element, description: DeviceDescription, info: FileInfo) -> None:
    device = description.device_info
    identity = SubElement(body, "DeviceIdentity")
    _text(identity, "vendorName", device.vendor_name)
    if device.vendor_number is not None:
        _text(identity, "vendorID", f"0x{device.vendor_number:08X}")
    _text(identity, "productName", device.product_name)
    if device.product_number is not None:
        _text(identity, "productID", f"0x{device.product_number:08X}")
    if info.description:
        _text(SubElement(identity, "productText"), "description", info.description, lang="en")
    _text(identity, "orderNumber", device.order_code)
    described = [variable for variable in description.dictionary if _needs_parameter(variable)]
    if described:
        parameters = SubElement(SubElement(body, "ApplicationProcess"), "parameterList")
        for variable in described:
            _parameter(parameters, variable)


def _needs_parameter(variable: Variable) -> bool:
    return bool(variable.unit or variable.description or variable.factor != 1)


def _unique_id(variable: Variable) -> str:
    return f"P_{variable.index:04X}_{variable.subindex:02X}"


def _parameter(parent: Element, variable: Variable) -> None:
    factor = "" if variable.factor == 1 else repr(variable.factor)
    element = _element(parent, "parameter", uniqueID=_unique_id(variable), access=_ACCESS[variable.access], multiplier=factor)
    _text(element, "label", variable.name, lang="en")
    if variable.description:
        _text(element, "description", variable.description, lang="en")
    SubElement(element, _ELEMENTARY.get(variable.data_type, _OTHER_TYPE))
    if variable.unit:
        _text(SubElement(element, "unit"), "label", variable.unit, lang="en")


def _network_profile(body: Element, description: DeviceDescription) -> None:
    layers = SubElement(body, "ApplicationLayers")
    objects = SubElement(layers, "CANopenObjectList")
    for each in description.dictionary.objects.values():
        _object(objects, each)
    if description.dummies is not None:
        dummies = SubElement(layers, "dummyUsage")
        for index, usable in description.dummies.items():
            _element(dummies, "dummy", entry=f"Dummy{index:04X}={int(usable)}")
    if description.dynamic_channels:
        channels = SubElement(layers, "dynamicChannels")
        for channel in description.dynamic_channels:
            _element(
                channels,
                "dynamicChannel",
                dataType=f"{channel.data_type:04X}",
                accessType=_DIRECTIONS.get(channel.direction, channel.direction),
                startIndex=f"{channel.first:04X}",
                endIndex=f"{channel.last:04X}",
                addressOffset=f"{channel.pp_offset:X}",
            )
    device = description.device_info
    rates = SubElement(SubElement(SubElement(body, "TransportLayers"), "PhysicalLayer"), "baudRate")
    for rate in sorted(device.bit_rates):
        _element(rates, "supportedBaudRate", value=f"{rate} Kbps")
    management = SubElement(body, "NetworkManagement")
    _element(
        management,
        "CANopenGeneralFeatures",
        granularity=str(device.granularity),
        nrOfRxPDO=_count(device.rpdo_count),
        nrOfTxPDO=_count(device.tpdo_count),
        bootUpSlave=_flag(device.simple_boot_up_slave),
        dynamicChannels=str(device.dynamic_channels_supported),
        groupMessaging=_flag(device.group_messaging),
        layerSettingServiceSlave=_flag(device.lss_supported),
    )
    _element(management, "CANopenMasterFeatures", bootUpMaster=_flag(device.simple_boot_up_master))
    if description.commissioning is not None:
        _commissioning(management, description.commissioning)


def _commissioning(parent: Element, facts: Commissioning) -> None:
    _element(
        parent,
        "deviceCommissioning",
        nodeID=_count(facts.node_id),
        nodeName=facts.node_name,
        actualBaudRate="" if facts.bit_rate is None else f"{facts.bit_rate} Kbps",
        networkNumber=_count(facts.net_number),
        networkName=facts.network_name,
        CANopenManager=_flag(facts.canopen_manager),
    )


def _object(parent: Element, each: Object) -> None:
    attributes = {"index": f"{each.index:04X}", "name": each.name, "objectType": str(int(each.object_type))}
    flags = f"{each.object_flags:04X}" if each.object_flags else ""
    single = each.variables.get(0)
    if single is not None and len(each.variables) == 1 and each.object_type not in WITH_FIELDS:
        flags = f"{single.object_flags | each.object_flags:04X}" if single.object_flags | each.object_flags else ""
        _element(parent, "CANopenObject", **attributes, **dict(_of_variable(single)), objFlags=flags)
        return
    attributes["dataType"] = "" if each.data_type is None else f"{each.data_type:04X}"
    attributes["subNumber"] = str(len(each.variables))
    element = _element(parent, "CANopenObject", **attributes, denotation=each.denotation, objFlags=flags)
    for subindex, variable in sorted(each.variables.items()):
        own = {"subIndex": f"{subindex:02X}", "name": variable.name, "objectType": str(int(ObjectType.VAR))}
        flags = f"{variable.object_flags:04X}" if variable.object_flags else ""
        _element(element, "CANopenSubObject", **own, **dict(_of_variable(variable)), objFlags=flags)


def _of_variable(variable: Variable) -> Iterator[tuple[str, str]]:
    """Yield the attributes of a variable that objects and sub-objects have in common."""
    access = variable.access
    is_told_by_mapping = variable.pdo_mappable and access in (Access.RWR, Access.RWW)
    yield "denotation", variable.denotation
    yield "dataType", f"{variable.data_type:04X}"
    yield "accessType", "rw" if is_told_by_mapping else access.value
    yield "defaultValue", _value(variable, variable.default, variable.adds_node_id)
    yield "actualValue", _value(variable, variable.configured, variable.configured_adds_node_id)
    yield "lowLimit", limit_text(variable, variable.low_limit)
    yield "highLimit", limit_text(variable, variable.high_limit)
    yield "PDOmapping", _MAPPING.get(access, "TPDO") if variable.pdo_mappable else "no"
    yield "uniqueIDRef", _unique_id(variable) if _needs_parameter(variable) else ""


def _value(variable: Variable, value: Value | None, adds_node_id: bool) -> str:
    return "" if value is None else value_text(variable, value, adds_node_id)


def _element(parent: Element, tag: str, /, **attributes: str) -> Element:
    """Add an element with those attributes that are not empty."""
    return SubElement(parent, tag, {key: _clean(text) for key, text in attributes.items() if text})


def _text(parent: Element, tag: str, text: str, **attributes: str) -> None:
    SubElement(parent, tag, attributes).text = _clean(text)


def _clean(text: str) -> str:
    """Return a text in one line, without characters that XML cannot have."""
    return _NO_XML.sub("?", one_line(text))


def _date(text: str) -> str:
    """Return a date of an EDS as XML has it; another text stays."""
    match = _EDS_DATE.fullmatch(text)
    return text if match is None else f"{match[3]}-{match[1]}-{match[2]}"


def _time(text: str) -> str:
    match = _EDS_TIME.fullmatch(text)
    return text if match is None else f"{int(match[1]) % 12 + 12 * (match[3] == 'PM'):02}:{match[2]}:00"


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _count(value: int | None) -> str:
    return "" if value is None else str(value)
