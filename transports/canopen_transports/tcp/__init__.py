"""A bus between processes, by TCP: `canopen bus serve` in one terminal, `-b tcp` in the others. No hardware, no kernel module.

framing     the protocol, pure           outgoing    the queue for one member, pure
address     HOST:PORT, and its errors    client      the transport                     server      the bus
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_transports.tcp.client import TcpTransport as TcpTransport
    from canopen_transports.tcp.client import open_tcp as open_tcp
    from canopen_transports.tcp.server import BusServer as BusServer
    from canopen_transports.tcp.server import serve_bus as serve_bus
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
