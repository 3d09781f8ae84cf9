"""What a fuzzer's bytes mean: frames, time that passes, and things that our own side does; and the way back, for people.

A step is an operation byte and what belongs to it; whatever is cut off at the end counts as zeros. A crash is best read by
`python -m fuzz show FILE`; its text is also what a corpus file is made from (`encode`).

    operation % 8   0, 1   a frame with one of OWN_CAN_IDS: which, length % 9, that many bytes
                    2, 3   an SDO frame: which direction, 8 bytes
                    4      any frame: 4 bytes of identifier and flags, length % 9, that many bytes
                    5      time passes: 2 bytes, in units of 100 us
                    6      much time passes: 1 byte, in seconds
                    7      our own side acts: 2 bytes
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, TypeAlias

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import MICROSECOND, SECOND

OWN_CAN_IDS: Final = (0x000, 0x080, 0x085, 0x185, 0x205, 0x285, 0x305, 0x585, 0x605, 0x705, 0x709)
"""Those of node 5, the network's, and the heartbeat of node 9, which it monitors."""

TICK: Final = 100 * MICROSECOND

Step: TypeAlias = Frame | tuple[str, int]
"""A frame; ("wait", ns); ("act", number)."""


class _Bytes:
    """Bytes to be taken one after the other; behind their end there are zeros."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._place = 0

    def __bool__(self) -> bool:
        return self._place < len(self._data)

    def take(self, count: int) -> bytes:
        taken = self._data[self._place : self._place + count]
        self._place += count
        return taken.ljust(count, b"\x00")

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")


def decode(data: bytes) -> Iterator[Step]:
    """The steps that a fuzzer's bytes stand for. Any bytes stand for some."""
    source = _Bytes(data)
    while source:
        match source.number(1) % 8:
            case 0 | 1:
                can_id = OWN_CAN_IDS[source.number(1) % len(OWN_CAN_IDS)]
                yield Frame(can_id, source.take(source.number(1) % 9))
            case 2 | 3:
                yield Frame((0x605, 0x585)[source.number(1) % 2], source.take(8))
            case 4:
                yield _any_frame(source.number(4), source)
            case 5:
                yield "wait", source.number(2) * TICK
            case 6:
                yield "wait", source.number(1) * SECOND
            case _:
                yield "act", source.number(2)


def _any_frame(identifier: int, source: _Bytes) -> Frame:
    flags = identifier >> 29 & (EXTENDED | REMOTE)
    can_id = identifier & (0x1FFFFFFF if flags & EXTENDED else 0x7FF)
    length = source.number(1) % 9
    return Frame(can_id, b"", flags, length) if flags & REMOTE else Frame(can_id, source.take(length), flags)


def text_of(steps: Iterator[Step]) -> str:
    """Steps as lines: candump's notation, "wait 12.5 ms", "act 7"."""
    lines = []
    for step in steps:
        if isinstance(step, Frame):
            lines.append(str(step))
        else:
            what, amount = step
            lines.append(f"wait {amount / 1_000_000:g} ms" if what == "wait" else f"act {amount}")
    return "\n".join(lines)


def encode(text: str) -> bytes:
    """The bytes for such lines. Raises ValueError where a line is none of these, or waits for no multiple of 0.1 ms."""
    return b"".join(_encode_line(line.strip()) for line in text.splitlines() if line.strip())


def _encode_line(line: str) -> bytes:
    word, _, rest = line.partition(" ")
    if word == "act":
        return b"\x07" + int(rest).to_bytes(2, "little")
    if word == "wait":
        ticks = round(float(rest.removesuffix(" ms")) * 10)
        seconds, short = divmod(ticks, 10_000)
        return b"\x05" + ticks.to_bytes(2, "little") if ticks <= 0xFFFF or short else b"\x06" + bytes((seconds,))
    frame = Frame.parse(line)
    if frame.can_id in (0x605, 0x585) and not frame.flags and frame.dlc == 8:
        return bytes((2, frame.can_id == 0x585)) + frame.data
    if frame.can_id in OWN_CAN_IDS and not frame.flags:
        return bytes((0, OWN_CAN_IDS.index(frame.can_id), frame.dlc)) + frame.data
    return b"\x04" + (frame.can_id | frame.flags << 29).to_bytes(4, "little") + bytes((frame.dlc,)) + frame.data
