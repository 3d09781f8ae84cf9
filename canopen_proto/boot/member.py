"""`Member`: a node of the network that the master boots, and all that decides whether it may be started."""

from __future__ import annotations

from canopen_proto.boot.entry import BootEntry
from canopen_proto.boot.outcome import BootOutcome
from canopen_proto.machine import NEVER, Time
from canopen_proto.nmt import NmtCommand
from canopen_proto.remote_node import RemoteNode


class Member:
    """A node of the network. outcome: of its last boot-up. boots: the node's count of boot-ups that were seen to.

    started_at: when it was last started. absent_since: since when it is known to be away; NEVER if it is not. reset: how it is
    reset when it is heard again.
    """

    def __init__(self, entry: BootEntry, node: RemoteNode) -> None:
        self.entry = entry
        self.node = node
        self.outcome: BootOutcome | None = None
        self.boots = node.boots
        self.reset = NmtCommand.RESET_COMMUNICATION
        self.started_at: Time = -NEVER
        self.absent_since: Time = NEVER
        self.is_booting = False
        self.is_running = False
        self.is_requested = False
        self.is_suspended = False

    def take_start(self, now: Time) -> None:
        """Take note of a start command."""
        self.is_running, self.started_at = True, now

    @property
    def is_good(self) -> bool:
        """Whether its last boot-up went well."""
        return self.outcome is not None and not self.outcome.is_failure

    @property
    def is_lost(self) -> bool:
        """Whether it shows no sign of life since a good boot-up."""
        return self.is_good and (self.node.heartbeat.lost or self.node.guarding.lost)

    @property
    def is_gone(self) -> bool:
        """Whether it is lost, or has booted again, since a good boot-up."""
        return self.is_lost or (self.is_good and self.node.boots != self.boots)

    @property
    def is_ready(self) -> bool:
        """Whether it is as a good boot-up has left it."""
        return self.is_good and not self.is_gone and not self.is_suspended

    @property
    def may_start(self) -> bool:
        return self.is_ready and self.entry.assignment.boots and not self.is_running

    @property
    def has_come_back(self) -> bool:
        """Whether it was away, and was heard without a boot-up."""
        heard = self.node.heartbeat.last_heard
        return heard is not None and heard > self.absent_since
