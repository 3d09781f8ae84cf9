"""CAN as it is on a cable: how long frames are, who may send when, what faults do. Pure: no I/O, no clock, no trio.

    frame_bits      the exact length of a frame in bits, and its bounds
    wire            the bus machine: arbitration, transmit queues, faults by a seed, error counters, load
    response_time   the longest time that a frame may wait, without a simulation

Time is ns on any monotonic clock, and an argument, as in the core.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.frame_bits import duration as duration
    from canopen_proto.frame_bits import frame_bits as frame_bits
    from canopen_proto.frame_bits import least_bits as least_bits
    from canopen_proto.frame_bits import worst_bits as worst_bits
    from canopen_transports.wire.faults import FaultKind as FaultKind
    from canopen_transports.wire.faults import FaultRates as FaultRates
    from canopen_transports.wire.member import QueueFullError as QueueFullError
    from canopen_transports.wire.member import QueueOrder as QueueOrder
    from canopen_transports.wire.member import WireMember as WireMember
    from canopen_transports.wire.reports import Delivery as Delivery
    from canopen_transports.wire.reports import FaultHappened as FaultHappened
    from canopen_transports.wire.reports import StateReported as StateReported
    from canopen_transports.wire.reports import WireEvent as WireEvent
    from canopen_transports.wire.response_time import PeriodicMessage as PeriodicMessage
    from canopen_transports.wire.response_time import ResponseTime as ResponseTime
    from canopen_transports.wire.response_time import response_times as response_times
    from canopen_transports.wire.wire import Wire as Wire
    from canopen_transports.wire.wire import WireSettings as WireSettings
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
