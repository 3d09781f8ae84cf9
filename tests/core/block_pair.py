"""An SDO client and an SDO server on a bus, for tests of block transfer: one DOMAIN, and somebody who writes everything down."""

from __future__ import annotations

from typing import Any, Final

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, NEVER, Event, Outbox, Outcome, Time
from canopen_proto.sdo.access import PENDING, Pending
from canopen_proto.sdo.block import SUB_BLOCK_SIZE
from canopen_proto.sdo.client import SdoChunk, SdoClient, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.server import ObjectAccessPending, SdoServer
from tests.core.bus import Bus
from tests.core.machines import held_data

INDEX: Final = 0x2000
BY_HOST: Final = 0x2001
"""The same object, served by the host in pieces."""
MAX_DELAY: Final = 5 * MILLISECOND
LARGEST: Final = 4000


def pattern(size: int, seed: int = 1) -> bytes:
    """Bytes of which no two segments are alike (and the first is not 0)."""
    return bytes((number * 31 + number // 7 * 5 + number // 1777 + seed) % 255 + 1 for number in range(size))


class Store:
    """One object of any length."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.written: list[bytes] = []
        self.others: list[int] = []  # what else somebody wanted to write: a segment that is taken for a request

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        return PENDING if index == BY_HOST else self.content if index == INDEX else AbortCode.NO_SUCH_OBJECT

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        return PENDING if index == BY_HOST else None if index == INDEX else AbortCode.NO_SUCH_OBJECT

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index == BY_HOST:
            return PENDING
        if index != INDEX:
            self.others.append(index)
            return AbortCode.NO_SUCH_OBJECT
        self.written.append(data)
        return None


class BlockPair:
    """client: keyword arguments for the SdoClient, server: for the SdoServer."""

    def __init__(
        self,
        bus: Bus | None = None,
        content: bytes = b"",
        *,
        client: dict[str, Any] | None = None,
        server: dict[str, Any] | None = None,
        host_piece: int = 1000,
    ) -> None:
        self.bus = Bus() if bus is None else bus
        self.store = Store(content)
        self.client = self.bus.attach(SdoClient(Outbox(), 12, **{"max_upload": LARGEST, **(client or {})}))
        self.server = self.bus.attach(SdoServer(Outbox(), 12, self.store, **{"max_download": LARGEST, **(server or {})}))
        self.bus.on_event = self.on_event
        self.outcomes: list[Outcome] = []
        self.host_piece = host_piece
        self.host_size: int | None = None  # what the host announces of an upload in pieces
        self.taken = b""  # by the host
        self.chunks = b""  # of an upload stream
        self.to_feed: bytes | None = None  # to a download stream
        self.feed_size = 1024

    def on_event(self, report: Event) -> None:
        now = self.bus.now
        bound = max(self.client.max_upload, self.server.max_download) + SUB_BLOCK_SIZE + 7
        for transfer in (self.client._transfer, self.server._transfer):
            assert held_data(transfer) <= bound
        if isinstance(report, Outcome):
            self.outcomes.append(report)
        elif isinstance(report, ObjectAccessPending):
            self.serve(report, now)
        elif isinstance(report, SdoChunk):
            assert report.offset == len(self.chunks)
            self.chunks += report.data
            self.client.proceed(report.request_id, now)
        elif isinstance(report, SdoDataWanted):
            self.feed(report.request_id)

    def feed(self, request_id: int) -> None:
        assert self.to_feed is not None
        piece, self.to_feed = self.to_feed[: self.feed_size], self.to_feed[self.feed_size :]
        self.client.feed(request_id, piece, self.bus.now, last=not self.to_feed)

    def serve(self, report: ObjectAccessPending, now: Time) -> None:
        if report.data is None:
            end = report.offset + self.host_piece
            piece, more = self.store.content[report.offset : end], end < len(self.store.content)
            self.server.complete(report.access_id, piece, now, more=more, size=self.host_size)
            return
        if report.offset == 0:
            self.taken = b""
        assert report.offset == len(self.taken)
        self.taken += report.data
        if self.server.complete(report.access_id, None, now) and not report.more:
            self.store.written.append(self.taken)

    def upload(self, block: Any = True, index: int = INDEX) -> int:
        return self.client.upload(index, 0, self.bus.now, block=block)

    def download(self, content: bytes, block: Any = True, index: int = INDEX) -> int:
        return self.client.download(index, 0, content, self.bus.now, block=block)

    def settle(self) -> Outcome:
        """Run to the end; the last outcome."""
        self.bus.settle()
        assert not self.client.busy
        assert not self.server.busy
        assert self.client.deadline == self.server.deadline == NEVER
        assert self.client._transfer is None
        assert self.server._transfer is None
        return self.outcomes[-1]

    def is_right(self, sent: bytes) -> bool:
        """Whether the last outcome is a success. Fails where it is one, and the bytes are not those."""
        (outcome,) = self.outcomes
        if isinstance(outcome, SdoUploaded):
            assert outcome.data == sent
        elif isinstance(outcome, SdoStreamUploaded):
            assert self.chunks == sent
            assert outcome.size == len(sent)
        elif isinstance(outcome, SdoDownloaded):
            assert self.store.written[-1] == sent
        else:
            return False
        return True
