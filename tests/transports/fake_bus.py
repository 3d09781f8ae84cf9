"""A python-can backend whose hardware is a script."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable

import can


class ScriptedBus(can.BusABC):
    """sends: what each call of send raises, None for success; then success. received: what each recv gives or raises."""

    def __init__(
        self, *, sends: Iterable[Exception | None] = (), received: Iterable[can.Message | Exception] = (), fd: int | None = None
    ) -> None:
        self.sends = deque(sends)
        self.received = deque(received)
        self.sent: list[can.Message] = []
        self.timeouts: list[float | None] = []
        self.threads: list[threading.Thread] = []
        self.fd = fd
        self.idle = threading.Event()
        self.channel_info = "scripted"
        super().__init__(channel="scripted")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.timeouts.append(timeout)
        self.threads.append(threading.current_thread())
        outcome = self.sends.popleft() if self.sends else None
        if outcome is not None:
            raise outcome
        self.sent.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.received:
            self.idle.wait(timeout)
            return None, False
        item = self.received.popleft()
        if isinstance(item, Exception):
            raise item
        return item, False

    def fileno(self) -> int:
        return super().fileno() if self.fd is None else self.fd
