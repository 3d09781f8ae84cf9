"""The machine while it is made of a configuration: tables of the machine file, and what is to be set in each device."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen_data import DataError
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description
from canopen_data.durations import duration_text
from canopen_master.ros_configurations.report import ImportReport, YamlSection, key_text
from canopen_master.ros_configurations.scale import ContradictionError, JointKeys, number_in_toml
from canopen_master.ros_configurations.unit_expression import Exact
from canopen_master.ros_configurations.yaml_text import Value
from canopen_proto.drives.cia402.axes import MAX_AXES
from canopen_proto.drives.cia402.objects import INTERPOLATION_TIME_UNITS
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.multiplexer import AXIS_STEP, Mux, index_of

BUS: Final = "can0"
CAUTIOUS: Final = {"radian": 0.5, "millimetre": 100.0}
"""Speed limits, by the unit, of joints of which no limit is known. Half a metre from a joint the first is 250 mm/s, which
ISO 10218-1 calls reduced speed."""
CHAIN: Final = "chain1"
"""The manual's; a configuration of ros2_canopen names no chain."""
STATES: Final = {2: "switch on disabled", 3: "ready to switch on", 4: "switched on", 5: "operation enabled"}
"""States by the number that both predecessors give them, of those in which a mode can be changed."""
TORQUE: Final = "torques are thousandths of the rated torque (0x6076), as CiA 402 has them"
"""Why conversions of efforts need no counterpart."""
NO_SCALE: Final = "a part of the conversion cannot be used, and a default in its place would be a guess: no scale, no set-points"
_STATE_NAMES: Final = {0: "unknown", 1: "not ready to switch on", 6: "quick stop active", 7: "fault reaction active", 8: "fault"}


@dataclass(frozen=True, slots=True)
class Choices:
    """The user's additions to the files. locator: of the bus, "" for that of the files. chain: its name, "" likewise.

    packages: folders of ROS packages by name. linear: joints that are slides: their positions are in metres there.
    """

    locator: str = ""
    chain: str = ""
    packages: Mapping[str, Path] = field(default_factory=dict)
    linear: frozenset[str] = frozenset()


class Setting(NamedTuple):
    """A value that an object of a device is to have. value: the key that says so; whole: the PDO that it belongs to, or the same.

    maps: for an entry of a PDO's mapping, the object that is mapped: its length, which the value needs, is in the device's file.
    """

    mux: Mux
    text: str
    value: Value
    whole: Value
    maps: Mux | None = None


class DeviceDraft(NamedTuple):
    """A node. entry: its table. file: its own file; None if it has none, or it was not found. file_key: the key that names it."""

    entry: dict[str, Any]
    file: Path | None
    file_key: Value | None
    settings: list[Setting]


@dataclass(slots=True)
class Draft:
    """The tables of the machine file by name, and the report.

    lost: the places of the values that cannot be used. What such a value would have said must not become a default of the
    predecessor, if joints would move by it.
    """

    choices: Choices
    report: ImportReport
    master: dict[str, Any] = field(default_factory=dict)
    network: dict[str, Any] = field(default_factory=dict)
    bus: dict[str, Any] = field(default_factory=dict)
    devices: dict[str, DeviceDraft] = field(default_factory=dict)
    joints: dict[str, dict[str, Any]] = field(default_factory=dict)
    chain: str = CHAIN
    mode: str = ""
    lost: AbstractSet[str] = frozenset()
    _descriptions: dict[Path, DeviceDescription] = field(default_factory=dict)

    def is_lost(self, value: Value, keys: Iterable[str]) -> bool:
        """Return whether one of these keys, or the section that would have it, was left out because it could not be used. It may
        be the node's own, or that of the defaults."""
        places = {f"{place}.{key}" for place in (value.place, "defaults") for key in keys}
        return not self.lost.isdisjoint(places | {"defaults"})

    def description_of(self, path: Path) -> DeviceDescription:
        """Return what a device's file says; it is read once. Raises DataError, DictionaryError if it cannot be used."""
        if path not in self._descriptions:
            self._descriptions[path] = load_description(path)
        return self._descriptions[path]

    def name(self, value: Value, wanted: str) -> str:
        """Return a name of the machine file for a node or joint. Raises DictionaryError if it is taken."""
        name = re.sub(r"\s+", "_", wanted.strip())
        name = f"n{name}" if name[:1].isdigit() else name
        if not name:
            raise value.failure("the name is empty")
        if name != wanted:
            self.report.taken(value, f"the name {name!r}: names have no blanks and do not begin with a digit")
        return name

    def add_device(self, value: Value, name: str, device: DeviceDraft) -> None:
        """Add a node. Raises DictionaryError if its name or its node-ID is taken."""
        if name in self.devices:
            raise value.failure(f"there are two nodes {name!r}")
        for other, each in self.devices.items():
            if each.entry["id"] == device.entry["id"]:
                raise value.failure(f"node-ID {device.entry['id']} is that of {other} already")
        self.devices[name] = device

    def add_joint(self, value: Value, name: str, entry: dict[str, Any]) -> None:
        """Add a joint. Raises DictionaryError if its name is taken."""
        if name in self.joints:
            raise value.failure(f"there are two joints {name!r}")
        self.joints[name] = entry

    def take_switching_state(self, section: YamlSection, joint: dict[str, Any]) -> None:
        """Take over the state in which a drive changes its mode."""
        value = section.take("switching_state")
        if value is None:
            return
        number = value.integer(0, 8)
        if number in STATES:
            joint["mode_change_state"] = STATES[number]
            self.report.taken(value, f'mode_change_state = "{STATES[number]}"')
        else:
            state = _STATE_NAMES[number]
            self.report.left_out(
                value, f"{number} is the state {state!r}, in which no drive changes its mode; 5 is operation enabled"
            )

    def take_homing_timeout(self, section: YamlSection, joint: dict[str, Any]) -> None:
        """Take over the time for a whole homing."""
        section.into(
            joint, "homing_timeout_seconds", lambda value: duration_text(value.integer(1, 3600) * SECOND), "homing_timeout"
        )

    def take_cycle(self, value: Value, time: Time) -> None:
        """Take over the time between two SYNCs, ns; 0: none is sent, which a chain cannot do."""
        if time:
            self.master["cycle"] = duration_text(time)
            self.report.taken(value, f"{key_text('cycle', self.master['cycle'])} in [master]")
        else:
            self.report.left_out(value, "a chain needs SYNC: the cycle is that of [master], 10 ms by default")

    def take_watchdog_node(self, value: Value, node_id: int) -> None:
        """Take over the node-ID of the master's heartbeat, by which drives notice that it is gone."""
        self.master.setdefault("watchdog", {})["node_id"] = node_id
        self.report.taken(value, f"watchdog.node_id = {node_id} in [master]")

    def take_watchdog_period(self, value: Value, milliseconds: int) -> None:
        """Take over the time between two heartbeats of the master."""
        watchdog = self.master.setdefault("watchdog", {})
        period, timeout = duration_text(milliseconds * MILLISECOND), duration_text(max(500, 5 * milliseconds) * MILLISECOND)
        watchdog["period"], watchdog["timeout"] = period, timeout
        self.report.taken(value, f'watchdog.period = "{period}", watchdog.timeout = "{timeout}" in [master]')

    def take_scale(
        self, joint: dict[str, Any], values: Sequence[Value], make: Callable[[], JointKeys], note: str = ""
    ) -> JointKeys | None:
        """Take over the keys of a scale; if its values contradict each other, leave them out, and return None.

        values: those that say the scale. note: behind the contradiction, for people.
        """
        try:
            made = make()
        except ContradictionError as error:
            for value in values:
                self.report.left_out(value, f"{error}{note}")
            return None
        joint.update(made.keys)
        for value in values:
            self.report.taken(value, str(made))
        return made

    def take_overflow(self, value: Value | None) -> None:
        """Tell of the counter of SYNC, which is sent without one."""
        if value is not None and value.number() == 0:
            self.report.not_needed(value, "SYNC has no counter")
        elif value is not None:
            self.report.left_out(value, "the master sends SYNC without a counter (0x1019)")

    def take_limits(self, limits: YamlSection) -> None:
        """Take over `joint_limits`, as MoveIt and ros_control have it: in rad or m, rad/s or m/s."""
        for name, joint in self.joints.items():
            value = limits.take(name)
            if value is None:
                continue
            value.check("map")
            own = YamlSection(value.entries, self.report)
            for has, keys in _LIMITS.items():
                flag = own.take(has)
                is_set = flag is not None and flag.truth()
                if flag is not None:
                    self.report.not_needed(flag, "a limit that is not set is left out here")
                for key, ours in keys.items():
                    if (limit := own.take(key)) is not None and is_set:
                        self._take_limit(limit, ours, joint)
                    elif limit is not None:
                        self.report.not_needed(limit, f"{has} is not true")
            own.close()
            if joint.get("min_position", -math.inf) >= joint.get("max_position", math.inf):
                raise value.failure(f"min_position {joint['min_position']!r} is not below max_position {joint['max_position']!r}")
        limits.close()
        for name, joint in self.joints.items():
            if "unit" in joint and "max_speed" not in joint:
                joint["max_speed"] = CAUTIOUS[joint["unit"]]
                self.report.missing(
                    f"joint_limits.{name}",
                    f"nothing says how fast {name} may go: max_speed = {joint['max_speed']:g} ({joint['unit']}s per second) is a "
                    "cautious guess. Give your own: a joint_limits.yaml beside this file, or max_speed in the machine file",
                )

    def _take_limit(self, value: Value, key: str, joint: dict[str, Any]) -> None:
        if "unit" not in joint:
            self.report.left_out(value, "the joint has no scale, and a limit would be in counts")
            return
        if "position" not in key and value.number() <= 0:
            raise value.failure(f"a limit above 0 is expected, not {value}")
        notes: list[str] = []
        per_metre = 1000 if joint["unit"] == "millimetre" else 1
        try:
            joint[key] = number_in_toml(Exact(value.number() * per_metre), notes)
        except ContradictionError as error:
            raise value.failure(str(error)) from None
        self.report.taken(value, "; ".join([f"{key} = {joint[key]!r}", *notes]))

    def device_file(self, value: Value, name: str, package: str, *folders: Path) -> Path | None:
        """Return the device file that a key names, as `file_beside`. Raises UnusableValueError if it is no such file."""
        path = self.file_beside(value, name, package, *folders)
        try:
            if path is not None:
                self.description_of(path)
        except DataError as error:
            raise value.failure(f"the file cannot be used: {error}") from None
        return path

    def file_beside(self, value: Value, name: str, package: str, *folders: Path) -> Path | None:
        """Return the file that a key names; None, which is reported, if it is not there.

        It is looked for in the package's folder, if the user named that; else beside the configuration and in the folders above
        it, as far as the package reaches; and in `folders`.
        """
        if "\0" in name:
            raise value.failure("no file name has a zero byte")
        beside = Path(value.source).absolute().parent
        above = [beside, *beside.parents][:_ABOVE]
        named = self.choices.packages.get(package)
        places = [named] if named is not None else [*folders, *above, *_ros_packages(package)]
        for folder in places:
            path = folder / name
            try:
                if path.is_file():
                    return path
            except OSError as error:
                raise value.failure(f"the file cannot be looked for: {error.strerror}") from None
        hint = f"--package {package}=FOLDER names its folder" if package else "put it beside the configuration"
        looked = f"in {named}" if named is not None else "beside the configuration and in the folders above"
        self.report.left_out(value, f"there is no file {name!r} {looked}; {hint}")
        return None


def is_interpolation_time(where: Mux) -> bool:
    """Return whether an object is the interpolation time period (0x60C2), of any axis."""
    distance = index_of(where) - index_of(INTERPOLATION_TIME_UNITS)
    return distance in range(0, AXIS_STEP * MAX_AXES, AXIS_STEP)


_ABOVE: Final = 4
"""Folders in which a file is looked for: package/config/bus_name/bus.yml names files from the package's folder on."""
_LIMITS: Final = {
    "has_position_limits": {"min_position": "min_position", "max_position": "max_position"},
    "has_velocity_limits": {"max_velocity": "max_speed"},
    "has_acceleration_limits": {"max_acceleration": "max_acceleration"},
    "has_jerk_limits": {"max_jerk": "max_jerk"},
}


def _ros_packages(package: str) -> list[Path]:
    """Return where ROS 1 and ROS 2 say that a package is."""
    if not package or "/" in package:
        return []
    ros1 = [Path(each) / package for each in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
    ros2 = [Path(each) / "share" / package for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    return ros1 + ros2
