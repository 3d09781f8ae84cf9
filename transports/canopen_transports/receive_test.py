"""The receive test: open a bus, send nothing, and report what is heard.

If python-can can make the adapter listen only, the test does so; then not even a wrong bit rate disturbs a running bus. Otherwise
the adapter's controller acknowledges the frames of others, as any node does. The test never sends a frame.

A wrong bit rate shows as error frames without any frame. `find_bitrate` tries one bit rate after the other, and only with
adapters that can listen only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from canopen_proto.frame import EXTENDED, Frame
from canopen_transports.diagnosis import bring_up
from canopen_transports.errors import BAD_LOCATOR, BusState, BusStateChanged, ReceiveOverrun, TransportError
from canopen_transports.listen_only import LISTEN_ONLY, can_listen_only
from canopen_transports.locator import Locator, bitrate_text, parse_locator
from canopen_transports.loop import current_loop
from canopen_transports.opening import open_transport
from canopen_transports.transport import Transport

BITRATES: Final = (1_000_000, 500_000, 250_000, 125_000, 800_000, 100_000, 50_000, 20_000, 10_000)
"""The bit rates of CiA 301 (v4.2.0, table 1), the usual ones first."""
_HEARTBEATS: Final = range(0x701, 0x780)
Each: TypeAlias = Callable[[Frame, int | None], None]
NO_WIRE: Final = ("virtual", "udp_multicast", "tcp")
"""Interfaces without a CAN controller."""


@dataclass
class Heard:
    """The frames that were heard on a bus, counted.

    locator: as it was opened. listen_only: whether the adapter only listened. frames: how many came. ids: how often each 11-bit
    CAN-ID came. first: the first frame. states: the bus's reports, in order. faults: how many error frames. lost: how many
    frames.
    """

    locator: str
    listen_only: bool
    frames: int = 0
    ids: Counter[int] = field(default_factory=Counter)
    first: Frame | None = None
    states: list[tuple[BusState, str]] = field(default_factory=list)
    faults: int = 0
    lost: int = 0

    @property
    def nodes(self) -> list[int]:
        """The nodes whose heartbeat or boot-up came."""
        return sorted(can_id - 0x700 for can_id in self.ids if can_id in _HEARTBEATS)

    @property
    def is_bad(self) -> bool:
        """Whether the bus is at fault, not merely silent."""
        return any(state in (BusState.BUS_OFF, BusState.DOWN) for state, _ in self.states) or self.faults > 0


def _has_silent_wire(locator: Locator) -> bool:
    return can_listen_only(locator) and locator.interface not in NO_WIRE


def silently(locator: Locator) -> str:
    """Return the locator that opens the same bus to listen only, or the same locator if that is not possible."""
    if not can_listen_only(locator) or LISTEN_ONLY in locator.options:
        return locator.text
    return f"{locator.text}{'&' if '?' in locator.text else '?'}{LISTEN_ONLY}=true"


async def listen(text: str, seconds: float, each: Each = lambda frame, stamp: None) -> Heard:
    """Report what is heard on a bus within `seconds`. each: called with each frame and its time stamp. text: the locator.

    Raises TransportError if the bus cannot be opened, or fails.
    """
    locator = parse_locator(text)
    async with await open_transport(silently(locator)) as transport:
        return await listen_on(transport, text, seconds, each, listen_only=_has_silent_wire(locator))


async def listen_on(
    transport: Transport,
    text: str,
    seconds: float,
    each: Each = lambda frame, stamp: None,
    *,
    listen_only: bool = False,
) -> Heard:
    """Do as `listen` on an open bus. text: its locator, for the result. listen_only: it does not acknowledge."""
    heard = Heard(text, listen_only)
    with current_loop().move_on_after(seconds):
        while True:
            received = await transport.receive()
            if isinstance(received, BusStateChanged):
                heard.states.append((received.state, received.seen))
            elif isinstance(received, ReceiveOverrun):
                heard.lost += received.lost
            elif isinstance(received, tuple):
                frame, stamp = received
                each(frame, stamp)
                heard.frames += 1
                heard.first = heard.first or frame
                if not frame.flags & EXTENDED:
                    heard.ids[frame.can_id] += 1
    errors = getattr(transport, "errors", 0)
    heard.faults = errors if isinstance(errors, int) else 0
    return heard


async def find_bitrate(text: str, seconds: float, told: Callable[[Heard], None] = lambda heard: None) -> Heard | None:
    """Listen at one bit rate after the other; return the first result with frames and without errors, or None. text: the locator.

    seconds: for each bit rate. told: called with each result. Bit rates that the adapter does not support are left out. Raises
    TransportError if the adapter cannot listen only (CO100), or cannot be opened.
    """
    locator = parse_locator(text)
    if not _has_silent_wire(locator):
        seen = f"{locator.interface} cannot listen only; with a wrong bit rate it would destroy the frames of others"
        tries: tuple[str, ...] = ("an adapter that can: pcan, slcan, kvaser, vector",)
        if locator.interface == "socketcan":
            again = f"sudo ip link set {locator.channel} down && {bring_up(locator)} listen-only on && canopen doctor -b {text}"
            tries = (f"{again}   (for each bit rate)", *tries)
        raise TransportError(BAD_LOCATOR, text, f"cannot try bit rates on {text}", seen=seen, tries=tries)
    address, _, query = text.partition("?")
    address = address.rpartition("@")[0] or address
    failure: TransportError | None = None
    opened = False
    for bitrate in BITRATES:
        name = (
            f"{address}@{bitrate_text(bitrate)}" if locator.text[:1] != "/" else f"pcan:{locator.channel}@{bitrate_text(bitrate)}"
        )
        try:
            heard = await listen(f"{name}?{query}" if query else name, seconds)
        except TransportError as error:
            failure = error
            continue
        opened = True
        told(heard)
        if heard.frames and not heard.faults:
            return heard
    if failure is not None and not opened:
        raise failure
    return None
