"""Other clients on an SDO channel: what they ask for, and what their requests and our own may be confused with.

A channel belongs to one client (CiA 301 v4.2.0, 7.2.4.1); who shares it breaks the rule, and many do: a service tool beside a
master, two programs on one computer. A server cannot tell them apart. An initiate request of one ends the transfer of another, or
is not heeded; the segments of one are answered to all. So an SdoClient hears the requests on its own channel too: a participant
does not receive its own frames, so each request that comes is a stranger's.

CAN has one order of frames for all, but a client does not learn where its own frames stand in it: a stranger's request that comes
after ours was queued may have gone before it. All that is decided here is right in both cases.

`OtherClient` follows what strangers have under way, as far as requests and answers tell. An exchange is over with its last answer
or an abort. It also counts as over if nothing was heard of it for a while: the time-out (1 s in block transfer, whose sides may
pause) if the server has to answer, PAUSE if it is the stranger's turn. Where exchanges overlap, the answers about each object are
counted: a stranger that goes on asking for one object holds nobody off for longer than the answers that are due.

`Contested` stands for a request whose initiate answer is due while a stranger asks for another object. An expedited answer names
its object, so it is still taken; so is the server's refusal, if it names the object and is not about the protocol. Everything
else is in doubt, and ends the attempt. A stranger that only reads the object of our write leaves the confirmation sure as well:
the server says 0x60 to writes alone. Then a refusal is in doubt, since it may be that of the read.
"""

from __future__ import annotations

from typing import ClassVar, Final

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.sdo.block import silence_limit
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    END,
    END_RESPONSE,
    EXPEDITED_BIT,
    INITIATE_UPLOAD_RESPONSE,
    INITIATES,
    KIND,
    LAST,
    REQUESTS,
    RESPONSES,
    SPECIFIER,
    TOGGLE,
    SdoFrame,
    is_initiate,
)
from canopen_proto.sdo.transfer import INITIATED, Buffer, Transfer

PAUSE: Final = 200 * MILLISECOND
"""How long another client may take for its next request within a transfer: programs with a window to draw need 20 ms and more."""
SPREAD: Final = 16 * MILLISECOND
"""Two clients that have disturbed each other go on up to so much apart: longer than a frame waits in a queue, so that one of them
hears the other."""
SERVICE_ERROR: Final = 0x05
"""The highest byte of abort codes about the protocol itself (CiA 301 v4.2.0, table 22): they may be a stranger's doing."""
MAX_NAMES: Final = 16
"""Objects of strangers' open requests that are remembered; with more of them nothing is certain."""
_ONE_FRAME: Final = (SdoFrame.DOWNLOAD, SdoFrame.UPLOAD)
"""The initiate frames of transfers that may be over with their answer: expedited ones."""
_ENDING: Final = (*_ONE_FRAME, SdoFrame.DOWNLOAD_SEGMENT, SdoFrame.UPLOAD_SEGMENT)
_NOTHING: Final = bytes((ABORT,)).ljust(8, b"\x00")
"""A request that needs no answer."""


class OtherClient:
    """What strangers have under way on the channel; see this module's text.

    last: the request that is to be answered, or was the last one in a transfer under way; empty if none is. in_blocks: it may be
    a block transfer. until: when it counts as over if nothing else comes. heard: the last request that came, for errors, and
    heard_at its time. count: of all requests that came. unfinished: the names of objects whose exchange fell silent: the server
    may still say something about them.
    """

    __slots__ = (
        "_is_ambiguous", "_is_twofold", "_names", "_open", "_written", "count", "heard", "heard_at", "in_blocks", "last",
        "unfinished", "until",
    )  # fmt: skip

    def __init__(self) -> None:
        self.count = 0
        self.heard = b""
        self.heard_at: Time = -NEVER
        self.unfinished: set[bytes] = set()
        self.close()

    def expire(self) -> None:
        """Nothing was heard of the exchange for as long as it is waited for."""
        self.unfinished = self._names
        self.close()

    def close(self) -> None:
        """The exchange is over."""
        self.last = b""
        self.in_blocks = False
        self.until: Time = -NEVER
        self._names: set[bytes] = set()  # of the objects whose answers may still come
        self._written: set[bytes] = set()  # those of them whose answer may be that to a write
        self._open: dict[bytes, int] = {}  # how many answers about each of them are still to come
        self._is_twofold = False  # the last request names an object that another open one names
        self._is_ambiguous = False  # several exchanges overlap: no answer is the last one for certain

    def expect(self, name: bytes) -> None:
        """The answer to a request of ours that has ended is still to come: another request for that object is not alone."""
        self._is_ambiguous |= bool(self._names)
        self._names.add(name)
        self._written.add(name)
        self._open[name] = self._open.get(name, 0) + 1

    def on_request(self, data: bytes, ours: Transfer | None, timeout: Time, now: Time) -> None:
        """Take a stranger's request. ours: our own transfer that is under way. data: eight bytes. timeout: ns, after which it
        counts as over."""
        command = data[0]
        self.count += 1
        self.heard, self.heard_at = data, now
        if self.in_blocks and self.last[0] & SPECIFIER == BLOCK_DOWNLOAD and command != ABORT and command & KIND != END:
            self.until = now + silence_limit(timeout)  # a segment, it seems
            if is_initiate(command):  # or a request of yet another client, whose answer comes behind that to the block transfer
                self._note(data, ours)
                self._is_twofold = True
            return
        if is_initiate(command):
            self._note(data, ours)
        self.last = data
        self.in_blocks = command & SPECIFIER in (BLOCK_UPLOAD, BLOCK_DOWNLOAD)
        if command != ABORT and command != END_RESPONSE:
            self.until = now + (silence_limit(timeout) if self.in_blocks else timeout)
        elif ours is not None or self._is_ambiguous:
            self.until = max(self.until, now + PAUSE)  # no answer is due to this one, but perhaps to another
        else:
            self.until = now + SPREAD  # its next request may be right behind

    def _note(self, data: bytes, ours: Transfer | None) -> None:
        """Note the name of an object whose answer may come. data: an initiate request."""
        name = data[1:4]
        self._is_twofold = bool(self._open.get(name)) or (ours is not None and name == ours.name)
        self._is_ambiguous |= bool(self._names) or self._is_twofold
        if len(self._names) <= MAX_NAMES:
            self._names.add(name)
            self._open[name] = self._open.get(name, 0) + 1
            if REQUESTS[data[0]] is not SdoFrame.UPLOAD:
                self._written.add(name)

    def on_answer(self, data: bytes, timeout: Time, now: Time) -> None:
        """Take an answer of the server that is none to us. Does nothing if no stranger has anything under way. data: eight bytes.
        timeout: ns, as of `on_request`."""
        name = data[1:4]
        if self._open.get(name) and not self.in_blocks and RESPONSES[data[0]] in INITIATES:  # an abort may be about an older one
            self._open[name] -= 1
        if not self.last or self.last[0] == ABORT:
            return
        if self._is_last_answer(data) and (not self._is_ambiguous or self._is_idle_after(data)):
            self.close()
        elif self._is_ambiguous:
            self.until = max(self.until, now + PAUSE)
        else:
            self.until = now + (silence_limit(timeout) if self.in_blocks else PAUSE)

    def _is_last_answer(self, data: bytes) -> bool:
        request, command = self.last[0], data[0]
        asked, said = REQUESTS[request], RESPONSES[command]
        is_named = data[1:4] == self.last[1:4]
        is_alike = (request ^ command) & TOGGLE == 0
        if command == ABORT:
            return not self._names or data[1:4] in self._names
        if self.in_blocks:  # the segments of an upload may look like anything else
            return request & KIND == END and command == END_RESPONSE
        if asked is not said or asked not in _ENDING:
            return False
        by_sender = request if asked in (SdoFrame.DOWNLOAD, SdoFrame.DOWNLOAD_SEGMENT) else command
        if asked in _ONE_FRAME:
            return is_named and bool(by_sender & EXPEDITED_BIT)
        return is_alike and bool(by_sender & LAST)

    def _is_idle_after(self, data: bytes) -> bool:
        """Return whether a last answer shows that nothing else is open: a server answers in order, and in one frame only if it is
        in no transfer; so does a refusal that is not about the protocol. Not if two asked for the object."""
        is_plain = data[0] != ABORT or (data[7] != SERVICE_ERROR and data[1:4] == self.last[1:4])
        return is_plain and is_initiate(self.last[0]) and not self._is_twofold

    def leaves_sure(self, transfer: Transfer) -> bool:
        """Return whether an expedited answer to our request cannot be one to a stranger's.

        Both are initiate requests without blocks, they name different objects or are a write of ours and a read, and nothing else
        was sent for ours yet.
        """
        if transfer.state is not INITIATED or REQUESTS[self.last[0]] not in _ONE_FRAME:
            return False
        asked = REQUESTS[transfer.first[0]]
        is_one_frame = asked is SdoFrame.UPLOAD or (asked is SdoFrame.DOWNLOAD and bool(transfer.first[0] & EXPEDITED_BIT))
        names = self._names if asked is SdoFrame.UPLOAD else self._written
        return is_one_frame and transfer.name not in names and len(self._names) <= MAX_NAMES

    def has_asked_for(self, name: bytes) -> bool:
        """Return whether an answer about this object may be one to a stranger."""
        return name in self._names

    def may_answer(self, transfer: Transfer) -> bool:
        """Return whether answers to a stranger may meet this request of ours."""
        is_named = transfer.name in self._names or len(self._names) > MAX_NAMES
        return bool(self.last) and (self.last[0] != ABORT or is_named)

    def goes_first(self, now: Time) -> None:
        """Let a stranger that has waited go on: for so long our next request waits for it."""
        if not self.last:
            self.last, self.until = _NOTHING, now + SPREAD


def spread(now: Time) -> Time:
    """Return a time of 0 ns up to SPREAD that differs from client to client: the clocks of two are never the same to the ns."""
    return (now ^ now >> 7) * 0x9E3779B1 % SPREAD


class Contested(Transfer):
    """A request whose initiate answer is due, while a stranger asks too; see this module's text.

    request: it. believes: an expedited answer is still taken; else every answer to it is in doubt. is_shared: a stranger asks for
    the same object, by a read, so that a refusal may be the read's.
    """

    __slots__ = ("believes", "is_shared", "request")

    is_contested: ClassVar[bool] = True

    def __init__(self, request: Transfer, believes: bool, is_shared: bool) -> None:
        super().__init__(request.end, request.index, request.subindex, request.first)
        self.request_id = request.request_id
        self.is_urgent = request.is_urgent
        self.deadline, self.own_timeout = request.deadline, request.own_timeout
        self.request = request
        self.believes = believes
        self.is_shared = is_shared

    @property
    def is_all_sent(self) -> bool:
        return self.request.is_all_sent

    @property
    def is_download(self) -> bool:
        return self.request.is_download

    def again(self) -> Transfer | None:
        return self.request.again()

    @property
    def room(self) -> int:
        return self.request.room

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        self.request.feed(piece, last, now)

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        if not self.believes or (command & SPECIFIER == INITIATE_UPLOAD_RESPONSE and not command & EXPEDITED_BIT):
            return False
        is_taken = self.request.receive(command, data, frame, now)
        self.is_answered = self.request.is_answered
        self.state = self.request.state
        return is_taken


def is_own_refusal(transfer: Transfer, data: bytes) -> bool:
    """Return whether an abort of the server is its refusal of our request, and not a stranger's doing. data: of the abort, eight
    bytes."""
    is_believed = isinstance(transfer, Contested) and transfer.believes and not transfer.is_shared
    return is_believed and data[1:4] == transfer.name and data[7] != SERVICE_ERROR


def is_value_for_other(transfer: Transfer, command: int) -> bool:
    """Return whether an answer about our object is the whole value that a stranger has asked for, while we write it."""
    is_value = command & SPECIFIER == INITIATE_UPLOAD_RESPONSE and bool(command & EXPEDITED_BIT)
    return is_value and isinstance(transfer, Contested) and transfer.believes and transfer.is_shared
