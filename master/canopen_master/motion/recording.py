"""`Recorder`: writes down what a chain did, one row for each SYNC, at the full cycle rate. `Chain.record` makes one.

    async with arm.record("run.csv"):
        ...

A row begins with the SYNC that is sent and ends right before the next one, when the drives have answered. It is put together in
the pump's turn, and written in a thread of its own, many rows at a time. So neither a slow disk nor the program's own loop delays
a cycle. What waits to be written is bounded (MAX_WAITING values); beyond that, rows are left out and counted in `lost`. A file
that cannot be written to, because the disk is full, ends the recording and not the motion. record_files.py has the columns.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from canopen_master.motion.cycles import SetPoints
from canopen_master.motion.device import Device
from canopen_master.motion.path_motion import Motion
from canopen_master.motion.record_files import INCOMPLETE, RecordedJoint, RecordError, RecordHead, Row, Value, open_record
from canopen_master.participant.dispatch import Watcher
from canopen_master.participant.participant import Participant
from canopen_proto.drives.axis.settings import MILLIDEGREES_PER_RADIAN, AxisSettings
from canopen_proto.drives.trajectory import PathClock
from canopen_proto.explained import counted
from canopen_proto.machine import SECOND, Time
from canopen_proto.sync import SyncSent
from canopen_transports.loop import current_loop

MAX_WAITING: Final = 1_000_000
"""Values that wait to be written: some 30 MB, or half a minute of six joints at 1 ms while a disk does nothing."""


class Recorder:
    """A recording under way. rows: recorded so far. lost: rows that were left out, because the disk was too slow. failure: why
    the recording ended before its time, or None."""

    def __init__(
        self,
        participant: Participant,
        chain: str,
        devices: Sequence[Device],
        set_points: SetPoints,
        has_begun: Callable[[], bool],
        motion: Callable[[], Motion | None],
        path: str | Path,
    ) -> None:
        """has_begun: whether the chain is initialised; no rows before. motion: what moves the chain at present.

        Raises OSError, PackageMissingError if no file can be made.
        """
        self.path = Path(path)
        self.rows = 0
        self.lost = 0
        self.failure: Exception | None = None
        self._participant = participant
        self._chain = chain
        self._devices = devices
        self._set_points = set_points
        self._has_begun = has_begun
        self._motion = motion
        self._file = open_record(path)
        self._begun: Time | None = None  # when the first row began
        self._now: Row | None = None  # the chain's columns of the row that is open
        self._sent: list[tuple[Value, Value]] = []  # of each joint: the set-point and the controlword of that row
        self._cycle = 0
        self._missed_before = 0
        self._ready: list[Any] = []
        self._given = self._written = 0  # rows: to the thread, and by it
        self._queue: queue.SimpleQueue[RecordHead | list[Any] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write_all, name=f"recording {self.path.name}")
        self._thread.start()
        bus = participant.bus(devices[0].node.bus)
        self._watcher: Watcher | None = participant.watch((SyncSent,), self._begin_row, bus)
        devices[0].node.remote.add_listener(on_sync=self._end_row)

    def __repr__(self) -> str:
        return f"<Recorder {self.path}: {counted(self.rows, 'row')}>"

    def close(self) -> None:
        """End the recording with the row that is open. The thread finishes the file by itself."""
        if self._watcher is None:
            return
        self._participant.unwatch(self._watcher)
        self._watcher = None
        self._devices[0].node.remote.remove_sync_listener(self._end_row)
        self._end_row(self._participant.now())
        if self._begun is None:
            self._queue.put(self._head())
        self._hand_over()
        self._queue.put(None)

    def wait(self) -> None:
        """Wait until the file is whole; `close` has to be called before. Blocks: for a thread, or where nothing else runs.

        Raises RecordError if rows are missing in it.
        """
        self._thread.join()
        if self.failure is not None:
            seen = f"{getattr(self.failure, 'strerror', None) or self.failure} after {counted(self.rows - self.lost, 'row')}"
            raise RecordError(INCOMPLETE, f"the recording {self.path} is not complete", seen=seen, tries=("make room",))
        if self.lost:
            seen = f"{self.lost} of {counted(self.rows, 'row')} missing in it: they came faster than they could be written"
            tries = ("a faster disk", "fewer joints or a longer cycle")
            raise RecordError(INCOMPLETE, f"the recording {self.path} is not complete", seen=seen, tries=tries)

    # ---- in the pump's turn ----

    def _begin_row(self, sync: SyncSent) -> None:
        """Begin the row of a SYNC, once the chain has counted it. On a bus in this process the answers are there already."""
        if not self._has_begun() or self.failure is not None:
            return
        set_points, now = self._set_points, self._participant.now()
        if self._begun is None:
            self._begun = now
            self._queue.put(self._head())
        else:
            self._cycle += 1 + sync.skipped
        missed = set_points.missed_cycles - self._missed_before
        self._missed_before = set_points.missed_cycles
        skipped = sync.skipped if self._cycle else 0
        motion = self._motion()
        rate = motion.generator.rate if motion is not None and isinstance(motion.generator, PathClock) else None
        self._now = self._cycle, (now - self._begun) / SECOND, skipped, int(missed > 0), rate
        sent: Sequence[float | None] = set_points.on_wire or [None] * len(self._devices)
        self._sent = [(point, int(device.axis.controlword)) for point, device in zip(sent, self._devices, strict=True)]

    def _end_row(self, now: Time) -> None:
        """End the row of the SYNC before: the next one is on its way out. All answers that came to it are there."""
        row, self._now = self._now, None
        if row is None:
            return
        values: list[Value] = [*row]
        for device, (set_point, controlword) in zip(self._devices, self._sent, strict=True):
            error = None if set_point is None else device.following_error
            axis = device.axis
            values += (set_point, axis.position, device.velocity, error, axis.torque, controlword, axis.statusword, axis.mode)
        self.rows += 1
        if (self._given - self._written) * len(values) > MAX_WAITING:
            self.lost += 1
            return
        self._given += 1
        self._ready.append(self._file.encode(tuple(values)))
        if len(self._ready) >= self._file.chunk:
            self._hand_over()

    def _hand_over(self) -> None:
        rows, self._ready = self._ready, []
        if rows:
            self._queue.put(rows)

    def _head(self) -> RecordHead:
        joints = tuple(RecordedJoint(each.name, unit_of(each.axis.settings), each.node.where) for each in self._devices)
        begun = datetime.now(UTC).isoformat(timespec="milliseconds")
        return RecordHead(self._chain, self._set_points.cycle_time, joints, begun)

    # ---- in the thread ----

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not None:
            if self.failure is None:
                self._try(lambda: self._write(item))
            if isinstance(item, list):
                self._written += len(item)
        self._try(self._file.close)

    def _write(self, item: RecordHead | list[Any]) -> None:
        if isinstance(item, RecordHead):
            self._file.begin(item)
        else:
            self._file.write(item)

    def _try(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception as error:  # noqa: BLE001 - whatever it is ends the recording, and `wait` tells it
            self.failure = self.failure or error


def unit_of(settings: AxisSettings) -> str:
    """Return the name of the unit of a joint's positions: "degree" ..., "count" without a scale, "" if it has no name."""
    if settings.unit is not None:
        return settings.unit.value
    if settings.counts_per_unit is None:
        return "count"
    return "radian" if settings.counts_per_unit == MILLIDEGREES_PER_RADIAN else ""  # as for Schunk's joints by themselves


@asynccontextmanager
async def recording(make: Callable[[], Recorder]) -> AsyncIterator[Recorder]:
    """Record while the block runs; see Chain.record. make: makes the recorder when the block begins."""
    recorder = make()
    try:
        yield recorder
    finally:
        recorder.close()  # after an error or a cancellation the drives come first: the thread finishes the file by itself
    await current_loop().in_thread(recorder.wait)
