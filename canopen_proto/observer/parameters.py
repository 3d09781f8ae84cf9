"""Keep the communication parameters of all devices on a bus, as far as they can be known by listening only.

Two sources say which value a device has, the surer one first:

1. the recording: what was written to the device, or read from it. A boot-up ends that: the device has its power-on values again.
   These are those that it had when they were stored (0x1010), if the recording has shown that, and no restoring (0x1011) since.
2. the device's own file: the defaults of an EDS, the values of a DCF.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from canopen_proto import indices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.multiplexer import Mux, index_of, mux
from canopen_proto.parameter_storage import SIGNATURES, STORE
from canopen_proto.pdo.settings import place_of

COB_IDS: Final = (
    indices.COB_ID_SYNC,
    indices.COB_ID_TIME_STAMP,
    indices.COB_ID_EMERGENCY,
    indices.EMERGENCY_CONSUMER,
)
MAX_RECORDED: Final = 4096
"""Values of one device: more than 127 SDO channels and 64 PDOs with 50 entries each."""
_MAX_BYTES: Final = 4
_COMMUNICATION: Final = (1, 2)
"""Subindices of 0x1010 and 0x1011: all parameters, and those of communication."""


class Parameters:
    """See this module's text. dictionaries: by node-ID, one for each device that a bus may have."""

    __slots__ = ("_in_file", "_recorded", "_shown", "_stored", "dictionaries")

    def __init__(self, dictionaries: Mapping[int, ObjectDictionary]) -> None:
        self.dictionaries = dictionaries
        self._recorded: dict[int, dict[Mux, int]] = {}  # by node-ID
        self._shown: dict[int, set[int]] = {}  # by node-ID: the indices of these
        self._stored: dict[int, dict[Mux, int]] = {}  # by node-ID: those that a boot-up leaves
        of_files: dict[int, tuple[int, ...]] = {}  # many devices may share one dictionary
        for dictionary in dictionaries.values():
            if id(dictionary) not in of_files:
                of_files[id(dictionary)] = tuple(index for index in dictionary.objects if is_parameter(index))
        self._in_file = {node_id: of_files[id(dictionary)] for node_id, dictionary in dictionaries.items()}

    def settle(self, node_id: int, index: int, subindex: int, data: bytes) -> bool:
        """Take note that a device holds this value. Return whether it is a communication parameter that had another value."""
        if not is_parameter(index) or len(data) > _MAX_BYTES:
            return False
        recorded, key = self._recorded.setdefault(node_id, {}), mux(index, subindex)
        value = int.from_bytes(data, "little")
        if recorded.get(key) == value or len(recorded) >= MAX_RECORDED:
            return False
        recorded[key] = value
        self._shown.setdefault(node_id, set()).add(index)
        return True

    def booted(self, node_id: int) -> bool:
        """Take note of a boot-up. Return whether the device had other values than it has now."""
        before, stored = self._recorded.pop(node_id, {}), self._stored.get(node_id, {})
        self._recorded[node_id] = dict(stored)
        self._shown[node_id] = {index_of(key) for key in stored}
        return before != stored

    def store(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Take note of a confirmed write, if it stores parameters, or restores them at the next boot-up."""
        if subindex not in _COMMUNICATION or int.from_bytes(data, "little") != SIGNATURES.get(index):
            return
        if index == STORE:
            self._stored[node_id] = dict(self._recorded.get(node_id, {}))
        else:
            self._stored.pop(node_id, None)

    def value(self, node_id: int, index: int, subindex: int) -> int | None:
        """Return the number that a device has in an object; None if that is not known."""
        recorded = self._recorded.get(node_id)
        if recorded is not None:
            value = recorded.get(mux(index, subindex))
            if value is not None:
                return value
        variable = self.dictionaries[node_id].get(index, subindex)
        initial = None if variable is None else variable.initial_of(node_id)
        return initial if isinstance(initial, int) else None

    def is_recorded(self, node_id: int, index: int) -> bool:
        """Return whether the recording has shown a value of an object."""
        return index in self._shown.get(node_id, ())

    def indices(self, node_id: int) -> set[int]:
        """Return the indices of the parameters that the device has, by either source."""
        return self._shown.get(node_id, set()).union(self._in_file[node_id])


def is_parameter(index: int) -> bool:
    """Return whether an object says which frames a device exchanges: a COB-ID, an SDO channel or a PDO."""
    return index in COB_IDS or index in indices.SDO_SERVERS or index in indices.SDO_CLIENTS or place_of(index) is not None
