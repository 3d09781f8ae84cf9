"""Store and restore parameters: 0x1010, 0x1011, and the values that a device has at power-on (CiA 301 v4.2.0, 7.5.2.13, .14).

Theory of operation
-------------------
A client writes "save" to a subindex of 0x1010, and the parameters of that group are as they are now after the next power-on; or
"load" to 0x1011, and they have their defaults again, after the next reset. Another signature is refused with 0x08000020, so that
nothing is stored by accident. Reading tells what the device can do: bit 0, it does so on command (bit 1 of 0x1010: by itself). A
dictionary says that with the object's default; without one it is bit 0, and where bit 0 is 0 the signature is refused too.

    1        all parameters                  0x1000 to 0xFFFF
    2        communication parameters        0x1000 to 0x1FFF
    3        application parameters          0x6000 to 0x9FFF
    4..127   the manufacturer's              0x2000 to 0x5FFF, until `groups` says otherwise

A parameter is what a client may read and write. Left out are DOMAINs and `excluded`: objects that are commands or a history, to
which a device adds its own (a control word is no parameter). The COB-IDs that an SDO manager has given (bit 30) are not stored.

**The host does the storing**, since the core has nothing that outlives it:

    1. ObjectAccessPending for 0x1010 or 0x1011: the server holds its answer, and the values of that moment are taken
    2. kept = node.storage.to_keep(index, subindex): everything that is to be there at the next power-on, not this group only
    3. the host writes that somewhere, and says node.complete(access_id, None, now), or AbortCode.HARDWARE_ERROR if it could not
    4. at the next start, before `boot`: node.storage.load(kept)

Until 3. nothing has changed. `saved` is what a reset puts back in place of the defaults: of everything (reset node), or of
0x1000 to 0x1FFF (reset communication).

What a DCF has configured (`Variable.configured`) counts as stored already, as somebody would have done who set the device up by
it: after "load" the parameter has the default of its EDS again. What a client cannot write stays as it is configured.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Final

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value, ValueRangeError, range_of
from canopen_proto.dictionary import Values, Variable
from canopen_proto.multiplexer import Mux, index_of, mux, split_mux
from canopen_proto.owner import Owner
from canopen_proto.sdo.channels import is_dynamic

STORE: Final = 0x1010
RESTORE: Final = 0x1011
SIGNATURES: Final = {STORE: 0x65766173, RESTORE: 0x64616F6C}
"""ASCII "save" and "load", as little-endian numbers: what a client has to write. CiA 301 v4.2.0, figures 54 and 58"""
ON_COMMAND: Final = 0x01
"""Bit of what is read: the device stores (restores) on command."""

GROUPS: Final[Mapping[int, Collection[int]]] = {
    1: range(0x1000, 0x10000),
    2: range(0x1000, 0x2000),
    3: range(0x6000, 0xA000),
    **dict.fromkeys(range(4, 128), range(0x2000, 0x6000)),
}
ALL_INDICES: Final = range(0x10000)
NO_PARAMETERS: Final = frozenset({0x1003, STORE, RESTORE, 0x1023, 0x1024, 0x1025, 0x1026})
"""Communication objects that can be written and are no parameters: error history, storage, OS commands, debugger, prompt."""


class ParameterStorage(Owner):
    """What a device keeps over power-off; see this module's text.

    saved: the power-on values that are not the defaults, by mux; at first those of a DCF. groups: indices by subindex of 0x1010
    and 0x1011; excluded: indices that are no parameters. The device may change these two before it boots.
    """

    __slots__ = ("_after", "_configured", "_values", "excluded", "groups", "saved")

    def __init__(self, values: Values) -> None:
        self._values = values
        self._after: dict[tuple[int, int], dict[Mux, Value]] = {}  # `saved` as it will be, by the access that is with the host
        self.groups: dict[int, Collection[int]] = dict(GROUPS)
        self.excluded: set[int] = set(NO_PARAMETERS)
        # What `Values` begins with, but is not the default
        self._configured = [each for each in values.dictionary if each.configured is not None and self._is_parameter(each)]
        self.saved: dict[Mux, Value] = {variable.mux: values.store[variable.mux] for variable in self._configured}

    # ---- for the host ----

    def load(self, kept: Mapping[Mux, bytes]) -> list[Mux]:
        """Hand in what was kept (mux -> bytes, of `to_keep`), before the node boots: these are its values from now on.

        They take the place of what a DCF has configured, which was among them unless a client restored the defaults: a host
        that has kept nothing yet leaves it.
        Returns the muxes that were left out, because there is no such parameter any more or it cannot have that value: another
        version of the device may have stored them.
        """
        left_out = []
        self.saved = {}
        self.put_back(ALL_INDICES)
        for key, data in kept.items():
            variable = self._values.dictionary.get(*split_mux(key))
            if variable is None or not self._is_parameter(variable):
                left_out.append(key)
                continue
            try:
                value = variable.decode(data)
                variable.check_limits(value)
            except ValueRangeError:
                left_out.append(key)
                continue
            self.saved[key] = self._values.store[key] = value
        return left_out

    def to_keep(self, index: int, subindex: int) -> dict[Mux, bytes]:
        """All that is to be kept (mux -> bytes) once the pending access to 0x1010 or 0x1011 is done; now, if there is none."""
        after = self._after.get((index, subindex), self.saved)
        return {variable.mux: variable.encode(value) for variable, value in self._with_variables(after)}

    # ---- for the node ----

    def capability(self, index: int, subindex: int) -> int | None:
        """What a client reads there; None where it is no subindex of 0x1010 or 0x1011 that stands for a group.

        None too where it is described as something that has no room for a signature.
        """
        variable = self._values.dictionary.get(index, subindex) if index in SIGNATURES and subindex else None
        numbers = None if variable is None else range_of(variable.data_type)
        if variable is None or numbers is None or numbers[1] < SIGNATURES[index]:
            return None
        default = variable.default
        return default if isinstance(default, int) and numbers[0] <= default <= numbers[1] else ON_COMMAND

    @staticmethod
    def owns(index: int) -> bool:
        return index in SIGNATURES

    def refresh(self, index: int, subindex: int) -> AbortCode | None:
        capability = self.capability(index, subindex)
        if capability is not None:
            self._values.store[mux(index, subindex)] = capability
        return None

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Whether that value begins to store or restore: it is the signature, and the device can do so on command."""
        capability = self.capability(index, subindex)
        able = capability is not None and capability & ON_COMMAND
        return None if able and value == SIGNATURES[index] else AbortCode.CANNOT_TRANSFER

    def begin(self, index: int, subindex: int) -> None:
        """The signature was written, and the host is asked: take the values of this moment."""
        group = self.groups.get(subindex, ())
        after = {key: value for key, value in self.saved.items() if index_of(key) not in group}
        if index == STORE:
            store = self._values.store
            present = {variable.mux: store[variable.mux] for variable in self._parameters(group)}
            lasting = {key: value for key, value in present.items() if not is_dynamic(key, value)}
            after |= {variable.mux: value for variable, value in self._with_variables(lasting)}
        self._after[index, subindex] = after

    def commit(self, index: int, subindex: int) -> None:
        """The host has done it."""
        self.saved = self._after.pop((index, subindex), self.saved)

    def forget(self, index: int, subindex: int) -> None:
        """The host could not, or the client gave up."""
        self._after.pop((index, subindex), None)

    def put_back(self, indices: Collection[int]) -> None:
        """The initial values were put back in these objects: the power-on values go over them."""
        for variable in self._configured:
            if variable.index in indices and variable.mux not in self.saved:
                self._values.put_default(variable)
        self._values.store.update({key: value for key, value in self.saved.items() if index_of(key) in indices})

    # ---- inside ----

    def _is_parameter(self, variable: Variable) -> bool:
        both_ways = variable.access.readable and variable.access.writable
        return both_ways and variable.index not in self.excluded and variable.data_type is not DataType.DOMAIN

    def _parameters(self, group: Collection[int]) -> Iterator[Variable]:
        for variable in self._values.dictionary:
            if variable.index in group and self._is_parameter(variable):
                yield variable

    def _with_variables(self, values: Mapping[Mux, Value]) -> Iterator[tuple[Variable, Value]]:
        """The values that their objects can have: the device itself may have put something else into its memory."""
        for key, value in values.items():
            variable = self._values.dictionary.variable(split_mux(key))
            try:
                variable.encode(value)
            except ValueRangeError:
                continue
            yield variable, value
