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
_NODE: Final = "node_of_command"


class _NodeName(DriveId):
    """The node of a command: its number is checked at once, a name once the command has read its machine file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return super().convert(value, param, ctx) if NUMBER.fullmatch(str(value)) else str(value)


class _Drives(LazyGroup):
    """The commands. Each is about a node, and most can be about a further axis of it.

    The command comes before the node: `drive move 5 2000`. `drive 5 move 2000`, the order of old, is understood as well.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        is_old = len(args) > 1 and args[0] not in self.table and not args[0].startswith("-")
        if is_old and (args[1] in self.table or (_is_node(args[0]) and not args[1].startswith("-"))):
            args[:2] = [args[1], args[0]]
        elif args and _is_node(args[0]) and not ctx.resilient_parsing:
            raise usage(
                "CO001", f"what is drive {args[0]} to do?", tries=(f"canopen drive state {args[0]}", "canopen drive --help")
            )
        return super().parse_args(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None or any(each.name == _NODE for each in command.params):
            return command

        def name(context: click.Context, param: click.Parameter, node_id: int | str) -> None:
            context.meta[NODE] = node_id

        command.params.insert(0, click.Argument((_NODE,), metavar="NODE", type=_NodeName(), expose_value=False, callback=name))
        if cmd_name in _FIRST_AXIS:
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


def _is_node(word: str) -> bool:
    return NUMBER.fullmatch(word) is not None


@click.group(cls=_Drives, table=COMMANDS)
def drive() -> None:
    """One drive (CiA 402): what it shows, why it does not move, what its numbers mean.

    \b
    canopen drive state 3 -b demo      and what keeps it from moving
    canopen drive units 3 -b demo      what a count is, and where that stands
    canopen drive fault-reset 3 -b demo
    canopen drive mode 3 -b demo       the modes that it has; with a mode: select it
    canopen drive plan 3 -e FILE ...   how it would follow set-points: mode and PDOs; nothing is written
    canopen drive home 3 -b demo       IT MOVES, to its reference; --list: the homing methods
    canopen drive move 3 2000 -b demo  IT MOVES, in counts or --in degree; Ctrl-C halts it
    canopen drive velocity 5 2000 -b can0   IT MOVES, as long as the command runs
    canopen drive torque 5 50 ...      IT MOVES, pushed by 50 per mille of its rated torque for --for
    canopen drive inputs 3 -b demo     digital inputs; outputs: the outputs, 16=1 sets one
    canopen drive probe 5 -b can0      the position at the edge of a touch probe
    canopen drive enable 3 -b demo     power until Ctrl-C
    canopen drive disable 3 -b demo    no power, from any state
    canopen drive commission 3 ...     IT MOVES: a new drive, from its identity to the first move; asks before each motion
    canopen drive stop 3 -b demo       a quick stop
    canopen drive state 3 --axis 1 ... the second of several drives behind one node-ID (0x6840, 0x6841 ...)
    """
