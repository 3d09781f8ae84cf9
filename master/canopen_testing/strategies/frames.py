"""Frames: as the standard has them, nearly so, and any at all."""

from __future__ import annotations

import datetime
from collections.abc import Collection
from typing import Final

from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument
from hypothesis.strategies import SearchStrategy

from canopen_proto import frame as ids
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import EPOCH, DataType, encode
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.nmt import NmtCommand, NmtState, Service
from canopen_proto.sdo.codec import (
    ABORT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BITS,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    SIZE_BIT,
    TOGGLE,
    UPLOAD_SEGMENT,
    pack_expedited,
    pack_initiate,
    segment,
)
from canopen_testing.strategies.identifiers import node_ids

_PDOS: Final = (ids.TPDO1, ids.RPDO1, ids.TPDO2, ids.RPDO2, ids.TPDO3, ids.RPDO3, ids.TPDO4, ids.RPDO4)
_STATES: Final = (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL, NmtState.STOPPED)
_EMERGENCIES: Final = (0x0000, 0x1000, 0x2310, 0x3210, 0x4210, 0x5000, 0x6100, 0x7300, 0x8130, 0x8210, 0xFF00)
_INDICES: Final = st.sampled_from((0x2000, 0x1000, 0x1018, 0x1017, 0x6040, 0x6041)) | st.integers(0x1000, 0xFFFF)
_MILLISECONDS: Final = st.integers(0, 0xFFFF * 86_400_000 + 86_399_999)

ALL_SERVICES: Final = (
    Service.SYNC, Service.BOOT_UP, Service.ERROR_CONTROL, Service.NMT, Service.PDO, Service.EMCY, Service.TIME, Service.SDO,
)  # fmt: skip
"""Every service, the simplest first: towards that one `frames` shrinks."""


def frames(services: Collection[Service] = ALL_SERVICES, *, nodes: SearchStrategy[int] | None = None) -> SearchStrategy[Frame]:
    """Return a strategy for frames that CiA 301 has, by themselves: identifier, length and content fit.

    services: which ones (`canopen_proto.nmt.Service`). nodes: whose; None = `node_ids()`. The identifiers are those of the
    predefined connection set (CiA 301 v4.2.0, 7.3.3). No frame answers another one: see `sdo_conversations`. No block transfer.
    Bounds: 0 to 8 bytes. Shrinks towards SYNC without a counter, `080#`; within a service towards node 1 and zeros.
    """
    wanted = [each for each in ALL_SERVICES if each in services]
    if not wanted:
        raise InvalidArgument("frames of no service: name one in services, such as Service.PDO")
    return st.one_of([_of_service(each, node_ids() if nodes is None else nodes) for each in wanted])


def _of_service(service: Service, nodes: SearchStrategy[int]) -> SearchStrategy[Frame]:
    match service:
        case Service.SYNC:
            return st.builds(Frame, st.just(int(ids.SYNC)), st.just(b"") | _octets(st.integers(1, 240)))
        case Service.BOOT_UP:
            return st.builds(_frame, st.just(ids.ERROR_CONTROL), nodes, st.just(b"\x00"))
        case Service.ERROR_CONTROL:
            return st.builds(_frame, st.just(ids.ERROR_CONTROL), nodes, _octets(st.sampled_from(_STATES)))
        case Service.NMT:
            return st.builds(
                lambda command, node_id: Frame(ids.NMT, bytes((command, node_id))),
                st.sampled_from(NmtCommand),
                nodes | st.just(0),
            )
        case Service.PDO:
            return st.builds(_frame, st.sampled_from(_PDOS), nodes, st.binary(max_size=8))
        case Service.EMCY:
            return st.builds(_emergency, nodes, st.sampled_from(_EMERGENCIES), st.binary(min_size=5, max_size=5))
        case Service.TIME:
            return st.builds(_time, _MILLISECONDS)
        case Service.SDO:
            requests = st.builds(_frame, st.just(ids.SDO_CLIENT_TO_SERVER), nodes, _REQUESTS)
            return requests | st.builds(_frame, st.just(ids.SDO_SERVER_TO_CLIENT), nodes, _RESPONSES)


def _octets(numbers: SearchStrategy[int]) -> SearchStrategy[bytes]:
    return numbers.map(lambda number: bytes((number,)))


def _frame(base: int, node_id: int, data: bytes) -> Frame:
    return Frame(base + node_id, data)


def _command(command: NmtCommand, node_id: int) -> Frame:
    return Frame(ids.NMT, bytes((command, node_id)))


def _emergency(node_id: int, code: int, vendor_data: bytes) -> Frame:
    register = 1 if code else 0  # the generic bit is set while there is any error
    return Frame(ids.EMCY + node_id, code.to_bytes(2, "little") + bytes((register,)) + vendor_data)


def _time(milliseconds: int) -> Frame:
    return Frame(ids.TIME, encode(EPOCH + datetime.timedelta(milliseconds=milliseconds), DataType.TIME_OF_DAY))


def _of_object(command: int, numbers: SearchStrategy[int] | None = None) -> SearchStrategy[bytes]:
    """A frame that names an object, with a number: the size of a segmented transfer, an abort code, or 0."""
    return st.builds(pack_initiate, st.just(command), _INDICES, st.integers(0, 0xFF), st.just(0) if numbers is None else numbers)


def _expedited(command: int) -> SearchStrategy[bytes]:
    return st.builds(
        lambda index, subindex, data: pack_expedited(command | EXPEDITED_BITS[len(data)], index, subindex, data),
        _INDICES,
        st.integers(0, 0xFF),
        st.binary(min_size=1, max_size=4),
    )


_SIZES: Final = st.integers(5, 0xFFFF)
_TOGGLES: Final = st.sampled_from((0, TOGGLE))
_SEGMENTS: Final = st.builds(lambda toggle, content: segment(toggle, content, 0), _TOGGLES, st.binary(min_size=1, max_size=8))
_ABORTS: Final = _of_object(ABORT, st.sampled_from(AbortCode))


def _bare(command: int) -> SearchStrategy[bytes]:
    """A frame of the middle of a segmented transfer that carries nothing."""
    return _TOGGLES.map(lambda toggle: bytes((command | toggle,)) + bytes(7))


_REQUESTS: Final = st.one_of(
    _of_object(INITIATE_UPLOAD),
    _expedited(INITIATE_DOWNLOAD),
    _of_object(INITIATE_DOWNLOAD | SIZE_BIT, _SIZES),
    _bare(UPLOAD_SEGMENT),
    _SEGMENTS,
    _ABORTS,
)
_RESPONSES: Final = st.one_of(
    _of_object(INITIATE_DOWNLOAD_RESPONSE),
    _expedited(INITIATE_UPLOAD_RESPONSE),
    _of_object(INITIATE_UPLOAD_RESPONSE | SIZE_BIT, _SIZES),
    _bare(DOWNLOAD_SEGMENT_RESPONSE),
    _SEGMENTS,
    _ABORTS,
)


@st.composite
def near_valid_frames(
    draw: st.DrawFn, services: Collection[Service] = ALL_SERVICES, *, nodes: SearchStrategy[int] | None = None
) -> Frame:
    """Return a strategy for frames of `frames` with one mistake.

    The mistakes, the simplest first: a byte is missing, a byte is too much, one bit of the data is wrong, it is a remote frame,
    its CAN-ID has 29 bits, one bit of the CAN-ID is wrong. By chance the frame may be a right one of something else.
    Bounds: still a frame that CAN can carry. Shrinks towards `080#00`, and towards the first mistake that its service can have.
    """
    right = draw(frames(services, nodes=nodes))
    can_id, data = right.can_id, right.data
    mistakes = ["remote", "extended", "identifier"]
    if len(data) < 8:
        mistakes.insert(0, "longer")
    if data:
        mistakes = ["shorter", *mistakes[:-3], "bit", *mistakes[-3:]]
    match draw(st.sampled_from(mistakes)):
        case "shorter":
            return Frame(can_id, data[:-1])
        case "longer":
            return Frame(can_id, data + b"\x00")
        case "bit":
            place = draw(st.integers(0, 8 * len(data) - 1))
            return Frame(can_id, (int.from_bytes(data, "little") ^ 1 << place).to_bytes(len(data), "little"))
        case "remote":
            return Frame(can_id, b"", REMOTE, len(data))
        case "extended":
            return Frame(can_id, data, EXTENDED)
        case _:
            return Frame(can_id ^ 1 << draw(st.integers(0, 10)), data)


@st.composite
def random_frames(draw: st.DrawFn, *, extended: bool = True, remote: bool = True) -> Frame:
    """Return a strategy for any frames of classical CAN, whatever CANopen makes of them.

    extended: CAN-IDs of 29 bits too. remote: remote frames too. Bounds: 0 to 8 bytes, those that a remote frame asks for too.
    Shrinks towards `000#`.
    """
    is_extended = extended and draw(st.booleans())
    can_id = draw(st.integers(0, 0x1FFF_FFFF if is_extended else 0x7FF))
    flags = EXTENDED if is_extended else 0
    if remote and draw(st.booleans()):
        return Frame(can_id, b"", flags | REMOTE, draw(st.integers(0, 8)))
    return Frame(can_id, draw(st.binary(max_size=8)), flags)
