"""The start of a network leaves nodes alone that are in no list, or get a program. It tells which ones are gone meanwhile."""

from __future__ import annotations

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Outbox
from canopen_proto.procedures.steps import Procedure
from tests.manager.boot_bench import MANDATORY, OPTIONAL, BootBench, TableNode, entry


def test_no_command_to_all_starts_a_node_that_nobody_has_checked() -> None:
    bench = BootBench([2, 3])
    stranger = bench.bus.attach(TableNode(Outbox(), 127))
    stranger.boot(bench.bus.now)
    bench.master.receive(Frame.parse("77F#00"), bench.bus.now)
    report = bench.run(bench.network_boot(3).start())
    bench.bus.run(MILLISECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#0103"]
    assert (report.running, stranger.state) == ((2, 3), 0x7F)


def test_our_own_node_is_no_stranger() -> None:
    bench = BootBench([2, 3])
    bench.master.receive(Frame.parse("77F#00"), bench.bus.now)
    bench.run(bench.network_boot(3, own_id=127).start())
    assert bench.commands_sent() == ["000#8200", "000#0100"]


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_node_that_gets_a_program_is_not_reset_by_a_command_that_waits(is_lost: bool) -> None:
    """It was suspended within the pause between two NMT commands."""
    bench = BootBench([2, 3], pause=500 * MILLISECOND)
    boot = bench.network_boot(1, entry(2, OPTIONAL), entry(3, OPTIONAL))
    bench.supervise(boot, 2 * SECOND)
    bench.bus.sent.clear()
    for node_id in (2, 3):
        if is_lost:
            bench.nodes[node_id].switch_off()
        else:
            boot.boot_again(node_id, bench.bus.now)
    bench.bus.run_until(lambda: len(bench.commands_sent()) == 1, 2 * SECOND)
    bench.bus.run(100 * MILLISECOND)
    boot.suspend(3, bench.bus.now)
    bench.bus.run(5 * SECOND)
    assert not any(command.endswith("03") for command in bench.commands_sent())
    boot.boot_again(3, bench.bus.now)
    bench.bus.run(2 * SECOND)
    assert any(command.endswith("03") for command in bench.commands_sent())


def test_a_node_that_is_lost_while_others_boot_is_not_told_to_run() -> None:
    bench = BootBench([2, 3])
    bench.nodes[3].boot_delay = 1500 * MILLISECOND
    boot = bench.network_boot(1, entry(2, OPTIONAL), entry(3, MANDATORY))
    request_id = bench.master.run(boot.start(), bench.bus.now)
    bench.bus.run(300 * MILLISECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102"]
    bench.nodes[2].switch_off()
    bench.outcome(request_id)
    report = boot.report(bench.bus.now)
    assert (report.running, report.gone, report.missing) == ((3,), (2,), ())


@pytest.mark.parametrize(("startup", "command"), [(0x41, "000#0200"), (0x11, "000#8100")])
def test_no_node_runs_on_without_a_mandatory_one_because_another_is_awaited(startup: int, command: str) -> None:
    bench = BootBench([2, 3, 4])
    described = entry(2, MANDATORY), entry(3, OPTIONAL), entry(4, MANDATORY)
    boot = bench.network_boot(startup, *described, boot_time=60 * SECOND)
    bench.nodes[4].boot_delay = NEVER

    def both() -> Procedure[object]:
        yield from boot.start()
        return (yield from boot.supervise())

    bench.master.run(both(), bench.bus.now)
    bench.bus.run(4 * SECOND)
    assert bench.commands_sent() == ["000#8200", "000#0102", "000#0103"]
    bench.nodes[2].switch_off()
    bench.bus.run(SECOND)
    assert bench.commands_sent()[3] == command


def test_nodes_that_are_mixed_up_are_refused() -> None:
    bench = BootBench([2, 3])
    bench.remotes = {2: bench.remotes[3], 3: bench.remotes[2]}
    with pytest.raises(LocalProtocolError, match="the RemoteNode for node 2 is that of node 3"):
        bench.network_boot()
