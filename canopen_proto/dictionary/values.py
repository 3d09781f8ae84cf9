"""The values of one device's objects.

An `ObjectDictionary` describes and never changes; `Values` is one device's memory for it. SDO and PDO read and write the same
`Values`: a device's dictionary and its PDOs are one memory. It holds Python values, not bytes: a received PDO is unpacked once
and read often.

`store` is public on purpose: hot paths (PDO, the simulated drive) read and write it directly, by mux and without any check.
Values from outside pass `write` (our own caller) or the SDO server's checks (a peer).

`Values` does not check access rights: a device writes its own read-only objects. It keeps no history and reports no changes; the
node that owns it lets a write take effect.

A description may give an object a value that its type cannot hold: the EDS is wrong, or adding the node-ID overflows the type.
The object then starts with a value from `nearest`, so that it can be read, and `unfit` lists it.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from canopen_proto.datatypes import DataType, Value, ValueRangeError, zero_of
from canopen_proto.dictionary.model import Key, ObjectDictionary, ObjectNotFoundError, Variable
from canopen_proto.multiplexer import Mux, mux_text


class Values:
    """The memory of one device. node_id: added to the defaults that depend on it.

    store: the value of every variable of the dictionary, by mux. unfit: the variables whose type cannot hold their initial value.
    """

    __slots__ = ("dictionary", "node_id", "store", "unfit")

    def __init__(self, dictionary: ObjectDictionary, node_id: int = 0) -> None:
        self.dictionary = dictionary
        self.node_id = node_id
        initial, dependent, unfit = _initial(dictionary)
        self.store: dict[Mux, Value] = initial.copy()
        for variable in dependent:
            self.store[variable.mux] = variable.initial_of(node_id)
        self.unfit = _unfit(dependent, node_id, unfit)
        self._mend()

    def __getitem__(self, mux: Mux) -> Value:
        """Return the value at a mux. Raises KeyError if the dictionary has no such object."""
        return self.store[mux]

    def __setitem__(self, mux: Mux, value: Value) -> None:
        """Set the value at a mux, without checking it. Raises KeyError if the dictionary has no such object."""
        if mux not in self.store:
            raise ObjectNotFoundError(f"object {mux_text(mux)} is not in the dictionary")
        self.store[mux] = value

    def read(self, key: Key) -> Value:
        """Return the value of an object. Raises ObjectNotFoundError."""
        return self.store[self._held(key).mux]

    def write(self, key: Key, value: Value) -> None:
        """Set the value of an object. A constant's name stands for its value.

        Raises ObjectNotFoundError, ConstantNotFoundError, or ValueRangeError if the value does not fit the type or the limits.
        The old value then stays.
        """
        variable = self._held(key)
        value = self.dictionary.value_from(variable, value)
        variable.encode(value)
        variable.check_limits(value)
        self.store[variable.mux] = value

    def raw(self, index: int, subindex: int = 0) -> bytes:
        """Return the bytes of an object as SDO carries them. Raises ObjectNotFoundError."""
        variable = self._held((index, subindex))
        return variable.encode(self.store[variable.mux])

    def reset(self, first_index: int = 0, last_index: int = 0xFFFF) -> None:
        """Put the defaults back, in all objects from first_index to last_index: what an NMT reset does.

        0x1000..0x1FFF is the communication profile area (reset communication). Source: CiA 301 v4.2.0, 7.3.2.2.1.
        """
        for variable in self.dictionary:
            if first_index <= variable.index <= last_index:
                self.store[variable.mux] = variable.initial_of(self.node_id)
        self._mend(first_index, last_index)

    def set_node_id(self, node_id: int) -> dict[Mux, tuple[Value, Value]]:
        """Take another node-ID. Initial values that depend on it follow, as far as they have not been changed since.

        Returns the old and the new initial value of all that depend on it, by mux.
        """
        old_id, self.node_id = self.node_id, node_id
        moved: dict[Mux, tuple[Value, Value]] = {}
        _, dependent, unfit = _initial(self.dictionary)
        for variable in dependent:
            old, new = (_fitting(variable, variable.initial_of(each)) for each in (old_id, node_id))
            moved[variable.mux] = old, new
            if self.store[variable.mux] == old:
                self.store[variable.mux] = new
        self.unfit = _unfit(dependent, node_id, unfit)
        return moved

    def put_default(self, variable: Variable) -> None:
        """Set an object to its default, even if a DCF has configured another value."""
        self.store[variable.mux] = _fitting(variable, variable.default_of(self.node_id))

    def _mend(self, first_index: int = 0, last_index: int = 0xFFFF) -> None:
        for variable in self.unfit:
            if first_index <= variable.index <= last_index:
                self.store[variable.mux] = nearest(variable, variable.initial_of(self.node_id))

    def _held(self, key: Key) -> Variable:
        variable = self.dictionary.variable(key)
        if variable.mux not in self.store:
            raise ObjectNotFoundError(f"{variable.label} is no object of this device")
        return variable


@lru_cache(maxsize=32)
def _initial(dictionary: ObjectDictionary) -> tuple[dict[Mux, Value], tuple[Variable, ...], tuple[Variable, ...]]:
    """Return what all devices with a dictionary have in common, which is found once for all of them: the initial values for
    node-ID 0, the variables whose value depends on the node-ID, and the others that are unfit."""
    initial = {variable.mux: variable.initial_of(0) for variable in dictionary}
    dependent = tuple(variable for variable in dictionary if variable.depends_on_node_id)
    others = initial.keys() - {variable.mux for variable in dependent}
    unfit = (variable for variable in dictionary if variable.mux in others and not _takes(variable, initial[variable.mux]))
    return initial, dependent, tuple(unfit)


def _unfit(dependent: Iterable[Variable], node_id: int, others: Iterable[Variable]) -> tuple[Variable, ...]:
    found = [variable for variable in dependent if not _takes(variable, variable.initial_of(node_id))]
    return tuple(sorted([*others, *found], key=lambda variable: variable.mux))


def nearest(variable: Variable, value: Value) -> Value:
    """Return a substitute for a value that the object's type cannot hold: a text's UTF-8 bytes as Latin-1, else the type's zero.

    A VISIBLE_STRING has no character beyond Latin-1, but devices with an EDS in UTF-8 send these bytes.
    """
    if isinstance(value, str) and variable.data_type == DataType.VISIBLE_STRING:
        return value.encode("utf-8", "surrogatepass").decode("latin-1")
    return zero_of(variable.data_type)


def _fitting(variable: Variable, value: Value) -> Value:
    return value if _takes(variable, value) else nearest(variable, value)


def _takes(variable: Variable, value: Value) -> bool:
    try:
        variable.encode(value)
    except ValueRangeError:
        return False
    return True
