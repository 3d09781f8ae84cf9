"""ros_canopen's parameters: `bus`, `sync`, `heartbeat`, `name`, `defaults` and `nodes`, of one file or of several.

Source: ros_canopen (canopen_chain_node, canopen_motor_node), its wiki pages and defaults.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from canopen_master.ros_configurations.draft import BUS, NO_SCALE, TORQUE, DeviceDraft, Draft, Setting, is_interpolation_time
from canopen_master.ros_configurations.report import YamlSection, section_of
from canopen_master.ros_configurations.scale import ContradictionError, JointKeys, position_keys, velocity_keys
from canopen_master.ros_configurations.unit_expression import Line, NotLinearError, read_expression
from canopen_master.ros_configurations.yaml_text import Value
from canopen_proto.drives.cia402.objects import CONTROLWORD, POSITION_ACTUAL_VALUE, VELOCITY_ACTUAL_VALUE
from canopen_proto.machine import MILLISECOND
from canopen_proto.multiplexer import index_of, mux, split_mux
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator

DEFAULTS: Final = {
    "pos_to_device": "rint(rad2deg(pos)*1000)",
    "pos_from_device": "deg2rad(obj6064)/1000",
    "vel_to_device": "rint(rad2deg(vel)*1000)",
    "vel_from_device": "deg2rad(obj606C)/1000",
}
"""The unit of a configuration without a conversion: millidegrees, as Schunk's arms have them."""
_VARIABLES: Final = {"pos_to_device": "pos", "vel_to_device": "vel"}
_OBJECTS: Final = {"pos_from_device": index_of(POSITION_ACTUAL_VALUE), "vel_from_device": index_of(VELOCITY_ACTUAL_VALUE)}
_OBJECT: Final = re.compile(r"obj([0-9A-Fa-f]{4})(?:sub0*)?")
_OVERLAY: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{1,4})(?:sub(?:0x)?([0-9A-Fa-f]{1,2}))?")
_CANSEND: Final = re.compile(r"7([0-9A-Fa-f]{2})#(?:0?5)")
_EFFORTS: Final = ("eff_to_device", "eff_from_device")
_LOGS: Final = ("log", "log_warn", "log_error")
_LOGGED: Final = "diagnostics show state, statusword, 0x603F and EMCY"
_FILTERS: Final = ("position_filters", "velocity_filters", "effort_filters")
_BRAKE_TEST: Final = (
    "a safety function of Pilz's arms: prbt_hardware_support has the drive test its brake. Nothing here does; the test is still "
    "due, by the maker's own means"
)
"""Source: pilz_robots, canopen_braketest_adapter.h of prbt_hardware_support."""
MILLISECONDS: Final = (1, 60_000)
"""Of a cycle."""


def is_ros_canopen(top: Mapping[str, Value]) -> bool:
    """Return whether these top-level keys are ros_canopen's."""
    nodes = top.get("nodes")
    named = [] if nodes is None else [*nodes.entries.values(), *nodes.items]
    return bool(top.keys() & {"bus", "sync", "heartbeat"}) or any("id" in each.entries for each in named)


def take_ros_canopen(top: YamlSection, draft: Draft) -> None:
    """Take over a whole configuration. Raises DictionaryError."""
    report = draft.report
    _take_bus(section_of(top.take("bus"), report), draft)
    _take_sync(section_of(top.take("sync"), report), draft)
    _take_heartbeat(section_of(top.take("heartbeat"), report), draft)
    if (name := top.take("name")) is not None:
        draft.chain = draft.name(name, name.string())
        report.taken(name, f"the chain {draft.chain!r}")
    defaults = section_of(top.take("defaults"), report)
    for key, value in _named_nodes(top.take("nodes")):
        node = section_of(value, report, defaults)
        _take_node(key, value, node, draft)
        node.close()
    defaults.close()
    top.not_needed({"hardware_id": "diagnostics name the chain", "reset_errors_before_recover": "`recover` resets a fault first"})


def _named_nodes(nodes: Value | None) -> Iterator[tuple[str, Value]]:
    """Return the nodes with their names: a map of them, or a list of maps with `name`."""
    if nodes is None or nodes.kind == "null":
        return
    nodes.check("map", "list")
    for key, value in nodes.entries.items():
        value.check("map")
        yield key, value
    for value in nodes.items:
        value.check("map")
        if "name" not in value.entries:
            raise value.failure("it has no name")
        yield value.entries["name"].string(), value


def _take_bus(bus: YamlSection, draft: Draft) -> None:
    report = draft.report
    device = bus.take("device")
    if draft.choices.locator:
        if device is not None:
            report.not_needed(device, f"the bus is {draft.choices.locator}, as you say")
    elif device is None:
        report.assumed("bus.device", f"the bus {BUS}, ros_canopen's default; --locator names another one")
    else:
        draft.bus["locator"] = device.string()
        try:
            parse_locator(device.string())
        except TransportError as error:
            raise device.failure(f"{error.failed}: {error.seen}") from None
        report.taken(device, f"the bus {device.string()}")
    if (plugin := bus.take("driver_plugin")) is not None:
        if "SocketCAN" in plugin.string():
            report.not_needed(plugin, "a plain name such as can0 is SocketCAN")
        else:
            report.left_out(plugin, "this driver is not known; --locator names a bus, see docs/buses.md")
    bus.not_needed(
        {
            "loopback": "a transport does not receive its own frames, and other programs do",
            "master_allocator": "there is one kind of master",
        }
    )
    bus.close()


def _take_sync(sync: YamlSection, draft: Draft) -> None:
    if (interval := sync.take("interval_ms")) is not None:
        draft.take_cycle(interval, interval.integer(*MILLISECONDS) * MILLISECOND if interval.number() else 0)
    draft.take_overflow(sync.take("overflow"))
    sync.not_needed({"update_ms": "drives are looked at with each SYNC and each of their PDOs"})
    sync.left_out({"silence_us": "the master's PDOs go out right after SYNC"})
    sync.close()


def _take_heartbeat(heartbeat: YamlSection, draft: Draft) -> None:
    """Take over the master's own heartbeat, by which drives notice that it is gone."""
    report = draft.report
    rate, message = heartbeat.take("rate"), heartbeat.take("msg")
    if message is not None:
        found = _CANSEND.fullmatch(message.string().strip())
        node_id = int(found[1], 16) if found is not None else 0
        if 1 <= node_id <= 127:
            draft.take_watchdog_node(message, node_id)
        else:
            report.left_out(message, "this is not the heartbeat of an operational node (7xx#05)")
    if rate is not None:
        hertz = rate.number()
        period = 1000 / hertz if hertz > 0 else None
        if period is not None and period.denominator == 1 and 1 <= period <= 30_000:
            draft.take_watchdog_period(rate, int(period))
        else:
            report.left_out(rate, f"a heartbeat comes each whole number of ms, and {rate} in a second do not")
    heartbeat.close()


def _take_node(key: str, value: Value, node: YamlSection, draft: Draft) -> None:
    report = draft.report
    number = node.take("id")
    if number is None:
        raise value.failure("it has no id (node-ID)")
    named = node.take("name")
    wanted = key if named is None else named.string()
    name = draft.name(value if named is None else named, wanted)
    entry: dict[str, Any] = {"id": number.integer(1, 127)}
    report.taken(number, f"the node and joint {name!r}, id = {entry['id']}")
    if named is not None:
        report.taken(named, "the name of the node and its joint")
    package, eds = node.take("eds_pkg"), node.take("eds_file")
    if package is not None:
        report.not_needed(package, "the device's file is named by its path")
    file = None
    if eds is not None:
        file = draft.device_file(eds, eds.string(), "" if package is None else package.string())
    else:
        report.missing(f"nodes.{key}.eds_file", "the node has no file: objects are those of the data files")
    draft.add_device(value, name, DeviceDraft(entry, file, eds, _overlay(node, draft)))
    _take_joint(name, value, node, draft, is_drive=file is None or _is_drive(draft, file))
    if (test := node.take("braketest_required")) is not None and (test.kind != "bool" or test.truth()):
        report.left_out(test, _BRAKE_TEST)
    elif test is not None:
        report.not_needed(test, "the brake of this drive is not tested there either")
    node.not_needed({"motor_allocator": "every joint is a drive of CiA 402"} | dict.fromkeys(_LOGS, _LOGGED))
    node.left_out(
        {
            "publish": "no topic for single objects: the service `get_object`, or `canopen read`",
            "motor_layer": "settings of a plugin, which is not here",
        }
        | dict.fromkeys(_FILTERS, "positions, velocities and torques are published as the drive shows them")
    )


def _is_drive(draft: Draft, file: Path) -> bool:
    """Return whether a device has the controlword of CiA 402, by its file."""
    return draft.description_of(file).dictionary.get(*split_mux(CONTROLWORD)) is not None


def _take_joint(name: str, value: Value, node: YamlSection, draft: Draft, *, is_drive: bool) -> None:
    """Take over what makes a node a joint. A device that is no drive is none."""
    if not is_drive:
        node.not_needed(
            dict.fromkeys((*DEFAULTS, *_EFFORTS, "joint", "switching_state", "homing_timeout_seconds"), "the device is no drive")
        )
        draft.report.assumed(value.place, "a node, and no joint: its file has no controlword (0x6040)")
        return
    joint: dict[str, Any] = {}
    named, wanted = node.take("joint"), name
    if named is not None:  # as motor_chain.cpp has it: the name in the URDF and in /joint_states
        wanted = draft.name(named, named.string())
        draft.report.taken(named, f"the name of the joint, of the node {name!r}")
    _take_scale(value, node, joint, draft, is_linear=bool(draft.choices.linear & {name, wanted}))
    draft.take_switching_state(node, joint)
    draft.take_homing_timeout(node, joint)
    if wanted != name:
        joint["node"] = name
    draft.add_joint(value, wanted, joint)
    node.not_needed(dict.fromkeys(_EFFORTS, TORQUE))


def _overlay(node: YamlSection, draft: Draft) -> list[Setting]:
    """Return the values of `dcf_overlay`: those of the node go before those of the defaults."""
    found: dict[int, Setting] = {}
    for overlay in reversed(node.take_both("dcf_overlay")):
        if overlay is None:
            continue
        overlay.check("map")
        for key, value in overlay.entries.items():
            match = _OVERLAY.fullmatch(key)
            if match is None:
                raise value.failure("an object is an index, or index and subindex, as 6081 or 60C2sub1")
            where = mux(int(match[1], 16), int(match[2] or "0", 16))
            if is_interpolation_time(where):
                draft.report.not_needed(value, f"a chain sets 0x{index_of(where):04X} by its cycle")
            else:
                found[where] = Setting(where, value.string(), value, value)
    return list(found.values())


def _take_scale(node_value: Value, node: YamlSection, joint: dict[str, Any], draft: Draft, *, is_linear: bool) -> None:
    """Take over the conversions of position and velocity."""
    report = draft.report
    values = {key: node.take(key) for key in DEFAULTS}
    if draft.is_lost(node_value, DEFAULTS):
        for each in filter(None, values.values()):
            report.left_out(each, NO_SCALE)
        report.missing(f"{node_value.place}.pos_to_device", NO_SCALE)
        return
    lines: dict[str, Line] = {}
    for key, default in DEFAULTS.items():
        value = values[key]
        try:
            lines[key] = _line(key, default if value is None else value.string())
        except NotLinearError as error:
            assert value is not None  # the defaults are lines
            report.left_out(value, f"{error}: only a plain factor, with an offset at most, is a scale here")
    for quantity in ("pos", "vel"):
        keys = f"{quantity}_to_device", f"{quantity}_from_device"
        given = [value for key in keys if (value := values[key]) is not None]
        if not lines.keys() >= set(keys) or (quantity == "vel" and not given):
            for key in keys:
                if key in lines and (value := values[key]) is not None:
                    report.left_out(value, "its counterpart is left out")
            continue
        note = "" if len(given) == 2 else " (the other one has ros_canopen's default)"
        make = partial(_keys, quantity, lines, joint, is_linear=is_linear)
        made = draft.take_scale(joint, given, make, note)
        if made is not None and not given:
            report.assumed("pos_to_device, pos_from_device", f"{made}: ros_canopen's default, millidegrees")


def _keys(quantity: str, lines: Mapping[str, Line], joint: Mapping[str, Any], *, is_linear: bool) -> JointKeys:
    """Return the keys of a position ("pos") or velocity ("vel"). Raises ContradictionError."""
    there, back = lines[f"{quantity}_to_device"], lines[f"{quantity}_from_device"]
    if quantity == "pos":
        return position_keys(there, back, is_linear=is_linear)
    if "pos_to_device" not in lines or "unit" not in joint:
        raise ContradictionError("the position has no scale")
    return velocity_keys(lines["pos_to_device"].factor, there, back)


def _line(key: str, text: str) -> Line:
    """Return a conversion as a line of the variable that its key stands for. Raises NotLinearError."""
    line = read_expression(text)
    if key in _VARIABLES:
        if line.variable and line.variable != _VARIABLES[key]:
            raise NotLinearError(f"its variable is {line.variable}, not {_VARIABLES[key]}")
    elif line.variable:
        found = _OBJECT.fullmatch(line.variable)
        if found is None or int(found[1], 16) != _OBJECTS[key]:
            raise NotLinearError(f"it reads {line.variable}, not obj{_OBJECTS[key]:04X}")
    return line
