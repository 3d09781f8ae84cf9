"""`Follower`: a machine of a `Network` that follows the SYNC and NMT commands of the others."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from canopen_proto.machine import Time
from canopen_proto.nmt import NmtCommand


@runtime_checkable
class Follower(Protocol):
    """A machine (a RemoteNode) to which the Network reports what the other machines sent or received."""

    node_id: int

    def on_sync(self, counter: int | None, now: Time, *, heard: bool = False) -> None:
        """React to a SYNC that we sent, or heard; a heard one may have been on its way for a while."""

    def on_nmt_command(self, command: NmtCommand, now: Time) -> None:
        """React to an NMT command for this node that we sent."""
