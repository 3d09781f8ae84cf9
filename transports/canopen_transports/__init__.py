"""Frames in, frames out: CAN buses for trio and asyncio. `open_transport("socketcan:can0")`; `locator` lists them all."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_transports.errors import BusState as BusState
    from canopen_transports.errors import BusStateChanged as BusStateChanged
    from canopen_transports.errors import FrameNotSentError as FrameNotSentError
    from canopen_transports.errors import ReceiveOverrun as ReceiveOverrun
    from canopen_transports.errors import Report as Report
    from canopen_transports.errors import TransportError as TransportError
    from canopen_transports.locator import Locator as Locator
    from canopen_transports.locator import parse_bitrate as parse_bitrate
    from canopen_transports.locator import parse_locator as parse_locator
    from canopen_transports.log_files import LogFileError as LogFileError
    from canopen_transports.log_files import LogReader as LogReader
    from canopen_transports.log_files import log_writer as log_writer
    from canopen_transports.opening import OpenTransport as OpenTransport
    from canopen_transports.opening import open_transport as open_transport
    from canopen_transports.python_can import PythonCanTransport as PythonCanTransport
    from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE as RECEIVE_QUEUE_SIZE
    from canopen_transports.receive_queue import ReceiveQueue as ReceiveQueue
    from canopen_transports.record import Record as Record
    from canopen_transports.replay import ReplayTransport as ReplayTransport
    from canopen_transports.tcp.client import TcpTransport as TcpTransport
    from canopen_transports.transport import BatchTransport as BatchTransport
    from canopen_transports.transport import CyclicTransport as CyclicTransport
    from canopen_transports.transport import EagerTransport as EagerTransport
    from canopen_transports.transport import FilteringTransport as FilteringTransport
    from canopen_transports.transport import NarrowTransport as NarrowTransport
    from canopen_transports.transport import PromptTransport as PromptTransport
    from canopen_transports.transport import PushingTransport as PushingTransport
    from canopen_transports.transport import RatedTransport as RatedTransport
    from canopen_transports.transport import Received as Received
    from canopen_transports.transport import Transport as Transport
    from canopen_transports.transport import check_frame as check_frame
    from canopen_transports.virtual import VirtualTransport as VirtualTransport
    from canopen_transports.virtual_wire import WireTransport as WireTransport
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
