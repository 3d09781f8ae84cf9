"""`canopen drive`: one drive by CiA 402: its state and what keeps it from moving, its units; disable it, reset its fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import click

from canopen_cli.options import NodeId, Settings, common
from canopen_cli.problem import ExitCode, Problem, usage
from canopen_cli.running import run
from canopen_cli.screen import Screen, node_text
from canopen_cli.session import Session, open_session
from canopen_master.motion.joint_procedures import awake
from canopen_proto import drive as procedures
from canopen_proto.cia402.modes import describe_status, mode_name
from canopen_proto.drive.axis import Axis, AxisSettings
from canopen_proto.drive.reasons import DriveView, look_at, reasons
from canopen_proto.drive.units import DriveUnits, Unit, read_units
from canopen_proto.procedures.steps import Procedure

T = TypeVar("T")

_NODE: Final = "canopen.drive.node"
_COUNTS: Final = AxisSettings(counts_per_unit=1.0)


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
    canopen drive 3 disable -b demo    no power, from any state
    """
    ctx.meta[_NODE] = node_id


def _on_axis(settings: Settings, screen: Screen, procedure: Callable[[Axis], Procedure[T]]) -> T:
    """Run a procedure on the drive that the command line names."""
    node_id: int = click.get_current_context().meta[_NODE]

    def whole(session: Session) -> Procedure[T]:
        node = session.node(node_id)
        yield from awake(node)
        return (yield from procedure(session.master.device(node, settings=_COUNTS).axis))

    async def command() -> T:
        async with open_session(settings, screen) as session:
            return await session.master.run(whole(session))

    return run(settings, screen, command)


def _look_at(axis: Axis) -> Procedure[DriveView]:
    view = yield from look_at(axis.node)
    if view is None:
        raise Problem(
            ExitCode.SDO_ABORT,
            "CO408",
            f"{node_text(axis.node.node_id)} is no drive by CiA 402: it has no statusword (0x6041)",
            tries=(f"canopen info {axis.node.node_id}    what it is",),
        )
    return view


@drive.command()
@common
@click.pass_obj
def state(settings: Settings) -> None:
    """Show state, mode and position of a drive, and what keeps it from moving."""
    screen = settings.screen()
    _show(settings, screen, _on_axis(settings, screen, _look_at))


@drive.command("fault-reset")
@common
@click.pass_obj
def fault_reset(settings: Settings) -> None:
    """Reset a fault: a rising edge of bit 7. It moves nothing: the drive is not enabled afterwards."""
    screen = settings.screen()

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from procedures.reset_fault(axis)
        return (yield from _look_at(axis))

    _show(settings, screen, _on_axis(settings, screen, procedure))


@drive.command()
@common
@click.pass_obj
def disable(settings: Settings) -> None:
    """Take the power from a drive. One that moves is stopped as its option codes (0x605B, 0x605C) say, or coasts."""
    screen = settings.screen()

    def procedure(axis: Axis) -> Procedure[DriveView]:
        yield from procedures.shut_down(axis)
        return (yield from _look_at(axis))

    _show(settings, screen, _on_axis(settings, screen, procedure))


@drive.command()
@common
@click.pass_obj
def units(settings: Settings) -> None:
    """Show what the numbers of a drive mean, and which of its objects say so (the factor group)."""
    screen = settings.screen()
    found = _on_axis(settings, screen, lambda axis: read_units(axis.node))
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
    for number, (what, remedy) in enumerate(found):
        screen.fact("" if number else "it does not move", f"{what}. Try: {remedy}")
