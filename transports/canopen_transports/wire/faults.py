"""The faults of a wire, and how often they happen. The wire's seed decides which frame is hit, and at which member."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time


class FaultKind(Enum):
    """What happened to a frame."""

    LOSS = "lost at one receiver"
    """One receiver missed it: its receive buffer was full, or it was error-passive when it saw an error."""
    REPETITION = "repeated"
    """The last bit of EOF was disturbed: all receivers have taken the frame, and its sender sends it again."""
    CORRUPTION = "corrupted"
    """A member saw a bit error, a stuff error or a CRC error: an error frame follows, and the frame is sent again."""
    DELAY = "late at one receiver"
    """One receiver got it late, and so all frames after it: a gateway, or a controller that is read too seldom."""
    COLLISION = "collided"
    """Two members sent different frames with one identifier. The members cause this, never the rates."""
    CUT = "destroyed by a cut"
    """The cable was cut or mended during the frame."""
    NOT_SENT = "not sent"
    """It was queued when its member went bus-off."""


@dataclass(frozen=True, slots=True)
class FaultRates:
    """How often a frame is hit: probabilities for each frame; at most one comes true.

    delay_time: how late a late frame is at most, ns. Raises LocalProtocolError for rates outside 0 to 1, or with a sum above 1.
    """

    loss: float = 0.0
    repetition: float = 0.0
    corruption: float = 0.0
    delay: float = 0.0
    delay_time: Time = 5 * MILLISECOND

    def __post_init__(self) -> None:
        rates = (self.loss, self.repetition, self.corruption, self.delay)
        if not all(0 <= rate <= 1 for rate in rates) or sum(rates) > 1:
            raise LocalProtocolError(f"fault rates are probabilities, together at most 1, not {rates}")
        if self.delay_time < 1:
            raise LocalProtocolError(f"a late frame is late by 1 ns or more, not {self.delay_time}")

    @property
    def total(self) -> float:
        """The probability that a frame is hit at all."""
        return self.loss + self.repetition + self.corruption + self.delay
