"""The frames of a bus as lines: which of them are shown, and what such a line says. `canopen monitor` and `canopen log decode`.

In a pipe a line has the time, the frame, the service, the node and the meaning, however long. On a terminal with less than WIDE
columns it has the CAN-ID in place of the frame, and a long meaning goes on below itself. A line that begins with ! says what is
wrong with the frame before it. A line that begins with = sums up frames before it: a fastscan, whose frames are left out, or what
a node was told behind its boot-up.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import click

from canopen_cli.live.clocks import RecordClocks
from canopen_cli.live.window import time_of_day
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import NodeIds, together
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_master.monitor_words import SERVICES, finding_text, is_of_service, service_word
from canopen_master.plain_text import clean, json_text
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import SECOND, Time
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.meaning import ShownObject
from canopen_proto.observer.observer import Observation, Observer
from canopen_proto.observer.sequences import Summary
from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.record import Record

WIDE: Final = 120
"""Columns of a terminal that shows the bytes of each frame, too."""
MAX_KEPT: Final = 1 << 16
"""Frames and objects of which the last value is kept, to see changes."""

_STYLES: Final = {
    "nmt": "bold",
    "nmt master": "bold",
    "boot-up": "bold green",
    "emcy": "bold yellow",
    "sdo": "cyan",
    "sync": "dim",
    "heartbeat": "dim",
    "guarding": "dim",
    "time": "dim",
    "lss": "magenta",
    "?": "dim",
}
_FINDING: Final = "bold red"
_NUMBER: Final = re.compile(r"(?:0x)?([0-9a-f]{4})(?:[:.]([0-9a-f]{1,2}))?", re.IGNORECASE)


class Buses:
    """The observers of a source: each bus in it has its own.

    time: of the last record, ns, as its observer has it: it never goes back, and goes on where a clock was set back. jumps: how
    often one was.
    """

    def __init__(self, files: NodeFiles, **settings: Any) -> None:
        self.time: Time = 0
        self._files = files
        self._settings = settings
        self._first: Time | None = None
        self._clocks = RecordClocks()
        self._observers: dict[str, Observer] = {}
        self._lost = ""  # the receiver's words, until the observers know them
        self._is_finding = False

    @property
    def jumps(self) -> int:
        return self._clocks.jumps

    def observe(self, record: Record) -> tuple[float, Observation]:
        """Return the seconds since the first record, and what is known of this one."""
        if self._first is None:
            self._first = record.time
        channel = record.channel
        if not self._observers:
            self._lost = ""  # nothing was heard before it
        if channel not in self._observers:
            self._observers[channel] = Observer(self._files.dictionary_of, **self._settings)
        jumps = self._clocks.jumps
        self.time = self._clocks.set(channel, record.time)
        if self._clocks.jumps > jumps and not self._lost:
            self._lost = "the clock went back"  # how long nothing was heard is not known
        now = self.time - self._first
        found = self._tell_lost(now)
        observation = self._observers[channel].observe(record.frame, now)
        if found is not None:
            observation = observation.behind(found)
        return self.seconds(record.time), observation

    def lost(self, text: str, *, is_finding: bool = False) -> None:
        """Take the receiver's own word that it lost frames of some bus before the next record; see `Observer.lost`.

        text: its words. is_finding: this is a finding of that record; else the caller tells it.
        """
        self._lost, self._is_finding = text, is_finding

    def _tell_lost(self, now: Time) -> BusFinding | None:
        """Tell the observers that frames were lost; return that, if it is a finding."""
        if not self._lost:
            return None
        found = [observer.lost(self._lost, now) for observer in self._observers.values()]
        is_finding, self._lost, self._is_finding = self._is_finding, "", False
        return found[0] if found and is_finding else None

    def idle(self, time: Time) -> Iterator[tuple[str, tuple[BusFinding, ...], tuple[Summary, ...]]]:
        """Return what each bus shows by its silence; see `Observer.idle`. time: all frames before it have been observed."""
        now = time - (self._first or 0)
        self._tell_lost(now)
        for channel, observer in self._observers.items():
            yield channel, *observer.idle(now)

    def unfinished(self) -> Iterator[tuple[str, Summary]]:
        """Return the sequences that are not over yet, each with its bus: behind the last frame."""
        for channel, observer in self._observers.items():
            for summary in observer.unfinished():
                yield channel, summary

    def seconds(self, time: Time) -> float:
        """Return the seconds since the first record."""
        return 0.0 if self._first is None else (time - self._first) / SECOND


# ---- which frames ----


class WantedFrames(NamedTuple):
    """The frames that the options of `choosing` name. nodes: None for all of them; no services and no objects: all. changes: only
    frames that differ from the last one of their kind, in these objects."""

    nodes: tuple[int, ...] | None = None
    services: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    changes: bool = False


choosing: Final = together(
    "wanted",
    WantedFrames,
    click.option("--node", "nodes", type=NodeIds(), help="Only what is from or for these nodes: 5, or 3-8."),
    click.option(
        "--service",
        "services",
        multiple=True,
        metavar="NAME",
        help=f"Only these: pdo, tpdo, rpdo, {', '.join(SERVICES)}; also several, as in sdo,emcy.",
    ),
    click.option(
        "--object",
        "objects",
        multiple=True,
        metavar="OBJECT",
        help="Only what has this object in it: 0x6041, 1018:01, statusword; 5:statusword of node 5 alone.",
    ),
    click.option(
        "--changes",
        is_flag=True,
        help="Leave out a frame that says the same as the last one of its kind (with --object: of these objects).",
    ),
)
"""The options that choose frames. The command takes `wanted`: WantedFrames."""


class FrameChoice:
    """The frames that are shown."""

    def __init__(self, files: NodeFiles, wanted: WantedFrames) -> None:
        """Raises CommandError, ObjectNotFoundError for a word that fits nothing."""
        nodes, services, objects, changes = wanted
        self.files = files
        self._has_parts = files.settings.verbosity > 0 or files.settings.json
        self._nodes = frozenset(nodes or ())
        self._services = tuple(_service(word) for each in services for word in each.lower().split(","))
        self._wanted = tuple(self._object(word) for word in objects)
        self._of_node: dict[int, tuple[tuple[int, int | None], ...]] = {}
        self._last: dict[object, str] | None = {} if changes else None
        for each in self._wanted:
            self._check(each)

    def shows(self, record: Record, observation: Observation) -> bool:
        """Return whether a frame is shown. With a finding it always counts as a change, and as one of the finding's node."""
        meaning, findings = observation.meaning, observation.findings
        if observation.is_part and meaning.service == "LSS" and not findings and not self._has_parts:
            return False
        if self._nodes and meaning.node_id not in self._nodes and not any(each.node_id in self._nodes for each in findings):
            return False
        if self._services and not any(is_of_service(meaning.service.lower(), word) for word in self._services):
            return False
        if self._wanted and not any(self.wants(shown) for shown in meaning.objects):
            return False
        return self._last is None or self._has_changed(self._last, record, observation)

    def wants(self, shown: ShownObject) -> bool:
        """Return whether an object of a frame is one of those that were named; all are, if none was."""
        return not self._wanted or self._wants(shown.node_id, shown.index, shown.subindex)

    def warns(self, finding: BusFinding) -> bool:
        """Return whether a finding is shown that belongs to no frame."""
        is_free = not (self._wanted or self._services)
        return is_free and (not self._nodes or finding.node_id in self._nodes)

    def tells(self, summary: Summary) -> bool:
        """Return whether the summary of a sequence of frames is shown."""
        if self._wanted or (self._nodes and summary.node_id not in self._nodes):
            return False
        return not self._services or any(is_of_service(summary.service.lower(), word) for word in self._services)

    def _has_changed(self, last: dict[object, str], record: Record, observation: Observation) -> bool:
        meaning = observation.meaning
        key = (record.channel, record.frame.key, tuple((shown.index, shown.subindex) for shown in meaning.objects))
        if len(last) >= MAX_KEPT:
            last.clear()
        text = meaning.text
        if self._wanted:  # what else is in the frame may change as it likes
            text = "\n".join(shown.text for shown in meaning.objects if self.wants(shown))
        before, last[key] = last.get(key), text
        return before != text or bool(observation.findings)

    def _wants(self, node_id: int, index: int, subindex: int) -> bool:
        if node_id not in self._of_node:
            self._of_node[node_id] = tuple(self._places(node_id))
        return any(place in ((index, None), (index, subindex)) for place in self._of_node[node_id])

    def _places(self, node_id: int) -> Iterator[tuple[int, int | None]]:
        """Yield where a node has the objects that were named. None: each subindex."""
        dictionary = self.files.dictionary_of(node_id) if node_id else None
        for each in self._wanted:
            if each.node_id not in (None, node_id):
                continue
            if each.index is not None:
                yield each.index, each.subindex
            elif dictionary is not None and each.name in dictionary:
                variable = dictionary.variable(each.name)
                yield variable.index, variable.subindex

    def _object(self, word: str) -> WantedObject:
        """Return what a word means: an object, perhaps of one node: "6041", "1018:01", "statusword", "5:statusword". A name of a
        field has a colon, too: what stands before it is a node only if there is one of that name, or if it is a number."""
        word = word.strip()
        node, colon, rest = word.partition(":")
        node_id = None
        if colon and _NUMBER.fullmatch(word) is None and rest and self.files.settings.is_node(node):
            node_id, word = self.files.settings.node_id(node), rest
        number = _NUMBER.fullmatch(word)
        if number is None:
            return WantedObject(node_id, word)
        return WantedObject(node_id, word, int(number[1], 16), int(number[2], 16) if number[2] else None)

    def _check(self, wanted: WantedObject) -> None:
        """Raise ObjectNotFoundError if no node has an object of this name."""
        if wanted.index is not None:
            return
        nodes = self._nodes or range(1, MAX_NODE_ID + 1) if wanted.node_id is None else (wanted.node_id,)
        if not any(wanted.name in self.files.dictionary_of(node_id) for node_id in nodes):
            self.files.dictionary_of(min(nodes)).variable(wanted.name)


@dataclass(frozen=True)
class WantedObject:
    """An object that was named. node_id: None: of each node. index: None: by its name. subindex: None: each."""

    node_id: int | None
    name: str
    index: int | None = None
    subindex: int | None = None


def _service(word: str) -> str:
    try:
        return service_word(word)
    except ValueError as error:
        raise usage("CO001", str(error), tries=("--service with one of these",)) from None


# ---- what a line says ----


class FrameLines:
    """Makes the lines, each with its end: JSON documents with --json, else text for this screen."""

    def __init__(self, screen: Screen, *, clock: bool = False) -> None:
        """clock: times of day, in place of seconds since the first frame."""
        self._clock = clock
        self._json = screen.json_output
        self._screen = screen
        self._paint = _painter(screen)
        self.measure()

    def measure(self) -> None:
        """Take the present width of the terminal."""
        self._columns = self._screen.out.width if self._screen.out.is_terminal else None
        self._has_bytes = self._columns is None or self._columns >= WIDE or self._screen.verbosity > 0

    def frame(self, seconds: float, record: Record, observation: Observation) -> str:
        """Return the lines for a frame, and for what is wrong with it. seconds: since the first frame."""
        meaning, findings = observation.meaning, observation.findings
        if self._json:
            line = {"time": record.time, "channel": record.channel, "frame": str(record.frame), "sent": record.sent}
            line |= {"service": meaning.service, "node": meaning.node_id, "text": meaning.text}
            line |= {"objects": [_object_json(shown) for shown in meaning.objects]}
            line |= {"findings": [finding._asdict() for finding in findings]}
            return json_text(line) + "\n"
        service, node = clean(meaning.service), str(meaning.node_id or "")
        if self._has_bytes:
            head = f"{self._at(seconds, record.time, 6)} {record.frame!s:<25} {service:<9} {node:>3}  "
        else:
            head = f"{self._at(seconds, record.time, 4)} {str(record.frame).partition('#')[0]:<3} {service:<9} {node:>3}  "
        style = _STYLES.get(meaning.service.lower(), "")
        wrong = "".join(self._line("! ", finding_text(each), _FINDING) for each in findings)
        return self._line(head, clean(meaning.text), style) + wrong

    def finding(self, seconds: float, time: Time, channel: str, finding: BusFinding) -> str:
        """Return the line for what is wrong because no frame comes. seconds: since the first frame."""
        if self._json:
            return json_text({"time": time, "channel": channel, "findings": [finding._asdict()]}) + "\n"
        return self._line("! ", f"{self._words(seconds, time)}: {finding_text(finding)}", _FINDING)

    def summary(self, time: Time, channel: str, summary: Summary) -> str:
        """Return the line that sums up a sequence of frames. time: of the frame that it comes with."""
        service, node_id, text = summary
        if self._json:
            line = {"time": time, "channel": channel, "service": service, "node": node_id, "summary": text}
            return json_text(line) + "\n"
        return self._line("= ", f"{service}{f' of node {node_id}' if node_id else ''}: {text}", _STYLES[service.lower()])

    def report(self, seconds: float, time: Time, report: Report) -> str:
        """Return the line for a report of the bus. seconds: since the first frame."""
        if self._json:
            lost = report.lost if isinstance(report, ReceiveOverrun) else 0
            return json_text({"time": time, "report": report.failed, "seen": report.seen, "lost": lost}) + "\n"
        return self._line("! ", clean(f"{self._words(seconds, time)}: {report.failed}: {report.seen}"), _FINDING)

    def gap(self, number: int) -> str:
        """Return the line in place of frames that the reader was too slow for. number: how many."""
        if self._json:
            return json_text({"left_out": number}) + "\n"
        return self._line("! ", f"{number} frames are left out here: the reader of this output is too slow", _FINDING)

    def _at(self, seconds: float, time: Time, digits: int) -> str:
        return f"{time_of_day(time):>{digits + 6}}" if self._clock else f"{seconds:{digits + 6}.{digits}f}"

    def _words(self, seconds: float, time: Time) -> str:
        return time_of_day(time) if self._clock else f"{seconds:.4f} s"

    def _line(self, head: str, text: str, style: str) -> str:
        if self._columns is None:
            return f"{head}{text}".rstrip() + "\n"
        room = max(self._columns - len(head), 20)
        first, *others = textwrap.wrap(text, room, break_on_hyphens=False) or [""]
        lines = [head + first, *(" " * len(head) + each for each in others)]
        return "".join(f"{self._paint(line.rstrip(), style)}\n" for line in lines)


def _object_json(shown: ShownObject) -> dict[str, Any]:
    return {
        "node": shown.node_id,
        "index": shown.index,
        "sub": shown.subindex,
        "name": shown.name,
        "value": shown.value.hex() if isinstance(shown.value, bytes) else shown.value,
        "text": shown.text,
    }


def _painter(screen: Screen) -> Callable[[str, str], str]:
    """Return a function that gives a line the colour of a style. rich itself would take longer for a line than the rest."""
    made: dict[str, tuple[str, str]] = {"": ("", "")}

    def paint(line: str, style: str) -> str:
        if style not in made:
            with screen.out.capture() as captured:
                screen.out.print("x", style=style, end="")
            before, _, behind = captured.get().partition("x")
            made[style] = before, behind
        before, behind = made[style]
        return f"{before}{line}{behind}"

    return paint
