"""What the plugin needs for a test with a world: the world, what a report shows of it, and its traffic as a file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import pytest

from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_proto.testing import Fault as Fault
from canopen_proto.testing.times import nanoseconds
from canopen_testing.present import present as present
from canopen_testing.program_world import DAY
from canopen_testing.program_world import ProgramWorld as ProgramWorld
from canopen_transports.candump_text import CandumpWriter
from canopen_transports.record import Record

SHOWN: Final = 20
"""The last frames of each bus that a report shows."""
FOUND: Final = 10


def limit_of(marked: tuple[tuple[Any, ...], dict[str, Any]] | None, option: float | None) -> Time:
    """Return how long the program of a test may run, ns. marked: the arguments of its marker. option: seconds.

    Raises UsageError.
    """
    __tracebackhide__ = True
    if marked is None:
        return DAY if option is None else round(option * SECOND)
    try:
        (limit,), options = marked
        if options:
            raise ValueError
        return nanoseconds(limit, "canopen_limit")
    except LocalProtocolError as error:
        raise pytest.UsageError(str(error)) from None
    except ValueError:
        raise pytest.UsageError("canopen_limit takes one time, such as 10 * SECOND") from None


def sections_of(world: ProgramWorld) -> list[tuple[str, str]]:
    """Return what the report of a failure shows: what the faults have done, the last frames of each bus, and what the observer
    found wrong."""
    faults = world.fault_lines
    sections = [("CANopen: what the faults have done", "\n".join(faults))] if faults else []
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
