"""The watchdog: a drive that watches over its master stops when it is gone; let go, it has what it had before."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.descriptions import load_description
from canopen_data.drive_from_file import drive_dictionary_of
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, NotHeldError, Watchdog, release
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import ForeignHeartbeat, OwnHeartbeat
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.procedures.steps import SdoTransferError
from canopen_proto.sdo.server import Pending
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.testing import Pause
from tests.drives.watchdog_world import NODE, HeldDrive, without
from tests.examples import examples
from tests.vendor_files import needs_vendor_files, path_of

ENTRY = 127 << 16 | 500
CONSUMERS, REACTION = mux(0x1016, 1), mux(0x6007)


def ramp_time(world: HeldDrive, speed: int) -> Time:
    return round(speed / world.node.drive._servo.rate(objects.QUICK_STOP_DECELERATION) * SECOND)


# ---- held ----


@pytest.mark.parametrize("mode", [1, 3])
def test_a_drive_whose_master_dies_stands_within_the_timeout_and_its_ramp(mode: int) -> None:
    world = HeldDrive()
    assert world.take_hold() == ""
    assert (world.store[CONSUMERS], world.store[REACTION]) == (ENTRY, 3)
    world.move(mode)
    world.kill_master()
    assert world.time_to_stand(5 * SECOND) <= DEFAULT_WATCHDOG.timeout + ramp_time(world, 20_000) + 5 * MILLISECOND
    assert world.node.drive.state is State.SWITCH_ON_DISABLED


def test_a_drive_whose_master_lives_goes_on() -> None:
    world = HeldDrive()
    world.take_hold()
    world.move(3)
    world.advance(60 * SECOND)
    assert world.speed() == 20_000


@examples(20)
@given(
    entries=st.lists(st.sampled_from([0, 9 << 16 | 100, 10 << 16 | 100, 11 << 16, 127 << 16 | 700, 127 << 16]), max_size=4),
    reaction=st.integers(0, 3),
    wanted=st.sampled_from([2, 3]),
)
def test_whatever_was_there_is_there_again_after_release(entries: list[int], reaction: int, wanted: int) -> None:
    world = HeldDrive()
    for place, entry in enumerate(entries, start=1):
        if all(not entry & 0xFFFF or entry >> 16 != other >> 16 for other in entries[: place - 1]):  # else the drive refuses it
            world.put(mux(0x1016, place), entry)
    world.put(REACTION, reaction)
    before = dict(world.store)
    others = {key: entry for key, entry in before.items() if key >> 8 == 0x1016 and key & 0xFF and entry_of_others(entry)}
    gap = world.take_hold(Watchdog(abort_connection=wanted))
    assert (gap == "") is (len(others) < 4)
    assert world.store[REACTION] == wanted
    assert {key: world.store[key] for key in others} == others
    if not gap:
        assert [world.store[mux(0x1016, place)] for place in range(1, 5)].count(ENTRY) == 1
    world.holder.run(release(world.hold))
    assert {key: world.store[key] for key in (REACTION, *range(CONSUMERS, CONSUMERS + 4))} == {
        key: before[key] for key in (REACTION, *range(CONSUMERS, CONSUMERS + 4))
    }
    assert world.hold.before == {}


def entry_of_others(entry: object) -> bool:
    return isinstance(entry, int) and bool(entry & 0xFFFF) and entry >> 16 != 127


def test_an_entry_that_a_dead_master_left_is_used_and_becomes_free() -> None:
    world = HeldDrive()
    world.put(mux(0x1016, 2), ENTRY)
    assert world.take_hold() == ""
    assert world.store[CONSUMERS] == 0
    assert world.store[mux(0x1016, 2)] == ENTRY
    world.holder.run(release(world.hold))
    assert world.store[mux(0x1016, 2)] == 0


def test_taking_hold_twice_keeps_what_was_there_first() -> None:
    world = HeldDrive()
    world.put(REACTION, 1)
    world.take_hold()
    world.take_hold()
    world.holder.run(release(world.hold))
    assert (world.store[CONSUMERS], world.store[REACTION]) == (0, 1)


def test_a_drive_that_booted_is_not_held_and_nothing_is_put_back() -> None:
    world = HeldDrive()
    world.take_hold()
    world.hold.forget()
    assert not world.hold.is_taken
    world.holder.run(release(world.hold))
    assert world.store[CONSUMERS] == ENTRY


# ---- life guarding ----


def test_without_heartbeat_consumers_it_is_guarded() -> None:
    world = HeldDrive(without(0x1016, more=(0x100C, 0x100D)))
    world.put(mux(0x1017), 200)
    assert world.take_hold() == ""
    assert (world.store[mux(0x1017)], world.store[mux(0x100C)], world.store[mux(0x100D)]) == (0, 100, 5)
    world.move(3)
    world.advance(30 * SECOND)
    assert world.speed() == 20_000
    world.kill_master()
    assert world.time_to_stand(5 * SECOND) <= DEFAULT_WATCHDOG.timeout + ramp_time(world, 20_000) + 5 * MILLISECOND
    world.heartbeat.start(DEFAULT_WATCHDOG.period, world.now)
    world.holder.run(release(world.hold))
    assert (world.store[mux(0x1017)], world.store[mux(0x100C)], world.store[mux(0x100D)]) == (200, 0, 0)


def test_a_drive_that_does_not_answer_guarding_has_its_heartbeat_again() -> None:
    world = HeldDrive(without(0x1016, more=(0x100C, 0x100D)))
    world.put(mux(0x1017), 200)
    world.node._members.detach(world.node.communication.guarding)
    assert world.take_hold() == (
        "no 0x1016 (consumer heartbeat time), and it does not answer guarding (some adapters send no remote frames)"
    )
    assert (world.store[mux(0x1017)], world.store[mux(0x100C)], world.store[mux(0x100D)]) == (200, 0, 0)
    assert world.remote.guarding.guard_time == 0


@examples(20)
@given(period=st.integers(1, 5_000), more=st.integers(0, 60_000))
def test_a_life_time_is_never_longer_than_the_timeout_nor_its_factor_below_3(period: int, more: int) -> None:
    timeout = min(2 * period + more, 65_535)
    watchdog = Watchdog(period=period * MILLISECOND, timeout=timeout * MILLISECOND)
    world = HeldDrive(without(0x1016, more=(0x100C, 0x100D)))
    gap = world.take_hold(watchdog)
    guard_time, factor = world.store[mux(0x100C)], world.store[mux(0x100D)]
    assert isinstance(guard_time, int)
    assert isinstance(factor, int)
    if not gap:
        assert factor >= 3
        assert guard_time * factor <= max(timeout, 3)


# ---- not held ----


@pytest.mark.parametrize(
    ("missing", "gap"),
    [
        ((0x6007,), "no 0x6007 (abort connection option code)"),
        ((0x1016,), "no 0x1016 (consumer heartbeat time), and no 0x100D (life time factor)"),
        (
            (0x1016, 0x6007),
            "no 0x1016 (consumer heartbeat time), and no 0x100D (life time factor); no 0x6007 (abort connection option code)",
        ),
    ],
)
def test_what_a_drive_lacks_is_told_and_only_an_error_where_asked_for(missing: tuple[int, ...], gap: str) -> None:
    assert HeldDrive(without(*missing)).take_hold() == gap
    world = HeldDrive(without(*missing))
    with pytest.raises(NotHeldError, match="would not stop by itself"):
        world.take_hold(Watchdog(required=True))
    assert not world.hold.is_taken


class Refusing(DriveNode):
    """It does not take writes of one index: with an abort code, or it confirms and ignores them."""

    index = 0
    answer: AbortCode | None = None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return self.answer if index == self.index else super().write(index, subindex, data, now)


@pytest.mark.parametrize(
    ("at", "what", "gap"),
    [
        (0x6007, AbortCode.INVALID_VALUE, "it refuses 0x3 in 0x6007 (abort connection option code) (abort 0x06090030)"),
        (0x6007, None, "its 0x6007 (abort connection option code) shows 0x0 after 0x3 was written"),
        (0x1016, AbortCode.READ_ONLY, "it refuses 0x7F01F4 in 0x1016:01 (consumer heartbeat time) (abort 0x06010002), and no"),
        (0x1016, None, "its 0x1016:01 (consumer heartbeat time) shows 0x0 after 0x7F01F4 was written, and no 0x100D"),
    ],
)
def test_a_drive_that_refuses_or_shows_something_else_is_told(at: int, what: AbortCode | None, gap: str) -> None:
    class Kind(Refusing):
        index, answer = at, what

    assert HeldDrive(kind=Kind).take_hold().startswith(gap)


def test_a_drive_that_does_not_answer_fails() -> None:
    world = HeldDrive()
    world.add_faults(Pause(NODE))
    with pytest.raises(SdoTransferError):
        world.take_hold()


@pytest.mark.parametrize(
    "values",
    [
        {"node_id": 0}, {"node_id": 128}, {"period": 0}, {"period": MILLISECOND + 1}, {"timeout": 199 * MILLISECOND},
        {"timeout": 65_536 * MILLISECOND}, {"abort_connection": 0x8000},
    ],
)  # fmt: skip
def test_settings_that_cannot_be(values: dict[str, int]) -> None:
    with pytest.raises(LocalProtocolError):
        Watchdog(**values)  # type: ignore[arg-type]


# ---- the files of real drives ----

FILES = {
    "maxon-epos2.eds": (True, ""),
    "faulhaber-605.3150.70-B.eds": (True, "no 0x6007 (abort connection option code)"),
    "schunk-powerball-lwa4p.dcf": (True, "no 0x6007 (abort connection option code)"),
    "cia-402.eds": (False, "no 0x1016 (consumer heartbeat time), and no 0x100D (life time factor)"),
    "ros2-cia402-slave.eds": (True, ""),  # by life guarding
    "faulhaber-605.3150.51-V.eds": (True, "no 0x6007 (abort connection option code)"),
    "inovance-e35.eds": (True, "no 0x6007 (abort connection option code)"),
}
"""File -> whether the drive notices that its master is gone, and why it does not stop."""


@cache
def dictionary_of(name: str) -> ObjectDictionary:
    return drive_dictionary_of(load_description(path_of(name)).dictionary, Shape.STANDARD)[0]


@needs_vendor_files
@pytest.mark.parametrize("name", sorted(FILES))
def test_drives_made_of_files(name: str) -> None:
    notices, gap = FILES[name]
    world = HeldDrive(dictionary_of(name))
    before = dict(world.store)
    assert world.take_hold() == gap
    world.advance(5 * SECOND)
    assert not any("#3081" in str(each.frame) for each in world.bus().trace)  # it hears us
    world.holder.run(release(world.hold))
    touched = (0x1016, 0x1017, 0x100C, 0x100D, 0x6007)
    assert {key for key in before if key >> 8 in touched and before[key] != world.store[key]} == set()

    world = HeldDrive(dictionary_of(name))
    world.take_hold()
    if objects.SUPPORTED_DRIVE_MODES in before:  # else the simulated drive has no mode to move in
        world.move(1)
        world.kill_master()
        time = world.time_to_stand(5 * SECOND)
        assert (time <= DEFAULT_WATCHDOG.timeout + ramp_time(world, 20_000) + 5 * MILLISECOND) is (gap == "")
    world.kill_master()
    world.advance(SECOND)
    assert any("#3081" in str(each.frame) for each in world.bus().trace) is notices


# ---- our own heartbeat ----


def test_our_heartbeat_is_sent_while_it_is_wanted_and_hears_who_else_has_its_node_id() -> None:
    machine = OwnHeartbeat(Outbox(), 127)
    machine.receive(Frame(0x77F, b"\x05"), 0)
    machine.start(100 * MILLISECOND, 0)
    machine.start(100 * MILLISECOND, 0)
    machine.handle_timeout(100 * MILLISECOND)
    assert machine.out.frames == [Frame(0x77F, b"\x05"), Frame(0x77F, b"\x05")]
    assert machine.out.events == []
    for _ in range(3):
        machine.receive(Frame(0x77F, b"\x00"), 0)
        machine.receive(Frame(0x77F, b"\x04"), 0)
        machine.receive(Frame(0x77F, b""), 0)
    assert machine.out.events == [ForeignHeartbeat(127, None)]
    machine.stop(0)
    machine.handle_timeout(SECOND)
    assert len(machine.out.frames) == 2
