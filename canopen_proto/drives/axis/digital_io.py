"""Digital inputs and outputs of a drive, its brake among them, and the position of a second encoder.

    0x60FD      inputs: bit 0 negative limit switch, 1 positive limit switch, 2 home switch, 3 interlock; from 16 the maker's
    0x60FE:01   outputs: bit 0 "set brake"; from 16 the maker's
    0x60FE:02   mask: an output whose bit is 0 here stays the drive's own
    0x60E4:01   position of the second encoder, in its own counts

**Outputs** are written first, then the mask: no output takes an old value for a moment. Only the outputs that are named change.

**The brake.** With bit 0 of the mask, the master commands the brake in place of the drive, and a 0 in the outputs opens it (a 1
holds; `AxisSettings.brake_bit` says it for drives that differ). Without power, an open brake lets a vertical axis fall. So it is
opened only while the drive is in Operation enabled, unless the caller says that the axis cannot fall. The drive gets its brake
back before it is led to a state without power, and after a quick stop was commanded. If this program dies meanwhile, it does
not: a drive that stops by itself then stands without power and without brake.

Source: IEC 61800-7-201 (CiA 402-2), 60FDh, 60FEh, 60E4h; from memory, and as the manuals of several makers have them.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntFlag
from typing import Final, NoReturn

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import DriveError, as_drive_errors, name_of
from canopen_proto.drives.axis.watching import POLL_INTERVAL, read_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.machine import Event, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_if_present, read_int, write
from canopen_proto.procedures.steps import Procedure, ProcedureError, current_time, sleep

_BITS: Final = 32
SET_BRAKE: Final = DriveBit(objects.DIGITAL_OUTPUTS, 0)
"""The standard's bit of the brake: 1 holds."""


class Input(IntFlag):
    """The inputs (0x60FD) that the standard names. A maker's are bits 16 to 31."""

    NEGATIVE_LIMIT = 1 << 0
    POSITIVE_LIMIT = 1 << 1
    HOME = 1 << 2
    INTERLOCK = 1 << 3


class DigitalInputsChanged(Event):
    """The inputs of a drive have changed. inputs: as they are now, `Input` and the maker's bits; changed: those that differ.
    axis: of the node."""

    __match_args__ = ("node_id", "inputs", "changed", "axis")

    def __init__(self, node_id: int, inputs: Input, changed: Input, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.inputs = inputs
        self.changed = changed


@as_drive_errors
def read_inputs(axis: Axis, max_age: Time = 0) -> Procedure[Input]:
    """Return the digital inputs: as heard by PDO within `max_age` ns, else read by SDO."""
    heard = axis.node.fresh(objects.DIGITAL_INPUTS, (yield from current_time()), max_age) if max_age else None
    value = heard if isinstance(heard, int) else (yield from read_int(axis.node, objects.DIGITAL_INPUTS))
    return Input(value)


@as_drive_errors
def watch_inputs(axis: Axis, interval: Time = POLL_INTERVAL) -> Procedure[NoReturn]:
    """Report each change of the digital inputs as `DigitalInputsChanged`, until cancelled. interval: ns between two looks."""
    node = axis.node
    before = yield from read_inputs(axis, interval)
    while True:
        yield from sleep(interval)
        inputs = yield from read_inputs(axis, interval)
        if inputs != before:
            node.out.events.append(DigitalInputsChanged(node.node_id, inputs, inputs ^ before, axis.number))
            before = inputs


@as_drive_errors
def set_outputs(axis: Axis, outputs: Mapping[int, bool], *, cannot_fall: bool = False) -> Procedure[None]:
    """Set digital outputs, by bit number of 0x60FE; the others stay as they are.

    cannot_fall: the brake may be opened although the drive has no power. Raises DriveError, with nothing written, for a brake
    that would be opened without; LocalProtocolError for a bit that is none; SdoTransferError.
    """
    node = axis.node
    wrong = [bit for bit in outputs if not 0 <= bit < _BITS]
    if wrong:
        raise LocalProtocolError(f"{name_of(axis)} has no output {wrong[0]}: 0x60FE has bits 0 to {_BITS - 1}")
    brake = brake_of(axis)
    opens_brake = brake.bit in outputs and outputs[brake.bit] is not (brake.value == 1)
    if opens_brake and not cannot_fall:
        state = state_of((yield from read_statusword(axis)))
        if state is not State.OPERATION_ENABLED:
            raise DriveError(
                axis,
                "was not told to open its brake",
                reason=f"it has no power to hold the axis ({state}); nothing was sent",
                remedy="enable it first; set_outputs(..., cannot_fall=True) for an axis that cannot fall",
            )
    before = yield from read_int(node, objects.DIGITAL_OUTPUTS)
    mask = yield from read_if_present(node, objects.DIGITAL_OUTPUT_MASK)
    bits = sum(1 << bit for bit in outputs)
    if opens_brake:
        axis.has_opened_brake = True  # before it is: a write that is not confirmed may have arrived
    yield from write(node, objects.DIGITAL_OUTPUTS, before & ~bits | sum(1 << bit for bit, value in outputs.items() if value))
    if isinstance(mask, int) and mask & bits != bits:
        yield from write(node, objects.DIGITAL_OUTPUT_MASK, mask | bits)
    if brake.bit in outputs and not opens_brake:
        axis.has_opened_brake = False


def brake_of(axis: Axis) -> DriveBit:
    """Return the output bit that commands the brake."""
    brake = axis.settings.brake_bit
    return brake if brake is not None and brake.mux == objects.DIGITAL_OUTPUTS else SET_BRAKE


def return_brake(axis: Axis) -> Procedure[None]:
    """Let the drive command its brake again, if this master has opened it. A drive without a mask is told to hold it."""
    if not axis.has_opened_brake:
        return
    node, brake = axis.node, brake_of(axis)
    mask = yield from read_if_present(node, objects.DIGITAL_OUTPUT_MASK)
    if isinstance(mask, int):
        yield from write(node, objects.DIGITAL_OUTPUT_MASK, mask & ~(1 << brake.bit))
    else:
        before = yield from read_int(node, objects.DIGITAL_OUTPUTS)
        yield from write(node, objects.DIGITAL_OUTPUTS, before & ~(1 << brake.bit) | brake.value << brake.bit)
    axis.has_opened_brake = False


@as_drive_errors
def read_encoder(axis: Axis, number: int = 1) -> Procedure[int]:
    """Return the position of a further encoder, in its own counts. Raises ProcedureError if the drive has none.

    number: subindex of 0x60E4, from 1.
    """
    position = yield from read_if_present(axis.node, Mux(objects.ADDITIONAL_POSITION + number - 1))
    if not isinstance(position, int):
        raise ProcedureError(f"{name_of(axis)} shows no further encoder: it has no 0x60E4:{number:02X}")
    return position
