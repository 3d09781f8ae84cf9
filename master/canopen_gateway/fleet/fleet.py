"""`Fleet`: the machines of many computers as one, from anywhere. Made by `open_fleet`; on trio, or on asyncio.

    async with open_fleet(connect=["tcp/192.168.1.20:7447"]) as fleet:
        await fleet.settled()
        print(fleet.nodes)                                               # ("hall-2/arm/5", ...), as far as it was heard
        print((await fleet.read("hall-2/arm/5", "statusword")).value)
        for each in await fleet.read_all("*/*/*", 0x1008):              # side by side
            print(each.place, each.value, each.problem)
        with fleet.news(FleetEmcy, PlaceGone) as news:
            async for event in news:
                print(event)

A bridge that is away gives no answer at all: FleetError. What a node or a bridge refuses is BridgeRefusedError. A viewer that is
slow loses the oldest news, which `Subscription.dropped` counts; no bridge waits for it.
"""

from __future__ import annotations

import contextlib
import json
import re
import secrets
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from canopen_gateway.errors import BridgeRefusedError, FleetError
from canopen_gateway.fleet import keys
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import FleetPlace, key_of, parse_count, parse_key, parse_place
from canopen_gateway.fleet.news import (
    FleetEmcy,
    FleetField,
    FleetNews,
    FleetPdo,
    FleetState,
    FleetStatus,
    PlaceAppeared,
    PlaceGone,
)
from canopen_gateway.nmt_words import NMT_COMMANDS
from canopen_master.participant.subscription import Subscription
from canopen_proto import LocalProtocolError, NmtCommand
from canopen_proto.datatypes import DataType, Value, decode
from canopen_proto.multiplexer import place_of
from canopen_proto.nmt import NmtState
from canopen_transports.loop import Loop, LoopToken, current_loop

if TYPE_CHECKING:
    import zenoh

N = TypeVar("N", bound=FleetNews)
PATIENCE: Final = 10.0
"""Seconds that an answer may take; that of a silent node comes from its bridge, after the bridge's own time-out."""
READS_AT_A_TIME: Final = 8
"""Reads of one site that `read_all` has under way: four viewers fit into what a bridge serves."""
COPIES: Final = 8
"""How much later, in things told under one key, a copy may come."""
MOST_KEYS: Final = 200_000
"""Keys of which the last things told are remembered."""
MOST_TEXT: Final = 500
"""Characters of a text that a bridge tells."""
MOST_STATUS: Final = 1 << 16
"""Bytes of a status: those of a bus with 127 named nodes have a tenth."""
RENEWAL: Final = 0.1
"""Seconds from one sign of life of a lease to the next; it is over after three of them."""
EVERYWHERE: Final = FleetPlace(keys.ANY, keys.ANY, -1)
ON_REQUEST: Final[Mapping[type[FleetNews], Sequence[str]]] = {FleetPdo: (keys.PDO, keys.ANY), FleetStatus: (keys.STATUS,)}
"""News that come over the network only while somebody takes them, and under which key."""
_NMT_WORDS: Final = {command: word for word, command in NMT_COMMANDS.items()}
_PDO_NUMBER: Final = re.compile(r"[1-9][0-9]{0,2}\Z")
_STAMP: Final = 8
_EMCY_LENGTH: Final = 8


class FleetValue(NamedTuple):
    """An object that was read through a fleet. key: as it was asked for, "6041:00" or a name. value: as the bridge's dictionary
    has it, else bytes; None if there is none. name, unit: of the dictionary, or "". data: the bytes. problem: why there is no
    value; "" if there is. object: "6041:00", and data_type: as the bridge knows them, or "". time: of the bridge's clock, ns
    since 1970; None if it has not told. constants: names that the bridge's dictionary has for this value."""

    place: FleetPlace
    key: str
    value: Value | None
    name: str = ""
    unit: str = ""
    data: bytes = b""
    problem: str = ""
    object: str = ""
    data_type: str = ""
    time: int | None = None
    constants: Sequence[str] = ()


class FleetAnswer(NamedTuple):
    """One answer to a query. attachment: what stood beside it."""

    place: FleetPlace
    data: bytes
    attachment: dict[str, Any]


class _Entry(NamedTuple):
    """What a PDO carries at one place, as its bridge tells. bits: its length."""

    object: str
    name: str
    data_type: DataType
    unit: str
    bits: int


class _Wish(NamedTuple):
    """Which news a subscription takes. at: patterns of places."""

    subscription: Subscription[Any]
    kinds: tuple[type[FleetNews], ...]
    at: Collection[FleetPlace]

    def takes(self, event: FleetNews) -> bool:
        return isinstance(event, self.kinds) and any(_is_at(event.place, pattern) for pattern in self.at)

    def requests(self) -> Iterator[str]:
        """The keys of what comes only on request."""
        for news, rest in ON_REQUEST.items():
            if any(issubclass(news, kind) for kind in self.kinds):
                for pattern in self.at:
                    yield key_of(pattern.bus_place if news is FleetStatus else pattern, *rest)


class _Copies:
    """Knows what has come before, by another router. What is told twice on purpose has another time, or another count."""

    def __init__(self) -> None:
        self._seen: dict[str, deque[tuple[bytes, bytes]]] = {}

    def has(self, key: str, beside: bytes, data: bytes) -> bool:
        """Return whether this is a copy of one of the last things told under a key; remember it."""
        last = self._seen.get(key)
        if last is None:
            last = self._seen[key] = deque(maxlen=COPIES)
            if len(self._seen) > MOST_KEYS:
                del self._seen[next(iter(self._seen))]
        told = beside, data
        if told in last:
            return True
        last.append(told)
        return False


class Fleet:
    """See this module's text; made by `open_fleet`."""

    def __init__(self, session: zenoh.Session, loop: Loop, patience: float) -> None:
        self._patience = patience
        self._zenoh = session
        self._loop = loop
        self._token: LoopToken = loop.token()
        self._alive: set[FleetPlace] = set()
        self._subscriptions: list[_Wish] = []
        self._pdos: dict[tuple[FleetPlace, str], Sequence[_Entry]] = {}
        self._asking: set[FleetPlace] = set()
        self._copies = _Copies()
        self._listening: dict[str, zenoh.Subscriber[None]] = {}
        self._came = loop.parking_lot()
        self._last = 0.0

    # ---- who is there ----

    @property
    def buses(self) -> Sequence[FleetPlace]:
        """The buses whose bridges are there."""
        return sorted(place for place in self._alive if not place.node_id)

    @property
    def nodes(self) -> Sequence[FleetPlace]:
        """The nodes that their bridges have heard of lately."""
        return sorted(place for place in self._alive if place.node_id)

    async def settled(self, quiet: float = 0.3, longest: float = 5.0) -> None:
        """Wait until nothing new has appeared for `quiet` seconds; `longest` seconds at most, also where nobody is there."""
        with self._loop.move_on_after(longest):
            while not self._alive or self._loop.current_time() < self._last + quiet:
                with self._loop.move_on_after(quiet):
                    await self._came.park()

    def matching(self, pattern: FleetPlace | str) -> Sequence[FleetPlace]:
        """Return the nodes that are there and that a pattern names, as "hall-2/*/*". Raises ValueError."""
        wanted = _place(pattern, node=True)
        return [place for place in self.nodes if place.matches(wanted)]

    def news(self, *kinds: type[N], at: Collection[FleetPlace | str] = (EVERYWHERE,)) -> Subscription[N]:
        """Return an async iterator over news of these kinds from now on; FleetNews: all. at: of these nodes, and their buses;
        each may be a pattern. With FleetPdo, FleetStatus or FleetNews, the PDOs of these nodes, or the status of their buses,
        come over the network from here on. Raises ValueError."""
        subscription: Subscription[N] = Subscription(self._unsubscribe)
        self._subscriptions.append(_Wish(subscription, kinds, tuple(_place(each, node=True) for each in at)))
        self._listen()
        return subscription

    # ---- objects ----

    async def read(self, place: FleetPlace | str, key: str | int) -> FleetValue:
        """Read an object of a node. key: a name of the bridge's dictionary, "6041:00", or 0x6041 (0x604101 with a subindex).
        Raises FleetError, BridgeRefusedError, ValueError."""
        where, text = _place(place, node=True), _text(key)
        if where.node_id < 0 or keys.ANY in where:
            raise ValueError(f"{where} is many nodes: read_all reads them")
        return _value_of(where, text, await self._ask_one(where, keys.GET, text))

    async def read_all(self, pattern: FleetPlace | str, key: str | int) -> list[FleetValue]:
        """Read an object of all nodes that a pattern names, side by side: READS_AT_A_TIME of each site; a bridge serves only
        so many. One that fails has a `problem`. Raises ValueError."""
        text = _text(key)
        found: dict[FleetPlace, FleetValue] = {}
        waiting: dict[str, list[FleetPlace]] = {}
        for place in reversed(self.matching(pattern)):
            waiting.setdefault(place.site, []).append(place)

        async def read(places: list[FleetPlace]) -> None:
            while places:
                place = places.pop()
                try:
                    found[place] = await self.read(place, text)
                except (FleetError, BridgeRefusedError) as error:
                    found[place] = FleetValue(place, text, None, problem=error.failed)

        async with self._loop.open_nursery() as nursery:
            for places in waiting.values():
                for _ in range(min(READS_AT_A_TIME, len(places))):
                    nursery.start_soon(read, places)
        return [found[place] for place in sorted(found)]

    async def objects(self, place: FleetPlace | str) -> Sequence[Any]:
        """Return the objects that a node has by its bridge's dictionary: "path" ("6041:00"), "name", "type", "access", "unit",
        "constants" of each, whatever the bridge tells. Raises as `read`; BridgeRefusedError of a bridge that cannot tell it."""
        told = _object((await self._ask_one(self._one_node(place), keys.OBJECTS)).data).get("objects")
        return told if isinstance(told, list) else ()

    async def write(self, place: FleetPlace | str, key: str | int, value: Value) -> None:
        """Write an object of a node. value: its bytes, or what the bridge's dictionary takes. Raises FleetError (it may have been
        written), BridgeRefusedError, ValueError."""
        where = self._one_node(place)
        raw = isinstance(value, bytes | bytearray)
        payload = bytes(value) if isinstance(value, bytes | bytearray) else json.dumps(value).encode()
        encoding = "application/octet-stream" if raw else "application/json"
        await self._ask_one(where, keys.SET, _text(key), payload=payload, encoding=encoding, unknown="it may have been written")

    async def nmt(self, place: FleetPlace | str, command: NmtCommand) -> None:
        """Send an NMT command to a node. Raises as `write`."""
        payload = _NMT_WORDS[command].encode()
        await self._ask_one(self._one_node(place), keys.COMMAND, payload=payload, unknown="it may have been sent")

    async def emergencies(self, place: FleetPlace | str) -> list[FleetEmcy]:
        """Return the last emergencies of a node, oldest first, as its bridge remembers them. Raises as `read`."""
        where = self._one_node(place)
        answers = await self.ask(where, keys.EMCY)
        return [_emcy(where, answer.data) for answer in answers if len(answer.data) == _STAMP + _EMCY_LENGTH]

    async def status(self, place: FleetPlace | str) -> dict[str, Any]:
        """Return what a bridge says of its bus. Raises as `read`."""
        return _object((await self._ask_one(_place(place).bus_place, keys.STATUS)).data)

    async def halt(self, pattern: FleetPlace | str = "*/*") -> dict[FleetPlace, list[str]]:
        """Stop what moves at the places that a pattern names. Returns for each that answered what did not confirm that it stands.
        Anybody may, always. Raises FleetError if nobody answered, ValueError."""
        where = _place(pattern)
        answers = await self.ask(where, keys.HALT)
        if not answers:
            raise FleetError(f"nobody at {where} answered the halt", seen=self._seen(), tries=("the emergency stop",))
        found: dict[FleetPlace, list[str]] = {}
        for answer in answers:  # two for one place: what any of them says counts
            found.setdefault(answer.place, []).extend(_problems(answer.data))
        return found

    @asynccontextmanager
    async def lead(self, place: FleetPlace | str) -> AsyncIterator[FleetLease]:
        """Move the machine of a bus while the block runs, as nobody else can then; see FleetLease. Raises BridgeRefusedError,
        FleetError."""
        lease = FleetLease(self, _place(place).bus_place)
        await lease.say("take")
        async with self._loop.open_nursery() as nursery:
            nursery.start_soon(lease.keep)
            try:
                yield lease
            finally:
                nursery.cancel_scope.cancel()
                with self._loop.move_on_after(1.0, shield=True), contextlib.suppress(FleetError, BridgeRefusedError):
                    await lease.say("leave")

    # ---- the network ----

    def begin(self) -> None:
        """Listen to who is there (`open_fleet` does)."""
        everywhere = f"{keys.ROOT}/**"
        self._zenoh.liveliness().declare_subscriber(everywhere, self._hand_over(self._on_liveliness), history=True)
        for what in (keys.EMCY, keys.NMT):
            self._zenoh.declare_subscriber(f"{keys.ROOT}/*/*/*/{what}", self._hand_over(self._on_sample))

    def end(self, reason: BaseException) -> None:
        """End all subscriptions (`open_fleet` does)."""
        for wish in self._subscriptions:
            wish.subscription.end(reason)

    async def ask(self, place: FleetPlace, *rest: str, payload: bytes = b"", encoding: str = "") -> list[FleetAnswer]:
        """Send a query, and return its answers; none if nobody is there. Raises BridgeRefusedError if there is no other one;
        FleetError if several bridges have answered for one place, but to a halt."""
        import zenoh

        replies: list[zenoh.Reply] = []
        over = self._loop.event()

        def ended() -> None:
            with contextlib.suppress(self._loop.RunFinishedError):
                self._token.run_sync_soon(over.set)

        handler: Any = zenoh.handlers.Callback(replies.append, ended)
        try:
            self._zenoh.get(
                key_of(place, *rest),
                handler,
                payload=payload or None,
                attachment=secrets.token_bytes(keys.MARK_BYTES),
                encoding=encoding or None,
                timeout=self._patience,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        except zenoh.ZError as error:
            raise FleetError(f"{place} cannot be asked", seen=str(error)) from error  # that the session is closed
        await over.wait()
        answers, refused = [], None
        for reply in replies:
            if reply.ok is not None:
                found = parse_key(str(reply.ok.key_expr))
                beside = b"" if reply.ok.attachment is None else bytes(reply.ok.attachment)
                answers.append(FleetAnswer(place if found is None else found[0], bytes(reply.ok.payload), _object(beside)))
            elif reply.err is not None:
                refused = _refused(place, bytes(reply.err.payload))
        bridges = {str(reply.replier_id) for reply in replies}
        if len(bridges) > 1 and keys.ANY not in place.bus_place and keys.HALT not in rest:
            raise self._twins(place.bus_place, payload != b"")
        if refused is not None and not answers:
            raise refused
        return answers

    async def _ask_one(
        self, place: FleetPlace, *rest: str, payload: bytes = b"", encoding: str = "", unknown: str = ""
    ) -> FleetAnswer:
        """Send a query, and return its first answer. unknown: what may have become of it, if there is none. Raises as `ask`;
        FleetError if nobody is there."""
        answers = await self.ask(place, *rest, payload=payload, encoding=encoding)
        if not answers:
            raise FleetError(
                f"nobody answers for {place}" + (f"; {unknown}" if unknown else ""),
                seen=self._seen(),
                cause="its bridge is away, hung, or was told not to answer this program",
                tries=("canopen fleet ls", "canopen serve zenoh on the computer that has the bus"),
            )
        return answers[0]

    def _hand_over(self, take: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
        """Return a callback for Zenoh's threads, which lets the loop take each sample."""

        def call(sample: zenoh.Sample) -> None:
            with contextlib.suppress(self._loop.RunFinishedError):
                self._token.run_sync_soon(take, sample)

        return call

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        import zenoh

        found = parse_key(str(sample.key_expr))
        if found is None or list(found[1]) != [keys.ALIVE]:
            return
        place = found[0]
        is_there = sample.kind == zenoh.SampleKind.PUT
        if is_there is (place in self._alive):
            return
        self._last = self._loop.current_time()
        if is_there:
            self._alive.add(place)
        else:
            self._alive.discard(place)
            self._pdos = {key: pdo for key, pdo in self._pdos.items() if key[0] != place}
        self._came.unpark_all()
        self._tell(PlaceAppeared(place) if is_there else PlaceGone(place))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        found = parse_key(str(sample.key_expr))
        if found is None or found[0].node_id < 0 or keys.ANY in found[0]:
            return
        place, rest, data = found[0], list(found[1]), bytes(sample.payload)
        if not place.node_id:
            if rest == [keys.STATUS] and len(data) <= MOST_STATUS:
                self._tell(FleetStatus(place, _object(data)))
            return
        beside = b"" if sample.attachment is None else bytes(sample.attachment)
        has_time = bool(beside) or rest != [keys.NMT]
        if has_time and self._copies.has(str(sample.key_expr), beside, data):
            return
        match rest:
            case [keys.NMT]:
                name = data.decode("ascii", "replace")
                stamp = int.from_bytes(beside, "little") if len(beside) == _STAMP else None
                self._tell(FleetState(place, NmtState[name] if name in NmtState.__members__ else None, stamp))
            case [keys.EMCY] if len(data) == _STAMP + _EMCY_LENGTH:
                self._tell(_emcy(place, data))
            case [keys.PDO, number] if _PDO_NUMBER.match(number) and len(data) >= _STAMP:
                stamp, carried = int.from_bytes(data[:_STAMP], "little"), data[_STAMP:]
                fields = self._fields(place, number, carried)
                self._tell(FleetPdo(place, int(number), carried, fields, stamp, parse_count(beside)))

    def _fields(self, place: FleetPlace, number: str, data: bytes) -> Sequence[FleetField]:
        """Return what a PDO carries; nothing while that is not known, or no longer true."""
        entries = self._pdos.get((place, number))
        if entries is None or sum(each.bits for each in entries) != 8 * len(data):
            self._ask_for_pdos(place)
            return ()
        fields, bits, at = [], int.from_bytes(data, "little"), 0
        for entry in entries:
            carried = ((bits >> at) & ((1 << entry.bits) - 1)).to_bytes((entry.bits + 7) // 8, "little")
            at += entry.bits
            value: Value = carried
            with contextlib.suppress(LocalProtocolError, ValueError):  # no time of a day
                value = decode(carried, entry.data_type)
            fields.append(FleetField(entry.object, entry.name, entry.data_type, entry.unit, value, carried))
        return fields

    def _ask_for_pdos(self, place: FleetPlace) -> None:
        if place not in self._asking:
            self._asking.add(place)
            self._loop.spawn_system_task(self._learn_pdos, place, name=f"what the PDOs of {place} carry")

    async def _learn_pdos(self, place: FleetPlace) -> None:
        # A bridge may tell nonsense: then it is not known what its PDOs carry
        nonsense = KeyError, TypeError, ValueError, AttributeError, RecursionError
        with contextlib.suppress(FleetError, BridgeRefusedError, *nonsense):
            for answer in await self.ask(place, keys.PDOS):
                for number, entries in _object(answer.data).items():
                    self._pdos[place, number] = [
                        _Entry(
                            str(each["object"]),
                            str(each["name"]),
                            DataType[each["type"]],
                            str(each.get("unit", "")),
                            _bits(each["bits"]),
                        )
                        for each in entries
                    ]
        self._asking.discard(place)

    def _tell(self, event: FleetNews) -> None:
        for wish in self._subscriptions:
            if wish.takes(event):
                wish.subscription.put(event)

    def _unsubscribe(self, subscription: Subscription[Any]) -> None:
        self._subscriptions = [each for each in self._subscriptions if each.subscription is not subscription]
        self._listen()

    def _listen(self) -> None:
        """Let come over the network what somebody takes, and nothing else. Where two patterns meet, it comes twice, and the copy
        is left alone."""
        wanted = {key for wish in self._subscriptions for key in wish.requests()}
        for key in self._listening.keys() - wanted:
            self._listening.pop(key).undeclare()  # type: ignore[no-untyped-call]
        for key in wanted - self._listening.keys():
            self._listening[key] = self._zenoh.declare_subscriber(key, self._hand_over(self._on_sample))

    def _one_node(self, place: FleetPlace | str) -> FleetPlace:
        where = _place(place, node=True)
        if where.node_id < 0 or keys.ANY in where:
            raise ValueError(f"{where} is many nodes; this is for one")
        return where

    def _twins(self, place: FleetPlace, changes: bool) -> FleetError:
        return FleetError(
            f"several bridges have the name {place}" + ("; each of them may have done it" if changes else ""),
            seen="more than one has answered, and nobody can tell which machine is which",
            cause="two computers were given one --site, or two bridges serve one bus",
            tries=("a --site of its own for each computer",),
        )

    def _seen(self) -> str:
        return "bridges that are there: " + (", ".join(map(str, self.buses)) or "none")


class FleetLease:
    """Who moves the machine of a bus; made by `Fleet.lead`. It is renewed in the background. If it cannot be, the bridge halts
    what it moves 300 ms after the last sign of life; `problem` then says what was told. doing: what moves at present."""

    def __init__(self, fleet: Fleet, place: FleetPlace) -> None:
        self.place = place
        self.doing = ""
        self.problem = ""
        self._fleet = fleet
        self._number = secrets.token_hex(16)
        self._term = ""
        self._sequence = 0

    async def enable(self, chain: str) -> None:
        """Give the joints of a chain power, in the background. Raises BridgeRefusedError, FleetError, as all of these."""
        await self.say("enable", chain=chain)

    async def disable(self, chain: str) -> None:
        """Halt the joints of a chain and take their power away, in the background."""
        await self.say("disable", chain=chain)

    async def jog(self, chain: str, velocities: Sequence[float]) -> None:
        """Move the joints of a chain at these velocities, in their units per second, until 300 ms after the last call."""
        await self.say("jog", chain=chain, velocities=list(velocities))

    async def move(self, chain: str, targets: Sequence[float], *, speed: float = 1.0) -> None:
        """Move a chain to a target, in the background, for as long as this lease lasts. speed: the share of each limit."""
        await self.say("move", chain=chain, targets=list(targets), speed=speed)

    async def stop(self) -> None:
        """End the motion under way: the joints brake, and keep their power."""
        await self.say("stop")

    async def keep(self) -> None:
        """Renew it until it is cancelled (`Fleet.lead` does)."""
        while True:
            await self._fleet._loop.sleep(RENEWAL)
            try:
                await self.say("renew")
            except (FleetError, BridgeRefusedError) as error:
                self.problem = error.failed

    async def say(self, do: str, **what: object) -> None:
        """Say what is wanted, and take what the bridge tells. Raises BridgeRefusedError, FleetError."""
        self._sequence += 1
        said = {"client": self._number, "term": self._term, "sequence": self._sequence, "do": do, **what}
        payload = json.dumps(said).encode()
        answer = await self._fleet._ask_one(self.place, keys.LEASE, payload=payload, encoding="application/json")
        told = _object(answer.data)
        self._term = str(told.get("term", ""))
        self.doing, self.problem = str(told.get("doing", "")), str(told.get("problem", ""))


@asynccontextmanager
async def open_fleet(
    *, connect: Collection[str] = (), listen: Collection[str] = (), config: Path | None = None, patience: float = PATIENCE
) -> AsyncIterator[Fleet]:
    """Be a viewer of a fleet while the block runs. connect: endpoints of bridges or routers, as "tcp/192.168.1.20:7447".
    patience: seconds that an answer may take; it comes from the bridge, after the bridge's own time-out for a node. For the rest,
    and what is raised, see `open_zenoh`. A bridge that is away and comes back is there again by itself."""
    session = await open_zenoh(connect=tuple(connect), listen=tuple(listen), config=config)
    fleet = Fleet(session, current_loop(), patience)
    try:
        fleet.begin()
        yield fleet
    finally:
        fleet.end(FleetError("the fleet was left"))
        await close_zenoh(session)


def _place(place: FleetPlace | str, *, node: bool = False) -> FleetPlace:
    found = parse_place(place, node=node) if isinstance(place, str) else place
    if node and not found.node_id:
        raise ValueError(f"{found} is a bus; this is for a node")
    return found


def _is_at(place: FleetPlace, pattern: FleetPlace) -> bool:
    """Return whether a pattern of nodes names a node, or the bus of one."""
    return place.matches(pattern) if place.node_id else place.matches(pattern.bus_place)


def _text(key: str | int) -> str:
    text = _number_text(key) if isinstance(key, int) else key
    if not keys.OBJECT.match(text):
        raise ValueError(f"{text!r} is no object: it is a name, or 6041:00")
    return text


def _number_text(number: int) -> str:
    index, subindex = place_of(number)
    return f"{index:04X}:{subindex:02X}"


def _value_of(place: FleetPlace, key: str, answer: FleetAnswer) -> FleetValue:
    beside = answer.attachment
    name, unit = _told(beside, "name"), _told(beside, "unit")
    kind = beside.get("type")
    value: Value = answer.data
    if isinstance(kind, str) and kind in DataType.__members__:
        with contextlib.suppress(LocalProtocolError, ValueError):  # another length than its type has: the bytes
            value = decode(answer.data, DataType[kind])
    data_type, stamp, named = _told(beside, "type"), beside.get("time"), beside.get("constants")
    time = stamp if isinstance(stamp, int) else None
    constants = tuple(each for each in named if isinstance(each, str)) if isinstance(named, list) else ()
    told = _told(beside, "object")
    return FleetValue(place, key, value, name, unit, answer.data, "", told, data_type, time, constants)


def _emcy(place: FleetPlace, data: bytes) -> FleetEmcy:
    stamp, told = int.from_bytes(data[:_STAMP], "little"), data[_STAMP:]
    return FleetEmcy(place, int.from_bytes(told[:2], "little"), told[2], told[3:8], stamp)


def _bits(told: object) -> int:
    """Return the length of a value in a PDO. Raises ValueError for what is none."""
    if not isinstance(told, int) or not 0 < told <= 64:
        raise ValueError(f"{str(told)[:20]} is no number of bits in a PDO")
    return told


def _object(data: bytes) -> dict[str, Any]:
    try:
        said = json.loads(data) if data else {}
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def _problems(data: bytes) -> list[str]:
    """Return what a bridge says of a halt; nonsense confirms nothing."""
    try:
        said = json.loads(data)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, list):
        return ["its bridge does not say whether all stands"]
    return [each[:MOST_TEXT] if isinstance(each, str) else "a problem that its bridge does not name" for each in said]


def _told(said: Mapping[str, Any], name: str) -> str:
    """Return a text that a bridge tells, cut; "" for something else."""
    text = said.get(name)
    return text[:MOST_TEXT] if isinstance(text, str) else ""


def _refused(place: FleetPlace, data: bytes) -> BridgeRefusedError:
    said = _object(data)
    abort = said.get("abort")
    message = _told(said, "message") or "it gave no reason"
    where = _told(said, "place")[:100] or str(place)
    return BridgeRefusedError(
        message if where in message else f"{where}: {message}",
        bridge_code=_told(said, "code")[:20],
        seen=_told(said, "seen"),
        abort_code=abort if isinstance(abort, int) and 0 <= abort < 1 << 32 else None,
        not_confirmed=said.get("not_confirmed") is True,
    )
