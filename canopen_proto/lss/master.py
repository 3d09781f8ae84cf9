"""`LssMaster`: the master's side of the layer setting services (CiA 305).

Each command sends one service and returns a RequestId; an `LssReply` with that id follows, with all answers that came, none for
silence. LSS has no other sign of failure: a slave in the wrong state, or without the service, is silent. Two commands have no
answer and so no outcome: `switch_global` and `activate_bit_timing`.

**How long a command waits.** Several slaves may answer one frame at different times, and LSS has the lowest priority on the bus.

    window    while nothing has come: how long silence has to last to count
    guard     after the first answer: how long further ones are awaited, at most until the window ends; None: all of the window

An answer that comes when no command waits for it is an LssAnswerUnexpected: it was late, or another master is at work. One that
comes in the window of a later command cannot be told from that one's own: so procedures check what they find
(scan.py).

**One master on a bus** (CiA 305, from memory): slaves cannot tell two apart, and each would write to what the other has selected.
So the master hears the requests of others; `others` and `others_at` tell the last one. Procedures refuse to go on then (scan.py).

One command at a time: slaves drop a request that comes before they have answered the last one. A command that is given while
another one waits is a fault of the caller.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.lss.messages import (
    CIA_TABLE,
    FROM_MASTER,
    FROM_SLAVE,
    IDENTIFY,
    LENGTH,
    SELECT,
    LssAddress,
    LssService,
    LssState,
    fastscan_message,
    is_node_id,
    message,
    number_message,
)
from canopen_proto.machine import (
    MILLISECOND,
    NEVER,
    Event,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Outcome,
    RequestId,
    Time,
)

WINDOW: Final = 100 * MILLISECOND
"""For an answer: what Lely's master and CANopenNode's gateway wait."""
STORE_WINDOW: Final = 1000 * MILLISECOND
"""For the answer to "store": the device writes its memory first."""
FRAME_GAP: Final = 1 * MILLISECOND
"""Between the frames of one command (0x40..0x43, 0x46..0x4B): slaves with one receive buffer lose them back to back."""
MAX_ANSWERS: Final = 127
"""Kept of one command, as many as nodes fit a bus; further ones are counted only."""


class LssReply(Outcome):
    """The answers to a command; none for silence.

    service: the command specifier of its answers. answers: the whole data of each, in order. count: of all answers. slowest: ns
    from the last frame of the command to its last answer.

    request_id: the one that the command returned.
    """

    __match_args__ = ("node_id", "request_id", "service", "answers", "count", "slowest")

    def __init__(
        self, node_id: int, request_id: RequestId, service: LssService, answers: tuple[bytes, ...], count: int, slowest: Time
    ) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.service = service
        self.answers = answers
        self.count = count
        self.slowest = slowest


class LssAnswerUnexpected(Event):
    """A slave answered when no command waited for this: late, or asked by another master."""

    __match_args__ = ("node_id", "frame")

    def __init__(self, node_id: int, frame: Frame) -> None:
        self.node_id = node_id
        self.frame = frame


class LssMaster(Machine):
    """Sends LSS commands; see this module's text. frame_gap: ns; may be set. others: the last request of another LSS master;
    None: none was heard. others_at: when it came."""

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.frame_gap: Time = FRAME_GAP
        self.others: Frame | None = None
        self.others_at: Time = -NEVER
        self._request_id: RequestId = 0  # 0: no command waits
        self._queue: list[bytes] = []  # its frames that are still to be sent
        self._expected = LssService.IDENTIFIED
        self._window: Time = WINDOW
        self._guard: Time = NEVER
        self._until: Time = NEVER
        self._sent_at: Time = 0
        self._answers: list[bytes] = []
        self._count = 0
        self._slowest: Time = 0

    @property
    def is_busy(self) -> bool:
        """Whether a command waits for answers."""
        return self._request_id != 0

    def can_ids(self) -> Iterable[RoutingKey]:
        return (FROM_SLAVE, FROM_MASTER)

    # ---- commands without an answer ----

    def switch_global(self, state: LssState, now: Time) -> None:
        """Send all slaves into a state. A command that waits for answers keeps waiting."""
        self._send(message(LssService.SWITCH_GLOBAL, bytes((state,))))

    def activate_bit_timing(self, delay: Time, now: Time) -> None:
        """Let the slaves in "configuration" switch their bit rate after `delay` (ns, whole ms up to 65,535), and be silent for as
        long again. Raises LocalProtocolError for another delay."""
        milliseconds, rest = divmod(delay, MILLISECOND)
        if rest or not 0 <= milliseconds <= 0xFFFF:
            raise LocalProtocolError(f"a switch delay of {delay} ns: whole milliseconds are possible, 0..65535")
        self._send(message(LssService.ACTIVATE_BIT_TIMING, milliseconds.to_bytes(2, "little")))

    # ---- commands with an LssReply ----

    def select(self, address: LssAddress, now: Time, *, window: Time = WINDOW, guard: Time | None = None) -> RequestId:
        """Send the one slave with this address into "configuration". It answers SELECTED; it has to be in "waiting". window,
        guard: ns, see this module's text."""
        frames = [number_message(SELECT[place], number) for place, number in enumerate(address)]
        return self._ask(frames, LssService.SELECTED, window, guard, now)

    def configure_node_id(self, node_id: int, now: Time, *, window: Time = WINDOW, guard: Time | None = None) -> RequestId:
        """Set the pending node-ID of the selected slave: 1..127, or UNCONFIGURED; else LocalProtocolError. Every slave in
        "configuration" takes it: see that it is one. window, guard: ns, see this module's text."""
        if not is_node_id(node_id):
            raise LocalProtocolError(f"node-ID {node_id} is neither 1..127 nor 255 (none)")
        service = LssService.CONFIGURE_NODE_ID
        return self._ask([message(service, bytes((node_id,)))], service, window, guard, now)

    def configure_bit_timing(
        self, index: int, now: Time, *, table: int = CIA_TABLE, window: Time = WINDOW, guard: Time | None = None
    ) -> RequestId:
        """Set the pending bit rate of the selected slave: an entry of a table (BIT_RATES). Raises LocalProtocolError beyond
        0..255. index, table: 0..255. window, guard: ns, see this module's text."""
        if not (0 <= index <= 0xFF and 0 <= table <= 0xFF):
            raise LocalProtocolError(f"entry {index} of the table {table} of bit timings: both are 0..255")
        service = LssService.CONFIGURE_BIT_TIMING
        return self._ask([message(service, bytes((table, index)))], service, window, guard, now)

    def store(self, now: Time, *, window: Time = STORE_WINDOW, guard: Time | None = None) -> RequestId:
        """Let the selected slave store its pending node-ID and bit rate. window, guard: ns, see this module's text; the window is
        1 s by default."""
        return self._ask([message(LssService.STORE)], LssService.STORE, window, guard, now)

    def inquire(self, service: LssService, now: Time, *, window: Time = WINDOW, guard: Time | None = None) -> RequestId:
        """Ask the selected slave for a number of its identity (INQUIRE_VENDOR .. INQUIRE_SERIAL) or its node-ID
        (INQUIRE_NODE_ID): the active one; Lely's slaves tell the pending one while they have none. service: which of them, else
        LocalProtocolError. window, guard: ns, see this module's text."""
        if not LssService.INQUIRE_VENDOR <= service <= LssService.INQUIRE_NODE_ID:
            raise LocalProtocolError(f"{service.name} is no inquiry")
        return self._ask([message(service)], service, window, guard, now)

    def identify(
        self,
        vendor_id: int,
        product_code: int,
        revisions: tuple[int, int],
        serials: tuple[int, int],
        now: Time,
        *,
        window: Time = WINDOW,
        guard: Time | None = None,
    ) -> RequestId:
        """Ask whether slaves with such an address are there; each answers IDENTIFIED. The bounds are inclusive. vendor_id,
        product_code: UNSIGNED32. revisions, serials: least and greatest. window, guard: ns, see this module's text."""
        numbers = (vendor_id, product_code, *revisions, *serials)
        frames = [number_message(IDENTIFY[place], number) for place, number in enumerate(numbers)]
        return self._ask(frames, LssService.IDENTIFIED, window, guard, now)

    def identify_non_configured(self, now: Time, *, window: Time = WINDOW, guard: Time | None = None) -> RequestId:
        """Ask whether slaves without a node-ID are there; each answers NON_CONFIGURED. Some slaves lack this service. window,
        guard: ns, see this module's text."""
        return self._ask([message(LssService.IDENTIFY_NON_CONFIGURED)], LssService.NON_CONFIGURED, window, guard, now)

    def fastscan(
        self,
        number: int,
        bit_check: int,
        sub: int,
        following: int,
        now: Time,
        *,
        window: Time = WINDOW,
        guard: Time | None = None,
    ) -> RequestId:
        """Ask the slaves without a node-ID: do the bits 31 to `bit_check` of your number `sub` (0 vendor-ID .. 3 serial number)
        equal those of `number`? Each that says yes answers IDENTIFIED and goes on to the number `following`. With `bit_check` 0
        and a lower `following` it is selected. bit_check CONFIRM: all answer, and begin with number 0. window, guard: ns, see
        this module's text."""
        if not 0 <= number <= 0xFFFF_FFFF:
            raise LocalProtocolError(f"fastscan: {number} is outside 0..0xFFFFFFFF")
        frames = [fastscan_message(number, bit_check, sub, following)]
        return self._ask(frames, LssService.IDENTIFIED, window, guard, now)

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Stop waiting: LssReply follows at once, with the answers until now. Returns False if it does not wait any more.
        request_id: the one that the command returned."""
        if request_id != self._request_id or not self.is_busy:
            return False
        self._queue.clear()
        self._finish()
        return True

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        """Take an answer, or note a request of another master: our own are not received."""
        if frame.key == FROM_MASTER:
            self.others, self.others_at = frame, now
            return
        data = frame.data
        if len(data) != LENGTH:
            self.out.events.append(FrameIgnored(0, frame, f"an LSS frame has {LENGTH} bytes, not {len(data)}"))
            return
        if not self.is_busy or self._queue or data[0] != self._expected:
            self.out.events.append(LssAnswerUnexpected(0, frame))
            return
        self._count += 1
        if len(self._answers) < MAX_ANSWERS:
            self._answers.append(data)
        self._slowest = now - self._sent_at
        if self._guard < NEVER:
            self._arm(min(self._until, now + self._guard))

    def handle_timeout(self, now: Time) -> None:
        """Send the next frame of the command, or end its wait."""
        if now < self.deadline or not self.is_busy:
            return
        if self._queue:
            self._send_next(now)
        else:
            self._finish()

    def _ask(self, frames: Sequence[bytes], expected: LssService, window: Time, guard: Time | None, now: Time) -> RequestId:
        if self.is_busy:
            raise LocalProtocolError(f"an LSS command is waiting for answers ({self._expected.name})")
        self._request_id = self.out.next_request_id()
        self._expected = expected
        self._window, self._guard = window, NEVER if guard is None else guard
        self._answers = []
        self._count, self._slowest = 0, 0
        self._queue = list(frames)
        self._send_next(now)
        return self._request_id

    def _send_next(self, now: Time) -> None:
        self._send(self._queue.pop(0))
        if self._queue:
            self._arm(now + self.frame_gap)
            return
        self._sent_at, self._until = now, now + self._window
        self._arm(self._until)

    def _finish(self) -> None:
        request_id, self._request_id = self._request_id, 0
        self._arm(NEVER)
        self.out.events.append(LssReply(0, request_id, self._expected, tuple(self._answers), self._count, self._slowest))

    def _send(self, data: bytes) -> None:
        self.out.frames.append(Frame(FROM_MASTER, data))
