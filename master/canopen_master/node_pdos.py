"""Exchanges the PDOs of a node whose file is known, as the device has set them up; see `Master.node`.

The exchange begins when the node is made, and again whenever the device boots, since a reset restores its settings. A device that
is silent, or Stopped, is asked when it is next heard. The PDOs are read again if we have set one up anew meanwhile: for who asks
how they differ, and for who waits until they are exchanged if one is not (`RemoteNode.unread_pdos`). TPDOs are read again, too,
once a heartbeat shows that it is Operational: somebody may have configured and started it, as the boot of a network does.
"""

from __future__ import annotations

import logging
from typing import Final

from canopen_master.participant.participant import Participant, ProcedureSlot
from canopen_master.participant.peer import Peer
from canopen_proto.dictionary import Direction
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.machine import Event
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.configure import PdoDifference, exchange_device_pdos, renew_tpdos
from canopen_proto.procedures.steps import Procedure, ProcedureError

log: Final = logging.getLogger("canopen_master")


class PdoDiffers(Event):
    """A device has a PDO set up otherwise than its file describes it. The device's own mapping is used. difference: which PDO,
    and what both say."""

    __match_args__ = ("node_id", "difference")

    def __init__(self, node_id: int, difference: PdoDifference) -> None:
        self.node_id = node_id
        self.difference = difference


class NodePdos:
    """See this module's text. differences: those known between the device and its file."""

    def __init__(self, participant: Participant, node: Peer) -> None:
        self.differences: tuple[PdoDifference, ...] = ()
        self._participant = participant
        self._node = node
        self._exchanging = ProcedureSlot(participant)
        self._error: ProcedureError | None = None
        self._writes = 0
        self._renewed = 0  # `pdo_writes` when TPDOs were read again
        self._watcher = node.watch((NodeBooted, HeartbeatReceived), self._on_heard)
        self._begin()

    def stop(self) -> None:
        """Stop renewing the exchange: something else, such as a chain, sees to this node's PDOs."""
        self._participant.unwatch(self._watcher)
        self._exchanging.take_back()

    async def compare(self) -> tuple[PdoDifference, ...]:
        """Wait until the PDOs are exchanged, and return `differences` as they are now. Raises as `wait`."""
        await self.wait()
        if self._writes != self._node.remote.pdo_writes:
            await self._once_more()
        return self.differences

    async def wait(self) -> None:
        """Wait until the PDOs are exchanged. Raises the reason if they cannot be: SdoTransferError, UnexpectedLengthError,
        InvalidPdoError.

        Raises BusError or MasterClosedError if that ended the exchange.
        """
        await self._exchanging.ended()
        if self._node.remote.unread_pdos:
            await self._once_more()
        self._check()

    async def _once_more(self) -> None:
        if not self._exchanging.is_running:  # who waits beside us may have begun it
            self._begin()
        await self._exchanging.ended()
        self._check()

    def _check(self) -> None:
        self._participant.check_open()
        if self._error is not None:
            raise self._error

    def _begin(self) -> None:
        self._error = None
        self._writes = self._node.remote.pdo_writes
        self._exchanging.begin(self._exchange())

    def _exchange(self) -> Procedure[None]:
        try:
            self.differences = yield from exchange_device_pdos(self._node.remote)
        except ProcedureError as error:
            self._error = error
        else:
            for each in self.differences:
                self._node.remote.out.events.append(PdoDiffers(self._node.node_id, each))
                log.warning("node %d on %s: %s", self._node.node_id, self._node.bus, each)

    def _renew(self) -> Procedure[None]:
        writes = self._node.remote.pdo_writes
        try:
            yield from renew_tpdos(self._node.remote)
        except ProcedureError as error:  # its next heartbeat makes it be asked again
            log.debug("node %d on %s: TPDOs that were set up anew are not known: %s", self._node.node_id, self._node.bus, error)
        else:
            self._renewed = writes

    def _has_unread_tpdos(self) -> bool:
        remote = self._node.remote
        return self._renewed != remote.pdo_writes and any(each[0] is Direction.TPDO for each in remote.unread_pdos)

    def _on_heard(self, report: NodeBooted | HeartbeatReceived) -> None:
        if isinstance(report, NodeBooted):
            self._exchanging.take_back()
            self._begin()
        elif self._error is not None and report.state is not NmtState.STOPPED:
            self._begin()
        elif report.state is NmtState.OPERATIONAL and self._has_unread_tpdos() and not self._exchanging.is_running:
            self._exchanging.begin(self._renew())
