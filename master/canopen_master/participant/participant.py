"""`Participant`: one participant on one or several CAN buses: what runs there, and how tasks command it and hear of it.

A `Participant` has one core Network for each bus, all with one Runner, and the pump that drives them (pump.py). It knows nothing
of drives: a `Master` (master.py) is a participant with nodes, drives and chains. Everything that it offers is one of three kinds:

- a command that only mutates: it is called, `pump` follows, done;
- a request with an outcome (an SDO transfer, a procedure): a task waits for the Outcome event of that id. If the task is
  cancelled, the request is taken back: a transfer is aborted on the wire; a procedure is cancelled, and the task waits, shielded,
  for its clean-up (it halts what it moved);
- a subscription to events.

SYNC is one for all buses: it is sent on each of them at the same instant, back to back. Before one that is late is sent, because
this process was stalled, those who follow it may look at their drives (`SyncGuard`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any, Final, Protocol, TypeVar

from canopen_master.errors import UNKNOWN_CHAIN, BusError, MasterClosedError, UnknownChainError, forked
from canopen_master.participant.bus import Bus
from canopen_master.participant.dispatch import Dispatcher, ProcedureTakenBackError, Waiter, Watcher, check_callback, event_kinds
from canopen_master.participant.pump import Pump
from canopen_master.participant.requests import OpenRequest
from canopen_master.participant.sleeping import sleep_watch
from canopen_master.participant.subscription import Subscription
from canopen_master.seconds import nanoseconds
from canopen_proto.heartbeat import HeartbeatReceived
from canopen_proto.machine import NEVER, SECOND, Event, LocalProtocolError, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, all_of, current_time
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sync import SyncConsumer, SyncProducer
from canopen_transports import Transport, TransportError
from canopen_transports.loop import CancelScope, NoLoopError, current_loop, protected

T = TypeVar("T")
E = TypeVar("E", bound=Event)

ON_TIME: Final = 20
"""A SYNC that is late by less than this part of its period is on time: clocks of computers jitter."""

_LOOK = 0.1
"""Seconds between two looks, on the way out, whether a drive needs longer."""


class SyncGuard(Protocol):
    """Is asked before a SYNC is sent that is late, in the pump's turn."""

    def look_before_sync(self, late: Time) -> Procedure[object] | None:
        """Return what has to be done before SYNC is sent; None: nothing. late: ns. The procedure must not fail."""

    def look_again(self, took: Time) -> Procedure[object] | None:
        """Return what has to be done once more; None: nothing. took: ns, of all that the guards did, side by side."""

    def before_late_sync(self, late: Time) -> None:
        """SYNC is sent now. late: ns."""

    def before_ordered_sync(self, late: Time) -> None:
        """SYNC is sent now by a command, and was not sent before. late: ns since then."""


class Participant:
    """See this module's text. buses: the Bus objects by their names. failure: why it went down, or None.

    is_closed: it takes no new commands. Times are in seconds here.
    """

    def __init__(self, transports: Mapping[str, Transport], aliases: Mapping[str, str] | None = None) -> None:
        """transports: open ones, by name. aliases: more names for them."""
        self._loop = current_loop()
        self._dispatcher = Dispatcher()
        self.buses: dict[str, Bus] = {}
        self._nmt: dict[Bus, NmtMaster] = {}
        self._sync: dict[Bus, SyncProducer] = {}
        for name, transport in transports.items():
            self._add_bus(name, transport)
        self._own_buses = tuple(self.buses.values())
        self._pump = Pump(self._own_buses, self._dispatcher.dispatch, self.on_failure, before_timeouts=self._before_timeouts)
        self._tell_networks()
        self._token = self._loop.token()
        self.runner = self._own_buses[0].network.runner
        self._root = self._own_buses[0].network.out.root
        for alias, name in (aliases or {}).items():
            self.buses[alias] = self.buses[name]
        self._procedures: set[RequestId] = set()
        self._procedure_ended = self._loop.parking_lot()
        self._guards: list[SyncGuard] = []
        self._looking: tuple[RequestId, Time] | None = None  # and when the SYNC was due that waits for it
        self._without_sync: Time | None = None  # since when SYNC is stopped
        self._sleep_watch = sleep_watch()
        self._subscriptions: dict[Subscription[Any], Watcher] = {}
        self.failure: Exception | None = None
        self.is_closed = False
        self._body = self._loop.cancel_scope()
        self.watch((ProcedureFinished, ProcedureFailed, ProcedureCancelled), self._on_procedure_ended, self._own_buses[0])

    def _add_bus(self, name: str, transport: Transport) -> None:
        network = Network(next(iter(self.buses.values())).network.runner if self.buses else None)
        sync, consumer = SyncProducer(network.out), SyncConsumer(network.out)
        bus = self.buses[name] = Bus(name, transport, network, sync, consumer)
        self._sync[bus] = sync
        self._nmt[bus] = NmtMaster(network.out)
        for machine in (sync, consumer, self._nmt[bus]):
            network.attach(machine)

    # ---- time, buses, state ----

    def now(self) -> Time:
        """Return the time of all machines: the loop's clock, in ns."""
        return self._pump.now()

    def bus(self, name: str | None = None) -> Bus:
        """Return a bus by its name; the only bus needs no name. Raises UnknownChainError, LocalProtocolError."""
        names = ", ".join(self.buses)
        if name is None:
            if len(self._own_buses) > 1:
                raise LocalProtocolError(f"this master has several buses ({names}): say which one")
            return self._own_buses[0]
        if name not in self.buses:
            raise UnknownChainError(UNKNOWN_CHAIN, f"this master has no bus {name!r}", seen=f"its buses are {names}")
        return self.buses[name]

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left; LocalProtocolError in a process that
        was forked from its own."""
        if self._pump.is_inherited:
            raise forked()
        if self.failure is not None:
            raise self.failure
        if self.is_closed:
            raise MasterClosedError

    def check_loop(self) -> None:
        """Raise LocalProtocolError where another run of a loop than this master's, or none, calls: mostly in another thread.
        Nobody would wake the task when its answer comes, and the loop may be in the middle of the same machine."""
        if self._pump.is_inherited:
            raise forked()
        try:
            is_ours = current_loop().token() is self._token
        except NoLoopError:
            is_ours = False
        if not is_ours:
            raise LocalProtocolError(
                "this master belongs to another event loop, or thread, than the one that runs here; "
                "hand over to its own, or use canopen_master.blocking, which any thread may call"
            )

    # ---- network management and SYNC ----

    @protected
    async def nmt(self, command: NmtCommand, node_id: int = 0, *, bus: str | None = None) -> None:
        """Send an NMT command to one node, or to all (0; on all buses, unless one is named); return when it is on its way.

        Only the nodes' heartbeats confirm it. The states that this master knows of the nodes follow the command.
        command: also as its number. Raises LocalProtocolError for a number that is no command, and for another node-ID.
        """
        self.check_open()
        self.check_loop()
        try:
            command = NmtCommand(command)
        except ValueError:
            known = ", ".join(f"{int(each)} {each.name}" for each in NmtCommand)
            raise LocalProtocolError(f"{command!r} is not an NMT command; these are: {known}") from None
        buses = self._own_buses if bus is None and node_id == 0 else (self.bus(bus),)
        for each in buses:
            self._nmt[each].send(command, node_id, self.now())
        await self._sent(buses)

    def nmt_master(self, bus: Bus) -> NmtMaster:
        """Return the machine that sends the NMT commands of a bus, for procedures."""
        return self._nmt[bus]

    async def nmt_start(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Start remote node: to Operational. node_id: 1..127; 0: all nodes. bus: its name; None: the only one, and for all nodes
        all buses."""
        await self.nmt(NmtCommand.START, node_id, bus=bus)

    async def nmt_stop(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Stop remote node: to Stopped, where only NMT and heartbeat live. node_id, bus: as of `nmt_start`."""
        await self.nmt(NmtCommand.STOP, node_id, bus=bus)

    async def nmt_enter_pre_operational(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Enter pre-operational: SDO, no PDOs. node_id, bus: as of `nmt_start`."""
        await self.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node_id, bus=bus)

    async def nmt_reset_node(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Reset node: as after power-on. `Node.reset` also waits for the boot-up. node_id, bus: as of `nmt_start`."""
        await self.nmt(NmtCommand.RESET_NODE, node_id, bus=bus)

    async def nmt_reset_communication(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Reset communication: the communication objects as after power-on. node_id, bus: as of `nmt_start`."""
        await self.nmt(NmtCommand.RESET_COMMUNICATION, node_id, bus=bus)

    @property
    def sync_period(self) -> Time:
        """ns between two SYNCs, 0 while none are sent."""
        return self._own_buses[0].sync_period

    @protected
    def sync_start(self, period: float) -> None:
        """Send SYNC on all buses, now and then once per period (seconds). A SYNC that runs starts again. Events: SyncSent"""
        import canopen_proto.observer.observer  # noqa: F401 - an error would import it, for 40 ms, between two SYNCs

        self.check_open()
        self.check_loop()
        now, period_ns = self.now(), nanoseconds("period", period, above_zero=True)
        self._before_ordered_sync(now)
        for bus in self._own_buses:
            bus.start_sync(period_ns, now)
        self._without_sync = None
        self._pump.pump()

    @protected
    def sync_stop(self) -> None:
        """Stop sending SYNC periodically."""
        self.check_loop()
        if self.sync_period:
            self._without_sync = self.now() if self._looking is None else self._looking[1]
        for bus in self._own_buses:
            bus.stop_sync()
        self._pump.pump()

    @protected
    async def send_sync(self) -> None:
        """Send one SYNC on all buses; return when it is on its way. A running period keeps its phase."""
        self.check_open()
        self.check_loop()
        now = self.now()
        self._before_ordered_sync(now)
        for sync in self._sync.values():
            sync.send(now)
        await self._sent(self._own_buses)

    def guard_sync(self, guard: SyncGuard) -> None:
        """Ask before a SYNC is sent that is late. Not for a SYNC that the transport sends. guard: is asked."""
        self._guards.append(guard)

    def _slept(self) -> Time:
        """Return for how long the computer has slept since the last SYNC, where its clock does not tell."""
        return 0 if self._sleep_watch is None else self._sleep_watch.slept()

    def _before_ordered_sync(self, now: Time) -> None:
        """Let guards stop what would jump at a SYNC that comes without the look at the drives."""
        since = self._without_sync if self._looking is None else self._looking[1]
        if since is not None:
            for guard in self._guards:
                guard.before_ordered_sync(now - since)
            if self._without_sync is not None:
                self._without_sync = now

    def _before_timeouts(self, now: Time) -> None:
        """See whether a due SYNC is late; if a guard has something to do first, put it off on all buses."""
        if not self._guards:
            return
        due = NEVER
        for sync in self._sync.values():
            if sync.deadline < due:
                due = sync.deadline
        if now < due:
            return
        due -= self._slept()
        if (now - due) * ON_TIME <= self.sync_period:
            return
        looks = [look for guard in self._guards if (look := guard.look_before_sync(now - due)) is not None]
        if not looks:
            self._before_late_sync(now - due)
            return
        for sync in self._sync.values():
            sync.put_off()
        request_id = self.runner.start(self._look(looks), now)
        self._procedures.add(request_id)
        self._looking = request_id, due

    def _look(self, looks: list[Procedure[object]]) -> Procedure[None]:
        while looks:
            began = yield from current_time()
            yield from all_of(*looks)
            took = (yield from current_time()) - began
            looks = [look for guard in self._guards if (look := guard.look_again(took)) is not None]

    def _before_late_sync(self, late: Time) -> None:
        for guard in self._guards:
            guard.before_late_sync(late)

    async def _sent(self, buses: Iterable[Bus]) -> None:
        self._pump.pump()
        await self._loop.checkpoint()
        for bus in buses:
            await bus.flush()
        if self.failure is not None:
            raise self.failure

    # ---- requests and procedures ----

    @protected
    def begin(self, bus: Bus, remote: RemoteNode, submit: Callable[[Time], RequestId]) -> OpenRequest:
        """Give a command with an outcome. The caller waits for the outcome, or takes the request back. submit: gives the command
        at a time, and returns its RequestId."""
        self.check_open()
        self.check_loop()
        return OpenRequest(self._pump, self._dispatcher, bus, remote, submit)

    @protected
    async def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure of `canopen_proto.procedures`, or your own, to its end, and return its result.

        If the task is cancelled, the procedure is cancelled, and the task waits for its clean-up (at most CLEAN_UP_TIME, 1 s, or
        longer for a drive that still slows down). Raises the procedure's own error: a ProcedureError.
        """
        self.check_open()
        self.check_loop()
        place = ProcedureSlot(self)
        place.begin(procedure)
        result: T = await place.outcome()
        return result

    def launch(self, procedure: Procedure[Any]) -> None:
        """Start a procedure that nobody waits for or takes back. May be called while events are delivered."""
        ProcedureSlot(self).begin(procedure)

    def start(self, procedure: Procedure[Any]) -> tuple[RequestId, Waiter]:
        """Start a procedure, and send nothing of it yet: `pump` has to follow. `ProcedureSlot` does both."""
        if not isinstance(procedure, Generator):
            what_to_do = "give one of canopen_proto.procedures, as read(node.remote, 0x1000); a coroutine is awaited"
            raise LocalProtocolError(f"procedure {procedure!r} is none; {what_to_do}")
        request_id = self.runner.start(procedure, self.now())
        self._procedures.add(request_id)
        return request_id, self._dispatcher.expect(self._root, request_id, self.runner)

    @protected
    def take_back(self, request_id: RequestId) -> None:
        """Cancel a procedure; does nothing if it has ended. request_id: the one that the procedure got."""
        self.runner.cancel(request_id, self.now())
        self._pump.pump()

    # ---- events ----

    @protected
    def subscribe(self, kinds: tuple[type[E], ...], bus: Bus | None = None, node_id: int = 0) -> Subscription[E]:
        """Return a Subscription to all events of these kinds from now on, of one bus and node, or of all (None, 0).

        Raises LocalProtocolError for no kind, and for one that is no class derived from Event.
        """
        self.check_open()
        kinds = event_kinds(kinds)
        subscription: Subscription[E] = Subscription(self._unsubscribe)
        self._subscriptions[subscription] = self._dispatcher.watch(kinds, subscription.put, bus, node_id, subscription.put_all)
        self._tell_networks()
        return subscription

    def _unsubscribe(self, subscription: Subscription[Any]) -> None:
        watcher = self._subscriptions.pop(subscription, None)
        if watcher is not None:
            self.unwatch(watcher)

    def watch(
        self, kinds: tuple[type[Event], ...], callback: Callable[[Any], None], bus: Bus | None = None, node_id: int = 0
    ) -> Watcher:
        """Call `callback` with each event of these kinds, in the pump's turn. It must not raise or block. bus: only of this one;
        None: of all. node_id: only of this one; 0: of all.

        Raises LocalProtocolError for kinds as `subscribe`, and for a callback that is no plain function: a coroutine would not be
        awaited.
        """
        check_callback(callback)
        watcher = self._dispatcher.watch(event_kinds(kinds), callback, bus, node_id)
        self._tell_networks()
        return watcher

    def unwatch(self, watcher: Watcher) -> None:
        """End a `watch`. watcher: what `watch` returned."""
        self._dispatcher.unwatch(watcher)
        self._tell_networks()

    def _tell_networks(self) -> None:
        """Tell the networks whether somebody asks for the events that come with each frame of the usual traffic."""
        quiet = not self._dispatcher.is_asked_for(PdoReceived, HeartbeatReceived)
        for bus in self._own_buses:
            bus.network.quiet = quiet

    # ---- what the pump tells ----

    def _on_procedure_ended(self, outcome: Outcome) -> None:
        self._procedures.discard(outcome.request_id)
        self._procedure_ended.unpark_all()
        if self._looking is not None and self._looking[0] == outcome.request_id:
            (_, due), self._looking = self._looking, None
            now = self.now()
            self._before_late_sync(now - due)
            for sync in self._sync.values():
                sync.catch_up(now)

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        if self.failure is None:
            self.failure = BusError(bus.name, error) if bus is not None and isinstance(error, TransportError) else error
        if not self.is_closed:  # else no task waits any longer, and what runs are the halts
            self._end_waiting(self.failure)
        self._body.cancel()

    def _end_waiting(self, reason: Exception) -> None:
        self._dispatcher.give_up(reason, self.now())
        for subscription in tuple(self._subscriptions):
            subscription.end(reason)
            subscription.close()
        self._pump.pump()

    # ---- the way out: see session.py ----

    @property
    def pump(self) -> Pump:
        """What drives the networks."""
        return self._pump

    @property
    def body(self) -> CancelScope:
        """Around the user's block; cancelled when a bus fails."""
        return self._body

    def end_all(self) -> None:
        """Take no new commands, and end everything that waits or runs."""
        self.is_closed = True
        self._end_waiting(MasterClosedError())
        for request_id in tuple(self._procedures):
            self.take_back(request_id)

    async def finish(self, scope: CancelScope, longest: float, in_a_hurry: Callable[[], bool]) -> None:
        """Wait for the end of all procedures, then until everything queued is sent.

        scope: around this. While procedures ask for time, its deadline is put off, to `longest` (the loop's clock) at most; not
        when somebody is in a hurry.
        """
        usual = scope.deadline
        while self._procedures:
            with self._loop.move_on_after(_LOOK):
                await self._procedure_ended.park()
            asked = self._loop.current_time() + (self.runner.needs_until - self.now()) / SECOND
            scope.deadline = usual if in_a_hurry() else min(max(scope.deadline, asked), longest)
        await self._pump.flush()


class ProcedureSlot:
    """A place for a procedure that runs beside its owner, who may wait for it, or take it back.

    The first frames of a procedure may be answered while they are sent. So the procedure may end within `begin`, or an answer may
    make the owner take it back, or begin another one here. The place therefore knows its procedure before anything is sent.
    """

    __slots__ = ("_begun", "_participant")

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._begun: tuple[RequestId, Waiter] | None = None

    @property
    def is_running(self) -> bool:
        """Whether a procedure was begun here and has not ended."""
        return self._begun is not None and not self._begun[1].is_done

    @protected
    def begin(self, procedure: Procedure[Any]) -> None:
        """Start a procedure. One that was begun here before runs on by itself. May be called while events are delivered."""
        self._begun = self._participant.start(procedure)
        self._participant.pump.pump()

    def take_back(self) -> None:
        """Cancel the procedure; does nothing if none runs."""
        if self._begun is not None:
            self._participant.take_back(self._begun[0])

    async def ended(self) -> None:
        """Wait until no procedure runs here, also none that was begun meanwhile. Always a checkpoint."""
        await current_loop().checkpoint()
        while self._begun is not None and not self._begun[1].is_done:
            await self._begun[1].wait()

    @protected
    async def outcome(self) -> Any:
        """Wait for the end, and return the result. If this task is cancelled, cancel the procedure, and wait for its clean-up.

        Raises as `result`.
        """
        assert self._begun is not None
        request_id, waiter = self._begun
        try:
            await waiter.wait()
        except BaseException:
            self._participant.take_back(request_id)
            with current_loop().cancel_scope(shield=True):
                await waiter.wait()
            raise
        return self.result()

    def result(self) -> Any:
        """Return the result of the procedure, which has ended; None if none was begun.

        Raises its exception; ProcedureTakenBackError if it was taken back; BusError or MasterClosedError if that ended it.
        """
        if self._begun is None:
            return None
        match self._begun[1].result():
            case ProcedureFinished(result=result):
                return result
            case ProcedureFailed(error=error):
                raise error
            case outcome:
                assert isinstance(outcome, ProcedureCancelled)
                raise ProcedureTakenBackError
