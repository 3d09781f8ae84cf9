"""The tree of commands, and `main`, which runs one of them: one exit status, and one screen if it fails."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import click

from canopen_cli.shared.importing import LibraryMissingError, importing
from canopen_cli.shared.lazy import LazyGroup
from canopen_cli.shared.options import Settings, common_options
from canopen_cli.shared.problem import NO_ROOM, CommandError, ExitCode, usage
from canopen_cli.shared.streams import (
    open_closed_streams,
    put_closed_pipes_to_rest,
    put_lost_terminal_to_rest,
    put_to_rest,
)

if TYPE_CHECKING:
    import trio

    from canopen_cli.shared.screen import Screen

CLOSED_PIPE = 128 + 13
"""The status that a shell reports for a command whose reader went away (SIGPIPE)."""

COMMANDS: Final = {
    "demo": ("demo.demo", "A six-joint arm boots, homes itself and moves."),
    "plot": ("plot.plot", "Draw a recording (--record): position, velocity, acceleration and following error."),
    "doctor": ("bus.doctor", "Check adapters, drivers and permissions; with -b also what is heard on a bus."),
    "scan": ("bus.scan", "Find the nodes of a bus."),
    "node": ("groups", "The nodes of a machine file: list them, and look which are there."),
    "info": ("node.info", "Show a node's identity, state, errors and PDOs."),
    "read": ("node.objects", "Read objects of a node."),
    "write": ("node.objects", "Write an object of a node, and show its value before and after."),
    "nmt": ("bus.nmt", "Start, stop or reset a node, or all of them."),
    "pdo": ("groups", "The PDOs of nodes: show them, map one, compare those of several nodes."),
    "emcy": ("groups", "Emergencies of a bus, and the error history of a node."),
    "sync": ("bus.sync_time", "Send SYNC: all nodes take and send their synchronous PDOs."),
    "time": ("bus.sync_time", "Send this computer's time of day to all nodes (TIME, 0x100), once, in UTC."),
    "lss": ("groups", "Give devices their node-ID and bit rate over the bus itself (CiA 305)."),
    "listen": ("live.listen", "Hear who is on a bus, and with --bitrates find its bit rate."),
    "monitor": ("live.monitor", "Show what each frame on a bus means, until Ctrl-C."),
    "top": ("live.top", "Show a bus at a glance: nodes, states, rates, load, SYNC, errors, and what is wrong."),
    "tui": ("tui.tui", "A view that stays open: nodes, objects, emergencies, live values, traffic, drives."),
    "watch": ("live.watch", "Show the values of a node's objects, live."),
    "net": ("groups", "The network of a machine file: check it, boot it, watch it (CiA 302-2)."),
    "drive": ("drive.group", "One drive (CiA 402): what it shows, why it does not move, what its numbers mean."),
    "move": ("motion.move", "Move chains to a target, or along a path."),
    "jog": ("motion.jog", "Move joints of a chain by keys, as long as a key is held."),
    "home": ("drive.home", "Home drives (CiA 402), all at the same time."),
    "backup": ("node.backup", "Read all values of a node into a DCF, which `canopen restore` writes back."),
    "restore": ("node.restore", "Write those settings of a DCF or XDC to a node that differ from its own."),
    "store": ("node.storing", "Have a device keep its present parameters over power-off (0x1010)."),
    "reset-defaults": ("node.storing", "Have a device take the defaults of its parameters from its next reset on (0x1011)."),
    "flash": ("node.flash", "Write a new program (firmware) into a device that takes it by CiA 302-3, and start it."),
    "compare": ("node.compare", "Compare the values of a node, or of a file, with those of another file."),
    "dump": ("node.dump", "Read all objects of a node, and show them."),
    "check": ("node.check", "Run the 127 cases of a conformance test against a node, by its file (-e); or check a file alone."),
    "bus": ("bus.serve", "Run a bus in software, for several terminals or programs."),
    "serve": ("groups", "Let other programs and networks use a machine: read-only, unless --allow says more."),
    "fleet": ("groups", "Many buses on many computers, which `canopen serve zenoh` brings together."),
    "log": ("live.log", "Log files of CAN buses: .log and .txt (candump's), .asc, .blf, .trc, .pcap, .pcapng."),
    "sim": (
        "simulation.sim",
        "Serve simulated devices on a bus until Ctrl-C: of any EDS, DCF, XDD or XDC, written in Python, or drives of our own.",
    ),
    "device": ("groups", "Devices of one's own, written in Python: make one, write its file."),
    "plan": (
        "machine.network_plan:plan",
        "Does this network fit? Load, worst latency of each PDO, margins, the shortest cycle that fits.",
    ),
    "eds": ("groups", "Device descriptions: EDS, DCF, XDD and XDC files."),
    "machine": ("machine.group", "The machine file: one file with the buses, devices, joints and chains of a machine."),
    "ros": ("machine.ros", "ROS: write a package with launch files for a machine."),
    "data": ("machine.data", "The object dictionary and the chain files."),
    "run": ("scripting.run:run_script", "Run a Python script on a bus that is open already, with `await` at its top level."),
    "shell": (
        "scripting.shell",
        "A Python prompt on an open bus, with `await`, completion of nodes, objects and constants, and history.",
    ),
    "completion": (
        "completion.completion",
        "Write the script by which a shell completes commands, nodes, objects and constants.",
    ),
}
"""Listed in the order to try them."""


@click.group(cls=LazyGroup, table=COMMANDS, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="canopen-proto", prog_name="canopen")
@common_options
def cli() -> None:
    """CANopen from the command line. Without hardware, begin with `canopen demo`; every command takes `-b demo`.

    Exit status: 0 ok, 1 findings or differences, 2 usage, 3 cannot open the bus, 4 bus fault, 5 no answer, 6 bad input file,
    7 partial, 9 permission, 10 internal, 11 SDO abort, 12 drive fault or refused, 13 verify mismatch, 130 interrupted.
    """


def main(arguments: Sequence[str] | None = None, *, clock: trio.abc.Clock | None = None) -> int:
    """Run the command line and return its exit status. arguments: by default those of this process. clock: trio's, for tests.

    Raises LibraryMissingError.
    """
    settings = Settings(clock=clock)
    asks_json = "--json" in (sys.argv if arguments is None else arguments)
    open_closed_streams()
    try:
        if asked := os.environ.get("_CANOPEN_COMPLETE"):
            with importing():
                from canopen_cli.completion.words import complete
            return complete(cli, asked)
        result = cli.main(
            None if arguments is None else list(arguments), prog_name="canopen", standalone_mode=False, obj=settings
        )
        sys.stdout.flush()
    except BrokenPipeError:
        put_closed_pipes_to_rest()
        return CLOSED_PIPE
    except SystemExit as ended:  # click met a closed pipe, and has silenced stdout; or it completed words for a shell (0)
        return CLOSED_PIPE if ended.code else ExitCode.OK
    except (click.Abort, KeyboardInterrupt):
        return _show(settings, CommandError(ExitCode.INTERRUPTED, "CO132", "interrupted by Ctrl-C"))
    except click.exceptions.NoArgsIsHelpError as no_arguments:
        if asks_json:
            command = "canopen" if no_arguments.ctx is None else no_arguments.ctx.command_path
            settings.json = True
            return _show(settings, usage("CO001", f"{command}: no command was named", tries=(f"{command} --help",)))
        click.echo(no_arguments.format_message(), err=True)
        return ExitCode.USAGE
    except LibraryMissingError:
        raise  # perhaps rich, which makes the screens
    except Exception as error:  # noqa: BLE001 - the last place: whatever it is becomes one screen
        if isinstance(error, click.UsageError | CommandError) and asks_json:
            settings.json = True  # click failed before it read this option
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            put_to_rest(sys.stdout)
        with importing():
            from canopen_cli.shared.failures import problem_of
        return _show(settings, problem_of(error))
    except BaseExceptionGroup as group:  # trio reports a Ctrl-C like this if nothing has begun yet
        if group.subgroup(KeyboardInterrupt) is None:
            raise
        return _show(settings, CommandError(ExitCode.INTERRUPTED, "CO132", "interrupted by Ctrl-C"))
    if settings.late is not None:
        return _show(settings, settings.late)
    status = result if isinstance(result, int) else ExitCode.OK
    return _last_words(settings, lambda screen: screen.finish(), status) if settings.notes else status


def _show(settings: Settings, problem: CommandError) -> int:
    if settings.late is not None and settings.late is not problem:
        problem.also.append(f"{settings.late.failed}: {settings.late.seen}")
    if problem.exit_code is ExitCode.CANNOT_OPEN and (origin := settings.origin_of_bus()):
        problem.also.append(origin)
    return _last_words(settings, lambda screen: screen.problem(problem.on_bus(*settings.typed_bus())), problem.exit_code)


def _last_words(settings: Settings, speak: Callable[[Screen], None], status: int) -> int:
    """Write on a screen of its own, and return the status of the command."""
    try:
        speak(settings.screen())
    except BrokenPipeError:  # it may have been the problem itself
        put_closed_pipes_to_rest()
        return CLOSED_PIPE
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        put_lost_terminal_to_rest()
    return status
