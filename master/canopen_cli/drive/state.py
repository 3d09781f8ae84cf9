"""`canopen drive state NODE|units|mode|fault-reset`: what gives a drive no power."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import click

from canopen_cli.drive.session import (
    axis_of_command,
    command_drive,
    joint_settings,
    node_of_command,
    read_drive,
    show_drive,
    take_step,
    unit_of_command,
)
from canopen_cli.shared.numbers import NumberCommand
from canopen_cli.shared.options import Settings, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen
from canopen_master.motion.single_drive import look_at_drive, require_drive
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.units import COUNTS, DriveUnits, Unit, read_number, read_units
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, mode_name, supported_modes
from canopen_proto.drives.cia402.states import POWERED
from canopen_proto.machine import MILLISECOND
from canopen_proto.procedures.steps import Procedure, sleep

_LOOK: Final = 50 * MILLISECOND
"""Between two positions that show whether a drive moves."""


@command()
def state(settings: Settings, screen: Screen) -> None:
    """Show state, mode and position of a drive, and what keeps it from moving.

    \b
    canopen drive state 3 -b demo
    """
    unit, _ = unit_of_command(settings, None)
    axis_settings = joint_settings(settings)

    def look(node: AxisNode) -> Procedure[tuple[DriveView, int, tuple[float, str, float] | None]]:
        view = yield from look_at_drive(node, axis_settings)
        moved = yield from _moved(node, view)
        counts = axis_settings.counts_per_unit
        if unit == COUNTS or view.position is None:
            return view, moved, None
        if counts is None and axis_settings.unit is not None:
            counts = (yield from read_units(node)).counts_per(axis_settings.unit)
        if counts is None:
            return view, moved, None
        return view, moved, (axis_settings.direction * (view.position - axis_settings.offset) / counts, unit, counts)

    view, moved, position = read_drive(settings, screen, look)
    show_drive(settings, screen, view, position, moved)


def _moved(node: AxisNode, view: DriveView) -> Procedure[int]:
    """Return by how many counts the drive moves in _LOOK; 0 if it stands, by its velocity (0x606C) too, or shows no position."""
    if view.position is None:
        return 0
    before = yield from read_number(node, objects.POSITION_ACTUAL_VALUE, signed=True)
    yield from sleep(_LOOK)
    after = yield from read_number(node, objects.POSITION_ACTUAL_VALUE, signed=True)
    way = 0 if before is None or after is None else after - before
    stands = abs(way) <= 1 or (yield from read_number(node, objects.VELOCITY_ACTUAL_VALUE, signed=True)) == 0
    return 0 if stands else way


@command("fault-reset")
@commanding
def fault_reset(settings: Settings, screen: Screen) -> None:
    """Reset a fault: a rising edge of bit 7. It moves nothing: the drive is not enabled afterwards.

    \b
    canopen drive fault-reset 3 -b demo
    """
    take_step(settings, screen, procedures.reset_fault)


@command()
def units(settings: Settings, screen: Screen) -> None:
    """Show what the numbers of a drive mean, and which of its objects say so (the factor group).

    \b
    canopen drive units 3 -b demo
    """

    def look(node: AxisNode) -> Procedure[DriveUnits]:
        yield from require_drive(node)
        return (yield from read_units(node))

    found = read_drive(settings, screen, look)
    if settings.json:
        screen.json(_units_json(found))
        return
    rows = [row for row in _units_rows(found) if row[1]]
    screen.table(("", "on the wire", "which says"), rows)
    for conflict in found.conflicts:
        screen.data(f"[yellow]these differ:[/] {conflict}")
    if found.per_turn is None and found.per_metre is None:
        joint = settings.joint(node_of_command(), axis_of_command(settings))
        if joint is not None and joint.settings.counts_per_unit is not None:
            unit = "unit" if joint.settings.unit is None else joint.settings.unit.value
            screen.say(
                f"The drive does not tell what a count is. The machine file does: {joint.settings.counts_per_unit:g} in a {unit}"
            )
        else:
            screen.say("The drive does not tell what a count is. Try: counts_per_turn in a machine file, by its manual")


def _units_rows(units: DriveUnits) -> list[tuple[str, str, str]]:
    origins: Mapping[str, str] = units.origins

    def counts(value: float | None, per: str = "") -> str:
        return "" if value is None else f"{value:.10g} count{'s' * (value != 1)}{per}"

    return [
        ("a turn of the shaft", counts(units.per_turn), origins.get("per_turn", "")),
        ("a turn of the motor", counts(units.per_motor_turn), origins.get("per_motor_turn", "")),
        ("a degree", counts(units.counts_per(Unit.DEGREE)), ""),
        ("a millimetre", counts(units.counts_per(Unit.MILLIMETRE)), origins.get("per_metre", "")),
        ("a velocity of 1", counts(units.per_velocity, " per second") or "not known", origins.get("per_velocity", "")),
        (
            "an acceleration of 1",
            counts(units.acceleration_unit(units.per_velocity), " per second²") or "not known",
            origins.get("per_acceleration", "the velocity unit per second"),
        ),
        ("a torque of 1", "" if units.rated_torque is None else f"{units.torque(1):g} N·m", origins.get("rated_torque", "")),
        ("reversed", ", ".join(units.reversed), "0x607E"),
        ("the home position", counts(units.home_offset or None), "0x607C"),
    ]


def _units_json(units: DriveUnits) -> dict[str, Any]:
    return {
        "counts_per_turn": units.per_turn,
        "counts_per_motor_turn": units.per_motor_turn,
        "counts_per_metre": units.per_metre,
        "counts_per_second_per_velocity": units.per_velocity,
        "counts_per_second2_per_acceleration": units.acceleration_unit(units.per_velocity),
        "rated_torque": units.rated_torque,
        "reversed": list(units.reversed),
        "home_offset": units.home_offset,
        "origins": dict(units.origins),
        "conflicts": list(units.conflicts),
    }


@command(cls=NumberCommand)  # a maker's mode is below 0
@click.argument("name", metavar="[MODE]", required=False)
@commanding
def mode(settings: Settings, screen: Screen, name: str | None) -> None:
    """Show the modes of operation that a drive has; with MODE (pp, ip, csp ... or a number) select one.

    A drive that is enabled is not changed: in some modes it would obey an old target at once.

    \b
    canopen drive mode 3 -b demo
    canopen drive mode 3 pp -b demo
    """

    def select(axis: Axis, number: int) -> Procedure[DriveView]:
        view = yield from look_at_drive(axis.node)
        if view.state in POWERED:
            raise CommandError(
                ExitCode.DRIVE_FAULT,
                "CO409",
                f"{axis.title} has power ({view.state}): in another mode it could obey an old target at once",
                tries=(f"canopen drive disable {axis.node.node_id}{_option(axis)}",),
            )
        yield from procedures.set_mode(axis, number)
        return (yield from look_at_drive(axis.node))

    if name is None:
        view = read_drive(settings, screen, look_at_drive)
    else:
        view = command_drive(settings, screen, partial(select, number=_mode_of(name)))
    modes = () if view.supported_modes is None else supported_modes(view.supported_modes)
    if settings.json:
        screen.json({"mode": view.mode, "wanted_mode": view.wanted_mode, "supported_modes": list(modes)})
        return
    screen.fact("mode", "not told (0x6061)" if view.mode is None else mode_name(view.mode))
    screen.fact("it has", ", ".join(map(mode_name, modes)) if modes else "it does not tell (0x6502)")


def _option(axis: Axis) -> str:
    return f" --axis {axis.number}" if axis.number else ""


def _mode_of(name: str) -> int:
    """Return the number of a mode that the command line names."""
    short = {mode_name(each).rpartition("(")[2].rstrip(")"): int(each) for each in Mode if each}
    if name.lower() in short:
        return short[name.lower()]
    if re.fullmatch("-?[0-9]{1,3}", name) and -128 <= int(name) <= 127:
        return int(name)
    raise usage("CO136", f"{name!r} is no mode of operation", tries=(f"one of {', '.join(short)}, or a number from -128 to 127",))
