"""The SDO server against a small model, with time as a rule (CiA 301 v4.2.0, 7.2.4).

The model knows what the standard says of a server: one transfer at a time, toggle, sizes, aborts. It never looks into the server.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, SECOND, Event, FrameIgnored, Outbox, Time
from canopen_proto.sdo.server import (
    ACCESS_TIMEOUT,
    PENDING,
    TIMEOUT,
    ObjectAccessPending,
    ObjectWritten,
    Pending,
    SdoServer,
    SdoServerAborted,
)
from tests.core.bus import take_events, take_frames
from tests.examples import examples

BLOB, SHORT, READ_ONLY, BY_HOST, MISSING = 0x2000, 0x2001, 0x2002, 0x2003, 0x2004
INDICES = st.sampled_from([BLOB, SHORT, READ_ONLY, BY_HOST, MISSING])
MAX_DOWNLOAD = 30


class Objects:
    """BLOB is of any length, SHORT of two bytes, READ_ONLY of ten, BY_HOST asks the host."""

    def __init__(self) -> None:
        self.values = {BLOB: b"0123456789", SHORT: b"ab", READ_ONLY: b"read only!"}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        return PENDING if index == BY_HOST else self.values.get(index, AbortCode.NO_SUCH_OBJECT)

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        if index == MISSING:
            return AbortCode.NO_SUCH_OBJECT
        if index == READ_ONLY:
            return AbortCode.READ_ONLY
        return AbortCode.LENGTH_MISMATCH if index == SHORT and size not in (None, 2) else None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        refusal = self.check_write(index, subindex, len(data))
        if refusal is None and index == BY_HOST:
            return PENDING
        if refusal is None:
            self.values[index] = data
        return refusal


@dataclass
class Transfer:
    """What the model knows of a transfer under way."""

    index: int
    upload: bool
    rest: bytes = b""  # still to upload
    received: bytes = b""
    announced: int | None = None
    toggle: int = 0
    last: bytes = b""  # last request
    copies: int = 0  # of it, so far
    access_id: int | None = None  # the host's turn
    held: bytes = b""  # the confirmation that waits for the host
    deadline: Time = field(default=0)


class ServerAgainstModel(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.objects = Objects()
        self.expected = dict(self.objects.values)
        self.out = Outbox()
        self.server = SdoServer(self.out, 12, self.objects, max_download=MAX_DOWNLOAD)
        self.now: Time = 0
        self.transfer: Transfer | None = None
        self.enabled = True
        self.reports: list[Event] = []
        self.stale: list[int] = []  # accesses that nobody waits for any more

    # ---- what the model does and expects ----

    def ask(self, data: bytes) -> list[bytes]:
        self.now += 1000
        self.server.receive(Frame(0x60C, data), self.now)
        return self.take()

    def take(self) -> list[bytes]:
        """What the server sends; what it reports stands in `reports` then."""
        self.reports = take_events(self.out)
        return [bytes.fromhex(text.removeprefix("58C#")) for text in take_frames(self.out)]

    def expect_abort(self, answers: list[bytes], index: int, code: int) -> None:
        self.end()
        assert answers == [b"\x80" + index.to_bytes(2, "little") + b"\x00" + code.to_bytes(4, "little")]
        assert self.reports[-1] == SdoServerAborted(12, index, 0, code, AbortOrigin.LOCAL)

    def expect_ignored(self, answers: list[bytes]) -> None:
        assert answers == []
        assert [type(report) for report in self.reports] == [FrameIgnored]

    def end(self) -> None:
        if self.transfer is not None and self.transfer.access_id is not None:
            self.stale.append(self.transfer.access_id)
        self.transfer = None

    def begin(self, index: int, *, upload: bool, request: bytes) -> Transfer:
        self.transfer = Transfer(index, upload, last=request, deadline=self.now + TIMEOUT)
        return self.transfer

    def initiate(self, request: bytes) -> list[bytes] | None:
        """The answers to an initiate request, which ends a transfer; None if it was a copy of one that the host is serving."""
        old = self.transfer
        answers = self.ask(request)
        if old is not None and old.last == request and old.access_id is not None:
            self.expect_ignored(answers)
            return None
        self.end()
        if old is not None and old.last != request:
            assert self.reports[0] == SdoServerAborted(12, old.index, 0, AbortCode.GENERAL_ERROR, AbortOrigin.REPLACED)
        return answers

    def expect_confirmation(self, index: int, content: bytes, answer: bytes, answers: list[bytes], request: bytes) -> None:
        """A download is complete: written, refused, or handed to the host."""
        refusal = Objects.check_write(self.objects, index, 0, len(content))
        if refusal is not None:
            self.expect_abort(answers, index, refusal)
        elif index == BY_HOST:
            access = self.reports[-1]
            assert isinstance(access, ObjectAccessPending)
            assert (access.index, access.data) == (index, content)
            transfer = self.transfer or self.begin(index, upload=False, request=request)
            transfer.access_id, transfer.held, transfer.last, transfer.copies = access.access_id, answer, request, 0
            transfer.deadline = self.now + ACCESS_TIMEOUT
            assert answers == []
        else:
            assert answers == [answer]
            assert self.reports[-1] == ObjectWritten(12, index, 0)
            self.expected[index] = content
            self.end()

    def expect_upload(self, index: int, content: bytes, answers: list[bytes], request: bytes) -> None:
        head = index.to_bytes(2, "little") + b"\x00"
        if 1 <= len(content) <= 4:
            assert answers == [bytes((0x43 | 4 - len(content) << 2,)) + head + content.ljust(4, b"\x00")]
        else:
            assert answers == [b"\x41" + head + len(content).to_bytes(4, "little")]
            self.begin(index, upload=True, request=request).rest = content

    # ---- rules ----

    @precondition(lambda self: self.enabled)
    @rule(index=INDICES)
    def initiate_upload(self, index: int) -> None:
        request = b"\x40" + index.to_bytes(2, "little") + bytes(5)
        answers = self.initiate(request)
        if answers is None:
            return
        if index == MISSING:
            self.expect_abort(answers, index, AbortCode.NO_SUCH_OBJECT)
        elif index == BY_HOST:
            access = self.reports[-1]
            assert isinstance(access, ObjectAccessPending)
            assert access.data is None
            transfer = self.begin(index, upload=True, request=request)
            transfer.access_id, transfer.deadline = access.access_id, self.now + ACCESS_TIMEOUT
            assert answers == []
        else:
            self.expect_upload(index, self.objects.values[index], answers, request)

    @precondition(lambda self: self.enabled)
    @rule(index=INDICES, content=st.binary(min_size=1, max_size=4))
    def expedited_download(self, index: int, content: bytes) -> None:
        head = index.to_bytes(2, "little") + b"\x00"
        request = bytes((0x23 | 4 - len(content) << 2,)) + head + content.ljust(4, b"\x00")
        answers = self.initiate(request)
        if answers is not None:
            self.expect_confirmation(index, content, b"\x60" + head + bytes(4), answers, request)

    @precondition(lambda self: self.enabled)
    @rule(index=INDICES, announced=st.one_of(st.none(), st.integers(0, MAX_DOWNLOAD + 2)))
    def initiate_segmented_download(self, index: int, announced: int | None) -> None:
        head = index.to_bytes(2, "little") + b"\x00"
        request = (b"\x20" + head + bytes(4)) if announced is None else b"\x21" + head + announced.to_bytes(4, "little")
        answers = self.initiate(request)
        assert answers is not None
        refusal = self.objects.check_write(index, 0, announced)
        if refusal is None and (announced or 0) > MAX_DOWNLOAD:
            refusal = AbortCode.OUT_OF_MEMORY
        if refusal is not None:
            self.expect_abort(answers, index, refusal)
        else:
            assert answers == [b"\x60" + head + bytes(4)]
            self.begin(index, upload=False, request=request).announced = announced

    def in_upload(self) -> bool:
        return self.enabled and self.transfer is not None and self.transfer.upload and self.transfer.access_id is None

    def in_download(self) -> bool:
        return self.enabled and self.transfer is not None and not self.transfer.upload and self.transfer.access_id is None

    @precondition(in_upload)
    @rule()
    def ask_for_the_segment_that_is_due(self) -> None:
        transfer = self.transfer
        assert transfer is not None
        request = bytes((0x60 | transfer.toggle,)) + bytes(7)
        piece, transfer.rest = transfer.rest[:7], transfer.rest[7:]
        last = 0 if transfer.rest else 1
        assert self.ask(request) == [bytes((transfer.toggle | (7 - len(piece)) << 1 | last,)) + piece.ljust(7, b"\x00")]
        transfer.toggle ^= 0x10
        transfer.last, transfer.copies, transfer.deadline = request, 0, self.now + TIMEOUT
        if last:
            self.end()

    @precondition(in_download)
    @rule(piece=st.binary(max_size=7), last=st.booleans())
    def send_the_segment_that_is_due(self, piece: bytes, last: bool) -> None:
        transfer = self.transfer
        assert transfer is not None
        request = bytes((transfer.toggle | (7 - len(piece)) << 1 | last,)) + piece.ljust(7, b"\x00")
        answers = self.ask(request)
        transfer.received += piece
        limit = MAX_DOWNLOAD if transfer.announced is None else transfer.announced
        if len(transfer.received) > limit:
            code = AbortCode.OUT_OF_MEMORY if transfer.announced is None else AbortCode.LENGTH_TOO_HIGH
            self.expect_abort(answers, transfer.index, code)
        elif last and len(transfer.received) < (transfer.announced or 0):
            self.expect_abort(answers, transfer.index, AbortCode.LENGTH_TOO_LOW)
        elif last:
            answer = bytes((0x20 | transfer.toggle,)) + bytes(7)
            self.expect_confirmation(transfer.index, transfer.received, answer, answers, request)
        elif not piece:
            self.expect_abort(answers, transfer.index, AbortCode.INVALID_COMMAND)
        else:
            assert answers == [bytes((0x20 | transfer.toggle,)) + bytes(7)]
            transfer.toggle ^= 0x10
            transfer.last, transfer.copies, transfer.deadline = request, 0, self.now + TIMEOUT

    @precondition(lambda self: self.enabled)
    @rule(command=st.sampled_from([0x00, 0x01, 0x10, 0x11, 0x60, 0x70, 0xA1, 0xC1, 0xE0]), tail=st.binary(min_size=7, max_size=7))
    def send_what_is_not_due(self, command: int, tail: bytes) -> None:
        transfer = self.transfer
        due = None
        if transfer is not None and transfer.access_id is None:
            due = 0x60 if transfer.upload else 0x00
            if command & 0xF0 == due | transfer.toggle:
                return
        request = bytes((command,)) + tail
        if transfer is not None and request == transfer.last:
            return
        toggle_fault = due is not None and command & 0xE0 == due
        code = AbortCode.TOGGLE_NOT_ALTERNATED if toggle_fault else AbortCode.INVALID_COMMAND
        self.expect_abort(self.ask(request), 0 if transfer is None else transfer.index, code)

    @precondition(lambda self: self.enabled and self.transfer is not None and self.transfer.last[0] & 0xE0 in (0x00, 0x60))
    @rule()
    def repeat_the_last_segment(self) -> None:
        transfer = self.transfer
        assert transfer is not None
        transfer.copies += 1
        answers = self.ask(transfer.last)
        if transfer.copies == 1:
            assert answers == []
            assert isinstance(self.reports[-1], FrameIgnored)
        else:
            at_host = transfer.access_id is not None
            code = AbortCode.INVALID_COMMAND if at_host else AbortCode.TOGGLE_NOT_ALTERNATED
            self.expect_abort(answers, transfer.index, code)

    @rule(code=st.integers(0, 0xFFFFFFFF))
    def send_abort(self, code: int) -> None:
        answers = self.ask(b"\x80" + bytes(3) + code.to_bytes(4, "little"))
        assert answers == []
        expected = [] if self.transfer is None else [SdoServerAborted(12, self.transfer.index, 0, code, AbortOrigin.PEER)]
        assert self.reports == expected
        self.end()

    @rule(data=st.binary(max_size=3))
    def send_too_little(self, data: bytes) -> None:
        if self.enabled and (not data or data[0] & 0xE0 in (0x20, 0x40, 0x80)):
            self.expect_ignored(self.ask(data))

    @precondition(lambda self: self.transfer is not None and self.transfer.access_id is not None)
    @rule(result=st.one_of(st.binary(max_size=12), st.just(AbortCode.HARDWARE_ERROR)))
    def host_answers(self, result: bytes | AbortCode) -> None:
        transfer = self.transfer
        assert transfer is not None
        assert transfer.access_id is not None
        self.now += 1000
        read = isinstance(result, bytes) and transfer.upload
        assert self.server.complete(transfer.access_id, result if read or isinstance(result, AbortCode) else None, self.now)
        answers = self.take()
        self.end()
        if isinstance(result, AbortCode):
            self.expect_abort(answers, transfer.index, result)
        elif transfer.upload:
            self.expect_upload(transfer.index, result, answers, transfer.last)
        else:
            assert answers == [transfer.held]
            assert self.reports[-1] == ObjectWritten(12, transfer.index, 0)

    @precondition(lambda self: bool(self.stale))
    @rule()
    def host_answers_too_late(self) -> None:
        assert not self.server.complete(self.stale.pop(), AbortCode.HARDWARE_ERROR, self.now)

    @rule(duration=st.one_of(st.integers(0, 6 * SECOND), st.just(None)))
    def time_passes(self, duration: int | None) -> None:
        """By some time, or exactly to the deadline."""
        transfer = self.transfer
        if duration is None:
            duration = 0 if transfer is None else transfer.deadline - self.now
        self.now += duration
        self.server.handle_timeout(self.now)
        answers = self.take()
        if transfer is None or self.now < transfer.deadline:
            assert answers == []
            return
        code = AbortCode.TOGGLE_NOT_ALTERNATED if transfer.copies else AbortCode.TIMED_OUT
        if transfer.access_id is not None:
            code = AbortCode.CANNOT_TRANSFER
        self.end()
        assert answers == [b"\x80" + transfer.index.to_bytes(2, "little") + b"\x00" + code.to_bytes(4, "little")]
        assert self.reports[-1] == SdoServerAborted(12, transfer.index, 0, code, AbortOrigin.TIMEOUT)

    @rule()
    def nmt_state_changes(self) -> None:
        if self.enabled:
            self.server.disable()
            self.end()
        else:
            self.server.enable()
        self.enabled = not self.enabled
        assert self.take() == []
        assert all(isinstance(report, SdoServerAborted) for report in self.reports)

    @precondition(lambda self: not self.enabled)
    @rule(data=st.binary(max_size=8))
    def nothing_is_answered_while_disabled(self, data: bytes) -> None:
        assert self.ask(data) == []
        assert self.reports == []

    # ---- invariants ----

    @invariant()
    def the_deadline_is_never_if_and_only_if_it_is_idle(self) -> None:
        assert self.server.busy == (self.transfer is not None)
        assert self.server.deadline == (NEVER if self.transfer is None else self.transfer.deadline)

    @invariant()
    def only_complete_values_are_stored(self) -> None:
        assert self.objects.values == self.expected

    @invariant()
    def it_listens_only_while_enabled(self) -> None:
        assert self.server.can_ids() == ((0x60C,) if self.enabled else ())


TestServerAgainstModel = ServerAgainstModel.TestCase
TestServerAgainstModel.settings = examples(150, steps=40)
