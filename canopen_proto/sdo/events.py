"""What SDO clients and servers report. (client.py and server.py hand these names on.)"""

from __future__ import annotations

from canopen_proto.abort import AbortOrigin, text_of
from canopen_proto.machine import Event, Outcome, RequestId, Time
from canopen_proto.sdo.codec import what_was_asked

# ---- a client ----


class SdoUploaded(Outcome):
    """An object was read: its bytes as the server sent them (4 where it sent an expedited value without its size). request_id:
    the one that `upload` returned. data: little-endian."""

    __slots__ = ("data", "index", "subindex")
    __match_args__ = ("node_id", "request_id", "index", "subindex", "data")

    def __init__(self, node_id: int, request_id: RequestId, index: int, subindex: int, data: bytes) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex
        self.data = data


class SdoDownloaded(Outcome):
    """An object was written: the server has confirmed it. request_id: the one that `download` returned."""

    __slots__ = ("index", "subindex")
    __match_args__ = ("node_id", "request_id", "index", "subindex")

    def __init__(self, node_id: int, request_id: RequestId, index: int, subindex: int) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex


class SdoStreamUploaded(Outcome):
    """An object was read piece by piece: the pieces that came as SdoChunk are all, `size` bytes, and right. request_id: the one
    that `upload_stream` returned."""

    __slots__ = ("index", "size", "subindex")
    __match_args__ = ("node_id", "request_id", "index", "subindex", "size")

    def __init__(self, node_id: int, request_id: RequestId, index: int, subindex: int, size: int) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex
        self.size = size


class SdoAborted(Outcome):
    """A transfer ended without success.

    not_confirmed: it was a download, all of its data had been sent, and neither a confirmation nor a refusal has come: it may
    have been executed. (False also where only a part had been sent: the server was told that the rest does not come.)
    waited: where the server fell silent, how long that was, in ns; else 0.
    other: with origin CONTESTED, the last request of the other client, eight bytes; `others_doing` says it in words. Then
    not_confirmed is True for every download that was begun: the other client's frames may have ended it.

    abort_code: 32 bits, the server's or ours. origin: which side ended it. request_id: the one that the request returned.
    """

    __slots__ = ("abort_code", "index", "not_confirmed", "origin", "other", "subindex", "waited")
    __match_args__ = ("node_id", "request_id", "index", "subindex", "abort_code", "origin", "not_confirmed", "waited", "other")

    def __init__(
        self,
        node_id: int,
        request_id: RequestId,
        index: int,
        subindex: int,
        abort_code: int,
        origin: AbortOrigin,
        not_confirmed: bool = False,
        waited: Time = 0,
        other: bytes = b"",
    ) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex
        self.abort_code = abort_code
        self.origin = origin
        self.not_confirmed = not_confirmed
        self.waited = waited
        self.other = other

    @property
    def others_doing(self) -> str:
        """What the other client did, as in "asked for 0x1018:01"; "" if there was none."""
        return what_was_asked(self.other)

    @property
    def text(self) -> str:
        """What the abort code says."""
        return text_of(self.abort_code)


class SdoProgress(Event):
    """Base of what is told of a stream while it is under way. request_id: of its request."""

    __slots__ = ("index", "request_id", "subindex")
    __match_args__ = ("node_id", "request_id", "index", "subindex")

    def __init__(self, node_id: int, request_id: int, index: int, subindex: int) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex


class SdoChunk(SdoProgress):
    """A piece of an upload stream: `data`, 1 to 889 bytes, `offset` bytes behind its beginning. `proceed` asks for the next one.

    It counts only once SdoStreamUploaded has come: the checksum stands at the end of the transfer.

    request_id: the one that `upload_stream` returned.
    """

    __slots__ = ("data", "offset")
    __match_args__ = ("node_id", "request_id", "index", "subindex", "offset", "data")

    def __init__(self, node_id: int, request_id: int, index: int, subindex: int, offset: int, data: bytes) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex
        self.offset = offset
        self.data = data


class SdoDataWanted(SdoProgress):
    """A download stream runs short: `feed` it, with up to `room` bytes. request_id: the one that `download_stream` returned."""

    __slots__ = ("room",)
    __match_args__ = ("node_id", "request_id", "index", "subindex", "room")

    def __init__(self, node_id: int, request_id: int, index: int, subindex: int, room: int) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.index = index
        self.subindex = subindex
        self.room = room


# ---- a server ----


class ObjectAccessPending(Event):
    """The host has to serve an access: data to write, or None to read; it answers by `complete(access_id, ...)`.

    more, offset: of an object that goes in pieces, each with an access_id of its own. To write: more follow, or it is the last
    one, and only then all of them are known to be right. To read: the piece from `offset` on is wanted.
    """

    __slots__ = ("access_id", "data", "index", "more", "offset", "subindex")
    __match_args__ = ("node_id", "access_id", "index", "subindex", "data", "more", "offset")

    def __init__(
        self, node_id: int, access_id: int, index: int, subindex: int, data: bytes | None, more: bool = False, offset: int = 0
    ) -> None:
        self.node_id = node_id
        self.access_id = access_id
        self.index = index
        self.subindex = subindex
        self.data = data
        self.more = more
        self.offset = offset


class ObjectWritten(Event):
    """A client wrote an object; the store has it, and the confirmation is on its way."""

    __slots__ = ("index", "subindex")
    __match_args__ = ("node_id", "index", "subindex")

    def __init__(self, node_id: int, index: int, subindex: int) -> None:
        self.node_id = node_id
        self.index = index
        self.subindex = subindex


class SdoServerAborted(Event):
    """A transfer ended without success. A pending access of it no longer needs an answer. 0x0000:00: there was no transfer.
    abort_code: 32 bits, as it went over the bus. origin: which side ended it."""

    __slots__ = ("abort_code", "index", "origin", "subindex")
    __match_args__ = ("node_id", "index", "subindex", "abort_code", "origin")

    def __init__(self, node_id: int, index: int, subindex: int, abort_code: int, origin: AbortOrigin) -> None:
        self.node_id = node_id
        self.index = index
        self.subindex = subindex
        self.abort_code = abort_code
        self.origin = origin
