"""A master and one simulated drive on a bus in virtual time, and a way to run procedures there."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, SCHUNK_POWERBALL, Axis, AxisSettings
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Outbox, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_proto.sync import SyncConsumer, SyncProducer
from tests.core.bus import Bus, Ended, result_of

T = TypeVar("T")

CYCLE = 10 * MILLISECOND

MILLIDEGREES = AxisSettings(counts_per_unit=MILLIDEGREES_PER_RADIAN)
"""What the simulated drives count, and radians outside."""
SETTINGS = {Shape.STANDARD: replace(MILLIDEGREES, homing_method=35), Shape.SCHUNK_POWERBALL: SCHUNK_POWERBALL}
STREAMED = {Shape.STANDARD: ((4,), (3,)), Shape.SCHUNK_POWERBALL: ((1,), (1,))}
"""Shape -> RPDOs, TPDOs of its defaults that carry the set-point and the statusword by SYNC."""


class Rig:
    """One drive as node 5, powered on and Operational; an axis over it; PDOs exchanged as the drive has them by default.

    axis: the drive is that of a further axis of the node; without PDOs.
    """

    def __init__(
        self,
        shape: Shape,
        *,
        pdos: bool = True,
        drive: DriveSettings | None = None,
        dictionary: ObjectDictionary | None = None,
        axis: int = 0,
    ) -> None:
        self.bus = Bus(delay=(100 * MICROSECOND, 100 * MICROSECOND))
        self.device = self.bus.attach(Network())
        settings = drive or DriveSettings(shape=shape)
        if axis:
            settings = replace(settings, further_axes=(settings,) * axis)
        self.node = DriveNode(self.device.out, 5, settings, dictionary)
        self.device.attach(self.node)
        self.drive = self.node.drives[axis]
        self.master = self.bus.attach(Network())
        self.remote = RemoteNode(self.master.out, 5, self.node.dictionary)
        self.nmt, self.sync = NmtMaster(self.master.out), SyncProducer(self.master.out)
        for machine in (self.remote, self.nmt, self.sync, SyncConsumer(self.master.out)):  # as `Participant` has them
            self.master.attach(machine)
        self.axis = Axis(self.remote, SETTINGS[shape], axis)
        self.node.boot(self.bus.now)
        self.bus.run(MILLISECOND)
        self.nmt.start(0, self.bus.now)
        self.bus.run(MILLISECOND)
        if pdos and not axis:
            rpdos, tpdos = STREAMED[shape]
            for number in rpdos:
                self.run(use_device_pdo(self.remote, Direction.RPDO, number))
            for number in tpdos:
                self.run(use_device_pdo(self.remote, Direction.TPDO, number))

    def ignore_halts(self) -> None:
        """From now on the drive ignores bit 8 of its controlword, which comes by SDO or at the beginning of an RPDO."""
        deliver = self.bus._deliver

        def deliver_without(receiver: Outbox, frame: Frame) -> None:
            at = 5 if frame.data[:4] == b"\x2b\x40\x60\x00" else 1
            if at == 5 or frame.can_id in (0x205, 0x505):
                data = bytearray(frame.data)
                data[at] &= ~1
                frame = Frame(frame.can_id, bytes(data))
            deliver(receiver, frame)

        self.bus._deliver = deliver_without  # type: ignore[method-assign]

    def start_sync(self) -> None:
        self.sync.start(CYCLE, self.bus.now)

    def outcome(self, request_id: RequestId, limit: Time = 120 * SECOND) -> Ended:
        """Run the bus until a procedure has ended."""
        return self.bus.outcome(request_id, limit)

    def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure to its end: its result, or what it raised."""
        return result_of(self.outcome(self.master.run(procedure, self.bus.now)))  # type: ignore[no-any-return]
