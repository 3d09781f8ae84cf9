"""Ask a node by SDO for what `canopen watch` shows, as far as no PDO brings it, at a rate that leaves the bus to others.

One request at a time, and a pause after each: all of them take at most MAX_SHARE of the bus. The answers are not used here; the
command hears them on the bus, as it hears PDOs.

An SDO server has one client at a time (CiA 301 v4.2.0, 7.2.4.1). So nothing is asked while another program asks the node, until
OTHERS_QUIET after its last request; what it reads is shown meanwhile.

At first, and after each boot-up, the device's TPDO parameters are read: so its PDOs are understood by the mapping that they have.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NoReturn

import trio

from canopen_cli.live.watched import FRESH, Watched
from canopen_cli.shared.session import BusSession
from canopen_cli.shared.values import block_of
from canopen_master.errors import NO_ANSWER, SdoError, SdoRefusedError
from canopen_master.node import Node
from canopen_proto.abort import AbortOrigin, text_of
from canopen_proto.dictionary import Direction, Variable
from canopen_proto.frame import Frame
from canopen_proto.frame_bits import frame_bits, worst_bits
from canopen_proto.machine import SECOND, Time
from canopen_proto.pdo.configure import InvalidPdoError, read_pdo
from canopen_proto.procedures.objects import UnexpectedLengthError
from canopen_proto.procedures.steps import SdoTransferError
from canopen_transports.locator import bitrate_text

MAX_SHARE: Final = 0.05
"""The share of the bus that the requests and answers take at most."""
SLOW_BUS: Final = 125_000
"""bit/s that are assumed if the bit rate is not known."""
READ_BITS: Final = 2 * worst_bits(8)
"""A request and its answer."""
SILENT_AGAIN: Final = 1.0
"""Seconds until a node that did not answer is asked again."""
REFUSED_AGAIN: Final = 5.0
"""Seconds until a node is asked again for an object that it refused: some are refused in one state only."""
OTHERS_QUIET: Final = 2.0
"""Seconds without a request of another client until the node is asked again."""
MAX_PDOS: Final = 8
"""PDOs of each direction whose parameters are read."""
MAX_READS: Final = 6
"""Reads for the parameters of a usual PDO."""
NO_ANSWER_TEXT: Final = "the node does not answer SDO requests"


class Load:
    """The frames and bits of one second, counted."""

    def __init__(self) -> None:
        self._second = 0
        self._now = (0, 0)
        self._last = (0, 0)

    def add(self, frame: Frame, now: Time) -> None:
        """Count a frame."""
        self._turn(now)
        self._now = self._now[0] + 1, self._now[1] + frame_bits(frame)

    def last_second(self, now: Time) -> tuple[int, int]:
        """Return frames and bits of the last whole second."""
        self._turn(now)
        return self._last

    def _turn(self, now: Time) -> None:
        second = now // SECOND
        if second != self._second:
            self._last = self._now if second == self._second + 1 else (0, 0)
            self._second, self._now = second, (0, 0)


def load_text(load: tuple[int, int], bitrate: int | None) -> str:
    """Return the load that the requests make, for people. load: frames and bits of a second. bitrate: bit/s; None: not known."""
    frames, bits = load
    share = f"{bits / bitrate * 100:.2g} % of {bitrate_text(bitrate)}" if bitrate else f"{bits / 1000:.2g} kbit/s"
    return f"SDO: {frames // 2} reads a second, {share} of load" if frames else "SDO: no reads"


class Polling:
    """See this module's text.

    now: returns the time of `watched`, ns. every: ns between two requests for one object. bitrate: bit/s; None: not known.
    """

    def __init__(
        self, session: BusSession, node: Node, watched: Watched, now: Callable[[], Time], every: Time, bitrate: int | None
    ) -> None:
        self._session, self._node, self._watched = session, node, watched
        self._now = now
        self._every = every / SECOND
        self._pause = READ_BITS / (MAX_SHARE * (bitrate or SLOW_BUS))
        self._unknown: list[tuple[Direction, int]] = []  # PDOs whose parameters are to be read
        self._boots = 0  # of the node, before that began
        self._others: float | None = None  # trio's clock: when another client asked last

    def make_way(self) -> None:
        """Ask for nothing for a while: another client asks."""
        self._others = trio.current_time()

    @property
    def makes_way(self) -> bool:
        """Whether nothing is asked, since another client asks."""
        return self._others is not None and trio.current_time() - self._others < OTHERS_QUIET

    async def run(self) -> NoReturn:
        """Ask for ever. Raises BusError."""
        start = trio.current_time()
        due: dict[Variable | None, float] = dict.fromkeys(self._watched.variables, start)
        due[None] = math.nextafter(start, math.inf)  # the mappings: once each object was asked for
        while True:
            if self._boots != self._watched.boots:
                self._unknown, self._boots, due[None] = [], self._watched.boots, trio.current_time()
            each = min(due, key=lambda each: due[each])
            await trio.sleep_until(due[each])
            if self.makes_way:
                await trio.sleep(OTHERS_QUIET / 4)
                continue
            if each is None:
                pause = await self._learn_mapping()
            elif self._watched.pdo_age(each, self._now()) < FRESH // 2:
                due[each] = trio.current_time() + self._every
                continue
            else:
                pause = await self._ask(each)
            due[each] = trio.current_time() + (pause or self._every)
            if pause == SILENT_AGAIN:
                due = {other: max(time, due[each]) for other, time in due.items()}
            await trio.sleep(self._pause)

    async def _ask(self, variable: Variable) -> float:
        """Read an object; return the seconds until the next time, 0 for the usual ones."""
        try:
            await self._node.read_bytes(variable.index, variable.subindex, block=block_of(variable, None))
        except SdoRefusedError as refused:
            self._watched.refused(variable, f"refused: {text_of(refused.abort_code)}")
            return REFUSED_AGAIN
        except SdoError as error:
            for each in self._watched.variables:
                self._watched.refused(each, _reason(error))
            return SILENT_AGAIN
        return 0.0

    async def _learn_mapping(self) -> float:
        """Read the parameters of the device's next PDO, which the observer hears. Returns as `_ask`; math.inf after the last."""
        if not self._unknown:
            is_written = any(each.access.writable for each in self._watched.variables)
            directions = (Direction.TPDO, Direction.RPDO) if is_written else (Direction.TPDO,)
            self._unknown = [(direction, number) for direction in directions for number in range(1, MAX_PDOS + 1)]
        direction, number = self._unknown[0]
        is_last = False
        try:
            await self._session.master.run(read_pdo(self._node.remote, direction, number))
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.PEER:
                return SILENT_AGAIN
            is_last = True
        except (InvalidPdoError, UnexpectedLengthError):
            pass  # the observer judges for itself
        self._unknown = [pdo for pdo in self._unknown[1:] if not (is_last and pdo[0] is direction)]
        return MAX_READS * self._pause if self._unknown else math.inf


def _reason(error: SdoError) -> str:
    return NO_ANSWER_TEXT if error.code == NO_ANSWER else error.failed
