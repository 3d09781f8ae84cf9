"""PDO mappings that fit."""

from __future__ import annotations

from typing import Final

from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument

from canopen_proto.datatypes import DataType, bit_length_of
from canopen_proto.dictionary import Access, Direction, ObjectDictionary
from canopen_proto.pdo.mapping import MAX_BITS, MAX_ENTRIES, MappedEntry, Mapping, may_have_width
from canopen_proto.pdo.multiplexed import MAPPABLE
from canopen_proto.testing.strategies.objects import data_types

_USUAL_ENTRIES: Final = 8
_TIMES: Final = (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)


@st.composite
def pdo_mappings(
    draw: st.DrawFn,
    dictionary: ObjectDictionary | None = None,
    direction: Direction | None = None,
    *,
    min_size: int = 1,
    max_bits: int = MAX_BITS,
    dummies: bool = True,
    whole: bool = False,
) -> Mapping:
    """Return a strategy for PDO mappings of at most max_bits bits.

    dictionary: only its objects that a PDO may carry, in their full width; None = objects from 0x2000 on, of any type and width.
    direction: which of them, those that a TPDO or an RPDO may carry; None = both. dummies: places that nobody
    reads too. whole: without a dictionary, only types of fixed width, whole.
    Bounds: min_size (0 or 1) to 64 entries, 64 bits. Shrinks towards one UNSIGNED8.
    """
    if not 0 <= max_bits <= MAX_BITS or min_size not in (0, 1):
        raise InvalidArgument(
            f"a PDO has 0..{MAX_BITS} bits and min_size is 0 or 1, not max_bits={max_bits}, min_size={min_size}"
        )
    accesses = MAPPABLE[direction] if direction else Access
    carried = dictionary and [each for each in dictionary if each.pdo_mappable and each.bit_length and each.access in accesses]
    entries: list[MappedEntry] = []
    free = max_bits
    for number in range(draw(st.integers(min_size, _USUAL_ENTRIES) | st.integers(min_size, MAX_ENTRIES))):
        if carried is not None:
            fitting = [MappedEntry.of(each) for each in carried if (each.bit_length or 0) <= free]
        else:
            fitting = draw(_of_any_type(number, free, dummies, whole)) if free else []
        if not fitting:
            break
        entries.append(draw(st.sampled_from(fitting)))
        free -= entries[-1].bit_length
    return Mapping(entries)


@st.composite
def _of_any_type(draw: st.DrawFn, number: int, free: int, dummies: bool, whole: bool) -> list[MappedEntry]:
    """The entries that a variable of its own could have, of full width first; none if none fits."""
    data_type = draw(data_types(mappable=whole).filter(lambda each: each not in _TIMES))
    full = bit_length_of(data_type)
    widths = [bits for bits in range(1, free + 1) if may_have_width(data_type, bits) and not (whole and bits != full)]
    is_dummy = draw(st.integers(0, 4)) == 4 and dummies and full is not None
    index = int(data_type) if is_dummy else 0x2000 + number
    return [MappedEntry(index, 0, bits, data_type, f"v{number}") for bits in sorted(widths, key=lambda bits: bits != full)]
