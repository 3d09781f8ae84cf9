"""`LiveHub` and `LiveClient`: what goes over the WebSocket of the page: pulses, values, events; and the hand on the machine.

All messages are JSON objects; "k" is their kind. The door sends, by itself:

    hello     what is allowed, the nets, the name of this client, and what is "absent" here, with the reason; then
    pulse     ten times a second: chains with positions, the lease, how many messages this client has missed
    nets      twice a second: all nodes with their states
    event     a boot-up, an emergency, a changed state, a lost heartbeat
    frames    up to ten times a second, for a monitor: "rows" with [kind, seconds, frame, service, node, text], as
              `canopen monitor` tells them; how many were "seen", how many of these were wanted ("fitting") and "left_out", and
              how many the bus itself has "lost"
    commission  "what" a dialogue says: heading, fact, say, remark, warn, ask, file (in base64), end
    values    up to 25 times a second: [[number, time, value], ...] of what the client watches; behind them perhaps a problem,
              and over a fleet how many seconds late it came
    error     what the client asked for was refused; "about" is the kind of its message
    halted    the end of a halt; "problems" has what did not confirm that it stands

A client sends:

    watch     "objects": [[net, node, object], ...], "period": seconds; in place of what it watched before
    monitor   "net", and if not all "nodes" and "services": begin to see frames, in place of those before; "on": false ends it
    halt      always open; "net", "node" if not all
    commission  "net", "node", perhaps the "name" of its joint: begin the dialogue of `canopen drive commission`
    answer    "question", "value" (null: its default), and "n" as below: the answer to a question of that dialogue
    take, leave, renew, stop; enable, disable with "chain"; jog with "chain" and "velocities"; move with "chain" and "targets":
              see `Lease`. Each but take and leave has "n", a number above all before

**A slow client delays nobody.** What is sent to it waits in a bounded channel; a message that finds it full is dropped, and
counted. What a dialogue says has a room of its own (MOST_SAID): it has the files. A client that takes nothing for
`Limits.send_seconds` is cut off. The cycle never waits for any of them.
"""

from __future__ import annotations

import logging
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeVar

import trio
from starlette.websockets import WebSocket, WebSocketDisconnect

from canopen_gateway.commissioning import ClientConversation, check_commissioning, commission
from canopen_gateway.errors import GatewayError, first_of
from canopen_gateway.places import find_node, json_said, number_said
from canopen_gateway.plain_data import EXPECTED, Plain, error_data
from canopen_gateway.traffic import FrameWish
from canopen_gateway.traffic.trace import MOST_NAME
from canopen_gateway.values import WatchedObject
from canopen_gateway.web.subject import WebClient, WebSubject
from canopen_master.plain_text import json_text

T = TypeVar("T", int, str)

PULSE: Final = 0.1
"""Seconds between two pulses."""
NETS_EACH: Final = 5
"""Pulses between two lists of all nodes."""
FLUSH: Final = 0.04
"""Seconds between two messages with values: a page draws at most so often what a person can see."""
WAITING: Final = 32
"""Messages that wait for one client."""
MOST_SAID: Final = 400
"""Messages of a dialogue that wait besides: some hundred are said from one question to the next, where a drive lists as many."""
MAX_MESSAGE: Final = 4096
"""Bytes of a message of a client."""
MOVES: Final = frozenset({"take", "leave", "renew", "stop", "enable", "disable", "jog", "move", "commission", "answer"})
"""Messages about the hand on the machine."""
LOG_LENGTH: Final = 200
LOGGER: Final = logging.getLogger("canopen_gateway")
_LOOK: Final = ""
"""No message: it wakes the one who sends."""


class LiveHub:
    """What all clients of the live channel hear; encoded once for all of them. events: the last ones, as plain data. told: how
    many there were so far. run_name: of this start, for the ids of events. counts: of all events so far, by net, node and kind.

    subject: what is shown. clock: seconds since 1970, for events.
    """

    def __init__(self, subject: WebSubject, clock: Callable[[], float] = time.time) -> None:
        self.subject = subject
        self.events: deque[Plain] = deque(maxlen=LOG_LENGTH)
        self.told = 0
        self.run_name = secrets.token_hex(4)
        self.counts: Counter[tuple[str, int, str]] = Counter()
        self._clock = clock
        self._listeners: set[Callable[[str], None]] = set()

    async def run(self) -> None:
        """Listen, and tell the clients, until cancelled."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self.subject.hear, self._tell_event, self._clock)
            await self._pulse()

    def listen(self, listener: Callable[[str], None]) -> Callable[[], None]:
        """Call `listener` with each message for all clients; return what ends that. It must not block."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def nets(self) -> list[Plain]:
        """Return all nets with their nodes."""
        return [self.subject.net_data(net) for net in self.subject.nets]

    def _tell_event(self, net: str, event: Plain) -> None:
        self.events.append(event)
        self.told += 1
        self.counts[net, event["node"], event["kind"]] += 1
        self._tell({"k": "event", **event})

    async def _pulse(self) -> None:
        number = 0
        while True:
            if self._listeners:
                self._tell({"k": "pulse", "time": self.subject.now(), **self.subject.state()})
                if number % NETS_EACH == 0:
                    self._tell({"k": "nets", "nets": self.nets()})
            number += 1
            await trio.sleep(PULSE)

    def _tell(self, message: Plain) -> None:
        text = json_text(message)
        for listener in tuple(self._listeners):
            listener(text)


class LiveClient:
    """One client of the live channel. dropped: messages that found no room."""

    def __init__(self, hub: LiveHub, client: WebClient, websocket: WebSocket) -> None:
        self.dropped = 0
        self._hub = hub
        self._subject = hub.subject
        self._client = client
        self._websocket = websocket
        self._put, self._get = trio.open_memory_channel[str](WAITING)
        self._waits: deque[str] = deque()  # what a dialogue has said
        self._watch_scope = trio.CancelScope()
        self._watch_turn = trio.Lock()
        self._monitor_scope = trio.CancelScope()
        self._talk: ClientConversation | None = None

    async def run(self) -> None:
        """Serve it until it leaves, or is cut off."""
        await self._websocket.accept()
        subject = self._subject
        hello = {"k": "hello", "you": self._client.name, "nets": self._hub.nets(), "absent": subject.absent, **subject.state()}
        self.put(json_text({**hello, "events": list(self._hub.events), "least_period": subject.limits.least_period}))
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

    def _tell(self, said: dict[str, Any]) -> None:
        """Send what a dialogue says, in its order and before all else. A question that still waits is not asked twice."""
        text = json_text({"k": "commission", **said})
        if said["what"] == "ask" and text in self._waits:
            return
        if len(self._waits) >= MOST_SAID:
            self.dropped += 1
            return
        self._waits.append(text)
        with suppress(trio.WouldBlock):  # full: the one who sends is awake
            self._put.send_nowait(_LOOK)

    async def _send(self, nursery: trio.Nursery) -> None:
        told = 0
        while True:
            text = self._waits.popleft() if self._waits else await self._get.receive()
            if not text:
                continue
            with trio.move_on_after(self._subject.limits.send_seconds) as limit:
                try:
                    await self._websocket.send_text(text)
                    if self.dropped > told:
                        told = self.dropped
                        await self._websocket.send_text(json_text({"k": "dropped", "messages": told}))
                except (WebSocketDisconnect, RuntimeError, OSError):  # it is gone: Starlette says so in each of these ways
                    nursery.cancel_scope.cancel()
            if limit.cancelled_caught:
                LOGGER.info("%s is cut off: it took nothing for %g s", self._client.name, self._subject.limits.send_seconds)
                nursery.cancel_scope.cancel()

    async def _receive(self, nursery: trio.Nursery) -> None:
        while True:
            try:
                text = await self._websocket.receive_text()
            except WebSocketDisconnect:
                return
            except KeyError:  # a message of bytes
                self.put(json_text({"k": "error", "about": "", "code": "", "text": "messages here are JSON as text, not bytes"}))
                continue
            kind = ""
            try:
                message = json_said(text[:MAX_MESSAGE])
                if not isinstance(message, dict) or not isinstance(message.get("k"), str):
                    raise ValueError("a message is a JSON object with a kind, k")
                kind = message["k"][:20]
                self._take(message, nursery)
            except (GatewayError, *EXPECTED, TypeError) as error:
                self.put(json_text({"k": "error", "about": kind, **error_data(error)}))

    def _take(self, message: dict[str, Any], nursery: trio.Nursery) -> None:
        match message["k"]:
            case "halt":
                nursery.start_soon(self._halt, message)
            case "watch":
                objects = [self._watched(each) for each in message.get("objects", ())]
                period = _number(message.get("period", 0.1))
                marked = _marked(message)
                self._watch_scope.cancel()
                self._watch_scope = trio.CancelScope()
                nursery.start_soon(self._watch, self._watch_scope, objects, period, marked)
            case "monitor":
                self._monitor_scope.cancel()
                if message.get("on", True):
                    self._subject.machine("a monitor of frames")
                    net = self._subject.find_net(str(message.get("net", 1)))
                    wish, marked = FrameWish.of(_list(message, "nodes", int), _list(message, "services", str)), _marked(message)
                    self._monitor_scope = trio.CancelScope()
                    nursery.start_soon(self._monitor, self._monitor_scope, net, wish, marked)
            case kind:
                self._move(kind, message)

    def _move(self, kind: str, message: dict[str, Any]) -> None:
        """Do what is said about the hand on the machine."""
        if kind not in MOVES:
            raise ValueError(f"there is no message of the kind {kind[:20]!r}")
        session, service = self._client.machine_session("moving a machine"), self._subject.machine("moving a machine")
        lease = service.lease
        match kind:
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
            case "commission":
                net = self._subject.find_net(str(message.get("net", 1)))
                node = service.node(net, find_node(message.get("node")))
                check_commissioning(service, node)
                talk = ClientConversation(self._tell)
                name = str(message.get("name", ""))[:MOST_NAME]
                lease.commission(session, _sequence(message), node, partial(commission, service, node, talk, name))
                self._talk = talk
            case "answer":
                lease.renew(session, _sequence(message))
                if self._talk is not None and isinstance(message.get("question"), int):
                    self._talk.answer(message["question"], message.get("value"))
            case "move":
                targets = [_number(each) for each in message.get("targets", ())]
                lease.move(
                    session, _sequence(message), str(message.get("chain")), targets, speed=_number(message.get("speed", 0.1))
                )

    async def _monitor(self, scope: trio.CancelScope, net: str, wish: FrameWish, marked: Plain) -> None:
        """Send the frames of a net until something else is looked at. Those that this client has no room for are counted. marked:
        as of `_watch`."""
        traffic = self._subject.machine("a monitor of frames").traffic(net)
        with scope, traffic.watch(wish) as feed:
            told = (-1, 0)
            while True:
                rows = feed.take()
                if rows or (feed.seen, feed.left_out) != told:
                    told = feed.seen, feed.left_out
                    counts = {"seen": feed.seen, "fitting": feed.fitting, "left_out": feed.left_out}
                    lost = traffic.lost + traffic.dropped
                    self.put(json_text({"k": "frames", "net": net, "rows": rows, **counts, "lost": lost, **marked}))
                if traffic.failure is not None:
                    text = "what passes is not understood any more: the gateway's log says why"
                    self.put(json_text({"k": "error", "about": "monitor", "code": "", "text": text, "details": []}))
                    return
                await trio.sleep(PULSE)

    async def _halt(self, message: dict[str, Any]) -> None:
        try:
            net = None if message.get("net") is None else self._subject.find_net(str(message["net"]))
            problems = await self._subject.halt(net, find_node(message.get("node", 0), least=0))
        except (GatewayError, *EXPECTED, TypeError) as error:
            self.put(json_text({"k": "error", "about": "halt", **error_data(error)}))
            return
        self.put(json_text({"k": "halted", "problems": problems}))

    def _watched(self, place: Any) -> WatchedObject:
        if not isinstance(place, list) or len(place) != 3:
            raise ValueError("an object to watch is [net, node, object]")
        return self._subject.place_of(self._subject.find_net(str(place[0])), find_node(place[1]), str(place[2]))

    async def _watch(self, scope: trio.CancelScope, objects: Sequence[WatchedObject], period: float, marked: Plain) -> None:
        """Send values until something else is watched. A value that a PDO brings is sent each time that it comes. marked: stands
        in each message, since some of the choice before may be on their way still, and their numbers mean other objects."""
        if not objects:
            return
        with scope:
            await self._watch_turn.acquire()  # what was watched before has to end first
            try:
                async with self._client.watch(objects, max(period, 0.1)) as take:
                    while True:
                        rows = take()
                        if rows:
                            self.put(json_text({"k": "values", "values": rows, **marked}))
                        await trio.sleep(FLUSH)
            except* (GatewayError, *EXPECTED) as failed:
                self.put(json_text({"k": "error", "about": "watch", **error_data(first_of(failed))}))
            finally:
                self._watch_turn.release()


def _list(message: dict[str, Any], name: str, kind: type[T]) -> list[T]:
    """Return a list of a message; nothing if it is not there."""
    found = message.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, kind) and not isinstance(each, bool) for each in found):
        raise ValueError(f"{name} has to be a list: {'numbers' if kind is int else 'texts'}")
    return found


def _marked(message: dict[str, Any]) -> Plain:
    """Return the mark of a choice, as it stands in what is sent for it; nothing if it has none."""
    return {"mark": _sequence(message, "mark")} if "mark" in message else {}


def _sequence(message: dict[str, Any], name: str = "n") -> int:
    number = message.get(name)
    if not isinstance(number, int) or isinstance(number, bool):
        raise ValueError(f"the message needs a number, {name}, above all before")
    return number


def _number(value: Any) -> float:
    number = number_said(value)
    if number is None:
        raise ValueError(f"{str(value)[:20] if isinstance(value, float | str) else 'this'!r} is no number")
    return number
