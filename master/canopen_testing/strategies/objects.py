"""Data types and their values, variables, objects, object dictionaries."""

from __future__ import annotations

import datetime
from collections.abc import Collection
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias, overload

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from canopen_proto.datatypes import EPOCH, DataType, Value, bit_length_of, is_number, range_of
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable

_TYPES: Final = (
    DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32,
    DataType.BOOLEAN, DataType.REAL32, DataType.REAL64, DataType.UNSIGNED64, DataType.INTEGER64, DataType.UNSIGNED24,
    DataType.INTEGER24, DataType.UNSIGNED40, DataType.INTEGER40, DataType.UNSIGNED48, DataType.INTEGER48, DataType.UNSIGNED56,
    DataType.INTEGER56, DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.UNICODE_STRING, DataType.TIME_OF_DAY,
    DataType.TIME_DIFFERENCE, DataType.DOMAIN,
)  # fmt: skip
"""All data types, the simplest and the most usual first."""
_Integers: TypeAlias = Literal[
    DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED24, DataType.UNSIGNED32, DataType.UNSIGNED40, DataType.UNSIGNED48,
    DataType.UNSIGNED56, DataType.UNSIGNED64, DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER24, DataType.INTEGER32,
    DataType.INTEGER40, DataType.INTEGER48, DataType.INTEGER56, DataType.INTEGER64,
]  # fmt: skip
_TEXTS: Final = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_CHARACTERS: Final = st.sampled_from("abcXYZ019 ;=[]#%$\"'\\/:,.()+-_~|&<>{}@^°µ²äß")
"""What stands in names, and what a careless reader trips over."""
_MOST_MILLISECONDS: Final = 0xFFFF * 86_400_000 + 86_399_999
_AREAS: Final = (0x2000, 0x1000, 0x1018, 0x1400, 0x1A00, 0x1FFF, 0x5FFF, 0x6000, 0x6041, 0x9FFF, 0xFFFF)


_WITH_NODE_ID: Final = (DataType.UNSIGNED16, DataType.UNSIGNED32)
_EDS_FIELDS: Final = ("default", "mappable", "low_limit", "high_limit", "flags", "unit", "factor", "description")
_DCF_FIELDS: Final = (*_EDS_FIELDS, "configured", "denotation", "upload_file", "download_file")


def texts(max_size: int = 12) -> SearchStrategy[str]:
    """Return a strategy for texts of one line, without blanks at the ends, as a description of a device can hold them.

    They have the characters that careless readers trip over: `=`, `;`, `[`, quotes, Latin-1. Bounds: 0 to max_size characters.
    Shrinks towards "", then letters.
    """
    return st.text(_CHARACTERS, max_size=max_size).map(str.strip)


NAMES: Final = st.builds(lambda first, rest: (first + rest).strip(), st.sampled_from("aZ9_("), texts())
"""Names of objects: as `texts`, at least one character."""


def data_types(*, mappable: bool = False) -> SearchStrategy[DataType]:
    """Return a strategy for the data types of CiA 301.

    mappable: only those with a fixed width, as a PDO carries them without further ado. Shrinks towards UNSIGNED8.
    """
    return st.sampled_from([each for each in _TYPES if not mappable or bit_length_of(each) is not None])


@overload
def values(of: Literal[DataType.BOOLEAN], *, max_size: int = ..., in_file: bool = ...) -> SearchStrategy[bool]: ...
@overload
def values(of: _Integers, *, max_size: int = ..., in_file: bool = ...) -> SearchStrategy[int]: ...
@overload
def values(
    of: Literal[DataType.REAL32, DataType.REAL64], *, max_size: int = ..., in_file: bool = ...
) -> SearchStrategy[float]: ...
@overload
def values(
    of: Literal[DataType.VISIBLE_STRING, DataType.UNICODE_STRING], *, max_size: int = ..., in_file: bool = ...
) -> SearchStrategy[str]: ...
@overload
def values(
    of: Literal[DataType.OCTET_STRING, DataType.DOMAIN], *, max_size: int = ..., in_file: bool = ...
) -> SearchStrategy[bytes]: ...
@overload
def values(of: DataType | Variable, *, max_size: int = ..., in_file: bool = ...) -> SearchStrategy[Value]: ...
def values(of: DataType | Variable, *, max_size: int = 12, in_file: bool = False) -> SearchStrategy[Any]:
    """Return a strategy for the values of a data type, or of a variable within its limits, as Python has them.

    max_size: characters or bytes, of what has no fixed size. in_file: only what a line of an EDS can hold: no empty text, no line
    break, no blank at an end, no NaN. The ends of a range come often. Bounds: `encode` takes each value.
    Shrinks towards 0, False, "", b"", the epoch; or the limit next to it.
    """
    if isinstance(of, Variable):
        data_type, low, high = of.data_type, of.low_limit, of.high_limit
    else:
        data_type, low, high = of, None, None
    ends = range_of(data_type)
    if data_type is DataType.BOOLEAN:
        return st.booleans()
    if ends is not None:
        least = ends[0] if low is None else max(ends[0], _whole_from(low))
        most = ends[1] if high is None else min(ends[1], int(high // 1))
        if least > most:  # limits that exclude each other are no limits: see Variable.may_be
            least, most = ends
        return st.integers(least, most) | st.sampled_from((least, most))
    if is_number(data_type):
        return st.floats(
            width=32 if data_type is DataType.REAL32 else 64, allow_nan=not in_file, allow_infinity=not in_file
        ).filter(_within(low, high))
    if data_type is DataType.TIME_OF_DAY:
        return st.integers(0, _MOST_MILLISECONDS).map(lambda milliseconds: EPOCH + datetime.timedelta(milliseconds=milliseconds))
    if data_type is DataType.TIME_DIFFERENCE:
        return st.integers(0, _MOST_MILLISECONDS).map(lambda milliseconds: datetime.timedelta(milliseconds=milliseconds))
    if data_type in _TEXTS:
        if in_file:
            return texts(max_size).filter(bool)
        last = 0xFF if data_type is DataType.VISIBLE_STRING else None
        return st.text(st.characters(max_codepoint=last, exclude_categories=["Cs"]), max_size=max_size)
    return st.binary(min_size=1 if in_file else 0, max_size=max_size)


def _whole_from(low: float) -> int:
    return -int(-low // 1)


def _within(low: float | None, high: float | None) -> Any:
    return lambda value: (low is None or value >= low) and (high is None or value <= high)


@st.composite
def variables(
    draw: st.DrawFn,
    index: int = 0x2000,
    subindex: int = 0,
    *,
    types: SearchStrategy[DataType] | None = None,
    configured: bool = False,
) -> Variable:
    """Return a strategy for variables, with whatever an EDS says of one.

    types: its data type; None = `data_types()`. configured: with what a DCF says too (value, denotation, files of a DOMAIN).
    Limits may exclude each other, and the default may be beyond them, as in files of the field.
    Bounds: what CiA 306 can say. Shrinks towards an UNSIGNED8 named "a", rw, that has nothing else.
    """
    data_type = draw(data_types() if types is None else types)
    access = draw(st.sampled_from((Access.RW, *Access)))
    name = draw(NAMES)
    said = draw(st.sets(st.sampled_from(_DCF_FIELDS if configured else _EDS_FIELDS)))  # what is not said costs no choice

    def value(field: str) -> tuple[Any, bool]:
        if field not in said:
            return None, False
        found = draw(values(data_type, in_file=True))
        limits = range_of(data_type) if data_type in _WITH_NODE_ID else None
        return found, limits is not None and found != limits[1] and draw(st.booleans())  # the greatest fits no node-ID

    def text(field: str) -> str:
        return draw(texts()) if field in said else ""

    default, adds_node_id = value("default")
    chosen, chosen_adds = value("configured")
    has_limits = is_number(data_type)
    is_domain = data_type is DataType.DOMAIN
    return Variable(
        index,
        subindex,
        name,
        data_type,
        access,
        default=default,
        low_limit=value("low_limit")[0] if has_limits else None,
        high_limit=value("high_limit")[0] if has_limits else None,
        pdo_mappable="mappable" in said and bit_length_of(data_type) is not None,
        adds_node_id=adds_node_id,
        configured=chosen,
        configured_adds_node_id=chosen_adds,
        object_flags=draw(st.integers(1, 3)) if "flags" in said else 0,
        denotation=text("denotation"),
        unit=draw(texts(3)) if "unit" in said else "",
        factor=draw(st.sampled_from((0.1, -3e-7))) if "factor" in said else 1.0,
        description=text("description"),
        upload_file=text("upload_file") if is_domain else "",
        download_file=text("download_file") if is_domain else "",
    )


@st.composite
def objects(draw: st.DrawFn, index: int = 0x2000, *, configured: bool = False) -> Object:
    """Return a strategy for objects: VAR, DOMAIN, ARRAY or RECORD, with up to four fields.

    configured: as in `variables`. Bounds: subindices 0 to 0xFE. Shrinks towards the VAR of the smallest variable.
    """
    kind = draw(st.sampled_from((ObjectType.VAR, ObjectType.ARRAY, ObjectType.RECORD)))
    if kind is ObjectType.VAR:
        only = draw(variables(index, configured=configured))
        kind = ObjectType.DOMAIN if only.data_type is DataType.DOMAIN else kind
        return Object(index, only.name, kind, MappingProxyType({0: only}), only.data_type, only.object_flags, only.denotation)
    fields = data_types().filter(lambda each: each is not DataType.DOMAIN)
    subindices = sorted(draw(st.sets(st.integers(1, 0xFE), max_size=4)))
    first = draw(variables(index, 0, types=st.just(DataType.UNSIGNED8), configured=configured))
    rest = [draw(variables(index, subindex, types=fields, configured=configured)) for subindex in subindices]
    by_subindex = MappingProxyType({variable.subindex: variable for variable in (first, *rest)})
    data_type = draw(st.none() | st.integers(1, 0x7F))
    return Object(index, draw(NAMES), kind, by_subindex, data_type, draw(st.integers(0, 3)), draw(texts()) if configured else "")


@st.composite
def object_dictionaries(
    draw: st.DrawFn, *, indices: Collection[int] | None = None, max_size: int = 5, configured: bool = False
) -> ObjectDictionary:
    """Return a strategy for object dictionaries: any objects in any area, whether a device could live by them or not.

    indices: where objects may be; None = anywhere from 0x1000 on, often at the ends of the areas. configured: as in `variables`.
    A dictionary by which a device runs: see `device_dictionaries`. Bounds: 0 to max_size objects. Shrinks towards none.
    """
    places = st.sampled_from(_AREAS) | st.integers(0x1000, 0xFFFF) if indices is None else st.sampled_from(sorted(indices))
    chosen = draw(st.sets(places, max_size=max_size))
    return ObjectDictionary([draw(objects(index, configured=configured)) for index in sorted(chosen)])
