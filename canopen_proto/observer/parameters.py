"""Keep the communication parameters of all devices on a bus, as far as they can be known by listening only.

Two sources say which value a device has, the surer one first:

1. the recording: what was written to the device, or read from it. A boot-up ends that: the device has its power-on values again.
   These are those that it had when they were stored (0x1010), if the recording has shown that, and no restoring (0x1011) since.
2. the device's own file: the defaults of an EDS, the values of a DCF.

`services_of` and `channels_of` find by these parameters the services whose COB-IDs are not those of the predefined connection
set: SYNC, TIME and EMCY (0x1005, 0x1012, 0x1014, 0x1028), SDO channels (0x1200.., 0x1280..). An SDO channel may stand in its
server, in its client, or in both; EMCY in its producer and in its consumers.

Source: CiA 301 v4.2.0, 7.5.2.5, 7.5.2.15, 7.5.2.17, 7.5.2.33 and 7.5.2.34; for 0x1028 the table of the objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.cob_id import CAN_ID_AND_FRAME, is_valid
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import (
    ALL_NODE_IDS,
    COB_ID_INVALID,
    MAX_NODE_ID,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TIME,
    RoutingKey,
    key_of_cob_id,
)
from canopen_proto.multiplexer import Mux, index_of, mux
from canopen_proto.parameter_storage import SIGNATURES, STORE
from canopen_proto.pdo.settings import place_of
from canopen_proto.sdo.channels import OTHER_NODE, TO_CLIENT, TO_SERVER

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
_FIRST_CHANNELS: Final = range(SDO_SERVER_TO_CLIENT, SDO_CLIENT_TO_SERVER + MAX_NODE_ID + 1)


class ObservedParameters:
    """See this module's text. dictionaries: by node-ID, one for each device that a bus may have."""

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
        """Take note that a device holds this value. Return whether it is a communication parameter that had another value. data:
        little-endian."""
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


# ---- what they say ----


class CobIdService(Enum):
    """A service that a COB-ID may have been given."""

    SYNC = "SYNC"
    TIME = "TIME"
    EMCY = "EMCY"


class Channel(NamedTuple):
    """An SDO channel. node_id: of the server."""

    to_server: RoutingKey
    to_client: RoutingKey
    node_id: int


def services_of(parameters: ObservedParameters, node_id: int) -> Iterator[tuple[RoutingKey, CobIdService, int]]:
    """Return the COB-IDs that a device has for SYNC, TIME and EMCY, each with the node that it is of."""
    for index, service in (
        (indices.COB_ID_SYNC, CobIdService.SYNC),
        (indices.COB_ID_TIME_STAMP, CobIdService.TIME),
        (indices.COB_ID_EMERGENCY, CobIdService.EMCY),
    ):
        cob_id = parameters.value(node_id, index, 0)
        if cob_id and not (service is CobIdService.EMCY and cob_id & COB_ID_INVALID):
            key = key_of_cob_id(cob_id & CAN_ID_AND_FRAME)
            if _may_be(key, service, is_recorded=parameters.is_recorded(node_id, index)):
                yield key, service, node_id
    if indices.EMERGENCY_CONSUMER in parameters.indices(node_id):
        is_recorded = parameters.is_recorded(node_id, indices.EMERGENCY_CONSUMER)
        for producer in ALL_NODE_IDS:
            cob_id = parameters.value(node_id, indices.EMERGENCY_CONSUMER, producer) or 0
            if is_valid(cob_id) and _may_be(key_of_cob_id(cob_id), CobIdService.EMCY, is_recorded=is_recorded):
                yield key_of_cob_id(cob_id), CobIdService.EMCY, producer


def _may_be(key: RoutingKey, service: CobIdService, *, is_recorded: bool) -> bool:
    """Return whether a service may be there.

    Files often leave out the node-ID, as in 0x80 for EMCY: SYNC and TIME keep their place, and a file changes none that the
    predefined connection set gives to SYNC, EMCY or TIME.
    """
    return key not in (SYNC, TIME) and (is_recorded or not SYNC < key < TIME)


def channels_of(parameters: ObservedParameters, node_id: int) -> Iterator[Channel]:
    """Return the SDO channels beyond the first that a device's records describe; none with a CAN-ID of a first one."""
    for index in sorted(parameters.indices(node_id)):
        is_client = index in indices.SDO_CLIENTS
        if not is_client and index not in indices.SDO_SERVERS[1:]:
            continue
        cob_ids = [parameters.value(node_id, index, sub) or 0 for sub in (TO_SERVER, TO_CLIENT)]
        keys = [key_of_cob_id(cob_id) for cob_id in cob_ids]
        server = (parameters.value(node_id, index, OTHER_NODE) or 0) if is_client else node_id
        if all(map(is_valid, cob_ids)) and not any(key in _FIRST_CHANNELS for key in keys) and 0 < server <= MAX_NODE_ID:
            yield Channel(keys[0], keys[1], server)
