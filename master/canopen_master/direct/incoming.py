"""`IncomingPdos`: the manual's queue `incomingPDOs`, but bounded."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Final

from canopen_master.blocking.loop_thread import LOOK_UP
from canopen_proto.pdo.consumer import PdoReceived

QUEUE_SIZE: Final = 4096
"""PDOs that wait for a reader: four seconds of six drives with one PDO a cycle of 10 ms, and more."""


class IncomingPdos:
    """The PDOs that devices sent, oldest first. Any thread may take from it, and wait.

    Each is a `PdoReceived`: node_id, `values` by name, `get("position_actual_value")`, data, timestamp. A full queue loses its
    oldest entries; `dropped` counts them.

    size: how many it holds at most.
    """

    def __init__(self, size: int = QUEUE_SIZE) -> None:
        self.dropped = 0
        self._size = size
        self._pdos: deque[PdoReceived] = deque()
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._pdos)

    def __iter__(self) -> Iterator[PdoReceived]:
        """Take PDOs, also those that come meanwhile, until the queue is empty."""
        while (pdo := self.get(0)) is not None:
            yield pdo

    def get(self, timeout: float | None = None) -> PdoReceived | None:
        """Take the oldest PDO, waiting at most `timeout` seconds for one; None if none came."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while not self._pdos:
                rest = LOOK_UP if deadline is None else deadline - time.monotonic()
                if rest <= 0:
                    return None
                self._changed.wait(min(rest, LOOK_UP))
            return self._pdos.popleft()

    def clear(self) -> None:
        """Drop all PDOs in the queue."""
        self._pdos.clear()

    def put(self, pdo: PdoReceived) -> None:
        """Add a PDO (the session does)."""
        with self._changed:
            if len(self._pdos) == self._size:
                self._pdos.popleft()
                self.dropped += 1
            self._pdos.append(pdo)
            self._changed.notify()
