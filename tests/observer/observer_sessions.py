"""Clean recordings for the observer, made by our own stack; and what a recorder does to them: frames are lost, copied, late."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from random import Random

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from tests.core.block_pair import BlockPair, pattern
from tests.core.bus import Bus

Session = list[tuple[Time, Frame]]
NODE = 12
CLEAN = 60
"""Clean recordings: see `clean`."""
OF_THE_RECORDER = frozenset(("missing", "copied", "late heartbeat", "late pdo"))
"""What may be told of a clean recording that was damaged, besides a boot-up whose reset command was lost."""


def transfer(size: int, *, up: bool, block: bool, crc: bool = True) -> Session:
    """A transfer of our client and our server."""
    content = pattern(size)
    pair = BlockPair(Bus(0), content, client={"crc": crc, "block_size": 9}, server={"block_size": 9})
    if up:
        pair.upload(block)
    else:
        pair.download(content, block)
    pair.bus.settle()
    return pair.bus.sent


def _sdo(index: int, subindex: int, value: int, size: int, *, is_read: bool) -> Iterator[str]:
    place = f"{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}"
    data, command = value.to_bytes(4, "little").hex(), 3 | (4 - size) << 2
    yield f"{0x600 + NODE:03X}#40{place}00000000" if is_read else f"{0x600 + NODE:03X}#{0x20 | command:02X}{place}{data}"
    yield f"{0x580 + NODE:03X}#{0x40 | command:02X}{place}{data}" if is_read else f"{0x580 + NODE:03X}#60{place}00000000"


def _configured() -> Iterator[str]:
    """Node 12 gets a heartbeat of 100 ms, a synchronous TPDO, an event-driven one, and a consumer; then it is started."""
    for entry in (
        (0x1017, 0, 100, 2),
        (0x1016, 1, 13 << 16 | 250, 4),
        (0x1800, 1, 0x8000_0180 + NODE, 4),
        (0x1800, 2, 1, 1),
        (0x1A00, 0, 0, 1),
        (0x1A00, 1, 0x6041_0010, 4),
        (0x1A00, 0, 1, 1),
        (0x1800, 1, 0x180 + NODE, 4),
        (0x1801, 3, 200, 2),
        (0x1015, 0, 200, 2),
    ):
        yield from _sdo(*entry, is_read=False)
    yield f"000#01{NODE:02X}"


@cache
def machine(counter: int = 0) -> tuple[tuple[Time, Frame], ...]:
    """Three seconds of a bus: node 12 is reset, boots, is configured, runs with SYNC each 20 ms, and is read by SDO. LSS, and the
    guarding of node 14. counter: the overflow value of SYNC's counter; 0: without one."""
    lines: list[tuple[Time, str]] = []
    now = 0
    for text in ("70D#05", f"000#81{NODE:02X}", "70C#00", *_configured()):
        now += 2 * MILLISECOND
        lines.append((now, text))
    end = now + 3 * SECOND
    for number in range(140):
        at = now + number * 20 * MILLISECOND
        lines.append((at, f"080#{number % counter + 1:02X}" if counter else "080#"))
        lines.append((at + MILLISECOND, f"18C#{number & 0xFF:02X}02"))
        if number % 3 == 0:
            reads = [(0x6041, 0, 0x0237 + number, 2), (0x1018, 1 + number % 4, 77, 4)]
            for place, text in enumerate(_sdo(*reads[number % 2], is_read=True)):
                lines.append((at + (5 + place) * MILLISECOND, text))
    for number in range(30):
        at = now + number * 100 * MILLISECOND
        lines += [(at + 3 * MILLISECOND, f"70C#{4 if 12 < number < 18 else 5:02X}"), (at + 8 * MILLISECOND, "70D#05")]
        lines += [(at + 9 * MILLISECOND, "70E#R1"), (at + 10 * MILLISECOND, f"70E#{5 + 0x80 * (number % 2):02X}")]
        if number in (12, 17):
            lines.append((at + 50 * MILLISECOND, f"000#0{2 if number == 12 else 1}{NODE:02X}"))
    for number, service in enumerate(("5A", "5B", "5C", "5D")):
        lines.append((end + number * MILLISECOND, f"7E5#{service}00000000000000"))
        lines.append((end + number * MILLISECOND + 500 * MICROSECOND, f"7E4#{service}0{number}000000000000"))
    stopped = range(now + 12 * 100 * MILLISECOND + 50 * MILLISECOND, now + 17 * 100 * MILLISECOND + 50 * MILLISECOND)
    kept = [each for each in lines if not (each[0] in stopped and each[1][:3] in ("18C", "58C", "60C"))]
    return tuple((at, Frame.parse(text)) for at, text in sorted(kept, key=lambda line: line[0]))


def clean(number: int) -> Session:
    """A clean recording: of a machine, with and without a counter, or of transfers."""
    if number < 4:
        return list(machine((0, 0, 10, 240)[number]))
    size, kind = 1 + (number * 37) % 400, number % 8
    parts = [transfer(each, up=bool(kind & 1), block=bool(kind & 2), crc=bool(kind & 4)) for each in (size, 30, size // 2 + 1)]
    return [(at + place * SECOND, frame) for place, part in enumerate(parts) for at, frame in part]


def damaged(session: Session, seed: int) -> Session:
    """A recording as a recorder leaves it that loses frames, has them twice, has single ones late, or holds back a burst."""
    random = Random(seed)
    rate = random.choice((0.0, 0.003, 0.01, 0.05, 0.2))
    ways: list[Callable[[Session], Session]] = [
        lambda each: [line for line in each if random.random() >= rate],
        lambda each: [copy for line in each for copy in [line] * (2 if random.random() < rate else 1)],
        lambda each: _late(each, random, rate),
        lambda each: _held_back(each, random),
        lambda each: _without_a_part(each, random),
    ]
    for way in random.sample(ways, random.randint(1, 3)):
        session = way(session)
    return session


def _late(session: Session, random: Random, rate: float) -> Session:
    lines = [(at + (random.randint(0, 20) * MILLISECOND if random.random() < rate else 0), frame) for at, frame in session]
    return sorted(lines, key=lambda line: line[0])


def _held_back(session: Session, random: Random) -> Session:
    """For a while nothing comes, then all of it at once, 50 us apart."""
    if not session:
        return session
    begin, length = random.choice(session)[0], random.randint(1, 2000) * MILLISECOND
    held = [line for line in session if begin <= line[0] < begin + length]
    late = [(begin + length + number * 50 * MICROSECOND, frame) for number, (_, frame) in enumerate(held)]
    rest = [line for line in session if not begin <= line[0] < begin + length]
    return sorted(rest + late, key=lambda line: line[0])


def _without_a_part(session: Session, random: Random) -> Session:
    begin = random.randrange(len(session) + 1)
    return session[:begin] + session[begin + random.choice((1, 1, 2, 3, 10, 100)) :]
