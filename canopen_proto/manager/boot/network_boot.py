"""The NMT master's start of a network, and what it does afterwards: `NetworkBoot`.

`start` resets the communication of all nodes, then boots them side by side (node_boot.py). Each node is started as soon as it is
ready; with 0x1F80 bit 1 all are started at once, when all mandatory nodes are ready. If a mandatory node fails, the network does
not start: with bit 1 no node runs then, else those that are ready. `supervise` goes on where `start` has ended:

    a node boots, later or again           its boot-up, then its start; the others are not touched
    a mandatory node is ready at last      the network is started
    a mandatory node is lost               0x1F80 bit 6: all nodes are stopped, and `supervise` ends
                                           bit 4: all nodes are reset, and the network starts again
    any other node is lost                 it is reset; a node that is kept alive is not
    a lost one is heard without a boot-up  it is reset again: the first time it was not connected

**No failed node is ever started.** Right before a start command, the node still has to be as its boot-up has left it: not lost,
not booted again. The command to all nodes (bit 1) is sent only if each listed node is ready, and nobody else was heard; else the
ready ones are started one by one. A node that is kept alive is reset only if it is not Operational. A node that boots just when
it is started runs without its settings until its boot-up is heard; then it is reset.

**Running is who shows it.** NMT commands are not confirmed. A node that is watched, and still shows Pre-operational after its
start, has not got the command: it is sent again, START_TRIES times in all. `BootReport.idle` names those that do not run all the
same, or that another master has sent into another state since; they are left to that master.

**Watched is whoever sends heartbeats.** A node without a consumer time and without guarding is watched by the time in its 0x1017.
A node that begins to send heartbeats later is watched from then on (`NodeSupervised`): by its 0x1017, or, if it does not answer,
by the longest of the first intervals. Such a node is lost only if it does not answer either: when its heartbeats stop, its 0x1017
is read. If it answers, it is watched by its new time, or no longer, until its next heartbeat.
`BootReport.unsupervised` names the nodes whose loss nobody would notice.

**A bus above its nodes.** While the driver says that no frames pass (`Network.outage`), no node is lost, and nothing is reset or
stopped for it. Once the bus is back, each node has its full time again.

Each loss has one reaction: while a node is lost or boots, nobody waits for its heartbeats. The host may `suspend` a node while it
gets a program.

Source: CiA 302-2 v4.1.0, process boot NMT master (from memory) and error handling (figure 12, as Lely core's master, nmt.c, cites
it: bits 6 and 4 of 0x1F80). That master differs in this: it also resets a lost node that is kept alive, and it sends the command
to all nodes though one has failed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortOrigin
from canopen_proto.guarding import NodeGuardingLost
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, LocalProtocolError, Time
from canopen_proto.manager.boot.entry import CONSUMER_FACTOR, NetworkEntry
from canopen_proto.manager.boot.member import BootingNode
from canopen_proto.manager.boot.node_boot import DEFAULT_TIMES, BootTimes, NmtCommands, NodeHook, boot_node, watch_by
from canopen_proto.manager.boot.outcome import BootEnded, BootLetter, BootOutcome
from canopen_proto.network import Network, OutageChanged
from canopen_proto.nmt import ALL_NODES, NmtCommand, NmtMaster, NmtState
from canopen_proto.procedures.steps import Procedure, SdoTransferError, Wait, act, all_of, current_time, upload
from canopen_proto.remote_node import NMT_REACTION_TIME, RemoteNode

ROUNDS: Final = 3
"""How often `start` boots a node that boots again while others are not ready yet."""


ASKED_AGAIN: Final = 1 * SECOND
"""After so long, a node that says that it sends no heartbeats, and seems to, is asked again."""
MEASURED: Final = 3
"""Intervals of heartbeats from which a period is taken that the node does not tell: an adapter may hold single frames back."""
LEAST_MEASURED: Final = 100 * MILLISECOND
"""The shortest consumer time that is taken from measured intervals."""
START_TRIES: Final = 3
"""How often a start command is sent, until a heartbeat shows that the node runs."""
SEEN_WITHIN: Final = 2 * SECOND
"""For a heartbeat after a start, before `start` ends: slower ones are for `supervise`."""
LOOK: Final = 100 * MILLISECOND
"""Between two looks whether the others have booted."""


class LossResponse(StrEnum):
    """What the master has sent because of a lost node, in words."""

    RESET = "the master has sent it a reset"
    RESET_ALL = "the master has reset all nodes"
    STOP_ALL = "the master has stopped all nodes"
    NONE = "the master has sent nothing"


_FOR_ALL: Final = (LossResponse.STOP_ALL, LossResponse.RESET_ALL)


class NodeLost(Event):
    """A booted node has shown no sign of life in time. reaction: of the master."""

    __match_args__ = ("node_id", "reaction")

    def __init__(self, node_id: int, reaction: LossResponse) -> None:
        self.node_id = node_id
        self.reaction = reaction


class NetworkStarted(Event):
    """All mandatory nodes are ready. running: the nodes that were started so far, or left running."""

    __match_args__ = ("node_id", "running")

    def __init__(self, node_id: int, running: tuple[int, ...]) -> None:
        self.node_id = node_id
        self.running = running


class NodeSupervised(Event):
    """The heartbeats of a node, which the master was not told to watch, are watched from now on. timeout: its consumer time, ns.

    timeout 0: no longer, since it answers and sends none.
    """

    __match_args__ = ("node_id", "timeout")

    def __init__(self, node_id: int, timeout: Time) -> None:
        self.node_id = node_id
        self.timeout = timeout


class _BootRequested(Event):
    """The host wants a node to be booted again."""


_OF_ABSENT: Final = (BootLetter.SILENT, BootLetter.NO_HEARTBEAT, BootLetter.NO_GUARDING)
"""The outcomes of nodes that are not there, unless they were heard meanwhile."""


_TROUBLE: Final = (NodeBooted, HeartbeatLost, NodeGuardingLost, _BootRequested)
"""The events after which a node has to be looked at."""


@dataclass(frozen=True, slots=True)
class BootReport:
    """How the start of a network went.

    outcomes: by node-ID, as far as there are. missing: the mandatory nodes that are not ready. running: the nodes that were
    started, or left running, and are still as they were then, as far as is known. idle: those that were, and show that they do
    not run. gone: those that were ready, and are lost or have booted again. unsupervised: those that are ready, and whose loss
    nobody would notice: they send no heartbeat, and are not guarded. left_running: those that have failed, were not reset since
    they are kept alive, and were last heard as Operational. elapsed: ns.
    """

    outcomes: Mapping[int, BootOutcome]
    missing: tuple[int, ...]
    running: tuple[int, ...]
    gone: tuple[int, ...]
    elapsed: Time
    unsupervised: tuple[int, ...] = ()
    left_running: tuple[int, ...] = ()
    idle: tuple[int, ...] = ()

    @property
    def is_started(self) -> bool:
        """Whether all mandatory nodes are ready."""
        return not self.missing


class _LostAtStart(Exception):
    """A mandatory node was lost, which concerns all, while others boot."""


class _MandatoryLost(Exception):
    """A mandatory node was lost, which concerns all."""

    def __init__(self, lost: NodeLost) -> None:
        self.lost = lost


class NetworkBoot:
    """The boot-up of a network; see this module's text. is_started: all mandatory nodes were ready."""

    def __init__(
        self,
        network: Network,
        nmt: NmtMaster,
        description: NetworkEntry,
        nodes: Mapping[int, RemoteNode],
        *,
        own_id: int | None = None,
        own: Callable[[NmtCommand, Time], object] = lambda command, now: None,
        times: BootTimes = DEFAULT_TIMES,
        update: NodeHook | None = None,
        configure: NodeHook | None = None,
    ) -> None:
        """nmt, nodes: attached to the network; a node for each entry. own_id, own: our own node-ID, and what to call with the
        commands that concern our own node too, such as `LocalNode.execute`. update, configure: as for `boot_node`.

        Raises LocalProtocolError if a node is missing or has another node-ID, or if 0x1F80 says that we are not the master.
        """
        if not description.startup.is_master:
            raise LocalProtocolError("0x1F80 bit 0 is 0: this device is not the NMT master, and boots no network")
        missing = sorted(description.nodes.keys() - nodes.keys())
        if missing:
            raise LocalProtocolError(f"there is no RemoteNode for node {', '.join(map(str, missing))}")
        for node_id in description.nodes:
            if nodes[node_id].node_id != node_id:
                raise LocalProtocolError(f"the RemoteNode for node {node_id} is that of node {nodes[node_id].node_id}")
        self.network = network
        self.startup = description.startup
        self.boot_time = description.boot_time
        self.commands = NmtCommands(nmt, description.pause)
        self.is_started = False
        self._own_id = own_id
        self._own = own
        self._times = times
        self._update = update
        self._configure = configure
        self._members = {node_id: BootingNode(entry, nodes[node_id]) for node_id, entry in sorted(description.nodes.items())}
        self._listed = [member for member in self._members.values() if member.entry.assignment.is_listed]
        self._begun: Time = 0

    # ---- for the host ----

    def report(self, now: Time) -> BootReport:
        """Return how it went so far, at any time."""
        members = self._members.items()
        gone = {node_id for node_id, member in members if member.is_missed or (member.is_gone and not self._is_unheard(member))}
        return BootReport(
            {node_id: member.outcome for node_id, member in members if member.outcome is not None},
            tuple(node_id for node_id, member in members if member.entry.assignment.is_mandatory and not member.is_ready),
            tuple(node_id for node_id, member in members if member.is_running and not member.is_idle and node_id not in gone),
            tuple(sorted(gone)),
            now - self._begun,
            tuple(node_id for node_id, member in members if member.is_ready and not member.is_supervised),
            tuple(node_id for node_id, member in members if member.is_left_running),
            tuple(node_id for node_id, member in members if member.is_idle and node_id not in gone),
        )

    def _is_unheard(self, member: BootingNode) -> bool:
        """Return whether a lost node may be there: its bus is, or was, away."""
        return member.is_lost and member.may_be_unheard(self.network.outage, self.network.back_at)

    def suspend(self, node_id: int, now: Time) -> None:
        """Leave a node alone until `boot_again`: something is done to it, such as a program download, that looks like a loss.

        Only a command to all nodes still concerns it: a new start of the network, and the loss of another mandatory node.
        Raises LocalProtocolError for a node that is not in the network, or boots at present.
        """
        member = self._member(node_id)
        if member.is_booting:
            raise LocalProtocolError(f"node {node_id} boots at present. Try: wait for its BootEnded")
        member.is_suspended = True
        self._stop_watching(member, now)

    def boot_again(self, node_id: int, now: Time) -> None:
        """Reset a node and boot it, once `supervise` runs: it was suspended, or failed for a reason that is gone.

        A node that is kept alive is not reset if it is Operational. Raises LocalProtocolError for an unknown node.
        """
        member = self._member(node_id)
        member.is_suspended = False
        member.is_requested = True
        member.node.out.events.append(_BootRequested(node_id))

    def _member(self, node_id: int) -> BootingNode:
        member = self._members.get(node_id)
        if member is None:
            raise LocalProtocolError(f"node {node_id} is not in the network list")
        return member

    # ---- the start ----

    def start(self) -> Procedure[BootReport]:
        """Reset, boot and start the network; return how it went. It ends when each node has failed or is ready, and, if it was
        started and is watched, has shown whether it runs (SEEN_WITHIN at most); and early if a
        mandatory node is lost again, and the reaction to that (bits 4, 6) is one for all nodes: `supervise` shows it at once.

        Mandatory nodes have `boot_time` to answer; all others, and without a limit all, are asked once, after the time for their
        boot-up. Those that come later are for `supervise`.
        """
        self._begun = yield from current_time()
        yield from self._reset()
        return (yield from self._boot_all())

    def _reset(self) -> Procedure[None]:
        """Reset the communication of all nodes, except those that are kept alive, and except ourselves."""
        kept = {node_id for node_id, member in self._members.items() if member.entry.assignment.keep_alive}
        if not kept:
            yield from self._command_all(NmtCommand.RESET_COMMUNICATION)
            return
        listed = {member.node.node_id for member in self._listed}
        for node_id in sorted((listed | set(self.network.heard_nodes())) - kept - {self._own_id}):
            yield from self._reset_node(NmtCommand.RESET_COMMUNICATION, node_id)

    def _reset_node(self, command: NmtCommand, node_id: int) -> Procedure[bool]:
        """Reset a node, unless it is suspended: it may be getting a program. Return whether it was reset."""
        member = self._members.get(node_id)

        def may_reset() -> bool:
            return (member is None or not member.is_suspended) and self._forget(node_id)

        return (yield from self.commands.send(command, node_id, may_reset))

    def _command_all(self, command: NmtCommand) -> Procedure[None]:
        def forget_all() -> bool:
            return all(self._forget(node_id) for node_id in self._members)

        yield from self.commands.send(command, ALL_NODES, forget_all)

    def _forget(self, node_id: int) -> bool:
        """Forget what is known of a node: it will be reset, and boot. A boot-up that it has sent before does not count."""
        member = self._members.get(node_id)
        if member is not None:
            member.boots, member.outcome, member.is_running = member.node.boots, None, False
            member.was_reset = not member.entry.assignment.keep_alive
        return True

    def _boot_all(self) -> Procedure[BootReport]:
        self.is_started = False
        until = self._begun + self.boot_time if self.boot_time else 0
        try:
            yield from all_of(*(self._first_boot(member, until) for member in self._members.values()))
            for _ in range(ROUNDS):
                again = [member for member in self._listed if member.is_good and member.node.boots != member.boots]
                if not again:
                    break
                yield from all_of(*(self._on_boot_up(member) for member in again))
            yield from all_of(*(self._see_all_running(member) for member in self._listed))
        except _LostAtStart:
            return (yield from act(self.report))
        return (yield from act(self.report))

    def _first_boot(self, member: BootingNode, until: Time) -> Procedure[None]:
        assignment = member.entry.assignment
        if assignment.is_listed and not assignment.keep_alive:
            yield from self._await_boot_up(member)
        yield from self._boot(member, self._begun, until if assignment.is_mandatory else 0)
        yield from self._see_running(member, SEEN_WITHIN)
        one_by_one = not self.startup.start_all  # else those that have ended here are started, and seen, later
        yield from self._look_out(
            member, lambda each: (each.outcome is None and not each.is_suspended) or (one_by_one and each.is_unseen)
        )

    def _see_all_running(self, member: BootingNode) -> Procedure[None]:
        yield from self._see_running(member, SEEN_WITHIN)
        yield from self._look_out(member, lambda each: each.is_unseen)

    def _look_out(self, member: BootingNode, is_awaited: Callable[[BootingNode], bool]) -> Procedure[None]:
        """While others are awaited, look whether a node is lost; raise _LostAtStart if that concerns all."""
        if self._reaction_to(member) not in _FOR_ALL:
            return
        while any(is_awaited(each) for each in self._members.values()):
            if member.is_lost:
                if not self._is_unheard(member):
                    raise _LostAtStart
                yield from self._await_bus(member)
            yield Wait(LOOK, member.node, _is_of(member), _TROUBLE)

    def _await_boot_up(self, member: BootingNode) -> Procedure[None]:
        """Wait for the boot-up of a node that was reset, for its time at most."""
        if member.node.boots == member.boots:
            yield Wait(self._times.boot_up, member.node, _is_of(member), (NodeBooted,))

    def _boot(self, member: BootingNode, since: Time, until: Time = 0) -> Procedure[None]:
        """Boot a node, report its outcome, and start what is ready now. since: a node that was not heard since then is away."""
        if member.is_suspended:
            return
        member.is_booting, member.is_running, member.is_requested, member.outcome = True, False, False, None
        unconfirmed, member.was_reset = member.unconfirmed, False
        try:
            outcome = yield from boot_node(
                member.node,
                self.commands,
                member.entry,
                times=self._times,
                until=until,
                update=self._update,
                configure=self._configure,
                unconfirmed=unconfirmed,
            )
        finally:
            member.is_booting = False
        if outcome.is_failure and self.network.outage:
            outcome = replace(outcome, remark=self.network.outage)
        member.outcome, member.boots, member.beats, member.is_missed = outcome, member.node.boots, [], False
        member.is_running = outcome.letter is BootLetter.RUNNING
        heard = member.node.heartbeat.last_heard
        member.absent_since = since if outcome.letter in _OF_ABSENT and (heard is None or heard < since) else NEVER
        yield from act(lambda now: member.node.out.events.append(BootEnded(member.node.node_id, outcome)))
        if not self.startup.start_all or self.is_started:
            yield from self._start(member)
        yield from self._start_network()

    def _start(self, member: BootingNode) -> Procedure[None]:
        """Start a node, if that is allowed."""
        if self.startup.application_starts:
            return
        if (yield from self.commands.send(NmtCommand.START, member.node.node_id, lambda: member.may_start)):
            yield from act(member.take_start)

    def _see_running(self, member: BootingNode, limit: Time = NEVER) -> Procedure[None]:
        """See by its heartbeat, or its answer to guarding, that a node has followed its start command; send it again if it has
        not. Not more than one task at a time does so."""
        node, tries = member.node, 1
        while member.is_unseen:
            timeout = min(node.heartbeat.timeout or node.guarding.life_time, limit)
            event = (yield Wait(timeout, node, _is_of(member), (HeartbeatReceived, *_TROUBLE))) if timeout else None
            if not isinstance(event, HeartbeatReceived) or event.state is not NmtState.PRE_OPERATIONAL:
                break
            if (yield from current_time()) - member.started_at < NMT_REACTION_TIME:
                continue
            if tries == START_TRIES or not (yield from self._start_again(member)):
                break
            tries += 1
        member.is_unseen = False

    def _start_again(self, member: BootingNode) -> Procedure[bool]:
        def is_wanted() -> bool:
            return member.is_ready and member.is_running

        sent = yield from self.commands.send(NmtCommand.START, member.node.node_id, is_wanted)
        if sent:
            yield from act(member.take_start)
        return sent

    def _start_network(self) -> Procedure[None]:
        """Start the network, if the time for it has come. A start that is right before a pause may be wrong after it."""
        if self.startup.start_all and self._may_start_network():
            yield from self.commands.wait()
        if not self._may_start_network():
            return
        self.is_started = True
        if not self.startup.waits:
            yield from act(lambda now: self._own(NmtCommand.START, now))
        if self.startup.start_all and not self.startup.application_starts:
            yield from self._start_all()
        running = tuple(node_id for node_id, member in self._members.items() if member.is_running)
        yield from act(lambda now: self.network.out.events.append(NetworkStarted(0, running)))

    def _may_start_network(self) -> bool:
        """Return whether all mandatory nodes are ready; without any, whether all nodes have booted or failed."""
        members = self._members.values()
        mandatory = [member for member in members if member.entry.assignment.is_mandatory]
        if mandatory:
            return not self.is_started and all(member.is_ready for member in mandatory)
        return not self.is_started and all(member.outcome is not None or member.is_suspended for member in members)

    def _start_all(self) -> Procedure[None]:
        members = self._members.values()

        def all_may_start() -> bool:
            if set(self.network.heard_nodes()) - self._members.keys() - {self._own_id}:
                return False  # it would start nodes that nobody has checked
            return all(member.may_start or (member.is_ready and member.is_running) for member in members)

        if (yield from self.commands.send(NmtCommand.START, ALL_NODES, all_may_start)):
            for member in members:
                yield from act(member.take_start)
        else:
            for member in members:
                yield from self._start(member)

    # ---- afterwards ----

    def supervise(self) -> Procedure[NodeLost]:
        """Boot nodes that come later, or come back, and react to lost ones; see this module's text.

        It runs until it is cancelled. It ends by itself only if all nodes were stopped because a mandatory one was lost (0x1F80
        bit 6): the loss is returned.
        """
        while True:
            try:
                yield from all_of(*(self._watch(member) for member in self._listed))
                yield Wait(None)  # there are no nodes
            except _MandatoryLost as failed:
                lost = failed.lost
            if lost.reaction is LossResponse.STOP_ALL:
                yield from self._for_all(NmtCommand.STOP)
                return lost
            self._begun = yield from current_time()
            yield from self._for_all(NmtCommand.RESET_NODE)
            yield from self._boot_all()

    def _for_all(self, command: NmtCommand) -> Procedure[None]:
        """Command all nodes and our own one, and watch none of them any more."""
        yield from act(self._watch_nobody)
        yield from self._command_all(command)
        yield from act(lambda now: self._own(command, now))

    def _watch(self, member: BootingNode) -> Procedure[None]:
        """Look after one node, for ever."""
        while True:
            if self.network.outage or self._is_unheard(member):
                yield from self._await_bus(member)
            elif member.is_suspended:
                yield Wait(None, member.node, _is_of(member), (_BootRequested,))
            elif member.is_requested:
                yield from self._reset_and_boot(member)
            elif member.node.boots != member.boots:
                yield from self._on_boot_up(member)
            elif member.is_lost:
                if member.entry.consumer_time or not member.node.heartbeat.lost or not (yield from self._answers(member)):
                    yield from self._on_lost(member)
            elif member.has_come_back:
                yield from self._reset_and_boot(member)
            elif member.is_unseen:
                yield from self._see_running(member)
            else:
                learns = member.is_good and not member.is_supervised and member.entry.learns
                sign_of_life = (HeartbeatReceived,) if learns or member.absent_since < NEVER else ()
                event = yield Wait(None, member.node, _is_of_or_outage(member), (*_TROUBLE, OutageChanged, *sign_of_life))
                if learns and isinstance(event, HeartbeatReceived):
                    yield from self._learn(member)

    def _await_bus(self, member: BootingNode) -> Procedure[None]:
        """Wait while no frames pass; then give a node its full time again, unless it was silent for long between outages."""
        heard = self.network.heard(member.node.node_id).state_time
        if self.network.outage:
            yield from act(lambda now: member.count_unheard(heard, now))
        while self.network.outage:
            yield Wait(None, member.node, _is_outage, (OutageChanged,))
        if member.has_patience:
            yield from act(member.watch_again)

    def _learn(self, member: BootingNode) -> Procedure[None]:
        """Watch a node that has begun to send heartbeats, as soon as its period is known."""
        node = member.node
        now = yield from current_time()
        if now < member.sends_none_until:
            return
        member.beats.append(now)
        timeout: Time = 0
        if len(member.beats) == 1:
            try:
                period = yield from upload(node.sdo, indices.PRODUCER_HEARTBEAT_TIME, 0)
            except (SdoTransferError, LocalProtocolError):
                period = b""  # it does not say, or other requests fill its queue: then it is measured
            if period and not any(period):  # it has answered another master's guarding
                member.beats.clear()
                member.sends_none_until = now + ASKED_AGAIN
            elif member.is_ready:
                timeout = yield from act(lambda now: watch_by(node, period, now))
        elif len(member.beats) > MEASURED:
            longest = max(after - before for before, after in pairwise(member.beats))
            timeout = max(CONSUMER_FACTOR * longest, LEAST_MEASURED)
            yield from act(lambda now: node.heartbeat.set_timeout(timeout, now))
        if timeout:
            member.beats.clear()
            yield from act(lambda now: node.out.events.append(NodeSupervised(node.node_id, timeout)))

    def _answers(self, member: BootingNode) -> Procedure[bool]:
        """Return whether a node whose heartbeats have stopped is there all the same: it answers, or is heard meanwhile."""
        node, before, period = member.node, member.node.heartbeat.timeout, b""
        try:
            period = yield from upload(node.sdo, indices.PRODUCER_HEARTBEAT_TIME, 0)
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.PEER:
                return not member.is_lost or member.is_suspended or self._is_unheard(member) or node.boots != member.boots
        except LocalProtocolError:  # other requests fill its queue, and none of them is answered
            return False
        if member.is_lost and not member.is_suspended and node.boots == member.boots:
            member.beats.clear()
            yield from act(lambda now: node.heartbeat.set_timeout(0, now))
            timeout = yield from act(lambda now: watch_by(node, period, now))
            if timeout == before:  # it does not do what its 0x1017 says
                timeout = 0
                yield from act(lambda now: node.heartbeat.set_timeout(0, now))
            yield from act(lambda now: node.out.events.append(NodeSupervised(node.node_id, timeout)))
        return True

    def _on_boot_up(self, member: BootingNode) -> Procedure[None]:
        """Check, configure and start a node whose boot-up frame has come. If a start command crossed that frame on the bus, the
        node may run without its settings: it is reset before."""
        now = yield from current_time()
        if member.node.booted_at - member.started_at < NMT_REACTION_TIME:
            yield from self._reset_node(NmtCommand.RESET_COMMUNICATION, member.node.node_id)
            yield from self._await_boot_up(member)
        yield from self._boot(member, now)

    def _on_lost(self, member: BootingNode) -> Procedure[None]:
        lost = NodeLost(member.node.node_id, self._reaction_to(member))
        yield from act(lambda now: self._take_loss(member, lost, now))
        if lost.reaction in _FOR_ALL:
            raise _MandatoryLost(lost)
        if lost.reaction is LossResponse.RESET:
            member.reset = NmtCommand.RESET_NODE
            yield from self.commands.send(member.reset, member.node.node_id, lambda: not member.is_suspended)
            yield from self._await_boot_up(member)
        member.absent_since = yield from current_time()

    def _reaction_to(self, member: BootingNode) -> LossResponse:
        assignment = member.entry.assignment
        if assignment.is_mandatory and self.startup.stop_all_on_loss:
            return LossResponse.STOP_ALL
        if assignment.is_mandatory and self.startup.reset_all_on_loss:
            return LossResponse.RESET_ALL
        return LossResponse.RESET if assignment.boots and not assignment.keep_alive else LossResponse.NONE

    def _take_loss(self, member: BootingNode, lost: NodeLost, now: Time) -> None:
        member.node.heartbeat.set_timeout(0, now)  # guarding goes on: only so a node that is connected again is heard
        member.boots, member.outcome, member.is_running, member.absent_since = member.node.boots, None, False, now
        member.is_missed = True
        member.node.out.events.append(lost)

    def _watch_nobody(self, now: Time) -> None:
        for member in self._members.values():
            self._stop_watching(member, now)

    def _stop_watching(self, member: BootingNode, now: Time) -> None:
        member.node.heartbeat.set_timeout(0, now)
        member.node.stop_guarding()

    def _reset_and_boot(self, member: BootingNode) -> Procedure[None]:
        """Boot a node that has not just booted: reset it, unless the master leaves that to the application, or keeps it alive."""
        assignment = member.entry.assignment
        since = yield from current_time()
        if assignment.boots and not assignment.keep_alive:
            if not (yield from self._reset_node(member.reset, member.node.node_id)):
                return
            yield from self._await_boot_up(member)
        yield from self._boot(member, since)


def _is_outage(event: Event) -> bool:
    return isinstance(event, OutageChanged)


def _is_of_or_outage(member: BootingNode) -> Callable[[Event], bool]:
    node_id = member.node.node_id
    return lambda event: event.node_id == node_id or isinstance(event, OutageChanged)


def _is_of(member: BootingNode) -> Callable[[Event], bool]:
    node_id = member.node.node_id
    return lambda event: event.node_id == node_id
