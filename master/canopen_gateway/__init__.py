"""Doors to a machine from other programs and networks: a service on top of a master, the text protocol of CiA 309-3, a page in a
browser (web/), and a fleet of many buses on many computers (fleet/).

    async with open_master("socketcan:can0") as master, open_gateway(master) as service:
        async with open_ascii_door(service, tcp=("127.0.0.1", 60000)) as door:
            await trio.sleep_forever()

Read-only unless it is allowed otherwise: see guard.py. docs/gateway.md has the whole of it.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.errors import BridgeRefusedError as BridgeRefusedError
    from canopen_gateway.errors import DoorError as DoorError
    from canopen_gateway.errors import FleetError as FleetError
    from canopen_gateway.errors import GatewayError as GatewayError
    from canopen_gateway.errors import GatewayFullError as GatewayFullError
    from canopen_gateway.errors import GatewayRefusedError as GatewayRefusedError
    from canopen_gateway.errors import HistoryError as HistoryError
    from canopen_gateway.errors import HistoryQueryError as HistoryQueryError
    from canopen_gateway.errors import LeaseError as LeaseError
    from canopen_gateway.errors import NoGatewayError as NoGatewayError
    from canopen_gateway.errors import NoSuchPlaceError as NoSuchPlaceError
    from canopen_gateway.errors import NotAllowedError as NotAllowedError
    from canopen_gateway.errors import NotOverFleetError as NotOverFleetError
    from canopen_gateway.errors import NotOverTextError as NotOverTextError
    from canopen_gateway.errors import PdoTakenError as PdoTakenError
    from canopen_gateway.errors import QueryRefusedError as QueryRefusedError
    from canopen_gateway.guard import Guard as Guard
    from canopen_gateway.guard import Permission as Permission
    from canopen_gateway.guard import parse_permissions as parse_permissions
    from canopen_gateway.guard import permission_to_write as permission_to_write
    from canopen_gateway.layer_settings import LayerSettings as LayerSettings
    from canopen_gateway.lease import Lease as Lease
    from canopen_gateway.limits import Limits as Limits
    from canopen_gateway.samples import PdoSample as PdoSample
    from canopen_gateway.samples import PdoSamples as PdoSamples
    from canopen_gateway.service import GatewayService as GatewayService
    from canopen_gateway.service import GatewaySession as GatewaySession
    from canopen_gateway.service import HeardOnNet as HeardOnNet
    from canopen_gateway.service import open_gateway as open_gateway
    from canopen_gateway.values import ValueSeen as ValueSeen
    from canopen_gateway.values import ValueStream as ValueStream
    from canopen_gateway.values import WatchedObject as WatchedObject
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
