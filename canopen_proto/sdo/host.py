"""How a server's transfers reach what the device holds: its store, and the host where the store says PENDING.

An access that only the host can serve is reported as ObjectAccessPending and waits for `SdoServer.complete`; at most one at a
time.

    WriteAccess   HELD   the host has taken what was downloaded: the response that was held goes out -> OVER
"""

from __future__ import annotations

from typing import ClassVar

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.sdo.access import PENDING, ObjectStore, Pending
from canopen_proto.sdo.events import ObjectAccessPending, ObjectWritten
from canopen_proto.sdo.transfer import HELD, OVER, ChannelEnd, Transfer


class Door:
    """The store, and the host behind it; see this module's text.

    access_id: of the access that the host is serving; 0 if none. is_reading: it is to give bytes. handed: bytes that it has
    given, or taken. size: of the whole, as the host says with its first piece. takes_pieces: the download under way goes to the
    host piece by piece.
    """

    __slots__ = ("access_id", "handed", "is_reading", "size", "store", "takes_pieces")

    def __init__(self, store: ObjectStore) -> None:
        self.store = store
        self.close()

    def close(self) -> None:
        """Forget the access: the transfer is over, or there is none yet."""
        self.access_id = 0
        self.is_reading = False
        self.handed = 0
        self.size: int | None = None
        self.takes_pieces = False

    def may_download(self, transfer: Transfer, size: int | None, limit: int) -> bool:
        """Return whether a download may go on; else abort it. size: None if not announced. limit: bytes of what is held whole."""
        refusal = self.store.check_write(transfer.index, transfer.subindex, size)
        self.takes_pieces = isinstance(refusal, Pending)
        self.handed = 0
        if refusal is None and size is not None and size > limit:
            refusal = AbortCode.OUT_OF_MEMORY
        if isinstance(refusal, AbortCode):
            transfer.abort(refusal)
            return False
        return True

    def ask(self, transfer: Transfer) -> None:
        """Ask the host for the object, or for its next piece. Does nothing if it was asked already."""
        if not self.access_id:
            self._report(transfer, None, self.handed > 0, self.handed)
            self.is_reading = True

    def hand_over(self, transfer: Transfer, content: bytes, offset: int, *, more: bool) -> None:
        """Give the host what was downloaded, all of it or a piece. offset: of the piece in the whole, bytes. more: others
        follow."""
        self._report(transfer, content, more, offset)
        self.is_reading = False

    def _report(self, transfer: Transfer, content: bytes | None, more: bool, offset: int) -> None:
        end = transfer.end
        self.access_id = end.out.next_request_id()
        index, subindex = transfer.index, transfer.subindex
        end.out.events.append(ObjectAccessPending(end.node_id, self.access_id, index, subindex, content, more, offset))

    def write(self, transfer: Transfer, content: bytes, offset: int, answer: Frame, now: Time) -> None:
        """Write what was downloaded, whole or as its last piece from `offset` on; send `answer` when it is done."""
        result = PENDING if self.takes_pieces else self.store.write(transfer.index, transfer.subindex, content, now)
        if result is None:
            confirm(transfer, answer)
        else:
            self.defer(transfer, result, content, offset, answer, now)

    def defer(
        self, transfer: Transfer, result: AbortCode | Pending, content: bytes, offset: int, answer: Frame, now: Time
    ) -> None:
        """Do what the store says instead of writing: refuse, or let the host take the content. result: what the store said.
        offset: of the content in the whole. answer: what confirms the download."""
        if isinstance(result, Pending):
            self.hand_over(transfer, content, offset, more=False)
            transfer.instead = WriteAccess(transfer.end, transfer.index, transfer.subindex, transfer.first, answer, now)
            transfer.state = OVER
        else:
            transfer.abort(result)


def confirm(transfer: Transfer, answer: Frame) -> None:
    """End a download: the object was written. answer: the frame that says so."""
    end = transfer.end
    end.out.events.append(ObjectWritten(end.node_id, transfer.index, transfer.subindex))
    end.out.frames.append(answer)
    transfer.state = OVER


class WriteAccess(Transfer):
    """A whole download that waits for the host, which takes or refuses it."""

    __slots__ = ("_answer",)

    is_with_host: ClassVar[bool] = True

    def __init__(self, end: ChannelEnd, index: int, subindex: int, first: bytes, answer: Frame, now: Time) -> None:
        """answer: what confirms the download."""
        super().__init__(end, index, subindex, first)
        self._answer = answer
        self.state = HELD
        self.deadline = now + end.stream_timeout

    def proceed(self, now: Time) -> bool:
        confirm(self, self._answer)
        return True
