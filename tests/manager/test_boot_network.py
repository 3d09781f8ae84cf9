"""The start of a network, and what the master does afterwards."""

from __future__ import annotations

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.manager.boot.network_boot import BootReport, LossResponse, NetworkStarted, NodeLost
from tests.manager.boot_bench import (
    HEARTBEAT,
    KEPT,
    MANDATORY,
    OPTIONAL,
    SERIAL,
    SETTING,
    BootBench,
    beating,
    entry,
    u32,
)

WRONG = u32(0x63)


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
    assert bench.bus.take_events(NodeLost) == [NodeLost(3, LossResponse.RESET)]
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


@pytest.mark.parametrize("startup", [1, 3])
def test_a_node_comes_later(startup: int) -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].switch_off()
    bench.supervise(bench.network_boot(startup, entry(2, MANDATORY), entry(3, OPTIONAL)), SECOND)
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


def test_a_node_that_boots_again_before_all_are_started_is_booted_once_more() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = SECOND
    request_id = bench.master.run(bench.network_boot(3).start(), bench.bus.now)
    bench.bus.run(500 * MILLISECOND)
    assert bench.letters() == "0"
    bench.nodes[2].boot(bench.bus.now)
    report: BootReport = bench.outcome(request_id)
    assert bench.letters() == "000"
    assert (report.is_started, bench.commands_sent()) == (True, ["000#8200", "000#0100"])


def test_a_node_that_was_lost_before_all_are_started_is_not_started() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = 1900 * MILLISECOND
    request_id = bench.master.run(bench.network_boot(3).start(), bench.bus.now)
    bench.bus.run(SECOND)
    bench.nodes[2].switch_off()
    report: BootReport = bench.outcome(request_id)
    assert (report.is_started, report.missing) == (False, (2,))
    assert bench.commands_sent() == ["000#8200"]


# ---- mandatory and optional, there and late and lost ----


@pytest.mark.parametrize("assignment", [MANDATORY, OPTIONAL])
@pytest.mark.parametrize("boot_time", [0, 5000 * MILLISECOND])
@pytest.mark.parametrize(("late", "letters"), [(100, "0"), (2100, "0"), (4000, "?"), (8000, "B")])
def test_nodes_that_come_late(assignment: int, boot_time: int, late: int, letters: str) -> None:
    """Only a mandatory node is waited for, and only with a boot time; the others are booted when they come."""
    bench = BootBench([2])
    bench.nodes[2].boot_delay = late * MILLISECOND
    begun = bench.bus.now
    boot = bench.network_boot(1, entry(2, assignment), boot_time=boot_time)
    report = bench.run(boot.start())
    waits = assignment == MANDATORY and boot_time > 0
    expected = letters if letters != "?" else "0" if waits else "B"
    assert report.outcomes[2].letter == expected
    assert report.is_started == (expected == "0" or assignment == OPTIONAL)
    if expected == "B":
        assert bench.bus.now - begun == (boot_time if waits else 2400 * MILLISECOND), "exactly"
    bench.master.run(boot.supervise(), bench.bus.now)
    bench.bus.run(10 * SECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102"]
    assert boot.report(bench.bus.now).is_started
    assert boot.is_started


@pytest.mark.thorough(3)
@pytest.mark.parametrize("assignment", [MANDATORY, OPTIONAL, KEPT, OPTIONAL & ~4, MANDATORY & ~4])
@pytest.mark.parametrize("startup", [0x01, 0x03, 0x11, 0x41])
def test_a_lost_node_has_one_reaction(assignment: int, startup: int) -> None:
    """However long it stays away."""
    bench = BootBench([2, 3])
    beating(bench, 3)
    bench.supervise(bench.network_boot(startup, entry(2, MANDATORY), entry(3, assignment)), SECOND)
    bench.bus.sent.clear()
    bench.nodes[3].switch_off()
    bench.bus.run(60 * SECOND)
    concerns_all = assignment & 8 and startup > 0xF
    if concerns_all:
        expected = {0x11: "000#8100", 0x41: "000#0200"}[startup]
        assert bench.commands_sent()[0] == expected
        assert [each for each in bench.commands_sent()[1:] if each != "000#0102"] == []
    else:
        assert bench.commands_sent() == (["000#8103"] if assignment in (MANDATORY, OPTIONAL) else [])
    assert len(bench.bus.take_events(NodeLost)) == 1


def test_a_running_node_that_boots_has_lost_its_settings() -> None:
    bench = BootBench([2, 3])
    bench.supervise(bench.network_boot(), SECOND)
    bench.bus.sent.clear()
    bench.nodes[3].writes.clear()
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#0103"]
    assert [place for place, _ in bench.nodes[3].writes] == [HEARTBEAT, SETTING]


def test_a_node_that_is_left_to_the_application_is_only_watched() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].defaults[HEARTBEAT] = b"\x64\0"
    bench.supervise(bench.network_boot(1, entry(2, MANDATORY), entry(3, 0x01)), SECOND)
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    bench.nodes[3].switch_off()
    bench.bus.run(SECOND)
    assert bench.bus.take_events(NodeLost) == [NodeLost(3, LossResponse.NONE)]
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.letters() == "0000"
    assert not [each for each in bench.bus.trace() if each.startswith(("603#", "000#8103", "000#0103"))]


# ---- kept alive ----


def test_a_running_node_is_left_running() -> None:
    bench = BootBench([2, 3, 4])
    beating(bench, 3)
    for heartbeat in ("709#05", "70A#05"):  # of nodes that are not in the list; the second is our own
        bench.master.receive(Frame.parse(heartbeat), bench.bus.now)
    report = bench.run(bench.network_boot(1, entry(2, MANDATORY), entry(3, KEPT), entry(4, OPTIONAL), own_id=10).start())
    assert bench.commands_sent() == ["000#8202", "000#8204", "000#8209", "000#0102", "000#0104"]
    assert report.running == (2, 3, 4)
    assert bench.nodes[3].writes == []
    assert report.outcomes[3].letter == "L"


def test_all_are_started_at_once_though_one_runs_already() -> None:
    bench = BootBench([2, 3])
    beating(bench, 3)
    report = bench.run(bench.network_boot(3, entry(2, MANDATORY), entry(3, KEPT)).start())
    assert bench.commands_sent() == ["000#8202", "000#0100"]
    assert report.running == (2, 3)


@pytest.mark.parametrize("state", [5, 0x7F])
def test_a_running_node_that_is_away_for_a_while(state: int) -> None:
    """It is not reset if it has gone on running."""
    bench = BootBench([2, 3])
    beating(bench, 3)
    bench.supervise(bench.network_boot(1, entry(2, MANDATORY), entry(3, KEPT)), SECOND)
    bench.bus.sent.clear()
    bench.bus.detach(bench.nodes[3])
    bench.bus.run(5 * SECOND)
    bench.nodes[3].state = state
    bench.bus.attach(bench.nodes[3])
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ([] if state == 5 else ["000#8203", "000#0103"])
    assert bench.letters() == ("L0L" if state == 5 else "L00")


# ---- what the host may say ----


def test_a_node_that_is_suspended_is_left_alone() -> None:
    bench = BootBench([2, 3])
    boot = bench.network_boot(0x11)
    bench.supervise(boot, SECOND)
    bench.bus.sent.clear()
    boot.suspend(3, bench.bus.now)
    bench.nodes[3].switch_off()
    bench.bus.run(10 * SECOND)
    bench.nodes[3].boot(bench.bus.now)
    bench.bus.run(10 * SECOND)
    assert bench.bus.trace().count("703#00") == 1
    assert bench.commands_sent() == []
    boot.boot_again(3, bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.commands_sent() == ["000#8203", "000#0103"]
    assert bench.letters() == "000"


def test_a_failed_node_may_be_booted_again() -> None:
    bench = BootBench([2])
    bench.nodes[2].defaults[SERIAL] = WRONG
    boot = bench.network_boot()
    bench.supervise(boot, SECOND)
    bench.nodes[2].defaults[SERIAL] = u32(0x4D)
    boot.boot_again(2, bench.bus.now)
    bench.bus.run(SECOND)
    assert bench.letters() == "O0"
    assert bench.commands_sent() == ["000#8200", "000#8202", "000#0102"]


def test_a_node_cannot_be_suspended_while_it_boots() -> None:
    bench = BootBench([2])
    boot = bench.network_boot()
    bench.master.run(boot.start(), bench.bus.now)
    bench.bus.run(100 * MILLISECOND)
    with pytest.raises(LocalProtocolError, match="node 2 boots at present"):
        boot.suspend(2, bench.bus.now)
    for command in (boot.suspend, boot.boot_again):
        with pytest.raises(LocalProtocolError, match="node 9 is not in the network list"):
            command(9, bench.bus.now)


def test_who_is_no_master_boots_no_network() -> None:
    bench = BootBench([2])
    with pytest.raises(LocalProtocolError, match="not the NMT master"):
        bench.network_boot(0)
    with pytest.raises(LocalProtocolError, match="no RemoteNode for node 7"):
        bench.network_boot(1, entry(7))
