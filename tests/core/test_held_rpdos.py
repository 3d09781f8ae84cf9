"""A synchronous RPDO waits in the drive for a SYNC. It never undoes what was commanded by SDO meanwhile.

The property: a set-point was sent by hand, and no SYNC behind it. Whatever SYNC comes then, at whatever moment, ours or another's
or none: when a halt, a change of state or a write has returned, the drive's controlword is the one that was commanded last, and
the drive stands; and no later SYNC changes that.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.cia402.objects import CONTROLWORD
from canopen_proto.drives.cia402.states import ControlBit, State
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.pdo.producer import SYNC_TRANSIT, PdoProducer
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import FRESH, RemoteNode
from canopen_proto.simulation.drive.settings import Shape
from tests.drives.rig import CYCLE, STREAMED, Rig
from tests.examples import examples


class Hands:
    """A drive that follows set-points which the test sends, each with a SYNC behind it."""

    def __init__(self, shape: Shape, delay: Time) -> None:
        self.rig = rig = Rig(shape, pdos=False)
        rig.bus._delay = delay, delay
        ((number,), _) = STREAMED[shape]
        rig.run(use_device_pdo(rig.remote, Direction.RPDO, number))
        taken = rig.remote.rpdos[number]
        rig.remote.remove_pdo(Direction.RPDO, number)
        self.producer = PdoProducer(rig.remote.out, 5, number, taken.key, taken.mapping, rig.remote.values.store, 1)
        self.producer.set_enabled(True, rig.bus.now)
        rig.run(drive.start_interpolation(rig.axis, CYCLE, sends_itself=True))
        for _ in range(2):
            self.send_set_point(50)
            rig.bus.run(MICROSECOND)
            self.sync()
            rig.bus.run(CYCLE)

    def send_set_point(self, step: int) -> None:
        self.rig.axis.set_points.set_position_counts(self.rig.axis.set_points.counts + step)
        assert self.rig.remote.send_rpdo(self.producer, self.rig.bus.now)

    def sync(self, is_ours: bool = True) -> None:
        if is_ours:
            self.rig.sync.send(self.rig.bus.now)
        else:
            self.rig.bus.send("080#")

    def controlword(self) -> int:
        word = self.rig.drive.values.store[CONTROLWORD]
        assert isinstance(word, int)
        return word

    def where(self) -> tuple[State, int, bool]:
        rig = self.rig
        rig.drive.refresh(rig.bus.now)
        return rig.drive.state, self.controlword(), rig.drive._servo.at_rest


WAYS: dict[str, tuple[Callable[[Rig], Procedure[object]], State]] = {
    "halt": (lambda rig: drive.halt(rig.axis), State.OPERATION_ENABLED),
    "brake": (lambda rig: drive.change_state(rig.axis, State.READY_TO_SWITCH_ON), State.READY_TO_SWITCH_ON),
    "disable": (lambda rig: drive.change_state(rig.axis, State.SWITCHED_ON), State.SWITCHED_ON),
    "shut down": (lambda rig: drive.shut_down(rig.axis), State.SWITCH_ON_DISABLED),
    "by hand": (lambda rig: write(rig.remote, "0x6040", 0x06), State.READY_TO_SWITCH_ON),
}


def microseconds(most: int) -> st.SearchStrategy[Time]:
    return st.integers(0, most).map(lambda number: number * MICROSECOND)


@pytest.mark.parametrize("way", WAYS)
@examples(10)
@given(
    shape=st.sampled_from((Shape.STANDARD, Shape.SCHUNK_POWERBALL)),
    delay=st.sampled_from((50 * MICROSECOND, 2 * MILLISECOND)),
    crossing=st.none() | microseconds(2_000),
    braked=st.booleans(),
    pause=microseconds(5_000) | st.just(200 * MILLISECOND),
    moment=st.none() | microseconds(20_000),
    is_ours=st.booleans(),
)
@example(Shape.SCHUNK_POWERBALL, 2 * MILLISECOND, MILLISECOND, False, 5 * MILLISECOND, None, False)  # that SYNC counts not
@example(Shape.SCHUNK_POWERBALL, 2 * MILLISECOND, None, True, 200 * MILLISECOND, None, False)  # nothing is left to command
@example(Shape.SCHUNK_POWERBALL, 2 * MILLISECOND, None, True, 200 * MILLISECOND, 3 * MILLISECOND, False)
def test_no_sync_undoes_a_command(
    way: str,
    shape: Shape,
    delay: Time,
    crossing: Time | None,
    braked: bool,
    pause: Time,
    moment: Time | None,
    is_ours: bool,
) -> None:
    """delay: of each frame. crossing: from another's SYNC to the set-point. braked: by somebody else, behind the set-point.

    pause: from there to the command. moment: from the command to a SYNC.
    """
    hands = Hands(shape, delay)
    rig, (procedure, state) = hands.rig, WAYS[way]
    if crossing is not None:
        hands.sync(is_ours=False)
        rig.bus.run(crossing)
    hands.send_set_point(300)
    if braked:
        rig.bus.send("605#2B40600006000000")
        rig.bus.run_until(lambda: rig.drive.state is State.READY_TO_SWITCH_ON)
    rig.bus.run(pause)
    request = rig.master.run(procedure(rig), rig.bus.now)
    if moment is not None:
        rig.bus.run(moment)
        hands.sync(is_ours)
    rig.outcome(request)
    rig.bus.run(SECOND if way == "by hand" else delay + MILLISECOND)  # nobody waits for the drive; a SYNC is on its way
    _, word, stands = hands.where()
    assert stands
    if not (braked and way == "halt"):  # a drive that is not enabled is not told to halt
        assert word == rig.axis.controlword
    for later in (True, False, True):
        hands.sync(later)
        rig.bus.run(5 * CYCLE)
        shown, word, stands = hands.where()
        assert (word, stands) == (rig.axis.controlword, True)
        if braked and way == "halt":
            was_known = pause > FRESH and moment is None
            assert shown is State.READY_TO_SWITCH_ON or (not was_known and word & ControlBit.HALT)
        else:
            assert shown is state


def test_the_rpdo_goes_before_the_sdo() -> None:
    hands = Hands(Shape.SCHUNK_POWERBALL, 50 * MICROSECOND)
    hands.send_set_point(0)
    hands.rig.bus.run(CYCLE)
    hands.rig.bus.sent.clear()
    hands.rig.remote.write("0x6040", 0x06, hands.rig.bus.now)
    hands.rig.bus.pump()
    assert [frame[:8] for frame in hands.rig.bus.trace()] == ["205#0600", "605#2B40"], "a SYNC may come between the two"


@pytest.mark.parametrize("shape", [Shape.STANDARD, Shape.SCHUNK_POWERBALL])
def test_a_set_point_that_a_sync_of_ours_has_taken_costs_no_frame(shape: Shape) -> None:
    hands = Hands(shape, 50 * MICROSECOND)
    rig = hands.rig
    rig.bus.sent.clear()
    rig.run(drive.halt(rig.axis))
    assert not [frame for _, frame in rig.bus.sent if frame.can_id == hands.producer.key]


@pytest.mark.parametrize("behind", [0, 1, 50, 98])
def test_a_sync_of_another_may_have_passed_before_the_rpdo(behind: int) -> None:
    """Adapters and a busy process hand it over late: the RPDO counts as held, and goes once more before the command."""
    hands = Hands(Shape.SCHUNK_POWERBALL, 50 * MICROSECOND)
    rig = hands.rig
    hands.send_set_point(50)
    rig.bus.run(behind * MILLISECOND)
    hands.sync(is_ours=False)
    rig.bus.run(MILLISECOND)
    rig.bus.sent.clear()
    rig.remote.write("0x6040", 0x06, rig.bus.now)
    rig.bus.pump()
    assert [frame[:3] for frame in rig.bus.trace()] == ["205", "605"]


def test_a_sync_of_another_that_came_long_after_the_rpdo_has_taken_it() -> None:
    hands = Hands(Shape.SCHUNK_POWERBALL, 50 * MICROSECOND)
    rig = hands.rig
    hands.send_set_point(50)
    rig.bus.run(SYNC_TRANSIT + MILLISECOND)
    hands.sync(is_ours=False)
    rig.bus.run(MILLISECOND)
    rig.bus.sent.clear()
    rig.remote.write("0x6040", 0x06, rig.bus.now)
    rig.bus.pump()
    assert [frame[:3] for frame in rig.bus.trace()] == ["605"]


def test_an_rpdo_that_was_never_sent_is_not_held() -> None:
    """Of a node that was never heard to boot, on a bus without SYNC."""
    rig = Rig(Shape.SCHUNK_POWERBALL)
    rig.master.detach(rig.remote)
    remote = RemoteNode(rig.master.out, 5, rig.node.dictionary)
    rig.master.attach(remote)
    rig.run(use_device_pdo(remote, Direction.RPDO, 1))
    rig.bus.sent.clear()
    rig.run(drive.enable(Axis(remote)))
    assert {frame.can_id for _, frame in rig.bus.sent} == {0x605, 0x585}


def test_an_rpdo_that_was_not_taken_when_sync_ended_is_replaced_before_the_next_command() -> None:
    """Of those that follow the SYNC, too: SYNC ends, and begins again behind the command."""
    rig = Rig(Shape.SCHUNK_POWERBALL)
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    rig.bus.run(5 * CYCLE)
    rig.sync.stop()
    rig.bus.run(SECOND)
    rig.run(drive.change_state(rig.axis, State.READY_TO_SWITCH_ON))
    seen = set()
    rig.start_sync()
    for _ in range(50):
        rig.bus.run(MILLISECOND)
        seen.add(rig.drive.state)
    assert seen == {State.READY_TO_SWITCH_ON}


def test_a_device_that_has_booted_holds_nothing() -> None:
    hands = Hands(Shape.SCHUNK_POWERBALL, 50 * MICROSECOND)
    rig = hands.rig
    hands.send_set_point(50)
    rig.bus.run(CYCLE)
    rig.nmt.reset_node(5, rig.bus.now)
    rig.bus.run(CYCLE)
    rig.bus.sent.clear()
    rig.remote.write("0x6040", 0x06, rig.bus.now)
    rig.bus.run(CYCLE)
    assert rig.bus.trace() == ["605#2B40600006000000", "585#6040600000000000"]
