"""SocketCAN's error frames (linux/can/error.h): the identifier gives the kinds of error, the data bytes the details.

A CAN controller reports far more than anyone wants to read: with error reporting on, a wrong bit rate brings thousands of these
frames a second. `ErrorReport` decodes one frame; the transport reports only what has changed.
"""

from __future__ import annotations

from typing import Final

from canopen_transports.errors import BusState

_TX_TIMEOUT: Final = 0x001
_LOST_ARBITRATION: Final = 0x002
_CONTROLLER: Final = 0x004
_PROTOCOL: Final = 0x008
_TRANSCEIVER: Final = 0x010
_NO_ACKNOWLEDGE: Final = 0x020
_BUS_OFF: Final = 0x040
_BUS_ERROR: Final = 0x080
_RESTARTED: Final = 0x100

_CLASSES: Final = (
    (_TX_TIMEOUT, "transmission timed out"),
    (_LOST_ARBITRATION, "lost arbitration"),
    (_PROTOCOL, "protocol violation on the wire"),
    (_TRANSCEIVER, "transceiver fault"),
    (_NO_ACKNOWLEDGE, "no acknowledge"),
    (_BUS_OFF, "controller is bus-off"),
    (_BUS_ERROR, "bus error"),
    (_RESTARTED, "controller restarted"),
)
_OVERRUN: Final = 0x01
_TX_OVERRUN: Final = 0x02
_WARNING: Final = 0x0C
_PASSIVE: Final = 0x30
_ACTIVE: Final = 0x40
_CONTROLLER_TEXTS: Final = (  # data[1]
    (_OVERRUN, "controller's receive buffer overran"),
    (_TX_OVERRUN, "controller's transmit buffer overran"),
    (_WARNING, "controller warns of errors"),
    (_PASSIVE, "controller is error-passive"),
    (_ACTIVE, "controller is error-active again"),
)
_VIOLATIONS: Final = (  # data[2]
    (0x01, "single bit"),
    (0x02, "format"),
    (0x04, "bit stuffing"),
    (0x08, "a dominant bit failed"),
    (0x10, "a recessive bit failed"),
    (0x20, "overload"),
    (0x40, "active error flag"),
    (0x80, "while sending"),
)
_ACKNOWLEDGE_SLOT: Final = 0x19  # data[3]: where in the frame it happened


class ErrorReport:
    """The meaning of an error frame.

    text: for people. state: the BusState that it reports; None if it is part of normal operation (lost arbitration), or only
    counters. overrun: whether the controller lost received frames.
    """

    __slots__ = ("overrun", "state", "text")

    def __init__(self, can_id: int, data: bytes) -> None:
        """can_id: with or without flags. data: up to 8 bytes."""
        data = data.ljust(8, b"\0")
        controller = data[1] if can_id & _CONTROLLER else 0
        violation = data[2] if can_id & _PROTOCOL else 0
        no_acknowledge = bool(can_id & _NO_ACKNOWLEDGE or (can_id & _PROTOCOL and data[3] == _ACKNOWLEDGE_SLOT))
        texts = [text for bit, text in _CLASSES if can_id & bit]
        texts += [text for bits, text in _CONTROLLER_TEXTS if controller & bits]
        if can_id & _CONTROLLER and not controller:
            texts.append("controller trouble, unspecified")
        texts += [text for bit, text in _VIOLATIONS if violation & bit]
        if no_acknowledge and not can_id & _NO_ACKNOWLEDGE:
            texts.append("no acknowledge")
        if data[6] or data[7]:  # error counters; older drivers give them without their flag
            texts.append(f"tx error counter {data[6]}, rx error counter {data[7]}")
        self.text = ", ".join(texts) or "unknown error"
        self.overrun = bool(controller & _OVERRUN)
        self.state = _state(can_id, controller, no_acknowledge)


def _state(can_id: int, controller: int, no_acknowledge: bool) -> BusState | None:
    """Return the worst state that is reported."""
    if can_id & _BUS_OFF:
        return BusState.BUS_OFF
    if can_id & _RESTARTED or controller & _ACTIVE:
        return BusState.ACTIVE
    if controller & _PASSIVE:
        return BusState.PASSIVE
    if controller & _WARNING:
        return BusState.WARNING
    if no_acknowledge:
        return BusState.NO_ACKNOWLEDGE
    if can_id & (_TX_TIMEOUT | _PROTOCOL | _TRANSCEIVER | _BUS_ERROR) or controller & _TX_OVERRUN:
        return BusState.FAULT
    return None
