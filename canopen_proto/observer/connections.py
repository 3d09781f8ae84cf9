"""Find the services of a bus whose COB-IDs are not those of the predefined connection set: SYNC, TIME, EMCY, SDO channels.

The objects 0x1005, 0x1012, 0x1014, 0x1200.. and 0x1280.. of all devices say it, by the recording or by the devices' files
(parameters.py). An SDO channel may stand in its server, in its client, or in both.

Source: CiA 301 v4.2.0, 7.5.2.5, 7.5.2.15, 7.5.2.17, 7.5.2.33 and 7.5.2.34.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.cob_id import is_valid
from canopen_proto.frame import COB_ID_INVALID, MAX_NODE_ID, RoutingKey, key_of_cob_id
from canopen_proto.observer.parameters import Parameters
from canopen_proto.sdo.channels import OTHER_NODE, TO_CLIENT, TO_SERVER

COB_ID_BITS: Final = 0x3FFF_FFFF
"""Bits 30 and 31 say for SYNC and TIME whether the device produces or consumes them."""


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


def services_of(parameters: Parameters, node_id: int) -> Iterator[tuple[RoutingKey, Service]]:
    """Return the COB-IDs that a device has for SYNC, TIME and EMCY."""
    for index, service in (
        (indices.COB_ID_SYNC, Service.SYNC),
        (indices.COB_ID_TIME_STAMP, Service.TIME),
        (indices.COB_ID_EMERGENCY, Service.EMCY),
    ):
        cob_id = parameters.value(node_id, index, 0)
        if cob_id and not (service is Service.EMCY and cob_id & COB_ID_INVALID):
            yield key_of_cob_id(cob_id & COB_ID_BITS), service


def channels_of(parameters: Parameters, node_id: int) -> Iterator[Channel]:
    """Return the SDO channels beyond the first that a device's records describe."""
    for index in sorted(parameters.indices(node_id)):
        is_client = index in indices.SDO_CLIENTS
        if not is_client and index not in indices.SDO_SERVERS[1:]:
            continue
        to_server, to_client = (parameters.value(node_id, index, sub) or 0 for sub in (TO_SERVER, TO_CLIENT))
        server = (parameters.value(node_id, index, OTHER_NODE) or 0) if is_client else node_id
        if is_valid(to_server) and is_valid(to_client) and 0 < server <= MAX_NODE_ID:
            yield Channel(key_of_cob_id(to_server), key_of_cob_id(to_client), server)
