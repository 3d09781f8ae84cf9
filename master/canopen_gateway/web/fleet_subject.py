"""`FleetSubject`: the machines of many computers, for a web door. Needs the extra `fleet`.

Reading and halting are open to all. A change goes only if both allow it: this door, which asks its own guard, and the bridge,
which asks its own. What a bridge tells is data, looked at before it is told on (fleet_picture.py).
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Final

import trio

from canopen_gateway.errors import BridgeRefusedError, FleetError, GatewayFullError, NoSuchPlaceError, NotOverFleetError
from canopen_gateway.fleet import (
    Fleet,
    FleetEmcy,
    FleetNews,
    FleetPdo,
    FleetPlace,
    FleetState,
    FleetStatus,
    FleetValue,
    PlaceAppeared,
    PlaceGone,
)
from canopen_gateway.fleet.keys import OBJECT
from canopen_gateway.guard import Guard, Permission
from canopen_gateway.limits import Limits, RequestsUnderWay
from canopen_gateway.places import number_of_object
from canopen_gateway.plain_data import MAX_BYTES_SHOWN, Plain, place_text, plain_value, view_data
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.values import WatchedObject
from canopen_gateway.web.fleet_picture import MOST_NAME, FleetPicture
from canopen_gateway.web.subject import TakeRows, TellEvent, WebClient, WebSubject
from canopen_master.plain_text import clean
from canopen_proto import NmtCommand
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import fold_name
from canopen_proto.drives.axis.view import DriveView

NEVER_ALLOWED: Final = frozenset({Permission.MOTION, Permission.LSS})
"""A dead man's switch needs a short way to the machine; and a bridge has no layer setting services."""
MOST_OBJECTS: Final = 20_000
"""Objects of a node that are told on."""
MOST_CONSTANTS: Final = 64
LEAST_PERIOD: Final = 0.5
"""Seconds between two reads of a value that no PDO brings: each goes over the network, and takes a turn of the bus."""
ALL: Final = FleetPlace("*", "*")
ABSENT: Final[Mapping[str, str]] = {
    "motion": "Jogging, and commissioning of a drive: a dead man's switch needs a short way to the machine.",
    "monitor": "The monitor of frames, and traces: each frame stays on the computer that has the bus.",
    "network": "Who sends which PDO to whom, and the load of a bus: its bridge does not tell it.",
    "search": "A search for nodes: each bridge asks all node-IDs once, when it starts.",
    "nmt-all": "An NMT command to all nodes of a bus: a bridge takes one for a node at a time.",
}
"""What a page over a fleet does not have, and why."""
_PATH: Final = re.compile(r"[0-9A-F]{4}:[0-9A-F]{2}\Z")
_DRIVE: Final = {"mode": 0x6061, "wanted_mode": 0x6060, "error_code": 0x603F, "controlword": 0x6040, "supported_modes": 0x6502}
_SIGNED: Final = ("mode", "wanted_mode")
_NOT_THERE: Final = (AbortCode.NO_SUCH_OBJECT, AbortCode.NO_SUCH_SUBINDEX)


class FleetSubject(WebSubject):
    """See this module's text. clock: seconds since 1970, of this computer."""

    absent: Mapping[str, str] = ABSENT

    def __init__(
        self,
        fleet: Fleet,
        allow: Collection[Permission] = (),
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """allow: what clients may change; by default nothing. Raises ValueError for motion and lss."""
        if never := NEVER_ALLOWED.intersection(allow):
            raise ValueError(f"{', '.join(sorted(each.value for each in never))}: not over a fleet")
        self.fleet = fleet
        self.guard = Guard(allow)
        self.limits = Limits() if limits is None else limits
        self.picture = FleetPicture()
        self._clock = clock
        self._under_way = RequestsUnderWay(self.limits.requests)  # a halt is none of them: it waits for nobody
        self._clients = 0

    def machine(self, what: str) -> GatewayService:
        """See WebSubject."""
        raise NotOverFleetError(what)

    # ---- what was heard ----

    @property
    def nets(self) -> Sequence[str]:
        """See WebSubject."""
        return self.picture.names

    def find_net(self, text: str) -> str:
        """See WebSubject. In a path the name is "hall-2:arm": a slash would end it."""
        name = text.replace(":", "/")
        if name in self.nets:
            return name
        found = self.picture.name_of(int(text)) if text.isascii() and text.isdecimal() and len(text) < 4 else None
        if found is None:
            raise NoSuchPlaceError(f"there is no net {text[:40]!r}", seen=f"this fleet has had {len(self.nets)}, as SITE:BUS")
        return found

    def state(self) -> Plain:
        """See WebSubject."""
        allow = sorted(each.value for each in self.guard.allowed)
        lease = {"owner": None, "left": 0.0, "doing": "", "problem": ""}
        return {"allow": allow, "mode": self.guard.mode, "chains": [], "lease": lease}

    def net_data(self, net: str) -> Plain:
        """See WebSubject."""
        return self.picture.net_data(net, self.guard.allowed, self.now())

    def node_data(self, net: str, node_id: int) -> Plain:
        """See WebSubject."""
        if not self.picture.has_node(net, node_id):
            raise NoSuchPlaceError(f"there is no node {net}/{node_id}", seen="its bridge has not told of it")
        return self.picture.node_data(net, node_id, self.now())

    def now(self) -> float:
        """See WebSubject."""
        return trio.current_time()

    async def hear(self, tell: TellEvent, clock: Callable[[], float]) -> None:
        """See WebSubject."""
        dropped = 0
        kinds: tuple[type[FleetNews], ...] = (PlaceAppeared, PlaceGone, FleetState, FleetEmcy, FleetStatus)
        with self.fleet.news(*kinds) as news:
            self.picture.agree(self._alive(), self.now())
            while True:
                first = await news.receive()
                for net, event in self.picture.take([first, *news.take()], self.now()):
                    tell(net, {"time": round(clock(), 3), **event})
                if news.dropped > dropped:
                    dropped = news.dropped
                    self.picture.agree(self._alive(), self.now())

    def _alive(self) -> list[FleetPlace]:
        return [*self.fleet.buses, *self.fleet.nodes]

    # ---- what is asked, and changed ----

    async def search(self, net: str) -> None:
        """See WebSubject."""
        raise NotOverFleetError("a search for nodes")

    async def about(self, net: str, node_id: int) -> Plain:
        """See WebSubject."""
        name, drive, problem = "", None, ""
        place = self.picture.place(net, node_id)
        try:
            drive = await self._drive(place)
            name = await self._name(place)
        except (FleetError, BridgeRefusedError) as error:
            problem = clean(error.failed)
        return {"name": name, "drive": drive, "problem": problem}

    async def _drive(self, place: FleetPlace) -> Plain | None:
        statusword = await self._number(place, 0x6041, 2)
        if statusword is None:
            return None
        shown: dict[str, Any] = {name: await self._number(place, key, 4, signed=name in _SIGNED) for name, key in _DRIVE.items()}
        return view_data(DriveView(statusword, **shown))

    async def _number(self, place: FleetPlace, key: int, most: int, *, signed: bool = False) -> int | None:
        """Return an object as a number; None if the node has none, or it is longer than `most` bytes."""
        try:
            data = (await self._read(place, f"{key:04X}:00")).data
        except BridgeRefusedError as error:
            if error.abort_code in _NOT_THERE:
                return None
            raise
        return int.from_bytes(data, "little", signed=signed) if 0 < len(data) <= most else None

    async def _name(self, place: FleetPlace) -> str:
        try:
            return clean((await self._read(place, "1008:00")).data.decode("latin-1"), MOST_NAME)
        except BridgeRefusedError as error:
            if error.abort_code in _NOT_THERE:
                return ""
            raise

    async def objects(self, net: str, node_id: int) -> Sequence[Plain]:
        """See WebSubject."""
        with self._under_way:
            told = await self.fleet.objects(self.picture.place(net, node_id))
        return [row for each in told[:MOST_OBJECTS] if (row := _object_row(each)) is not None]

    async def read(self, net: str, node_id: int, text: str) -> tuple[bytes, Plain]:
        """See WebSubject."""
        key = text.replace(" ", "_")  # to a dictionary both are one name, and a key of a fleet has no blanks
        if not OBJECT.match(key):
            raise NoSuchPlaceError(f"{net}/{node_id} has no object {text[:60]!r}", seen="no key of a fleet can name it")
        value = await self._read(self.picture.place(net, node_id), key)
        path = value.object if _PATH.match(value.object) else text
        return value.data, {
            "path": path,
            "size": len(value.data),
            "hex": value.data[:MAX_BYTES_SHOWN].hex(" "),
            "name": clean(value.name, MOST_NAME),
            "type": clean(value.data_type, MOST_NAME),
            "value": _shown(value.value),
            "unit": clean(value.unit, MOST_NAME),
            "constants": [clean(each, MOST_NAME) for each in value.constants[:MOST_CONSTANTS]],
            "late": self.picture.late_by(value.place, value.time, self._clock()),
        }

    async def _read(self, place: FleetPlace, text: str) -> FleetValue:
        with self._under_way:
            value = await self.fleet.read(place, text)
        if len(value.data) > self.limits.value_bytes:
            most = self.limits.value_bytes
            raise BridgeRefusedError(f"{place}: its bridge tells {len(value.data)} bytes, and a page takes {most}")
        return value

    async def may_write(self, net: str, node_id: int, text: str) -> tuple[int, int]:
        """See WebSubject. A name is looked up in what the bridge tells of the node; what is written then is the number that the
        guard has seen."""
        place = number_of_object(text)
        if place is None:
            self.guard.require(Permission.WRITE, "writing")  # nobody is asked for a name in vain
            rows = await self.objects(net, node_id)
            named = [row for row in rows if row["name"] == text]
            named = named or [row for row in rows if fold_name(row["name"]) == fold_name(text)]  # as a dictionary compares
            place = number_of_object(named[0]["path"]) if len(named) == 1 else None
        if place is None:
            raise NoSuchPlaceError(f"{net}/{node_id} has no object {text[:60]!r}", seen="its bridge tells of none, or of several")
        self.guard.require_write(*place)
        return place

    async def write(self, net: str, node_id: int, place: tuple[int, int], given: bytes | Value | None) -> str:
        """See WebSubject."""
        if not isinstance(given, bytes | int | float | str):
            raise ValueError(f"{place_text(*place)}: the value has to be a number or a text")
        self.guard.require_write(*place)
        self._require_one_bridge(net)
        with self._under_way:
            await self.fleet.write(self.picture.place(net, node_id), place_text(*place), given)
        return given.hex(" ") if isinstance(given, bytes) else str(given)

    async def nmt(self, net: str, command: NmtCommand, node_id: int) -> None:
        """See WebSubject."""
        self.guard.require(Permission.NMT, f"NMT {command.name.lower().replace('_', ' ')}")
        if not node_id:
            raise NotOverFleetError("an NMT command to all nodes of a bus")
        self._require_one_bridge(net)
        with self._under_way:
            await self.fleet.nmt(self.picture.place(net, node_id), command)

    async def halt(self, net: str | None, node_id: int = 0) -> list[str]:
        """See WebSubject. A bus that does not answer, or is lost, is named: nobody knows whether it stands. So is one that has
        several bridges."""
        place = ALL if net is None else self.picture.place(net, node_id)
        there, lost = [each for each in self.fleet.buses if net in (None, str(each))], self.picture.lost()
        answers = await self.fleet.halt(place)
        answered = {each.bus_place for each in answers}
        problems = [f"{where}: {clean(each)}" for where, told in sorted(answers.items()) for each in told]
        problems += [f"{each} did not answer" for each in there if each not in answered]
        problems += [f"{each} is lost: nobody knows whether it stands" for each in lost if net in (None, each)]
        twins = [each for each in self.picture.twins(self.now()) if net in (None, each)]
        return problems + [f"{each}: several bridges have this name; did all of them answer?" for each in twins]

    def _require_one_bridge(self, net: str) -> None:
        """Raise BridgeRefusedError if a change would go to several machines."""
        if net in self.picture.twins(self.now()):
            raise BridgeRefusedError(f"{net}: several bridges have this name, and nothing was sent")

    # ---- clients of the live channel ----

    def place_of(self, net: str, node_id: int, text: str) -> WatchedObject:
        """See WebSubject."""
        place = number_of_object(text)
        if place is None:
            raise ValueError(f"{text[:60]!r}: over a fleet an object to watch is a number, as 6041:00")
        return WatchedObject(net, node_id, *place)

    @contextmanager
    def open_client(self, name: str) -> Iterator[WebClient]:
        """See WebSubject."""
        if self._clients >= self.limits.sessions:
            raise GatewayFullError("clients", self.limits.sessions)
        self._clients += 1
        try:
            yield _FleetClient(self, name)
        finally:
            self._clients -= 1

    @asynccontextmanager
    async def watching(self, objects: Sequence[WatchedObject], period: float) -> AsyncIterator[TakeRows]:
        """Have the values of objects while the block runs; see WebClient."""
        if len(objects) > self.limits.subscriptions // 2:
            raise ValueError(f"a page watches {self.limits.subscriptions // 2} objects at most")
        numbers: dict[tuple[FleetPlace, str], list[int]] = {}
        for number, each in enumerate(objects):
            key = self.picture.place(each.net, each.node_id), place_text(each.index, each.subindex)
            numbers.setdefault(key, []).append(number)
        came = [float("-inf")] * len(objects)
        polled: deque[list[Any]] = deque(maxlen=4 * len(objects))
        with self.fleet.news(FleetPdo, at=[place for place, _ in numbers]) as news:

            def take() -> list[list[Any]]:
                rows = list(polled)
                polled.clear()
                now = self.now()
                for pdo in news.take():
                    late = self.picture.late_by(pdo.place, pdo.time, self._clock())
                    for told in pdo.fields:
                        for number in numbers.get((pdo.place, told.object), ()):
                            came[number] = now
                            rows.append([number, round(now - late, 4), _shown(told.value), "", late])
                return rows

            async with trio.open_nursery() as nursery:
                for bus in {place.bus_place for place, _ in numbers}:  # one that is hung holds up no other
                    nursery.start_soon(self._poll, bus, numbers, max(period, LEAST_PERIOD), came, polled)
                yield take
                nursery.cancel_scope.cancel()

    async def _poll(
        self,
        bus: FleetPlace,
        numbers: Mapping[tuple[FleetPlace, str], Sequence[int]],
        period: float,
        came: Sequence[float],
        polled: deque[list[Any]],
    ) -> None:
        """Read the values of a bus that no PDO has brought of late."""
        while True:
            for (place, key), wanted in numbers.items():
                if place.bus_place != bus or self.now() - came[wanted[0]] <= 2 * period:
                    continue
                shown, problem, late = None, "", 0.0
                try:
                    value = await self._read(place, key)
                    shown, late = _shown(value.value), self.picture.late_by(place, value.time, self._clock())
                except (FleetError, BridgeRefusedError, GatewayFullError) as error:
                    problem = clean(error.failed)
                polled.extend([number, round(self.now() - late, 4), shown, problem, late] for number in wanted)
            await trio.sleep(period)


class _FleetClient(WebClient):
    def __init__(self, subject: FleetSubject, name: str) -> None:
        self.name = name
        self._subject = subject

    def machine_session(self, what: str) -> GatewaySession:
        raise NotOverFleetError(what)

    def watch(self, objects: Sequence[WatchedObject], period: float) -> Any:
        return self._subject.watching(objects, period)


def _shown(value: Value | None) -> int | float | str | None:
    plain = plain_value(value)
    return clean(plain, MAX_BYTES_SHOWN) if isinstance(plain, str) and isinstance(value, str) else plain


def _object_row(told: Any) -> Plain | None:
    """Return an object as a bridge tells it; None for nonsense."""
    if not isinstance(told, dict) or not isinstance(told.get("path"), str) or not _PATH.match(told["path"]):
        return None
    row: Plain = {name: _text(told.get(name)) for name in ("path", "name", "type", "access", "unit")}
    constants = told.get("constants")
    return row | {"constants": list(map(_text, constants[:MOST_CONSTANTS])) if isinstance(constants, list) else []}


def _text(told: Any) -> str:
    """Return a text that a bridge tells; "" for something else."""
    return clean(told, MOST_NAME) if isinstance(told, str) else ""
