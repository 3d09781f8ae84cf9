"""`Record`: a frame in a log."""

from __future__ import annotations

from typing import NamedTuple

from canopen_proto.frame import Frame


class Record(NamedTuple):
    """A frame in a log. time: ns since 1970, or since the file begins. sent: by whoever recorded it."""

    time: int
    channel: str
    frame: Frame
    sent: bool = False
