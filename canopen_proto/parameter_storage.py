"""Store and restore parameters: 0x1010, 0x1011, and the values of a device at power-on (CiA 301 v4.2.0, 7.5.2.13, .14).

A client writes "save" to a subindex of 0x1010: the parameters of that group keep their present values after the next power-on. Or
it writes "load" to 0x1011: they have their defaults again after the next reset. Another signature is refused with 0x08000020, so
that nothing is stored by accident. A read shows what the device can do: bit 0, on command (bit 1 of 0x1010: by itself). The
object's default in the dictionary gives this value; without a default it is bit 0. If bit 0 is 0, the signature is refused too.

    1        all parameters                  0x1000 to 0xFFFF
    2        communication parameters        0x1000 to 0x1FFF
    3        application parameters          0x6000 to 0x9FFF
    4..127   the manufacturer's              0x2000 to 0x5FFF, until `groups` says otherwise

Every object that a client may read and write is a parameter, except DOMAINs and `excluded`: commands and histories, to which a
device adds its own (a controlword is not a parameter). COB-IDs that an SDO manager has given (bit 30) are not stored.

**The host stores the values**, since the core has no memory that outlives it:

    1. ObjectAccessPending for 0x1010 or 0x1011: the server holds its answer, and the values of that moment are taken
    2. kept = node.storage.to_keep(index, subindex): all values for the next power-on, not only those of this group
    3. the host stores them, and calls node.complete(access_id, None, now), or with AbortCode.HARDWARE_ERROR if that failed
    4. at the next start, before `boot`: node.storage.load(kept)

Before step 3 nothing changes. A reset puts back `saved` in place of the defaults: all of it (reset node), or 0x1000 to 0x1FFF
(reset communication).

**0x1020** holds date and time of a configuration, in days since 1984 and ms since midnight (CiA 301 v4.2.0, 7.5.2.21, as the
manuals of Nanotec, esd and TR-Electronic have it): a tool writes it at the end, and reads it later to see whether the device
still has that configuration. It becomes 0 as soon as a client changes any other setting (from memory; esd's modules leave it
alone); commands, set-points and outputs are none.

A value that a DCF configures (`Variable.configured`) counts as stored, as if the device had been set up by the DCF: after "load"
the parameter has the default of its EDS again. An object that a client cannot write keeps its configured value.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value, ValueRangeError, range_of
from canopen_proto.dictionary import Values, Variable
from canopen_proto.dictionary.roles import Role, role_of
from canopen_proto.multiplexer import Mux, index_of, mux, split_mux
from canopen_proto.owner import Owner
from canopen_proto.sdo.channels import is_dynamic

STORE: Final = indices.STORE_PARAMETERS
RESTORE: Final = indices.RESTORE_DEFAULT_PARAMETERS
SIGNATURES: Final = {STORE: 0x65766173, RESTORE: 0x64616F6C}
"""The values that a client has to write: ASCII "save" and "load", as little-endian numbers. CiA 301 v4.2.0, figures 54 and 58"""
ON_COMMAND: Final = 0x01
"""Bit of the value that is read: the device stores (restores) on command."""

GROUPS: Final[Mapping[int, Collection[int]]] = {
    1: range(0x1000, 0x10000),
    2: indices.COMMUNICATION_AREA,
    3: indices.PROFILE_AREA,
    **dict.fromkeys(range(4, 128), indices.MANUFACTURER_AREA),
}
ALL_INDICES: Final = range(0x10000)
NO_PARAMETERS: Final = frozenset(
    {
        indices.PREDEFINED_ERROR_FIELD,
        STORE,
        RESTORE,
        indices.OS_COMMAND,
        indices.OS_COMMAND_MODE,
        indices.OS_DEBUGGER_INTERFACE,
        indices.OS_PROMPT,
    }
)
"""Communication objects that can be written but are not parameters: error history, storage, OS commands, debugger, prompt."""

_DATE: Final = (mux(indices.VERIFY_CONFIGURATION, 1), mux(indices.VERIFY_CONFIGURATION, 2))


class ParameterStorage(Owner):
    """The values that a device keeps without power; see this module's text.

    saved: the power-on values that are not the defaults, by mux; at first those of a DCF. groups: subindex of 0x1010 and 0x1011
    -> its indices. excluded: indices that are not parameters. The device may change these two before it boots.
    """

    def __init__(self, values: Values) -> None:
        self._values = values
        self._after: dict[tuple[int, int], dict[Mux, Value]] = {}  # access that waits for the host -> `saved` after it
        self.groups: dict[int, Collection[int]] = dict(GROUPS)
        self.excluded: set[int] = set(NO_PARAMETERS)
        # The values with which `Values` begins that are not defaults
        self._configured = [each for each in values.dictionary if each.configured is not None and self._is_parameter(each)]
        self.saved: dict[Mux, Value] = {variable.mux: values.store[variable.mux] for variable in self._configured}

    def load(self, kept: Mapping[Mux, bytes]) -> list[Mux]:
        """Load the values that the host kept (mux -> bytes, of `to_keep`), before the node boots: the node has them from now on.

        They replace the values of a DCF, which are among them unless a client restored the defaults. Do not call it if nothing
        was kept yet. Returns the muxes that were left out, because the parameter no longer exists or cannot have that value:
        another version of the device may have stored them.
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
        """Return all values to keep (mux -> bytes) once the pending access to 0x1010 or 0x1011 is done, or now if there is
        none."""
        after = self._after.get((index, subindex), self.saved)
        return {variable.mux: variable.encode(value) for variable, value in self._with_variables(after)}

    def capability(self, index: int, subindex: int) -> int | None:
        """Return the value that a client reads; None if it is not a subindex of 0x1010 or 0x1011 for a group.

        Also None if the dictionary describes the object with too few bytes for a signature.
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
        """Return None if this value starts to store or restore (it is the signature, and the device can do so on command), else
        the abort code."""
        capability = self.capability(index, subindex)
        able = capability is not None and capability & ON_COMMAND
        return None if able and value == SIGNATURES[index] else AbortCode.CANNOT_TRANSFER

    def begin(self, index: int, subindex: int) -> None:
        """Take the present values: the signature was written, and the host is asked."""
        group = self.groups.get(subindex, ())
        after = {key: value for key, value in self.saved.items() if index_of(key) not in group}
        if index == STORE:
            store = self._values.store
            present = {variable.mux: store[variable.mux] for variable in self._parameters(group)}
            lasting = {key: value for key, value in present.items() if not is_dynamic(key, value)}
            after |= {variable.mux: value for variable, value in self._with_variables(lasting)}
        self._after[index, subindex] = after

    def commit(self, index: int, subindex: int) -> None:
        """Finish a pending access: the host has stored the values."""
        self.saved = self._after.pop((index, subindex), self.saved)

    def forget(self, index: int, subindex: int) -> None:
        """Drop a pending access: the host failed, or the client gave up."""
        self._after.pop((index, subindex), None)

    def changed(self, variable: Variable) -> None:
        """A client has changed an object: if it is a setting, 0x1020 no longer tells what is configured."""
        store = self._values.store
        if not any(map(store.get, _DATE)) or variable.mux in _DATE or not self._is_parameter(variable):
            return
        if role_of(self._values.dictionary, variable) in (Role.COMMUNICATION, Role.APPLICATION):
            store.update({key: 0 for key in _DATE if key in store})

    def put_back(self, indices: Collection[int]) -> None:
        """Put the power-on values into these objects, over the initial values that were put back before."""
        for variable in self._configured:
            if variable.index in indices and variable.mux not in self.saved:
                self._values.put_default(variable)
        self._values.store.update({key: value for key, value in self.saved.items() if index_of(key) in indices})

    def follow(self, moved: Mapping[Mux, tuple[Value, Value]]) -> None:
        """Let stored values that depend on the node-ID follow it. moved: of `Values.set_node_id`."""
        for key, (old, new) in moved.items():
            if key in self.saved and self.saved[key] == old:
                self.saved[key] = new

    def _is_parameter(self, variable: Variable) -> bool:
        both_ways = variable.access.readable and variable.access.writable
        return both_ways and variable.index not in self.excluded and variable.data_type is not DataType.DOMAIN

    def _parameters(self, group: Collection[int]) -> Iterator[Variable]:
        for variable in self._values.dictionary:
            if variable.index in group and self._is_parameter(variable):
                yield variable

    def _with_variables(self, values: Mapping[Mux, Value]) -> Iterator[tuple[Variable, Value]]:
        """Return the values that fit their objects: the device itself may have put others into its memory."""
        for key, value in values.items():
            variable = self._values.dictionary.variable(split_mux(key))
            try:
                variable.encode(value)
            except ValueRangeError:
                continue
            yield variable, value
