"""The frames of SDO transfers in words.

The meaning of a frame depends on those before it: the follower (sdo.py) keeps that in an `SdoStep`.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.multiplexer import Mux, mux, split_mux
from canopen_proto.observer.meaning import Words, hex_text, object_text, shown_of

WRITTEN: Final = "written"
"""The verb of a confirmation: it shows the value as held, and does not repeat it in words."""


class SdoStep:
    """The content of one frame of a transfer, kept until somebody reads it in words. place: index and subindex, as sent."""

    __slots__ = ("after", "before", "data", "dictionary", "is_held", "node_id", "place")

    def __init__(
        self, dictionary: ObjectDictionary, node_id: int, place: bytes, before: str, after: str, data: bytes | None, is_held: bool
    ) -> None:
        self.dictionary = dictionary
        self.node_id = node_id
        self.place = place
        self.before = before
        self.after = after
        self.data = data
        self.is_held = is_held

    def say(self, _frame: Frame) -> Words:
        """Return the step in words, with its object."""
        index, subindex = split_mux(mux_of(self.place))
        shown = shown_of(self.dictionary, self.node_id, index, subindex, self.data, is_held=self.is_held)
        after = f" = {shown.text}" if self.data is not None and self.before != WRITTEN else self.after
        return Words(f"{self.before} {object_text(self.dictionary, index, subindex)}{after}", (shown,))


def alone(frame: Frame) -> Words:
    """Say that a frame belongs to a transfer of which nothing else is known."""
    return Words(f"part of a transfer whose beginning was not heard: {frame.data[:8].ljust(8, bytes(1)).hex(' ')}")


def a_confirmation(_frame: Frame) -> Words:
    """Say that a segment is confirmed, of a transfer of which nothing else is known."""
    return Words("a segment is confirmed")


def a_block_confirmation(_frame: Frame) -> Words:
    """Say that a block transfer is confirmed, of which nothing else is known."""
    return Words("a block transfer is confirmed")


def once_more(_frame: Frame) -> Words:
    """Say that a frame is the one before it."""
    return Words("the same frame once more")


def too_short(frame: Frame) -> Words:
    """Say that bytes are missing which the command byte announces."""
    return Words(f"too short for its command: {hex_text(frame.data)}")


def mux_of(place: bytes) -> Mux:
    """Return the object that an SDO frame names. place: index and subindex, as they are sent."""
    return mux(place[0] | place[1] << 8, place[2])


def name_of(place: bytes) -> str:
    """Return the object that an SDO frame names, as "6041:00"."""
    return f"{place[1]:02X}{place[0]:02X}:{place[2]:02X}"
