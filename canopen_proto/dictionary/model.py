"""The object dictionary as a description: which objects a device has, what they are called, of which type they are.

Theory of operation
-------------------
An `Object` stands at an index (16 bits) and has one `Variable` per subindex (8 bits); CiA 301 v4.2.0, 7.4. A variable is what
SDO and PDO transfer. Variables carry names (aliases): "statusword" or, for a field of a record, "record:field". Names and
numbers are equally good keys; see `Key`. Files of CiA 306 and CiA 311 give the field its own name only ("COB-ID"), which many
records have: it is found as "record:field" too, and by its own name where no other field has that.

To that the product's own files (see csv.py) add

- constants: named values of an object, each with a mask. A value bears a constant when `(value & mask) == constant`; one value
  may bear several, and one (mask, value) may have several names.
- PDO descriptions: which objects one PDO carries in which order, some of them fillers.
- pseudo objects, which have a name but no place in any device: `NMT` at index 0x0000, whose constants are the NMT commands.

A description never changes once it is made: six drives may share one. What the objects *hold* is in `values.Values`, one for
each device. Making a new description out of others: `with_objects` and `with_names_of`.

What a file says of the device as a whole (vendor, bit rates, commissioning) is in `description.DeviceDescription`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Final, NoReturn

from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import DataType, Value, is_signed
from canopen_proto.dictionary.objects import Access, Key, Object, ObjectType, Variable
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux, index_of, mux, place_of

__all__ = [
    "Access",
    "Constant",
    "ConstantNotFound",
    "Direction",
    "Filler",
    "Key",
    "Message",
    "NotInDictionary",
    "Object",
    "ObjectDictionary",
    "ObjectNotFound",
    "ObjectType",
    "PdoDescription",
    "PdoNotFound",
    "Variable",
    "did_you_mean",
]


@mypyc_attr(native_class=False)
class NotInDictionary(LocalProtocolError, KeyError):
    """A name or number that the dictionary does not have; the text says which are near."""

    def __str__(self) -> str:  # KeyError would show its text in quotes
        return str(self.args[0])


@mypyc_attr(native_class=False)
class ObjectNotFound(NotInDictionary):
    """No such object or subindex."""


@mypyc_attr(native_class=False)
class ConstantNotFound(NotInDictionary):
    """No such constant of this object."""


@mypyc_attr(native_class=False)
class PdoNotFound(NotInDictionary):
    """No such PDO description."""


class Direction(StrEnum):
    """Of a PDO, as the device sees it: it receives RPDOs (master to device) and transmits TPDOs (device to master)."""

    RPDO = "RPDO"
    TPDO = "TPDO"


@dataclass(frozen=True, slots=True)
class Constant:
    """A named value of an object. value: as the wire has it (unsigned), only with bits of the mask."""

    name: str
    mask: int
    value: int

    def is_in(self, value: int) -> bool:
        """Whether a value bears this constant. A negative value counts as its two's complement."""
        return value & self.mask == self.value


@dataclass(frozen=True, slots=True)
class Filler:
    """Bits of a PDO that stand for nothing: sent as 0, ignored on receipt; in a device a dummy entry."""

    name: str
    bit_length: int


@dataclass(frozen=True, slots=True)
class PdoDescription:
    """Which objects a PDO carries, first bits first.

    cob_base: the node-ID is added to it. number: 1..4 where cob_base is of the predefined connection set, else None.
    """

    name: str
    cob_base: int
    direction: Direction
    number: int | None
    entries: tuple[Variable | Filler, ...]

    @property
    def bit_length(self) -> int:
        """Bits of all entries together."""
        return sum(entry.bit_length or 0 for entry in self.entries)

    def can_id(self, node_id: int) -> int:
        """The CAN-ID with which it is sent to or by that node."""
        return self.cob_base + node_id


@dataclass(slots=True, unsafe_hash=True)  # not frozen: one is made for each value that is read
class Message:
    """One object's value as it was transferred: of which node, its name, which constants the value bears, and when.

    timestamp: what the transport said (its own clock), None where it said nothing.
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
"""Index of pseudo objects; CiA 301 v4.2.0, table 41, keeps it unused. They are found by name only: no device has them."""

_NUMBER: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?:[:.](?:0[xX])?([0-9A-Fa-f]{1,2}))?")
MAX_NAME_COMPARED: Final = 100
"""Characters of a name for which near ones are sought: comparing takes time by the square of the length."""
_SEPARATORS: Final = re.compile(r"[\s_-]+")


class ObjectDictionary:
    """The objects of a device, by number and by name, with constants and PDO descriptions. Never changes once made.

    Iteration gives all variables by index and subindex, without pseudo objects. source: where it came from, for people.
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
        """constants: by mux. Where two objects share an index, or two variables a name, the later one wins it."""
        by_index = {each.index: each for each in objects}
        self._pseudo = by_index.pop(PSEUDO_INDEX, None)
        self.objects: Mapping[int, Object] = MappingProxyType(dict(sorted(by_index.items())))
        by_mux = {variable.mux: variable for each in self.objects.values() for variable in each.variables.values()}
        if (keys := list(by_mux)) != (ordered := sorted(keys)):  # they are in order in most files, and sorted soon then
            by_mux = {key: by_mux[key] for key in ordered}
        self._by_mux: dict[Mux, Variable] = by_mux
        self._names: _Names | None = None
        self._constants = {key: tuple(each) for key, each in (constants or {}).items()}
        self.pdos: tuple[PdoDescription, ...] = tuple(pdos)
        self._fillers = {filler.name: filler for filler in fillers}
        self.source = source

    def _name_all(self) -> _Names:
        """Take up the names when the first one is looked for: a caller that works with numbers need not wait for them."""
        self._names = _Names([*([self._pseudo] if self._pseudo else ()), *self.objects.values()])
        return self._names

    # ---- objects ----

    def get(self, index: int, subindex: int = 0) -> Variable | None:
        """The variable at index 0..0xFFFF, subindex 0..0xFF, or None. One dict look-up."""
        return self._by_mux.get(mux(index, subindex))

    def has_index(self, index: int) -> bool:
        """Whether there is an object at this index (then a missing subindex is another fault than a missing object)."""
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
        except (NotInDictionary, TypeError):
            return False
        return True

    def variable(self, key: Key) -> Variable:
        """The variable that a key names; see `Key`.

        A name counts before a number, and an exact name before one that differs in case, or in spaces, hyphens and underscores.
        Raises ObjectNotFound, whose text names near ones.
        """
        if isinstance(key, str):
            names = self._names or self._name_all()
            found = names.exact.get(key)  # nearly always: it costs one look-up
            return self._by_text(key, names) if found is None else found
        if isinstance(key, Variable):
            return key
        if isinstance(key, int):
            return self.at(*place_of(key))
        return self.at(*key)

    def _by_text(self, text: str, names: _Names) -> Variable:
        """What a text means that is not a name as it is spelt."""
        found = names.folded.get(_fold(text))
        if found is not None:
            return found
        number = _NUMBER.fullmatch(text.strip())
        if number is None:
            self._not_named(text, names)
        return self.at(int(number[1], 16), int(number[2] or "0", 16))

    def at(self, index: int, subindex: int) -> Variable:
        """The variable at an index and subindex. Raises ObjectNotFound, which says what there is; `get` gives None instead."""
        if 0 < index <= 0xFFFF and 0 <= subindex <= 0xFF:
            found = self._by_mux.get(mux(index, subindex))
            if found is not None:
                return found
        where = f"object 0x{index:04X}:{subindex:02X} is not in the dictionary{self._of_source()}"
        if index in self.objects:
            known = ", ".join(str(each) for each in sorted(self.objects[index].variables))
            raise ObjectNotFound(f"{where}; {self.objects[index].name} has subindex {known}")
        raise ObjectNotFound(where)

    def _not_named(self, name: str, names: _Names) -> NoReturn:
        if name in self._fillers:
            raise ObjectNotFound(f"{name!r} is a filler of PDOs; it has no value")
        if name in names.shared:
            raise ObjectNotFound(f"{names.shared[name]} objects have a field {name!r}; say which one, as {names.example(name)!r}")
        raise ObjectNotFound(f"object {name!r} is not in the dictionary{self._of_source()}{did_you_mean(name, names.exact)}")

    def _of_source(self) -> str:
        return f" ({self.source})" if self.source else ""

    # ---- constants ----

    def constants_of(self, key: Key) -> tuple[Constant, ...]:
        """The constants of an object, in the order of the file."""
        return self._constants.get(self.variable(key).mux, ())

    def constant(self, key: Key, name: str) -> Constant:
        """One constant. Raises ConstantNotFound, whose text names near ones."""
        variable = self.variable(key)
        constants = self._constants.get(variable.mux, ())
        for each in constants:
            if each.name == name:
                return each
        near = did_you_mean(name, [each.name for each in constants])
        raise ConstantNotFound(f"{variable.label} has no constant {name!r}{near}")

    def constant_value(self, key: Key, name: str) -> int:
        """What to write for a constant: its value, negative where the object is signed and the value's highest bit is set."""
        variable = self.variable(key)
        value = self.constant(variable, name).value
        if is_signed(variable.data_type) and variable.bit_length is not None and value >> variable.bit_length - 1:
            return value - (1 << variable.bit_length)
        return value

    def matches(self, key: Key, constant_name: str, value: Value) -> bool:
        """Whether a value bears a constant: `(value & mask) == constant`. Raises ConstantNotFound."""
        constant = self.constant(key, constant_name)
        return isinstance(value, int) and constant.is_in(value)

    def names_of(self, key: Key, value: Value) -> tuple[str, ...]:
        """The names of all constants that a value bears."""
        constants = self.constants_of(key)
        if not constants or not isinstance(value, int):
            return ()
        return tuple(constant.name for constant in constants if constant.is_in(value))

    def value_from(self, key: Key, value: Value) -> Value:
        """The value that a caller means: a constant's name becomes its value, anything else stays as it is.

        Text for an object that holds no text can only be a constant: raises ConstantNotFound where it is none.
        """
        if not isinstance(value, str):
            return value
        variable = self.variable(key)
        holds_text = variable.data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
        return value if holds_text else self.constant_value(variable, value)

    # ---- PDOs and messages ----

    @property
    def fillers(self) -> Mapping[str, Filler]:
        """The fillers that PDO descriptions may name."""
        return MappingProxyType(self._fillers)

    def pdo(self, name: str) -> PdoDescription:
        """A PDO description by name. Raises PdoNotFound."""
        for each in self.pdos:
            if each.name == name:
                return each
        near = did_you_mean(name, [each.name for each in self.pdos])
        raise PdoNotFound(f"PDO {name!r} is not in the dictionary{self._of_source()}{near}")

    def message(self, node_id: int, key: Key, value: Value, timestamp: int | None = None) -> Message:
        """A transferred value with its name and the constants that it bears."""
        variable = self.variable(key)
        return Message(node_id, variable.name, value, self.names_of(variable, value), timestamp)

    # ---- new dictionaries out of this one ----

    def with_objects(self, objects: Iterable[Object], source: str | None = None) -> ObjectDictionary:
        """This dictionary with more objects; one whose index it has already takes the place of the old one."""
        pseudo = [self._pseudo] if self._pseudo else []
        return ObjectDictionary(
            [*pseudo, *self.objects.values(), *objects],
            constants=self._constants,
            pdos=self.pdos,
            fillers=self._fillers.values(),
            source=self.source if source is None else source,
        )

    def with_names_of(self, other: ObjectDictionary) -> ObjectDictionary:
        """This dictionary, called by the names of another one.

        The objects, types and access rights stay; names, constants, pseudo objects and fillers of `other` come with them (its
        constants go before ours of the same name). Its PDO descriptions come where every entry is an object here too and is
        of the same length. This is how a device described by an EDS gets the aliases of the product's CSV files.
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
        """The same PDO of this dictionary's variables, or None where one is missing or of another length."""
        entries: list[Variable | Filler] = []
        for entry in pdo.entries:
            ours = self._by_mux.get(entry.mux) if isinstance(entry, Variable) else entry
            if ours is None or ours.bit_length != entry.bit_length:
                return None
            entries.append(ours)
        return replace(pdo, entries=tuple(entries))


class _Names:
    """What names stand for. exact: as they are spelt. shared: fields that several records have, and how many."""

    __slots__ = ("exact", "folded", "shared")

    def __init__(self, objects: Iterable[Object]) -> None:
        self.exact: dict[str, Variable] = {}
        self.shared: dict[str, int] = {}
        fields: dict[str, Variable] = {}
        whole: dict[str, Variable] = {}
        for each in objects:
            alone = len(each.variables) == 1 and each.object_type not in _WITH_FIELDS
            for variable in each.variables.values():
                for name in variable.names:
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
        self.folded = {_fold(name): variable for name, variable in self.exact.items()}

    def example(self, field: str) -> str:
        """One of the whole names of a field that several records have."""
        return next(name for name in self.exact if name.endswith(f":{field}"))


_WITH_FIELDS: Final = (ObjectType.ARRAY, ObjectType.RECORD, ObjectType.DEFSTRUCT)


def _renamed(each: Object, other: ObjectDictionary) -> Object:
    variables = {}
    for subindex, variable in each.variables.items():
        theirs = other.get(each.index, subindex)
        if theirs is not None:
            new = [name for name in (*theirs.names, *variable.names) if name != theirs.name]
            variable = replace(variable, name=theirs.name, aliases=tuple(dict.fromkeys(new)))
        variables[subindex] = variable
    return replace(each, variables=MappingProxyType(variables))


def _fold(name: str) -> str:
    return _SEPARATORS.sub("_", name.strip()).casefold()


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """ "; did you mean ...?" where something is near, else what there is where that is little, else nothing."""
    import difflib  # only here, for a name that is not there

    if len(name) > MAX_NAME_COMPARED:
        return ""
    names = list(dict.fromkeys(known))
    whole = {each.casefold(): each for each in reversed(names)}
    fields = {each.casefold().rpartition(":")[2]: each for each in reversed(names)}
    near = difflib.get_close_matches(name.casefold(), [*whole, *fields], n=3, cutoff=0.6)
    if near:
        return f"; did you mean {' or '.join(dict.fromkeys(whole.get(each) or fields[each] for each in near))}?"
    return f"; there are {', '.join(names)}" if 0 < len(names) <= 8 else ""
