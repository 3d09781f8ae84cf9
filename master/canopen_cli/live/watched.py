"""The objects that `canopen watch` shows: the last value of each, when and how it came, and whether it is still the present one.

Pure: `Watched.take` gets what an observer says of each frame, `Watched.view` returns what is to be shown. All values come from
the bus, also those that the command asks for by SDO: it hears the answers as it hears those to others.

A value is stale when nothing has brought it again for the time `fresh_for`, and at once when its node boots.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from canopen_cli.shared.values import hex_text, place_text, value_text
from canopen_cli.shared.values import physical as physical_value
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.drives.cia402.axes import axis_of, swapped
from canopen_proto.drives.cia402.modes import describe_command, describe_status
from canopen_proto.drives.cia402.objects import CONTROLWORD, ERROR_CODE, MODES_OF_OPERATION_DISPLAY, STATUSWORD
from canopen_proto.drives.cia402.states import FAULT_STATES, State, state_of
from canopen_proto.error_codes import error_text
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.observer.meaning import Meaning, ShownObject

FRESH: Final = SECOND
"""The least time for which a value counts as the present one. A device that sends a value only when it changes is asked again
within it."""
BOOTED: Final = "from before its boot-up"
SLOTS: Final = 400
"""Slots of time that a curve has: twice as many points as a wide terminal has in a line."""
CODES: Final = (STATUSWORD, CONTROLWORD, ERROR_CODE)
"""Objects whose numbers are read in hexadecimal."""
_STATES: Final = ("heartbeat", "guarding")
_WORD_BITS: Final = 16
_MAKERS_BITS: Final = 0xC100
"""Bits 8, 14 and 15 of the statusword."""


class WatchedSample(NamedTuple):
    """A value as it came. source: "SDO", "TPDO 1"."""

    time: Time
    variable: Variable
    value: Value
    source: str
    is_change: bool


class CurveSlot(NamedTuple):
    """A part of the curve of a value. age: ns, of its end. least, most: of the values in it."""

    age: Time
    least: float
    most: float


class WatchedRow(NamedTuple):
    """An object as it is shown.

    value: "" if there is none yet. age: ns; None without a value. words: the state and bits of a word, or the names of a value.
    bits: of a word, by fours. trouble: why there is no newer value. is_stale: the value must not be taken for the present one.
    is_fault: the drive shows a fault. number, curve: for a plot; None and nothing for bits and texts.
    """

    place: str
    name: str
    value: str
    unit: str
    least: str
    most: str
    age: Time | None
    source: str
    words: tuple[str, ...] = ()
    bits: str = ""
    trouble: str = ""
    is_stale: bool = False
    is_fault: bool = False
    number: float | None = None
    curve: tuple[CurveSlot, ...] = ()


class View(NamedTuple):
    """All that is shown of a node at one time. state: its NMT state in words; "" if it is not known, or not any more."""

    node_id: int
    rows: tuple[WatchedRow, ...]
    state: str
    emergency: str
    emergency_age: Time | None
    heard: Time | None
    """ns since it was last heard; None: never."""


@dataclass
class _WatchedObject:
    variable: Variable
    value: Value | None = None
    time: Time = -NEVER
    by_pdo: Time = -NEVER
    source: str = ""
    least: float | None = None
    most: float | None = None
    trouble: str = ""
    is_old: bool = False
    is_plain: bool = True
    """Its number is an amount: no bits, no names."""
    curve: deque[tuple[int, float, float]] = field(default_factory=lambda: deque(maxlen=SLOTS))
    """By the numbers of slots of time, the oldest first: the least and the greatest value in each."""


class Watched:
    """See this module's text.

    node_id, dictionary: of the node. variables: its objects to show. fresh_for: ns. span: ns that the curve of a value goes
    back; 0: none is kept.
    """

    def __init__(
        self,
        node_id: int,
        dictionary: ObjectDictionary,
        variables: Iterable[Variable],
        fresh_for: Time = FRESH,
        span: Time = 0,
    ) -> None:
        self.node_id = node_id
        self.fresh_for = max(FRESH, fresh_for)
        self._slot = span // SLOTS
        self._dictionary = dictionary
        self._entries = {each.mux: _WatchedObject(each, is_plain=not self._has_names(each)) for each in variables}
        self._modes: dict[int, tuple[Time, int]] = {}  # by axis
        self._state: tuple[Time, str] = (-NEVER, "")
        self._emergency: tuple[Time, str] | None = None
        self._heard: Time | None = None
        self.boots = 0
        """How many boot-ups of the node came."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The objects, in their order."""
        return tuple(entry.variable for entry in self._entries.values())

    # ---- what comes ----

    def take(self, meaning: Meaning, now: Time) -> list[WatchedSample]:
        """Take in what a frame means; return the values that it brings. now: ns."""
        if meaning.node_id != self.node_id:
            return []  # and its words are never made
        self._of_node(meaning, now)
        return [each for shown in meaning.objects if (each := self._shown(shown, meaning.service, now)) is not None]

    def _of_node(self, meaning: Meaning, now: Time) -> None:
        service = meaning.service
        if service in _STATES and meaning.text:
            self._state = now, meaning.text
        elif service == "boot-up":
            self._state = now, "booted"
            self.boots += 1
            self._modes.clear()
            for entry in self._entries.values():
                entry.is_old = entry.value is not None
                entry.by_pdo = -NEVER
                entry.trouble = BOOTED if entry.is_old else ""
        elif service == "EMCY":
            self._emergency = now, meaning.text
        elif not (service.startswith("TPDO") or any(each.is_held for each in meaning.objects)):
            return  # perhaps a frame for the node, not of it
        self._heard = now

    def _shown(self, shown: ShownObject, service: str, now: Time) -> WatchedSample | None:
        if shown.node_id != self.node_id or shown.value is None:
            return None
        by_pdo = service != "SDO"
        if not (shown.is_held or by_pdo):
            return None  # a write that the device has not confirmed
        key = mux(shown.index, shown.subindex)
        home = _home(key)
        if home == MODES_OF_OPERATION_DISPLAY and isinstance(shown.value, int):
            self._modes[axis_of(key) or 0] = now, shown.value
        entry = self._entries.get(key)
        if entry is None:
            return None
        is_change = entry.value is None or shown.value != entry.value or entry.is_old
        entry.value, entry.time, entry.source = shown.value, now, service
        entry.by_pdo = now if by_pdo else entry.by_pdo
        entry.trouble, entry.is_old = "", False
        number = self._number(entry)
        if number is not None:
            entry.least = number if entry.least is None else min(entry.least, number)
            entry.most = number if entry.most is None else max(entry.most, number)
            if self._slot:
                self._draw(entry, number, now // self._slot)
        return WatchedSample(now, entry.variable, shown.value, service, is_change)

    @staticmethod
    def _draw(entry: _WatchedObject, number: float, slot: int) -> None:
        """Add a value to the curve."""
        least = most = number
        if entry.curve and entry.curve[-1][0] == slot:
            _, low, high = entry.curve.pop()
            least, most = min(low, number), max(high, number)
        entry.curve.append((slot, least, most))

    def refused(self, variable: Variable, why: str) -> None:
        """Take note why an object could not be read. It stands until a value comes."""
        self._entries[variable.mux].trouble = why

    def forget_limits(self) -> None:
        """Begin least and greatest values again."""
        for entry in self._entries.values():
            entry.least = entry.most = None

    def pdo_age(self, variable: Variable, now: Time) -> Time:
        """Return how long ago a PDO brought an object, ns; at least NEVER if none did since the node's boot-up."""
        return now - self._entries[variable.mux].by_pdo

    # ---- what is shown ----

    def view(self, now: Time) -> View:
        """Return what is to be shown. now: ns."""
        state_at, state = self._state
        emergency = self._emergency
        return View(
            self.node_id,
            tuple(self._row(entry, now) for entry in self._entries.values()),
            state if now - state_at < max(self.fresh_for, 3 * SECOND) else "",
            "" if emergency is None else emergency[1],
            None if emergency is None else now - emergency[0],
            None if self._heard is None else now - self._heard,
        )

    def row(self, variable: Variable, now: Time) -> WatchedRow:
        """Return an object as it is shown."""
        return self._row(self._entries[variable.mux], now)

    def _row(self, entry: _WatchedObject, now: Time) -> WatchedRow:
        variable, value = entry.variable, entry.value
        place, name = place_text(variable), variable.name
        if value is None:
            return WatchedRow(place, name, "", "", "", "", None, "", trouble=entry.trouble)
        age = max(0, now - entry.time)
        is_stale = entry.is_old or age > self.fresh_for
        words, bits, is_fault = self._words(variable, value, now)
        number = self._number(entry)
        text = value_text(variable, value) if number is None else f"{number:.10g}"
        if _home(variable.mux) in CODES:
            text = hex_text(variable, value) or text
        return WatchedRow(
            place,
            name,
            text,
            variable.unit if number is not None else "",
            "" if entry.least is None else f"{entry.least:.10g}",
            "" if entry.most is None else f"{entry.most:.10g}",
            age,
            entry.source,
            words,
            bits,
            entry.trouble,
            is_stale,
            is_fault,
            number,
            tuple(CurveSlot(max(0, now - (slot + 1) * self._slot), low, high) for slot, low, high in entry.curve),
        )

    def _number(self, entry: _WatchedObject) -> float | None:
        """Return the value as an amount, in its unit if it has one; None if it is none."""
        value = entry.value
        if not entry.is_plain or isinstance(value, bool) or not isinstance(value, int | float):
            return None
        physical = physical_value(entry.variable, value)
        return value if physical is None else physical

    def _words(self, variable: Variable, value: Value, now: Time) -> tuple[tuple[str, ...], str, bool]:
        """Return the words and the bits of a value, and whether it shows a fault."""
        home = _home(variable.mux)
        if not isinstance(value, int) or isinstance(value, bool):
            return (), "", False
        if home in (STATUSWORD, CONTROLWORD):
            mode = self._mode(variable, now)
            bits = " ".join(f"{value & 0xFFFF:0{_WORD_BITS}b}"[begin : begin + 4] for begin in range(0, _WORD_BITS, 4))
            if home == CONTROLWORD:
                return describe_command(value, mode), bits, False
            return (*describe_status(value, mode), *self._own_names(variable, value)), bits, state_of(value) in FAULT_STATES
        if home == ERROR_CODE:
            return (error_text(value),), "", value != 0
        return self._dictionary.names_of(variable, value) if variable in self._dictionary else (), "", False

    def _own_names(self, variable: Variable, value: int) -> tuple[str, ...]:
        """Return the names of the manufacturer's bits: those that only the dictionary tells."""
        if variable not in self._dictionary:
            return ()
        masks = {each.name: each.mask for each in self._dictionary.constants_of(variable)}
        return tuple(each for each in self._dictionary.names_of(variable, value) if not masks[each] & ~_MAKERS_BITS)

    def _mode(self, variable: Variable, now: Time) -> int | None:
        """Return the mode of operation of an object's axis; None if it is not known, or not any more."""
        time, mode = self._modes.get(axis_of(variable.mux) or 0, (-NEVER, 0))
        return mode if now - time <= self.fresh_for else None

    def _has_names(self, variable: Variable) -> bool:
        if _home(variable.mux) in CODES:
            return True
        return variable in self._dictionary and bool(self._dictionary.constants_of(variable))


def _home(key: Mux) -> Mux:
    """Return the object of the first axis that an object is on its own axis."""
    axis = axis_of(key)
    return swapped(key, axis) if axis else key


def state_style(row: WatchedRow) -> str:
    """Return the colour of the first word of a statusword: what a drive may do."""
    if row.is_stale:
        return "dim"
    first = row.words[0] if row.words else ""
    return "red" if row.is_fault else "green" if first == State.OPERATION_ENABLED else "yellow"
