"""Put each frame of a bus in words, for people who read a recording.

A `Decoder` gets all frames in their order and returns a `Meaning` for each. It uses the predefined connection set (CiA 301
v4.2.0, 7.3.3) and the devices' dictionaries: names and types of objects, and the PDOs that they describe. It follows SDO
transfers through their segments and blocks, and uses PDO parameters from the moment when the recording shows them (pdo.py).

Left out: COB-IDs of other services that were changed at run time, SDO channels beyond the first, and services of other
standards but LSS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.error_codes import error_text, register_names
from canopen_proto.frame import (
    EMCY,
    ERROR_CONTROL,
    EXTENDED,
    MAX_NODE_ID,
    NMT,
    REMOTE,
    RPDO4,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TIME,
    TPDO1,
    TPDO4,
    Frame,
    RoutingKey,
    routing_key,
)
from canopen_proto.lss import messages as lss
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.observer.meaning import Meaning, Shown, bytes_text, shown_value
from canopen_proto.observer.pdo import OverheardPdo, OverheardPdos
from canopen_proto.observer.sdo import OverheardChannel, Settled
from canopen_proto.pdo.mapping import MappedEntry
from canopen_proto.time_stamp import time_of

_EMPTY: Final = ObjectDictionary((), source="nothing")
_PDO_FUNCTIONS: Final = range(TPDO1 >> 7, (RPDO4 >> 7) + 1)
_NMT_WORDS: Final = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    NmtCommand.RESET_NODE: "reset node",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}
_BOOT_UP: Final = b"\0"
_TOGGLE: Final = 0x80


class Decoder:
    """Puts frames in words. dictionary_of: returns the dictionary of a node-ID, or None.

    Of the last frame: pdo: it is this one, or None. settled: the node, and the value that it has shown to hold, or None.
    """

    def __init__(self, dictionary_of: Callable[[int], ObjectDictionary | None] = lambda node_id: None) -> None:
        self._dictionaries = {node_id: dictionary_of(node_id) or _EMPTY for node_id in range(1, MAX_NODE_ID + 1)}
        self._channels: dict[int, OverheardChannel] = {}
        self._pdos = OverheardPdos(self._dictionaries)
        self.pdo: OverheardPdo | None = None
        self.settled: tuple[int, Settled] | None = None

    def shared_cob_ids(self) -> list[tuple[RoutingKey, OverheardPdo, OverheardPdo]]:
        """Return the PDOs that two nodes send with one COB-ID, with its routing key."""
        return self._pdos.shared

    def decode(self, frame: Frame) -> Meaning:
        """Return the meaning of a frame, as the next one after all frames before."""
        self.settled = None
        self.pdo = pdo = self._pdos.find(routing_key(frame.can_id, frame.flags & ~REMOTE), frame.can_id & 0x7F, len(frame.data))
        if pdo is not None:
            return _of_pdo(pdo, self._dictionaries[pdo.node_id], frame)
        if frame.flags & EXTENDED:
            return Meaning("?", 0, "29-bit identifier, which no file here assigns")
        function, node_id = frame.can_id & 0x780, frame.can_id & 0x7F
        if frame.flags & REMOTE:
            return _of_remote(frame, function, node_id)
        data = frame.data
        if frame.can_id == NMT:
            return _of_nmt(data)
        if frame.can_id == SYNC:
            return Meaning("SYNC", 0, f"counter {data[0]}" if data else "")
        if frame.can_id == TIME:
            return Meaning("TIME", 0, _time_text(data))
        if frame.can_id in (lss.FROM_MASTER, lss.FROM_SLAVE):
            return Meaning("LSS", 0, lss.text_of(frame))
        if node_id:
            if function == EMCY:
                return Meaning("EMCY", node_id, _emergency_text(data))
            if function == SDO_CLIENT_TO_SERVER:
                channel = self._channel(node_id)
                return _of_sdo(node_id, channel.client(data), channel.shown)
            if function == SDO_SERVER_TO_CLIENT:
                return self._answer(node_id, data)
            if function == ERROR_CONTROL:
                if data == _BOOT_UP:
                    self._pdos.booted(node_id)
                return _of_error_control(node_id, data)
            if function >> 7 in _PDO_FUNCTIONS:
                return Meaning(_pdo_name(function), node_id, bytes_text(data))
        return Meaning("?", 0, bytes_text(data))

    def _answer(self, node_id: int, data: bytes) -> Meaning:
        channel = self._channel(node_id)
        text = channel.server(data)
        if channel.settled is not None:
            self.settled = node_id, channel.settled
            self._pdos.settle(node_id, *channel.settled.place, channel.settled.data)
        return _of_sdo(node_id, text, channel.shown)

    def _channel(self, node_id: int) -> OverheardChannel:
        if node_id not in self._channels:
            self._channels[node_id] = OverheardChannel(self._dictionaries[node_id], node_id)
        return self._channels[node_id]


def _pdo_name(function: int) -> str:
    """Return the name of the PDO with a function code: TPDO1 is 3, RPDO1 4, TPDO2 5 ..."""
    number = (function >> 7) - (TPDO1 >> 7)
    return f"{'RPDO' if number % 2 else 'TPDO'} {number // 2 + 1}"


def _of_sdo(node_id: int, text: str, shown: Shown | None) -> Meaning:
    return Meaning("SDO", node_id, text, () if shown is None else (shown,))


def _of_pdo(pdo: OverheardPdo, dictionary: ObjectDictionary, frame: Frame) -> Meaning:
    if frame.flags & REMOTE:
        return Meaning(pdo.name, pdo.node_id, "requested by a remote frame")
    mapping, size = pdo.mapping, len(frame.data)
    try:
        values = mapping.unpack(frame.data)
    except ValueRangeError as error:
        why = f"shorter than its mapping of {mapping.byte_length} bytes" if size < mapping.byte_length else str(error)
        return Meaning(pdo.name, pdo.node_id, f"{why}: {frame.data.hex(' ') or 'no data'}")
    is_held = pdo.direction is Direction.TPDO
    objects = tuple(
        Shown(
            pdo.node_id,
            entry.index,
            entry.subindex,
            entry.name,
            value,
            shown_value(dictionary, entry.index, entry.subindex, value),
            is_held,
        )
        for entry, value in zip(mapping.components, values, strict=True)
    )
    texts = [
        f"{_name_of(entry, label)} = {shown.text}"
        for entry, label, shown in zip(mapping.components, mapping.labels, objects, strict=True)
    ]
    if size > mapping.byte_length:
        texts.append(
            f"longer than its mapping of {mapping.byte_length} bytes: {frame.data[mapping.byte_length :].hex(' ')} left over"
        )
    return Meaning(pdo.name, pdo.node_id, ", ".join(texts), objects)


def _name_of(entry: MappedEntry, label: str) -> str:
    """Return an object's label; with its index and subindex too, if several objects of the PDO have that name."""
    return label if label == entry.name else f"{label} {entry.name}"


def _of_remote(frame: Frame, function: int, node_id: int) -> Meaning:
    if function == ERROR_CONTROL and node_id:
        return Meaning("guarding", node_id, "the master asks for the state")
    if node_id and function >> 7 in _PDO_FUNCTIONS and TPDO1 <= function <= TPDO4:
        return Meaning(_pdo_name(function), node_id, "requested by a remote frame")
    return Meaning("?", 0, f"a remote frame, {frame.dlc} bytes")


def _of_nmt(data: bytes) -> Meaning:
    if len(data) < 2:
        return Meaning("NMT", 0, f"too short: {data.hex(' ') or 'no data'}")
    command, node_id = data[0], data[1]
    words = _NMT_WORDS.get(NmtCommand(command)) if command in set(NmtCommand) else None
    whom = "all nodes" if node_id == 0 else f"node {node_id}"
    return Meaning("NMT", node_id if node_id <= MAX_NODE_ID else 0, f"{words or f'unknown command 0x{command:02X}'}: {whom}")


def _of_error_control(node_id: int, data: bytes) -> Meaning:
    if len(data) != 1:
        return Meaning("heartbeat", node_id, f"of a wrong length: {data.hex(' ') or 'no data'}")
    if data == _BOOT_UP:
        return Meaning("boot-up", node_id, "")
    state = data[0] & ~_TOGGLE
    word = NmtState(state).name.lower().replace("_", "-") if state in set(NmtState) else f"unknown state 0x{state:02X}"
    return Meaning("guarding" if data[0] & _TOGGLE else "heartbeat", node_id, word)


def _emergency_text(data: bytes) -> str:
    if len(data) < 3:
        return f"too short: {data.hex(' ') or 'no data'}"
    code = data[0] | data[1] << 8
    register = f"error register 0x{data[2]:02X}"
    names = register_names(data[2])
    if names:
        register += f" ({', '.join(names)})"
    rest = f", {data[3:].hex(' ')}" if any(data[3:]) else ""
    return f"0x{code:04X} {error_text(code)}, {register}{rest}"


def _time_text(data: bytes) -> str:
    try:
        return str(time_of(data[:6]))
    except ValueRangeError:
        return f"not a time: {data.hex(' ') or 'no data'}"
