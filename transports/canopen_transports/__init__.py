"""Frames in, frames out: CAN buses for trio. `open_transport("socketcan:can0")`; see `locator` for what else it opens."""

from canopen_transports.errors import BusState, BusStateChanged, FrameNotSent, ReceiveOverrun, Report, TransportError
from canopen_transports.locator import Locator, parse_bitrate, parse_locator
from canopen_transports.opening import OpenTransport, open_transport
from canopen_transports.python_can import PythonCanTransport
from canopen_transports.replay import ReplayTransport
from canopen_transports.tcp import TcpTransport
from canopen_transports.transport import (
    BatchTransport,
    CyclicTransport,
    EagerTransport,
    FilteringTransport,
    Received,
    Transport,
    check_frame,
)
from canopen_transports.virtual import VirtualTransport
from canopen_transports.virtual_wire import WireTransport

__all__ = [
    "BatchTransport",
    "BusState",
    "BusStateChanged",
    "CyclicTransport",
    "EagerTransport",
    "FilteringTransport",
    "FrameNotSent",
    "Locator",
    "OpenTransport",
    "PythonCanTransport",
    "ReceiveOverrun",
    "Received",
    "ReplayTransport",
    "Report",
    "TcpTransport",
    "Transport",
    "TransportError",
    "VirtualTransport",
    "WireTransport",
    "check_frame",
    "open_transport",
    "parse_bitrate",
    "parse_locator",
]
