"""`GatewayClient`: the client's side of the text protocol of CiA 309-3, without a socket.

    client = GatewayClient()
    sequence = client.send(GatewayRequest(GatewayCommand.READ, numbers=(0x1000, 0)), now)
    stream.send(client.take_bytes())
    client.receive(stream.receive(), now)
    for message in client.take_messages(): ...      # GatewayAnswered, GatewayEvent, GatewayOddLine

The client gives each request its number, and matches the answer by it. An answer with a number that nobody waits for (it came too
late, or twice) is no answer to anything: it is told as a `GatewayOddLine`. Events are told apart by how they begin. A gateway's
bytes never raise anything, and what is kept of them is bounded.

`GatewayLines`: bytes of a stream cut into lines, of bounded length.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from canopen_proto.gateway.answer import GatewayAnswer, GatewayEvent, parse_message
from canopen_proto.gateway.dialect import CANOPENNODE, Dialect
from canopen_proto.gateway.request import MAX_SEQUENCE, GatewayRequest
from canopen_proto.gateway.request_text import print_request
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Time

MAX_LINE: Final = 65_536
"""Bytes of a line: a value of 48 KiB as base64. A longer one is no request."""


class GatewayLines:
    """Cuts what comes into lines. too_long: a line was longer than `limit`; nothing is understood from there on.

    pending: bytes of a line that has no end yet.
    """

    def __init__(self, line_end: bytes = b"\n", limit: int = MAX_LINE) -> None:
        """line_end: what ends a line. limit: bytes of a line, without its end."""
        self._line_end = line_end
        self._limit = limit
        self._pending = bytearray()
        self.too_long = False

    @property
    def pending(self) -> int:
        """How many bytes wait for the end of their line."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes; return the lines that are whole now, without their ends. data: at most a few KiB at a time, of which
        what has no end yet is kept."""
        if self.too_long:
            return []
        searched = max(0, len(self._pending) - len(self._line_end) + 1)
        self._pending += data
        lines: list[bytes] = []
        begin = 0
        while (end := self._pending.find(self._line_end, max(begin, searched))) >= 0:
            if end - begin > self._limit:
                self._give_up()
                return lines
            lines.append(bytes(self._pending[begin:end]))
            begin = end + len(self._line_end)
        del self._pending[:begin]
        if len(self._pending) > self._limit + len(self._line_end) - 1:  # the last bytes may be the beginning of an end
            self._give_up()
        return lines

    def _give_up(self) -> None:
        self.too_long = True
        self._pending.clear()


MAX_OPEN: Final = 64
"""Requests that may wait for their answers: a gateway of CANopenNode has room for 2,000 bytes of them."""
MAX_MESSAGES: Final = 1024
"""What may wait to be taken; then the oldest events and odd lines are dropped, and counted."""
MAX_ANSWER: Final = 4 << 20
"""Bytes of one answer: a value of a megabyte, written as bytes in hexadecimal."""
PATIENCE: Final = 5 * SECOND
"""How long an answer may take, in ns: ten times what a gateway of CANopenNode waits for a node."""


@dataclass(frozen=True)
class GatewayAnswered:
    """The outcome of a request: each gets exactly one. answer: None if none came in time, or the connection ended."""

    request: GatewayRequest
    answer: GatewayAnswer | None


@dataclass(frozen=True)
class GatewayOddLine:
    """A line that is neither an event nor the answer to a request that waits. text: its beginning. is_late: it is an answer."""

    text: str
    is_late: bool = False


GatewayMessage: TypeAlias = GatewayAnswered | GatewayEvent | GatewayOddLine
"""What a client is told."""


class GatewayClient:
    """See this module's text. deadline: when the first of the requests that wait is given up, ns; NEVER if none waits.

    dropped: events and odd lines that nobody took in time. is_broken: the gateway sent a line without an end; nothing more is
    understood.
    """

    def __init__(self, dialect: Dialect = CANOPENNODE, *, patience: Time = PATIENCE) -> None:
        """dialect: of the gateway. patience: ns for an answer."""
        self.dialect = dialect
        self.patience = patience
        self.dropped = 0
        self._lines = GatewayLines(dialect.line_end, MAX_ANSWER)
        self._sequence = 0
        self._open: dict[int, tuple[GatewayRequest, Time]] = {}
        self._out = bytearray()
        self._messages: deque[GatewayMessage] = deque()
        self._untaken = 0  # answers among them, which are never dropped

    @property
    def deadline(self) -> Time:
        return min((deadline for _, deadline in self._open.values()), default=NEVER)

    @property
    def waiting(self) -> int:
        """How many requests wait for their answers."""
        return len(self._open)

    @property
    def is_broken(self) -> bool:
        return self._lines.too_long

    def send(self, request: GatewayRequest, now: Time) -> int:
        """Send a request; GatewayAnswered follows. Returns the number that it was given, whatever it had before.

        Raises LocalProtocolError for one that cannot be typed, if MAX_OPEN requests wait, or were answered and not taken, and
        once the gateway `is_broken`.
        """
        if self.is_broken:
            raise LocalProtocolError("the gateway sent a line without an end, and is not understood any more: connect again")
        if len(self._open) + self._untaken >= MAX_OPEN:
            raise LocalProtocolError(f"{MAX_OPEN} requests wait for their answers, or to be taken, already")
        sequence = self._next_sequence()
        numbered = replace(request, sequence=sequence)
        line = print_request(numbered, self.dialect)
        self._sequence = sequence
        self._open[sequence] = numbered, now + self.patience
        self._out += line + b"\r\n"
        return sequence

    def take_bytes(self) -> bytes:
        """Return what is to be sent now."""
        taken = bytes(self._out)
        self._out.clear()
        return taken

    def take_messages(self) -> list[GatewayMessage]:
        """Return what came since the last time, in order."""
        taken = list(self._messages)
        self._messages.clear()
        self._untaken = 0
        return taken

    def receive(self, data: bytes, now: Time) -> None:
        """Take bytes of the gateway."""
        for line in self._lines.feed(data):
            self._take(line)
        if self.is_broken:
            self.give_up()

    def handle_timeout(self, now: Time) -> None:
        """Give up the requests whose answers did not come in time."""
        for sequence in [each for each, (_, deadline) in self._open.items() if deadline <= now]:
            self._answered(sequence, None)

    def give_up(self) -> None:
        """Give all requests up: the connection has ended."""
        for sequence in list(self._open):
            self._answered(sequence, None)

    def _next_sequence(self) -> int:
        sequence = self._sequence
        while True:
            sequence = sequence + 1 if sequence < MAX_SEQUENCE else 1
            if sequence not in self._open:
                return sequence

    def _take(self, line: bytes) -> None:
        if not line.strip():
            return  # the answer to an empty line, which we did not send
        message = parse_message(line.rstrip(b"\r"))
        if isinstance(message, GatewayAnswer) and message.sequence in self._open:
            self._answered(message.sequence, message)
        elif isinstance(message, GatewayEvent):
            self._tell(message)
        else:
            self._tell(GatewayOddLine(line[:80].decode("latin-1"), isinstance(message, GatewayAnswer)))

    def _answered(self, sequence: int, answer: GatewayAnswer | None) -> None:
        request, _ = self._open.pop(sequence)
        self._messages.append(GatewayAnswered(request, answer))
        self._untaken += 1

    def _tell(self, message: GatewayMessage) -> None:
        if len(self._messages) >= MAX_MESSAGES:
            for place, waiting in enumerate(self._messages):
                if not isinstance(waiting, GatewayAnswered):
                    del self._messages[place]
                    break
            self.dropped += 1
        self._messages.append(message)
