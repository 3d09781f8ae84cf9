"""The check of a stop along its own way: what it lets pass keeps the limits, by samples of the motion itself."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.drives.trajectory import JointLimits, Path, Segment
from canopen_proto.drives.trajectory.speed_change import SpeedChange
from canopen_proto.drives.trajectory.stop_check import keeps_limits, pieces_of, stretches_of
from tests.examples import examples

SAMPLES = 600
LONG = 20.0
"""Seconds of the path: the stop ends on it."""
number = st.floats(-3.0, 3.0)


def largest(coefficients: tuple[float, ...], stop: SpeedChange) -> tuple[float, float]:
    """The largest acceleration and jerk of p(s(t)), by the chain rule, at many moments of the stop."""
    _, c1, c2, c3, c4, c5 = coefficients
    acceleration = jerk = 0.0
    for k in range(SAMPLES):
        time = stop.duration * (k + 0.5) / SAMPLES
        s, rate, change = stop.at(time)
        onset = next(phase[4] for phase in reversed(stop.phases[:3]) if phase[0] <= time)
        first = c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
        second = 2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))
        third = 6 * c3 + s * (24 * c4 + s * 60 * c5)
        acceleration = max(acceleration, abs(second * rate**2 + first * change))
        jerk = max(jerk, abs(third * rate**3 + 3 * second * rate * change + first * onset))
    return acceleration, jerk


@given(
    coefficients=st.tuples(st.just(0.0), number, number, number, st.sampled_from([0.0, 0.5, -0.5]), st.just(0.0)),
    rate=st.floats(0.2, 1.0),
    hardness=st.floats(0.3, 8.0),
)
@example((0.0, 0.0, 3.0, -1.5, 0.0, 0.0), 1.0, 0.6)  # a velocity that bulges between two looks
@example((0.0, 0.0, 3.0, -3.0, 0.0, 0.0), 1.0, 1.0)
@examples(150)
def test_a_stop_beyond_a_limit_is_never_let_pass(coefficients: tuple[float, ...], rate: float, hardness: float) -> None:
    path = Path([[Segment(LONG, coefficients)]])
    stop = SpeedChange(rate, 0.0, 0.0, hardness, 4.0 * hardness)
    acceleration, jerk = largest(coefficients, stop)
    pieces, stretches = pieces_of(stop, 0.0), stretches_of(path.pieces[0], 0, 1)
    assert keeps_limits(pieces, stretches, JointLimits(), 0.01)
    for limits in (
        JointLimits(acceleration=0.999 * acceleration) if acceleration > 1e-6 else None,
        JointLimits(jerk=0.999 * jerk) if jerk > 1e-6 else None,
    ):
        assert limits is None or not keeps_limits(pieces, stretches, limits, 0.01)
