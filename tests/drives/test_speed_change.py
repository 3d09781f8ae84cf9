"""The change of one speed with limited acceleration and jerk: its limits, its end, and that nothing is faster."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto import LocalProtocolError
from canopen_proto.drives.trajectory import SpeedChange
from tests.examples import examples

speeds = st.floats(-3, 3)
magnitudes = st.floats(0.1, 10)
parts = st.floats(-1, 1)


@given(speeds, parts, speeds, magnitudes, magnitudes)
@example(0.0, 0.0, 0.0, 1.0, 1.0)
@example(1.0, 1.0, 1.5, 1.0, 1.0)  # just what is left if the acceleration ends
@example(1.0, -1.0, 0.5, 1.0, 1.0)
@examples(60)
def test_it_gets_there_within_its_limits(speed: float, part: float, wanted: float, most: float, jerk: float) -> None:
    given_acceleration = part * most
    change = SpeedChange(speed, given_acceleration, wanted, most, jerk)
    assert change.at(0.0) == pytest.approx((0.0, speed, given_acceleration), abs=1e-12)
    assert change.at(change.duration) == (change.distance, wanted, 0.0)
    assert SpeedChange.seconds(speed, given_acceleration, wanted, most, jerk) == change.duration
    assert change.at(change.duration + 2.0) == pytest.approx((change.distance + 2.0 * wanted, wanted, 0.0))
    before = change.at(change.duration * (1 - 1e-9))
    assert before == pytest.approx((change.distance, wanted, 0.0), abs=1e-6)
    dt = max(change.duration, 0.01) / 50
    points = [change.at(number * dt) for number in range(52)]
    for (d, v, a), (e, w, b) in itertools.pairwise(points):  # each is the derivative of the one before
        assert abs(b) <= most * (1 + 1e-9)
        assert abs(b - a) <= jerk * dt * (1 + 1e-9) + 1e-12
        assert w - v == pytest.approx((a + b) / 2 * dt, abs=jerk * dt * dt)
        assert e - d == pytest.approx((v + w) / 2 * dt, abs=(most + jerk * dt) * dt * dt)


@given(speeds, parts, speeds, magnitudes, magnitudes)
@examples(60)
def test_no_change_is_faster(speed: float, part: float, wanted: float, most: float, jerk: float) -> None:
    """Pontryagin in a few lines: with a bounded jerk the fastest way is full jerk, at most one arc at the limit, full jerk back.

    So a faster one had a peak of the acceleration that differs from ours: its time is computed from the peak alone.
    """
    a = part * most
    change = SpeedChange(speed, a, wanted, most, jerk)

    def time_with(peak: float) -> float | None:
        """The time with this peak (either sign); None if the speed does not come out with it."""
        gained = (abs(peak - a) / jerk) * (peak + a) / 2 + abs(peak) / jerk * peak / 2
        rest = wanted - speed - gained
        held = rest / peak if peak else 0.0 if abs(rest) < 1e-12 else -1.0
        return None if held < -1e-9 else abs(peak - a) / jerk + max(held, 0.0) + abs(peak) / jerk

    times = [time for number in range(-100, 101) if (time := time_with(number / 100 * most)) is not None]
    assert all(change.duration <= time + 1e-6 for time in times)


@given(speeds, parts, speeds, speeds, magnitudes, magnitudes, st.floats(0, 1))
@examples(80)
def test_another_speed_may_be_wanted_at_any_moment(
    speed: float, part: float, wanted: float, then: float, most: float, jerk: float, when: float
) -> None:
    first = SpeedChange(speed, part * most, wanted, most, jerk)
    _, now, acceleration = first.at(when * first.duration)
    second = SpeedChange(now, acceleration, then, most, jerk)
    assert second.at(0.0)[1:] == pytest.approx((now, acceleration), abs=1e-12)
    assert second.at(second.duration)[1:] == (then, 0.0)
    same = SpeedChange(now, acceleration, wanted, most, jerk)
    assert same.duration == pytest.approx((1 - when) * first.duration, abs=1e-6)


def test_from_rest_by_hand() -> None:
    change = SpeedChange(0.0, 0.0, 1.0, 0.5, 1.0)  # 0.5 s up, 1.5 s held, 0.5 s down
    assert (change.duration, change.distance) == (2.5, 1.25)
    assert change.at(0.5) == pytest.approx((0.5**3 / 6, 0.125, 0.5))
    assert change.at(1.25) == pytest.approx((0.5**3 / 6 + 0.125 * 0.75 + 0.5 * 0.75**2 / 2, 0.5, 0.5))


@pytest.mark.parametrize("values", [(0, 2, 1, 1, 1), (0, 0, 1, 1, 0), (math.nan, 0, 1, 1, 1), (0, 0, 1, 0, math.inf)])
def test_limits_that_cannot_be_kept(values: tuple[float, ...]) -> None:
    with pytest.raises(LocalProtocolError, match="A speed cannot change"):
        SpeedChange(*map(float, values))
