"""`MachineView`: the program of `canopen tui`: a line of tabs, a view, a line of notices, a line of keys.

It looks at a MachineWatch a few times a second, and asks it for what its user wants. Nothing is written or commanded by one key:
each write is a value to be typed, and then `yes`, in full. Only a halt is not asked about: it stops, and moves nothing.
"""

from __future__ import annotations

from functools import partial
from time import monotonic
from typing import ClassVar, Final, Protocol

from rich.text import Text
from textual import on
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.driver import Driver
from textual.widgets import ContentSwitcher, DataTable, Input, Static

from canopen_cli.shared.screen import counted, node_text
from canopen_cli.tui.machine_watch import REFRESH, MachineWatch, refusal_text
from canopen_cli.tui.questions import YES, Ask, KeysPage
from canopen_cli.tui.shown import MachineShown, NodePlace
from canopen_cli.tui.views import (
    VIEWS,
    DrivesView,
    EventsView,
    NodesView,
    ObjectsView,
    Pane,
    TrafficView,
    ValuesView,
    known,
    object_name,
)
from canopen_gateway import NotAllowedError, Permission, WatchedObject, permission_to_write
from canopen_gateway.nmt_words import NMT_COMMANDS
from canopen_gateway.plain_data import place_text
from canopen_master.plain_text import clean

NOTICE_TIME: Final = 8.0
"""Seconds for which a notice stands."""

HELP: Final = """\
1 to 6, Tab   nodes, objects, emergencies, values, traffic, drives
Up, Down ...  the cursor; also PageUp, PageDown, Home, End
Enter         nodes: its objects; objects: read
/             search, filter; Enter or Esc ends it
[ ]           objects: of the node before, of the next one
f             ask all node-IDs who is there, and for their names
e             write an object: asks for its value, then for "yes"
n             NMT command to a node: asks for it, then for "yes"
w             watch an object live, or no longer
p             hold the traffic; Up and Down scroll it
!             traffic: only what is wrong
a             emergencies alone, or all events
h, H          halt the drive at the cursor; halt all drives
              at once, without a question, without --allow
F12           halt all drives, also while you type
r             read again
q, Ctrl-C     end

--allow names what may be written, as for `canopen serve`.
This is no emergency stop."""


class Shows(Protocol):
    """A place whose text is set."""

    def update(self, content: Text) -> None: ...


class MachineView(App[None]):
    """See this module's text."""

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { layout: vertical; }
    #title, #tabs, #keys { height: 1; }
    #notice { height: auto; max-height: 3; }
    #title { text-style: bold; }
    ContentSwitcher { height: 1fr; }
    Pane { height: 1fr; }
    Rows { height: 1fr; scrollbar-size-horizontal: 0; scrollbar-size-vertical: 1; }
    TrafficLines { height: 1fr; }
    Input { width: 1fr; }
    #objects-detail, #drives-detail { height: auto; max-height: 50%; }
    #objects-node, #events-note, #values-note, #nodes-note { height: auto; }
    Ask, KeysPage { align: center middle; }
    #question, #page { width: 72; max-width: 100%; height: auto; max-height: 100%; padding: 0 1; border: solid ansi_default; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c,ctrl+q", "leave", "end", priority=True),
        Binding("q", "leave", "end"),
        Binding("ctrl+z", "nothing", show=False, priority=True),  # a view that is stopped would leave the drives as they are
        *(Binding(str(number), f"view({number})") for number in range(1, len(VIEWS) + 1)),
        Binding("tab", "step(1)", priority=True),
        Binding("shift+tab", "step(-1)", priority=True),
        Binding("escape", "leave_line"),
        Binding("question_mark", "help"),
        Binding("slash", "search"),
        Binding("left_square_bracket", "node(-1)"),
        Binding("right_square_bracket", "node(1)"),
        Binding("f", "find"),
        Binding("e", "write"),
        Binding("n", "nmt"),
        Binding("w", "watch"),
        Binding("p", "hold"),
        Binding("a", "all_events"),
        Binding("exclamation_mark", "findings"),
        Binding("r", "read"),
        Binding("h", "halt"),
        Binding("H", "halt_all"),
        Binding("f12", "halt_all", priority=True),  # also while something is typed
        Binding("up", "scroll_lines(1)"),
        Binding("down", "scroll_lines(-1)"),
        Binding("pageup", "scroll_lines(10)"),
        Binding("pagedown", "scroll_lines(-10)"),
    ]

    def __init__(self, watch: MachineWatch, name: str) -> None:
        """name: of the bus or the machine."""
        super().__init__(ansi_color=True)
        self.theme = "textual-ansi" if "textual-ansi" in self.available_themes else self.theme
        self._watch = watch
        self._machine_name = clean(name)
        self._at = 0
        self._noticed = 0.0

    def compose(self) -> ComposeResult:
        """What stands on the screen, from the top."""
        yield Static("", id="title")
        yield Static("", id="tabs")
        with ContentSwitcher(initial="view-1"):
            for number, made in enumerate(VIEWS, 1):
                yield made(id=f"view-{number}")
        yield Static("", id="notice")
        yield Static("", id="keys")

    def on_mount(self) -> None:
        """Begin with the nodes."""
        self.action_view(1)
        self.set_interval(REFRESH, self.look)

    def get_driver_class(self) -> type[Driver]:
        """Return the driver of this system, whose thread goes on after bytes that are no text."""
        found = super().get_driver_class()

        class PatientDriver(found):  # type: ignore[misc, valid-type]
            def run_input_thread(self) -> None:
                while True:
                    try:
                        super().run_input_thread()
                    except UnicodeDecodeError:
                        continue
                    return

        return PatientDriver

    # ---- what is shown ----

    @property
    def machine(self) -> MachineShown:
        """The machine as it is now."""
        return self._watch.shown

    @property
    def view(self) -> Pane:
        """The view that is shown."""
        return self.query_one(f"#view-{self._at}", Pane)

    def look(self) -> None:
        """Show the machine as it is now."""
        if not self.is_running:  # it ends: the views go first, and the interval that calls this goes last
            return
        machine = self.machine
        self.view.show(machine)
        self._tell_title(machine)
        if self._watch.notices:
            text, is_error = self._watch.notices.popleft()
            self.tell(text, is_error=is_error)
        elif self._noticed and monotonic() - self._noticed > NOTICE_TIME:
            self._noticed = 0.0
            self._place("#notice").update(Text(""))

    def tell(self, text: str, *, is_error: bool = False) -> None:
        """Show a notice for a while."""
        self._noticed = monotonic()
        self._place("#notice").update(Text(text, style="bold red" if is_error else "bold green"))

    def _tell_title(self, machine: MachineShown) -> None:
        title = Text(no_wrap=True, overflow="ellipsis")
        title.append(f"canopen  {self._machine_name}  ", style="bold")
        title.append(machine.mode, style="" if machine.mode == "read-only" else "bold yellow")
        for net in machine.nets:
            if net["state"] != "error-active" or net["outage"]:
                title.append(f"  {clean(net['name'])}: {net['state']} {clean(net['outage'] or '')}".rstrip(), style="bold red")
        if machine.lease.get("owner"):
            title.append(f"  moved by {clean(machine.lease['owner'])}", style="bold yellow")
        title.append(f"  {machine.rate:.0f} frames/s")
        if machine.load is not None:
            title.append(f"  load {machine.load:.0%}")
        if machine.findings:
            title.append(f"  {counted(machine.findings, 'finding')}", style="bold red")
        self._place("#title").update(title)

    def _tell_tabs(self) -> None:
        tabs = Text(no_wrap=True, overflow="ellipsis")
        for number, made in enumerate(VIEWS, 1):
            tabs.append(f" {number} {made.name_shown} ", style="reverse bold" if number == self._at else "")
            tabs.append(" ")
        self._place("#tabs").update(tabs)
        keys = f"{self.view.keys}  ? keys  q end".strip()
        self._place("#keys").update(Text(keys, style="dim", no_wrap=True, overflow="ellipsis"))

    def _place(self, name: str) -> Shows:
        return self.screen_stack[0].query_one(name, Static)

    # ---- keys ----

    def action_nothing(self) -> None:
        """Do nothing."""

    def action_leave(self) -> None:
        """End the view."""
        self.exit()

    def action_view(self, number: int) -> None:
        """Show another view."""
        self._at = number
        self.query_one(ContentSwitcher).current = f"view-{number}"
        if isinstance(self.view, ObjectsView) and self.view.node is None:
            self._choose(self._known_nodes()[:1])
        self._watch.look_at_drives(isinstance(self.view, DrivesView))
        self._tell_tabs()
        self.look()
        self.view.focus_first()

    def action_step(self, step: int) -> None:
        """Show the next view, or the one before."""
        if len(self.screen_stack) == 1:
            self.action_view((self._at - 1 + step) % len(VIEWS) + 1)

    def action_leave_line(self) -> None:
        """Leave the line that is typed in."""
        self.view.focus_first()

    def action_help(self) -> None:
        """Show all keys."""
        self.push_screen(KeysPage(HELP))

    def action_search(self) -> None:
        """Type what is searched for."""
        for line in self.view.query(Input):
            line.focus()

    def action_find(self) -> None:
        """Ask who is there."""
        self._watch.ask_find()

    def action_node(self, step: int) -> None:
        """Show the objects of another node."""
        nodes = self._known_nodes()
        if isinstance(self.view, ObjectsView) and nodes:
            at = nodes.index(self.view.node) if self.view.node in nodes else -step
            self._choose([nodes[(at + step) % len(nodes)]])

    def action_read(self) -> None:
        """Read what is at the cursor."""
        if isinstance(self.view, ObjectsView) and self.view.place is not None:
            self._read(self.view.place)
        elif isinstance(self.view, DrivesView):
            self._watch.look_at_drives(True)

    def action_watch(self) -> None:
        """Watch what is at the cursor, or no longer."""
        view = self.view
        if isinstance(view, ObjectsView) and view.place is not None and view.variable is not None:
            self._watch.ask_watch(view.place, clean(view.name_of_object))
            self.tell(f"{place_text(view.place.index, view.place.subindex)}: see view 4; w again ends it")
        elif isinstance(view, ValuesView) and view.chosen is not None:
            self._watch.ask_watch(view.chosen, "")

    def action_hold(self) -> None:
        """Hold the traffic, or let it go on."""
        if isinstance(self.view, TrafficView):
            self.view.hold()
            self.tell("held: p lets it go on" if self.view.held is not None else "it goes on")

    def action_scroll_lines(self, lines: int) -> None:
        """Go back, or forward, in the traffic."""
        if isinstance(self.view, TrafficView):
            self.view.scroll_lines(lines)

    def action_findings(self) -> None:
        """Show only what is wrong, or all."""
        if isinstance(self.view, TrafficView):
            self.view.only_findings = not self.view.only_findings
            self.tell("only what is wrong" if self.view.only_findings else "all frames")
            self.look()

    def action_all_events(self) -> None:
        """Show only emergencies, or all events."""
        if isinstance(self.view, EventsView):
            self.view.only_emergencies = not self.view.only_emergencies
            self.tell("only emergencies" if self.view.only_emergencies else "all events")
            self.look()

    def action_halt(self) -> None:
        """Halt the drive at the cursor."""
        if isinstance(self.view, DrivesView) and self.view.chosen is not None:
            self._watch.ask_halt(self.view.chosen.place)

    def action_halt_all(self) -> None:
        """Halt everything; and each drive that is shown."""
        self._watch.ask_halt(None)

    @on(DataTable.RowSelected)
    def enter(self, event: DataTable.RowSelected) -> None:
        """Enter, or a click, on a row."""
        event.stop()
        if isinstance(self.view, NodesView) and self.view.chosen is not None:
            self._choose([self.view.chosen])
            self.action_view(2)
        elif isinstance(self.view, ObjectsView):
            self.action_read()

    # ---- what is asked about ----

    def action_write(self) -> None:
        """Write the object at the cursor: ask for its value, and again."""
        view = self.view
        if not isinstance(view, ObjectsView) or view.place is None or view.variable is None:
            return
        place, variable = view.place, view.variable
        try:
            self._watch.service.guard.require_write(place.index, place.subindex)
        except NotAllowedError as error:
            self.tell(refusal_text(error), is_error=True)
            return
        if not variable.access.writable:
            self.tell(f"{clean(variable.label)} is {variable.access}: it cannot be written", is_error=True)
            return
        question = f"{node_text(place.node_id)}: a new value of {place_text(place.index, place.subindex)} {variable.label}"
        before = view.value or "not read yet"
        self.push_screen(Ask(question, f"{variable.data_type.name}; it is {before}"), partial(self._confirm_write, place, before))

    def _confirm_write(self, place: WatchedObject, before: str, value: str | None) -> None:
        if not value:
            return
        moves = permission_to_write(place.index, place.subindex) is Permission.MOTION
        question = f"{node_text(place.node_id)}: write {place_text(place.index, place.subindex)}: {before} -> {value}"
        more = "This may move a drive. Is everybody away from it?\n" if moves else ""

        def answered(answer: str | None) -> None:
            if self._is_yes(answer):
                self._watch.ask_write(place, value)

        self.push_screen(Ask(question, f"{more}Type {YES} to send it."), answered)

    def action_nmt(self) -> None:
        """Send an NMT command to the node at the cursor: ask which, and again."""
        if not isinstance(self.view, NodesView) or self.view.chosen is None:
            return
        place = self.view.chosen
        try:
            self._watch.service.guard.require(Permission.NMT, "an NMT command")
        except NotAllowedError as error:
            self.tell(refusal_text(error), is_error=True)
            return
        self.push_screen(
            Ask(f"{node_text(place.node_id)}: which NMT command?", ", ".join(NMT_COMMANDS)), partial(self._confirm_nmt, place)
        )

    def _confirm_nmt(self, place: NodePlace, word: str | None) -> None:
        if not word:
            return
        if word not in NMT_COMMANDS:
            self.tell(f"{clean(word)!r} is no NMT command", is_error=True)
            return

        def answered(answer: str | None) -> None:
            if self._is_yes(answer):
                self._watch.ask_nmt(place, word)

        more = "A drive that moves loses its commands by it.\n" if word != "start" else ""
        self.push_screen(Ask(f"{node_text(place.node_id)}: {word}", f"{more}Type {YES} to send it."), answered)

    def _is_yes(self, answer: str | None) -> bool:
        if answer == YES:
            return True
        self.tell("nothing was sent")
        return False

    # ---- of nodes ----

    def _known_nodes(self) -> list[NodePlace]:
        return known(self.machine.nets)

    def _choose(self, nodes: list[NodePlace]) -> None:
        for node in nodes:
            dictionary = self._watch.service.node(*node).dictionary
            self.query_one(ObjectsView).choose(node, dictionary)

    def _read(self, place: WatchedObject) -> None:
        dictionary = self._watch.service.node(place.net, place.node_id).dictionary
        variable = dictionary.get(place.index, place.subindex)
        name = "" if variable is None else clean(object_name(dictionary, variable))
        self.tell(f"reading {place_text(place.index, place.subindex)} {name} ...")
        self._watch.ask_read(place)
