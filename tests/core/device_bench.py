"""A device on the bench: frames in as candump text, frames out as candump text, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Event, Outbox, Time
from canopen_proto.network import Network
from tests.core.devices import io_device

E = TypeVar("E", bound=Event)


class Bench:
    """A Network in virtual time. events: those that nobody has looked at yet."""

    def __init__(self, now: Time) -> None:
        self.now = now
        self.events: list[Event] = []
        self.network = Network()

    def take(self) -> list[str]:
        """What it sent since the last time."""
        frames, events = self.network.drain(self.now)
        self.events += events
        return [str(frame) for frame in frames]

    def tell(self, *frames: str) -> list[str]:
        """Hand it frames; what it sends for them."""
        for frame in frames:
            self.network.receive(Frame.parse(frame), self.now)
        return self.take()


class DeviceBench(Bench):
    """One LocalNode of node-ID 5 in a Network of its own, booted unless told otherwise."""

    def __init__(
        self,
        dictionary: ObjectDictionary | None = None,
        *,
        boot: bool = True,
        make: Callable[[Outbox, int, ObjectDictionary], LocalNode] = LocalNode,
    ) -> None:
        super().__init__(0)
        self.node = make(self.network.out, 5, io_device() if dictionary is None else dictionary)
        self.network.attach(self.node)
        if boot:
            self.node.boot(self.now)
            self.take()
            self.events.clear()

    def wait(self, milliseconds: float) -> list[str]:
        """Let time pass; what it sends, each with the millisecond at which it was sent: "20 705#7F"."""
        end = self.now + int(milliseconds * MILLISECOND)
        sent: list[str] = []
        while (deadline := self.network.next_deadline()) <= end:
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            sent += [f"{self.now / MILLISECOND:g} {frame}" for frame in self.take()]
        self.now = end
        return sent

    def write(self, index: int, subindex: int, value: int, size: int) -> int | None:
        """An expedited download: None, or the abort code. Frames besides the answer stay in `others`."""
        command = 0x23 | 4 - size << 2
        data = value.to_bytes(size, "little", signed=value < 0).ljust(4, b"\x00")
        sent = self.tell(f"605#{command:02X}{_multiplexer(index, subindex)}{data.hex()}")
        (answer,) = [frame for frame in sent if frame.startswith("585#")]
        self.others = [frame for frame in sent if not frame.startswith("585#")]
        if answer[4:6] == "80":
            return int.from_bytes(bytes.fromhex(answer[12:]), "little")
        assert answer == f"585#60{_multiplexer(index, subindex)}00000000"
        return None

    def read(self, index: int, subindex: int = 0) -> bytes | int:
        """An upload of up to 4 bytes: these, or the abort code."""
        (answer,) = self.tell(f"605#40{_multiplexer(index, subindex)}00000000")
        data = bytes.fromhex(answer[4:])
        if data[0] == 0x80:
            return int.from_bytes(data[4:], "little")
        assert data[0] & 0xF3 == 0x43, answer
        return data[4 : 8 - (data[0] >> 2 & 3)]

    def number(self, index: int, subindex: int = 0) -> int:
        """An upload of an unsigned number that is not refused."""
        data = self.read(index, subindex)
        assert isinstance(data, bytes), hex(data)
        return int.from_bytes(data, "little")

    def seen(self, kind: type[E]) -> list[E]:
        """The events of one type; they are taken out of `events`."""
        found = [event for event in self.events if isinstance(event, kind)]
        self.events = [event for event in self.events if not isinstance(event, kind)]
        return found


def _multiplexer(index: int, subindex: int) -> str:
    return f"{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}"


START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = "000#0105", "000#0205", "000#8005", "000#8105", "000#8205"
SYNC = "080#"
