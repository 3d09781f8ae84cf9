"""`Passed`: one frame that was on a bus of a World."""

from __future__ import annotations

from typing import NamedTuple

from canopen_proto.frame import Frame
from canopen_proto.machine import Time


class Passed(NamedTuple):
    """See this module's text. time: ns. sender: its name; "" for somebody whom nobody knows.

    fate: what a fault did to it, in words; "" if it came as it was sent. only: the one receiver that this is about; 0: all.
    """

    time: Time
    frame: Frame
    sender: str
    fate: str = ""
    only: int = 0

    @property
    def was_heard(self) -> bool:
        """Whether the bus has seen it: it was not lost on its way, and it is no copy that one receiver alone has got."""
        return self.fate != "lost" and not self.only
