"""What an SDO server serves in the plain case: a dictionary and its values, by the rules that stand in the dictionary.

Theory of operation
-------------------
`ValuesStore` is an ObjectStore that answers each access by the description (existence, access right, type, length, limits) and
keeps what is written in `Values`, which PDOs share. Its abort codes are those of CiA 301 v4.2.0, 7.2.4.3.17, table 22.

The steps of a write stand apart, so that a device can put its own between check and store (an object with an effect refuses, or
acts): `writable`, `check_size`, `decode`, `check`, `store`. Each gives either what the next one needs or an abort code.
"""

from __future__ import annotations

from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary.model import ObjectDictionary, Variable
from canopen_proto.dictionary.values import Values
from canopen_proto.machine import Time
from canopen_proto.sdo.abort import AbortCode


class ValuesStore:
    """The objects of one device; see this module's text."""

    __slots__ = ("dictionary", "values")

    def __init__(self, values: Values) -> None:
        self.values = values
        self.dictionary: ObjectDictionary = values.dictionary

    # ---- the ObjectStore ----

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        """The bytes of an object, or 0x06020000, 0x06090011, 0x06010001."""
        variable = self.readable(index, subindex)
        if isinstance(variable, AbortCode):
            return variable
        try:
            return variable.encode(self.values.store[variable.mux])
        except ValueRangeError:  # the device itself put something into its memory that does not fit the object
            return AbortCode.INTERNAL_INCOMPATIBILITY

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        """None, or 0x06020000, 0x06090011, 0x06010002, 0x06070010, 0x06070012, 0x06070013."""
        variable = self.writable(index, subindex)
        if isinstance(variable, AbortCode):
            return variable
        return None if size is None else self.check_size(variable, size)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        """None, and it is stored; or what `check_write` says, 0x06090030, 0x06090031, 0x06090032, and nothing has changed."""
        variable = self.writable(index, subindex)
        if isinstance(variable, AbortCode):
            return variable
        value = self.decode(variable, data)
        if isinstance(value, AbortCode):
            return value
        refusal = self.check(variable, value)
        if refusal is None:
            self.store(variable, value)
        return refusal

    # ---- its steps ----

    def find(self, index: int, subindex: int) -> Variable | AbortCode:
        """The variable, or why there is none."""
        variable = self.dictionary.get(index, subindex)
        if variable is not None:
            return variable
        return AbortCode.NO_SUCH_SUBINDEX if self.dictionary.has_index(index) else AbortCode.NO_SUCH_OBJECT

    def readable(self, index: int, subindex: int) -> Variable | AbortCode:
        """The variable, if it exists and may be read."""
        variable = self.find(index, subindex)
        if isinstance(variable, Variable) and not variable.access.readable:
            return AbortCode.WRITE_ONLY
        return variable

    def writable(self, index: int, subindex: int) -> Variable | AbortCode:
        """The variable, if it exists and may be written."""
        variable = self.find(index, subindex)
        if isinstance(variable, Variable) and not variable.access.writable:
            return AbortCode.READ_ONLY
        return variable

    @staticmethod
    def check_size(variable: Variable, size: int) -> AbortCode | None:
        """Whether a value of so many bytes fits the object's type."""
        expected = variable.size
        if expected is None:
            odd = variable.data_type == DataType.UNICODE_STRING and size % 2
            return AbortCode.LENGTH_MISMATCH if odd else None
        if size > expected:
            return AbortCode.LENGTH_TOO_HIGH
        return AbortCode.LENGTH_TOO_LOW if size < expected else None

    @classmethod
    def decode(cls, variable: Variable, data: bytes) -> Value | AbortCode:
        """The value of the bytes that a client sent."""
        try:
            return variable.decode(data)
        except ValueRangeError:
            return cls.check_size(variable, len(data)) or AbortCode.INVALID_VALUE

    @staticmethod
    def check(variable: Variable, value: Value) -> AbortCode | None:
        """Whether a value lies within the object's limits."""
        low, high = variable.low_limit, variable.high_limit
        if (low is None and high is None) or not isinstance(value, int | float):
            return None
        if value != value:  # NaN is beyond every limit
            return AbortCode.INVALID_VALUE
        if high is not None and value > high:
            return AbortCode.VALUE_TOO_HIGH
        return AbortCode.VALUE_TOO_LOW if low is not None and value < low else None

    def store(self, variable: Variable, value: Value) -> None:
        """Keep the value."""
        self.values.store[variable.mux] = value
