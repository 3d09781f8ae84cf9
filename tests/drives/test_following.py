"""`Following`: what a drive sends, value by value, and what that says about its following. No bus, no simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest

from canopen_data import load_dictionary
from canopen_proto.dictionary import Direction, ObjectDictionary, PdoDescription
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.drives.axis.following import SILENT_TIME, Following, FollowingLost
from canopen_proto.drives.axis.following_procedures import READ_INTERVAL, following_limit, read_unsent
from canopen_proto.drives.axis.limits import DEFAULT_SPEED, Limit, limits_of
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.objects import (
    FOLLOWING_ERROR_WINDOW,
    MODES_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL_VALUE,
    STATUSWORD,
)
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.store import ValuesStore
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Rig

FOLLOWS = 0x1237  # operation enabled, bit 12
LIMIT = Limit(50, "this test")
DICTIONARY = drive_dictionary()
CYCLIC = {STATUSWORD: 1, POSITION_ACTUAL_VALUE: 1}


class Desk:
    """A drive that follows set-points, played by the test. Positions in counts; SYNC every 10 ms."""

    def __init__(self, *, cyclic: Mapping[int, int] = CYCLIC, start: int = 0, statusword: int = FOLLOWS, lag: int = 2) -> None:
        self.now: Time = 0
        self.node = RemoteNode(Outbox(), 5, DICTIONARY)
        tpdo = PdoDescription("tpdo", 0x180, Direction.TPDO, 1, tuple(map(DICTIONARY.variable, ("0x6041", "0x6064"))))
        self.node.add_pdo(tpdo, 0)
        self.axis = Axis(self.node, AxisSettings(counts_per_unit=1.0))
        self.following = Following(self.axis)
        self.axis.set_points.set_position_counts(start)
        self.send(start, statusword)
        self.following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=cyclic, lag=lag)

    def send(self, position: int, statusword: int = FOLLOWS) -> None:
        """The drive's PDO."""
        data = statusword.to_bytes(2, "little") + position.to_bytes(4, "little", signed=True)
        self.node.receive(Frame(0x185, data), self.now)

    def sync(self, period: Time = CYCLE) -> None:
        self.now += period
        self.node.on_sync(None, self.now)

    def cycle(self, set_point: int, position: int, statusword: int = FOLLOWS) -> None:
        self.axis.set_points.set_position_counts(set_point)
        self.sync()
        self.send(position, statusword)

    @property
    def lost(self) -> str:
        """Why, in words; "" while it follows. It is told once."""
        causes = [event.cause for event in self.node.out.events if isinstance(event, FollowingLost)]
        assert len(causes) <= 1
        assert self.following.is_on is not bool(causes)
        return causes[0] if causes else ""


def late_by(desk: Desk) -> int:
    """By how many SYNCs the positions came late, by the event that tells that the drive is off its path."""
    assert "off its path" in desk.lost
    return next(event.late for event in desk.node.out.events if isinstance(event, FollowingLost))


def test_positions_that_come_late_are_told_from_a_drive_that_lags() -> None:
    """Its PDOs answer older and older SYNCs: each second one waits on the bus. The drive itself is on its path."""
    desk = Desk()
    points = [0, 0]
    for number in range(100):
        points.append(10 * number)
        desk.axis.set_points.set_position_counts(points[-1])
        desk.sync()
        if number % 2 == 0 and not desk.lost:
            desk.send(points[number // 2])
    late = late_by(desk)
    assert late == pytest.approx(LIMIT.value / 10 + 4, abs=2)  # when it was so far off, beside the uncertainty of the pairing


def test_lost_pdos_do_not_make_a_blocked_drive_a_late_one() -> None:
    desk = Desk()
    for number in range(200):
        desk.axis.set_points.set_position_counts(10 * number)
        desk.sync()
        if number % 10 and not desk.lost:
            desk.send(10 * min(number, 150))
    assert late_by(desk) == 0


@pytest.mark.parametrize("lag", [1, 2])
def test_the_error_is_that_of_one_cycle(lag: int) -> None:
    desk = Desk(lag=lag)
    for number in range(1, 20):
        desk.cycle(10 * number, max(0, 10 * (number - lag)) - 3)
        assert desk.following.error == 3
    assert desk.following.largest_error == 3
    assert not desk.lost
    desk.following.end()
    assert desk.following.error == 0


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("late", range(-2, 3))
def test_a_position_that_belongs_to_another_cycle_is_not_off_the_path(direction: int, late: int) -> None:
    """At any speed: a step is much more than the limit."""
    desk = Desk()
    for number in range(1, 20):
        desk.cycle(direction * 1_000 * number, direction * 1_000 * max(0, number - 2 - late))
        assert not desk.lost
    assert abs(desk.following.error) == 1_000 * abs(late)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_joint_that_stays_behind_is_lost_at_the_limit_and_not_before(direction: int) -> None:
    desk = Desk()
    for number in range(1, 100):
        desk.cycle(direction * number, 0)
        if number <= 50 + 4:
            assert not desk.lost
        else:
            assert desk.lost == (
                f"is 51 off its path: it is at 0 and should be at {direction * 53}; the limit is 50, by this test"
            )
            return
    raise AssertionError("not lost")


@pytest.mark.parametrize(
    ("statusword", "cause"),
    [
        (0x0237, "no longer follows its set-points: bit 12 of its statusword is 0 (missed one, halted, another mode)"),
        (0x3237, "reports a following error: bit 13 of its statusword is 1"),
        (0x0221, "left operation enabled by itself: ready to switch on"),
        (0x0208, "left operation enabled by itself: fault"),
    ],
)
def test_one_statusword_is_enough(statusword: int, cause: str) -> None:
    desk = Desk()
    desk.cycle(0, 0)
    assert not desk.lost
    desk.cycle(0, 0, statusword)
    assert desk.lost == cause
    desk.cycle(0, 0, statusword)
    assert desk.lost == cause


def test_a_drive_that_does_not_show_bit_12_is_watched_without_it() -> None:
    desk = Desk()
    desk.axis.settings = replace(desk.axis.settings, shows_following=False)
    desk.following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=CYCLIC)
    desk.cycle(0, 0, 0x0237)
    assert not desk.lost
    desk.cycle(0, 0, 0x0221)
    assert desk.lost.startswith("left operation enabled")


def test_a_limit_counts_when_it_stands_in_two_statuswords() -> None:
    desk = Desk()
    for _ in range(3):
        desk.cycle(0, 0, FOLLOWS | 1 << 11)
        desk.cycle(0, 0)
        assert not desk.lost
    desk.cycle(0, 0, FOLLOWS | 1 << 11)
    desk.cycle(0, 0, FOLLOWS | 1 << 11)
    assert "bit 11" in desk.lost


@pytest.mark.parametrize("bit", [11, 13])
def test_a_bit_that_stood_before_is_no_news_until_it_falls(bit: int) -> None:
    desk = Desk(statusword=FOLLOWS | 1 << bit)
    for _ in range(5):
        desk.cycle(0, 0, FOLLOWS | 1 << bit)
    assert not desk.lost
    desk.cycle(0, 0)
    for _ in range(2):
        desk.cycle(0, 0, FOLLOWS | 1 << bit)
    assert f"bit {bit}" in desk.lost


@pytest.mark.parametrize("every", [1, 2, 5])
def test_silence_is_counted_in_syncs_that_were_sent(every: int) -> None:
    """Three of them in a row, or three times as many as the drive takes for a PDO."""
    desk = Desk(cyclic={STATUSWORD: every})
    for _ in range(3):
        for _ in range(3 * every):
            desk.sync()
            assert not desk.lost
        desk.send(0)
    desk.cycle(0, 0)
    for _ in range(3 * every + 1):
        assert not desk.lost
        desk.sync()
    assert "is silent: no PDO with its statusword for" in desk.lost


def test_a_stall_of_ours_is_no_silence() -> None:
    desk = Desk()
    for _ in range(5):
        desk.sync(period=1_000 * CYCLE)
        desk.send(0)
        desk.sync()
        desk.sync(period=500 * CYCLE)
        assert not desk.lost
        desk.send(0)


def test_a_fast_cycle_waits_for_the_adapter() -> None:
    desk = Desk()
    for _ in range(SILENT_TIME // MILLISECOND):
        desk.sync(period=MILLISECOND)
        assert not desk.lost
    desk.sync(period=MILLISECOND)
    assert "for 20 ms, behind" in desk.lost


def test_one_object_that_no_longer_comes_is_enough() -> None:
    """The statusword in one PDO, the position in another."""
    desk = Desk(cyclic={STATUSWORD: 1, MODES_OF_OPERATION_DISPLAY: 1})
    for _ in range(4):
        assert not desk.lost
        desk.sync()
        desk.send(0)
    assert "no PDO with its mode (0x6061)" in desk.lost


def test_what_heartbeats_say_of_the_node() -> None:
    desk = Desk()
    desk.node.on_nmt_command(NmtCommand.START, desk.now)
    desk.cycle(0, 0)
    desk.now += 100 * MILLISECOND
    desk.node.receive(Frame(0x705, b"\x7f"), desk.now)
    desk.cycle(0, 0)
    assert desk.lost == "left NMT state Operational: PRE_OPERATIONAL"
    desk = Desk()
    desk.node.receive(Frame(0x705, b"\x00"), desk.now)
    assert desk.lost == "was reset, or lost its power"


def test_nothing_is_told_before_it_begins_and_after_it_has_ended() -> None:
    desk = Desk()
    desk.following.end()
    desk.cycle(0, 5_000, 0x0208)
    for _ in range(10):
        desk.sync()
    assert not [event for event in desk.node.out.events if isinstance(event, FollowingLost)]
    desk.following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=CYCLIC)
    desk.following.lose("is lost for a reason of the caller's")
    assert desk.lost == "is lost for a reason of the caller's"


# ---- the limit ----


SETTING = "the settings (following_error_limit)"
DRIVE = "0x6065 of the drive"
DEFAULT = "default, its way in 0.1 s at {} per second; following_error_limit of its settings raises it"


@pytest.mark.parametrize(
    ("setting", "window", "max_speed", "expected"),
    [
        (0.5, 1_000, 7.0, Limit(0.5, SETTING)),
        (math.inf, 1_000, 7.0, Limit(math.inf, SETTING)),
        (None, 1_000, 7.0, Limit(10.0, DRIVE)),
        (None, 0, 7.0, Limit(0.7, DEFAULT.format(7))),
        (None, 0xFFFF_FFFF, 7.0, Limit(0.7, DEFAULT.format(7))),
        (None, 0x7FFF_FFFF, None, Limit(DEFAULT_SPEED / 1000, DEFAULT.format(DEFAULT_SPEED // 100))),
        (None, 0, math.inf, Limit(DEFAULT_SPEED / 1000, DEFAULT.format(DEFAULT_SPEED // 100))),
    ],
)
@pytest.mark.parametrize("direction", [1, -1])
def test_where_the_limit_comes_from(
    setting: float | None, window: int, max_speed: float | None, expected: Limit, direction: int
) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.values.store[FOLLOWING_ERROR_WINDOW] = window
    rig.axis.settings = AxisSettings(
        counts_per_unit=100.0, direction=direction, offset=700, following_error_limit=setting, max_speed=max_speed
    )
    limit = rig.run(following_limit(rig.axis, limits_of(rig.axis)))
    assert limit == (pytest.approx(expected.value), expected.source)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_limit_that_cannot_be(value: float) -> None:
    with pytest.raises(LocalProtocolError, match="following_error_limit must be above 0"):
        AxisSettings(following_error_limit=value)


# ---- what no PDO brings ----


def watched(rig: Rig, cyclic: Mapping[int, int] = CYCLIC) -> Following:
    """The drive follows set-points, in interpolated position mode."""
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    following = Following(rig.axis)
    following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=cyclic)
    return following


def test_what_is_not_sent_is_read_until_cancelled() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL)
    following = watched(rig)
    assert following.unsent == {MODES_OF_OPERATION_DISPLAY}
    rig.bus.sent.clear()
    request_id = rig.master.run(read_unsent([following]), rig.bus.now)
    rig.bus.run(1_000 * MILLISECOND)
    requests = [time for time, frame in rig.bus.sent if frame.can_id == 0x605]
    assert len(requests) == 1_000 * MILLISECOND // CYCLE
    rig.sync.start(MILLISECOND, rig.bus.now)
    rig.bus.run(100 * MILLISECOND)
    requests = [time for time, frame in rig.bus.sent if frame.can_id == 0x605 and time > rig.bus.now - 100 * MILLISECOND]
    assert 10 < len(requests) <= 100 * MILLISECOND // READ_INTERVAL
    assert {frame.data[1:4] for _, frame in rig.bus.sent if frame.can_id == 0x605} == {b"\x61\x60\x00"}
    rig.node.drive.mode = Mode.PROFILE_POSITION
    rig.node.values.store[MODES_OF_OPERATION_DISPLAY] = 1
    rig.bus.run(2 * CYCLE)
    (lost,) = [event for event in rig.bus.events if isinstance(event, FollowingLost)]
    assert lost.cause == "changed its mode of operation: 0x6061 shows profile position (pp), not interpolated position (ip)"
    rig.master.cancel(request_id, rig.bus.now)
    rig.bus.run(100 * MILLISECOND)
    rig.bus.sent.clear()
    rig.bus.run(100 * MILLISECOND)
    assert not [frame for _, frame in rig.bus.sent if frame.can_id == 0x605]


def test_a_drive_that_cannot_be_asked_is_lost() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL)
    following = watched(rig, cyclic={})
    following.unsent = {MODES_OF_OPERATION_DISPLAY}
    rig.master.run(read_unsent([following]), rig.bus.now)
    rig.bus.run(100 * MILLISECOND)
    rig.node.execute(NmtCommand.STOP, rig.bus.now)
    rig.bus.run(5_000 * MILLISECOND)
    (lost,) = [event for event in rig.bus.events if isinstance(event, FollowingLost)]
    assert lost.cause == "cannot be watched: 0x6061 could not be read for 1.5 s: node 5 did not answer reading 0x6061:00"


class Two:
    """Two drives on one bus, watched for their mode alone, which no PDO brings; SYNC every 10 ms. Frames take 1 ms."""

    def __init__(self) -> None:
        self.rig = rig = Rig(Shape.STANDARD, pdos=False)
        rig.bus._delay = MILLISECOND, MILLISECOND
        other = rig.bus.attach(Network())
        self.second = DriveNode(other.out, 6, DriveSettings(shape=Shape.STANDARD))
        other.attach(self.second)
        remote = RemoteNode(rig.master.out, 6, rig.node.dictionary)
        rig.master.attach(remote)
        self.second.boot(rig.bus.now)
        rig.bus.run(CYCLE)
        self.watches = [Following(rig.axis), Following(Axis(remote))]
        for node, watch in zip((rig.node, self.second), self.watches, strict=True):
            node.values.store[MODES_OF_OPERATION_DISPLAY] = Mode.INTERPOLATED_POSITION
            watch.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=CYCLIC, silent_syncs=10**9)
        rig.start_sync()
        self.request_id = rig.master.run(read_unsent(self.watches), rig.bus.now)
        rig.bus.run(100 * MILLISECOND)

    def transfer(self) -> None:
        """Begin to read a long object of the first drive: 3,000 segments, of which each takes 2 ms."""
        self.rig.node.values.store[0x1008_00] = "x" * 21_000
        self.rig.remote.read((0x1008, 0), self.rig.bus.now)

    def lost(self) -> dict[int, str]:
        return {event.node_id: event.cause for event in self.rig.bus.events if isinstance(event, FollowingLost)}

    def run_until_lost(self, node_id: int, limit: Time) -> None:
        self.rig.bus.run_until(lambda: node_id in self.lost(), limit)


@pytest.mark.parametrize("moment", range(0, 40, 7))
def test_a_long_transfer_with_one_drive_blinds_nobody_for_another(moment: int) -> None:
    two = Two()
    two.transfer()
    two.rig.bus.run(200 * MILLISECOND + moment * MILLISECOND)
    two.rig.bus.send("606#2F60600003000000")  # somebody else: profile velocity
    two.run_until_lost(6, 2 * CYCLE + 4 * MILLISECOND)
    assert "changed its mode of operation" in two.lost()[6]
    assert 5 not in two.lost()


def test_a_drive_that_does_not_answer_holds_up_no_other() -> None:
    two = Two()
    two.rig.bus.detach(two.rig.device)
    two.rig.bus.run(30 * MILLISECOND)
    two.rig.bus.send("606#2F60600003000000")
    two.run_until_lost(6, 2 * CYCLE + 4 * MILLISECOND)


def test_a_drive_that_cannot_be_read_for_another_transfer_is_lost_in_time() -> None:
    two = Two()
    two.transfer()
    two.run_until_lost(5, 1_500 * MILLISECOND + 3 * CYCLE)
    assert two.lost() == {5: "cannot be watched: 0x6061 could not be read for 1.5 s: another SDO transfer with it is under way"}
    assert not two.rig.remote.sdo.waiting  # the read was taken back


def test_requests_that_wait_for_a_drive_do_not_hold_its_watch_up() -> None:
    two = Two()
    for _ in range(100):
        two.rig.remote.read((0x1018, 1), two.rig.bus.now)
    two.rig.bus.send("605#2F60600003000000")
    two.run_until_lost(5, 2 * CYCLE + 6 * MILLISECOND)


def test_a_free_sdo_channel_is_used() -> None:
    two = Two()
    rig = two.rig
    rig.remote.add_sdo_channel(0x640, 0x5C0)
    server = SdoServer(rig.device.out, 5, ValuesStore(rig.node.values), request_key=0x640, response_key=0x5C0)
    rig.device.attach(server)
    two.transfer()
    rig.bus.run(2_000 * MILLISECOND)
    assert not two.lost()
    assert rig.remote.sdo.busy
    rig.node.values.store[MODES_OF_OPERATION_DISPLAY] = Mode.PROFILE_POSITION
    two.run_until_lost(5, 2 * CYCLE + 4 * MILLISECOND)


def test_what_is_being_read_is_taken_back_with_the_watch() -> None:
    two = Two()
    two.transfer()
    two.rig.bus.run(50 * MILLISECOND)
    assert two.rig.remote.sdo.waiting == 1
    two.rig.master.cancel(two.request_id, two.rig.bus.now)
    assert two.rig.remote.sdo.waiting == 0


def test_a_queue_that_is_full_is_a_reason_too() -> None:
    two = Two()
    two.transfer()
    two.rig.bus.run(1)
    two.rig.remote.sdo.max_queue = 0
    two.run_until_lost(5, 1_500 * MILLISECOND + 3 * CYCLE)
    assert "requests are waiting already" in two.lost()[5]
    assert 6 not in two.lost()


def test_what_a_drive_does_not_have_is_left_out() -> None:
    rig = Rig(Shape.STANDARD)
    rig.master.detach(rig.remote)
    node = RemoteNode(rig.master.out, 5, load_dictionary()[0])
    rig.master.attach(node)
    following = Following(Axis(node))
    following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic=CYCLIC)
    following.unsent = {0x6069_00}
    rig.start_sync()
    rig.run(read_unsent([following]))
    assert not following.unsent
    assert following.is_on


def test_what_the_dictionary_does_not_have_is_not_read() -> None:
    axis = Axis(RemoteNode(Outbox(), 5, ObjectDictionary([each for each in DICTIONARY.objects.values() if each.index != 0x6064])))
    following = Following(axis)
    following.begin(LIMIT, Mode.INTERPOLATED_POSITION, cyclic={})
    assert following.unsent == {STATUSWORD, MODES_OF_OPERATION_DISPLAY}


def test_nothing_to_read_is_nothing_to_do() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL)
    following = watched(rig, cyclic={**CYCLIC, MODES_OF_OPERATION_DISPLAY: 1})
    rig.bus.sent.clear()
    rig.run(read_unsent([following]))
    assert not rig.bus.sent
