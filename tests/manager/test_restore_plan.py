"""Setting a device to given values: the plan of what is written, and in which order."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectNotFoundError
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.manager.parameters.backup import back_up
from canopen_proto.manager.parameters.restore import plan_restore
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import SdoTransferError
from tests.builds import replaces_what_is_compiled
from tests.core.devices import LIMITED, OUTPUT
from tests.examples import examples
from tests.manager.restore_bench import CHANGES, FACTORY, GAIN, HIDDEN, SECRET, Bench, changed, device, nmt_commands


def test_only_what_differs_is_planned() -> None:
    bench = Bench()
    values = bench.run(back_up(bench.remote)).values
    bench.change()
    plan = bench.plan(values)
    assert plan.equal > 60
    assert nmt_commands(bench) == []
    assert bench.device.writes == []
    shown = [f"{each.variable.index:04X}:{each.variable.subindex:02X} {each.value_before} {each.value}" for each in plan.writes]
    off = COB_ID_INVALID
    assert shown == [
        f"1400:01 {0x205} {off | 0x205}",
        f"1401:01 {off | 0x315} {off | 0x315}",
        f"1801:01 {0x295} {off | 0x295}",
        "1006:00 10000 0",
        "1600:00 2 0",
        "1600:01 536936464 536936464",
        "1600:00 0 1",
        "1401:02 255 1",
        "1A01:00 0 0",
        "1801:02 254 1",
        "1A01:01 536870928 536870928",
        "1A01:00 0 1",
        "2002:00 17 10",
        "2003:00 another text that takes several segments an I/O device with a long name",
        "2012:00 -2.25 1.5",
        "2100:02 -300 0",
        f"1400:01 {off | 0x205} {0x205}",
        f"1401:01 {off | 0x315} {0x305}",
        f"1801:01 {off | 0x295} {0x285}",
    ]


def test_a_node_that_has_all_of_it_is_left_alone() -> None:
    bench, _ = changed()
    done = bench.restore(dict(CHANGES))
    assert done.is_done
    assert done.plan.writes == ()
    assert done.plan.equal == len(CHANGES)
    assert nmt_commands(bench) == []
    assert bench.device.state is NmtState.OPERATIONAL


def test_what_a_restore_leaves_out() -> None:
    bench = Bench()
    values = dict(bench.device.values.store) | {LIMITED << 8: 11, GAIN << 8: 9.0, OUTPUT << 8: 7, SECRET << 8: 5, FACTORY << 8: 9}
    plan = bench.plan(values, skip=[GAIN << 8])
    assert [(each.variable.index, each.value, each.value_before) for each in plan.writes] == [
        (LIMITED, 11, 10),
        (SECRET, 5, None),  # what cannot be read may differ
        (HIDDEN, 0, None),
    ]
    reasons = {key >> 8: reason for key, reason in plan.left_out.items()}
    assert reasons[GAIN] == "skipped"
    assert reasons[OUTPUT] == "process data"  # RPDO 1 carries it
    assert reasons[FACTORY] == "its ObjFlags forbid a download"
    assert reasons[0x1000] == "read-only"
    assert reasons[0x1010] == "a command: store"
    with_outputs = bench.plan({OUTPUT << 8: 7}, process_data=True)
    assert [each.value for each in with_outputs.writes] == [7]


FAILURES = st.sampled_from([None, AbortCode.GENERAL_ERROR, AbortCode.DEVICE_STATE, AbortCode.CRC_ERROR])


@replaces_what_is_compiled
@examples(25)
@given(st.dictionaries(st.sampled_from([*sorted(CHANGES), 0x1017_00, 0x2100_01]), FAILURES, max_size=6), st.booleans())
def test_a_plan_invents_no_write_from_a_read_that_failed(failing: dict[int, AbortCode | None], everything: bool) -> None:
    """Without failures, the plan has the writes that are needed, or asked for; with them, some of these, and no other."""
    bench, before = changed()
    values = bench.run(back_up(bench.remote)).values | before
    whole = bench.plan(values, everything=everything)
    reads = bench.device.read
    silent = {key for key, code in failing.items() if code is None}

    def read(index: int, subindex: int, now: Time) -> Any:
        return failing.get(index << 8 | subindex) or reads(index, subindex, now)

    bench.device.read = read  # type: ignore[method-assign]
    bench.device.takes = lambda frame: (
        frame.can_id != 0x605 or int.from_bytes(frame.data[1:3], "little") << 8 | frame.data[3] not in silent
    )
    try:
        plan = bench.plan(values, everything=everything)
    except SdoTransferError:
        assert len(silent) >= 3  # in a row: the device counts as gone
        return
    needed = {(each.variable.mux, each.data) for each in whole.writes}
    written = {(each.variable.mux, each.data) for each in plan.writes}
    assert written <= needed
    assert not {key for key, _ in written} & failing.keys()
    assert plan.unread <= failing.keys()
    assert {key for key in failing if key in {key for key, _ in needed}} <= plan.left_out.keys()
    others = {(key, data) for key, data in needed if not any(related(key, each) for each in failing)}
    assert others <= written


def related(one: int, other: int) -> bool:
    """Whether two objects are one, or of one PDO, or the one may be written only while the other is 0."""
    pdo = range(0x1400, 0x1C00)
    same_pdo = one >> 8 in pdo and other >> 8 in pdo and (one >> 8 | 0x200) == (other >> 8 | 0x200)
    return one == other or same_pdo or (one, other) == (0x1019_00, 0x1006_00)


def test_everything_is_planned_on_request() -> None:
    bench = Bench()
    plan = bench.plan(dict(CHANGES), everything=True)
    assert {each.variable.mux for each in plan.writes} >= CHANGES.keys() - {0x1600_02}
    again = bench.plan({LIMITED << 8: 10}, everything=True)
    assert [(each.value, each.value_before) for each in again.writes] == [(10, 10)]
    assert again.equal == 0


def test_what_the_device_does_not_have_is_left_out() -> None:
    bench = Bench(device(0).with_objects([]))
    described = device(0)
    del bench.device.values.store[GAIN << 8]
    reads = bench.device.read
    bench.device.read = lambda index, sub, now: (  # type: ignore[method-assign]
        AbortCode.NO_SUCH_OBJECT if index == GAIN else reads(index, sub, now)
    )
    plan = bench.run(plan_restore(bench.remote, described, {GAIN << 8: 3.0, LIMITED << 8: 12}))
    assert [each.variable.index for each in plan.writes] == [LIMITED]
    assert plan.left_out[GAIN << 8] == "the device does not have it"


def test_a_plan_of_nonsense_is_refused_before_anything_is_sent() -> None:
    bench = Bench()
    with pytest.raises(ObjectNotFoundError):
        bench.plan({0x5FFF_00: 1})
    with pytest.raises(LocalProtocolError):
        bench.plan({LIMITED << 8: 256})
    assert not [line for line in bench.bus.trace() if line.startswith("605#")]


def test_a_node_that_is_not_there() -> None:
    bench = Bench()
    bench.bus.detach(bench.network)
    with pytest.raises(SdoTransferError, match="did not answer"):
        bench.plan({LIMITED << 8: 12})
