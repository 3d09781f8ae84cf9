"""A bus between processes, by TCP: `canopen bus serve` in one terminal, `-b tcp` in the others. No hardware, no kernel module.

framing: what travels, pure. outgoing: a member's queue, pure. address: HOST:PORT, and what to say about it. client: the
transport. server: the bus.
"""

from canopen_transports.tcp.client import TcpTransport, open_tcp
from canopen_transports.tcp.server import BusServer, serve_bus

__all__ = ["BusServer", "TcpTransport", "open_tcp", "serve_bus"]
