"""Every object of the makers' EDS and DCF files, as we read it and as `canopen` reads it; each difference with its reason.

Names, types, access, defaults, configured values, limits, PDO flags, dependence on the node-ID, units, factors and descriptions
are compared. Two files the peer cannot read at all; it gets them repaired. Our own samples, and a file of what such files have
been found to hold, are compared everywhere.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from canopen.objectdictionary import ODArray, ODVariable, import_od

from canopen_data.description import DeviceDescription
from canopen_data.descriptions import read_file
from canopen_data.eds import read_eds
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Variable
from tests.vendor_files import INI_NAMES, load, needs_vendor_files


class Difference(NamedTuple):
    """What differs in a file, in one field, and why. places: as "6041:00", or "*" for any."""

    name: str
    field: str
    places: str
    ours: object
    theirs: object
    reason: str


ANY = object()
DEFAULT_OF_STRING = "DefaultValue= with nothing behind it is no default (CiA 306-1, 4.6)"
TWOS_COMPLEMENT = "a signed default as its two's complement; the peer takes that for limits only"
HEXADECIMAL = "0000 0000h is a hexadecimal number, if not one of CiA 306"
COMPACT_COUNT = "subindex 0 of an array in compact form: named, read-only and holding the count by CiA 306-1, 4.6"

DIFFERENCES = [
    Difference("canopen-sample.eds", "data_type", "2020:00", 0x0A, 0x0F, "no section describes the type 0x40: bytes for both"),
    Difference("canopen-sample.eds", "low_limit", "3002:00", 4.5, None, "the peer loses limits of REAL32"),
    Difference("canopen-sample.eds", "name", "3004:00", "NrOfObjects", "Number of entries", COMPACT_COUNT),
    Difference("canopen-sample.eds", "access", "3004:00", "ro", "rw", COMPACT_COUNT),
    Difference("canopen-sample.eds", "default", "3004:00", 3, None, COMPACT_COUNT),
    Difference("canopen-sample.eds", "name", "3006:00", "NrOfObjects", "Number of entries", COMPACT_COUNT),
    Difference("canopen-sample.eds", "access", "3006:00", "ro", "rw", COMPACT_COUNT),
    Difference("canopen-sample.eds", "default", "3006:00", 24, None, COMPACT_COUNT),
    Difference(
        "canopen-sample.eds", "name", "3006:01", "Valve 1 % Open1", "Valve 1 % Open", "the number is part of it (CiA 306-1, 4.6)"
    ),
    Difference("canopennode-demo-device.eds", "default", "1008:00", None, "", DEFAULT_OF_STRING),
    Difference("canopennode-demo-device.eds", "default", "1009:00", None, "", DEFAULT_OF_STRING),
    Difference("canopennode-demo-device.eds", "default", "100A:00", None, "", DEFAULT_OF_STRING),
    Difference("canopennode-demo-device.eds", "default", "2122:00", None, b"", DEFAULT_OF_STRING),
    *(Difference("cia-301.eds", "default", f"{index}:00", 0, None, HEXADECIMAL) for index in ("1006", "1007", "100C", "100D")),
    Difference("cia-402.eds", "default", "607B:01", -(1 << 31), 1 << 31, TWOS_COMPLEMENT),
    Difference("cia-402.eds", "default", "607D:01", -(1 << 31), 1 << 31, TWOS_COMPLEMENT),
    Difference("cia-402.eds", "default", "60C2:02", -3, 253, TWOS_COMPLEMENT),
    Difference("maxon-epos2.eds", "default", "60C0:00", -1, 65535, TWOS_COMPLEMENT),
    Difference("maxon-epos2.eds", "default", "60C2:02", -3, 253, TWOS_COMPLEMENT),
    Difference("sample-node-1.eds", "access", "*", ANY, "unknown", "AccessType=UNKNOWN is no access; the standard's is taken"),
    Difference("sample-node-1.eds", "default", "2000:00", None, b"", DEFAULT_OF_STRING),
    Difference("oresat-battery.dcf", "configured", "1008:00", None, "", DEFAULT_OF_STRING),
    Difference("oresat-battery.dcf", "configured", "1009:00", None, "", DEFAULT_OF_STRING),
    Difference("oresat-battery.dcf", "configured", "100A:00", None, "", DEFAULT_OF_STRING),
    Difference("oresat-battery.dcf", "configured", "2100:00", None, b"", DEFAULT_OF_STRING),
    Difference(
        "oresat-battery.dcf", "default", "*", ANY, None, "[DeviceCommissioning] in its right spelling has no node-ID for the peer"
    ),
    Difference(
        "schunk-powerball-lwa4p.dcf", "adds_node_id", "*", True, False, "$NodeID in small letters is not seen as relative"
    ),
]

MADE_ON_ACCESS = {("canopen-sample.eds", 0x3006)}
"""An array in compact form without names: the peer makes its entries 2 and following when somebody asks for them."""


def repaired(name: str, text: str) -> str:
    """The text as the peer can read it at all."""
    if name == "canopennode-ds301.eds":  # ValueError: VendorNumber= with nothing behind it
        return re.sub(r"(?m)^(VendorNumber|ProductNumber|RevisionNumber)=$", r"\1=0", text)
    if name == "cia-301.eds":  # ValueError: a comment behind a number
        return re.sub(r"(?m)^(ObjectType|DataType|AccessType|PDOMapping|SubNumber)(=[^#\n]*?)\s*#.*$", r"\1\2", text)
    if name == "sample_io.eds":  # NoOptionError: a type that [DummyUsage] does not name
        return text.replace("[DummyUsage]", "[NoDummyUsage]")
    return text


class Stream(io.StringIO):
    """A text stream with the name by which the peer knows what it is."""

    name = "file.eds"


def their_variables(text: str) -> dict[tuple[int, int], ODVariable]:
    """By index and subindex, without the dummies, which the peer has as objects."""
    found: dict[tuple[int, int], ODVariable] = {}
    for each in import_od(Stream(text)).values():
        if isinstance(each, ODVariable):
            found[each.index, 0] = each
        else:
            found |= {(each.index, subindex): variable for subindex, variable in each.subindices.items()}
    return {place: variable for place, variable in found.items() if place[0] > 0x1F}


def facts_of_ours(variable: Variable, node_id: int | None) -> dict[str, object]:
    """By field; a value that depends on the node-ID is None where that is not known, as for the peer."""

    def value(value: Value | None, adds_node_id: bool) -> Value | None:
        if not adds_node_id or not isinstance(value, int):
            return value
        return None if node_id is None else value + node_id

    return {
        "name": variable.name,
        "data_type": int(variable.data_type),
        "access": variable.access.value,
        "default": value(variable.default, variable.adds_node_id),
        "configured": value(variable.configured, variable.configured_adds_node_id),
        "low_limit": variable.low_limit,
        "high_limit": variable.high_limit,
        "pdo_mappable": variable.pdo_mappable,
        "adds_node_id": variable.adds_node_id,
        "unit": variable.unit,
        "factor": variable.factor,
        "description": variable.description,
    }


def facts_of_theirs(variable: Any) -> dict[str, object]:
    """The same fields."""
    return {
        "name": variable.name,
        "data_type": variable.data_type,
        "access": variable.access_type,
        "default": variable.default,
        "configured": variable.value,
        "low_limit": variable.min,
        "high_limit": variable.max,
        "pdo_mappable": variable.pdo_mappable,
        "adds_node_id": variable.relative,
        "unit": variable.unit,
        "factor": variable.factor,
        "description": variable.description,
    }


def differing(name: str, read: DeviceDescription, theirs: dict[tuple[int, int], ODVariable]) -> Iterator[Difference]:
    """All differences of a file."""
    node_id = read.commissioning.node_id if read.commissioning is not None else None
    for variable in read.dictionary:
        peer = theirs.get((variable.index, variable.subindex))
        if peer is None:
            continue
        other = facts_of_theirs(peer)
        for field, value in facts_of_ours(variable, node_id).items():
            if value != other[field]:
                place = f"{variable.index:04X}:{variable.subindex:02X}"
                yield Difference(name, field, place, value, other[field], "")


OWN_FILE = """[DeviceInfo]
VendorName=x
[2000]
ParameterName=Limit beyond the type
ObjectType=0x7
DataType=0x0006
AccessType=rw
LowLimit=0
HighLimit=65536
PDOMapping=0
[2001]
ParameterName=Limits of a REAL32
ObjectType=0x7
DataType=0x0008
AccessType=rw
LowLimit=-1.5
HighLimit=4.5
DefaultValue=1.5
PDOMapping=0
[2002]
ParameterName=Signed limits as their bits
ObjectType=0x7
DataType=0x0004
AccessType=rw
LowLimit=0x80000000
HighLimit=0x7FFFFFFF
DefaultValue=0xFFFFFFFF
PDOMapping=0
[2003]
ParameterName=COB-ID with a comment
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x80 ; COB-ID of SYNC
PDOMapping=0
[2004]
ParameterName=COB-ID relative to the node-ID, with a comment
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180 ; $NODEID is added
PDOMapping=0
[2005]
ParameterName=Number with a leading zero
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=010
PDOMapping=0
"""
"""What makers' files hold that this project cannot keep: a maxon EPOS (comments), YiyouServo (a limit of 65536), and the like."""
OWN_DIFFERENCES = [
    Difference("sample_io.eds", "name", "6401:00", "NrOfObjects", "Number of entries", COMPACT_COUNT),
    Difference("sample_io.eds", "access", "6401:00", "ro", "rw", COMPACT_COUNT),
    Difference("sample_io.eds", "default", "6401:00", 2, None, COMPACT_COUNT),
    Difference(
        "own.eds", "high_limit", "2000:00", None, 65536, "an UNSIGNED16 cannot be 65536; lint says so, the type limits it"
    ),
    Difference("own.eds", "low_limit", "2001:00", -1.5, None, "the peer loses limits of REAL32"),
    Difference("own.eds", "high_limit", "2001:00", 4.5, None, "the peer loses limits of REAL32"),
    Difference("own.eds", "default", "2002:00", -1, 0xFFFFFFFF, TWOS_COMPLEMENT),
    Difference("own.eds", "default", "2005:00", 8, None, "a leading 0 means octal (CiA 306-1, 4.2); lint says so"),
]


def explains(known: Difference, found: Difference) -> bool:
    """Whether a difference is one of the list."""
    return (
        known[:2] == found[:2]
        and known.places in ("*", found.places)
        and known.ours in (ANY, found.ours)
        and known.theirs == found.theirs
    )


@needs_vendor_files
@pytest.mark.filterwarnings("ignore:The 'warn' method:DeprecationWarning")  # the peer's, where [DeviceInfo] is missing
@pytest.mark.parametrize("name", INI_NAMES)
def test_every_object_is_as_the_peer_reads_it_or_the_difference_has_a_reason(name: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR, logger="canopen")
    data = load(name)
    read = read_eds(data, name)
    theirs = their_variables(repaired(name, data.decode("utf-8", "replace")))
    ours = {(each.index, each.subindex) for each in read.dictionary}
    assert {place for place in ours ^ set(theirs) if (name, place[0]) not in MADE_ON_ACCESS} == set()
    listed = [each for each in DIFFERENCES if each.name == name]
    found = list(differing(name, read, theirs))
    assert [each for each in found if not any(explains(known, each) for known in listed)] == []
    assert [each for each in listed if not any(explains(each, other) for other in found)] == []


@pytest.mark.parametrize("name", ["sample_drive.eds", "sample_io.eds", "own.eds"])
def test_our_own_files_are_as_the_peer_reads_them_or_the_difference_has_a_reason(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL, logger="canopen")
    data = OWN_FILE.encode() if name == "own.eds" else read_file(name)
    read = read_eds(data, name)
    theirs = their_variables(repaired(name, data.decode()))
    assert {(each.index, each.subindex) for each in read.dictionary} == set(theirs)
    listed = [each for each in OWN_DIFFERENCES if each.name == name]
    found = list(differing(name, read, theirs))
    assert [each for each in found if not any(explains(known, each) for known in listed)] == []
    assert [each for each in listed if not any(explains(each, other) for other in found)] == []


@needs_vendor_files
def test_the_peer_makes_compact_entries_when_they_are_asked_for() -> None:
    text = load("canopen-sample.eds").decode()
    theirs = import_od(Stream(text))[0x3006]
    assert isinstance(theirs, ODArray)
    assert (len(theirs), theirs[24].data_type) == (2, DataType.REAL32)
    ours = read_eds(text).dictionary.objects[0x3006]
    assert (len(ours.variables), ours.variables[24].data_type) == (25, DataType.REAL32)
