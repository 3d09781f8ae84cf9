"""`BusFinding`: something on a bus that is against the standard, or that will not work. `Gaps`: where a recording lacks frames.

A recorder loses frames when its computer is busy; an adapter or a gateway holds them back and hands them over in a burst; a frame
is copied where its last bit was disturbed (the sender repeats it). Nobody on the bus is to blame for that. What such a frame
shows next is no evidence against a node: so each rule that a missing frame could break asks `Gaps` first. One cause is told once.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, Time

QUIET: Final = 1 * SECOND
"""Another sign within this time behind the last one is of the same gap."""

AT_ONCE: Final = 40 * MICROSECOND
"""No bus carries two frames in less time: the shortest one takes 47 us at 1 Mbit/s."""


class BusFinding(NamedTuple):
    """A fault. rule: one of RULES (observer.py). node_id: of the device that it concerns; 0 for none. text: for people.

    is_certain: no frames that are missing from the recording, or that came late, can look like this. Else it is likely only.
    """

    rule: str
    node_id: int
    text: str
    is_certain: bool = True


class Gaps:
    """Where a recording lacks frames, has them twice, or has them late; see this module's text.

    last: when the last sign came that frames are missing. is_at_once: this frame has come within AT_ONCE behind the one before
    it: a late reader took both from its queue, and when they came is not known.
    """

    def __init__(self) -> None:
        self.last: Time = -NEVER
        self.is_at_once = False
        self._copied: Time = -NEVER

    def is_near(self, now: Time) -> bool:
        """Return whether frames were missing, or there twice, within the last QUIET."""
        return now - max(self.last, self._copied) <= QUIET

    def missing(self, node_id: int, text: str, now: Time, found: list[BusFinding]) -> None:
        """Take a sign that frames are missing. found: takes the finding, if this is not the gap of the sign before. text: the
        sign, for people."""
        if now - self.last > QUIET:
            found.append(BusFinding("missing", node_id, f"frames are missing here: {text}", is_certain=False))
        self.last = now

    def lost(self, text: str, now: Time) -> BusFinding:
        """Take the receiver's own word that it lost frames; return it, as certain."""
        self.last = now
        return BusFinding("missing", 0, f"frames are missing here: {text}")

    def copied(self, node_id: int, text: str, now: Time, found: list[BusFinding]) -> None:
        """Take a frame that has come twice. text: for people. found: takes the finding, if the last one is a while ago, and if it
        is known when the frame came."""
        if now - self._copied > QUIET and not self.is_at_once:
            found.append(BusFinding("copied", node_id, text, is_certain=False))
        self._copied = now


def ms_text(time: Time) -> str:
    """Return a duration for people: "9.5 ms"."""
    return f"{round(time / MILLISECOND, 1):g} ms"


def duration_text(time: Time) -> str:
    """Return a duration for people, with three digits: "1.25 s", "9.54 ms"."""
    return f"{time / SECOND:.3g} s" if time >= SECOND else f"{time / MILLISECOND:.3g} ms"
