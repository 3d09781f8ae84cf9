"""The peer without a bus and without threads: two of its Networks, coupled by a function call.

`canopen` sends by `network.bus.send(message)` and receives by its listener,
`network.listeners[0].on_message_received(message)`. So a "bus" whose `send` calls the other side's listener is all that is
needed: the answer is in the client's queue before `send` returns, and its blocking `get` finds it there. Making the
`can.Message` is part of what is measured, because `canopen` makes it itself; what python-can's drivers would cost on top is
in neither side.
"""

from __future__ import annotations

import logging
from typing import Any

import canopen

VERSION = canopen.__version__


class DirectBus:
    """Stands where a python-can bus stands; hands each message straight to the other network."""

    channel_info = "direct"

    def __init__(self, other: canopen.Network) -> None:
        self._receive = other.listeners[0].on_message_received

    def send(self, message: Any, timeout: float | None = None) -> None:
        self._receive(message)


def coupled_networks() -> tuple[canopen.Network, canopen.Network]:
    """Two networks of the peer; what one sends, the other receives before `send` returns."""
    logging.getLogger("canopen").setLevel(logging.WARNING)
    first, second = canopen.Network(), canopen.Network()
    first.bus, second.bus = DirectBus(second), DirectBus(first)
    return first, second


def variable(name: str, index: int, subindex: int, data_type: int, access: str = "rw") -> canopen.objectdictionary.ODVariable:
    """One variable of the peer's object dictionary."""
    described = canopen.objectdictionary.ODVariable(name, index, subindex)
    described.data_type = data_type
    described.access_type = access
    return described


def record(name: str, index: int, *members: canopen.objectdictionary.ODVariable) -> canopen.objectdictionary.ODRecord:
    """One record of the peer's object dictionary."""
    described = canopen.objectdictionary.ODRecord(name, index)
    for member in members:
        described.add_member(member)
    return described
