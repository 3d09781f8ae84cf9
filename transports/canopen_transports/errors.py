"""The errors and reports of a transport. Each is one screen of text that ends with the next step.

A transport raises three kinds of exception, and no others:

- `ValueError`: the caller passed a frame that classical CAN cannot carry. Nothing was sent.
- `ClosedResourceError`: our own side closed the transport, before or during the call. (`BusyResourceError`: two tasks receive at
  once.) In trio they are trio's, in asyncio those of `canopen_transports.loop`.
- `TransportError`: the bus cannot be opened or used. While the bus is away, `send` raises its subclass `FrameNotSentError`, and
  the transport continues to work. After any other TransportError it has ended.

A `Report` is not an error. `receive` returns it in place of a frame, in order with the frames: `ReceiveOverrun` if frames were
lost at this place, `BusStateChanged` if the bus reported its state.

The codes are those of the command line: CO1xx is the bus itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Final, Unpack

from canopen_proto.explained import ErrorWords, Explained

BAD_LOCATOR: Final = "CO100"
"""The locator is not valid; nothing was opened."""
CANNOT_OPEN: Final = "CO101"
"""The interface does not exist, is down or in use, or its driver is missing."""
NO_PERMISSION: Final = "CO102"
"""The interface exists, but this user may not open it."""
NOT_ACKNOWLEDGED: Final = "CO110"
"""Frames do not get out: no node acknowledges them, or the controller is bus-off."""
BUS_LOST: Final = "CO111"
"""The bus worked and then failed: adapter unplugged, interface set down, driver error."""
OVERRUN: Final = "CO112"
"""Frames arrived faster than they were taken; some are lost."""
STATE_CHANGED: Final = "CO113"
"""The bus reports the state of its controller, or that it went away or came back."""


class BusState(Enum):
    """The state that a bus reports. The first four are the fault confinement states of CAN (ISO 11898-1), from good to bad."""

    ACTIVE = "error-active"
    """The normal state; reported when the bus returns to it, also after bus-off."""
    WARNING = "error warning"
    """An error counter is at 96 or more: many frames are disturbed."""
    PASSIVE = "error-passive"
    """An error counter is at 128 or more. A controller whose frame nobody acknowledges gets here, and no further."""
    BUS_OFF = "bus-off"
    """The controller has left the bus. Frames do not get out (FrameNotSentError) until it is ACTIVE again."""
    NO_ACKNOWLEDGE = "no acknowledge"
    """Nobody acknowledged a frame of ours: no other node is on the bus, or none with our bit rate. The controller repeats the
    frame."""
    FAULT = "bus fault"
    """Another fault that an adapter reports: of the transceiver, or a protocol violation on the wire. See `seen`."""
    DOWN = "down"
    """The way to the bus is gone: interface set down, adapter unplugged, connection lost. Frames may be missing from here on."""
    UP = "up"
    """The way to the bus is back; frames come again."""


DEAF: Final = (BusState.DOWN, BusState.BUS_OFF)
"""A bus in one of these states is not heard: that nothing comes says nothing about a node."""


class _OfBus(Explained):
    def __init__(self, code: str, locator: str, failed: str, **words: Unpack[ErrorWords]) -> None:
        super().__init__(code, failed, **words)
        self.locator = locator


class TransportError(_OfBus, Exception):
    """The bus cannot be opened or used. locator: the bus, as `open_transport` takes it. The other fields: see Explained."""


class Report(_OfBus):
    """A ReceiveOverrun or a BusStateChanged, which `receive` returns in place of a frame.

    It is no error: the transport continues to work. locator: the bus. The other fields: see Explained.
    """

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.failed}>"


class ReceiveOverrun(Report):
    """Received frames were lost at this place in the order of frames.

    lost: how many, at least 1. It is a lower bound if a CAN controller reports a loss without its number.

    seen: how the loss showed. cause: "" for the usual one, a process that was too slow.
    """

    def __init__(self, locator: str, lost: int, seen: str, *, cause: str = "") -> None:
        super().__init__(
            OVERRUN,
            locator,
            f"{lost} received frame{'s' if lost > 1 else ''} lost on {locator}",
            seen=seen,
            cause=cause or "this process was too slow or stalled, or a burst was longer than the receive queue",
            tries=() if cause else ("take frames in a task that does nothing else",),
        )
        self.lost = lost


class BusStateChanged(Report):
    """The bus reported its state at this place in the order of frames.

    state: the new state. seen: what was observed, in words.
    """

    def __init__(self, locator: str, state: BusState, seen: str, *, cause: str = "", tries: Iterable[str] = ()) -> None:
        super().__init__(STATE_CHANGED, locator, f"{locator}: {state.value}", seen=seen, cause=cause, tries=tries)
        self.state = state


class FrameNotSentError(TransportError):
    """This frame was not sent because the bus is away (interface down, bus-off). The transport continues to work.

    To learn when the bus is back, wait for a BusStateChanged. Then decide whether the frame should still be sent.
    """

    @classmethod
    def because(cls, reason: TransportError) -> FrameNotSentError:
        """Return the same error as a FrameNotSentError."""
        return cls(reason.code, reason.locator, reason.failed, seen=reason.seen, cause=reason.cause, tries=reason.tries)


def bad_locator(text: str, seen: str, tries: Iterable[str]) -> TransportError:
    """Return the error for a locator that is not valid (CO100). text: the locator. seen: what is wrong with it. tries: what to
    try."""
    return TransportError(BAD_LOCATOR, text, f"the bus {text!r} is not a valid locator", seen=seen, tries=tries)
