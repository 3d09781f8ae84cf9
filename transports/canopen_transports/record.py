"""`Record`: one frame in a log."""

from __future__ import annotations

from typing import NamedTuple

from canopen_proto.frame import Frame


class Record(NamedTuple):
    """One frame in a log. time: ns since 1970, or since the file begins. channel: its bus. sent: by the recorder itself."""

    time: int
    channel: str
    frame: Frame
    sent: bool = False
