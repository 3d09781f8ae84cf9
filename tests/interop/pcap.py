"""Our frames as a capture file, and what Wireshark makes of them: an implementation of CANopen that none of us wrote.

`read_by_wireshark` writes such a file, and has `tshark` dissect it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_transports.log_files import log_writer
from canopen_transports.record import Record

TSHARK = shutil.which("tshark")
LIMIT = 120.0  # seconds; a run takes about one

_BYTES = {"sdo.data.bytes", "pdo.data.bytes", "em.err_field", "reserved"}
_TEXT = {"time_stamp"}


class Packet:
    """One frame as Wireshark understands it.

    frame: ours. kind: the service, in Wireshark's words, such as "Default-SDO (tx)", where tx is the device's side; "" where it
    sees a CAN frame and no CANopen. complaint: what it finds wrong with it. Fields by `packet["sdo.main_idx"]`: numbers, or
    bytes, or text; one that the packet does not have is None.
    """

    def __init__(self, frame: Frame, layers: dict[str, Any]) -> None:
        self.frame = frame
        self.kind = ""
        self._fields: dict[str, str] = {}
        self._collect(layers)
        self.complaint = layers.get("_ws.malformed", "")

    def _collect(self, layer: dict[str, Any]) -> None:
        for name, value in layer.items():
            if name.startswith("Type: "):
                self.kind = name.removeprefix("Type: ")
            if isinstance(value, dict):
                self._collect(value)
            elif isinstance(value, str):
                self._fields[name] = value

    def __getitem__(self, name: str) -> Any:
        text = self._fields.get(name if name.startswith("can.") else f"canopen.{name}")
        if text is None or name in _TEXT:
            return text
        return bytes.fromhex(text.replace(":", "")) if name in _BYTES else int(text, 0)

    def __repr__(self) -> str:
        return f"<{self.frame}: {self.kind} {self._fields}>"


def read_by_wireshark(path: Path, frames: list[Frame]) -> list[Packet]:
    """What `tshark` says of each frame of that file."""
    assert TSHARK is not None
    writer = log_writer(path)
    for number, frame in enumerate(frames):
        writer.write(Record(number * MILLISECOND, "can0", frame))
    writer.close()
    command = [TSHARK, "-r", str(path), "-d", "can.subdissector,canopen", "-T", "json", "--no-duplicate-keys"]
    run = subprocess.run(command, capture_output=True, timeout=LIMIT, check=True)
    packets = [packet["_source"]["layers"] for packet in json.loads(run.stdout)]
    return [Packet(frame, layers) for frame, layers in zip(frames, packets, strict=True)]


Session: TypeAlias = Callable[[], list[Frame]]
"""Makes frames for Wireshark to read."""
Reading: TypeAlias = Callable[[Session], list[Packet]]
"""What Wireshark says of a session's frames."""


class Sessions(list[Session]):
    """The sessions of one test module, which are read in one run."""

    def add(self, make: Session) -> Session:
        """Decorator."""
        self.append(make)
        return make

    def read(self, path: Path) -> Reading:
        """Have Wireshark read them all; path: of the capture file that is written."""
        made = {make: make() for make in self}
        packets = iter(read_by_wireshark(path, [frame for frames in made.values() for frame in frames]))
        readings = {make: [next(packets) for _ in frames] for make, frames in made.items()}
        return readings.__getitem__


def check_whole(packets: list[Packet]) -> None:
    """That Wireshark finds nothing wrong with any of them, and sees the frames that we wrote."""
    assert packets
    for packet in packets:
        assert not packet.complaint, packet
        assert packet["can.len"] == packet.frame.dlc
        assert packet["can.id"] == packet.frame.can_id
