"""What the plugin needs for a test with a world: the world, what a report shows of it, and its traffic as a file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from canopen_proto.testing import Fault as Fault
from canopen_testing.present import present as present
from canopen_testing.program_world import ProgramWorld as ProgramWorld
from canopen_transports.candump_text import CandumpWriter
from canopen_transports.record import Record

SHOWN: Final = 20
"""The last frames of each bus that a report shows."""
FOUND: Final = 10


def sections_of(world: ProgramWorld) -> list[tuple[str, str]]:
    """Return what the report of a failure shows: the last frames of each bus, and what the observer found wrong."""
    sections = []
    for name, bus in world.buses.items():
        head = f"CANopen: the last frames on {name} (seed {world.seed}, {world.now / 1e9:.6f} s)"
        sections.append((head, "\n".join(bus.lines(SHOWN)) or "no frame"))
        findings = bus.observer.findings
        if findings:
            sections.append((f"CANopen: what was wrong on {name}", "\n".join(str(found) for found in findings[:FOUND])))
    return sections


def write_trace(world: ProgramWorld, folder: Path, test: str) -> None:
    """Write the traffic of all buses as candump does: `canopen log decode FILE` reads it. test: its id, which gives the name."""
    folder.mkdir(parents=True, exist_ok=True)
    records = [
        Record(passed.time, name, passed.frame) for name, bus in world.buses.items() for passed in bus.trace if passed.was_heard
    ]
    name = re.sub(r"[^\w.\[\]=-]+", "_", test)
    writer = CandumpWriter((folder / f"{name[:200]}.log").open("w", encoding="utf-8"))
    for record in sorted(records, key=lambda record: record.time):
        writer.write(record)
    writer.close()
