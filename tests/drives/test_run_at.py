"""`drive.run_at`: at a velocity in pv and vl, for as long as the procedure runs; in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import POWERED
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import Rig
from tests.examples import examples

DEGREES = AxisSettings(counts_per_unit=1000.0)
MODES = [Mode.PROFILE_VELOCITY, Mode.VELOCITY]


def with_encoder() -> ObjectDictionary:
    """A motor with 60,000 counts a turn, so that 1 rpm is 1 degree a second. Ramps as in pv."""
    found = [standard_object(0x608F, highest=2, defaults={1: 60_000, 2: 1})]
    ramps = {0x6048: 100, 0x6049: 100, 0x604A: 400}
    found += [standard_object(index, highest=2, defaults={1: speed, 2: 1}) for index, speed in ramps.items()]
    return drive_dictionary().with_objects(found)


def rig_with(settings: AxisSettings = DEGREES, *, reaction: Time = 0) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, reaction=reaction), dictionary=with_encoder())
    rig.axis.settings = settings
    return rig


def speed(rig: Rig) -> float:
    """In degrees a second."""
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.demand_velocity / 1000


def stands(rig: Rig) -> bool:
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.at_rest and abs(rig.drive._servo.velocity) < 1


@pytest.mark.thorough(2)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("velocity", [10.0, -10.0])
def test_it_runs_for_its_time_and_stands_then(mode: Mode, direction: int, velocity: float) -> None:
    rig = rig_with(replace(DEGREES, direction=direction))
    news: list[drive.Running] = []
    rig.master.run(drive.run_at(rig.axis, velocity, duration=2 * SECOND, mode=mode, news=news.append), rig.bus.now)
    rig.bus.run(1500 * MILLISECOND)
    assert speed(rig) == pytest.approx(direction * velocity)
    assert news == [drive.Running(mode, velocity, False), drive.Running(mode, velocity, True)]
    rig.bus.run(4 * SECOND)
    assert stands(rig)
    assert not rig.master.runner.busy
    target = {Mode.PROFILE_VELOCITY: objects.TARGET_VELOCITY, Mode.VELOCITY: objects.VL_TARGET_VELOCITY}[mode]
    assert rig.node.values.store[target] == 0
    assert rig.axis.controlword & 0x100


@pytest.mark.thorough(2)
@pytest.mark.parametrize("mode", MODES)
def test_it_runs_until_it_is_cancelled(mode: Mode) -> None:
    rig = rig_with()
    request = rig.master.run(drive.run_at(rig.axis, 10.0, mode=mode), rig.bus.now)
    rig.bus.run(10 * SECOND)
    assert speed(rig) == pytest.approx(10)
    rig.master.cancel(request, rig.bus.now)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureCancelled)
    assert ended.clean_up_error is None
    assert stands(rig)


@pytest.mark.parametrize("mode", MODES)
def test_with_a_controlword_that_goes_by_a_synchronous_rpdo(mode: Mode) -> None:
    rig = Rig(Shape.STANDARD, drive=DriveSettings(position=0), dictionary=with_encoder())
    rig.axis.settings = DEGREES
    rig.start_sync()
    for number in rig.remote.rpdos:
        rig.remote.enable_rpdo(number, rig.bus.now)
    rig.master.run(drive.run_at(rig.axis, 10.0, mode=mode, duration=SECOND), rig.bus.now)
    rig.bus.run(SECOND)
    assert speed(rig) == pytest.approx(10)
    rig.bus.run(SECOND)
    assert stands(rig)
    assert not rig.master.runner.busy


@pytest.mark.parametrize("mode", MODES)
def test_once_it_runs_only_what_its_watch_needs_is_read(mode: Mode) -> None:
    """Each other read, of its ramp or its jerk, would be a time in which nobody looks at its limits."""
    rig = rig_with()
    rig.node.values.store[objects.MOTION_PROFILE_TYPE] = 3
    rig.master.run(drive.run_at(rig.axis, 10.0, mode=mode), rig.bus.now)
    rig.bus.run(5 * SECOND)
    assert speed(rig) == pytest.approx(10)
    frames = [frame for _, frame in rig.bus.sent if frame.key == 0x605]
    target = {Mode.PROFILE_VELOCITY: 0x60FF, Mode.VELOCITY: 0x6042}[mode]
    is_target = [int.from_bytes(each.data[1:3], "little") == target and any(each.data[4:]) for each in frames]
    read = {int.from_bytes(each.data[1:3], "little") for each in frames[is_target.index(True) :] if each.data[0] == 0x40}
    assert 0x6064 in read
    assert read <= {0x6041, 0x6043, 0x6044, 0x6061, 0x6064, 0x606C}


@pytest.mark.thorough(2)
@pytest.mark.parametrize("mode", MODES)
def test_the_ramps_are_those_asked_for(mode: Mode) -> None:
    rig = rig_with()
    ramps = {"acceleration": 2.5, "deceleration": 5.0}
    rig.master.run(drive.run_at(rig.axis, 10.0, mode=mode, duration=6 * SECOND, **ramps), rig.bus.now)
    while speed(rig) == 0:
        rig.bus.run(MILLISECOND)
    rig.bus.run(2 * SECOND)
    assert speed(rig) == pytest.approx(5, abs=0.05)
    rig.bus.run(4 * SECOND)
    while speed(rig) > 9.99:
        rig.bus.run(MILLISECOND)
    rig.bus.run(SECOND)
    assert speed(rig) == pytest.approx(5, abs=0.05)


def test_the_mode_is_the_first_that_the_drive_has() -> None:
    for modes, mode in ((0xE7, Mode.PROFILE_VELOCITY), (0x02, Mode.VELOCITY)):
        rig = rig_with()
        rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = modes
        rig.run(drive.run_at(rig.axis, 5.0, duration=SECOND))
        assert rig.drive.mode == mode
    rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0x41
    with pytest.raises(
        drive.ModeUnsupportedError,
        match=r"has no profile velocity \(pv\) nor velocity \(vl\): it has profile position.*interpolated",
    ):
        rig.run(drive.run_at(rig.axis, 5.0, duration=SECOND))


def test_factors_of_velocity_mode() -> None:
    rig = rig_with()
    store = rig.node.values.store
    store[objects.VL_SET_POINT_FACTOR], store[objects.VL_DIMENSION_FACTOR] = 2, -5
    rig.master.run(drive.run_at(rig.axis, 20.0, mode=Mode.VELOCITY), rig.bus.now)
    rig.bus.run(2 * SECOND)
    assert speed(rig) == pytest.approx(20)
    assert store[objects.VL_TARGET_VELOCITY] == -2


def test_a_velocity_that_its_unit_cannot_hold_is_told() -> None:
    rig = rig_with()
    rig.node.values.store[objects.VL_DIMENSION_FACTOR] = 5
    news: list[drive.Running] = []
    rig.run(drive.run_at(rig.axis, 12.0, mode=Mode.VELOCITY, duration=SECOND, news=news.append))
    assert news[0].velocity == 10
    with pytest.raises(drive.DriveError, match=r"less than one unit of 0x6042"):
        rig.run(drive.run_at(rig.axis, 2.0, mode=Mode.VELOCITY, duration=SECOND))


def test_a_drive_that_does_not_tell_what_a_turn_is() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    rig.axis.settings = DEGREES
    with pytest.raises(drive.DriveError, match="counts_per_motor_turn"):
        rig.run(drive.run_at(rig.axis, 5.0, duration=SECOND))
    rig.axis.settings = replace(DEGREES, counts_per_motor_turn=60.0)
    rig.master.run(drive.run_at(rig.axis, 5.0), rig.bus.now)
    rig.bus.run(2 * SECOND)
    assert speed(rig) == pytest.approx(5)


def test_an_old_target_moves_nothing() -> None:
    rig = rig_with()
    rig.node.values.store[objects.TARGET_VELOCITY] = -50_000
    rig.master.run(drive.run_at(rig.axis, 10.0), rig.bus.now)
    slowest = 0.0
    for _ in range(1_000):
        rig.bus.run(MILLISECOND)
        slowest = min(slowest, speed(rig))
    assert slowest == 0
    assert speed(rig) == pytest.approx(10)


# ---- limits ----


@pytest.mark.parametrize("mode", MODES)
def test_a_velocity_beyond_the_limit_is_refused_with_nothing_sent(mode: Mode) -> None:
    rig = rig_with(replace(DEGREES, max_speed=20.0))
    for velocity in (20.1, -20.1):
        with pytest.raises(drive.LimitReachedError, match=r"max_speed.*allows 20; nothing was sent"):
            rig.run(drive.run_at(rig.axis, velocity, mode=mode, duration=SECOND))
    rig.axis.settings = DEGREES
    with pytest.raises(drive.LimitReachedError, match="0x6080 of the drive allows 100"):
        rig.run(drive.run_at(rig.axis, 101.0, mode=mode, duration=SECOND))
    assert not [frame for _, frame in rig.bus.sent if frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x20]


@pytest.mark.parametrize(("velocity", "is_refused"), [(4.0, True), (0.0, True), (5.0, False), (-20.0, False), (-21.0, True)])
def test_a_velocity_that_0x6046_would_change_is_refused(velocity: float, is_refused: bool) -> None:
    """A drive with a minimum runs at it even if it is told 0."""
    rig = rig_with()
    rig.node.values.store.update({objects.VL_VELOCITY_MIN_AMOUNT: 5, objects.VL_VELOCITY_MAX_AMOUNT: 20})
    run = drive.run_at(rig.axis, velocity, mode=Mode.VELOCITY, duration=SECOND)
    if is_refused:
        with pytest.raises(drive.LimitReachedError, match=r"runs at 5 to 20 only \(0x6046\)"):
            rig.run(run)
        assert rig.drive.mode == Mode.NO_MODE
    else:
        rig.run(run)
        assert stands(rig)


@pytest.mark.parametrize(("velocity", "highest", "told"), [(1.6, 1.6, 1.0), (-1.6, 1.9, -1.0), (1.6, 2.0, 2.0)])
def test_a_velocity_is_not_rounded_beyond_the_limit(velocity: float, highest: float, told: float) -> None:
    """0x6042 counts whole turns a minute, which are degrees a second here."""
    rig = rig_with(replace(DEGREES, max_speed=highest))
    news: list[drive.Running] = []
    rig.run(drive.run_at(rig.axis, velocity, mode=Mode.VELOCITY, duration=SECOND, news=news.append))
    assert news[0].velocity == told


@pytest.mark.thorough(2)
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("sides", [("min_position",), ("min_position", "max_position")])
def test_a_drive_that_runs_the_other_way_is_halted_before_its_limit(direction: int, sides: tuple[str, ...]) -> None:
    """As by a polarity (0x607E) of velocities alone; here its factor is told with the wrong sign."""
    limits = {"min_position": -20.0, "max_position": 20.0}
    rig = rig_with(replace(DEGREES, direction=direction, **{name: limits[name] for name in sides}))
    rig.node.values.store[objects.VL_DIMENSION_FACTOR] = -1
    rig.node.answer(0x604C, 1, Answer(value=1))
    with pytest.raises(drive.LimitReachedError, match=r"came near -20 .*polarity \(0x607E\)"):
        rig.run(drive.run_at(rig.axis, 10.0, mode=Mode.VELOCITY))
    assert stands(rig)
    assert -20 <= rig.run(drive.read_position(rig.axis)) < -10


@given(
    mode=st.sampled_from(MODES),
    velocity=st.sampled_from([-30.0, -8.0, 3.0, 12.0, 30.0]),
    direction=st.sampled_from([1, -1]),
    reaction=st.sampled_from([0, 100 * MILLISECOND, 240 * MILLISECOND]),
)
@example(mode=Mode.PROFILE_VELOCITY, velocity=30.0, direction=-1, reaction=240 * MILLISECOND)
@examples(8)
def test_it_is_halted_before_the_limits_of_its_position(mode: Mode, velocity: float, direction: int, reaction: Time) -> None:
    rig = rig_with(replace(DEGREES, min_position=-20.0, max_position=20.0, direction=direction), reaction=reaction)
    with pytest.raises(drive.LimitReachedError, match=r"was halted at .* it came near"):
        rig.run(drive.run_at(rig.axis, velocity, mode=mode))
    assert stands(rig)
    end = rig.run(drive.read_position(rig.axis))
    assert 0 < abs(end) <= 20
    assert end * velocity > 0
    with pytest.raises(drive.LimitReachedError, match=r"to stop before .* nothing was sent"):
        rig.run(drive.run_at(rig.axis, velocity, mode=mode))
    rig.run(drive.run_at(rig.axis, -velocity, mode=mode, duration=200 * MILLISECOND))


def test_a_drive_with_limits_and_a_lost_reference_does_not_run() -> None:
    rig = rig_with(replace(DEGREES, homing_method=35, max_position=20.0))
    rig.run(drive.home(rig.axis))
    rig.axis.is_homed = False
    with pytest.raises(drive.ReferenceLostError):
        rig.run(drive.run_at(rig.axis, 5.0, duration=SECOND))
    rig.axis.settings = replace(DEGREES, homing_method=35)
    rig.run(drive.run_at(rig.axis, 5.0, duration=SECOND))


def test_a_drive_that_stands_at_a_limit_of_its_own_is_told() -> None:
    rig = rig_with()
    rig.axis.is_homed = True
    rig.axis.is_homed = False  # the reference is lost: no limit of its position counts
    rig.node.values.store[objects.MIN_SOFTWARE_POSITION_LIMIT], rig.node.values.store[objects.MAX_SOFTWARE_POSITION_LIMIT] = (
        -1,
        100,
    )
    with pytest.raises(drive.LimitReachedError, match="does not run"):
        rig.run(drive.run_at(rig.axis, 10.0))
    assert stands(rig)


def test_a_drive_that_does_not_get_fast_enough_is_halted() -> None:
    rig = rig_with()
    rig.node.values.store[objects.FOLLOWING_ERROR_WINDOW] = 2**32 - 1
    rig.node.block(True, rig.bus.now)
    with pytest.raises(drive.DriveTimeoutError, match=r"did not reach 10 within 4\.1 s"):
        rig.run(drive.run_at(rig.axis, 10.0))


# ---- whatever happens ----


def cancel(rig: Rig, request: int) -> None:
    rig.master.cancel(request, rig.bus.now)


def fault(rig: Rig, request: int) -> None:
    rig.node.raise_fault(0x2310, rig.bus.now)


def quick_stop(rig: Rig, request: int) -> None:
    rig.node.values.store[objects.CONTROLWORD] = 0x02
    rig.drive.written(0x6040, 0, rig.bus.now)


def other_mode(rig: Rig, request: int) -> None:
    rig.node.values.store[objects.MODES_OF_OPERATION] = 1
    rig.drive.written(0x6060, 0, rig.bus.now)


def lost(rig: Rig, request: int) -> None:
    """The cable is unplugged. The drive notices that the master is gone, and quick-stops by 0x6007 = 3."""
    rig.node.values.store[objects.ABORT_CONNECTION_OPTION_CODE] = 3
    rig.bus.detach(rig.device)
    rig.drive.connection_lost(rig.bus.now, 0x8130)


@given(
    mode=st.sampled_from(MODES),
    at=st.integers(0, 1_500),
    happens=st.sampled_from([cancel, fault, quick_stop, other_mode, lost]),
    reaction=st.sampled_from([0, 0, 50 * MILLISECOND]),
)
@example(mode=Mode.VELOCITY, at=5, happens=cancel, reaction=50 * MILLISECOND)
@examples(15)
def test_whenever_and_however_it_ends_the_drive_stands_or_has_no_power(
    mode: Mode, at: int, happens: Callable[[Rig, int], None], reaction: Time
) -> None:
    rig = rig_with(reaction=reaction)
    request = rig.master.run(forever(rig, mode), rig.bus.now)
    rig.bus.run(at * MILLISECOND // 10)
    happens(rig, request)
    rig.bus.run(20 * SECOND)
    rig.drive.refresh(rig.bus.now)
    if rig.master.runner.busy:  # it happened before the drive was enabled, and did no harm
        assert happens is not cancel
        cancel(rig, request)
        rig.bus.run(20 * SECOND)
    assert rig.drive.state not in POWERED or stands(rig)


def forever(rig: Rig, mode: Mode) -> Procedure[None]:
    return drive.run_at(rig.axis, 15.0, mode=mode)


@pytest.mark.parametrize("at", [0, 1])
def test_an_error_of_the_callers_own_code_halts_it_too(at: int) -> None:
    """As a pipe that is broken while the news is printed."""
    rig = rig_with()
    heard: list[drive.Running] = []

    def news(running: drive.Running) -> None:
        heard.append(running)
        if len(heard) > at:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        rig.run(drive.run_at(rig.axis, 10.0, news=news))
    assert stands(rig)
    assert rig.axis.controlword & 0x100


@pytest.mark.thorough(2)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("is_cancelled", [True, False])
def test_a_drive_that_ignores_the_halt_is_stopped_by_its_target(mode: Mode, is_cancelled: bool) -> None:
    rig = rig_with()
    rig.ignore_halts()
    request = rig.master.run(drive.run_at(rig.axis, 10.0, mode=mode, duration=3 * SECOND), rig.bus.now)
    rig.bus.run(2 * SECOND)
    assert speed(rig) == pytest.approx(10)
    if is_cancelled:
        rig.master.cancel(request, rig.bus.now)
    ended = rig.outcome(request)
    assert stands(rig)
    assert isinstance(ended, ProcedureCancelled if is_cancelled else ProcedureFinished)


@pytest.mark.parametrize("knows", [True, False])
def test_a_frequency_converter_without_a_position_is_seen_to_stand(knows: bool) -> None:
    """knows: the master's dictionary lacks the objects too."""
    hidden = (0x6062, 0x6064, 0x606C)
    fewer = ObjectDictionary([each for index, each in with_encoder().objects.items() if index not in hidden])
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0), dictionary=fewer)
    rig.axis.settings = DEGREES
    if not knows:
        rig.remote.dictionary = with_encoder()
    rig.run(drive.run_at(rig.axis, 10.0, mode=Mode.VELOCITY, duration=2 * SECOND))
    assert abs(speed(rig)) <= 0.5  # 0x6044 rounds it to 0
    rig.bus.run(100 * MILLISECOND)
    assert stands(rig)
    rig.axis.settings = replace(DEGREES, max_position=20.0)
    with pytest.raises(drive.DriveError, match="shows no position"):
        rig.run(drive.run_at(rig.axis, 10.0, mode=Mode.VELOCITY, duration=2 * SECOND))


def test_a_duration_below_0_is_refused() -> None:
    rig = rig_with()
    with pytest.raises(LocalProtocolError, match="duration must"):
        rig.run(drive.run_at(rig.axis, 10.0, duration=-1))


def test_the_speed_of_the_motor_is_a_limit_by_the_settings_too() -> None:
    """0x6080 is in turns per minute: a drive that does not tell what a turn is keeps it, as its settings tell."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0))
    rig.axis.settings = replace(DEGREES, counts_per_motor_turn=60_000.0)
    rig.drive.values.store[objects.MAX_MOTOR_SPEED] = 5
    with pytest.raises(drive.LimitReachedError, match="0x6080 of the drive allows 5; nothing was sent"):
        rig.run(drive.run_at(rig.axis, 6.0, mode=Mode.VELOCITY, duration=SECOND))


@pytest.mark.parametrize("option", [1, 2])
@pytest.mark.parametrize("slow", ["deceleration", "quick stop"])
def test_in_velocity_mode_it_is_halted_as_early_as_its_halt_option_needs(option: int, slow: str) -> None:
    """0x605D: 1, by 0x6049; 2, by 0x604A. The settings let it go to 30 degrees."""
    rig = rig_with(replace(DEGREES, max_position=30.0, keeps_reference=True))
    ramps = {objects.VL_VELOCITY_DECELERATION: 100, objects.VL_VELOCITY_QUICK_STOP: 400}
    ramps[objects.VL_VELOCITY_DECELERATION if slow == "deceleration" else objects.VL_VELOCITY_QUICK_STOP] = 5
    rig.node.values.store.update({objects.HALT_OPTION_CODE: option, **ramps})
    with pytest.raises(drive.LimitReachedError, match="came near 30"):
        rig.run(drive.run_at(rig.axis, 10.0, mode=Mode.VELOCITY))
    assert stands(rig)
    assert rig.drive._servo.position <= 30_000
