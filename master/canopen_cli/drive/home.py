"""`canopen home`: home drives at the same time, and disable them afterwards. `canopen drive home NODE`: the same for one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import click
import trio

from canopen_cli.drive.session import axis_of_command, node_of_command
from canopen_cli.motion.view import DemoView, JointView
from canopen_cli.shared.chosen_machine import NUMBER, ChosenMachine
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.numbers import NumberCommand
from canopen_cli.shared.options import Duration, Settings, command, commanding, enabling, option_group, together
from canopen_cli.shared.problem import usage
from canopen_cli.shared.rehearsal import rehearse
from canopen_cli.shared.running import all_stand, run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_master.motion.joint_procedures import ensure_answers
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis, AxisSettings, HomingStyle
from canopen_proto.drives.axis.axis_node import AxisNode, node_of_axis
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS, homing_name
from canopen_proto.drives.cia402.modes import describe_status
from canopen_proto.drives.cia402.objects import SCHUNK_VENDOR_ID, VENDOR_ID
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, StepTimeoutError, all_of
from canopen_transports.loop.beside import beside

REFRESH: Final = 0.1
"""Seconds between two updates of the picture."""
METHOD: Final = click.IntRange(-128, 127)
STYLES: Final = {"auto": None, "standard": HomingStyle.STANDARD, "schunk": HomingStyle.SCHUNK}


class HomingChoice(NamedTuple):
    """How to home, as the command line says."""

    style: str
    method: int | None
    limit: Time | None
    reset_fault: bool


homing_options: Final = option_group(
    together(
        "choice",
        HomingChoice,
        click.option(
            "--style",
            type=click.Choice(list(STYLES)),
            default="auto",
            help="How they home: as CiA 402 says, or as Schunk Powerball joints do.  [default: as the vendor-ID in 0x1018 says]",
        ),
        click.option("--limit", type=Duration(), help="How long it may take.  [default: that of the machine file, else 60s]"),
        click.option("--reset-fault", is_flag=True, help="Reset a fault first."),
    ),
    click.option("--list", "lists", is_flag=True, help="Show the homing methods, those of NODE if it tells; nothing moves."),
    enabling,
    commanding,
)
"""The options of a command that homes. It has `method` besides, and takes `choice` and `lists`."""


@command()
@click.argument("names", metavar="NODE...", nargs=-1)
@click.option("--method", type=METHOD, help="Homing method, written to 0x6098; --list has them.")
@homing_options
def home(settings: Settings, screen: Screen, names: tuple[str, ...], choice: HomingChoice, lists: bool) -> None:
    """Home drives (CiA 402), all at the same time. THEY MOVE. Ctrl-C halts them.

    The names of a machine file may be on several of its buses.

    \b
    canopen home 3 4 -b demo
    canopen home --list
    """
    if lists:
        list_methods(settings, screen, [settings.node_id(each) for each in names])
    elif not names:
        raise usage("CO001", "no NODE was named", tries=("canopen home 3", "canopen home --list    the homing methods"))
    else:
        home_nodes(screen, _by_bus(settings, names), choice)


@command("home", cls=NumberCommand)
@click.argument("method", metavar="[METHOD]", required=False, type=METHOD)
@homing_options
def home_one(settings: Settings, screen: Screen, choice: HomingChoice, lists: bool) -> None:
    """Home a drive (CiA 402), by METHOD (written to 0x6098) or by its own. IT MOVES. Ctrl-C halts it.

    `canopen home NODE...` does the same with several at a time.

    \b
    canopen drive home 3 -b demo
    canopen drive home 5 35 -b can0        method 35: the present position becomes 0
    """
    node_ids = (node_of_command(),)
    if lists:
        list_methods(settings, screen, node_ids, axis_of_command(settings))
    else:
        home_nodes(screen, [DrivesOnBus(settings, node_ids, axis_of_command(settings))], choice)


class DrivesOnBus(NamedTuple):
    """The drives to home on one bus, and the options of a command that is about this bus. axis: of each node."""

    settings: Settings
    node_ids: tuple[int, ...]
    axis: int = 0


def _by_bus(settings: Settings, names: Sequence[str]) -> list[DrivesOnBus]:
    """Return the drives that these node-IDs and names mean, by their buses. Raises a CommandError."""
    machine = settings.machine_file()
    nodes = [None if machine is None or NUMBER.fullmatch(each) else machine.node_of(each.strip()) for each in names]
    buses = {node.bus for node in nodes if node is not None}
    if len(buses) < 2 or None in nodes:  # a node-ID is on the one bus of the command
        return [DrivesOnBus(settings, tuple(dict.fromkeys(settings.node_id(each) for each in names)))]
    found: dict[str, tuple[Settings, dict[int, None]]] = {}
    for name, node in zip(names, nodes, strict=True):
        assert node is not None
        own, node_ids = found.setdefault(node.bus, (replace(settings, chosen=ChosenMachine()), {}))
        node_ids[own.node_id(name)] = None
    return [DrivesOnBus(own, tuple(node_ids)) for own, node_ids in found.values()]


def home_nodes(screen: Screen, groups: Sequence[DrivesOnBus], homing: HomingChoice) -> None:
    """Home drives side by side, and show how they stand then. A failure is raised with a note of what was done. groups: the
    drives, by their bus."""
    if homing.style == "schunk" and homing.method is not None:
        raise usage("CO125", "a method is for drives that home as CiA 402 says", tries=("the same without the method",))
    settings = groups[0].settings
    for each in groups:
        each.settings.required_bus()

    def procedure(session: BusSession, axes: dict[int, Axis], group: DrivesOnBus) -> Procedure[list[None]]:
        return all_of(*(_home(session, axes, node_id, homing, group.axis) for node_id in group.node_ids))

    if settings.dry_run:
        for group in groups:

            async def work(session: BusSession, group: DrivesOnBus = group) -> None:
                axes: dict[int, Axis] = {}
                await session.master.run(procedure(session, axes, group))
                await session.master.run(all_of(*(drive.shut_down(axis) for axis in axes.values())))

            rehearse(group.settings, screen, group.node_ids, work, ends=True, axis=group.axis)
        return
    found: list[dict[int, Axis]] = [{} for _ in groups]
    chosen = [node_id for group in groups for node_id in group.node_ids]

    async def on_bus(group: DrivesOnBus, axes: dict[int, Axis]) -> None:
        async with open_session(group.settings, screen) as session:
            await session.master.run(procedure(session, axes, group))
            await session.master.run(all_of(*(drive.shut_down(axis) for axis in axes.values())))

    async def command() -> list[Axis]:
        with DemoView(screen, f"homing {', '.join(map(node_text, chosen))}", range=180) as view:
            view.joints = [JointView(f"node {node_id}", node_id) for node_id in chosen]
            step = view.begin("home", "")
            async with beside(trio.open_nursery()) as watching:
                watching.start_soon(_watch, view, groups, found)
                async with trio.open_nursery() as nursery:
                    for group, axes in zip(groups, found, strict=True):
                        nursery.start_soon(on_bus, group, axes)
            view.done(step, f"{len(chosen)} of {len(chosen)} homed")
        return [axes[node_id] for group, axes in zip(groups, found, strict=True) for node_id in group.node_ids]

    try:
        axes = run(settings, screen, command, story=_story)
    except Exception as error:  # noqa: BLE001 - raised again, with a note of what was done
        problem = problem_of(error)
        if isinstance(problem.__cause__, StepTimeoutError):
            problem.also += _story(all_stand(error))
            limits = [_limit_of(group.settings, node_id, group.axis) for group in groups for node_id in group.node_ids]
            now = (homing.limit or max(limits)) / SECOND
            problem.tries = ("look whether the axis can move freely", f"a longer --limit (now {now:g} s)")
        raise problem from problem.__cause__
    if settings.json:
        screen.json([_as_json(axis) for axis in axes])
        return
    rows = [
        (
            f"{axis.node.node_id} (0x{axis.node.node_id:02X})",
            "[green]yes[/]" if axis.is_homed else "[red]no[/]",
            escape(", ".join(describe_status(axis.statusword, axis.mode))),
            "" if axis.position_counts is None else str(axis.position_counts),
        )
        for axis in axes
    ]
    screen.table(("node", "homed", "statusword", "position in counts"), rows, right=("node", "position in counts"))


def _limit_of(settings: Settings, node_id: int, axis: int) -> Time:
    joint = settings.joint(node_id, axis)
    return (AxisSettings() if joint is None else joint.settings).homing_timeout


def _story(confirmed: bool) -> list[str]:
    return [f"the drives were {'halted' if confirmed else 'told to halt'}; what was not done by then is not homed"]


def _as_json(axis: Axis) -> dict[str, Any]:
    return {
        "node": axis.node.node_id,
        **({"axis": axis.number} if axis.number else {}),
        "homed": axis.is_homed,
        "statusword": axis.statusword,
        "state": str(axis.state),
        "position": axis.position_counts,
    }


def list_methods(settings: Settings, screen: Screen, node_ids: Sequence[int], axis: int = 0) -> None:
    """Show the homing methods of the standard, or those that drives list. node_ids: of these drives; empty: the standard's."""
    lists: dict[int, tuple[int, ...] | None] = {}

    def methods_of(node: AxisNode) -> Procedure[tuple[int, ...] | None]:
        if (yield from read_number(node, VENDOR_ID)) == SCHUNK_VENDOR_ID:
            return ()
        return (yield from drive.read_homing_methods(node))

    async def command() -> None:
        async with open_session(settings, screen) as session:
            for node_id in dict.fromkeys(node_ids):
                seen = node_of_axis(session.node(node_id, axis).remote, axis)
                lists[node_id] = await session.master.run(methods_of(seen))

    if node_ids:
        run(settings, screen, command)
    listed = {method for methods in lists.values() for method in methods or ()}
    shown = sorted(listed) if lists and None not in lists.values() else sorted({*HOMING_METHODS, *listed})
    if settings.json:
        screen.json(
            {
                "methods": [{"method": each, "name": homing_name(each)} for each in shown],
                "listed": {str(node_id): None if methods is None else list(methods) for node_id, methods in lists.items()},
            }
        )
        return
    tells = {node_id: methods for node_id, methods in lists.items() if methods}
    columns = tuple(f"node {node_id}" for node_id in tells)
    rows = [(str(each), *("yes" if each in has else "" for has in tells.values()), homing_name(each)) for each in shown]
    if rows:
        screen.table(("method", *columns, "home, and where it begins"), rows, right=("method",))
    for node_id, methods in lists.items():
        if methods is None:
            screen.say(f"{node_text(node_id)} does not tell its methods (0x60E3): its manual does")
        elif not methods:
            screen.say(f"{node_text(node_id)} is Schunk's by its vendor-ID (0x1018:01): its joints home without a method")


def _home(session: BusSession, axes: dict[int, Axis], node_id: int, homing: HomingChoice, number: int) -> Procedure[None]:
    style, method, limit, reset_fault = homing
    node = session.node(node_id, number)
    yield from ensure_answers(node)
    yield from session.master.watchdogs.check(node)
    settings = session.axis_settings(node_id, number)
    settings = replace(
        settings,
        homing=STYLES[style] or settings.homing,
        homing_method=settings.homing_method if method is None else method,
        homing_timeout=limit or settings.homing_timeout,
    )
    axis = session.master.device(node, settings=settings, axis=number).axis
    axes[node_id] = axis
    yield from identify(axis)
    if axis.settings.homing is HomingStyle.SCHUNK and method is not None:
        raise ProcedureError(
            f"drive {node_id} is Schunk's by its vendor-ID (0x1018:01): its joints home without a method. "
            "Try: the same without a method, or --style standard"
        )
    if reset_fault:
        yield from drive.reset_fault(axis)
    yield from drive.home(axis)
    yield from drive.read_position(axis)


async def _watch(view: DemoView, groups: Sequence[DrivesOnBus], found: Sequence[dict[int, Axis]]) -> None:
    """Keep the picture up to date."""
    places = [(axes, node_id) for group, axes in zip(groups, found, strict=True) for node_id in group.node_ids]
    while True:
        for joint, (axes, node_id) in zip(view.joints, places, strict=True):
            axis = axes.get(node_id)
            if axis is not None:
                joint.state = str(axis.state) if not axis.is_homed else "homed"
        view.refresh()
        await trio.sleep(REFRESH)
