"""What a wire reports: the frames that came out of it, and what happened to them and to its members."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind
from canopen_transports.wire.member import WireMember


class Delivery(NamedTuple):
    """A frame that came out of the wire. at: the end of EOF. queued: when it was queued. senders: as a rule one."""

    at: Time
    frame: Frame
    queued: Time
    senders: tuple[WireMember, ...]
    receivers: tuple[WireMember, ...]


class FaultHappened(NamedTuple):
    """A frame was hit. member: who missed it or had it late; else who sent it."""

    at: Time
    kind: FaultKind
    frame: Frame
    member: WireMember


class StateReported(NamedTuple):
    """What a member's controller reports. state: its new one, or NO_ACKNOWLEDGE once for each frame that has none."""

    at: Time
    state: BusState
    member: WireMember


WireEvent: TypeAlias = FaultHappened | StateReported
