"""A bus between processes, by TCP: `canopen bus serve` in one terminal, `-b tcp` in the others. No hardware, no kernel module.

framing     the protocol, pure           outgoing    the queue for one member, pure
address     HOST:PORT, and its errors    client      the transport                     server      the bus
"""

from canopen_transports.tcp.client import TcpTransport, open_tcp
from canopen_transports.tcp.server import BusServer, serve_bus

__all__ = ["BusServer", "TcpTransport", "open_tcp", "serve_bus"]
