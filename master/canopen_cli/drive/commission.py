"""`canopen drive commission NODE`: a new drive, from its identity to the first move; its machine file and its DCF."""

from __future__ import annotations

import os
from pathlib import Path

import click

from canopen_cli.drive.commissioning import dialogue_of
from canopen_cli.drive.session import axis_of_command, node_of_command
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import DEMO, Settings, command, enabling, without_dry_run
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import is_asked
from canopen_cli.shared.running import all_stand, run
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import open_session
from canopen_master.commissioning import commissioned_machine, commissioned_name
from canopen_master.commissioning_dialogue import CommissioningDialogue, renamed_text
from canopen_master.machine_file import machine_text
from canopen_master.simulation.serving import DEMO_LOCATOR


@command()
@click.option("-o", "--output", metavar="FILE.toml", help="The machine file to write.  [default: NAME.toml]")
@click.option("--dcf", metavar="FILE.dcf", help="The drive's values, as they were before.  [default: NAME.dcf]")
@click.option("--name", help="The name of its joint.  [default: that of the machine file (-m), else driveNODE]")
@click.option("--yes", is_flag=True, help="Ask nothing, and move: for simulated drives (-b demo, -b virtual:...) only.")
@without_dry_run(
    "each step depends on how the drive has moved in the one before",
    "canopen drive commission 3 -b demo --yes    (all of it, with a simulated drive)",
)
@enabling
def commission(settings: Settings, screen: Screen, output: str | None, dcf: str | None, name: str | None, yes: bool) -> int:
    """Commission a new drive, step by step: identity, file, units, limits, a small move, homing, a first move. IT MOVES.

    Each motion is asked for before, and an empty answer is always safe: nothing moves by it. The drive has power only while it
    moves. Ctrl-C halts it, and says what was done. The values as they were go into a DCF, which `canopen restore` writes back;
    units, limits and homing into a machine file, once you have confirmed the small move. With -m it is that machine, with this
    joint changed; its comments are lost.

    Exit status 7: it was not moved, or the move was not confirmed, so there is no machine file.

    \b
    canopen drive commission 5 -e drive.eds -b socketcan:can0
    canopen drive commission 3 -b demo --yes                   with a simulated drive
    """
    node_id, bus = node_of_command(), settings.required_bus()
    if axis := axis_of_command(settings):
        raise usage("CO123", f"only the first axis of a node can be commissioned, and this is axis {axis}")
    if yes and bus != DEMO and not bus.startswith("virtual:"):
        failed, tries = (
            "--yes is for simulated drives: a real one moves only if somebody looks at it",
            ("the same without --yes",),
        )
        raise usage("CO123", failed, seen=f"the bus is {bus}", tries=tries)
    if not yes and not is_asked(screen):
        failed, seen = "commissioning asks before each motion, and there is no terminal to ask on", "nothing was sent"
        raise usage("CO122", failed, seen=seen, tries=("-b demo --yes    for a simulated drive",))
    joint = settings.joint(node_id)
    asked = name or (f"drive{node_id}" if joint is None else joint.name)
    name = commissioned_name(*settings.machine_on_bus(), node_id, asked)
    if name != asked:
        screen.say(escape(renamed_text(asked, name)))
    output, dcf = output or f"{name}.toml", dcf or f"{name}.dcf"
    for path in (output, dcf):
        check_new_file(settings, screen, path)
    done: list[str] = []

    async def command() -> tuple[CommissioningDialogue, str]:
        async with open_session(settings, screen) as session:
            dialogue = dialogue_of(settings, screen, session, node_id, dcf, done, agrees=yes)
            await dialogue.run()
            if dialogue.is_given_up:
                tries = ("-e with the drive's own file",)
                raise CommandError(ExitCode.INTERRUPTED, "CO132", "by you: nothing was changed", tries=tries)
            description = session.description_of(node_id)
            return dialogue, "" if description is None else description.source

    def story(confirmed: bool) -> list[str]:
        return [f"the drive was {'halted' if confirmed else 'told to halt'}", *done] if done else ["nothing was done"]

    try:
        dialogue, file = run(settings, screen, command, story=story)
    except BrokenPipeError:  # nobody reads on: that is no failure
        raise
    except Exception as error:  # noqa: BLE001 - raised again, with what was done
        problem = problem_of(error)
        problem.also += [each for each in story(all_stand(error)) if each not in problem.also]
        raise problem from problem.__cause__
    work, is_confirmed = dialogue.work, dialogue.is_confirmed
    if is_confirmed:
        machine, locator = settings.machine_on_bus()
        if machine is None:
            locator = DEMO_LOCATOR if bus == DEMO else bus
        file = os.path.relpath(file, Path(output).parent) if file and Path(file).is_file() else file
        made = commissioned_machine(machine, locator, node_id, name, work.settings, file=file, master_id=settings.master_id)
        write_file(output, machine_text(made).encode())
    if settings.json:
        files = {"dcf": dcf, "machine": output if is_confirmed else None}
        screen.json({"node": node_id, "moved": work.has_moved, "homed": work.is_homed, **files})
    elif is_confirmed:
        screen.say(f"\n{escape(output)}: {escape(name)} with its unit and limits. Next: canopen machine check {escape(output)}")
    else:
        screen.say(f"\nNo machine file was written: its scale is not proven. {escape(dcf)} has its values as they were")
    return ExitCode.OK if is_confirmed else ExitCode.PARTIAL
