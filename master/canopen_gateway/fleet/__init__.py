"""Many buses on many computers, on Zenoh: a bridge for each computer that has buses (`bind_fleet_door`), and `open_fleet` for
whoever looks at all of them. It needs the extra `fleet`. docs/fleet.md has the whole of it.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.fleet.bridge import FleetDoor as FleetDoor
    from canopen_gateway.fleet.bridge import bind_fleet_door as bind_fleet_door
    from canopen_gateway.fleet.fleet import Fleet as Fleet
    from canopen_gateway.fleet.fleet import FleetLease as FleetLease
    from canopen_gateway.fleet.fleet import FleetValue as FleetValue
    from canopen_gateway.fleet.fleet import open_fleet as open_fleet
    from canopen_gateway.fleet.joining import open_zenoh as open_zenoh
    from canopen_gateway.fleet.keys import FleetPlace as FleetPlace
    from canopen_gateway.fleet.keys import parse_place as parse_place
    from canopen_gateway.fleet.news import FleetEmcy as FleetEmcy
    from canopen_gateway.fleet.news import FleetNews as FleetNews
    from canopen_gateway.fleet.news import FleetPdo as FleetPdo
    from canopen_gateway.fleet.news import FleetState as FleetState
    from canopen_gateway.fleet.news import FleetStatus as FleetStatus
    from canopen_gateway.fleet.news import PlaceAppeared as PlaceAppeared
    from canopen_gateway.fleet.news import PlaceGone as PlaceGone
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
