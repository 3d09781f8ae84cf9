"""`WorldLine`: the buses that a program opens by canopen_transports, as buses of a world."""

from __future__ import annotations

from canopen_proto.frame import Frame
from canopen_proto.machine import Time
from canopen_proto.testing import World, WorldMember
from canopen_transports.virtual import VirtualLine, VirtualTransport


class WorldLine(VirtualLine):
    """The line of one name. Each member is a participant of the world's bus of that name."""

    def __init__(self, world: World, name: str) -> None:
        super().__init__()
        self._world = world
        self._name = name
        self._participants: dict[VirtualTransport, WorldMember] = {}

    def join(self, member: VirtualTransport) -> None:
        super().join(member)
        others = sum(each.name.startswith("program") for each in self._world.bus(self._name).participants)
        name = f"program {others + 1}" if others else "program"
        self._participants[member] = self._world.listener(
            lambda frame, now: member.take(frame, now, True), name=name, bus=self._name
        )

    def leave(self, member: VirtualTransport) -> None:
        super().leave(member)
        self._world.leave(self._participants.pop(member))

    def carry(self, sender: VirtualTransport, frame: Frame, now: Time) -> None:
        self._world.send(self._participants[sender], frame)
