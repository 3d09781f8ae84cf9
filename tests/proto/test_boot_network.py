"""The start of a network, and what the master does afterwards."""

from __future__ import annotations

import pytest

from canopen_proto.boot.network_boot import LossReaction, NetworkStarted, NodeLost
from canopen_proto.machine import MILLISECOND, SECOND
from tests.proto.boot_bench import (
    HEARTBEAT,
    MANDATORY,
    OPTIONAL,
    SERIAL,
    BootBench,
    entry,
    u32,
)

WRONG = u32(0x63)


def beating(bench: BootBench, node_id: int, state: int = 5) -> None:
    """Let a node run already, with a heartbeat."""
    node = bench.nodes[node_id]
    node.table[HEARTBEAT] = b"\x64\0"
    node.boot(bench.bus.now)
    node.state = state
    bench.bus.run(MILLISECOND)
    bench.bus.sent.clear()


def test_each_node_is_started_as_soon_as_it_is_ready() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = 500 * MILLISECOND
    report = bench.run(bench.network_boot().start())
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#0103"]
    assert (report.is_started, report.running, report.missing) == (True, (2, 3), ())
    assert bench.letters() == "00"
    assert bench.bus.take_events(NetworkStarted) == [NetworkStarted(0, (2, 3))]


def test_all_nodes_are_started_at_once() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = 500 * MILLISECOND
    report = bench.run(bench.network_boot(3).start())
    assert bench.commands_sent() == ["000#8200", "000#0100"]
    bench.bus.run(MILLISECOND)
    assert [node.state for node in bench.nodes.values()] == [5, 5]
    assert report.running == (2, 3)


@pytest.mark.parametrize(("startup", "running"), [(1, (2,)), (3, ())])
def test_a_mandatory_node_that_fails_stops_the_start(startup: int, running: tuple[int, ...]) -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].defaults[SERIAL] = WRONG
    report = bench.run(bench.network_boot(startup).start())
    assert (report.is_started, report.missing, report.running) == (False, (3,), running)
    assert bench.commands_sent() == ["000#8200", *(f"000#01{each:02X}" for each in running)]
    assert bench.letters() == "O0"
    assert bench.bus.take_events(NetworkStarted) == []


@pytest.mark.parametrize("startup", [1, 3])
def test_an_optional_node_that_fails_is_the_only_one_that_is_not_started(startup: int) -> None:
    bench = BootBench([2, 3, 4])
    bench.nodes[3].defaults[SERIAL] = WRONG
    boot = bench.network_boot(startup, entry(2, MANDATORY), entry(3, OPTIONAL), entry(4, MANDATORY))
    report = bench.run(boot.start())
    assert report.running == (2, 4)
    assert sorted(bench.commands_sent()[1:]) == ["000#0102", "000#0104"]
    assert bench.nodes[3].state == 0x7F


def test_the_application_starts() -> None:
    bench = BootBench([2, 3])
    report = bench.run(bench.network_boot(0xB).start())
    assert (report.is_started, report.running) == (True, ())
    assert bench.commands_sent() == ["000#8200"]


@pytest.mark.parametrize(("startup", "own"), [(1, [1]), (5, [])])
def test_whether_the_master_enters_operational(startup: int, own: list[int]) -> None:
    bench, commands = BootBench([2]), []
    bench.run(bench.network_boot(startup, own=lambda command, now: commands.append(int(command))).start())
    assert commands == own


def test_a_lost_node_is_reset_and_booted_again() -> None:
    bench = BootBench([2, 3])
    bench.supervise(bench.network_boot(), SECOND)
    bench.bus.sent.clear()
    bench.nodes[3].switch_off()
    bench.bus.run(20 * SECOND)
    assert bench.commands_sent() == ["000#8103"]
    assert bench.bus.take_events(NodeLost) == [NodeLost(3, LossReaction.RESET)]
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#8103", "000#0103"]
    assert bench.letters() == "000"


def test_a_node_that_was_not_connected_is_reset_once_more() -> None:
    bench = BootBench([2, 3])
    bench.supervise(bench.network_boot(), SECOND)
    bench.bus.sent.clear()
    bench.bus.detach(bench.nodes[3])
    bench.bus.run(10 * SECOND)
    bench.bus.attach(bench.nodes[3])
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#8103", "000#8103", "000#0103"]


@pytest.mark.parametrize(
    ("startup", "sent", "own"),
    [
        (0x11, ["000#8100", "000#0102", "000#0103"], [1, 0x81, 1]),
        (0x41, ["000#0200"], [1, 2]),
        (0x51, ["000#0200"], [1, 2]),
        (0x13, ["000#8100", "000#0100"], [1, 0x81, 1]),
    ],
)
def test_a_lost_mandatory_node_concerns_all(startup: int, sent: list[str], own: list[int]) -> None:
    bench, commands = BootBench([2, 3]), []
    bench.supervise(bench.network_boot(startup, own=lambda command, now: commands.append(int(command))), SECOND)
    bench.bus.sent.clear()
    bench.nodes[3].table[HEARTBEAT] = bytes(2)
    bench.nodes[3]._begin_heartbeat(bench.bus.now)
    bench.bus.run(3 * SECOND)
    assert bench.commands_sent() == sent
    assert commands == own


def test_a_node_comes_later() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].switch_off()
    bench.supervise(bench.network_boot(1, entry(2, MANDATORY), entry(3, OPTIONAL)), SECOND)
    assert bench.letters() == "0B"
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#0103"]
    assert bench.letters() == "0B0"


@pytest.mark.parametrize(("startup", "last"), [(1, "000#0103"), (3, "000#0100")])
def test_the_network_starts_when_the_missing_node_comes(startup: int, last: str) -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].switch_off()
    bench.supervise(bench.network_boot(startup), SECOND)
    assert bench.bus.take_events(NetworkStarted) == []
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.commands_sent()[-1] == last
    assert bench.bus.take_events(NetworkStarted) == [NetworkStarted(0, (2, 3))]
