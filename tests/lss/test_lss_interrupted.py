"""LSS procedures that are cancelled at any frame: nobody stays selected, and nothing half done is left that counts later.

The oracle is what the devices really have: their LSS state, and their three pairs of node-ID and bit rate.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_proto.lss.assign import LssAssignment, assign_all, found_device, give, in_order
from canopen_proto.lss.bit_rate import missing, prepare, store_all
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress
from canopen_proto.machine import MILLISECOND
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.procedures.steps import Procedure
from tests.lss.lss_bench import LssBench

ADDRESSES = [LssAddress(0x360, 2, 3, serial) for serial in (1, 2, 3)]
IDS = (4, 5, UNCONFIGURED)
FRAMES = 1000
"""More than any of these procedures sends."""


def bench_of(count: int = 3) -> LssBench:
    bench = LssBench(ADDRESSES[:count], IDS)
    for slave in bench.slaves:
        slave.persistent = slave.pending = slave.active = slave.active._replace(bit_rate=125)
    return bench


def interrupted(bench: LssBench, procedure: Procedure[object], frame: int) -> bool:
    """Cancel a procedure once so many frames were sent; return False if it had ended before."""
    before = len(bench.bus.sent)
    request_id = bench.network.run(procedure, bench.bus.now)
    bench.bus.run_until(lambda: len(bench.bus.sent) >= before + frame or not bench.network.runner.busy)
    bench.network.cancel(request_id, bench.bus.now)
    return isinstance(bench.end_of(request_id), ProcedureCancelled)


PROCEDURES: dict[str, Callable[[LssBench], Procedure[object]]] = {
    "find one by its address": lambda bench: found_device(bench.tool, bench.pace, ADDRESSES[1]),
    "find the only one": lambda bench: found_device(bench.tool, bench.pace, None),
    "give a node-ID": lambda bench: give(bench.tool, bench.pace, ADDRESSES[2], 9),
    "give another node-ID": lambda bench: give(bench.tool, bench.pace, ADDRESSES[0], 9, present=4),
    "prepare a bit rate": lambda bench: prepare(bench.tool, bench.pace, ADDRESSES, 500, 125),
    "store": lambda bench: store_all(bench.tool, bench.pace, ADDRESSES),
    "look who is missing": lambda bench: missing(bench.tool, bench.pace, ADDRESSES),
}


@pytest.mark.parametrize("name", PROCEDURES)
def test_nobody_stays_selected_wherever_a_procedure_is_cancelled(name: str) -> None:
    for frame in range(FRAMES):
        bench = bench_of(1 if name == "find the only one" else 3)
        was_cancelled = interrupted(bench, PROCEDURES[name](bench), frame)
        assert bench.none_is_selected, frame
        if not was_cancelled:
            assert frame > 2
            return
    raise AssertionError("it never ends")


def test_a_change_of_the_bit_rate_that_is_cancelled_leaves_no_rate_that_a_later_store_would_keep() -> None:
    for frame in range(FRAMES):
        bench = bench_of()
        was_cancelled = interrupted(bench, prepare(bench.tool, bench.pace, ADDRESSES, 500, 125), frame)
        if not was_cancelled:
            return
        assert [slave.pending.bit_rate for slave in bench.slaves] == [125] * 3, frame
    raise AssertionError("it never ends")


def test_a_device_whose_node_id_was_interrupted_has_it_for_good_once_the_assignment_is_begun_again() -> None:
    for frame in range(FRAMES):
        bench = bench_of()
        was_cancelled = interrupted(bench, give(bench.tool, bench.pace, ADDRESSES[2], 9), frame)
        bench.bus.run(10 * MILLISECOND)
        bench.run(assign_all(LssAssignment(bench.tool, in_order(range(9, 20)), bench.pace, (*ADDRESSES[2],))))
        assert all(slave.active == slave.persistent for slave in bench.slaves), frame
        assert bench.slaves[2].active.node_id != UNCONFIGURED
        if not was_cancelled:
            return
    raise AssertionError("it never ends")


def test_a_node_whose_other_node_id_was_interrupted_does_not_take_it_at_a_later_reset_unless_it_has_stored_it() -> None:
    for frame in range(FRAMES):
        bench = bench_of()
        was_cancelled = interrupted(bench, give(bench.tool, bench.pace, ADDRESSES[0], 9, present=4), frame)
        slave = bench.slaves[0]
        assert slave.pending.node_id == slave.persistent.node_id, frame
        if not was_cancelled:
            assert bench.ids[0] == 9
            return
    raise AssertionError("it never ends")
