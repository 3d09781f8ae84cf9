"""The world of the running test or program, for what is made without being told of it (can_bus.py)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from canopen_proto.machine import LocalProtocolError
from canopen_testing.real_time import virtual_time

if TYPE_CHECKING:
    from canopen_testing.program_world import ProgramWorld

_worlds: list[ProgramWorld] = []


@contextmanager
def present(world: ProgramWorld) -> Iterator[None]:
    """Let this world be the present one; what runs in real time is an error meanwhile."""
    _worlds.append(world)
    try:
        with virtual_time(world):
            yield
    finally:
        _worlds.remove(world)


def present_world() -> ProgramWorld:
    """Return the world of the running test or program. Raises LocalProtocolError if there is none."""
    if not _worlds:
        raise LocalProtocolError("there is no world: use the fixture canopen_world, or World.run, or give the world")
    return _worlds[-1]
