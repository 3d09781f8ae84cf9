"""`WorldMember`: one place on a bus of a World, with one CAN controller: a device, a master, a host, a program's adapter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from typing import TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, Event, Time
from canopen_proto.network import Network

OnFrame: TypeAlias = Callable[[Frame, Time], object]
OnEvent: TypeAlias = Callable[[Event], object]


@dataclass(eq=False, repr=False)
class WorldMember:
    """See this module's text; made by `World.host` and the like.

    name: for people. network: what it runs, if it is one of ours. device: if it is one. events: what its network has
    reported, in order. on_event: called with each of them; may command machines. on_frame: called with each frame instead, if it
    has no network.
    """

    name: str
    _: KW_ONLY
    network: Network | None = None
    device: LocalNode | None = None
    events: list[Event] = field(default_factory=list, init=False)
    on_event: OnEvent = lambda event: None
    on_frame: OnFrame = lambda frame, now: None
    paused_until: Time = field(default=-NEVER, init=False)
    off_until: Time = field(default=-NEVER, init=False)
    _held: list[Frame] = field(default_factory=list, init=False)
    _is_off: bool = field(default=False, init=False)

    @property
    def node_id(self) -> int:
        """Of the device at present; 0 if it is none."""
        return 0 if self.device is None else self.device.node_id

    def hear(self, frame: Frame, now: Time) -> None:
        """Take a frame from the bus. It waits while the participant is paused, and is lost while its controller is off."""
        if now < self.off_until:
            return
        if now < self.paused_until:
            self._held.append(frame)
        elif self.network is None:
            self.on_frame(frame, now)
        else:
            self.network.receive(frame, now, now)

    def controller_is(self, off: bool, now: Time) -> None:
        """Take the state of its controller on a cable: a device is told when it goes bus-off, and when it is back."""
        if off is not self._is_off:
            self._is_off = off
            if self.device is not None:
                (self.device.bus_off if off else self.device.bus_recovered)(now)

    def next_deadline(self) -> Time:
        """Return when it wants to be woken; NEVER if nothing waits."""
        return NEVER if self.network is None else max(self.network.next_deadline(), self.paused_until)

    def wake(self, now: Time) -> None:
        """Let time pass: take what waited, then act on the deadline."""
        held, self._held = self._held, []
        for frame in held:
            self.hear(frame, now)
        if self.network is not None:
            self.network.handle_timeout(now)

    def drain(self, now: Time) -> list[Frame]:
        """Return what it has to send; tell its events."""
        if self.network is None or now < self.paused_until:
            return []
        frames, events = self.network.drain(now)
        self.events += events
        for event in events:
            self.on_event(event)
        return frames
