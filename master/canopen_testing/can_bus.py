"""`WorldCanBus`: a bus of a world for programs that use python-can: `can.Bus(interface="canopen_world", channel="can0")`.

A blocking program waits in the world's time: `recv(timeout)` lets the world run until a frame comes. In asyncio a `can.Notifier`
with `loop=` watches the bus by `fileno()`, and needs no thread.

The world is the one of the running test or program (`current`), or is given: `WorldCanBus("can0", world=world)`.
"""

from __future__ import annotations

import socket
from collections import deque
from typing import Any, Final

import can

from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Time
from canopen_proto.testing import DidNotHappenError, World
from canopen_testing.present import present_world
from canopen_transports.messages import frame_of, message_of

FOREVER: Final = 24 * 3600.0
"""Seconds of the world for which `recv` waits without a time-out, before it counts as stuck."""


class WorldCanBus(can.BusABC):
    """See this module's text. Takes any further option of an adapter, such as a bit rate, and does not look at it."""

    def __init__(self, channel: Any = "can0", can_filters: Any = None, *, world: World | None = None, **options: Any) -> None:
        self._world = present_world() if world is None else world
        self._frames: deque[tuple[Frame, Time]] = deque()
        self._reader, self._writer = socket.socketpair()  # readable while a frame waits, for loops that watch files
        self._participant = self._world.listener(self._take, name=f"can.Bus {channel}", bus=str(channel))
        self.channel_info = f"the bus {channel} of a world in virtual time"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel, can_filters, **options)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus of the world."""
        self._world.send(self._participant, frame_of(msg))

    def _take(self, frame: Frame, now: Time) -> None:
        self._frames.append((frame, now))
        if len(self._frames) == 1:
            self._writer.send(b"\0")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Let the world run until a frame comes that passes the filters; return it, or None after `timeout` seconds of the world.

        Raises DidNotHappenError if nothing comes in FOREVER without a timeout.
        """
        __tracebackhide__ = True
        end = self._world.now + round((FOREVER if timeout is None else timeout) * SECOND)
        while True:
            message = self._taken()
            if message is not None:
                if self._matches_filters(message):
                    return message
            elif timeout is not None and self._world.now >= end:
                return None
            else:
                try:
                    self._world.run_until(
                        lambda: self._frames,
                        end - self._world.now,
                        told=f"a frame for recv() of {self.channel_info} did not come",
                    )
                except DidNotHappenError:
                    if timeout is None:
                        raise
                    self._world.advance(end - self._world.now)  # where nothing more will happen, the time-out still comes

    def _taken(self) -> can.Message | None:
        """The next frame that waits."""
        if not self._frames:
            return None
        frame, now = self._frames.popleft()
        if not self._frames:
            self._reader.recv(1)
        message = message_of(frame)
        message.timestamp = now / SECOND
        return message

    def fileno(self) -> int:
        """Return a file that can be read while a frame waits."""
        return self._reader.fileno()

    def shutdown(self) -> None:
        """Leave the bus."""
        if not self._is_shutdown:
            self._world.leave(self._participant)
            self._reader.close()
            self._writer.close()
        super().shutdown()
