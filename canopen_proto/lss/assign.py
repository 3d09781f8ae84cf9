"""Give devices their node-IDs by LSS (CiA 305).

`assign_all` repeats three steps until no device without a node-ID is left, or only such as it is not to touch. One device is
finished before the next is searched, so what ends it early takes nothing away from those that have theirs:

    1. find      one device without a node-ID; nothing is written
    2. plan      choose its node-ID, by a table of addresses or in order; none that anybody on the bus has; then ask
    3. write     `give`: it gets its node-ID, stores it and boots

Devices that are left alone, or did not get theirs, are selected while the next one is searched: so they hide nobody. The search
for one device takes `Pace.device_limit` at most; then the assignment ends, and says so. Nobody is left behind without a word: a
device has its node-ID, or is in `done` or `left` with the reason, or `unfinished` says why there may be more.

`give` never writes to a device that it is not sure of. All slaves are sent to "waiting", one is selected by its address, and the
selected one is asked for its identity and node-ID: there has to be exactly one, with that address, and without a node-ID. Each
step that is not answered is repeated: all of them may be done twice. `Given` names a step that remains unanswered. A node-ID that
a device may have is not given to another one.

An interrupted assignment is simply begun again. The device that it was at then has no node-ID, as before, or was told to store
the new one: it never runs with one that only its next power-off would show to be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from canopen_proto.lss.messages import OK, UNCONFIGURED, LssAddress, LssService, LssState, error_text
from canopen_proto.lss.scan import (
    NOTHING_KNOWN,
    TRIES,
    BootUpHeard,
    Known,
    LssError,
    LssTool,
    Pace,
    all_waiting,
    ask,
    identity_of_selected,
    matches,
    released,
    survey,
)
from canopen_proto.machine import MILLISECOND, SECOND, Event, Time, check_node_id
from canopen_proto.manager.scan import NodeFound, scan
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, Wait, act, ask_for_time

NOBODY_AGREED: Final = "nobody agreed"
"""Why a device is left alone whose node-ID somebody did not want to be written."""

REFUSED: Final = "the device says"
"""Begins the reason of a device that has refused."""
SELECTIONS: Final = 5
"""How often a device is selected at most: each takes five frames, and one that is lost spoils it."""
CONFIRMATIONS: Final = 6
"""How often a selected device is asked at most: at a loss of 10 % one in five questions stays without its answer."""
BOOT_WINDOW: Final = 1 * SECOND
"""For the boot-up of a device that leaves LSS with its first node-ID."""
TWIN_WINDOW: Final = 50 * MILLISECOND
"""After a boot-up, for that of a second device with the same node-ID."""
LISTEN: Final = 200 * MILLISECOND
"""For nodes that have a node-ID that is to be given. They are asked by SDO, too."""

Choice = Callable[[LssAddress, Collection[int]], int | None]
"""Chooses the node-ID of a device: its address, the node-IDs that are taken -> 1..127, or None to leave it alone."""


@dataclass(frozen=True)
class Planned:
    """A device without a node-ID, and the one that it is to get."""

    address: LssAddress
    node_id: int


@dataclass(frozen=True)
class Given:
    """How it went with one device.

    written: it has confirmed its pending node-ID. stored: the same for its memory; None if that was not wanted. booted: it is
    there with the new node-ID. remark: for people, what failed, and what that means; "" if all is well. is_refused: the device
    itself has said no, so the same once more does not help.
    """

    address: LssAddress
    node_id: int
    written: bool = False
    stored: bool | None = None
    booted: bool = False
    remark: str = ""
    is_refused: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left to do."""
        return self.written and self.stored is not False and self.booted


class LssGiven(Event):
    """A device was given its node-ID, or was not: see `result`."""

    __match_args__ = ("node_id", "result")

    def __init__(self, node_id: int, result: Given) -> None:
        self.node_id = node_id
        self.result = result


@dataclass
class LssAssignment:
    """An assignment under way; see this module's text. choose: the node-IDs. known: numbers that all addresses have. store:
    whether the devices store their node-ID.

    done: what has been written. left: the devices that are left alone, and why. unfinished: why the search ended before nobody
    was left; "" if nobody is. remark: what else is to know; or "". taken: node-IDs that are in use, or may be.
    """

    tool: LssTool
    choose: Choice
    pace: Pace = field(default_factory=Pace)
    known: Known = NOTHING_KNOWN
    store: bool = True
    done: list[Given] = field(default_factory=list)
    left: dict[LssAddress, str] = field(default_factory=dict)
    taken: set[int] = field(default_factory=set)
    unfinished: str = ""
    remark: str = ""
    _aside: list[LssAddress] = field(default_factory=list)  # they have no part in the search
    _listen: Time = LISTEN

    def next_plan(self) -> Procedure[list[Planned]]:
        """Find the next device, and choose its node-ID. Empty: there is nothing to do any more. Writes nothing.

        Raises LssError if not even one device can be found.
        """
        while not self.unfinished:
            address = yield from self._next_device()
            if address is None:
                break
            node_id = yield from self._free_node_id(address)
            if node_id is not None:
                self.taken.add(node_id)
                return [Planned(address, node_id)]
            self.left[address] = "no node-ID for it is free, or it is not in the table"
            self._aside.append(address)
        return []

    def _next_device(self) -> Procedure[LssAddress | None]:
        """Find a device that was not met yet; None if there is none, or if the search ended: see `unfinished`."""
        while True:
            try:
                found = yield from survey(self.tool, self.pace, self.known, 1, self._aside)
            except LssError as failed:
                if not self.done and not self.left:
                    raise
                self.unfinished = str(failed)
                return None
            if found.again is not None:
                self.unfinished = (
                    f"{found.again} takes part in the fastscan though it is selected: devices with higher addresses are hidden "
                    "behind it. Try: canopen lss identify with their vendor-ID and product code"
                )
                return None
            if not found.found:
                return None
            (address,) = found.found
            if all(address != given.address for given in self.done):
                return address
            self._aside.append(address)
            self.remark = (
                f"{address} took part in the fastscan again, after it was given a node-ID. Some devices do so though "
                "they have one; or there are two devices with this address, or it has reset without having stored its node-ID"
            )

    def _free_node_id(self, address: LssAddress) -> Procedure[int | None]:
        node_id = self._choose(address)
        while node_id is not None and (yield from self._is_taken(node_id)):
            node_id = self._choose(address)
        return node_id

    def _is_taken(self, node_id: int) -> Procedure[bool]:
        listen, self._listen = self._listen, 0  # once is enough
        self.taken |= yield from nodes_there(self.tool, [node_id], listen)
        return node_id in self.taken

    def _choose(self, address: LssAddress) -> int | None:
        node_id = self.choose(address, self.taken)
        return None if node_id is None or node_id in self.taken else check_node_id(node_id)

    def write(self, plan: Sequence[Planned]) -> Procedure[list[Given]]:
        """Write a plan; each device is also reported by LssGiven."""
        written = []
        for planned in plan:
            result = yield from give(self.tool, self.pace, planned.address, planned.node_id, store=self.store)
            self.done.append(result)
            written.append(result)
            if not result.written:
                self._aside.append(planned.address)
        return written

    def put_aside(self, plan: Iterable[Planned]) -> None:
        """Search behind the devices of a plan from now on, as if they had their node-IDs: they are selected meanwhile."""
        self._aside += (planned.address for planned in plan)

    def leave(self, plan: Iterable[Planned]) -> None:
        """Leave the devices of a plan alone: nobody agreed to it."""
        for planned in plan:
            self.left[planned.address] = NOBODY_AGREED
            self._aside.append(planned.address)
            self.taken.discard(planned.node_id)


def assign_all(
    assignment: LssAssignment, agree: Callable[[Sequence[Planned]], bool] = lambda plan: True
) -> Procedure[LssAssignment]:
    """Give all devices without a node-ID theirs; return the assignment, with what became of each. agree: asked before a plan is
    written; if it says no, these devices are left alone."""
    while True:
        plan = yield from assignment.next_plan()
        if not plan:
            return assignment
        if agree(plan):
            yield from assignment.write(plan)
        else:
            assignment.leave(plan)


def in_order(node_ids: Iterable[int]) -> Choice:
    """Give the first of these node-IDs that is free."""
    wanted = [check_node_id(node_id) for node_id in node_ids]
    return lambda address, taken: next((node_id for node_id in wanted if node_id not in taken), None)


def by_table(table: Sequence[tuple[Known, int]]) -> Choice:
    """Give the node-ID of the first row whose numbers (None: any) are those of the address; None without such a row. table:
    address and node-ID of each row."""

    def choose(address: LssAddress, taken: Collection[int]) -> int | None:
        rows = [node_id for numbers, node_id in table if all(n in (None, own) for n, own in zip(numbers, address, strict=True))]
        return next((node_id for node_id in rows if node_id not in taken), None)

    return choose


def nodes_there(tool: LssTool, node_ids: Collection[int], listen: Time = LISTEN) -> Procedure[set[int]]:
    """Return which of these node-IDs somebody on the bus has: it was heard, or answers SDO. listen: ns, before the first
    question."""
    rows: list[NodeFound] = yield from scan(tool.scanner, node_ids, listen=listen)
    return {row.node_id for row in rows}


# ---- one device ----


def give(
    tool: LssTool, pace: Pace, address: LssAddress, node_id: int, *, present: int = UNCONFIGURED, store: bool = True
) -> Procedure[Given]:
    """Give the device with this address a node-ID; see this module's text. The result is also reported by LssGiven. pace: how
    long questions wait.

    present: the node-ID that it has; if it has one, it resets its communication, on our command. store: it keeps the node-ID
    without power. When it is cancelled before the device was told to store, the device gets its present node-ID back; in any case
    all slaves are sent to "waiting" first. If another LSS master is heard while the node-ID is written, the device gets none, and
    LssError is raised.
    """
    try:
        result = yield from _give(tool, pace, address, check_node_id(node_id), present, store)
    except (Cancelled, LssError):
        yield from all_waiting(tool)
        raise
    yield from act(lambda now: tool.out.events.append(LssGiven(0, result)))
    return result


def _give(tool: LssTool, pace: Pace, address: LssAddress, node_id: int, present: int, store: bool) -> Procedure[Given]:
    try:
        yield from select_only(tool, pace, address)
        own = yield from own_node_id(tool, pace)
    except LssNotSelectedError as failed:
        yield from all_waiting(tool)
        return Given(address, node_id, remark=f"nothing was written: {failed}")
    if own not in (present, node_id):
        yield from all_waiting(tool)
        who = "no node-ID" if own == UNCONFIGURED else f"node-ID {own}"
        return Given(address, node_id, remark=f"nothing was written: the device has {who}")
    try:
        error = yield from _confirmed(tool, pace, LssService.CONFIGURE_NODE_ID, node_id)
    except Cancelled:
        yield from ask_for_time(TRIES * pace.window + BOOT_WINDOW)
        yield from _take_back(tool, pace, present)
        raise
    except LssError:  # another master's device may have taken it, too: none may boot with it
        yield from _take_back(tool, pace, UNCONFIGURED)
        raise
    if error:
        yield from _take_back(tool, pace, present)
        yield from all_waiting(tool)
        return Given(address, node_id, remark=f"the node-ID was not confirmed ({error})", is_refused=REFUSED in error)
    stored, remark, is_refused = None, "", False
    if store:
        error = yield from _confirmed(tool, pace, LssService.STORE, node_id)
        stored, is_refused = not error, REFUSED in error
        sure = "is not stored" if is_refused else "is perhaps not stored"
        remark = f"the node-ID {sure} ({error}): the device loses it without power" if error else ""
    booted, why = yield from _start(tool, address, node_id, present)
    return Given(address, node_id, True, stored, booted, "; ".join(filter(None, (remark, why))), is_refused)


class LssNotSelectedError(ProcedureError):
    """It is not sure that exactly the device with this address is selected."""


def select_only(tool: LssTool, pace: Pace, address: LssAddress) -> Procedure[None]:
    """Select the device with this address, and make sure that no other is selected. Raises LssNotSelectedError. pace: how long
    questions wait.

    Then all slaves are to be sent to "waiting" (`all_waiting`), also when it fails or is cancelled: `released` does so.
    """
    seen: list[set[int]] = []
    for attempt in range(SELECTIONS):
        yield from all_waiting(tool)
        yield from ask(tool, lambda now: tool.master.select(address, now, window=pace.window, guard=pace.after_answer))
        seen = yield from identity_of_selected(tool, pace)
        if matches(seen, [address]):
            return
        if attempt:
            pace.slow_down(attempt)  # not one lost frame
    if not any(seen):
        raise LssNotSelectedError(f"no device with the address {address} answers")
    raise LssNotSelectedError(f"another device is selected beside {address}: is a second LSS master at work?")


def found_device(tool: LssTool, pace: Pace, address: LssAddress | None) -> Procedure[tuple[LssAddress, int]]:
    """Return the address of a device, and its node-ID or UNCONFIGURED. Nothing is written. pace: how long questions wait.
    address: None: it is the only one on the bus.

    However it ends, all slaves are in "waiting". Raises LssNotSelectedError if there is not exactly this one.
    """
    return (yield from released(tool, _found_device(tool, pace, address)))


def _found_device(tool: LssTool, pace: Pace, address: LssAddress | None) -> Procedure[tuple[LssAddress, int]]:
    if address is None:
        yield from all_waiting(tool)
        yield from act(lambda now: tool.master.switch_global(LssState.CONFIGURATION, now))
        numbers = yield from identity_of_selected(tool, pace)
        if not all(len(given) == 1 for given in numbers):
            seen = "several devices answer, or not all of its numbers came" if any(numbers) else "nobody answers"
            raise LssNotSelectedError(f"there is not exactly one device with LSS on the bus: {seen}")
        address = LssAddress(*(given.pop() for given in numbers))
    yield from select_only(tool, pace, address)
    return address, (yield from own_node_id(tool, pace))


def own_node_id(tool: LssTool, pace: Pace) -> Procedure[int]:
    """Return the node-ID of the selected device, or UNCONFIGURED. Raises LssNotSelectedError unless one device answers. pace: how
    long questions wait."""
    unanswered = 0
    for _ in range(CONFIRMATIONS):
        reply = yield from ask(tool, lambda now: tool.master.inquire(LssService.INQUIRE_NODE_ID, now, window=pace.window))
        unanswered += 1 - reply.count
        if unanswered < 0:  # one device gives one answer to each question, however late
            raise LssNotSelectedError(
                "two answers came: of two devices with this address (set another serial number, or connect one at a time), or of "
                "one, twice (then the same again)"
            )
        if reply.count == 1:
            return reply.answers[0][1]
    raise LssNotSelectedError("it does not say which node-ID it has")


def _confirmed(tool: LssTool, pace: Pace, service: LssService, node_id: int) -> Procedure[str]:
    """Write the node-ID, or store it; return "" if the one device has confirmed it, else why not."""
    unanswered = 0
    for _ in range(CONFIRMATIONS):
        if service is LssService.STORE:
            reply = yield from ask(tool, lambda now: tool.master.store(now, guard=pace.after_answer))
        else:
            reply = yield from ask(tool, lambda now: tool.master.configure_node_id(node_id, now, window=pace.window))
        errors = {error_text(service, answer[1], answer[2]) for answer in reply.answers if answer[1] != OK}
        if errors:
            return f"{REFUSED}: {', '.join(sorted(errors))}"
        unanswered += 1 - reply.count
        if unanswered < 0 and service is LssService.CONFIGURE_NODE_ID:  # as in `own_node_id`
            return "two answers came, of two devices or of one twice"
        if reply.count == 1 or (reply.count and service is LssService.STORE):
            return ""
    return "no answer: the device may have it all the same" if service is LssService.CONFIGURE_NODE_ID else "no answer"


def _take_back(tool: LssTool, pace: Pace, present: int) -> Procedure[None]:
    """Put the old pending node-ID back, before the device leaves "configuration"."""
    for _ in range(TRIES):
        reply = yield from ask(tool, lambda now: tool.master.configure_node_id(present, now, window=pace.window), alone=False)
        if reply.count:
            break


def _start(tool: LssTool, address: LssAddress, node_id: int, present: int) -> Procedure[tuple[bool, str]]:
    """Let the device leave LSS, and see that it boots with its node-ID; return whether it did, and a remark."""
    if present == node_id:
        yield from all_waiting(tool)
        return True, ""
    for attempt in range(TRIES):
        yield from all_waiting(tool)
        if present != UNCONFIGURED or attempt:  # Lely's devices wait for a reset after they got their first node-ID
            yield from act(lambda now: tool.reset(present, now))
        count = yield from _boot_ups(tool, node_id)
        if count > 1:
            return False, f"two boot-ups came with the node-ID {node_id}, of two devices (disconnect one) or of one twice"
        if count or node_id in (yield from nodes_there(tool, [node_id], listen=0)):
            return True, ""
    return False, (
        f"it has not booted with the node-ID {node_id}. It may need a reset: canopen nmt reset-comm --all, or power off and on"
    )


def _boot_ups(tool: LssTool, node_id: int) -> Procedure[int]:
    """Wait for the boot-up of a node; return how many came shortly after one another, 2 at most."""

    def is_it(event: Event) -> bool:
        return isinstance(event, BootUpHeard) and event.node_id == node_id

    count = 0
    for window in (BOOT_WINDOW, TWIN_WINDOW):
        if (yield Wait(window, tool, is_it, (BootUpHeard,))) is None:
            break
        count += 1
    return count
