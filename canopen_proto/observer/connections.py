"""Find the services of a bus whose COB-IDs are not those of the predefined connection set: SYNC, TIME, EMCY, SDO channels.

The objects 0x1005, 0x1012, 0x1014, 0x1028, 0x1200.. and 0x1280.. of all devices say it, by the recording or by the devices' files
(parameters.py). An SDO channel may stand in its server, in its client, or in both; EMCY in its producer and in its consumers.

Source: CiA 301 v4.2.0, 7.5.2.5, 7.5.2.15, 7.5.2.17, 7.5.2.33 and 7.5.2.34; for 0x1028 the table of the objects.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.cob_id import is_valid
from canopen_proto.frame import (
    COB_ID_INVALID,
    MAX_NODE_ID,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TIME,
    RoutingKey,
    key_of_cob_id,
)
from canopen_proto.observer.parameters import Parameters
from canopen_proto.sdo.channels import OTHER_NODE, TO_CLIENT, TO_SERVER

COB_ID_BITS: Final = 0x3FFF_FFFF
"""Bits 30 and 31 say for SYNC and TIME whether the device produces or consumes them."""


_FIRST_CHANNELS: Final = range(SDO_SERVER_TO_CLIENT, SDO_CLIENT_TO_SERVER + MAX_NODE_ID + 1)


class Service(Enum):
    """A service that a COB-ID may have been given."""

    SYNC = "SYNC"
    TIME = "TIME"
    EMCY = "EMCY"


class Channel(NamedTuple):
    """An SDO channel. node_id: of the server."""

    to_server: RoutingKey
    to_client: RoutingKey
    node_id: int


def services_of(parameters: Parameters, node_id: int) -> Iterator[tuple[RoutingKey, Service, int]]:
    """Return the COB-IDs that a device has for SYNC, TIME and EMCY, each with the node that it is of."""
    for index, service in (
        (indices.COB_ID_SYNC, Service.SYNC),
        (indices.COB_ID_TIME_STAMP, Service.TIME),
        (indices.COB_ID_EMERGENCY, Service.EMCY),
    ):
        cob_id = parameters.value(node_id, index, 0)
        if cob_id and not (service is Service.EMCY and cob_id & COB_ID_INVALID):
            key = key_of_cob_id(cob_id & COB_ID_BITS)
            if _may_be(key, service, is_recorded=parameters.is_recorded(node_id, index)):
                yield key, service, node_id
    if indices.EMERGENCY_CONSUMER in parameters.indices(node_id):
        is_recorded = parameters.is_recorded(node_id, indices.EMERGENCY_CONSUMER)
        for producer in range(1, MAX_NODE_ID + 1):
            cob_id = parameters.value(node_id, indices.EMERGENCY_CONSUMER, producer) or 0
            if is_valid(cob_id) and _may_be(key_of_cob_id(cob_id), Service.EMCY, is_recorded=is_recorded):
                yield key_of_cob_id(cob_id), Service.EMCY, producer


def _may_be(key: RoutingKey, service: Service, *, is_recorded: bool) -> bool:
    """Return whether a service may be there.

    Files often leave out the node-ID, as in 0x80 for EMCY: SYNC and TIME keep their place, and a file changes none that the
    predefined connection set gives to SYNC, EMCY or TIME.
    """
    return key not in (SYNC, TIME) and (is_recorded or not SYNC < key < TIME)


def channels_of(parameters: Parameters, node_id: int) -> Iterator[Channel]:
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
