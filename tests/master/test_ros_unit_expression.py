"""Conversions of ros_canopen, read as arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master.ros_configurations.scale import ContradictionError, position_keys, velocity_keys
from canopen_master.ros_configurations.unit_expression import (
    MAX_DEPTH,
    MAX_LENGTH,
    ONE,
    ZERO,
    Exact,
    Line,
    NotLinearError,
    read_expression,
)
from tests.examples import examples


@pytest.mark.parametrize(
    ("text", "factor", "power", "offset", "variable"),
    [
        ("pos", 1, 0, 0, "pos"),
        ("rint(rad2deg(pos)*1000)", 180_000, -1, 0, "pos"),
        ("rint(rad2deg(pos)*3200*26/360)", 41_600, -1, 0, "pos"),
        ("deg2rad(obj6064*360/3200/26)", Fraction(1, 41_600), 1, 0, "obj6064"),
        ("pos * 360000 / (2 * pi)", 180_000, -1, 0, "pos"),
        ("-(pos + 0.1) * 100", -100, 0, -10, "pos"),
        ("1e3*pos - 2*pos/4 + 7", Fraction(1999, 2), 0, 7, "pos"),
        ("010*pos", 10, 0, 0, "pos"),
        ("--pos", 1, 0, 0, "pos"),
        ("0", 0, 0, 0, ""),
        ("pos - pos", 0, 0, 0, "pos"),
    ],
)
def test_a_plain_factor_is_kept_exactly(text: str, factor: Fraction, power: int, offset: int, variable: str) -> None:
    assert read_expression(text) == Line(Exact(Fraction(factor), power), Exact(Fraction(offset)), variable)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("norm(obj6064, -pi, pi)", "the function 'norm' is no plain factor"),
        ("smooth(vel, old, 0.1)", "the function 'smooth'"),
        ("__import__('os')", "is not known in it"),
        ("pos*pos", "multiplies or divides by its variable"),
        ("1/pos", "multiplies or divides by its variable"),
        ("pos/0", "divides by 0"),
        ("pos/(1-1)", "divides by 0"),
        ("pos+vel", "two variables"),
        ("pos+pi*pos", "with pi and without"),
        ("2*(pos", "not closed"),
        ("deg2rad(pos, 2)", "several arguments"),
        ("rint(pos)*1000", "the function 'rint'"),
        ("rint(pos)*rint(2)", "the function 'rint'"),
        ("pos pos", "out of place"),
        ("2**pos", "out of place"),
        ("pos)", "out of place"),
        ("pos^2", "'^' is not known"),
        ("", "ends too early"),
        ("pos*", "ends too early"),
        ("(" * (MAX_DEPTH + 1) + "pos" + ")" * (MAX_DEPTH + 1), "nested deeper"),
        ("pos" + "+1" * MAX_LENGTH, "more than"),
        ("pos, vel", "out of place"),
    ],
)
def test_anything_else_is_refused_with_its_reason(text: str, reason: str) -> None:
    with pytest.raises(NotLinearError) as raised:
        read_expression(text)
    assert reason in str(raised.value)


@given(st.text("pos12.e()+-*/ rintadgobj6", max_size=40))
def test_no_text_does_more_than_be_read_or_refused(text: str) -> None:
    try:
        line = read_expression(text)
    except NotLinearError as refused:
        assert str(refused)  # a reason, always
    else:
        assert isinstance(line.factor.fraction, Fraction)


def line(text: str) -> Line:
    return read_expression(text)


def test_the_scale_stands_under_the_key_that_holds_it_exactly() -> None:
    degrees = position_keys(line("rad2deg(pos)*1000"), line("deg2rad(obj6064)/1000"), is_linear=False)
    assert (degrees.keys, degrees.notes) == ({"unit": "radian", "counts_per_turn": 360_000}, ())
    radians = position_keys(line("pos*1000.5"), line("obj6064/1000.5"), is_linear=False)
    assert (radians.keys, radians.notes) == ({"unit": "radian", "counts_per_unit": 1000.5}, ())
    slide = position_keys(line("pos*200000"), line("obj6064/200000"), is_linear=True)
    assert (slide.keys, slide.notes) == ({"unit": "millimetre", "counts_per_unit": 200}, ())
    reversed_ = position_keys(line("7-1000*pos"), line("(7-obj6064)/1000"), is_linear=False)
    assert reversed_.keys == {"unit": "radian", "counts_per_unit": 1000, "direction": -1, "offset": 7}


def test_what_is_rounded_is_told() -> None:
    third = position_keys(line("pos/3"), line("3*obj6064"), is_linear=False)
    assert third.keys["counts_per_unit"] == 1 / 3
    assert third.notes == ("rounded to 17 digits, as every float",)
    typed = position_keys(line("pos*57295.78"), line("obj6064*1.745329e-05"), is_linear=False)
    assert typed.keys["counts_per_unit"] == 57295.78
    assert "differs by" in typed.notes[0]


@given(scale=st.floats(1e-3, 1e7), digits=st.integers(3, 12), others=st.integers(3, 12), swapped=st.booleans())
@examples(60)
def test_inverses_that_were_rounded_give_a_scale_by_the_one_with_more_digits(
    scale: float, digits: int, others: int, swapped: bool
) -> None:
    factors = f"{scale:.{digits - 1}e}", f"{1 / scale:.{others - 1}e}"
    there, back = factors[::-1] if swapped else factors
    made = position_keys(line(f"pos*{there}"), line(f"obj6064*{back}"), is_linear=False)
    kept = made.keys["counts_per_unit"]
    assert kept in (pytest.approx(float(there), rel=1e-12), pytest.approx(1 / float(back), rel=1e-12))
    finest = 10.0 ** (1 - max(digits, others))
    assert kept == pytest.approx(1 / scale if swapped else scale, rel=max(finest, 1e-6))


@pytest.mark.parametrize(
    ("there", "back", "counts", "said"),
    [
        ("pos*57295.78", "obj6064*0.00001745", 57295.78, "the one to the drive has more digits"),
        ("pos*57296", "obj6064*0.0000174533", 1 / 0.0000174533, "the one from the drive has more digits"),
        ("pos*57.3", "obj6064*0.01745329", 1 / 0.01745329, "the one from the drive has more digits"),
    ],
)
def test_the_factor_that_counts_is_told(there: str, back: str, counts: float, said: str) -> None:
    made = position_keys(line(there), line(back), is_linear=False)
    assert made.keys["counts_per_unit"] == pytest.approx(counts, rel=1e-12)
    assert said in made.notes[0]


@pytest.mark.parametrize(
    ("there", "back", "reason"),
    [
        ("pos*1400", "obj6064*0.001", "not the inverse"),
        ("pos*57295.78", "obj6064*0.00001755", "not the inverse"),
        ("pos*3200*26/360", "obj6064*360/(3205*26)", "not the inverse"),
        ("pos*1000", "obj6064/2000", "not the inverse"),
        ("pos*1000", "-obj6064/1000", "not the inverse"),
        ("0", "obj6064", "a factor is 0"),
        ("pos*1000+10", "obj6064/1000+5", "do not belong together"),
        ("pos*1000+10", "obj6064/1000", "do not belong together"),
        ("pos*1000+0.5", "obj6064/1000-0.0005", "a whole number of counts"),
        ("pos*1e999", "obj6064/1e999", "too large"),
        ("pos/1e999", "obj6064*1e999", "too large or too small"),
        ("pos*1000+10*pi", "obj6064/1000-1", "do not belong together"),
    ],
)
def test_contradictions_give_no_scale(there: str, back: str, reason: str) -> None:
    with pytest.raises(ContradictionError) as raised:
        position_keys(line(there), line(back), is_linear=False)
    assert reason in str(raised.value)


def test_the_unit_of_velocities() -> None:
    scale = line("rad2deg(pos)*1000").factor
    assert velocity_keys(scale, line("rad2deg(vel)*100"), line("deg2rad(obj606C)/100")).keys == {"velocity_unit": 10}
    irrational = velocity_keys(scale, line("vel"), line("obj606C"))
    assert irrational.keys == {"velocity_unit": pytest.approx(180_000 / math.pi)}
    assert irrational.notes
    for there, back in (("vel*2", "obj606C*2"), ("vel+1", "obj606C"), ("-vel", "-obj606C"), ("0", "obj606C")):
        with pytest.raises(ContradictionError):
            velocity_keys(scale, line(there), line(back))


def test_zero_has_no_pi() -> None:
    assert Exact(Fraction(2), 3) * ZERO == ZERO
    assert ZERO + ONE == ONE + ZERO == ONE
