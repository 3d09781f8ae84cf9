"""Descriptions of devices and the text of their EDS and DCF."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

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
from canopen_data.eds.writer import write_eds
from canopen_proto.dictionary import ObjectDictionary
from canopen_testing.strategies.identifiers import node_ids
from canopen_testing.strategies.objects import NAMES, object_dictionaries, texts

_NUMBER: Final = st.integers(0, 0xFF)
_MAYBE: Final = st.none() | st.integers(0, 0xFFFF_FFFF)
_FILE_INFOS: Final = st.just(FileInfo()) | st.builds(
    FileInfo, texts(), _NUMBER, _NUMBER, texts(), texts(), texts(), texts(), texts(), texts(), texts(), texts(), texts()
)
_DEVICE_INFOS: Final = st.just(DeviceInfo()) | st.builds(
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
_COMMISSIONINGS: Final = st.builds(
    Commissioning,
    node_id=node_ids(),
    node_name=texts(),
    bit_rate=st.none() | st.sampled_from(BIT_RATES),
    net_number=st.none() | _NUMBER,
    network_name=texts(),
    canopen_manager=st.booleans(),
    lss_serial_number=_MAYBE,
)
_CHANNELS: Final = st.builds(
    lambda data_type, direction, first, size, offset: DynamicChannel(data_type, direction, first, first + size, offset),
    st.integers(1, 0x1F),
    st.sampled_from(["ro", "wo", "rww", "rwr"]),
    st.integers(0xA000, 0xAF00),
    st.integers(0, 0x3F),
    _NUMBER,
)


@st.composite
def _modules(draw: st.DrawFn, number: int) -> Module:
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
def device_descriptions(
    draw: st.DrawFn, kind: FileKind | None = None, *, dictionaries: SearchStrategy[ObjectDictionary] | None = None
) -> DeviceDescription:
    """Return a strategy for descriptions of devices, with everything that CiA 306 can say, and no more.

    kind: EDS or DCF; None = either. dictionaries: its objects; None = `object_dictionaries`, for a DCF with configured values.
    Bounds: up to five objects, two modules, two dynamic channels. Shrinks towards an EDS without objects, in which all is empty.
    """
    dcf = (kind or draw(st.sampled_from([FileKind.EDS, FileKind.DCF]))) is FileKind.DCF
    plain = describe(draw(object_dictionaries(configured=dcf) if dictionaries is None else dictionaries))
    count = draw(st.integers(0, 2))
    described = [draw(_modules(number)) for number in range(1, count + 1)]
    connected = tuple(draw(st.lists(st.integers(1, 2), max_size=3))) if dcf and count == 2 else ()
    if connected:  # they would add to the dictionary
        described = [replace(each, sub_extensions={}) for each in described]
    info = draw(_FILE_INFOS)
    if not dcf:
        info = replace(info, last_eds="")
    return DeviceDescription(
        plain.dictionary,
        FileKind.DCF if dcf else FileKind.EDS,
        file_info=info,
        device_info=draw(_DEVICE_INFOS),
        commissioning=draw(_COMMISSIONINGS) if dcf else None,
        dummies=draw(st.none() | st.dictionaries(st.integers(1, 7), st.booleans(), min_size=1)),
        comments=tuple(draw(st.lists(texts(), max_size=3))),
        mandatory=plain.mandatory,
        optional=plain.optional,
        manufacturer=plain.manufacturer,
        modules=tuple(described),
        connected_modules=connected,
        dynamic_channels=tuple(draw(st.lists(_CHANNELS, max_size=2))),
    )


def eds_texts(
    kind: FileKind | None = FileKind.EDS, *, dictionaries: SearchStrategy[ObjectDictionary] | None = None
) -> SearchStrategy[str]:
    """Return a strategy for the text of EDS files, as `device_descriptions` describes devices.

    kind: DCF for those; None = either. dictionaries: the objects, such as `device_dictionaries()`. Bounds: files without a fault.
    Shrinks towards the file of a device without objects.
    """
    return device_descriptions(kind, dictionaries=dictionaries).map(write_eds)


@st.composite
def damaged_texts(draw: st.DrawFn, text: str, *, max_size: int = 8) -> str:
    """Return a strategy for a file whose lines are damaged as editors, transfers and people damage them.

    text: the right file. A line is lost, doubled, cut in half, in capitals, or has another character. Bounds: 1 to max_size
    damages. Shrinks towards an empty first line.
    """
    lines = text.split("\n")
    place = st.integers(0, len(lines) - 1)
    for at, other, what in draw(st.lists(st.tuples(place, place, st.integers(0, 5)), min_size=1, max_size=max_size)):
        line = lines[at]
        lines[at] = (
            "",
            f"{line}\n{lines[other]}",
            line.upper(),
            line[: len(line) // 2],
            line.replace("=", "= $", 1),
            line.replace("0", "x", 1),
        )[what]
    return "\n".join(lines)
