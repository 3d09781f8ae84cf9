"""`canopen drive`: one drive by CiA 402: its state and what keeps it from moving, its units; power, mode, moves."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, TypeVar

import click

from canopen_cli.options import Duration, NodeId, Settings, common, enabling
from canopen_cli.problem import ExitCode, Problem, usage
from canopen_cli.running import Story, run
from canopen_cli.screen import Screen, node_text
from canopen_cli.session import Session, open_session
from canopen_master.motion.joint_procedures import awake
from canopen_master.node import Node
from canopen_proto import drive as procedures
from canopen_proto.cia402.modes import Mode, describe_status, mode_name, supported_modes
from canopen_proto.cia402.states import POWERED, State
from canopen_proto.drive.axis import Axis, AxisSettings
from canopen_proto.drive.identity import identify
from canopen_proto.drive.reasons import DriveView, look_at, reasons
from canopen_proto.drive.units import DriveUnits, Unit, read_units
from canopen_proto.drive.watching import Watch
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, current_time
from canopen_proto.remote_node import RemoteNode

T = TypeVar("T")

COUNTS: Final = "counts"
_NODE: Final = "canopen.drive.node"


class _Node(NodeId):
    """A node-ID before a command: an exchange of the two is noticed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if str(value) in drive.commands:
            raise usage("CO120", f"the node comes before {value!r}", tries=(f"canopen drive 3 {value}",))
        return super().convert(value, param, ctx)


@click.group()
@click.argument("node_id", metavar="NODE", type=_Node())
@click.pass_context
def drive(ctx: click.Context, node_id: int) -> None:
    """One drive (CiA 402): what it shows, why it does not move, what its numbers mean.

    \b
    canopen drive 3 state -b demo      and what keeps it from moving
    canopen drive 3 units -b demo      what a count is, and where that stands
    canopen drive 3 fault-reset -b demo
    canopen drive 3 mode -b demo       the modes that it has; with a mode: select it
    canopen drive 3 move 2000 -b demo  IT MOVES, in counts or --in degree; Ctrl-C halts it
    canopen drive 3 enable -b demo     power until Ctrl-C
    canopen drive 3 disable -b demo    no power, from any state
    canopen drive 3 stop -b demo       a quick stop
    """
    ctx.meta[_NODE] = node_id


def _run(
    settings: Settings, screen: Screen, procedure: Callable[[Session, Node], Procedure[T]], story: Story = lambda confirmed: []
) -> T:
    """Run a procedure on the node that the command line names."""
    node_id: int = click.get_current_context().meta[_NODE]

    async def command() -> T:
        async with open_session(settings, screen) as session:
            return await session.master.run(procedure(session, session.node(node_id)))

    return run(settings, screen, command, story=story)


def _read(settings: Settings, screen: Screen, procedure: Callable[[RemoteNode], Procedure[T]]) -> T:
    """Run a procedure that only reads: another program may move the drive meanwhile."""
    return _run(settings, screen, lambda session, node: procedure(node.remote))


def _command(
    settings: Settings,
    screen: Screen,
    procedure: Callable[[Axis], Procedure[T]],
    story: Story = lambda confirmed: [],
    scale: Callable[[Node], Procedure[float]] | None = None,
) -> T:
    """Run a procedure that commands the drive. scale: reads the counts in one unit; by default the unit is the count."""

    def whole(session: Session, node: Node) -> Procedure[T]:
        yield from awake(node)
        counts = 1.0 if scale is None else (yield from scale(node))
        return (yield from procedure(session.master.device(node, settings=AxisSettings(counts_per_unit=counts)).axis))

    return _run(settings, screen, whole, story)


def _look_at(node: RemoteNode) -> Procedure[DriveView]:
    view = yield from look_at(node)
    if view is None:
        raise Problem(
            ExitCode.SDO_ABORT,
            "CO408",
            f"{node_text(node.node_id)} is no drive by CiA 402: it has no statusword (0x6041)",
            tries=(f"canopen info {node.node_id}    what it is",),
        )
    return view


def _do(settings: Settings, step: Callable[[Axis], Procedure[None]]) -> None:
    """Take a step with the drive, and show what it shows then."""
    screen = settings.screen()

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from step(axis)
        return (yield from _look_at(axis.node))

    _show(settings, screen, _command(settings, screen, procedure))


@drive.command()
@common
@click.pass_obj
def state(settings: Settings) -> None:
    """Show state, mode and position of a drive, and what keeps it from moving."""
    screen = settings.screen()
    _show(settings, screen, _read(settings, screen, _look_at))


@drive.command("fault-reset")
@common
@click.pass_obj
def fault_reset(settings: Settings) -> None:
    """Reset a fault: a rising edge of bit 7. It moves nothing: the drive is not enabled afterwards."""
    _do(settings, procedures.reset_fault)


@drive.command()
@common
@click.pass_obj
def disable(settings: Settings) -> None:
    """Take the power from a drive. One that moves is stopped as its option codes (0x605B, 0x605C) say, or coasts."""
    _do(settings, procedures.shut_down)


@drive.command()
@common
@click.pass_obj
def units(settings: Settings) -> None:
    """Show what the numbers of a drive mean, and which of its objects say so (the factor group)."""
    screen = settings.screen()
    found = _read(settings, screen, read_units)
    if settings.json:
        screen.json(_units_json(found))
        return
    rows = [row for row in _units_rows(found) if row[1]]
    screen.table(("", "on the wire", "which says"), rows)
    for conflict in found.conflicts:
        screen.data(f"[yellow]these differ:[/] {conflict}")
    if found.per_turn is None and found.per_metre is None:
        screen.say("The drive does not tell what a count is. Try: --counts-per-degree, by its manual")


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
        "rated_torque": units.rated_torque,
        "reversed": list(units.reversed),
        "home_offset": units.home_offset,
        "origins": dict(units.origins),
        "conflicts": list(units.conflicts),
    }


def _show(settings: Settings, screen: Screen, view: DriveView) -> None:
    """Show what a drive shows, and what keeps it from moving."""
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
        screen.fact("position", f"{view.position} counts")
    if not found:
        screen.fact("it does not move", "if nothing commands it to: no obstacle was found")
    for number, (what, remedy, _) in enumerate(found):
        screen.fact("" if number else "it does not move", f"{what}. Try: {remedy}")


@drive.command()
@common
@click.pass_obj
def stop(settings: Settings) -> None:
    """Command a quick stop. The drive brakes as 0x605A says, and most drives have no power afterwards."""
    _do(settings, procedures.quick_stop)


@drive.command()
@click.argument("name", metavar="[MODE]", required=False)
@common
@click.pass_obj
def mode(settings: Settings, name: str | None) -> None:
    """Show the modes of operation that a drive has; with MODE (pp, ip, csp ... or a number) select one.

    A drive that is enabled is not changed: in some modes it would obey an old target at once.
    """
    screen = settings.screen()

    def select(axis: Axis, number: int) -> Procedure[DriveView]:
        view = yield from _look_at(axis.node)
        if view.state in POWERED:
            raise Problem(
                ExitCode.DRIVE_FAULT,
                "CO409",
                f"drive {axis.node.node_id} has power ({view.state}): in another mode it could obey an old target at once",
                tries=(f"canopen drive {axis.node.node_id} disable",),
            )
        yield from procedures.set_mode(axis, number)
        return (yield from _look_at(axis.node))

    if name is None:
        view = _read(settings, screen, _look_at)
    else:
        view = _command(settings, screen, partial(select, number=_mode_of(name)))
    modes = () if view.supported_modes is None else supported_modes(view.supported_modes)
    if settings.json:
        screen.json({"mode": view.mode, "wanted_mode": view.wanted_mode, "supported_modes": list(modes)})
        return
    screen.fact("mode", "not told (0x6061)" if view.mode is None else mode_name(view.mode))
    screen.fact("it has", ", ".join(map(mode_name, modes)) if modes else "it does not tell (0x6502)")


def _mode_of(name: str) -> int:
    """Return the number of a mode that the command line names."""
    short = {mode_name(each).rpartition("(")[2].rstrip(")"): int(each) for each in Mode if each}
    if name.lower() in short:
        return short[name.lower()]
    if re.fullmatch("-?[0-9]{1,3}", name) and -128 <= int(name) <= 127:
        return int(name)
    raise usage("CO136", f"{name!r} is no mode of operation", tries=(f"one of {', '.join(short)}, or a number from -128 to 127",))


@drive.command()
@click.option("--seconds", type=click.FloatRange(0), help="End after this time, instead of by Ctrl-C.")
@enabling
@common
@click.pass_obj
def enable(settings: Settings, seconds: float | None) -> None:
    """Give a drive power, in a mode in which that moves nothing, until Ctrl-C. Then it has none."""
    screen = settings.screen()

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from identify(axis)
        yield from procedures.select_standing_mode(axis)
        try:
            yield from procedures.enable(axis)
            screen.say(f"drive {axis.node.node_id} is enabled, in {mode_name(axis.mode or 0)}; Ctrl-C disables it")
            end = NEVER if seconds is None else (yield from current_time()) + round(seconds * SECOND)
            watch: Watch[bool] = Watch(axis, "the end of its time", stays=State.OPERATION_ENABLED)
            yield from watch.until(lambda statusword, heard_at: heard_at >= end or None, NEVER)
        except (Cancelled, ProcedureError):
            yield from procedures.shut_down(axis)
            raise
        yield from procedures.shut_down(axis)
        return (yield from _look_at(axis.node))

    _show(settings, screen, _command(settings, screen, procedure))


@drive.command()
@click.argument("position", type=float)
@click.option("--relative", is_flag=True, help="By so much from where it stands.")
@click.option(
    "--in",
    "unit",
    type=click.Choice([COUNTS, *(each.value for each in Unit)]),
    default=COUNTS,
    show_default=True,
    help="The unit of POSITION.",
)
@click.option("--limit", type=Duration(), default=60 * SECOND, help="How long it may take.  [default: 60s]")
@enabling
@common
@click.pass_obj
def move(settings: Settings, position: float, relative: bool, unit: str, limit: Time) -> None:
    """Move a drive to POSITION by its own profile (profile position). IT MOVES. At its target it has no power. Ctrl-C halts it.

    The speed is that of 0x6081, the ramps those of 0x6083 and 0x6084: `canopen write NODE 0x6081 ...` changes them. Units other
    than counts need a drive that tells its scale: `canopen drive NODE units`.
    """
    screen = settings.screen()

    def procedure(axis: Axis) -> Procedure[tuple[float, float, DriveView]]:
        yield from identify(axis)
        begin = yield from procedures.read_position(axis)
        yield from procedures.move_to(axis, position, timeout=limit, relative=relative)
        end = yield from procedures.read_position(axis)
        yield from procedures.shut_down(axis)
        return begin, end, (yield from _look_at(axis.node))

    scale = None if unit == COUNTS else partial(_scale, unit=Unit(unit))
    begin, end, view = _command(settings, screen, procedure, _moved, scale)
    if settings.json:
        screen.json({"from": begin, "to": end, "unit": unit, "state": str(view.state)})
        return
    name = unit if unit == COUNTS else f"{unit}s"
    screen.fact("moved", f"from {begin:.10g} to {end:.10g} {name}")
    screen.fact("state", str(view.state))


def _moved(confirmed: bool) -> list[str]:
    return [f"the drive was {'halted' if confirmed else 'told to halt'}: it is not at its target"]


def _scale(node: Node, unit: Unit) -> Procedure[float]:
    """Return the counts in one unit, as the drive tells. Raises a Problem if it does not."""
    found = (yield from read_units(node.remote)).counts_per(unit)
    if found is None:
        raise Problem(
            ExitCode.USAGE,
            "CO321",
            f"drive {node.node_id} does not tell how many counts a {unit} has",
            tries=(f"canopen drive {node.node_id} units    what it tells", "the same in counts, without --in"),
        )
    return found
