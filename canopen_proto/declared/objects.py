"""The objects in the class of a device: `variable` and `array`.

In the class, a declaration stands for its objects: it goes into PDOs, and its decorators `check`, `on_write` and `on_read` name
the methods that serve it. In a device, it is the value: `self.filter_time`, `self.inputs[1]`. Setting a value that differs from
the present one sends the event-driven TPDOs that carry it; it may be set whatever the access right says, as the device's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, Generic, Literal, Never, Protocol, Self, TypeAlias, TypedDict, TypeVar, Unpack, cast, overload

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.objects import Access, ObjectType, Variable
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import LocalProtocolError

T = TypeVar("T", bound=Value)
F = TypeVar("F", bound=Callable[..., object])

HIGHEST_SUBINDEX: Final = "Highest sub-index supported"
MAX_ENTRIES: Final = 0xFE
"""Of an array. Subindex 0xFF is the structure of an object (CiA 301 v4.2.0, 7.4.5)."""

IntegerType: TypeAlias = Literal[
    DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER24, DataType.INTEGER32, DataType.INTEGER40, DataType.INTEGER48,
    DataType.INTEGER56, DataType.INTEGER64, DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED24, DataType.UNSIGNED32,
    DataType.UNSIGNED40, DataType.UNSIGNED48, DataType.UNSIGNED56, DataType.UNSIGNED64,
]  # fmt: skip
RealType: TypeAlias = Literal[DataType.REAL32, DataType.REAL64]
TextType: TypeAlias = Literal[DataType.VISIBLE_STRING, DataType.UNICODE_STRING]
BytesType: TypeAlias = Literal[DataType.OCTET_STRING, DataType.DOMAIN]


class Facts(TypedDict, total=False):
    """What may be said of a variable, as in `Variable`: access by SDO (RW if not said), limits of a write, unit and factor of the
    value, a description for people. pdo: a PDO may carry it; not said: only if access is RWR (a TPDO) or RWW (an RPDO)."""

    access: Access
    pdo: bool
    low_limit: float
    high_limit: float
    unit: str
    factor: float
    description: str


class Holder(Protocol):
    """A device, as its objects need it: where their values are, and how one is set."""

    node: LocalNode

    def set_value(self, variable: Variable, value: Value) -> None: ...


class Declared:
    """What `variable` and `array` have in common: variables of one index, and the names of the methods that serve them.

    record: the name of the whole object. An overridden method counts, so they are kept by name.
    """

    def __init__(self, record: str, variables: Sequence[Variable], object_type: ObjectType) -> None:
        self.record = record
        self.variables = tuple(variables)
        self.object_type = object_type
        self.checks = self.acts = self.reads = ""

    @property
    def index(self) -> int:
        """The index of the object."""
        return self.variables[0].index

    def check(self, function: F) -> F:
        """Ask this method before a client's value is stored; type and limits are right already. It returns None, or the abort
        code that refuses the value, and changes nothing. A PDO cannot be refused: it is not asked then."""
        self.checks = function.__name__
        return function

    def on_write(self, function: F) -> F:
        """Call this method when a client has written a value, by SDO or PDO. It is stored already.

        If it returns an abort code, or raises, an SDO client gets that code (0x08000020), and the object has the value from
        before again. A PDO has no answer: its value stays."""
        self.acts = function.__name__
        return function

    def on_read(self, function: F) -> F:
        """Ask this method for the value before a client reads it; if a PDO may carry it, also before each TPDO that is sent by
        SYNC, event timer or remote request. It returns the value, which is stored, or the abort code that refuses the read."""
        self.reads = function.__name__
        return function

    def serves(self, variable: Variable) -> bool:
        """Return whether its methods are for this one of its variables: not for the number of entries of an array."""
        return self.object_type is not ObjectType.ARRAY or variable.subindex > 0

    def arguments_for(self, subindex: int) -> tuple[int, ...]:
        """Return what its methods get before the value."""
        return ()


class DeclaredVariable(Declared, Generic[T]):
    """A variable of a device. Its methods: `check(self, value)`, `on_write(self, value)`, `on_read(self)`."""

    @overload
    def __get__(self, device: None, owner: type[Holder]) -> Self: ...
    @overload
    def __get__(self, device: Holder, owner: type[Holder]) -> T: ...
    def __get__(self, device: Holder | None, owner: type[Holder]) -> Self | T:
        return self if device is None else cast(T, device.node.values.store[self.variables[0].mux])

    def __set__(self, device: Holder, value: T) -> None:
        device.set_value(self.variables[0], value)


class DeclaredArray(Declared, Generic[T]):
    """An array of a device. Its methods get the subindex first: `check(self, subindex, value)`, `on_read(self, subindex)`.

    In the class, `outputs[1]` is one entry of it, for a PDO.
    """

    def __getitem__(self, subindex: int) -> Variable:
        return self.variables[subindex]

    @overload
    def __get__(self, device: None, owner: type[Holder]) -> Self: ...
    @overload
    def __get__(self, device: Holder, owner: type[Holder]) -> Entries[T]: ...
    def __get__(self, device: Holder | None, owner: type[Holder]) -> Self | Entries[T]:
        return self if device is None else Entries(device, self)

    def __set__(self, device: Holder, value: Never) -> None:
        raise AttributeError(f"{self.record} is an array: set its values, such as [1], one by one")

    def arguments_for(self, subindex: int) -> tuple[int, ...]:
        return (subindex,)


class Entries(Generic[T]):
    """The values of an array of a device, by subindex from 1 on. Iteration gives the values in order."""

    __slots__ = ("_device", "_variables")

    def __init__(self, device: Holder, declared: DeclaredArray[T]) -> None:
        self._device = device
        self._variables = declared.variables

    def __len__(self) -> int:
        return len(self._variables) - 1

    def __iter__(self) -> Iterator[T]:
        return (self[subindex] for subindex in range(1, len(self._variables)))

    def __getitem__(self, subindex: int) -> T:
        return cast(T, self._device.node.values.store[self._variable(subindex).mux])

    def __setitem__(self, subindex: int, value: T) -> None:
        self._device.set_value(self._variable(subindex), value)

    def _variable(self, subindex: int) -> Variable:
        if not 1 <= subindex < len(self._variables):
            raise IndexError(f"{self._variables[0].label}: subindex {subindex} is outside 1..{len(self)}")
        return self._variables[subindex]


def _make(place: tuple[int, int], name: str, data_type: DataType, default: Any, facts: Facts) -> Variable:
    access = facts.get("access", Access.RW)
    variable = Variable(
        *place,
        name,
        data_type,
        access,
        default,
        facts.get("low_limit"),
        facts.get("high_limit"),
        facts.get("pdo", access in (Access.RWR, Access.RWW)),
        unit=facts.get("unit", ""),
        factor=facts.get("factor", 1.0),
        description=facts.get("description", ""),
    )
    initial = variable.initial_of(0)
    variable.encode(initial)
    variable.check_limits(initial)
    return variable


Names: TypeAlias = int | Sequence[str]
"""The entries of an array: how many, or their names."""
Place: TypeAlias = int | tuple[int, int]
"""An index, or an index and a subindex from 1 on: a field of a record, whose name is then "record:field"."""


@overload
def variable(
    place: Place, name: str, data_type: IntegerType, default: int | None = None, **facts: Unpack[Facts]
) -> DeclaredVariable[int]: ...
@overload
def variable(
    place: Place, name: str, data_type: RealType, default: float | None = None, **facts: Unpack[Facts]
) -> DeclaredVariable[float]: ...
@overload
def variable(
    place: Place, name: str, data_type: TextType, default: str | None = None, **facts: Unpack[Facts]
) -> DeclaredVariable[str]: ...
@overload
def variable(
    place: Place, name: str, data_type: BytesType, default: bytes | None = None, **facts: Unpack[Facts]
) -> DeclaredVariable[bytes]: ...
@overload
def variable(
    place: Place, name: str, data_type: Literal[DataType.BOOLEAN], default: bool | None = None, **facts: Unpack[Facts]
) -> DeclaredVariable[bool]: ...
def variable(place: Place, name: str, data_type: DataType, default: Any = None, **facts: Unpack[Facts]) -> DeclaredVariable[Any]:
    """Declare an object with one value, or a field of a record: `variable((0x2100, 1), "Sensor:Temperature", DataType.REAL32)`.

    place: from 0x2000 on; the communication objects are made by the device itself. name: for people, and in the file. default:
    the value after power-on; None = 0, or empty. facts: see `Facts`.

    Raises ValueRangeError if the default does not fit type and limits, LocalProtocolError for another place or name.
    """
    index, subindex = place if isinstance(place, tuple) else (place, 0)
    _check_index(index)
    record, colon, field = name.partition(":")
    if bool(colon) != (subindex in range(1, MAX_ENTRIES + 1)) or not record or (colon and not field):
        where = f"0x{index:04X}:{subindex:02X} {name!r}"
        raise LocalProtocolError(f'{where}: a field of a record has subindex 1..254 and a name "record:field", others neither')
    object_type = ObjectType.RECORD if subindex else ObjectType.DOMAIN if data_type is DataType.DOMAIN else ObjectType.VAR
    return DeclaredVariable(record, [_make((index, subindex), field or name, data_type, default, facts)], object_type)


@overload
def array(
    index: int, name: str, data_type: IntegerType, entries: Names, default: int | None = None, **facts: Unpack[Facts]
) -> DeclaredArray[int]: ...
@overload
def array(
    index: int, name: str, data_type: RealType, entries: Names, default: float | None = None, **facts: Unpack[Facts]
) -> DeclaredArray[float]: ...
@overload
def array(
    index: int, name: str, data_type: TextType, entries: Names, default: str | None = None, **facts: Unpack[Facts]
) -> DeclaredArray[str]: ...
@overload
def array(
    index: int, name: str, data_type: BytesType, entries: Names, default: bytes | None = None, **facts: Unpack[Facts]
) -> DeclaredArray[bytes]: ...
@overload
def array(
    index: int,
    name: str,
    data_type: Literal[DataType.BOOLEAN],
    entries: Names,
    default: bool | None = None,
    **facts: Unpack[Facts],
) -> DeclaredArray[bool]: ...
def array(
    index: int, name: str, data_type: DataType, entries: Names, default: Any = None, **facts: Unpack[Facts]
) -> DeclaredArray[Any]:
    """Declare an array of 1 to 254 values of one type. entries: how many, or their names. default: of each entry.

    The other parameters, and the errors: as of `variable`.
    """
    _check_index(index)
    names = [f"{name} {number}" for number in range(1, entries + 1)] if isinstance(entries, int) else list(entries)
    if not 1 <= len(names) <= MAX_ENTRIES:
        raise LocalProtocolError(f"0x{index:04X} {name!r} has {len(names)} entries; an array has 1..{MAX_ENTRIES}")
    variables = [_make((index, subindex), each, data_type, default, facts) for subindex, each in enumerate(names, start=1)]
    return DeclaredArray(name, [highest_subindex(index, len(names)), *variables], ObjectType.ARRAY)


def highest_subindex(index: int, highest: int) -> Variable:
    """Return subindex 0 of an array or record."""
    return Variable(index, 0, HIGHEST_SUBINDEX, DataType.UNSIGNED8, Access.CONST, highest)


def _check_index(index: int) -> None:
    if not 0x2000 <= index <= 0x9FFF:
        raise LocalProtocolError(f"0x{index:04X}: a device declares objects at 0x2000..0x9FFF; those below are `standard`")
