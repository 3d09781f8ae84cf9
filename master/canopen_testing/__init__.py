"""For tests of devices and programs: a World with files, bit timing and programs in trio and asyncio, and the pytest plugin.

    program_world.py   `ProgramWorld`; its time in trio, and world_loop.py for asyncio; can_bus.py for python-can
    plugin.py          the fixtures; docs/testing.md shows them
    strategies/        what Hypothesis draws; the one room that needs hypothesis

The faults, patterns and assertions are in canopen_proto.testing.

It is a package of its own because the core imports nothing of trio and pytest, and canopen_master nothing of canopen_check.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_testing.can_bus import WorldCanBus as WorldCanBus
    from canopen_testing.conformance_fixture import RunCase as RunCase
    from canopen_testing.fixture_types import SimDrive as SimDrive
    from canopen_testing.fixture_types import SimNode as SimNode
    from canopen_testing.program_world import ProgramWorld as ProgramWorld
    from canopen_testing.real_time import ThreadStartedError as ThreadStartedError
    from canopen_testing.real_time import WallClockWaitError as WallClockWaitError
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
