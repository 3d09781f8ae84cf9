"""Supervised means supervised: a node that is lost is told in its time, or was named at the start as one that nobody watches.

And a bus above its nodes: while no frames pass, nobody is lost.
"""

from __future__ import annotations

from typing import Final

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.manager.boot.entry import CONSUMER_FACTOR
from canopen_proto.manager.boot.network_boot import LossResponse, NodeLost, NodeSupervised
from canopen_proto.network import OutageChanged
from tests.manager.boot_bench import HEARTBEAT, MANDATORY, OPTIONAL, SETTING, Answer, BootBench, TableNode, entry

NODES: Final = (3, 6, 9)
STOP_ALL: Final = 1 | 1 << 6
PERIODS: Final = (0, 50, 200, 1000)
ASKED: Final = 2 * SECOND
"""Within this time, a node whose heartbeats have stopped was asked once more."""
QUIET: Final = {"consumer_time": 0, "configuration": ((*SETTING, b"\x34\x12"),)}
"""As `net init` once wrote it: nobody is told to send a heartbeat."""


def sends(node: TableNode, period: int) -> None:
    """Let a node send a heartbeat each `period` ms, of its own."""
    node.table[HEARTBEAT] = node.defaults[HEARTBEAT] = period.to_bytes(2, "little")


def losses(bench: BootBench) -> list[NodeLost]:
    return [event for event in bench.bus.events if isinstance(event, NodeLost)]


@given(
    periods=st.tuples(*[st.sampled_from(PERIODS)] * 3),
    victim=st.sampled_from(NODES),
    when=st.integers(0, 3000),
    assignment=st.sampled_from((OPTIONAL, MANDATORY)),
    begins=st.sampled_from((None, 100, 700)),
)
def test_a_lost_node_is_told_in_its_time_or_was_named(
    periods: tuple[int, ...], victim: int, when: int, assignment: int, begins: int | None
) -> None:
    """periods: of their own heartbeats, ms; 0: none. begins: when somebody lets the victim send heartbeats of 100 ms."""
    bench = BootBench(NODES)
    for node_id, period in zip(NODES, periods, strict=True):
        sends(bench.nodes[node_id], period)
    boot = bench.network_boot(STOP_ALL, *(entry(node_id, assignment, **QUIET) for node_id in NODES))
    report = bench.run(boot.start())
    assert report.unsupervised == tuple(node_id for node_id, period in zip(NODES, periods, strict=True) if not period)
    bench.master.run(boot.supervise(), bench.bus.now)
    node, period = bench.nodes[victim], periods[NODES.index(victim)]
    if begins is not None and not period and begins < when:
        bench.bus.run(begins * MILLISECOND)
        node.table[HEARTBEAT] = (100).to_bytes(2, "little")
        node._begin_heartbeat(bench.bus.now)
        node._rearm()
        bench.bus.run((when - begins) * MILLISECOND)
        period = 100 if any(isinstance(event, NodeSupervised) for event in bench.bus.events) else 0
        assert period or when - begins <= 100
    else:
        bench.bus.run(when * MILLISECOND)
    assert not losses(bench)
    was_watched = victim not in boot.report(bench.bus.now).unsupervised
    assert was_watched is (period > 0)
    node.switch_off()
    node.boot_delay = 3600 * SECOND
    limit = (CONSUMER_FACTOR + 1) * period * MILLISECOND
    bench.bus.run(limit + ASKED)
    told = [each.node_id for each in losses(bench)]
    assert told == ([victim] if was_watched else [])


@pytest.mark.parametrize("period", [50, 200, 1000])
@given(held=st.lists(st.integers(0, 90), max_size=12))
def test_a_period_that_the_node_does_not_tell_is_measured(period: int, held: list[int]) -> None:
    """held: for how much of its period an adapter holds each heartbeat back, %."""
    bench = BootBench((6,))
    hidden: Answer = 0x0602_0000
    bench.node.table[HEARTBEAT] = bench.node.defaults[HEARTBEAT] = hidden
    boot = bench.network_boot(1, entry(6, OPTIONAL, **QUIET))
    assert bench.run(boot.start()).unsupervised == (6,)
    bench.master.run(boot.supervise(), bench.bus.now)
    begun = bench.bus.now
    for number in range(30):
        delay = held[number] if number < len(held) else 0
        bench.bus.run(begun + (100 * number + delay) * period * MILLISECOND // 100 - bench.bus.now)
        bench.bus.send("706#05")
    bench.bus.run(MILLISECOND)
    assert not losses(bench)
    assert boot.report(bench.bus.now).unsupervised == ()
    supervised = [event for event in bench.bus.events if isinstance(event, NodeSupervised)]
    assert len(supervised) == 1
    bench.bus.run(supervised[0].timeout - MILLISECOND)
    bench.node.switch_off()
    bench.node.boot_delay = 3600 * SECOND
    bench.bus.run(ASKED)
    assert [each.node_id for each in losses(bench)] == [6]


@given(
    begins=st.integers(0, 2000),
    lasts=st.integers(1, 5000),
    victim=st.sampled_from((None, *NODES)),
    assignment=st.sampled_from((OPTIONAL, MANDATORY)),
    while_booting=st.booleans(),
)
@example(begins=0, lasts=500, victim=None, assignment=OPTIONAL, while_booting=True)  # it ends when the consumer times do
def test_while_the_bus_is_away_nobody_is_lost(
    begins: int, lasts: int, victim: int | None, assignment: int, while_booting: bool
) -> None:
    """victim: loses its power meanwhile, which is told once the bus is back."""
    bench = BootBench(NODES)
    boot = bench.network_boot(STOP_ALL, *(entry(node_id, assignment) for node_id in NODES))
    bench.run(boot.start())
    assert boot.report(bench.bus.now).running == NODES
    request = None if while_booting else bench.master.run(boot.supervise(), bench.bus.now)
    bench.bus.run(begins * MILLISECOND)
    bench.bus.sent.clear()
    bench.master.outage = "can0 is down: unplugged"
    bench.bus.disturb(loss=1.0, delay=(100_000, 100_000))
    if victim is not None:
        bench.nodes[victim].switch_off()
        bench.nodes[victim].boot_delay = 3600 * SECOND
    bench.bus.run(lasts * MILLISECOND)
    assert not losses(bench)
    assert not bench.commands_sent()
    report = boot.report(bench.bus.now)
    assert (report.gone, report.running) == ((), NODES)
    bench.bus.disturb(delay=(100_000, 100_000))
    bench.master.outage = ""
    if request is None:
        bench.master.run(boot.supervise(), bench.bus.now)
    consumer_time: Time = 500 * MILLISECOND
    bench.bus.run(2 * consumer_time + MILLISECOND)
    expected = [] if victim is None else [victim]
    assert [each.node_id for each in losses(bench)] == expected
    if victim is not None and assignment == MANDATORY:
        assert losses(bench)[0].reaction is LossResponse.STOP_ALL
    told = [event.outage for event in bench.bus.events if isinstance(event, OutageChanged)]
    assert told == ["can0 is down: unplugged", ""]


@pytest.mark.parametrize(("works", "fails"), [(300, 200), (450, 10), (250, 5000)])
def test_a_bus_that_comes_and_goes_hides_a_lost_node_for_a_bounded_time(works: int, fails: int) -> None:
    """Each stretch in which the bus works is shorter than the node's time of 500 ms. The others are heard in them."""
    bench = BootBench(NODES)
    boot = bench.network_boot(STOP_ALL, *(entry(node_id, OPTIONAL) for node_id in NODES))
    bench.run(boot.start())
    bench.master.run(boot.supervise(), bench.bus.now)
    victim = NODES[0]
    bench.nodes[victim].switch_off()
    bench.nodes[victim].boot_delay = 3600 * SECOND
    flaps = 0
    while not losses(bench) and flaps < 100:
        flaps += 1
        bench.bus.run(works * MILLISECOND)
        bench.master.outage = "can0 is bus-off"
        bench.bus.disturb(loss=1.0, delay=(100_000, 100_000))
        bench.bus.run(fails * MILLISECOND)
        assert victim not in [each.node_id for each in losses(bench)] or flaps > 1
        bench.bus.disturb(delay=(100_000, 100_000))
        bench.master.outage = ""
        bench.bus.run(MILLISECOND)
    assert [each.node_id for each in losses(bench)] == [victim]
    assert 3 * 500 <= flaps * works + 500 <= 5 * 500 + works


def test_who_is_not_to_be_watched_is_not_watched() -> None:
    bench = BootBench((6,))
    sends(bench.node, 100)
    boot = bench.network_boot(1, entry(6, MANDATORY, **QUIET, learns=False))
    bench.supervise(boot, SECOND)
    bench.node.switch_off()
    bench.bus.run(10 * SECOND)
    assert not losses(bench)
    assert boot.report(bench.bus.now).unsupervised == (6,)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("now", [0, 200, 1000, 65535])
@pytest.mark.parametrize("before", [50, 200, 40000, 65535])
def test_a_node_that_answers_is_not_lost_whatever_its_heartbeats_do(before: int, now: int) -> None:
    """before, now: its 0x1017, ms, of which the master is not told that it has changed; what it sends changes with it."""
    bench = BootBench(NODES)
    for node_id in NODES:
        sends(bench.nodes[node_id], before)
    boot = bench.network_boot(STOP_ALL, *(entry(node_id, MANDATORY, **QUIET) for node_id in NODES))
    assert bench.run(boot.start()).unsupervised == ()
    bench.master.run(boot.supervise(), bench.bus.now)
    bench.bus.disturb(delay=(100_000, 3_000_000))
    bench.bus.run(3 * before * MILLISECOND)
    node = bench.nodes[6]
    node.table[HEARTBEAT] = now.to_bytes(2, "little")
    node._begin_heartbeat(bench.bus.now)
    node._rearm()
    bench.bus.run(5 * max(before, now) * MILLISECOND)
    assert not losses(bench)
    assert boot.report(bench.bus.now).running == NODES
    assert boot.report(bench.bus.now).unsupervised == (() if now else (6,))
    node.switch_off()
    node.boot_delay = 3600 * SECOND
    bench.bus.run((CONSUMER_FACTOR + 1) * max(before, now) * MILLISECOND + ASKED)
    assert [each.node_id for each in losses(bench)] == ([6] if now else [])


def test_a_node_that_never_sends_what_its_0x1017_says_is_not_reset_but_named() -> None:
    bench = BootBench(NODES)
    for node_id in NODES:
        sends(bench.nodes[node_id], 200)
    bench.nodes[6]._begin_heartbeat = lambda now: None  # type: ignore[method-assign]
    boot = bench.network_boot(STOP_ALL, *(entry(node_id, MANDATORY, **QUIET) for node_id in NODES))
    bench.run(boot.start())
    bench.master.run(boot.supervise(), bench.bus.now)
    bench.bus.run(20 * SECOND)
    assert not losses(bench)
    assert boot.report(bench.bus.now).unsupervised == (6,)
    assert [event.timeout for event in bench.bus.events if isinstance(event, NodeSupervised)] == [0]


@pytest.mark.parametrize("tells", [True, False])
def test_answers_to_another_masters_guarding_make_no_loss(tells: bool) -> None:
    bench = BootBench((6,))
    sends(bench.node, 0)
    if not tells:
        bench.node.table[HEARTBEAT] = bench.node.defaults[HEARTBEAT] = 0x0602_0000
    boot = bench.network_boot(STOP_ALL, entry(6, MANDATORY, **QUIET))
    bench.run(boot.start())
    bench.master.run(boot.supervise(), bench.bus.now)
    for number in range(30):
        bench.bus.send(f"706#{5 | number % 2 << 7:02X}")
        bench.bus.run(100 * MILLISECOND)
    if tells:
        assert not any(isinstance(event, NodeSupervised) for event in bench.bus.events)
    bench.bus.run(10 * SECOND)
    assert not losses(bench)
    assert boot.report(bench.bus.now).unsupervised == (6,)
