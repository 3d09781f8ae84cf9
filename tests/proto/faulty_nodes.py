"""Devices that are wrong in one way, for the conformance cases."""

from __future__ import annotations

from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Time
from canopen_proto.nmt import NmtCommand, NmtResetRequested, NmtState
from canopen_proto.sdo.abort import AbortCode
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

    def handle_timeout(self, now: Time) -> None:
        super().handle_timeout(now)
        self.sdo.enable()
