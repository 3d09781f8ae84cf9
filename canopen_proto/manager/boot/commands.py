"""NMT commands with a pause between them: object 0x102A of a master, the NMT inhibit time (CiA 302-2, as Lely has it)."""

from __future__ import annotations

from collections.abc import Callable

from canopen_proto.machine import NEVER, LocalProtocolError, Time
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.procedures.steps import Procedure, act, sleep


class NmtCommands:
    """Sends the NMT commands of procedures that run side by side, with a pause between two of them.

    pause: ns, 0 for none.
    """

    def __init__(self, nmt: NmtMaster, pause: Time = 0) -> None:
        if pause < 0:
            raise LocalProtocolError(f"the pause between NMT commands is {pause} ns, less than 0")
        self.nmt = nmt
        self.pause = pause
        self._free_at: Time = -NEVER

    def send(self, command: NmtCommand, node_id: int, condition: Callable[[], bool] = lambda: True) -> Procedure[bool]:
        """Send a command to a node, or to all (0), when the pause since the one before is over.

        condition: asked right before; if it does not hold any more, nothing is sent. Returns whether the command was sent.
        """
        yield from self.wait()
        return (yield from act(lambda now: self._send_now(command, node_id, condition, now)))

    def wait(self) -> Procedure[None]:
        """Wait until the pause is over."""
        while left := (yield from act(self._time_left)):
            yield from sleep(left)

    def _time_left(self, now: Time) -> Time:
        return max(self._free_at - now, 0)

    def _send_now(self, command: NmtCommand, node_id: int, condition: Callable[[], bool], now: Time) -> bool:
        if not condition():
            return False
        self.nmt.send(command, node_id, now)
        self._free_at = now + self.pause
        return True
