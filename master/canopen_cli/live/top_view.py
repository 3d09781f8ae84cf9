"""The picture of `canopen top`: a bus, its nodes, its last emergencies and findings. Pure: text of a given size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from canopen_cli.live.watch_view import age_text, line
from canopen_cli.shared.screen import counted
from canopen_master.plain_text import clean
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtState
from canopen_proto.observer.bus_view import BusFigures, Emergency, Intervals, NodeFigures
from canopen_transports.errors import BusState
from canopen_transports.locator import bitrate_text

SILENT: Final = 3 * SECOND
"""A node without a heartbeat is shown as silent after this time."""
MISSED: Final = 3
"""A node with a heartbeat is shown as silent after so many of its periods."""
MOST_EVENTS: Final = 4
"""Lines for emergencies and findings, where the nodes need the others."""
KEYS: Final = "q end   p pause   s sort"
GAP: Final = 1


class BusShown(NamedTuple):
    """A bus as it is shown. now: of its frames, ns. last: the time of its last frame. bitrate: bit/s; 0: not known."""

    name: str
    figures: BusFigures
    now: Time
    last: Time
    bitrate: int


class TopView(NamedTuple):
    """All that is shown. source: the bus or file. buses: one at least. chosen: the one that is shown. sort: see SORTS.

    notes: what else has happened, each in one line. bus_state: what a live bus has said last; None if it has said nothing.
    """

    source: str
    buses: tuple[BusShown, ...]
    chosen: int = 0
    sort: str = "node"
    notes: tuple[str, ...] = ()
    bus_state: BusState | None = None


def is_silent(node: NodeFigures, now: Time) -> bool:
    """Return whether a node was not heard for longer than its heartbeat, or than SILENT, allows."""
    return node.last_heard is None or now - node.last_heard > _patience(node)


def is_old(node: NodeFigures, now: Time) -> bool:
    """Return whether a node said its state so long ago that it may have another one now."""
    return node.state_at is None or now - node.state_at > _patience(node)


def _patience(node: NodeFigures) -> Time:
    return SILENT if node.heartbeat is None else max(SECOND, round(MISSED * node.heartbeat.mean))


SORTS: Final[dict[str, Callable[[NodeFigures], Any]]] = {
    "node": lambda node: node.node_id,
    "load": lambda node: (-node.bits_per_second, node.node_id),
    "silence": lambda node: (-1 if node.last_heard is None else node.last_heard, node.node_id),
    "errors": lambda node: (-len(node.errors), -node.aborts, node.node_id),
}
"""The orders of the nodes, in the order in which s chooses them."""


def picture(view: TopView, width: int, height: int, paused: float | None = None) -> RenderableType:
    """Return the whole picture. width, height: of the terminal. paused: seconds for which it stands still; None: it goes on."""
    shown = view.buses[view.chosen]
    head = _head(view, shown, width, paused)
    keys = KEYS + ("   b next bus" if len(view.buses) > 1 else "")
    foot = _absent(shown, width) + [line(note, width, "yellow") for note in view.notes] + [line(keys, width, "dim")]
    room = height - len(head) - len(foot) - 1
    events = _events(shown, width)
    nodes = _heard(shown, view.sort)
    all_of_them = len(nodes)
    for_nodes = max(1, min(len(nodes), room - min(len(events), MOST_EVENTS)))
    cut = len(nodes) - for_nodes
    if cut > 0:
        nodes = nodes[: max(0, for_nodes - 1)]
        cut = all_of_them - len(nodes)
    body: list[RenderableType] = [*head, _table(nodes, shown, view.sort, width)]
    used = len(nodes)
    if cut > 0:
        body.append(line(f"... {counted(cut, 'node')} more: the terminal is too low", width, "yellow"))
        used += 1
    events = events[: max(0, room - used)]
    blank = max(0, room - used - len(events))
    return Group(*body, *[Text("")] * blank, *events, *foot)


def plain(view: TopView, width: int) -> RenderableType:
    """Return the tables of all buses, as they are printed once."""
    pieces: list[RenderableType] = []
    for number, shown in enumerate(view.buses):
        if number:
            pieces.append(Text(""))
        pieces += [
            *_head(view._replace(chosen=number), shown, width, None),
            _table(_heard(shown, view.sort), shown, view.sort, width),
            *_events(shown, width),
            *_absent(shown, width),
        ]
    return Group(*pieces, *(line(note, width, "yellow") for note in view.notes))


# ---- the bus ----


def _head(view: TopView, shown: BusShown, width: int, paused: float | None) -> list[Text]:
    figures = shown.figures
    several = f" ({view.chosen + 1} of {len(view.buses)})" if len(view.buses) > 1 else ""
    right = f"{figures.frames_per_second} frames/s, {_load_text(shown)}"
    if paused is not None:
        right = f" PAUSED {paused:.0f} s AGO "
    source = clean(view.source if shown.name in view.source else f"{view.source} {shown.name}")
    over = cell_len(source) + len(several) + 2 + len(right) - width
    source = f"…{source[over + 1 :]}" if over > 0 else source
    left = f"{source}{several}"
    gap = max(2, width - cell_len(left) - len(right))
    first = line(f"{left}{' ' * gap}{right}", width)
    first.stylize("bold", 0, len(source))
    if paused is not None:
        first.stylize("reverse", len(left) + gap)
    silence = shown.now - shown.last
    second = _sync_text(shown)
    if silence > SILENT:
        second = f"NOTHING HEARD FOR {age_text(silence)}"
    wrong = ", ".join(f"{count} x {rule}" for rule, count in sorted(figures.found.items(), key=lambda each: -each[1]))
    third = f"{counted(figures.frames, 'frame')} in {age_text(figures.elapsed)}, SDO: {counted(figures.transfers, 'value')}"
    third += f", {counted(figures.aborts, 'abort')}" if figures.aborts else ""
    return [
        first,
        line(second, width, "bold yellow" if silence > SILENT else ""),
        line(f"{third}   wrong: {wrong}" if wrong else third, width, "yellow" if wrong else ""),
    ]


def _load_text(shown: BusShown) -> str:
    figures = shown.figures
    if figures.load is None or figures.peak is None:
        return f"{figures.bits_per_second / 1000:.3g} kbit/s"
    return f"load {figures.load:.1%} of {bitrate_text(shown.bitrate)}, peak {figures.peak:.1%}"


def _sync_text(shown: BusShown) -> str:
    figures = shown.figures
    if figures.sync_at is None:
        return "no SYNC"
    age = shown.now - figures.sync_at
    sync = figures.sync
    if sync is None:
        return f"one SYNC, {age_text(age)} ago"
    if age > max(SECOND, round(MISSED * sync.mean)):
        return f"SYNC has stopped {age_text(age)} ago; it came each {_ms(sync.mean)} ms"
    return (
        f"SYNC each {_ms(sync.mean)} ms, from {_ms(sync.least)} to {_ms(sync.most)}, standard deviation {_ms(sync.deviation)} ms"
    )


def _ms(time: float) -> str:
    milliseconds = time / MILLISECOND
    return f"{milliseconds:.0f}" if milliseconds >= 100 else f"{milliseconds:.2f}"


# ---- its nodes ----


def state_text(node: NodeFigures) -> str:
    """Return the NMT state of a node, in words; "" if it is not known."""
    if node.state is None:
        return ""
    return node.state.name.lower().replace("_", "-") if isinstance(node.state, NmtState) else f"0x{node.state:02X}"


def _state_cell(node: NodeFigures, now: Time) -> str:
    """Return the state with how far it is known, in 19 characters at most."""
    word = state_text(node)
    if not word:
        return "SILENT" if is_silent(node, now) else "not known"
    if is_silent(node, now):
        return f"SILENT, {_SHORT.get(word, word)}"
    if not node.is_said:
        return f"told: {_SHORT.get(word, word)}"
    return f"was {_SHORT.get(word, word)}" if is_old(node, now) else word


_SHORT: Final = {"pre-operational": "pre-op", "initialising": "init"}


def _heard(shown: BusShown, sort: str) -> list[NodeFigures]:
    """Return the nodes for the table: those that have sent anything. A scan speaks to all 127."""
    return sorted((each for each in shown.figures.nodes if each.last_heard is not None), key=SORTS[sort])


def _absent(shown: BusShown, width: int) -> list[Text]:
    """Return a line with the node-IDs to which others have only spoken, if there are any."""
    ids = [each.node_id for each in shown.figures.nodes if each.last_heard is None]
    runs: list[list[int]] = []
    for node_id in ids:
        if runs and node_id == runs[-1][-1] + 1:
            runs[-1].append(node_id)
        else:
            runs.append([node_id])
    words = ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
    return [line(f"spoken to, and never heard: {words}", width, "dim")] if ids else []


def _table(nodes: Sequence[NodeFigures], shown: BusShown, sort: str, width: int) -> RenderableType:
    """Return the table of the nodes. Where it is too wide, columns are left out, which --json has."""
    load = "load %" if shown.bitrate else "bit/s"
    heads = ("node", "state", "heard", "heartbeat", "frames/s", load, "SDO", "aborts", "errors")
    sorted_by = {"node": "node", "load": load, "silence": "heard", "errors": "errors"}[sort]
    rows = [_cells(node, shown) for node in nodes]
    sizes = [max(map(cell_len, (name, *(row[place] for row in rows)))) for place, name in enumerate(heads)]
    used = [name != "aborts" or any(row[place] for row in rows) for place, name in enumerate(heads)]
    for place in (heads.index(name) for name in ("SDO", "heartbeat", load, "frames/s") if name != sorted_by):
        least = sum(size + GAP for size, is_used in zip(sizes, used, strict=True) if is_used) - GAP
        used[place] = used[place] and least <= width
    sizes[-1] = max(6, width - sum(size + GAP for size, is_used in zip(sizes[:-1], used, strict=False) if is_used))
    table = Table.grid(padding=(0, GAP, 0, 0))
    for name, size, is_used in zip(heads, sizes, used, strict=True):
        if is_used:
            is_text = name in ("node", "state", "errors")
            table.add_column(width=size, no_wrap=True, overflow="ellipsis", justify="left" if is_text else "right")
    table.add_row(
        *(
            Text(name, style="bold underline" if name == sorted_by else "bold")
            for name, is_used in zip(heads, used, strict=True)
            if is_used
        )
    )
    for node, row in zip(nodes, rows, strict=True):
        styled = zip(row, _styles(node, shown.now), used, strict=True)
        table.add_row(*(Text(cell, style=style) for cell, style, is_used in styled if is_used))
    return table


def _cells(node: NodeFigures, shown: BusShown) -> tuple[str, ...]:
    return (
        f"{node.node_id} (0x{node.node_id:02X})",
        _state_cell(node, shown.now),
        "never" if node.last_heard is None else age_text(shown.now - node.last_heard),
        _heartbeat_text(node.heartbeat),
        str(node.frames_per_second),
        f"{node.bits_per_second / shown.bitrate * 100:.1f}" if shown.bitrate else str(node.bits_per_second),
        str(node.transfers),
        str(node.aborts or ""),
        _errors_text(node),
    )


def _heartbeat_text(heartbeat: Intervals | None) -> str:
    if heartbeat is None:
        return ""
    deviation = heartbeat.deviation / MILLISECOND
    return f"{heartbeat.mean / MILLISECOND:.0f} ±{deviation:.{0 if deviation >= 9.5 else 1}f} ms"


def _errors_text(node: NodeFigures) -> str:
    words = [f"0x{code:04X}" for code in node.errors]
    if node.register and not words:
        words.append(f"register 0x{node.register:02X}")
    return ", ".join(words)


def _styles(node: NodeFigures, now: Time) -> tuple[str, ...]:
    if is_silent(node, now):
        return ("dim", "dim", "bold yellow", *["dim"] * 6)
    is_known = node.is_said and not is_old(node, now)
    state = _COLOURS.get(node.state, "yellow") if is_known else "dim"
    heartbeat = "dim" if is_old(node, now) else ""
    return ("bold", state, "dim", heartbeat, "", "", "", "yellow", "bold red")


_COLOURS: Final[dict[int | None, str]] = {NmtState.OPERATIONAL: "green", NmtState.STOPPED: "red"}


# ---- what has happened ----


def _events(shown: BusShown, width: int) -> list[Text]:
    """Return the last emergencies and findings, the newest first."""
    happened: list[tuple[Time, str, str]] = []
    for node in shown.figures.nodes:
        happened += [(each.time, _emergency_text(node.node_id, each), "red" if each.code else "") for each in node.emergencies]
    for time, finding in shown.figures.findings:
        who = f"node {finding.node_id}  " if finding.node_id else ""
        happened.append((time, f"{who}! {finding.rule}: {finding.text}", "yellow"))
    happened.sort(key=lambda each: -each[0])
    return [line(f"{age_text(shown.now - time):>6} ago  {text}", width, style) for time, text, style in happened]


def _emergency_text(node_id: int, emergency: Emergency) -> str:
    vendor = f"  {emergency.data.hex(' ')}" if any(emergency.data) else ""
    return f"node {node_id}  EMCY 0x{emergency.code:04X} {emergency.text}{vendor}"


# ---- for programs ----


def as_json(view: TopView) -> list[dict[str, Any]]:
    """Return all buses for a JSON document. Times in ns. `bus_state` and `notes` are those of the source, for all its buses."""
    state = None if view.bus_state is None else view.bus_state.value
    return [{**_bus_json(shown), "bus_state": state, "notes": list(view.notes)} for shown in view.buses]


def _bus_json(shown: BusShown) -> dict[str, Any]:
    figures = shown.figures
    document = {"bus": shown.name, "bitrate": shown.bitrate or None, **figures._asdict()}
    document["sync"] = None if figures.sync is None else figures.sync._asdict()
    document["findings"] = [{"time": time, **finding._asdict()} for time, finding in figures.findings]
    document["nodes"] = [_node_json(node, shown.now) for node in figures.nodes]
    return document


def _node_json(node: NodeFigures, now: Time) -> dict[str, Any]:
    document = {"node": node.node_id, **node._asdict(), "is_silent": is_silent(node, now), "is_old": is_old(node, now)}
    del document["node_id"]
    document["state"] = state_text(node) or None
    document["heartbeat"] = None if node.heartbeat is None else node.heartbeat._asdict()
    document["emergencies"] = [{**each._asdict(), "data": each.data.hex(), "text": each.text} for each in node.emergencies]
    return document
