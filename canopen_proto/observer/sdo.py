"""Follow SDO transfers by listening only: put each frame in words, with the object and its value.

There is one `OverheardChannel` for each pair of client and server. It follows a transfer through its segments and blocks, so that
the last frame shows the value. It takes nothing for granted: recordings begin in the middle, lose frames, and show faulty
devices. A frame that does not fit into the transfer is described as such, and the next initiate starts a new transfer. CRC,
toggle bits and sizes are not checked: `SdoClient` and `SdoServer` do that for those that take part.

Source: CiA 301 v4.2.0, 7.2.4.3.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.abort import text_of
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.observer.meaning import Shown, object_text, shown_of, value_text
from canopen_proto.sdo.block import ACKNOWLEDGEMENT, END, END_RESPONSE, FINAL, KIND, MAX_BLOCK_SIZE, SEQUENCE, START_UPLOAD
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    LAST,
    LEAST_REQUEST,
    LEAST_RESPONSE,
    SIZE_BIT,
    SPECIFIER,
    UPLOAD_SEGMENT,
    complete,
)

MAX_KEPT: Final = 1 << 16
"""The most bytes of a value that are kept: a longer one is firmware or the like, and its length is enough."""


class Settled(NamedTuple):
    """A value that a device is known to hold: it was read, or a write of it was confirmed. place: index and subindex."""

    place: tuple[int, int]
    data: bytes


class OverheardChannel:
    """The transfers between one client and one server. dictionary: of the server's device, for names and types; may be empty.

    Of the last frame: settled: the value that it shows the device to hold, or None. shown: its object, or None if that is not
    known.
    """

    def __init__(self, dictionary: ObjectDictionary, node_id: int = 0) -> None:
        self.settled: Settled | None = None
        self._node_id = node_id
        self._shows: bytes | None = None
        self._dictionary = dictionary
        self._is_upload: bool
        self._verb: str
        self._place: tuple[int, int]
        self._object: str
        self._data: bytearray
        self._length: int
        self._is_whole: bool
        self._in_block: bool
        self._was_last: bool
        self._was_abort: bool
        self._block_size: int
        self._segments: list[bytes]  # of this block, without a gap
        self._sent: int  # the number of the last segment
        self._end()

    @property
    def shown(self) -> Shown | None:
        """See this class's text."""
        if not self._object and not self._was_abort:
            return None
        return shown_of(self._dictionary, self._node_id, *self._place, self._shows, is_held=self.settled is not None)

    def client(self, data: bytes) -> str:
        """Return a frame of the client in words."""
        self.settled = self._shows = None
        self._was_abort = False
        if self._in_block and not self._is_upload:
            return self._block_segment(data)
        frame = complete(data, LEAST_REQUEST)
        if frame is None:
            return _strange(data)
        command = frame[0]
        specifier = command & SPECIFIER
        if specifier == ABORT:
            return self._aborted(frame, "the client")
        if specifier == INITIATE_DOWNLOAD:
            return self._initiate(frame, is_upload=False)
        if specifier == INITIATE_UPLOAD:
            self._begin(frame, is_upload=True)
            return f"read {self._object}"
        if specifier == UPLOAD_SEGMENT:
            return f"read {self._object}: next segment" if self._object and self._is_upload else _lone(data)
        if specifier == BLOCK_UPLOAD:
            return self._block_upload_request(frame)
        if specifier == BLOCK_DOWNLOAD:
            return self._block_end(frame) if command & LAST else self._block_download(frame)
        return self._segment(frame) if not self._is_upload else _lone(data)

    def server(self, data: bytes) -> str:
        """Return a frame of the server in words."""
        self.settled = self._shows = None
        self._was_abort = False
        if self._in_block and self._is_upload:
            return self._block_segment(data)
        frame = complete(data, LEAST_RESPONSE)
        if frame is None:
            return _strange(data)
        command = frame[0]
        specifier = command & SPECIFIER
        if specifier == ABORT:
            return self._aborted(frame, "the server")
        if specifier == INITIATE_UPLOAD:
            return self._initiate(frame, is_upload=True)
        if specifier == INITIATE_DOWNLOAD_RESPONSE:
            self._object = self._object or self._named(frame)
            return self._written() if self._is_whole else f"write {self._object}: go on"
        if specifier == INITIATE_DOWNLOAD:
            return self._confirmed()
        if specifier == BLOCK_UPLOAD:
            return self._block_download_response(frame)
        if specifier == BLOCK_DOWNLOAD:
            if command & LAST:
                return self._block_end(frame)
            self._object = self._object or self._named(frame)
            return f"read {self._object}: in blocks{self._announced(frame, 0x02)}"
        return self._segment(frame) if self._is_upload else _lone(data)

    def _initiate(self, frame: bytes, *, is_upload: bool) -> str:
        if not is_upload or not self._is_this(frame):
            self._begin(frame, is_upload=is_upload)
        command = frame[0]
        if command & EXPEDITED_BIT:
            self._keep(frame[4 : 8 - (command >> 2 & 3 if command & SIZE_BIT else 0)])
            return self._value()
        return f"{self._verb} {self._object}: in segments{self._announced(frame, SIZE_BIT)}"

    def _segment(self, frame: bytes) -> str:
        if not self._object:
            return _lone(frame)
        self._keep(frame[1 : 8 - (frame[0] >> 1 & 7)])
        return self._value() if frame[0] & LAST else f"{self._verb} {self._object}: segment, {self._length} bytes so far"

    def _confirmed(self) -> str:
        if not self._object:
            return "a segment is confirmed"
        return self._written() if self._is_whole else f"write {self._object}: segment confirmed"

    def _block_upload_request(self, frame: bytes) -> str:
        kind = frame[0] & 0x03
        if kind == 0:
            self._begin(frame, is_upload=True)
            self._block_size = frame[4]
            return f"read {self._object}: in blocks of {frame[4]} segments"
        if not self._object:
            return _lone(frame)
        if frame[0] & KIND == START_UPLOAD:
            self._in_block = True
            return f"read {self._object}: start"
        if frame[0] & KIND == ACKNOWLEDGEMENT:
            return self._acknowledged(frame)
        return f"read {self._object}: block transfer ended"

    def _block_download(self, frame: bytes) -> str:
        self._begin(frame, is_upload=False)
        return f"write {self._object}: in blocks{self._announced(frame, 0x02)}"

    def _block_download_response(self, frame: bytes) -> str:
        if frame[0] & KIND == ACKNOWLEDGEMENT:
            return self._acknowledged(frame)
        if frame[0] & KIND == END_RESPONSE:
            return self._written() if self._object else "a block transfer is confirmed"
        self._object = self._object or self._named(frame)
        self._block_size, self._in_block = frame[4], True
        return f"write {self._object}: go on, {frame[4]} segments a block"

    def _block_segment(self, data: bytes) -> str:
        if len(data) == 8 and data[0] == ABORT and data[1] | data[2] << 8 == self._place[0]:
            return self._aborted(data, "the sender")
        frame = data[:8].ljust(8, b"\0")
        number = frame[0] & SEQUENCE
        self._sent = number
        if number == len(self._segments) + 1:
            self._segments.append(frame[1:])
        if frame[0] & FINAL or number >= self._block_size:
            self._in_block = False
            self._was_last = bool(frame[0] & FINAL)
        return f"{self._verb} {self._object}: block segment {number}{', the last' if frame[0] & FINAL else ''}"

    def _acknowledged(self, frame: bytes) -> str:
        taken, self._block_size = frame[1], frame[2] or MAX_BLOCK_SIZE
        again = taken < self._sent
        for segment in self._segments[:taken]:
            self._keep(segment)
        self._segments.clear()
        self._sent = 0
        self._in_block = not self._was_last or again
        return f"{self._verb} {self._object}: {taken} segments taken{', the others must be sent again' if again else ''}"

    def _block_end(self, frame: bytes) -> str:
        if not self._object or frame[0] & KIND != END:
            return _lone(frame)
        unused = min(frame[0] >> 2 & 7, len(self._data))
        self._length -= unused
        if unused and self._length < MAX_KEPT:
            del self._data[-unused:]
        return self._value()

    def _begin(self, frame: bytes, *, is_upload: bool) -> None:
        self._end()
        self._is_upload = is_upload
        self._verb = "read" if is_upload else "write"
        self._place = (frame[1] | frame[2] << 8, frame[3])
        self._object = self._named(frame)

    def _end(self) -> None:
        self._is_upload = False
        self._verb = "write"
        self._place = (0, 0)
        self._object = ""
        self._data = bytearray()
        self._length = 0
        self._is_whole = False
        self._in_block = self._was_last = self._was_abort = False
        self._block_size = MAX_BLOCK_SIZE
        self._segments = []
        self._sent = 0

    def _is_this(self, frame: bytes) -> bool:
        return bool(self._object) and self._is_upload and self._place == (frame[1] | frame[2] << 8, frame[3])

    def _named(self, frame: bytes) -> str:
        return object_text(self._dictionary, frame[1] | frame[2] << 8, frame[3])

    def _keep(self, data: bytes) -> None:
        self._length += len(data)
        if len(self._data) < MAX_KEPT:
            self._data += data

    def _written(self) -> str:
        if self._is_whole and not self._is_upload:
            self._settle()
        return f"written {self._object}"

    def _settle(self) -> None:
        if self._length == len(self._data):
            self._shows = bytes(self._data)
            self.settled = Settled(self._place, self._shows)

    def _value(self) -> str:
        self._is_whole = True
        if self._is_upload:
            self._settle()
        if self._length > len(self._data):
            return f"{self._verb} {self._object}: {self._length} bytes"
        self._shows = bytes(self._data)
        return f"{self._verb} {self._object} = {value_text(self._dictionary, *self._place, self._shows)}"

    def _aborted(self, frame: bytes, who: str) -> str:
        self._end()
        self._place, self._was_abort = (frame[1] | frame[2] << 8, frame[3]), True
        place = self._named(frame)
        code = int.from_bytes(frame[4:8], "little")
        text = text_of(code)
        return f"aborted by {who}, {place}: {text}" + ("" if "(0x" in text else f" (0x{code:08X})")

    @staticmethod
    def _announced(frame: bytes, bit: int) -> str:
        return f", {int.from_bytes(frame[4:8], 'little')} bytes" if frame[0] & bit else ""


def _lone(frame: bytes) -> str:
    return f"part of a transfer whose beginning was not heard: {frame.hex(' ')}"


def _strange(data: bytes) -> str:
    return f"too short for its command: {data.hex(' ') or 'no data'}"
