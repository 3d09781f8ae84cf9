"""CAN as it is on a cable: how long frames are, who may send when, what faults do. Pure: no I/O, no clock, no trio.

    frame_bits      the exact length of a frame in bits, and its bounds
    wire            the bus machine: arbitration, transmit queues, faults by a seed, error counters, load
    response_time   the longest time that a frame may wait, without a simulation

Time is ns on any monotonic clock, and an argument, as in the core.
"""

from canopen_proto.frame_bits import duration, frame_bits, least_bits, worst_bits
from canopen_transports.wire.faults import FaultKind, FaultRates
from canopen_transports.wire.member import QueueFullError, QueueOrder, WireMember
from canopen_transports.wire.reports import Delivery, FaultHappened, StateReported, WireEvent
from canopen_transports.wire.response_time import PeriodicMessage, ResponseTime, response_times
from canopen_transports.wire.wire import Wire, WireSettings

__all__ = [
    "Delivery",
    "FaultHappened",
    "FaultKind",
    "FaultRates",
    "PeriodicMessage",
    "QueueFullError",
    "QueueOrder",
    "ResponseTime",
    "StateReported",
    "Wire",
    "WireEvent",
    "WireMember",
    "WireSettings",
    "duration",
    "frame_bits",
    "least_bits",
    "response_times",
    "worst_bits",
]
