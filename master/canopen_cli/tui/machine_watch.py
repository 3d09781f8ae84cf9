"""`MachineWatch`: what `canopen tui` knows of a machine, and does with it: a client of the gateway's service, on trio's
side.

The view looks at `shown`, which is made anew each REFRESH, and asks for something by one of the methods that begin with `ask_`.
Those may be called from outside of trio, and return at once. What became of it is in `shown`, or in `notices`.

What is read, written and commanded goes through the service like that of any other client: its guard, its limits and its lease
decide. The service's `NetTraffic` also tells what passes on the bus, as it does for the page of the web door. It listens only.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Final

import trio

from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.problem import CommandError
from canopen_cli.shared.screen import counted, node_text
from canopen_cli.shared.values import parse_value, physical, physical_text, value_text
from canopen_cli.tui.shown import DriveShown, MachineShown, NodePlace, ReadObject, ValueShown
from canopen_gateway import GatewayError, GatewayService, GatewaySession, ValueSeen, WatchedObject
from canopen_gateway.errors import first_line
from canopen_gateway.nmt_words import nmt_command
from canopen_gateway.plain_data import (
    EXPECTED,
    Plain,
    error_data,
    event_data,
    lease_data,
    net_data,
    node_ids,
    place_text,
    plain_value,
    view_data,
)
from canopen_gateway.traffic import FeedRow, FrameWish, TrafficFeed
from canopen_gateway.values import decoded
from canopen_master.errors import NodeIsNoDriveError
from canopen_master.plain_text import clean
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.procedures import ProcedureError

REFRESH: Final = 0.25
"""Seconds between two looks at the machine."""
MOST_EVENTS: Final = 200
MOST_LINES: Final = 1000
"""Lines of the traffic that are kept."""
LOOK_AGAIN: Final = 1.5
"""Seconds between two looks at the drives, while they are shown."""
VALUES_EACH: Final = 0.25
"""Seconds between two values of an object that no PDO brings."""
CURVE: Final = 60
"""Numbers of a watched object that are drawn."""
REFUSED: Final = (GatewayError, *EXPECTED, ProcedureError, CommandError)
"""What the user is told, and no more: the machine or the gateway says no, or a node is silent."""


class MachineWatch:
    """See this module's text. shown: what there is to be seen. notices: what the user is to be told, oldest first, each with
    whether it is an error; the view takes them out."""

    def __init__(
        self,
        service: GatewayService,
        session: GatewaySession,
        files: NodeFiles | None,
    ) -> None:
        """session: this view, as a client. files: those of the nodes of the only net."""
        self.service = service
        self.notices: deque[tuple[str, bool]] = deque(maxlen=20)
        self._session, self._files = session, files
        self.shown = MachineShown(mode=service.guard.mode)
        self._token = trio.lowlevel.current_trio_token()
        self._scope = trio.CancelScope()
        self._nursery: trio.Nursery | None = None
        self._traffic = {net: service.traffic(net) for net in service.nets}
        self._feeds: list[TrafficFeed] = []
        self._failed: set[str] = set()  # the nets whose traffic is not understood any more
        self._lines: deque[FeedRow] = deque(maxlen=MOST_LINES)
        self._older: deque[FeedRow] = deque(maxlen=MOST_LINES)  # findings that are older than these lines
        self._events: deque[Plain] = deque(maxlen=MOST_EVENTS)
        self._objects: dict[WatchedObject, ReadObject] = {}
        self._values: dict[WatchedObject, _LiveValue] = {}
        self._watching = trio.CancelScope()
        self._turn = trio.Lock()
        self._drives: dict[tuple[NodePlace, int], DriveShown] = {}
        self._no_drives: set[NodePlace] = set()
        self._looks_at_drives = False
        self._look = trio.Event()
        self._names: dict[NodePlace, str] = {}
        self._bits: dict[str, tuple[float, int]] = {}

    # ---- on trio's side ----

    async def run(self) -> None:
        """Watch the machine until the view leaves, or this is cancelled."""
        with self._scope, ExitStack() as stack:
            self._feeds = [stack.enter_context(each.watch(FrameWish(), MOST_LINES)) for each in self._traffic.values()]
            for net in self.service.nets:
                self._session.hear_boot_ups(net, True)
            async with trio.open_nursery() as nursery:
                self._nursery = nursery
                nursery.start_soon(self._hear)
                nursery.start_soon(self._look_at_drives)
                await self._refresh()

    async def _refresh(self) -> None:
        before, told = 0, trio.current_time()
        rate = 0.0
        while True:
            self._take_lines()
            self._session.watch_heard()
            self._name_objects()
            now = trio.current_time()
            if now - told >= 1.0:
                rate, before, told = (self._seen - before) / (now - told), self._seen, now
            self.shown = self._take(rate)
            await trio.sleep(REFRESH)

    @property
    def _seen(self) -> int:
        """The frames so far."""
        return sum(each.seen for each in self._feeds)

    def _take_lines(self) -> None:
        """Take what has passed, in words. Findings stay when frames have taken their places: they are counted in the header."""
        rows = (row for feed in self._feeds for row in feed.take())
        for row in sorted(rows, key=lambda row: row.seconds):
            if len(self._lines) == MOST_LINES and self._lines[0].kind == "finding":
                self._older.append(self._lines[0])
            self._lines.append(row)
        for net, traffic in self._traffic.items():
            if traffic.failure is not None and net not in self._failed:
                self._failed.add(net)
                self.notices.append((f"{net}: what passes is not understood any more: {first_line(traffic.failure)}", True))

    def _name_objects(self) -> None:
        """Know each node by its own file."""
        if self._files is not None:
            for net in self.service.nets:
                for node_id in node_ids(self.service.master, net):
                    self.service.master.node(node_id, self._files.dictionary_of(node_id), bus=net)

    def _take(self, rate: float) -> MachineShown:
        now = trio.current_time()
        nets = tuple(net_data(self.service, net) for net in self.service.nets)
        return MachineShown(
            mode=self.service.guard.mode,
            nets=nets,
            names=dict(self._names),
            events=tuple(self._events),
            lease=lease_data(self.service),
            traffic=(*self._older, *self._lines),
            frames=self._seen,
            findings=sum(each.found.total() for each in self._traffic.values()),
            rate=rate,
            load=self._load(nets, now),
            values=tuple(each.shown(now) for each in self._values.values()),
            objects=dict(self._objects),
            drives=tuple(self._drives.values()),
        )

    def _load(self, nets: tuple[Plain, ...], now: float) -> float | None:
        """Return the greatest load of a net since a second ago."""
        loads = []
        for net in nets:
            bits, bitrate = net["bits"], net["bitrate"]
            if not bitrate or bits is None:
                continue
            time_before, bits_before = self._bits.setdefault(net["name"], (now, bits))
            if now - time_before >= 1.0:
                loads.append((bits - bits_before) / (now - time_before) / bitrate)
                self._bits[net["name"]] = now, bits
        return max(loads) if loads else self.shown.load

    async def _hear(self) -> None:
        while True:
            heard = await self._session.next_event()
            event = event_data(self.service, heard, time.time())
            if event["kind"] == "boot-up":
                self._no_drives.discard(NodePlace(heard.net, event["node"]))
            self._events.append(event)

    async def _look_at_drives(self) -> None:
        while True:
            self._look = trio.Event()
            if self._looks_at_drives:
                for net in self.service.nets:
                    for node_id in node_ids(self.service.master, net):
                        await self._look_at(NodePlace(net, node_id))
            with trio.move_on_after(LOOK_AGAIN):
                await self._look.wait()

    async def _look_at(self, place: NodePlace) -> None:
        if place in self._no_drives:
            return
        devices = self.service.master.devices.values()
        axes = {each.axis.number for each in devices if (each.node.bus, each.node.node_id) == place} or {0}
        for axis in sorted(axes):
            try:
                view = await self.service.look_at_drive(*place, axis)
            except NodeIsNoDriveError:
                self._no_drives.add(place)
                return
            except REFUSED as error:
                shown = DriveShown(place, axis, None, clean(first_line(error)))
            else:
                shown = DriveShown(place, axis, view_data(view))
            self._drives[place, axis] = shown

    # ---- asked by the view ----

    def leave(self) -> None:
        """End `run`: what this view has set up ends with it."""
        self._ask(self._scope.cancel)

    def look_at_drives(self, wanted: bool) -> None:
        """Read what the drives show, again and again, or not any longer."""
        self._looks_at_drives = wanted
        if wanted:
            self._ask(lambda: self._look.set())

    def ask_find(self) -> None:
        """Ask all node-IDs of all nets that were not heard yet."""
        self._start(self._find)

    def ask_read(self, place: WatchedObject) -> None:
        """Read an object, and tell its value."""
        self._start(partial(self._read_and_tell, place))

    def ask_write(self, place: WatchedObject, text: str) -> None:
        """Write an object, and read it back. text: as `bytes_of` takes it."""
        self._start(partial(self._write, place, text))

    def ask_nmt(self, place: NodePlace, word: str) -> None:
        """Send an NMT command to a node."""
        self._start(partial(self._nmt, place, word))

    def ask_halt(self, place: NodePlace | None) -> None:
        """Stop what moves: a node, or everything."""
        self._start(partial(self._halt, place))

    def ask_watch(self, place: WatchedObject, name: str) -> None:
        """Watch an object; or end that, if it is watched."""
        self._ask(lambda: self._watch(place, name))

    def _ask(self, function: Callable[[], object]) -> None:
        try:
            self._token.run_sync_soon(function)
        except trio.RunFinishedError:
            self.notices.append(("the bus is closed", True))

    def _start(self, task: Callable[[], Awaitable[None]]) -> None:
        def start() -> None:
            if self._nursery is not None and not self._scope.cancel_called:
                self._nursery.start_soon(self._told, task)

        self._ask(start)

    async def _told(self, task: Callable[[], Awaitable[None]]) -> None:
        """Do what was asked for; tell why it cannot be done."""
        try:
            await task()
        except REFUSED as error:
            self._refuse(error)

    def _refuse(self, error: Exception) -> None:
        self.notices.append((refusal_text(error), True))

    async def _find(self) -> None:
        for net in self.service.nets:
            self.notices.append((f"{net}: asking all node-IDs ...", False))
            await self.service.find_nodes(net)
        places = [NodePlace(net, node_id) for net in self.service.nets for node_id in node_ids(self.service.master, net)]
        self.notices.append((f"{counted(len(places), 'node')} known", False))
        for place in places:
            with suppress(*REFUSED):  # a node without a name, or a silent one, is no error
                self._names[place] = await self._session.read_name(*place)

    async def _read(self, place: WatchedObject) -> None:
        dictionary = self.service.node(place.net, place.node_id).dictionary
        try:
            data = await self._session.read(place.net, place.node_id, place.index, place.subindex)
        except REFUSED as error:
            self._objects[place] = ReadObject("", clean(first_line(error)))
            raise
        value = decoded(dictionary, place.index, place.subindex, data)
        self._objects[place] = ReadObject(shown_value(dictionary, place, value))

    async def _read_and_tell(self, place: WatchedObject) -> None:
        await self._read(place)
        self.notices.append((f"{place_text(place.index, place.subindex)} is {self._objects[place].text}", False))

    async def _write(self, place: WatchedObject, text: str) -> None:
        node = self.service.node(place.net, place.node_id)
        variable = node.dictionary.at(place.index, place.subindex)
        _, _, data = node.remote.encode(variable, parse_value(node.dictionary, variable, text))
        await self._session.write(place.net, place.node_id, place.index, place.subindex, data)
        told = f"{node_text(place.node_id)}: {place_text(place.index, place.subindex)} was written"
        try:
            await self._read(place)
        except REFUSED:
            self.notices.append((f"{told}; it cannot be read back", False))
        else:
            self.notices.append((f"{told}: it is {self._objects[place].text}", False))

    async def _nmt(self, place: NodePlace, word: str) -> None:
        await self._session.nmt(place.net, nmt_command(word), place.node_id)
        self.notices.append((f"{node_text(place.node_id)}: {word} was sent", False))

    async def _halt(self, place: NodePlace | None) -> None:
        problems = await (self.service.halt() if place is None else self.service.halt(*place))
        what = "everything that this view's master moves" if place is None else node_text(place.node_id)
        if problems:
            self.notices.append((clean(f"halt: not all confirmed that they stand: {'; '.join(problems)}"), True))
        else:
            self.notices.append((f"halted: {what}", False))
        self._look.set()

    def _watch(self, place: WatchedObject, name: str) -> None:
        if self._values.pop(place, None) is None:
            self._values[place] = _LiveValue(place, name)
        self._follow_anew()

    def _follow_anew(self) -> None:
        """Follow what is watched now, in place of what was followed before."""
        self._watching.cancel()
        self._watching = trio.CancelScope()
        if self._nursery is not None and self._values:
            self._nursery.start_soon(self._follow_values, self._watching)

    async def _follow_values(self, scope: trio.CancelScope) -> None:
        with scope:
            async with self._turn:  # what was followed before has to end first: it still counts as watched
                try:
                    async with self._session.watch_values(list(self._values), VALUES_EACH) as values:
                        async for seen in values:
                            watched = self._values.get(seen.place)
                            if watched is not None:
                                watched.take(seen, self.service.node(seen.place.net, seen.place.node_id).dictionary)
                except REFUSED as error:
                    self._values.popitem()  # the one that was too many
                    self._refuse(error)
                    self._follow_anew()


class _LiveValue:
    """A watched object, while it is watched."""

    def __init__(self, place: WatchedObject, name: str) -> None:
        self._place, self._name = place, name
        self._text = self._problem = ""
        self._least: float | None = None
        self._most: float | None = None
        self._time: float | None = None
        self._curve: deque[float] = deque(maxlen=CURVE)

    def take(self, seen: ValueSeen, dictionary: ObjectDictionary) -> None:
        """Take a value."""
        self._problem = clean(seen.problem)
        if seen.value is None:
            return
        self._time = trio.current_time()
        self._text = shown_value(dictionary, self._place, seen.value)
        if isinstance(seen.value, int | float):
            variable = dictionary.get(self._place.index, self._place.subindex)
            in_unit = None if variable is None else physical(variable, seen.value)
            number = seen.value if in_unit is None else in_unit
            self._least = number if self._least is None else min(self._least, number)
            self._most = number if self._most is None else max(self._most, number)
            self._curve.append(number)

    def shown(self, now: float) -> ValueShown:
        """Return it as it is shown."""
        age = None if self._time is None else now - self._time
        return ValueShown(self._place, self._name, self._text, self._problem, self._least, self._most, age, tuple(self._curve))


def refusal_text(error: Exception) -> str:
    """Return an error in one line, with what was seen, its cause, and what to try."""
    data = error_data(error)
    code = f"{data['code']}: " if data["code"] else ""
    details = (" ".join(each.split()) for each in data["details"])
    return clean("; ".join([f"{code}{data['text']}", *details]))


def shown_value(dictionary: ObjectDictionary, place: WatchedObject, value: Value) -> str:
    """Return a value as it is shown: with its unit, if it has one, and with the names that it has."""
    variable = dictionary.get(place.index, place.subindex)
    if variable is None:
        return clean(str(plain_value(value)))
    text = physical_text(variable, value) or value_text(variable, value)
    names = ", ".join(dictionary.names_of(variable, value))
    return clean(f"{text} ({names})" if names else text)
