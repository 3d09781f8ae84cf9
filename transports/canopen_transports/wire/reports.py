"""What a wire reports: the frames that came out of it, and what happened to them and to its members."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind
from canopen_transports.wire.member import WireMember


class Delivery(NamedTuple):
    """A frame that came out of the wire. at: the end of EOF. queued: when it was queued. senders: usually one."""

    at: Time
    frame: Frame
    queued: Time
    senders: tuple[WireMember, ...]
    receivers: tuple[WireMember, ...]


class FaultHappened(NamedTuple):
    """A frame was hit. member: the one that missed it or got it late, else its sender."""

    at: Time
    kind: FaultKind
    frame: Frame
    member: WireMember


class StateReported(NamedTuple):
    """A report of a member's controller. state: its new state, or NO_ACKNOWLEDGE once for each frame that nobody acknowledges."""

    at: Time
    state: BusState
    member: WireMember


WireEvent: TypeAlias = FaultHappened | StateReported
