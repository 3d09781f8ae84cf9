"""A node that was started is called running only as long as nothing that it says is against it; a lost start is sent again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.manager.boot.network_boot import NetworkBoot
from canopen_proto.nmt import NmtCommand
from tests.core.bus import Fate
from tests.examples import examples
from tests.manager.boot_bench import HEARTBEAT_TIME, MANDATORY, OPTIONAL, BootBench, entry

START_ALL = 3
OPERATIONAL, PRE_OPERATIONAL = 5, 0x7F
GUARDED = MANDATORY | 3 << 8 | 100 << 16


def lose(bench: BootBench, command: str, count: int) -> None:
    """Nobody gets the first frames that are this command."""
    deliver = bench.bus._deliver
    left = count * len(bench.nodes)

    def drop(receiver: object, frame: Frame) -> None:
        nonlocal left
        if str(frame) == command and left:
            left -= 1
        else:
            deliver(receiver, frame)  # type: ignore[arg-type]

    bench.bus._deliver = drop  # type: ignore[method-assign]


def said_to_run(bench: BootBench, boot: NetworkBoot) -> set[int]:
    return set(boot.report(bench.bus.now).running)


@pytest.mark.parametrize(("startup", "command"), [(1, "000#0106"), (START_ALL, "000#0100")])
@pytest.mark.parametrize("assignment", [MANDATORY, OPTIONAL, GUARDED])
def test_a_start_command_that_gets_lost_is_sent_again(startup: int, command: str, assignment: int) -> None:
    bench = BootBench((6, 7))
    bench.node.guarded = assignment == GUARDED
    bench.nodes[7].guarded = bench.node.guarded
    boot = bench.network_boot(
        startup, *(entry(each, assignment, consumer_time=0 if bench.node.guarded else 500 * MILLISECOND) for each in bench.nodes)
    )
    lose(bench, command, 1)
    report = bench.run(boot.start())
    assert [node.state for node in bench.nodes.values()] == [OPERATIONAL, OPERATIONAL]
    assert report.running == (6, 7)


def test_a_node_that_does_not_follow_its_start_command_is_not_called_running() -> None:
    bench = BootBench((6, 7))
    boot = bench.network_boot()
    lose(bench, "000#0106", 99)
    report = bench.run(boot.start())
    assert (report.running, report.idle, bench.node.state) == ((7,), (6,), PRE_OPERATIONAL)
    assert bench.commands_sent().count("000#0106") == 3


def test_a_node_that_boots_later_and_misses_its_start_command_gets_it_again() -> None:
    bench = BootBench()
    boot = bench.network_boot()
    bench.supervise(boot, SECOND)
    lose(bench, "000#0106", 1)
    bench.node.boot(bench.bus.now)
    bench.bus.run(5 * SECOND)
    assert (bench.node.state, said_to_run(bench, boot)) == (OPERATIONAL, {6})


@pytest.mark.parametrize(("command", "state"), [(NmtCommand.STOP, 4), (NmtCommand.ENTER_PRE_OPERATIONAL, 0x7F)])
def test_a_node_that_another_master_has_stopped_is_not_called_running(command: NmtCommand, state: int) -> None:
    bench = BootBench((6, 7))
    boot = bench.network_boot()
    bench.supervise(boot, SECOND)
    bench.bus.sent.clear()
    bench.bus.send(Frame(0, bytes((command, 6))))
    bench.bus.run(2 * HEARTBEAT_TIME)
    assert (said_to_run(bench, boot), boot.report(bench.bus.now).idle) == ({7}, (6,))
    bench.bus.run(5 * SECOND)
    assert (bench.node.state, len(bench.commands_sent())) == (state, 1), "it is left to that master"


def test_the_loss_of_a_mandatory_node_concerns_all_at_once_though_others_have_not_shown_that_they_run() -> None:
    bench = BootBench((6, 7))
    slow = entry(7, OPTIONAL, consumer_time=60 * SECOND, configuration=((0x1017, 0, (20_000).to_bytes(2, "little")),))
    boot = bench.network_boot(0x41, entry(6, MANDATORY), slow)
    request_id = bench.master.run(boot.start(), bench.bus.now)
    bench.bus.run_until(lambda: bench.commands_sent()[-1:] == ["000#0107"])
    bench.node.switch_off()
    lost_at = bench.bus.now
    report = bench.outcome(request_id)
    assert report.gone == (6,)
    assert bench.bus.now <= lost_at + SECOND


FATES = (*[Fate.DELIVERED] * 6, Fate.LOST, Fate.COPIED)


@examples(150)
@given(
    fates=st.lists(st.sampled_from(FATES), max_size=80),
    skipped=st.integers(0, 60),
    startup=st.sampled_from([1, START_ALL]),
    reset_at=st.none() | st.integers(0, 60),
)
def test_whatever_gets_lost_and_whoever_boots_the_nodes_that_are_told_to_run_do(
    fates: list[Fate], skipped: int, startup: int, reset_at: int | None
) -> None:
    """A node may boot at any frame. Soon after the last lost frame each node does what the report says, with its settings, and
    none was written while it ran."""
    bench = BootBench((6, 7))
    written_in: list[int] = []
    for node in bench.nodes.values():
        node.state = OPERATIONAL
        node.on_write = lambda place, data, node=node: written_in.append(node.state)  # type: ignore[misc]
    boot = bench.network_boot(startup)
    bench.bus._fates = iter([*[Fate.DELIVERED] * skipped, *fates])
    request_id = bench.master.run(boot.start(), bench.bus.now)
    if reset_at is not None:
        bench.bus.run_until(lambda: len(bench.bus.sent) > reset_at or not bench.master.runner.busy)
        bench.node._obey(NmtCommand.RESET_NODE, bench.bus.now)
        bench.node._rearm()
    bench.outcome(request_id)
    bench.master.run(boot.supervise(), bench.bus.now)
    bench.bus._fates = iter(())
    bench.bus.run(15 * SECOND)
    report = boot.report(bench.bus.now)
    assert OPERATIONAL not in written_in
    assert set(report.running) == {node_id for node_id, node in bench.nodes.items() if node.state == OPERATIONAL}
    for node_id in report.running:
        assert bench.nodes[node_id].table[0x2002, 0] == b"\x34\x12", "it runs without its settings"


@pytest.mark.parametrize("heartbeat", [bytes(2), b"\x64\0"])
@pytest.mark.parametrize("assignment", [MANDATORY, OPTIONAL])
def test_a_reset_that_gets_lost_is_sent_again_before_the_node_is_configured(assignment: int, heartbeat: bytes) -> None:
    """Else it is configured while it runs, with what somebody else has left in it."""
    bench = BootBench((6, 7))
    bench.node.table[0x1017, 0] = heartbeat
    bench.node.boot(bench.bus.now)
    bench.node.state = OPERATIONAL
    bench.bus.run(SECOND)
    bench.bus.sent.clear()
    written_in: list[int] = []
    bench.node.on_write = lambda place, data: written_in.append(bench.node.state)
    boot = bench.network_boot(1, entry(6, assignment), entry(7, MANDATORY))
    lose(bench, "000#8200", 1)
    report = bench.run(boot.start())
    assert set(written_in) == {PRE_OPERATIONAL}
    assert [str(outcome.letter) for outcome in report.outcomes.values()] == ["0", "0"]
    assert bench.commands_sent()[:3] == ["000#8200", "000#8206", "000#8207"]


def test_a_node_that_never_sends_a_boot_up_is_booted_all_the_same() -> None:
    bench = BootBench()
    boot_up = Frame(0x706, b"\0")
    deliver = bench.bus._deliver
    bench.bus._deliver = lambda receiver, frame: None if frame == boot_up else deliver(receiver, frame)  # type: ignore[method-assign]
    report = bench.run(bench.network_boot().start())
    assert (report.running, str(report.outcomes[6].letter)) == ((6,), "0")
