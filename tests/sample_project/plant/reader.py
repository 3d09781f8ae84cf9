"""Reads objects of a device: a small SDO client on python-can."""

from __future__ import annotations

import can

TIMEOUT = 0.5  # s


class SdoTimeoutError(Exception):
    pass


class SdoAbortError(Exception):
    pass


class SdoToggleError(Exception):
    pass


class Reader:
    """bus: one that hears the answers of this node only."""

    def __init__(self, bus: can.BusABC, node_id: int) -> None:
        self.bus = bus
        self.node_id = node_id

    def read(self, index: int, subindex: int = 0) -> bytes:
        answer = self.ask(b"\x40" + index.to_bytes(2, "little") + bytes((subindex, 0, 0, 0, 0)))
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        content, toggle = b"", 0
        while True:
            answer = self.ask(bytes((0x60 | toggle,)) + bytes(7))
            if answer[0] & 0x10 != toggle:
                raise SdoToggleError(f"node {self.node_id} sent a segment twice")
            content += answer[1 : 8 - (answer[0] >> 1 & 7)]
            if answer[0] & 0x01:
                return content
            toggle ^= 0x10

    def ask(self, request: bytes) -> bytes:
        self.bus.send(can.Message(arbitration_id=0x600 + self.node_id, data=request, is_extended_id=False))
        message = self.bus.recv(TIMEOUT)
        if message is None:
            raise SdoTimeoutError(f"node {self.node_id} does not answer")
        answer = bytes(message.data)
        if answer[0] == 0x80:
            raise SdoAbortError(f"node {self.node_id} refused: 0x{int.from_bytes(answer[4:], 'little'):08X}")
        return answer
