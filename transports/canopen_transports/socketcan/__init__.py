"""`socketcan:can0`: Linux's own CAN, straight from the kernel."""

from canopen_transports.socketcan.broadcast import Broadcast
from canopen_transports.socketcan.transport import SocketCanTransport, open_socketcan

__all__ = ["Broadcast", "SocketCanTransport", "open_socketcan"]
