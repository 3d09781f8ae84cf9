"""`LiveHub` and `LiveClient`: what goes over the WebSocket of the page: pulses, values, events; and the hand on the machine.

All messages are JSON objects; "k" is their kind. The door sends, by itself:

    hello     what is allowed, the nets, the name of this client; then
    pulse     ten times a second: chains with positions, the lease, how many messages this client has missed
    nets      twice a second: all nodes with their states
    event     a boot-up, an emergency, a changed state, a lost heartbeat
    values    up to 25 times a second: [[number, time, value], ...] of what the client watches
    error     what the client asked for was refused; "about" is the kind of its message
    halted    the end of a halt; "problems" has what did not confirm that it stands

A client sends:

    watch     "objects": [[net, node, object], ...], "period": seconds; in place of what it watched before
    halt      always open; "net", "node" if not all
    take, leave, renew, stop; enable, disable with "chain"; jog with "chain" and "velocities"; move with "chain" and "targets":
              see `Lease`. Each but take and leave has "n", a number above all before

**A slow client delays nobody.** What is sent to it waits in a bounded channel; a message that finds it full is dropped, and
counted. A client that takes nothing for `Limits.send_seconds` is cut off. The cycle never waits for any of them.
"""

from __future__ import annotations

import json
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, Final

import trio
from starlette.websockets import WebSocket, WebSocketDisconnect

from canopen_gateway.errors import GatewayError
from canopen_gateway.places import find_net, find_node, find_object
from canopen_gateway.plain_data import (
    EXPECTED,
    Plain,
    chain_data,
    error_data,
    event_data,
    lease_data,
    net_data,
    plain_value,
)
from canopen_gateway.service import GatewayService, GatewaySession, HeardOnNet
from canopen_gateway.values import WatchedObject
from canopen_master.plain_text import json_text
from canopen_proto.machine import SECOND

PULSE: Final = 0.1
"""Seconds between two pulses."""
NETS_EACH: Final = 5
"""Pulses between two lists of all nodes."""
FLUSH: Final = 0.04
"""Seconds between two messages with values: a page draws at most so often what a person can see."""
WAITING: Final = 32
"""Messages that wait for one client."""
MOST_NUMBER: Final = 1e300
"""The greatest number that a message holds."""
MAX_MESSAGE: Final = 4096
"""Bytes of a message of a client."""
HEARTBEAT_TIME: Final = 2_500_000_000
"""ns without a heartbeat until the page says that it is lost: the usual period is 1 s, and two of them may be late."""
LOG_LENGTH: Final = 200
LOGGER: Final = logging.getLogger("canopen_gateway")


class LiveHub:
    """What all clients of the live channel hear; encoded once for all of them. events: the last ones, as plain data.
    counts: of all events so far, by net, node and kind.

    service: the gateway. clock: seconds since 1970, for events.
    """

    def __init__(self, service: GatewayService, clock: Callable[[], float] = time.time) -> None:
        self.service = service
        self.events: deque[Plain] = deque(maxlen=LOG_LENGTH)
        self.counts: Counter[tuple[str, int, str]] = Counter()
        self._clock = clock
        self._listeners: set[Callable[[str], None]] = set()

    async def run(self) -> None:
        """Listen, and tell the clients, until cancelled."""
        with self.service.open_session("the page's ear") as ear:
            for net in self.service.nets:
                ear.hear_boot_ups(net, True)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._hear, ear)
                await self._pulse(ear)

    def listen(self, listener: Callable[[str], None]) -> Callable[[], None]:
        """Call `listener` with each message for all clients; return what ends that. It must not block."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def nets(self) -> list[Plain]:
        """Return all nets with their nodes."""
        return [net_data(self.service, net) for net in self.service.nets]

    def state(self) -> Plain:
        """Return what is allowed, the chains, and who moves them."""
        return {
            "allow": sorted(each.value for each in self.service.guard.allowed),
            "mode": self.service.guard.mode,
            "chains": [chain_data(chain) for chain in self.service.master.chains.values()],
            "lease": lease_data(self.service),
        }

    async def _hear(self, ear: GatewaySession) -> None:
        while True:
            self._tell_event(await ear.next_event())

    def _tell_event(self, heard: HeardOnNet) -> None:
        event = event_data(self.service, heard, self._clock())
        self.events.append(event)
        self.counts[heard.net, event["node"], event["kind"]] += 1
        self._tell({"k": "event", **event})

    async def _pulse(self, ear: GatewaySession) -> None:
        number = 0
        watched: set[tuple[str, int]] = set()
        while True:
            if number % NETS_EACH == 0:
                self._watch_new_heartbeats(ear, watched)
            if self._listeners:
                state = self.state()
                self._tell({"k": "pulse", "time": self.service.master.now() / SECOND, **state})
                if number % NETS_EACH == 0:
                    self._tell({"k": "nets", "nets": self.nets()})
            number += 1
            await trio.sleep(PULSE)

    def _watch_new_heartbeats(self, ear: GatewaySession, watched: set[tuple[str, int]]) -> None:
        for net in self.service.nets:
            network = self.service.master.bus(net).network
            for node_id in network.heard_nodes():
                if (net, node_id) not in watched and network.heard(node_id).state_time is not None:
                    watched.add((net, node_id))
                    ear.watch_heartbeat(net, node_id, HEARTBEAT_TIME)

    def _tell(self, message: Plain) -> None:
        text = json_text(message)
        for listener in tuple(self._listeners):
            listener(text)


class LiveClient:
    """One client of the live channel. dropped: messages that found no room."""

    def __init__(self, hub: LiveHub, session: GatewaySession, websocket: WebSocket) -> None:
        self.dropped = 0
        self._hub = hub
        self._session = session
        self._websocket = websocket
        self._put, self._get = trio.open_memory_channel[str](WAITING)
        self._watch_scope = trio.CancelScope()
        self._watch_turn = trio.Lock()

    async def run(self) -> None:
        """Serve it until it leaves, or is cut off."""
        await self._websocket.accept()
        service = self._hub.service
        hello = {"k": "hello", "you": self._session.name, "nets": self._hub.nets(), **self._hub.state()}
        self.put(json_text({**hello, "events": list(self._hub.events), "least_period": service.limits.least_period}))
        end = self._hub.listen(self.put)
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._send, nursery)
                await self._receive(nursery)
                nursery.cancel_scope.cancel()
        finally:
            end()

    def put(self, text: str) -> None:
        """Send a message when the client takes it; drop it if too many wait already."""
        try:
            self._put.send_nowait(text)
        except trio.WouldBlock:
            self.dropped += 1

    async def _send(self, nursery: trio.Nursery) -> None:
        told = 0
        while True:
            text = await self._get.receive()
            with trio.move_on_after(self._hub.service.limits.send_seconds) as limit:
                try:
                    await self._websocket.send_text(text)
                    if self.dropped > told:
                        told = self.dropped
                        await self._websocket.send_text(json_text({"k": "dropped", "messages": told}))
                except (WebSocketDisconnect, RuntimeError, OSError):  # it is gone: Starlette says so in each of these ways
                    nursery.cancel_scope.cancel()
            if limit.cancelled_caught:
                LOGGER.info("%s is cut off: it took nothing for %g s", self._session.name, self._hub.service.limits.send_seconds)
                nursery.cancel_scope.cancel()

    async def _receive(self, nursery: trio.Nursery) -> None:
        while True:
            try:
                text = await self._websocket.receive_text()
            except (WebSocketDisconnect, KeyError):  # KeyError: a message of bytes, which no client of ours sends
                return
            kind = ""
            try:
                message = json.loads(text[:MAX_MESSAGE])
                if not isinstance(message, dict) or not isinstance(message.get("k"), str):
                    raise ValueError("a message is a JSON object with a kind, k")
                kind = message["k"][:20]
                self._take(message, nursery)
            except (GatewayError, *EXPECTED, TypeError, RecursionError) as error:
                self.put(json_text({"k": "error", "about": kind, **error_data(error)}))

    def _take(self, message: dict[str, Any], nursery: trio.Nursery) -> None:
        lease, session = self._hub.service.lease, self._session
        match message["k"]:
            case "halt":
                nursery.start_soon(self._halt, message)
            case "watch":
                objects = [self._watched(each) for each in message.get("objects", ())]
                self._watch_scope.cancel()
                self._watch_scope = trio.CancelScope()
                period = _number(message.get("period", 0.1))
                nursery.start_soon(self._watch, self._watch_scope, objects, period)
            case "take":
                lease.take(session)
            case "leave":
                lease.leave(session)
            case "renew":
                lease.renew(session, _sequence(message))
            case "stop":
                lease.stop(session, _sequence(message))
            case "enable":
                lease.enable(session, _sequence(message), str(message.get("chain")))
            case "disable":
                lease.disable(session, _sequence(message), str(message.get("chain")))
            case "jog":
                velocities = [_number(each) for each in message.get("velocities", ())]
                lease.jog(session, _sequence(message), str(message.get("chain")), velocities)
            case "move":
                targets = [_number(each) for each in message.get("targets", ())]
                lease.move(
                    session, _sequence(message), str(message.get("chain")), targets, speed=_number(message.get("speed", 0.1))
                )
            case other:
                raise ValueError(f"there is no message of the kind {other[:20]!r}")

    async def _halt(self, message: dict[str, Any]) -> None:
        try:
            net = None if message.get("net") is None else find_net(self._hub.service, str(message["net"]))
            problems = await self._hub.service.halt(net, find_node(message.get("node", 0), least=0))
        except (GatewayError, *EXPECTED, TypeError) as error:
            self.put(json_text({"k": "error", "about": "halt", **error_data(error)}))
            return
        self.put(json_text({"k": "halted", "problems": problems}))

    def _watched(self, place: Any) -> WatchedObject:
        if not isinstance(place, list) or len(place) != 3:
            raise ValueError("an object to watch is [net, node, object]")
        net = find_net(self._hub.service, str(place[0]))
        node = self._hub.service.node(net, find_node(place[1]))
        return WatchedObject(net, node.node_id, *find_object(node.dictionary, str(place[2])))

    async def _watch(self, scope: trio.CancelScope, objects: Sequence[WatchedObject], period: float) -> None:
        """Send values until something else is watched. A value that a PDO brings is sent each time that it comes."""
        if not objects:
            return
        session = self._session
        with scope:
            await self._watch_turn.acquire()  # what was watched before has to end first
            try:
                half = self._hub.service.limits.subscriptions // 2  # each is sampled, and asked for while no PDO brings it
                if len(objects) > half:
                    raise ValueError(f"a page watches {half} objects at most")
                polled: deque[list[Any]] = deque(maxlen=4 * len(objects))
                with session.sample_pdos(objects) as samples:
                    came = [float("-inf")] * len(objects)
                    async with trio.open_nursery() as nursery:
                        nursery.start_soon(self._poll, objects, max(period, 0.1), came, polled)
                        while True:
                            rows: list[list[Any]] = list(polled)
                            polled.clear()
                            for number, at, value in samples.take():
                                came[number] = trio.current_time()
                                rows.append([number, round(at, 4), plain_value(value)])
                            if rows:
                                self.put(json_text({"k": "values", "values": rows}))
                            await trio.sleep(FLUSH)
            except* (GatewayError, *EXPECTED) as failed:
                self.put(json_text({"k": "error", "about": "watch", **error_data(_first(failed))}))
            finally:
                self._watch_turn.release()

    async def _poll(
        self, objects: Sequence[WatchedObject], period: float, came: Sequence[float], polled: deque[list[Any]]
    ) -> None:
        """Ask for the values that no PDO has brought of late."""
        places = {place: number for number, place in enumerate(objects)}
        async with self._session.watch_values(objects, period) as values:
            async for seen in values:
                number = places[seen.place]
                if trio.current_time() - came[number] > 2 * period:
                    now = round(self._hub.service.master.now() / SECOND, 4)
                    polled.append([number, now, plain_value(seen.value), seen.problem])


def _sequence(message: dict[str, Any]) -> int:
    number = message.get("n")
    if not isinstance(number, int) or isinstance(number, bool):
        raise ValueError("the message needs a number, n, above all before")
    return number


def _number(value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MOST_NUMBER:  # NaN is not
        return float(value)
    raise ValueError(f"{str(value)[:20] if isinstance(value, float | str) else 'this'!r} is no number")


def _first(error: BaseException) -> Exception:
    """Return the error that nurseries have put into groups."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Exception)
    return error
