"""A thermometer for the bus, written by hand: NMT, an SDO server for three objects, and a TPDO with the temperature."""

from __future__ import annotations

from collections.abc import Callable

from canopen_proto import Frame

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
STATES = {1: OPERATIONAL, 2: STOPPED, 0x80: PRE_OPERATIONAL}
TEMPERATURE, PLACE = (0x2000, 0), (0x2001, 0)
NO_SUCH_OBJECT = 0x06020000


class Thermometer:
    """send: puts a frame on the bus. It boots with `reset`."""

    def __init__(self, node_id: int, send: Callable[[Frame], None]) -> None:
        self.node_id = node_id
        self.send = send
        self.tenths = 0
        self.state = BOOT_UP
        self.left = b""
        self.toggle = 0

    def reset(self) -> None:
        self.send(Frame(0x700 + self.node_id, bytes((BOOT_UP,))))
        self.state = PRE_OPERATIONAL

    def measure(self, tenths: int) -> None:
        """A new temperature, in tenths of a degree."""
        self.tenths = tenths
        if self.state == OPERATIONAL:
            self.send(Frame(0x180 + self.node_id, self.temperature))

    @property
    def temperature(self) -> bytes:
        return self.tenths.to_bytes(2, "little", signed=True)

    def on_frame(self, frame: Frame, now: int) -> None:
        if frame.can_id == 0 and frame.data[1] in (0, self.node_id):
            self.command(frame.data[0])
        elif frame.can_id == 0x600 + self.node_id and self.state != STOPPED:
            self.send(Frame(0x580 + self.node_id, self.answer(frame.data)))

    def command(self, command: int) -> None:
        if command in STATES:
            self.state = STATES[command]
        else:
            self.reset()

    def answer(self, request: bytes) -> bytes:
        if request[0] & 0xE0 == 0x60:
            return self.segment()
        objects = {(0x1000, 0): bytes(4), TEMPERATURE: self.temperature, PLACE: b"cold store, north wall"}
        place = (int.from_bytes(request[1:3], "little"), request[3])
        if request[0] != 0x40 or place not in objects:
            return b"\x80" + request[1:4] + NO_SUCH_OBJECT.to_bytes(4, "little")
        content = objects[place]
        if len(content) <= 4:
            return bytes((0x43 | 4 - len(content) << 2,)) + request[1:4] + content.ljust(4, b"\0")
        self.left, self.toggle = content, 0
        return b"\x41" + request[1:4] + len(content).to_bytes(4, "little")

    def segment(self) -> bytes:
        piece, self.left = self.left[:7], self.left[7:]
        command = self.toggle | 7 - len(piece) << 1 | (not self.left)
        self.toggle ^= 0x10
        return bytes((command,)) + piece.ljust(7, b"\0")
