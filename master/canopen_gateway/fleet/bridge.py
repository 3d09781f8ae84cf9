"""`FleetDoor`: the bridge between the buses of a master and a fleet on Zenoh. keys.py has its keys.

    door = await bind_fleet_door("hall-2", listen=["tcp/127.0.0.1:7447"])    # before drives boot: a port in use stops nothing
    async with open_master(...) as master, open_gateway(master) as service:
        await door.serve(service)

- Whoever hangs delays nothing here: what is published is dropped where it is not taken (`CongestionControl.DROP`), never waited
  for. Set-points and SYNC never leave this process.
- A halt, and the lease, have room of their own: nobody who asks for much else keeps them waiting.
- Any other query is served in a task of its own, and answered in a thread, since Zenoh waits for whoever asks and takes no
  answer. Beyond `Limits.requests` of them, one is answered by CO151 at once.
- Who may change what is the guard's (guard.py), as at every door. Moving needs the lease (lease.py): a client that is cut off
  loses it after 300 ms, by the clock of this computer.
- Strings of devices and of clients are data: a name that is no plain one is refused, or goes as JSON.
- If the door itself fails, it is closed, and says why (`failure`); the master goes on.
- Two bridges of one name are one too many: clients refuse the answers of both. So a bridge first asks for the tokens of its own
  keys, and does not serve while another one's is alive; from its first moment on it halts for whoever asks.
"""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import trio

from canopen_gateway.errors import (
    BRIDGE_REFUSED,
    NO_SUCH_PLACE,
    DoorError,
    GatewayError,
    GatewayFullError,
    NoSuchPlaceError,
    QueryRefusedError,
)
from canopen_gateway.fleet import keys
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import FleetPlace, check_name, key_of, name_of_bus, parse_key
from canopen_gateway.fleet.leading import RemoteLead
from canopen_gateway.nmt_words import nmt_command
from canopen_gateway.places import bytes_of, find_object, json_said
from canopen_gateway.plain_data import names_of_nodes, object_data, value_data
from canopen_gateway.service import GatewayService, GatewaySession, HeardOnNet
from canopen_master import MasterError, Node
from canopen_master.errors import SdoError, SdoNotConfirmedError
from canopen_master.participant.subscription import Subscription
from canopen_proto import LocalProtocolError, PdoReceived
from canopen_proto.abort import AbortCode
from canopen_proto.bus_knowledge import HeardService
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectNotFoundError
from canopen_proto.gateway import GatewayCode, GatewayNews, NodeReport
from canopen_proto.machine import SECOND
from canopen_proto.manager.scan import NodeFound, Scanner, scan
from canopen_proto.multiplexer import Mux, index_of, subindex_of
from canopen_proto.nmt import NmtState
from canopen_proto.procedures import ProcedureError, SdoTransferError

if TYPE_CHECKING:
    import zenoh

TWIN_WAIT: Final = 5.0
"""Seconds for which a bridge waits for the token of another one of its name to end. That of a program that has crashed lives on
for HUNG_TIME, and is told on from router to router."""
TWIN_LOOK: Final = 0.2
"""Seconds from one look for such a token to the next."""
TWIN_ANSWER: Final = 1.0
"""Seconds that a look takes at most, where somebody on the way is hung."""
STATUS_PERIOD: Final = 1.0
"""Seconds from one status of a bus to the next."""
SILENT_AFTER: Final = 3 * SECOND
"""A node whose heartbeat has begun is away after this time without one."""
EMERGENCIES_KEPT: Final = 32
"""Of each node, for those who come later."""
MAX_PAYLOAD: Final = 1 << 20
MOST_WAITING: Final = 256
"""Queries at a time that get an answer at all, be it that there are too many; further ones are dropped, and counted."""
MOST_MARKS: Final = 10_000
"""Queries of which it is remembered that they have come."""
THREADS: Final = 8
"""In which answers go out."""
ONE_PLACE: Final = (keys.SET, keys.COMMAND, keys.LEASE)
"""What is asked of one place at a time."""
URGENT: Final = (keys.HALT, keys.LEASE)
LOGGER: Final = logging.getLogger("canopen_gateway")
Answer: TypeAlias = tuple[str | None, bytes, bytes | None]
"""Key, payload and attachment of an answer; without a key an error."""
_LOST: Final = (GatewayCode.HEARTBEAT_LOST,)


class Taking(Enum):
    """Which queries a bridge takes."""

    NOTHING = "nothing"
    HALTS = "halts"
    ALL = "all"


class FleetDoor:
    """See this module's text; made by `bind_fleet_door`. site: its name in keys. failure: why it was closed, or None. buses: the
    nets by their names in keys, once it serves. dropped: events that came faster than they were taken; dropped_queries: queries
    that got no answer, since too many waited."""

    def __init__(self, session: zenoh.Session, site: str, twin: bool = False) -> None:
        """twin: serve though another bridge has the same name."""
        self.site = site
        self._twin = twin
        self._taking = Taking.NOTHING
        self.failure: Exception | None = None
        self.buses: dict[str, str] = {}
        self._zenoh = session
        self._service: GatewayService
        self._lead: RemoteLead
        self._session: GatewaySession
        self._names: dict[str, str] = {}  # of the buses, by net
        self._tokens: dict[FleetPlace, zenoh.LivelinessToken] = {}
        self._emergencies: dict[FleetPlace, deque[bytes]] = {}
        self._states: dict[FleetPlace, NmtState] = {}
        self._run = secrets.token_bytes(keys.RUN_BYTES)
        self._asked: dict[bytes, None] = {}  # the marks of the last queries, oldest first
        self._answering = 0
        self._urgent = 0
        self._urgent_threads = trio.CapacityLimiter(THREADS)
        self._threads = trio.CapacityLimiter(THREADS)
        self.dropped_queries = 0

    @property
    def dropped(self) -> int:
        """Events of nodes that came faster than they were taken."""
        return self._session.dropped

    @property
    def alive(self) -> Sequence[FleetPlace]:
        """The nodes that were heard lately."""
        return sorted(place for place in self._tokens if place.node_id)

    async def __aenter__(self) -> FleetDoor:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Leave the fleet. Does nothing the second time."""
        if not self._zenoh.is_closed():
            await close_zenoh(self._zenoh)

    async def serve(self, service: GatewayService, begun: Callable[[], object] | None = None) -> None:
        """Serve the fleet until cancelled. begun: called once it serves all that it is asked. Returns early only if the door
        itself fails; see `failure`. Raises GatewayFullError, ValueError if two buses would have one name; DoorError if another
        bridge of the fleet serves a bus of this name, and still does so after TWIN_WAIT seconds. Until that is known, halts are
        served, and nothing else."""
        import zenoh

        self.buses = self.names_of(service.nets)
        self._names = {net: name for name, net in self.buses.items()}
        self._service = service
        self._lead = RemoteLead(service.lease)
        async with self:
            with service.open_session(f"the fleet, as {self.site}") as self._session:
                taken = ""
                try:
                    async with trio.open_nursery() as nursery:
                        self._listen(nursery)
                        taken = await self._taken_key()
                        if taken:
                            self._taking = Taking.NOTHING  # the halts that are under way come to their end
                        else:
                            self._begin(nursery)
                            if begun is not None:
                                begun()
                except* zenoh.ZError as failed:
                    self.failure = failed.exceptions[0]
                    LOGGER.warning("the door to the fleet is closed: %s", self.failure)
                finally:
                    self._taking = Taking.NOTHING
                    self._tokens.clear()
                if taken:
                    raise _twin_error(taken)

    def names_of(self, nets: Sequence[str]) -> dict[str, str]:
        """Return the nets by their names in keys. Raises ValueError if two would have one name."""
        named: dict[str, str] = {}
        for net in nets:
            name = name_of_bus(net)
            if name in named:
                raise ValueError(
                    f"the buses {named[name]} and {net} would both be called {name!r}: give them names in a machine file"
                )
            named[name] = net
        return named

    # ---- what goes out ----

    def _listen(self, nursery: trio.Nursery) -> None:
        """Take queries, of which only halts are served yet."""
        token = trio.lowlevel.current_trio_token()

        def take(query: zenoh.Query) -> None:  # in a thread of Zenoh
            try:
                token.run_sync_soon(self._take, query, nursery)
            except trio.RunFinishedError:
                query.drop()  # type: ignore[no-untyped-call]

        self._taking = Taking.HALTS
        self._zenoh.declare_queryable(f"{keys.ROOT}/{self.site}/**", take)

    async def _taken_key(self) -> str:
        """Return the key of another bridge of this name that is alive; "" if there is none, or its end has come in time."""
        alive = [key_of(FleetPlace(self.site, name), keys.ALIVE) for name in self.buses]
        over = trio.current_time() + TWIN_WAIT
        told = False
        while True:
            taken = await trio.to_thread.run_sync(_first_alive, self._zenoh, alive, abandon_on_cancel=True)
            if not taken or self._twin or trio.current_time() >= over:
                return "" if self._twin else taken
            if not told:
                told = True
                LOGGER.warning("another bridge is alive: %s. Waiting %g s for its end", taken, TWIN_WAIT)
            await trio.sleep(TWIN_LOOK)

    def _begin(self, nursery: trio.Nursery) -> None:
        self._taking = Taking.ALL
        for name, net in self.buses.items():
            self._appear(FleetPlace(self.site, name))
            self._session.hear_boot_ups(net, True)
            for node_id in range(1, 128):
                self._session.watch_heartbeat(net, node_id, SILENT_AFTER)
            nursery.start_soon(self._publish_pdos, name, net)
            nursery.start_soon(self._publish_status, name, net)
            nursery.start_soon(self._ask_around, name, net)
        nursery.start_soon(self._publish_events)

    async def _publish_events(self) -> None:
        while True:
            heard = await self._session.next_event()
            assert isinstance(heard.event, NodeReport)  # no guarding, and no PDOs of its own
            self._on_report(heard, heard.event)

    def _on_report(self, heard: HeardOnNet, report: NodeReport) -> None:
        place = FleetPlace(self.site, self._names[heard.net], report.node_id)
        if report.kind is GatewayNews.ERROR and report.numbers == _LOST:
            self._disappear(place)
            return
        self._appear(place)
        if report.kind is GatewayNews.STATE:
            self._on_state(place, NmtState(report.numbers[0]))
        elif report.kind is GatewayNews.BOOT_UP:
            self._on_state(place, NmtState.PRE_OPERATIONAL)  # which it enters by itself; CiA 301 v4.2.0, 7.3.2.2.1
        elif report.kind is GatewayNews.EMCY:
            code, register, *data = report.numbers
            emergency = _stamp() + code.to_bytes(2, "little") + bytes((register, *data))
            self._emergencies.setdefault(place, deque(maxlen=EMERGENCIES_KEPT)).append(emergency)
            self._put(key_of(place, keys.EMCY), emergency)

    def _on_state(self, place: FleetPlace, state: NmtState) -> None:
        self._states[place] = state
        self._put(key_of(place, keys.NMT), state.name.encode(), _stamp())

    async def _publish_pdos(self, name: str, net: str) -> None:
        counts: dict[tuple[int, int], int] = defaultdict(int)
        with self._service.master.events(PdoReceived, bus=net) as pdos:
            async for pdo in pdos:
                place = FleetPlace(self.site, name, pdo.node_id)
                if pdo.number and pdo.node_id:
                    self._appear(place)
                    counts[pdo.node_id, pdo.number] += 1
                    beside = keys.count_bytes(self._run, counts[pdo.node_id, pdo.number], pdos.dropped)
                    self._put(key_of(place, keys.PDO, str(pdo.number)), _stamp() + pdo.data, beside)

    async def _publish_status(self, name: str, net: str) -> None:
        dropped = 0
        while True:
            if self.dropped != dropped:
                dropped = self.dropped
                self._look_again(name, net)
            self._put(key_of(FleetPlace(self.site, name), keys.STATUS), _json(self._status(name, net)))
            await trio.sleep(STATUS_PERIOD)

    def _look_again(self, name: str, net: str) -> None:
        """Tell the states that the bus itself has heard: events were dropped, and some were the only ones of a node."""
        network, now = self._service.master.bus(net).network, self._service.master.now()
        for node_id in network.heard_nodes():
            place, heard = FleetPlace(self.site, name, node_id), network.heard(node_id)
            if heard.time is None or heard.state is None:
                continue
            if now - heard.time < SILENT_AFTER:
                self._appear(place)
                if heard.state is not self._states.get(place):
                    self._on_state(place, heard.state)
            elif heard.service is HeardService.HEARTBEAT:
                self._disappear(place)

    async def _ask_around(self, name: str, net: str) -> None:
        """Ask each node-ID once who is there: one that sends no heartbeat would not be seen else."""
        network = self._service.master.bus(net).network
        scanner = Scanner(network.out)
        network.attach(scanner)
        try:
            with self._service.master.events(NodeFound, bus=net) as found:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(self._take_found, name, found)
                    with contextlib.suppress(MasterError):  # an outage, which the status tells
                        await self._service.master.run(scan(scanner, listen=0))
                    await trio.sleep(0)  # what was found last
                    nursery.cancel_scope.cancel()
        finally:
            network.detach(scanner)

    async def _take_found(self, name: str, found: Subscription[NodeFound]) -> None:
        async for node in found:
            place = FleetPlace(self.site, name, node.node_id)
            self._appear(place)
            if node.state is not None and place not in self._states:
                self._on_state(place, node.state)

    def _status(self, name: str, net: str) -> dict[str, object]:
        bus = self._service.master.bus(net)
        return {
            "bus": net,
            "run": self._run.hex(),
            "outage": bus.network.outage,
            "nodes": {str(place.node_id): self._state_name(place) for place in self.alive if place.bus == name},
            "names": names_of_nodes(self._service.master, net),
            "allow": sorted(each.value for each in self._service.guard.allowed),
            "chains": [each.name for each in self._service.master.chains.values()],
            "moved_by": "" if self._service.lease.owner is None else self._service.lease.owner.name,
            "doing": self._service.lease.doing,
            "problem": self._service.lease.problem,
            "dropped": self.dropped,
        }

    def _state_name(self, place: FleetPlace) -> str:
        state = self._states.get(place)
        return "" if state is None else state.name

    def _put(self, key: str, data: bytes, beside: bytes | None = None) -> None:
        import zenoh

        self._zenoh.put(key, data, attachment=beside, congestion_control=zenoh.CongestionControl.DROP)

    def _appear(self, place: FleetPlace) -> None:
        if place not in self._tokens:
            self._tokens[place] = self._zenoh.liveliness().declare_token(key_of(place, keys.ALIVE))

    def _disappear(self, place: FleetPlace) -> None:
        token = self._tokens.pop(place, None)
        self._states.pop(place, None)
        if token is not None:
            token.undeclare()  # type: ignore[no-untyped-call]

    # ---- queries ----

    def _take(self, query: zenoh.Query, nursery: trio.Nursery) -> None:
        """Begin with a query, in trio's thread."""
        key = str(query.key_expr)
        found = parse_key(key)
        is_halt = found is not None and found[1][0] == keys.HALT
        if self._taking is Taking.NOTHING or (self._taking is Taking.HALTS and not is_halt):
            query.drop()  # type: ignore[no-untyped-call]  # as if nobody were here
            return
        if self._is_copy(query):
            query.drop()  # type: ignore[no-untyped-call]
            return
        if found is not None and found[1][0] in URGENT:  # they have room of their own, whatever else is asked
            if self._urgent >= MOST_WAITING:
                query.drop()  # type: ignore[no-untyped-call]  # as many halts are under way
                self.dropped_queries += 1
                return
            self._urgent += 1
            nursery.start_soon(self._answer, query, *found, self._led(query, *found))
            return
        if self._answering >= MOST_WAITING:
            query.drop()  # type: ignore[no-untyped-call]  # told nothing: an answer may have to wait, too
            self.dropped_queries += 1
            return
        self._answering += 1
        if found is None:
            nursery.start_soon(self._refuse, query, QueryRefusedError(f"{key[:200]!r} is no key of this fleet"))
        elif self._answering > self._service.limits.requests:
            nursery.start_soon(self._refuse, query, GatewayFullError("requests at a time", self._service.limits.requests))
        else:
            nursery.start_soon(self._answer, query, *found, [])

    def _is_copy(self, query: zenoh.Query) -> bool:
        """Return whether a query has come before: by another router, to which both sides are connected. It is served once."""
        mark = b"" if query.attachment is None else bytes(query.attachment)
        if len(mark) != keys.MARK_BYTES:
            return False  # of another program
        if mark in self._asked:
            return True
        self._asked[mark] = None
        if len(self._asked) > MOST_MARKS:
            del self._asked[next(iter(self._asked))]
        return False

    async def _refuse(self, query: zenoh.Query, error: GatewayError) -> None:
        try:
            await trio.to_thread.run_sync(_reply, query, [_refusal(error)], limiter=self._threads)
        finally:
            query.drop()  # type: ignore[no-untyped-call]
            self._answering -= 1

    def _led(self, query: zenoh.Query, place: FleetPlace, rest: Sequence[str]) -> list[Answer]:
        """Do what a message about the lease says, and return the answer; none for another query. It is done here and not in a
        task: tasks begin in any order, and a message that another one has overtaken is refused as old, be it a stop."""
        answers: list[Answer] = []
        if list(rest) == [keys.LEASE] and place in [FleetPlace(self.site, name) for name in self.buses]:
            with self._refusals(place, rest, answers):
                answers.append((key_of(place, *rest), _json(self._lead.say(_payload(query))), None))
        return answers

    async def _answer(self, query: zenoh.Query, pattern: FleetPlace, rest: Sequence[str], answers: list[Answer]) -> None:
        """Serve a query, unless there are answers already. They go out in a thread of their own: who asked may be hung, and Zenoh
        then waits for him."""
        is_served = bool(answers)
        try:
            if not is_served and rest[0] in ONE_PLACE and (pattern.node_id < 0 or keys.ANY in pattern):
                answers.append(_refusal(QueryRefusedError(f"{rest[0]} is for one place, and {pattern} is many")))
            elif not is_served:
                async with trio.open_nursery() as nursery:
                    for place in self._places(pattern):
                        nursery.start_soon(self._answer_for, query, place, rest, answers)
            threads = self._urgent_threads if rest[0] in URGENT else self._threads
            await trio.to_thread.run_sync(_reply, query, answers, limiter=threads)
        finally:
            query.drop()  # type: ignore[no-untyped-call]  # done already, unless this was cancelled
            if rest[0] in URGENT:
                self._urgent -= 1
            else:
                self._answering -= 1

    def _places(self, pattern: FleetPlace) -> list[FleetPlace]:
        """Return the places that a query is about: with a node-ID of its own any, with "*" the nodes that are alive."""
        found: list[FleetPlace] = []
        for name in self.buses:
            bus = FleetPlace(self.site, name)
            if not bus.matches(pattern._replace(node_id=0)):
                continue
            found += (
                [each for each in self.alive if each.bus == name]
                if pattern.node_id < 0
                else [bus._replace(node_id=pattern.node_id)]
            )
        return found

    async def _answer_for(self, query: zenoh.Query, place: FleetPlace, rest: Sequence[str], answers: list[Answer]) -> None:
        with self._refusals(place, rest, answers):
            served = await self._serve(query, place, list(rest))
            answers += [(key_of(place, *rest), data, attachment) for data, attachment in served]

    @contextmanager
    def _refusals(self, place: FleetPlace, rest: Sequence[str], answers: list[Answer]) -> Iterator[None]:
        """Let what is refused be an answer."""
        try:
            yield
        except (GatewayError, MasterError, ProcedureError, LocalProtocolError, ValueError) as error:
            answers.append(_refusal(error, place))
        except Exception:  # a mistake of ours ends neither the door nor the master
            LOGGER.exception("the query %s for %s failed", rest, place)
            answers.append(_refusal(RuntimeError("a mistake in this bridge"), place))

    async def _serve(self, query: zenoh.Query, place: FleetPlace, rest: list[str]) -> list[tuple[bytes, bytes | None]]:
        """Do what a query asks for; return the answers, each with what stands beside it."""
        net = self.buses[place.bus]
        payload = _payload(query)
        match place.node_id, rest:
            case 0, [keys.STATUS]:
                return [(_json(self._status(place.bus, net)), None)]
            case node_id, [keys.HALT]:
                return [(_json(await self._service.halt(net, node_id)), None)]
            case int(node_id), [keys.GET, text] if node_id:
                return [await self._read(net, place, text)]
            case int(node_id), [keys.SET, text] if node_id:
                await self._write(net, place, text, payload, str(query.encoding or ""))
                return [(b"", None)]
            case int(node_id), [keys.COMMAND] if node_id:
                await self._session.nmt(net, nmt_command(payload.decode("ascii", "replace")), node_id)
                return [(b"", None)]
            case int(node_id), [keys.NMT] if node_id:
                return [(self._state_name(place).encode(), None)]
            case int(node_id), [keys.EMCY] if node_id:
                return [(each, None) for each in self._emergencies.get(place, ())]
            case int(node_id), [keys.OBJECTS] if node_id:
                dictionary = self._service.node(net, node_id).dictionary
                return [(_json({"objects": [object_data(dictionary, variable) for variable in dictionary]}), None)]
            case int(node_id), [keys.PDOS] if node_id:
                return [(_json(_pdos_of(self._service.node(net, node_id))), None)]
        raise QueryRefusedError(f"{'/'.join(rest)[:200]!r} is nothing that can be asked for here")

    async def _read(self, net: str, place: FleetPlace, text: str) -> tuple[bytes, bytes]:
        node = self._service.node(net, place.node_id)
        index, subindex = _object(node, text)
        try:
            data = await self._session.read(net, place.node_id, index, subindex)
        except SdoError as error:
            if error.abort_code != AbortCode.TIMED_OUT:
                self._appear(place)
            elif self._states.get(place) is None:  # no heartbeat would tell that it is away
                self._disappear(place)
            raise
        self._appear(place)
        beside: dict[str, object] = {"object": f"{index:04X}:{subindex:02X}", "time": time.time_ns()}
        variable = node.dictionary.get(index, subindex)
        if variable is not None:
            beside |= {"name": variable.name, "type": variable.data_type.name, "unit": variable.unit}
            if constants := value_data(node.dictionary, index, subindex, data)["constants"]:
                beside["constants"] = constants
        return data, _json(beside)

    async def _write(self, net: str, place: FleetPlace, text: str, payload: bytes, encoding: str) -> None:
        node = self._service.node(net, place.node_id)
        index, subindex = _object(node, text)
        if encoding.startswith("application/json"):
            payload = bytes_of(node, index, subindex, _value(payload))
        await self._session.write(net, place.node_id, index, subindex, payload)


def _first_alive(session: zenoh.Session, alive: Sequence[str]) -> str:
    """Return the first of these keys whose token is alive; "" if none is. It waits for Zenoh."""
    return next((key for key in alive for each in session.liveliness().get(key, timeout=TWIN_ANSWER) if each.ok is not None), "")


def _twin_error(key: str) -> DoorError:
    return DoorError(
        f"another bridge serves this site and bus: {key} is alive",
        seen=f"it still is after {TWIN_WAIT:g} s, so its program has not crashed",
        cause="two bridges have one name, and clients refuse the answers of both",
        tries=(
            "--site with another name",
            "another name of the bus, in a machine file",
            "end the other bridge: canopen fleet ls --json tells its bus",
            "--twin, if both have to be there: halts go to both",
        ),
    )


async def bind_fleet_door(
    site: str,
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config: Path | None = None,
    reachable: bool = False,
    twin: bool = False,
) -> FleetDoor:
    """Join a fleet as a bridge, before anything moves; `FleetDoor.serve` then serves it. site: its name. twin: serve though
    another bridge has the same name, whose clients then refuse the answers of both but to a halt. For the rest, and what is
    raised, see `open_zenoh`; also ValueError for a name that cannot stand in a key."""
    check_name("site", site)
    session = await open_zenoh(connect=connect, listen=listen, config=config, reachable=reachable, mode="router")
    return FleetDoor(session, site, twin)


def _object(node: Node, text: str) -> tuple[int, int]:
    """Return index and subindex of an object in a key."""
    if not keys.OBJECT.match(text):
        raise NoSuchPlaceError(f"{text[:200]!r} is no object")
    return find_object(node.dictionary, text)


def _pdos_of(node: Node) -> dict[str, object]:
    return {
        str(number): [
            {
                "object": f"{index_of(mux):04X}:{subindex_of(mux):02X}",
                "name": label,
                "type": entry.data_type.name,
                "unit": _unit_of(node, mux),
                "bits": entry.bit_length,
            }
            for mux, label, entry in zip(pdo.mapping.muxes, pdo.mapping.labels, pdo.mapping.components, strict=True)
        ]
        for number, pdo in node.remote.tpdos.items()
    }


def _unit_of(node: Node, mux: Mux) -> str:
    variable = node.dictionary.get(index_of(mux), subindex_of(mux))
    return "" if variable is None else variable.unit


def _value(payload: bytes) -> Value:
    try:
        value = json_said(payload)
    except ValueError as error:
        raise QueryRefusedError(f"the value is no JSON that is understood: {error}") from error
    return value  # type: ignore[no-any-return]  # `bytes_of` looks whether it fits


def _stamp() -> bytes:
    """The time of this computer, for people: 8 bytes, ns since 1970."""
    return time.time_ns().to_bytes(8, "little")


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()


def _refusal(error: Exception, place: FleetPlace | None = None) -> Answer:
    """Return the answer to a query that was refused, or failed."""
    said: dict[str, object] = {"message": str(error).split("\n")[0], "place": "" if place is None else str(place)}
    if isinstance(error, GatewayError | MasterError):
        said |= {"code": error.code, "message": error.failed, "seen": error.seen}
    elif isinstance(error, ObjectNotFoundError):
        said["code"] = NO_SUCH_PLACE
    elif isinstance(error, LocalProtocolError | ValueError):  # what was asked for is wrong, and nothing was sent
        said["code"] = BRIDGE_REFUSED
    if isinstance(error, SdoError):
        said |= {"abort": error.abort_code, "not_confirmed": isinstance(error, SdoNotConfirmedError)}
    elif isinstance(error, SdoTransferError):
        said |= {"abort": error.abort_code, "not_confirmed": error.not_confirmed}
    return None, _json(said), None


def _payload(query: zenoh.Query) -> bytes:
    payload = b"" if query.payload is None else bytes(query.payload)
    if len(payload) > MAX_PAYLOAD:
        raise QueryRefusedError(f"a payload of {len(payload)} bytes: {MAX_PAYLOAD} at most")
    return payload


def _reply(query: zenoh.Query, answers: Sequence[Answer]) -> None:
    """Send the answers to a query, and end it; in a thread."""
    import zenoh

    try:
        for key, data, attachment in answers:
            if key is None:
                query.reply_err(data, encoding="application/json")
            else:
                query.reply(key, data, attachment=attachment)
    except zenoh.ZError as error:  # who asked is gone, or asked for a key that an answer may not have
        LOGGER.info("an answer was not taken: %s", error)
    query.drop()  # type: ignore[no-untyped-call]
