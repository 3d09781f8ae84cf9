"""The names of topics, services and actions, one table for both adapters, so that they are the same in ROS 1 and ROS 2."""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple


class Kind(Enum):
    """The kind of thing that has a name."""

    SERVICE = "service"
    SUBSCRIBED = "subscribed topic"
    PUBLISHED = "published topic"
    ACTION = "action"


class Name(NamedTuple):
    """A name and its message type. name: with {chain} where the name of the chain goes. type: "package/Type", as ROS 1 has it.

    in_ros2: whether the ROS 2 adapter has it, too. latched: of a published topic; transient local in ROS 2.
    """

    name: str
    kind: Kind
    type: str
    in_ros2: bool = True
    latched: bool = False

    def of(self, chain: str) -> str:
        """Return the name for a chain."""
        return self.name.format(chain=chain)


TRIGGER: Final = "std_srvs/Trigger"

COMMANDS: Final = ("init", "home", "homing", "recover", "halt", "shutdown", "IPmode")
"""The services of each chain. `homing` is `home`, and `IPmode` is the mode service of ip: the names of 2012."""

MODE_SERVICES: Final = {
    "position_mode": "pp",
    "interpolated_position_mode": "ip",
    "cyclic_position_mode": "csp",
}
"""The mode services of ros2_canopen that a chain can have, and the mode of each one."""

OTHER_MODES: Final = {"velocity_mode": "pv", "torque_mode": "tq", "cyclic_velocity_mode": "csv", "cyclic_torque_mode": "cst"}
"""Those that no chain has: it leads its joints by positions."""

JOINT_STATES: Final = Name("joint_states", Kind.PUBLISHED, "sensor_msgs/JointState")
DIAGNOSTICS: Final = Name("/diagnostics", Kind.PUBLISHED, "diagnostic_msgs/DiagnosticArray")
STATE: Final = Name("{chain}/state", Kind.PUBLISHED, "std_msgs/String", latched=True)
COMMAND_VELOCITIES: Final = Name("{chain}/command_vel", Kind.SUBSCRIBED, "std_msgs/Float64MultiArray")
TRAJECTORY: Final = Name("{chain}/joint_trajectory", Kind.SUBSCRIBED, "trajectory_msgs/JointTrajectory")
JOINT_COMMANDS: Final = Name("{chain}/joint_commands", Kind.SUBSCRIBED, "sensor_msgs/JointState")
FOLLOW: Final = Name("{chain}/follow_joint_trajectory", Kind.ACTION, "control_msgs/FollowJointTrajectory", in_ros2=False)
GET_OBJECT: Final = Name("get_object", Kind.SERVICE, "canopen_chain_node/GetObject")
SET_OBJECT: Final = Name("set_object", Kind.SERVICE, "canopen_chain_node/SetObject")
SERVICE: Final = Name("{chain}/", Kind.SERVICE, TRIGGER)
"""Each of `ChainBridge.services` is a service of this kind, its name behind the slash."""

OF_CHAIN: Final = (STATE, COMMAND_VELOCITIES, TRAJECTORY, JOINT_COMMANDS, FOLLOW)

NO_FILE: Final = "File not found. Please provide a description file as command line argument"
"""The sentence of the old node without arguments and parameters; the exit status is 1."""
