"""Procedures that read and write large objects (firmware images, recordings) piece by piece, without holding them whole.

`upload_stream` hands each piece to a function. `download_stream` takes pieces of any size from an iterable, when there is room
for them: at most MAX_FED bytes (64 KiB) and the present piece are held. Both use SDO block transfer. With block = "auto", the
default, they fall back on a normal transfer if the server has no block transfer; a normal transfer holds the whole object
(reading: up to the client's `max_upload`). block = True never falls back, block = False does not try block transfer.

An exception of `take` or of the iterable aborts the transfer on the wire, and is raised as it is.

Source: CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from canopen_proto.machine import LocalProtocolError, Outcome, Time
from canopen_proto.procedures.steps import Procedure, Request, SdoTransferError, download, upload
from canopen_proto.sdo.block_client import lacks_blocks
from canopen_proto.sdo.client import AUTO_BLOCK, Block, SdoClient
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoProgress, SdoStreamUploaded
from canopen_proto.sdo.transfer import Buffer


def upload_stream(
    client: SdoClient, index: int, subindex: int, take: Callable[[bytes], object], *, block: Block = "auto"
) -> Procedure[int]:
    """Read an object piece by piece: call `take(piece)` for each, in order. Return their total size in bytes.

    Do not trust the pieces before it has returned: the checksum comes last. Raises SdoTransferError. block: see this module's
    text.
    """
    pieces = 0

    def on_news(report: SdoProgress, now: Time) -> None:
        nonlocal pieces
        if isinstance(report, SdoChunk):
            pieces += 1
            take(report.data)
            client.proceed(report.request_id, now)

    if block is True or (block == "auto" and client.serves_blocks):
        outcome: Outcome = yield Request(
            client, lambda now, urgent: client.upload_stream(index, subindex, now, urgent=urgent), on_news
        )
        if isinstance(outcome, SdoStreamUploaded):
            return outcome.size
        assert isinstance(outcome, SdoAborted)
        if block is True or pieces or not lacks_blocks(outcome):
            raise SdoTransferError(outcome, "reading")
    data = yield from upload(client, index, subindex)
    take(data)
    return len(data)


def download_stream(
    client: SdoClient,
    index: int,
    subindex: int,
    pieces: Iterable[Buffer] | Buffer,
    size: int | None = None,
    *,
    block: Block = "auto",
) -> Procedure[None]:
    """Write an object from pieces of any size; return when the node has confirmed the whole.

    size: of the whole in bytes, if known; servers may insist on it. Raises SdoTransferError; LocalProtocolError if the pieces
    have more or fewer bytes. block: see this module's text.
    """
    feeder = Feeder(client, pieces, size)
    goes_in_blocks = client.serves_blocks and (size is None or size > AUTO_BLOCK) if block == "auto" else block
    if goes_in_blocks:
        outcome: Outcome = yield Request(
            client,
            lambda now, urgent: client.download_stream(index, subindex, now, size=size, urgent=urgent),
            lambda report, now: feeder.supply(report, now) if isinstance(report, SdoDataWanted) else None,
        )
        if isinstance(outcome, SdoDownloaded):
            return
        assert isinstance(outcome, SdoAborted)
        if block is True or feeder.has_begun or not lacks_blocks(outcome):
            raise SdoTransferError(outcome, "writing")
    yield from download(client, index, subindex, feeder.whole())


class Feeder:
    """Feeds a download stream from pieces of any size."""

    def __init__(self, client: SdoClient, pieces: Iterable[Buffer] | Buffer, size: int | None) -> None:
        self.has_begun = False
        self._client = client
        self._pieces: Iterator[Buffer] = iter((pieces,) if isinstance(pieces, bytes | bytearray | memoryview) else pieces)
        self._size = size
        self._rest = memoryview(b"")  # of the present piece
        self._fed = 0

    def supply(self, wanted: SdoDataWanted, now: Time) -> None:
        """Feed as many bytes as there is room for."""
        self.has_begun = True
        while (room := self._client.room(wanted.request_id)) or self._fed == self._size:  # all is fed: no piece may follow
            if not self._rest:
                piece = next(self._pieces, None)
                if piece is None:
                    self._client.feed(wanted.request_id, b"", now, last=True)
                    return
                self._rest = memoryview(piece).cast("B")
            part = self._rest[:room] if room else self._rest
            self._client.feed(wanted.request_id, part, now)
            self._rest = self._rest[len(part) :]
            self._fed += len(part)

    def whole(self) -> bytes:
        """Return all pieces, joined. Raises LocalProtocolError if they are not as long as announced."""
        data = b"".join(self._pieces)
        if self._size is not None and len(data) != self._size:
            raise LocalProtocolError(f"{len(data)} bytes to write, {self._size} announced")
        return data
