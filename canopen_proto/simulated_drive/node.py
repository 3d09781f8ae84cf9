"""`DriveNode`: a simulated drive on the bus, which is a `LocalNode` with a `Drive` as its application.

The node acts on the drive's events: a fault becomes an EMCY with its entry in 0x1001 and 0x1003, and a fault reset clears it. A
statusword or a shown mode that changes sends the event-driven TPDOs that carry it; so does entering Operational. The node tells
the drive of an overdue RPDO.
"""

from __future__ import annotations

from dataclasses import replace

from canopen_proto.abort import AbortCode
from canopen_proto.cia402.objects import CONTROLWORD, MODES_OF_OPERATION_DISPLAY, STATUSWORD
from canopen_proto.compiling import mypyc_attr
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.consumer import PdoOverdue
from canopen_proto.sdo.server import PENDING, ObjectAccessPending, Pending
from canopen_proto.simulated_drive.answers import Answer, AnswerDue, DelayedAnswers
from canopen_proto.simulated_drive.dictionary import drive_dictionary
from canopen_proto.simulated_drive.drive import Drive
from canopen_proto.simulated_drive.events import DriveFault, DriveFaultCleared, InputsChanged, ModeChanged, StatuswordChanged
from canopen_proto.simulated_drive.fallbacks import UNSET_BY_ZERO
from canopen_proto.simulated_drive.late_drive import LateDrive
from canopen_proto.simulated_drive.settings import DriveSettings, Shape


@mypyc_attr(allow_interpreted_subclasses=True)
class DriveNode(LocalNode):
    """A simulated CiA 402 drive. drive: the part that moves; `boot` powers it on."""

    __slots__ = ("_answers", "_delayed", "drive")

    def __init__(self, out: Outbox, node_id: int, settings: DriveSettings, dictionary: ObjectDictionary | None = None) -> None:
        """Make the drive. settings: its shape and its mechanics. dictionary: by default that of its shape. An object of
        UNSET_BY_ZERO that is 0 in it, and would keep the drive from moving, counts as not set.
        """
        super().__init__(out, node_id, drive_dictionary(settings.shape) if dictionary is None else dictionary)
        zeros = frozenset(key for key in UNSET_BY_ZERO if self.values.store.get(key) == 0)
        kind = LateDrive if settings.reaction else Drive
        self.drive: Drive = kind(self.inner, node_id, self.values, replace(settings, unset=settings.unset | zeros))
        self.pdos.sends_on_start = True  # a master that relies on event-driven TPDOs needs the values before the first change
        self.application = self.drive
        self.storage.excluded.add(CONTROLWORD >> 8)  # a command, not a parameter
        self._members.attach(self.drive)
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

    def boot(self, now: Time) -> None:
        if self.state is NmtState.INITIALISING:  # else boot does nothing, and the drive stays as it is
            self.drive.reset(now)
        super().boot(now)

    def raise_fault(self, error_code: int, now: Time, *, lasting: bool = False) -> None:
        """Make a fault in the drive: it goes into Fault, and the node sends an EMCY. See Drive.raise_fault."""
        with self._settling(now):
            self.drive.raise_fault(error_code, now, lasting=lasting)

    def block(self, blocked: bool, now: Time) -> None:
        """Block the axis mechanically, or free it: a blocked drive that is to move gets a following error. See Drive.block."""
        with self._settling(now):
            self.drive.block(blocked, now)

    def set_safe_torque_off(self, is_active: bool, now: Time) -> None:
        """Switch the STO input. Active: no torque, and no command enables the drive. See Drive.set_safe_torque_off."""
        with self._settling(now):
            self.drive.set_safe_torque_off(is_active, now)

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
        self.communication.emcy.raise_error(fault.error_code, fault.error_register, b"", now)

    def _on_fault_cleared(self, cleared: DriveFaultCleared, now: Time) -> None:
        self.communication.emcy.clear(cleared.error_code, now)

    def _on_statusword(self, change: StatuswordChanged, now: Time) -> None:
        self.pdos.trigger(STATUSWORD, now)

    def _on_mode(self, change: ModeChanged, now: Time) -> None:
        self.pdos.trigger(MODES_OF_OPERATION_DISPLAY, now)

    def _on_inputs(self, change: InputsChanged, now: Time) -> None:
        self.pdos.trigger(change.mux, now)

    def _on_rpdo_overdue(self, overdue: PdoOverdue, now: Time) -> None:
        self._on_pdo_error(overdue, now)
        self.drive.rpdo_overdue(now)


def powerball(out: Outbox, node_id: int) -> DriveNode:
    """Return a joint of the Schunk Powerball arm, as the manual's library met it."""
    return DriveNode(out, node_id, DriveSettings(shape=Shape.SCHUNK_POWERBALL))
