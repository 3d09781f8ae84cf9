"""`canopen plot FILE`: draw a recording, or the path of a file."""

from __future__ import annotations

import re
from pathlib import Path

import click

from canopen_cli.plot.curves import JointCurves, MotionCurves, curves_of_path, curves_of_record, largest
from canopen_cli.plot.cycles import check_plot
from canopen_cli.plot.motion import write_motion_plot
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.options import FILE, Settings, command
from canopen_cli.shared.screen import Screen, escape
from canopen_data import text_of
from canopen_data.path_file import TIME, read_path
from canopen_master.motion.record_reader import is_record, read_record

COLUMNS = "joint", "unit", "from", "to", "largest\nspeed", "largest\nacceleration", "largest\nfollowing\nerror"

_CLOSE = 1e-9
"""Smaller numbers are shown as 0: they are left by rounding."""


@command()
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("-o", "--output", type=FILE, help="The picture: .png, .svg, .pdf.  [default: FILE.png]")
def plot(settings: Settings, screen: Screen, file: str, output: Path | None) -> None:
    """Draw a recording (--record): position, velocity, acceleration and following error.

    Each joint has its colour, and the four stand one above the other.

    Velocity and acceleration are those of the set-points, by their differences; the velocity that the drive told lies over it.
    A path (a CSV file for `canopen move`) is drawn without a following error; with -m in the units of the joints.

    \b
    canopen demo --record run.csv
    canopen plot run.csv                  run.png
    canopen plot run.csv -o run.svg
    canopen plot path.csv                 a path, before it is followed
    """
    target = Path(file).with_suffix(".png") if output is None else output
    check_plot(target)
    curves = read_curves(settings, file, screen)
    check_new_file(settings, screen, target, file)
    write_motion_plot(target, curves)
    if settings.json:
        screen.json({"file": file, "picture": str(target), "joints": [_as_json(joint) for joint in curves.joints]})
    else:
        screen.table(COLUMNS, [_row(joint) for joint in curves.joints], right=COLUMNS[2:])
    screen.say(f"Drawn: [bold]{escape(str(target))}[/]")


def read_curves(settings: Settings, file: str, screen: Screen) -> MotionCurves:
    """Read what is to be drawn. Raises RecordError, DictionaryError."""
    text = None if not Path(file).is_file() or is_record(file) else text_of(Path(file), file)
    if text is not None and _is_path(text):
        machine = settings.machine_file()
        units = {} if machine is None else {name: joint.settings.unit for name, joint in machine.joints.items()}
        return curves_of_path(read_path(text, file), file, units)
    record = read_record(file)
    if record.is_cut:
        screen.say("[yellow]the last line is not whole, and was left out: the program ended while it wrote, or writes still[/]")
    return curves_of_record(record)


def _is_path(text: str) -> bool:
    """Return whether a text is meant as a path: it has a column `time`."""
    head = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    return TIME in (cell.strip().strip('"') for cell in re.split("[,;\t]", head))


def _as_json(joint: JointCurves) -> dict[str, object]:
    known = [value for value in joint.wanted if value == value]
    return {
        "joint": joint.name,
        "unit": joint.unit,
        "from": min(known, default=None),
        "to": max(known, default=None),
        "largest_speed": largest(joint.velocities),
        "largest_acceleration": largest(joint.accelerations),
        "largest_following_error": largest(joint.errors),
    }


def _row(joint: JointCurves) -> tuple[str, ...]:
    name, unit, *numbers = _as_json(joint).values()
    return escape(str(name)), escape(str(unit)), *map(_shown, numbers)


def _shown(number: object) -> str:
    return f"{0.0 if abs(number) < _CLOSE else number:.4g}" if isinstance(number, float) else ""
