"""The frames of the services in words.

Those of services without memory say it themselves: NMT, error control, SYNC, TIME, EMCY, LSS, remote frames. The meaning of an
SDO frame depends on those before it, which the follower (sdo.py) keeps.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.error_codes import error_text, register_names
from canopen_proto.explained import counted
from canopen_proto.frame import MAX_NODE_ID, Frame
from canopen_proto.lss import messages as lss
from canopen_proto.multiplexer import split_mux
from canopen_proto.nmt import STATE_OF_BYTE, NmtCommand
from canopen_proto.observer.meaning import Say, Words, bytes_text, hex_text, object_text, shown_of
from canopen_proto.sdo.codec import SdoFrame, mux_in
from canopen_proto.time_stamp import time_of

_COMMANDS: Final[dict[int, str]] = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    NmtCommand.RESET_NODE: "reset node",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}
_STATE: Final = 0x7F

ACTIVE_MASTER: Final = 0x71
NEGOTIATION: Final[dict[int, str]] = {
    ACTIVE_MASTER: "the active master answers",
    0x72: "a negotiation of the flying masters begins",
    0x73: "who is the active master?",
    0x74: "a device that can be master answers",
    0x75: "who can be master?",
    0x76: "the flying masters have to negotiate again",
}
"""CAN-ID -> its meaning. CiA 302-2, as two stacks have it (emotas, and a master in Python); the standard was not at hand."""


def of_nmt(frame: Frame) -> Words:
    data = frame.data
    if len(data) < 2:
        return Words(f"too short: {hex_text(data)}")
    command = nmt_command_text(data[0])
    if data[1] > MAX_NODE_ID:
        return Words(f"{command}: node-ID {data[1]}, which no node can have")
    return Words(f"{command}: {'all nodes' if data[1] == 0 else f'node {data[1]}'}")


def nmt_command_text(command: int) -> str:
    """Return the name of an NMT command."""
    return _COMMANDS.get(command) or f"unknown command 0x{command:02X}"


def of_negotiation(frame: Frame) -> Words:
    """The negotiation of flying masters. The answer of the active one has its priority and its node-ID."""
    if frame.can_id == ACTIVE_MASTER and len(frame.data) == 2:
        priority, node_id = frame.data
        return Words(f"node {node_id} is the active master, priority {priority}")
    return Words(NEGOTIATION[frame.can_id] + (f": {hex_text(frame.data)}" if frame.data else ""))


def of_error_control(frame: Frame) -> Words:
    data = frame.data
    if len(data) != 1:
        return Words(f"of a wrong length: {hex_text(data)}")
    if not data[0]:
        return Words("")
    return Words(state_text(data[0]))


def state_text(byte: int) -> str:
    """Return the NMT state in a heartbeat or guarding answer, which may have the toggle bit. byte: the only one of the frame."""
    state = STATE_OF_BYTE[byte]
    return state.name.lower().replace("_", "-") if state is not None else f"unknown state 0x{byte & _STATE:02X}"


def of_sync(frame: Frame) -> Words:
    return Words(f"counter {frame.data[0]}" if frame.data else "")


def of_time(frame: Frame) -> Words:
    try:
        return Words(str(time_of(frame.data[:6])))
    except ValueRangeError:
        return Words(f"not a time: {hex_text(frame.data)}")


def of_emergency(frame: Frame) -> Words:
    data = frame.data
    if len(data) < 3:
        return Words(f"too short: {hex_text(data)}")
    code = data[0] | data[1] << 8
    register = f"error register 0x{data[2]:02X}"
    names = register_names(data[2])
    if names:
        register += f" ({', '.join(names)})"
    rest = f", {data[3:].hex(' ')}" if any(data[3:]) else ""
    return Words(f"0x{code:04X} {error_text(code)}, {register}{rest}")


def of_lss(frame: Frame) -> Words:
    return Words(lss.text_of(frame))


def of_bytes(frame: Frame) -> Words:
    return Words(bytes_text(frame.data))


def of_request(frame: Frame) -> Words:
    return Words("requested by a remote frame")


def of_guarding_request(frame: Frame) -> Words:
    return Words("the master asks for the state")


def of_remote(frame: Frame) -> Words:
    return Words(f"a remote frame, {counted(frame.dlc, 'byte')}")


def of_extended(frame: Frame) -> Words:
    return Words("29-bit identifier, which no file here assigns")


# ---- SDO ----

WRITTEN: Final = "written"
"""The verb of a confirmation: it shows the value as held, and does not repeat it in words."""


def sdo_step(
    dictionary: ObjectDictionary,
    node_id: int,
    named: bytes,
    verb: str,
    after: str,
    data: bytes | None,
    is_held: bool,
    _frame: Frame,
) -> Words:
    """Say what one frame of a transfer does, with its object.

    named: the frame of the transfer that names the object. after: what follows the object, unless its value does. data: the
    value, if the frame shows or confirms one. is_held: the device holds it.
    """
    index, subindex = split_mux(mux_in(named))
    shown = shown_of(dictionary, node_id, index, subindex, data, is_held=is_held)
    if data is not None and verb != WRITTEN:
        after = f" = {shown.text}"
    return Words(f"{verb} {object_text(dictionary, index, subindex)}{after}", (shown,))


def alone(frame: Frame) -> Words:
    """Say that a frame belongs to a transfer of which nothing else is known."""
    return Words(f"part of a transfer whose beginning was not heard: {frame.data[:8].ljust(8, bytes(1)).hex(' ')}")


def once_more(_frame: Frame) -> Words:
    """Say that a frame is the one before it."""
    return Words("the same frame once more")


def too_short(frame: Frame) -> Words:
    """Say that bytes are missing which the command byte announces."""
    return Words(f"too short for its command: {hex_text(frame.data)}")


def name_of(named: bytes) -> str:
    """Return the object that an SDO frame names, as "6041:00"."""
    index, subindex = split_mux(mux_in(named))
    return f"{index:04X}:{subindex:02X}"


STRAY_ANSWERS: Final[dict[SdoFrame, Say]] = {
    SdoFrame.DOWNLOAD_SEGMENT: lambda _frame: Words("a segment is confirmed"),
    SdoFrame.BLOCK_END_RESPONSE: lambda _frame: Words("a block transfer is confirmed"),
}
"""Answers, of transfers of which nothing else is known, that still say something. The others are `alone`."""
