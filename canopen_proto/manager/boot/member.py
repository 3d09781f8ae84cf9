"""`BootingNode`: a node of the network that the master boots, and all that decides whether it may be started."""

from __future__ import annotations

from typing import Final

from canopen_proto.machine import NEVER, Time
from canopen_proto.manager.boot.entry import BootEntry
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.remote_node import RemoteNode

RENEWALS: Final = 3
"""For so many of its full times the bus may work without a sign of life of a node; then an outage is no excuse any more."""


class BootingNode:
    """A node of the network. outcome: of its last boot-up. boots: the node's count of boot-ups that were seen to.

    started_at: when it was last started. absent_since: since when it is known to be away; NEVER if it is not. watched_since: when
    it last got its full time again, after an outage of the bus. unheard: how long the bus has worked without a sign of its life,
    summed over the stretches between outages. beats: when its heartbeats came, while they are not watched yet.
    sends_none_until: so long its word counts that it sends none. is_unseen: it was started, and has not yet shown that it runs.
    was_reset: it was told to reset, and has not been booted since.
    reset: how it is reset when it is heard again. is_missed: it was lost, and has not booted since.
    """

    def __init__(self, entry: BootEntry, node: RemoteNode) -> None:
        self.entry = entry
        self.node = node
        self.outcome: BootOutcome | None = None
        self.boots = node.boots
        self.reset = NmtCommand.RESET_COMMUNICATION
        self.started_at: Time = -NEVER
        self.absent_since: Time = NEVER
        self.watched_since: Time = -NEVER
        self.unheard: Time = 0
        self.beats: list[Time] = []
        self.sends_none_until: Time = -NEVER
        self.is_booting = False
        self.is_running = False
        self.is_requested = False
        self.is_suspended = False
        self.is_missed = False
        self.is_unseen = False
        self.was_reset = False

    def take_start(self, now: Time) -> None:
        """Take note of a start command."""
        self.is_running, self.started_at, self.is_unseen = True, now, True

    @property
    def is_good(self) -> bool:
        """Whether its last boot-up went well."""
        return self.outcome is not None and not self.outcome.is_failure

    @property
    def is_lost(self) -> bool:
        """Whether it shows no sign of life since a good boot-up."""
        return self.is_good and (self.node.heartbeat.lost or self.node.guarding.lost)

    @property
    def is_supervised(self) -> bool:
        """Whether its loss would be noticed: its heartbeats are watched, or it is guarded."""
        return bool(self.node.heartbeat.timeout or self.node.guarding.guard_time)

    @property
    def unconfirmed(self) -> NmtCommand | None:
        """The reset that it was told, if no boot-up has come since."""
        return self.reset if self.was_reset and self.node.boots == self.boots else None

    @property
    def is_idle(self) -> bool:
        """Whether it was started, or left running, and its own word, or a command since, is that it does not run."""
        return self.is_running and self.node.nmt_state is not NmtState.OPERATIONAL

    @property
    def is_left_running(self) -> bool:
        """Whether it has failed, was not reset since it is kept alive, and was last heard as Operational."""
        outcome = self.outcome
        if outcome is None or not outcome.is_failure or not self.entry.assignment.keep_alive:
            return False
        is_silent = outcome.letter in (BootLetter.SILENT, BootLetter.NO_HEARTBEAT, BootLetter.NO_GUARDING)
        return not is_silent and not self.node.heartbeat.lost and self.node.nmt_state is NmtState.OPERATIONAL

    def may_be_unheard(self, outage: str, back_at: Time) -> bool:
        """Return whether it was lost while the bus was away (`outage`), or before it could show itself since (`back_at`)."""
        heard = self.node.heartbeat.last_heard or -NEVER
        is_patient = self.has_patience or heard > self.watched_since
        return bool(outage) or (is_patient and max(heard, self.watched_since) < back_at)

    @property
    def has_patience(self) -> bool:
        """Whether it gets its full time again after an outage: a bus that comes and goes would renew it for ever."""
        return self.unheard < RENEWALS * (self.node.heartbeat.timeout or self.node.guarding.life_time)

    def count_unheard(self, heard: Time | None, now: Time) -> None:
        """Add the stretch that ends now. heard: when it last told its NMT state."""
        heard = -NEVER if heard is None else heard
        if heard >= self.watched_since:
            self.unheard = 0
        self.unheard += max(0, now - max(heard, self.watched_since))

    def watch_again(self, now: Time) -> None:
        """Give it its full time again to show itself."""
        self.watched_since = now
        heartbeat, guarding = self.node.heartbeat, self.node.guarding
        timeout, guard_time = heartbeat.timeout, guarding.guard_time
        if timeout:
            heartbeat.set_timeout(0, now)
            heartbeat.set_timeout(timeout, now, begun=True)
        if guard_time:
            life_time_factor = guarding.life_time // guard_time
            self.node.stop_guarding()
            self.node.start_guarding(guard_time, life_time_factor, now)

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
