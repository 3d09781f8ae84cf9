"""What a gateway says (CiA 309-3): `GatewayAnswer` to a request, and `GatewayEvent`, which nobody asked for at that moment.

An answer begins with the number of its request in brackets, an event with the number of its net: so a client tells them by the
first character. `print_answer` and `print_event` write them, `parse_message` reads both.

The events are those of Lely CANopen, whose form they have (CANopenNode sends none):

    1 3 BOOT_UP                         node 3 of net 1 has booted
    1 3 ERRORx OPER                     its NMT state has changed: STOP, OPER, PREO
    1 3 ERROR 203 (Heartbeat lost.)     one of the codes 200 to 204
    1 3 EMCY 2310 03 0 0 0 0 0          an emergency: code, error register, five bytes of the maker
    1 3 SDOr 32                         so many bytes were read so far (SDOw: written)
    1 pdo 1 2 0x37 0x10                 PDO 1 came, with two values
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_proto.abort import text_of
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.gateway.codes import code_text
from canopen_proto.gateway.dialect import CANOPENNODE, Dialect
from canopen_proto.gateway.value_types import integer_of
from canopen_proto.nmt import NmtState

MAX_REMARK: Final = 300
"""Characters of a remark behind an error: one line on a screen, and a half."""


@dataclass(frozen=True)
class GatewayAnswer:
    """The answer to a request: a value, an error, or OK.

    sequence: of the request. value: as text; None: there is none. It may hold LFs, where the dialect ends lines by CR LF. code:
    an internal error code (GatewayCode), 0 if there is none. abort_code: with which the node, or the SDO client of the gateway,
    has refused; None if none did. remark: for people, behind the code; "" for the usual text. lines: comments before the answer.
    """

    sequence: int
    value: str | None = None
    code: int = 0
    abort_code: int | None = None
    remark: str = ""
    lines: tuple[str, ...] = ()

    @property
    def is_error(self) -> bool:
        """Whether the request was refused, or failed."""
        return self.code != 0 or self.abort_code is not None


class GatewayNews(Enum):
    """The kinds of events."""

    BOOT_UP = "BOOT_UP"
    STATE = "ERRORx"
    ERROR = "ERROR"
    EMCY = "EMCY"
    READ_SO_FAR = "SDOr"
    WRITTEN_SO_FAR = "SDOw"
    PDO = "pdo"
    OTHER = "other"


STATE_WORDS: Final = {NmtState.STOPPED: "STOP", NmtState.OPERATIONAL: "OPER", NmtState.PRE_OPERATIONAL: "PREO"}
_STATE_OF_WORD: Final = {word: state for state, word in STATE_WORDS.items()}


@dataclass(frozen=True)
class GatewayEvent:
    """Something that a gateway reports by itself.

    net: its number. node: 1..127; 0 of a PDO, which has none. numbers: the NMT state; the code; the emergency's code, error
    register and five bytes; the bytes so far; the PDO's number and its values. text: of an event of another kind, all behind the
    numbers.
    """

    net: int
    node: int
    kind: GatewayNews
    numbers: tuple[int, ...] = ()
    text: str = ""


def print_answer(answer: GatewayAnswer, dialect: Dialect = CANOPENNODE) -> bytes:
    """Return an answer as bytes, with the end of its line."""
    head = f"[{answer.sequence}]"
    if answer.abort_code is not None:
        body = _error_text(f"{answer.abort_code:08X}", "0x", answer.remark or text_of(answer.abort_code), dialect)
    elif answer.code:
        body = _error_text(str(answer.code), "", answer.remark or code_text(answer.code), dialect)
    else:
        body = "OK" if answer.value is None else _one_line(answer.value, dialect)
    lines = [f"# {one_line(line)}" for line in answer.lines]
    return "\n".join([*lines, f"{head} {body}"]).encode("latin-1", "replace") + dialect.line_end


def print_event(event: GatewayEvent, dialect: Dialect = CANOPENNODE) -> bytes:
    """Return an event as bytes, with the end of its line."""
    where = f"{event.net} {event.node}"
    numbers = event.numbers
    match event.kind:
        case GatewayNews.BOOT_UP:
            text = f"{where} BOOT_UP"
        case GatewayNews.STATE:
            text = f"{where} ERRORx {STATE_WORDS[NmtState(numbers[0])]}"
        case GatewayNews.ERROR:
            text = f"{where} ERROR {numbers[0]} ({code_text(numbers[0])})"
        case GatewayNews.EMCY:
            code, register, *maker = numbers
            text = " ".join([where, "EMCY", f"{code:04X}", f"{register:02X}", *map(str, maker)])
        case GatewayNews.PDO:
            number, *values = numbers
            text = " ".join([str(event.net), "pdo", str(number), str(len(values)), *(f"0x{each:x}" for each in values)])
        case GatewayNews.READ_SO_FAR | GatewayNews.WRITTEN_SO_FAR:
            text = f"{where} {event.kind.value} {numbers[0]}"
        case GatewayNews.OTHER:
            text = f"{where} {one_line(event.text)}"
    return text.encode("latin-1", "replace") + dialect.line_end


def parse_message(line: bytes) -> GatewayAnswer | GatewayEvent | None:
    """Return what a gateway says in a line, of either dialect; None for an empty line, or one that is neither answer nor event.
    line: without its end. Lines of comments before an answer are in its `lines`; the end of a read that failed half-way (LF, then
    `...ERROR:`) makes it an error."""
    text = line.decode("latin-1")
    lines = []
    while text.startswith("#"):
        comment, _, text = text.partition("\n")
        lines.append(comment[1:].removeprefix(" "))
    if text.startswith("["):
        return _parse_answer(text, tuple(lines))
    return _parse_event(text.strip())


def one_line(text: str) -> str:
    """Return a text without what would break a line of the protocol, and no longer than MAX_REMARK."""
    return "".join(char if " " <= char <= "~" or char >= "\xa0" else " " for char in text[:MAX_REMARK]).strip()


_ANSWER: Final = re.compile(r"\[(0|[1-9][0-9]{0,9})\] ?(.*)", re.DOTALL)
_ERROR: Final = re.compile(r"ERROR: ?(?:0x([0-9A-Fa-f]{8})|([0-9A-Fa-f]{8})|([0-9]{1,4}))(?:\s+(.*))?", re.DOTALL)
_HALF_WAY: Final = "\n...ERROR:"
_EMCY: Final = re.compile(r"([0-9A-F]{4}) ([0-9A-F]{2}) ([0-9]{1,3}) ([0-9]{1,3}) ([0-9]{1,3}) ([0-9]{1,3}) ([0-9]{1,3})")
_CODE: Final = re.compile(r"([1-9][0-9]{0,3}) \(.*\)")


def _one_line(value: str, dialect: Dialect) -> str:
    """Return a value as it is sent: without ends of lines. A help has several lines where the dialect can carry them."""
    value = value.replace("\r", "")
    return value if dialect.line_end == b"\r\n" else value.replace("\n", " ")


def _error_text(code: str, prefix: str, text: str, dialect: Dialect) -> str:
    text = one_line(text)
    return f"ERROR: {code} ({text})" if dialect.spaced_errors else f"ERROR:{prefix}{code} #{text}"


def _parse_answer(text: str, lines: tuple[str, ...]) -> GatewayAnswer | None:
    match = _ANSWER.fullmatch(text)
    if match is None or int(match[1]) > 0xFFFF_FFFF:
        return None
    sequence, body = int(match[1]), match[2]
    if body == "OK":
        return GatewayAnswer(sequence, lines=lines)
    if _HALF_WAY in body:
        body = body[body.rindex(_HALF_WAY) + 4 :]
    error = _ERROR.fullmatch(body)
    if error is None:
        return GatewayAnswer(sequence, body, lines=lines)
    remark = _remark_of(error[4] or "")
    abort = error[1] or error[2]
    if abort is not None:
        code = int(abort, 16)
        return GatewayAnswer(sequence, abort_code=code, remark="" if remark == one_line(text_of(code)) else remark, lines=lines)
    number = int(error[3])
    if number == 0:
        return None
    return GatewayAnswer(sequence, code=number, remark="" if remark == code_text(number) else remark, lines=lines)


def _remark_of(text: str) -> str:
    text = text.removeprefix("#") if text.startswith("#") else text.removeprefix("(").removesuffix(")")
    return one_line(text)


def _parse_event(text: str) -> GatewayEvent | None:
    net_word, _, rest = text.partition(" ")
    net = _small(net_word, 0xFFFF)
    if net is None:
        return None
    if rest.startswith("pdo "):
        return _parse_pdo(net, rest.split()[1:])
    node_word, _, rest = rest.partition(" ")
    node = _small(node_word, MAX_NODE_ID)
    if not node or not rest.strip():
        return None
    kind, _, tail = rest.partition(" ")
    event = _known_event(net, node, kind, tail)
    if event is not None:
        return event
    other = one_line(rest)
    return GatewayEvent(net, node, GatewayNews.OTHER, text=other) if other else None


def _known_event(net: int, node: int, kind: str, tail: str) -> GatewayEvent | None:
    if kind == "BOOT_UP" and not tail:
        return GatewayEvent(net, node, GatewayNews.BOOT_UP)
    if kind == "ERRORx" and tail in _STATE_OF_WORD:
        return GatewayEvent(net, node, GatewayNews.STATE, (int(_STATE_OF_WORD[tail]),))
    if kind in ("SDOr", "SDOw"):
        count = _small(tail, 0xFFFF_FFFF)
        return None if count is None else GatewayEvent(net, node, GatewayNews(kind), (count,))
    if kind == "ERROR":
        error = _CODE.fullmatch(tail)
        if error is not None and tail == f"{int(error[1])} ({code_text(int(error[1]))})":
            return GatewayEvent(net, node, GatewayNews.ERROR, (int(error[1]),))
    if kind == "EMCY":
        emcy = _EMCY.fullmatch(tail)
        maker = () if emcy is None else tuple(map(int, emcy.groups()[2:]))
        if emcy is not None and max(maker) <= 0xFF:
            return GatewayEvent(net, node, GatewayNews.EMCY, (int(emcy[1], 16), int(emcy[2], 16), *maker))
    return None


def _parse_pdo(net: int, words: list[str]) -> GatewayEvent | None:
    numbers = [integer_of(word) for word in words]
    known = tuple(number for number in numbers if number is not None and 0 <= number < 1 << 64)
    if len(known) != len(numbers) or len(known) < 2 or known[1] != len(known) - 2:
        return None
    return GatewayEvent(net, 0, GatewayNews.PDO, (known[0], *known[2:]))


def _small(text: str, most: int) -> int | None:
    """Return a number without a sign in decimal, as gateways write it; None if it is none, or too great."""
    return int(text) if text.isdecimal() and text.isascii() and len(text) <= 10 and int(text) <= most else None
