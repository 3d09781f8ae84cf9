"""`canopen drive torque NODE`: let a drive push with a torque for a time."""

from __future__ import annotations

import math
from typing import Final

import click

from canopen_cli.drive.session import command_drive
from canopen_cli.shared.numbers import NumberCommand, UnitName
from canopen_cli.shared.options import FiniteRange, Settings, command, commanding, enabling, lasting
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_master.motion.single_drive import ends_unpowered, look_at_drive
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.machine import SECOND
from canopen_proto.procedures.steps import Procedure

PER_MILLE: Final = "per-mille"
NEWTON_METRE: Final = "newton-metre"


@command(cls=NumberCommand)
@click.argument("value", type=float)
@click.option(
    "--in",
    "unit",
    type=UnitName([PER_MILLE, NEWTON_METRE]),
    default=PER_MILLE,
    show_default=True,
    help="The unit of VALUE: thousandths of the rated torque, or N·m.",
)
@lasting("For how long: 2s; then it stands.", low_open=True, required=True)
@click.option("--slope", type=FiniteRange(0, min_open=True), help="Per second, in the unit of VALUE, into 0x6087.")
@click.option(
    "--max-speed",
    type=FiniteRange(0, min_open=True),
    help="Stop it when it is faster, in counts (or the joint's unit) per second.",
)
@click.option("--any-speed", is_flag=True, help="It may be as fast as it can.")
@enabling
@commanding
def torque(
    settings: Settings,
    screen: Screen,
    value: float,
    unit: str,
    seconds: float,
    slope: float | None,
    max_speed: float | None,
    any_speed: bool,
) -> None:
    """Let a drive push with a torque (profile torque) for a time. IT MOVES, as the torque makes it. Then it has no power.

    Ctrl-C ends it earlier. Nothing is done if nothing limits the speed: neither --max-speed nor 0x607F or 0x6080 of the drive.
    The master watches the speed, and the limits of the position, and halts the drive when it leaves them. A load that the brake
    holds may fall until the torque has grown.

    \b
    canopen drive torque 5 50 --max-speed 20000 --for 0.2s -b can0
    """
    if any_speed and max_speed is not None:
        raise usage("CO123", "--max-speed and --any-speed exclude each other", tries=("one of them",))

    def procedure(axis: Axis) -> Procedure[tuple[float, float | None, DriveView]]:
        yield from procedures.identify(axis)
        rated = (yield from procedures.learn_units(axis)).rated_torque
        whole = _whole(axis, unit, rated)
        applied = procedures.apply_torque(
            axis,
            value / whole,
            round(seconds * SECOND),
            slope=None if slope is None else slope / whole,
            max_speed=math.inf if any_speed else max_speed,
        )
        given = yield from ends_unpowered(axis, applied)
        return given, None if rated is None else given * rated, (yield from look_at_drive(axis.node))

    given, newton_metres, view = command_drive(settings, screen, procedure, _ended, enables=True)
    if settings.json:
        screen.json({"per_mille": given * 1000, "newton_metre": newton_metres, "seconds": seconds, "state": str(view.state)})
        return
    said = f"{given * 1000:g} per mille of the rated torque"
    screen.fact("applied", f"{said} for {seconds:g} s" + ("" if newton_metres is None else f", which is {newton_metres:g} N·m"))
    screen.fact("state", str(view.state))


def _whole(axis: Axis, unit: str, rated: float | None) -> float:
    """Return the rated torque in the unit. rated: in N m; None: the drive does not tell it, which raises a CommandError where the
    unit needs it."""
    if unit == PER_MILLE:
        return 1000.0
    if rated is None:
        raise usage(
            "CO321",
            f"drive {axis.node.node_id} does not tell its rated torque (0x6076)",
            tries=("the same in per mille, without --in",),
        )
    return rated


def _ended(confirmed: bool) -> list[str]:
    return [f"the drive was {'stopped, and has no power' if confirmed else 'told to stop, and to take its power away'}"]
