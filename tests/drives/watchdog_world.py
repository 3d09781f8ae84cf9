"""A simulated drive, and a master that holds it and can be killed, in virtual time."""

from __future__ import annotations

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Hold, Watchdog, take_hold
from canopen_proto.drives.cia402 import objects
from canopen_proto.heartbeat import OwnHeartbeat
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_proto.testing import World

NODE = 5
FRAME = 100 * MICROSECOND
SETTINGS = DriveSettings(position=0, lag=0, track=Track(negative_limit=-1e9, positive_limit=1e9))


class HeldDrive(World):
    """A simulated drive, and a master with its own heartbeat, which can be killed: it sends nothing from then on."""

    def __init__(self, dictionary: ObjectDictionary | None = None, kind: type[DriveNode] = DriveNode) -> None:
        super().__init__(transmission=(FRAME, FRAME))
        self.node = self.device(lambda out: kind(out, NODE, SETTINGS, dictionary or drive_dictionary()))
        self.holder = self.master()
        self.remote = self.holder.node(NODE)
        self.heartbeat = OwnHeartbeat(self.holder.runs.out, DEFAULT_WATCHDOG.node_id)
        self.holder.runs.attach(self.heartbeat)
        self.hold = Hold(self.remote)
        self.store = self.node.values.store

    def take_hold(self, watchdog: Watchdog = DEFAULT_WATCHDOG) -> str:
        self.heartbeat.start(watchdog.period, self.now)
        self.holder.run(take_hold(self.hold, watchdog))
        self.advance(self.heartbeat.deadline - self.now)
        return self.hold.gap

    def put(self, key: int, value: int) -> None:
        """As if a client had written it."""
        self.node.set_value(key >> 8, key & 0xFF, value, self.now)
        self.node.drive.written(key >> 8, key & 0xFF, self.now)

    def move(self, mode: int) -> None:
        """Set it in motion by pp or pv, at 20000 units/s."""
        for key, value in ((objects.PROFILE_VELOCITY, 20_000), (objects.MAX_PROFILE_VELOCITY, 20_000), (0x6083_00, 100_000)):
            if key in self.store:
                self.store[key] = value
        self.put(objects.MODES_OF_OPERATION, mode)
        for word in (0x06, 0x07, 0x0F):
            self.put(objects.CONTROLWORD, word)
        if mode == 1:
            self.put(objects.TARGET_POSITION, 2_000_000)
            self.put(objects.CONTROLWORD, 0x1F)
        else:
            self.put(objects.TARGET_VELOCITY, 20_000)
        self.advance(2 * SECOND)
        assert self.speed() == 20_000

    def speed(self) -> int:
        self.node.drive.refresh(self.now)
        found = self.store[objects.VELOCITY_DEMAND_VALUE]
        assert isinstance(found, int)
        return abs(found)

    def kill_master(self) -> None:
        self.heartbeat.stop(self.now)
        if self.remote.guarding.guard_time:
            self.remote.stop_guarding()

    def time_to_stand(self, limit: Time) -> Time:
        """ns until it stands; `limit` if it does not."""
        began = self.now
        while self.speed() and self.now < began + limit:
            self.advance(5 * MILLISECOND)
        return self.now - began


def without(*indices: int, more: tuple[int, ...] = ()) -> ObjectDictionary:
    kept = [each for index, each in drive_dictionary().objects.items() if index not in indices]
    return ObjectDictionary([*kept, *(standard_object(index) for index in more)])
