"""The analysis: against the example of its paper, and against every schedule that there can be.

(Against the machine: test_wire_latency.) What is from where:

- From the paper (Davis, Burns, Bril, Lukkien 2007, section 3): the message set EXAMPLE, and what the paper says of it: the older
  analysis finds 2, 3 and 3 ms, and in truth C waits 3.5 ms, in its second instance. The paper was not at hand when this was
  written: these figures are quoted from memory. (The equations' numbers were checked against implementations that cite them.)
- Derived here, from nothing but the rules of the bus: `worst_of_all_schedules` plays through every phasing. It gives the same
  figures, so that they rest on nobody's memory.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, LocalProtocolError
from canopen_transports.wire import PeriodicMessage, duration, response_times, worst_bits
from canopen_transports.wire.response_time import utilisation
from tests.examples import examples

BITRATE = 125_000

# 7 bytes and 11-bit identifiers, at most 125 bits, on 125 kbit/s.
FRAME_TIME = duration(worst_bits(7), BITRATE)
EXAMPLE = [
    PeriodicMessage("A", 1, FRAME_TIME, 2_500 * MICROSECOND, deadline=2_500 * MICROSECOND),
    PeriodicMessage("B", 2, FRAME_TIME, 3_500 * MICROSECOND, deadline=3_250 * MICROSECOND),
    PeriodicMessage("C", 3, FRAME_TIME, 3_500 * MICROSECOND, deadline=3_250 * MICROSECOND),
]


def test_the_example_of_the_paper() -> None:
    assert FRAME_TIME == MILLISECOND
    assert round(utilisation(EXAMPLE), 2) == 0.97
    a, b, c = response_times(EXAMPLE, BITRATE)
    assert (a.worst, b.worst) == (2 * MILLISECOND, 3 * MILLISECOND)
    # C's busy period lasts 7 ms, two of its periods.
    assert (c.worst, c.instance, c.instances) == (3_500 * MICROSECOND, 1, 2)
    assert [each.fits for each in (a, b, c)] == [True, True, False]
    assert (a.blocking, b.blocking, c.blocking) == (MILLISECOND, MILLISECOND, 0)


def test_the_older_analysis_would_have_passed_it() -> None:
    """It looks at the first instance only."""
    assert [first_instance_only(EXAMPLE, number) for number in range(3)] == [2 * MILLISECOND, 3 * MILLISECOND, 3 * MILLISECOND]


def first_instance_only(messages: Sequence[PeriodicMessage], number: int) -> int:
    """Tindell and Burns 1994, without jitter; messages in the order of their priority."""
    own, blocking = messages[number].time, max((each.time for each in messages[number + 1 :]), default=0)
    wait = blocking
    while True:
        needed = blocking + sum(-(-(wait + duration(1, BITRATE)) // each.period) * each.time for each in messages[:number])
        if needed == wait:
            return wait + own
        wait = needed


# ---- against every schedule ----


def worst_of_all_schedules(messages: Sequence[tuple[int, int]]) -> list[int]:
    """The longest that each of (time, period) waits and is sent, in all phasings of whole ticks; in the order of their priority.

    Who is ready and most urgent begins when the bus is free; who becomes ready in the same tick takes part.
    """
    worst = [0] * len(messages)
    for phases in itertools.product((0,), *(range(period) for _, period in messages[1:])):
        end = 2 * math.lcm(*(period for _, period in messages)) + max(phases)
        ready = list(phases)  # of each, when its oldest waiting instance was queued, or will be
        now = 0
        while now < end:
            number = next((place for place, since in enumerate(ready) if since <= now), None)
            if number is None:
                now = min(ready)
                continue
            time, period = messages[number]
            now += time
            worst[number] = max(worst[number], now - ready[number])
            ready[number] += period
    return worst


def bounds_of(messages: Sequence[tuple[int, int]]) -> list[int]:
    """The same by the analysis; a tick is a bit."""
    named = [PeriodicMessage(f"{number}", number, *each) for number, each in enumerate(messages)]
    return [each.worst for each in response_times(named, SECOND)]


def test_the_example_in_every_phasing() -> None:
    """In eighths of a millisecond: nothing comes later than the analysis says, and all but what is blocked comes as late."""
    ticks = [(8, 20), (8, 28), (8, 28)]
    assert bounds_of(ticks) == [2 * 8, 3 * 8, 3.5 * 8]
    # A frame of lower priority that blocks began a tick earlier at least.
    assert worst_of_all_schedules(ticks) == [2 * 8 - 1, 3 * 8 - 1, 3.5 * 8]


@examples(60)
@given(st.lists(st.tuples(st.integers(1, 4), st.integers(2, 12)), min_size=1, max_size=3))
def test_every_phasing_of_small_sets(messages: list[tuple[int, int]]) -> None:
    """Never above the bound, which is reached where nothing blocks. (A blocking frame begins a tick early.)"""
    assume(sum(time / period for time, period in messages) < 1)
    found, bound = worst_of_all_schedules(messages), bounds_of(messages)
    assert all(each <= limit for each, limit in zip(found, bound, strict=True))
    assert found[-1] == bound[-1]


# ---- jitter, errors, queues ----


def test_jitter_and_errors_make_it_longer() -> None:
    plain = [PeriodicMessage("A", 1, 1000, 10_000), PeriodicMessage("B", 2, 1000, 20_000)]
    late = [PeriodicMessage("A", 1, 1000, 10_000, jitter=9_500), PeriodicMessage("B", 2, 1000, 20_000, jitter=300)]
    assert [each.worst for each in response_times(plain, 1_000_000)] == [2_000, 2_000]
    # Two of A come at once before B.
    assert [each.worst for each in response_times(late, 1_000_000)] == [9_500 + 2_000, 300 + 3_000]
    with_errors = response_times([PeriodicMessage("A", 1, 100_000, SECOND)], 1_000_000, error_interval=SECOND)
    assert with_errors[0].worst == 100_000 + 31_000 + 100_000


def test_a_network_that_needs_more_than_there_is() -> None:
    fast, slow = response_times([PeriodicMessage("fast", 1, 400, 1_000), PeriodicMessage("slow", 2, 700, 1_000)], 1_000_000)
    assert fast.worst == 1_100
    assert slow.worst == NEVER
    assert not slow.fits


def test_a_busy_period_that_is_too_long_is_given_up() -> None:
    nearly = PeriodicMessage("nearly all", 1, 999, 1_000)
    found = response_times([nearly, PeriodicMessage("rest", 2, 1_000, 10**8)], 1_000_000)
    assert found[1].worst == 1_000 * 1_000  # one of 10**8, in which the other is sent a thousand times
    assert response_times([PeriodicMessage("rest", 0, 2_000, 10**8), nearly], 1_000_000)[1].worst == NEVER


def test_a_queue_lets_the_urgent_wait_for_the_others() -> None:
    messages = [
        PeriodicMessage("SYNC", 0x80, 55, 10_000, queue="master"),
        PeriodicMessage("SDO", 0x601, 135, 10_000, queue="master"),
        PeriodicMessage("TPDO", 0x181, 100, 10_000),
        PeriodicMessage("heartbeat", 0x701, 65, 10_000),
    ]
    sync, sdo, tpdo, _ = response_times(messages, 1_000_000_000)
    # SYNC: behind the SDO, which lets the TPDO go first, and the heartbeat may have begun.
    assert sync.worst == 65 + 100 + 135 + 55
    assert sdo.worst == sync.worst
    free = response_times([PeriodicMessage(each.name, each.priority, each.time, each.period) for each in messages], 1_000_000_000)
    assert free[0].worst == 135 + 55
    assert free[2].worst <= tpdo.worst


def test_queues_that_hold_each_other_up() -> None:
    crowd = [PeriodicMessage(f"{number}", number, 1_000, 10_500, queue=str(number % 3)) for number in range(10)]
    found = response_times([PeriodicMessage("first", -1, 10, 10_000), *crowd], 1_000_000_000)
    assert found[0].worst == 1_010
    assert all(each.worst == NEVER for each in found[1:])
    assert not any(each.instances for each in found[1:])


@pytest.mark.parametrize("wrong", [{"time": 0}, {"period": 0}, {"jitter": -1}])
def test_nonsense_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(LocalProtocolError, match="message A"):
        PeriodicMessage(**({"name": "A", "priority": 1, "time": 10, "period": 10} | wrong))
