"""Paths that were written with few decimals: the path goes through the smoothest positions that the numbers can have meant."""

from __future__ import annotations

import contextlib
import itertools
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_data.findings import DictionaryError
from canopen_data.path_file import PathFile, read_path
from canopen_proto.drives.trajectory.fitting import MAX_SMOOTHED, is_rounded, smoothed
from canopen_proto.drives.trajectory.limit_check import demands_of
from tests.examples import examples

COUNT = 200
PERIOD = 0.02
"""20 degrees out and back in 4 s."""


def position(time: float, amplitude: float = 10.0) -> float:
    return amplitude * (1.0 - math.cos(2.0 * math.pi * time / (COUNT * PERIOD)))


JERK = 10.0 * (2.0 * math.pi / (COUNT * PERIOD)) ** 3
"""The highest jerk of that motion."""


def text_of(decimals: int, *, times: list[float] | None = None) -> str:
    rows = times or [number * PERIOD for number in range(COUNT + 1)]
    return "time,a\n" + "".join(f"{time!r},{position(time):.{decimals}f}\n" for time in rows)


def waypoints(positions: str, step: float = 1.0) -> str:
    return "time,a\n" + "".join(f"{number * step!r},{each}\n" for number, each in enumerate(positions.split()))


def jerk_of(file: PathFile) -> float:
    return max(each.jerk.magnitude for each in demands_of(file.path, 0, 0.01))


@pytest.mark.parametrize("decimals", [1, 2, 3, 4])
def test_a_smooth_motion_keeps_its_jerk_however_few_decimals_it_is_written_with(decimals: int) -> None:
    text = text_of(decimals)
    file = read_path(text)
    assert jerk_of(file) < 1.1 * JERK
    assert file.roundings[0].is_smoothed
    rows = [line.split(",") for line in text.splitlines()[1:]]
    for time, written in rows:
        assert abs(file.path.at(float(time)).positions[0] - float(written)) <= 0.5 * 10.0**-decimals * (1 + 1e-6) + 1e-12
    for row, at in ((rows[0], file.path.start), (rows[-1], file.path.end)):
        assert at.positions[0] == pytest.approx(float(row[1]), abs=1e-12)
        assert at.velocities[0] == pytest.approx(0.0, abs=1e-9)


def test_rows_may_be_unevenly_apart() -> None:
    times = [0.0, *itertools.accumulate([0.01 if number % 3 else 0.03 for number in range(COUNT)])]
    scale = COUNT * PERIOD / times[-1]
    smooth = read_path(text_of(2, times=[time * scale for time in times]))
    assert jerk_of(smooth) < 3.0 * JERK  # a spline through the samples has 600 times as much


def test_numbers_that_nobody_rounded_and_waypoints_are_passed_exactly() -> None:
    for text in (
        text_of(9),
        "time,a\n" + "".join(f"{number * 0.5},{value}\n" for number, value in enumerate([0, 7, 3, 9, 2, 8, 1, 5, 0, 6])),
        "time,a\n" + "".join(f"{number},{number * 10}\n" for number in range(20)),
        "time,a\n0,0.0\n0.01,0.1\n0.02,0.1\n0.03,0.0\n",
        waypoints("0 1 0 1 0 1 0 1 0 1 0 1 0 0"),
        waypoints("0 1 2 3 3 3 3 3 3 3 2 1 0 0"),
        waypoints("0.0 0.1 0.2 0.3 0.4 0.4 0.4 0.4 0.4 0.4 0.2 0.0", 2.0),
        waypoints(" ".join(["90"] * 25 + ["91", "95", "105", "120", "140"] + ["150"] * 10), 0.1),
        waypoints(" ".join(f"{number / 10:.1f}" for number in [*range(40), *[40] * 20]), 0.01),  # too few units
        waypoints(" ".join(str(number) for number in [*range(100), *[100] * 20]), 0.01),  # whole numbers
        waypoints(" ".join(f"{number / 10:.1f}" for number in [*range(100), *[100] * 20]), 0.06),  # too far apart
    ):
        file = read_path(text)
        assert not file.roundings[0].is_smoothed
        for line in text.splitlines()[1:]:
            time, value = map(float, line.split(","))
            assert file.path.at(time).positions[0] == pytest.approx(value, abs=1e-12)


def test_a_hold_stays_exactly_where_it_is_written_and_the_way_to_it_is_smooth() -> None:
    out = [f"{position(number * PERIOD):.2f}" for number in range(COUNT // 2 + 1)]
    dwell = 60
    file = read_path(waypoints(" ".join(out + [out[-1]] * dwell + out[::-1]), PERIOD))
    assert 0 < file.roundings[0].moved < 2 * len(out) + 12
    for number in range(len(out) + 5, len(out) + dwell - 5):
        assert file.path.at(number * PERIOD).positions[0] == 20.0
    assert (
        jerk_of(file) < 10.0 * JERK
    )  # through the samples: 100 times as much; half of the cosine ends with a jump of acceleration


@pytest.mark.parametrize("step", ["e-120", "e-60", "e-9", "e120", "e300"])
def test_times_at_the_end_of_what_floats_can_be_never_end_in_an_error_of_arithmetic(step: str) -> None:
    for unit in ("", ".5", f".{'0' * 8}1", "e-400", f"e-{'9' * 400}"):
        text = "time,a\n" + "".join(f"{number}{step},{number % 2 * 77}{unit}\n" for number in range(12))
        with contextlib.suppress(DictionaryError):
            assert read_path(text).roundings[0].moved == 0


def test_what_rounding_can_make_is_known() -> None:
    rounding = read_path(text_of(4)).roundings[0]
    assert (rounding.unit, rounding.step) == (pytest.approx(1e-4), pytest.approx(PERIOD))
    assert rounding.jerk == pytest.approx(4 * 1e-4 / PERIOD**3)
    assert rounding.decimals_for(4.0 / PERIOD**3) == 1
    assert read_path("time,a\n0,1.5e-3\n1,2\n").roundings[0].unit == pytest.approx(1e-4)


@given(
    samples=st.lists(st.integers(-60, 60), min_size=8, max_size=60),
    steps=st.lists(st.floats(0.005, 0.05), min_size=59, max_size=59),
    unit=st.sampled_from([1.0, 0.1, 0.01, 1e-4]),
    is_sloped=st.booleans(),
)
@example([0] * 8 + [60] * 50, [0.01] * 59, 0.1, False)
@example([-30, 30] * 5, [0.005] * 59, 1.0, False)
@examples(40)
def test_no_position_leaves_its_band_whatever_the_samples(
    samples: list[int], steps: list[float], unit: float, is_sloped: bool
) -> None:
    positions = [unit * (each % 3 + number if is_sloped else each) for number, each in enumerate(samples)]
    found = smoothed(steps[: len(positions) - 1], positions, unit)
    assert (found[0], found[-1]) == (positions[0], positions[-1])
    assert all(abs(one - other) <= unit / 2 + 1e-12 for one, other in zip(found, positions, strict=True))
    if not is_rounded(steps[: len(positions) - 1], positions, unit):
        assert found == positions


def test_more_samples_than_can_be_smoothed_are_left_as_they_are() -> None:
    many = [float(number % 2) for number in range(MAX_SMOOTHED + 1)]
    assert smoothed([0.01] * MAX_SMOOTHED, many, 1.0) == many
