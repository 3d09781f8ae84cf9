"""The set-points of the cyclic modes, in the user's units: what the image holds, and what is refused."""

from __future__ import annotations

import math

import pytest

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import Direction, ObjectDictionary, PdoDescription
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.drives.axis.units import DriveUnits
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import LocalProtocolError, Outbox
from canopen_proto.multiplexer import Mux, index_of
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary

TARGETS = (objects.TARGET_VELOCITY, objects.TARGET_TORQUE)
NOTHING_TOLD = DriveUnits()
OFFSETS = (objects.POSITION_OFFSET, objects.VELOCITY_OFFSET, objects.TORQUE_OFFSET)


def axis_of(settings: AxisSettings, units: DriveUnits = NOTHING_TOLD, carried: tuple[Mux, ...] = OFFSETS) -> Axis:
    """The axis of a drive with all set-points. carried: the objects of the RPDO that is exchanged with it."""
    given = dict(drive_dictionary().objects)
    added = {index_of(mux): standard_object(index_of(mux)) for mux in (*TARGETS, *OFFSETS)}
    node = RemoteNode(Outbox(), 5, ObjectDictionary(list((given | added).values())))
    for number, mux in enumerate(carried, start=1):
        node.add_pdo(PdoDescription("rpdo", 0x100 + 0x100 * number, Direction.RPDO, number, (node.dictionary.variable(mux),)), 0)
    axis = Axis(node, settings)
    axis.scale.units = units
    return axis


def images(axis: Axis, *muxes: Mux) -> list[object]:
    return [axis.node.values.store.get(mux, 0) for mux in muxes]


@pytest.mark.parametrize("direction", [1, -1])
def test_a_velocity_goes_out_in_the_drives_unit(direction: int) -> None:
    """A degree has 100 counts, and a velocity of 1 is a revolution of 36,000 counts a minute, 600 counts per second."""
    axis = axis_of(AxisSettings(counts_per_unit=100.0, direction=direction, offset=5_000), DriveUnits(per_velocity=600.0))
    assert axis.set_points.set_velocity(60.0) == pytest.approx(60.0)
    assert images(axis, objects.TARGET_VELOCITY) == [10 * direction]
    assert axis.set_points.set_velocity(61.0) == pytest.approx(60.0)  # rounded, which the result tells
    axis.node.values.store[objects.VELOCITY_ACTUAL_VALUE] = 20 * direction
    axis.node.heard_at[objects.VELOCITY_ACTUAL_VALUE] = 0
    assert axis.velocity == pytest.approx(120.0)


def test_the_settings_go_before_the_drives_velocity_unit() -> None:
    axis = axis_of(AxisSettings(counts_per_unit=100.0, velocity_unit=10.0), DriveUnits(per_velocity=600.0))
    axis.set_points.set_velocity(-1.0)
    assert images(axis, objects.TARGET_VELOCITY) == [-10]
    for unit in (0.0, -1.0, math.nan):
        with pytest.raises(LocalProtocolError, match="velocity_unit must be"):
            AxisSettings(velocity_unit=unit)


def test_without_a_velocity_unit_no_velocity_is_sent() -> None:
    axis = axis_of(AxisSettings(counts_per_unit=100.0))
    with pytest.raises(LocalProtocolError, match="velocity unit of drive 5 is not known"):
        axis.set_points.set_velocity(0.0)
    with pytest.raises(LocalProtocolError, match="velocity unit of drive 5 is not known"):
        axis.set_points.set_offsets(velocity=1.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_torque_is_a_share_of_the_rated_torque(direction: int) -> None:
    axis = axis_of(AxisSettings(direction=direction))
    assert axis.set_points.set_torque(0.2504) == pytest.approx(0.25)
    assert images(axis, objects.TARGET_TORQUE) == [250 * direction]
    with pytest.raises(ValueRangeError, match="target_torque"):
        axis.set_points.set_torque(33.0)
    assert images(axis, objects.TARGET_TORQUE) == [250 * direction]
    axis.node.values.store[objects.TORQUE_ACTUAL_VALUE] = 250 * direction
    axis.node.heard_at[objects.TORQUE_ACTUAL_VALUE] = 0
    assert axis.torque == 0.25


def test_newton_metres_need_the_rated_torque() -> None:
    assert DriveUnits(rated_torque=2.0).per_thousand(0.5) == 250
    assert DriveUnits().per_thousand(0.5) is None


def test_offsets_go_into_their_objects_without_the_offset_of_positions() -> None:
    settings = AxisSettings(counts_per_unit=100.0, direction=-1, offset=5_000)
    axis = axis_of(settings, DriveUnits(per_velocity=50.0))
    axis.set_points.set_offsets(position=0.5, velocity=2.0, torque=0.1)
    assert images(axis, *OFFSETS) == [-50, -4, -100]
    axis.set_points.set_offsets(torque=0.1)
    assert images(axis, *OFFSETS) == [0, 0, -100]


def test_an_offset_that_no_rpdo_carries_is_refused_and_nothing_changes() -> None:
    axis = axis_of(AxisSettings(), carried=(objects.TORQUE_OFFSET,))
    axis.set_points.set_offsets(torque=0.1)
    with pytest.raises(LocalProtocolError, match=r"no RPDO that is exchanged with drive 5 carries the offset 0x60B0:00"):
        axis.set_points.set_offsets(position=1.0, torque=0.2)
    with pytest.raises(ValueRangeError, match="torque_offset"):
        axis.set_points.set_offsets(torque=40.0)
    assert images(axis, *OFFSETS) == [0, 0, 100]


def test_a_drive_without_the_object_says_so() -> None:
    axis = Axis(RemoteNode(Outbox(), 5, ObjectDictionary([
        each for index, each in drive_dictionary().objects.items() if index not in (0x6071, 0x60FF)
    ])))  # fmt: skip
    with pytest.raises(LocalProtocolError, match="6071"):
        axis.set_points.set_torque(0.1)
