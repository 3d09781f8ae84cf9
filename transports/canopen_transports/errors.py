"""What a transport reports when the world refuses: `TransportError`, one screen that ends in the next step.

Three kinds of failure, and no other, leave a transport:

- `ValueError`: our own caller asked for a frame that classical CAN cannot carry. Nothing was sent.
- `trio.ClosedResourceError`: our own side closed the transport, before or during the call. (`trio.BusyResourceError`: two tasks
  receive at once.)
- `TransportError`: the world refused. After a `FrameNotSent`, which `send` raises while the bus is away, the transport goes on
  working; after any other it has ended.

A `Report` is no error. `receive` returns it in place of a frame, at its place in the order of frames: `ReceiveOverrun` if frames
were lost there, `BusStateChanged` if the bus told its state.

The codes are those of the command line: CO1xx is the bus itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Final

from canopen_proto.explained import Explained

BAD_LOCATOR: Final = "CO100"
"""The locator makes no sense; nothing was opened."""
CANNOT_OPEN: Final = "CO101"
"""The interface is not there, is down, is in use, or its driver is missing."""
NO_PERMISSION: Final = "CO102"
"""The interface is there, but this user may not open it."""
NOT_ACKNOWLEDGED: Final = "CO110"
"""Frames do not get out: nobody acknowledges them, or the controller is bus-off."""
BUS_LOST: Final = "CO111"
"""The bus worked and then failed: adapter unplugged, interface set down, driver error."""
OVERRUN: Final = "CO112"
"""Frames were received faster than they were taken; some are lost."""
STATE_CHANGED: Final = "CO113"
"""The bus reports something that is no frame: its controller's state, or that it went away or came back."""


class BusState(Enum):
    """What a bus reports of itself. The first four are the fault confinement states of CAN (ISO 11898-1), in rising order."""

    ACTIVE = "error-active"
    """As it should be; reported when it is so again, also after bus-off."""
    WARNING = "error warning"
    """One of the error counters is at 96 or more: many frames are disturbed."""
    PASSIVE = "error-passive"
    """One of the error counters is at 128 or more; a frame that nobody acknowledges takes a controller there, and no further."""
    BUS_OFF = "bus-off"
    """The controller has left the bus. What is sent now does not get out (FrameNotSent), until it is ACTIVE again."""
    NO_ACKNOWLEDGE = "no acknowledge"
    """A frame of ours was not acknowledged: nobody else is on the bus, or nobody with our bit rate. The controller repeats it."""
    FAULT = "bus fault"
    """Something else that an adapter reports: a transceiver's fault, a protocol violation on the wire. See `seen`."""
    DOWN = "down"
    """The way to the bus is gone: interface set down, adapter unplugged, connection lost. Frames may be missing from here on."""
    UP = "up"
    """It is back, and frames come again."""


class _OfBus(Explained):
    def __init__(
        self, code: str, locator: str, failed: str, *, seen: str = "", cause: str = "", tries: Iterable[str] = ()
    ) -> None:
        super().__init__(code, failed, seen=seen, cause=cause, tries=tries)
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
    """Received frames were lost, at this place in the order of frames.

    lost: how many, at least 1. Only a lower bound where a CAN controller reports that it lost some, but not how many.
    """

    def __init__(self, locator: str, lost: int, seen: str, *, cause: str = "") -> None:
        super().__init__(
            OVERRUN,
            locator,
            f"{lost} received frame{'s' if lost > 1 else ''} lost on {locator}",
            seen=seen,
            cause=cause or "this process was too slow, or stalled; a burst was longer than the receive queue",
            tries=() if cause else ("take frames in a task that does nothing else",),
        )
        self.lost = lost


class BusStateChanged(Report):
    """The bus reports its state, at this place in the order of frames.

    state: what it is now. seen: what was observed, in words.
    """

    def __init__(self, locator: str, state: BusState, seen: str, *, cause: str = "", tries: Iterable[str] = ()) -> None:
        super().__init__(STATE_CHANGED, locator, f"{locator}: {state.value}", seen=seen, cause=cause, tries=tries)
        self.state = state


class FrameNotSent(TransportError):
    """This frame was not sent because the bus is away (interface down, bus-off). The transport continues to work.

    To learn when the bus is back, wait for a BusStateChanged. Then decide whether the frame should still be sent.
    """

    @classmethod
    def because(cls, reason: TransportError) -> FrameNotSent:
        """Return the same error as a FrameNotSent."""
        return cls(reason.code, reason.locator, reason.failed, seen=reason.seen, cause=reason.cause, tries=reason.tries)


def bad_locator(text: str, seen: str, tries: Iterable[str]) -> TransportError:
    """Return the error for a locator that is not valid (CO100)."""
    return TransportError(BAD_LOCATOR, text, f"the bus {text!r} is not a valid locator", seen=seen, tries=tries)
