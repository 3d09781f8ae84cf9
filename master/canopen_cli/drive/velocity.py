"""`canopen drive velocity NODE`: run a drive at a velocity, for as long as the command runs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import click

from canopen_cli.drive.session import command_drive, unit_of_command
from canopen_cli.shared.numbers import NumberCommand, UnitName
from canopen_cli.shared.options import FiniteRange, Settings, command, commanding, enabling, lasting, until_text
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_master.motion.single_drive import ends_unpowered, look_at_drive
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.units import COUNTS, Unit, read_number
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.machine import SECOND
from canopen_proto.procedures.steps import Procedure

RPM: Final = "rpm"
_MODES: Final = {"pv": Mode.PROFILE_VELOCITY, "vl": Mode.VELOCITY}
_ABOVE_0: Final = FiniteRange(0, min_open=True)


@command(cls=NumberCommand)
@click.argument("value", type=FiniteRange())
@click.option(
    "--in",
    "unit",
    type=UnitName([COUNTS, RPM, *Unit]),
    help=f"VALUE is so many of it per second; rpm: turns of the motor.  [default: that of the joint, else {COUNTS}]",
)
@lasting(low_open=True)
@click.option("--mode", "mode_name_", type=click.Choice(list(_MODES)), help="By default pv, else vl, whichever it has.")
@click.option("--acceleration", type=_ABOVE_0, help="Per second, in the unit of VALUE; by default the drive's own ramp.")
@click.option("--deceleration", type=_ABOVE_0, help="In the same way.")
@click.option("--max-speed", type=_ABOVE_0, help="The highest VALUE; by default the drive's, else 30,000 counts per second.")
@click.option(
    "--counts-per-motor-turn",
    type=_ABOVE_0,
    metavar="COUNTS",
    help="For rpm, and for vl: COUNTS of the position in a turn of the motor, by its manual.  [default: as the drive tells]",
)
@enabling
@commanding
def velocity(
    settings: Settings,
    screen: Screen,
    value: float,
    unit: str | None,
    seconds: float,
    mode_name_: str | None,
    acceleration: float | None,
    deceleration: float | None,
    max_speed: float | None,
    counts_per_motor_turn: float | None,
) -> None:
    """Run a drive at a velocity (profile velocity, else velocity), until Ctrl-C. IT MOVES, as long as the command runs.

    Then the drive is halted, and has no power once it stands. It is also halted before the limits of its position (0x607D), if
    it tells them. It gets VALUE rounded to its own unit; the command tells which velocity that is. A joint of a machine file runs
    in the unit, and within the limits, that stand there.

    \b
    canopen drive velocity 5 500 --for 2s -b can0
    """
    chosen, scale = unit_of_command(settings, unit)
    told: list[procedures.Running] = []

    def tell(running: procedures.Running) -> None:
        told.append(running)
        if running.is_reached:
            return
        rounded = "" if abs(running.velocity - value) < 1e-9 + 1e-6 * abs(value) else f" ({value:g} was asked for)"
        end = "Ctrl-C stops it" if seconds == math.inf else until_text(seconds)
        screen.say(f"it runs at {_named(running.velocity, chosen)}{rounded}, in {mode_name(running.mode)}; {end}")

    def procedure(axis: Axis) -> Procedure[tuple[DriveView, float | None]]:
        yield from procedures.identify(axis)
        mode = yield from procedures.choose_velocity_mode(axis, None if mode_name_ is None else _MODES[mode_name_])
        if counts_per_motor_turn is not None:
            axis.settings = replace(axis.settings, counts_per_motor_turn=counts_per_motor_turn)
        yield from _set_scale(axis, value, chosen, mode, max_speed)
        if max_speed is not None:  # the limit of a joint in the machine file stays
            limit = axis.settings.max_speed
            axis.settings = replace(axis.settings, max_speed=max_speed if limit is None else min(max_speed, limit))
        run = procedures.run_at(
            axis,
            value,
            duration=None if seconds == math.inf else round(seconds * SECOND),
            mode=mode,
            acceleration=acceleration,
            deceleration=deceleration,
            news=tell,
        )
        measured = yield from ends_unpowered(axis, run)
        return (yield from look_at_drive(axis.node)), measured

    view, measured = command_drive(settings, screen, procedure, _ended, scale, ends=seconds < math.inf, enables=True)
    last = told[-1]
    if settings.json:
        document = {"velocity": last.velocity, "unit": chosen, "mode": int(last.mode), "reached": last.is_reached}
        screen.json({**document, "measured": measured, "state": str(view.state)})
        return
    screen.fact("told", _named(last.velocity, chosen) + ("" if last.is_reached else ", which it did not show in that time"))
    screen.fact(
        "ran", "it shows no velocity" if measured is None else f"at {_named(float(f'{measured:.6g}'), chosen)}, as it shows"
    )
    screen.fact("state", str(view.state))


def _named(value: float, unit: str) -> str:
    if unit == RPM:
        return f"{value:.10g} rpm"
    return f"{value:.10g} {unit if unit == COUNTS else f'{unit}s'} per second"


def _set_scale(axis: Axis, value: float, unit: str, mode: Mode, max_speed: float | None) -> Procedure[None]:
    """Make turns of the motor per minute the unit of the axis, if that of the command or the drive needs them.

    Raises a CommandError if nobody tells what a turn is.
    """
    if unit != RPM and mode is not Mode.VELOCITY:
        return
    units = yield from procedures.learn_units(axis)
    turn = axis.settings.counts_per_motor_turn or units.per_motor_turn
    node_id = axis.node.node_id
    if turn is None and unit == RPM and mode is Mode.VELOCITY and not (yield from _counts(axis.node)):
        told = yield from read_number(axis.node, objects.MAX_MOTOR_SPEED)
        limits = [each for each in (max_speed, told) if each]
        if not limits:  # a limit in counts says nothing here
            raise usage(
                "CO321",
                f"drive {node_id} does not tell how fast its motor may turn (0x6080)",
                tries=("--max-speed RPM, by its manual",),
            )
        axis.settings = replace(axis.settings, counts_per_unit=1.0, counts_per_motor_turn=60.0, max_speed=min(limits))
    elif turn is None:
        named = "" if unit == COUNTS else f" --in {unit}"
        shaft = "" if units.per_turn is None else f": {units.per_turn:g}, a turn of its shaft, divided by its gear"
        raise usage(
            "CO321",
            f"drive {node_id} does not tell how many counts a turn of its motor has (0x608F)",
            cause="in velocity mode (vl) its target (0x6042) is in turns of the motor; its position and its limits are in counts"
            if mode is Mode.VELOCITY
            else "rpm are turns of the motor; its position is in counts",
            tries=(
                f"canopen drive velocity {node_id} {value:g}{named} --counts-per-motor-turn COUNTS    by its manual{shaft}",
                "counts_per_motor_turn of its joint in a machine file (-m), which keeps it",
            ),
        )
    elif unit == RPM:
        axis.settings = replace(axis.settings, counts_per_unit=turn / 60)


def _counts(node: AxisNode) -> Procedure[bool]:
    """Return whether the drive has positions: then its limits are in counts. A frequency converter only turns its motor."""
    return (yield from read_number(node, objects.POSITION_ACTUAL_VALUE, signed=True)) is not None


def _ended(confirmed: bool) -> list[str]:
    return [f"the drive was {'halted, and has no power' if confirmed else 'told to halt, and to take its power away'}"]
