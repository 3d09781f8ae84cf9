"""Node-IDs for all devices: by a table or in order; never twice the same, and nothing is left half done without a word."""

from __future__ import annotations

import random

import pytest
from hypothesis import example
from hypothesis import given as given_by
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.lss.assign import Given, LssAssignment, LssGiven, assign_all, by_table, give, in_order
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress, LssConfiguration, LssService, LssState
from canopen_proto.lss.scan import LssError
from canopen_proto.lss.slave import LssResetNeeded, LssSlave, LssStoreRequested
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, Time
from canopen_proto.procedures.runner import ProcedureCancelled
from tests.examples import examples, takes_all
from tests.lss.lss_bench import LssBench, random_addresses

TYPE = (0x360, 0x2, 0x10003)
KNOWN = (*TYPE, None)


def some(count: int, first: int = 0x100) -> list[LssAddress]:
    return [LssAddress(*TYPE, first + 3 * place) for place in range(count)]


def assignment(bench: LssBench, *, choose=in_order(range(10, 100)), **more: object) -> LssAssignment:  # type: ignore[no-untyped-def] # noqa: B008
    return LssAssignment(bench.tool, choose, bench.pace, KNOWN, **more)  # type: ignore[arg-type]


def test_all_devices_get_their_ids_in_order_store_them_and_boot() -> None:
    bench = LssBench(some(3))
    result = bench.run(assign_all(assignment(bench)))
    assert result.done == [Given(address, 10 + place, True, True, True) for place, address in enumerate(some(3))]
    assert (result.left, result.remark, bench.running) == ({}, "", [10, 11, 12])
    assert [slave.persistent.node_id for slave in bench.slaves] == [10, 11, 12]
    assert bench.none_is_selected
    assert [event.result for event in bench.events if isinstance(event, LssGiven)] == result.done
    bench.run(assign_all(assignment(bench)))  # again: there is nothing to do
    assert bench.running == [10, 11, 12]


def test_nothing_is_stored_if_that_is_not_wanted() -> None:
    bench = LssBench(some(1))
    (given,) = bench.run(assign_all(assignment(bench, store=False))).done
    assert (given.stored, given.is_complete) == (None, True)
    assert bench.slaves[0].persistent.node_id == UNCONFIGURED


def test_ids_by_a_table_and_strangers_are_left_alone() -> None:
    addresses = some(3)
    bench = LssBench(addresses)
    table = [((*TYPE, addresses[2].serial), 5), ((0x360, None, None, addresses[0].serial), 6)]
    result = bench.run(assign_all(assignment(bench, choose=by_table(table))))
    assert bench.ids == [6, UNCONFIGURED, 5]
    assert list(result.left) == [addresses[1]]
    assert bench.none_is_selected


def test_node_ids_that_somebody_has_are_not_given() -> None:
    bench = LssBench(some(2))
    bench.add(LssAddress(1, 2, 3, 4), 10)
    bench.bus.run(MILLISECOND)
    result = bench.run(assign_all(assignment(bench)))
    assert (bench.ids, result.taken) == ([11, 12, 10], {10, 11, 12})
    bench.add(LssAddress(*TYPE, 1))
    table = [((*TYPE, 1), 12)]
    result = bench.run(assign_all(assignment(bench, choose=by_table(table))))
    assert (bench.ids[-1], list(result.left)) == (UNCONFIGURED, [(*TYPE, 1)])


def test_nothing_is_written_to_what_nobody_agreed_to() -> None:
    bench = LssBench(some(2))
    result = bench.run(assign_all(assignment(bench), lambda plan: False))
    assert list(result.left.values()) == ["nobody agreed"] * 2
    assert bench.sent(LssService.CONFIGURE_NODE_ID) == bench.sent(LssService.STORE) == 0
    assert bench.none_is_selected


def test_two_devices_with_one_address_get_no_node_id() -> None:
    bench = LssBench([LssAddress(*TYPE, 0)] * 2)
    (given,) = bench.run(assign_all(assignment(bench))).done
    assert "two devices with this address" in given.remark
    assert bench.ids == [UNCONFIGURED] * 2
    assert bench.sent(LssService.CONFIGURE_NODE_ID) == 0


class Waits(LssSlave):
    """Lely's: with a new node-ID it waits for an NMT command, and it takes part in fastscans though it has one."""

    def __init__(self, address: LssAddress) -> None:
        super().__init__(Outbox(), address)

    def can_ids(self):  # type: ignore[no-untyped-def]
        return (*super().can_ids(), 0)

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == 0:
            if frame.data[0] == 0x82 and frame.data[1] in (0xFF, 0) and self.pending.node_id != UNCONFIGURED:
                self.active = self.pending
                self.out.frames.append(Frame(0x700 + self.active.node_id, b"\0"))
            return
        if frame.data[0] != LssService.FASTSCAN:
            super().receive(frame, now)
            return
        active, pending = self.active, self.pending
        self.active = self.pending = LssConfiguration()
        super().receive(frame, now)
        self.active, self.pending = active, pending


def test_a_device_that_waits_for_an_nmt_command_and_answers_again() -> None:
    bench = LssBench(some(1, first=0x900))
    bench.bus.attach(Waits(some(1)[0]))
    result = bench.run(assign_all(assignment(bench)))
    assert [(each.node_id, each.booted) for each in result.done] == [(10, True), (11, True)]
    assert "took part in the fastscan again" in result.remark
    assert "000#82FF" in bench.bus.trace()
    assert "000#8200" not in bench.bus.trace()


@pytest.mark.parametrize(
    ("answers", "remark"),
    [
        ({0x17: "1701"}, "not stored (the device says: storing not supported): the device loses it without power"),
        ({0x17: "1702"}, "not stored (the device says: access to the storage failed)"),
        ({0x17: None}, "perhaps not stored (no answer)"),
        ({0x11: "1101"}, "was not confirmed (the device says: node-ID out of range)"),
        ({0x11: "11FF09"}, "the maker's own error 9"),
        ({0x11: None}, "no answer: the device may have it all the same"),
        ({0x5E: "5E07"}, "nothing was written: the device has node-ID 7"),
        ({0x5E: None}, "nothing was written: it does not say which node-ID it has"),
    ],
)
def test_refusals_are_told(answers: dict[int, str | None], remark: str) -> None:
    class Refuses(LssSlave):
        def receive(self, frame: Frame, now: Time) -> None:
            if frame.data[0] not in answers:
                super().receive(frame, now)
                if self.out.events and isinstance(self.out.events[-1], LssResetNeeded):
                    self.active = self.pending
                    self.out.frames.append(Frame(0x700 + self.active.node_id, b"\0"))
            elif (text := answers[frame.data[0]]) is not None and self.state:
                self.out.frames.append(Frame.parse(f"7E4#{text.ljust(16, '0')}"))

    bench = LssBench([])
    slave = bench.bus.attach(Refuses(Outbox(), some(1)[0]))
    (given,) = bench.run(assign_all(assignment(bench))).done
    assert remark in given.remark
    assert not given.is_complete
    assert given.is_refused == any(answer is not None and answer[:2] != "5E" for answer in answers.values())
    assert slave.state == 0


class Deaf(LssSlave):
    """A slave that does not hear "waiting"."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data[0] != LssService.SWITCH_GLOBAL:
            super().receive(frame, now)


def test_nothing_is_written_while_another_device_is_selected_too() -> None:
    bench = LssBench(some(1))
    deaf = bench.bus.attach(Deaf(Outbox(), LssAddress(*TYPE, 7)))
    deaf.state = LssState.CONFIGURATION
    given = bench.run(give(bench.tool, bench.pace, some(1)[0], 10))
    assert "another device is selected beside" in given.remark
    assert (bench.sent(LssService.CONFIGURE_NODE_ID), deaf.pending.node_id, bench.ids) == (0, UNCONFIGURED, [UNCONFIGURED])


class Shy(LssSlave):
    """A slave that does not say which node-ID it has."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data[0] != LssService.INQUIRE_NODE_ID:
            super().receive(frame, now)


def test_a_node_id_that_two_devices_confirm_is_taken_back() -> None:
    bench = LssBench(some(1))
    shy = bench.bus.attach(Shy(Outbox(), some(1)[0]))
    given = bench.run(give(bench.tool, bench.pace, some(1)[0], 10))
    assert "two answers came, of two devices or of one twice" in given.remark
    assert (bench.ids, shy.pending.node_id, bench.sent(LssService.STORE)) == ([UNCONFIGURED], UNCONFIGURED, 0)


class Late(LssSlave):
    """A slave whose first answer to a service comes together with its second one."""

    def __init__(self, address: LssAddress, service: int) -> None:
        super().__init__(Outbox(), address)
        self._service = service
        self._late: list[Frame] | None = None

    def receive(self, frame: Frame, now: Time) -> None:
        super().receive(frame, now)
        if self.out.events and isinstance(self.out.events[-1], LssResetNeeded):
            self.active = self.pending
            self.out.frames.append(Frame(0x700 + self.active.node_id, b"\0"))
        if self.out.frames and frame.data[0] == self._service:
            if self._late is None:
                self._late = [self.out.frames.pop()]
            else:
                self.out.frames[:0] = self._late
                self._late = []


@pytest.mark.parametrize("service", [LssService.INQUIRE_NODE_ID, LssService.CONFIGURE_NODE_ID])
def test_a_late_answer_is_no_second_device(service: int) -> None:
    bench = LssBench([])
    slave = bench.bus.attach(Late(some(1)[0], service))
    given = bench.run(give(bench.tool, bench.pace, some(1)[0], 10, store=False))
    assert (given.is_complete, given.remark, slave.active.node_id) == (True, "", 10)


@pytest.mark.parametrize("service", [LssService.INQUIRE_NODE_ID, LssService.CONFIGURE_NODE_ID])
def test_two_devices_with_one_address_are_two_though_the_first_question_is_lost(service: int) -> None:
    class Misses(LssSlave):
        missed = False

        def receive(self, frame: Frame, now: Time) -> None:
            if frame.data[0] == service and not self.missed:
                self.missed = True
            elif service != LssService.CONFIGURE_NODE_ID or frame.data[0] != LssService.INQUIRE_NODE_ID or self is twins[0]:
                super().receive(frame, now)

    bench = LssBench([])
    twins = [bench.bus.attach(Misses(Outbox(), some(1)[0])) for _ in range(2)]
    given = bench.run(give(bench.tool, bench.pace, some(1)[0], 10))
    assert "two devices" in given.remark
    assert [twin.pending.node_id for twin in twins] == [UNCONFIGURED] * 2


def test_a_node_changes_its_id_and_no_other_does() -> None:
    addresses = some(2)
    bench = LssBench(addresses, [4, 5])
    given = bench.run(give(bench.tool, bench.pace, addresses[0], 9, present=4))
    assert (given.is_complete, bench.running) == (True, [9, 5])
    given = bench.run(give(bench.tool, bench.pace, addresses[0], 7, present=4))
    assert given.remark == "nothing was written: the device has node-ID 9"
    given = bench.run(give(bench.tool, bench.pace, LssAddress(*TYPE, 1), 7))
    assert "no device with the address" in given.remark
    assert bench.running == [9, 5]


@pytest.mark.thorough(3)
@pytest.mark.parametrize("moment", range(0, 260, 13))
def test_a_cancelled_assignment_leaves_nobody_selected_and_goes_on_when_begun_again(moment: int) -> None:
    bench = LssBench(some(2))
    request_id = bench.network.run(assign_all(assignment(bench)), bench.bus.now)
    bench.bus.run_until(lambda: len(bench.bus.sent) > moment)
    bench.network.cancel(request_id, bench.bus.now)
    assert isinstance(bench.end_of(request_id), ProcedureCancelled)
    assert bench.none_is_selected
    bench.bus.run(10 * MILLISECOND)
    bench.run(assign_all(assignment(bench)))
    assert len(set(bench.ids)) == 2
    assert UNCONFIGURED not in bench.ids


def frames_to_lose() -> list[int]:
    """Each frame but those that ask for single bits, of which some: test_lss_scan.py loses them all."""
    share = 8 if takes_all() else 32
    bench = LssBench(some(2))
    bench.run(assign_all(assignment(bench)))
    kept = []
    for number, (_, frame) in enumerate(bench.bus.sent):
        asks_for_a_bit = frame.data[0] in (LssService.FASTSCAN, LssService.IDENTIFIED) and frame.data[5] in range(1, 32)
        if not asks_for_a_bit or number % share == 0:
            kept.append(number)
    return kept


@pytest.mark.thorough(5)
@pytest.mark.parametrize("part", range(4))
def test_any_frame_may_be_lost(part: int) -> None:
    """No two nodes get one ID, and each device has what the result says, in its memory too, or stands in it as unfinished."""
    for lost in frames_to_lose()[part::4]:
        bench = LssBench(some(2), lose=[lost])
        result = bench.run(assign_all(assignment(bench)))
        told = {given.address: given for given in result.done}
        assert len(set(bench.ids) | {UNCONFIGURED}) == len([each for each in bench.ids if each != UNCONFIGURED]) + 1, lost
        for node in bench.nodes:
            given = told[node.lss.address]
            assert given.is_complete or given.remark, lost
            if given.is_complete:
                assert (node.node_id, node.lss.persistent.node_id, node.lss.pending.node_id) == (given.node_id,) * 3, lost
        assert bench.none_is_selected, lost


@pytest.mark.thorough(2)
@pytest.mark.parametrize("seed", range(4))
def test_many_devices_on_a_bad_bus(seed: int) -> None:
    addresses = random_addresses(4, seed, TYPE)
    bench = LssBench(addresses, seed=seed, loss=0.003, delay=(100_000, 2 * MILLISECOND))
    result = bench.run(assign_all(assignment(bench)))
    given = [node_id for node_id in bench.ids if node_id != UNCONFIGURED]
    assert len(given) == len(set(given)) == 4
    assert all(each.is_complete or each.remark for each in result.done)


# ---- whatever is lost, however late ----

LIMIT = 20 * SECOND
GIVEN_WITHIN = 60 * SECOND
"""For one device: to be selected, to get its node-ID, to store it and to boot; and for the last question of a search."""


class Hostile(LssBench):
    """Devices that store, cannot store, or say nothing when they should store."""

    def __init__(self, answers: list[int | None], addresses: list[LssAddress], **faults: object) -> None:
        self.answers = dict(zip(addresses, answers, strict=False))
        super().__init__(addresses, **faults)  # type: ignore[arg-type]

    def _on_event(self, event: Event) -> None:
        if isinstance(event, LssStoreRequested):
            for node in self.nodes:
                answer = self.answers.get(node.lss.address, 0)
                if node.lss.is_storing and answer is not None:
                    node.lss.complete_store(answer, self.bus.now)


def is_told_as_two(result: LssAssignment, address: LssAddress) -> bool:
    """Two devices with one LSS address cannot be told apart. So what becomes of them is not promised, but that it is told."""
    remarks = [given.remark for given in result.done if given.address == address]
    return "two devices" in result.remark or any("two devices" in remark for remark in remarks) or bool(result.unfinished)


@examples(60, least=12)
@given_by(
    seed=st.integers(0, 1 << 32),
    count=st.integers(1, 5),
    loss=st.sampled_from([0.0, 0.002, 0.01, 0.03, 0.06]),
    latest=st.sampled_from([MILLISECOND // 5, 2 * MILLISECOND, 8 * MILLISECOND, 30 * MILLISECOND]),
    copies=st.sampled_from([0.0, 0.05]),
    same=st.sampled_from([(), TYPE[:1], TYPE]),
    storing=st.lists(st.sampled_from([0, 0, 0, 1, 2, None]), min_size=5, max_size=5),
    agrees=st.booleans(),
    is_twin=st.booleans(),
)
@example(  # one long question and the short ones before it were lost, or answered late
    seed=5211,
    count=1,
    loss=0.1,
    latest=30 * MILLISECOND,
    copies=0.05,
    same=TYPE[:1],
    storing=[0] * 5,
    agrees=False,
    is_twin=False,
)
def test_each_device_has_its_node_id_for_good_or_is_named(
    seed: int,
    count: int,
    loss: float,
    latest: Time,
    copies: float,
    same: tuple[int, ...],
    storing: list[int | None],
    agrees: bool,
    is_twin: bool,
) -> None:
    """And no node-ID is there twice, what is called complete is so, nobody stays selected, and the time is kept."""
    addresses = random_addresses(count, seed, same)
    bench = Hostile(storing, addresses, seed=seed, loss=loss, delay=(50_000, latest), copies=copies)
    if is_twin:
        bench.add(addresses[0])
    bench.pace.device_limit = LIMIT
    result = LssAssignment(bench.tool, in_order(range(1, 20)), bench.pace)
    chance, begun = random.Random(seed), bench.bus.now
    try:
        bench.run(assign_all(result, lambda plan: agrees or chance.random() < 0.5))
    except LssError:
        assert (result.done, result.left) == ([], {})
        assert UNCONFIGURED in bench.ids
        assert loss or latest > MILLISECOND, "a quiet bus"
    else:
        told = {given.address: given for given in result.done}
        for slave in bench.slaves:
            given = told.get(slave.address)
            if given is None:
                assert slave.address in result.left or result.unfinished, slave.address
                assert slave.active.node_id == UNCONFIGURED
            elif is_twin and slave.address == addresses[0]:
                assert is_told_as_two(result, slave.address), "two devices, and not a word of it"
            elif given.is_complete:
                assert (slave.active.node_id, slave.persistent.node_id) == (given.node_id,) * 2
            else:
                assert given.remark
    bench.bus.run(SECOND)
    own = [slave for slave in bench.slaves if not (is_twin and slave.address == addresses[0])]
    ids = [slave.active.node_id for slave in own if slave.active.node_id != UNCONFIGURED]
    assert len(ids) == len(set(ids))
    assert not set(ids) & {slave.active.node_id for slave in bench.slaves if slave not in own}
    assert bench.bus.now - begun <= (len(bench.slaves) + 1) * (LIMIT + GIVEN_WITHIN)


@pytest.mark.thorough(5)
@pytest.mark.parametrize(("loss", "seed", "within"), [(0.02, 2, 120), (0.1, 2, 240), (0.1, 3, 240)])
def test_eight_devices_on_a_bus_that_loses_frames_get_their_ids_within_minutes(loss: float, seed: int, within: int) -> None:
    """With the window that a real bus has. The first ones have theirs before the last one is found."""
    bench = LssBench(random_addresses(8, seed), window=100 * MILLISECOND, seed=seed, loss=loss)
    request_id = bench.network.run(assign_all(LssAssignment(bench.tool, in_order(range(1, 20)), bench.pace)), bench.bus.now)
    bench.bus.run_until(lambda: len(bench.running) == 1, 60 * SECOND)
    assert bench.slaves[[node.node_id for node in bench.nodes].index(1)].persistent.node_id == 1
    result = bench.end_of(request_id)
    assert [given.is_complete for given in result.done] == [True] * 8
    assert bench.bus.now < within * SECOND


def test_the_time_for_one_device_is_kept_and_what_is_known_of_it_is_told() -> None:
    bench = LssBench(some(2), window=100 * MILLISECOND)
    bench.pace.device_limit = 8 * SECOND
    result = LssAssignment(bench.tool, in_order(range(10, 100)), bench.pace, KNOWN)
    bench.run(assign_all(result))
    assert (result.unfinished, len(result.done)) == ("", 2)
    bench = LssBench([LssAddress(*TYPE, 0xFFFF_FFFF)], window=100 * MILLISECOND)
    bench.pace.device_limit = 3 * SECOND
    begun = bench.bus.now
    with pytest.raises(LssError, match=r"the time for one device is over.*vendor-ID 0x360, product code 0x2"):
        bench.run(assign_all(LssAssignment(bench.tool, in_order(range(10, 100)), bench.pace)))
    assert bench.bus.now - begun < 4 * SECOND
    assert bench.none_is_selected


def test_a_search_that_is_given_up_takes_nothing_from_those_that_are_ready_and_says_so() -> None:
    bench = LssBench([LssAddress(*TYPE, 1), LssAddress(*TYPE, 0xFFFF_FFFF)], window=100 * MILLISECOND)
    bench.pace.device_limit = 3 * SECOND
    result = bench.run(assign_all(LssAssignment(bench.tool, in_order(range(10, 100)), bench.pace)))
    assert [given.is_complete for given in result.done] == [True]
    assert "the time for one device is over" in result.unfinished
    assert (bench.ids, bench.none_is_selected) == ([10, UNCONFIGURED], True)


def test_a_device_that_was_left_alone_hides_no_other() -> None:
    """It is selected while the others are searched, though it has the lowest address and answers each fastscan."""
    addresses = some(4)
    bench = LssBench(addresses)
    table = [((*TYPE, addresses[3].serial), 5)]
    result = bench.run(assign_all(assignment(bench, choose=by_table(table))))
    assert bench.ids == [UNCONFIGURED] * 3 + [5]
    assert (list(result.left), result.unfinished) == (addresses[:3], "")
