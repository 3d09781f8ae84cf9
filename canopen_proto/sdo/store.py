"""The usual store of an SDO server: a dictionary and its values, by the rules that stand in the dictionary.

`ValuesStore` is an ObjectStore that answers each access by the description (existence, access right, type, length, limits) and
keeps what is written in `Values`, which PDOs share. Its abort codes are those of CiA 301 v4.2.0, 7.2.4.3.17, table 22.

The steps of a write stand apart, so that a device can put its own between check and store (an object with an effect refuses, or
acts): `writable` and `check_size`, `decode` (with `check` for the limits), then `values.store[variable.mux] = value`. Each gives
either what the next one needs or an abort code.
"""

from __future__ import annotations

from functools import lru_cache

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary.model import ObjectDictionary, Variable
from canopen_proto.dictionary.values import Values
from canopen_proto.machine import Time


@lru_cache(maxsize=32)
def _tables(dictionary: ObjectDictionary) -> tuple[dict[int, Variable], dict[int, Variable]]:
    """Return the objects that can be read, and those that can be written, by mux: once for all devices with a dictionary."""
    readable: dict[int, Variable] = {each.mux: each for each in dictionary if each.access.readable}
    writable: dict[int, Variable] = {each.mux: each for each in dictionary if each.access.writable}
    return readable, writable


class ValuesStore:
    """The objects of one device; see this module's text."""

    __slots__ = ("_readable", "_writable", "dictionary", "values")

    def __init__(self, values: Values) -> None:
        self.values = values
        self.dictionary: ObjectDictionary = values.dictionary
        # An object in neither table is looked up again to find out why. The key is made in each access without a call of `mux`,
        # which costs as much as the look-up.
        self._readable, self._writable = _tables(self.dictionary)

    # ---- the ObjectStore ----

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        """Return the bytes of an object, or 0x06020000, 0x06090011, 0x06010001."""
        variable = self._readable.get(index << 8 | subindex)
        if variable is None:
            return self._missing(index, subindex, AbortCode.WRITE_ONLY)
        try:
            return variable.codec.encode(self.values.store[variable.mux], variable)
        except ValueRangeError:  # the device itself put something into its memory that does not fit the object
            return AbortCode.INTERNAL_INCOMPATIBILITY

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        """Return None, or 0x06020000, 0x06090011, 0x06010002, 0x06070010, 0x06070012, 0x06070013. size: bytes, as announced;
        None: not announced."""
        variable = self._writable.get(index << 8 | subindex)
        if variable is None:
            return self._missing(index, subindex, AbortCode.READ_ONLY)
        return None if size is None or size == variable.size else self.check_size(variable, size)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        """Store the value and return None; or return what `check_write` says, 0x06090030, 0x06090031 or 0x06090032. data:
        little-endian."""
        variable = self._writable.get(index << 8 | subindex)
        if variable is None:
            return self._missing(index, subindex, AbortCode.READ_ONLY)
        value = self.decode(variable, data)
        if type(value) is AbortCode:  # `isinstance` takes five times as long of an enumeration
            return value
        self.values.store[variable.mux] = value
        return None

    # ---- its steps ----

    def readable(self, index: int, subindex: int) -> Variable | AbortCode:
        """Return the variable if it exists and may be read, else why not."""
        return self._readable.get(index << 8 | subindex) or self._missing(index, subindex, AbortCode.WRITE_ONLY)

    def writable(self, index: int, subindex: int) -> Variable | AbortCode:
        """Return the variable if it exists and may be written, else why not."""
        variable = self._writable.get(index << 8 | subindex)
        return self._missing(index, subindex, AbortCode.READ_ONLY) if variable is None else variable

    def _missing(self, index: int, subindex: int, no_access: AbortCode) -> AbortCode:
        if self.dictionary.get(index, subindex) is not None:
            return no_access
        return AbortCode.NO_SUCH_SUBINDEX if self.dictionary.has_index(index) else AbortCode.NO_SUCH_OBJECT

    @staticmethod
    def check_size(variable: Variable, size: int) -> AbortCode | None:
        """Return None if a value of so many bytes fits the object's type, else why not. size: bytes."""
        expected = variable.size
        if expected is None:
            odd = variable.data_type == DataType.UNICODE_STRING and size % 2
            return AbortCode.LENGTH_MISMATCH if odd else None
        if size > expected:
            return AbortCode.LENGTH_TOO_HIGH
        return AbortCode.LENGTH_TOO_LOW if size < expected else None

    def decode(self, variable: Variable, data: bytes) -> Value | AbortCode:
        """Return the value of the bytes that a client sent, or why they do not fit the object's type and limits."""
        try:
            value = variable.codec.decode(data, variable)
        except ValueRangeError:
            return self.check_size(variable, len(data)) or AbortCode.INVALID_VALUE
        if variable.low_limit is not None or variable.high_limit is not None:
            return self.check(variable, value) or value
        return value

    @staticmethod
    def check(variable: Variable, value: Value) -> AbortCode | None:
        """Return None if a value lies within the object's limits, else why not."""
        low, high = variable.low_limit, variable.high_limit
        if (low is None and high is None) or not isinstance(value, int | float):
            return None
        if value != value:  # NaN is beyond every limit
            return AbortCode.INVALID_VALUE
        if high is not None and value > high:
            return AbortCode.VALUE_TOO_HIGH
        return AbortCode.VALUE_TOO_LOW if low is not None and value < low else None
