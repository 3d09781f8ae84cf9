"""One side of a block transfer that stands alone: the other side is hex text, as in the standard."""

from __future__ import annotations

from binascii import crc_hqx
from typing import Any

from canopen_proto.abort import AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, Event, Outbox, Time
from canopen_proto.sdo.client import SdoAborted, SdoClient
from canopen_proto.sdo.server import SdoServer, SdoServerAborted
from tests.core.block_pair import Store
from tests.core.bus import take_events, take_frames


class Bench:
    """A machine, and the peer's frames."""

    machine: SdoClient | SdoServer
    hears: int
    sends: str

    def __init__(self) -> None:
        self.out = Outbox()
        self.now: Time = 0

    def tell(self, *frames: str) -> list[str]:
        """What it says to frames that come one millisecond after another; turns that are due come first, as in any driver.

        Less than eight bytes are filled with zeros.
        """
        for frame in frames:
            self.turn()
            self.now += MILLISECOND
            self.machine.receive(self.heard(frame), self.now)
        self.turn()
        return self.said()

    def heard(self, text: str) -> Frame:
        return Frame(self.hears, bytes.fromhex(text).ljust(8, b"\x00"))

    def tell_at_once(self, *frames: str) -> list[str]:
        """What it says to frames that are there before its next turn."""
        for frame in frames:
            self.machine.receive(self.heard(frame), self.now)
        self.turn()
        return self.said()

    def turn(self) -> None:
        """Serve the deadlines that are due."""
        while self.machine.deadline <= self.now:
            self.machine.handle_timeout(self.now)

    def wait(self) -> list[str]:
        """What it says when its deadline comes."""
        assert self.machine.deadline < NEVER
        self.now = self.machine.deadline
        self.machine.handle_timeout(self.now)
        self.turn()
        return self.said()

    def said(self) -> list[str]:
        frames = take_frames(self.out)
        assert all(frame.startswith(self.sends) for frame in frames)
        return [frame[4:] for frame in frames]

    def events(self) -> list[Event]:
        return take_events(self.out)

    def outcome(self) -> Event:
        """The one event that there is."""
        (report,) = self.events()
        return report

    def aborted(self) -> tuple[int, AbortOrigin]:
        report = self.outcome()
        assert isinstance(report, SdoAborted | SdoServerAborted)
        assert self.machine.deadline == NEVER
        assert not self.machine.busy
        return report.abort_code, report.origin


class ClientBench(Bench):
    """A client of node 12."""

    hears, sends = 0x58C, "60C#"

    def __init__(self, **options: Any) -> None:
        super().__init__()
        self.machine = self.client = SdoClient(self.out, 12, **{"max_upload": 2000, **options})

    def upload(self, block: Any = True) -> list[str]:
        self.client.upload(0x1008, 0, self.now, block=block)
        return self.said()

    def download(self, content: bytes, block: Any = True) -> list[str]:
        self.client.download(0x2000, 0, content, self.now, block=block)
        return self.said()


class ServerBench(Bench):
    """The server of node 12; object 0x2000 holds `content`, 0x2001 is served by the host."""

    hears, sends = 0x60C, "58C#"

    def __init__(self, content: bytes = b"", **options: Any) -> None:
        super().__init__()
        self.store = Store(content)
        self.machine = self.server = SdoServer(self.out, 12, self.store, **{"max_download": 2000, **options})


def frames(*texts: str) -> list[str]:
    """Hex text as it comes out of a bench."""
    return [bytes.fromhex(text).ljust(8, b"\x00").hex().upper() for text in texts]


def crc_bytes(content: bytes) -> str:
    """The CRC as it stands in an end frame, as hex text."""
    return crc_hqx(content, 0).to_bytes(2, "little").hex()


def segments(content: bytes, count: int = 127, *, final: bool = True, first: int = 1) -> list[str]:
    """The frames of a sub-block that begins with content, as hex text."""
    pieces = [content[offset : offset + 7] for offset in range(0, len(content), 7)][:count] or [b""]
    last = len(pieces) - 1
    return [
        (bytes((number + first | (0x80 if final and number == last else 0),)) + piece.ljust(7, b"\x00")).hex().upper()
        for number, piece in enumerate(pieces)
    ]
