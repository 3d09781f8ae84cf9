"""The examples on the pages of `canopen drive`, each as printed there, in virtual time.

`-b demo` is the demonstration. `-b can0` and `-b socketcan:can0` are here a bus with one drive that has everything of CiA 402,
as the node of the example.
"""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path

import click
import pytest

from canopen_cli.drive.group import COMMANDS, drive
from canopen_data.describing import describe
from canopen_data.eds.writer import write_eds
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.cli.cli_support import Alarm, only_drive, runner_in_folder

CAN0 = re.compile(r"-b (socketcan:)?can0")
ELSEWHERE = (
    "canopen drive commission 5 -e drive.eds -b socketcan:can0",  # asks a person at a terminal: test_drive_commission.py
    "canopen drive probe 5 -b can0",  # somebody has to move the drive: test_drive_io.py
    "canopen drive probe 5 --edge positive -b can0",
    "canopen drive enable 3 -b demo",  # until Ctrl-C: test_drive.py
    "canopen drive velocity 5 2000 -b can0",  # until Ctrl-C: test_drive_velocity.py
)
"""Examples that need somebody, and the tests that have them."""


def examples() -> list[str]:
    """Each example of the group's page and of the pages of its commands, without its comment; none with an ellipsis."""
    context = click.Context(drive)
    pages = [drive.help or "", *((drive.get_command(context, name) or drive).help or "" for name in COMMANDS)]
    lines = [line.strip() for page in pages for line in page.splitlines()]
    found = [re.split(r" {2,}", line)[0] for line in lines if line.startswith("canopen ")]
    return [each for each in dict.fromkeys(found) if "..." not in each and each not in ELSEWHERE]


@pytest.mark.parametrize("example", examples())
def test_an_example_succeeds_on_the_bus_that_it_names(
    example: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, alarm: Alarm
) -> None:
    run = runner_in_folder(capsys, monkeypatch, tmp_path)
    dictionary = drive_dictionary().with_objects([standard_object(0x608F, highest=2, defaults={1: 6_000, 2: 1})])
    Path("drive.eds").write_text(write_eds(describe(dictionary)), encoding="utf-8")
    if CAN0.search(example):
        settings = DriveSettings(position=0, mechanics=Mechanics(), track=Track(-math.inf, math.inf))
        only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, settings, dictionary))
    outcome = run(*shlex.split(CAN0.sub("-b demo", example))[1:])
    assert outcome.status == 0, outcome.err
