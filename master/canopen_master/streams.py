"""Reads and writes large objects (firmware images, recordings) piece by piece, so that none is held whole.

Both ways use SDO block transfer. With block = "auto", the default, they fall back on a normal transfer if the server has no
blocks; that transfer has to hold the whole object, at most MAX_WHOLE bytes. block = True never falls back, block = False does not
try blocks.

A transfer that is left early (an exception, a cancelled task, `break`) is aborted on the wire, and the next request to the node
works at once. A device that obeys does not execute such a write. The pieces of such a read are not valid: the checksum comes
last.

    async for piece in node.read_stream(0x1F50, 1):
        file.write(piece)
    with open("image.bin", "rb") as file:
        await node.write_stream(0x1F50, 1, iter(lambda: file.read(4096), b""), size=os.path.getsize("image.bin"))
"""

from __future__ import annotations

from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator
from contextlib import suppress
from types import TracebackType
from typing import Final, TypeAlias

from canopen_master.participant.peer import Peer
from canopen_master.participant.requests import OpenRequest
from canopen_proto.machine import LocalProtocolError, Outcome
from canopen_proto.sdo.block_client import lacks_blocks
from canopen_proto.sdo.client import AUTO_BLOCK, MAX_UPLOAD, Block
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.transfer import Buffer
from canopen_transports.loop import LoopToken, current_loop, protected

MAX_WHOLE: Final = MAX_UPLOAD
"""The most bytes held for a server without block transfer: as many as the SDO client takes in one upload."""

Pieces: TypeAlias = Iterable[Buffer] | AsyncIterable[Buffer]
"""The content to write: pieces of any size."""


class ReadStream:
    """Gives the pieces of an object as they come, 1 to 889 bytes each: `async for`, once. Made by Node.read_stream.

    Raises as Node.read_bytes; pieces that came before an error are not valid. size: bytes so far. `async with` closes the stream
    at once if the loop is left early; otherwise it is closed once it is no longer referenced.
    """

    def __init__(self, node: Peer, index: int, subindex: int, block: Block) -> None:
        self.size = 0
        self._loop = current_loop()
        self._node = node
        self._place = index, subindex
        self._block = block
        self._request: OpenRequest | None = None
        self._token: LoopToken | None = None
        self._is_over = False

    def __aiter__(self) -> ReadStream:
        return self

    @protected
    async def __anext__(self) -> bytes:
        if self._is_over:
            raise StopAsyncIteration
        try:
            piece = await self._next()
        except BaseException:
            self._close()
            raise
        if piece is None:
            self._close()
            raise StopAsyncIteration
        self.size += len(piece)
        return piece

    async def aclose(self) -> None:
        """Close the stream. A transfer under way is aborted on the wire."""
        self._close()
        await self._loop.checkpoint()

    async def __aenter__(self) -> ReadStream:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._close()

    def __del__(self) -> None:
        # Taken back later: Python may run this anywhere, even in the middle of a machine's turn.
        if self._request is not None and self._token is not None:
            with suppress(self._loop.RunFinishedError):
                self._token.run_sync_soon(self._request.take_back)

    def _close(self) -> None:
        self._is_over = True
        request, self._request = self._request, None
        if request is not None:
            request.take_back()

    async def _next(self) -> bytes | None:
        node, client = self._node, self._node.remote.sdo
        if self._request is None:
            if not (client.serves_blocks if self._block == "auto" else self._block):
                return await self._whole()
            self._token = self._loop.token()
            self._request = node.begin(lambda now: client.upload_stream(*self._place, now))
        else:
            client.proceed(self._request.request_id, node.now())
            self._request.pump()
        report = await self._request.news()
        if isinstance(report, SdoChunk):
            return report.data
        outcome = await self._request.outcome()
        if isinstance(outcome, SdoStreamUploaded):
            return None
        assert isinstance(outcome, SdoAborted)
        if self._block != "auto" or self.size or not lacks_blocks(outcome):
            raise node.error_of(outcome, "reading")
        return await self._whole()

    async def _whole(self) -> bytes | None:
        self._is_over = True
        outcome = await self._node.begin(lambda now: self._node.remote.sdo.upload(*self._place, now)).outcome()
        if isinstance(outcome, SdoUploaded):
            return outcome.data or None
        assert isinstance(outcome, SdoAborted)
        raise self._node.error_of(outcome, "reading")


async def write_stream(node: Peer, index: int, subindex: int, pieces: Pieces, size: int | None, block: Block) -> None:
    """See Node.write_stream."""
    client = node.remote.sdo
    source = PieceSource(pieces, size)
    if client.serves_blocks and (size is None or size > AUTO_BLOCK) if block == "auto" else block:
        request = node.begin(lambda now: client.download_stream(index, subindex, now, size=size))
        try:
            outcome = await _feed(node, request, source)
        except BaseException:
            request.take_back()
            raise
        if block is True or source.has_begun or not lacks_blocks_of(outcome):
            _check(node, outcome, size_unknown=size is None)
            return
    data = await source.whole()
    _check(node, await node.begin(lambda now: client.download(index, subindex, data, now)).outcome())


def lacks_blocks_of(outcome: Outcome) -> bool:
    """Return whether a stream ended because the server has no block transfer."""
    return isinstance(outcome, SdoAborted) and lacks_blocks(outcome)


def _check(node: Peer, outcome: Outcome, *, size_unknown: bool = False) -> None:
    if not isinstance(outcome, SdoDownloaded):
        assert isinstance(outcome, SdoAborted)
        raise node.error_of(outcome, "writing to", size_unknown=size_unknown)


async def _feed(node: Peer, request: OpenRequest, source: PieceSource) -> Outcome:
    """Feed a download stream from a source until it ends."""
    client, request_id = node.remote.sdo, request.request_id
    rest, fed = memoryview(b""), 0
    report = await request.news()  # the source is not asked before the server has agreed
    while report is not None:
        room = client.room(request_id)
        if not room and fed != source.size:
            report = await request.news()
            continue
        if not rest:
            with request.while_open() as scope:
                piece = await source.next_piece()
            if scope.cancelled_caught:
                break  # the transfer ended while the source was working
            if piece is None:
                client.feed(request_id, b"", node.now(), last=True)
                request.pump()
                break
            rest = memoryview(piece).cast("B")
        part = rest[:room] if room else rest  # without room no more may follow: the client raises
        client.feed(request_id, part, node.now())
        request.pump()
        rest, fed = rest[len(part) :], fed + len(part)
    return await request.outcome()


class PieceSource:
    """The source of the pieces. size: as announced."""

    def __init__(self, pieces: Pieces, size: int | None) -> None:
        self.size = size
        self.has_begun = False
        self._async: AsyncIterator[Buffer] | None = None
        self._plain: Iterator[Buffer] = iter(())
        if isinstance(pieces, bytes | bytearray | memoryview):
            self._plain = iter((pieces,))
        elif isinstance(pieces, AsyncIterable):
            self._async = aiter(pieces)
        else:
            self._plain = iter(pieces)

    async def next_piece(self) -> Buffer | None:
        """Return the next piece; None at the end."""
        self.has_begun = True
        return next(self._plain, None) if self._async is None else await anext(self._async, None)

    async def whole(self) -> bytes:
        """Return all pieces, joined. Raises LocalProtocolError for more than MAX_WHOLE bytes, or a size that was not
        announced."""
        found: list[Buffer] = []
        size = 0
        while (piece := await self.next_piece()) is not None:
            size += memoryview(piece).nbytes
            if size > MAX_WHOLE:
                raise LocalProtocolError(
                    f"more than {MAX_WHOLE} bytes to write: without block transfer they would have to be held at once"
                )
            found.append(bytes(piece))
        if self.size is not None and size != self.size:
            raise LocalProtocolError(f"{size} bytes to write, {self.size} announced")
        return b"".join(found)
