"""The mapping of a PDO: its bits as objects, lowest bits first.

A PDO has no header. Both sides know from the PDO mapping parameter (0x1600.., 0x1A00..) which objects its up to 64 bits carry.
Each entry names an object and a length in bits. Entries follow one another without gaps, from the lowest bit of the first byte on
(CiA 301 v4.2.0, 7.4.7.1 and 7.1.4). So the whole PDO is one little-endian integer, and an entry is `integer >> offset & mask`, at
any offset and of any width. If every entry is aligned to bytes and has the width of a C type, a precompiled `struct` does the
same in one call.

- A number may be mapped with fewer bits than its type has: these are its lowest bits, and the highest of them is the sign of a
  signed type. More bits than the type has are refused.
- A BOOLEAN is one bit. Devices that can map only bytes give it up to 8; it is true if any of them is 1.
- REAL32, REAL64 and the times are mapped whole, strings and DOMAIN in whole bytes (16 bits for UNICODE_STRING). A shorter text is
  filled up with NULs; a received text keeps its NULs.
- The index of a dummy entry is the code of a data type (0x0001..0x001B). Its bits are sent as 0 and ignored when received, and it
  is no component of the PDO. The fillers of PDO descriptions (`notused16`) become dummy entries.

A PDO reads and writes `Values.store` (mux -> Python value) directly: a PDO and the dictionary are one memory. Limits of objects
are not checked, because a PDO has no way to refuse a value.

Multiplexed PDOs (sub 0 = 0xFE and 0xFF) have no mapping; see multiplexed.py.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Mapping as ReadOnlyDict
from functools import lru_cache
from operator import itemgetter
from typing import Any, Final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import (
    DataType,
    Value,
    ValueRangeError,
    bit_length_of,
    decode,
    encode,
    integer_type,
    is_integer,
    is_signed,
    zero_of,
)
from canopen_proto.dictionary import Filler, Key, ObjectDictionary, PdoDescription, Values, Variable
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux, index_of, mapped, mapping_entry, mux, subindex_of

MAX_BITS: Final = 64
"""A classical CAN frame carries 8 bytes."""

MAX_ENTRIES: Final = 64
"""The greatest number of entries, 64 single bits (CiA 301 v4.2.0, 7.5.2.36)."""

LAST_DUMMY_INDEX: Final = 0x001B
"""UNSIGNED64, the last data type code with a fixed width."""

MAX_BOOLEAN_BITS: Final = 8

_MOST_KNOWN: Final = 1024
"""So many mappings of one dictionary are kept, however many a peer writes: all PDOs of a device."""

_ALIGNED: Final = {8: "b", 16: "h", 32: "i", 64: "q"}  # struct's letters by width; in upper case they are unsigned
_WHOLE: Final = (DataType.REAL32, DataType.REAL64, DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)
_NUMBER = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?:[:.](?:0[xX])?([0-9A-Fa-f]{1,2}))?")


@mypyc_attr(native_class=False)
class MappingError(LocalProtocolError, ValueError):
    """These entries cannot form a PDO. The text names the wrong one and the reason."""


class MappedEntry:
    """One object of a PDO, or a dummy entry. Never changes.

    bit_length: bits in the PDO. data_type: of the object; of a dummy entry, the type that its index names. names: the object's
    names; `name` is the first. Raises MappingError if this type cannot have this width in a PDO.
    """

    __slots__ = ("bit_length", "data_type", "index", "is_dummy", "mux", "names", "subindex")

    def __init__(self, index: int, subindex: int, bit_length: int, data_type: DataType, name: str = "", *aliases: str) -> None:
        self.index = index
        self.subindex = subindex
        self.bit_length = bit_length
        self.data_type = data_type
        self.names = (name or f"0x{index:04X}:{subindex:02X}", *aliases)
        self.is_dummy = index <= LAST_DUMMY_INDEX
        self.mux = mux(index, subindex)
        if not may_have_width(data_type, bit_length):
            raise MappingError(f"{self.names[0]}: {data_type.name} cannot be mapped to a PDO with {bit_length} bits")

    @classmethod
    def of(cls, entry: Variable | Filler) -> MappedEntry:
        """Return the entry for a variable in its full width, or for a filler. Raises MappingError for a variable without a width,
        such as a string."""
        if isinstance(entry, Variable):
            return cls(entry.index, entry.subindex, entry.bit_length or 0, entry.data_type, *entry.names)
        data_type = _dummy_type(entry)
        return cls(int(data_type), 0, entry.bit_length, data_type, entry.name)

    @classmethod
    def from_parameter(cls, parameter: int, dictionary: ObjectDictionary) -> MappedEntry:
        """Return the entry for a value of a mapping parameter, such as 0x1600:01. Raises MappingError if the dictionary has no
        such object, or if its type cannot have this width."""
        index, subindex, bit_length = mapped(parameter)
        if index <= LAST_DUMMY_INDEX:
            if subindex or index not in DUMMY_TYPES:
                raise MappingError(f"0x{index:04X}:{subindex:02X} is no data type that a dummy entry may have")
            return cls(index, 0, bit_length, DUMMY_TYPES[index])
        variable = dictionary.get(index, subindex)
        if variable is None:
            raise MappingError(f"object 0x{index:04X}:{subindex:02X} is not in the dictionary")
        return cls(index, subindex, bit_length, variable.data_type, *variable.names)

    @property
    def name(self) -> str:
        """The object's first name; index and subindex, as "0x6041:00", if it has none."""
        return self.names[0]

    @property
    def parameter(self) -> int:
        """The entry as a value of a mapping parameter: index << 16 | subindex << 8 | bits."""
        return mapping_entry(self.mux, self.bit_length)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MappedEntry) and self.parameter == other.parameter and self.data_type == other.data_type

    def __hash__(self) -> int:
        return hash(self.parameter)

    def __repr__(self) -> str:
        return f"<{self.name} {self.index:04X}{self.subindex:02X}{self.bit_length:02X}>"


class Mapping:
    """The entries of one PDO. Packs values into bytes and unpacks them. Never changes.

    entries: all entries. components: the entries without dummies; `unpack` and `pack` have one value for each, in this order.
    muxes: of the components. labels: a unique name for each component: the object's name, or "6401:01" if several components
    have that name, or "6401:01#2" if the object is mapped a second time. Raises MappingError for more than 64 bits.
    """

    __slots__ = (
        "_fields", "_places", "_values_of", "bit_length", "byte_length", "components", "entries", "labels", "layout", "muxes",
    )  # fmt: skip

    def __init__(self, entries: Iterable[MappedEntry] = ()) -> None:
        self.entries: tuple[MappedEntry, ...] = tuple(entries)
        self.bit_length = sum(entry.bit_length for entry in self.entries)
        if self.bit_length > MAX_BITS:
            names = ", ".join(entry.name for entry in self.entries)
            raise MappingError(f"a PDO has {MAX_BITS} bits at most, not {self.bit_length} ({names})")
        self.byte_length = (self.bit_length + 7) // 8
        self.components: tuple[MappedEntry, ...] = tuple(entry for entry in self.entries if not entry.is_dummy)
        self.muxes = tuple(entry.mux for entry in self.components)
        self.labels = _labels(self.components)
        self._places: dict[str | int, list[int]] = {}  # mux, label or name -> positions among the components
        for position, (entry, label) in enumerate(zip(self.components, self.labels, strict=True)):
            keys: tuple[str | int, ...] = (entry.mux, label, *entry.names)
            for key in dict.fromkeys(keys):
                self._places.setdefault(key, []).append(position)
        self._fields: list[_Field] = []
        offset = 0
        for entry in self.entries:
            if not entry.is_dummy:
                self._fields.append(_field(entry, offset))
            offset += entry.bit_length
        self.layout = _layout(self.entries)
        # Takes the values out of a store at once; of a single one it would make no tuple
        self._values_of = itemgetter(*self.muxes) if len(self.muxes) > 1 else None

    @classmethod
    def from_description(cls, description: PdoDescription) -> Mapping:
        """Return the mapping for a line of PDOs.csv."""
        return cls(MappedEntry.of(entry) for entry in description.entries)

    @staticmethod
    def from_parameters(parameters: Iterable[int], dictionary: ObjectDictionary) -> Mapping:
        """Return the mapping for the values of sub 1, 2 ... of a mapping parameter. Raises MappingError."""
        known, key = _known(dictionary), tuple(parameters)
        mapping = known.get(key)
        if mapping is None:
            mapping = Mapping([MappedEntry.from_parameter(parameter, dictionary) for parameter in key])
            if len(known) >= _MOST_KNOWN:
                known.clear()
            known[key] = mapping
        return mapping

    @classmethod
    def from_values(cls, values: Values, index: int) -> Mapping:
        """Return the mapping at `index` (0x1600..0x17FF, 0x1A00..0x1BFF) of a device. Raises MappingError."""
        count = number_at(values.store, mux(index))
        if count > MAX_ENTRIES:
            raise MappingError(f"0x{index:04X}:00 = {count}: a PDO has {MAX_ENTRIES} entries at most")
        parameters = (number_at(values.store, mux(index, subindex)) for subindex in range(1, count + 1))
        return cls.from_parameters(parameters, values.dictionary)

    @property
    def parameters(self) -> tuple[int, ...]:
        """The entries as values of sub 1, 2 ... of a mapping parameter."""
        return tuple(entry.parameter for entry in self.entries)

    def find_component(self, key: Key) -> MappedEntry | None:
        """Return the entry of an object; None if the PDO does not carry it.

        key: a name or label, (index, subindex), a multiplexer, "6041:00", or an index alone. An index alone means subindex 0 if
        that is mapped, else the only mapped subindex. The first entry is returned if an object is mapped twice. Raises
        LocalProtocolError if a name or an index alone could mean several objects.
        """
        position = self.position_of(key)
        return None if position is None else self.components[position]

    def position_of(self, key: Key) -> int | None:
        """Return the position of an object among the components, or None. key, errors: as in `find_component`."""
        if isinstance(key, str):
            if key in self._places:
                return self._named(key)
            number = _NUMBER.fullmatch(key.strip())
            if number is None:
                return None
            index = int(number[1], 16)
            return self._of_index(index) if number[2] is None else self._of_mux(mux(index, int(number[2], 16)))
        if isinstance(key, int):
            return self._of_index(key) if key <= 0xFFFF else self._of_mux(Mux(key))
        index, subindex = (key.index, key.subindex) if isinstance(key, Variable) else key
        return self._of_mux(mux(index, subindex))

    def _named(self, name: str) -> int:
        places = self._places[name]
        labels = [self.labels[place] for place in places]
        if name not in labels and len({self.muxes[place] for place in places}) > 1:
            raise LocalProtocolError(f"this PDO maps several objects {name!r}: name one, as {labels[0]!r} ({', '.join(labels)})")
        return places[labels.index(name) if name in labels else 0]

    def _of_mux(self, mux: Mux) -> int | None:
        places = self._places.get(mux)
        return None if places is None else places[0]

    def _of_index(self, index: int) -> int | None:
        mapped = {subindex_of(mux) for mux in self.muxes if index_of(mux) == index}
        if 0 in mapped or not mapped:
            return self._of_mux(mux(index))
        if len(mapped) > 1:
            subindices = ", ".join(str(subindex) for subindex in sorted(mapped))
            raise LocalProtocolError(f"this PDO maps subindex {subindices} of 0x{index:04X}: name one, as (0x{index:04X}, 1)")
        return self._of_mux(mux(index, mapped.pop()))

    def unpack(self, data: bytes) -> tuple[Value, ...]:
        """Return the values of the components. Bytes after the mapped ones are ignored. data: of the frame.

        Raises ValueRangeError if there are too few bytes, or if a time of day in them has more milliseconds than a day.
        """
        if len(data) < self.byte_length:
            raise ValueRangeError(f"the mapping of this PDO has {self.byte_length} bytes, but only {len(data)} were received")
        if self.layout is not None:
            return self.layout.unpack_from(data)
        bits = int.from_bytes(data[: self.byte_length], "little")
        return tuple([field.read(bits) for field in self._fields])

    def unpack_into(self, store: dict[Mux, Value], data: bytes) -> tuple[Value, ...]:
        """Put the values into a store by mux, and return them. Errors are those of `unpack`; the store then stays as it was.
        data: of the frame."""
        layout = self.layout
        values = self.unpack(data) if layout is None or len(data) < self.byte_length else layout.unpack_from(data)
        muxes: tuple[Any, ...] = self.muxes  # Any: compiled, a number would be taken out of its object and put into a new one
        position = 0  # counted by hand in this hottest of paths: zip takes half as long again, and twice as long with strict=
        for each in muxes:
            store[each] = values[position]
            position += 1  # noqa: SIM113
        return values

    def pack(self, values: Sequence[Value]) -> bytes:
        """Return the PDO's bytes; dummies and unused bits are 0. values: of the components, in order.

        Raises ValueRangeError, which names the object, if a value does not fit; also for too few or too many values.
        """
        if self.layout is not None:
            try:
                return self.layout.pack(*values)
            except (struct.error, OverflowError):
                pass  # the fields below cut a value to its mapped width, or name the wrong one
        if len(values) != len(self._fields):
            raise ValueRangeError(f"this PDO has {len(self._fields)} components, but {len(values)} values were given")
        bits = 0
        for field, value in zip(self._fields, values, strict=True):
            bits |= field.write(value)
        return bits.to_bytes(self.byte_length, "little")

    def pack_from(self, store: ReadOnlyDict[Mux, Value]) -> bytes:
        """Return the PDO's bytes from a store by mux. A value that the store lacks counts as zero. Raises ValueRangeError."""
        values_of = self._values_of
        try:
            return self.pack([store[mux] for mux in self.muxes] if values_of is None else values_of(store))
        except KeyError:
            return self.pack([store.get(entry.mux, zero_of(entry.data_type)) for entry in self.components])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mapping) and self.entries == other.entries

    def __hash__(self) -> int:
        return hash(self.entries)

    def __repr__(self) -> str:
        return f"<Mapping {' '.join(f'{entry.name}/{entry.bit_length}' for entry in self.entries)}>"


def _labels(components: Sequence[MappedEntry]) -> tuple[str, ...]:
    """Return the labels of the components; see `Mapping`."""
    names = tuple(entry.name for entry in components)
    if len(set(names)) == len(names):
        return names
    shared = Counter(names)
    labels: dict[str, None] = {}
    for entry in components:
        place = f"{entry.index:04X}:{entry.subindex:02X}"
        label, number = (entry.name, 0) if shared[entry.name] == 1 else (place, 1)
        while label in labels:
            number += 1
            label = place if number == 1 else f"{place}#{number}"
        labels[label] = None
    return tuple(labels)


def entries_of(parameters: Iterable[int], dictionary: ObjectDictionary) -> Iterator[MappedEntry]:
    """Return the entries for the values of a device's mapping parameter. Raises MappingError.

    An object that the dictionary lacks counts as an unsigned number: the dictionary of a device that was read may be incomplete.
    """
    for parameter in parameters:
        index, subindex, bits = mapped(parameter)
        if index > LAST_DUMMY_INDEX and dictionary.get(index, subindex) is None and 0 < bits <= MAX_BITS:
            yield MappedEntry(index, subindex, bits, integer_type((bits + 7) // 8))
        else:
            yield MappedEntry.from_parameter(parameter, dictionary)


def may_have_width(data_type: DataType, bit_length: int) -> bool:
    """Return whether a PDO may carry an object of this type with so many bits; see this module's text. bit_length: how many."""
    if not 1 <= bit_length <= MAX_BITS:
        return False
    full = bit_length_of(data_type)
    if full is None:
        return bit_length % (16 if data_type == DataType.UNICODE_STRING else 8) == 0
    if data_type == DataType.BOOLEAN:
        return bit_length <= MAX_BOOLEAN_BITS
    return bit_length == full if data_type in _WHOLE else bit_length <= full


def number_at(store: ReadOnlyDict[Mux, Value], mux: Mux, default: int = 0) -> int:
    """Return the number at a mux, as PDO parameters are; `default` if there is no number.

    A negative one (if a file describes a parameter as INTEGERn) counts as the 32 bits that a client reads.
    """
    value = store.get(mux, default)
    if not isinstance(value, int):
        return default
    return value if value >= 0 else value & 0xFFFF_FFFF


DUMMY_TYPES: Final = {int(each): each for each in DataType if bit_length_of(each) is not None}
"""The data type of a dummy entry, by its index."""


def _dummy_type(filler: Filler) -> DataType:
    """Return the unsigned type with so many bits, or the next wider one."""
    if filler.bit_length == 1:
        return DataType.BOOLEAN
    try:
        return integer_type((filler.bit_length + 7) // 8)
    except KeyError:
        raise MappingError(f"filler {filler.name} has {filler.bit_length} bits; a PDO has at most {MAX_BITS}") from None


def _layout(entries: Sequence[MappedEntry]) -> struct.Struct | None:
    """Return the `struct` that packs all entries at once; None if `struct` has no format for one of them."""
    letters = "<"
    for entry in entries:
        if entry.is_dummy and entry.bit_length % 8 == 0:
            letters += f"{entry.bit_length // 8}x"
        elif is_integer(entry.data_type) and not entry.is_dummy and entry.bit_length in _ALIGNED:
            letter = _ALIGNED[entry.bit_length]
            letters += letter if is_signed(entry.data_type) else letter.upper()
        elif entry.data_type in (DataType.REAL32, DataType.REAL64) and not entry.is_dummy:
            letters += "f" if entry.data_type == DataType.REAL32 else "d"
        else:
            return None
    return struct.Struct(letters)


class _Field:
    """The place of one component in the PDO as one integer. This base handles types that are no numbers, by their bytes."""

    __slots__ = ("entry", "mask", "offset")

    def __init__(self, entry: MappedEntry, offset: int) -> None:
        self.entry = entry
        self.offset = offset
        self.mask = (1 << entry.bit_length) - 1

    def read(self, bits: int) -> Value:
        data = (bits >> self.offset & self.mask).to_bytes(self.entry.bit_length // 8, "little")
        return decode(data, self.entry.data_type, self.entry.name)

    def write(self, value: Value) -> int:
        """Return the value's bits at their place. A number is cut to the mapped bits of its two's complement."""
        data = encode(value, self.entry.data_type, self.entry.name)
        room = self.entry.bit_length // 8
        if bit_length_of(self.entry.data_type) is None and len(data) > room:
            raise ValueRangeError(f"{self.entry.name}: the value has {len(data)} bytes, but only {room} are mapped")
        return (int.from_bytes(data, "little") & self.mask) << self.offset


class _IntegerField(_Field):
    """sign: the highest mapped bit of a signed type, else 0. Flipping and subtracting it extends the sign."""

    __slots__ = ("sign",)

    def __init__(self, entry: MappedEntry, offset: int) -> None:
        super().__init__(entry, offset)
        self.sign = 1 << entry.bit_length - 1 if is_signed(entry.data_type) else 0

    def read(self, bits: int) -> int:
        return ((bits >> self.offset & self.mask) ^ self.sign) - self.sign


class _BooleanField(_Field):
    __slots__ = ()

    def read(self, bits: int) -> bool:
        return bits >> self.offset & self.mask != 0


@lru_cache(maxsize=32)
def _known(dictionary: ObjectDictionary) -> dict[tuple[int, ...], Mapping]:
    """Return the mappings of a dictionary that were made: all its devices map much the same, and again at each start."""
    return {}


def _field(entry: MappedEntry, offset: int) -> _Field:
    if entry.data_type == DataType.BOOLEAN:
        return _BooleanField(entry, offset)
    return _IntegerField(entry, offset) if is_integer(entry.data_type) else _Field(entry, offset)
