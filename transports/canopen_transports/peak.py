"""PCAN-Basic's status codes and the channels that exist, which python-can's pcan backend leaves out.

PCAN-Basic answers each call with a status: a set of bits (its `PCAN_ERROR_...`). Three kinds matter:

- the state of the bus: light, heavy and passive stand for the limits of the error counters; and bus-off;
- lost frames: the controller (OVERRUN) or the library's queue (QOVERRUN) was read too late;
- all others, except those for a full or empty queue: the adapter is gone, or the driver failed.

python-can turns a status into an exception that carries only the library's texts for these bits. `PeakStatus.code` finds the bits
again by asking the library for its texts. After bus-off, python-can's `reset` does not help: PCAN-Basic's CAN_Reset empties the
queues and leaves the controller as it is. The channel must be initialised again; with `?auto_reset=true` the driver does that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from canopen_transports.errors import BusState

if TYPE_CHECKING:
    import can

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

# PCAN_CHANNEL_CONDITION: available, occupied; both if PEAK's viewer uses the channel, which it shares
_AVAILABLE: Final = 1
_OCCUPIED: Final = 2

_KINDS: Final = {1: "bit error", 2: "form error", 4: "stuff error"}


def state_of(status: int) -> BusState:
    """Return the bus's state in a status: the worst, if there are several."""
    if status & BUS_OFF:
        return BusState.BUS_OFF
    if status & PASSIVE:
        return BusState.PASSIVE
    return BusState.WARNING if status & _BUS else BusState.ACTIVE


def has_overrun(status: int) -> bool:
    """Whether received frames were lost. status: of PCAN-Basic, bits."""
    return bool(status & _OVERRUNS)


def is_lost(status: int) -> bool:
    """Whether the adapter or its driver has failed. status: of PCAN-Basic, bits."""
    return bool(status & ~(_BUS | _OVERRUNS | _NO_FAULT))


class PeakStatus:
    """The status of an open bus of python-can's pcan backend."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus: Any = bus
        self._codes: dict[str, int] = {}

    def look(self) -> int:
        """Return the status now."""
        return int(self._bus.status())

    def code(self, error: BaseException) -> int:
        """Return the status that an exception of python-can stands for; 0 if the library does not know its text."""
        if not self._codes:
            self._codes = {self.text(1 << bit): 1 << bit for bit in range(32)}
            self._codes |= {self.text(code): code for code in (0x1400, 0x1800, 0x1C00)}  # the invalid handles: two bits each
        lines = str(error).removeprefix("Failed to send: ").splitlines()
        code = 0
        for line in lines:
            code |= self._codes.get(line, 0)
        return code

    def text(self, status: int) -> str:
        """Return the library's words for a status, those of several bits one after the other."""
        is_one = status & (status - 1) == 0 or status in (0x1400, 0x1800, 0x1C00)
        parts = [status] if is_one else [1 << bit for bit in range(32) if status >> bit & 1]
        return "; ".join(self._one_text(part) for part in parts)

    def _one_text(self, status: int) -> str:
        result, text = self._bus.m_objPCANBasic.GetErrorText(status, _LANGUAGE)
        return text.decode("utf-8", errors="replace") if result == 0 else f"status 0x{status:X}"


def error_text(message: can.Message) -> str:
    """Return the meaning of an error frame of PCAN-Basic. Its ID is the kind; its data: direction, place in the frame, error
    counters."""
    sending, _, received, sent = bytes(message.data[:4]).ljust(4, b"\0")
    kind = _KINDS.get(message.arbitration_id, "another error on the wire")
    return f"{kind} while {'receiving' if sending else 'sending'}, tx error counter {sent}, rx error counter {received}"


def attached() -> dict[str, str]:
    """Return the channels of all PEAK adapters that PCAN-Basic sees, each with "free" or "in use"; none if the library is
    missing."""
    found: dict[str, str] = {}
    with suppress(OSError, AttributeError, StopIteration, NotImplementedError):
        from can.interfaces.pcan import PcanBus

        detect: Callable[[], Iterable[dict[str, Any]]] = PcanBus._detect_available_configs
        for config in detect():
            condition = config.get("channel_condition", _AVAILABLE)
            found[str(config["channel"])] = (
                "free" if condition & _AVAILABLE else "in use" if condition & _OCCUPIED else "not usable"
            )
    return found
