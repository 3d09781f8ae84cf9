"""Real drives, as far as the direct API can tell: simulated, but in a thread of their own, on a bus that the test listens to."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import can
import pytest
import trio

from canopen_master import Host, session, simulate
from canopen_master.blocking.background import Background
from canopen_master.direct.drive import COUNTS
from canopen_master.simulation.host import IN_PROCESS, DeviceMaker
from canopen_proto.drives.axis import following
from canopen_proto.drives.axis.watchdog import Watchdog
from canopen_proto.machine import SECOND
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_transports import open_transport

LIMIT = 60.0
"""Seconds after which a test gives up."""
PATIENT = 10.0
"""Seconds for an answer, for a computer that is busy with other things."""
LOOSE = Watchdog(timeout=60 * SECOND)
"""Drives wait so long for the heartbeat of a master that is late."""

INTERVAL = 100
"""Milliseconds from SYNC to SYNC that drives and master are told: a busy computer is late."""
SILENT_TIME = SECOND
"""A drive that is late by less is not silent, however many SYNCs come meanwhile."""

_numbers = itertools.count()


def patient(*node_ids: int, settings: DriveSettings = DriveSettings(shape=Shape.SCHUNK_POWERBALL)) -> list[DeviceMaker]:  # noqa: B008 - frozen
    """Drives that never lose SYNC, by default Powerball joints."""
    settings = replace(settings, sync_tolerance=IN_PROCESS)
    return [partial(DriveNode, node_id=node_id, settings=settings) for node_id in node_ids]


def near_home(*node_ids: int, sync_tolerance: int = IN_PROCESS, waits_for_sync: bool = False) -> list[DeviceMaker]:
    """Powerball joints that are homed in a blink: the edge of their home switch is near. For the rest: see DriveSettings."""
    track = Track(home_switch=(1_500, 10_000))
    settings = DriveSettings(
        shape=Shape.SCHUNK_POWERBALL, track=track, sync_tolerance=sync_tolerance, waits_for_sync=waits_for_sync
    )
    return [partial(DriveNode, node_id=node_id, settings=settings) for node_id in node_ids]


class Devices:
    """Devices on a bus of python-can's `virtual` interface, and a listener to all of its frames. bus: its locator."""

    def __init__(self, *node_ids: int, makers: Sequence[DeviceMaker] = ()) -> None:
        channel = f"direct{next(_numbers)}"
        self.bus = f"pythoncan:virtual:{channel}"
        self._listener = can.Bus(channel, interface="virtual")
        self._background = Background(lambda: _host(self.bus, [*patient(*node_ids), *makers]))
        self.host = self._background.start()
        self._await_boot()

    def node(self, node_id: int) -> DriveNode:
        (node,) = (each for each in self.host.nodes if each.node_id == node_id)
        assert isinstance(node, DriveNode)
        return node

    def power_cycle(self) -> None:
        """Everything as at power-on; nothing of before is in `frames`."""
        self.frames(0)
        self.send(0x000, "8100")
        self._await_boot()

    def is_moving(self, node_id: int) -> bool:
        """As the drive's own bit 8 says."""
        node = self.node(node_id)
        self.do(lambda host: node.drive.refresh(host.now()))
        return bool(int(node.values.read("statusword")) & 0x100)  # type: ignore[arg-type]

    def do(self, function: Callable[[Host], object]) -> None:
        """Do something to the devices, in their thread."""

        async def act(host: Host) -> None:
            function(host)
            host.pump()

        self._background.call(act)

    def break_down(self, node_id: int, error_code: int = 0x8611) -> None:
        self.do(lambda host: self.node(node_id).raise_fault(error_code, host.now()))

    def send(self, can_id: int, data: str) -> None:
        """Somebody else sends a frame."""
        self._listener.send(can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False))

    def frames(self, quiet: float = 0.03, *, last: str = "") -> list[str]:
        """Return the frames since the last look, as candump writes them, once the bus is quiet and `last` has come."""
        frames: list[str] = []
        deadline = time.monotonic() + LIMIT
        while True:
            while (message := self._listener.recv(quiet)) is not None:
                frames.append(_text(message))
            if not last or any(frame.startswith(last) for frame in frames):
                return frames
            assert time.monotonic() < deadline, frames

    def _await_boot(self) -> None:
        """Wait for the boot-up of each device; nothing of before is in `frames` then."""
        missing = {f"{0x700 + node.node_id:03X}#00" for node in self.host.nodes}
        while missing:
            message = self._listener.recv(LIMIT)
            assert message is not None, missing
            missing.discard(_text(message))

    def close(self) -> None:
        self._background.stop()
        self._listener.shutdown()


def _text(message: can.Message) -> str:
    return f"{message.arbitration_id:03X}#{bytes(message.data).hex().upper()}"


@contextlib.asynccontextmanager
async def _host(bus: str, devices: Sequence[DeviceMaker]) -> AsyncIterator[Host]:
    async with trio.open_nursery() as nursery:
        yield await nursery.start(simulate, await open_transport(bus), devices)
        nursery.cancel_scope.cancel()


@contextlib.contextmanager
def devices(*node_ids: int, makers: Sequence[DeviceMaker] = ()) -> Iterator[Devices]:
    made = Devices(*node_ids, makers=makers)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following, "SILENT_TIME", SILENT_TIME)
        patch.setattr(session, "SHUTDOWN_TIME", PATIENT)
        patch.setattr("canopen_master.direct.session.COUNTS", replace(COUNTS, state_timeout=20 * SECOND))
        try:
            yield made
        finally:
            made.close()


def until(condition: Callable[[], object]) -> None:
    """Wait until it holds."""
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)
