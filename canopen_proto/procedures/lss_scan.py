"""Find devices by LSS (CiA 305): those without a node-ID by fastscan, any by a search through ranges of addresses.

**Fastscan.** The slaves without a node-ID answer questions about their address, bit by bit; an answer means 0, silence means 1.
So the lowest address is found first; a number that is known costs one question instead of 33.

    1 frame              is anybody there?
    32 + 1 frames        for each number of the address: its bits, then "is it this one?"; the others drop out
                         = 133 frames; 37 with vendor-ID, product code and revision known; 5 with a known address

The slave that is found is in "configuration" then, and takes part no longer, until all are sent to "waiting". So `survey` finds
all of them without writing anything. A device that comes a second time does take part: CANopenNode's slaves answer even when they
are selected, Lely's even with a node-ID. Then the survey ends, and says so.

**Nothing is believed that could be a late answer.** A late one counts for the next question and makes a wrong bit. Then
"is it this one?" remains unanswered, and the number is asked for again, each question with twice the window and all of it
(`Pace`). Silence counts after the whole window only; after an answer a guard time is enough for the others. At the end the slave
that should have been selected is asked for its identity. "Nobody" is believed the second time, and if also 0x4C is not answered.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, NMT, Frame, RoutingKey, routing_key
from canopen_proto.group import Group
from canopen_proto.lss.master import WINDOW, LssMaster, LssReply
from canopen_proto.lss.messages import CONFIRM, FIELD_NAMES, UNCONFIGURED, LssAddress, LssService, LssState, number_of
from canopen_proto.machine import MILLISECOND, SECOND, Event, Machine, Outbox, RequestId, Time
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.scan import Scanner
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, Request, act

NUMBERS: Final = len(FIELD_NAMES)
BITS: Final = 32
ALL_ONES: Final = 0xFFFF_FFFF
HIGHEST_BIT: Final = BITS - 1

GUARD: Final = 5 * MILLISECOND
"""After an answer, for those of other slaves: two frames at 125 kbit/s, and some time for a slave to look at its buffer."""
SLOWEST_FACTOR: Final = 4
"""The guard time is at least so many times the slowest answer that was seen."""
MAX_WINDOW: Final = 2 * SECOND
ATTEMPTS: Final = 4
"""How often a scan is begun, and a number asked for, before it is given up."""

Known = tuple[int | None, int | None, int | None, int | None]
"""The numbers of an address; None for one that is not known."""
NOTHING_KNOWN: Final[Known] = (None, None, None, None)


class LssError(ProcedureError):
    """LSS did not lead to its goal. The message says what was seen, and what to try."""


class LssFound(Event):
    """A survey found a device without a node-ID; it has the LSS address `address`."""

    __slots__ = ("address",)
    __match_args__ = ("node_id", "address")

    def __init__(self, node_id: int, address: LssAddress) -> None:
        self.node_id = node_id
        self.address = address


class LssProgress(Event):
    """A fastscan knows `done` of the four numbers of an address."""

    __slots__ = ("done",)
    __match_args__ = ("node_id", "done")

    def __init__(self, node_id: int, done: int) -> None:
        self.node_id = node_id
        self.done = done


class BootUpHeard(Event):
    """A node sent its boot-up frame."""

    __slots__ = ()


class LssTool(Group):
    """What LSS needs on one bus: the LSS master, ears for boot-ups, a Scanner. Attach it to a Network; detach it afterwards."""

    __slots__ = ("master", "scanner")

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.master = LssMaster(self.inner)
        self.scanner = Scanner(self.inner)
        for machine in (self.master, self.scanner, _BootUps(self.inner)):
            self._members.attach(machine)

    def reset_unconfigured(self, now: Time) -> None:
        """Tell the devices without a node-ID to reset their communication: Lely's wait for it after they got one."""
        self.inner.frames.append(Frame(NMT, bytes((NmtCommand.RESET_COMMUNICATION, UNCONFIGURED))))

    def reset(self, node_id: int, now: Time) -> None:
        """Tell a node to reset its communication: then it takes its pending node-ID."""
        self.inner.frames.append(Frame(NMT, bytes((NmtCommand.RESET_COMMUNICATION, node_id))))


class _BootUps(Machine):
    """Reports each boot-up frame."""

    __slots__ = ()

    def can_ids(self) -> Iterator[RoutingKey]:
        return (routing_key(ERROR_CONTROL + node_id) for node_id in range(1, MAX_NODE_ID + 1))

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data == b"\0":
            self.out.events.append(BootUpHeard(frame.can_id - ERROR_CONTROL))


@dataclass
class Pace:
    """How long the questions wait, ns. It adapts: to the slowest answer, and to answers that went missing.

    window: for silence. guard: after an answer, at least. slowest: the slowest answer so far.
    """

    window: Time = WINDOW
    guard: Time = GUARD
    slowest: Time = 0

    def learn(self, reply: LssReply) -> None:
        """Take the time of the answers to a question that waited its whole window."""
        self.slowest = max(self.slowest, reply.slowest)
        self.window = min(max(self.window, 2 * self.slowest), max(MAX_WINDOW, self.window))

    def slow_down(self) -> None:
        """Wait twice as long from now on, and after an answer as long as for silence: something was late or lost."""
        self.window = min(2 * self.window, max(MAX_WINDOW, self.window))
        self.guard = self.window

    @property
    def after_answer(self) -> Time:
        """The guard time."""
        return min(self.window, max(self.guard, SLOWEST_FACTOR * self.slowest))


def duration_of(known: Known = NOTHING_KNOWN, pace: Pace | None = None) -> tuple[Time, Time]:
    """Return the least and the greatest time for one device, in ns, if nothing is late or lost: all bits 0, and all 1."""
    pace = Pace() if pace is None else pace
    bits = BITS * sum(number is None for number in known)
    rest = (1 + NUMBERS + NUMBERS) * pace.window  # the first question, "is it this one?", and the identity
    return rest + bits * pace.after_answer, rest + bits * pace.window


# ---- single services as steps ----


def ask(tool: LssTool, command: Callable[[Time], RequestId]) -> Procedure[LssReply]:
    """Give a command of the LSS master; return its reply. A command that raises LocalProtocolError raises it here."""
    reply: LssReply = yield Request(tool.master, lambda now, urgent: command(now))
    return reply


def all_waiting(tool: LssTool) -> Procedure[None]:
    """Send all slaves to "waiting", twice: one that misses it would take what is meant for another."""
    for _ in range(2):
        yield from act(lambda now: tool.master.switch_global(LssState.WAITING, now))


def identity_of_selected(tool: LssTool, pace: Pace) -> Procedure[list[set[int]]]:
    """Return the numbers that the slaves in "configuration" give for each part of their address."""
    numbers = []
    for service in (
        LssService.INQUIRE_VENDOR, LssService.INQUIRE_PRODUCT, LssService.INQUIRE_REVISION, LssService.INQUIRE_SERIAL,
    ):  # fmt: skip
        reply = yield from ask(tool, lambda now, service=service: tool.master.inquire(service, now, window=pace.window))  # type: ignore[misc]
        numbers.append({number_of(answer) for answer in reply.answers})
    return numbers


def matches(numbers: Sequence[set[int]], addresses: Collection[LssAddress]) -> bool:
    """Return whether exactly the slaves with these addresses may have given these numbers."""
    return all(given == {address[place] for address in addresses} for place, given in enumerate(numbers))


# ---- fastscan ----


@dataclass
class Survey:
    """The devices without a node-ID. found: their addresses, the lowest first. again: one that took part a second time though it
    was selected, or has a node-ID: devices with higher addresses may be hidden behind it; None if there is none."""

    found: list[LssAddress] = field(default_factory=list)
    again: LssAddress | None = None


class _Unclear(Exception):
    """Another device is selected than the one that was found: begin the survey again."""


def survey(tool: LssTool, pace: Pace, known: Known = NOTHING_KNOWN, limit: int = MAX_NODE_ID) -> Procedure[Survey]:
    """Find the devices without a node-ID whose addresses have the numbers of `known`; at most `limit` of them. Writes nothing.

    Each is reported by LssFound. At the end, and when it is cancelled, all slaves are in "waiting". Raises LssError if the
    answers make no sense even when the questions wait long.
    """
    try:
        for _ in range(ATTEMPTS):
            yield from all_waiting(tool)
            try:
                result = yield from _survey_once(tool, pace, known, limit)
            except _Unclear:
                pace.slow_down()
                continue
            yield from all_waiting(tool)
            return result
    except Cancelled:
        yield from all_waiting(tool)
        raise
    yield from all_waiting(tool)
    raise LssError(
        f"the fastscan found addresses that no device has, {ATTEMPTS} times, with up to {pace.window / 1e6:g} ms for an answer. "
        "Answers come late or get lost, or another LSS master is at work. Try: less traffic on the bus (no SYNC); a longer window"
    )


def _survey_once(tool: LssTool, pace: Pace, known: Known, limit: int) -> Procedure[Survey]:
    result = Survey()
    while len(result.found) < limit:
        address = yield from fastscan(tool, pace, known, first=not result.found)
        if address is None:
            break
        if address in result.found:
            result.again = address
            break
        if not matches((yield from identity_of_selected(tool, pace)), (*result.found, address)):
            raise _Unclear
        result.found.append(address)
        yield from _report(tool, LssFound(0, address))
    return result


def fastscan(tool: LssTool, pace: Pace, known: Known = NOTHING_KNOWN, *, first: bool = True) -> Procedure[LssAddress | None]:
    """Find the lowest address among the devices without a node-ID, and select that device; None if there is none.

    known: numbers that the address has. first: no slave is selected yet; slaves in "configuration" do not take part. The
    caller has to check the result (`identity_of_selected`): a late answer may have been the last one. Raises LssError if
    nothing sensible comes.
    """
    last = absent = 0
    for _ in range(ATTEMPTS):
        if not (yield from _anybody(tool, pace, first)):
            return None
        numbers: list[int] = []
        for sub in range(NUMBERS):
            number = yield from _number(tool, pace, sub, known[sub])
            if number is None:
                break
            numbers.append(number)
            yield from _report(tool, LssProgress(0, sub + 1))
        if len(numbers) == NUMBERS:
            return LssAddress(*numbers)
        last = len(numbers)
        absent += known[last] is not None
        if absent > 1:
            return None  # twice nobody with that number
    raise LssError(
        f"devices without a node-ID are there, but none says yes to a {FIELD_NAMES[last]}, with up to "
        f"{pace.window / 1e6:g} ms for an answer. Answers come late or get lost. Try: less traffic on the bus; a longer window"
    )


def _anybody(tool: LssTool, pace: Pace, first: bool) -> Procedure[bool]:
    """Begin a fastscan; return whether anybody takes part. Silence is believed the second time."""
    for attempt in range(ATTEMPTS):
        reply = yield from _question(tool, pace, 0, CONFIRM, 0, 0, None)
        if reply.count:
            pace.learn(reply)
            return True
        if first:  # else those that are selected answer this
            known = yield from ask(tool, lambda now: tool.master.identify_non_configured(now, window=pace.window))
            if known.count:
                pace.slow_down()
                continue
        if attempt:
            return False
    raise LssError(
        "devices without a node-ID are there (they answer 0x4C), but do not take part in a fastscan, which not all devices know. "
        "Try: canopen lss identify with their vendor-ID and product code; or connect one at a time, and canopen lss set-id --only"
    )


def _question(
    tool: LssTool, pace: Pace, number: int, bit: int, sub: int, following: int, guard: Time | None
) -> Procedure[LssReply]:
    return (
        yield from ask(tool, lambda now: tool.master.fastscan(number, bit, sub, following, now, window=pace.window, guard=guard))
    )


def _number(tool: LssTool, pace: Pace, sub: int, known: int | None) -> Procedure[int | None]:
    """Find a number of the address; None if nobody is asked about this one any more."""
    following = sub + 1 if sub + 1 < NUMBERS else 0
    for _ in range(ATTEMPTS):
        number = known
        if number is None:
            number = 0
            for bit in range(HIGHEST_BIT, -1, -1):
                if not (yield from _question(tool, pace, number, bit, sub, sub, pace.after_answer)).count:
                    number |= 1 << bit
        if (yield from _question(tool, pace, number, 0, sub, following, None)).count:
            return number
        if not following and (yield from _has_serial(tool, pace, number)):
            return number  # the answer was lost, but it is selected
        pace.slow_down()
        if known is not None or number == ALL_ONES:
            return None
    return None


def _has_serial(tool: LssTool, pace: Pace, number: int) -> Procedure[bool]:
    reply = yield from ask(tool, lambda now: tool.master.inquire(LssService.INQUIRE_SERIAL, now, window=pace.window))
    return any(number_of(answer) == number for answer in reply.answers)


def _report(tool: LssTool, event: Event) -> Procedure[None]:
    yield from act(lambda now: tool.out.events.append(event))


# ---- a search for any device ----


def search(
    tool: LssTool,
    pace: Pace,
    vendor_id: int,
    product_code: int,
    revisions: tuple[int, int] = (0, ALL_ONES),
    serials: tuple[int, int] = (0, ALL_ONES),
) -> Procedure[list[LssAddress]]:
    """Find all devices of a type, with and without a node-ID, by halving the ranges (inclusive): six frames a step.

    Also for devices that know no fastscan. Each is reported by LssFound; two with one address count once.
    """
    found: list[LssAddress] = []
    waiting = [(revisions, serials)]
    while waiting:
        revision, serial = waiting.pop()
        reply = yield from ask(
            tool,
            lambda now, revision=revision, serial=serial: tool.master.identify(  # type: ignore[misc]
                vendor_id, product_code, revision, serial, now, window=pace.window, guard=pace.after_answer
            ),
        )
        if not reply.count:
            continue
        if revision[0] < revision[1]:
            waiting += [(half, serial) for half in reversed(_halves(revision))]
        elif serial[0] < serial[1]:
            waiting += [(revision, half) for half in reversed(_halves(serial))]
        else:
            found.append(LssAddress(vendor_id, product_code, revision[0], serial[0]))
            yield from _report(tool, LssFound(0, found[-1]))
    return found


def _halves(bounds: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    middle = (bounds[0] + bounds[1]) // 2
    return (bounds[0], middle), (middle + 1, bounds[1])
