"""Devices that are wrong in one way, for the conformance cases."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand, NmtResetRequested, NmtState, NmtStateChanged
from canopen_proto.sdo.events import ObjectWritten
from canopen_proto.sdo.server import Pending


class KeepsCommunication(LocalNode):
    """A communication reset restarts it, and puts nothing back."""

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        if request.command is NmtCommand.RESET_COMMUNICATION:
            self._start(now)
        else:
            super()._on_reset(request, now)


class KeepsAll(LocalNode):
    """A reset restarts it, and puts nothing back."""

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        self._start(now)


class KeepsChannels(LocalNode):
    """A reset puts the records of its SDO channels back, but not the channels."""

    def _start(self, now: Time) -> None:
        self.nmt.boot(now)
        self.pdos.reload(now)
        self.communication.reload(now)


class CountsStarts(LocalNode):
    """Counts its starts in 0x2003, which a reset does not put back."""

    starts = 0

    def _start(self, now: Time) -> None:
        super()._start(now)
        self.starts += 1
        self.values.store[mux(0x2003)] = self.starts


class BusyWhenOperational(LocalNode):
    """Takes no settings in Operational."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return AbortCode.DEVICE_STATE if self.state is NmtState.OPERATIONAL else super().write(index, subindex, data, now)


class Inverting(LocalNode):
    """Stores what is written to 0x2000 wrongly."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return super().write(index, subindex, bytes(byte ^ 0xFF for byte in data) if index == 0x2000 else data, now)


class Talkative(LocalNode):
    """Its SDO server answers in every NMT state."""

    def _on_state(self, change: NmtStateChanged, now: Time) -> None:
        super()._on_state(change, now)
        self.sdo.enable()


class SelfStarting(LocalNode):
    """Does not wait for anybody to start it."""

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        super()._on_reset(request, now)
        self.nmt.execute(NmtCommand.START, now)


class EagerPdos(LocalNode):
    """Its PDOs live in every NMT state."""

    def _on_state(self, change: NmtStateChanged, now: Time) -> None:
        super()._on_state(change, now)
        self.pdos.set_enabled(True, now)


class AlwaysGuarded(LocalNode):
    """Answers guarding requests beside its heartbeat."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        result = super().write(index, subindex, data, now)
        self.communication.guarding.set_enabled(True)
        return result


class RatherGuarded(LocalNode):
    """Stops its heartbeat when a life time factor is set."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        result = super().write(index, subindex, data, now)
        if self.values.store[0x100D00]:
            self.communication.heartbeat.set_period(0, now)
        return result


class KeepsNothing(LocalNode):
    """Confirms that its parameters are stored, and they are not."""

    def _on_written(self, report: ObjectWritten, now: Time) -> None:
        self.storage.forget(report.index, report.subindex)
        super()._on_written(report, now)


class RestoresNothing(LocalNode):
    """Confirms that its defaults are restored, and they are not."""

    def _on_written(self, report: ObjectWritten, now: Time) -> None:
        if report.index != 0x1011:
            super()._on_written(report, now)


class Endless(LocalNode):
    """Its name is longer than any name."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        return bytes(40_000) if index == 0x1008 else super().read(index, subindex, now)


def without_crc(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
    """Its SDO server knows no CRC."""
    node = LocalNode(out, node_id, dictionary)
    node.sdo.crc = False
    return node
