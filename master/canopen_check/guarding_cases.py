"""Chapters 7.1 and 7.2 of the conformance test: node guarding, life guarding, and their place beside the heartbeat
(CiA 301 v4.2.0, 7.2.8.3.2, 7.5.2.11, 7.5.2.12).

A device has one or the other: while it produces a heartbeat, it does not answer guarding requests.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from canopen_check.bench import ANSWER_TIME, PERIOD_TOLERANCE, REACTION_TIME, Bench
from canopen_check.case import Case
from canopen_check.emergencies import code_of, errors_heard, expect_no_error, next_error
from canopen_check.expectations import TimingError, some
from canopen_check.heartbeat_cases import EMCY_CONNECTION_LOST, check_not_early, highest
from canopen_check.heartbeat_cases import PRODUCER as HEARTBEAT
from canopen_proto.explained import counted
from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, RoutingKey
from canopen_proto.guarding import TOGGLE
from canopen_proto.indices import COB_ID_EMERGENCY, GUARD_TIME, LIFE_TIME_FACTOR
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures.steps import Procedure, current_time
from canopen_proto.verdict import expect, expect_equal

PERIOD: Final = 100 * MILLISECOND
FACTOR: Final = 3


def _configure(bench: Bench, period: int, factor: int) -> Procedure[None]:
    yield from bench.write(GUARD_TIME, 0, period // MILLISECOND)
    yield from bench.write(LIFE_TIME_FACTOR, 0, factor)


def request(bench: Bench) -> Procedure[int]:
    """Send a guarding request; return the byte of the answer."""
    key = bench.error_control_key
    bench.probe.forget(key)
    yield from bench.send_remote(key, 1)
    heard = yield from bench.next_frame(key, ANSWER_TIME, "the answer to a guarding request")
    expect_equal(len(heard.frame.data), 1, f"the length of a guarding answer ({heard.frame})")
    return heard.frame.data[0]


def _without_heartbeat(bench: Bench) -> Procedure[None]:
    if bench.has_heartbeat:
        yield from bench.write(HEARTBEAT, 0, 0)


def read_objects(bench: Bench) -> Procedure[None]:
    """7.1: both objects have their defaults."""
    for index in (GUARD_TIME, LIFE_TIME_FACTOR):
        yield from bench.expect_default(index, 0, "after a reset")


def answer(bench: Bench) -> Procedure[None]:
    """7.2: the answer has the NMT state."""
    yield from _without_heartbeat(bench)
    state = (yield from request(bench)) & ~TOGGLE
    expect_equal(state, int(NmtState.PRE_OPERATIONAL), "the NMT state in a guarding answer")


def toggle(bench: Bench) -> Procedure[None]:
    """7.3: the toggle bit is 0 in the first answer after a reset, and changes each time. If the test is strict, a reset of the
    communication puts it back too."""
    for _ in range(2 if bench.strict else 1):
        yield from _without_heartbeat(bench)
        seen = []
        for _ in range(5):
            seen.append(((yield from request(bench)) & TOGGLE) // TOGGLE)
            yield from bench.sleep(PERIOD)
        expect_equal(seen, [0, 1, 0, 1, 0], "the toggle bit in five guarding answers")
        if bench.strict:
            yield from bench.reset(NmtCommand.RESET_COMMUNICATION)


def other_ids(bench: Bench) -> Procedure[None]:
    """7.4: requests for other nodes are not answered."""
    yield from _without_heartbeat(bench)
    for node_id in range(1, MAX_NODE_ID + 1):
        if node_id != bench.node_id:
            bench.probe.forget(bench.error_control_key)
            yield from bench.send_remote(RoutingKey(ERROR_CONTROL + node_id), 1)
            yield from bench.sleep(REACTION_TIME)
            heard = bench.probe.take_all(bench.error_control_key)
            expect(not heard, f"a guarding request for node {node_id} was answered")
    yield from request(bench)


def write_objects(bench: Bench) -> Procedure[None]:
    """7.5: both objects can be written; if the test is strict, up to their last bits, or limits."""
    most = highest(bench, GUARD_TIME, 0xFFFF) * MILLISECOND, highest(bench, LIFE_TIME_FACTOR, 0xFF)
    for period, factor in ((PERIOD, FACTOR), *((most,) if bench.strict else ()), (0, 0)):
        yield from _configure(bench, period, factor)
        yield from bench.expect_number(GUARD_TIME, 0, period // MILLISECOND, "written")
        yield from bench.expect_number(LIFE_TIME_FACTOR, 0, factor, "written")


def life_guarding(bench: Bench) -> Procedure[None]:
    """7.6: a device that gets its requests in time makes no error; after they end, one emergency message follows in time. If the
    test is strict, none comes before the first request: that begins life guarding (7.2.8.3.2.1)."""
    bench.check_emergency()
    yield from _without_heartbeat(bench)
    yield from _configure(bench, PERIOD, FACTOR)
    if bench.strict:
        yield from expect_no_error(bench, PERIOD * FACTOR * 2, "the device was not asked yet, and an emergency message came")
    for _ in range(10):
        yield from request(bench)
        yield from bench.sleep(PERIOD)
    for each in errors_heard(bench):
        asked = f"the device was asked each {PERIOD // MILLISECOND} ms, its life time is {PERIOD * FACTOR // MILLISECOND} ms"
        raise TimingError(f"{asked}, and an emergency message came: {each.frame}")
    begin = yield from current_time()  # the device hears the request after this time, however late we are
    yield from request(bench)
    life_time = PERIOD * FACTOR
    latest = int(life_time * (1 + PERIOD_TOLERANCE)) + REACTION_TIME
    heard = yield from next_error(bench, latest, "an emergency message about the end of guarding")
    expect_equal(code_of(heard.frame.data), EMCY_CONNECTION_LOST, "the error code of life guarding")
    check_not_early(heard.at - begin, life_time, "life guarding ended")


def one_of_both(bench: Bench) -> Procedure[None]:
    """7.201: the objects of error control have their defaults, and these do not use both heartbeat and guarding."""
    found = [index for index in _BOTH if bench.dictionary.has_index(index)]
    for index in some(found, "the dictionary has no heartbeat and no guarding"):
        yield from bench.expect_default(index, 0, "after a reset")
    guarded = bench.default(GUARD_TIME) and bench.default(LIFE_TIME_FACTOR)
    expect(not (bench.default(HEARTBEAT) and guarded), "by default both heartbeat and guarding are in use")


def heartbeat_off(bench: Bench) -> Procedure[None]:
    """7.202: without a heartbeat time, no frame comes unless requested."""
    yield from bench.write(HEARTBEAT, 0, PERIOD // MILLISECOND)
    yield from bench.write(HEARTBEAT, 0, 0)
    yield from bench.expect_silence(bench.error_control_key, 1 * SECOND, "the heartbeat is off, and a frame")


def guarding_instead(bench: Bench) -> Procedure[None]:
    """7.203: when the heartbeat is off, guarding requests are answered."""
    yield from heartbeat_off(bench)
    yield from toggle(bench)


def heartbeats(guard: bool, ask: bool, bench: Bench) -> Procedure[str]:
    """7.204 to 7.207: with the heartbeat on, heartbeats come and nothing else. guard: guarding is on too. ask: ask for it."""
    yield from _configure(bench, *((PERIOD, FACTOR) if guard else (0, 0)))
    yield from bench.write(HEARTBEAT, 0, PERIOD // MILLISECOND)
    bench.probe.forget(bench.error_control_key)
    begin = yield from current_time()
    for _ in range(10):
        if ask:
            yield from bench.send_remote(bench.error_control_key, 1)
        yield from bench.sleep(PERIOD)
    heard = bench.probe.take_all(bench.error_control_key)
    bench.check_period(heard, begin, (yield from current_time()), PERIOD, "the heartbeat, or an answer to guarding,")
    for each in heard:
        expect_equal(each.frame.data, bytes((NmtState.PRE_OPERATIONAL,)), "the data of a heartbeat in pre-operational")
    yield from expect_no_error(bench, PERIOD * FACTOR * 2, "an emergency message though there is a heartbeat")
    return counted(len(heard), "heartbeat")


_GUARDING: Final = (GUARD_TIME, LIFE_TIME_FACTOR)
_BOTH: Final = (*_GUARDING, HEARTBEAT)


def _beside(number: str, name: str, title: str, *, guard: bool, ask: bool) -> Case:
    return Case(number, name, title, partial(heartbeats, guard, ask), _BOTH)


CASES: Final = (
    Case("7.1", "Guarding 01", "Read 0x100C and 0x100D", read_objects, _GUARDING),
    Case("7.2", "Guarding 02", "Send a remote frame and wait for the answer", answer, _GUARDING),
    Case("7.3", "Guarding 03", "Check the toggle bit", toggle, _GUARDING),
    Case("7.4", "Guarding 04", "Check that only the own guarding CAN-ID is answered", other_ids, _GUARDING),
    Case("7.5", "Guarding 05", "Write 0x100C and 0x100D", write_objects, _GUARDING),
    Case("7.6", "Guarding 06", "Test life guarding", life_guarding, (*_GUARDING, COB_ID_EMERGENCY)),
    Case("7.201", "Heartbeat versus guarding 01", "Check the heartbeat and guarding objects", one_of_both),
    Case("7.202", "Heartbeat versus guarding 02", "Switch off the heartbeat", heartbeat_off, _BOTH),
    Case("7.203", "Heartbeat versus guarding 03", "Test node guarding", guarding_instead, _BOTH),
    _beside("7.204", "Heartbeat versus guarding 04", "Guarding off and heartbeat on", guard=False, ask=False),
    _beside("7.205", "Heartbeat versus guarding 05", "Heartbeat on, guarding off: send remote frames", guard=False, ask=True),
    _beside("7.206", "Heartbeat versus guarding 06", "Heartbeat on, guarding on: wait for heartbeats", guard=True, ask=False),
    _beside("7.207", "Heartbeat versus guarding 07", "Heartbeat on, guarding on: send remote frames", guard=True, ask=True),
)
