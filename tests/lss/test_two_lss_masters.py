"""Two LSS masters at once, of two programs: each hears the other and refuses. No two devices ever get one node-ID."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from canopen_proto.lss.assign import LssAssignment, assign_all, give, in_order
from canopen_proto.lss.bit_rate import activate, prepare
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress, LssService
from canopen_proto.lss.scan import OTHERS_GONE, LssError, LssTool, Pace, survey
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureFailed, ProcedureFinished
from tests.lss.lss_bench import QUICK, LssBench

TYPE = (0x360, 0x2, 0x10003)
KNOWN = (*TYPE, None)
ADDRESSES = [LssAddress(*TYPE, 0x100 + 3 * place) for place in range(3)]
SAID = "another LSS master is at work on this bus: it sent 7E5#"


class TwoMasters(LssBench):
    """A second tool, of another program, on the same bus."""

    def __init__(self, addresses: list[LssAddress]) -> None:
        super().__init__(addresses)
        self.other = self.bus.attach(Network())
        self.other_tool = LssTool(self.other.out)
        self.other_tool.master.frame_gap = 0
        self.other.attach(self.other_tool)


@pytest.mark.parametrize("seed", range(12))
def test_of_two_assignments_at_once_no_two_devices_get_one_node_id(seed: int) -> None:
    draws = random.Random(seed)
    bench = TwoMasters(ADDRESSES)
    ends: list[ProcedureFinished | ProcedureFailed] = []
    on_event = bench.bus.on_event

    def keep(event: object) -> None:
        if isinstance(event, ProcedureFinished | ProcedureFailed):
            ends.append(event)
        on_event(event)  # type: ignore[arg-type]

    bench.bus.on_event = keep
    for network, tool in ((bench.network, bench.tool), (bench.other, bench.other_tool)):
        work = LssAssignment(tool, in_order(range(10, 100)), Pace(window=QUICK, guard=MILLISECOND), KNOWN)
        network.run(assign_all(work), bench.bus.now)
        bench.bus.run(draws.randrange(40_000) * MICROSECOND)
    bench.bus.run(20 * SECOND)
    texts = [str(end.error) if isinstance(end, ProcedureFailed) else end.result.unfinished for end in ends]
    assert len(ends) == 2
    assert all(SAID in text for text in texts), texts
    ids = [each for each in [*bench.ids, *(slave.persistent.node_id for slave in bench.slaves)] if each != UNCONFIGURED]
    assert all(count <= 2 for count in Counter(ids).values()), "active and stored of one device"
    assert len({each for each in bench.ids if each != UNCONFIGURED}) == len([each for each in bench.ids if each != UNCONFIGURED])
    assert bench.none_is_selected
    bench.bus.run(OTHERS_GONE)
    bench.run(assign_all(LssAssignment(bench.tool, in_order(range(50, 60)), bench.pace, KNOWN)))
    assert len(set(bench.ids)) == 3
    assert UNCONFIGURED not in bench.ids, "once it is alone, all goes well"


@pytest.mark.parametrize("at", range(1, 22, 2))
def test_a_device_that_the_other_master_has_selected_boots_with_no_node_id_of_ours(at: int) -> None:
    """The other one selects its device by a single frame, as after an inquiry by hand, while ours is written."""
    bench = TwoMasters(ADDRESSES[:2])
    request = bench.network.run(give(bench.tool, bench.pace, ADDRESSES[0], 33), bench.bus.now)
    while len(bench.bus.sent) < at:
        bench.bus.run(50 * MICROSECOND)
    bench.other.out.next_request_id()  # its requests have other numbers
    bench.other.run(give(bench.other_tool, bench.pace, ADDRESSES[1], 44), bench.bus.now)
    with pytest.raises(LssError, match="another LSS master"):
        bench.end_of(request)
    bench.bus.run(10 * SECOND)
    assert bench.ids.count(33) <= 1
    assert bench.ids.count(44) <= 1
    assert bench.none_is_selected


def test_nothing_is_written_while_another_master_was_heard() -> None:
    bench = TwoMasters(ADDRESSES[:1])
    bench.other.run(survey(bench.other_tool, Pace(window=QUICK, guard=MILLISECOND), KNOWN), bench.bus.now)
    bench.bus.run(SECOND)
    bench.bus.events.clear()  # the requests of the other have the same numbers
    began = bench.sent(LssService.CONFIGURE_NODE_ID)
    switched = bench.sent(LssService.SWITCH_GLOBAL)
    for procedure in (activate(bench.tool), prepare(bench.tool, bench.pace, ADDRESSES[:1], 500, 1000)):
        with pytest.raises(LssError, match="another LSS master"):
            bench.run(procedure)
    assert bench.sent(LssService.SWITCH_GLOBAL) == switched, "what the other has selected would be selected beside all others"
    assert bench.sent(LssService.CONFIGURE_BIT_TIMING) == 0
    with pytest.raises(LssError, match=r"it sent 7E5#0400000000000000 \d+ ms ago"):
        bench.run(give(bench.tool, bench.pace, ADDRESSES[0], 33))
    assert bench.sent(LssService.CONFIGURE_NODE_ID) == began
    assert bench.sent(LssService.ACTIVATE_BIT_TIMING) == 0
    assert bench.ids == [UNCONFIGURED]
