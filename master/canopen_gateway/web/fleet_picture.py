"""`FleetPicture`: what is known of a fleet: its buses, their nodes, and since when something is lost. Pure: it is given news,
and the time.

A bridge may be hostile. So each thing that it tells is looked at: another type counts as not told, a text is cleaned and cut, and
there is room for MOST_BUSES buses. Numbers of buses stay as they were, so that a request never means another bus than the one
that was shown; what is lost stays, shown as lost.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from canopen_gateway.fleet import FleetEmcy, FleetNews, FleetPlace, FleetState, FleetStatus, PlaceAppeared, PlaceGone
from canopen_gateway.guard import Permission
from canopen_gateway.plain_data import Plain, state_words
from canopen_master.plain_text import clean
from canopen_proto.error_codes import error_text
from canopen_proto.nmt import NmtState

MOST_BUSES: Final = 256
"""Buses of one page; each has 127 nodes at most."""
LATE_STATUS: Final = 3.0
"""Seconds without a status until a bridge counts as late: it sends one each second."""
LATE_VALUE: Final = 1.0
"""Seconds by which a thing told may be later than the soonest ones of its bus, until it counts as late."""
CLOCK_SPAN: Final = 30.0
"""Seconds of which the soonest thing told is remembered, twice: a clock that is set anew is forgotten after that."""
MOST_RUNS: Final = 8
"""Runs of a bridge that are remembered."""
TWINS: Final = "several bridges have this name: what is shown is of all of them, and nothing is changed there"
MOST_NAME: Final = 200
THERE, LATE, LOST = "there", "late", "lost"
_NO_ERROR_CODE: Final = 0x00FF
"""Error codes up to here say that errors are gone (CiA 301 v4.2.0, table 26)."""


@dataclass
class _NodeSeen:
    """since: when it came, or went. heard: when its bridge last told anything of it."""

    since: float
    heard: float
    is_there: bool = True
    state: NmtState | None = None
    name: str = ""
    emergency: int = 0


@dataclass
class _BusSeen:
    """number: of the net, from 1. since, heard: as of a node. soonest: how much later than its bridge's clock things come at
    best, in this span and the one before; begun: when this span has begun. runs: of its bridge, the one that spoke
    last is the last; twins_heard: when another one has spoken again, which is another bridge."""

    place: FleetPlace
    number: int
    since: float
    heard: float
    is_there: bool = True
    outage: str = ""
    allow: frozenset[str] = frozenset()
    nodes: dict[int, _NodeSeen] = field(default_factory=dict)
    soonest: tuple[float, float] = (float("inf"), float("inf"))
    begun: float = float("-inf")
    runs: list[str] = field(default_factory=list)
    twins_heard: float = float("-inf")

    def has_twins(self, now: float) -> bool:
        return now - self.twins_heard <= LATE_STATUS


class FleetPicture:
    """See this module's text. All times are seconds of one clock, but for those that are said to be of a bridge's own."""

    def __init__(self) -> None:
        self._buses: dict[FleetPlace, _BusSeen] = {}
        self._is_full = False

    @property
    def names(self) -> Sequence[str]:
        """The buses by name, as "hall-2/arm"."""
        return [str(place) for place in sorted(self._buses)]

    def place(self, net: str, node_id: int = 0) -> FleetPlace:
        """Return the place of a bus, or of a node on it. net: one of `names`."""
        site, _, bus = net.partition("/")
        return FleetPlace(site, bus, node_id)

    def name_of(self, number: int) -> str | None:
        """Return the name of a bus by its number, from 1."""
        return next((str(each.place) for each in self._buses.values() if each.number == number), None)

    def lost(self) -> Sequence[str]:
        """Return the names of the buses whose bridge is lost."""
        return sorted(map(str, self._lost()))

    def twins(self, now: float) -> Sequence[str]:
        """Return the names of the buses for which several bridges speak: one answer does not say that all have answered."""
        return sorted(str(each.place) for each in self._buses.values() if each.has_twins(now))

    def _lost(self) -> set[FleetPlace]:
        return {each.place for each in self._buses.values() if not each.is_there}

    def late_by(self, place: FleetPlace, stamp: int | None, now: float) -> float:
        """Return how many seconds late a thing told is: later than the soonest things of this bus, whose clock may be any. 0.0
        for one that is not late, or has no sound time. stamp: ns of the bridge's clock. now: s of this computer's clock."""
        bus = self._buses.get(place.bus_place)
        if bus is None or stamp is None or not 0 <= stamp < 1 << 64:
            return 0.0
        took = now - stamp / 1e9
        if now - bus.begun > CLOCK_SPAN:
            bus.soonest, bus.begun = (float("inf"), bus.soonest[0]), now
        bus.soonest = min(bus.soonest[0], took), bus.soonest[1]
        late = took - min(bus.soonest)
        return round(late, 1) if late > LATE_VALUE else 0.0

    def agree(self, alive: Collection[FleetPlace], now: float) -> None:
        """Have exactly these places as those that are there: news of them were lost."""
        known = {bus.place for bus in self._buses.values() if bus.is_there}
        for bus in self._buses.values():
            known |= {bus.place._replace(node_id=node_id) for node_id, node in bus.nodes.items() if node.is_there}
        for place in known.difference(alive):
            self._gone(place, now)
        for place in sorted(alive):
            self._appeared(place, now)

    def take(self, news: Iterable[FleetNews], now: float) -> list[tuple[str, Plain]]:
        """Take what has happened, and return what of it is worth telling: the name of the bus, and the event, without its time.
        Nodes that are lost together with their bridge are told as one event, that of the bridge."""
        told: list[tuple[str, Plain]] = []
        batch = list(news)
        gone = {each.place for each in batch if isinstance(each, PlaceGone) and not each.node_id}
        for event in batch:
            plain = self._take(event, now)
            bus = self._buses.get(event.place.bus_place)
            if plain is None or (isinstance(event, PlaceGone) and event.node_id and event.place.bus_place in gone | self._lost()):
                continue
            number = 0 if bus is None else bus.number
            about: Plain = {"net": number, "node": event.node_id, "place": str(event.place)}
            told.append((str(event.place.bus_place), about | plain))
        return told

    def net_data(self, net: str, allowed: Iterable[Permission], now: float) -> Plain:
        """Return a bus with its nodes, as `plain_data.net_data` does; its age is since when it is lost, or late, in seconds: None
        while neither. allowed: by the page itself."""
        bus = self._buses[self.place(net)]
        silent = now - bus.heard
        state = LOST if not bus.is_there else LATE if silent > LATE_STATUS else THERE
        age = now - bus.since if state == LOST else silent if state == LATE else None
        return {
            "net": bus.number,
            "name": net,
            "state": state,
            "age": None if age is None else round(age, 1),
            "outage": TWINS if bus.has_twins(now) else bus.outage,
            "allow": sorted(each.value for each in allowed if each.value in bus.allow),
            "nodes": [self.node_data(net, node_id, now) for node_id in sorted(bus.nodes)],
        }

    def has_node(self, net: str, node_id: int) -> bool:
        """Return whether a node was ever seen."""
        return node_id in self._buses[self.place(net)].nodes

    def node_data(self, net: str, node_id: int, now: float) -> Plain:
        """Return a node, as `plain_data.node_data` does; its age is since its bridge last told of it, or since it is lost."""
        bus = self._buses[self.place(net)]
        node = bus.nodes[node_id]
        is_lost = not (bus.is_there and node.is_there)
        since = min(each.since for each in (bus, node) if not each.is_there) if is_lost else node.heard
        emergency = {"code": f"0x{node.emergency:04X}", "text": error_text(node.emergency)} if node.emergency else None
        return {
            "node": node_id,
            "name": node.name,
            "state": LOST if is_lost else state_words(node.state),
            "age": round(now - since, 2),
            "heard": None,
            "emergency": emergency,
            "drives": [],
        }

    # ---- news ----

    def _take(self, event: FleetNews, now: float) -> Plain | None:
        match event:
            case PlaceAppeared(place=place):
                return self._appeared(place, now)
            case PlaceGone(place=place):
                return self._gone(place, now)
            case FleetState(place=place, state=state):
                if (node := self._node(place)) is None:
                    return None
                node.state, node.heard = state, now
                return {"kind": "state", "text": "a state that this page does not know" if state is None else state_words(state)}
            case FleetEmcy(place=place, code=code):
                if (node := self._node(place)) is None:
                    return None
                is_error = code > _NO_ERROR_CODE
                node.emergency, node.heard = code if is_error else 0, now
                text = error_text(code) if is_error else "no error any more"
                vendor, register = event.vendor_data.hex(" "), event.error_register
                return {"kind": "emergency", "code": f"0x{code:04X}", "text": text, "register": register, "vendor": vendor}
            case FleetStatus(place=place, told=told):
                self._on_status(place, told, now)
        return None

    def _appeared(self, place: FleetPlace, now: float) -> Plain | None:
        bus = self._buses.get(place.bus_place)
        if bus is None:
            if len(self._buses) >= MOST_BUSES:
                was_full, self._is_full = self._is_full, True
                text = f"more than {MOST_BUSES} buses: this one, and all further ones, are not shown"
                return None if was_full else {"kind": "other", "text": text}
            # A node may show itself before its bus: the bus then is there, too
            bus = self._buses[place.bus_place] = _BusSeen(place.bus_place, len(self._buses) + 1, now, now)
        if not place.node_id:
            was_lost, bus.is_there = not bus.is_there, True
            if was_lost:
                bus.since = bus.heard = now
            return {"kind": "there", "text": "its bridge is there again" if was_lost else "its bridge is there"}
        node = bus.nodes.setdefault(place.node_id, _NodeSeen(now, now))
        if not node.is_there:
            node.is_there, node.since, node.heard, node.state = True, now, now, None
        return {"kind": "there", "text": "it was heard"}

    def _gone(self, place: FleetPlace, now: float) -> Plain | None:
        bus = self._buses.get(place.bus_place)
        seen = bus if bus is None or not place.node_id else bus.nodes.get(place.node_id)
        if seen is None or not seen.is_there:
            return None
        seen.is_there, seen.since = False, now
        text = "nothing is heard of it any more" if place.node_id else "its bridge is away, hung, or cut off"
        return {"kind": "lost", "text": text}

    def _node(self, place: FleetPlace) -> _NodeSeen | None:
        """Return a node that something is told of; None for one that has never appeared: its bridge tells that, too."""
        bus = self._buses.get(place.bus_place)
        return None if bus is None else bus.nodes.get(place.node_id)

    def _on_status(self, place: FleetPlace, told: Mapping[str, Any], now: float) -> None:
        bus = self._buses.get(place)
        if bus is None:
            return
        bus.heard = now
        outage, allow = told.get("outage"), told.get("allow")
        bus.outage = clean(outage, MOST_NAME) if isinstance(outage, str) else ""
        bus.allow = frozenset(each for each in allow if isinstance(each, str)) if isinstance(allow, list) else frozenset()
        if isinstance(run := told.get("run"), str):
            self._on_run(bus, run[:MOST_NAME], now)
        states, names = told.get("nodes"), told.get("names")
        for node_id, node in bus.nodes.items():
            state = states.get(str(node_id)) if isinstance(states, dict) else None
            if isinstance(state, str):
                node.heard = now
                node.state = NmtState[state] if state in NmtState.__members__ else None
            name = names.get(str(node_id)) if isinstance(names, dict) else None
            node.name = clean(name, MOST_NAME) if isinstance(name, str) else ""

    def _on_run(self, bus: _BusSeen, run: str, now: float) -> None:
        """Take that a run of a bridge speaks: a bridge that was started anew has another one, and the old one is silent then."""
        if run in bus.runs and run != bus.runs[-1]:
            bus.twins_heard = now
        bus.runs = [*(each for each in bus.runs if each != run), run][-MOST_RUNS:]
