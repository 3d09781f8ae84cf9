"""`DriveView`: what a drive shows, and what it was commanded: the facts from which reasons.py finds why it does not move.

`view_of` makes one of what was heard. Commands of another master that are heard on the bus (controlword, mode of operation) are
part of it: see `ForeignCommand`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import describe_command, describe_status, mode_name
from canopen_proto.drives.cia402.states import COMMAND_BITS, ControlBit, State, enables_operation, state_of
from canopen_proto.emcy import EmcyReceived
from canopen_proto.foreign_writes import ForeignWrite
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, RoutingKey, routing_key
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.slots import described_pdos

RECENT: Final = 5 * SECOND
"""A command of another master that is older than this explains nothing."""
COMPARED: Final = COMMAND_BITS & ~ControlBit.FAULT_RESET | ControlBit.HALT
"""The bits in which two controlwords contradict each other; a drive may clear the others by itself."""


class ForeignCommand(NamedTuple):
    """A command of another master. words: such as "commanded 0x0006 (shutdown)". age: ns before the drive was last heard.
    source: "SDO", or "RPDO 0x203"."""

    words: str
    age: Time
    source: str

    def __str__(self) -> str:
        return f"another master {self.words} {self.age / MILLISECOND:.0f} ms ago by {self.source}"


@dataclass(frozen=True, slots=True)
class DriveView:
    """A drive as it is known, by the values of its objects of CiA 402. None: it lacks the object, or it was not heard.

    statusword: 0 if it was never heard, and `is_heard` is False. controlword, wanted_mode: 0x6040 and 0x6060 as the drive has
    them. commanded, selected_mode: as this master sent them last. rpdo: number of the live RPDO that carries the controlword.
    emcy: the last emergency. nmt_state: None: it was never heard. safe_torque_off, brake: the bit of the settings that shows
    that torque is off, or that the brake holds; None if it does not show it. is_homed: None if it does not matter. foreign: a
    command of another master that contradicts ours.
    """

    statusword: int = 0
    controlword: int | None = None
    mode: int | None = None
    wanted_mode: int | None = None
    supported_modes: int | None = None
    error_code: int | None = None
    position: int | None = None
    inputs: int | None = None
    nmt_state: NmtState | None = None
    commanded: int | None = None
    selected_mode: int | None = None
    rpdo: int | None = None
    emcy: EmcyReceived | None = None
    safe_torque_off: DriveBit | None = None
    brake: DriveBit | None = None
    is_homed: bool | None = None
    has_lost_reference: bool = False
    foreign: ForeignCommand | None = None
    is_heard: bool = True

    @property
    def state(self) -> State:
        """The state of the drive, by its statusword."""
        return state_of(self.statusword) if self.is_heard else State.UNKNOWN

    def describe(self) -> str:
        """Return one line for people: statusword by its bits, the command, the mode, error code and last emergency."""
        parts = ["its statusword was not heard yet"]
        if self.is_heard:
            parts = [f"statusword 0x{self.statusword:04X}: {', '.join(describe_status(self.statusword, self.mode))}"]
        if self.commanded is not None:
            parts.append(f"commanded {command_text(self.commanded, self.mode)}")
        parts.extend(self._modes())
        if self.error_code:
            parts.append(f"error code 0x{self.error_code:04X}")
        if self.emcy is not None and self.emcy.code:
            parts.append(f"last EMCY 0x{self.emcy.code:04X} {self.emcy.text}")
        return "; ".join(parts)

    def _modes(self) -> list[str]:
        wanted = self.wanted_mode if self.selected_mode is None else self.selected_mode
        if not wanted or wanted == self.mode:
            return [] if self.mode is None else [f"mode {mode_name(self.mode)}"]
        return [f"mode {mode_name(wanted)} wanted, {'none' if self.mode is None else mode_name(self.mode)} shown"]


def command_text(controlword: int, mode: int | None = None) -> str:
    """Return a controlword in words: "0x010F (enable operation, halt)". mode: of operation, which gives bits 4 to 6 their names;
    None: not known."""
    return f"0x{controlword:04X} ({', '.join(describe_command(controlword, mode))})"


def view_of(axis: Axis) -> DriveView:
    """Return what was heard from a drive, and what it was commanded; nothing is read."""
    producer = axis.node.rpdo_of(objects.CONTROLWORD)
    commanded = None if axis.commanded_at is None else axis.controlword
    if commanded is not None and axis.commanded in axis.node.may_hold(objects.CONTROLWORD):
        commanded = axis.commanded  # also one that the drive has not confirmed
    return DriveView(
        axis.statusword,
        mode=axis.mode,
        error_code=axis.error_code,
        position=axis.position_counts,
        inputs=axis.heard(objects.DIGITAL_INPUTS),
        supported_modes=axis.heard(objects.SUPPORTED_DRIVE_MODES),
        nmt_state=axis.node.nmt_state,
        controlword=commanded,
        commanded=commanded,
        selected_mode=axis.selected_mode,
        wanted_mode=axis.selected_mode,
        rpdo=None if producer is None else producer.number,
        emcy=axis.node.emcy.last,
        has_lost_reference=axis.has_lost_reference,
        safe_torque_off=_if_shown(axis, axis.settings.sto_input),
        brake=_if_shown(axis, axis.settings.brake_bit),
        foreign=_foreign_command(axis),
        is_heard=objects.STATUSWORD in axis.node.heard_at,
    )


def _if_shown(axis: Axis, bit: DriveBit | None) -> DriveBit | None:
    """Return the bit if the drive shows it, as last heard, else None."""
    value = None if bit is None else axis.heard(bit.mux)
    return bit if bit is not None and value is not None and bit.is_shown_by(value) else None


def _foreign_command(axis: Axis) -> ForeignCommand | None:
    """Return the last command of another master that came after ours, contradicts it, and is not older than RECENT; else None.

    A controlword that disables the drive contradicts the motion under way. Else nothing contradicts a command that we have not
    sent.
    """
    node = axis.node
    now = max(node.heard_at.values(), default=-NEVER)
    found: list[tuple[ForeignWrite, str]] = []
    word = last_foreign(axis, objects.CONTROLWORD)
    if word is not None and (_is_disabling(axis, word) or (axis.commanded_at is not None and word.time >= axis.commanded_at)):
        if not isinstance(word.value, int):
            found.append((word, "sent it a controlword"))
        elif _is_disabling(axis, word) or (word.value ^ axis.controlword) & COMPARED:
            found.append((word, f"commanded {command_text(word.value)}"))
    selected = last_foreign(axis, objects.MODES_OF_OPERATION)
    is_later = selected is not None and axis.selected_at is not None and selected.time >= axis.selected_at
    if selected is not None and is_later and selected.value != axis.selected_mode:
        name = mode_name(selected.value) if isinstance(selected.value, int) else "a mode"
        found.append((selected, f"selected {name}"))
    recent = [(heard, words) for heard, words in found if now - heard.time <= RECENT]
    if not recent:
        return None
    (time, key, _), words = max(recent, key=lambda each: each[0].time)
    source = "SDO" if key == SDO_CLIENT_TO_SERVER + node.node_id else f"RPDO 0x{key:03X}"
    return ForeignCommand(words, max(0, now - time), source)


def last_foreign(axis: Axis, mux: Mux) -> ForeignWrite | None:
    """Return the last write of an object by another master, as far as its frames are understood; None if there was none."""
    foreign = axis.remote.foreign_writes
    others = _described(axis.remote.dictionary, axis.remote.node_id) if foreign.unknown else {}
    return foreign.last(axis.node.on_device(mux), others)


def is_taken_down(axis: Axis) -> bool:
    """Return whether somebody else has disabled the drive since the motion under way began: it left Operation enabled, or another
    master was heard that commanded it to."""
    word = last_foreign(axis, objects.CONTROLWORD)
    return axis.was_taken_down or (word is not None and _is_disabling(axis, word))


def _is_disabling(axis: Axis, word: ForeignWrite) -> bool:
    """Return whether a controlword of another master disables the drive, and came since the motion under way began."""
    return word.time >= axis.motion_began and not enables_operation(word.value)


@lru_cache(maxsize=32)
def _described(dictionary: ObjectDictionary, node_id: int) -> dict[RoutingKey, Mapping]:
    """Return the RPDOs that a node's dictionary knows: those of its file, else those of PDOs.csv. Kept: each look asks."""
    found = {
        routing_key(each.can_id(node_id)): Mapping.from_description(each)
        for each in dictionary.pdos
        if each.direction is Direction.RPDO
    }
    for pdo in described_pdos(dictionary, node_id):
        if pdo.direction is Direction.RPDO:
            found[pdo.key] = Mapping.from_parameters(pdo.entries, dictionary)
    return found
