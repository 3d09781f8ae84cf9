"""Draw the pictures of the pages: each page's example runs on simulated drives in virtual time, and its motion is drawn.

    python docs/pictures.py [--into FOLDER] [PAGE ...]

docs/modes: an example is the first Python block of a page. It defines `main(master, joint)`: an open master, and the `Device` of
one drive whose unit is the degree (1000 counts). PICTURES has what belongs to each page.

docs/move-an-arm.md: each function of its Python blocks runs alone; ARM_EXAMPLE is drawn from its own recording.

docs/live.md: a demonstration in which a drive breaks down is recorded, and its frames are shown as `canopen watch` and
`canopen top` show them at one moment.

docs/screens: what SCREENS says, as a terminal shows it.

docs/tui: the views of `canopen tui` that TUI_VIEWS says, on two simulated drives, of which one has a fault.

Needs the extras `plot`, `motion` and `tui`.
"""

from __future__ import annotations

import argparse
import asyncio
import inspect
import io
import os
import re
import tempfile
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import trio
import trio.testing
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console, RenderableType
from rich.text import Text

from canopen_cli.app import main as run_command
from canopen_cli.live.top_view import BusShown, TopView
from canopen_cli.live.top_view import picture as draw_top
from canopen_cli.live.watch_view import Around
from canopen_cli.live.watch_view import picture as draw_watch
from canopen_cli.live.watched import Watched
from canopen_cli.plot.curves import curves_of_record
from canopen_cli.plot.motion import write_motion_plot
from canopen_data import load_dictionary
from canopen_data.configured import configure
from canopen_master import Chain, ChainSettings, Master, open_master, read_record
from canopen_master.motion.device import Device
from canopen_master.simulation.serving import simulated_devices
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import describe_status
from canopen_proto.drives.cia402.states import POWERED, state_of
from canopen_proto.frame import EMCY
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.multiplexer import Mux
from canopen_proto.observer.bus_view import BusView
from canopen_proto.observer.observer import Observer
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_transports.log_files import LogReader
from canopen_transports.record import Record

PAGES: Final = Path(__file__).parent / "modes"
ARM_PAGE: Final = Path(__file__).parent / "move-an-arm.md"
ARM_EXAMPLE: Final = "to_a_target"
BUS: Final = "virtual:docs"
NODE_ID: Final = 5
COUNTS: Final = 1000
"""In a degree."""
AXIS: Final = AxisSettings(counts_per_unit=COUNTS, max_speed=90.0)
SAMPLE: Final = 0.001
"""Seconds of virtual time between two samples."""

INK, GREY, BLUE, RED, GREEN = "#243b53", "#9aa5b1", "#0b6e99", "#ba2525", "#3f9142"
LANES: Final = {objects.CONTROLWORD: RED, objects.STATUSWORD: BLUE, objects.DIGITAL_INPUTS: GREEN}


class Curve(NamedTuple):
    """An object that is drawn. scale: from its unit to that of its panel."""

    key: Mux
    label: str
    scale: float = 1 / COUNTS
    is_demand: bool = False


class Panel(NamedTuple):
    """Curves with one axis."""

    title: str
    curves: Sequence[Curve]


POSITION: Final = Panel(
    "position in degrees",
    (
        Curve(objects.POSITION_DEMAND_VALUE, "demand (6062)", is_demand=True),
        Curve(objects.POSITION_ACTUAL_VALUE, "actual (6064)"),
    ),
)
VELOCITY: Final = Panel(
    "velocity in degrees/s",
    (
        Curve(objects.VELOCITY_DEMAND_VALUE, "demand (606B)", is_demand=True),
        Curve(objects.VELOCITY_ACTUAL_VALUE, "actual (606C)"),
    ),
)
TORQUE: Final = Panel(
    "torque in % of rated",
    (
        Curve(objects.TORQUE_DEMAND_VALUE, "demand (6074)", 0.1, is_demand=True),
        Curve(objects.TORQUE_ACTUAL_VALUE, "actual (6077)", 0.1),
    ),
)


class Lane(NamedTuple):
    """A bit that is drawn beneath the curves."""

    key: Mux
    bit: int
    label: str


def command(bit: int, name: str) -> Lane:
    """A bit of the controlword."""
    return Lane(objects.CONTROLWORD, bit, f"6040.{bit} {name}")


def status(bit: int, name: str) -> Lane:
    """A bit of the statusword."""
    return Lane(objects.STATUSWORD, bit, f"6041.{bit} {name}")


FASTER: Final = {objects.PROFILE_VELOCITY: 60_000, objects.PROFILE_ACCELERATION: 120_000, objects.PROFILE_DECELERATION: 120_000}
JOINT: Final = DriveSettings(position=0.0, mechanics=Mechanics(load=3.0), reaction=20 * MILLISECOND)
"""A joint with a weight, whose drive takes 20 ms to obey, so that the handshakes can be seen."""


class Picture(NamedTuple):
    """The picture of a page. settings: of the simulated drive; values: of its objects."""

    panels: Sequence[Panel]
    lanes: Sequence[Lane]
    settings: DriveSettings = JOINT
    values: Mapping[Mux, int] = FASTER


PICTURES: Final = {
    "pp": Picture(
        (POSITION, VELOCITY, TORQUE),
        (
            command(4, "new set-point"),
            command(9, "change on set-point"),
            status(12, "acknowledged"),
            status(10, "target reached"),
        ),
    ),
    "pv": Picture(
        (VELOCITY, POSITION, TORQUE), (status(10, "velocity reached"), status(12, "speed is zero"), command(8, "halt"))
    ),
    "vl": Picture((VELOCITY, POSITION, TORQUE), (command(4, "ramp enabled"), command(8, "halt"))),
    "tq": Picture((TORQUE, VELOCITY, POSITION), (status(10, "torque reached"), command(8, "halt"))),
    "hm": Picture(
        (POSITION, VELOCITY),
        (
            command(4, "start"),
            Lane(objects.DIGITAL_INPUTS, 2, "60FD.2 home switch"),
            status(12, "attained"),
            status(10, "stands"),
        ),
        settings=replace(JOINT, position=-12_000.0, track=Track(home_switch=(10_000.0, 60_000.0))),
    ),
    "ip": Picture((POSITION, VELOCITY, TORQUE), (command(4, "interpolate"), status(12, "active"))),
    "csv": Picture((VELOCITY, POSITION, TORQUE), (status(12, "follows the command"), command(8, "halt"))),
    "cst": Picture((TORQUE, POSITION, VELOCITY), (status(12, "follows the command"), command(8, "halt"))),
    "csp": Picture((POSITION, VELOCITY, TORQUE), (status(12, "follows the command"),)),
}


class Sample(NamedTuple):
    """The drive at one time, in seconds."""

    time: float
    values: dict[Mux, int]


class Run(NamedTuple):
    """An example that ran. drive: as the example left it."""

    samples: list[Sample]
    drive: DriveNode


def example_of(page: str) -> str:
    """Return the first Python block of a page."""
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    if code is None:
        raise SystemExit(f"{page}.md has no example")
    return code[1]


def run_example(page: str, sample: float = SAMPLE) -> Run:
    """Run a page's example in virtual time, and watch the drive. sample: s between two samples."""
    scope: dict[str, Any] = {}
    exec(compile(example_of(page), f"{page}.md", "exec"), scope)
    return trio.run(_run, PICTURES[page], scope["main"], sample, clock=trio.testing.MockClock(autojump_threshold=0))


async def _run(picture: Picture, main: Callable[[Master, Device], Awaitable[None]], sample: float) -> Run:
    encoder = standard_object(0x608F, highest=2, defaults={1: 360 * COUNTS, 2: 1})
    dictionary = configure(drive_dictionary().with_objects([encoder]), picture.values, NODE_ID)
    maker = partial(DriveNode, node_id=NODE_ID, settings=picture.settings, dictionary=dictionary)
    samples: list[Sample] = []
    async with simulated_devices({BUS: [maker]}) as simulation, open_master(BUS) as master:
        joint = master.device(master.node(NODE_ID, dictionary, pdos=False), "joint", AXIS)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(_watch, simulation.drives[NODE_ID], samples, sample)
            await main(master, joint)
            await trio.sleep(0.1)
            nursery.cancel_scope.cancel()
    return Run(samples, simulation.drives[NODE_ID])


async def _watch(drive: DriveNode, samples: list[Sample], pause: float) -> None:
    while True:
        now = trio.current_time()
        drive.drive.refresh(round(now * 1e9))
        samples.append(Sample(now, {key: value for key, value in drive.values.store.items() if isinstance(value, int)}))
        await trio.sleep(pause)


ARM_AXIS: Final = replace(
    AXIS, min_position=-170.0, max_position=170.0, max_acceleration=360.0, max_jerk=3600.0, unit=Unit.DEGREE
)
ARM_JOINT: Final = DriveSettings(position=0.0, track=Track(negative_limit=-180_000.0, positive_limit=180_000.0))
ArmExample = Callable[..., Awaitable[None]]


def arm_examples() -> dict[str, ArmExample]:
    """Return the functions of the page that take chains, by their names; `begin` is for all of them."""
    scope: dict[str, Any] = {}
    code = "\n".join(re.findall(r"```python\n(.*?)```", ARM_PAGE.read_text(encoding="utf-8"), re.DOTALL))
    exec(compile(code, ARM_PAGE.name, "exec"), scope)
    return {name: scope[name] for name in re.findall(r"^async def (\w+)\(arm", code, re.MULTILINE)}


def run_on_arms(example: ArmExample, recording: Path) -> None:
    """Run an example on simulated arms in virtual time, with a recording of `arm`."""
    trio.run(_run_on_arms, example, recording, clock=trio.testing.MockClock(autojump_threshold=0))


async def _run_on_arms(example: ArmExample, recording: Path) -> None:
    dictionary = drive_dictionary()
    chains = {"arm": (BUS, (1, 2)), "leg": ("virtual:leg", (1,))}
    makers = {
        bus: [partial(DriveNode, node_id=each, settings=ARM_JOINT, dictionary=dictionary) for each in nodes]
        for bus, nodes in chains.values()
    }
    async with simulated_devices(makers), open_master(buses={bus: bus for bus in makers}, dictionary=dictionary) as master:
        given: dict[str, Chain] = {}
        for name in inspect.signature(example).parameters:
            bus, nodes = chains[name]
            text = f"{name} " + " ".join(f"joint{node} {bus} {node}" for node in nodes)
            settings = ChainSettings(cycle_time=0.01, own_pdos=True)
            given[name] = master.load_chains(text=text, settings=settings, axes=ARM_AXIS)[name]
            await arm_examples()["begin"](given[name])
        async with given["arm"].record(recording):
            await example(**given)
        for chain in given.values():
            await chain.shut_down()


def draw_arm(path: Path) -> str:
    """Draw the motion of ARM_EXAMPLE; return how far the arm went, for people."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / f"{ARM_EXAMPLE}.csv"
        run_on_arms(arm_examples()[ARM_EXAMPLE], recording)
        curves = curves_of_record(read_record(recording))
    write_motion_plot(path, curves)
    return ", ".join(f"{each.name} up to {max(map(abs, each.actual)):.1f} {each.unit}" for each in curves.joints)


FAULT: Final = "5@3.0"
LIVE_PAGE: Final = Path(__file__).parent / "live.md"
LIVE_TITLES: Final = {
    "watch": "canopen watch 3 --402 --plot --log arm.log",
    "top": "canopen top --log arm.log --bitrate 1M",
}
LIVE_SIZE: Final = (80, 24)
LIVE_SPAN: Final = 10.0
LIVE_BITRATE: Final = 1_000_000


def record_demonstration(path: Path) -> list[Record]:
    """Record the frames of a demonstration in which a drive breaks down, in virtual time. Times count from the first frame."""
    arguments = ["demo", "--seconds", "4", "--fault", FAULT, "--trace", str(path), "--quiet", "--force"]
    run_command(arguments, clock=trio.testing.MockClock(autojump_threshold=0))
    records = list(LogReader(path))
    return [record._replace(time=record.time - records[0].time) for record in records]


def live_pictures(records: Sequence[Record]) -> dict[str, RenderableType]:
    """Return what `canopen watch` and `canopen top` show when a drive has just broken down."""
    dictionary = load_dictionary()[0]
    variables = [dictionary.variable(key) for key in ("6041", "6061", "6064", "6077", "60F4")]
    watched = Watched(3, dictionary, variables, span=round(LIVE_SPAN * SECOND))
    observer, view = Observer(lambda node_id: dictionary, bitrate=LIVE_BITRATE), BusView(bitrate=LIVE_BITRATE)
    emergency = next(each.time for each in records if each.frame.can_id == EMCY + 5)
    end = 0
    for record in records:
        if record.time > emergency + SECOND // 20:
            break
        observation = observer.observe(record.frame, record.time)
        watched.take(observation.meaning, record.time)
        view.add(record.frame, observation, record.time)
        end = record.time
    around = Around("arm.log", "a recording")
    shown = TopView("arm.log", (BusShown("can0", view.figures(end), end, end, LIVE_BITRATE),))
    return {
        "watch": draw_watch(watched.view(end), around, *LIVE_SIZE, span=LIVE_SPAN),
        "top": draw_top(shown, *LIVE_SIZE),
    }


def draw_live(folder: Path) -> None:
    """Draw the pictures of the page."""
    with tempfile.TemporaryDirectory() as temporary:
        pictures = live_pictures(record_demonstration(Path(temporary) / "demo.log"))
    for name, shown in pictures.items():
        path = folder / f"{name}.svg"
        write_svg(path, shown, LIVE_TITLES[name])
        print(path)


SCREENS: Final = {
    "scan": "canopen scan -b demo",
    "info": "canopen info 3 -b demo",
    "state": "canopen drive state 3 -b demo",
    "check": "canopen log check customer.log",
}
"""Commands by the names of their pictures. customer.log is a demonstration in which a drive breaks down."""
SCREEN_WIDTH: Final = 96


def draw_screens(folder: Path) -> None:
    """Draw what each command of SCREENS prints, in virtual time."""
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary, chdir(temporary):
        record_demonstration(Path("customer.log"))
        for name, command_line in SCREENS.items():
            path = folder / f"{name}.svg"
            write_svg(path, Text.from_ansi(printed_by(command_line)), command_line, SCREEN_WIDTH)
            print(path)


def printed_by(command_line: str) -> str:
    """Return what a command prints on a terminal with colours."""
    out = io.StringIO()
    with patch.dict(os.environ, FORCE_COLOR="1", COLUMNS=str(SCREEN_WIDTH)), redirect_stdout(out), redirect_stderr(io.StringIO()):
        run_command(command_line.split()[1:], clock=trio.testing.MockClock(autojump_threshold=0))
    return out.getvalue().rstrip()


def write_svg(path: Path, shown: RenderableType, title: str, width: int = LIVE_SIZE[0]) -> None:
    """Write what a terminal shows as a picture, which loads no fonts from elsewhere."""
    console = Console(record=True, width=width, file=io.StringIO(), force_terminal=True, color_system="truecolor")
    console.print(shown)
    svg = console.export_svg(title=title, unique_id=path.stem)
    path.write_text(re.sub(r"\s*@font-face \{.*?\}", "", svg, flags=re.DOTALL), encoding="utf-8")


def draw(picture: Picture, samples: Sequence[Sample], path: Path) -> None:
    """Draw the motion, from the moment at which the drive has power."""
    powered = [each for each in samples if state_of(each.values[objects.STATUSWORD]) in POWERED]
    begun = powered[0].time
    times = [each.time - begun for each in powered]
    heights = [*(1.9 for _ in picture.panels), 0.38 * len(picture.lanes)]
    figure = Figure(figsize=(8.5, 0.8 + sum(heights)), layout="constrained", facecolor="white")
    *panels, lanes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    for axes, panel in zip(panels, picture.panels, strict=True):
        for curve in panel.curves:
            values = [each.values.get(curve.key, 0) * curve.scale for each in powered]
            color, width = (GREY, 3.5) if curve.is_demand else (BLUE, 1.6)
            axes.plot(times, values, color=color, linewidth=width, label=curve.label)
        _dress(axes)
        axes.set_title(panel.title, loc="left", fontsize=9.5, color=INK)
        axes.legend(frameon=False, fontsize=8, loc="best")
    for place, lane in enumerate(picture.lanes):
        high = [-place + 0.7 * (each.values[lane.key] >> lane.bit & 1) for each in powered]
        lanes.fill_between(times, -place, high, step="post", color=LANES[lane.key], linewidth=0)
    lanes.set_yticks([0.35 - place for place in range(len(picture.lanes))], [lane.label for lane in picture.lanes], fontsize=8)
    _dress(lanes)
    lanes.grid(False)
    lanes.set_xlabel("time in s", fontsize=9, color=INK)
    figure.savefig(path, dpi=90, metadata={"Software": None})


def _dress(axes: Axes) -> None:
    axes.grid(color="#e4e7eb", linewidth=0.8)
    axes.tick_params(colors=INK, labelsize=8, length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(GREY)
    axes.margins(x=0.01)


class TuiView(NamedTuple):
    """A view of `canopen tui`. keys: that lead to it. shown: what stands there once it is whole."""

    keys: Sequence[str]
    shown: str
    size: tuple[int, int] = (80, 24)


TUI_VIEWS: Final = {
    "nodes": TuiView(("1", "f"), "Powerball", (100, 20)),
    "objects": TuiView(("2", "slash", *"6081", "enter", "enter"), "profile_velocity: 20000"),
    "drives": TuiView(("6",), "error 0x3220"),
    "traffic": TuiView(("5",), "heartbeat", (100, 20)),
}
"""By the names of their pictures."""
TUI_LIMIT: Final = 30.0
"""Seconds in which each view has to be whole."""


def draw_tui(folder: Path) -> None:
    """Draw the views of `canopen tui`."""
    folder.mkdir(exist_ok=True)
    for name, wanted in TUI_VIEWS.items():
        path = folder / f"{name}.svg"
        write_svg(path, tui_picture(wanted), f"canopen tui -b {TUI_BUS}", wanted.size[0])
        print(path)


def tui_picture(wanted: TuiView) -> Text:
    """Return a view as a terminal shows it. The machine runs in virtual time, which follows the real one; the view does not."""
    from canopen_cli.shared.node_files import NodeFiles
    from canopen_cli.shared.options import Settings
    from canopen_cli.tui.app import MachineView
    from canopen_cli.tui.guest import run_beside
    from canopen_cli.tui.machine_watch import MachineWatch
    from canopen_gateway import open_gateway
    from canopen_master.participant.patient_clock import PatientClock
    from canopen_master.simulation.serving import simulated_drives

    watches: list[MachineWatch] = []
    pictures: list[Text] = []
    opened = asyncio.Event()

    async def machine() -> None:
        settings = Settings()
        async with open_master(TUI_BUS) as master, open_gateway(master) as service:
            with service.open_session("the view") as session:
                watches.append(MachineWatch(service, session, NodeFiles(settings, settings.screen())))
                async with simulated_drives([(TUI_BUS, 3), (TUI_BUS, 4)]) as drives:
                    drives.raise_fault(3, 0x3220)
                    opened.set()
                    await watches[0].run()

    async def host(ended: asyncio.Future[Any]) -> None:
        await asyncio.wait_for(opened.wait(), TUI_LIMIT)
        view = MachineView(watches[0], TUI_BUS)
        async with view.run_test(size=wanted.size) as pilot:
            end = asyncio.get_running_loop().time() + TUI_LIMIT
            await shown(view, pilot, "4 (0x04)", end)
            await pilot.press(*wanted.keys)
            pictures.append(await shown(view, pilot, wanted.shown, end))

    async def shown(view: MachineView, pilot: Any, text: str, end: float) -> Text:
        while True:
            strips = view.screen._compositor.render_strips()
            picture = Text("\n").join(Text.assemble(*((each.text, each.style or "") for each in strip)) for strip in strips)
            if text in picture.plain:
                return picture
            if asyncio.get_running_loop().time() > end:
                raise RuntimeError(f"{text!r} was not seen in:\n{picture.plain}")
            await pilot.pause(0.05)

    run_beside(host, lambda: watches[0].leave())(machine, clock=PatientClock())
    return pictures[0]


SCREENS_FOLDER: Final = "screens"
TUI_FOLDER: Final = "tui"
TUI_BUS: Final = "virtual:cell"
PICTURED: Final = (*PICTURES, ARM_PAGE.stem, LIVE_PAGE.stem, SCREENS_FOLDER, TUI_FOLDER)
"""The pages with pictures."""


def draw_page(page: str, docs: Path) -> None:
    """Draw the pictures of a page (one of PICTURED) into a folder that is laid out as this one."""
    if page == LIVE_PAGE.stem:
        draw_live(docs / "live")
    elif page == SCREENS_FOLDER:
        draw_screens(docs / SCREENS_FOLDER)
    elif page == TUI_FOLDER:
        draw_tui(docs / TUI_FOLDER)
    elif page == ARM_PAGE.stem:
        path = docs / f"{page}.png"
        print(f"{path}: {draw_arm(path)}")
    else:
        run = run_example(page)
        path = docs / PAGES.name / f"{page}.png"
        draw(PICTURES[page], run.samples, path)
        end = run.samples[-1].values
        print(f"{path}: {'; '.join(describe_status(end[objects.STATUSWORD], end[objects.MODES_OF_OPERATION_DISPLAY]))}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("pages", metavar="PAGE", nargs="*", help=f"one of {', '.join(PICTURED)}; by default all")
    parser.add_argument("--into", type=Path, metavar="FOLDER", default=PAGES.parent, help="by default beside the pages")
    arguments = parser.parse_args()
    for page in arguments.pages or PICTURED:
        draw_page(page, arguments.into)


if __name__ == "__main__":
    main()
