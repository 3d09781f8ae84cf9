"""`get_object` and `set_object`: the objects of nodes by SDO, with the fields of ros_canopen's services."""

from __future__ import annotations

import re
from typing import Final

from canopen_master.errors import CHAIN_NOT_READY, UNKNOWN_CHAIN, ChainError, UnknownChainError
from canopen_master.master import Master
from canopen_master.node import Node
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axis_of, swapped
from canopen_proto.multiplexer import Mux, mux_text
from canopen_ros.reply import COMMAND_ERRORS, Reply

_SUB: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})(?:sub|:)([0-9A-Fa-f]{1,2})!?")
"""ros_canopen's names: 6041sub0; and ours: 6041:00."""

_COMMANDING: Final = (
    objects.CONTROLWORD, objects.MODES_OF_OPERATION, *SET_POINT_OF.values(),
)  # fmt: skip
"""Objects that move a drive, or change how it moves."""


async def get_object(master: Master, node: str, key: str, cached: bool) -> Reply:
    """See `Bridge.get_object`."""
    try:
        master.check_open()
        where = _node_of(master, node)
        variable = where.dictionary.variable(_key_of(key))
        value = where.remote.values.store.get(variable.mux) if cached else None
        if value is None or variable.mux not in where.remote.heard_at:
            value = await where.read((variable.index, variable.subindex))
    except COMMAND_ERRORS as error:
        return Reply(False, str(error))
    return Reply(True, "", shown(value))


async def set_object(master: Master, node: str, key: str, text: str, cached: bool) -> Reply:
    """See `Bridge.set_object`."""
    try:
        master.check_open()
        where = _node_of(master, node)
        variable = where.dictionary.variable(_key_of(key))
        _require_no_motion(master, where, variable.mux)
        value = where.dictionary.value_from(variable, _value_of(text))
        if cached and variable.mux in where.remote.heard_at and where.remote.values.store.get(variable.mux) == value:
            return Reply(True, f"it has the value {shown(value)}")
        await where.write((variable.index, variable.subindex), value)
    except COMMAND_ERRORS as error:
        return Reply(False, str(error))
    return Reply(True, "")


def shown(value: Value) -> str:
    """Return a value as text: a number, text, or bytes in hexadecimal."""
    return bytes(value).hex() if isinstance(value, bytes | bytearray) else str(value)


def _key_of(key: str) -> str:
    match = _SUB.fullmatch(key)
    return key if match is None else f"{match[1]}:{int(match[2], 16):02X}"


def _value_of(text: str) -> Value:
    """Return a number if the text is one, else the text: a constant by its name, or the value of an object that holds text."""
    for kind in (lambda: int(text, 0), lambda: float(text)):
        try:
            return kind()
        except ValueError:
            continue
    return text


def _node_of(master: Master, name: str) -> Node:
    """Return the node of this name, or of the joint of this name."""
    joints = {device.name: device.node for chain in master.chains.values() for device in chain.devices}
    known = {**joints, **master.nodes}
    if name not in known:
        failed = f"there is no node or joint {name!r}{did_you_mean(name, known)}"
        raise UnknownChainError(UNKNOWN_CHAIN, failed, seen=f"there are {', '.join(known)}")
    return known[name]


def _require_no_motion(master: Master, node: Node, mux: Mux) -> None:
    """Raise for an object that commands a joint of a chain: the services, which check what may move, do that."""
    axis = axis_of(mux)
    if axis is None or swapped(mux, axis) not in _COMMANDING:
        return
    for chain in master.chains.values():
        for device in chain.devices:
            if device.node is node and device.axis.number == axis:
                failed = f"{device.name} is a joint of chain {chain.name}: {mux_text(mux)} is not written by hand"
                raise ChainError(CHAIN_NOT_READY, chain.name, failed, joint=device.name, tries=(f"{chain.name}/init ...",))
