"""Which drives are Schunk's: those whose vendor-ID, or whose user, says so. 0x6502 says nothing of it."""

from __future__ import annotations

import dataclasses
import math

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL, Axis, AxisSettings, HomingStyle
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND, LocalProtocolError
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.core.object_answers import run_against
from tests.drives.rig import Rig

SCHUNK = objects.SCHUNK_VENDOR_ID
STANDARD = AxisSettings(homing=HomingStyle.STANDARD)


@pytest.mark.parametrize("modes", [0x43, 0x63, 0])
@pytest.mark.parametrize(("vendor", "expected"), [(SCHUNK, SCHUNK_POWERBALL), (0x147, STANDARD), (0, STANDARD)])
@pytest.mark.parametrize("shape", list(Shape))
def test_the_vendor_id_decides_and_the_modes_do_not(shape: Shape, vendor: int, expected: AxisSettings, modes: int) -> None:
    rig = Rig(shape, pdos=False)
    rig.node.values.store |= {objects.VENDOR_ID: vendor, objects.SUPPORTED_DRIVE_MODES: modes}
    axis = Axis(rig.remote)
    rig.run(identify(axis))
    assert axis.settings == expected


def test_the_simulated_powerball_is_schunks() -> None:
    assert {shape: drive_dictionary(shape).variable((0x1018, 1)).default for shape in Shape} == {
        Shape.STANDARD: 0,
        Shape.SCHUNK_POWERBALL: SCHUNK,
    }


def test_a_drive_without_a_vendor_id_is_a_standard_one() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    rig.device.detach(rig.node)
    objects_without = [each for each in rig.node.dictionary.objects.values() if each.index != 0x1018]
    node = DriveNode(rig.device.out, 5, DriveSettings(), dictionary=ObjectDictionary(objects_without))
    rig.device.attach(node)
    node.boot(rig.bus.now)
    rig.bus.run(MILLISECOND)
    axis = Axis(rig.remote)
    rig.run(identify(axis))
    assert axis.settings == STANDARD


def test_a_drive_that_does_not_answer_is_not_guessed() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    rig.node.sdo.disable()
    axis = Axis(rig.remote)
    with pytest.raises(SdoTransferError):
        rig.run(identify(axis))
    assert not axis.is_identified


@pytest.mark.parametrize("given", [SCHUNK_POWERBALL, STANDARD])
@pytest.mark.parametrize("shape", list(Shape))
def test_what_the_user_says_goes_before_the_vendor_id(shape: Shape, given: AxisSettings) -> None:
    rig = Rig(shape, pdos=False)
    axis = Axis(rig.remote, given)
    rig.bus.sent.clear()
    rig.run(identify(axis))
    assert axis.settings == given
    assert not rig.bus.sent


def identified(given: AxisSettings) -> Axis:
    """An axis of a drive that has a feed constant of 3600 counts, and no vendor-ID, after it was identified twice."""
    axes: list[Axis] = []

    def procedure(node: RemoteNode) -> Procedure[None]:
        axes.append(Axis(node, given))
        yield from identify(axes[0])
        yield from identify(axes[0])

    assert run_against({(0x6092, 1): 3600, (0x6092, 2): 1}, procedure) is None
    return axes[0]


@pytest.mark.parametrize(("unit", "counts"), [(Unit.DEGREE, 10.0), (Unit.TURN, 3600.0), (Unit.RADIAN, 1800 / math.pi)])
def test_the_scale_of_a_named_unit_is_the_drives(unit: Unit, counts: float) -> None:
    given = AxisSettings(unit=unit, min_position=-1.0)
    axis = identified(given)
    assert axis.settings.counts_per_unit == pytest.approx(counts)
    assert dataclasses.replace(axis.settings, counts_per_unit=None) == dataclasses.replace(given, homing=HomingStyle.STANDARD)
    assert axis.scale.is_known
    assert axis.scale.to_counts(1) == round(counts)
    axis.check_settings(given)


def test_a_scale_by_hand_goes_before_the_drives() -> None:
    assert identified(AxisSettings(unit=Unit.DEGREE, counts_per_unit=7.0)).settings.counts_per_unit == 7


@pytest.mark.parametrize(("unit", "counts"), [(None, 180_000 / math.pi), (Unit.RADIAN, 180_000 / math.pi), (Unit.DEGREE, 1000)])
def test_schunks_joints_count_millidegrees_in_any_unit(unit: Unit | None, counts: float) -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    axis = Axis(rig.remote, AxisSettings(unit=unit))
    rig.run(identify(axis))
    assert axis.settings.counts_per_unit == pytest.approx(counts)


@pytest.mark.parametrize(("shape", "unit"), [(Shape.STANDARD, Unit.MILLIMETRE), (Shape.SCHUNK_POWERBALL, Unit.MILLIMETRE)])
def test_a_drive_that_does_not_tell_its_scale_is_not_used(shape: Shape, unit: Unit) -> None:
    axis = Axis((rig := Rig(shape, pdos=False)).remote, AxisSettings(unit=unit))
    with pytest.raises(ProcedureError, match=r"how many counts a millimetre has .*\. Try: counts_per_unit, by its manual"):
        rig.run(identify(axis))
    assert not axis.scale.is_known


def test_a_drive_is_asked_once_and_units_that_were_given_stay() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    given = AxisSettings(counts_per_unit=1.0, direction=-1)
    axis = Axis(rig.remote, given)
    rig.run(identify(axis))
    assert axis.settings == dataclasses.replace(given, homing=HomingStyle.SCHUNK)
    rig.bus.sent.clear()
    rig.run(identify(axis))
    assert not rig.bus.sent
    for same in (given, axis.settings):
        axis.check_settings(same)
    with pytest.raises(LocalProtocolError, match=r"other settings: direction -1, not 1, homing schunk, not standard$"):
        axis.check_settings(dataclasses.replace(STANDARD, counts_per_unit=1.0))
