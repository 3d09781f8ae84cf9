"""Each headline, summary and exit status of `canopen net boot` and `net watch` says what the devices really do.

The devices are tables of objects in virtual time; the oracle is their own NMT state and what was planted in them.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_cli.net.boot_summary import NodeRow, NodeState, by_state, policy, problem_of, rows_of, success, tally
from canopen_cli.net.check import Checked, verdict
from canopen_cli.shared.problem import ExitCode
from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, NEVER, SECOND
from canopen_proto.manager.boot.assignment import Startup
from canopen_proto.manager.boot.comparison import Compared, NodeComparison
from canopen_proto.manager.boot.entry import NetworkEntry
from canopen_proto.manager.boot.network_boot import BootReport
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome, BootStep
from tests.examples import examples
from tests.manager.boot_bench import KEPT, MANDATORY, OPTIONAL, SERIAL, SETTING, BootBench, beating, entry, u32

OPERATIONAL = 5
SILENT, WRONG, REFUSES, NO_BEAT, RIGHT = "silent", "wrong", "refuses", "no beat", "right"
FAULTS = (SILENT, WRONG, REFUSES, NO_BEAT)
STARTS = {"each": 1, "all": 3, "none": 9}
"""The values of 0x1F80: bit 0 the master, bit 1 all at once, bit 3 the application starts."""


@dataclass(frozen=True)
class Planted:
    """A node: what is planted in it, and whether the network needs it."""

    fault: str
    is_mandatory: bool
    is_kept: bool = False


NODE = st.builds(Planted, st.sampled_from([*FAULTS, RIGHT, RIGHT, RIGHT]), st.booleans()) | st.builds(
    Planted, st.sampled_from([SILENT, WRONG, RIGHT]), st.booleans(), st.just(True)
)
NODES = st.lists(NODE, min_size=1, max_size=5)


def booted(bus: str, nodes: list[Planted], start: str, heard: int) -> tuple[list[NodeRow], int]:
    """Boot a bus; return its table, and how many devices are Operational. heard: ms for heartbeats before."""
    bench = BootBench(range(1, 1 + len(nodes)))
    entries = []
    for node_id, planted in enumerate(nodes, start=1):
        device = bench.nodes[node_id]
        if planted.is_kept:  # it runs already
            beating(bench, node_id)
            bench.bus.run(heard * MILLISECOND)
        if planted.fault == SILENT:
            device.switch_off()
        elif planted.fault == WRONG:
            device.defaults[SERIAL] = device.table[SERIAL] = u32(4711)
        elif planted.fault == REFUSES:
            device.defaults[SETTING] = int(AbortCode.DEVICE_STATE)
        elif planted.fault == NO_BEAT:
            device.on_write = lambda place, data, device=device: setattr(device, "_beats_at", NEVER)  # type: ignore[misc]
        kind = MANDATORY if planted.is_mandatory else OPTIONAL
        entries.append(entry(node_id, kind | (KEPT & ~MANDATORY if planted.is_kept else 0)))
    boot = bench.network_boot(STARTS[start], *entries, boot_time=SECOND)
    report: BootReport = bench.run(boot.start())
    bench.bus.run(MILLISECOND)
    places = {node_id: f"n{node_id} on {bus}" for node_id in bench.nodes}
    running = sum(device.state == OPERATIONAL for device in bench.nodes.values())
    described = NetworkEntry(boot.startup, {each.node_id: each for each in entries})
    return rows_of(bus, described, report, places), running


def running_in(text: str) -> int:
    """Return the number of running nodes that a headline tells."""
    if "no node runs" in text or "no node was started" in text:
        assert not re.search(r"\d+ of \d+ nodes? runs?", text)
        return 0
    (found,) = re.findall(r"(\d+) of \d+ nodes? runs?", text)
    return int(found)


@examples(150, least=30)
@given(buses=st.lists(NODES, min_size=1, max_size=3), start=st.sampled_from(list(STARTS)), heard=st.sampled_from([0, 150]))
@example(buses=[[Planted(RIGHT, True), Planted(WRONG, True)]], start="each", heard=150)
@example(buses=[[Planted(RIGHT, True), Planted(WRONG, True)]], start="all", heard=150)
@example(buses=[[Planted(RIGHT, True)], [Planted(WRONG, True), Planted(SILENT, True)]], start="all", heard=150)
@example(buses=[[Planted(RIGHT, False, True), Planted(SILENT, True)]], start="all", heard=150)
@example(buses=[[Planted(WRONG, True, True), Planted(WRONG, True)]], start="all", heard=150)
def test_headlines_say_what_the_devices_do(buses: list[list[Planted]], start: str, heard: int) -> None:
    rows: list[NodeRow] = []
    running = 0
    for number, nodes in enumerate(buses):
        table, count = booted(f"can{number}", nodes, start, heard)
        rows += table
        running += count
        if start == "all" and any(each.fault in FAULTS and each.is_mandatory for each in nodes):
            assert count == sum(each.is_kept and each.fault != SILENT for each in nodes), "nobody was started"
    planted = [each for nodes in buses for each in nodes]
    startup = Startup.from_value(STARTS[start])
    problem = problem_of(rows, startup)
    failed = [each for each in planted if each.fault in FAULTS]
    missing = [each for each in failed if each.is_mandatory]
    assert (problem is None) == (not failed)
    headline = success(rows) if problem is None else problem.failed
    wrong_ones = sum(each.is_kept and each.fault == WRONG for each in planted)
    assert running_in(headline) + wrong_ones == running_in(tally(rows)) + wrong_ones == running
    told = Counter(row.state for row in rows)
    assert told[NodeState.RUNS_ON] <= wrong_ones
    assert told[NodeState.RUNS_ON] == wrong_ones or not heard
    assert told[NodeState.RUNS_ON] + told[NodeState.MAY_RUN] == sum(each.is_kept for each in failed)
    assert "no node runs" not in headline or running == 0
    assert len(rows) == len(planted)
    if problem is None:
        assert headline.startswith(f"{len(rows)} node")
        return
    is_silent = any(each.fault in (SILENT, NO_BEAT) for each in missing)
    assert problem.exit_code == (ExitCode.NO_ANSWER if is_silent else ExitCode.PARTIAL)
    assert problem.code == ("CO215" if missing else "CO216")
    numbers = re.match(r"(\d+) (mandatory )?nodes? not ready", headline)
    assert numbers is not None
    assert int(numbers[1]) == len(missing or failed)
    kept = sum(each.is_kept for each in failed)
    assert kept == len(failed) or f"{len(failed) - kept} failed" in headline
    assert not kept or "since it is kept alive" in headline
    if missing:
        assert policy(startup) in problem.also


@pytest.mark.parametrize("start", ["each", "all"])
@pytest.mark.parametrize("state", [4, 0x7F])
def test_a_node_that_does_not_follow_its_start_command_is_not_told_to_run(start: str, state: int) -> None:
    bench = BootBench((1, 2))
    deaf, obey = bench.nodes[1], bench.nodes[1]._obey
    deaf._obey = lambda command, now: setattr(deaf, "state", state) if command == 1 else obey(command, now)  # type: ignore[method-assign]
    boot = bench.network_boot(STARTS[start])
    report: BootReport = bench.run(boot.start())
    described = NetworkEntry(boot.startup, {each: entry(each, MANDATORY) for each in bench.nodes})
    rows = rows_of("can0", described, report, {1: "n1", 2: "n2"})
    problem = problem_of(rows, boot.startup)
    assert problem is not None
    assert (problem.exit_code, problem.node) == (ExitCode.PARTIAL, 1)
    assert "1 of 2 nodes runs, 1 started and not running" in problem.failed
    assert problem.seen == "n1: was started, and shows that it does not run"
    assert "canopen nmt start 1" in problem.tries[0]


@examples(300, least=60)
@given(
    states=st.lists(st.tuples(st.sampled_from(list(NodeState)), st.booleans(), st.sampled_from(list(BootLetter))), min_size=1),
    startup=st.builds(Startup, start_all=st.booleans(), application_starts=st.booleans()),
)
def test_any_table_gives_a_headline_that_adds_up(states: list[tuple[NodeState, bool, BootLetter]], startup: Startup) -> None:
    """Also for states that only `net watch` meets: each node is counted once, in the headline and in the story."""
    rows = [
        NodeRow("can0", number, f"n{number}.", is_mandatory, state, BootOutcome(number, letter, BootStep.IDENTITY))
        for number, (state, is_mandatory, letter) in enumerate(states, start=1)
    ]
    text = tally(rows)
    others = [int(number) for number in re.findall(r", (\d+) ", text)]
    assert running_in(text) + sum(others) == len(rows)
    story = by_state(rows)
    assert all(sum(f"{row.place}," in f"{line}," for line in story) == 1 for row in rows)
    problem = problem_of(rows, startup)
    bad = [row for row in rows if row.state not in (NodeState.RUNNING, NodeState.UNWATCHED, NodeState.READY)]
    assert (problem is None) == (not bad)
    if problem is not None:
        assert problem.code == ("CO215" if any(row.is_mandatory for row in bad) else "CO216")
        assert text in problem.failed
        assert problem.node in {row.node_id for row in bad}


KINDS = {
    "as in the file": [],
    "silent": [],
    "another device": [Compared(0x1018, 4, u32(1), u32(2))],
    "with other settings": [Compared(0x2000, 0, u32(1), u32(2), is_setting=True)],
}
"""A word of the headline of `net check` -> what is wrong with such a node."""


@examples(200, least=40)
@given(
    kinds=st.lists(st.tuples(st.sampled_from(list(KINDS)), st.booleans(), st.booleans()), min_size=1, max_size=20),
)
def test_the_headline_of_a_check_adds_up(kinds: list[tuple[str, bool, bool]]) -> None:
    """Each node is counted once, with what is planted in it. Another device is that, whatever its settings are."""
    nodes = []
    for number, (kind, has_right_ones, has_other_settings) in enumerate(kinds, start=1):
        objects = [Compared(0x1000, 0, u32(5), u32(5))] * has_right_ones + KINDS[kind]
        if kind == "another device" and has_other_settings:
            objects += KINDS["with other settings"]
        nodes.append(Checked(None, NodeComparison(number, kind != "silent", tuple(objects)), None))  # type: ignore[arg-type]
    headline, status = verdict(nodes)
    planted = Counter(kind for kind, _, _ in kinds)
    told = {words: int(number) for number, words in re.findall(r"(\d+) (silent|another device|with other settings)", headline)}
    right = planted.pop("as in the file", 0)
    assert headline.startswith(f"{right} of {len(kinds)} node")
    assert told == planted
    assert right + sum(told.values()) == len(kinds)
    if right == len(kinds):
        assert status is ExitCode.OK
    else:
        assert status is (ExitCode.NO_ANSWER if planted["silent"] == len(kinds) else ExitCode.DIFFERENT)
