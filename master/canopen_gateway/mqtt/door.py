"""`MqttDoor`: what a machine does, for an MQTT broker. It tells, and is told nothing.

    canopen/v1/SITE/online                      whether this program is there; the broker says no if it has lost it (last will)
    canopen/v1/SITE/BUS/status                  the bus: its state, an outage, its nodes
    canopen/v1/SITE/BUS/NODE/state              the NMT state, or that its heartbeat is lost
    canopen/v1/SITE/BUS/NODE/emcy               its last emergency
    canopen/v1/SITE/BUS/NODE/values/NAME        a value: of a PDO, or of an object that is read

All are JSON, and retained: who subscribes later has the last of each at once. A value is sent once in each period, the last one;
what came between is not. That is telemetry; a history is `canopen fleet record`.

**Nothing waits for the broker.** What is new stands in a table with a place for each topic, and a thread hands it over while the
broker takes it. While it does not, the table has the last values; emergencies wait, EVENTS_KEPT of them, and then the oldest go.
When the broker is back all last values are sent again.
"""

from __future__ import annotations

import json
import logging
import math
import re
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import trio

from canopen_gateway.errors import GatewayError, first_of
from canopen_gateway.fleet.keys import ROOT, check_name, name_of_bus
from canopen_gateway.mqtt.broker import BrokerAddress, BrokerLink, BrokerLogin, check_secret
from canopen_gateway.places import check_object, find_object
from canopen_gateway.plain_data import (
    HEARTBEAT_WORDS,
    NOT_HEARD,
    error_data,
    event_data,
    net_data,
    node_ids,
    place_text,
    plain_value,
)
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.values import decoded
from canopen_master import MasterError, Node
from canopen_proto import LocalProtocolError, PdoReceived
from canopen_proto.bus_knowledge import HeardService
from canopen_proto.datatypes import Value
from canopen_proto.gateway import GatewayCode
from canopen_proto.machine import SECOND
from canopen_proto.multiplexer import index_of, subindex_of
from canopen_proto.procedures import ProcedureError

PERIOD: Final = 1.0
"""Seconds from one value of a topic to the next."""
LEAST_PERIOD: Final = 0.05
STATUS_PERIOD: Final = 5.0
SILENT_AFTER: Final = 3 * SECOND
"""A node whose heartbeat has begun is away after this time without one."""
EVENTS_KEPT: Final = 256
"""Emergencies that wait for a broker; further ones push out the oldest, which are counted."""
LOST: Final = HEARTBEAT_WORDS[GatewayCode.HEARTBEAT_LOST]
MOST_TOPICS: Final = 100_000
CLOSING: Final = 5.0
"""Seconds for the last word to the broker."""
LOGGER: Final = logging.getLogger("canopen_gateway")
_NO_LEVEL: Final = re.compile(r"[^A-Za-z0-9_.:()\[\]-]+")


class MqttDoor:
    """See this module's text; made by `bind_mqtt_door`. failure: why it was closed, or None. link: to the broker. dropped:
    emergencies that the broker never got; sent: messages that it was given."""

    def __init__(self, site: str, link: BrokerLink, objects: Sequence[str], period: float, every: float) -> None:
        self.site = site
        self.link = link
        self.failure: Exception | None = None
        self.dropped = 0
        self.sent = 0
        self._objects = tuple(objects)
        self._period = max(period, LEAST_PERIOD)
        self._every = max(every, LEAST_PERIOD)
        self._service: GatewayService
        self._session: GatewaySession
        self._names: dict[str, str] = {}
        self._last: dict[str, bytes] = {}  # what each topic says
        self._changed: dict[str, None] = {}  # the topics that the broker has not got yet, in the order of their change
        self._events: deque[tuple[str, bytes]] = deque()
        self._pdos: dict[tuple[str, int, int], tuple[PdoReceived, int]] = {}
        self._states: dict[str, str] = {}
        self._levels: dict[tuple[str, int, int, int], str] = {}
        self._taken_levels: dict[str, tuple[str, int, int, int]] = {}

    async def __aenter__(self) -> MqttDoor:
        return self

    async def __aexit__(self, *exc: object) -> None:
        with trio.move_on_after(CLOSING, shield=True):
            await trio.to_thread.run_sync(self.link.close, self._online(False), abandon_on_cancel=True)

    async def serve(self, service: GatewayService, begun: Callable[[], object] | None = None) -> None:
        """Tell the broker until cancelled. begun: called once nothing can be refused any more; the broker may still be away.
        Returns early only if the door itself fails; see `failure`. Raises GatewayFullError; ValueError if two buses would have
        one name; ObjectNotFoundError for an object to read that no dictionary at hand knows by this name."""
        self._names = {net: name_of_bus(net) for net in service.nets}
        if len(set(self._names.values())) < len(self._names):
            raise ValueError("two buses would have one name: give them names in a machine file")
        for each in self._objects:
            check_object(service.master.dictionaries, each)
        self._service = service
        with service.open_session(f"an MQTT broker, as {self.site}") as self._session:
            watchers = [
                service.master.watch((PdoReceived,), partial(self._hear, net), service.master.bus(net)) for net in service.nets
            ]
            try:
                if begun is not None:
                    begun()
                await self._tell_all()
            finally:
                for watcher in watchers:
                    service.master.unwatch(watcher)

    async def _tell_all(self) -> None:
        try:
            async with trio.open_nursery() as nursery:
                self._begin(nursery)
        except* Exception as failed:  # noqa: BLE001 - whatever it is, it ends this door alone
            self.failure = first_of(failed)
            LOGGER.warning("the door to a broker is closed: %s", self.failure)

    def _begin(self, nursery: trio.Nursery) -> None:
        for net in self._service.nets:
            self._session.hear_boot_ups(net, True)
            for node_id in range(1, 128):
                self._session.watch_heartbeat(net, node_id, SILENT_AFTER)
            nursery.start_soon(self._ask_around, net)
            nursery.start_soon(self._again, STATUS_PERIOD, partial(self._take_status, net))
            for each in self._objects:
                nursery.start_soon(self._again, self._every, partial(self._read_all, net, each))
        nursery.start_soon(self._take_events)
        nursery.start_soon(self._send)

    # ---- what there is to tell ----

    def _hear(self, net: str, event: PdoReceived) -> None:
        """Take a PDO, in the pump's turn: it is looked at when it is sent."""
        if event.number and event.node_id:
            self._pdos[net, event.node_id, event.number] = event, time.time_ns()

    async def _take_events(self) -> None:
        while True:
            heard = await self._session.next_event()
            told = event_data(self._service, heard, time.time())
            topic = f"{self._bus(heard.net)}/{heard.event.node_id}"
            kind = told.pop("kind")
            told = {"time": _clock(time.time_ns()), **{key: told[key] for key in told if key not in ("time", "net", "node")}}
            if kind == "emergency":
                self._events.append((f"{topic}/emcy", _json(told)))
                self._forget_old_events()
            else:
                self._tell_state(f"{topic}/state", told["text"])

    def _tell_state(self, topic: str, state: str) -> None:
        self._states[topic] = state
        self._tell(topic, {"time": _clock(time.time_ns()), "state": state})

    async def _ask_around(self, net: str) -> None:
        """Ask once who is there: a node without a heartbeat would not be seen else."""
        with suppress(MasterError, GatewayError):  # an outage, which the status tells
            await self._service.find_nodes(net)
        await self._take_status(net)

    async def _again(self, period: float, work: Callable[[], Any]) -> None:
        """Do something again and again. Periods that were missed are left out."""
        due = trio.current_time()
        while True:
            await work()
            due += period
            due += max(0, math.ceil((trio.current_time() - due) / period)) * period
            await trio.sleep_until(due)

    async def _take_status(self, net: str) -> None:
        told = net_data(self._service, net)
        for each in told["nodes"]:  # events may have been dropped, and some were the only ones of a node
            if each["age"] is None or each["state"] == NOT_HEARD:
                continue
            is_silent = each["age"] >= SILENT_AFTER / SECOND
            if is_silent and each["heard"] != HeardService.HEARTBEAT.value:
                continue  # perhaps it has none
            state = LOST if is_silent else each["state"]
            topic = f"{self._bus(net)}/{each['node']}/state"
            if self._states.get(topic) != state:
                self._tell_state(topic, state)
        nodes = {str(each["node"]): {"name": each["name"], "state": each["state"]} for each in told["nodes"]}
        self._tell(
            f"{self._bus(net)}/status",
            {"time": _clock(time.time_ns()), "bus": net, "state": told["state"], "outage": told["outage"], "nodes": nodes},
        )

    async def _read_all(self, net: str, key: str) -> None:
        """Read an object of all nodes that were heard, side by side."""
        async with trio.open_nursery() as nursery:
            for node_id in node_ids(self._service.master, net):
                nursery.start_soon(self._read, net, node_id, key)

    async def _read(self, net: str, node_id: int, key: str) -> None:
        node = self._service.node(net, node_id)
        try:
            index, subindex = find_object(node.dictionary, key)
            data = await self._session.read(net, node_id, index, subindex)
        except (MasterError, GatewayError, ProcedureError, LocalProtocolError, LookupError, ValueError) as error:
            told = {"time": _clock(time.time_ns()), "value": None, "problem": str(error_data(error)["text"])[:500]}
            self._tell(f"{self._bus(net)}/{node_id}/values/{_level(key)}", told)
            return
        self._tell_value(node, index, subindex, decoded(node.dictionary, index, subindex, data), data, time.time_ns())

    def _take_pdos(self) -> None:
        """Look at the PDOs that came since the last time: the last of each kind."""
        taken, self._pdos = self._pdos, {}
        for (net, node_id, _), (event, when) in taken.items():
            node = self._service.node(net, node_id)
            for mux, value in zip(event.mapping.muxes, event.components, strict=True):
                self._tell_value(node, index_of(mux), subindex_of(mux), value, None, when)

    def _tell_value(self, node: Node, index: int, subindex: int, value: Value, data: bytes | None, when: int) -> None:
        variable = node.dictionary.get(index, subindex)
        is_odd = isinstance(value, float) and not math.isfinite(value)  # JSON has no such number
        told: dict[str, Any] = {"time": _clock(when), "value": None if is_odd else plain_value(value)}
        if variable is not None:
            told |= {"unit": variable.unit, "type": variable.data_type.name}
        if data is not None:
            told["bytes"] = data[:4096].hex(" ")
        if is_odd:
            told["problem"] = f"{value!r} is no number in JSON"
        level = self._level_of(node, index, subindex, "" if variable is None else variable.name)
        self._tell(f"{self._bus(node.bus)}/{node.node_id}/values/{level}", told)

    def _level_of(self, node: Node, index: int, subindex: int, name: str) -> str:
        """Return the last level of a value's topic: its name, or its place where another object has that name."""
        place = (node.bus, node.node_id, index, subindex)
        level = self._levels.get(place)
        if level is None:
            where = place_text(index, subindex)
            level = _level(name) or where
            topic = f"{node.bus}/{node.node_id}/{level}"
            if self._taken_levels.setdefault(topic, place) != place:
                level = where
            self._levels[place] = level
        return level

    def _tell(self, topic: str, told: dict[str, Any]) -> None:
        """Let a topic say this from now on."""
        payload = _json(told)
        if topic not in self._last and len(self._last) >= MOST_TOPICS:
            self.dropped += 1
            return
        self._last[topic] = payload
        self._changed[topic] = None

    # ---- to the broker ----

    async def _send(self) -> None:
        """Hand over what is new, once in each period, in a thread. What the broker does not take stays."""
        connections = 0
        while True:
            self._take_pdos()
            if self.link.connections != connections and self.link.is_connected:
                connections = self.link.connections
                self._changed |= dict.fromkeys(self._last)  # it may have lost all, or be another one
                self._events.appendleft(self._online(True))
            if self.link.is_connected:
                await self._hand_over()
            await trio.sleep(self._period)

    async def _hand_over(self) -> None:
        events = list(self._events)
        self._events.clear()
        topics = list(self._changed)
        batch = events + [(topic, self._last[topic]) for topic in topics]
        self._changed.clear()
        count = await trio.to_thread.run_sync(self.link.send, batch)
        self.sent += count
        self._events.extendleft(reversed(events[count:]))
        self._forget_old_events()
        for topic in topics[max(0, count - len(events)) :]:
            self._changed.setdefault(topic)

    def _forget_old_events(self) -> None:
        while len(self._events) > EVENTS_KEPT:
            self._events.popleft()
            self.dropped += 1

    def _online(self, is_online: bool) -> tuple[str, bytes]:
        return online_message(self.site, is_online)

    def _bus(self, net: str) -> str:
        return f"{ROOT}/{self.site}/{self._names[net]}"


async def bind_mqtt_door(
    site: str,
    address: BrokerAddress,
    login: BrokerLogin = BrokerLogin(),  # noqa: B008 - a tuple
    *,
    objects: Sequence[str] = (),
    period: float = PERIOD,
    every: float = 5.0,
    clear_text: bool = False,
) -> MqttDoor:
    """Begin to connect to a broker, and wait for nothing: one that is away is tried again for ever. `MqttDoor.serve` tells it.

    site: this computer's name in topics. objects: are read from each node that was heard, too, each `every` seconds. period:
    seconds from one value of a topic to the next. clear_text: a password may cross a network without TLS. Raises DoorError,
    ValueError for a name that cannot stand in a topic, PackageMissingError.
    """
    check_name("site", site)
    check_secret(address, login, clear_text=clear_text)
    link = BrokerLink(address, login, f"canopen-{site}", online_message(site, False))
    link.start()
    return MqttDoor(site, link, objects, period, every)


def online_message(site: str, is_online: bool) -> tuple[str, bytes]:
    """Return topic and payload that say whether the program of a site is there."""
    told: dict[str, object] = {"online": is_online}
    if is_online:
        told["since"] = _clock(time.time_ns())
    return f"{ROOT}/{site}/online", _json(told)


def _level(name: str) -> str:
    """Return a name as a level of a topic: without what means something there, or is no text."""
    return _NO_LEVEL.sub("-", name)[:200].strip("-")


def _clock(nanoseconds: int) -> str:
    return datetime.fromtimestamp(nanoseconds / 1e9, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _json(told: dict[str, Any]) -> bytes:
    return json.dumps(told, allow_nan=False, separators=(",", ":")).encode()
