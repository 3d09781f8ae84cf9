"""`canopen drive`: one drive by CiA 402: its state and what keeps it from moving, its units; power, mode, moves."""

from __future__ import annotations

from typing import Any, Final

import click

from canopen_cli.drive.session import AXIS, NODE
from canopen_cli.shared.chosen_machine import NUMBER
from canopen_cli.shared.lazy import LazyGroup
from canopen_cli.shared.options import DriveId
from canopen_cli.shared.problem import usage
from canopen_proto.drives.cia402.axes import MAX_AXES

COMMANDS: Final = {
    "state": ("drive.state", "Show state, mode and position of a drive, and what keeps it from moving."),
    "units": ("drive.state", "Show what the numbers of a drive mean, and which of its objects say so (the factor group)."),
    "fault-reset": ("drive.state", "Reset a fault: a rising edge of bit 7."),
    "plan": (
        "drive.motion_plan:plan",
        "Show how a drive would follow set-points: its mode and why, its PDOs, and what would be written to it.",
    ),
    "mode": ("drive.state", "Show the modes of operation that a drive has; with MODE (pp, ip, csp ... or a number) select one."),
    "enable": ("drive.power", "Give a drive power, in a mode in which that moves nothing, until Ctrl-C."),
    "home": ("drive.home:home_one", "Home a drive (CiA 402), by METHOD (written to 0x6098) or by its own."),
    "move": ("drive.power", "Move a drive to POSITION by its own profile (profile position)."),
    "velocity": ("drive.velocity", "Run a drive at a velocity (profile velocity, else velocity), until Ctrl-C."),
    "torque": ("drive.torque", "Let a drive push with a torque (profile torque) for a time."),
    "commission": (
        "drive.commission",
        "Commission a new drive, step by step: identity, file, units, limits, a small move, homing, a first move.",
    ),
    "inputs": ("drive.io", "Show the digital inputs of a drive (0x60FD)."),
    "outputs": ("drive.io", "Show the digital outputs of a drive (0x60FE); with BIT=0 or BIT=1 set some of them."),
    "probe": ("drive.io", "Arm a touch probe (0x60B8), wait for its edge, and show the position there."),
    "stop": ("drive.stop", "Command a quick stop, and wait until the drive stands."),
    "disable": ("drive.stop", "Take the power from a drive."),
}


_FIRST_AXIS: Final = ("commission",)
"""Commands that know the first axis only."""
_AXIS: Final = "axis_number"


class _NodeBeforeCommand(DriveId):
    """A node-ID or a name before a command: an exchange of the two is noticed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if str(value) in COMMANDS:
            raise usage("CO120", f"the node comes before {value!r}", tries=(f"canopen drive 3 {value}",))
        # The machine file of a name may be named behind it
        return super().convert(value, param, ctx) if NUMBER.fullmatch(str(value)) else str(value)


class _Drives(LazyGroup):
    """The commands, each of which can be about a further axis of the node."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None or cmd_name in _FIRST_AXIS or any(each.name == _AXIS for each in command.params):
            return command

        def choose(context: click.Context, param: click.Parameter, axis: int | None) -> None:
            context.meta[AXIS] = axis

        axis = click.Option(
            ("--axis", _AXIS),
            type=click.IntRange(0, MAX_AXES - 1),
            help="Which axis of the node: its objects are those of the first one, 0x800 * AXIS higher.  [default: 0]",
            expose_value=False,
            callback=choose,
        )
        command.params.append(axis)
        return command


@click.group(cls=_Drives, table=COMMANDS)
@click.argument("node_id", metavar="NODE", type=_NodeBeforeCommand())
@click.pass_context
def drive(ctx: click.Context, node_id: int | str) -> None:
    """One drive (CiA 402): what it shows, why it does not move, what its numbers mean.

    \b
    canopen drive 3 state -b demo      and what keeps it from moving
    canopen drive 3 units -b demo      what a count is, and where that stands
    canopen drive 3 fault-reset -b demo
    canopen drive 3 mode -b demo       the modes that it has; with a mode: select it
    canopen drive 3 plan -e FILE ...   how it would follow set-points: mode and PDOs; nothing is written
    canopen drive 3 home 19 -b demo    IT MOVES, to its reference; --list: the homing methods
    canopen drive 3 move 2000 -b demo  IT MOVES, in counts or --in degree; Ctrl-C halts it
    canopen drive 3 velocity 500 --in rpm -b demo   IT MOVES, as long as the command runs
    canopen drive 3 torque 50 ...      IT MOVES, pushed by 50 per mille of its rated torque for --seconds
    canopen drive 3 inputs -b demo     digital inputs; outputs: the outputs, 16=1 sets one
    canopen drive 3 probe -b demo      the position at the edge of a touch probe
    canopen drive 3 enable -b demo     power until Ctrl-C
    canopen drive 3 disable -b demo    no power, from any state
    canopen drive 3 commission ...     IT MOVES: a new drive, from its identity to the first move; asks before each motion
    canopen drive 3 stop -b demo       a quick stop
    canopen drive 3 state --axis 1 ... the second of several drives behind one node-ID (0x6840, 0x6841 ...)
    """
    ctx.meta[NODE] = node_id
