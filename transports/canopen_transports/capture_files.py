"""Capture files of Wireshark, tshark, dumpcap and tcpdump: pcap and pcapng, with frames of SocketCAN.

Each packet of link type 227 (LINKTYPE_CAN_SOCKETCAN) is the head of Linux's `struct can_frame`, of which the identifier and its
three flags are big-endian, and the data. A capture of all interfaces (`-i any`) has a head of the "cooked" capture before it
(link types 113 and 276), which also says which packets this computer sent; the identifier behind it has the byte order of the
file. Packets of other link types and protocols are skipped, as are CAN FD, CAN XL and error frames. Three things say that the
recorder lost frames: SocketCAN's error frame of an overrun, and in pcapng the number of lost packets before a packet, and of all
that an interface lost.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng, the formats; tcpdump.org's list of link types. The tests have tshark
read what is written here, and read here what tshark writes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

from canopen_proto.explained import counted
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import SECOND
from canopen_transports.candump_text import NotAFrameError
from canopen_transports.error_frames import ErrorReport
from canopen_transports.record import DEFAULT_CHANNEL, LogDamagedError, Record, Skip

CAN_SOCKETCAN: Final = 227
_HEAD_LENGTHS: Final = {CAN_SOCKETCAN: 0, 113: 16, 276: 20}
"""By link type: the bytes of a cooked capture's head."""
_ETHERTYPE_CAN: Final = 0x000C
_OUTGOING: Final = 4  # a cooked packet's type

_CAN_HEAD: Final = {order: struct.Struct(order + "IBB2x") for order in "<>"}
_CAN_HEAD_LENGTH: Final = 8
_COOKED_HEAD: Final = {113: struct.Struct(">H12xH"), 276: struct.Struct(">H8xB9x")}
_EXTENDED_FLAG: Final = 1 << 31
_REMOTE_FLAG: Final = 1 << 30
_ERROR_FLAG: Final = 1 << 29
_FD_FLAG: Final = 0x04  # in the byte behind the length
_XL_FLAG: Final = 0x80  # in the byte of the length: a CAN XL frame has its flags there

_MICROSECONDS, _NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
_SECTION_HEADER: Final = 0x0A0D0D0A  # reads the same in both byte orders
_INTERFACE, _SIMPLE_PACKET, _STATISTICS, _ENHANCED_PACKET = 1, 3, 5, 6
_BYTE_ORDER: Final = 0x1A2B3C4D
_OPTION_NAME, _OPTION_RESOLUTION, _OPTION_OFFSET, _OPTION_FLAGS, _OPTION_DROPPED = 2, 9, 14, 2, 4
_OPTIONS_OF_LOSSES: Final = (5, 7)  # isb_ifdrop, isb_osdrop: by the interface, by the system
_OVERRUN: Final = _ERROR_FLAG | 0x004, b"\0\1".ljust(8, b"\0")
"""linux/can/error.h: the identifier and the data of an error frame of a receive buffer that overran."""
_LARGEST: Final = 1 << 24  # bytes: no program writes a block or a packet as large; damaged files say so

MAGICS: Final = frozenset(
    struct.pack(order + "I", magic) for order in "<>" for magic in (_MICROSECONDS, _NANOSECONDS, _SECTION_HEADER)
)
"""A capture file begins with one of these."""


def read_capture(file: BinaryIO, skip: Skip, channel: str = DEFAULT_CHANNEL) -> Iterator[Record]:
    """Yield the records of a capture of either format, in its order. Raises LogDamagedError after the last that can be read.

    skip: called with the reason, for each packet that is not a classical CAN frame. channel: the bus, where the file names none.
    """
    magic = file.read(4)
    if magic not in MAGICS:
        raise LogDamagedError("the file begins neither like pcap nor like pcapng")
    if int.from_bytes(magic, "big") == _SECTION_HEADER:
        return _pcapng_records(file, skip, channel)
    return _pcap_records(file, magic, skip, channel)


# ---- pcap ----


def _pcap_records(file: BinaryIO, magic: bytes, skip: Skip, channel: str) -> Iterator[Record]:
    order = "<" if int.from_bytes(magic, "little") in (_MICROSECONDS, _NANOSECONDS) else ">"
    unit = 1 if int.from_bytes(magic, "little" if order == "<" else "big") == _NANOSECONDS else 1000
    (link_type,) = struct.unpack(order + "16xI", _exactly(file, 20, "its head"))
    head = struct.Struct(order + "IIII")
    while (begin := file.read(head.size)) != b"":
        seconds, fraction, length, _ = head.unpack(begin + _exactly(file, head.size - len(begin), "the head of a packet"))
        content = _exactly(file, _bounded(length), "a packet")
        yield from _records(link_type & 0xFFFF, order, content, seconds * SECOND + fraction * unit, channel, skip)


# ---- pcapng ----


class _Interface(NamedTuple):
    link_type: int
    channel: str
    per_second: int
    offset: int  # ns

    def time(self, ticks: int) -> int:
        return ticks * SECOND // self.per_second + self.offset


def _pcapng_records(file: BinaryIO, skip: Skip, channel: str) -> Iterator[Record]:
    order = ""
    interfaces: list[_Interface] = []
    begin = struct.pack("<I", _SECTION_HEADER)  # the caller has read it
    while begin:
        begin += _exactly(file, 8 - len(begin), "the head of a block")
        if int.from_bytes(begin[:4], "big") == _SECTION_HEADER:  # another section, maybe of another computer
            mark = _exactly(file, 4, "the head of a section")
            order = "<" if int.from_bytes(mark, "little") == _BYTE_ORDER else ">"
            if int.from_bytes(mark, "little" if order == "<" else "big") != _BYTE_ORDER:
                raise LogDamagedError("a section of the file has no byte order")
            interfaces = []
            _body(file, order, begin[4:], 4)
        else:
            (kind,) = struct.unpack(order + "I", begin[:4])
            body = _body(file, order, begin[4:], 0)
            if kind == _INTERFACE:
                interfaces.append(_interface(body, order, f"can{len(interfaces)}" if interfaces else channel))
            elif kind == _ENHANCED_PACKET:
                yield from _packet(body, order, interfaces, skip)
            elif kind == _SIMPLE_PACKET:
                skip("a packet without a time")
            elif kind == _STATISTICS:
                options = _options(body[12:], order)
                _tell_lost(sum(_number(options.get(each, b""), order) for each in _OPTIONS_OF_LOSSES), "somewhere before", skip)
        begin = file.read(8)


def _body(file: BinaryIO, order: str, length: bytes, already: int) -> bytes:
    """Read a block from behind its head to its end, where its length stands again. already: how much of it has been read."""
    (total,) = struct.unpack(order + "I", length)
    if total % 4 or _bounded(total) < 12 + already:
        raise LogDamagedError(f"a block says that it has {total} bytes")
    body = _exactly(file, total - 12 - already, "a block")
    if _exactly(file, 4, "a block") != length:
        raise LogDamagedError(f"a block of {total} bytes says something else at its end")
    return body


def _interface(body: bytes, order: str, channel: str) -> _Interface:
    if len(body) < 8:
        raise LogDamagedError("the description of an interface is too short")
    options = _options(body[8:], order)
    resolution = (options.get(_OPTION_RESOLUTION) or b"\x06")[0]
    per_second = 1 << (resolution & 0x7F) if resolution & 0x80 else 10 ** (resolution & 0x7F)
    seconds = int.from_bytes(options.get(_OPTION_OFFSET, b"")[:8], "little" if order == "<" else "big", signed=True)
    name = options.get(_OPTION_NAME, b"").rstrip(b"\0").decode("utf-8", "replace")
    return _Interface(struct.unpack(order + "H", body[:2])[0], name or channel, per_second, seconds * SECOND)


def _packet(body: bytes, order: str, interfaces: list[_Interface], skip: Skip) -> Iterator[Record]:
    if len(body) < 20:
        raise LogDamagedError("the head of a packet is too short")
    number, high, low, length, _ = struct.unpack(order + "5I", body[:20])
    if number >= len(interfaces) or 20 + length > len(body):
        raise LogDamagedError(f"a packet of {length} bytes on interface {number} does not fit what comes before it")
    interface = interfaces[number]
    options = _options(body[20 + length + -length % 4 :], order)
    _tell_lost(_number(options.get(_OPTION_DROPPED, b""), order), "here", skip)
    sent = _number(options.get(_OPTION_FLAGS, b"")[:4], order) & 3 == 2
    time = interface.time(high << 32 | low)
    for record in _records(interface.link_type, order, body[20 : 20 + length], time, interface.channel, skip):
        yield record._replace(sent=sent) if sent else record


def _options(text: bytes, order: str) -> dict[int, bytes]:
    """Return the options behind a block's fixed part, by number; of several with one number the last."""
    found = {}
    at = 0
    while at + 4 <= len(text):
        number, length = struct.unpack_from(order + "HH", text, at)
        if number == 0:
            break
        found[number] = text[at + 4 : at + 4 + length]
        at += 4 + length + -length % 4
    return found


def _number(content: bytes, order: str) -> int:
    return int.from_bytes(content[:8], "little" if order == "<" else "big")


def _tell_lost(count: int, where: str, skip: Skip) -> None:
    """Tell the recorder's own number of lost packets, if it is one: all ones mean that it does not know."""
    if 0 < count < (1 << 64) - 1:
        skip(f"the recorder has lost {counted(count, 'packet')} {where}", is_overrun=True)


# ---- both ----


def _exactly(file: BinaryIO, size: int, what: str) -> bytes:
    content = file.read(size)
    if len(content) < size:
        raise LogDamagedError(f"the file ends in the middle of {what}")
    return content


def _bounded(length: int) -> int:
    if length > _LARGEST:
        raise LogDamagedError(f"a part of the file says that it has {length} bytes")
    return length


def _records(link_type: int, order: str, packet: bytes, time: int, channel: str, skip: Skip) -> Iterator[Record]:
    """Yield the record of a packet, or skip it."""
    head = _HEAD_LENGTHS.get(link_type)
    if head is None:
        skip(f"a packet of link type {link_type}: {CAN_SOCKETCAN} is SocketCAN's")
        return
    if len(packet) < head + _CAN_HEAD_LENGTH:
        skip(f"a packet of {len(packet)} bytes")
        return
    sent = False
    if head:
        # Cooked, version 1: packet type .. protocol. Version 2: protocol .. packet type.
        first, second = _COOKED_HEAD[link_type].unpack(packet[:head])
        kind, protocol = (first, second) if link_type == 113 else (second, first)
        if protocol != _ETHERTYPE_CAN:
            skip(f"a packet of protocol 0x{protocol:04X}: 0x000C is CAN's")
            return
        sent = kind == _OUTGOING
    try:
        yield Record(time, channel, _frame(packet[head:], order if head else ">"), sent)
    except NotAFrameError as reason:
        skip(str(reason), is_overrun=reason.is_overrun)


def _frame(packet: bytes, order: str) -> Frame:
    """Return the frame of SocketCAN's bytes. Raises NotAFrameError, which says what else it is."""
    can_id, length, flags = _CAN_HEAD[order].unpack_from(packet)
    if length & _XL_FLAG:
        raise NotAFrameError("a CAN XL frame")
    if length > 8 or flags & _FD_FLAG:
        raise NotAFrameError("a CAN FD frame")
    if can_id & _ERROR_FLAG:
        report = ErrorReport(can_id, packet[_CAN_HEAD_LENGTH : _CAN_HEAD_LENGTH + length])
        raise NotAFrameError("an error frame", is_overrun=report.overrun)
    extended = EXTENDED if can_id & _EXTENDED_FLAG else 0
    can_id_alone = can_id & (0x1FFFFFFF if extended else 0x7FF)
    if can_id & _REMOTE_FLAG:
        return Frame(can_id_alone, b"", extended | REMOTE, length)
    data = packet[_CAN_HEAD_LENGTH : _CAN_HEAD_LENGTH + length]
    if len(data) < length:
        raise NotAFrameError(f"a packet that was cut to {len(packet)} bytes when it was captured")
    return Frame(can_id_alone, data, extended)


def _packet_of(frame: Frame) -> bytes:
    flags = _EXTENDED_FLAG * bool(frame.flags & EXTENDED) | _REMOTE_FLAG * bool(frame.flags & REMOTE)
    return _CAN_HEAD[">"].pack(frame.can_id | flags, frame.dlc, 0) + frame.data


def _packet_of_loss() -> bytes:
    can_id, data = _OVERRUN
    return _CAN_HEAD[">"].pack(can_id, len(data), 0) + data


class PcapWriter:
    """Writes pcap with times in nanoseconds. Each packet goes to the system at once. left_out: frames of 2106 and later. file:
    open for writing."""

    def __init__(self, file: BinaryIO) -> None:
        self.left_out = 0
        self._file = file
        file.write(struct.pack("<IHHiIII", _NANOSECONDS, 2, 4, 0, 0, 262144, CAN_SOCKETCAN))

    def write(self, record: Record) -> None:
        """Add a packet."""
        self.left_out += not self._add(record.time, _packet_of(record.frame))

    def lost(self, time: int, channel: str) -> None:
        """Add the error frame by which `read_capture` knows that frames are missing."""
        self._add(time, _packet_of_loss())

    def _add(self, time: int, packet: bytes) -> bool:
        seconds, fraction = divmod(time, SECOND)
        if seconds >> 32:
            return False
        self._file.write(struct.pack("<IIII", seconds, fraction, len(packet), len(packet)) + packet)
        self._file.flush()
        return True

    def close(self) -> None:
        """End the file."""
        self._file.close()


class PcapngWriter:
    """Writes pcapng with times in nanoseconds, names of buses, and directions. Each block goes to the system at once.

    left_out: frames of the year 2554 and later. file: open for writing.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.left_out = 0
        self._file = file
        self._interfaces: dict[str, int] = {}
        self._block(_SECTION_HEADER, struct.pack("<IHHq", _BYTE_ORDER, 1, 0, -1))

    def write(self, record: Record) -> None:
        """Add a packet; before it its interface, if it is the first one there."""
        self.left_out += not self._add(record.time, record.channel, _packet_of(record.frame), sent=record.sent)

    def lost(self, time: int, channel: str) -> None:
        """Add the error frame by which `read_capture` knows that frames are missing."""
        self._add(time, channel, _packet_of_loss(), sent=False)

    def _add(self, time: int, channel: str, packet: bytes, *, sent: bool) -> bool:
        if time >> 64:
            return False
        number = self._interfaces.get(channel)
        if number is None:
            number = self._interfaces[channel] = len(self._interfaces)
            options = _option(_OPTION_NAME, channel.encode()) + _option(_OPTION_RESOLUTION, b"\x09")
            self._block(_INTERFACE, struct.pack("<HHI", CAN_SOCKETCAN, 0, 0) + options + _option(0, b""))
        body = struct.pack("<5I", number, time >> 32, time & 0xFFFFFFFF, len(packet), len(packet)) + _filled(packet)
        direction = struct.pack("<I", 2 if sent else 1)
        self._block(_ENHANCED_PACKET, body + _option(_OPTION_FLAGS, direction) + _option(0, b""))
        self._file.flush()
        return True

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def _block(self, kind: int, body: bytes) -> None:
        length = struct.pack("<I", len(body) + 12)
        self._file.write(struct.pack("<I", kind) + length + body + length)


def _option(number: int, content: bytes) -> bytes:
    return struct.pack("<HH", number, len(content)) + _filled(content)


def _filled(content: bytes) -> bytes:
    return content + bytes(-len(content) % 4)
