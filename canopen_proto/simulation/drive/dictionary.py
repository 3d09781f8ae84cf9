"""The object dictionaries of the simulated drives.

Two shapes, see `settings.Shape`. Both have the communication objects of CiA 301 with four RPDOs and four TPDOs, whose COB-IDs
follow the predefined connection set.

             standard (CiA 402 default mapping where it has one)   Schunk Powerball (the manual's PDOs.csv)
    RPDO1    6040                                                  6040, 6042, 60C1:01, type 1 (6042: the manual's 16-bit filler)
    RPDO2    6040, 6060                                            off
    RPDO3    6040, 607A                                            off
    RPDO4    6040, 60C1:01, type 1                                 off
    TPDO1    6041                                                  6041, 6077, 6064, type 1
    TPDO2    6041, 6061                                            606B, 606C, off
    TPDO3    6041, 6064                                            off
    TPDO4    6064, 606C, type 1                                    off

As in the files of real drives, the shapes differ in how a drive notices that its master is gone. Standard: SYNC period, four
heartbeat consumers, event times of RPDOs, 6007. Powerball: three heartbeat consumers, guarding, no 6007.

The defaults of speeds and ramps are those of fallbacks.FALLBACKS: an arm's joint in millidegrees.

**Several axes** (`axes`): each has the objects of the first one, and 0x67FF, 0x800 higher than the axis before it, and four PDOs
of each kind, from 64 * k + 1 on. The predefined connection set gives a node four CAN-IDs of each kind, so only the first PDOs of
the first four axes are valid: RPDO 64 * k + 1 (controlword and target position, type 1) is at 0x200 + 0x100 * k + node-ID, TPDO
64 * k + 1 (statusword, mode, position, type 1) at 0x180 + 0x100 * k + node-ID. All others are off, and empty.

Sources: CiA 301 v4.2.0, 7.5.2; CiA 402-4 (PDO mapping); the manual's files.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import Access, Object, ObjectDictionary
from canopen_proto.dictionary.pdo_records import pdo_records
from canopen_proto.dictionary.standard import standard_object, standard_variable
from canopen_proto.drives.cia402 import objects, positioning
from canopen_proto.drives.cia402.axes import PDOS_PER_AXIS, moved, with_names_of_axes
from canopen_proto.drives.cia402.option_codes import OPTION_CODES
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR, RPDO1, TPDO1
from canopen_proto.multiplexer import Mux, index_of, split_mux, subindex_of
from canopen_proto.simulation.drive.fallbacks import FALLBACKS
from canopen_proto.simulation.drive.homing import METHODS
from canopen_proto.simulation.drive.inputs import FUNCTIONS
from canopen_proto.simulation.drive.interpolated_position import POSITION_AND_VELOCITY
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.simulation.drive.smooth_motion import JERK_LIMITED

_EVENT_DRIVEN: Final = 255
_EACH_SYNC: Final = 1
_CHANNEL: Final = 0x100  # from one PDO's CAN-IDs to the next one's
_DEVICE_TYPE: Final = 0x0002_0192  # servo drive by CiA 402
_SEVERAL_DEVICES: Final = 0xFFFF_0192  # several logical devices, the first one by CiA 402


class _Pdo(NamedTuple):
    """The settings of a PDO after power-on."""

    entries: tuple[Mux, ...] = ()
    transmission_type: int = _EVENT_DRIVEN
    is_valid: bool = True


_OFF: Final = _Pdo(is_valid=False)

_RPDOS: Final[dict[Shape, tuple[_Pdo, ...]]] = {
    Shape.STANDARD: (
        _Pdo((objects.CONTROLWORD,)),
        _Pdo((objects.CONTROLWORD, objects.MODES_OF_OPERATION)),
        _Pdo((objects.CONTROLWORD, objects.TARGET_POSITION)),
        _Pdo((objects.CONTROLWORD, objects.INTERPOLATION_SET_POINT), _EACH_SYNC),
    ),
    Shape.SCHUNK_POWERBALL: (
        _Pdo((objects.CONTROLWORD, objects.VL_TARGET_VELOCITY, objects.INTERPOLATION_SET_POINT), _EACH_SYNC),
        _OFF,
        _OFF,
        _OFF,
    ),
}
_TPDOS: Final[dict[Shape, tuple[_Pdo, ...]]] = {
    Shape.STANDARD: (
        _Pdo((objects.STATUSWORD,)),
        _Pdo((objects.STATUSWORD, objects.MODES_OF_OPERATION_DISPLAY)),
        _Pdo((objects.STATUSWORD, objects.POSITION_ACTUAL_VALUE)),
        _Pdo((objects.POSITION_ACTUAL_VALUE, objects.VELOCITY_ACTUAL_VALUE), _EACH_SYNC),
    ),
    Shape.SCHUNK_POWERBALL: (
        _Pdo((objects.STATUSWORD, objects.TORQUE_ACTUAL_VALUE, objects.POSITION_ACTUAL_VALUE), _EACH_SYNC),
        _Pdo((objects.VELOCITY_DEMAND_VALUE, objects.VELOCITY_ACTUAL_VALUE), is_valid=False),
        _OFF,
        _OFF,
    ),
}

_COMMON: Final = (
    0x603F, 0x6040, 0x6041, 0x6060, 0x6061, 0x6062, 0x6064, 0x6065, 0x6066, 0x6067, 0x6068, 0x606B, 0x606C, 0x6077, 0x607A,
    0x607C, 0x607D, 0x6081, 0x6083, 0x6086, 0x60C0, 0x60C1, 0x60C2, 0x60C4, 0x60F4, 0x60FD, 0x6502,
)  # fmt: skip
_VELOCITY_MODE: Final = (0x6042, 0x6043, 0x6044, 0x6046, 0x6048, 0x6049, 0x604A, 0x604B, 0x604C)
_INPUTS_AND_PROBES: Final = (
    0x60B8, 0x60B9, 0x60BA, 0x60BB, 0x60BC, 0x60BD, 0x60D5, 0x60D6, 0x60D7, 0x60D8, 0x60E3, 0x60E4,
)  # fmt: skip
_ONLY: Final = {
    Shape.STANDARD: (
        0x6007, *_VELOCITY_MODE, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x606D, 0x606E, 0x606F, 0x6070, 0x6071, 0x6072, 0x6073,
        0x6074, 0x6075, 0x6076, 0x6078, 0x607F, 0x6080, 0x6082, 0x6084, 0x6085, 0x6087, 0x6098, 0x6099, 0x609A, 0x60A3, 0x60A4,
        0x607B, 0x60B0, 0x60B1, 0x60B2, 0x60C5, 0x60C6, 0x60E0, 0x60E1, 0x60F2, 0x60F8, 0x60FE, 0x60FF, *_INPUTS_AND_PROBES,
    ),
    Shape.SCHUNK_POWERBALL: (0x6042, 0x6098, 0x60B2),
}  # fmt: skip
"""The CiA 402 objects of each shape. (The real Powerball has some more, which mean nothing to a simulation.)"""

_ONLY_COMMUNICATION: Final = {
    Shape.STANDARD: (indices.COMMUNICATION_CYCLE_PERIOD, indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE),
    Shape.SCHUNK_POWERBALL: (indices.GUARD_TIME, indices.LIFE_TIME_FACTOR),
}
_HEARTBEAT_CONSUMERS: Final = {Shape.STANDARD: 4, Shape.SCHUNK_POWERBALL: 3}
_RPDO_SUBINDICES: Final = {Shape.STANDARD: (1, 2, 3, 5), Shape.SCHUNK_POWERBALL: (1, 2)}
"""Subindex 5, the event time, lets a drive notice that its RPDO stays away."""
_TPDO_SUBINDICES: Final = (1, 2, 3, 5, 6)
_SUPPORTED_MODES: Final = {Shape.STANDARD: 0x3EF, Shape.SCHUNK_POWERBALL: 0x43}  # all but 5 and 11; pp vl ip
_PRODUCT_CODES: Final = {Shape.STANDARD: 0xE5, Shape.SCHUNK_POWERBALL: 0x43}
_VENDOR_IDS: Final = {Shape.STANDARD: 0, Shape.SCHUNK_POWERBALL: objects.SCHUNK_VENDOR_ID}
_BUFFER_SIZE: Final = {Shape.STANDARD: 16, Shape.SCHUNK_POWERBALL: 1}
_NAMES: Final = {Shape.STANDARD: "Simulated CiA 402 drive", Shape.SCHUNK_POWERBALL: "Simulated Schunk Powerball joint"}


ALLOWED_VALUES: Final[dict[Mux, Collection[int]]] = {
    **OPTION_CODES,
    objects.MOTION_PROFILE_TYPE: (0, JERK_LIMITED),
    objects.PROFILE_JERK_USE: (1, 2),
    objects.INTERPOLATION_SUB_MODE_SELECT: (0, POSITION_AND_VELOCITY),
    objects.INTERPOLATION_TIME_UNITS: range(1, 256),
    objects.INTERPOLATION_TIME_INDEX: range(-6, 1),
    objects.BUFFER_ORGANISATION: range(2),
    objects.BUFFER_CLEAR: range(2),
    objects.TOUCH_PROBE_FUNCTION: FUNCTIONS,
    objects.POSITIONING_OPTION_CODE: positioning.OPTION_CODES,
}
"""The values that may be written to these objects; all others are refused with 06090030h."""


@cache
def drive_dictionary(shape: Shape = Shape.STANDARD, axes: int = 1) -> ObjectDictionary:
    """Return the dictionary of a simulated drive with 1 to 8 axes. All share one: the node-ID is added to COB-IDs in each drive's
    `Values`.
    """
    profile, source = _profile(shape), f"the simulated drive {shape.value!r}"
    if axes == 1:
        return ObjectDictionary([*_communication(shape), *_pdos(shape), *profile], source=source)
    name = "single_device_type"
    device_type = Object.of(name, [replace(standard_variable(0x1000), index=0x67FF, name=name, default=_DEVICE_TYPE)])
    of_axes = [moved(each, axis) for axis in range(axes) for each in (*profile, *_pdos_of_axis(axis), device_type)]
    whole = ObjectDictionary([*_communication(shape, _SEVERAL_DEVICES), *of_axes], source=f"{source} with {axes} axes")
    return with_names_of_axes(whole)


def _communication(shape: Shape, device_type: int = _DEVICE_TYPE) -> list[Object]:
    """Return the objects that CiA 301 asks for, and those that a master of these drives uses."""
    single: dict[int, Value | None] = {
        indices.DEVICE_TYPE: device_type,
        indices.ERROR_REGISTER: None,
        indices.COB_ID_SYNC: None,
        indices.MANUFACTURER_DEVICE_NAME: _NAMES[shape],
        indices.MANUFACTURER_HARDWARE_VERSION: "simulation",
        indices.MANUFACTURER_SOFTWARE_VERSION: "1",
        indices.COB_ID_EMERGENCY: None,
        indices.INHIBIT_TIME_EMERGENCY: None,
        indices.PRODUCER_HEARTBEAT_TIME: None,
    }
    single |= dict.fromkeys(_ONLY_COMMUNICATION[shape])
    described = [standard_object(index, value) for index, value in single.items()]
    described += [
        standard_object(indices.PREDEFINED_ERROR_FIELD, highest=8),
        standard_object(indices.CONSUMER_HEARTBEAT_TIME, highest=_HEARTBEAT_CONSUMERS[shape]),
        standard_object(
            indices.IDENTITY_OBJECT, highest=4, defaults={1: _VENDOR_IDS[shape], 2: _PRODUCT_CODES[shape], 3: 0x0001_0000, 4: 1}
        ),
        standard_object(indices.SDO_SERVER_PARAMETER, highest=2),
    ]
    return described


def _pdos(shape: Shape) -> list[Object]:
    """Return the records of the PDOs of a drive with one axis."""
    described: list[Object] = []
    for number in range(4):
        rpdo, tpdo = RPDO1 + number * _CHANNEL, (TPDO1 + number * _CHANNEL) | COB_ID_NO_RTR
        described += _pdo(indices.RPDO1_COMMUNICATION_PARAMETER + number, rpdo, _RPDO_SUBINDICES[shape], _RPDOS[shape][number])
        described += _pdo(indices.TPDO1_COMMUNICATION_PARAMETER + number, tpdo, _TPDO_SUBINDICES, _TPDOS[shape][number])
    return described


def _pdos_of_axis(axis: int) -> list[Object]:
    """Return the records of the PDOs of one of several axes; the objects that they carry are those of the first axis."""
    described: list[Object] = []
    for number in range(4):
        is_valid = number == 0 and axis < 4
        commands = (objects.CONTROLWORD, objects.TARGET_POSITION)
        values = (objects.STATUSWORD, objects.MODES_OF_OPERATION_DISPLAY, objects.POSITION_ACTUAL_VALUE)
        rpdo = _Pdo(commands, _EACH_SYNC) if is_valid else _OFF
        tpdo = _Pdo(values, _EACH_SYNC) if is_valid else _OFF
        place, shift = axis * PDOS_PER_AXIS + number, axis * _CHANNEL if is_valid else 0
        described += _pdo(indices.RPDO1_COMMUNICATION_PARAMETER + place, RPDO1 + shift, _RPDO_SUBINDICES[Shape.STANDARD], rpdo)
        described += _pdo(indices.TPDO1_COMMUNICATION_PARAMETER + place, (TPDO1 + shift) | COB_ID_NO_RTR, _TPDO_SUBINDICES, tpdo)
    return described


def _pdo(index: int, cob_id: int, subindices: tuple[int, ...], pdo: _Pdo) -> list[Object]:
    """Return the communication and the mapping record of one PDO."""
    cob_id |= 0 if pdo.is_valid else COB_ID_INVALID
    fields: dict[int, Value | None] = dict.fromkeys(subindices[1:]) | {2: pdo.transmission_type}
    return pdo_records(index, cob_id, fields, [standard_variable(*split_mux(key)) for key in pdo.entries])


def _profile(shape: Shape) -> list[Object]:
    """Return the CiA 402 objects of a shape."""
    defaults: dict[Mux, Value] = {
        **FALLBACKS,
        objects.SUPPORTED_DRIVE_MODES: _SUPPORTED_MODES[shape],
        objects.MAXIMUM_BUFFER_SIZE: _BUFFER_SIZE[shape],
    }
    if shape is Shape.STANDARD:
        defaults |= {objects.INTERPOLATION_TIME_UNITS: 10, objects.HOMING_METHOD: 35, objects.SHUTDOWN_OPTION_CODE: 1}
        defaults |= {Mux(objects.SUPPORTED_HOMING_METHODS + place): method for place, method in enumerate(METHODS, start=1)}
    described: dict[int, Object] = {}
    for index in (*_COMMON, *_ONLY[shape]):
        highest = {0x60C1: 2 if shape is Shape.STANDARD else 1, 0x60E3: len(METHODS)}.get(index)
        described[index] = standard_object(
            index,
            highest=highest,
            defaults={subindex_of(key): value for key, value in defaults.items() if index_of(key) == index},
        )
    if shape is Shape.SCHUNK_POWERBALL:  # it homes by its own method: 6098h is there, but constant 0
        constant = standard_variable(0x6098, access=Access.CONST, default=0, pdo_mappable=False)
        described[0x6098] = Object.of("homing_method", [constant])
    return list(described.values())
