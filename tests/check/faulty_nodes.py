"""Devices that are wrong in one way, for the conformance cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.guarding import TOGGLE
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import COMPILED, Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand, NmtResetRequested, NmtState, NmtStateChanged
from canopen_proto.pdo.consumer import PdoConsumer
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.sdo.events import ObjectWritten
from canopen_proto.sdo.server import Pending
from tests.builds import replaces_what_is_compiled


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


class AnyLength(LocalNode):
    """Takes any number of bytes for its own objects, and fills them up or cuts them."""

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        return None if index >= 0x2000 else super().check_write(index, subindex, size)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        variable = self.dictionary.get(index, subindex)
        if index >= 0x2000 and variable is not None and variable.size is not None and variable.access.writable:
            data = data[: variable.size].ljust(variable.size, b"\x00")
        return super().write(index, subindex, data, now)


class Bottomless(LocalNode):
    """The subindex behind the last one of 0x1018 can be read."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        return bytes(4) if (index, subindex) == (0x1018, 5) else super().read(index, subindex, now)


class OldestFirst(LocalNode):
    """Its error history begins with the oldest error."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        history = self.communication.emcy.history
        if index == 0x1003 and 0 < subindex <= len(history):
            return history[-subindex].to_bytes(4, "little")
        return super().read(index, subindex, now)


class KeepsErrors(LocalNode):
    """No reset clears its error register."""

    register = 0

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        self.register |= self.communication.emcy.error_register
        return bytes((self.register,)) if index == 0x1001 else super().read(index, subindex, now)


class KeepsToggle(LocalNode):
    """Its first guarding answer after a reset of the communication has the toggle bit."""

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        super()._on_reset(request, now)
        if request.command is NmtCommand.RESET_COMMUNICATION:
            self.communication.guarding._toggle = TOGGLE


class GuardedAtOnce(LocalNode):
    """Its life guarding begins with its life time, without a request."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        result = super().write(index, subindex, data, now)
        guarding = self.communication.guarding
        if index in (0x100C, 0x100D) and guarding.life_time:
            guarding._begun = True
            guarding.set_life_time(guarding.life_time, now)
        return result


class StoresUnsigned(LocalNode):
    """Refuses a wrong signature, and stores all the same."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        result = super().write(index, subindex, data, now)
        if index == 0x1010 and isinstance(result, AbortCode):
            self.storage.begin(index, subindex)
            self.storage.commit(index, subindex)
        return result


class LoadsAtOnce(LocalNode):
    """Has its defaults as soon as "load" is confirmed."""

    def _on_written(self, report: ObjectWritten, now: Time) -> None:
        super()._on_written(report, now)
        if report.index == 0x1011:
            self.values.reset()


class HearsInStopped(LocalNode):
    """Its RPDOs live in Stopped."""

    def _on_state(self, change: NmtStateChanged, now: Time) -> None:
        super()._on_state(change, now)
        for consumer in self.pdos.consumers.values():
            consumer.set_enabled(change.state in (NmtState.OPERATIONAL, NmtState.STOPPED), now)


class TakesShort(PdoConsumer):
    """Reports that an RPDO is too short, and processes it."""

    __slots__ = ()

    def receive(self, frame: Frame, now: Time) -> None:
        super().receive(frame, now)
        if self.key is not None and len(frame.data) < self.mapping.byte_length:
            self.mapping.unpack_into(self.store, frame.data.ljust(self.mapping.byte_length, b"\x55"))


class TakesAtOnce(PdoConsumer):
    """Processes a synchronous RPDO before the SYNC."""

    __slots__ = ()

    def receive(self, frame: Frame, now: Time) -> None:
        super().receive(frame, now)
        self.on_sync(None, now)


class NeverTakes(PdoConsumer):
    """Never processes a synchronous RPDO."""

    __slots__ = ()

    def on_sync(self, counter: int | None, now: Time) -> None:
        self._held = None


class HearsInvalid(PdoConsumer):
    """Does not look at bit 31 of the COB-ID."""

    __slots__ = ()

    def configure(self, key: RoutingKey | None, *settings: Any, **more: Any) -> None:
        super().configure(self.key if key is None else key, *settings, **more)


class SendsInvalid(PdoProducer):
    """Does not look at bit 31 of the COB-ID."""

    __slots__ = ()

    def configure(self, key: RoutingKey | None, *settings: Any, **more: Any) -> None:
        super().configure(self.key if key is None else key, *settings, **more)


def with_pdos(kind: type[PdoConsumer] | type[PdoProducer]) -> Callable[[Outbox, int, ObjectDictionary], LocalNode]:
    """A node with RPDOs or TPDOs of that kind."""

    def make(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
        if COMPILED:
            pytest.skip(replaces_what_is_compiled.kwargs["reason"])
        node = LocalNode(out, node_id, dictionary)
        for pdo in (*node.pdos.consumers.values(), *node.pdos.producers.values()):
            if isinstance(pdo, kind.__mro__[1]):
                pdo.__class__ = kind
        return node

    return make


def without_crc(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
    """Its SDO server knows no CRC."""
    node = LocalNode(out, node_id, dictionary)
    node.sdo.crc = False
    return node
