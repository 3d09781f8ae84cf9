"""Chapter 7.1xx of the conformance test: heartbeat, produced and monitored (CiA 301 v4.2.0, 7.2.8.3.2.2, 7.5.2.19, 7.5.2.20)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_check.bench import PERIOD_TOLERANCE, REACTION_TIME, Bench
from canopen_check.case import Case
from canopen_check.emergencies import code_of, errors_heard, expect_no_error, next_error
from canopen_check.expectations import TimingError, expect_refusal, some
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.explained import counted
from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, RoutingKey
from canopen_proto.indices import COB_ID_EMERGENCY
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import Procedure, current_time
from canopen_proto.verdict import ViolationError, expect_equal

CONSUMER: Final = indices.CONSUMER_HEARTBEAT_TIME
PRODUCER: Final = indices.PRODUCER_HEARTBEAT_TIME

PERIOD: Final = 100 * MILLISECOND
COUNTED: Final = 10 * SECOND
MONITORED: Final = 500 * MILLISECOND

EMCY_CONNECTION_LOST: Final = 0x8130

TWICE: Final = (AbortCode.PARAMETER_INCOMPATIBLE, AbortCode.GENERAL_ERROR)


def highest(bench: Bench, index: int, most: int) -> int:
    """Return the highest number that an object takes; its type holds `most`."""
    limit = bench.variable(index).high_limit
    return most if limit is None else min(int(limit), most)


def write_period(bench: Bench) -> Procedure[None]:
    """7.101: the producer heartbeat time can be written; if the test is strict, up to its last bit, or its limit."""
    most = (highest(bench, PRODUCER, 0xFFFF),) if bench.strict else ()
    for milliseconds in (100, *most, 0):
        yield from bench.write(PRODUCER, 0, milliseconds)
        yield from bench.expect_number(PRODUCER, 0, milliseconds, "written")


def count_heartbeats(bench: Bench) -> Procedure[str]:
    """7.102: one heartbeat per period, each with the NMT state."""
    yield from bench.write(PRODUCER, 0, PERIOD // MILLISECOND)
    heard = yield from bench.expect_period(bench.error_control_key, COUNTED, PERIOD, "the heartbeat")
    for each in heard:
        expect_equal(each.frame.data, bytes((NmtState.PRE_OPERATIONAL,)), "the data of a heartbeat in pre-operational")
    return counted(len(heard), "heartbeat")


def stop_heartbeat(bench: Bench) -> Procedure[None]:
    """7.103: a heartbeat time of 0 ends the heartbeat."""
    yield from bench.write(PRODUCER, 0, PERIOD // MILLISECOND)
    yield from bench.next_frame(bench.error_control_key, 2 * PERIOD, "a heartbeat")
    yield from bench.write(PRODUCER, 0, 0)
    yield from bench.expect_silence(bench.error_control_key, 1 * SECOND, "the heartbeat time is 0, and a heartbeat")


def _entries(bench: Bench) -> list[int]:
    """Return the subindices of the consumer heartbeat time that can be written; without any, the case does not apply."""
    found = [subindex for subindex in bench.dictionary.objects[CONSUMER].variables if subindex]
    return some([each for each in found if bench.is_writable(CONSUMER, each)], "0x1016 has no entry that can be written")


def _clear_entries(bench: Bench) -> Procedure[list[int]]:
    """Stop all monitoring; return the subindices."""
    found = _entries(bench)
    for subindex in found:
        yield from bench.write(CONSUMER, subindex, 0)
    return found


def _others(bench: Bench) -> Iterator[int]:
    """Return node-IDs that are not the device's, and of which no heartbeat was heard: other devices may be on the bus."""
    return (node_id for node_id in range(1, MAX_NODE_ID + 1) if node_id not in {bench.node_id, *bench.bystander.nodes})


def _entry(node_id: int, timeout: Time) -> int:
    return node_id << 16 | timeout // MILLISECOND


def monitor_twice(bench: Bench) -> Procedure[str | None]:
    """7.104: an entry takes its own value; no two entries may monitor the same node."""
    node_id, (first, *rest) = next(_others(bench)), (yield from _clear_entries(bench))
    for _ in range(2):
        yield from bench.write(CONSUMER, first, _entry(node_id, MONITORED))
    if not rest:
        return "the device monitors one node only"
    refusal = yield from bench.refusal_of_write(CONSUMER, rest[0], _entry(node_id, MONITORED))
    expect_refusal(refusal, TWICE, f"monitoring node {node_id} twice")
    return None


def _heartbeat(bench: Bench, node_id: int) -> Procedure[None]:
    yield from bench.send(RoutingKey(ERROR_CONTROL + node_id), bytes((NmtState.OPERATIONAL,)))


def monitor_in_time(bench: Bench) -> Procedure[str]:
    """7.105: heartbeats that come in time make no error, in any entry."""
    bench.check_emergency()
    monitored = list(zip((yield from _clear_entries(bench)), _others(bench), strict=False))
    for subindex, node_id in monitored:
        yield from bench.write(CONSUMER, subindex, _entry(node_id, MONITORED))
    bench.probe.forget(bench.emcy_key)
    for _ in range(8):
        for _, node_id in monitored:
            yield from _heartbeat(bench, node_id)
        yield from bench.sleep(MONITORED // 2)
    sent = f"heartbeats came each {MONITORED // 2 // MILLISECOND} ms, the consumer time is {MONITORED // MILLISECOND} ms"
    for each in errors_heard(bench):
        raise TimingError(f"{sent}, and an emergency message came too: {each.frame}")
    return counted(len(monitored), "entry")


def check_not_early(after: Time, time: Time, what: str) -> None:
    """Check that something that is due after `time` did not come much earlier. Raises TimingError. after: ns until it came. what:
    for the text."""
    if after < time * (1 - PERIOD_TOLERANCE):
        wanted = f"the time is {time / MILLISECOND:g} ms ± {PERIOD_TOLERANCE:.0%}"
        raise TimingError(f"{what} after {after / MILLISECOND:.0f} ms; {wanted}")


def expect_lost(bench: Bench, node_id: int) -> Procedure[None]:
    """Send one heartbeat only; check that an emergency message reports the loss after the consumer time, not before."""
    bench.probe.forget(bench.emcy_key)
    yield from _heartbeat(bench, node_id)
    begin = yield from current_time()
    latest = int(MONITORED * (1 + PERIOD_TOLERANCE)) + REACTION_TIME
    lost = f"the lost heartbeat of node {node_id}"
    heard = yield from next_error(bench, latest, f"an emergency message about {lost}")
    expect_equal(code_of(heard.frame.data), EMCY_CONNECTION_LOST, f"the error code for {lost}")
    check_not_early(heard.at - begin, MONITORED, f"{lost} was reported")


def lose_a_node(bench: Bench) -> Procedure[bool]:
    """Make the device lose the heartbeat of another node; return False if it monitors none."""
    if not bench.dictionary.has_index(CONSUMER) or not bench.is_writable(CONSUMER, 1):
        return False
    node_id = next(_others(bench))
    yield from bench.write(CONSUMER, 1, _entry(node_id, MONITORED))
    yield from expect_lost(bench, node_id)
    return True


def monitor_late(bench: Bench) -> Procedure[str]:
    """7.106: a heartbeat that does not come in time makes an error, in each entry; a node that was never heard makes none."""
    bench.check_emergency()
    monitored = list(zip((yield from _clear_entries(bench)), _others(bench), strict=False))
    for subindex, node_id in monitored:
        yield from bench.write(CONSUMER, subindex, _entry(node_id, MONITORED))
        yield from expect_no_error(bench, 2 * MONITORED, f"node {node_id} was not heard yet, and a message")
        yield from expect_lost(bench, node_id)
        yield from bench.write(CONSUMER, subindex, 0)
        yield from bench.sleep(REACTION_TIME)
    return counted(len(monitored), "entry")


def monitor_after_reset(bench: Bench) -> Procedure[None]:
    """7.107: a reset ends monitoring that is not the default; it can be set up again, beside the device's own heartbeat."""
    bench.check_emergency()
    (first, *_), node_id = (yield from _clear_entries(bench)), next(_others(bench))
    yield from bench.write(CONSUMER, first, _entry(node_id, MONITORED))
    yield from _heartbeat(bench, node_id)
    yield from bench.reset()
    if bench.default(CONSUMER, first) == 0:
        yield from _heartbeat(bench, node_id)
        yield from expect_no_error(bench, 2 * MONITORED, "nobody is monitored after a reset, and a message")
    yield from _clear_entries(bench)
    yield from bench.write(PRODUCER, 0, PERIOD // MILLISECOND)
    yield from bench.write(CONSUMER, first, _entry(node_id, MONITORED))
    yield from expect_lost(bench, node_id)
    if not bench.probe.take_all(bench.error_control_key):
        raise ViolationError("the device's own heartbeat did not come meanwhile")


_MONITORING: Final = (CONSUMER, COB_ID_EMERGENCY)

CASES: Final = (
    Case("7.101", "Heartbeat 01", "Write 0x1017:00", write_period, (PRODUCER,)),
    Case("7.102", "Heartbeat 02", "Count the heartbeats", count_heartbeats, (PRODUCER,)),
    Case("7.103", "Heartbeat 03", "Switch off the heartbeat", stop_heartbeat, (PRODUCER,)),
    Case("7.104", "Heartbeat 04", "Try to monitor one node twice in 0x1016", monitor_twice, (CONSUMER,)),
    Case("7.105", "Heartbeat 05", "Monitor a heartbeat that is faster than the consumer time", monitor_in_time, _MONITORING),
    Case("7.106", "Heartbeat 06", "Monitor a heartbeat that is slower than the consumer time", monitor_late, _MONITORING),
    Case("7.107", "Heartbeat 07", "Monitor a heartbeat after a reset of the node", monitor_after_reset, (*_MONITORING, PRODUCER)),
)
