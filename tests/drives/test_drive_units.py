"""The units of a drive: each object of the factor group, and drives as their makers deliver them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import FACTOR_GROUP, DriveUnits, Unit, read_units, units_of
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.procedures.steps import SdoTransferError
from canopen_proto.simulation.drive.settings import Shape
from tests.core.object_answers import run_against
from tests.drives.rig import Rig

ENCODER = {mux(0x608F, 1): 2000, mux(0x608F, 2): 1}
GEAR = {mux(0x6091, 1): 100, mux(0x6091, 2): 1}
FEED = {mux(0x6092, 1): 360_000, mux(0x6092, 2): 1}
SI_POSITION, SI_VELOCITY = mux(0x60A8), mux(0x60A9)
NOT_SET = {mux(0x608F, 1): 1, mux(0x608F, 2): 1, mux(0x6091, 1): 1, mux(0x6091, 2): 1, mux(0x6092, 1): 1, mux(0x6092, 2): 1}

TURNS: dict[str, tuple[dict[Mux, int], float | None, float | None]] = {
    "nothing": ({}, None, None),
    "the defaults of a file that leaves it alone": (NOT_SET, None, None),
    "an encoder": (ENCODER, 2000, 2000),
    "an encoder and a gear": (ENCODER | GEAR, 200_000, 2000),
    "a feed constant": (FEED, 360_000, 360_000),
    "a feed constant and a gear; the encoder does not count": (ENCODER | GEAR | FEED, 360_000, 3600),
    "a fraction": ({mux(0x608F, 1): 8192, mux(0x608F, 2): 3}, 8192 / 3, 8192 / 3),
    "a denominator of 0 sets nothing": ({mux(0x6092, 1): 5000, mux(0x6092, 2): 0} | ENCODER, 2000, 2000),
    "millidegrees": ({SI_POSITION: 0xFD410000}, 360_000, 360_000),
    "millidegrees, with a gear": ({SI_POSITION: 0xFD410000} | GEAR, 360_000, 3600),
    "microradians": ({SI_POSITION: 0xFA100000}, 2 * math.pi * 1e6, 2 * math.pi * 1e6),
    "thousandths of a turn": ({SI_POSITION: 0xFDB40000}, 1000, 1000),
    "increments": ({SI_POSITION: 0x00B50000} | ENCODER, 2000, 2000),
    "a unit that is not known": ({SI_POSITION: 0x00990000} | ENCODER, 2000, 2000),
}


@pytest.mark.parametrize("case", TURNS)
def test_counts_for_a_turn(case: str) -> None:
    values, shaft, motor = TURNS[case]
    units = units_of(values)
    assert units.per_turn == (shaft if shaft is None else pytest.approx(shaft))
    assert units.per_motor_turn == (motor if motor is None else pytest.approx(motor))
    assert units.conflicts == ()
    assert ("per_turn" in units.origins) is (shaft is not None)
    if shaft is not None:
        assert units.counts_per(Unit.TURN) == pytest.approx(shaft)
        assert units.counts_per(Unit.DEGREE) == pytest.approx(shaft / 360)
        assert units.counts_per(Unit.RADIAN) == pytest.approx(shaft / (2 * math.pi))
    assert units.counts_per(Unit.MILLIMETRE) is None


def test_a_slide_counts_lengths() -> None:
    units = units_of({SI_POSITION: 0xFA010000} | FEED)  # micrometres, 360 mm for a turn
    assert units.counts_per(Unit.MILLIMETRE) == pytest.approx(1000)
    assert units.per_turn == 360_000
    assert units.origins["per_metre"] == "0x60A8 = 0xFA010000, a count is 1e-06 m"
    assert units.conflicts == ()


def test_two_scales_that_differ_are_told() -> None:
    units = units_of({SI_POSITION: 0xFD410000} | ENCODER | GEAR)
    assert units.per_turn == 360_000
    assert units.conflicts == (
        "0x608F = 2000 / 1, 0x6091 = 100 / 1: 200000 counts for a turn; 0x60A8 = 0xFD410000, a count is 0.001 degree: 360000",
    )


VELOCITIES: dict[str, tuple[dict[Mux, int], float | None]] = {
    "by default a count per second": ({}, 1),
    "increments per second": ({SI_VELOCITY: 0x00B50300}, 1),
    "turns per minute of the shaft": ({SI_VELOCITY: 0x00B44700} | ENCODER | GEAR, 200_000 / 60),
    "thousandths of a turn per minute": ({SI_VELOCITY: 0xFDB44700} | ENCODER, 2 / 60),
    "degrees per second": ({SI_VELOCITY: 0x00410300} | FEED, 1000),
    "millimetres per second of a slide in micrometres": ({SI_VELOCITY: 0xFD010300, SI_POSITION: 0xFA010000}, 1000),
    "metres without a length": ({SI_VELOCITY: 0x00010300} | ENCODER, None),
    "a unit of time that is not known": ({SI_VELOCITY: 0x00B54800}, None),
    "a turn that is not known": ({SI_VELOCITY: 0x00B44700}, None),
    "the older rev/min is the motor's": ({mux(0x608C): 0xA4} | ENCODER | GEAR, 2000 / 60),
    "the older tenths of rev/min": ({mux(0x608C): 0xA4, mux(0x608B): 0xFF} | ENCODER, 200 / 60),
    "an older unit that is not known": ({mux(0x608C): 0x41} | ENCODER, None),
    "the velocity factor makes rev/min of counts per second": ({mux(0x6096, 1): 60, mux(0x6096, 2): 65536}, 65536 / 60),
    "a velocity factor of 1": ({mux(0x6096, 1): 1, mux(0x6096, 2): 1}, 1),
}


@pytest.mark.parametrize("case", VELOCITIES)
def test_a_velocity_unit(case: str) -> None:
    values, expected = VELOCITIES[case]
    assert units_of(values).per_velocity == (expected if expected is None else pytest.approx(expected))


SI_ACCELERATION = mux(0x60AA)
ACCELERATIONS: dict[str, tuple[dict[Mux, int], float | None]] = {
    "by default the velocity unit per second": ({mux(0x6096, 1): 60, mux(0x6096, 2): 65536}, 65536 / 60),
    "increments": ({SI_ACCELERATION: 0x00B55700, SI_VELOCITY: 0x00B44700} | ENCODER, 1),
    "degrees": ({SI_ACCELERATION: 0x00415700} | FEED, 1000),
    "millimetres of a slide in micrometres": ({SI_ACCELERATION: 0xFD015700, SI_POSITION: 0xFA010000}, 1000),
    "metres without a length": ({SI_ACCELERATION: 0x00015700} | ENCODER, None),
    "not over square seconds": ({SI_ACCELERATION: 0x00B44700} | ENCODER, None),
    "the acceleration factor": ({mux(0x6097, 1): 1, mux(0x6097, 2): 1000}, 1000),
    "an acceleration factor of 1": ({mux(0x6097, 1): 1, mux(0x6097, 2): 1}, 1),
    "the name before the factor": ({SI_ACCELERATION: 0x00B55700, mux(0x6097, 1): 1, mux(0x6097, 2): 1000}, 1),
}


@pytest.mark.parametrize("case", ACCELERATIONS)
def test_an_acceleration_unit(case: str) -> None:
    values, expected = ACCELERATIONS[case]
    units = units_of(values)
    assert units.acceleration_unit(units.per_velocity) == (expected if expected is None else pytest.approx(expected))


def test_accelerations_go_in_the_drives_own_unit() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = AxisSettings(counts_per_unit=1000.0)
    rig.axis.scale.units = units_of({mux(0x6097, 1): 1, mux(0x6097, 2): 100})
    assert (rig.axis.scale.rate_to_wire(5.0), rig.axis.scale.speed_to_wire(5.0)) == (50, 5000)
    rig.axis.scale.units = units_of({SI_ACCELERATION: 0x00B44700} | ENCODER)
    with pytest.raises(LocalProtocolError, match=r"cannot be converted \(0x60AA = 0x00B44700\)"):
        rig.axis.scale.rate_to_wire(5.0)
    rig.axis.settings = AxisSettings(counts_per_unit=1000.0, acceleration_unit=10.0)
    assert rig.axis.scale.rate_to_wire(5.0) == 500


def test_torque_polarity_and_offset() -> None:
    units = units_of({mux(0x6076): 1270, mux(0x607E): 0xA0, mux(0x607C): -500})
    assert units.torque(500) == pytest.approx(0.635)
    assert units.reversed == ("position", "torque")
    assert units.home_offset == -500
    assert units_of({mux(0x6076): 0}).torque(500) is None
    assert units_of({mux(0x607E): 0x40}).reversed == ("velocity",)


MAKERS: dict[str, tuple[dict[Mux, int], DriveUnits]] = {
    "Inovance E35": (
        {**ENCODER, **{key: 1 for key in NOT_SET if key >= mux(0x6091)}, SI_POSITION: 0xB50000, SI_VELOCITY: 0xB50300},
        DriveUnits(2000, 2000, None, 1),
    ),
    "maxon EPOS2": ({mux(0x608C): 0xA4, mux(0x608B): 0}, DriveUnits(None, None, None, None)),
    "Faulhaber": (
        {mux(0x608F, 1): 4096, mux(0x608F, 2): 1, mux(0x6092, 1): 4096, mux(0x6092, 2): 1},
        DriveUnits(4096, 4096, None, 1),
    ),
    "Schunk Powerball": ({}, DriveUnits(None, None, None, 1)),
}


@pytest.mark.parametrize("maker", MAKERS)
def test_drives_as_they_are_delivered(maker: str) -> None:
    values, expected = MAKERS[maker]
    units = units_of(values)
    assert (units.per_turn, units.per_motor_turn, units.per_metre, units.per_velocity) == (
        expected.per_turn,
        expected.per_motor_turn,
        expected.per_metre,
        expected.per_velocity,
    )


@given(st.dictionaries(st.sampled_from(FACTOR_GROUP), st.integers(0, 0xFFFF_FFFF)))
def test_whatever_a_drive_says_is_no_error(values: dict[Mux, int]) -> None:
    units = units_of(values)
    rates = units.per_velocity, units.per_acceleration
    for scale in (units.per_turn, units.per_motor_turn, units.per_metre, *rates, units.rated_torque):
        assert scale is None or (scale > 0 and math.isfinite(scale))
    for name in ("per_turn", "per_metre", "rated_torque"):
        assert (name in units.origins) is (getattr(units, name) is not None)


def test_it_is_read_from_the_drive() -> None:
    units = run_against({(0x608F, 1): 2000, (0x608F, 2): 1, (0x607C, 0): -500, (0x6076, 0): 310}, read_units)
    assert isinstance(units, DriveUnits)
    assert (units.per_turn, units.home_offset, units.rated_torque) == (2000, -500, 0.31)
    assert run_against({}, read_units) == DriveUnits(per_velocity=1.0, origins={"per_velocity": "the default"})


def test_a_drive_that_does_not_answer_is_an_error() -> None:
    assert isinstance(run_against({}, read_units, abort=None), SdoTransferError)
    told = run_against({}, read_units, abort=AbortCode.TIMED_OUT)  # the drive's own abort, not our time-out
    assert isinstance(told, DriveUnits)
