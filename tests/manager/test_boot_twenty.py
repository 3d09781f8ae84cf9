"""Twenty nodes side by side, one of which fails in any step; and random faults: no failed node is ever started."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, Time
from canopen_proto.manager.boot.network_boot import BootReport
from tests.examples import examples
from tests.manager.boot_bench import (
    DEVICE_TYPE,
    HEARTBEAT,
    HEARTBEAT_TIME,
    IDENTITY,
    KEPT,
    KIND,
    LOAD,
    MANDATORY,
    OPTIONAL,
    PRODUCT,
    PROGRAM,
    REVISION,
    SAVE,
    SERIAL,
    SETTING,
    VENDOR,
    Answer,
    BootBench,
    Object,
    TableNode,
    entry,
    u32,
)

TWENTY = range(2, 22)
ODD_ONE = 13
REFUSED, WRONG, SILENT = 0x0800_0022, u32(0x63), None
ROUND_TRIP = 200 * MICROSECOND
"""Of a request and its answer on the bus of the bench."""

FAULTS: list[tuple[str, dict[Object, Answer]]] = [
    ("B", {DEVICE_TYPE: SILENT}),
    ("B", {DEVICE_TYPE: REFUSED}),
    ("C", {DEVICE_TYPE: WRONG}),
    *((letter, {place: fault}) for letter, place in zip("DMNO", (VENDOR, PRODUCT, REVISION, SERIAL), strict=True)
      for fault in (SILENT, REFUSED, WRONG)),
    ("G", {PROGRAM: SILENT}),
    ("G", {PROGRAM: REFUSED}),
    ("H", {PROGRAM: WRONG}),
    *(("J", {place: fault}) for place in (LOAD, HEARTBEAT, SETTING, SAVE) for fault in (SILENT, REFUSED)),
]  # fmt: skip


@pytest.mark.thorough(5)
@pytest.mark.parametrize("startup", [1, 3])
@pytest.mark.parametrize(("letter", "answers"), FAULTS)
def test_one_of_twenty_fails_in_any_step(letter: str, answers: dict[Object, Answer], startup: int) -> None:
    bench = BootBench(TWENTY, together=True)
    bench.nodes[ODD_ONE].defaults.update(answers)
    told = {"software": 1, "restore_subindex": 1, "save": True}
    others = [entry(node_id, MANDATORY | 0xA0, **told) for node_id in TWENTY if node_id != ODD_ONE]
    boot = bench.network_boot(startup, *others, entry(ODD_ONE, OPTIONAL | 0xA0, **told))
    report = bench.run(boot.start())
    assert {node_id: str(outcome.letter) for node_id, outcome in report.outcomes.items()} == {
        **dict.fromkeys(TWENTY, "0"), ODD_ONE: letter,
    }  # fmt: skip
    assert report.running == tuple(node_id for node_id in TWENTY if node_id != ODD_ONE)
    bench.bus.run(MILLISECOND)
    assert [node_id for node_id, node in bench.nodes.items() if node.state != 5] == [ODD_ONE]
    assert "000#0100" not in bench.commands_sent()


def test_nineteen_do_not_wait_for_a_twentieth_that_is_away() -> None:
    bench = BootBench(TWENTY, together=True)
    bench.nodes[ODD_ONE].switch_off()
    entries = [entry(node_id, OPTIONAL if node_id == ODD_ONE else MANDATORY) for node_id in TWENTY]
    begun = bench.bus.now
    request_id = bench.master.run(bench.network_boot(3, *entries).start(), begun)
    bench.bus.run(400 * MILLISECOND)
    assert sum(node.state == 5 for node in bench.nodes.values()) == 19
    report: BootReport = bench.outcome(request_id)
    seen = bench.bus.now - 2400 * MILLISECOND
    assert begun <= seen <= begun + HEARTBEAT_TIME, "until the others have shown that they run"
    assert report.outcomes[ODD_ONE].letter == "B"


def test_twenty_nodes_take_the_time_of_one() -> None:
    """Devices that need 1 ms for each answer: eight requests to each, all nodes side by side."""
    bench = BootBench(TWENTY, together=True)
    for node in bench.nodes.values():
        node.answer_delay, node.boot_delay = MILLISECOND, 0
    begun = bench.bus.now
    report = bench.run(bench.network_boot(3, *(entry(node_id, MANDATORY, consumer_time=0) for node_id in TWENTY)).start())
    assert report.is_started
    requests = [frame for _, frame in bench.bus.sent if 0x600 < frame.can_id < 0x680]
    one_by_one = len(requests) * (MILLISECOND + ROUND_TRIP)
    assert len(requests) == 8 * 20
    assert one_by_one == 192 * MILLISECOND
    started_at = next(moment for moment, frame in bench.bus.sent if str(frame) == "000#0100")
    assert started_at - begun == one_by_one // 20 + ROUND_TRIP, "the reset and the boot-ups beside them"


# ---- any faults, at any time ----


class Judge:
    """Watches what is started: only nodes that are right, and configured since their last boot-up."""

    def __init__(self, bench: BootBench) -> None:
        self.since_boot: dict[int, set[Object]] = {}
        self.booted_at: dict[int, Time] = {}
        self.started = 0
        for node_id, node in bench.nodes.items():
            self._follow(node_id, node)

    def _follow(self, node_id: int, node: TableNode) -> None:
        boot, receive = node.boot, node.receive
        self.since_boot[node_id], self.booted_at[node_id] = set(), -NEVER

        def boots(now: Time) -> None:
            self.since_boot[node_id], self.booted_at[node_id] = set(), now
            boot(now)

        def hears(frame: Frame, now: Time) -> None:
            if frame.can_id == 0 and frame.data[0] == 1 and frame.data[1] in (0, node_id) and node.state in (4, 0x7F):
                self.judge(node_id, node, now)
            receive(frame, now)

        node.boot, node.receive = boots, hears  # type: ignore[method-assign]
        node.on_write = lambda place, data: self.since_boot[node_id].add(place)

    def judge(self, node_id: int, node: TableNode, now: Time) -> None:
        self.started += 1
        if now - self.booted_at[node_id] <= ROUND_TRIP:
            return  # its boot-up and the command have passed each other: nobody could have known
        identity = [node.table[0x1018, subindex] for subindex in range(1, 5)]
        assert identity == [u32(number) for number in IDENTITY]
        assert node.table[DEVICE_TYPE] == u32(KIND)
        assert self.since_boot[node_id] >= {HEARTBEAT, SETTING}, f"node {node_id} was started without its configuration"


OBJECTS = (DEVICE_TYPE, VENDOR, PRODUCT, REVISION, SERIAL, HEARTBEAT, SETTING)
EVENTS = ("off", "boot", "unplug", "plug", "mute", "right", "wrong", "slow")


@st.composite
def networks(draw: st.DrawFn) -> dict[str, Any]:
    node_ids = (2, 3, 4)
    fault = st.tuples(st.sampled_from(OBJECTS), st.sampled_from([REFUSED, WRONG, SILENT]))
    moment = st.integers(0, 4000).map(lambda ms: ms * MILLISECOND + 50 * MICROSECOND)
    return {
        "startup": draw(st.sampled_from([0x01, 0x03, 0x11, 0x13, 0x07, 0x0B])),
        "assignments": [draw(st.sampled_from([MANDATORY, OPTIONAL, KEPT])) for _ in node_ids],
        "faults": [draw(st.none() | fault) for _ in node_ids],
        "delays": [draw(st.sampled_from([0, 12, 500, 2500])) * MILLISECOND for _ in node_ids],
        "events": sorted(
            draw(st.lists(st.tuples(moment, st.sampled_from(node_ids), st.sampled_from(EVENTS)), max_size=6)),
        ),
        "boot_time": draw(st.sampled_from([0, 3 * SECOND])),
    }


@given(networks())
@examples(400, least=40)
def test_no_failed_node_is_ever_started(plan: dict[str, Any]) -> None:
    bench = BootBench([2, 3, 4])
    judge = Judge(bench)
    entries = []
    for node_id, assignment, fault, delay in zip(bench.nodes, plan["assignments"], plan["faults"], plan["delays"], strict=True):
        node = bench.nodes[node_id]
        node.boot_delay = delay
        if fault is not None:
            node.table[fault[0]] = node.defaults[fault[0]] = fault[1]
        entries.append(entry(node_id, assignment))
    boot = bench.network_boot(plan["startup"], *entries, boot_time=plan["boot_time"])
    begun = bench.bus.now

    def both() -> Any:
        yield from boot.start()
        yield from boot.supervise()

    bench.master.run(both(), begun)
    for moment, node_id, event in plan["events"]:
        bench.bus.run(max(begun + moment - bench.bus.now, 0))
        happen(bench, bench.nodes[node_id], event)
    bench.bus.run(6 * SECOND)
    report = boot.report(bench.bus.now)
    running = {node_id for node_id, node in bench.nodes.items() if node.state == 5 and node in bench.bus.machines}
    for node_id in running:
        assert judge.since_boot[node_id] >= {HEARTBEAT, SETTING}, "it runs, and has booted since it was configured"
    if plan["startup"] & 8:
        assert judge.started == 0
    if not plan["events"]:
        assert set(report.running) == running
        assert not [node_id for node_id in report.running if report.outcomes[node_id].is_failure]


def happen(bench: BootBench, node: TableNode, event: str) -> None:
    """Something happens to a node."""
    now = bench.bus.now
    match event:
        case "off":
            node.switch_off()
        case "boot":
            node.table = dict(node.defaults)
            node.boot(now)
        case "unplug" if node in bench.bus.machines:
            bench.bus.detach(node)
        case "plug" if node not in bench.bus.machines:
            bench.bus.attach(node)
        case "mute":
            node.table[HEARTBEAT] = bytes(2)
            node._begin_heartbeat(now)
            node._rearm()
        case "right":
            identity = {(0x1018, subindex): u32(number) for subindex, number in enumerate(IDENTITY, start=1)}
            node.defaults.update({DEVICE_TYPE: u32(KIND), HEARTBEAT: bytes(2), SETTING: bytes(2), **identity})
        case "wrong":
            node.defaults[SERIAL] = WRONG
        case "slow":
            node.answer_delay = 90 * MILLISECOND
