"""The text door (CiA 309-3): a server on TCP and on a Unix socket, and a client of other gateways.

connection.py: what one client's requests mean for the service; door.py: the sockets, and clients that misbehave; remote.py: the
client; address.py: where a gateway is.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.ascii.address import GatewayAddress as GatewayAddress
    from canopen_gateway.ascii.address import parse_gateway_address as parse_gateway_address
    from canopen_gateway.ascii.connection import AsciiConnection as AsciiConnection
    from canopen_gateway.ascii.door import AsciiDoor as AsciiDoor
    from canopen_gateway.ascii.door import bind_ascii_door as bind_ascii_door
    from canopen_gateway.ascii.remote import RemoteGateway as RemoteGateway
    from canopen_gateway.ascii.remote import open_remote_gateway as open_remote_gateway
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
