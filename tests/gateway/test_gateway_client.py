"""The client's machine of CiA 309-3: numbers, answers, events, and a gateway that misbehaves."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.gateway import (
    CANOPENNODE,
    LELY,
    GatewayAnswer,
    GatewayAnswered,
    GatewayClient,
    GatewayCommand,
    GatewayEvent,
    GatewayNews,
    GatewayOddLine,
    GatewayRequest,
)
from canopen_proto.gateway.client import MAX_ANSWER, MAX_MESSAGES, MAX_OPEN, PATIENCE
from canopen_proto.machine import NEVER, LocalProtocolError
from tests.examples import examples

READ = GatewayRequest(GatewayCommand.READ, node=3, numbers=(0x1000, 0))


def test_each_request_gets_a_number_and_its_own_answer() -> None:
    client = GatewayClient()
    first, second = client.send(READ, 0), client.send(READ, 0)
    assert (first, second) == (1, 2)
    assert client.take_bytes() == b"[1] 3 r 0x1000 0\r\n[2] 3 r 0x1000 0\r\n"
    client.receive(b"[2] 92 01 02 00\r\n\r\n[1] ERROR:0x06020000 #no\r\n", 0)
    answers = client.take_messages()
    assert [
        (each.request.sequence, each.answer and each.answer.value) for each in answers if isinstance(each, GatewayAnswered)
    ] == [
        (2, "92 01 02 00"),
        (1, None),
    ]
    assert client.waiting == 0
    assert client.deadline == NEVER


def test_an_event_between_request_and_answer_is_no_answer() -> None:
    client = GatewayClient()
    client.send(READ, 0)
    client.receive(b"1 3 BOOT_UP\r\n[1] 5\r\n", 0)
    assert client.take_messages() == [
        GatewayEvent(1, 3, GatewayNews.BOOT_UP),
        GatewayAnswered(GatewayRequest(GatewayCommand.READ, 1, None, 3, (0x1000, 0)), GatewayAnswer(1, "5")),
    ]


def test_an_answer_that_nobody_waits_for_is_told_as_that() -> None:
    client = GatewayClient()
    client.send(READ, 0)
    client.handle_timeout(PATIENCE - 1)
    assert client.waiting == 1
    client.handle_timeout(PATIENCE)
    client.send(READ, PATIENCE)
    client.receive(b"[1] 5\r\n[2] 6\r\n[2] 7\r\nnonsense\r\n", PATIENCE)
    late, answer, again, odd = client.take_messages()[1:]
    assert late == GatewayOddLine("[1] 5", is_late=True)
    assert isinstance(answer, GatewayAnswered)
    assert answer.answer == GatewayAnswer(2, "6")
    assert again == GatewayOddLine("[2] 7", is_late=True)
    assert odd == GatewayOddLine("nonsense")


def test_a_read_that_failed_half_way_is_an_error() -> None:
    client = GatewayClient(CANOPENNODE)
    client.send(READ, 0)
    client.receive(b"[1] 00 01\n", 0)
    assert client.take_messages() == []
    client.receive(b"...ERROR:0x05040000 #late\r\n", 0)
    (answered,) = client.take_messages()
    assert isinstance(answered, GatewayAnswered)
    assert answered.answer is not None
    assert answered.answer.abort_code == 0x05040000


def test_a_gateway_of_lely_ends_its_lines_by_lf_alone() -> None:
    client = GatewayClient(LELY)
    client.send(READ, 0)
    client.receive(b"[1] 0x00020192\n", 0)
    (answered,) = client.take_messages()
    assert isinstance(answered, GatewayAnswered)
    assert answered.answer == GatewayAnswer(1, "0x00020192")


def test_a_line_without_an_end_breaks_the_connection_and_each_request_has_its_outcome() -> None:
    client = GatewayClient()
    client.send(READ, 0)
    for _ in range(MAX_ANSWER // 65536 + 1):
        client.receive(b"x" * 65536, 0)
    assert client.is_broken
    (answered,) = client.take_messages()
    assert isinstance(answered, GatewayAnswered)
    assert answered.answer is None
    with pytest.raises(LocalProtocolError, match="connect again"):
        client.send(READ, 0)


def test_requests_and_messages_are_bounded() -> None:
    client = GatewayClient()
    for _ in range(MAX_OPEN):
        client.send(READ, 0)
    with pytest.raises(LocalProtocolError, match="64 requests"):
        client.send(READ, 0)
    for _ in range(MAX_MESSAGES + 10):
        client.receive(b"1 3 BOOT_UP\r\n", 0)
    client.give_up()
    with pytest.raises(LocalProtocolError, match="64 requests"):  # their outcomes were not taken
        client.send(READ, 0)
    messages = client.take_messages()
    assert sum(isinstance(each, GatewayAnswered) for each in messages) == MAX_OPEN
    assert len(messages) <= MAX_MESSAGES + MAX_OPEN
    assert client.dropped == 10
    client.send(READ, 0)


def test_the_number_after_the_greatest_is_one_that_nobody_waits_for() -> None:
    client = GatewayClient()
    client.send(READ, 0)
    client._sequence = 0xFFFF_FFFE
    assert client.send(READ, 0) == 0xFFFF_FFFF
    assert client.send(READ, 0) == 2


@examples(200)
@given(
    st.lists(
        st.binary(max_size=40) | st.sampled_from([b"[1] OK\r\n", b"[2] 5\r\n", b"1 3 BOOT_UP\r\n", b"\n...ERROR:"]), max_size=8
    )
)
def test_whatever_a_gateway_sends_each_request_has_one_outcome(pieces: list[bytes]) -> None:
    client = GatewayClient()
    sent = {client.send(READ, 0) for _ in range(3)}
    for piece in pieces:
        client.receive(piece, 0)
    client.handle_timeout(PATIENCE)
    answered = [each.request.sequence for each in client.take_messages() if isinstance(each, GatewayAnswered)]
    assert sorted(answered) == sorted(sent)
