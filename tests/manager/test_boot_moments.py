"""The start of a network and the time after it: nodes that boot, are lost or suspended at any moment; pauses, resets, cancels."""

from __future__ import annotations

import itertools

import pytest

from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND
from canopen_proto.manager.boot.network_boot import BootReport, NetworkBoot, NetworkStarted, NodeLost
from canopen_proto.procedures.steps import Procedure
from tests.manager.boot_bench import (
    DEVICE_TYPE,
    HEARTBEAT,
    KEPT,
    MANDATORY,
    SETTING,
    BootBench,
    beating,
    entry,
)


def test_nodes_that_are_not_listed_are_not_touched() -> None:
    bench = BootBench([2, 3])
    report = bench.run(bench.network_boot(3, entry(2, MANDATORY), entry(3, 0)).start())
    assert report.outcomes[3].letter == "A"
    assert bench.commands_sent() == ["000#8200", "000#0102"]
    assert bench.nodes[3].state == 0x7F


def test_there_is_a_pause_between_nmt_commands() -> None:
    """0x102A: also between those of nodes that are ready at the same moment."""
    bench = BootBench([2, 3, 4, 5], pause=30 * MILLISECOND)
    beating(bench, 5)
    bench.run(bench.network_boot(1, *(entry(node_id, MANDATORY) for node_id in (2, 3, 4)), entry(5, KEPT)).start())
    moments = [moment for moment, frame in bench.bus.sent if frame.can_id == 0]
    assert len(moments) == 6
    assert all(later - earlier >= 30 * MILLISECOND for earlier, later in itertools.pairwise(moments))


def test_a_network_without_mandatory_nodes_starts_when_all_have_ended() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = NEVER
    bench.run(bench.network_boot(3, entry(2), entry(3)).start())
    assert bench.commands_sent() == ["000#8200", "000#0102"]
    assert bench.bus.take_events(NetworkStarted) == [NetworkStarted(0, (2,))]


def test_a_network_without_nodes_has_nothing_to_do() -> None:
    bench = BootBench([])
    bench.supervise(bench.network_boot(), SECOND)
    assert bench.commands_sent() == ["000#8200"]
    assert bench.master.runner.busy


def test_a_guarded_node_that_was_not_connected_comes_back() -> None:
    bench = BootBench([2])
    bench.nodes[2].guarded = True
    bench.supervise(bench.network_boot(1, entry(2, 0x0064_030D, consumer_time=0, configuration=())), SECOND)
    bench.bus.sent.clear()
    bench.bus.detach(bench.nodes[2])
    bench.bus.run(10 * SECOND)
    assert bench.commands_sent() == ["000#8102"]
    bench.bus.attach(bench.nodes[2])
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#8102", "000#8102", "000#0102"]
    assert len(bench.bus.take_events(NodeLost)) == 1


def test_a_node_without_sdo_is_not_reset_over_and_over() -> None:
    """It boots and sends heartbeats, but answers nothing."""
    bench = BootBench([2])
    bench.nodes[2].defaults.update({DEVICE_TYPE: None, HEARTBEAT: b"\xe8\x03"})
    bench.supervise(bench.network_boot(), 20 * SECOND)
    assert bench.letters() == "B"
    assert bench.commands_sent() == ["000#8200"]


@pytest.mark.parametrize("startup", [1, 3])
@pytest.mark.parametrize("assignment", [MANDATORY, KEPT])
def test_a_boot_up_that_passes_the_start_command(startup: int, assignment: int) -> None:
    """The node runs without its settings then: it is reset, and booted again."""

    def bench_of_two() -> BootBench:
        bench = BootBench([2, 3])
        for node in bench.nodes.values():
            node.defaults[HEARTBEAT] = node.table[HEARTBEAT] = b"\x64\0"
            node.boot(bench.bus.now)
        bench.bus.run(MILLISECOND)
        bench.master.run(
            started_and_supervised(bench.network_boot(startup, entry(2, MANDATORY), entry(3, assignment))), bench.bus.now
        )
        return bench

    bench = bench_of_two()
    bench.bus.run(SECOND)
    started_at = next(moment for moment, frame in bench.bus.sent if str(frame) in ("000#0103", "000#0100"))
    bench = bench_of_two()
    bench.bus.run(started_at - 50 * MICROSECOND - bench.bus.now)
    bench.nodes[3].writes.clear()
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(160 * MICROSECOND)
    assert bench.nodes[3].state == 5, "the command has passed the boot-up"
    assert bench.nodes[3].writes == []
    bench.bus.run(SECOND)
    assert "000#8203" in bench.commands_sent()
    assert [place for place, _ in bench.nodes[3].writes] == [HEARTBEAT, SETTING]
    assert bench.nodes[3].state == 5


def test_a_boot_up_that_passes_the_start_command_while_another_node_is_awaited() -> None:
    """It is seen to later, and the node runs without its settings all the same."""
    bench = BootBench([2, 3])
    bench.nodes[3].switch_off()
    boot = bench.network_boot(1, entry(2, MANDATORY), entry(3, MANDATORY), boot_time=5 * SECOND)
    bench.master.run(boot.start(), bench.bus.now)
    bench.bus.run_until(lambda: "000#0102" in bench.commands_sent())
    bench.nodes[2].boot(bench.bus.now - 50 * MICROSECOND)
    bench.bus.run(MILLISECOND)
    assert bench.nodes[2].state == 5, "the command has passed the boot-up"
    bench.nodes[2].table[SETTING] = bytes(2)
    bench.bus.run(10 * SECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#8202", "000#0102"]
    assert (bench.nodes[2].state, bench.nodes[2].table[SETTING]) == (5, b"\x34\x12")


def started_and_supervised(boot: NetworkBoot) -> Procedure[NodeLost]:
    yield from boot.start()
    return (yield from boot.supervise())


@pytest.mark.parametrize("startup", [1, 3])
def test_a_node_that_boots_while_its_start_command_waits_is_not_started(startup: int) -> None:
    """The pause of 0x102A lies between: what was right before it is judged again after it."""
    bench = BootBench([2, 3], pause=300 * MILLISECOND)
    bench.master.run(bench.network_boot(startup).start(), bench.bus.now)
    bench.bus.run_until(lambda: bench.letters() == "00")
    assert bench.commands_sent() == ["000#8200"]
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(160 * MILLISECOND)
    assert [node.state for node in bench.nodes.values()] == [5 if startup == 1 else 0x7F, 0x7F]
    bench.bus.run(2 * SECOND)
    assert [node.state for node in bench.nodes.values()] == [5, 5]


@pytest.mark.parametrize("startup", [1, 3])
def test_a_suspended_node_is_not_started(startup: int) -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = SECOND
    boot = bench.network_boot(3)
    request_id = bench.master.run(boot.start(), bench.bus.now)
    bench.bus.run(500 * MILLISECOND)
    boot.suspend(2, bench.bus.now)
    report: BootReport = bench.outcome(request_id)
    assert (report.missing, report.running) == ((2,), ())
    assert bench.commands_sent() == ["000#8200"]


def test_nobody_waits_for_the_heartbeat_of_a_suspended_node() -> None:
    bench = BootBench([2, 3])
    boot = bench.network_boot()
    bench.supervise(boot, SECOND)
    boot.suspend(3, bench.bus.now)
    bench.bus.detach(bench.nodes[3])
    bench.bus.run(10 * SECOND)
    assert bench.bus.take_events(HeartbeatLost) == []
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#0103"]


def test_a_suspended_node_is_not_booted_by_a_reset_of_before() -> None:
    """It was lost and reset, and is suspended before its boot-up has come."""
    bench = BootBench([2, 3])
    boot = bench.network_boot()
    bench.supervise(boot, SECOND)
    bench.nodes[3].boot_delay = SECOND
    bench.nodes[3].table[HEARTBEAT] = bytes(2)
    bench.nodes[3]._begin_heartbeat(bench.bus.now)
    bench.bus.run_until(lambda: "000#8103" in bench.commands_sent())
    boot.suspend(3, bench.bus.now)
    bench.bus.run(5 * SECOND)
    assert bench.letters() == "00"


def test_a_boot_up_before_the_reset_does_not_count() -> None:
    """The reset undoes what would be configured: the node is asked after its next boot-up."""
    bench = BootBench([2])
    boot = bench.network_boot()
    bench.nodes[2].boot(bench.bus.now)
    bench.bus.run(MILLISECOND)
    bench.bus.sent.clear()
    bench.run(boot.start())
    assert bench.bus.trace()[:3] == ["000#8200", "702#00", "602#4000100000000000"]


def test_a_node_that_is_reset_is_not_lost_once_more() -> None:
    """Not by a heartbeat that passes the reset, and not by a boot-up that comes late."""
    bench = BootBench([2, 3])
    bench.supervise(bench.network_boot(), SECOND)
    node = bench.nodes[3]
    node.boot_delay = 5 * SECOND
    node.table[HEARTBEAT] = bytes(2)
    node._begin_heartbeat(bench.bus.now)
    bench.bus.run_until(lambda: "000#8103" in bench.commands_sent())
    bench.master.receive(Frame.parse("703#05"), bench.bus.now)
    bench.bus.run(10 * SECOND)
    assert len(bench.bus.take_events(HeartbeatLost)) == 1
    assert bench.letters() == "000"


def test_all_are_reset_and_have_their_whole_time_again() -> None:
    """Nobody is watched meanwhile, nothing runs, and the boot time begins again."""
    bench = BootBench([2, 3])
    boot = bench.network_boot(0x11, boot_time=3 * SECOND)
    bench.supervise(boot, 10 * SECOND)
    for node in bench.nodes.values():
        node.boot_delay = 2 * SECOND
    bench.nodes[3].switch_off()
    bench.bus.run_until(lambda: "000#8100" in bench.commands_sent())
    lost_at = bench.bus.now
    bench.bus.run(SECOND)
    assert boot.report(bench.bus.now).running == ()
    bench.bus.run_until(lambda: bench.letters() == "000B", 10 * SECOND)
    assert bench.bus.now == lost_at + 3 * SECOND, bench.letters()
    assert len(bench.bus.take_events(HeartbeatLost)) == 1


@pytest.mark.parametrize("moment", [0, 1, 12, 13, 14, 100, 212, 213, 1000])
def test_after_a_cancel_nothing_is_sent_any_more(moment: int) -> None:
    """But the abort of the transfer under way. A node that runs goes on running, and the report tells it."""
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = SECOND
    boot = bench.network_boot()
    request_id = bench.master.run(started_and_supervised(boot), bench.bus.now)
    bench.bus.run(moment * MILLISECOND + 350 * MICROSECOND)
    bench.master.cancel(request_id, bench.bus.now)
    bench.bus.pump()
    bench.bus.sent.clear()
    bench.bus.run(10 * SECOND)
    assert [text for text in bench.bus.trace() if not text.startswith(("58", "70"))] == []
    assert not bench.master.runner.busy
    assert boot.report(bench.bus.now).running == tuple(each for each, node in bench.nodes.items() if node.state == 5)
