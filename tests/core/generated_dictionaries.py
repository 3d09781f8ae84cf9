"""Hypothesis strategies for dictionaries and descriptions: everything that CiA 306 can say, and no more."""

from __future__ import annotations

import datetime
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from hypothesis import strategies as st

from canopen_data.describing import describe
from canopen_data.description import (
    BIT_RATES,
    Commissioning,
    DeviceDescription,
    DeviceInfo,
    DynamicChannel,
    FileInfo,
    FileKind,
    Module,
)
from canopen_proto.datatypes import EPOCH, DataType, Value, bit_length_of, is_number, range_of
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable

CHARACTERS = st.sampled_from("abcXYZ019 ;=[]#%$\"'\\/:,.()+-_~|&<>{}@^°µ²äß")
"""What stands in names, and what a careless reader trips over."""


def texts(max_size: int = 12) -> st.SearchStrategy[str]:
    """Texts of one line, without blanks at the ends."""
    return st.text(CHARACTERS, max_size=max_size).map(str.strip)


NAMES = st.builds(lambda first, rest: (first + rest).strip(), st.sampled_from("aZ9_("), texts())
UNSIGNED32 = st.integers(0, 0xFFFF_FFFF)
_MILLISECONDS = st.integers(0, 0xFFFF * 86_400_000)


def values_of(data_type: DataType) -> st.SearchStrategy[Any]:
    """Values of a type that a line can hold. An empty text or no octets are no value to an EDS."""
    limits = range_of(data_type)
    if data_type is DataType.BOOLEAN:
        return st.booleans()
    if limits is not None:
        return st.integers(*limits) | st.sampled_from(limits)
    if is_number(data_type):
        return st.floats(width=32 if data_type is DataType.REAL32 else 64, allow_nan=False, allow_infinity=False)
    if data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
        return texts().filter(bool)
    if data_type is DataType.TIME_OF_DAY:
        return _MILLISECONDS.map(lambda milliseconds: EPOCH + datetime.timedelta(milliseconds=milliseconds))
    if data_type is DataType.TIME_DIFFERENCE:
        return _MILLISECONDS.map(lambda milliseconds: datetime.timedelta(milliseconds=milliseconds))
    return st.binary(min_size=1, max_size=12)


@st.composite
def variables(draw: st.DrawFn, index: int, subindex: int, types: st.SearchStrategy[DataType], dcf: bool) -> Variable:
    """One variable, with whatever an EDS, or a DCF, says of it."""
    data_type = draw(types)
    access = draw(st.sampled_from(Access))

    def value() -> tuple[Value | None, bool]:
        given: Value | None = draw(st.none() | values_of(data_type))
        relative = data_type in (DataType.UNSIGNED32, DataType.UNSIGNED16) and given is not None and draw(st.booleans())
        return given, relative

    default, adds_node_id = value()
    configured, configured_adds = value() if dcf else (None, False)
    low: int | float | None = None
    high: int | float | None = None
    if is_number(data_type):
        low, high = draw(st.none() | values_of(data_type)), draw(st.none() | values_of(data_type))
    is_domain = data_type is DataType.DOMAIN and dcf
    return Variable(
        index,
        subindex,
        draw(NAMES),
        data_type,
        access,
        default=default,
        low_limit=low,
        high_limit=high,
        pdo_mappable=bit_length_of(data_type) is not None and draw(st.booleans()),
        adds_node_id=adds_node_id,
        configured=configured,
        configured_adds_node_id=configured_adds,
        object_flags=draw(st.integers(0, 3)),
        denotation=draw(texts()) if dcf else "",
        unit=draw(texts(3)),
        factor=draw(st.sampled_from([1.0, 1.0, 0.1, -3e-7])),
        description=draw(texts()),
        upload_file=draw(texts()) if is_domain else "",
        download_file=draw(texts()) if is_domain else "",
    )


_ANY_TYPE = st.sampled_from([each for each in DataType if each is not DataType.DOMAIN])


@st.composite
def objects(draw: st.DrawFn, index: int, dcf: bool) -> Object:
    """One object: VAR, DOMAIN, ARRAY or RECORD."""
    kind = draw(st.sampled_from([ObjectType.VAR, ObjectType.DOMAIN, ObjectType.ARRAY, ObjectType.RECORD]))
    if kind in (ObjectType.VAR, ObjectType.DOMAIN):
        types = st.just(DataType.DOMAIN) if kind is ObjectType.DOMAIN else _ANY_TYPE
        only = draw(variables(index, 0, types, dcf))
        return Object(index, only.name, kind, MappingProxyType({0: only}), only.data_type, only.object_flags, only.denotation)
    subs = sorted(draw(st.sets(st.integers(1, 0xFE), max_size=4)))
    first = draw(variables(index, 0, st.just(DataType.UNSIGNED8), dcf))
    rest = [draw(variables(index, subindex, _ANY_TYPE, dcf)) for subindex in subs]
    by_subindex = MappingProxyType({variable.subindex: variable for variable in (first, *rest)})
    data_type = draw(st.none() | st.integers(1, 0x7F))
    return Object(index, draw(NAMES), kind, by_subindex, data_type, draw(st.integers(0, 3)), draw(texts()) if dcf else "")


@st.composite
def dictionaries(draw: st.DrawFn, dcf: bool = False) -> ObjectDictionary:
    """A few objects of all areas."""
    areas = st.sampled_from([0x1000, 0x1018, 0x1400, 0x1A00, 0x1FFF, 0x2000, 0x5FFF, 0x6000, 0x6041, 0x9FFF, 0xFFFF])
    indices = draw(st.sets(areas | st.integers(0x1000, 0xFFFF), max_size=5))
    return ObjectDictionary([draw(objects(index, dcf)) for index in sorted(indices)])


_NUMBER = st.integers(0, 0xFF)
_MAYBE = st.none() | UNSIGNED32
FILE_INFOS = st.builds(
    FileInfo, texts(), _NUMBER, _NUMBER, texts(), texts(), texts(), texts(), texts(), texts(), texts(), texts(), texts()
)
DEVICE_INFOS = st.builds(
    DeviceInfo,
    vendor_name=texts(),
    vendor_number=_MAYBE,
    product_name=texts(),
    product_number=_MAYBE,
    revision_number=_MAYBE,
    order_code=texts(),
    bit_rates=st.frozensets(st.sampled_from(BIT_RATES)),
    simple_boot_up_master=st.booleans(),
    simple_boot_up_slave=st.booleans(),
    granularity=st.integers(0, 64),
    dynamic_channels_supported=_NUMBER,
    group_messaging=st.booleans(),
    rpdo_count=st.none() | st.integers(0, 512),
    tpdo_count=st.none() | st.integers(0, 512),
    lss_supported=st.booleans(),
)
COMMISSIONINGS = st.builds(
    Commissioning,
    node_id=st.integers(1, 127),
    node_name=texts(),
    bit_rate=st.none() | st.sampled_from(BIT_RATES),
    net_number=st.none() | _NUMBER,
    network_name=texts(),
    canopen_manager=st.booleans(),
    lss_serial_number=_MAYBE,
)
CHANNELS = st.builds(
    lambda data_type, direction, first, size, offset: DynamicChannel(data_type, direction, first, first + size, offset),
    st.integers(1, 0x1F),
    st.sampled_from(["ro", "wo", "rww", "rwr"]),
    st.integers(0xA000, 0xAF00),
    st.integers(0, 0x3F),
    _NUMBER,
)


@st.composite
def modules(draw: st.DrawFn, number: int) -> Module:
    """A module, with what it brings and what it extends."""
    indices = st.integers(0x6000, 0x9FFF)
    return Module(
        number,
        draw(NAMES),
        draw(st.none() | _NUMBER),
        draw(st.none() | _NUMBER),
        draw(texts()),
        tuple(draw(st.lists(NAMES, max_size=2))),
        tuple(draw(st.lists(indices, max_size=2, unique=True))),
        draw(st.dictionaries(indices, st.fixed_dictionaries({"ParameterName": NAMES, "Count": st.just("1")}), max_size=2)),
    )


@st.composite
def descriptions(draw: st.DrawFn, kind: FileKind | None = None) -> DeviceDescription:
    """A whole EDS or DCF."""
    dcf = (kind or draw(st.sampled_from([FileKind.EDS, FileKind.DCF]))) is FileKind.DCF
    plain = describe(draw(dictionaries(dcf)))
    count = draw(st.integers(0, 2))
    described = [draw(modules(number)) for number in range(1, count + 1)]
    connected = tuple(draw(st.lists(st.integers(1, 2), max_size=3))) if dcf and count == 2 else ()
    if connected:  # what they would add to the dictionary: tests/data/test_eds_modules.py
        described = [replace(each, sub_extensions={}) for each in described]
    info = draw(FILE_INFOS)
    if not dcf:
        info = replace(info, last_eds="")
    return DeviceDescription(
        plain.dictionary,
        FileKind.DCF if dcf else FileKind.EDS,
        file_info=info,
        device_info=draw(DEVICE_INFOS),
        commissioning=draw(COMMISSIONINGS) if dcf else None,
        dummies=draw(st.none() | st.dictionaries(st.integers(1, 7), st.booleans(), min_size=1)),
        comments=tuple(draw(st.lists(texts(), max_size=3))),
        mandatory=plain.mandatory,
        optional=plain.optional,
        manufacturer=plain.manufacturer,
        modules=tuple(described),
        connected_modules=connected,
        dynamic_channels=tuple(draw(st.lists(CHANNELS, max_size=2))),
    )
