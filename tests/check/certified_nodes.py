"""Devices that are right in another way than ours: what certified stacks do, and a conformance test has to accept."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import COB_ID_INVALID, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox, Time
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.pdo.settings import COB_ID, INHIBIT_TIME, SYNC_START, communication_index, place_of
from canopen_proto.sdo.codec import ABORT, INITIATE_UPLOAD, SPECIFIER
from canopen_proto.sdo.server import Pending
from tests.check.faulty_nodes import SelfStarting
from tests.core.full_device import full_device

SYNC_PERIOD_US = 100_000
PRODUCES_SYNC = full_device(standard_object(0x1005, 0x4000_0080), standard_object(0x1006, SYNC_PERIOD_US))
"""A device that sends SYNC by default."""
_OVERFLOW = Variable(0x1019, 0, "synchronous counter overflow value", DataType.UNSIGNED8, default=0, high_limit=240)
EXPECTS_SYNC = full_device(standard_object(0x1006, 10_000), Object.of(_OVERFLOW.name, [_OVERFLOW]))
"""A SYNC consumer that knows the period. 0x1019 may change only while that is 0 (CiA 301 v4.2.0, 7.5.2.22)."""


class StateFirst(LocalNode):
    """It looks at 0x1006 first, and then whether the value of 0x1019 is a valid one."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index == 0x1019 and self.values.store[0x1006_00]:
            return AbortCode.DEVICE_STATE
        return super().write(index, subindex, data, now)


class FirmSettings(LocalNode):
    """While a PDO is valid, its mapping and its times refuse every value, their own too."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        place = place_of(index)
        if place is not None:
            cob_id = self.values.store.get(communication_index(place.direction, place.number) << 8 | COB_ID)
            if isinstance(cob_id, int) and not cob_id & COB_ID_INVALID:
                if place.is_mapping:
                    return AbortCode.UNSUPPORTED_ACCESS
                if subindex in (INHIBIT_TIME, SYNC_START):
                    return AbortCode.INVALID_VALUE
        return super().write(index, subindex, data, now)


class LenientMapping(LocalNode):
    """The entry of an enabled mapping takes its own value, which changes nothing."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        place = place_of(index)
        is_own = int.from_bytes(data, "little") == self.values.store.get(index << 8 | subindex)
        if place is not None and place.is_mapping and subindex and is_own:
            return None
        return super().write(index, subindex, data, now)


class OneAtATime(LocalNode):
    """Aborts a transfer in whose middle another one is begun."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == SDO_CLIENT_TO_SERVER + self.node_id and frame.data[0] & SPECIFIER == INITIATE_UPLOAD and self.sdo.busy:
            abort = bytes((ABORT,)) + frame.data[1:4] + AbortCode.INVALID_COMMAND.to_bytes(4, "little")
            super().receive(Frame(frame.can_id, abort), now)  # it lets go of the transfer
            self.out.frames.append(Frame(SDO_SERVER_TO_CLIENT + self.node_id, abort))
        else:
            super().receive(frame, now)


class FromTheMiddle(PdoProducer):
    """Goes first after half of its SYNCs, and then with each n-th."""

    __slots__ = ()

    def _restart(self, now: Time) -> None:
        super()._restart(now)
        self._syncs = max(self.transmission_type - 1 - self.transmission_type // 2, 0)


class AfterTheStart(PdoProducer):
    """The SYNC with the start value is the first of n."""

    __slots__ = ()

    def on_sync(self, counter: int | None, now: Time) -> None:
        is_start = self._awaits_start and counter == self.sync_start and self.transmission_type > 1
        if is_start:
            self._awaits_start = False
            self._syncs = 1
        else:
            super().on_sync(counter, now)


def counting(kind: type[PdoProducer], node: LocalNode) -> LocalNode:
    """The node with TPDOs of that kind."""
    for producer in node.pdos.producers.values():
        producer.__class__ = kind
        producer._restart(0)
    return node


def from_the_middle(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
    return counting(FromTheMiddle, LocalNode(out, node_id, dictionary))


def after_the_start(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
    return counting(AfterTheStart, LocalNode(out, node_id, dictionary))


class Restless(LocalNode):
    """An object that can be written counts by itself."""

    reads = 0

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        if index != 0x2000:
            return super().read(index, subindex, now)
        self.reads += 1
        return self.reads.to_bytes(4, "little")


class Certified(SelfStarting, FirmSettings, OneAtATime):
    """All of it together."""


def certified(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
    return counting(FromTheMiddle, Certified(out, node_id, dictionary))
