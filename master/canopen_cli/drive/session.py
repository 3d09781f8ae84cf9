"""The drive that a command of `canopen drive` names: run a procedure on it, and show what it shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final, TypeAlias, TypeVar

import click

from canopen_cli.shared.numbers import position_text
from canopen_cli.shared.options import DriveId, Settings
from canopen_cli.shared.problem import ExitCode, usage, with_bus
from canopen_cli.shared.running import Story, run
from canopen_cli.shared.screen import Screen, counted
from canopen_cli.shared.session import BusSession, open_session
from canopen_cli.shared.time_left import time_left
from canopen_master.motion.joint_procedures import ensure_answers
from canopen_master.motion.single_drive import look_at_drive, require_drive
from canopen_master.node import Node
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode, node_of_axis
from canopen_proto.drives.axis.reasons import reasons
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import COUNTS, Unit, read_units
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.cia402.modes import Mode, describe_status, mode_name
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.procedures.steps import Procedure

T = TypeVar("T")

NODE: Final = "canopen.drive.node"
"""The key of the node-ID, or of a name in the machine file, in `click.Context.meta`."""
AXIS: Final = "canopen.drive.axis"
"""The key of --axis there; None: not given."""
_REMEDIES: Final = {
    "enable it": "drive enable",
    "enable it again; if it does not leave this state, disable it first": "drive enable",
    "remove the cause, then reset the fault": "drive fault-reset",
    "a command without bit 8": "drive disable",
    "select one (0x6060)": "drive mode",
    "start it (NMT)": "nmt start",
    "home it": "drive home",
}
"""What the library advises, and the commands that do it, or show how."""
Scale: TypeAlias = Callable[[AxisNode], Procedure[float]]
"""Reads how many counts one unit of position has."""


def run_on_node(
    settings: Settings, screen: Screen, procedure: Callable[[BusSession, Node], Procedure[T]], story: Story = lambda confirmed: []
) -> T:
    """Run a procedure on the node that the command line names."""
    node_id, axis = node_of_command(), axis_of_command(settings)  # a name also says which bus the session opens

    label = f"drive {node_id}: {click.get_current_context().info_name}"

    async def command() -> T:
        async with open_session(settings, screen) as session, time_left(screen, label, ending="Ctrl-C halts it"):
            return await session.master.run(procedure(session, session.node(node_id, axis)))

    return run(settings, screen, command, story=story)


def node_of_command() -> int:
    """Return the node-ID that the command names, or that of the name that stands there."""
    context = click.get_current_context()
    return DriveId().convert(context.meta[NODE], None, context)


def axis_of_command(settings: Settings) -> int:
    """Return the axis of the node that the command is about: that of --axis, or of the joint that it names. Raises a CommandError
    if the two differ."""
    meta = click.get_current_context().meta
    machine, chosen = settings.machine_file(), meta.get(AXIS)
    joint = None if machine is None else machine.joints.get(str(meta[NODE]))
    if joint is None:
        return chosen or 0
    if chosen not in (None, joint.axis):
        raise usage("CO001", f"{joint.name} is axis {joint.axis} by the machine file", tries=("the same without --axis",))
    return joint.axis


def read_drive(settings: Settings, screen: Screen, procedure: Callable[[AxisNode], Procedure[T]]) -> T:
    """Run a procedure that only reads: another program may move the drive meanwhile."""
    axis = axis_of_command(settings)
    return run_on_node(settings, screen, lambda session, node: procedure(node_of_axis(node.remote, axis)))


def command_drive(
    settings: Settings,
    screen: Screen,
    procedure: Callable[[Axis], Procedure[T]],
    story: Story = lambda confirmed: [],
    scale: Scale | None = None,
    *,
    ends: bool = True,
    enables: bool = False,
) -> T:
    """Run a procedure that commands the drive, or rehearse it (--dry-run).

    scale: reads the counts in one unit; None: see `BusSession.axis_settings`. ends: it ends without a Ctrl-C. enables: it gives
    power, so it is refused before the first frame that commands, if the drive could not watch over this program.
    """

    number = axis_of_command(settings)

    def whole(session: BusSession, node: Node) -> Procedure[T]:
        yield from ensure_answers(node)
        if enables:
            yield from require_drive(node_of_axis(node.remote, number))
            yield from session.master.watchdogs.check(node)
        chosen = session.axis_settings(node.node_id, number)
        if scale is not None:
            chosen = replace(chosen, counts_per_unit=(yield from scale(node_of_axis(node.remote, number))))
        return (yield from procedure(session.master.device(node, settings=chosen, axis=number).axis))

    async def work(session: BusSession) -> None:
        await session.master.run(whole(session, session.node(node_of_command(), number)))

    if not ends:
        screen.tell_at_once()
    if settings.dry_run:
        from canopen_cli.shared.rehearsal import (
            rehearse,  # with the simulated drives, which no other way needs: a stop begins sooner
        )

        rehearse(settings, screen, (node_of_command(),), work, ends=ends, axis=number)
        raise click.exceptions.Exit(ExitCode.OK)
    return run_on_node(settings, screen, whole, story)


def joint_settings(settings: Settings) -> AxisSettings:
    """Return the settings of the drive that the command is about, by the machine file; the defaults if it has none."""
    joint = settings.joint(node_of_command(), axis_of_command(settings))
    return AxisSettings() if joint is None else joint.settings


def take_step(settings: Settings, screen: Screen, step: Callable[[Axis], Procedure[None]]) -> None:
    """Take a step with the drive, and show what it shows then."""

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from step(axis)
        return (yield from look_at_drive(axis.node))

    show_drive(settings, screen, command_drive(settings, screen, procedure))


def show_drive(
    settings: Settings,
    screen: Screen,
    view: DriveView,
    position: tuple[float, str, float] | None = None,
    moved: int | None = None,
) -> None:
    """Show what a drive shows, and what keeps it from moving.

    position: with its unit, and the counts in one, if a machine file tells the unit. moved: the counts by which it moved
    meanwhile; None: nobody looked.
    """
    found = reasons(view)
    if settings.json:
        screen.json(
            {
                "state": str(view.state),
                "statusword": view.statusword,
                "controlword": view.controlword,
                "mode": view.mode,
                "wanted_mode": view.wanted_mode,
                "error_code": view.error_code,
                "position": view.position,
                **({} if moved is None else {"moves": moved != 0}),
                **({} if position is None else {"position_in_unit": position[0], "unit": position[1]}),
                "nmt_state": None if view.nmt_state is None else view.nmt_state.name,
                "obstacles": [{"what": each.what, "remedy": each.remedy} for each in found],
            }
        )
        return
    screen.fact("state", str(view.state))
    screen.fact("statusword", f"{', '.join(describe_status(view.statusword, view.mode))}  (0x{view.statusword:04X})")
    if view.controlword is not None:
        screen.fact("controlword", f"0x{view.controlword:04X}")
    if view.mode is not None:
        screen.fact("mode", mode_name(view.mode))
    if view.position is not None:
        counts = f"{counted(view.position, 'count')}"
        screen.fact(
            "position", counts if position is None else f"{position_text(position[0], position[2])} {position[1]}  ({counts})"
        )
    if moved:
        screen.fact("it moves", f"{'up' if moved > 0 else 'down'}: by {counted(abs(moved), 'count')} while this command looked")
    elif not found and _is_on_its_way(view):
        screen.fact("it stands", "but has not reached its target (bit 10 is 0)")
    elif not found:
        screen.fact("it does not move", "if nothing commands it to: no obstacle was found")
    for number, (what, remedy, _) in enumerate(found):
        screen.fact(
            "" if number else "in the way" if moved else "it does not move", f"{what}. Try: {_with_command(settings, remedy)}"
        )


def _is_on_its_way(view: DriveView) -> bool:
    """Return whether a drive has a target, and does not show that it is there."""
    has_target = view.state is State.OPERATION_ENABLED and view.mode in (Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY)
    return has_target and not view.statusword & StatusBit.TARGET_REACHED


def _with_command(settings: Settings, remedy: str) -> str:
    """Return a remedy with the command that does it, if there is one."""
    if remedy not in _REMEDIES:
        return remedy
    verb, node = _REMEDIES[remedy], node_of_command()
    axis = 0 if verb.startswith("nmt ") else axis_of_command(settings)
    return f"{remedy}: {with_bus(f'canopen {verb} {node}' + f' --axis {axis}' * bool(axis), *settings.typed_bus())}"


def unit_of_command(settings: Settings, given: str | None) -> tuple[str, Scale | None]:
    """Return the unit of positions, and how the counts in it are found; None: as `BusSession.axis_settings` says.

    given: that of --in, None without it: then the unit is that of the joint in the machine file, or else the count. Raises a
    CommandError for an --in that is not the joint's unit: its limits are in that.
    """
    joint = settings.joint(node_of_command(), axis_of_command(settings))
    if joint is None or not joint.has_unit:
        return given or COUNTS, partial(counts_per, unit=Unit(given)) if given in list(Unit) else None
    unit = "unit" if joint.settings.unit is None else joint.settings.unit.value
    if given not in (None, unit):
        raise usage("CO001", f"positions of {joint.name} are in the {unit} of the machine file", tries=("the same without --in",))
    return unit, None


def counts_per(node: AxisNode, unit: Unit) -> Procedure[float]:
    """Return the counts in one unit, as the drive tells. Raises a CommandError if it does not."""
    found = (yield from read_units(node)).counts_per(unit)
    if found is None:
        raise usage(
            "CO321",
            f"drive {node.node_id} does not tell how many counts a {unit} has",
            tries=(
                f"canopen drive units {node.node_id}    what it tells",
                "the same in counts, without --in",
                "counts_per_turn, or counts_per_unit, of its joint in a machine file (-m), by its manual",
            ),
        )
    return found
