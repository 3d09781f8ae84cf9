"""Chapter 3 of the conformance test: PDO: the values of its parameters, and when TPDOs are sent (CiA 301 v4.2.0, 7.2.2,
7.5.2.37).

The cases 3 to 8 set each TPDO up in one way and check it in Operational. 9 to 14 do the same in Stopped and 15 to 20 in
Pre-operational, where no PDO may come. The state is commanded each time. Before SYNCs are counted, the device's own SYNC is
stopped. pdo_mapping_cases.py has the cases that write to mappings.

Values may change by themselves meanwhile: an input that flaps, a device whose own code sets the value again. Each such change is
an event, and a TPDO with other data than the one before it tells one. It is counted apart, and the verdict says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Final, TypeAlias

from canopen_check.bench import PERIOD_TOLERANCE, REACTION_TIME, Bench
from canopen_check.case import Body, Case, for_each
from canopen_check.expectations import TimingError, expect_refusal
from canopen_check.pdo_tools import (
    PROFILE_EVENTS,
    Pdo,
    all_pdos,
    content_of,
    create,
    destroy,
    has,
    key_of,
    length_of,
    mapped_variable,
    set_up,
    usable,
)
from canopen_check.probe import FrameHeard
from canopen_check.sdo_cases import NO_OBJECT, SYNC_OVERFLOW, TOO_HIGH
from canopen_proto.cob_id import RESTRICTED_CAN_IDS
from canopen_proto.dictionary import Direction
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.indices import COB_ID_SYNC
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.settings import COB_ID, EVENT_TIMER, INHIBIT_TIME, MAX_PDOS, SYNC_START, TRANSMISSION_TYPE
from canopen_proto.procedures.steps import Procedure, current_time
from canopen_proto.verdict import ViolationError, does_not_apply, expect, expect_equal

ACYCLIC: Final = 0
ON_REQUEST: Final = 253
MANUFACTURER_EVENTS: Final = 254
EVENT_TYPES: Final = (MANUFACTURER_EVENTS, PROFILE_EVENTS)

EVENT_TIME: Final = 100 * MILLISECOND
PAUSE: Final = 3 * EVENT_TIME
"""The inhibit time with which a shorter event timer has to wait."""
RESERVED_TYPE: Final = 241

UNFORCED: Final = "no stimulus: no event could be caused"
RESTLESS: Final = "its values change by themselves: each change is an event too"
WATCHED: Final = 8
"""SYNCs, at uneven times, in which a value that changes by itself shows it."""

LEADS_TO: Final = {
    NmtState.PRE_OPERATIONAL: NmtCommand.ENTER_PRE_OPERATIONAL,
    NmtState.OPERATIONAL: NmtCommand.START,
    NmtState.STOPPED: NmtCommand.STOP,
}
"""The command that leads to a state from each other state."""


def scan(direction: Direction, bench: Bench) -> Procedure[str]:
    """3.1 and 3.2: each PDO has the communication parameter of the dictionary. No two valid PDOs have the same CAN-ID, and no
    CAN-ID is restricted. There are no more PDOs than described. If the test is strict, a reserved transmission type is refused
    (7.5.2.35, 7.5.2.37)."""
    pdos, owners = all_pdos(bench, direction), dict[int, Pdo]()

    def look(pdo: Pdo) -> Procedure[None]:
        places = [(pdo, subindex) for subindex in bench.dictionary.objects[pdo.communication].variables]
        yield from for_each(bench, places, partial(_look_at_parameter, bench))
        cob_id = bench.default(pdo.communication, COB_ID)
        if not cob_id & COB_ID_INVALID:
            if not cob_id & COB_ID_EXTENDED:
                is_restricted = any(cob_id & 0x1FFF_FFFF in each for each in RESTRICTED_CAN_IDS)
                expect(not is_restricted, f"{pdo} has the restricted CAN-ID 0x{cob_id & 0x7FF:03X}")
            other = owners.setdefault(key_of(bench, pdo), pdo)
            expect(other is pdo, f"{other} and {pdo} have the same CAN-ID")
        if bench.strict and has(bench, pdo, COB_ID) and has(bench, pdo, TRANSMISSION_TYPE):
            yield from destroy(bench, pdo)
            refusal = yield from bench.refusal_of_write(pdo.communication, TRANSMISSION_TYPE, RESERVED_TYPE)
            expect_refusal(refusal, TOO_HIGH, f"the reserved transmission type {RESERVED_TYPE} of {pdo}")

    yield from for_each(bench, pdos, look)
    beyond = pdos[-1].number + 1
    if beyond <= MAX_PDOS:
        index = Pdo(direction, beyond).communication
        expect_refusal((yield from bench.refusal_of_read(index, COB_ID)), NO_OBJECT, f"reading 0x{index:04X}:01")
    return counted(len(pdos), "PDO")


def _look_at_parameter(bench: Bench, place: tuple[Pdo, int]) -> Procedure[None]:
    pdo, subindex = place
    yield from bench.expect_default(pdo.communication, subindex, f"after a reset, {pdo}")


Look: TypeAlias = Callable[[Bench, Pdo, bool], Procedure[str | None]]
"""Checks that a TPDO comes as set up, or (False) not at all. Returns a remark if it could not check."""


def expect_data(bench: Bench, pdo: Pdo, heard: list[FrameHeard]) -> None:
    """Check the length of the frames that came."""
    for each in heard:
        expect_equal(len(each.frame.data), length_of(bench, pdo), f"the length of {pdo} ({each.frame})")


def in_state(bench: Bench, state: NmtState, pdo: Pdo, look: Look) -> Procedure[str | None]:
    """Lead the device to a state, check the TPDO, and always lead it back to a state in which the TPDO can be set up."""
    yield from bench.command(LEADS_TO[state])
    bench.probe.listen_also(key_of(bench, pdo))
    try:
        remark = yield from look(bench, pdo, state is NmtState.OPERATIONAL)
    except ViolationError:
        yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        raise
    yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    return remark


def answers_requests(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.3, 3.9, 3.15: a TPDO that allows remote requests by default answers them, in Operational only.

    If the test is strict, other TPDOs are made to allow them too, and a TPDO that forbids them must not answer.
    """
    count = 0

    def look(pdo: Pdo) -> Procedure[None]:
        nonlocal count
        if bench.strict or not bench.default(pdo.communication, COB_ID) & COB_ID_NO_RTR:
            for transmission_type in (PROFILE_EVENTS, ON_REQUEST):
                if (yield from set_up(bench, pdo, transmission_type, requests=True)):
                    count += 1
                    yield from in_state(bench, state, pdo, _look_for_answers)
        yield from destroy(bench, pdo)
        if bench.strict and (yield from create(bench, pdo)) is None:
            yield from in_state(bench, state, pdo, _look_for_no_answers)

    yield from for_each(bench, usable(bench, Direction.TPDO), look)
    if not count:
        does_not_apply("no TPDO allows remote requests")
    return counted(count, "time")


def _look_for_answers(bench: Bench, pdo: Pdo, live: bool) -> Procedure[None]:
    heard = yield from _heard_after_request(bench, pdo)
    own = _changes(heard) if live else 0
    expect_equal(len(heard) - own, int(live), f"the number of answers to a remote request of {pdo}")
    expect_data(bench, pdo, heard)


def _heard_after_request(bench: Bench, pdo: Pdo) -> Procedure[list[FrameHeard]]:
    key = key_of(bench, pdo)
    yield from bench.send_remote(key, length_of(bench, pdo))
    return (yield from bench.frames_within(key, REACTION_TIME))


def _look_for_no_answers(bench: Bench, pdo: Pdo, live: bool) -> Procedure[None]:
    heard = yield from _heard_after_request(bench, pdo)
    if not (live and _changes(heard)):  # else they may be its own events
        expect_equal(len(heard), 0, f"the number of answers to a remote request of {pdo}, which forbids them,")


def _each_tpdo(
    bench: Bench,
    state: NmtState,
    types: tuple[int, ...],
    look: Look,
    *,
    event_time: int = 0,
    inhibit_time: int = 0,
    sync_start: int = 0,
) -> Procedure[str]:
    times = (event_time, EVENT_TIMER), (inhibit_time, INHIBIT_TIME)
    needed = [subindex for value, subindex in (*times, (sync_start, SYNC_START)) if value]
    count, seen = 0, set[str]()

    def try_it(attempt: tuple[Pdo, int]) -> Procedure[None]:
        nonlocal count
        pdo, transmission_type = attempt
        if (
            yield from set_up(
                bench, pdo, transmission_type, event_time=event_time, inhibit_time=inhibit_time, sync_start=sync_start
            )
        ):
            count += 1
            seen.add((yield from in_state(bench, state, pdo, look)) or "")
            yield from destroy(bench, pdo)

    able = [pdo for pdo in usable(bench, Direction.TPDO) if all(has(bench, pdo, subindex) for subindex in needed)]
    yield from for_each(bench, [(pdo, transmission_type) for pdo in able for transmission_type in types], try_it)
    if not count:
        does_not_apply("no TPDO supports it")
    return "; ".join((f"{counted(count, 'time')}", *sorted(seen - {""})))


def event_driven(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.4, 3.10, 3.16: an event-driven TPDO is sent at its event."""
    return (yield from _each_tpdo(bench, state, EVENT_TYPES, _look_for_event))


def _look_for_event(bench: Bench, pdo: Pdo, live: bool) -> Procedure[str | None]:
    variable = mapped_variable(bench, pdo)
    bench.probe.forget(key_of(bench, pdo))
    if variable is None or not (yield from bench.stimulate(variable)):
        return UNFORCED
    heard = yield from bench.frames_within(key_of(bench, pdo), REACTION_TIME)
    own = _changes(heard)
    expect_equal(len(heard) - own, int(live), f"the number of {pdo} for one event")
    expect_data(bench, pdo, heard)
    return RESTLESS if own else None


def _changes(heard: list[FrameHeard]) -> int:
    """How many of these frames tell another value than the one before."""
    return sum(before.frame.data != after.frame.data for before, after in pairwise(heard))


def event_timer(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.5, 3.11, 3.17: an event-driven TPDO with an event timer is sent each time that the timer expires; if the test is strict,
    not before its inhibit time is over."""
    seen = yield from _each_tpdo(bench, state, (PROFILE_EVENTS,), _look_for_period, event_time=EVENT_TIME)
    if bench.strict and any(has(bench, pdo, INHIBIT_TIME) for pdo in usable(bench, Direction.TPDO)):
        yield from _each_tpdo(bench, state, (PROFILE_EVENTS,), _look_for_pause, event_time=EVENT_TIME, inhibit_time=PAUSE)
    return seen


def _look_for_pause(bench: Bench, pdo: Pdo, live: bool) -> Procedure[None]:
    heard = yield from bench.frames_within(key_of(bench, pdo), 4 * PAUSE)
    if not live or not has(bench, pdo, INHIBIT_TIME):
        return
    seen = f"{pdo}, with an event timer of {EVENT_TIME / MILLISECOND:g} ms and an inhibit time of {PAUSE / MILLISECOND:g} ms,"
    if len(heard) < 2:
        raise TimingError(f"{seen} came {counted(len(heard), 'time')} in {4 * PAUSE / SECOND:g} s")
    shortest = min(after.at - before.at for before, after in pairwise(heard))
    if shortest < PAUSE * (1 - PERIOD_TOLERANCE):
        raise TimingError(f"{seen} came again after {shortest / MILLISECOND:.0f} ms")


def _look_for_period(bench: Bench, pdo: Pdo, live: bool) -> Procedure[str | None]:
    before, variable = None, mapped_variable(bench, pdo)
    if live:
        if variable is not None and (yield from bench.stimulate(variable)):  # another value than 0 tells more
            yield from bench.sleep(REACTION_TIME)
        before = yield from content_of(bench, pdo)
        bench.probe.forget(key_of(bench, pdo))
    begin = yield from current_time()
    heard = yield from bench.frames_within(key_of(bench, pdo), 1 * SECOND)
    own = live and _changes(heard)
    if not live:
        expect_equal(len(heard), 0, f"the number of {pdo} by its event timer")
    elif own:  # they come besides, and may begin the time anew: it is the longest pause
        times = [begin, *(each.at for each in heard), (yield from current_time())]
        pause = max(after - before for before, after in pairwise(times))
        if pause > EVENT_TIME * (1 + PERIOD_TOLERANCE):
            text = f"{pdo} did not come for {pause / MILLISECOND:.0f} ms"
            raise TimingError(f"{text}; its event timer is {EVENT_TIME / MILLISECOND:g} ms ± {PERIOD_TOLERANCE:.0%}")
    else:
        bench.check_period(heard, begin, (yield from current_time()), EVENT_TIME, f"{pdo}")
    expect_data(bench, pdo, heard)
    if before is not None and not own and before == (yield from content_of(bench, pdo)):
        seen = heard[-1].frame.data
        bench.notes.beyond(seen == before, f"{pdo} carries {seen.hex(' ')}; its objects, read by SDO, are {before.hex(' ')}")
    return RESTLESS if own else None


def cyclic(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.6, 3.12, 3.18: a TPDO of type n is sent at each n-th SYNC. The count may begin with any SYNC."""
    yield from bench.silence_sync()
    each = yield from _each_tpdo(bench, state, (1,), partial(_look_for_nth_sync, 1))
    third = yield from _each_tpdo(bench, state, (3,), partial(_look_for_nth_sync, 3))
    return f"each SYNC: {each}; each third: {third}"


def _look_for_nth_sync(period: int, bench: Bench, pdo: Pdo, live: bool) -> Procedure[None]:
    came = yield from _after_syncs(bench, pdo, [None] * 2 * period)
    if live:
        expect(
            sum(came) == 2 and came[:period] == came[period:],
            f"{pdo} of type {period} came {came} times after {counted(len(came), 'SYNC')}",
        )
    else:
        expect_equal(sum(came), 0, f"the number of {pdo} after {counted(len(came), 'SYNC')}")


def _after_syncs(bench: Bench, pdo: Pdo, counters: Sequence[int | None]) -> Procedure[list[int]]:
    """Send SYNCs with these counters; return how many times the PDO came after each."""
    came = yield from _heard_after_syncs(bench, pdo, counters)
    return [len(heard) for heard in came]


def _heard_after_syncs(bench: Bench, pdo: Pdo, counters: Sequence[int | None]) -> Procedure[list[list[FrameHeard]]]:
    came = []
    for counter in counters:
        bench.probe.forget(key_of(bench, pdo))
        yield from bench.sync(counter)
        came.append(bench.probe.take_all(key_of(bench, pdo)))
        expect_data(bench, pdo, came[-1])
    return came


def acyclic(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.7, 3.13, 3.19: a TPDO of type 0 is sent at the SYNC after its event, and at no other."""
    yield from bench.silence_sync()
    return (yield from _each_tpdo(bench, state, (ACYCLIC,), _look_for_event_and_sync))


def _look_for_event_and_sync(bench: Bench, pdo: Pdo, live: bool) -> Procedure[str | None]:
    variable, key = mapped_variable(bench, pdo), key_of(bench, pdo)
    yield from bench.sync()  # entering Operational may be an event
    bench.probe.forget(key)
    if variable is None or not (yield from bench.stimulate(variable)):
        yield from bench.expect_silence(key, REACTION_TIME, f"{pdo} of type 0, without SYNC")
        return UNFORCED
    yield from bench.expect_silence(key, REACTION_TIME, f"{pdo} of type 0, before SYNC")
    first, second = yield from _heard_after_syncs(bench, pdo, [None, None])
    if live and len(first) == len(second) == 1 and (yield from _is_restless(bench, pdo, first + second)):
        return RESTLESS
    expect_equal([len(first), len(second)], [int(live), 0], f"the number of {pdo} at the SYNC behind its event, and at the next,")
    return None


def _is_restless(bench: Bench, pdo: Pdo, heard: list[FrameHeard]) -> Procedure[bool]:
    """Whether a TPDO that comes at each SYNC tells that its values change: then each may have an event of its own."""
    for number in range(WATCHED):
        if _changes(heard):
            return True
        yield from bench.sleep(number * 3 * MILLISECOND)
        (more,) = yield from _heard_after_syncs(bench, pdo, [None])
        heard = heard + more
    return _changes(heard) > 0


def sync_start_value(state: NmtState, bench: Bench) -> Procedure[str]:
    """3.8, 3.14, 3.20: a TPDO of type 2 with the SYNC start value 3 waits for that counter.

    The SYNC with that counter "is regarded as the first one" (7.5.2.37). So the TPDO is sent at the counters 4 and 6; or at 3, 5
    and 7 if the first one already triggers it, as in many devices. Both are right.
    """
    yield from bench.silence_sync()
    yield from bench.write(SYNC_OVERFLOW, 0, 10)
    return (yield from _each_tpdo(bench, state, (2,), _look_for_start, sync_start=3))


_FROM_THE_FIRST, _BY_THE_SECOND = [0, 0, 1, 0, 1, 0, 1], [0, 0, 0, 1, 0, 1, 0]


def _look_for_start(bench: Bench, pdo: Pdo, live: bool) -> Procedure[str | None]:
    came = yield from _after_syncs(bench, pdo, [1, 2, 3, 4, 5, 6, 7])
    if live and came == _BY_THE_SECOND:
        return "the count begins with the start value"
    expect_equal(came, _FROM_THE_FIRST if live else [0] * 7, f"the number of {pdo} at the SYNC counters 1 to 7")
    return None


_KINDS: Final[tuple[tuple[str, Callable[[NmtState, Bench], Procedure[str | None]], tuple[int, ...]], ...]] = (
    ("request TPDOs by RTR, if allowed", answers_requests, ()),
    ("configure TPDOs for event-driven mode", event_driven, ()),
    ("configure the event timer of TPDOs", event_timer, ()),
    ("configure TPDOs for SYNC (cyclic) mode", cyclic, (COB_ID_SYNC,)),
    ("configure TPDOs for SYNC (acyclic) mode", acyclic, (COB_ID_SYNC,)),
    ("configure TPDOs for SYNC (cyclic) mode and a SYNC start value", sync_start_value, (COB_ID_SYNC, SYNC_OVERFLOW)),
)
_STATES: Final = ((3, NmtState.OPERATIONAL), (9, NmtState.STOPPED), (15, NmtState.PRE_OPERATIONAL))


def _case(number: int, state: NmtState, kind: int) -> Case:
    title, body, needs = _KINDS[kind]
    run: Body = partial(body, state)
    return Case(f"3.{number}", f"PDO {number:02}", f"{state.name.capitalize()}: {title}", run, needs)


CASES: Final = (
    Case("3.1", "PDO 01", "Scan for RPDOs: the communication parameters", partial(scan, Direction.RPDO)),
    Case("3.2", "PDO 02", "Scan for TPDOs: the communication parameters", partial(scan, Direction.TPDO)),
    *(_case(first + kind, state, kind) for first, state in _STATES for kind in range(len(_KINDS))),
)
