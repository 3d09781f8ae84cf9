"""What to draw for the text protocol: values of every type, requests of every command, answers and events."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import strategies as st

from canopen_proto.gateway import (
    VALUE_TYPES,
    Dialect,
    GatewayAnswer,
    GatewayCommand,
    GatewayEvent,
    GatewayNews,
    GatewayRequest,
    MappedValue,
    ValueType,
    print_value,
)
from canopen_proto.gateway.request import EVENT, RTR, About, Tail
from canopen_proto.gateway.value_types import TextForm
from canopen_proto.nmt import NmtState

TYPES = st.sampled_from(sorted(VALUE_TYPES))
_PRINTABLE = st.characters(min_codepoint=0x20, max_codepoint=0xFF, blacklist_categories=("Cc",))
_ANY_BYTE = st.characters(min_codepoint=1, max_codepoint=0xFF)


@st.composite
def data_of(draw: Any, value_type: ValueType, dialect: Dialect) -> bytes:
    """Bytes that a type can carry as text."""
    match value_type.form:
        case TextForm.REAL:
            width = 32 if value_type.size == 4 else 64
            return struct.pack("<f" if width == 32 else "<d", draw(st.floats(width=width, allow_nan=False)))
        case TextForm.TIME:
            return struct.pack("<IH", draw(st.integers(0, 86_399_999)), draw(st.integers(0, 0xFFFF)))
        case TextForm.QUOTED:
            text: str = draw(st.text(_ANY_BYTE if dialect.escapes else _PRINTABLE, max_size=20))
            return text.encode("latin-1")
    if value_type.word == "b":
        return draw(st.sampled_from([b"\0", b"\1"]))
    if value_type.size is not None:
        return draw(st.binary(min_size=value_type.size, max_size=value_type.size))
    data: bytes = draw(st.binary(max_size=20))
    if value_type.form is TextForm.BASE64:
        data = data * 2 or b"\0\1"  # an empty one has no text
    return data or b"\0"


@st.composite
def requests(draw: Any, dialect: Dialect) -> GatewayRequest:
    """Any request that can be typed."""
    command: GatewayCommand = draw(st.sampled_from(GatewayCommand))
    syntax = command.syntax
    count = draw(st.sampled_from(syntax.counts or (len(syntax.numbers),)))
    numbers = [draw(st.integers(*bounds)) for bounds in syntax.numbers[:count]]
    net = draw(st.none() | st.integers(0, 0xFFFF)) if command.about is not About.GATEWAY else None
    node = None
    if command.about is About.NODE:
        node = draw(st.integers(0, 127)) if net is not None else draw(st.none() | st.integers(0, 127))
    value_type, data, mapping = None, b"", ()
    match syntax.tail:
        case Tail.TYPE:
            value_type = draw(st.none() | TYPES.map(VALUE_TYPES.get))
        case Tail.VALUE:
            value_type = VALUE_TYPES[draw(TYPES)]
            data = draw(data_of(value_type, dialect))
        case Tail.COUNTED:
            numbers += draw(st.lists(st.integers(0, (1 << 64) - 1), max_size=5))
        case Tail.MAPPING | Tail.EXTENDED_MAPPING:
            numbers += _transmission(draw, syntax.tail)
            mapping = tuple(draw(st.lists(_mapped(), max_size=4)))
    sequence = draw(st.integers(0, 0xFFFF_FFFF))
    return GatewayRequest(command, sequence, net, node, tuple(numbers), value_type, data, mapping)


def _transmission(draw: Any, tail: Tail) -> list[int]:
    transmission = draw(st.sampled_from([EVENT, RTR, 0, 1, 240]))
    if tail is Tail.MAPPING:
        return [transmission]
    inhibit = draw(st.integers(0, 0xFFFF)) if transmission == EVENT else 0
    timer = draw(st.integers(0, 0xFFFF)) if transmission >= RTR else 0
    start = draw(st.integers(0, 0xFF)) if transmission < RTR else 0
    return [transmission, inhibit, timer, start]


def _mapped() -> st.SearchStrategy[MappedValue]:
    types = st.sampled_from([each for each in VALUE_TYPES.values() if each.size is not None])
    dummies = st.builds(MappedValue, types)
    return dummies | st.builds(MappedValue, types, st.integers(1, 0xFFFF), st.integers(0, 0xFF))


@st.composite
def answers(draw: Any, dialect: Dialect) -> GatewayAnswer:
    """Any answer."""
    sequence = draw(st.integers(0, 0xFFFF_FFFF))
    remark = draw(st.sampled_from(["", "start the gateway with --allow motion", "a (b) c"]))
    lines = tuple(draw(st.lists(st.sampled_from(["Found 2 nodes", "a: b"]), max_size=2))) if not dialect.spaced_errors else ()
    match draw(st.integers(0, 3)):
        case 0:
            return GatewayAnswer(sequence, lines=lines)
        case 1:
            value_type = VALUE_TYPES[draw(TYPES)]
            return GatewayAnswer(sequence, print_value(value_type, draw(data_of(value_type, dialect)), dialect), lines=lines)
        case 2:
            return GatewayAnswer(sequence, code=draw(st.sampled_from([100, 101, 107, 600, 999, 1])), remark=remark, lines=lines)
    codes = st.sampled_from([0x06020000, 0x05040000, 0, 0xFFFFFFFF, 0x06090030])
    return GatewayAnswer(sequence, abort_code=draw(codes), remark=remark, lines=lines)


@st.composite
def events(draw: Any) -> GatewayEvent:
    """Any event."""
    net, node = draw(st.integers(0, 0xFFFF)), draw(st.integers(1, 127))
    kind = draw(st.sampled_from(GatewayNews))
    match kind:
        case GatewayNews.STATE:
            states = (NmtState.STOPPED, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)
            return GatewayEvent(net, node, kind, (int(draw(st.sampled_from(states))),))
        case GatewayNews.ERROR:
            return GatewayEvent(net, node, kind, (draw(st.sampled_from([200, 202, 203, 999])),))
        case GatewayNews.EMCY:
            maker = draw(st.binary(min_size=5, max_size=5))
            return GatewayEvent(net, node, kind, (draw(st.integers(0, 0xFFFF)), draw(st.integers(0, 0xFF)), *maker))
        case GatewayNews.READ_SO_FAR | GatewayNews.WRITTEN_SO_FAR:
            return GatewayEvent(net, node, kind, (draw(st.integers(0, 0xFFFF_FFFF)),))
        case GatewayNews.PDO:
            values = draw(st.lists(st.integers(0, (1 << 64) - 1), max_size=4))
            return GatewayEvent(net, 0, kind, (draw(st.integers(1, 512)), *values))
        case GatewayNews.OTHER:
            return GatewayEvent(net, node, kind, text="USER BOOT A (not listed)")
    return GatewayEvent(net, node, kind)
