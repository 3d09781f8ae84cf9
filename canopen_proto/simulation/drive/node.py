"""`DriveNode`: a simulated drive on the bus, which is a `LocalNode` with a `Drive` as its application.

The node acts on the drive's events: a fault becomes an EMCY with its entry in 0x1001 and 0x1003, and a fault reset clears it. A
statusword or a shown mode that changes sends the event-driven TPDOs that carry it; so does entering Operational. The node tells
the drive of an overdue RPDO.

A node may have several drives (axes.py): those of `DriveSettings.further_axes`, or of all axes that its dictionary describes.
They share NMT state, heartbeat, SYNC and power. The EMCY of a fault has the number of the axis in byte 3; so has 0x1003.
"""

from __future__ import annotations

from dataclasses import replace

from canopen_proto.abort import AbortCode
from canopen_proto.compiling import mypyc_attr
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402.axes import axes_of, swapped
from canopen_proto.drives.cia402.objects import CONTROLWORD, MODES_OF_OPERATION_DISPLAY, STATUSWORD
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.pdo.consumer import PdoOverdue
from canopen_proto.sdo.server import PENDING, ObjectAccessPending, Pending
from canopen_proto.simulation.drive.answers import Answer, AnswerDue, DelayedAnswers
from canopen_proto.simulation.drive.axes import Axes, AxisValues
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.drive import Drive, LateDrive
from canopen_proto.simulation.drive.events import DriveFault, DriveFaultCleared, InputsChanged, ModeChanged, StatuswordChanged
from canopen_proto.simulation.drive.fallbacks import UNSET_BY_ZERO
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, DriveSettings, Shape


@mypyc_attr(allow_interpreted_subclasses=True)
class DriveNode(LocalNode):
    """A simulated CiA 402 drive, or several. drive: the part that moves, of the first axis; drives: of all axes; `boot` powers
    them on.
    """

    def __init__(self, out: Outbox, node_id: int, settings: DriveSettings, dictionary: ObjectDictionary | None = None) -> None:
        """Make the drive. settings: its shape and its mechanics. dictionary: by default that of its shape. An object of
        UNSET_BY_ZERO that is 0 in it, and would keep the drive from moving, counts as not set.
        """
        if dictionary is None:
            dictionary = drive_dictionary(settings.shape, 1 + len(settings.further_axes))
        super().__init__(out, node_id, dictionary)
        self.drive = self._drive(settings, self.values, 0)
        drives, further = [self.drive], []
        for axis in axes_of(dictionary)[1:]:
            if axis != len(drives):
                break  # an axis without those before it is none that we know
            values = AxisValues(self.values, axis)
            theirs = settings.further_axes[axis - 1] if axis <= len(settings.further_axes) else settings
            drives.append(self._drive(theirs, values.own, axis))
            further.append(values)
        self.drives = tuple(drives)
        self._axes = Axes(drives, further)
        self.pdos.sends_on_start = True  # a master that relies on event-driven TPDOs needs the values before the first change
        self.application = self._axes if further else self.drive
        for drive in drives:
            self.storage.excluded.add(swapped(CONTROLWORD, drive.axis) >> 8)  # a command, not a parameter
            self._members.attach(drive)
        self._answers = dict(settings.answers)
        self._delayed = DelayedAnswers(self.inner)
        self._members.attach(self._delayed)
        self._reactions.update(
            {
                DriveFault: self._on_fault,
                DriveFaultCleared: self._on_fault_cleared,
                StatuswordChanged: self._on_statusword,
                ModeChanged: self._on_mode,
                InputsChanged: self._on_inputs,
                PdoOverdue: self._on_rpdo_overdue,
                ObjectAccessPending: self._on_access,
                AnswerDue: self._on_answer_due,
            }
        )

    def _drive(self, settings: DriveSettings, values: Values, axis: int) -> Drive:
        zeros = frozenset(key for key in UNSET_BY_ZERO if values.store.get(key) == 0)
        kind = LateDrive if settings.reaction else Drive
        if not zeros <= settings.unset:
            settings = replace(settings, unset=settings.unset | zeros)
        return kind(self.inner, self.node_id, values, settings, axis)

    def _take_node_id(self, node_id: int) -> None:
        super()._take_node_id(node_id)
        for drive in self.drives:
            drive.set_node_id(node_id)

    def raise_fault(self, error_code: int, now: Time, *, lasting: bool = False, axis: int = 0) -> None:
        """Make a fault in a drive: it goes into Fault, and the node sends an EMCY. See Drive.raise_fault. error_code: 0x603F and
        EMCY then have it. lasting: until `end_fault` a fault reset does not clear it."""
        with self._settling(now):
            self.drives[axis].raise_fault(error_code, now, lasting=lasting)

    def block(self, blocked: bool, now: Time, *, axis: int = 0) -> None:
        """Block an axis mechanically, or free it: a blocked drive that is to move gets a following error. See Drive.block."""
        with self._settling(now):
            self.drives[axis].block(blocked, now)

    def set_safe_torque_off(self, is_active: bool, now: Time) -> None:
        """Switch the STO input of all axes. Active: no torque, and no command enables a drive. See Drive.set_safe_torque_off."""
        with self._settling(now):
            for drive in self.drives:
                drive.set_safe_torque_off(is_active, now)

    def answer(self, index: int, subindex: int, answer: Answer | None) -> None:
        """Answer each access to an object in this way from now on; None: as it should be."""
        if answer is None:
            self._answers.pop(mux(index, subindex), None)
        else:
            self._answers[mux(index, subindex)] = answer

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        answer = self._answers.get(mux(index, subindex))
        return PENDING if answer is not None and answer.delay else self._read_by(answer, index, subindex, now)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        answer = self._answers.get(mux(index, subindex))
        return PENDING if answer is not None and answer.delay else self._write_by(answer, index, subindex, data, now)

    def _read_by(self, answer: Answer | None, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        if answer is not None and answer.abort is not None:
            return answer.abort
        if answer is None or answer.value is None:
            return super().read(index, subindex, now)
        if isinstance(answer.value, bytes):
            return answer.value
        return self.dictionary.variable((index, subindex)).encode(answer.value)

    def _write_by(self, answer: Answer | None, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if answer is not None and answer.abort is not None:
            return answer.abort
        return super().write(index, subindex, data, now)

    def _on_access(self, access: ObjectAccessPending, now: Time) -> None:
        answer = self._answers.get(mux(access.index, access.subindex))
        if answer is not None and answer.delay:
            self._delayed.add(access, now + answer.delay)
        else:
            self._on_pending(access, now)

    def _on_answer_due(self, due: AnswerDue, now: Time) -> None:
        access = due.access
        index, subindex, data = access.index, access.subindex, access.data
        answer = self._answers.get(mux(index, subindex))
        result: bytes | AbortCode | Pending | None
        if data is None:
            result = self._read_by(answer, index, subindex, now)
        else:
            result = self._write_by(answer, index, subindex, data, now)
        self.channels.complete(access.access_id, AbortCode.LOCAL_CONTROL if isinstance(result, Pending) else result, now)

    def _on_fault(self, fault: DriveFault, now: Time) -> None:
        self.communication.emcy.raise_error(fault.error_code, fault.error_register, bytes((fault.axis,)), now, fault.axis)

    def _on_fault_cleared(self, cleared: DriveFaultCleared, now: Time) -> None:
        self.communication.emcy.clear(cleared.error_code, now, cleared.axis)

    def _on_statusword(self, change: StatuswordChanged, now: Time) -> None:
        self._trigger(STATUSWORD, change.axis, now)

    def _on_mode(self, change: ModeChanged, now: Time) -> None:
        self._trigger(MODES_OF_OPERATION_DISPLAY, change.axis, now)

    def _on_inputs(self, change: InputsChanged, now: Time) -> None:
        self._trigger(change.mux, change.axis, now)

    def _trigger(self, key: Mux, axis: int, now: Time) -> None:
        self._axes.show(axis)
        self.pdos.trigger(swapped(key, axis), now)

    def _on_rpdo_overdue(self, overdue: PdoOverdue, now: Time) -> None:
        self._on_pdo_error(overdue, now)
        for drive in self.drives:
            drive.rpdo_overdue(now)


def powerball(out: Outbox, node_id: int, sync_tolerance: Time = SYNC_TOLERANCE, waits_for_sync: bool = False) -> DriveNode:
    """Return a joint of the Schunk Powerball arm, as the manual's library knows it. sync_tolerance, waits_for_sync: see
    DriveSettings."""
    settings = DriveSettings(shape=Shape.SCHUNK_POWERBALL, sync_tolerance=sync_tolerance, waits_for_sync=waits_for_sync)
    return DriveNode(out, node_id, settings)
