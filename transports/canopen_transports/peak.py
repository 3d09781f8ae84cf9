"""What python-can's pcan backend leaves out: PCAN-Basic's status codes, and which channels are there.

PCAN-Basic answers each call with a status: a set of bits (its `PCAN_ERROR_...`). Three kinds matter:

- the bus's state: light, heavy and passive stand for the error counters' limits, and bus-off;
- frames were lost, as the controller (OVERRUN) or the library's queue (QOVERRUN) was read too late;
- everything else that is no mere want of room: the adapter is gone, the driver failed.

python-can turns them into exceptions that only carry the library's own texts for these bits. `PeakStatus.code` goes the way
back, by asking the library for its texts. After bus-off python-can's `reset` does not help: PCAN-Basic's CAN_Reset empties the
queues and leaves the controller as it is. Initialising the channel again brings it back, or `?auto_reset=true`, by which
the driver does so itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Final

import can

from canopen_transports.errors import BusState

LIGHT: Final = 0x4
HEAVY: Final = 0x8
"""PCAN-Basic's BUSWARNING is the same bit."""
BUS_OFF: Final = 0x10
PASSIVE: Final = 0x40000
OVERRUN: Final = 0x2
QUEUE_OVERRUN: Final = 0x40
_BUS: Final = LIGHT | HEAVY | BUS_OFF | PASSIVE
_OVERRUNS: Final = OVERRUN | QUEUE_OVERRUN
_NO_FAULT: Final = 0x1 | 0x20 | 0x80 | 0x20000 | 0x2000000  # XMTFULL, QRCVEMPTY, QXMTFULL, ILLDATA (CAN FD on the bus), CAUTION
_LANGUAGE: Final = 0x9  # English

# PCAN_CHANNEL_CONDITION: available, occupied, both where PEAK's own viewer has it (and lets others in)
_AVAILABLE: Final = 1
_OCCUPIED: Final = 2

_KINDS: Final = {1: "bit error", 2: "form error", 4: "stuff error"}


def state_of(status: int) -> BusState:
    """The bus's state that a status tells, the gravest first."""
    if status & BUS_OFF:
        return BusState.BUS_OFF
    if status & PASSIVE:
        return BusState.PASSIVE
    return BusState.WARNING if status & _BUS else BusState.ACTIVE


def has_overrun(status: int) -> bool:
    """Whether received frames were lost."""
    return bool(status & _OVERRUNS)


def is_lost(status: int) -> bool:
    """Whether the adapter or its driver has failed."""
    return bool(status & ~(_BUS | _OVERRUNS | _NO_FAULT))


class PeakStatus:
    """The status of an open bus of python-can's pcan backend."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus: Any = bus
        self._codes: dict[str, int] = {}

    def look(self) -> int:
        """The status now."""
        return int(self._bus.status())

    def code(self, error: BaseException) -> int:
        """The status that an exception of python-can stands for; 0 where its text says nothing that the library knows."""
        if not self._codes:
            self._codes = {self.text(1 << bit): 1 << bit for bit in range(32)}
            self._codes |= {self.text(code): code for code in (0x1400, 0x1800, 0x1C00)}  # the invalid handles: two bits each
        lines = str(error).removeprefix("Failed to send: ").splitlines()
        code = 0
        for line in lines:
            code |= self._codes.get(line, 0)
        return code

    def text(self, status: int) -> str:
        """The library's words for a status of one bit; for several, one after the other."""
        parts = [status] if status & (status - 1) == 0 or status in (0x1400, 0x1800, 0x1C00) else _bits(status)
        return "; ".join(self._one_text(part) for part in parts)

    def _one_text(self, status: int) -> str:
        result, text = self._bus.m_objPCANBasic.GetErrorText(status, _LANGUAGE)
        return text.decode("utf-8", errors="replace") if result == 0 else f"status 0x{status:X}"


def error_text(message: can.Message) -> str:
    """What an error frame of PCAN-Basic says. ID: the kind; data: direction, place in the frame, both error counters."""
    sending, _, received, sent = bytes(message.data[:4]).ljust(4, b"\0")
    kind = _KINDS.get(message.arbitration_id, "another error on the wire")
    return f"{kind} while {'receiving' if sending else 'sending'}, tx error counter {sent}, rx error counter {received}"


def attached() -> dict[str, str]:
    """The channels of all PEAK adapters that PCAN-Basic sees, each with "free" or "in use"; none where there is no library."""
    found: dict[str, str] = {}
    with suppress(OSError, AttributeError, StopIteration, NotImplementedError):
        from can.interfaces.pcan import PcanBus

        detect: Callable[[], Iterable[dict[str, Any]]] = PcanBus._detect_available_configs
        configs = detect()
        for config in configs:
            condition = config.get("channel_condition", _AVAILABLE)
            found[str(config["channel"])] = (
                "free" if condition & _AVAILABLE else "in use" if condition & _OCCUPIED else "not usable"
            )
    return found


def _bits(status: int) -> list[int]:
    return [1 << bit for bit in range(32) if status >> bit & 1]
