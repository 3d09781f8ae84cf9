"""What a machine looks like, as plain data that JSON can carry: nodes, drives, chains, objects, values, events, errors.

The page and an assistant's tools show the same things, so they are made here. Nothing is sent: all of it was heard before.
A string of a device is a value like any other; whoever shows it has to treat it as text.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

from canopen_gateway.errors import first_line
from canopen_gateway.service import GatewayService, HeardOnNet
from canopen_gateway.values import decoded
from canopen_master import Chain, Device, Master, MasterError
from canopen_proto import LocalProtocolError, NodeGuardingLost
from canopen_proto.abort import text_of
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.objects import Variable
from canopen_proto.drives.axis.reasons import reasons
from canopen_proto.drives.axis.view import DriveView, view_of
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.error_codes import error_text
from canopen_proto.explained import Explained
from canopen_proto.gateway import GatewayCode, GatewayNews, NodeReport
from canopen_proto.machine import SECOND, Time
from canopen_proto.nmt import NmtState

Plain: TypeAlias = "dict[str, Any]"

STATE_WORDS: Final = {
    NmtState.INITIALISING: "initialising",
    NmtState.STOPPED: "stopped",
    NmtState.OPERATIONAL: "operational",
    NmtState.PRE_OPERATIONAL: "pre-operational",
}
NOT_HEARD: Final = "not heard"
HEARTBEAT_WORDS: Final = {
    int(GatewayCode.HEARTBEAT_LOST): "its heartbeat is lost",
    int(GatewayCode.HEARTBEAT_STARTED): "its heartbeat has begun",
}
MAX_BYTES_SHOWN: Final = 4096
"""Bytes of a value that are shown in hexadecimal."""


def state_words(state: NmtState | None) -> str:
    """Return an NMT state in words. state: None: never heard."""
    return NOT_HEARD if state is None else STATE_WORDS[state]


def net_data(service: GatewayService, net: str) -> Plain:
    """Return a bus: its name, its state, its bits so far; and what is heard there, by `node_data`."""
    bus = service.master.bus(net)
    return {
        "net": service.nets.index(net) + 1,
        "name": net,
        "state": bus.state.value,
        "outage": bus.network.outage,
        "bitrate": bus.bitrate,
        "bits": bus.bits,
        "nodes": [node_data(service.master, net, node_id) for node_id in node_ids(service.master, net)],
    }


def node_ids(master: Master, net: str) -> list[int]:
    """Return the node-IDs that were heard on a bus, and those of the machine, in order."""
    known = {node.node_id for node in master.nodes.values() if node.bus == net}
    known |= {device.node.node_id for device in master.devices.values() if device.node.bus == net}
    return sorted(known | {*master.bus(net).network.heard_nodes()})


def names_of_nodes(master: Master, net: str) -> dict[str, str]:
    """Return the names that the machine has for nodes of a bus, by node-ID."""
    found = {node.node_id for node in master.nodes.values() if node.bus == net and node.name}
    found |= {device.node.node_id for device in master.devices.values() if device.node.bus == net}
    return {str(node_id): name for node_id in sorted(found) if (name := name_of_node(master, net, node_id))}


def name_of_node(master: Master, net: str, node_id: int) -> str:
    """Return the name that the machine has for a node: that of its drives, else its own; "" if there is none."""
    names = [each.name for each in master.devices.values() if _is_at(each.node, net, node_id)]
    return ", ".join(names or [each.name for each in master.nodes.values() if _is_at(each, net, node_id)])


def node_data(master: Master, net: str, node_id: int) -> Plain:
    """Return a node: its name, its state in words, since when it was not heard, and its drives."""
    heard = master.bus(net).network.heard(node_id)
    drives = [each for each in master.devices.values() if _is_at(each.node, net, node_id)]
    states = {each.nmt_state for each in drives}
    state = heard.state if heard.state is not None or not drives else states.pop()
    return {
        "node": node_id,
        "name": name_of_node(master, net, node_id),
        "state": state_words(state),
        "age": _age(master, heard.time),
        "heard": None if heard.service is None else heard.service.value,
        "emergency": None if heard.emcy is None or not heard.emcy.error_code else _emergency(heard.emcy.error_code),
        "drives": [device_data(each) for each in drives],
    }


def device_data(device: Device) -> Plain:
    """Return a drive of the machine: its state, what it does, and why it does not move."""
    return {
        **view_data(view_of(device.axis)),
        "name": device.name,
        "axis": device.axis.number,
        "position": device.position,
        "velocity": device.velocity,
        "unit": _unit_of(device),
        "homed": device.is_homed,
    }


def view_data(view: DriveView) -> Plain:
    """Return what a drive shows, with the reasons why it does not move, the first obstacle first."""
    return {
        "state": str(view.state),
        "mode": None if view.mode is None else mode_name(view.mode),
        "statusword": view.statusword if view.is_heard else None,
        "shown": view.describe(),
        "error": _emergency(view.error_code) if view.error_code else None,
        "reasons": [{"what": each.what, "remedy": each.remedy} for each in reasons(view)],
    }


def chain_data(chain: Chain) -> Plain:
    """Return a chain: its state, and where its joints are."""
    joints = [
        {
            "name": device.name,
            "node": device.node.node_id,
            "bus": device.node.bus,
            "position": device.position,
            "velocity": device.velocity,
            "unit": _unit_of(device),
            "state": str(device.state),
            "speed": device.limits.speed.value,
            "homed": device.is_homed,
        }
        for device in chain.devices
    ]
    return {"name": chain.name, "state": chain.state.value, "missed": chain.missed_cycles, "joints": joints}


def lease_data(service: GatewayService) -> Plain:
    """Return who moves the machine."""
    lease = service.lease
    owner = None if lease.owner is None else lease.owner.name
    return {"owner": owner, "left": round(lease.left, 3), "doing": lease.doing, "problem": lease.problem}


def object_data(dictionary: ObjectDictionary, variable: Variable) -> Plain:
    """Return the description of an object; "path" is its name in requests."""
    return {
        "path": place_text(variable.index, variable.subindex),
        "name": variable.name if ":" in variable.name else _whole_name(dictionary, variable),
        "type": variable.data_type.name,
        "access": str(variable.access),
        "unit": variable.unit,
        "constants": [each.name for each in dictionary.constants_of(variable)],
    }


def place_text(index: int, subindex: int) -> str:
    """Return a place as it is named in requests: "6041:00"."""
    return f"{index:04X}:{subindex:02X}"


def value_data(dictionary: ObjectDictionary, index: int, subindex: int, data: bytes) -> Plain:
    """Return a value that was read: as its type has it, in words, and its bytes. data: as on the wire, little-endian."""
    variable = dictionary.get(index, subindex)
    plain: Plain = {"path": place_text(index, subindex), "size": len(data), "hex": data[:MAX_BYTES_SHOWN].hex(" ")}
    if variable is None:
        return {**plain, "name": "", "type": "", "value": None, "unit": "", "constants": []}
    value = decoded(dictionary, index, subindex, data)
    shown = {"value": plain_value(value), "constants": list(dictionary.names_of(variable, value))}
    return {**plain, **object_data(dictionary, variable), **shown}


def plain_value(value: Value | None) -> int | float | str | None:
    """Return a value for JSON: bytes in hexadecimal, cut after MAX_BYTES_SHOWN."""
    if isinstance(value, bytes | bytearray):
        return bytes(value[:MAX_BYTES_SHOWN]).hex(" ")
    return value if value is None or isinstance(value, int | float | str) else str(value)


def event_data(service: GatewayService, heard: HeardOnNet, time: float) -> Plain:
    """Return an event of a net. time: seconds since 1970, when it was heard."""
    event = heard.event
    plain: Plain = {"time": round(time, 3), "net": service.nets.index(heard.net) + 1, "node": event.node_id}
    if isinstance(event, NodeGuardingLost):
        return {**plain, "kind": "lost", "text": "it does not answer node guarding"}
    if not isinstance(event, NodeReport):
        return {**plain, "kind": "pdo", "text": f"PDO {event.number}"}
    match event.kind, event.numbers:
        case GatewayNews.EMCY, (code, register, *rest):
            vendor = bytes(rest).hex(" ")
            plain |= {"kind": "emergency", **_emergency(code), "register": register, "vendor": vendor}
            return plain | {"text": plain["text"] if code & 0xFF00 else "no error any more"}
        case GatewayNews.BOOT_UP, _:
            return {**plain, "kind": "boot-up", "text": "it has booted"}
        case GatewayNews.STATE, (state,):
            return {**plain, "kind": "state", "text": state_words(NmtState(state))}
        case _, (code, *_):
            is_lost = code == GatewayCode.HEARTBEAT_LOST
            return {**plain, "kind": "lost" if is_lost else "state", "text": HEARTBEAT_WORDS.get(code, f"event {code}")}
        case _:
            return {**plain, "kind": "other", "text": event.kind.value}


def error_data(error: Exception) -> Plain:
    """Return an error: its code, its first line, the rest, and the abort code of the device if it refused."""
    abort = getattr(error, "abort_code", None)
    if isinstance(error, Explained):
        plain = {"code": error.code, "text": error.failed, "details": [f"{label} {text}" for label, text in error.details()]}
    else:
        plain = {"code": "", "text": first_line(error), "details": []}
    return plain if abort is None else {**plain, "abort": f"0x{abort:08X}", "abort_text": text_of(abort)}


EXPECTED: Final = (MasterError, LocalProtocolError, ValueError, KeyError)
"""What a request may end with, beside the errors of a gateway itself."""


def _is_at(node: Any, net: str, node_id: int) -> bool:
    return bool(node.bus == net and node.node_id == node_id)


def _age(master: Master, time: Time | None) -> float | None:
    return None if time is None else round((master.now() - time) / SECOND, 2)


def _unit_of(device: Device) -> str:
    """Return the unit of a drive's positions; "" for one that was given a scale and no name."""
    unit = device.axis.settings.unit
    if unit is None:
        return "" if device.axis.scale.is_known else "counts"
    return unit.value


def _emergency(code: int) -> Plain:
    return {"code": f"0x{code:04X}", "text": error_text(code)}


def _whole_name(dictionary: ObjectDictionary, variable: Variable) -> str:
    holder = dictionary.objects.get(variable.index)
    if holder is None or len(holder.variables) == 1:
        return variable.name
    return f"{holder.name}:{variable.name}"
