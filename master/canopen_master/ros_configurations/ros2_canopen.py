"""ros2_canopen's bus.yml: `options`, `master`, `defaults` and `nodes`; in older files the nodes stand at the top.

Source: ros2_canopen's documentation and drivers, and Lely's dcfgen (dcfgen/cli.py of lely-core), whose keys most of these are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from canopen_data.describing import identified
from canopen_data.durations import duration_text
from canopen_master.machine_file.keys import MODES
from canopen_master.ros_configurations.boot_keys import (
    DEFAULT_MULTIPLIER,
    HeartbeatWatch,
    settings_of_boot,
    take_boot,
    take_network,
)
from canopen_master.ros_configurations.draft import BUS, NO_SCALE, TORQUE, DeviceDraft, Draft, Setting, is_interpolation_time
from canopen_master.ros_configurations.report import ImportReport, YamlSection, section_of
from canopen_master.ros_configurations.scale import position_keys, velocity_keys
from canopen_master.ros_configurations.unit_expression import ZERO, Exact, Line, rounding_of
from canopen_master.ros_configurations.yaml_text import Value
from canopen_proto import indices
from canopen_proto.drives.cia402.axes import MAX_AXES
from canopen_proto.machine import MICROSECOND, MILLISECOND
from canopen_proto.multiplexer import index_of, mux

SCALES: Final = {
    "scale_pos_to_dev": "1000", "scale_pos_from_dev": "0.001", "scale_vel_to_dev": "1000", "scale_vel_from_dev": "0.001",
    "offset_pos_to_dev": "0", "offset_pos_from_dev": "0",
}  # fmt: skip
"""The scale of a drive that names none."""
BUS_CONFIG_PATH: Final = "@BUS_CONFIG_PATH@"
_TOP: Final = ("options", "master", "defaults", "nodes", "joint_limits")
_BOOT: Final = "the master starts each node that it uses, and drives only when a chain is initialised"
_IDENTITY: Final = "the device's file tells it; `canopen info NODE` compares"
_ROS: Final = "of ROS, not of the machine"
_PDO_BASES: Final = {"tpdo": (0x180, indices.TPDO_COMMUNICATION, indices.TPDO_MAPPINGS),
                     "rpdo": (0x200, indices.RPDO_COMMUNICATION, indices.RPDO_MAPPINGS)}  # fmt: skip
_PDO_KEYS: Final = {"tpdo": {"transmission": 2, "inhibit_time": 3, "event_timer": 5, "sync_start": 6},
                    "rpdo": {"transmission": 2, "event_deadline": 5}}  # fmt: skip
"""The keys that dcfgen writes to a PDO of this direction, and their subindices in its communication record."""


def is_ros2_canopen(top: Mapping[str, Value]) -> bool:
    """Return whether these top-level keys are those of a bus.yml."""
    nodes = top.get("nodes")
    named = [] if nodes is None else nodes.entries.values()
    return "master" in top or "options" in top or any("node_id" in each.entries for each in (*named, *top.values()))


def take_ros2_canopen(top: YamlSection, keys: Mapping[str, Value], draft: Draft) -> None:
    """Take over a whole bus.yml. keys: those of the top. Raises DictionaryError."""
    report = draft.report
    if draft.choices.locator:
        report.assumed("(the bus)", f"{draft.choices.locator}, as you say")
    else:
        report.assumed("(the bus)", f"{BUS}: a bus.yml names none (can_interface_name of the launch file does); --locator")
    options = section_of(top.take("options"), report)
    folder = _folder(options.take("dcf_path"), report)
    multiplier = options.take("heartbeat_multiplier")
    options.close()
    master = section_of(top.take("master"), report)
    consumer = master.take("heartbeat_consumer")
    is_watched = True
    if consumer is not None and consumer.kind != "bool":
        report.left_out(consumer, f"true or false is expected, not {consumer} ({consumer.kind}): it counts as true")
    elif consumer is not None:
        is_watched = consumer.truth()
    watch = HeartbeatWatch(multiplier, is_watched)
    _take_master(master, draft)
    take_network(master, draft)
    master.close()
    defaults = section_of(top.take("defaults"), report)
    for name, value in _nodes(top, keys):
        node = section_of(value, report, defaults)
        _take_node(name, value, node, draft, folder, watch)
        node.close()
    defaults.close()


def _folder(value: Value | None, report: ImportReport) -> tuple[Path, ...]:
    """Return the folder that `dcf_path` names; the one of the file itself is looked into anyway."""
    if value is None:
        return ()
    text = value.string()
    report.not_needed(value, "files are looked for beside the bus.yml and in the folders above")
    return () if text.startswith("@") or not Path(text).is_dir() else (Path(text),)


def _nodes(top: YamlSection, keys: Mapping[str, Value]) -> Iterator[tuple[str, Value]]:
    nodes = top.take("nodes")
    if nodes is not None and nodes.kind != "null":
        nodes.check("map", "list")
        yield from nodes.entries.items()
        for item in nodes.items:  # "- name: {...}", as the documentation shows it
            item.check("map")
            yield from item.entries.items()
        return
    for name, value in keys.items():
        if name.startswith("."):  # a pattern for others
            top.not_needed({name: "dcfgen leaves out names that begin with a dot"})
        elif name not in _TOP and value.kind == "map":
            top.take(name)
            yield name, value


def _take_master(master: YamlSection, draft: Draft) -> None:
    report = draft.report
    if (node_id := master.take("node_id")) is not None:
        number = node_id.integer(1, 255)
        if number <= 127:
            draft.take_watchdog_node(node_id, number)
        else:
            report.left_out(node_id, f"{number} is no node-ID: 1..127")
    if (period := master.take("heartbeat_producer")) is not None:
        ms = period.integer(0, 30_000)
        if ms:
            draft.take_watchdog_period(period, ms)
        else:
            report.left_out(period, "drives are always held by a heartbeat of the master; watchdog = false in [master] ends that")
    if (sync := master.take("sync_period")) is not None:
        draft.take_cycle(sync, sync.integer(0, 60_000_000) * MICROSECOND)
    master.into(draft.bus, "baudrate", lambda value: f"{value.integer(1, 1000)}k", "bitrate", " of the bus")
    draft.take_overflow(master.take("sync_overflow"))
    master.not_needed(
        {
            **dict.fromkeys(("driver", "package", "namespace"), _ROS),
            **dict.fromkeys(("vendor_id", "product_code", "revision_number", "serial_number"), "the master is no device"),
            **dict.fromkeys(("start", "boot_timeout_ms"), _BOOT),
            **dict.fromkeys(("emcy_inhibit_time", "sync_window", "time_cob_id"), "the master has no such object"),
            "heartbeat_consumer": "heartbeats are watched if heartbeat_timeout of [master], or of boot of a node, is set",
        }
    )
    master.left_out(
        {
            "error_behavior": "the master has no object 0x1029",
            "heartbeat_multiplier": "heartbeat_timeout of [master] is one time for all nodes",
        }
    )


def _take_node(name: str, value: Value, node: YamlSection, draft: Draft, folder: tuple[Path, ...], watch: HeartbeatWatch) -> None:
    report = draft.report
    ours = draft.name(value, name)
    dcf, own_path = node.take("dcf"), node.take("dcf_path")
    folders = (*_folder(own_path, report), *folder)
    file = None if dcf is None else draft.device_file(dcf, dcf.string().removeprefix(f"{BUS_CONFIG_PATH}/"), "", *folders)
    number = node.take("node_id")
    in_file = None if file is None else draft.description_of(file).node_id
    if number is None and (in_file is None or not 1 <= in_file <= 127):
        raise value.failure("it has no node_id")
    entry: dict[str, Any] = {"id": in_file if number is None else number.integer(1, 127)}
    driver = node.take("driver")
    is_drive = driver is not None and "402" in driver.string()
    report.taken(value if number is None else number, f"the node {ours!r}, id = {entry['id']}")
    if driver is not None:
        report.not_needed(driver, "the node is a drive: a joint" if is_drive else "no drive: a node, which is no joint")
    settings = [*settings_of_boot(node, report), *_sdo(node, report), *_pdos(node, report, int(entry["id"]))]
    if (producer := node.take("heartbeat_producer")) is not None:
        _take_heartbeat(node, producer, watch.multiplier, draft, settings)
    entry["boot"] = take_boot(node, draft, watch)
    _take_revision(value, entry["boot"], file, draft)
    draft.add_device(value, ours, DeviceDraft(entry, file, dcf, settings))
    if is_drive:
        _take_joints(ours, value, node, draft)
    node.not_needed(
        {
            **dict.fromkeys(("package", "namespace", "enable_lazy_load"), _ROS),
            **dict.fromkeys(("vendor_id", "product_code"), _IDENTITY),
            **dict.fromkeys(("period", "polling"), "drives are looked at with each SYNC and each of their PDOs"),
            "boot_timeout_ms": _BOOT,
            "diagnostics": "diagnostics are always there: at each change, and each second",
            "sdo_timeout_ms": "timeout of [master], 500 ms by default",
            "configuration_file": "the settings of a node are in its DCF",
            "heartbeat_consumer": "a drive watches the master's heartbeat: see watchdog in [master]",
        }
    )


def _take_revision(value: Value, boot: dict[str, Any], file: Path | None, draft: Draft) -> None:
    """Expect the revision of the node's file, as dcfgen does."""
    variable = None if file is None else identified(draft.description_of(file)).get(indices.IDENTITY_OBJECT, 3)
    revision = None if variable is None else variable.initial_of(0)
    if "revision" not in boot and isinstance(revision, int) and revision:
        boot["revision"] = revision
        draft.report.assumed(f"{value.place}.revision_number", f"revision = 0x{revision:08X}, as the file says")


def _sdo(node: YamlSection, report: ImportReport) -> Iterator[Setting]:
    """Return the values of `sdo`, which the master writes when the node boots."""
    requests = node.take("sdo")
    if requests is None or requests.kind == "null":
        return
    requests.check("list")
    for request in requests.items:
        request.check("map")
        own = YamlSection(request.entries, report)
        index, subindex, value = own.take("index"), own.take("sub_index"), own.take("value")
        own.close()
        if index is None or value is None:
            raise request.failure("an entry has index, sub_index and value")
        where = mux(index.integer(0x1000, 0xFFFF), 0 if subindex is None else subindex.integer(0, 255))
        if is_interpolation_time(where):
            report.not_needed(request, f"a chain sets 0x{index_of(where):04X} by its cycle")
        else:
            yield Setting(where, value.string(), request, request)


def _pdos(node: YamlSection, report: ImportReport, node_id: int) -> Iterator[Setting]:
    """Return the objects that the PDOs of `tpdo` and `rpdo` are."""
    for key, (base, communication, mapping) in _PDO_BASES.items():
        pdos = node.take(key)
        if pdos is None or pdos.kind == "null":
            continue
        pdos.check("map")
        for text, pdo in pdos.entries.items():
            if not (text.isdigit() and 1 <= int(text) <= 512):
                raise pdo.failure("a PDO has a number of 1..512")
            number = int(text)
            own = section_of(pdo, report)
            record, entries = communication[0] + number - 1, mapping[0] + number - 1
            enabled, cob_id = own.take("enabled"), own.take("cob_id")
            if cob_id is None or cob_id.text == "auto":
                can_id = base + 0x100 * (number - 1) + node_id if number <= 4 else None
            else:
                can_id = cob_id.integer(1, 0xFFFFFFFF)
            if can_id is None:
                report.left_out(pdo, "only the first four PDOs have a COB-ID by themselves: cob_id names one")
                continue
            is_enabled = enabled is None or enabled.truth()
            yield Setting(mux(record, 1), hex(can_id | (0 if is_enabled else 1 << 31)), pdo, pdo)
            for each, subindex in _PDO_KEYS[key].items():
                if (value := own.take(each)) is not None:
                    yield Setting(mux(record, subindex), value.string(), value, pdo)
            others = [each for other in _PDO_KEYS.values() for each in other if each not in _PDO_KEYS[key]]
            own.left_out(dict.fromkeys(others, f"dcfgen writes it to no {key.upper()}"))
            mapped = own.take("mapping")
            own.close()
            if mapped is not None:
                mapped.check("list")
                yield from _mapped(mapped, pdo, entries, report)


def _mapped(mapped: Value, pdo: Value, record: int, report: ImportReport) -> Iterator[Setting]:
    """Return the mapping record of a PDO. The lengths of the objects come from the device's file: see `device_settings`."""
    yield Setting(mux(record), str(len(mapped.items)), mapped, pdo)
    for number, item in enumerate(mapped.items[:64], start=1):
        item.check("map")
        own = YamlSection(item.entries, report)
        index, subindex = own.take("index"), own.take("sub_index")
        own.close()
        if index is None:
            raise item.failure("an entry has index and sub_index")
        where = mux(index.integer(1, 0xFFFF), 0 if subindex is None else subindex.integer(0, 255))
        yield Setting(mux(record, number), "", item, pdo, where)


def _take_heartbeat(node: YamlSection, producer: Value, multiplier: Value | None, draft: Draft, settings: list[Setting]) -> None:
    """Take over that a node sends a heartbeat, and how long the master waits for it."""
    own = node.take("heartbeat_multiplier")
    times = own or multiplier
    period = producer.integer(0, 0xFFFF)
    factor = times.number() if times is not None else Fraction(DEFAULT_MULTIPLIER)
    wait = period * factor * MILLISECOND
    settings.append(Setting(mux(indices.PRODUCER_HEARTBEAT_TIME), str(period), producer, producer))
    if not period:
        return
    if wait.denominator != 1 or wait <= 0:
        raise producer.failure(f"{period} ms times heartbeat_multiplier is no time in ns")
    text = duration_text(int(wait))
    if draft.master.setdefault("heartbeat_timeout", text) == text:
        draft.report.taken(producer, f'heartbeat_timeout = "{text}" in [master]')
        if times is not None:
            draft.report.taken(times, f'heartbeat_timeout = "{text}" in [master]')
    else:
        other = draft.master["heartbeat_timeout"]
        draft.report.left_out(producer, f"heartbeat_timeout of [master] is one time for all nodes: {other}, not {text}")


def _take_joints(name: str, value: Value, node: YamlSection, draft: Draft) -> None:
    """Take over the axes of a drive: one joint of the node's name, or several with names of their own."""
    report = draft.report
    count_given, names, channels = node.take("num_channels"), node.take("channel_names"), node.take("channels")
    count = 1 if count_given is None else count_given.integer(1, MAX_AXES)
    if count_given is not None:
        report.taken(count_given, f"{count} joint{'s' if count > 1 else ''} of the node, with the axes 0 to {count - 1}")
    common: dict[str, Any] = {}
    draft.take_switching_state(node, common)
    draft.take_homing_timeout(node, common)
    node.into(common, "homing_method", lambda value: value.integer(-128, 127))
    _take_mode(node, draft)
    of_node = {key: node.take(key) for key in SCALES}
    for axis in range(count):
        joint_name = name if count == 1 else f"{name}/{axis}"
        if names is not None and count > 1:
            names.check("list")
            if axis < len(names.items):
                joint_name = draft.name(names.items[axis], names.items[axis].string())
                report.taken(names.items[axis], f"the joint {joint_name!r}, axis = {axis}")
        given = dict(of_node)
        if channels is not None:
            channels.check("list")
            if axis < len(channels.items):
                own = section_of(channels.items[axis], report)
                given |= {key: each for key in SCALES if (each := own.take(key)) is not None}
                own.left_out({"scale_eff_from_dev": TORQUE})
                own.close()
        joint: dict[str, Any] = {} if joint_name == name else {"node": name}
        joint |= ({"axis": axis} if axis else {}) | common
        if draft.is_lost(value, (*SCALES, "channels", "num_channels")):
            for each in filter(None, given.values()):
                report.left_out(each, NO_SCALE)
            report.missing(f"{value.place}.scale_pos_to_dev", NO_SCALE)
            draft.add_joint(value, joint_name, joint)
            continue
        _take_scale(given, joint, draft, is_linear=joint_name in draft.choices.linear)
        draft.add_joint(value, joint_name, joint)
    if count > 1 and draft.devices[name].file is None:
        report.missing(
            f"{value.place}.dcf", "several axes behind one node-ID need the device's file, with the objects of all of them"
        )
    node.left_out({"scale_eff_from_dev": TORQUE})
    node.not_needed(
        {"velocity_mode": "velocities go by csv or pv, as the drive has them", "torque_mode": "torques go by cst or tq"}
    )


def _take_mode(node: YamlSection, draft: Draft) -> None:
    value = node.take("position_mode")
    if value is None:
        return
    number = value.integer(-128, 127)
    mode = next((word for word, each in MODES.items() if each is not None and each == number), "")
    if not mode:
        draft.report.left_out(value, f"{number} is no mode in which a chain moves: 1 (pp), 7 (ip), 8 (csp)")
    elif draft.mode in ("", mode):
        draft.mode = mode
        draft.report.taken(value, f'mode = "{mode}" of the chain')
    else:
        draft.report.left_out(value, f"a chain has one mode: {draft.mode}, not {mode}")


def _take_scale(given: Mapping[str, Value | None], joint: dict[str, Any], draft: Draft, *, is_linear: bool) -> None:
    """Take over the factors and offsets of position and velocity."""
    exact = {
        key: Exact(Value("float", default, key, "", 0).number() if (value := given[key]) is None else value.number())
        for key, default in SCALES.items()
    }

    def line(scale: str, offset: str = "") -> Line:
        texts = ["0" if not key else SCALES[key] if (each := given[key]) is None else each.text for key in (scale, offset)]
        return Line(exact[scale], exact[offset] if offset else ZERO, "", *map(rounding_of, texts))

    to_device = line("scale_pos_to_dev", "offset_pos_to_dev")
    from_device = line("scale_pos_from_dev", "offset_pos_from_dev")
    values = [value for key in SCALES if "pos" in key and (value := given[key]) is not None]
    made = draft.take_scale(joint, values, lambda: position_keys(to_device, from_device, is_linear=is_linear))
    if made is None:
        return
    if not values:
        draft.report.assumed("scale_pos_to_dev, scale_pos_from_dev", f"{made}: ros2_canopen's default, 1000 counts in a rad or m")
    values = [value for key in SCALES if "vel" in key and (value := given[key]) is not None]
    if values:
        there, back = line("scale_vel_to_dev"), line("scale_vel_from_dev")
        draft.take_scale(joint, values, lambda: velocity_keys(to_device.factor, there, back))
