"""What the bits of a PDO mean: mapped objects, first bits first.

Theory of operation
-------------------
A PDO has no header: both sides know by the PDO mapping parameter (0x1600.., 0x1A00..) which objects its up to 64 bits carry.
Each entry names an object and a length in bits; entries follow one another without gaps, from the least significant bit of the
first byte on, numbers least significant bit first (CiA 301 v4.2.0, 7.4.7.1 and 7.1.4). So the whole PDO is one little-endian
integer, and an entry is `integer >> offset & mask`: any offset, any width, across byte limits too. Where every entry stands on
bytes and has the width of a C type, a precompiled `struct` does the same in one call.

- A number mapped with fewer bits than its type has gives and takes just these bits, the lowest; a signed one is extended by the
  highest of them. More bits than the type has are refused.
- A BOOLEAN is one bit. Devices that know only bytes map it with up to 8; then any of them makes it true.
- REAL32, REAL64 and the times are mapped whole; strings and DOMAIN by whole bytes (16 bits for UNICODE_STRING), shorter text
  is filled up with NULs, and what comes keeps its NULs.
- Dummy entries have the code of a data type for their index (0x0001..0x001B). They are space: sent as 0, ignored on receipt,
  and no component of the PDO. The fillers of PDO descriptions (`notused16`) become dummy entries.

Values are those of `Values.store` (mux -> Python value), read and written here directly: a PDO and the dictionary are one
memory. Range limits of objects are not looked at: the standard gives a PDO no way to refuse a value.

Multiplexed PDOs (sub 0 = 0xFE and 0xFF) have no mapping: multiplexed.py.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Mapping as ReadOnlyDict
from typing import Final

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
"""Sub 0 of a mapping parameter counts to 0x40: 64 single bits (CiA 301 v4.2.0, 7.5.2.36)."""

LAST_DUMMY_INDEX: Final = 0x001B
"""UNSIGNED64, the last data type code with a fixed width."""

MAX_BOOLEAN_BITS: Final = 8

_ALIGNED: Final = {8: "b", 16: "h", 32: "i", 64: "q"}  # struct's letters by width; in upper case they are unsigned
_WHOLE: Final = (DataType.REAL32, DataType.REAL64, DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)
_NUMBER = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?:[:.](?:0[xX])?([0-9A-Fa-f]{1,2}))?")


@mypyc_attr(native_class=False)
class MappingError(LocalProtocolError, ValueError):
    """These entries cannot make a PDO; the text says which one and why."""


class MappedEntry:
    """One object of a PDO, or a dummy entry. Never changed after it was made.

    bit_length: bits in the PDO. data_type: of the object; of a dummy, what its index says. names: the object's names, the first
    of which is `name`. Raises MappingError where that type cannot have that width in a PDO.
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
        """The entry for a variable in its full width, or for a filler. Raises MappingError (a string has no width of its own)."""
        if isinstance(entry, Variable):
            return cls(entry.index, entry.subindex, entry.bit_length or 0, entry.data_type, *entry.names)
        data_type = _dummy_type(entry)
        return cls(int(data_type), 0, entry.bit_length, data_type, entry.name)

    @classmethod
    def from_parameter(cls, parameter: int, dictionary: ObjectDictionary) -> MappedEntry:
        """The entry that a value of 0x1600:01 and the like stands for. Raises MappingError: no such object, or not so wide."""
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
        """The first of its names; "0x6041:00" where it has none."""
        return self.names[0]

    @property
    def parameter(self) -> int:
        """The entry as it stands in a mapping parameter: index << 16 | subindex << 8 | bits."""
        return mapping_entry(self.mux, self.bit_length)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MappedEntry) and self.parameter == other.parameter and self.data_type == other.data_type

    def __hash__(self) -> int:
        return hash(self.parameter)

    def __repr__(self) -> str:
        return f"<{self.name} {self.index:04X}{self.subindex:02X}{self.bit_length:02X}>"


class Mapping:
    """The entries of one PDO, and how its bytes become values and values its bytes. Never changes after it was made.

    entries: all of them. components: those that carry a value, dummies left out; `unpack` and `pack` speak of these, in this
    order; muxes: theirs. labels: what each component is called here, no two alike: the name of its object, or "6401:01" where
    several components have that name, or "6401:01#2" for an object that is mapped a second time. Raises MappingError for more
    than 64 bits.
    """

    __slots__ = ("_fields", "_layout", "_places", "bit_length", "byte_length", "components", "entries", "labels", "muxes")

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
        self._places: dict[
            str | int, list[int]
        ] = {}  # by mux, label and name: positions among the components, the first one first
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
        self._layout = _layout(self.entries)

    @classmethod
    def from_description(cls, description: PdoDescription) -> Mapping:
        """The mapping that a line of PDOs.csv describes."""
        return cls(MappedEntry.of(entry) for entry in description.entries)

    @classmethod
    def from_parameters(cls, parameters: Iterable[int], dictionary: ObjectDictionary) -> Mapping:
        """The mapping of these values of sub 1, 2 ... of a mapping parameter. Raises MappingError."""
        return cls(MappedEntry.from_parameter(parameter, dictionary) for parameter in parameters)

    @classmethod
    def from_values(cls, values: Values, index: int) -> Mapping:
        """The mapping that stands at `index` (0x1600..0x17FF, 0x1A00..0x1BFF) of a device. Raises MappingError."""
        count = number_at(values.store, mux(index))
        if count > MAX_ENTRIES:
            raise MappingError(f"0x{index:04X}:00 = {count}: a PDO has {MAX_ENTRIES} entries at most")
        parameters = (number_at(values.store, mux(index, subindex)) for subindex in range(1, count + 1))
        return cls.from_parameters(parameters, values.dictionary)

    @property
    def parameters(self) -> tuple[int, ...]:
        """The entries as they stand in sub 1, 2 ... of a mapping parameter."""
        return tuple(entry.parameter for entry in self.entries)

    def find_component(self, key: Key) -> MappedEntry | None:
        """Whether the PDO carries an object: its entry, or None.

        key: a name or label, (index, subindex), a multiplexer, "6041:00", or an index alone, which stands for subindex 0 or else
        for the only mapped subindex of that index. Of an object that is mapped twice, the first one is found. Raises
        LocalProtocolError where a name or an index alone could mean several objects: picking one would be a guess.
        """
        position = self.position_of(key)
        return None if position is None else self.components[position]

    def position_of(self, key: Key) -> int | None:
        """The place of an object among the components, or None. key and errors: as `find_component`."""
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

    # ---- bytes -> values ----

    def unpack(self, data: bytes) -> tuple[Value, ...]:
        """The values of the components. Bytes beyond the mapping are ignored.

        Raises ValueRangeError where data is too short, or a time of day in it has more milliseconds than a day.
        """
        if len(data) < self.byte_length:
            raise ValueRangeError(f"a PDO of {self.byte_length} bytes is mapped, {len(data)} bytes came")
        if self._layout is not None:
            return self._layout.unpack_from(data)
        bits = int.from_bytes(data[: self.byte_length], "little")
        return tuple([field.read(bits) for field in self._fields])

    def unpack_into(self, store: dict[Mux, Value], data: bytes) -> tuple[Value, ...]:
        """Put the values into a store by mux, and return them too. Raises as `unpack` does; then the store is as it was."""
        values = self.unpack(data)
        position = 0  # counted by hand: in this hottest of paths zip would take half as long again, with strict= twice
        for each in self.muxes:
            store[each] = values[position]
            position += 1  # noqa: SIM113
        return values

    # ---- values -> bytes ----

    def pack(self, values: Sequence[Value]) -> bytes:
        """The PDO's bytes; dummies and unused bits are 0. values: of the components, in their order.

        Raises ValueRangeError that names the object which a value does not fit, or when there are too few or too many of them.
        """
        if self._layout is not None:
            try:
                return self._layout.pack(*values)
            except (struct.error, OverflowError):
                pass  # a value that its type can hold may need cutting to the mapped width; or it is wrong, then this names it
        if len(values) != len(self._fields):
            raise ValueRangeError(f"a PDO with {len(self._fields)} components is mapped, {len(values)} values were given")
        bits = 0
        for field, value in zip(self._fields, values, strict=True):
            bits |= field.write(value)
        return bits.to_bytes(self.byte_length, "little")

    def pack_from(self, store: ReadOnlyDict[Mux, Value]) -> bytes:
        """The PDO's bytes from a store by mux; what it does not hold counts as zero. Raises ValueRangeError as `pack` does."""
        try:
            return self.pack([store[mux] for mux in self.muxes])
        except KeyError:
            return self.pack([store.get(entry.mux, zero_of(entry.data_type)) for entry in self.components])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mapping) and self.entries == other.entries

    def __hash__(self) -> int:
        return hash(self.entries)

    def __repr__(self) -> str:
        return f"<Mapping {' '.join(f'{entry.name}/{entry.bit_length}' for entry in self.entries)}>"


def _labels(components: Sequence[MappedEntry]) -> tuple[str, ...]:
    """See `Mapping.labels`."""
    shared = Counter(entry.name for entry in components)
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
    """The entries that a device's mapping parameter stands for. An object that the dictionary lacks is an unsigned number.

    For code that reads what a device does, even if the dictionary is not complete. Raises MappingError.
    """
    for parameter in parameters:
        index, subindex, bits = mapped(parameter)
        if index > LAST_DUMMY_INDEX and dictionary.get(index, subindex) is None and 0 < bits <= MAX_BITS:
            yield MappedEntry(index, subindex, bits, integer_type((bits + 7) // 8))
        else:
            yield MappedEntry.from_parameter(parameter, dictionary)


def may_have_width(data_type: DataType, bit_length: int) -> bool:
    """Whether a PDO may carry an object of that type with that many bits; see this module's text."""
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

    A negative one (a file describes a parameter as INTEGERn) counts as the 32 bits that a client reads.
    """
    value = store.get(mux, default)
    if not isinstance(value, int):
        return default
    return value if value >= 0 else value & 0xFFFF_FFFF


DUMMY_TYPES: Final = {int(each): each for each in DataType if bit_length_of(each) is not None}
"""What a dummy entry may have for its index."""


def _dummy_type(filler: Filler) -> DataType:
    """The unsigned type for that many bits, or the next wider one."""
    if filler.bit_length == 1:
        return DataType.BOOLEAN
    try:
        return integer_type((filler.bit_length + 7) // 8)
    except KeyError:
        raise MappingError(f"filler {filler.name} has {filler.bit_length} bits; a PDO has {MAX_BITS}") from None


def _layout(entries: Sequence[MappedEntry]) -> struct.Struct | None:
    """The `struct` that does the same as the fields, or None where something in the PDO has no letter there."""
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
    """Where one component stands in the PDO taken as one integer; read and written as an unsigned number or as bytes."""

    __slots__ = ("entry", "mask", "offset")

    def __init__(self, entry: MappedEntry, offset: int) -> None:
        self.entry = entry
        self.offset = offset
        self.mask = (1 << entry.bit_length) - 1

    def read(self, bits: int) -> Value:
        data = (bits >> self.offset & self.mask).to_bytes(self.entry.bit_length // 8, "little")
        return decode(data, self.entry.data_type, self.entry.name)

    def write(self, value: Value) -> int:
        """The value's bits, in their place. A signed number is cut as its two's complement."""
        data = encode(value, self.entry.data_type, self.entry.name)
        if bit_length_of(self.entry.data_type) is None and len(data) * 8 > self.entry.bit_length:
            raise ValueRangeError(f"{self.entry.name}: {self.entry.bit_length // 8} bytes are mapped, the value has {len(data)}")
        return (int.from_bytes(data, "little") & self.mask) << self.offset


class _IntegerField(_Field):
    """sign: the highest of its bits for signed types, else 0; adding and taking it away again extends the sign."""

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


def _field(entry: MappedEntry, offset: int) -> _Field:
    if entry.data_type == DataType.BOOLEAN:
        return _BooleanField(entry, offset)
    return _IntegerField(entry, offset) if is_integer(entry.data_type) else _Field(entry, offset)
