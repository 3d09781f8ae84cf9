"""The last that a master does with a drive: it halts the drive, whatever the drive does, and sees that it stands."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import ensure_answers, stop
from canopen_master.node import Node
from canopen_master.watchdog import Watchdogs
from canopen_proto.drives.axis.halting import halt_first
from canopen_proto.drives.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_proto.drives.cia402.states import POWERED, Command, ControlBit, State, state_of
from canopen_proto.multiplexer import index_of
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import Procedure, SdoTransferError, all_of, download, upload


class Halt:
    """The halt of one drive. device: None if the node's dictionary describes no drive, though a drive was enabled there.

    where: the drive, for people. problem: why the drive is not known to stand; empty once it is, or if it could not move.
    is_confirmed: the drive was asked, and it stands.
    """

    def __init__(self, node: Node, device: Device | None) -> None:
        self.node = node
        self.device = device
        self.where = node.where if device is None else device.where
        self.is_confirmed = False
        may_move = device is None or device.may_move or device.state in POWERED
        self.problem = "" if not may_move else "its bus has failed" if node.bus_has_failed else "it has not answered yet"

    def run(self) -> Procedure[None]:
        """Halt the drive and wait until it stands. It never fails: no drive keeps another one from being halted."""
        try:
            yield from (self._by_number() if self.device is None else self._by_axis(self.device))
            self.is_confirmed = not self.problem
        except Exception as error:  # noqa: BLE001 - every failure is reported as this drive's
            self.problem = self.problem and (str(error) or repr(error))

    def _by_axis(self, device: Device) -> Procedure[None]:
        if device.node.nmt_state is not NmtState.STOPPED:  # where it takes no SDO
            with suppress(SdoTransferError):  # it is told again below
                yield from halt_first(device.axis)
        # The drive is asked again: a command that was cancelled half-way may have been executed since its last PDO.
        yield from ensure_answers(device.node, "0x6041")
        self.problem = "it still moves" if device.state in POWERED else ""
        yield from stop(device)
        self.problem = ""

    def _by_number(self) -> Procedure[None]:
        """Halt it by the object numbers of CiA 402, which it has if it is a drive."""
        client = self.node.remote.sdo
        try:
            state = state_of(int.from_bytes((yield from upload(client, index_of(STATUSWORD))), "little"))
        except SdoTransferError:  # only the answer may be lost
            state = State.OPERATION_ENABLED
        if state is State.OPERATION_ENABLED:
            word = Command.ENABLE_OPERATION | ControlBit.HALT
            self.problem = "its dictionary describes no drive: it was told to halt, and nothing shows whether it stands"
            yield from download(client, index_of(CONTROLWORD), 0, word.to_bytes(2, "little"))
        else:
            self.problem = ""


def halt_node(halts: Sequence[Halt], watchdogs: Watchdogs) -> Procedure[None]:
    """Halt the drives of one node, all axes at once; let them go (watchdog.py) if all are then known to stand."""
    yield from all_of(*(halt.run() for halt in halts))
    if all(halt.is_confirmed for halt in halts):
        yield from watchdogs.let_go(halts[0].node)
