"""`canopen drive plan NODE`: the mode in which a drive would follow set-points, and its PDOs. The drive is only read."""

from __future__ import annotations

from typing import Any, Final

import click

from canopen_cli.demo.demo import CYCLE
from canopen_cli.drive.session import axis_of_command, node_of_command, run_on_node
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import BusSession
from canopen_master.node import Node
from canopen_proto.dictionary.download_order import Write
from canopen_proto.drives.axis.axis_node import node_of_axis
from canopen_proto.drives.axis.motion_plan import MODES, MotionPlan, pending_steps, plan_motion, read_modes
from canopen_proto.drives.cia402.modes import mode_name, short_name
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import mux_text
from canopen_proto.pdo.settings import step_text
from canopen_proto.procedures.steps import Procedure

_SHORT: Final = {short_name(mode): mode for mode in MODES}


@command()
@click.option("--mode", "wish", type=click.Choice(list(_SHORT)), help="Only this mode.  [default: the first that works]")
@click.option("--cycle", type=CYCLE, help="Time between two SYNCs.  [default: that of the machine file, else 10ms]")
@click.option("--feed-forward", is_flag=True, help="With an RPDO for what is fed forward in csp: 0x60B1 and 0x60B2.")
def plan(settings: Settings, screen: Screen, wish: str | None, cycle: Time | None, feed_forward: bool) -> None:
    """Show how a drive would follow set-points: its mode and why, its PDOs, and what would be written to it. Nothing is written.

    The drive's file (-e, or that of the machine file) says which PDOs it has and what they may carry; 0x6502 of the drive says
    its modes. So does a chain with ChainSettings(mode=None), and `canopen demo --eds`.

    \b
    canopen drive plan 5 -e drive.eds -b socketcan:can0
    canopen drive plan 5 -e drive.eds -b socketcan:can0 --mode pp
    """
    if not settings.has_file(node_of_command()):
        raise usage(
            "CO134",
            "a plan needs the drive's own file, which says what its PDOs may carry",
            tries=("-e FILE.eds, from the maker of the drive", "file = ... of its node in the machine file (-m)"),
        )

    machine = settings.machine_file()
    period = cycle or (10 * MILLISECOND if machine is None else machine.master.cycle)

    axis = axis_of_command(settings)

    def procedure(session: BusSession, node: Node) -> Procedure[tuple[MotionPlan, list[Write]]]:
        modes = yield from read_modes(node_of_axis(node.remote, axis))
        mode = None if wish is None else _SHORT[wish]
        made = plan_motion(node.dictionary, node.node_id, period, modes=modes, wish=mode, axis=axis, feed_forward=feed_forward)
        return made, (yield from pending_steps(node.remote, made))

    made, steps = run_on_node(settings, screen, procedure)
    if settings.json:
        screen.json(_as_json(made, steps))
        return
    screen.fact("mode", f"{mode_name(made.mode)}: {made.reason}")
    for obstacle in made.rejected:
        screen.fact("", f"not {short_name(obstacle.mode)}: {obstacle.reason}")
    for name, lines in made.facts:
        screen.fact(name, lines)
    screen.table(("would be written", "value"), list(map(step_text, steps)))
    screen.say("Nothing was written." if steps else "Nothing would be written: the drive has these PDOs.")


def _as_json(made: MotionPlan, steps: list[Write]) -> dict[str, Any]:
    return {
        "mode": short_name(made.mode),
        "reason": made.reason,
        "rejected": [{"mode": short_name(each.mode), "reason": each.reason} for each in made.rejected],
        "pdos": [
            {
                "pdo": pdo.name,
                "cob_id": pdo.cob_id,
                "transmission_type": pdo.transmission_type,
                "entries": list(pdo.entries),
            }
            for pdo in made.pdos
        ],
        "written_by_sdo": [mux_text(key) for key in made.commands_by_sdo],
        "read_by_sdo": [mux_text(key) for key in made.watched_by_sdo],
        "notes": list(made.notes),
        "writes": [{"object": place, "value": value} for place, value in map(step_text, steps)],
    }
