"""Procedures that read and write what nobody holds whole."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import SECOND, LocalProtocolError, Outbox, Outcome, Time
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Cancelled, Procedure, Request, SdoTransferError, download, upload
from canopen_proto.procedures.streams import download_stream, upload_stream
from canopen_proto.sdo.block_client import MAX_FED
from canopen_proto.sdo.client import SdoClient
from canopen_proto.sdo.events import SdoAborted
from canopen_proto.sdo.server import SdoServer
from tests.core.block_pair import INDEX, Store, pattern
from tests.core.bus import Bus, Fate
from tests.core.desk import Desk, cancel, cancelled
from tests.examples import examples

NO_BLOCKS = "58C#8000200001000405"


class Pair:
    """A network with an SDO client, whose procedures access the objects of an SDO server."""

    def __init__(self, content: bytes = b"") -> None:
        self.bus = Bus()
        self.store = Store(content)
        self.network = self.bus.attach(Network())
        self.client = SdoClient(self.network.out, 12)
        self.network.attach(self.client)
        self.server = self.bus.attach(SdoServer(Outbox(), 12, self.store, max_download=1 << 21))

    def run(self, procedure: Procedure[Any]) -> Any:
        """Its result; or what it raised."""
        request_id = self.network.run(procedure, self.bus.now)
        self.bus.settle()
        (ended,) = (
            each
            for each in self.bus.events
            if isinstance(each, ProcedureFinished | ProcedureFailed) and each.request_id == request_id
        )
        assert not self.client.busy
        return ended.result if isinstance(ended, ProcedureFinished) else ended.error


def cut(content: bytes, size: int) -> Iterator[bytes]:
    return (content[start : start + size] for start in range(0, len(content), size))


@pytest.mark.parametrize("block", [False, True, "auto"])
@pytest.mark.parametrize("size", [0, 3, 29, 2000])
def test_upload_and_download_take_the_kind_of_transfer(block: Any, size: int) -> None:
    pair = Pair(pattern(size))
    assert pair.run(upload(pair.client, INDEX, block=block)) == pattern(size)
    assert pair.run(download(pair.client, INDEX, 0, pattern(size), block=block)) is None
    assert pair.store.written == [pattern(size)]
    kinds = {frame.split("#")[1][0] for frame in pair.bus.trace() if frame.startswith("60C")}
    assert bool(kinds & {"A", "C"}) == (block is True or (block == "auto"))


@examples(30)
@given(size=st.integers(0, 3000), piece=st.integers(1, 1500), known=st.booleans(), block=st.sampled_from([True, False, "auto"]))
def test_what_goes_in_pieces_of_any_size_arrives(size: int, piece: int, known: bool, block: Any) -> None:
    pair = Pair(pattern(size, 2))
    content = pattern(size)
    procedure = download_stream(pair.client, INDEX, 0, cut(content, piece), size if known else None, block=block)
    assert pair.run(procedure) is None
    assert pair.store.written == [content]
    taken: list[bytes] = []
    assert pair.run(upload_stream(pair.client, INDEX, 0, taken.append, block=block)) == size
    assert b"".join(taken) == pattern(size, 2)


def test_what_is_long_is_never_held() -> None:
    pair = Pair()
    most = 0

    def pieces() -> Iterator[bytes]:
        nonlocal most
        for _ in range(1 << 8):
            transfer = pair.client._transfer
            most = max(most, len(transfer._content))  # type: ignore[union-attr]
            yield bytes(1024)

    assert pair.run(download_stream(pair.client, INDEX, 0, pieces())) is None
    assert pair.store.written == [bytes(1 << 18)]
    assert 0 < most <= MAX_FED


def test_a_piece_may_be_larger_than_what_is_held_and_of_any_kind() -> None:
    pair = Pair()
    content = pattern(3 * MAX_FED)
    pieces = [b"", bytearray(content[:100]), memoryview(content)[100:], b""]
    assert pair.run(download_stream(pair.client, INDEX, 0, pieces, len(content))) is None
    assert pair.store.written == [content]


@pytest.mark.parametrize("block", [False, True, "auto"])
@pytest.mark.parametrize("given", [99, 101, 5000])
def test_another_size_than_announced_aborts(given: int, block: Any) -> None:
    pair = Pair()
    error = pair.run(download_stream(pair.client, INDEX, 0, cut(pattern(given), 64), 100, block=block))
    assert isinstance(error, LocalProtocolError)
    assert pair.store.written == []
    assert block is False or pair.bus.trace()[-1] == "60C#8000200000000008"


def test_one_piece_may_be_given_as_it_is() -> None:
    pair = Pair()
    for block in (True, False):
        assert pair.run(download_stream(pair.client, INDEX, 0, pattern(100), block=block)) is None
    assert pair.store.written == [pattern(100)] * 2


def test_our_own_slowness_is_not_called_silence(desk: Desk) -> None:
    request_id = desk.run(iter_request(desk))
    desk.receive("58C#A400200002000000")
    desk.wait(desk.sdo.stream_timeout)
    outcome = desk.result(request_id)
    assert isinstance(outcome, SdoAborted)
    assert "was given up" in str(SdoTransferError(outcome, "writing"))


def test_what_the_producer_raises_aborts_and_is_raised_as_it_is() -> None:
    pair = Pair()

    def pieces() -> Iterator[bytes]:
        yield bytes(5000)
        raise ZeroDivisionError("the file is gone")

    error = pair.run(download_stream(pair.client, INDEX, 0, pieces()))
    assert isinstance(error, ZeroDivisionError)
    assert pair.bus.trace()[-1] == "60C#8000200000000008"
    assert not any(frame.startswith(("60C#C1", "60C#D", "60C#C5")) for frame in pair.bus.trace())
    assert pair.store.written == []
    assert pair.run(download(pair.client, INDEX, 0, b"\x01")) is None


def test_what_the_consumer_raises_aborts_too() -> None:
    pair = Pair(pattern(3000))

    def full(piece: bytes) -> None:
        raise OSError("no room")

    assert isinstance(pair.run(upload_stream(pair.client, INDEX, 0, full)), OSError)
    assert pair.bus.trace()[-1] == "60C#8000200000000008"
    assert pair.run(upload(pair.client, INDEX)) == pattern(3000)


# ---- servers without blocks, faults ----


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_server_without_blocks_is_written_in_segments_and_nothing_is_lost(desk: Desk) -> None:
    request_id = desk.run(download_stream(desk.sdo, 0x2000, 0, iter([b"0123", b"456789"])))
    desk.receive(NO_BLOCKS)
    desk.receive("58C#6000200000000000")
    desk.receive("58C#2000000000000000")
    desk.receive("58C#3000000000000000")
    assert desk.sent == ["60C#C400200000000000", "60C#210020000A000000", "60C#0030313233343536", "60C#1937383900000000"]
    assert desk.result(request_id) is None
    assert not desk.sdo.serves_blocks
    desk.sent.clear()
    desk.run(download_stream(desk.sdo, 0x2000, 0, iter([bytes(40)])))
    desk.run(upload_stream(desk.sdo, 0x2000, 0, print))
    desk.sdo.abort_all(0x08000000, desk.now)
    assert desk.sent == ["60C#2100200028000000"]  # it is not asked for blocks any more


@pytest.mark.parametrize("answer", [NO_BLOCKS, "58C#8000200000000106", "58C#4F00200007000000"])
def test_a_server_without_blocks_is_read_in_segments(desk: Desk, answer: str) -> None:
    taken: list[bytes] = []
    request_id = desk.run(upload_stream(desk.sdo, 0x2000, 0, taken.append))
    desk.receive(answer)
    assert desk.sent[-1] == "60C#4000200000000000"
    desk.receive("58C#4F00200007000000")
    assert desk.result(request_id) == 1
    assert taken == [b"\x07"]


@pytest.mark.parametrize("block", [True, "auto"])
def test_a_refusal_is_a_refusal(desk: Desk, block: Any) -> None:
    answer = NO_BLOCKS if block is True else "58C#8000200022000008"
    for procedure in (
        upload_stream(desk.sdo, 0x2000, 0, print, block=block),
        download_stream(desk.sdo, 0x2000, 0, [bytes(40)], block=block),
    ):
        request_id = desk.run(procedure)
        desk.receive(answer)
        error = desk.result(request_id)
        assert isinstance(error, SdoTransferError)
        assert error.origin is AbortOrigin.PEER
        assert not error.not_confirmed


@pytest.mark.parametrize("size", [4, 5000])
def test_a_lost_initiate_response_is_a_time_out_and_not_a_server_without_blocks(size: int) -> None:
    """Whatever the server says to a client that has not begun."""
    pair = Pair()
    pair.bus = bus = Bus(fates=[Fate.DELIVERED, Fate.LOST])
    bus.attach(pair.network)
    bus.attach(pair.server)
    pair.client.timeout = 3 * SECOND
    error = pair.run(download_stream(pair.client, INDEX, 0, [pattern(size)], None if size < 29 else size))
    assert isinstance(error, SdoTransferError)
    assert (error.abort_code, error.origin) != (AbortCode.INVALID_COMMAND, AbortOrigin.LOCAL)
    assert not any(frame.startswith("60C#2") for frame in bus.trace())
    assert pair.client.serves_blocks


def test_an_acknowledgement_before_the_initiate_response_is_ignored(desk: Desk) -> None:
    request_id = desk.run(download_stream(desk.sdo, 0x2000, 0, [bytes(40)]))
    desk.receive("58C#A200020000000000")
    desk.wait(SECOND)
    error = desk.result(request_id)
    assert isinstance(error, SdoTransferError)
    assert error.origin is AbortOrigin.TIMEOUT


def test_a_refusal_in_the_middle_does_not_begin_anew(desk: Desk) -> None:
    request_id = desk.run(download_stream(desk.sdo, 0x2000, 0, [bytes(40)]))
    desk.receive("58C#A400200002000000")
    desk.receive(NO_BLOCKS)
    assert isinstance(desk.result(request_id), SdoTransferError)
    assert not any(frame.startswith("60C#2") for frame in desk.sent)


def test_a_stream_that_is_cancelled_is_aborted_on_the_wire(desk: Desk) -> None:
    request_id = desk.run(download_stream(desk.sdo, 0x2000, 0, [bytes(40)]))
    cancel(desk, request_id)
    assert cancelled(desk, request_id) is None
    assert desk.sent == ["60C#C400200000000000", "60C#8000200000000008"]


def test_a_step_that_cancels_its_own_procedure_and_then_raises(desk: Desk) -> None:
    own: list[int] = []

    def news(report: object, now: Time) -> None:
        desk.network.cancel(own[0], now)
        raise ZeroDivisionError

    def procedure() -> Procedure[None]:
        try:
            yield Request(desk.sdo, lambda now, urgent: desk.sdo.download_stream(0x2000, 0, now), news)
        except Cancelled:
            desk.sent.append("clean")
            raise

    own.append(desk.run(procedure()))
    desk.receive("58C#A400200002000000")
    assert isinstance(desk.outcomes[own[0]], ProcedureCancelled)
    assert "clean" in desk.sent
    assert "60C#8000200000000008" in desk.sent


def test_news_that_nobody_wants_is_left_alone(desk: Desk) -> None:
    request_id = desk.run(iter_request(desk))
    desk.receive("58C#A400200002000000")
    assert desk.network.runner.busy
    cancel(desk, request_id)


def iter_request(desk: Desk) -> Procedure[Outcome]:
    return (yield Request(desk.sdo, lambda now, urgent: desk.sdo.download_stream(0x2000, 0, now)))


def test_not_confirmed_in_procedures(desk: Desk) -> None:
    request_id = desk.run(download(desk.sdo, 0x6040, 0, b"\x06\x00"))
    desk.sdo.abort_all(0x08000022, desk.now)
    desk.drain()
    error = desk.result(request_id)
    assert isinstance(error, SdoTransferError)
    assert error.not_confirmed
    assert str(error).endswith(" (not confirmed: it may have been executed)")
    request_id = desk.run(download(desk.sdo, 0x2000, 0, bytes(40)))
    desk.wait(desk.sdo.timeout)
    error = desk.result(request_id)
    assert isinstance(error, SdoTransferError)
    assert not error.not_confirmed
    assert str(error) == "node 12 did not answer writing 0x2000:00"
