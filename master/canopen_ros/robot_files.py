"""The files about a machine in its ROS package: URDF, controllers of ros2_control, MoveIt's SRDF and limits.

A machine file tells the joints, their order, kinds, limits and names. It does not tell where they are mounted, how large the
links are, or how strong the joints: nothing is made up for that. A limit that is not known stands as 0, by which no planner moves
the joint, and `RobotFiles.missing` names each thing that is to be filled in.

Sources: URDF (wiki.ros.org/urdf/XML), SRDF and joint_limits.yaml (MoveIt's documentation), ros2_controllers' documentation; from
memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

from canopen_master.machine_file import ChainEntry, JointEntry, MachineFile
from canopen_proto.drives.axis.units import Unit
from canopen_ros import names
from canopen_ros.samples import SI

URDF: Final = "urdf/machine.urdf"
CONTROLLERS: Final = "config/controllers.yaml"
SRDF: Final = "config/moveit/machine.srdf"
JOINT_LIMITS: Final = "config/moveit/joint_limits.yaml"
MOVEIT_CONTROLLERS: Final = "config/moveit/moveit_controllers.yaml"
ROBOT: Final = "machine"


class RobotFiles(NamedTuple):
    """The files of a ROS package for a robot. files: their contents, by name. missing: what they lack, and the user has to fill
    in. controllers: the name of the controller of each chain."""

    files: Mapping[str, bytes]
    missing: tuple[str, ...]
    controllers: Mapping[str, str]


class _Joint(NamedTuple):
    """A joint in rad or m. None: the machine file does not tell."""

    name: str
    kind: str
    lower: float | None
    upper: float | None
    velocity: float | None
    acceleration: float | None
    jerk: float | None


def robot_files(machine: MachineFile) -> RobotFiles:
    """Return the files about a machine: none if it has no chain, or a joint of a chain has no unit. `missing` tells it."""
    if not machine.chains:
        return RobotFiles({}, ("the machine has no chain: no URDF, controllers or files for MoveIt are written",), {})
    entries = {name: machine.joints[name] for chain in machine.chains.values() for name in chain.joints}
    without = tuple(
        f"unit of the joint {name} in the machine file: whether it turns or slides is not known, so no URDF, controllers or "
        "files for MoveIt are written"
        for name, entry in entries.items()
        if entry.settings.unit is None
    )
    if without:
        return RobotFiles({}, without, {})
    joints = {name: _joint(entry) for name, entry in entries.items()}
    chains = tuple(machine.chains.values())
    controllers = {chain.name: re.sub(r"\W", "_", chain.name) + "_controller" for chain in chains}
    texts = {
        URDF: _urdf(joints, chains),
        CONTROLLERS: _controllers(chains, controllers),
        SRDF: _srdf(chains),
        JOINT_LIMITS: _joint_limits(joints),
        MOVEIT_CONTROLLERS: _moveit_controllers(chains, controllers),
    }
    return RobotFiles({name: text.encode() for name, text in texts.items()}, tuple(_missing(joints)), controllers)


def _joint(entry: JointEntry) -> _Joint:
    settings = entry.settings
    assert settings.unit is not None
    size = SI[settings.unit]
    kind = "prismatic" if settings.unit is Unit.MILLIMETRE else "revolute"
    limits = settings.min_position, settings.max_position, settings.max_speed, settings.max_acceleration, settings.max_jerk
    return _Joint(entry.name, kind, *(None if each is None or math.isinf(each) else each * size for each in limits))


def _missing(joints: Mapping[str, _Joint]) -> Iterator[str]:
    yield f"origin and axis of each joint, and the link it hangs on, in {URDF}: a chain's joints are in a row there, at one place"
    yield f"effort (N·m or N) of each joint in {URDF}: 0 now"
    for joint in joints.values():
        lacks = [
            key for key, value in (("lower", joint.lower), ("upper", joint.upper), ("velocity", joint.velocity)) if value is None
        ]
        if lacks:
            yield f"{', '.join(lacks)} of the joint {joint.name} in {URDF}: 0 now, so that no planner moves it"
    yield "config/moveit/kinematics.yaml: which solver is right depends on the geometry"


def _limit(value: float | None) -> str:
    return "0" if value is None else repr(value)


def _urdf(joints: Mapping[str, _Joint], chains: tuple[ChainEntry, ...]) -> str:
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Joints and limits of the machine file, in rad and m. To be filled in: origins, axes, the order of the links,",
        "     efforts, and each limit that is 0. -->",
        f'<robot name="{ROBOT}">',
        '  <link name="base_link"/>',
    ]
    parents: dict[str, str] = {}
    for chain in chains:
        parent = "base_link"
        for name in chain.joints:
            if name not in parents:
                joint, child = joints[name], f"{name}_link"
                limits = f'lower="{_limit(joint.lower)}" upper="{_limit(joint.upper)}" velocity="{_limit(joint.velocity)}"'
                lines += [
                    f"  <joint name={quoteattr(name)} type={quoteattr(joint.kind)}>",
                    f"    <parent link={quoteattr(parent)}/>",
                    f"    <child link={quoteattr(child)}/>",
                    f'    <limit {limits} effort="0"/>',
                    "  </joint>",
                    f"  <link name={quoteattr(child)}/>",
                ]
                parents[name] = child
            parent = parents[name]
    for chain in chains:
        lines += [
            f'  <ros2_control name={quoteattr(chain.name)} type="system">',
            "    <hardware>",
            "      <plugin>joint_state_topic_hardware_interface/JointStateTopicSystem</plugin>",
            f'      <param name="joint_commands_topic">/{names.JOINT_COMMANDS.of(chain.name)}</param>',
            f'      <param name="joint_states_topic">/{names.JOINT_STATES.name}</param>',
            "    </hardware>",
        ]
        for name in chain.joints:
            lines += [
                f"    <joint name={quoteattr(name)}>",
                '      <command_interface name="position"/>',
                '      <state_interface name="position"/>',
                '      <state_interface name="velocity"/>',
                "    </joint>",
            ]
        lines.append("  </ros2_control>")
    return "\n".join([*lines, "</robot>", ""])


def _srdf(chains: tuple[ChainEntry, ...]) -> str:
    lines = ['<?xml version="1.0"?>', f'<robot name="{ROBOT}">']
    for chain in chains:
        lines += [f"  <group name={quoteattr(chain.name)}>"]
        lines += [f"    <joint name={quoteattr(name)}/>" for name in chain.joints]
        lines += ["  </group>"]
    return "\n".join([*lines, "</robot>", ""])


def _quoted(text: str) -> str:
    """Return a text as YAML's and JSON's double-quoted string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _list(texts: tuple[str, ...]) -> str:
    return f"[{', '.join(map(_quoted, texts))}]"


def _controllers(chains: tuple[ChainEntry, ...], controllers: Mapping[str, str]) -> str:
    lines = [
        "# No joint_state_broadcaster: the node publishes /joint_states itself.",
        "controller_manager:",
        "  ros__parameters:",
        "    update_rate: 100 # Hz",
    ]
    for name in controllers.values():
        lines += [f"    {name}:", "      type: joint_trajectory_controller/JointTrajectoryController"]
    for chain in chains:
        lines += [
            f"{controllers[chain.name]}:",
            "  ros__parameters:",
            f"    joints: {_list(chain.joints)}",
            "    command_interfaces: [position]",
            "    state_interfaces: [position, velocity]",
            "    set_last_command_interface_value_as_state_on_activation: false # it begins where the joints are",
        ]
    return "\n".join([*lines, ""])


def _joint_limits(joints: Mapping[str, _Joint]) -> str:
    lines = ["# Limits of the machine file, in rad and m. A limit that is not known is not set.", "joint_limits:"]
    for joint in joints.values():
        lines.append(f"  {_quoted(joint.name)}:")
        for quantity, value in (("velocity", joint.velocity), ("acceleration", joint.acceleration), ("jerk", joint.jerk)):
            lines.append(f"    has_{quantity}_limits: {str(value is not None).lower()}")
            if value is not None:
                lines.append(f"    max_{quantity}: {value!r}")
    return "\n".join([*lines, ""])


def _moveit_controllers(chains: tuple[ChainEntry, ...], controllers: Mapping[str, str]) -> str:
    lines = [
        "moveit_controller_manager: moveit_simple_controller_manager/MoveItSimpleControllerManager",
        "moveit_simple_controller_manager:",
        f"  controller_names: {_list(tuple(controllers.values()))}",
    ]
    for chain in chains:
        lines += [
            f"  {controllers[chain.name]}:",
            "    action_ns: follow_joint_trajectory",
            "    type: FollowJointTrajectory",
            "    default: true",
            f"    joints: {_list(chain.joints)}",
        ]
    return "\n".join([*lines, ""])
