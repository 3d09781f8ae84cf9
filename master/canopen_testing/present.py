"""The world of the running test or program, for what is made without being told of it (can_bus.py)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from canopen_proto.machine import LocalProtocolError
from canopen_proto.testing import World
from canopen_testing.real_time import virtual_time

_worlds: list[World] = []


@contextmanager
def present(world: World) -> Iterator[None]:
    """Let this world be the present one; what runs in real time is an error meanwhile."""
    _worlds.append(world)
    try:
        with virtual_time(lambda: bool(getattr(world, "allows_threads", False))):
            yield
    finally:
        _worlds.remove(world)


def present_world() -> World:
    """Return the world of the running test or program. Raises LocalProtocolError if there is none."""
    if not _worlds:
        raise LocalProtocolError("there is no world: use the fixture canopen_world, or World.run, or give the world")
    return _worlds[-1]
