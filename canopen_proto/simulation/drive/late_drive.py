"""`LateDrive`: a simulated drive that obeys its commands late, as real ones do.

Controlwords and modes (6060h) take effect `DriveSettings.reaction` after they came, in the order in which they came; all else is
as in `Drive`. Until then statusword and mode display show the old values: a master that looks too early sees the past.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import Outbox, Time
from canopen_proto.multiplexer import Mux, mux, split_mux
from canopen_proto.simulation.drive.drive import STEP, Drive
from canopen_proto.simulation.drive.settings import DriveSettings

_COMMANDS: Final = (objects.CONTROLWORD, objects.MODES_OF_OPERATION)


class LateDrive(Drive):
    """A simulated drive that obeys late; see this module's text."""

    __slots__ = ("_late", "_obeys")

    def __init__(self, out: Outbox, node_id: int, values: Values, settings: DriveSettings, axis: int = 0) -> None:
        super().__init__(out, node_id, values, settings, axis)
        self._late: deque[tuple[Time, Mux, int]] = deque()  # when it takes effect, key, value
        self._obeys = False

    def reset(self, now: Time) -> None:
        self._late.clear()
        super().reset(now)

    def written(self, index: int, subindex: int, now: Time) -> None:
        key = mux(index, subindex)
        if key not in _COMMANDS:
            super().written(index, subindex, now)
            return
        value = self._servo.parameter(key)
        last = next((late[2] for late in reversed(self._late) if late[1] == key), None)
        if value != last:  # else the same value again, as in each cycle
            self._late.append((now + self.settings.reaction, key, value))
            self._schedule()

    def _advance(self, now: Time) -> None:
        while not self._obeys and self._late and self._late[0][0] <= now:
            self._obey(*self._late.popleft())
        super()._advance(now)

    def _obey(self, time: Time, key: Mux, value: int) -> None:
        store = self.values.store
        newest, store[key] = store[key], value
        self._obeys = True  # one after the other, also those of one PDO
        index, subindex = split_mux(key)
        super().written(index, subindex, time)
        self._obeys = False
        store[key] = newest

    def _schedule(self, step: Time = STEP) -> None:
        super()._schedule(step)
        if self._late:
            self._arm(min(self.deadline, self._late[0][0]))
