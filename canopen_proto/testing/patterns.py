"""Patterns: which frames are meant, in the words of CANopen: "the SDO answers of node 5", "controlword = 0x000F to node 5".

    sdo_write(5, "controlword", 0x0F)     heartbeat(5)      nmt("start", 5)      any_frame()      can_frame("605#40")

A fault takes a pattern to say which frames it hits, an assertion to say what was seen. A pattern is a plain value: it can be
compared, printed and kept. PDOs, emergencies, heartbeats and SDOs are those of the predefined connection set (CiA 301 v4.2.0,
7.3.3). A pattern of an object needs the dictionary of its node for a name; an index needs none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from canopen_proto.abort import text_of
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, ObjectDictionary, ObjectNotFoundError, Variable
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.dictionary.standard import STANDARD, find_standard
from canopen_proto.frame import (
    EMCY,
    ERROR_CONTROL,
    NMT,
    RPDO1,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TPDO1,
    Frame,
)
from canopen_proto.machine import LocalProtocolError, check_node_id
from canopen_proto.multiplexer import mux, mux_text, place_of
from canopen_proto.nmt import STATE_OF_BYTE, NmtCommand, NmtState
from canopen_proto.sdo.codec import ABORT, REQUESTS, SIZE_BIT, SdoFrame, expedited_data, mux_in, number_in

Names: TypeAlias = Callable[[int], "ObjectDictionary | None"]
"""Returns the dictionary of a node-ID, or None."""

_PDO_STEP: Final = 0x100
_PDOS: Final = 4
_BEGINNINGS: Final = {
    "sdo write": (SdoFrame.DOWNLOAD, SdoFrame.BLOCK_DOWNLOAD),
    "sdo read": (SdoFrame.UPLOAD, SdoFrame.BLOCK_UPLOAD),
}
_STANDARD_NAMES: Final = {name: variable for variable in STANDARD.values() for name in variable.names}


@dataclass(frozen=True, slots=True)
class Pattern:
    """See this module's text; made by the functions below. service: the kind of frame. node_id: 0 means any node.

    key: an object. value: of the object, or None for any. number: of a PDO; an NMT command or state, an error or abort code; -1
    means any. text: of `can_frame`, or of a whole frame, as candump writes it.
    """

    service: str
    node_id: int = 0
    key: Key | None = None
    value: Value | None = None
    number: int = -1
    text: str = ""

    def __post_init__(self) -> None:
        __tracebackhide__ = True
        if self.node_id != 0:
            check_node_id(self.node_id)

    def check(self, names: Names) -> None:
        """Look whether the object, and the value, are some of the node. Does nothing if the node is not known yet.

        Raises ObjectNotFoundError, which names similar ones; ValueRangeError.
        """
        __tracebackhide__ = True
        if self.key is not None and names(self.node_id) is not None:
            self.variable(names)
            self.data(names)

    def fits(self, frame: Frame, names: Names = lambda node_id: None) -> bool:
        """Whether a frame is meant. names: for the objects of nodes."""
        fits: bool = _FITS[self.service](self, frame, names)
        return fits

    def variable(self, names: Names) -> Variable:
        """Return the object that is meant. Raises ObjectNotFoundError for a name that nothing knows."""
        assert self.key is not None
        return _variable(self.node_id, self.key, names)

    def data(self, names: Names) -> bytes | None:
        """Return the bytes of the value that is meant; None for any."""
        if self.value is None:
            return None
        if isinstance(self.value, bytes):
            return self.value
        variable, dictionary = self.variable(names), names(self.node_id)
        return variable.encode(self.value if dictionary is None else dictionary.value_from(variable, self.value))

    def __str__(self) -> str:
        of = f" of node {self.node_id}" if self.node_id else ""
        to = f" to node {self.node_id}" if self.node_id else ""
        value = "" if self.value is None else f" = {_value_text(self.value)}"
        match self.service:
            case "any":
                return "any frame"
            case "frame" | "whole frame":
                return f"the frame {self.text}"
            case "nmt":
                command = "any NMT command" if self.number < 0 else f"NMT command {_words(NmtCommand(self.number))}"
                return f"{command}{to or ' to all nodes'}"
            case "sync":
                return "SYNC"
            case "tpdo" | "rpdo":
                return f"{self.service.upper()} {self.number}{of}"
            case "heartbeat" if self.number >= 0:
                return f"heartbeat{of}, {_words(NmtState(self.number))}"
            case "emcy" if self.number >= 0:
                return f"emergency 0x{self.number:04X}{of}"
            case "emcy":
                return f"an emergency{of}"
            case "sdo abort" if self.number >= 0:
                return f"SDO abort 0x{self.number:08X} ({text_of(self.number)}){of}"
            case "sdo write":
                return f"SDO write of {key_text(self.key)}{value}{to}"
            case "sdo read":
                return f"SDO read of {key_text(self.key)}{of}"
            case "sdo request":
                return f"an SDO request{to}"
            case "sdo answer":
                return f"an SDO answer{of}"
            case _:
                return f"{self.service}{of}"


# ---- the patterns ----


def as_pattern(meant: object) -> Pattern:
    """Return what a test gives for a pattern: a `Frame` means that one as a whole, a text as candump writes it is a `can_frame`.

    Raises LocalProtocolError, ValueError for text that is no frame.
    """
    __tracebackhide__ = True
    if isinstance(meant, Pattern):
        return meant
    if isinstance(meant, Frame):
        return Pattern("whole frame", text=str(meant))
    if isinstance(meant, str):
        return can_frame(meant)
    if callable(meant) and getattr(meant, "__name__", "").startswith("test"):
        raise LocalProtocolError("a marker takes faults, and no class of them: canopen_faults(Lose(...))")
    called = f": call it, {getattr(meant, '__name__', '')}(...)" if getattr(meant, "__module__", "") == __name__ else ""
    raise LocalProtocolError(f'{meant!r} is no pattern of frames, such as heartbeat(5) or "705#05"{called}')


def any_frame() -> Pattern:
    """Any frame."""
    return Pattern("any")


def can_frame(text: str) -> Pattern:
    """A frame as candump writes it, or its beginning: "605#40", "123#". Raises ValueError if it is none."""
    return Pattern("frame", text=str(Frame.parse(text)))


def nmt(command: NmtCommand | str | None = None, node_id: int = 0) -> Pattern:
    """An NMT command: a NmtCommand or its name, such as "start" or "reset_node"; None: any. node_id: 0: the one to all nodes."""
    return Pattern("nmt", node_id, number=-1 if command is None else _command(command))


def sync() -> Pattern:
    """SYNC."""
    return Pattern("sync")


def emcy(node_id: int = 0, code: int | None = None) -> Pattern:
    """An emergency. code: its error code; 0: the end of all errors; None: any."""
    return Pattern("emcy", node_id, number=-1 if code is None else code)


def tpdo(node_id: int, number: int = 1) -> Pattern:
    """A PDO that a node sends, 1..4."""
    __tracebackhide__ = True
    return _pdo("tpdo", node_id, number)


def rpdo(node_id: int, number: int = 1) -> Pattern:
    """A PDO to a node, 1..4."""
    __tracebackhide__ = True
    return _pdo("rpdo", node_id, number)


def heartbeat(node_id: int = 0, state: NmtState | None = None) -> Pattern:
    """A heartbeat. state: the NMT state that it shows; None: any. A boot-up is none."""
    return Pattern("heartbeat", node_id, number=-1 if state is None else int(state))


def boot_up(node_id: int = 0) -> Pattern:
    """A boot-up."""
    return Pattern("boot-up", node_id)


def sdo_request(node_id: int = 0) -> Pattern:
    """Any frame of a client to a node's SDO server."""
    return Pattern("sdo request", node_id)


def sdo_answer(node_id: int = 0) -> Pattern:
    """Any frame of a node's SDO server."""
    return Pattern("sdo answer", node_id)


def sdo_write(node_id: int, key: Key, value: Value | None = None) -> Pattern:
    """The beginning of an SDO download of an object. value: with this value; None: any.

    A value that goes in segments or blocks, as one of more than four bytes does, has no frame of its own: only assertions know
    it, by the frame that confirms it.
    """
    return Pattern("sdo write", check_node_id(node_id), key, value)


def sdo_read(node_id: int, key: Key) -> Pattern:
    """The beginning of an SDO upload of an object."""
    return Pattern("sdo read", check_node_id(node_id), key)


def sdo_abort(node_id: int = 0, code: int | None = None) -> Pattern:
    """An abort of an SDO transfer, by either side. code: 32 bits; None: any."""
    return Pattern("sdo abort", node_id, number=-1 if code is None else code)


def _pdo(service: str, node_id: int, number: int) -> Pattern:
    __tracebackhide__ = True
    if not 1 <= number <= _PDOS:
        raise LocalProtocolError(f"PDO {number} is not in the predefined connection set, which has 1..{_PDOS}: use can_frame")
    return Pattern(service, check_node_id(node_id), number=number)


def _command(command: NmtCommand | str) -> NmtCommand:
    if isinstance(command, NmtCommand):
        return command
    name = command.upper().replace("-", "_").replace(" ", "_")
    if name not in NmtCommand.__members__:
        known = ", ".join(each.lower() for each in NmtCommand.__members__)
        raise LocalProtocolError(f"{command!r} is no NMT command: {known}")
    return NmtCommand[name]


# ---- what fits ----


def _node(base: int, frame: Frame, pattern: Pattern) -> bool:
    """Whether a frame has the identifier of the node that is meant, in this function of the predefined connection set."""
    key = frame.key
    return key == base + pattern.node_id if pattern.node_id else base < key < base + 0x80


def _fits_frame(pattern: Pattern, frame: Frame, names: Names) -> bool:
    return str(frame).startswith(pattern.text)


def _fits_whole_frame(pattern: Pattern, frame: Frame, names: Names) -> bool:
    return str(frame) == pattern.text


def _fits_nmt(pattern: Pattern, frame: Frame, names: Names) -> bool:
    data = frame.data
    return frame.key == NMT and len(data) == 2 and data[1] == pattern.node_id and pattern.number in (-1, data[0])


def _fits_emcy(pattern: Pattern, frame: Frame, names: Names) -> bool:
    is_it = _node(EMCY, frame, pattern) and len(frame.data) >= 2
    return is_it and pattern.number in (-1, int.from_bytes(frame.data[:2], "little"))


def _fits_pdo(pattern: Pattern, frame: Frame, names: Names) -> bool:
    base = TPDO1 if pattern.service == "tpdo" else RPDO1
    return frame.key == base + _PDO_STEP * (pattern.number - 1) + pattern.node_id


def _fits_heartbeat(pattern: Pattern, frame: Frame, names: Names) -> bool:
    is_it = _node(ERROR_CONTROL, frame, pattern) and len(frame.data) == 1 and frame.data != b"\0"
    return is_it and (pattern.number < 0 or STATE_OF_BYTE[frame.data[0]] == pattern.number)


def _fits_object(pattern: Pattern, frame: Frame, names: Names) -> bool:
    data = frame.data
    if not _node(SDO_CLIENT_TO_SERVER, frame, pattern) or len(data) < 4:
        return False
    asked = REQUESTS[data[0]]
    if asked not in _BEGINNINGS[pattern.service] or mux_in(data) != pattern.variable(names).mux:
        return False
    wanted = pattern.data(names)
    written = expedited_data(data) if asked is SdoFrame.DOWNLOAD else None
    if wanted is None or written is None:
        return wanted is None
    return written == wanted if data[0] & SIZE_BIT else bool(wanted) and written.startswith(wanted)  # the device knows its size


def _fits_abort(pattern: Pattern, frame: Frame, names: Names) -> bool:
    is_it = _node(SDO_CLIENT_TO_SERVER, frame, pattern) or _node(SDO_SERVER_TO_CLIENT, frame, pattern)
    if not is_it or len(frame.data) < 8 or frame.data[0] != ABORT:
        return False
    return pattern.number in (-1, number_in(frame.data))


_FITS: Final[dict[str, Callable[[Pattern, Frame, Names], bool]]] = {
    "any": lambda pattern, frame, names: True,
    "frame": _fits_frame,
    "whole frame": _fits_whole_frame,
    "nmt": _fits_nmt,
    "sync": lambda pattern, frame, names: frame.key == SYNC,
    "emcy": _fits_emcy,
    "tpdo": _fits_pdo,
    "rpdo": _fits_pdo,
    "heartbeat": _fits_heartbeat,
    "boot-up": lambda pattern, frame, names: _node(ERROR_CONTROL, frame, pattern) and frame.data == b"\0",
    "sdo request": lambda pattern, frame, names: _node(SDO_CLIENT_TO_SERVER, frame, pattern),
    "sdo answer": lambda pattern, frame, names: _node(SDO_SERVER_TO_CLIENT, frame, pattern),
    "sdo write": _fits_object,
    "sdo read": _fits_object,
    "sdo abort": _fits_abort,
}


def _variable(node_id: int, key: Key, names: Names) -> Variable:
    """Return the object that a key means to a node; without a dictionary of it, that of the standards."""
    dictionary = names(node_id)
    if dictionary is not None and key in dictionary:
        return dictionary.variable(key)
    if isinstance(key, Variable):
        return key
    if isinstance(key, str):
        found = _STANDARD_NAMES.get(key)
    else:
        found = find_standard(*(key if isinstance(key, tuple) else place_of(key)))
    if found is None:
        known = [] if dictionary is None else [name for each in dictionary for name in each.names]
        similar = did_you_mean(key, [*known, *_STANDARD_NAMES]) if isinstance(key, str) else ""
        raise ObjectNotFoundError(
            f"{key_text(key)} is no object of node {node_id} nor of CiA 301 and CiA 402{similar or ': give (index, subindex)'}"
        )
    return found


def _words(member: NmtCommand | NmtState) -> str:
    return member.name.lower().replace("_", " ")


def _value_text(value: Value) -> str:
    return f"0x{value:X} ({value})" if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else repr(value)


def key_text(key: Key | None) -> str:
    """Return an object for people: its name or label, or 0x1018:01."""
    if isinstance(key, Variable):
        return key.label
    if isinstance(key, tuple):
        return mux_text(mux(*key))
    return mux_text(mux(*place_of(key))) if isinstance(key, int) else str(key)
