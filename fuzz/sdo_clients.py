"""Several clients on one SDO channel (sdo/contention.py): never wrong bytes as success, never "confirmed" for what is not there.

    python -m fuzz sdo_clients 100000 [SEED]

runs so many random cases, tells each false word with the case that shows it, and how the requests ended. SEED (0 by default) and
the number of a case make that case again. The everyday tests run some (tests/core/test_sdo_contention.py).

The bus is a CAN without losses: one order of frames, queues of any length at each end. One to three clients are ours; a stranger
follows no rule. The oracle is the server's own history: what an object held while a read of it was open, what was written to it
while a write was.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.indices import DEVICE_TYPE
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, Event, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.client import Block, SdoAborted, SdoChunk, SdoClient, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.codec import LEAST_REQUEST, complete, pack_initiate
from canopen_proto.sdo.segmented_client import question_about
from canopen_proto.sdo.server import SdoServer
from tests.core.bus import Wire

MOST_SHOWN: Final = 10
"""False words that are shown with their cases; the rest is counted."""
EACH: Final = 1000
"""Cases between two lines of progress."""

NODE = 5
WRITE_ONLY: Final = 0x2006
SIZES = {0x2000: 1, 0x2001: 4, 0x2002: 8, 0x2003: 8, 0x2004: 40, 0x2005: 300, WRITE_ONLY: 2}
"""The objects and their bytes: expedited, two segments, and more than a sub-block of the smallest size; and one that
is read, though it cannot be."""


class History:
    """A store that remembers what each object held, and since when."""

    def __init__(self) -> None:
        self.held: dict[int, list[tuple[Time, bytes]]] = {index: [(0, bytes(size))] for index, size in SIZES.items()}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        if index == WRITE_ONLY:
            return AbortCode.WRITE_ONLY
        return self.held[index][-1][1] if index in self.held else AbortCode.NO_SUCH_OBJECT

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return None if index in self.held else AbortCode.NO_SUCH_OBJECT

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        if index in self.held:
            self.held[index].append((now, bytes(data)))
            return None
        return AbortCode.NO_SUCH_OBJECT

    def between(self, index: int, start: Time, end: Time) -> set[bytes]:
        """All values that the object had from start to end."""
        entries = self.held[index]
        ends = [time for time, _ in entries[1:]] + [NEVER]
        return {value for (since, value), until in zip(entries, ends, strict=True) if since <= end and until >= start}

    def was_written(self, index: int, data: bytes, start: Time, end: Time) -> bool:
        return any(start <= time <= end and value == data for time, value in self.held[index][1:])


class Firmware(SdoServer):
    """A server as much firmware has it: during a segmented transfer it hears no initiate request, of whomever.

    is_loud: it answers these with an abort, 0x05040001, that names them.
    """

    is_loud = False

    def receive(self, frame: Frame, now: Time) -> None:
        data = complete(frame.data, LEAST_REQUEST)
        if data is not None and self.busy and data[0] >> 5 in (1, 2) and not (self._transfer and self._transfer.in_blocks):
            if self.is_loud:
                self.send(pack_initiate(0x80, data[1] | data[2] << 8, data[3], AbortCode.INVALID_COMMAND))
            return
        super().receive(frame, now)


class LoudFirmware(Firmware):
    is_loud = True


SERVERS: dict[str, type[SdoServer]] = {"restarts": SdoServer, "is deaf in a transfer": Firmware, "aborts intruders": LoudFirmware}


class Script(Machine):
    """A stranger that follows no rule: it sends what it was told, when it was told, and listens to nobody."""

    def __init__(self, out: Outbox, frames: list[tuple[Time, bytes]]) -> None:
        super().__init__(out)
        self._frames = sorted(frames, key=lambda each: each[0])
        self.deadline = self._frames[0][0] if self._frames else NEVER

    def handle_timeout(self, now: Time) -> None:
        while self._frames and self._frames[0][0] <= now:
            self.out.frames.append(Frame(0x600 + NODE, self._frames.pop(0)[1]))
        self.deadline = self._frames[0][0] if self._frames else NEVER


@dataclass(frozen=True)
class Asked:
    """One request of one of our clients. timeout: its own, or None."""

    client: int
    at: Time
    index: int
    is_write: bool
    block: Block
    urgent: bool
    stream: bool = False
    timeout: Time | None = None


@dataclass(frozen=True)
class Case:
    """All that happens on a bus. seed, slowest: of its delays. kind: of the server. script: when the stranger sends what."""

    seed: int
    slowest: Time
    kind: str
    asked: list[Asked]
    script: list[tuple[Time, bytes]]


def content(index: int, salt: int) -> bytes:
    """What request number `salt` writes: different bytes each time."""
    return bytes((salt * 17 + place * 31 + index) & 0xFF for place in range(SIZES[index]))


def run(case: Case, told: Counter[str] | None = None) -> list[str]:
    """Let them all go, and return what is wrong. told: counts how the requests ended."""
    kind, asked, script = case.kind, case.asked, case.script
    bus, history = Wire(case.seed, delay=(0, case.slowest)), History()
    bus.attach(SERVERS[kind](Outbox(), NODE, history))
    clients = [bus.attach(SdoClient(Outbox(), NODE)) for _ in range(1 + max(each.client for each in asked))]
    bus.attach(Script(Outbox(), script))
    for number, client in enumerate(clients):
        client.out.root.request_id = number * 1000  # so that an outcome tells whose it is
    opened: dict[RequestId, tuple[Asked, Time, int]] = {}
    ends: Counter[RequestId] = Counter()
    wrong: list[str] = []
    pieces: dict[RequestId, bytes] = {}

    def judge(event: Event) -> None:
        if isinstance(event, SdoChunk):
            pieces[event.request_id] = pieces.get(event.request_id, b"") + event.data
            clients[event.request_id // 1000].proceed(event.request_id, bus.now)
        if not isinstance(event, Outcome):
            return
        request, since, salt = opened[event.request_id]
        ends[event.request_id] += 1
        if told is not None:
            told[event.origin.name if isinstance(event, SdoAborted) else type(event).__name__] += 1
        if isinstance(event, SdoUploaded | SdoStreamUploaded):
            data = event.data if isinstance(event, SdoUploaded) else pieces.get(event.request_id, b"")
            if data not in history.between(request.index, since, bus.now):
                wrong.append(f"read {data.hex()} as success: {request}")
        elif isinstance(event, SdoDownloaded):
            if not history.was_written(request.index, content(request.index, salt), since, bus.now):
                wrong.append(f"confirmed what was not written: {request}")
        elif isinstance(event, SdoAborted):
            is_right = event.abort_code == AbortCode.WRITE_ONLY and request.index == WRITE_ONLY and not request.is_write
            if event.origin is AbortOrigin.PEER and not (is_right or event.not_confirmed):
                wrong.append(f"refused, though the server has it and takes it: {event}, {request}")
            is_there = request.is_write and history.was_written(request.index, content(request.index, salt), since, bus.now)
            if is_there and not event.not_confirmed:
                wrong.append(f"not a word that it may have been written: {event}, {request}")
            if event.origin is AbortOrigin.CONTESTED and not event.others_doing:
                wrong.append(f"nobody is named: {event}")

    bus.on_event = judge
    for salt, each in enumerate(sorted(asked, key=lambda each: each.at)):
        bus.run(each.at - bus.now)
        client, data = clients[each.client], content(each.index, salt)
        if each.is_write:
            request_id = client.download(each.index, 0, data, bus.now, urgent=each.urgent, block=each.block, timeout=each.timeout)
        elif each.stream:
            request_id = client.upload_stream(each.index, 0, bus.now, urgent=each.urgent)
        else:
            request_id = client.upload(each.index, 0, bus.now, urgent=each.urgent, block=each.block, timeout=each.timeout)
        opened[request_id] = each, bus.now, salt
    bus.settle(120 * SECOND)
    wrong += [f"{ends[request_id]} outcomes: {each}" for request_id, (each, _, _) in opened.items() if ends[request_id] != 1]
    return wrong


BLOCKS: Final[tuple[Block, ...]] = (False, False, True, "auto")
DELAYS: Final = (0, 60 * MICROSECOND, MILLISECOND, 8 * MILLISECOND)
TIMEOUTS: Final = (None, None, 100 * MILLISECOND, 2 * SECOND)  # all longer than any queue of these delays
GAPS: Final = (50 * MICROSECOND, 400 * MICROSECOND, 5 * MILLISECOND, 150 * MILLISECOND)


SPANS: Final = (3 * MILLISECOND, 800 * MILLISECOND)
CLOSE_SPANS: Final = (3, 100 * MICROSECOND, 3 * MILLISECOND, 40 * MILLISECOND)


def case_of(source: Random, kind: str) -> Case:
    """Draw a case: half of them of anything; half of them close: one or two objects of one frame, within so little time that all
    requests stand in queues together, mostly writes, many of them urgent."""
    is_close = source.randint(0, 1) == 1
    objects = list(SIZES)
    if is_close:
        objects = [WRITE_ONLY] if source.randint(0, 3) == 0 else objects[: source.randint(1, 2)]
    spans = CLOSE_SPANS if is_close else SPANS
    slowest = source.choice(DELAYS)
    count = source.randint(1, 3)
    asked = [_asked(source, count, objects, spans, is_close) for _ in range(source.randint(1, 6))]
    script = [frame for _ in range(source.randint(0, 4)) for frame in _exchange(source, objects, spans)]
    return Case(source.getrandbits(32), slowest, kind, asked, script)


def _time(source: Random, spans: Sequence[Time]) -> Time:
    return source.randint(0, source.choice(spans))


def _asked(source: Random, clients: int, objects: list[int], spans: Sequence[Time], is_close: bool) -> Asked:
    index = source.choice(objects)
    is_write = source.random() < (0.75 if is_close else 0.5)
    stream = not is_write and source.randint(0, 5) == 0
    return Asked(
        client=source.randint(0, clients - 1),
        at=_time(source, spans),
        index=index,
        is_write=is_write,
        block=source.choice(BLOCKS),
        urgent=source.randint(0, 1 if is_close else 3) == 0,
        stream=stream,
        timeout=source.choice(TIMEOUTS),
    )


def _exchange(source: Random, objects: list[int], spans: Sequence[Time]) -> list[tuple[Time, bytes]]:
    """Frames of a stranger: an exchange without regard to the answers, or its beginning, or anything at all."""
    at, index, gap = _time(source, spans), source.choice(objects), source.choice(GAPS)
    name = bytes((index & 0xFF, index >> 8, 0))
    size = SIZES[index].to_bytes(4, "little")
    fill = source.randbytes(7)
    exchanges = (
        [b"\x40" + name + bytes(4), b"\x60" + bytes(7), b"\x70" + bytes(7)],
        [b"\x21" + name + size, b"\x00" + fill, b"\x1d" + fill],
        [b"\x23" + name + fill[:4]],
        [question_about(DEVICE_TYPE)],  # our own question before a write: its answer may be taken for ours
        [b"\xa4" + name + b"\x02\0\0\0", b"\xa3" + bytes(7), b"\xa2\x02\x02" + bytes(5), b"\xa1" + bytes(7)],
        [b"\xc6" + name + size, b"\x01" + fill, b"\x82" + fill, b"\xc1" + fill],
        [b"\x80" + name + b"\0\0\x04\x05"],
        [source.randbytes(8) for _ in range(source.randint(1, 4))],
    )
    whole = source.choice(exchanges)
    return [(at + number * gap, data) for number, data in enumerate(whole[: source.randint(1, len(whole))])]


def many(count: int, seed: str) -> int:
    """Run so many cases and tell of them. The exit status: 1 if there was a false word."""
    told: Counter[str] = Counter()
    false = 0
    kinds = list(SERVERS)
    begun = time.process_time()
    for number in range(count):
        case = case_of(Random(f"{seed}/{number}"), kinds[number % len(kinds)])
        for word in run(case, told):
            false += 1
            if false <= MOST_SHOWN:
                print(f"seed {seed}, case {number}: {word}\n    {case}")
        if (number + 1) % EACH == 0 or number + 1 == count:
            used = time.process_time() - begun
            print(f"{number + 1} cases, {false} false words, {used * 1000 / (number + 1):.1f} s CPU per 1,000", flush=True)
    print("outcomes: " + ", ".join(f"{name} {times}" for name, times in told.most_common()))
    return 1 if false else 0
