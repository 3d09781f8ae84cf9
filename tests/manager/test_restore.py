"""Setting a device to given values: what is written, in which order, and what stands when it fails at any step."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli.node.restore_output import story
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.frame import COB_ID_INVALID, Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outcome
from canopen_proto.manager.parameters.restore import (
    NMT_TRIES,
    ObjectRestored,
    Restoration,
    RestoreError,
    RestorePlan,
    VerifyMismatchError,
    restore,
)
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from tests.core.bus import CAN_FATES, Fate
from tests.core.devices import LIMITED, TEXT
from tests.examples import examples
from tests.manager.restore_bench import CHANGES, GAIN, Bench, changed, device, nmt_commands

PRE_OPERATIONAL = "000#8005"
START = "000#0105"
PDOS = {0x1400_01: 0x1600, 0x1401_01: 0x1601, 0x1800_01: 0x1A00, 0x1801_01: 0x1A01}


def is_as_before(bench: Bench, before: dict[int, Value]) -> bool:
    """A mapping entry beyond the number of mapped objects says nothing, and is not written."""
    return bench.held(before) == before | {0x1600_02: CHANGES[0x1600_02]}


# ---- carried out ----


@pytest.mark.parametrize("verify", [False, True])
def test_a_changed_device_is_as_it_was(verify: bool) -> None:
    bench, values = changed()
    done = bench.restore(values, verify=verify)
    assert done.is_done
    assert (done.state_before, done.state) == (NmtState.OPERATIONAL, NmtState.OPERATIONAL)
    assert bench.device.state is NmtState.OPERATIONAL
    assert is_as_before(bench, values)
    assert nmt_commands(bench) == [PRE_OPERATIONAL, START]
    assert {state for _, _, state in bench.device.writes} == {NmtState.PRE_OPERATIONAL}
    assert [(each.done, each.total) for each in bench.bus.take_events(ObjectRestored)] == [
        (each, WRITES) for each in range(1, WRITES + 1)
    ]
    assert (done.open, done.pdos_off) == ((), ())
    assert bench.plan(values).writes == ()


def test_a_pre_operational_node_stays_so() -> None:
    bench, values = changed(start=False)
    assert bench.restore(values).state_before is NmtState.PRE_OPERATIONAL
    assert bench.device.state is NmtState.PRE_OPERATIONAL
    assert START not in nmt_commands(bench)


def test_without_a_heartbeat_the_state_is_not_known_and_the_node_stays_pre_operational() -> None:
    bench, values = changed(dictionary=device(0))
    assert bench.device.state is NmtState.PRE_OPERATIONAL  # changed() has restored once
    bench.nmt.start(5, bench.bus.now)
    bench.bus.run(MILLISECOND)
    done = bench.restore(values)
    assert done.is_done
    assert done.state_before is None
    assert bench.device.state is NmtState.PRE_OPERATIONAL


def test_without_the_object_of_the_heartbeat() -> None:
    whole = device()
    bench = Bench(type(whole)([each for each in whole.objects.values() if each.index != 0x1017]))
    assert bench.restore({LIMITED << 8: 12}).state_before is None


def test_a_heartbeat_that_0x1017_promises_and_that_does_not_come() -> None:
    bench = Bench()
    bench.bus.run(SECOND)
    bench.device.set_value(0x1017, 0, 0, bench.bus.now)
    reads = bench.device.read
    bench.device.read = lambda index, sub, now: b"\xc8\0" if index == 0x1017 else reads(index, sub, now)  # type: ignore[method-assign]
    done = bench.restore({LIMITED << 8: 12})
    assert (done.is_done, done.state_before) == (True, None)


def test_a_node_that_was_stopped_is_stopped_again() -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    bench.nmt.stop(5, bench.bus.now)
    bench.bus.run(SECOND)
    done = bench.run(restore(bench.remote, bench.nmt, plan))
    assert (done.state_before, done.state) == (NmtState.STOPPED, NmtState.STOPPED)
    assert bench.device.state is NmtState.STOPPED
    assert bench.device.values.store[LIMITED << 8] == 12


def test_nmt_commands_that_get_lost_are_repeated() -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    lost = [1, 2, 4]  # of the NMT frames, from 1 on
    count = [0]

    def lossy(frame: Frame) -> bool:
        count[0] += frame.can_id == 0
        return frame.can_id != 0 or count[0] not in lost

    bench.device.takes = lossy
    done = bench.run(restore(bench.remote, bench.nmt, plan))
    assert done.is_done
    assert nmt_commands(bench) == [PRE_OPERATIONAL] * 3 + [START] * 2
    assert bench.device.state is NmtState.OPERATIONAL


def test_a_node_that_does_not_obey_is_not_written() -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    bench.device.takes = lambda frame: frame.can_id != 0
    with pytest.raises(
        RestoreError, match=f"was sent {NMT_TRIES} times to PRE_OPERATIONAL, but its heartbeat shows OPER"
    ) as failed:
        bench.run(restore(bench.remote, bench.nmt, plan))
    assert failed.value.restoration.done == ()
    assert bench.device.writes == []


# ---- storing ----


def test_the_device_stores_at_the_end() -> None:
    bench, values = changed()
    done = bench.restore(values, store=True)
    assert done.stored
    assert bench.device.writes[-1] == (0x1010, 1, NmtState.PRE_OPERATIONAL)
    assert bench.device.state is NmtState.OPERATIONAL
    again = bench.restore(values, store=True)
    assert (again.plan.writes, again.stored) == ((), True)


@pytest.mark.parametrize("is_cancelled", [True, False])
def test_a_store_without_an_answer_may_have_been_executed_and_the_story_says_so(is_cancelled: bool) -> None:
    bench = Bench()
    bench.host_stores = False
    plan = bench.plan({LIMITED << 8: 12})
    so_far = Restoration(plan)
    request_id = bench.start(restore(bench.remote, bench.nmt, plan, so_far, store=True))
    bench.bus.run_until(lambda: (0x1010, 1) in [write[:2] for write in bench.device.writes])
    if is_cancelled:
        bench.master.cancel(request_id, bench.bus.now)
    else:
        bench.bus.detach(bench.network)
    bench.outcome()
    assert (so_far.stored, so_far.store_in_doubt, so_far.is_done) == (False, True, False)
    assert "all of it is written, and perhaps stored" in story([so_far])


def test_a_store_that_is_refused_is_in_no_doubt() -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    so_far = Restoration(plan)
    bench.device.refuse = lambda count: AbortCode.DEVICE_STATE if count == 2 else None
    bench.start(restore(bench.remote, bench.nmt, plan, so_far, store=True))
    assert isinstance(bench.outcome(), ProcedureFailed)
    assert (so_far.stored, so_far.store_in_doubt) == (False, False)


def test_a_store_may_take_its_time_and_not_all_of_it() -> None:
    bench = Bench()
    bench.host_stores = False
    plan = bench.plan({LIMITED << 8: 12})
    bench.start(restore(bench.remote, bench.nmt, plan, store=True))
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert isinstance(outcome.error, RestoreError)
    assert "1 of 1 writes" in str(outcome.error)
    assert "stays Pre-operational" in str(outcome.error)
    assert not outcome.error.restoration.stored
    assert bench.device.state is NmtState.PRE_OPERATIONAL
    assert bench.remote.sdo.timeout == 500 * MILLISECOND


@pytest.mark.parametrize("answer", [AbortCode.NO_SUCH_OBJECT, AbortCode.DEVICE_STATE, b"\x02\0\0\0"])
def test_a_device_that_cannot_store_is_not_written(answer: bytes | AbortCode) -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    bench.device.read = lambda index, sub, now: answer  # type: ignore[method-assign]
    with pytest.raises(RestoreError, match="nothing was written to node 5"):
        bench.run(restore(bench.remote, bench.nmt, plan, store=True))
    assert bench.device.writes == []
    assert nmt_commands(bench) == []


# ---- failures ----


def test_what_reads_back_as_something_else_ends_a_restore() -> None:
    bench, values = changed()
    reads = bench.device.read
    bench.device.read = lambda index, sub, now: (  # type: ignore[method-assign]
        b"\x01\x02" if index == GAIN and bench.device.writes else reads(index, sub, now)
    )
    with pytest.raises(RestoreError, match=r"took 0000c03f for gain \(0x2012:00\), but shows 0102") as failed:
        bench.restore(values, verify=True)
    assert isinstance(failed.value.__cause__, VerifyMismatchError)
    assert failed.value.__cause__.shown == b"\x01\x02"
    assert failed.value.restoration.done[-1].variable.index == GAIN
    assert_nothing_half_done(bench, failed.value.restoration)


def assert_nothing_half_done(bench: Bench, so_far: Restoration) -> None:
    """The node is not Operational, and each PDO that was to be changed is as it was, or destroyed, or as it shall be.

    Without a heartbeat that was heard, nothing confirms an NMT command: all of them may be lost.
    """
    assert bench.device.state is NmtState.PRE_OPERATIONAL or so_far.state_before is None
    assert not so_far.is_done
    changed = {each.variable.mux for each in so_far.open[so_far.in_doubt is not None :]}
    written = {each.variable.mux for each in so_far.done}
    for cob_id, mapping in PDOS.items():
        record = {cob_id, cob_id + 1, *(mapping << 8 | each for each in range(3))}
        if record & written and record & changed:
            value = bench.device.values.store[cob_id]
            assert isinstance(value, int)
            assert value & COB_ID_INVALID, f"{cob_id:06X}"
            is_to_live = any(each.variable.mux == cob_id for each in so_far.open)
            assert (cob_id in {each.mux for each in so_far.pdos_off}) == is_to_live


def count_writes() -> int:
    bench, values = changed()
    return len(bench.plan(values).writes)


WRITES = count_writes()


@pytest.mark.thorough(3)
@pytest.mark.parametrize("at", range(1, WRITES + 1))
def test_refused_at_any_write(at: int) -> None:
    bench, values = changed()
    plan = bench.plan(values)
    bench.device.refuse = lambda count: AbortCode.DEVICE_STATE if count == at else None
    with pytest.raises(RestoreError, match=f"ended after {at - 1} of {WRITES} writes: node 5 refused") as failed:
        bench.run(restore(bench.remote, bench.nmt, plan))
    so_far = failed.value.restoration
    assert (so_far.written, so_far.in_doubt) == (at - 1, None)
    assert so_far.open[0] == plan.writes[at - 1]
    assert_nothing_half_done(bench, so_far)
    bench.clear()  # and once more: it is finished then
    bench.device.refuse = lambda count: None
    assert bench.restore(values).is_done
    assert is_as_before(bench, values)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("at", range(1, WRITES + 1))
def test_silent_at_any_write(at: int) -> None:
    bench, values = changed()
    plan = bench.plan(values)
    bench.device.is_silent = lambda count: count == at
    with pytest.raises(RestoreError, match="not confirmed: it may have been executed") as failed:
        bench.run(restore(bench.remote, bench.nmt, plan))
    so_far = failed.value.restoration
    assert (so_far.written, so_far.in_doubt) == (at - 1, plan.writes[at - 1])
    assert len(bench.device.writes) == at  # it is not sent again
    assert_nothing_half_done(bench, so_far)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("at", range(WRITES + 1))
def test_cancelled_at_any_write(at: int) -> None:
    bench, values = changed()
    plan = bench.plan(values)
    so_far = Restoration(plan)
    request_id = bench.start(restore(bench.remote, bench.nmt, plan, so_far))
    bench.bus.run_until(lambda: so_far.state is not None and so_far.written == at)
    bench.master.cancel(request_id, bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureCancelled)
    assert outcome.clean_up_error is None
    assert so_far.written == at
    assert so_far.in_doubt in (None, plan.writes[at] if at < WRITES else None)
    assert_nothing_half_done(bench, so_far)


def test_cancelled_before_it_began_it_sends_nothing() -> None:
    bench, values = changed()
    so_far = Restoration(bench.plan(values))
    request_id = bench.start(restore(bench.remote, bench.nmt, so_far.plan, so_far))
    bench.master.cancel(request_id, bench.bus.now)
    assert isinstance(bench.outcome(), ProcedureCancelled)
    assert so_far.state is None
    assert nmt_commands(bench) == []
    assert bench.device.state is NmtState.OPERATIONAL


def test_somebody_starts_the_node_meanwhile() -> None:
    bench, values = changed()
    bench.device.refuse = lambda count: AbortCode.DEVICE_STATE if count == 5 else None
    so_far = Restoration(bench.plan(values))
    bench.start(restore(bench.remote, bench.nmt, so_far.plan, so_far))
    bench.bus.run_until(lambda: so_far.written == 3)
    bench.bus.send(START)
    assert isinstance(bench.outcome(), ProcedureFailed)
    assert_nothing_half_done(bench, so_far)


def test_the_node_is_gone_when_its_state_is_asked_for() -> None:
    bench = Bench()
    plan = bench.plan({LIMITED << 8: 12})
    bench.bus.detach(bench.network)
    with pytest.raises(RestoreError, match="nothing was written to node 5: node 5 did not answer"):
        bench.run(restore(bench.remote, bench.nmt, plan))


def test_our_own_queue_is_full() -> None:
    bench = Bench()
    so_far = Restoration(bench.plan({LIMITED << 8: 12}))
    bench.start(restore(bench.remote, bench.nmt, so_far.plan, so_far))
    bench.bus.run_until(lambda: so_far.state is not None)  # it waits for a heartbeat now
    bench.device.takes = lambda frame: frame.can_id != 0x605
    for _ in range(bench.remote.sdo.max_queue + 1):
        bench.remote.read(TEXT, bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert isinstance(outcome.error.__cause__, LocalProtocolError)
    assert (so_far.written, so_far.in_doubt) == (0, None)
    assert bench.device.state is NmtState.PRE_OPERATIONAL


def test_an_empty_plan_is_nothing_to_do() -> None:
    bench = Bench()
    assert bench.run(restore(bench.remote, bench.nmt, RestorePlan(5, ()))).is_done
    assert bench.bus.trace() == [line for line in bench.bus.trace() if line.startswith("705#")]


# ---- whatever the bus does ----


def judge(values: dict[int, Value], fates: list[Fate], verify: bool, skipped: int) -> Outcome:
    """Restore these values, with these fates of the frames behind the first `skipped` ones; return how it ended.

    Either it is done, and the device has them, or nothing half done lives.
    """
    bench = Bench()
    plan = bench.plan(values)
    bench.bus._fates = iter([*[Fate.DELIVERED] * skipped, *fates])
    so_far = Restoration(plan)
    bench.start(restore(bench.remote, bench.nmt, plan, so_far, verify=verify))
    outcome = bench.outcome()
    bench.bus._fates = iter(())
    bench.bus.run(SECOND)
    if isinstance(outcome, ProcedureFinished):
        assert bench.held(values).items() >= values.items() - {(0x1600_02, CHANGES[0x1600_02])}
        assert bench.device.state is NmtState.OPERATIONAL or not so_far.plan.writes or so_far.state_before is None
    else:
        assert isinstance(outcome, ProcedureFailed)
        assert isinstance(outcome.error, RestoreError)
        if so_far.written:
            assert_nothing_half_done(bench, so_far)
    sent = [line for line in bench.bus.trace() if line.startswith(("605#2", "605#3"))]
    assert len(sent) == len(set(sent))  # nothing is written twice, whatever was lost
    return outcome


@examples(50)
@given(
    values=st.fixed_dictionaries({}, optional={key: st.just(value) for key, value in CHANGES.items()}),
    fates=st.lists(st.sampled_from(CAN_FATES), max_size=60),
    verify=st.booleans(),
    skipped=st.integers(0, 80),
)
def test_with_frames_that_get_lost_it_is_done_or_nothing_half_done_lives(
    values: dict[int, Value], fates: list[Fate], verify: bool, skipped: int
) -> None:
    judge(values, fates, verify, skipped)


@pytest.mark.parametrize("copied", range(12))
def test_an_answer_that_comes_twice_confirms_no_write_that_the_device_refuses(copied: int) -> None:
    """0x1600:00 is set to 0 and then to 2, which the device refuses: an entry is missing."""
    outcome = judge({0x1600_00: 2}, [*[Fate.DELIVERED] * copied, Fate.COPIED, Fate.COPIED], False, 0)
    assert isinstance(outcome, ProcedureFailed)
    assert "refused writing 0x1600:00: abort 0x06020000" in str(outcome.error)


SETTINGS = {key: CHANGES[key] for key in (LIMITED << 8, TEXT << 8, GAIN << 8, 0x2100_02)}


@pytest.mark.parametrize("store", [False, True])
@pytest.mark.parametrize("write", range(1, len(SETTINGS)))
def test_whatever_resets_a_device_in_the_middle_never_is_it_called_restored(write: int, store: bool) -> None:
    """The answer to a write and the boot-up reach a master together that was stalled. The reset has undone what was written."""
    bench = Bench()
    plan = bench.plan(SETTINGS)
    bench.start(restore(bench.remote, bench.nmt, plan, store=store))
    bench.bus.run_until(lambda: len(bench.device.writes) == write)
    bench.device.execute(NmtCommand.RESET_NODE, bench.bus.now)
    frames, _ = bench.network.drain(bench.bus.now)
    waiting = [frame for _, _, receiver, frame in sorted(bench.bus._on_the_way) if receiver is bench.master.out]
    bench.bus._on_the_way.clear()
    bench.master.receive_many(iter([(frame, None) for frame in (*waiting, *frames)]), bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert f"ended after {write} of {len(SETTINGS)} writes" in str(outcome.error)
    assert 0x1010 not in [index for index, _, _ in bench.device.writes]
    assert bench.device.state is NmtState.PRE_OPERATIONAL


def test_a_device_that_was_reset_since_its_values_were_read_is_not_called_restored() -> None:
    """The plan has only what differed then. The reset has undone the rest."""
    bench = Bench()
    kept, rest = {LIMITED << 8: 17}, {GAIN << 8: -2.25}
    bench.restore(kept)
    plan = bench.plan({**kept, **rest})
    bench.device.execute(NmtCommand.RESET_NODE, bench.bus.now)
    bench.bus.run(MILLISECOND)
    bench.clear()
    bench.start(restore(bench.remote, bench.nmt, plan))
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert "nothing was written to node 5: it has booted since its values were read" in str(outcome.error)
    assert (bench.device.writes, nmt_commands(bench)) == ([], [])


@pytest.mark.parametrize(("command", "heartbeat_ms"), [("000#8005", 0), ("000#8005", 200), ("000#0105", 200)])
def test_a_device_that_is_reset_while_its_state_is_awaited_is_not_called_restored(command: str, heartbeat_ms: int) -> None:
    bench = Bench(device(heartbeat_ms))
    kept, rest = {LIMITED << 8: 17}, {GAIN << 8: -2.25}
    bench.restore(kept)
    plan = bench.plan({**kept, **rest})
    bench.clear()
    bench.start(restore(bench.remote, bench.nmt, plan))
    bench.bus.run_until(lambda: command in nmt_commands(bench))
    bench.device.execute(NmtCommand.RESET_NODE, bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert "it has booted since its values were read" in str(outcome.error)
    assert bench.device.state is NmtState.PRE_OPERATIONAL
