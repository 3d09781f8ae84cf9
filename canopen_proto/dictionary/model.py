"""The object dictionary as a description: the objects of a device, their names and their types.

An `Object` stands at an index (16 bits) and has one `Variable` per subindex (8 bits); CiA 301 v4.2.0, 7.4. SDO and PDO transfer
variables. A variable has names (aliases): "statusword" or, for a field of a record, "record:field". Names and numbers are equally
good keys; see `Key`. Files of CiA 306 and CiA 311 give a field only its own name ("COB-ID"), which many records have. Such a
field is also found as "record:field", and by its own name if no other record has that.

The product's own files (`canopen_data.csv`) add

- constants: named values of an object, each with a mask. A value bears a constant if `(value & mask) == constant`. One value may
  bear several constants, and one (mask, value) may have several names.
- PDO descriptions: the objects and fillers of one PDO, in order.
- pseudo objects, which have a name but no place in any device: `NMT` at index 0x0000, whose constants are the NMT commands.

A description never changes once it is made: six drives may share one. Each device has its own `values.Values`. `with_objects` and
`with_names_of` make a new description out of others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Final, NoReturn

from canopen_proto import indices
from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import DataType, Value, is_integer, is_signed
from canopen_proto.dictionary.objects import Access as Access
from canopen_proto.dictionary.objects import Key as Key
from canopen_proto.dictionary.objects import Object as Object
from canopen_proto.dictionary.objects import ObjectType as ObjectType
from canopen_proto.dictionary.objects import Variable as Variable
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import FIRST_MUX, Mux, index_of, mux, place_of


@mypyc_attr(native_class=False)
class NotInDictionaryError(LocalProtocolError, KeyError):
    """A name or number is not in the dictionary. The text suggests similar ones."""

    def __str__(self) -> str:  # KeyError would show its text in quotes
        return str(self.args[0])


@mypyc_attr(native_class=False)
class ObjectNotFoundError(NotInDictionaryError):
    """The dictionary has no such object, or no such subindex."""


@mypyc_attr(native_class=False)
class ConstantNotFoundError(NotInDictionaryError):
    """No such constant of this object."""


@mypyc_attr(native_class=False)
class PdoNotFoundError(NotInDictionaryError):
    """No such PDO description."""


class Direction(StrEnum):
    """The direction of a PDO, as the device sees it: it receives RPDOs and transmits TPDOs."""

    RPDO = "RPDO"
    TPDO = "TPDO"


@dataclass(frozen=True, slots=True)
class Constant:
    """A named value of an object. value: unsigned, as on the wire; only bits of the mask are set."""

    name: str
    mask: int
    value: int

    def is_in(self, value: int) -> bool:
        """Return whether a value bears this constant. A negative value counts as its two's complement."""
        return value & self.mask == self.value


@dataclass(frozen=True, slots=True)
class Filler:
    """Bits of a PDO without meaning: sent as 0, ignored when received. In a device they are a dummy entry."""

    name: str
    bit_length: int


@dataclass(frozen=True, slots=True)
class PdoDescription:
    """The objects that a PDO carries, lowest bits first.

    cob_base: the CAN-ID without the node-ID. number: 1..4 if cob_base is in the predefined connection set, else None.
    """

    name: str
    cob_base: int
    direction: Direction
    number: int | None
    entries: tuple[Variable | Filler, ...]

    @property
    def bit_length(self) -> int:
        """The bits of all entries together."""
        return sum(entry.bit_length or 0 for entry in self.entries)

    def can_id(self, node_id: int) -> int:
        """Return the CAN-ID of the PDO that this node receives or sends."""
        return self.cob_base + node_id


@dataclass(slots=True, unsafe_hash=True)  # not frozen: one is made for each value that is read
class Message:
    """One transferred value, with its node, the object's name and the constants that the value bears.

    timestamp: the transport's own clock; None if the transport gives none.
    """

    node_id: int
    name: str
    value: Value
    constants: tuple[str, ...] = ()
    timestamp: int | None = None

    def __str__(self) -> str:
        value = f"{self.value} (0x{self.value:X})" if isinstance(self.value, int) and self.value > 9 else repr(self.value)
        return f"node {self.node_id} {self.name} = {value}" + (f" [{', '.join(self.constants)}]" if self.constants else "")


PSEUDO_INDEX: Final = 0x0000
"""The index of pseudo objects, which are found by name only. CiA 301 v4.2.0, table 41, leaves this index unused."""

_NUMBER: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?:[:.](?:0[xX])?([0-9A-Fa-f]{1,2}))?")
MAX_NAME_COMPARED: Final = 100
"""Characters. No similar names are searched for a longer one: the time for it grows with the square of the length."""
_SEPARATORS: Final = re.compile(r"[\s_-]+")


class ObjectDictionary:
    """The objects of a device by number and by name, with constants and PDO descriptions. Never changes once made.

    Iteration gives all variables by index and subindex, without pseudo objects. source: the file's name, for error texts.
    """

    __slots__ = ("_by_mux", "_constants", "_fillers", "_names", "_pseudo", "objects", "pdos", "source")

    def __init__(
        self,
        objects: Iterable[Object],
        *,
        constants: Mapping[Mux, Sequence[Constant]] | None = None,
        pdos: Iterable[PdoDescription] = (),
        fillers: Iterable[Filler] = (),
        source: str = "",
    ) -> None:
        """constants: by mux. If two objects share an index, or two variables a name, the later one gets it; but a name that
        an object of a further logical device (0x6800 and on) shares with another one means the other. fillers: names for unused
        bits of a PDO."""
        by_index = {each.index: each for each in objects}
        self._pseudo = by_index.pop(PSEUDO_INDEX, None)
        self.objects: Mapping[int, Object] = MappingProxyType(dict(sorted(by_index.items())))
        by_mux = {variable.mux: variable for each in self.objects.values() for variable in each.variables.values()}
        if (keys := list(by_mux)) != (ordered := sorted(keys)):  # most files are in order, and sorting them is quick
            by_mux = {key: by_mux[key] for key in ordered}
        self._by_mux: dict[Mux, Variable] = by_mux
        self._names: _NameIndex | None = None
        self._constants = {key: tuple(each) for key, each in (constants or {}).items()}
        self.pdos: tuple[PdoDescription, ...] = tuple(pdos)
        self._fillers = {filler.name: filler for filler in fillers}
        self.source = source

    def _name_all(self) -> _NameIndex:
        """Collect the names when the first one is looked for: a caller that uses only numbers does not wait for them."""
        self._names = _NameIndex([*([self._pseudo] if self._pseudo else ()), *self.objects.values()])
        return self._names

    def get(self, index: int, subindex: int = 0) -> Variable | None:
        """Return the variable at index 0..0xFFFF, subindex 0..0xFF, or None. One dict look-up."""
        return self._by_mux.get(mux(index, subindex))

    def has_index(self, index: int) -> bool:
        """Return whether there is an object at this index. (A missing subindex and a missing object have different abort
        codes.)"""
        return index in self.objects

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._by_mux.values())

    def __len__(self) -> int:
        return len(self._by_mux)

    def __bool__(self) -> bool:  # an empty dictionary is a dictionary
        return True

    def __contains__(self, key: object) -> bool:
        try:
            self.variable(key)  # type: ignore[arg-type]
        except (NotInDictionaryError, TypeError):
            return False
        return True

    def variable(self, key: Key) -> Variable:
        """Return the variable that a key names; see `Key`.

        Text is tried as an exact name, then as a name with other case, spaces, hyphens or underscores, then as a number. Raises
        ObjectNotFoundError, whose text suggests similar names.
        """
        if isinstance(key, str):
            names = self._names or self._name_all()
            found = names.exact.get(key)  # nearly always enough
            return self._by_text(key, names) if found is None else found
        if isinstance(key, Variable):
            return key
        if isinstance(key, int):
            named = self._by_mux.get(key) if key >= FIRST_MUX else None  # type: ignore[call-overload]
            return self.at(*place_of(key)) if named is None else named
        return self.at(*key)

    def _by_text(self, text: str, names: _NameIndex) -> Variable:
        """Return the variable for a text that is no exact name. Raises ObjectNotFoundError."""
        found = names.folded.get(fold_name(text))
        if found is not None:
            return found
        number = _NUMBER.fullmatch(text.strip())
        if number is None:
            self._not_named(text, names)
        return self.at(int(number[1], 16), int(number[2] or "0", 16))

    def at(self, index: int, subindex: int) -> Variable:
        """Return the variable at an index and subindex. Raises ObjectNotFoundError, which lists the subindices; `get` returns
        None."""
        if 0 < index <= 0xFFFF and 0 <= subindex <= 0xFF:
            found = self._by_mux.get(mux(index, subindex))
            if found is not None:
                return found
        where = f"object 0x{index:04X}:{subindex:02X} is not in the dictionary{self._of_source()}"
        if index in self.objects:
            known = ", ".join(str(each) for each in sorted(self.objects[index].variables))
            raise ObjectNotFoundError(f"{where}; {self.objects[index].name} has subindex {known}")
        raise ObjectNotFoundError(where)

    def _not_named(self, name: str, names: _NameIndex) -> NoReturn:
        if name in self._fillers:
            raise ObjectNotFoundError(f"{name!r} is a filler of PDOs; it has no value")
        if name in names.shared:
            raise ObjectNotFoundError(
                f"{names.shared[name]} objects have a field {name!r}; say which one, as {names.example(name)!r}"
            )
        raise ObjectNotFoundError(f"object {name!r} is not in the dictionary{self._of_source()}{did_you_mean(name, names.exact)}")

    def _of_source(self) -> str:
        return f" ({self.source})" if self.source else ""

    def constants_of(self, key: Key) -> tuple[Constant, ...]:
        """Return the constants of an object, in the order of the file."""
        return self._constants.get(self.variable(key).mux, ())

    def constant(self, key: Key, name: str) -> Constant:
        """Return one constant of an object. Raises ConstantNotFoundError, whose text suggests similar names."""
        variable = self.variable(key)
        constants = self._constants.get(variable.mux, ())
        for each in constants:
            if each.name == name:
                return each
        near = did_you_mean(name, [each.name for each in constants])
        raise ConstantNotFoundError(f"{variable.label} has no constant {name!r}{near}")

    def constant_value(self, key: Key, name: str) -> int:
        """Return the number to write for a constant: negative if the object is signed and the constant's highest bit is set.
        name: of the constant."""
        variable = self.variable(key)
        value = self.constant(variable, name).value
        if is_signed(variable.data_type) and variable.bit_length is not None and value >> variable.bit_length - 1:
            return value - (1 << variable.bit_length)
        return value

    def matches(self, key: Key, constant_name: str, value: Value) -> bool:
        """Return whether a value bears a constant: `(value & mask) == constant`. Raises ConstantNotFoundError."""
        constant = self.constant(key, constant_name)
        return isinstance(value, int) and constant.is_in(value)

    def names_of(self, key: Key, value: Value) -> tuple[str, ...]:
        """Return the names of all constants that a value bears."""
        constants = self.constants_of(key)
        if not constants or not isinstance(value, int):
            return ()
        return tuple(constant.name for constant in constants if constant.is_in(value))

    def value_from(self, key: Key, value: Value) -> Value:
        """Return a value with a constant's name replaced by its number; any other value stays as it is.

        Text for an object that holds no text must be a constant: raises ConstantNotFoundError if it is none. Its text says which
        number may be meant, if the text is one.
        """
        if not isinstance(value, str):
            return value
        variable = self.variable(key)
        if variable.data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
            return value
        number = _number_in(value) if is_integer(variable.data_type) else None
        if number is not None and all(each.name != value for each in self.constants_of(variable)):
            what = f"{variable.label} has no constant {value!r}"
            raise ConstantNotFoundError(f"{what}: a number is expected; is {number} meant?")
        return self.constant_value(variable, value)

    @property
    def fillers(self) -> Mapping[str, Filler]:
        """The fillers that PDO descriptions may name."""
        return MappingProxyType(self._fillers)

    def pdo(self, name: str) -> PdoDescription:
        """Return a PDO description by its name. Raises PdoNotFoundError."""
        for each in self.pdos:
            if each.name == name:
                return each
        near = did_you_mean(name, [each.name for each in self.pdos])
        raise PdoNotFoundError(f"PDO {name!r} is not in the dictionary{self._of_source()}{near}")

    def message(self, node_id: int, key: Key, value: Value, timestamp: int | None = None) -> Message:
        """Return a Message for a transferred value. timestamp: as in Message."""
        variable = self.variable(key)
        return Message(node_id, variable.name, value, self.names_of(variable, value), timestamp)

    def with_objects(self, objects: Iterable[Object], source: str | None = None) -> ObjectDictionary:
        """Return this dictionary with more objects. A new object replaces the one that has its index. source: a new name for
        error texts; None: as before."""
        pseudo = [self._pseudo] if self._pseudo else []
        return ObjectDictionary(
            [*pseudo, *self.objects.values(), *objects],
            constants=self._constants,
            pdos=self.pdos,
            fillers=self._fillers.values(),
            source=self.source if source is None else source,
        )

    def with_names_of(self, other: ObjectDictionary) -> ObjectDictionary:
        """Return this dictionary with the names of another one: a device's EDS gets the aliases of the product's CSV files.

        Objects, types and access rights stay. Names, constants, pseudo objects and fillers of `other` are added; a constant of
        `other` replaces ours of the same name. A PDO description is taken over if this dictionary has all its objects, with the
        same lengths.
        """
        objects = [_renamed(each, other) for each in self.objects.values()]
        pseudo = other._pseudo or self._pseudo
        constants = dict(self._constants)
        for key, theirs in other._constants.items():
            if key in self._by_mux or index_of(key) == PSEUDO_INDEX:
                names = {constant.name for constant in theirs}
                constants[key] = (*theirs, *(own for own in constants.get(key, ()) if own.name not in names))
        fillers = self._fillers | other._fillers
        named = ObjectDictionary(
            [*([pseudo] if pseudo else []), *objects], constants=constants, fillers=fillers.values(), source=self.source
        )
        pdos = {pdo.name: pdo for pdo in (*self.pdos, *other.pdos)}
        named.pdos = tuple(moved for pdo in pdos.values() if (moved := named._own(pdo)) is not None)
        return named

    def _own(self, pdo: PdoDescription) -> PdoDescription | None:
        """Return the PDO with this dictionary's variables; None if one is missing or has another length."""
        entries: list[Variable | Filler] = []
        for entry in pdo.entries:
            ours = self._by_mux.get(entry.mux) if isinstance(entry, Variable) else entry
            if ours is None or ours.bit_length != entry.bit_length:
                return None
            entries.append(ours)
        return replace(pdo, entries=tuple(entries))


class _NameIndex:
    """The variables by name. exact: by the exact name. shared: field names of several records, and how many records."""

    __slots__ = ("exact", "folded", "shared")

    def __init__(self, objects: Iterable[Object]) -> None:
        self.exact: dict[str, Variable] = {}
        self.shared: dict[str, int] = {}
        fields: dict[str, Variable] = {}
        whole: dict[str, Variable] = {}
        for each in objects:
            alone = len(each.variables) == 1 and each.object_type not in WITH_FIELDS
            is_further = each.index in indices.FURTHER_DEVICES
            for variable in each.variables.values():
                for name in variable.names:
                    if is_further:  # a name that the first logical device has too means that one
                        self.exact.setdefault(name if alone or ":" in name else f"{each.name}:{name}", variable)
                        continue
                    if alone or ":" in name:
                        self.exact[name] = variable
                        continue
                    whole[f"{each.name}:{name}"] = variable
                    if fields.setdefault(name, variable).index != variable.index:
                        self.shared[name] = self.shared.get(name, 1) + 1
        for name, variable in whole.items():
            self.exact.setdefault(name, variable)
        for name, variable in fields.items():
            if name not in self.shared:
                self.exact.setdefault(name, variable)
        self.folded = {fold_name(name): variable for name, variable in self.exact.items()}

    def example(self, field: str) -> str:
        """Return one whole name ("record:field") of a field that several records have."""
        return next(name for name in self.exact if name.endswith(f":{field}"))


WITH_FIELDS: Final = (ObjectType.ARRAY, ObjectType.RECORD, ObjectType.DEFSTRUCT)


def _renamed(each: Object, other: ObjectDictionary) -> Object:
    variables = {}
    for subindex, variable in each.variables.items():
        theirs = other.get(each.index, subindex)
        if theirs is not None:
            new = [name for name in (*theirs.names, *variable.names) if name != theirs.name]
            variable = replace(variable, name=theirs.name, aliases=tuple(dict.fromkeys(new)))
        variables[subindex] = variable
    return replace(each, variables=MappingProxyType(variables))


def fold_name(name: str) -> str:
    """Return a name as all are compared: without regard to case, and with "_" for blanks and hyphens."""
    return _SEPARATORS.sub("_", name.strip()).casefold()


def _number_in(text: str) -> int | None:
    """Return the whole number that a text is, as 500, 0x1F4 or 007; None if it is none, or longer than a name."""
    if len(text) > MAX_NAME_COMPARED:
        return None
    for base in (0, 10):
        try:
            return int(text, base)
        except ValueError:  # in this base
            continue
    return None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of an error text: "; did you mean ...?" for names that hold this one as a word, and for similar ones; else
    all names if there are few, else "". known: the names that exist."""
    import difflib  # only a wrong name needs it

    if len(name) > MAX_NAME_COMPARED:
        return ""
    names = list(dict.fromkeys(known))
    whole = {each.casefold(): each for each in reversed(names)}
    fields = {each.casefold().rpartition(":")[2]: each for each in reversed(names)}
    own = name.casefold()
    holding = [
        each for each in map(str.casefold, names) if f"_{own}_" in f"_{each.replace(':', '_')}_"
    ]  # "position" is a word of these
    holding.sort(key=lambda each: not each.endswith("_actual_value"))
    alike = difflib.get_close_matches(own, [*whole, *fields], n=3, cutoff=0.6)
    near = list(dict.fromkeys([*holding[:2], *alike]))[:3]
    if near:
        return f"; did you mean {' or '.join(dict.fromkeys(whole.get(each) or fields[each] for each in near))}?"
    return f"; there are {', '.join(names)}" if 0 < len(names) <= 8 else ""
