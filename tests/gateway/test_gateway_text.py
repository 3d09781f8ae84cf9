"""Requests, answers and events of CiA 309-3 as lines: what is understood, what is refused, and that nothing raises."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.gateway import (
    CANOPENNODE,
    LELY,
    VALUE_TYPES,
    Dialect,
    GatewayAnswer,
    GatewayCommand,
    GatewayEvent,
    GatewayLines,
    GatewayNews,
    GatewayRequest,
    MappedValue,
    code_text,
    parse_message,
    parse_request,
    print_answer,
    print_event,
    print_request,
)
from canopen_proto.gateway.request import EVENT, About
from canopen_proto.machine import LocalProtocolError
from tests.examples import examples
from tests.gateway.gateway_draws import answers, events, requests

DIALECTS = pytest.mark.parametrize("dialect", [CANOPENNODE, LELY], ids=lambda each: each.name)
C = GatewayCommand
U8, U16 = VALUE_TYPES["u8"], VALUE_TYPES["u16"]


def understood(text: str) -> GatewayRequest:
    request = parse_request(text.encode())
    assert isinstance(request, GatewayRequest), request
    return request


@pytest.mark.parametrize(
    ("text", "request_"),
    [
        ("[1] r 0x1018 1", GatewayRequest(C.READ, 1, numbers=(0x1018, 1))),
        ("[0x10] 3 READ 4120 1 U32\r", GatewayRequest(C.READ, 16, None, 3, (0x1018, 1), VALUE_TYPES["u32"])),
        ("[2] 1 3 w 0x6060 0 i8 -1 # why", GatewayRequest(C.WRITE, 2, 1, 3, (0x6060, 0), VALUE_TYPES["i8"], b"\xff")),
        (
            '[2] 3 w 0x2000 0 vs "a # ""b"""',
            GatewayRequest(C.WRITE, 2, None, 3, (0x2000, 0), VALUE_TYPES["vs"], b'a # "b"'),
        ),
        (
            "[2] w 0x2000 0 hex 01 02 ff",
            GatewayRequest(C.WRITE, 2, numbers=(0x2000, 0), value_type=VALUE_TYPES["hex"], data=b"\1\2\xff"),
        ),
        ("[3] 0 start", GatewayRequest(C.START, 3, None, 0)),
        ("[3] 1 5 preoperational", GatewayRequest(C.PRE_OPERATIONAL, 3, 1, 5)),
        ("[3] 5 reset comm", GatewayRequest(C.RESET_COMMUNICATION, 3, None, 5)),
        ("[4] 2 set node 3", GatewayRequest(C.SET_NODE, 4, 2, None, (3,))),
        ("[4] set network 1", GatewayRequest(C.SET_NETWORK, 4, numbers=(1,))),
        ("[5] 1 boot_up_indication ENABLE", GatewayRequest(C.ENABLE_BOOT_UP, 5, 1)),
        ("[6] 1 r pdo 2", GatewayRequest(C.READ_PDO, 6, 1, None, (2,))),
        ("[6] w p 2 2 1 0x10", GatewayRequest(C.WRITE_PDO, 6, numbers=(2, 1, 16))),
        (
            "[7] set rpdo 1 0x185 event 2 0x2000 1 u16 u8",
            GatewayRequest(C.SET_RPDO, 7, numbers=(1, 0x185, EVENT), mapping=(MappedValue(U16, 0x2000, 1), MappedValue(U8))),
        ),
        (
            "[7] set tpdox 1 0x205 event10 20 1 u8",
            GatewayRequest(C.SET_TPDOX, 7, numbers=(1, 0x205, EVENT, 10, 20, 0), mapping=(MappedValue(U8),)),
        ),
        ("[7] set tpdox 1 0x205 sync3 4 0", GatewayRequest(C.SET_TPDOX, 7, numbers=(1, 0x205, 3, 0, 0, 4))),
        ("[8] lss_inquire_addr", GatewayRequest(C.LSS_INQUIRE_ADDRESS, 8)),
        ("[8] _lss_fastscan 50", GatewayRequest(C.LSS_FASTSCAN, 8, numbers=(50,))),
        ("[9] info version", GatewayRequest(C.INFO_VERSION, 9)),
        ("[9] help lss", GatewayRequest(C.HELP_LSS, 9)),
    ],
)  # fmt: skip
def test_a_line_and_what_it_asks_for(text: str, request_: GatewayRequest) -> None:
    assert understood(text) == request_


@pytest.mark.parametrize(
    ("text", "sequence", "code"),
    [
        ("r 0x1000 0", 0, 101),  # no number
        ("[x] 3 start", 0, 101),
        ("[4294967296] 3 start", 0, 101),
        ("[1]", 1, 101),
        ("[1] 3", 1, 101),
        ("[1] 3 frobnicate", 1, 100),
        ("[1] 3 re 0x1000 0", 1, 100),  # an abbreviation that is none
        ("[1] set frobnicate 1", 1, 100),
        ("[1] set", 1, 101),
        ("[1] reset", 1, 101),
        ("[1] 3 reset frobnicate", 1, 101),
        ("[1] r 0x10000 0", 1, 101),
        ("[1] r 0x1000", 1, 101),
        ("[1] r 010 0", 1, 101),
        ("[1] r 0x1000 0 u7", 1, 101),
        ("[1] r 0x1000 0 u8 5", 1, 101),
        ("[1] w 0x6060 0 i8 300", 1, 101),
        ("[1] w 0x6060 0 i8", 1, 101),
        ('[1] w 0x2000 0 vs "open', 1, 101),
        ("[1] 1 200 r 0x1000 0", 1, 107),
        ("[1] 128 start", 1, 107),
        ("[1] 70000 3 start", 1, 106),
        ("[1] 1 2 3 start", 1, 101),
        ("[1] 1 3 set node 3", 1, 101),  # a node before a command about a net
        ("[1] 1 info version", 1, 101),
        ("[1] lss_switch_sel 1 2 3", 1, 101),
        ("[1] lss_allnodes 1 2", 1, 101),
        ("[1] set rpdo 1 0x185 event 1 0x1008 0 vs", 1, 101),  # no length
        ("[1] w p 1 2 1", 1, 101),
        ("[1] set sdo_timeout 0", 1, 101),
        ("[1] start now", 1, 101),
    ],
)
def test_a_line_that_is_refused_with_its_code(text: str, sequence: int, code: int) -> None:
    unclosed = '"' in text
    answer = parse_request(text.encode())
    assert isinstance(answer, GatewayAnswer)
    assert replace(answer, remark="") == GatewayAnswer(0 if unclosed else sequence, code=code)


@pytest.mark.parametrize("text", ["", "  ", "\r", "# comment", "   # [1] start"])
def test_a_line_with_nothing_to_do(text: str) -> None:
    assert parse_request(text.encode()) is None


def test_each_command_has_its_words_alone() -> None:
    """Each spelling leads to its command, with the fewest numbers that it takes."""
    for command in GatewayCommand:
        for spelling in (0, -1):
            words = " ".join(each[spelling] for each in command.syntax.words)
            request = parse_request(f"[1] {words.upper()}".encode())
            refused = isinstance(request, GatewayAnswer)
            assert request == (GatewayAnswer(1, code=101) if refused else GatewayRequest(command, 1))
            needs = bool(command.syntax.numbers) and 0 not in command.syntax.counts
            assert refused is needs, command
    assert {each.about for each in GatewayCommand} == set(About)


@DIALECTS
@examples(600, least=100)
@given(data=st.data())
def test_a_request_is_read_as_it_was_written(dialect: Dialect, data: st.DataObject) -> None:
    request = data.draw(requests(dialect))
    line = print_request(request, dialect)
    assert parse_request(line, dialect) == request
    assert parse_request(line + b"  # comment\r", dialect) == request


@DIALECTS
@examples(300)
@given(data=st.data())
def test_an_answer_is_read_as_it_was_written(dialect: Dialect, data: st.DataObject) -> None:
    answer = data.draw(answers(dialect))
    line = print_answer(answer, dialect)
    assert line.endswith(dialect.line_end)
    assert parse_message(line.removesuffix(dialect.line_end)) == answer


@DIALECTS
@examples(300)
@given(event=events())
def test_an_event_is_read_as_it_was_written(dialect: Dialect, event: GatewayEvent) -> None:
    line = print_event(event, dialect)
    assert parse_message(line.removesuffix(dialect.line_end)) == event


@DIALECTS
@examples(500)
@given(line=st.binary(max_size=80) | st.text('[]1 3rwu8#"0xa\n', max_size=40).map(str.encode))
def test_any_bytes_are_understood_refused_or_nothing(dialect: Dialect, line: bytes) -> None:
    request = parse_request(line, dialect)
    if isinstance(request, GatewayRequest):
        assert parse_request(print_request(request, dialect), dialect) == request
    elif request is not None:
        assert request.code in (100, 101, 106, 107)
    message = parse_message(line)
    assert message is None or isinstance(message, GatewayAnswer | GatewayEvent)


@pytest.mark.parametrize(
    ("answer", "canopennode", "lely"),
    [
        (GatewayAnswer(2), b"[2] OK\r\n", b"[2] OK\n"),
        (GatewayAnswer(2, "576"), b"[2] 576\r\n", b"[2] 576\n"),
        (GatewayAnswer(2, code=101), b"[2] ERROR:101 #Syntax error.\r\n", b"[2] ERROR: 101 (Syntax error.)\n"),
        (
            GatewayAnswer(2, abort_code=0x06070010, remark="length"),
            b"[2] ERROR:0x06070010 #length\r\n",
            b"[2] ERROR: 06070010 (length)\n",
        ),
        (GatewayAnswer(2, lines=("Found 1",)), b"# Found 1\n[2] OK\r\n", b"# Found 1\n[2] OK\n"),
    ],
)
def test_an_answer_as_both_gateways_write_it(answer: GatewayAnswer, canopennode: bytes, lely: bytes) -> None:
    assert print_answer(answer, CANOPENNODE) == canopennode
    assert print_answer(answer, LELY) == lely


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"[8] 92 01\n...ERROR:0x05040000 #SDO protocol timed out.", GatewayAnswer(8, abort_code=0x05040000)),
        (b"[9] ERROR: 06020000 (Object does not exist)", GatewayAnswer(9, abort_code=0x06020000, remark="Object does not exist")),
        (b"[9] ERROR:104", GatewayAnswer(9, code=104)),
        (b"1 3 USER BOOT A (text)", GatewayEvent(1, 3, GatewayNews.OTHER, text="USER BOOT A (text)")),
        (b"1 3 EMCY 2310 03 0 0 0 0 300", GatewayEvent(1, 3, GatewayNews.OTHER, text="EMCY 2310 03 0 0 0 0 300")),
        (b"1 pdo 1 2 0x37", None),
        (b"hello", None),
        (b"[x] OK", None),
        (b"", None),
    ],
)
def test_a_line_of_a_gateway(line: bytes, message: GatewayAnswer | GatewayEvent | None) -> None:
    got = parse_message(line)
    if isinstance(got, GatewayAnswer) and isinstance(message, GatewayAnswer) and not message.remark:
        assert (got.sequence, got.abort_code, got.code) == (message.sequence, message.abort_code, message.code)
    else:
        assert got == message


def test_a_remark_cannot_break_a_line() -> None:
    line = print_answer(GatewayAnswer(1, code=102, remark="a\r\n[2] OK\r\n" + "x" * 1000))
    assert line.count(b"\n") == 1
    assert len(line) < 400
    assert code_text(4711) == "Error 4711."


def test_what_cannot_be_typed_is_refused() -> None:
    for request in (
        GatewayRequest(C.READ, 1, numbers=(0x10000, 0)),
        GatewayRequest(C.READ, 1, numbers=(0x1000,)),
        GatewayRequest(C.READ, -1, numbers=(0x1000, 0)),
        GatewayRequest(C.READ, 1, 1, None, (0x1000, 0)),  # one number is the node
        GatewayRequest(C.WRITE, 1, numbers=(0x1000, 0), value_type=VALUE_TYPES["vs"], data=b"a\r\nb"),
        GatewayRequest(C.WRITE, 1, numbers=(0x1000, 0)),
        GatewayRequest(C.INFO_VERSION, 1, 1),
    ):
        with pytest.raises(LocalProtocolError):
            print_request(request)


# ---- lines ----


@examples(200)
@given(
    lines=st.lists(st.binary(max_size=12).map(lambda each: each.replace(b"\n", b"")), max_size=5),
    cuts=st.lists(st.integers(0, 80), max_size=6),
    end=st.sampled_from([b"\n", b"\r\n"]),
)
def test_lines_come_whole_however_they_were_cut(lines: list[bytes], cuts: list[int], end: bytes) -> None:
    lines = [line.replace(b"\r", b"") for line in lines]
    stream = b"".join(line + end for line in lines)
    splitter = GatewayLines(end, 12)
    got, last = [], 0
    for cut in [*sorted(cuts), len(stream)]:
        got += splitter.feed(stream[last:cut])
        last = max(last, cut)
    assert got == lines
    assert not splitter.too_long
    assert splitter.pending == 0


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_the_longest_line_and_one_that_is_too_long(end: bytes) -> None:
    splitter = GatewayLines(end, 4)
    assert splitter.feed(b"abcd") == []
    assert splitter.feed(end) == [b"abcd"]
    assert not splitter.too_long
    assert splitter.feed(b"ab" + end + b"abcde" + end) == [b"ab"]
    assert splitter.too_long
    assert splitter.feed(b"x" + end) == []
    endless = GatewayLines(end, 4)
    for _ in range(7):
        assert endless.feed(b"a") == []
        assert endless.pending <= 4 + len(end)
    assert endless.too_long


@pytest.mark.parametrize(
    ("line", "remark"),
    [
        ("w 0x1017 0 u16 99999", "99999 is out of range for u16: 0 to 65535"),
        ("w 0x1017 0 i8 -129", "-129 is out of range for i8: -128 to 127"),
        ("w 0x1017 0 x16 0x10000", "0x10000 is out of range for x16: 0 to 65535"),
        ("w 0x1017 0 b 2", "2 is out of range for b: 0 to 1"),
        ("w 0x1017 0 u16 soon", "soon is no value of u16"),
        ("w 0x1017 0 r32 1,5", "1,5 is no value of r32"),
        ("w 0x1017 0 float 1", "float is no type"),
        ("set node 200", "200 is out of range: 0 to 127"),
        ("r 0x1000 300 u32", "300 is out of range: 0 to 255"),
        ("r 0x10000 0 u32", "0x10000 is out of range: 0 to 65535"),
        ("r 0x1000 -1 u32", "-1 is out of range: 0 to 255"),
        ("r x 0 u32", "x is no number"),
        ("r 01 0 u32", "01 is no number"),
        ("set rpdo 513 0x181 event 0", "513 is out of range: 1 to 512"),
        ("set rpdo 1 0x181 event 1 0x10000 0 u8", "0x10000 is out of range: 1 to 65535"),
        ("set rpdo 1 0x181 sync241 0", "sync241 is no transmission type: event, rtr, sync0 to sync240"),
        ("set rpdo 1 0x181 soon 0", "soon is no transmission type: event, rtr, sync0 to sync240"),
        ("w pdo 1 65 1", "65 is out of range: 0 to 64"),
    ],
)
def test_an_error_of_syntax_says_what_is_out_of_range_and_begins_as_ever(line: str, remark: str) -> None:
    answer = parse_request(f"[7] {line}".encode())
    assert isinstance(answer, GatewayAnswer)
    assert print_answer(answer) == f"[7] ERROR:101 #Syntax error. {remark}\r\n".encode()
    assert print_answer(answer, LELY) == f"[7] ERROR: 101 (Syntax error. {remark})\n".encode()


def test_a_long_word_of_a_client_makes_no_long_answer() -> None:
    answer = parse_request(b"[7] r " + b"x" * 5000 + b" 0 u32")
    assert isinstance(answer, GatewayAnswer)
    assert len(print_answer(answer)) < 120
