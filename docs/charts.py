"""Draw the state charts of docs/charts, from the tables of the machines; where there is none, from what a machine does.

    python docs/charts.py [--into FOLDER]      all; a test compares them with what this would write

The places of the states are chosen here by hand. The arrows and their words are not: a new row of a table becomes a new arrow.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from html import escape
from itertools import pairwise
from math import hypot
from pathlib import Path
from typing import Final, NamedTuple

from canopen_proto import MILLISECOND, SECOND, DataType, Frame, LocalNode, NmtCommand, NmtState, Outbox, SdoClient
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.dictionary.model import Access
from canopen_proto.drives.cia402.states import POWERED, TRANSITIONS, Command, Occurrence, State
from canopen_proto.lss.messages import CONFIRM, LssAddress, LssService, LssState, message, number_message
from canopen_proto.lss.slave import LssSlave
from canopen_proto.nmt import SERVICES
from canopen_proto.nmt import TRANSITIONS as NMT_TRANSITIONS
from canopen_proto.nmt import Service as NmtService
from canopen_proto.sdo.transfer import TransferState

FOLDER: Final = Path(__file__).parent / "charts"
WIDTH, HEIGHT = 190, 44
"""Of a state's box, in the units of the picture."""
COLUMN, ROW = 250, 110
MARGIN: Final = 30
INK, GREY, BLUE, RED = "#243b53", "#627d98", "#0b6e99", "#ba2525"
ANY: Final = "any state"


class Arrow(NamedTuple):
    """A transition. words: what causes it."""

    source: str
    target: str
    words: str


class Chart(NamedTuple):
    """places: of each state, in columns and rows. marked: states drawn in blue. notes: below a state's name. bends: of
    arrows that go around others; positive: to the right of the way."""

    title: str
    places: Mapping[str, tuple[float, float]]
    arrows: tuple[Arrow, ...]
    marked: frozenset[str] = frozenset()
    notes: Mapping[str, str] = {}
    bends: Mapping[tuple[str, str], float] = {}


def merged(arrows: Iterable[Arrow], many: int = 4) -> tuple[Arrow, ...]:
    """Return one arrow for each pair of states, with all words. many: a cause that leads on from so many states goes from ANY."""
    rows = list(dict.fromkeys(arrows))
    sources: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        sources.setdefault((row.target, row.words), []).append(row.source)
    words: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        source = row.source if len(sources[row.target, row.words]) < many else ANY
        if row.words not in (known := words.setdefault((source, row.target), [])):
            known.append(row.words)
    return tuple(Arrow(source, target, ", ".join(each)) for (source, target), each in words.items())


def word(member: NmtCommand | Command | Occurrence | LssService) -> str:
    """Return the name of a command or an occurrence, for people."""
    return member.name.replace("_", " ").lower().replace("pre oper", "pre-oper")


# ---- the four machines ----


def nmt_chart() -> Chart:
    """The NMT states: their table, and the boot-up, which a node does by itself."""
    arrows = [Arrow(name(state), name(target), word(command)) for (state, command), target in NMT_TRANSITIONS.items()]
    arrows.append(Arrow(name(NmtState.INITIALISING), name(NmtState.PRE_OPERATIONAL), "boot-up, by itself"))
    notes = {
        name(state): ", ".join(
            each.value for each in NmtService if each in services and each.value not in ("NMT node control", "error control")
        )
        for state, services in SERVICES.items()
    }
    return Chart(
        "NMT",
        {
            name(NmtState.INITIALISING): (1, 0),
            name(NmtState.PRE_OPERATIONAL): (1, 1.2),
            name(NmtState.STOPPED): (0, 2.6),
            name(NmtState.OPERATIONAL): (2, 2.6),
            ANY: (2.5, 0),
        },
        merged((each for each in arrows if each.source != each.target), many=3),
        frozenset({name(NmtState.OPERATIONAL)}),
        notes,
    )


def name(state: NmtState) -> str:
    """Return an NMT state for people."""
    return state.name.replace("PRE_OPERATIONAL", "PRE-OPERATIONAL").lower()


def drive_chart() -> Chart:
    """The states of a drive (CiA 402). The numbers are those of the standard."""
    arrows = []
    for (source, trigger), (target, number) in TRANSITIONS.items():
        goes_down = (source, trigger) == (State.OPERATION_ENABLED, Command.SWITCH_ON)  # the same bits have two names
        arrows.append(Arrow(source, target, f"{number} {'disable operation' if goes_down else word(trigger)}"))
    places = {
        State.UNKNOWN: (1.4, 0),
        State.NOT_READY_TO_SWITCH_ON: (1.4, 1),
        State.SWITCH_ON_DISABLED: (1.4, 2),
        State.READY_TO_SWITCH_ON: (1.4, 3.4),
        State.SWITCHED_ON: (1.4, 4.8),
        State.OPERATION_ENABLED: (1.4, 6.2),
        State.QUICK_STOP_ACTIVE: (3.4, 5.2),
        State.FAULT_REACTION_ACTIVE: (3.4, 1),
        State.FAULT: (3.4, 2),
    }
    bends = {
        (State.SWITCHED_ON, State.SWITCH_ON_DISABLED): -125,
        (State.OPERATION_ENABLED, State.SWITCH_ON_DISABLED): -320,
        (State.OPERATION_ENABLED, State.READY_TO_SWITCH_ON): 190,
        (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE): 24,
        (State.QUICK_STOP_ACTIVE, State.OPERATION_ENABLED): 24,
    }
    named = {str(state): place for state, place in places.items()}
    named["off"] = named.pop(str(State.UNKNOWN))
    named[ANY] = (3.4, 0)
    arrows = [each._replace(source="off") if each.source == State.UNKNOWN else each for each in arrows]
    return Chart(
        "A drive (CiA 402)",
        named,
        merged(arrows),
        frozenset(map(str, POWERED)),
        bends={(str(a), str(b)): each for (a, b), each in bends.items()},
    )


ADDRESS: Final = LssAddress(1, 2, 3, 4)


def lss_chart() -> Chart:
    """The states of an LSS slave: what each service does to a device without a node-ID."""
    select = [number_message(LssService(LssService.SELECT_VENDOR + place), number) for place, number in enumerate(ADDRESS)]
    scan = [
        message(LssService.FASTSCAN, number.to_bytes(4, "little") + bytes((0, place, (place + 1) % 4)))
        for place, number in enumerate(ADDRESS)
    ]
    causes = {
        "switch state global (1)": [message(LssService.SWITCH_GLOBAL, b"\1")],
        "switch state global (0)": [message(LssService.SWITCH_GLOBAL, b"\0")],
        "switch state selective": select,
        "the end of a fastscan": [message(LssService.FASTSCAN, bytes(4) + bytes((CONFIRM, 0, 0))), *scan],
        "configure node-ID": [message(LssService.CONFIGURE_NODE_ID, b"\5")],
        "inquire": [message(LssService.INQUIRE_NODE_ID)],
        "identify": [message(LssService.IDENTIFY_NON_CONFIGURED)],
    }
    arrows = []
    for state in LssState:
        for words, frames in causes.items():
            slave = LssSlave(Outbox(), ADDRESS)
            slave.receive(Frame(0x7E5, message(LssService.SWITCH_GLOBAL, bytes((state,)))), 0)
            slave.out.frames.clear()
            for data in frames:
                slave.receive(Frame(0x7E5, data), 0)
            if slave.state is not state or slave.out.frames:  # it did something
                arrows.append(Arrow(state.name.lower(), slave.state.name.lower(), words))
    return Chart(
        "An LSS slave (CiA 305)", {"waiting": (0, 0), "configuration": (2.4, 0)}, merged(arrows), frozenset({"configuration"})
    )


def sdo_chart() -> Chart:
    """The states of a client's transfer: what happens in transfers with a device."""
    arrows = []
    for words, begin in TRANSFERS.items():
        states = list(run_transfer(begin))
        arrows += [Arrow(before, after, words) for before, after in pairwise(states) if before != after]
    arrows += [
        Arrow(state.value, TransferState.OVER.value, "abort, time-out")
        for state in TransferState
        if state is not TransferState.OVER
    ]
    places = {
        ANY: (3.2, 0),
        "over": (3.2, 1.2),
        "initiated": (0, 1.2),
        "segments": (0.9, 2.6),
        "ending": (3.2, 2.6),
        "sent": (2.05, 4),
        "held": (0, 4),
    }
    return Chart("A transfer of an SDO client", places, merged(arrows), frozenset({"over"}))


LARGE: Final = bytes(range(256)) * 8
TRANSFERS: Final[dict[str, Callable[[SdoClient], object]]] = {
    "up to 4 bytes": lambda client: client.upload(0x1000, 0, 0),
    "in segments": lambda client: client.upload(0x2000, 0, 0, block=False),
    "block read": lambda client: client.upload(0x2000, 0, 0, block=True),
    "block write": lambda client: client.download(0x2000, 0, LARGE, 0, block=True),
}


def run_transfer(begin: Callable[[SdoClient], object]) -> Iterator[str]:
    """Run a transfer with a device; yield the client's state behind each frame."""
    objects = [
        Object.of("type", [Variable(0x1000, 0, "type", DataType.UNSIGNED32, Access.RO, 1)]),
        Object.of("large", [Variable(0x2000, 0, "large", DataType.DOMAIN, Access.RW, LARGE)]),
    ]
    device = LocalNode(Outbox(), 5, ObjectDictionary(objects))
    device.boot(0)
    client = SdoClient(Outbox(), 5)
    begin(client)
    transfer = client._transfer  # its states are what is drawn
    assert transfer is not None
    yield transfer.state.value
    for now in range(0, SECOND, MILLISECOND):
        for machine in (device, client):
            machine.handle_timeout(now)
        for frame in taken(client.out.frames):
            device.receive(frame, now)
        yield transfer.state.value
        for frame in taken(device.out.frames):
            if frame.can_id == 0x585:
                client.receive(frame, now)
                yield transfer.state.value
        if transfer.state is TransferState.OVER:
            return
    raise AssertionError("the transfer does not end")


def taken(frames: list[Frame]) -> list[Frame]:
    """Return the frames, and forget them."""
    found = list(frames)
    frames.clear()
    return found


CHARTS: Final[dict[str, Callable[[], Chart]]] = {"nmt": nmt_chart, "cia402": drive_chart, "lss": lss_chart, "sdo": sdo_chart}


# ---- the picture ----


STYLE: Final = f"""\
text {{ text-anchor: middle; font: 12px sans-serif; fill: {GREY} }} .state {{ font-weight: 600; font-size: 14px }}
.note {{ font-size: 10px }} path.way {{ fill: none; stroke: {GREY}; stroke-width: 1.3; marker-end: url(#tip) }}
rect.state {{ fill: #f8fafc; stroke-width: 1.6 }} .gap {{ fill: white }}"""
TIP: Final = (
    '<marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
    f'<path d="M0 0L10 5L0 10z" fill="{GREY}"/></marker>'
)


def svg(chart: Chart) -> str:
    """Return a chart as SVG."""
    used = {each.source for each in chart.arrows} | {each.target for each in chart.arrows}
    missing = used - chart.places.keys()
    assert not missing, f"{chart.title}: no place for {missing}"
    centres = {
        state: (MARGIN + WIDTH / 2 + column * COLUMN, MARGIN + HEIGHT / 2 + row * ROW)
        for state, (column, row) in chart.places.items()
        if state in used
    }
    width = round(max(x for x, _ in centres.values()) + WIDTH / 2 + MARGIN)
    height = round(max(y for _, y in centres.values()) + HEIGHT / 2 + 2 * MARGIN)
    lines = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">',
        f"<title>{escape(chart.title)}</title>",
        f"<defs><style>{STYLE}</style>{TIP}</defs>",
        f'<rect width="{width}" height="{height}" class="gap"/>',
        *(_arrow(each, centres, chart) for each in chart.arrows),
        *(_box(state, centres[state], chart) for state in centres),
        "</svg>",
        "",
    )
    return "\n".join(lines)


def _box(state: str, centre: tuple[float, float], chart: Chart) -> str:
    x, y = centre
    note = chart.notes.get(state, "")
    color = BLUE if state in chart.marked else RED if "fault" in state else INK
    dashes = ' stroke-dasharray="5 4"' if state in (ANY, "off") else ""
    corner = f'x="{x - WIDTH / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{WIDTH}" height="{HEIGHT}" rx="8"'
    lines = [f'<rect class="state" {corner} stroke="{color}"{dashes}/>', _text(x, y + (-2 if note else 5), state, "state", color)]
    return "\n".join([*lines, _text(x, y + 14, note, "note")] if note else lines)


def _text(x: float, y: float, text: str, kind: str = "", color: str = "") -> str:
    attributes = (f' class="{kind}"' if kind else "") + (f' style="fill: {color}"' if color else "")
    return f'<text x="{x:.0f}" y="{y:.0f}"{attributes}>{escape(text)}</text>'


def _arrow(arrow: Arrow, centres: Mapping[str, tuple[float, float]], chart: Chart) -> str:
    (x, y), (to_x, to_y) = centres[arrow.source], centres[arrow.target]
    if arrow.source == arrow.target:  # a loop, below the box
        bottom = y + HEIGHT / 2
        path = (
            f"M{x - 30:.0f} {bottom:.0f}C{x - 50:.0f} {bottom + 40:.0f} {x + 50:.0f} {bottom + 40:.0f} {x + 30:.0f} {bottom:.0f}"
        )
        return _line(path, x, bottom + 42 + 7 * arrow.words.count(", "), arrow.words)
    length = hypot(to_x - x, to_y - y)
    across_x, across_y = -(to_y - y) / length, (to_x - x) / length
    has_twin = any((each.source, each.target) == (arrow.target, arrow.source) for each in chart.arrows)
    bend = chart.bends.get((arrow.source, arrow.target), 18.0 if has_twin else 0.0)
    start, end = _edge(x, y, to_x, to_y, bend, across_x, across_y), _edge(to_x, to_y, x, y, bend, across_x, across_y)
    middle = ((x + to_x) / 2 + across_x * bend, (y + to_y) / 2 + across_y * bend)
    control = (2 * middle[0] - (start[0] + end[0]) / 2, 2 * middle[1] - (start[1] + end[1]) / 2)
    path = f"M{start[0]:.0f} {start[1]:.0f}Q{control[0]:.0f} {control[1]:.0f} {end[0]:.0f} {end[1]:.0f}"
    side = (bend > 0) - (bend < 0)  # the words stand beside an arrow that is bent
    lines = arrow.words.split(", ")
    beside_x = across_x * side * (3.1 * max(map(len, lines)) + 6) * (abs(across_x) > 0.5)
    return _line(
        path, middle[0] + beside_x, middle[1] + across_y * side * (7 * len(lines) + 2) * (abs(across_y) > 0.5), arrow.words
    )


def _edge(x: float, y: float, to_x: float, to_y: float, bend: float, across_x: float, across_y: float) -> tuple[float, float]:
    """Where an arrow meets the box around (x, y)."""
    toward_x, toward_y = to_x - x + across_x * bend, to_y - y + across_y * bend
    scale = min(
        (WIDTH / 2) / abs(toward_x) if abs(toward_x) > 1e-6 else 1e9,
        (HEIGHT / 2) / abs(toward_y) if abs(toward_y) > 1e-6 else 1e9,
    )
    return x + toward_x * scale, y + toward_y * scale


def _line(path: str, x: float, y: float, words: str) -> str:
    lines = words.split(", ")
    parts = [f'<path class="way" d="{path}"/>']
    top = y - 7 * (len(lines) - 1)
    for number, line in enumerate(lines):
        at, width = top + 14 * number, 6.2 * len(line) + 6
        parts.append(f'<rect class="gap" x="{x - width / 2:.0f}" y="{at - 8:.0f}" width="{width:.0f}" height="15"/>')
        parts.append(_text(x, at + 4, line))
    return "\n".join(parts)


def draw_all(folder: Path) -> None:
    """Draw all charts into a folder."""
    folder.mkdir(exist_ok=True)
    for name, chart in CHARTS.items():
        (folder / f"{name}.svg").write_text(svg(chart()), encoding="utf-8")
        print(folder / f"{name}.svg")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--into", type=Path, metavar="FOLDER", default=FOLDER)
    draw_all(parser.parse_args().into)


if __name__ == "__main__":
    main()
