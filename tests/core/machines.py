"""Small machines for tests of what holds machines: an alarm clock, a clerk that takes requests, a group that can be filled."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from canopen_proto.frame import Frame
from canopen_proto.group import Group
from canopen_proto.machine import NEVER, Event, Machine, Outbox, Outcome, RequestId, Time


class Rang(Event):
    """An Alarm was woken, at its time or later. timestamp: that of the outbox, of the frame if it was one."""

    __slots__ = ("at", "name")
    __match_args__ = ("node_id", "name", "at")

    def __init__(self, node_id: int, name: str, at: Time) -> None:
        self.node_id = node_id
        self.name = name
        self.at = at


class Heard(Event):
    """An Alarm received a frame."""

    __slots__ = ("frame", "name", "timestamp")
    __match_args__ = ("node_id", "name", "frame", "timestamp")

    def __init__(self, node_id: int, name: str, frame: Frame, timestamp: int | None) -> None:
        self.node_id = node_id
        self.name = name
        self.frame = frame
        self.timestamp = timestamp


class Answered(Outcome):
    """A Clerk's request was granted."""

    __slots__ = ("name",)
    __match_args__ = ("node_id", "request_id", "name")

    def __init__(self, node_id: int, request_id: RequestId, name: str) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.name = name


class Withdrawn(Outcome):
    """A Clerk's request was taken back."""

    __slots__ = ("name",)
    __match_args__ = ("node_id", "request_id", "name")

    def __init__(self, node_id: int, request_id: RequestId, name: str) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.name = name


class Alarm(Machine):
    """Listens to what it is told, rings at its deadline. then: the deadlines that it sets when it rings, the next one last."""

    def __init__(self, out: Outbox, name: str = "", keys: Iterable[int] = (), deadline: Time = NEVER) -> None:
        super().__init__(out)
        self.name = name
        self.keys = tuple(keys)
        self.then: list[Time] = []
        self.on_frame: Callable[[Frame], object] | None = None
        self.rang_at: list[Time] = []
        self._arm(deadline)

    def set(self, deadline: Time) -> None:
        self._arm(deadline)

    def listen(self, *keys: int) -> None:
        self.keys = keys
        self._reroute()

    def can_ids(self) -> Iterable[int]:
        return self.keys

    def receive(self, frame: Frame, now: Time) -> None:
        self.out.events.append(Heard(0, self.name, frame, self.out.timestamp))
        if self.on_frame is not None:
            self.on_frame(frame)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self.rang_at.append(now)
        self.out.events.append(Rang(0, self.name, now))
        self._arm(self.then.pop() if self.then else NEVER)


class Clerk(Machine):
    """Takes requests by name, and answers when the test says so. log: what it was told, urgent requests with "!"."""

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.open: dict[RequestId, str] = {}
        self.log: list[str] = []

    def ask(self, name: str, urgent: bool) -> RequestId:
        request_id = self.out.next_request_id()
        self.open[request_id] = name
        self.log.append(f"{name}{'!' if urgent else ''}")
        return request_id

    def answer(self, name: str) -> None:
        request_id = next(number for number, asked in self.open.items() if asked == name)
        self.out.events.append(Answered(1, request_id, self.open.pop(request_id)))

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        name = self.open.pop(request_id, None)
        if name is None:
            return False
        self.log.append(f"cancel {name}")
        self.out.events.append(Withdrawn(1, request_id, name))
        return True


class Box(Group):
    """A group that the test fills."""

    def put(self, *machines: Machine) -> None:
        for machine in machines:
            self._members.attach(machine)

    def take(self, machine: Machine) -> None:
        self._members.detach(machine)

    def react(self, kind: type[Event], reaction: Callable[..., None]) -> None:
        self._reactions[kind] = reaction

    @property
    def wakes_held(self) -> int:
        return len(self._members.heap)


def held_data(transfer: object) -> int:
    """Return how many bytes of data an SDO transfer, or None, holds of those that it received."""
    frames = sum(len(getattr(transfer, name, b"")) for name in ("_frames", "_sub_block"))
    return len(getattr(transfer, "_buffer", b"")) + frames // 8 * 7
