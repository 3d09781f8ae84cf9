"""`canopen machine import`: a machine file of what a user of ros_canopen or ros2_canopen has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape

if TYPE_CHECKING:
    from canopen_master.ros_configurations import Imported, Told


@command("import")
@click.argument("files", metavar="FILE.yaml...", nargs=-1, required=True)
@click.option("-o", "--output", metavar="FILE.toml", help="The machine file to write.  [default: stdout]")
@click.option("--locator", metavar="LOCATOR", default="", help="The bus, in place of that of the files; a bus.yml names none.")
@click.option("--chain", metavar="NAME", default="", help="The name of the chain, in place of that of the files.")
@click.option(
    "--package",
    "packages",
    metavar="NAME=FOLDER",
    multiple=True,
    help="Where a ROS package stands whose device files are named (eds_pkg); once for each.",
)
@click.option("--linear", metavar="JOINT", multiple=True, help="A slide: its positions are in metres there; once for each.")
def import_(
    settings: Settings,
    screen: Screen,
    files: tuple[str, ...],
    output: str | None,
    locator: str,
    chain: str,
    packages: tuple[str, ...],
    linear: tuple[str, ...],
) -> int:
    """Make a machine file of a configuration of ros_canopen (YAML) or ros2_canopen (bus.yml).

    Several files are parts of one configuration, as a launch file loads them. Each key is listed: taken over as what, or left out
    and why. Values to be set in devices (dcf_overlay, sdo, PDOs) go into a DCF for each node, beside the machine file. The files
    that are read stay as they are. Needs ruamel.yaml.

    Exit status: 0 all was taken over, 7 something was left out, 6 a file cannot be used.

    \b
    canopen machine import bus.yml -o cell.toml --locator can0
    canopen machine import can0.yaml driver.yaml -o arm.toml --package schunk_lwa4p=src/schunk_lwa4p
    """
    from canopen_master.ros_configurations import Choices, import_configuration
    from canopen_transports.locator import parse_locator

    folder = Path() if output is None else Path(output).parent
    choices = Choices(locator, chain, dict(map(_package, packages)), frozenset(linear))
    if output is not None:
        check_new_file(settings, screen, output, *files)
    if locator:
        parse_locator(locator)
    made = import_configuration(files, folder, choices)
    _check_slides(made, linear)
    for name in made.files if output is not None else ():
        check_new_file(settings, screen, folder / name, *files)
    if output is not None:
        for name, content in made.files.items():
            write_file(str(folder / name), content, *files)
        write_file(output, made.text.encode(), *files)
    _show(settings, screen, made, output)
    return ExitCode.OK if made.is_complete else ExitCode.PARTIAL


def _package(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise usage("CO001", f"--package {text!r} is not of the form NAME=FOLDER", tries=("--package my_robot=src/my_robot",))
    if not Path(folder).is_dir():
        raise usage("CO001", f"--package {text!r}: there is no folder {folder!r}")
    return name, Path(folder)


def _check_slides(made: Imported, linear: tuple[str, ...]) -> None:
    """Raise a CommandError if --linear names no joint: a slide would be in radians."""
    joints = made.machine.joints
    for name in linear:
        if name not in joints:
            raise usage(
                "CO120", f"--linear {name}: the files have no joint of this name", seen=f"joints: {', '.join(joints) or 'none'}"
            )


def _show(settings: Settings, screen: Screen, made: Imported, output: str | None) -> None:
    from canopen_master.ros_configurations import KeyOutcome

    left_out = [each for each in made.report if each.outcome is KeyOutcome.LEFT_OUT]
    if settings.json:
        report = [
            {"key": each.key, "file": each.source, "line": each.line, "outcome": each.outcome.value, "text": each.text}
            for each in made.report
        ]
        document = {"file": output, "kind": made.kind, "beside": sorted(made.files), "report": report}
        screen.json(document | ({"text": made.text} if output is None else {}))
        return
    if output is None:
        screen.text(made.text)
        for each in left_out:
            screen.say(f"left out: {escape(_place(each))}{escape(each.key)}: {escape(each.text)}")
        return
    for outcome in KeyOutcome:
        rows = [(escape(each.key), str(each.line or ""), escape(each.text)) for each in made.report if each.outcome is outcome]
        if rows:
            screen.data(f"[bold]{outcome}[/]")
            screen.table(("key", "line", "as" if outcome is KeyOutcome.TAKEN else "because"), rows, right=("line",))
    beside = f", with {', '.join(map(escape, made.files))}" if made.files else ""
    screen.say(f"{escape(output)}: a machine file of {made.kind}'s{beside}; {counted(len(left_out), 'key')} left out")
    screen.say(f"next: canopen machine check {escape(output)}, canopen move {escape(output)} -b demo --to ...    (simulated)")
    for name in made.files:
        screen.say(f"and:  canopen restore {escape(name.removesuffix('.dcf'))} {escape(name)} -m {escape(output)} --dry-run")


def _place(told: Told) -> str:
    return f"{told.source}:{told.line}: " if told.line else ""
