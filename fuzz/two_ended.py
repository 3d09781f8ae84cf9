"""An SDO client and an SDO server on a link with chosen faults, and somebody who knows the truth.

The other targets know that nothing may be raised. This one also knows what the object holds, what was written to it, and which
frames the link has lost, copied, held up or damaged. So it can say what must be true of an outcome:

- success means the right bytes, under all that CAN can do; in block transfer with CRC and size also where frames come late, out
  of their order or damaged (docs/limits.md tells what the others cannot promise);
- what was executed is never called refused, and an aborted write is not executed unless it says `not_confirmed`;
- some faults cost nothing: second copies; pauses below the time-out, which cause no frame; in block transfer with CRC and size a
  segment or an acknowledgement that was lost, and a segment that others overtook;
- a segment is never taken for a request;
- everything ends, in bounded time, and the next transfers work.

    bytes 0..9      the plan: see `plan_of`
    each other      how many frames go well (the upper five bits), and what becomes of the next one (the lower three, `FATES`)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, Event, Outbox, Outcome, Time
from canopen_proto.sdo.access import Pending
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, SEGMENT_SIZE
from canopen_proto.sdo.client import AUTO_BLOCK, Block, SdoAborted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.codec import ACKNOWLEDGEMENT, BLOCK_UPLOAD, END, KIND, SEQUENCE, pack_initiate, unpack_initiate
from canopen_proto.sdo.server import SdoServer
from tests.core.block_pair import BY_HOST, INDEX, LARGEST, BlockPair, Store, pattern
from tests.core.bus import Bus, Fate

MOST_STEPS: Final = 30_000
MOST_TIME: Final = 60 * SECOND
"""In virtual time: eight faults cost at most two silences each."""
MOST_FAULTS: Final = 8

FATES: Final = (Fate.DELIVERED, Fate.LOST, Fate.COPIED, Fate.PAUSED, Fate.LATE, Fate.COPIED_LATE, "damaged", "cancel")
"""damaged: one bit of it. cancel: the client gives the transfer up when so many frames have been sent."""

PAUSES: Final = (MILLISECOND, 150 * MILLISECOND, 450 * MILLISECOND, 990 * MILLISECOND, 1500 * MILLISECOND, 5 * SECOND)
LATER: Final = (300 * MICROSECOND, 2 * MILLISECOND, 60 * MILLISECOND, 400 * MILLISECOND)
GUARD: Final = 5 * MILLISECOND
"""The copy_guard, where there is one."""


@dataclass(frozen=True)
class Plan:
    """A transfer and what happens to it. faults: by the place of the frame among all that are sent."""

    is_upload: bool
    block: Block
    is_stream: bool
    size: int
    zeros: int  # at its beginning
    by_host: bool
    tells_size: bool
    client_crc: bool
    server_crc: bool
    client_block_size: int
    server_block_size: int
    max_burst: int
    has_guard: bool
    refuses_blocks: bool
    names_no_object: bool  # in those refusals
    second: int  # another request for the same object waits: 0 none, 1 a plain one, 2 an urgent one, 3 one in blocks
    is_tight: bool  # the receiver takes so many bytes and not one more
    is_too_large: bool  # by one byte, for the receiver
    pause: Time
    late: Time
    bit: int
    faults: dict[int, Fate | str]

    @property
    def in_blocks(self) -> bool:
        is_short = self.block == "auto" and not self.is_upload and self.size <= AUTO_BLOCK
        return self.block is not False and not self.refuses_blocks and not is_short

    @property
    def is_guarded(self) -> bool:
        """Whether CRC and size guard the transfer."""
        return self.in_blocks and self.client_crc and self.server_crc and self.tells_size


def plan_of(data: bytes) -> Plan:
    """The plan that bytes stand for; any bytes stand for some."""
    head, tail = data[:10].ljust(10, b"\0"), data[10:]
    kind, options, more = head[0], head[1], head[2]
    is_stream = kind & 6 == 6
    block: Block = True if is_stream else (False, True, "auto")[kind >> 1 & 3]
    by_host = bool(options & 1) and block is True
    faults: dict[int, Fate | str] = {}
    place = 0
    for step in tail:
        place += step >> 3
        fate = FATES[step & 7]
        if fate is not Fate.DELIVERED and len(faults) < MOST_FAULTS:
            faults[place] = fate
        place += 1
    size = head[3] | (head[4] & 3) << 8
    return Plan(
        is_upload=bool(kind & 1),
        block=block,
        is_stream=is_stream,
        size=size,
        zeros=17 * (head[4] >> 2) if options & 2 else 0,
        by_host=by_host,
        tells_size=bool(options & 4) or not (is_stream or (by_host and kind & 1)),
        client_crc=not options & 8,
        server_crc=not options & 16,
        client_block_size=head[5] % 128,
        server_block_size=head[6] % 128,
        max_burst=(MAX_BLOCK_SIZE, 1, 3, 8)[more & 3],
        has_guard=bool(more & 4),
        refuses_blocks=more & 24 == 24 and block == "auto",
        names_no_object=bool(more & 32),
        second=more >> 6,
        is_tight=bool(options & 0x20),
        is_too_large=options & 0x60 == 0x60 and size > 4 and not is_stream and (not by_host or bool(kind & 1)),
        pause=PAUSES[head[7] % len(PAUSES)],
        late=LATER[head[8] % len(LATER)],
        bit=head[9] % 56,
        faults=faults,
    )


class Link(Bus):
    """The bus between the two, with the faults of a plan."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(pause=plan.pause, late=(plan.late, plan.late))
        self.plan = plan
        self.met: dict[int, Fate | str] = {}  # the faults that came to pass, by the place of the frame
        self.cancel: Callable[[], object] | None = None

    def _schedule(self, frame: Frame, receiver: Outbox) -> None:
        place = len(self.sent) - 1
        fault = self.plan.faults.get(place)
        if fault == "damaged":
            sender = 0x58C if self.plan.is_upload else 0x60C
            if place < 2 or frame.can_id != sender or not self.plan.in_blocks:
                fault = None  # what no CRC guards
            else:
                damaged = int.from_bytes(frame.data, "little") ^ 1 << 8 + self.plan.bit
                frame = Frame(frame.can_id, damaged.to_bytes(8, "little"))
        if fault == "cancel" and self.cancel is not None:
            self.cancel()
        if fault is not None:
            self.met[place] = fault
        self._fates = iter([fault] if isinstance(fault, Fate) else [])
        super()._schedule(frame, receiver)


class Witness(Store):
    """The object; each reading of it has another first byte, so that an old answer is told from a new one."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.given: list[bytes] = []

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        content = super().read(index, subindex, now)
        if isinstance(content, bytes):
            content = content[:-1] + bytes((len(self.given) % 251,)) if content else content
            self.given.append(content)
        return content


class WithoutBlocks(SdoServer):
    """A server that knows no block transfer, as many in the field."""

    names_no_object = False

    def receive(self, frame: Frame, now: Time) -> None:
        command, index, subindex, _ = unpack_initiate(frame.data.ljust(8, b"\0"))
        if command < BLOCK_UPLOAD:
            super().receive(frame, now)
        else:
            mux = (0, 0) if self.names_no_object else (index, subindex)
            self.send(pack_initiate(0x80, *mux, AbortCode.INVALID_COMMAND))


class Scene:
    """A plan that is carried out."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.content = bytes(min(plan.zeros, plan.size)) + pattern(plan.size)[plan.zeros :]
        self.link = Link(plan)
        guard = GUARD if plan.has_guard else 0
        both = {"max_burst": plan.max_burst, "copy_guard": guard}
        limit = plan.size - plan.is_too_large if plan.is_tight else LARGEST
        in_pieces = plan.size // 2 if plan.is_tight and not plan.second else limit  # what goes in pieces is not limited
        client = {"crc": plan.client_crc, "block_size": plan.client_block_size, **both}
        client["max_upload"] = in_pieces if plan.is_stream else limit
        server = {"crc": plan.server_crc, "block_size": plan.server_block_size, **both}
        server["max_download"] = in_pieces if plan.by_host else limit
        self.pair = pair = BlockPair(self.link, self.content, client=client, server=server, host_piece=200)
        self.store = pair.store = Witness(self.content)
        pair.host_size = plan.size if plan.tells_size else None
        if plan.refuses_blocks:
            self.link.detach(pair.server)
            pair.server = self.link.attach(WithoutBlocks(Outbox(), 12, self.store, **server))
            pair.server.names_no_object = plan.names_no_object
        pair.server._door.store = self.store
        self.link.on_event = self._on_event
        self.marks: list[int] = []  # how often the object had been read when each outcome came
        self.first_end = 0  # how many frames had been sent when the first outcome came
        self.requests: list[int] = []
        self._begin()
        self._run(lambda: len(pair.outcomes) == len(self.requests))
        self.frames = [frame for _, frame in self.link.sent]

    def _on_event(self, report: Event) -> None:
        self.pair.on_event(report)
        if isinstance(report, Outcome):
            self.marks.append(len(self.store.given))
            self.first_end = self.first_end or len(self.link.sent)

    def _begin(self) -> None:
        plan, pair, now = self.plan, self.pair, self.link.now
        index = BY_HOST if plan.by_host else INDEX
        client = pair.client
        if plan.is_stream and not plan.is_upload:
            request = client.download_stream(index, 0, now, size=plan.size if plan.tells_size else None)
            pair.to_feed = self.content
            pair.feed(request)
        elif plan.is_stream:
            request = client.upload_stream(index, 0, now)
        elif plan.is_upload:
            request = client.upload(index, 0, now, block=plan.block)
        else:
            request = client.download(index, 0, self.content, now, block=plan.block)
        self.requests.append(request)
        self.link.cancel = lambda: client.cancel(request, self.link.now)
        if plan.second:
            block, is_urgent = plan.second == 3 and not plan.refuses_blocks, plan.second == 2
            if plan.is_upload:
                self.requests.append(client.upload(INDEX, 0, now, urgent=is_urgent, block=block))
            else:
                self.requests.append(client.download(INDEX, 0, self.content, now, urgent=is_urgent, block=block))

    def _run(self, condition: Callable[[], bool]) -> None:
        end = self.link.now + MOST_TIME
        self.link.pump()
        for _ in range(MOST_STEPS):
            if condition():
                return
            assert self.link.step(), "nothing more will happen, and it has not ended"
            assert self.link.now <= end, "it does not end in time"
        raise AssertionError("it does not end")

    # ---- what must be true ----

    def check(self) -> None:
        """Everything."""
        pair, plan = self.pair, self.plan
        assert [outcome.request_id for outcome in pair.outcomes] == self.requests, "in their order, each once"
        first = pair.outcomes[0]
        fates = set(self.link.met.values())
        is_order_kept = not fates & {Fate.LATE, Fate.COPIED_LATE, "damaged"}
        if is_order_kept or (plan.is_guarded and not plan.second):
            self._check_truth(first, self.content)
            is_told_apart = plan.has_guard or not fates or (not plan.is_upload and plan.second != 2)
            if plan.second and is_order_kept and is_told_apart:
                self._check_second(pair.outcomes[1])
        if self._costs_nothing(fates):
            assert isinstance(first, SdoAborted) == plan.is_too_large, first
        if self._shows_damage():
            assert isinstance(first, SdoAborted), first
        if fates == {Fate.PAUSED} and not plan.second and self._survives_pauses():
            assert self.frames == Scene(replace(plan, faults={})).frames, "a pause causes no frame"
        self._check_next()
        assert not is_order_kept or not self.store.others, "a segment is taken for a request"

    def _check_truth(self, outcome: Outcome, content: bytes) -> None:
        written = self.store.written
        assert set(written) <= {content}
        match outcome:
            case SdoUploaded():
                assert outcome.data == content or outcome.data in self.store.given
            case SdoStreamUploaded():
                assert outcome.size == len(content)
                assert self.pair.chunks == content or self.pair.chunks in self.store.given
            case SdoDownloaded():
                assert written
            case SdoAborted():
                assert not self.plan.is_upload or not outcome.not_confirmed
                assert outcome.not_confirmed or not written or self.plan.second, "executed is never called refused"

    def _check_second(self, outcome: Outcome) -> None:
        if set(self.link.met.values()) <= {Fate.COPIED} and not self.plan.is_too_large:
            assert not isinstance(outcome, SdoAborted), outcome
        if isinstance(outcome, SdoUploaded):
            assert outcome.data in self.store.given[self.marks[0] :] or not self.content, "an answer to the request before"
        elif isinstance(outcome, SdoDownloaded):
            assert self.store.written[-1] == self.content

    def _costs_nothing(self, fates: set[Fate | str]) -> bool:
        """Whether the faults are such that the transfer has to succeed all the same."""
        met, plan = self.link.met, self.plan
        if fates <= {Fate.COPIED}:
            if plan.in_blocks:
                return True
            return (len(met) <= 1 and (plan.has_guard or not plan.refuses_blocks)) or (set(met) == {0, 1} and not plan.block)
        if fates == {Fate.PAUSED}:
            return self._survives_pauses()
        if not plan.is_guarded or max(met) >= self.first_end:
            return False
        if fates == {Fate.LATE} and len(met) == 1:
            return self._is_segment(min(met))
        lost = [place for place, fate in met.items() if fate is Fate.LOST]
        if not all(place in lost or self._is_copy_held_off(place) for place in met):
            return False
        return not lost or (
            len(lost) == 1 and (self._is_segment(lost[0]) or (len(met) == 1 and self._is_acknowledgement(lost[0])))
        )

    def _is_copy_held_off(self, place: int) -> bool:
        """Whether it is a copy of an acknowledgement that copy_guard is there for."""
        is_in_time = self.plan.has_guard and self.plan.late < GUARD
        return self.link.met[place] is Fate.COPIED_LATE and is_in_time and self._is_acknowledgement(place)

    def _shows_damage(self) -> bool:
        """Whether all that happened is that the CRC was damaged on its way."""
        if list(self.link.met.values()) != ["damaged"] or not self.plan.is_guarded:
            return False
        (place,) = self.link.met
        return self.frames[place].data[0] & KIND == END and not self._is_segment(place) and self.plan.bit < 16

    def _survives_pauses(self) -> bool:
        limit = SECOND if self.plan.in_blocks and min(self.plan.faults) >= 2 else self.pair.client.timeout
        return len(self.link.met) == 1 and self.plan.pause + 5 * MILLISECOND < limit and max(self.link.met) < self.first_end

    @property
    def _block_size(self) -> int:
        return max(2, self.plan.client_block_size if self.plan.is_upload else self.plan.server_block_size)

    def _is_segment(self, place: int) -> bool:
        frame, sender = self.frames[place], 0x58C if self.plan.is_upload else 0x60C
        return place >= 2 and frame.can_id == sender and 1 <= frame.data[0] & SEQUENCE <= min(self._block_size, 64)

    def _is_acknowledgement(self, place: int) -> bool:
        """An acknowledgement that is not followed by a single segment: that one may have been lost just as well."""
        frame, receiver = self.frames[place], 0x60C if self.plan.is_upload else 0x58C
        if frame.can_id != receiver or frame.data[0] != ACKNOWLEDGEMENT:
            return False
        done = sum(
            each.data[1] for each in self.frames[: place + 1] if each.can_id == receiver and each.data[0] == ACKNOWLEDGEMENT
        )
        return not 0 < self.plan.size - done * SEGMENT_SIZE <= SEGMENT_SIZE

    def _check_next(self) -> None:
        """Reading and writing, plain and in blocks; at once, but for frames that are still on their way."""
        pair = self.pair
        pair.client.max_upload = pair.server.max_download = LARGEST
        self.link.cancel = None
        self.link.plan = replace(self.plan, faults={})
        if set(self.link.met.values()) <= {Fate.LOST, Fate.COPIED, Fate.COPIED_LATE, "cancel"}:
            self.link.run(self.plan.late + GUARD)
        else:
            self._settle()
        for block in (False, "auto"):
            pair.outcomes.clear()
            self.store.written.clear()
            read, write = pair.upload(block), pair.download(b"something else", block)
            self._run(lambda: len(pair.outcomes) == 2)
            first, last = pair.outcomes
            assert isinstance(first, SdoUploaded)
            assert first == SdoUploaded(12, read, INDEX, 0, self.store.given[-1])
            assert last == SdoDownloaded(12, write, INDEX, 0)
            assert self.store.written == [b"something else"]
            self._settle()

    def _settle(self) -> None:
        end = self.link.now + MOST_TIME
        for _ in range(MOST_STEPS):
            if not self.link.step():
                break
            assert self.link.now <= end, "it does not settle in time"
        pair = self.pair
        assert not pair.client.busy
        assert not pair.server.busy
        assert pair.client.deadline == pair.server.deadline == NEVER


def sdo_pair(data: bytes) -> None:
    """A transfer between our own client and our own server."""
    Scene(plan_of(data)).check()
