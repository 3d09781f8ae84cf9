"""Requests as lines of text: `parse_request` and `print_request`.

A line ends with LF; CR before it may be left out. Commands and types are typed in capital or small letters. `#` begins a comment,
but not inside quotes. Numbers are decimal, or hexadecimal with 0x; a leading 0 is refused, since C takes it for octal.

Any line has one of three meanings: a request, a refusal with the code that answers it, or nothing to do (empty, or a comment). A
client's bytes never raise anything.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import range_of
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.gateway.answer import GatewayAnswer, one_line
from canopen_proto.gateway.codes import GatewayCode, code_text
from canopen_proto.gateway.dialect import CANOPENNODE, Dialect
from canopen_proto.gateway.request import (
    EVENT,
    MAX_NET,
    MAX_PDO_VALUES,
    MAX_SEQUENCE,
    MAX_SYNC,
    RTR,
    About,
    GatewayCommand,
    GatewayRequest,
    MappedValue,
    Tail,
)
from canopen_proto.gateway.value_types import VALUE_TYPES, TextForm, ValueType, integer_of, parse_value, typed_value
from canopen_proto.machine import LocalProtocolError

MAX_SHOWN: Final = 40
"""Characters of a wrong word that its refusal repeats."""
_BLANK: Final = " \t"
_ONE_FRAME: Final = (TextForm.NUMBER, TextForm.HEXADECIMAL, TextForm.REAL, TextForm.TIME)
"""The forms of values that a PDO can carry: they have a length."""


class _Word(NamedTuple):
    """A word of a line. text: with its quotes, if it has some. place: where it begins."""

    text: str
    place: int


@mypyc_attr(native_class=False)
class _NotARequest(Exception):
    """This line is answered by an error. why: what is wrong with it, for people; "" for the usual text of the code."""

    def __init__(self, code: GatewayCode = GatewayCode.SYNTAX, why: str = "") -> None:
        super().__init__(code.name)
        self.code = code
        self.remark = one_line(f"{code_text(code)} {why}") if why else ""


def _spellings() -> dict[tuple[str, ...], GatewayCommand]:
    found: dict[tuple[str, ...], GatewayCommand] = {}
    for command in GatewayCommand:
        paths: list[tuple[str, ...]] = [()]
        for spellings in command.syntax.words:
            paths = [(*path, spelling) for path in paths for spelling in spellings]
        found.update(dict.fromkeys(paths, command))
    return found


_COMMANDS: Final = _spellings()
_FIRST_WORDS: Final = frozenset(path[0] for path in _COMMANDS)


def parse_request(line: bytes, dialect: Dialect = CANOPENNODE) -> GatewayRequest | GatewayAnswer | None:
    """Return what a line asks for; the answer that refuses it; or None for an empty line or a comment. line: without its LF."""
    text = line.decode("latin-1").removesuffix("\r")
    sequence = 0
    try:
        words = _words(text)
        if words is None:
            raise _NotARequest
        if not words:
            return None
        number = _sequence_of(words[0].text)
        if number is None:
            raise _NotARequest
        sequence = number
        return _request(sequence, text, words[1:], dialect)
    except _NotARequest as refused:
        return GatewayAnswer(sequence, code=int(refused.code), remark=refused.remark)


def print_request(request: GatewayRequest, dialect: Dialect = CANOPENNODE) -> bytes:
    """Return a request as a line, without its end: `parse_request` makes the same request of it. Raises LocalProtocolError for
    one that cannot be typed: a number out of its range, a value that its type does not carry."""
    syntax = request.command.syntax
    words = [f"[{_checked(request.sequence, (0, MAX_SEQUENCE))}]"]
    if request.net is not None:
        words.append(str(_checked(request.net, (0, MAX_NET))))
    if request.node is not None:
        words.append(str(_checked(request.node, (0, MAX_NODE_ID))))
    words += [spellings[0] for spellings in syntax.words]
    numbers = request.numbers
    fixed, rest = numbers[: len(syntax.numbers)], numbers[len(syntax.numbers) :]
    words += [_number_text(number, bounds) for number, bounds in zip(fixed, syntax.numbers, strict=False)]
    match syntax.tail:
        case Tail.TYPE:
            words += [] if request.value_type is None else [request.value_type.word]
        case Tail.VALUE if request.value_type is not None:
            words += [request.value_type.word, typed_value(request.value_type, request.data, dialect)]
        case Tail.COUNTED:
            words += [str(len(rest)), *(f"0x{_checked(each, (0, (1 << 64) - 1)):X}" for each in rest)]
        case Tail.MAPPING | Tail.EXTENDED_MAPPING if rest:
            words += [_transmission_text(rest[0]), *map(str, _further(syntax.tail, rest[0], rest[1:]))]
            words.append(str(len(request.mapping)))
            for each in request.mapping:
                words += [f"0x{each.index:X}", str(each.subindex)] if each.index else []
                words.append(each.value_type.word)
    line = " ".join(words).encode("latin-1")
    if parse_request(line, dialect) != request:
        raise LocalProtocolError(f"{request} cannot be typed as a line; {line[:80]!r} would be something else")
    return line


def _words(text: str) -> list[_Word] | None:
    """Return the words of a line, without its comment; None if a quote is not closed, or something follows it at once."""
    words: list[_Word] = []
    place, end = 0, len(text)
    while place < end:
        char = text[place]
        if char in _BLANK:
            place += 1
            continue
        if char == "#":
            break
        begin = place
        if char == '"':
            place = _after_quotes(text, place)
            if not place or (place < end and text[place] not in " \t#"):
                return None
        else:
            while place < end and text[place] not in " \t#":
                place += 1
        words.append(_Word(text[begin:place], begin))
    return words


def _after_quotes(text: str, place: int) -> int:
    """Return where a quoted text that begins at `place` has ended; 0 if it has no end."""
    place += 1
    while True:
        place = text.find('"', place)
        if place < 0:
            return 0
        if text[place + 1 : place + 2] != '"':
            return place + 1
        place += 2


def _sequence_of(text: str) -> int | None:
    if len(text) < 3 or text[0] != "[" or text[-1] != "]":
        return None
    number = integer_of(text[1:-1])
    return number if number is not None and 0 <= number <= MAX_SEQUENCE else None


def _request(sequence: int, text: str, words: list[_Word], dialect: Dialect) -> GatewayRequest:
    before: list[int] = []
    while words and len(before) < 3 and words[0].text[0] in "0123456789":
        number = integer_of(words[0].text)
        if number is None:
            raise _NotARequest
        before.append(number)
        words = words[1:]
    if not words or len(before) > 2:
        raise _NotARequest
    command, words = _command_of(words)
    net, node = _place(command.about, before)
    syntax = command.syntax
    line = _Rest(text, words)
    if syntax.tail in (Tail.MAPPING, Tail.EXTENDED_MAPPING, Tail.COUNTED, Tail.TYPE, Tail.VALUE):
        numbers = [line.number(*bounds) for bounds in syntax.numbers]
    else:
        if len(words) not in (syntax.counts or (len(syntax.numbers),)):
            raise _NotARequest
        numbers = [line.number(*bounds) for bounds in syntax.numbers[: len(words)]]
    value_type, data, mapping = _tail(syntax.tail, line, numbers, dialect)
    line.end()
    return GatewayRequest(command, sequence, net, node, tuple(numbers), value_type, data, mapping)


def _command_of(words: list[_Word]) -> tuple[GatewayCommand, list[_Word]]:
    first = words[0].text.lower()
    if len(words) > 1:
        command = _COMMANDS.get((first, words[1].text.lower()))
        if command is not None:
            return command, words[2:]
    command = _COMMANDS.get((first,))
    if command is not None:
        return command, words[1:]
    is_setting = first == "set" and len(words) > 1
    raise _NotARequest(GatewayCode.NOT_SUPPORTED if first not in _FIRST_WORDS or is_setting else GatewayCode.SYNTAX)


def _place(about: About, before: list[int]) -> tuple[int | None, int | None]:
    """Return net and node, of the numbers that stand before a command."""
    if len(before) > about.value:
        raise _NotARequest
    net = before[0] if before and len(before) + (about is About.NET) == 2 else None
    node = before[-1] if before and about is About.NODE else None
    if net is not None and net > MAX_NET:
        raise _NotARequest(GatewayCode.UNSUPPORTED_NET)
    if node is not None and node > MAX_NODE_ID:
        raise _NotARequest(GatewayCode.UNSUPPORTED_NODE)
    return net, node


class _Rest:
    """The words of a line that are not understood yet."""

    def __init__(self, text: str, words: list[_Word]) -> None:
        self._text = text
        self._words = words
        self._next = 0

    @property
    def is_empty(self) -> bool:
        return self._next >= len(self._words)

    def word(self) -> str:
        """Return the next word; refuse a line that has none."""
        if self.is_empty:
            raise _NotARequest
        self._next += 1
        return self._words[self._next - 1].text

    def number(self, low: int, high: int) -> int:
        """Return the next word as a number within bounds."""
        word = self.word()
        number = integer_of(word)
        if number is None:
            raise _refused(word, "is no number")
        return _bounded(word, number, low, high)

    def value_type(self) -> ValueType:
        """Return the next word as a type."""
        word = self.word()
        value_type = VALUE_TYPES.get(word.lower())
        if value_type is None:
            raise _refused(word, "is no type")
        return value_type

    def all(self) -> str:
        """Return all that follows, as it stands in the line; refuse a line where nothing does."""
        if self.is_empty:
            raise _NotARequest
        first, last = self._words[self._next], self._words[-1]
        self._next = len(self._words)
        return self._text[first.place : last.place + len(last.text)]

    def end(self) -> None:
        """Refuse a line that goes on."""
        if not self.is_empty:
            raise _NotARequest


def _refused(text: str, why: str) -> _NotARequest:
    """Return the refusal of a line. text: what is wrong in it."""
    return _NotARequest(why=f"{text[:MAX_SHOWN]} {why}")


def _bounded(word: str, number: int, low: int, high: int) -> int:
    if not low <= number <= high:
        raise _refused(word, f"is out of range: {low} to {high}")
    return number


def _why_no_value(value_type: ValueType, text: str) -> str:
    bounds = range_of(value_type.data_type)
    if bounds is None or integer_of(text) is None:
        return f"is no value of {value_type.word}"
    return f"is out of range for {value_type.word}: {bounds[0]} to {bounds[1]}"


def _tail(
    tail: Tail, line: _Rest, numbers: list[int], dialect: Dialect
) -> tuple[ValueType | None, bytes, tuple[MappedValue, ...]]:
    match tail:
        case Tail.TYPE:
            return (None if line.is_empty else line.value_type()), b"", ()
        case Tail.VALUE:
            value_type = line.value_type()
            text = line.all()
            data = parse_value(value_type, text, dialect)
            if data is None:
                raise _refused(text, _why_no_value(value_type, text))
            return value_type, data, ()
        case Tail.COUNTED:
            numbers += [line.number(0, (1 << 64) - 1) for _ in range(line.number(0, MAX_PDO_VALUES))]
        case Tail.MAPPING | Tail.EXTENDED_MAPPING:
            numbers += _transmission(line, tail)
            return None, b"", tuple(_mapped(line) for _ in range(line.number(0, MAX_PDO_VALUES)))
    return None, b"", ()


def _transmission(line: _Rest, tail: Tail) -> list[int]:
    """Return the transmission type, and for `tpdox` also inhibit time, event timer and SYNC start value."""
    word = line.word().lower()
    transmission, attached = _transmission_of(word)
    if tail is Tail.MAPPING:
        if attached is not None:
            raise _NotARequest
        return [transmission]
    inhibit = event = start = 0
    if transmission == EVENT:
        inhibit = line.number(0, 0xFFFF) if attached is None else attached
    if transmission >= RTR:
        event = line.number(0, 0xFFFF)
    else:
        start = line.number(0, 0xFF)
    return [transmission, inhibit, event, start]


def _transmission_of(word: str) -> tuple[int, int | None]:
    """Return the transmission type of a word, and the inhibit time that may stand behind `event`, as Lely CANopen has it."""
    if word == "rtr":
        return RTR, None
    for name, most in (("event", 0xFFFF), ("sync", MAX_SYNC)):
        if word.startswith(name):
            rest = word[len(name) :]
            number = integer_of(rest) if rest else None
            if name == "event" and not rest:
                return EVENT, None
            if number is None or not 0 <= number <= most:
                break
            return (EVENT, number) if name == "event" else (number, None)
    raise _refused(word, f"is no transmission type: event, rtr, sync0 to sync{MAX_SYNC}")


def _mapped(line: _Rest) -> MappedValue:
    word = line.word()
    index = subindex = 0
    number = integer_of(word)
    if number is not None:
        index, subindex = _bounded(word, number, 1, 0xFFFF), line.number(0, 0xFF)
        word = line.word()
    value_type = VALUE_TYPES.get(word.lower())
    if value_type is None or value_type.form not in _ONE_FRAME:
        raise _NotARequest
    return MappedValue(value_type, index, subindex)


def _further(tail: Tail, transmission: int, rest: tuple[int, ...]) -> list[int]:
    """Return the numbers that are typed behind a transmission type, of inhibit time, event timer and SYNC start value."""
    if tail is Tail.MAPPING or len(rest) != 3:
        return []
    if transmission == EVENT:
        return [rest[0], rest[1]]
    return [rest[1]] if transmission >= RTR else [rest[2]]


def _transmission_text(transmission: int) -> str:
    return {EVENT: "event", RTR: "rtr"}.get(transmission, f"sync{transmission}")


def _number_text(number: int, bounds: tuple[int, int]) -> str:
    """Return a number as it is usual: those of 16 and 32 bits, which are indices and COB-IDs, in hexadecimal."""
    return f"0x{_checked(number, bounds):X}" if bounds[1] >= 0xFFFF else str(_checked(number, bounds))


def _checked(number: int, bounds: tuple[int, int]) -> int:
    if not bounds[0] <= number <= bounds[1]:
        raise LocalProtocolError(f"{number} is outside {bounds[0]}..{bounds[1]}")
    return number
