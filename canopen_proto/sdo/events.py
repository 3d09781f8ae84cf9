"""What SDO clients and servers report. (client.py and server.py hand these names on.)"""

from __future__ import annotations

from canopen_proto.abort import AbortOrigin, text_of
from canopen_proto.machine import Event, Outcome, Time, event

# ---- a client ----


@event
class SdoUploaded(Outcome):
    """An object was read: its bytes as the server sent them (4 where it sent an expedited value without its size)."""

    index: int
    subindex: int
    data: bytes


@event
class SdoDownloaded(Outcome):
    """An object was written: the server has confirmed it."""

    index: int
    subindex: int


@event
class SdoStreamUploaded(Outcome):
    """An object was read piece by piece: the pieces that came as SdoChunk are all, `size` bytes, and right."""

    index: int
    subindex: int
    size: int


@event
class SdoAborted(Outcome):
    """A transfer ended without success.

    not_confirmed: it was a download, all of its data had been sent, and neither a confirmation nor a refusal has come: it may
    have been executed. (False also where only a part had been sent: the server was told that the rest does not come.)
    waited: where the server fell silent, how long that was, in ns; else 0.
    """

    index: int
    subindex: int
    abort_code: int
    origin: AbortOrigin
    not_confirmed: bool = False
    waited: Time = 0

    @property
    def text(self) -> str:
        """What the abort code says."""
        return text_of(self.abort_code)


@event
class SdoProgress(Event):
    """Base of what is told of a stream while it is under way. request_id: of its request."""

    request_id: int
    index: int
    subindex: int


@event
class SdoChunk(SdoProgress):
    """A piece of an upload stream, 1 to 889 bytes, `offset` bytes behind its beginning. `proceed` asks for the next one.

    It counts only once SdoStreamUploaded has come: the checksum stands at the end of the transfer.
    """

    offset: int
    data: bytes


@event
class SdoDataWanted(SdoProgress):
    """A download stream runs short: `feed` it, with up to `room` bytes."""

    room: int


# ---- a server ----


@event
class ObjectAccessPending(Event):
    """The host has to serve an access: data to write, or None to read; it answers by `complete(access_id, ...)`.

    more, offset: of an object that goes in pieces, each with an access_id of its own. To write: more follow, or it is the last
    one, and only then all of them are known to be right. To read: the piece from `offset` on is wanted.
    """

    access_id: int
    index: int
    subindex: int
    data: bytes | None
    more: bool = False
    offset: int = 0


@event
class ObjectWritten(Event):
    """A client wrote an object; the store has it, and the confirmation is on its way."""

    index: int
    subindex: int


@event
class SdoServerAborted(Event):
    """A transfer ended without success. A pending access of it needs no answer any more. 0x0000:00: there was no transfer."""

    index: int
    subindex: int
    abort_code: int
    origin: AbortOrigin
