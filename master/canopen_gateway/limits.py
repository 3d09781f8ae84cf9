"""`Limits`: how much a gateway takes on, so that no client can use up the computer or the bus. `RequestsUnderWay` counts."""

from __future__ import annotations

from dataclasses import dataclass

from canopen_gateway.errors import GatewayFullError


@dataclass(frozen=True)
class Limits:
    """Bounds of one gateway, for all of its doors together unless it says otherwise.

    sessions: clients at a time. requests: under way at a time. value_bytes: of one value that is read; a longer one is refused.
    line_bytes: of one line of a text door. send_seconds: a client that takes nothing for so long is cut off. idle_seconds: one
    that says nothing for so long; 0: never. subscriptions: objects that one session watches. least_period: seconds between two
    values of one. ports: PDOs that one session has set up.
    """

    sessions: int = 16
    requests: int = 32
    value_bytes: int = 1 << 20
    line_bytes: int = 1 << 16
    send_seconds: float = 30.0
    idle_seconds: float = 0.0
    subscriptions: int = 32
    least_period: float = 0.02
    ports: int = 32


class RequestsUnderWay:
    """Counts a request while a `with` block runs. most: of them at a time; GatewayFullError beyond."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._count = 0

    def __enter__(self) -> None:
        if self._count >= self._most:
            raise GatewayFullError("requests at a time", self._most)
        self._count += 1

    def __exit__(self, *exc: object) -> None:
        self._count -= 1
