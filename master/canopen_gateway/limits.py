"""`Limits`: how much a gateway takes on, so that no client can use up the computer or the bus."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Bounds of one gateway, for all of its doors together unless it says otherwise.

    sessions: clients at a time. requests: under way at a time. value_bytes: of one value that is read; a longer one is refused.
    line_bytes: of one line of a text door. send_seconds: a client that takes nothing for so long is cut off. idle_seconds: one
    that says nothing for so long; 0: never. waiting_bytes: what waits for a client that takes it slowly; then events are dropped,
    and counted. subscriptions: objects that one session watches. least_period: seconds between two values of one. ports: PDOs
    that one session has set up.
    """

    sessions: int = 16
    requests: int = 32
    value_bytes: int = 1 << 20
    line_bytes: int = 1 << 16
    send_seconds: float = 30.0
    idle_seconds: float = 0.0
    waiting_bytes: int = 1 << 16
    subscriptions: int = 32
    least_period: float = 0.02
    ports: int = 32
