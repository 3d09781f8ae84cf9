"""Read the facts about the device as a whole from an XDD: the file, identity, bit rates, features, dummies, commissioning.

Each function takes the bodies of the profiles (ISO 15745-1 ProfileBody: one of the device, one of its communication) and returns
one part of a `DeviceDescription`. A fact that cannot be read is a warning and is left out: no object depends on it.

CiA 311 has no revision number of the device, no compact PDO and no serial number for LSS: these keep their defaults.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from canopen_data.description import BIT_RATES, Commissioning, DeviceInfo, DynamicChannel, FileInfo
from canopen_data.eds.ini import quoted
from canopen_data.xdd.elements import Element, XddFindings
from canopen_data.xdd.texts import flag_of, hexadecimal_of, number_of
from canopen_proto.frame import MAX_NODE_ID

_VERSION: Final = re.compile(r"\s*([0-9]{1,9})(?:\.([0-9]{1,9}))?")
_DUMMY: Final = re.compile(r"\s*dummy\s*([0-9a-f]{4})\s*=\s*([01])\s*", re.IGNORECASE)
_BIT_RATE: Final = re.compile(r"\s*([0-9]{1,9})\s*(k?)[a-z/]*\s*", re.IGNORECASE)
_DIRECTIONS: Final = {"readonly": "ro", "writeonly": "wo", "readwriteoutput": "rww", "readwriteinput": "rwr", "readwrite": "rw"}
MAX_CHANNELS: Final = 1024
"""Segments of dynamic channels; CiA 302-4 has 32 kinds of them."""

Bodies = Iterable[Element]


def find(bodies: Bodies, *path: str) -> Element | None:
    """Return the first element of that path in any of the bodies."""
    return next(find_all(bodies, *path), None)


def find_all(bodies: Bodies, *path: str) -> Iterator[Element]:
    """Return all elements of that path in the bodies."""
    found: Iterable[Element] = bodies
    for name in path:
        found = [child for each in found for child in each.all(name)]
    return iter(found)


def file_info(bodies: Bodies, findings: XddFindings) -> FileInfo:
    """Return the file's own facts, from the attributes of the communication profile, else of the device profile. Dates stay as
    written."""
    bodies = list(bodies)
    for body in reversed(bodies):
        if body.get("fileName") or body.get("fileVersion"):
            break
    else:
        return FileInfo(description=_product_text(bodies))
    text = body.get("fileVersion")
    version = _VERSION.match(text)
    if text and version is None:
        findings.warning("number", f"the file's version {quoted(text)!r} is not a number", body, "fileVersion")
    by_name = {name: next((each.get(name) for each in reversed(bodies) if each.get(name)), "") for name in _OF_FILE}
    return FileInfo(
        file_name=body.get("fileName"),
        file_version=int(version[1]) if version is not None else 0,
        file_revision=int(version[2] or 0) if version is not None else 0,
        description=_product_text(bodies),
        creation_time=by_name["fileCreationTime"],
        creation_date=by_name["fileCreationDate"],
        created_by=by_name["fileCreator"],
        modification_time=by_name["fileModificationTime"],
        modification_date=by_name["fileModificationDate"],
        modified_by=by_name["fileModifiedBy"],
    )


_OF_FILE: Final = (
    "fileCreator",
    "fileCreationDate",
    "fileCreationTime",
    "fileModifiedBy",
    "fileModificationDate",
    "fileModificationTime",
)


def _product_text(bodies: Bodies) -> str:
    found = find(bodies, "DeviceIdentity", "productText", "description")
    return "" if found is None else found.text


def device_info(bodies: Bodies, findings: XddFindings) -> DeviceInfo:
    """Return the type of device: DeviceIdentity, the bit rates, and the features of network management."""
    bodies = list(bodies)

    def text(name: str) -> str:
        found = find(bodies, "DeviceIdentity", name)
        return "" if found is None else found.text

    def number(name: str) -> int | None:
        found = find(bodies, "DeviceIdentity", name)
        return None if found is None or not found.text else number_of(found.text, findings, found, most=0xFFFFFFFF)

    general = find(bodies, "NetworkManagement", "CANopenGeneralFeatures")
    master = find(bodies, "NetworkManagement", "CANopenMasterFeatures")

    def count(name: str, most: int) -> int | None:
        if general is None or not general.get(name):
            return None
        return number_of(general.get(name), findings, general, name, most=most)

    return DeviceInfo(
        vendor_name=text("vendorName"),
        vendor_number=number("vendorID"),
        product_name=text("productName"),
        product_number=number("productID"),
        order_code=text("orderNumber"),
        bit_rates=_bit_rates(bodies, findings),
        simple_boot_up_master=flag_of(master, "bootUpMaster", findings),
        simple_boot_up_slave=flag_of(general, "bootUpSlave", findings),
        granularity=count("granularity", 64) or 0,
        dynamic_channels_supported=count("dynamicChannels", 0xFF) or 0,
        group_messaging=flag_of(general, "groupMessaging", findings),
        rpdo_count=count("nrOfRxPDO", 512),
        tpdo_count=count("nrOfTxPDO", 512),
        lss_supported=flag_of(general, "layerSettingServiceSlave", findings),
    )


def _bit_rates(bodies: Bodies, findings: XddFindings) -> frozenset[int]:
    rates = set()
    for element in find_all(bodies, "TransportLayers", "PhysicalLayer", "baudRate", "supportedBaudRate"):
        text = element.get("value")
        rate = _bit_rate(text)
        if rate in BIT_RATES:
            rates.add(rate)
        elif not text.lower().startswith("auto"):
            findings.warning("bit-rate", f"{quoted(text)!r} is none of the bit rates {_RATES} kbit/s", element, "value")
    return frozenset(rates)


_RATES: Final = ", ".join(str(each) for each in BIT_RATES)


def _bit_rate(text: str) -> int | None:
    """Return kbit/s of "250 Kbps". A bare number is in kbit/s, or in bit/s if it is 10 000 or more."""
    match = _BIT_RATE.fullmatch(text)
    if match is None:
        return None
    rate = int(match[1])
    return rate // 1000 if not match[2] and rate >= 10_000 else rate


def dummies(bodies: Bodies, findings: XddFindings) -> Mapping[int, bool] | None:
    """Return which data types may be dummy entries of a mapping; None if the file does not say."""
    usage = find(bodies, "ApplicationLayers", "dummyUsage")
    if usage is None:
        return None
    known = {}
    for element in usage.all("dummy"):
        match = _DUMMY.fullmatch(element.get("entry"))
        if match is None:
            message = f"{quoted(element.get('entry'))!r} is not of the form Dummy0005=1"
            findings.warning("dummy", message, element, "entry")
        else:
            known[int(match[1], 16)] = match[2] == "1"
    return known


def dynamic_channels(bodies: Bodies, findings: XddFindings) -> tuple[DynamicChannel, ...]:
    """Return the segments of dynamic channels. Those that cannot be read are left out."""
    channels: list[DynamicChannel] = []
    for element in find_all(bodies, "ApplicationLayers", "dynamicChannels", "dynamicChannel"):
        if len(channels) == MAX_CHANNELS:
            findings.warning("too-many", f"there are more than {MAX_CHANNELS} dynamic channels", element)
            break
        access = element.get("accessType").lower()
        numbers = [
            hexadecimal_of(element, name, findings, most=most)
            for name, most in (("dataType", 0xFFFF), ("startIndex", 0xFFFF), ("endIndex", 0xFFFF))
        ]
        offset = hexadecimal_of(element, "addressOffset", findings, most=0xFFFFFFFF) if element.get("addressOffset") else 0
        data_type, first, last = numbers
        if data_type is not None and first is not None and last is not None and offset is not None:
            channels.append(DynamicChannel(data_type, _DIRECTIONS.get(access, access), first, last, offset))
    return tuple(channels)


def commissioning(bodies: Bodies, findings: XddFindings) -> Commissioning | None:
    """Return an XDC's facts about one device in its network; None if there are none."""
    element = find(bodies, "NetworkManagement", "deviceCommissioning")
    if element is None:
        return None
    node_id = None
    if element.get("nodeID"):
        node_id = number_of(element.get("nodeID"), findings, element, "nodeID", most=0xFF)
        if node_id is not None and not 1 <= node_id <= MAX_NODE_ID:
            findings.warning("node-id", f"node-ID {node_id} is outside 1..{MAX_NODE_ID}", element, "nodeID")
            node_id = None
    bit_rate = None
    text = element.get("actualBaudRate")
    if text and not text.lower().startswith("auto"):
        bit_rate = _bit_rate(text)
        if bit_rate not in BIT_RATES:
            findings.warning("bit-rate", f"{quoted(text)!r} is none of the bit rates {_RATES} kbit/s", element, "actualBaudRate")
            bit_rate = None
    net_number = None
    if element.get("networkNumber"):
        net_number = number_of(element.get("networkNumber"), findings, element, "networkNumber", most=0xFFFFFFFF)
    return Commissioning(
        node_id=node_id,
        node_name=element.get("nodeName"),
        bit_rate=bit_rate,
        net_number=net_number,
        network_name=element.get("networkName"),
        canopen_manager=flag_of(element, "CANopenManager", findings),
    )
