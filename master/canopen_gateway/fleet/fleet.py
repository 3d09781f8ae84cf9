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
import secrets
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from canopen_gateway.errors import BridgeRefusedError, FleetError
from canopen_gateway.fleet import keys
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import FleetPlace, key_of, parse_key, parse_place
from canopen_gateway.fleet.news import FleetEmcy, FleetNews, FleetPdo, FleetState, PlaceAppeared, PlaceGone
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
RENEWAL: Final = 0.1
"""Seconds from one sign of life of a lease to the next; it is over after three of them."""
_NMT_WORDS: Final = {command: word for word, command in NMT_COMMANDS.items()}
_STAMP: Final = 8
_EMCY_LENGTH: Final = 8


class FleetValue(NamedTuple):
    """An object that was read through a fleet. key: as it was asked for, "6041:00" or a name. value: as the bridge's dictionary
    has it, else bytes; None if there is none. name, unit: of the dictionary, or "". data: the bytes. problem: why there is no
    value; "" if there is."""

    place: FleetPlace
    key: str
    value: Value | None
    name: str = ""
    unit: str = ""
    data: bytes = b""
    problem: str = ""


class FleetAnswer(NamedTuple):
    """One answer to a query. attachment: what stood beside it."""

    place: FleetPlace
    data: bytes
    attachment: dict[str, Any]


class Fleet:
    """See this module's text; made by `open_fleet`."""

    def __init__(self, session: zenoh.Session, loop: Loop, patience: float) -> None:
        self._patience = patience
        self._zenoh = session
        self._loop = loop
        self._token: LoopToken = loop.token()
        self._alive: set[FleetPlace] = set()
        self._subscriptions: list[tuple[Subscription[Any], tuple[type[FleetNews], ...]]] = []
        self._pdos: dict[tuple[FleetPlace, str], Sequence[tuple[str, DataType, int]]] = {}
        self._asking: set[FleetPlace] = set()
        self._listening: zenoh.Subscriber[None] | None = None
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

    def news(self, *kinds: type[N]) -> Subscription[N]:
        """Return an async iterator over news of these kinds from now on; FleetNews: all. With FleetPdo, or FleetNews, the PDOs of
        all buses come over the network from here on."""
        subscription: Subscription[N] = Subscription(self._unsubscribe)
        self._subscriptions.append((subscription, kinds))
        if self._listening is None and any(issubclass(FleetPdo, kind) for kind in kinds):
            self._listening = self._zenoh.declare_subscriber(f"{keys.ROOT}/*/*/*/{keys.PDO}/*", self._hand_over(self._on_sample))
        return subscription

    # ---- objects ----

    async def read(self, place: FleetPlace | str, key: str | int) -> FleetValue:
        """Read an object of a node. key: a name of the bridge's dictionary, "6041:00", or 0x6041 (0x604101 with a subindex).
        Raises FleetError, BridgeRefusedError, ValueError."""
        where, text = _place(place, node=True), _text(key)
        if where.node_id < 0 or keys.ANY in where:
            raise ValueError(f"{where} is many nodes: read_all reads them")
        (answer,) = await self.ask(where, keys.GET, text) or (None,)
        if answer is None:
            raise self._away(where)
        return _value_of(where, text, answer)

    async def read_all(self, pattern: FleetPlace | str, key: str | int) -> list[FleetValue]:
        """Read an object of all nodes that a pattern names, side by side; one that fails has a `problem`. Raises ValueError."""
        text = _text(key)
        found: dict[FleetPlace, FleetValue] = {}

        async def read(place: FleetPlace) -> None:
            try:
                found[place] = await self.read(place, text)
            except (FleetError, BridgeRefusedError) as error:
                found[place] = FleetValue(place, text, None, problem=error.failed)

        async with self._loop.open_nursery() as nursery:
            for place in self.matching(pattern):
                nursery.start_soon(read, place)
        return [found[place] for place in sorted(found)]

    async def write(self, place: FleetPlace | str, key: str | int, value: Value) -> None:
        """Write an object of a node. value: its bytes, or what the bridge's dictionary takes. Raises FleetError (it may have been
        written), BridgeRefusedError, ValueError."""
        where = self._one_node(place)
        raw = isinstance(value, bytes | bytearray)
        payload = bytes(value) if isinstance(value, bytes | bytearray) else json.dumps(value).encode()
        encoding = "application/octet-stream" if raw else "application/json"
        if not await self.ask(where, keys.SET, _text(key), payload=payload, encoding=encoding):
            raise self._away(where, "it may have been written")

    async def nmt(self, place: FleetPlace | str, command: NmtCommand) -> None:
        """Send an NMT command to a node. Raises as `write`."""
        where = self._one_node(place)
        if not await self.ask(where, keys.COMMAND, payload=_NMT_WORDS[command].encode()):
            raise self._away(where, "it may have been sent")

    async def emergencies(self, place: FleetPlace | str) -> list[FleetEmcy]:
        """Return the last emergencies of a node, oldest first, as its bridge remembers them. Raises as `read`."""
        where = self._one_node(place)
        answers = await self.ask(where, keys.EMCY)
        return [_emcy(where, answer.data) for answer in answers if len(answer.data) == _STAMP + _EMCY_LENGTH]

    async def status(self, place: FleetPlace | str) -> dict[str, Any]:
        """Return what a bridge says of its bus. Raises as `read`."""
        where = _place(place).bus_place
        answers = await self.ask(where, keys.STATUS)
        if not answers:
            raise self._away(where)
        return _object(answers[0].data)

    async def halt(self, pattern: FleetPlace | str = "*/*") -> dict[FleetPlace, list[str]]:
        """Stop what moves at the places that a pattern names. Returns for each that answered what did not confirm that it stands.
        Anybody may, always. Raises FleetError if nobody answered, ValueError."""
        where = _place(pattern)
        answers = await self.ask(where, keys.HALT)
        if not answers:
            raise FleetError(f"nobody at {where} answered the halt", seen=self._seen(), tries=("the emergency stop",))
        return {answer.place: [str(each) for each in json.loads(answer.data)] for answer in answers}

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
        for subscription, _ in self._subscriptions:
            subscription.end(reason)

    async def ask(self, place: FleetPlace, *rest: str, payload: bytes = b"", encoding: str = "") -> list[FleetAnswer]:
        """Send a query, and return its answers; none if nobody is there. Raises BridgeRefusedError if there is no other one."""
        import zenoh

        replies: list[zenoh.Reply] = []
        over = self._loop.event()

        def ended() -> None:
            with contextlib.suppress(self._loop.RunFinishedError):
                self._token.run_sync_soon(over.set)

        handler: Any = zenoh.handlers.Callback(replies.append, ended)
        self._zenoh.get(
            key_of(place, *rest),
            handler,
            payload=payload or None,
            encoding=encoding or None,
            timeout=self._patience,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        await over.wait()
        answers, refused = [], None
        for reply in replies:
            if reply.ok is not None:
                found = parse_key(str(reply.ok.key_expr))
                beside = b"" if reply.ok.attachment is None else bytes(reply.ok.attachment)
                answers.append(FleetAnswer(place if found is None else found[0], bytes(reply.ok.payload), _object(beside)))
            elif reply.err is not None:
                refused = _refused(place, bytes(reply.err.payload))
        if refused is not None and not answers:
            raise refused
        return answers

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
        if found is None or found[0].node_id <= 0:
            return
        place, rest, data = found[0], list(found[1]), bytes(sample.payload)
        match rest:
            case [keys.NMT]:
                name = data.decode("ascii", "replace")
                self._tell(FleetState(place, NmtState[name] if name in NmtState.__members__ else None))
            case [keys.EMCY] if len(data) == _STAMP + _EMCY_LENGTH:
                self._tell(_emcy(place, data))
            case [keys.PDO, number] if number.isdigit() and len(data) >= _STAMP:
                stamp, carried = int.from_bytes(data[:_STAMP], "little"), data[_STAMP:]
                self._tell(FleetPdo(place, int(number), carried, self._values(place, number, carried), stamp))

    def _values(self, place: FleetPlace, number: str, data: bytes) -> dict[str, Value]:
        """Return the values of a PDO by name; none while it is not known, or no longer true, what it carries."""
        entries = self._pdos.get((place, number))
        if entries is None or sum(bits for _, _, bits in entries) != 8 * len(data):
            self._ask_for_pdos(place)
            return {}
        values, bits, at = {}, int.from_bytes(data, "little"), 0
        for name, data_type, length in entries:
            field = (bits >> at) & ((1 << length) - 1)
            at += length
            values[name] = decode(field.to_bytes((length + 7) // 8, "little"), data_type)
        return values

    def _ask_for_pdos(self, place: FleetPlace) -> None:
        if place not in self._asking:
            self._asking.add(place)
            self._loop.spawn_system_task(self._learn_pdos, place, name=f"what the PDOs of {place} carry")

    async def _learn_pdos(self, place: FleetPlace) -> None:
        with contextlib.suppress(FleetError, BridgeRefusedError):
            for answer in await self.ask(place, keys.PDOS):
                for number, entries in _object(answer.data).items():
                    self._pdos[place, number] = [
                        (str(each["name"]), DataType[each["type"]], int(each["bits"])) for each in entries
                    ]
        self._asking.discard(place)

    def _tell(self, event: FleetNews) -> None:
        for subscription, kinds in self._subscriptions:
            if isinstance(event, kinds):
                subscription.put(event)

    def _unsubscribe(self, subscription: Subscription[Any]) -> None:
        self._subscriptions = [each for each in self._subscriptions if each[0] is not subscription]
        if self._listening is not None and not any(
            issubclass(FleetPdo, kind) for _, kinds in self._subscriptions for kind in kinds
        ):
            self._listening.undeclare()  # type: ignore[no-untyped-call]
            self._listening = None

    def _one_node(self, place: FleetPlace | str) -> FleetPlace:
        where = _place(place, node=True)
        if where.node_id < 0 or keys.ANY in where:
            raise ValueError(f"{where} is many nodes; this is for one")
        return where

    def _away(self, place: FleetPlace, what: str = "") -> FleetError:
        return FleetError(
            f"nobody answers for {place}" + (f"; {what}" if what else ""),
            seen=self._seen(),
            cause="its bridge is away, hung, or was told not to answer this program",
            tries=("canopen fleet ls", "canopen serve zenoh on the computer that has the bus"),
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
        said = {"client": self._number, "sequence": self._sequence, "do": do, **what}
        answers = await self._fleet.ask(self.place, keys.LEASE, payload=json.dumps(said).encode(), encoding="application/json")
        if not answers:
            raise self._fleet._away(self.place)
        told = _object(answers[0].data)
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
    name, unit = str(beside.get("name", "")), str(beside.get("unit", ""))
    kind = beside.get("type")
    value: Value = answer.data
    if isinstance(kind, str) and kind in DataType.__members__:
        with contextlib.suppress(LocalProtocolError, ValueError):  # another length than its type has: the bytes
            value = decode(answer.data, DataType[kind])
    return FleetValue(place, key, value, name, unit, answer.data)


def _emcy(place: FleetPlace, data: bytes) -> FleetEmcy:
    stamp, told = int.from_bytes(data[:_STAMP], "little"), data[_STAMP:]
    return FleetEmcy(place, int.from_bytes(told[:2], "little"), told[2], told[3:8], stamp)


def _object(data: bytes) -> dict[str, Any]:
    try:
        said = json.loads(data) if data else {}
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def _refused(place: FleetPlace, data: bytes) -> BridgeRefusedError:
    said = _object(data)
    abort = said.get("abort")
    message = str(said.get("message") or "it gave no reason")[:500]
    where = str(said.get("place") or place)[:100]
    return BridgeRefusedError(
        message if where in message else f"{where}: {message}",
        bridge_code=str(said.get("code", ""))[:20],
        seen=str(said.get("seen", ""))[:500],
        abort_code=abort if isinstance(abort, int) else None,
        not_confirmed=said.get("not_confirmed") is True,
    )
