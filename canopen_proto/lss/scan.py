"""Find devices by LSS (CiA 305): those without a node-ID by fastscan, any by a search through ranges of addresses.

**Fastscan.** The slaves without a node-ID answer questions about their address, bit by bit; an answer means 0, silence means 1.
So the lowest address is found first; a number that is known costs one question instead of 33.

    1 frame              is anybody there?
    32 + 1 frames        for each number of the address: its bits, then "is it this one?"; the others drop out
                         = 133 frames; 37 with vendor-ID, product code and revision known; 5 with a known address

The slave that is found is in "configuration" then, and takes part no longer, until all are sent to "waiting". So `survey` finds
all of them without writing anything. A device that comes a second time does take part: CANopenNode's slaves answer even when they
are selected, Lely's even with a node-ID. Then the survey ends, and says so.

**Nothing is believed that could be a late or a lost answer.** A late one counts for the next question, a lost one for silence:
both make a wrong bit. Then "is it this one?" remains unanswered. A question that every slave at that number answers, with a long
window, tells which it was (`_look_closer`): late answers make the window longer. After a lost one (`Pace.repeats`) each bit is
asked for both as 0 and as 1, until somebody says yes. So loss costs a window, and makes no wrong bit. Silence counts after the
whole window only; after an answer a guard time is enough for the others. At the end the slave that should have been selected is
asked for its identity.
"Nobody" is believed the third time, after two long windows, and if also 0x4C is not answered.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

from canopen_proto.frame import ALL_NODE_IDS, ERROR_CONTROL, MAX_NODE_ID, NMT, Frame, RoutingKey, routing_key
from canopen_proto.group import Group
from canopen_proto.lss.master import WINDOW, LssMaster, LssReply
from canopen_proto.lss.messages import CONFIRM, FIELD_NAMES, INQUIRE, LssAddress, LssService, LssState, number_of
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Machine, Outbox, RequestId, Time
from canopen_proto.manager.scan import Scanner
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, Request, act, current_time

T = TypeVar("T")

NUMBERS: Final = len(FIELD_NAMES)
BITS: Final = 32
ALL_ONES: Final = 0xFFFF_FFFF
HIGHEST_BIT: Final = BITS - 1

GUARD: Final = 5 * MILLISECOND
"""After an answer, for those of other slaves: two frames at 125 kbit/s, and some time for a slave to look at its buffer."""
SLOWEST_FACTOR: Final = 4
"""The guard time is at least so many times the slowest answer that was seen."""
MAX_WINDOW: Final = 2 * SECOND
PATIENCE: Final = 10
"""So many windows is a late answer awaited where only that can tell late from lost."""
DEVICE_LIMIT: Final = 120 * SECOND
"""To find one device: a hundred times what a quick bus needs, nine times what the standard window needs."""
TRIES: Final = 3
"""How often an unanswered step is sent; and a silent question, once answers got lost."""
ROUNDS: Final = 5
"""How often a bit is asked for, as 0 and as 1, once answers got lost."""
UNLIKELY: Final = 3
"""After so many failures of one thing, late answers are a likelier cause than lost ones."""
OTHERS_GONE: Final = 5 * SECOND
"""Another LSS master that was not heard for this long has ended. It may wait a second or two for an answer."""

ATTEMPTS: Final = 8
"""How often a scan is begun, and a number asked for, before it is given up."""

Known = tuple[int | None, int | None, int | None, int | None]
"""The numbers of an address; None for one that is not known."""
NOTHING_KNOWN: Final[Known] = (None, None, None, None)


class LssError(ProcedureError):
    """LSS did not lead to its goal. The message says what was seen, and what to try."""


class LssTimeoutError(LssError):
    """The time for one device is over."""


class LssFound(Event):
    """A survey found a device without a node-ID; it has the LSS address `address`."""

    __match_args__ = ("node_id", "address")

    def __init__(self, node_id: int, address: LssAddress) -> None:
        self.node_id = node_id
        self.address = address


class LssProgress(Event):
    """A fastscan knows `done` of the four numbers of an address."""

    __match_args__ = ("node_id", "done")

    def __init__(self, node_id: int, done: int) -> None:
        self.node_id = node_id
        self.done = done


class BootUpHeard(Event):
    """A node sent its boot-up frame."""


class LssTool(Group):
    """What LSS needs on one bus: the LSS master, ears for boot-ups, a Scanner. Attach it to a Network; detach it afterwards."""

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.master = LssMaster(self.inner)
        self.scanner = Scanner(self.inner)
        for machine in (self.master, self.scanner, _BootUps(self.inner)):
            self._members.attach(machine)

    def reset(self, node_id: int, now: Time) -> None:
        """Tell a node to reset its communication: then it takes its pending node-ID. UNCONFIGURED: all that have none."""
        self.inner.frames.append(Frame(NMT, bytes((NmtCommand.RESET_COMMUNICATION, node_id))))


class _BootUps(Machine):
    """Reports each boot-up frame."""

    def can_ids(self) -> Iterator[RoutingKey]:
        return (routing_key(ERROR_CONTROL + node_id) for node_id in ALL_NODE_IDS)

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data == b"\0":
            self.out.events.append(BootUpHeard(frame.can_id - ERROR_CONTROL))


@dataclass
class Pace:
    """How long the questions wait, ns. It adapts: to the slowest answer, and to answers that went missing.

    window: for silence. guard: after an answer, at least. slowest: the slowest answer so far. repeats: how often a silent
    question is asked, 1 to TRIES. device_limit: the longest time to find one device; `until` is its end: then LssTimeoutError.
    """

    window: Time = WINDOW
    guard: Time = GUARD
    slowest: Time = 0
    repeats: int = 1
    device_limit: Time = DEVICE_LIMIT
    until: Time = NEVER

    def learn(self, reply: LssReply) -> None:
        """Take the time of the answers to a question that waited its whole window."""
        self.slowest = max(self.slowest, reply.slowest)
        self.window = min(max(self.window, 2 * self.slowest), max(MAX_WINDOW, self.window))

    def slow_down(self, failures: int) -> None:
        """Be more careful: something was late or lost. Repeat silent questions. If one thing has failed more often than loss
        makes likely (`failures`: how often before), wait twice as long, and after an answer as long as for silence."""
        self.repeats = min(self.repeats + 1, TRIES)
        if failures >= UNLIKELY:
            self.window = min(2 * self.window, max(MAX_WINDOW, self.window))
            self.guard = self.window

    @property
    def patience(self) -> Time:
        """A window for answers that are later than all before."""
        return max(self.window, min(PATIENCE * self.window, MAX_WINDOW))

    @property
    def after_answer(self) -> Time:
        """The guard time."""
        return min(self.window, max(self.guard, SLOWEST_FACTOR * self.slowest))


def duration_of(known: Known = NOTHING_KNOWN, pace: Pace | None = None) -> tuple[Time, Time]:
    """Return the least and the greatest time for one device, in ns, if nothing is late or lost: all bits 0, and all 1. known:
    numbers of the address that are known. pace: None: that of a first try."""
    pace = Pace() if pace is None else pace
    bits = BITS * sum(number is None for number in known)
    rest = (1 + NUMBERS + NUMBERS) * pace.window  # the first question, "is it this one?", and the identity
    return rest + bits * pace.after_answer, rest + bits * pace.window


# ---- single services as steps ----


def ask(tool: LssTool, command: Callable[[Time], RequestId], *, alone: bool = True) -> Procedure[LssReply]:
    """Give a command of the LSS master; return its reply. A command that raises LocalProtocolError raises it here.

    Raises LssError, before it or behind it, if another LSS master is heard. alone: False: give it all the same, to undo a write.
    """
    if alone:
        yield from require_alone(tool)
    reply: LssReply = yield Request(tool.master, lambda now, urgent: command(now))
    if alone:
        yield from require_alone(tool)
    return reply


def require_alone(tool: LssTool) -> Procedure[None]:
    """Raise LssError if another LSS master was heard within OTHERS_GONE."""
    age = (yield from current_time()) - tool.master.others_at
    if age <= OTHERS_GONE:
        raise LssError(
            f"another LSS master is at work on this bus: it sent {tool.master.others} {age / MILLISECOND:.0f} ms ago. Each of "
            "two masters writes to the devices that the other has selected, so nothing more was written. Try: wait until the "
            "other program has ended, or end it; then begin again"
        )


def all_waiting(tool: LssTool) -> Procedure[None]:
    """Send all slaves to "waiting", twice: one that misses it would take what is meant for another."""
    for _ in range(2):
        yield from act(lambda now: tool.master.switch_global(LssState.WAITING, now))


def released(tool: LssTool, work: Procedure[T]) -> Procedure[T]:
    """Run a procedure that selects slaves; return its result. However it ends, all slaves are in "waiting" then: one that stays
    selected takes what is meant for others, and no fastscan finds it."""
    try:
        result = yield from work
    except (Cancelled, Exception):
        yield from all_waiting(tool)
        raise
    yield from all_waiting(tool)
    return result


def identity_of_selected(tool: LssTool, pace: Pace) -> Procedure[list[set[int]]]:
    """Return the numbers that the slaves in "configuration" give for each part of their address. pace: how long questions
    wait."""
    numbers: list[set[int]] = []
    for service in INQUIRE:
        given: set[int] = set()
        for _ in range(TRIES):
            reply = yield from ask(tool, lambda now, service=service: tool.master.inquire(service, now, window=pace.window))  # type: ignore[misc]
            given = {number_of(answer) for answer in reply.answers}
            if given:
                break
        numbers.append(given)
        if not given:
            return [*numbers, *(set() for _ in range(NUMBERS - len(numbers)))]
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


def survey(
    tool: LssTool,
    pace: Pace,
    known: Known = NOTHING_KNOWN,
    limit: int = MAX_NODE_ID,
    aside: Collection[LssAddress] = (),
) -> Procedure[Survey]:
    """Find the devices without a node-ID whose addresses have the numbers of `known`; at most `limit` of them. Writes nothing.

    aside: devices that do not take part: they are selected first. Each device is reported by LssFound. At the end, and when it is
    cancelled, all slaves are in "waiting". Raises LssError if the answers make no sense even when the questions wait long, and
    LssTimeoutError if one device takes longer than `pace` allows.
    """
    result = Survey()
    pace.until = (yield from current_time()) + pace.device_limit
    try:
        for attempt in range(ATTEMPTS):
            yield from all_waiting(tool)
            try:
                yield from _survey_once(tool, pace, known, limit, (*aside, *result.found), result)
            except _Unclear:
                pace.slow_down(attempt)
                continue
            yield from all_waiting(tool)
            return result
    except (Cancelled, LssError):
        yield from all_waiting(tool)
        raise
    finally:
        pace.until = NEVER
    yield from all_waiting(tool)
    raise LssError(
        f"the fastscan found addresses that no device has, {ATTEMPTS} times, with up to {pace.window / 1e6:g} ms for an answer. "
        "Answers come late or get lost, or another LSS master is at work. Try: less traffic on the bus (no SYNC); a longer window"
    )


def _survey_once(
    tool: LssTool, pace: Pace, known: Known, limit: int, aside: Collection[LssAddress], result: Survey
) -> Procedure[None]:
    selected: list[LssAddress] = []
    for each in aside:
        selected += [each] * (yield from _is_selected(tool, pace, each))
    while len(result.found) < limit:
        address = yield from fastscan(tool, pace, known, first=not selected)
        if address is None:
            break
        if address in selected:
            result.again = address
            break
        selected.append(address)
        if address in aside or not matches((yield from identity_of_selected(tool, pace)), selected):
            raise _Unclear
        result.found.append(address)
        pace.until = (yield from current_time()) + pace.device_limit
        yield from _report(tool, LssFound(0, address))


def _is_selected(tool: LssTool, pace: Pace, address: LssAddress) -> Procedure[bool]:
    """Select a device beside others; return whether it has answered. One that is not there does not answer."""
    for _ in range(TRIES):
        reply = yield from ask(tool, lambda now: tool.master.select(address, now, window=pace.window, guard=pace.after_answer))
        if reply.count:
            return True
    return False


def fastscan(tool: LssTool, pace: Pace, known: Known = NOTHING_KNOWN, *, first: bool = True) -> Procedure[LssAddress | None]:
    """Find the lowest address among the devices without a node-ID, and select that device; None if there is none.

    known: numbers that the address has. first: no slave is selected yet; slaves in "configuration" do not take part. The
    caller has to check the result (`identity_of_selected`): a late answer may have been the last one. Raises LssError if
    nothing sensible comes, and LssTimeoutError at the end of the time of `pace`.
    """
    last = absent = 0
    for _ in range(ATTEMPTS):
        if not (yield from _anybody(tool, pace, first)):
            return None
        numbers: list[int] = []
        for sub in range(NUMBERS):
            try:
                number = yield from _number(tool, pace, sub, known[sub])
            except LssTimeoutError:
                raise LssTimeoutError(_time_over(numbers)) from None
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


def _time_over(numbers: Sequence[int]) -> str:
    """Say what is known of the device that was being searched."""
    known = ", ".join(f"{name} 0x{number:X}" for name, number in zip(FIELD_NAMES, numbers, strict=False))
    return (
        f"the time for one device is over before its address was known ({known or 'nothing of it is known'}): answers get lost, "
        "or come late. Try: less traffic on the bus; its known numbers (--vendor, --product); a longer --limit"
    )


def _anybody(tool: LssTool, pace: Pace, first: bool) -> Procedure[bool]:
    """Begin a fastscan; return whether anybody takes part. Silence is believed the third time, after two long windows."""
    known = False
    for silent in range(1, 1 + ATTEMPTS + TRIES):
        believed = TRIES * pace.repeats
        window = pace.patience if silent >= believed - 1 else pace.window  # one patient question may be lost
        reply = yield from _question(tool, pace, 0, CONFIRM, 0, 0, None, window)
        if reply.count:
            pace.learn(reply)
            return True
        if first:  # else those that are selected answer this
            others = yield from ask(tool, lambda now, window=window: tool.master.identify_non_configured(now, window=window))  # type: ignore[misc]
            if others.count:
                pace.learn(others)
                known = True
        if silent >= believed and not known:
            return False
    if not known:
        return False
    raise LssError(
        "devices without a node-ID are there (they answer 0x4C), but do not take part in a fastscan, which not all devices know. "
        "Try: canopen lss identify with their vendor-ID and product code; or one device at a time, and canopen lss set-id only ID"
    )


def _question(
    tool: LssTool, pace: Pace, number: int, bit: int, sub: int, following: int, guard: Time | None, window: Time = 0
) -> Procedure[LssReply]:
    """Ask the slaves without a node-ID. window: that of `pace` if it is 0. Raises LssTimeoutError."""
    if pace.until < NEVER and (yield from current_time()) >= pace.until:
        raise LssTimeoutError(_time_over(()))
    reply = yield from ask(
        tool, lambda now: tool.master.fastscan(number, bit, sub, following, now, window=window or pace.window, guard=guard)
    )
    return reply


def _number(tool: LssTool, pace: Pace, sub: int, known: int | None) -> Procedure[int | None]:
    """Find a number of the address; None if nobody is asked about this one any more."""
    following = sub + 1 if sub + 1 < NUMBERS else 0
    for attempt in range(ATTEMPTS):
        number = known if known is not None else (yield from _bits(tool, pace, sub))
        tries = TRIES if known is not None else pace.repeats
        if number is not None and (yield from _is_it(tool, pace, number, sub, following, tries)):
            return number
        if known is not None or not (yield from _look_closer(tool, pace, sub, attempt)):
            return None
    return None


def _bits(tool: LssTool, pace: Pace, sub: int) -> Procedure[int | None]:
    """Find a number bit by bit; None as soon as nobody says yes to what was found until then."""
    number = 0
    for bit in range(HIGHEST_BIT, -1, -1):
        found = yield from _with_bit(tool, pace, number, bit, sub)
        if found is None:
            return None
        number = found
    return number


def _with_bit(tool: LssTool, pace: Pace, number: int, bit: int, sub: int) -> Procedure[int | None]:
    """Return `number` with this bit as a slave has it; None if nobody says yes. A repetition changes nothing there.

    As long as nothing was lost, silence is a 1. Later a 1 is asked for, too: loss costs a window, and no bit is wrong.
    """
    one = number | 1 << bit
    if pace.repeats == 1:
        return number if (yield from _says_yes(tool, pace, number, bit, sub)) else one
    for _ in range(ROUNDS):
        for asked in (number, one):
            if (yield from _says_yes(tool, pace, asked, bit, sub)):
                return asked
    return None


def _says_yes(tool: LssTool, pace: Pace, number: int, bit: int, sub: int) -> Procedure[bool]:
    """Return whether any slave says that its bits down to this one are those of `number`."""
    reply = yield from _question(tool, pace, number, bit, sub, sub, pace.after_answer)
    return reply.count > 0


def _is_it(tool: LssTool, pace: Pace, number: int, sub: int, following: int, tries: int) -> Procedure[bool]:
    """Ask "is it this one?". A slave that has said yes goes on: if its answer was lost, it shows so by where it is."""
    for _ in range(tries):
        if (yield from _question(tool, pace, number, 0, sub, following, None)).count:
            return True
        if following:
            if (yield from _is_anybody_at(tool, pace, following, pace.window)):
                return True
        elif (yield from _has_serial(tool, pace, number)):
            return True  # it is selected
    return False


def _is_anybody_at(tool: LssTool, pace: Pace, sub: int, window: Time) -> Procedure[bool]:
    """Return whether a slave is asked about this number: its highest bit is 0 or 1. Learns how late the answers are."""
    for number in (0, 1 << HIGHEST_BIT):
        reply = yield from _question(tool, pace, number, HIGHEST_BIT, sub, sub, None, window)
        if reply.count:
            pace.learn(reply)
            return True
    return False


def _look_closer(tool: LssTool, pace: Pace, sub: int, attempt: int) -> Procedure[bool]:
    """Find out why a number was wrong: answers were late, or lost. Return whether anybody is still asked about it."""
    window, slowest = pace.window, max(pace.slowest, pace.guard)
    for _ in range(TRIES):
        if (yield from _is_anybody_at(tool, pace, sub, pace.patience)):
            if pace.window == window and pace.slowest <= slowest:  # not late, so lost
                pace.slow_down(attempt)
            return True
    return False


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
    """Find all devices of a type, with and without a node-ID, by halving the ranges (inclusive): six frames a step. vendor_id,
    product_code: UNSIGNED32. revisions, serials: least and greatest.

    Also for devices that know no fastscan. Each is reported by LssFound; two with one address count once. Raises LssError if a
    range has a device and neither half of it has: answers come late, or get lost.
    """
    found: list[LssAddress] = []
    if not (yield from _is_in(tool, pace, vendor_id, product_code, revisions, serials)):
        return found
    waiting = [(revisions, serials)]  # each has a device
    while waiting:
        revision, serial = waiting.pop()
        if revision[0] == revision[1] and serial[0] == serial[1]:
            found.append(LssAddress(vendor_id, product_code, revision[0], serial[0]))
            yield from _report(tool, LssFound(0, found[-1]))
            continue
        if revision[0] < revision[1]:
            halves = [(half, serial) for half in _halves(revision)]
        else:
            halves = [(revision, half) for half in _halves(serial)]
        for attempt in range(ATTEMPTS):
            there: list[tuple[tuple[int, int], tuple[int, int]]] = []
            for half in halves:
                there += [half] * (yield from _is_in(tool, pace, vendor_id, product_code, *half))
            if there:
                break
            pace.slow_down(attempt)
        else:
            raise LssError(
                "a device answers in a range of revisions or serial numbers, and in neither half of it, with up to "
                f"{pace.window / 1e6:g} ms for an answer. Answers come late or get lost. Try: less traffic on the bus; a longer "
                "window"
            )
        waiting += reversed(there)
    return found


def _is_in(
    tool: LssTool, pace: Pace, vendor_id: int, product_code: int, revisions: tuple[int, int], serials: tuple[int, int]
) -> Procedure[bool]:
    """Return whether a device of this type answers in these ranges. Silence is believed the second time, or later."""
    for _ in range(1 + pace.repeats):
        reply = yield from ask(
            tool,
            lambda now: tool.master.identify(
                vendor_id, product_code, revisions, serials, now, window=pace.window, guard=pace.after_answer
            ),
        )
        if reply.count:
            return True
    return False


def _halves(bounds: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    middle = (bounds[0] + bounds[1]) // 2
    return (bounds[0], middle), (middle + 1, bounds[1])
