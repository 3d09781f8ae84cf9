"""The views of `canopen tui`, one for each number key: what each shows of the machine, and the keys that it has."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar, Final

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Input, Static

from canopen_cli.live.braille import curve
from canopen_cli.shared.screen import counted, node_text
from canopen_cli.tui.rows import Rows, RowsColumn, cell
from canopen_cli.tui.shown import DriveShown, MachineShown, NodePlace, ReadObject
from canopen_gateway import WatchedObject
from canopen_gateway.plain_data import NOT_HEARD, Plain, place_text
from canopen_gateway.traffic import FeedRow
from canopen_master.plain_text import clean
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.objects import Variable

WIDE: Final = 110
"""Columns of a terminal that has room for more than the least."""
CURVE_WIDTH: Final = 40
QUIET_SERVICES: Final = ("SYNC", "heartbeat", "guarding", "TIME", "?")
STATE_STYLES: Final = {"operational": "green", "stopped": "yellow", NOT_HEARD: "dim", "initialising": "yellow"}
EVENT_STYLES: Final = {"emergency": "bold yellow", "lost": "bold red", "boot-up": "green"}
FINDING: Final = "bold red"
SERVICE_STYLES: Final = {"nmt": "bold", "boot-up": "bold green", "emcy": "bold yellow", "sdo": "cyan", "lss": "magenta"}


class Pane(Vertical):
    """One of the views. name_shown: of its tab. keys: its own, for the last line of the screen."""

    name_shown: ClassVar[str] = ""
    keys: ClassVar[str] = ""

    def show(self, machine: MachineShown) -> None:
        """Show the machine as it is now."""

    def focus_first(self) -> None:
        """Give the keys to what is moved by the cursor."""
        for each in self.query("Rows, TrafficLines").results():
            each.focus()


class NodesView(Pane):
    """Who is on the nets, and in which state."""

    name_shown = "Nodes"
    keys = "Enter objects  f find nodes  n NMT command"

    def compose(self) -> ComposeResult:
        """A table."""
        columns = (
            RowsColumn("Node", 11),
            RowsColumn("Name", 0),
            RowsColumn("State", 15),
            RowsColumn("Heard", 9, right=True),
            RowsColumn("Last error", 22, wide_only=78),
            RowsColumn("Drives", 0, wide_only=140),
            RowsColumn("Net", 16, wide_only=140),
        )
        self._rows = Rows(columns, id="nodes-rows")
        yield self._rows
        self._note = Static("", id="nodes-note")
        yield self._note

    def show(self, machine: MachineShown) -> None:
        rows = []
        for net in machine.nets:
            for node in net["nodes"]:
                error = node["emergency"]
                age = "" if node["age"] is None else f"{node['age']:.1f} s"
                drives = "; ".join(f"{each['name']} {each['state']}" for each in node["drives"])
                cells = (
                    cell(f"{node['node']} (0x{node['node']:02X})"),
                    cell(node["name"] or machine.names.get(NodePlace(net["name"], node["node"]), "")),
                    cell(node["state"], STATE_STYLES.get(node["state"], "")),
                    cell(age),
                    cell("" if error is None else f"{error['code']} {error['text']}", "yellow"),
                    cell(drives),
                    cell(net["name"]),
                )
                rows.append((NodePlace(net["name"], node["node"]), cells))
        self._rows.fill(rows)
        note = "" if rows else "No node was heard yet. f asks all node-IDs (it reads their device types)."
        self._note.update(Text(note, style="dim"))

    @property
    def chosen(self) -> NodePlace | None:
        """The node at the cursor."""
        place: NodePlace | None = self._rows.chosen
        return place


class ObjectsView(Pane):
    """The objects of a node."""

    name_shown = "Objects"
    keys = "/ search  Enter read  e write  w watch  [ ] node"

    def compose(self) -> ComposeResult:
        """A line to search in, a table, and the object at the cursor."""
        self._node = Static("", id="objects-node")
        yield self._node
        self._line = Input(placeholder="search: a name, or 60", compact=True, id="objects-search", select_on_focus=False)
        yield self._line
        columns = (
            RowsColumn("Object", 7),
            RowsColumn("Name", 0),
            RowsColumn("Type", 14, wide_only=WIDE),
            RowsColumn("Access", 6),
            RowsColumn("Value", 0),
        )
        self._rows = Rows(columns, id="objects-rows")
        yield self._rows
        self._detail = Static("", id="objects-detail")
        yield self._detail

    def on_mount(self) -> None:
        """Nothing is chosen yet."""
        self.node: NodePlace | None = None
        self._dictionary: ObjectDictionary | None = None
        self._machine = MachineShown()
        self._made: tuple[object, ...] = ()

    def choose(self, node: NodePlace, dictionary: ObjectDictionary) -> None:
        """Show the objects of a node."""
        self.node, self._dictionary = node, dictionary
        self.show(self._machine)

    def show(self, machine: MachineShown) -> None:
        self._machine = machine
        if self.node is None or self._dictionary is None:
            self._node.update(Text("Choose a node in view 1.", style="dim"))
            return
        wanted = self._line.value.strip().lower()
        values = {place: read for place, read in machine.objects.items() if (place.net, place.node_id) == self.node}
        made = (self.node, id(self._dictionary), wanted, tuple(values.items()))
        if made != self._made:
            self._made = made
            self._fill(self._dictionary, wanted, values)
        self._tell_detail()

    def _fill(self, dictionary: ObjectDictionary, wanted: str, values: dict[WatchedObject, ReadObject]) -> None:
        assert self.node is not None
        found = [each for each in dictionary if wanted in f"{place_text(each.index, each.subindex)} {each.label}".lower()]
        rows = []
        for each in found:
            read = values.get(WatchedObject(*self.node, each.index, each.subindex))
            value = cell(
                "" if read is None else read.problem or read.text, "red" if read is not None and read.problem else "bold"
            )
            cells = (
                cell(place_text(each.index, each.subindex)),
                cell(object_name(dictionary, each)),
                cell(each.data_type.name),
                cell(str(each.access)),
                value,
            )
            rows.append(((each.index, each.subindex), cells))
        self._rows.fill(rows)
        head = f"{node_text(self.node.node_id)} on {clean(self.node.net)}: {counted(len(found), 'object')}"
        self._node.update(Text(head, style="bold", no_wrap=True, overflow="ellipsis"))

    def _tell_detail(self) -> None:
        place, variable = self.place, self.variable
        text = ""
        if place is not None and variable is not None and self._dictionary is not None:
            read = self._machine.objects.get(place)
            value = "not read yet" if read is None else read.problem or read.text
            constants = ", ".join(each.name for each in self._dictionary.constants_of(variable))
            text = f"{place_text(place.index, place.subindex)} {clean(object_name(self._dictionary, variable))}: {value}"
            if constants:
                text += f"\n{clean(constants)}"
        self._detail.update(Text(text))

    @on(Input.Changed)
    def search(self, event: Input.Changed) -> None:
        """Show what fits."""
        event.stop()
        self.show(self._machine)

    @on(Input.Submitted)
    def end_search(self, event: Input.Submitted) -> None:
        """Give the keys back to the table."""
        event.stop()
        self.focus_first()

    @on(Rows.RowHighlighted)
    def tell(self) -> None:
        """Show the object at the cursor."""
        self._tell_detail()

    @property
    def place(self) -> WatchedObject | None:
        """The object at the cursor."""
        chosen = self._rows.chosen
        return None if chosen is None or self.node is None else WatchedObject(*self.node, *chosen)

    @property
    def variable(self) -> Variable | None:
        """Its description."""
        place = self.place
        return None if place is None or self._dictionary is None else self._dictionary.get(place.index, place.subindex)

    @property
    def name_of_object(self) -> str:
        """Its name; "" if there is none."""
        variable = self.variable
        return "" if variable is None or self._dictionary is None else object_name(self._dictionary, variable)

    @property
    def value(self) -> str:
        """Its value, as it was read last; "" if it was not."""
        read = None if self.place is None else self._machine.objects.get(self.place)
        return "" if read is None else read.text


class EventsView(Pane):
    """Emergencies, boot-ups, states and lost heartbeats."""

    name_shown = "Emergencies"
    keys = "a all events / emergencies only"

    def compose(self) -> ComposeResult:
        """A table, the newest row first."""
        columns = (
            RowsColumn("Time", 8),
            RowsColumn("Node", 11),
            RowsColumn("Kind", 9),
            RowsColumn("What", 0),
            RowsColumn("Register", 8, right=True, wide_only=70),
            RowsColumn("Maker's bytes", 14, wide_only=WIDE),
        )
        self._note = Static("", id="events-note")
        yield self._note
        self._rows = Rows(columns, id="events-rows")
        yield self._rows

    def on_mount(self) -> None:
        """All events are shown at first."""
        self.only_emergencies = False

    def show(self, machine: MachineShown) -> None:
        kinds = ("emergency",) if self.only_emergencies else ()
        chosen = [each for each in reversed(machine.events) if not kinds or each["kind"] in kinds]
        rows = []
        for number, each in enumerate(chosen):
            is_emergency = each["kind"] == "emergency"
            what = f"{each['code']} {each['text']}" if is_emergency else each["text"]
            cells = (
                cell(time.strftime("%H:%M:%S", time.localtime(each["time"]))),
                cell(f"{each['node']} (0x{each['node']:02X})"),
                cell(each["kind"], EVENT_STYLES.get(each["kind"], "")),
                cell(what, EVENT_STYLES.get(each["kind"], "") if is_emergency else ""),
                cell(f"0x{each['register']:02X}" if is_emergency else ""),
                cell(each.get("vendor", "")),
            )
            rows.append((number, cells))
        self._rows.fill(rows)
        count = sum(each["kind"] == "emergency" for each in machine.events)
        told = f"the last {counted(len(machine.events), 'event')}, the newest first; emergencies: {count}"
        self._note.update(Text(told if machine.events else "Nothing has happened yet.", style="dim"))


class ValuesView(Pane):
    """Watched objects, live."""

    name_shown = "Values"
    keys = "w watch no longer  (w in view 2 adds an object)"

    def compose(self) -> ComposeResult:
        """A table."""
        columns = (
            RowsColumn("Node", 11),
            RowsColumn("Object", 0),
            RowsColumn("Value", 0),
            RowsColumn("Least", 10, right=True, wide_only=100),
            RowsColumn("Most", 10, right=True, wide_only=100),
            RowsColumn("Age", 6, right=True, wide_only=100),
            RowsColumn("Curve", CURVE_WIDTH, wide_only=WIDE),
        )
        self._note = Static("", id="values-note")
        yield self._note
        self._rows = Rows(columns, id="values-rows")
        yield self._rows

    def show(self, machine: MachineShown) -> None:
        rows = []
        for each in machine.values:
            place = each.place
            cells = (
                cell(f"{place.node_id} (0x{place.node_id:02X})"),
                cell(f"{place_text(place.index, place.subindex)} {each.name}"),
                cell(each.problem or each.text, "red" if each.problem else "bold"),
                cell("" if each.least is None else f"{each.least:.6g}"),
                cell("" if each.most is None else f"{each.most:.6g}"),
                cell("" if each.age is None else f"{each.age:.1f} s"),
                cell(small_curve(each.curve)),
            )
            rows.append((place, cells))
        self._rows.fill(rows)
        note = "" if rows else "Nothing is watched yet: press w at an object in view 2."
        self._note.update(Text(note, style="dim"))

    @property
    def chosen(self) -> WatchedObject | None:
        """The object at the cursor."""
        place: WatchedObject | None = self._rows.chosen
        return place


class TrafficLines(Static, can_focus=True):
    """The last lines that fit."""


class TrafficView(Pane):
    """What passes on the nets, in words; and what is wrong."""

    name_shown = "Traffic"
    keys = "p hold  / filter  ! findings only  Up Down scroll, held"

    def compose(self) -> ComposeResult:
        """A line to filter by, and the lines."""
        self._line = Input(placeholder="filter: 5, sdo, statusword", compact=True, id="traffic-filter", select_on_focus=False)
        yield self._line
        self._lines = TrafficLines("", id="traffic-lines")
        yield self._lines

    def on_mount(self) -> None:
        """All lines go by at first."""
        self.only_findings = False
        self.held: tuple[FeedRow, ...] | None = None
        self._back = 0
        self._machine = MachineShown()

    def hold(self) -> None:
        """Hold the lines, or let them go on."""
        self.held = self._machine.traffic if self.held is None else None
        self._back = 0
        self.show(self._machine)

    def scroll_lines(self, lines: int) -> None:
        """Go back in what is held. lines: below 0: forward."""
        if self.held is None:
            self.hold()
        self._back = max(0, self._back + lines)
        self.show(self._machine)

    def show(self, machine: MachineShown) -> None:
        self._machine = machine
        shown = self._lines
        width, height = shown.size
        if not height:
            return
        lines = [each for each in self.held if self._fits(each)] if self.held is not None else None
        if lines is None:
            lines = last_fitting(machine.traffic, self._fits, height)
        self._back = min(self._back, max(0, len(lines) - height))
        end = len(lines) - self._back
        picture = Text(no_wrap=True, overflow="ellipsis")
        for each in lines[max(0, end - height) : end]:
            picture.append_text(traffic_text(each, width))
            picture.append("\n")
        if not lines:
            picture.append("No such frame yet." if self._wanted or self.only_findings else "No frame yet.", style="dim")
        shown.update(picture)

    @property
    def _wanted(self) -> str:
        return self._line.value.strip().lower()

    def _fits(self, line: FeedRow) -> bool:
        if self.only_findings and line.kind != "finding":
            return False
        wanted = self._wanted
        if wanted.isdecimal() and len(wanted) < 4:
            return line.node_id == int(wanted)
        return wanted in f"{line.service} {line.text}".lower()

    @on(Input.Changed)
    def filter(self, event: Input.Changed) -> None:
        """Show what fits."""
        event.stop()
        self.show(self._machine)

    @on(Input.Submitted)
    def end_filter(self, event: Input.Submitted) -> None:
        """Give the keys back to the lines."""
        event.stop()
        self.focus_first()


class DrivesView(Pane):
    """The drives: what they show, and why they do not move."""

    name_shown = "Drives"
    keys = "h halt this drive  H halt all  r look again"

    def compose(self) -> ComposeResult:
        """A table, and the drive at the cursor."""
        columns = (
            RowsColumn("Node", 11),
            RowsColumn("State", 22),
            RowsColumn("Mode", 24, wide_only=WIDE),
            RowsColumn("Why it does not move", 0),
        )
        self._rows = Rows(columns, id="drives-rows")
        yield self._rows
        self._detail = Static("", id="drives-detail")
        yield self._detail

    def on_mount(self) -> None:
        """Nothing was read yet."""
        self._machine = MachineShown()

    def show(self, machine: MachineShown) -> None:
        self._machine = machine
        rows = []
        for each in machine.drives:
            name = f"{each.place.node_id} (0x{each.place.node_id:02X})" + (f".{each.axis}" if each.axis else "")
            if each.data is None:
                cells = (cell(name), cell("no answer", "red"), cell(""), cell(each.problem, "red"))
            else:
                why = each.data["reasons"][0]["what"] if each.data["reasons"] else "nothing keeps it from moving"
                style = "green" if not each.data["reasons"] else ""
                fault = "bold red" if each.data["error"] else "bold"
                cells = (cell(name), cell(each.data["state"], fault), cell(each.data["mode"] or ""), cell(why, style))
            rows.append(((each.place, each.axis), cells))
        self._rows.fill(rows)
        self._tell_detail()

    def _tell_detail(self) -> None:
        drive = self.chosen
        if drive is None:
            text = Text("No drive has answered yet. Drives are looked for among the nodes of view 1.", style="dim")
        elif drive.data is None:
            text = Text(drive.problem)
        else:
            text = drive_text(drive.data)
        self._detail.update(text)

    @on(Rows.RowHighlighted)
    def tell(self) -> None:
        """Show the drive at the cursor."""
        self._tell_detail()

    @property
    def chosen(self) -> DriveShown | None:
        """The drive at the cursor."""
        chosen = self._rows.chosen
        return next((each for each in self._machine.drives if (each.place, each.axis) == chosen), None)


VIEWS: Final[Sequence[type[Pane]]] = (NodesView, ObjectsView, EventsView, ValuesView, TrafficView, DrivesView)


def last_fitting(lines: Sequence[FeedRow], fits: Callable[[FeedRow], bool], count: int) -> list[FeedRow]:
    """Return the last lines that fit, oldest first."""
    found: list[FeedRow] = []
    for each in reversed(lines):
        if fits(each):
            found.append(each)
            if len(found) == count:
                break
    return found[::-1]


def traffic_text(line: FeedRow, width: int) -> Text:
    """Return a line of the traffic, cut at a width."""
    if line.kind == "finding":
        text = Text(f"! {line.text}", style=FINDING)
    elif line.kind == "sum":
        of = f" of node {line.node_id}" if line.node_id else ""
        text = Text(f"= {line.service}{of}: {line.text}", style=SERVICE_STYLES.get(line.service.lower(), ""))
    else:
        frame = f"{line.frame:<25}" if width >= WIDE else f"{line.frame.partition('#')[0]:<3}"
        head = f"{line.seconds:10.3f} {frame} {line.service:<9} {line.node_id or '':>3}  "
        text = Text().append(head, style="dim")
        text.append(line.text, style=SERVICE_STYLES.get(line.service.lower(), "dim" if line.service in QUIET_SERVICES else ""))
    text.truncate(max(1, width), overflow="ellipsis")
    return text


def small_curve(numbers: Sequence[float]) -> str:
    """Return the curve of some numbers, one line high."""
    if len(numbers) < 2:
        return ""
    points = ((place / (len(numbers) - 1), number, number) for place, number in enumerate(numbers))
    return curve(points, CURVE_WIDTH, 1, gap=1.0)[0][0]


def drive_text(data: Plain) -> Text:
    """Return a drive in words. data: as plain_data.view_data has it."""
    text = Text().append(data["state"], style="bold")
    if data["shown"]:
        text.append(f"  {clean(data['shown'])}", style="dim")
    if data["error"]:
        text.append(f"\nerror {data['error']['code']} {clean(data['error']['text'])}", style="bold red")
    for each in data["reasons"]:
        text.append(f"\n- {clean(each['what'])}")
        if each["remedy"]:
            text.append(f"\n  try: {clean(each['remedy'])}", style="dim")
    return text


def object_name(dictionary: ObjectDictionary, variable: Variable) -> str:
    """Return the name of an object, with that of its record or array before it."""
    holder = dictionary.objects.get(variable.index)
    if holder is None or len(holder.variables) == 1 or variable.name.startswith(holder.name):
        return variable.name
    return f"{holder.name}: {variable.name}"


def known(places: Iterable[Plain]) -> list[NodePlace]:
    """Return the nodes of all nets, in order. places: nets, as plain_data has them."""
    return [NodePlace(net["name"], node["node"]) for net in places for node in net["nodes"]]
