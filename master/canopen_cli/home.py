"""`canopen home`: home drives at the same time, and disable them afterwards."""

from __future__ import annotations

from typing import Any, Final

import click
import trio

from canopen_cli.demo_view import DemoView, JointView
from canopen_cli.failures import problem_of
from canopen_cli.options import Duration, NodeId, Settings, common, enabling
from canopen_cli.problem import usage
from canopen_cli.running import all_stand, run
from canopen_cli.screen import escape, node_text
from canopen_cli.session import Session, open_session
from canopen_master.motion.joint_procedures import awake
from canopen_proto import drive
from canopen_proto.cia402.modes import describe_status
from canopen_proto.drive.axis import Axis, AxisSettings, HomingStyle
from canopen_proto.drive.identity import identify
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, StepTimeout, all_of

REFRESH: Final = 0.1
"""Seconds between two updates of the picture."""
STYLES: Final = {"auto": None, "standard": HomingStyle.STANDARD, "schunk": HomingStyle.SCHUNK}


@click.command()
@click.argument("node_ids", metavar="NODE...", nargs=-1, required=True, type=NodeId())
@click.option(
    "--style",
    type=click.Choice(list(STYLES)),
    default="auto",
    help="How the drives home: as CiA 402 says, or as Schunk Powerball joints do.  [default: what the vendor-ID in 0x1018 says]",
)
@click.option("--method", type=int, help="Homing method, written to 0x6098 (17, 18, 19, 21, 33 to 37 ...).")
@click.option("--limit", type=Duration(), default=60 * SECOND, help="How long it may take.  [default: 60s]")
@click.option("--reset-fault", is_flag=True, help="Reset a fault first.")
@enabling
@common
@click.pass_obj
def home(settings: Settings, node_ids: tuple[int, ...], style: str, method: int | None, limit: Time, reset_fault: bool) -> None:
    """Home drives (CiA 402), all at the same time. THEY MOVE. Ctrl-C halts them."""
    if style == "schunk" and method is not None:
        raise usage("CO125", "--method is for drives that home as CiA 402 says", tries=("the same without --method",))
    screen = settings.screen()
    chosen = tuple(dict.fromkeys(node_ids))

    def procedure(session: Session, axes: dict[int, Axis]) -> Procedure[list[None]]:
        return all_of(*(_home(session, axes, node_id, style, method, limit, reset_fault) for node_id in chosen))

    async def command() -> list[Axis]:
        async with open_session(settings, screen) as session:
            axes: dict[int, Axis] = {}
            with DemoView(screen, f"homing {', '.join(map(node_text, chosen))}", range=180) as view:
                view.joints = [JointView(f"node {node_id}", node_id) for node_id in chosen]
                step = view.begin("home", "")
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(_watch, view, axes)
                    await session.master.run(procedure(session, axes))
                    nursery.cancel_scope.cancel()
                view.done(step, f"{len(chosen)} of {len(chosen)} homed")
                await session.master.run(all_of(*(drive.shut_down(axis) for axis in axes.values())))
            return [axes[node_id] for node_id in chosen]

    try:
        axes = run(settings, screen, command, story=_story)
    except Exception as error:  # noqa: BLE001 - raised again, with a note of what was done
        problem = problem_of(error)
        if isinstance(problem.__cause__, StepTimeout):
            problem.also += _story(all_stand(error))
            problem.tries = ("look whether the axis can move freely", f"a longer --limit (now {limit / SECOND:g} s)")
        raise problem from problem.__cause__
    if settings.json:
        screen.json([_as_json(axis) for axis in axes])
        return
    rows = [
        (
            f"{axis.node.node_id} (0x{axis.node.node_id:02X})",
            "[green]yes[/]" if axis.is_homed else "[red]no[/]",
            escape(", ".join(describe_status(axis.statusword, axis.mode))),
            "" if axis.position is None else f"{axis.position:.0f}",
        )
        for axis in axes
    ]
    screen.table(("node", "homed", "statusword", "position in counts"), rows, right=("node", "position in counts"))


def _story(confirmed: bool) -> list[str]:
    return [f"the drives were {'halted' if confirmed else 'told to halt'}; what was not done by then is not homed"]


def _as_json(axis: Axis) -> dict[str, Any]:
    return {
        "node": axis.node.node_id,
        "homed": axis.is_homed,
        "statusword": axis.statusword,
        "state": str(axis.state),
        "position": None if axis.position is None else round(axis.position),
    }


def _home(
    session: Session, axes: dict[int, Axis], node_id: int, style: str, method: int | None, limit: Time, reset_fault: bool
) -> Procedure[None]:
    node = session.node(node_id)
    yield from awake(node)
    settings = AxisSettings(counts_per_unit=1.0, homing=STYLES[style], homing_method=method, homing_timeout=limit)
    axis = session.master.device(node, settings=settings).axis
    axes[node_id] = axis
    yield from identify(axis)
    if axis.settings.homing is HomingStyle.SCHUNK and method is not None:
        raise ProcedureError(
            f"drive {node_id} is Schunk's by its vendor-ID (0x1018:01): its joints home without a method. "
            "Try: the same without --method, or --style standard"
        )
    if reset_fault:
        yield from drive.reset_fault(axis)
    yield from drive.home(axis)
    yield from drive.read_position(axis)


async def _watch(view: DemoView, axes: dict[int, Axis]) -> None:
    """Keep the picture up to date."""
    while True:
        for joint in view.joints:
            axis = axes.get(joint.node_id)
            if axis is not None:
                joint.state = str(axis.state) if not axis.is_homed else "homed"
        view.refresh()
        await trio.sleep(REFRESH)
