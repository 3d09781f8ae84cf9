"""Tell what several frames do together: a fastscan, and what a node is told behind its boot-up. Each becomes one line.

    fastscan    begins with its first request and ends with the answer of the device that is selected, with another LSS request,
                or with a silence of SILENCE.
    boot-up     SDO transfers of a node behind its boot-up. It ends when the node is started or told another state, when it says
                itself that it is operational, when it boots again, or with a silence of SILENCE. The boot-up itself and NMT
                commands stand for themselves.

A silence is seen with the frame behind it, or by `Observer.idle`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.explained import counted
from canopen_proto.lss import messages as lss
from canopen_proto.lss.messages import LssService
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.nmt import NmtCommand
from canopen_proto.observer.finding import duration_text
from canopen_proto.observer.sdo import Settled

SILENCE: Final = 2 * SECOND
"""Longer than masters wait for a device: behind it something else begins."""


class Summary(NamedTuple):
    """Several frames in one line. service: "LSS" or "boot-up". node_id: 0 for no node."""

    service: str
    node_id: int
    text: str


class Sequences:
    """See this module's text.

    deadline: when `overdue` has something to do. is_part: the last frame is part of a sequence. ended: sequences that have ended
    since `take`.
    """

    def __init__(self) -> None:
        self.deadline: Time = NEVER
        self.is_part = False
        self.ended: list[Summary] = []
        self._scan: _Fastscan | None = None
        self._boots: dict[int, _Boot] = {}

    def overdue(self, now: Time) -> None:
        """End what was silent for too long. now: NEVER ends all."""
        if self._scan is not None and self._scan.last + SILENCE <= now:
            self._end_scan()
        for node_id, boot in list(self._boots.items()):
            if boot.last + SILENCE <= now:
                self._end_boot(node_id, "", now)
        pending = [boot.last for boot in self._boots.values()]
        if self._scan is not None:
            pending.append(self._scan.last)
        self.deadline = min(pending) + SILENCE if pending else NEVER

    def take(self) -> tuple[bool, tuple[Summary, ...]]:
        """Return whether the last frame is part of a sequence, and the sequences that have ended."""
        is_part, ended = self.is_part, tuple(self.ended)
        self.is_part = False
        self.ended.clear()
        return is_part, ended

    # ---- fastscan ----

    def lss(self, data: bytes, now: Time, *, by_master: bool) -> None:
        """Take an LSS frame."""
        scan = self._scan
        if by_master:
            if len(data) != lss.LENGTH or data[0] != LssService.FASTSCAN:
                self._end_scan()
                return
            number, bit_check, part, following = lss.fastscan_of(data)
            if scan is not None and bit_check == lss.CONFIRM and scan.is_confirmed:
                self._end_scan()
                scan = None
            if scan is None:
                scan = self._scan = _Fastscan(now)
            scan.ask(number, bit_check, part, following, now)
            self._wait(now)
        elif scan is None or data[:1] != _IDENTIFIED:
            return
        else:
            scan.answer(now)
        self.is_part = True
        if scan.is_over:
            self._end_scan()

    def _end_scan(self) -> None:
        if self._scan is not None:
            self.ended.append(Summary("LSS", 0, self._scan.text()))
            self._scan = None

    # ---- boot-up ----

    def booted(self, node_id: int, now: Time) -> None:
        """Take a boot-up."""
        self._end_boot(node_id, "boots again", now)
        self._boots[node_id] = _Boot(now)
        self._wait(now)

    def sdo(self, node_id: int, settled: Settled | None, aborted: Mux | None, now: Time) -> None:
        """Take an SDO frame of a server. settled: the value that it shows the device to hold. aborted: the object of an abort."""
        boot = self._boots.get(node_id)
        if boot is not None:
            self.is_part = True
            boot.take(settled, aborted, now)

    def command(self, command: int, node_id: int, now: Time) -> None:
        """Take an NMT command. node_id: 0 for all nodes."""
        for each in list(self._boots) if node_id == 0 else [node_id]:
            self._end_boot(each, _COMMANDS.get(command, "another NMT command"), now)

    def operational(self, node_id: int, now: Time) -> None:
        """Take a heartbeat of a node that is operational."""
        self._end_boot(node_id, "operational", now)

    def _end_boot(self, node_id: int, end: str, now: Time) -> None:
        boot = self._boots.pop(node_id, None)
        if boot is not None and boot.has_frames:
            how = f"; {end} {duration_text(now - boot.begin)} behind its boot-up" if end else ""
            self.ended.append(Summary("boot-up", node_id, boot.text() + how))

    def _wait(self, now: Time) -> None:
        self.deadline = min(self.deadline, now + SILENCE)


class _Fastscan:
    """One fastscan. numbers: the parts of the address that a device has confirmed."""

    def __init__(self, now: Time) -> None:
        self.begin = self.last = now
        self.requests = 0
        self.numbers: dict[int, int] = {}
        self.is_confirmed = False  # that there is a device without a node-ID
        self.is_over = False

    def ask(self, number: int, bit_check: int, part: int, following: int, now: Time) -> None:
        """Take a request."""
        self._number, self._bit_check, self._part, self._following = number, bit_check, part, following
        self.requests += 1
        self.last = now

    def answer(self, now: Time) -> None:
        """Take an answer to the last request."""
        self.last = now
        if self._bit_check == lss.CONFIRM:
            self.is_confirmed = True
        elif self._bit_check == 0 and self._following != self._part:
            self.numbers[self._part] = self._number
            self.is_over = self._following < self._part

    def text(self) -> str:
        """Return the fastscan in words."""
        count = f"{counted(self.requests, 'request')}, {duration_text(self.last - self.begin)}"
        numbers = sorted(self.numbers.items())
        found = ", ".join(f"{lss.field_name(part)} 0x{number:08X}" for part, number in numbers)
        if self.is_over:
            return f"fastscan: {found} is selected ({count})"
        if not self.is_confirmed:
            return f"fastscan: no device without a node-ID answers ({count})"
        return f"fastscan: given up{f' behind {found}' if found else ''} ({count})"


class _Boot:
    """The requests to a node since its boot-up, and its answers."""

    def __init__(self, now: Time) -> None:
        self.begin = self.last = now
        self.has_frames = False
        self._reads = 0
        self._writes = 0
        self._aborts = 0
        self._aborted: Mux | None = None  # the first one

    def take(self, settled: Settled | None, aborted: Mux | None, now: Time) -> None:
        """Take an SDO frame."""
        self.last, self.has_frames = now, True
        if settled is not None:
            if settled.is_read:
                self._reads += 1
            else:
                self._writes += 1
        if aborted is not None:
            self._aborts += 1
            self._aborted = self._aborted or aborted

    def text(self) -> str:
        """Return the transfers in words."""
        first = "" if self._aborted is None else f" ({mux_text(self._aborted)}{' first' if self._aborts > 1 else ''})"
        return f"{counted(self._reads, 'value')} read, {self._writes} written, {counted(self._aborts, 'transfer')} aborted{first}"


_IDENTIFIED: Final = bytes((LssService.IDENTIFIED,))
_COMMANDS: Final[dict[int, str]] = {
    NmtCommand.START: "started",
    NmtCommand.STOP: "stopped",
    NmtCommand.ENTER_PRE_OPERATIONAL: "told to stay pre-operational",
    NmtCommand.RESET_NODE: "reset",
    NmtCommand.RESET_COMMUNICATION: "its communication reset",
}
