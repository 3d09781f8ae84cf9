"""`canopen drive enable NODE|move`: what gives a drive power, for as long as the command runs."""

from __future__ import annotations

import math

import click

from canopen_cli.drive.session import command_drive, node_of_command, show_drive, unit_of_command
from canopen_cli.shared.numbers import NumberCommand, UnitName, position_text
from canopen_cli.shared.options import Duration, Settings, command, commanding, enabling, lasting
from canopen_cli.shared.problem import usage, with_bus
from canopen_cli.shared.screen import Screen
from canopen_master.motion.single_drive import ends_unpowered, look_at_drive
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.units import COUNTS, Unit
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.axis.watching import DriveWait
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.drives.cia402.states import POWERED, State
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, current_time


@command()
@lasting()
@enabling
@commanding
def enable(settings: Settings, screen: Screen, seconds: float) -> None:
    """Give a drive power, in a mode in which that moves nothing, until Ctrl-C. Then it has none.

    \b
    canopen drive enable 3 -b demo --for 5s
    """

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from identify(axis)
        yield from procedures.select_motionless_mode(axis)
        yield from ends_unpowered(axis, held(axis))
        return (yield from look_at_drive(axis.node))

    def held(axis: Axis) -> Procedure[None]:
        yield from procedures.enable(axis)
        tell(f"drive {axis.node.node_id} is enabled, in {mode_name(axis.mode or 0)}; Ctrl-C disables it")
        end = NEVER if seconds == math.inf else (yield from current_time()) + round(seconds * SECOND)
        watch: DriveWait[bool] = DriveWait(axis, "the end of its time", stays=State.OPERATION_ENABLED)
        yield from watch.until(lambda statusword, heard_at: heard_at >= end or None, NEVER)
        tell(f"{seconds:g} s are over: it gets no more power")

    def tell(what: str) -> None:
        if not settings.dry_run:  # then a simulated drive is enabled, and not the one that is named
            screen.say(what)

    def story(confirmed: bool) -> list[str]:
        return ["the drive has no power any more" if confirmed else "the drive was told to have no power any more"]

    show_drive(settings, screen, command_drive(settings, screen, procedure, story, ends=seconds < math.inf, enables=True))


@command(cls=NumberCommand)
@click.argument("position", type=float)
@click.option("--relative", is_flag=True, help="By so much from where it stands.")
@click.option(
    "--in",
    "unit",
    type=UnitName([COUNTS, *Unit]),
    help=f"The unit of POSITION.  [default: that of the joint in the machine file, else {COUNTS}]",
)
@click.option("--limit", type=Duration(), default=60 * SECOND, help="How long it may take.  [default: 60s]")
@enabling
@commanding
def move(settings: Settings, screen: Screen, position: float, relative: bool, unit: str | None, limit: Time) -> None:
    """Move a drive to POSITION by its own profile (profile position). IT MOVES. At its target it has no power. Ctrl-C halts it.

    The speed is that of 0x6081, the ramps those of 0x6083 and 0x6084: `canopen write NODE 0x6081 ...` changes them. Units other
    than counts need a drive that tells its scale: `canopen drive units NODE`. A joint of a machine file moves in the unit, and
    within the limits, that stand there.

    \b
    canopen drive move 3 2000 -b demo
    canopen drive move 3 --relative -b demo -- -500
    """
    chosen, scale = unit_of_command(settings, unit)
    if chosen == COUNTS and not position.is_integer():
        raise usage("CO120", f"a position in counts is a whole number; it is {position!r}", tries=("a whole number, or --in",))

    moving: list[Axis] = []

    def story(confirmed: bool) -> list[str]:
        told = f"the drive was {'halted' if confirmed else 'told to halt'}: it is not at its target"
        return [told, *power_of(moving)]

    def power_of(axes: list[Axis]) -> list[str]:
        disable = with_bus(f"canopen drive disable {node_of_command()}", *settings.typed_bus())
        return [f"it still has power: {disable}" for axis in axes if axis.state in POWERED]

    def procedure(axis: Axis) -> Procedure[tuple[float, float, float, DriveView]]:
        yield from identify(axis)
        begin = yield from procedures.read_position(axis)
        try:
            moving.append(axis)
            yield from procedures.move_to(axis, position, timeout=limit, relative=relative)
        except ProcedureError as error:
            for words in power_of(moving):
                error.add_note(words)
            raise
        end = yield from procedures.read_position(axis)
        yield from procedures.shut_down(axis)
        return begin, end, 1 / axis.scale.amount_from_counts(1), (yield from look_at_drive(axis.node))

    begin, end, counts, view = command_drive(settings, screen, procedure, story, scale, enables=True)
    if settings.json:
        screen.json({"from": begin, "to": end, "unit": chosen, "state": str(view.state)})
        return
    name = chosen if chosen == COUNTS else f"{chosen}s"
    screen.fact("moved", f"from {position_text(begin, counts)} to {position_text(end, counts)} {name}")
    screen.fact("state", str(view.state))
