"""What a drive must not be asked for: from its own objects, from the settings, or by default; whatever the units are."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, Axis, AxisSettings
from canopen_proto.drives.axis.limits import DEFAULT_SPEED, ROUNDING, DriveLimits, Limit, SetPointLimits, limits_of, read_limits
from canopen_proto.drives.trajectory import JointLimits, Path, Segment, first_violation
from canopen_proto.drives.trajectory.path import POSITION_TOLERANCE
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.procedures.steps import SdoTransferError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from tests.core.object_answers import run_against

DICTIONARY = drive_dictionary()
CYCLE = 10 * MILLISECOND
FOREVER = 10**12 * SECOND
DEGREES = AxisSettings(counts_per_unit=1000)
FARTHEST = 2_147_483.647 * (1 - ROUNDING)
"""The end of INTEGER32 in degrees, less what the check of a path takes for rounding."""
DEFAULT = "the default, as neither the settings nor the drive say how fast it may go"


def axis_of(settings: AxisSettings) -> Axis:
    return Axis(RemoteNode(Outbox(), 5, DICTIONARY), settings)


def read_from(
    objects: dict[tuple[int, int], int], settings: AxisSettings = DEGREES, abort: int = AbortCode.NO_SUCH_OBJECT
) -> SetPointLimits | Exception:
    """Read the limits of a drive that has these objects, and answers `abort` for all others."""
    return run_against(objects, lambda node: read_limits(Axis(node, settings)), abort)


# ---- what a drive says ----

NOBODY = Limit(DEFAULT_SPEED / 1000, DEFAULT)
LOW, HIGH = Limit(-90, "0x607D:01 of the drive"), Limit(170, "0x607D:02 of the drive")
PROFILE, MOTOR = "0x607F of the drive", "0x6080 of the drive"
END = 1 << 31
POSITIONS: dict[str, tuple[int, int, Limit | None, Limit | None]] = {
    "both": (-90_000, 170_000, LOW, HIGH),
    "the ends of INTEGER32 are none": (-END, END - 1, None, None),
    "the ends of INTEGER32, but one": (-END + 1, END - 1, None, None),
    "an upper one only": (-END, 170_000, None, HIGH),
    "0 and 0 are none": (0, 0, None, None),
    "a minimum above the maximum is none": (5, -5, None, None),
}


@pytest.mark.parametrize("case", POSITIONS)
def test_position_limits_of_a_drive(case: str) -> None:
    low, high, lowest, highest = POSITIONS[case]
    limits = read_from({(0x607D, 1): low, (0x607D, 2): high})
    assert isinstance(limits, SetPointLimits)
    assert (limits.lowest, limits.highest) == (lowest, highest)
    assert limits.speed == NOBODY


def factors(feed: int = 1, gear: int = 1, increments: int = 1) -> dict[tuple[int, int], int]:
    return {(0x6092, 1): feed, (0x6092, 2): 1, (0x6091, 1): gear, (0x6091, 2): 1, (0x608F, 1): increments, (0x608F, 2): 1}


SPEEDS: dict[str, tuple[dict[tuple[int, int], int], Limit]] = {
    "nothing": ({}, NOBODY),
    "0 is none": ({(0x607F, 0): 0, (0x6080, 0): 0}, NOBODY),
    "the largest values are none": ({(0x607F, 0): 0xFFFF_FFFF, (0x6080, 0): END - 1}, NOBODY),
    "counts per second": ({(0x607F, 0): 50_000}, Limit(50, PROFILE)),
    "counts per second, as 0x60A9 says": ({(0x607F, 0): 50_000, (0x60A9, 0): 0x00B50300}, Limit(50, PROFILE)),
    "thousands of counts per second": ({(0x607F, 0): 50, (0x60A9, 0): 0x03B50300}, Limit(50, PROFILE)),
    "thousandths of counts per second": ({(0x607F, 0): 50_000_000, (0x60A9, 0): 0xFDB50300}, Limit(50, PROFILE)),
    "rev/min, a turn is 6000 counts": ({(0x607F, 0): 500, (0x60A9, 0): 0x00B44700, **factors(6000)}, Limit(50, PROFILE)),
    "rev/s": ({(0x607F, 0): 5, (0x60A9, 0): 0x00B40300, **factors(increments=6000)}, Limit(30, PROFILE)),
    "rev/min, a turn is not known": ({(0x607F, 0): 500, (0x60A9, 0): 0x00B44700, **factors()}, NOBODY),
    "the older unit, rev/min": ({(0x607F, 0): 500, (0x608C, 0): 0xA4, **factors(6000)}, Limit(50, PROFILE)),
    "the older unit, tenths": ({(0x607F, 0): 5000, (0x608C, 0): 0xA4, (0x608B, 0): 0xFF, **factors(6000)}, Limit(50, PROFILE)),
    "an older unit that is not known": ({(0x607F, 0): 500, (0x608C, 0): 0x41}, NOBODY),
    "a unit that is not known": ({(0x607F, 0): 500, (0x60A9, 0): 0x00014700}, NOBODY),
    "motor speed, encoder only": ({(0x6080, 0): 3000, **factors(increments=2000)}, Limit(100, MOTOR)),
    "motor speed, feed and gear": ({(0x6080, 0): 3000, **factors(360_000, 100, 4096)}, Limit(180, MOTOR)),
    "motor speed without factors": ({(0x6080, 0): 3000}, NOBODY),
    "the lower of both": ({(0x607F, 0): 50_000, (0x6080, 0): 3000, **factors(increments=2000)}, Limit(50, PROFILE)),
    "the lower of both is the motor's": (
        {(0x607F, 0): 500_000, (0x6080, 0): 3000, **factors(increments=2000)},
        Limit(100, MOTOR),
    ),
}


@pytest.mark.parametrize("case", SPEEDS)
def test_speed_limits_of_a_drive(case: str) -> None:
    objects, expected = SPEEDS[case]
    limits = read_from(objects)
    assert isinstance(limits, SetPointLimits)
    assert limits.speed.source == expected.source
    assert limits.speed.value == pytest.approx(expected.value)


@pytest.mark.parametrize(
    ("objects", "settings", "expected"),
    [
        ({(0x60C5, 0): 100_000}, DEGREES, 100),
        ({(0x60C5, 0): 100, (0x60A9, 0): 0x03B50300}, DEGREES, 100),  # thousands of counts per second, each second
        ({(0x60C5, 0): 100}, replace(DEGREES, velocity_unit=500), 50),
        ({(0x60C5, 0): 100}, replace(DEGREES, velocity_unit=500, acceleration_unit=2000), 200),
        ({(0x60C5, 0): 100, (0x60A9, 0): 0x00014700}, DEGREES, None),  # a unit that is not known
        ({(0x60C5, 0): 0xFFFF_FFFF}, DEGREES, None),
    ],
)
def test_acceleration_is_told(objects: dict[tuple[int, int], int], settings: AxisSettings, expected: float | None) -> None:
    limits = read_from(objects, settings)
    assert isinstance(limits, SetPointLimits)
    assert limits.acceleration == (None if expected is None else Limit(expected, "0x60C5 of the drive"))
    assert limits.max_acceleration.value == (expected or 60)
    assert limits.max_jerk.value == 10 * (expected or 60)


@pytest.mark.parametrize(
    ("up", "down", "expected"),
    [
        (100_000, 40_000, Limit(40, "0x60C6 of the drive")),
        (40_000, 100_000, Limit(40, "0x60C5 of the drive")),
        (0xFFFF_FFFF, 40_000, Limit(40, "0x60C6 of the drive")),
        (40_000, 0, Limit(40, "0x60C5 of the drive")),
    ],
)
def test_a_path_brakes_no_harder_than_the_drive_may(up: int, down: int, expected: Limit) -> None:
    limits = read_from({(0x60C5, 0): up, (0x60C6, 0): down})
    assert isinstance(limits, SetPointLimits)
    assert limits.acceleration == limits.max_acceleration == expected


def test_a_path_has_the_limits_of_the_settings_else_of_the_drive_else_what_the_speed_gives() -> None:
    told = DriveLimits(Limit(-90_000, "low"), None, Limit(50_000, "fast"), Limit(400_000, "0x60C5 of the drive"))
    assert limits_of(axis_of(DEGREES), told).of_paths == JointLimits(-90, FARTHEST, 50, 400, 4000)
    own = limits_of(axis_of(replace(DEGREES, max_acceleration=500.0, max_jerk=math.inf)), told)
    assert own.max_acceleration == Limit(500, "the settings (max_acceleration)")
    assert own.max_jerk == Limit(math.inf, "the settings (max_jerk)")
    assert own.acceleration == Limit(400, "0x60C5 of the drive")  # the drive keeps to it, whatever a path may ask for
    assert limits_of(axis_of(replace(DEGREES, max_speed=math.inf))).of_paths == JointLimits(
        -FARTHEST - 0.001 * (1 - ROUNDING), FARTHEST, math.inf, math.inf, math.inf
    )


scales = st.floats(1e-3, 1e7)
offsets = st.integers(-(1 << 31), (1 << 31) - 1)


@given(st.none() | scales, offsets, st.sampled_from([1, -1]), st.sampled_from(["lowest", "highest"]))
def test_whatever_the_unit_a_path_that_is_within_its_limits_fits_the_object_of_the_drive(
    counts_per_unit: float | None, offset: int, direction: int, end: str
) -> None:
    axis = axis_of(AxisSettings(counts_per_unit=counts_per_unit, offset=offset, direction=direction))
    limits = limits_of(axis).of_paths
    position = getattr(limits, end)
    beyond = math.copysign(POSITION_TOLERANCE * max(1.0, abs(position)), 1.0 if end == "highest" else -1.0)
    path = Path([[Segment(1.0, (position + beyond,))]])  # as far as the check of a path lets it go
    assert first_violation(path, [limits], 0.01) is None
    axis.set_points.check(axis.scale.to_counts(position + beyond))
    further = Path([[Segment(1.0, (axis.scale.from_counts(axis.scale.to_counts(position + 3 * beyond)) + 3 * beyond,))]])
    assert first_violation(further, [limits], 0.01) is not None


def test_what_may_not_be_read_says_nothing_and_a_drive_that_does_not_answer_is_an_error() -> None:
    limits = read_from({}, abort=AbortCode.GENERAL_ERROR)
    assert isinstance(limits, SetPointLimits)
    assert (limits.lowest, limits.highest, limits.speed, limits.acceleration) == (None, None, NOBODY, None)
    assert limits.max_acceleration == Limit(60, "the default: the speed limit, reached in 0.5 s")
    assert limits.max_jerk == Limit(600, "the default: the limit of the acceleration, reached in 0.1 s")
    network = Network()
    node = RemoteNode(network.out, 5, DICTIONARY)
    network.attach(node)
    network.run(read_limits(Axis(node, DEGREES)), 0)
    network.drain(0)
    network.handle_timeout(SECOND)
    (failed,) = (event for event in network.drain(SECOND)[1] if isinstance(event, ProcedureFailed))
    assert isinstance(failed.error, SdoTransferError)


# ---- what the settings say ----


def test_the_settings_go_before_the_speed_of_the_drive_and_narrow_its_positions() -> None:
    told = DriveLimits(Limit(-90_000, "low"), Limit(170_000, "high"), Limit(50_000, "fast"))
    wide = limits_of(axis_of(AxisSettings(counts_per_unit=1000, min_position=-100, max_position=180, max_speed=80)), told)
    assert (wide.lowest, wide.highest, wide.speed) == (
        Limit(-90, "low"),
        Limit(170, "high"),
        Limit(80, "the settings (max_speed)"),
    )
    narrow = limits_of(axis_of(AxisSettings(counts_per_unit=1000, min_position=-10, max_position=math.inf)), told)
    assert (narrow.lowest, narrow.highest) == (Limit(-10, "the settings (min_position)"), Limit(170, "high"))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_acceleration", 0.0),
        ("max_jerk", math.nan),
        ("max_speed", 0.0),
        ("max_speed", -1.0),
        ("max_speed", math.nan),
        ("min_position", math.nan),
        ("max_position", math.nan),
    ],
)
def test_limits_that_cannot_be(field: str, value: float) -> None:
    with pytest.raises(LocalProtocolError, match=field):
        AxisSettings(**{field: value})  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match=r"below max_position; they are 1\.0 and 1\.0"):
        AxisSettings(min_position=1.0, max_position=1.0)


def test_the_manuals_paths_pass_by_default() -> None:
    """100 millidegrees in 10 ms."""
    limits = limits_of(axis_of(AxisSettings(counts_per_unit=MILLIDEGREES_PER_RADIAN)))
    assert limits.excess(0.0, 100 / MILLIDEGREES_PER_RADIAN, CYCLE) is None
    excess = limits.excess(0.0, 1000 / MILLIDEGREES_PER_RADIAN, CYCLE)  # ten times that
    assert excess is not None
    assert excess.is_speed


# ---- whatever the units are ----

scales = st.floats(1e-3, 1e6)
settings = st.builds(
    AxisSettings,
    counts_per_unit=st.none() | scales,
    direction=st.sampled_from([1, -1]),
    offset=st.integers(-(10**6), 10**6),
)
counts = st.integers(-(2**30), 2**30)
ends = st.tuples(counts, counts).filter(lambda pair: pair[0] < pair[1])


@given(settings, ends, counts, st.data())
def test_a_position_is_refused_if_its_counts_are_outside_the_drives_limits(
    settings: AxisSettings, ends: tuple[int, int], target: int, data: st.DataObject
) -> None:
    """Whatever scale, direction and offset are; and the limit that is named is the one that is passed."""
    axis = axis_of(settings)
    low, high = ends
    start = axis.scale.from_counts(data.draw(st.integers(low, high)))
    target = data.draw(st.sampled_from([target, low - 1, low, high, high + 1]))
    limits = limits_of(axis, DriveLimits(Limit(low, "min"), Limit(high, "max"), Limit(math.inf, "speed")))
    excess = limits.excess(start, axis.scale.from_counts(target), CYCLE)
    expected = "min" if target < low else "max" if target > high else None
    assert (None if excess is None else excess.limit.source) == expected
    assert limits.lowest is not None
    assert limits.highest is not None
    assert limits.lowest.value < limits.highest.value


@given(settings, ends, st.integers(1, 10**6), counts, st.lists(st.integers(-(10**5), 10**5), max_size=20))
def test_what_is_let_through_is_never_too_fast_and_never_further_out(
    settings: AxisSettings, ends: tuple[int, int], speed: int, start: int, steps: list[int]
) -> None:
    """From wherever the joint stands, outside its limits, too."""
    axis = axis_of(settings)
    low, high = ends
    limits = limits_of(axis, DriveLimits(Limit(low, "min"), Limit(high, "max"), Limit(speed, "speed")))
    position = axis.scale.from_counts(start)
    for step in steps:
        target = position + settings.direction * axis.scale.amount_from_counts(step)
        if limits.excess(position, target, CYCLE) is None:
            before, after = axis.scale.to_counts(position), axis.scale.to_counts(target)
            assert abs(after - before) <= speed / 100 * 1.001 + 1  # a count of rounding
            assert after <= max(high, before)
            assert after >= min(low, before)
            position = target


@given(settings, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.floats(0, 0.999), st.integers(1, 20))
def test_a_path_within_the_speed_limit_is_never_refused(
    settings: AxisSettings, speed: float, start: float, share: float, cycles: int
) -> None:
    axis = axis_of(AxisSettings(settings.counts_per_unit, settings.direction, settings.offset, max_speed=speed))
    limits = limits_of(axis)
    assert limits.excess(start, start + share * speed * cycles / 100, cycles * CYCLE) is None
    assert limits.excess(start, start - 1.001 * speed * cycles / 100, cycles * CYCLE) is not None


NEAR_LIMITS = st.sampled_from([-90.0, -89.9999, 170.0, 170.00049, 0.0, 3e6, -3e6, math.inf, -math.inf, math.nan])


@given(
    st.one_of(NEAR_LIMITS.filter(math.isfinite), st.floats(-200, 200)),
    st.one_of(NEAR_LIMITS, st.floats(-200, 200)),
    st.sampled_from([(None, None), (-90.0, 170.0), (None, 170.0), (-90.0, None)]),
    st.sampled_from([1.0, 5000.0, math.inf]),
    st.sampled_from([1, -1]),
)
def test_what_is_allowed_in_one_call_is_what_nothing_is_said_against(
    start: float, target: float, ends: tuple[float | None, float | None], speed: float, direction: int
) -> None:
    settings = AxisSettings(
        counts_per_unit=1000, direction=direction, min_position=ends[0], max_position=ends[1], max_speed=speed
    )
    limits = limits_of(axis_of(settings))

    def is_refused() -> bool:
        if not math.isfinite(target) or limits.excess(start, target, CYCLE) is not None:
            return True
        try:
            limits.axis.set_points.check(limits.axis.scale.to_counts(target))
        except ValueRangeError:
            return True
        return False

    is_beyond = (ends[0] is not None and target < ends[0]) or (ends[1] is not None and target > ends[1])
    assert limits.allows(start, target, CYCLE) is (not is_refused() and not is_beyond)


@pytest.mark.parametrize(
    ("start", "target", "is_allowed"),
    [
        (170.0, 170.0, True), (169.0, 170.01, False), (-90.0, -90.0, True), (-89.0, -90.01, False),
        (0.0, 50.0, True), (0.0, 50.01, False), (0.0, -50.01, False), (0.0, math.nan, False), (171.0, 170.5, False),
    ],
)  # fmt: skip
def test_what_is_allowed(start: float, target: float, is_allowed: bool) -> None:
    """5000 degrees per second are 50 in a cycle. A joint that comes back from beyond a limit is left to `excess`."""
    limits = limits_of(axis_of(replace(DEGREES, min_position=-90.0, max_position=170.0, max_speed=5000.0)))
    assert limits.allows(start, target, CYCLE) is is_allowed


def test_a_joint_without_a_scale_is_allowed_nothing() -> None:
    limits = limits_of(axis_of(AxisSettings()))
    assert limits.excess(0, 1, FOREVER) is None
    assert not limits.allows(0, 1, FOREVER)
