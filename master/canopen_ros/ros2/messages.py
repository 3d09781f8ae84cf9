"""Between the bridge's values and ROS 2's messages. The one module that makes messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import ParameterValue as MadeParameterValue
from rcl_interfaces.msg import SetParametersResult as MadeSetResult
from sensor_msgs.msg import JointState as MadeJointState
from std_msgs.msg import String

from canopen_proto.machine import SECOND
from canopen_ros.diagnostics import Diagnostic
from canopen_ros.goals import TrajectoryGoal, TrajectoryPoint
from canopen_ros.reply import Reply
from canopen_ros.ros2.rcl import JointState, JointTrajectory, ParameterValue, SetResult, Stamp
from canopen_ros.samples import Sample

_FIELDS: Final = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
}
"""The field of a ParameterValue that holds the value, by its type."""


def nanoseconds(stamp: Stamp) -> int:
    """Return a time or a duration in ns."""
    return stamp.sec * SECOND + stamp.nanosec


def joint_state(sample: Sample) -> object:
    """Make a sensor_msgs/JointState."""
    made: JointState = MadeJointState(
        name=sample.names, position=sample.positions, velocity=sample.velocities, effort=sample.efforts
    )
    _stamp(made.header.stamp, sample.stamp)
    return made


def text(value: str) -> object:
    """Make a std_msgs/String."""
    made: object = String(data=value)
    return made


def diagnostics(found: Iterable[Diagnostic], now: int) -> object:
    """Make a diagnostic_msgs/DiagnosticArray. now: ns since 1970."""
    array = DiagnosticArray(
        status=[
            DiagnosticStatus(
                level=bytes((each.level,)),
                name=each.name,
                message=each.message,
                hardware_id=each.hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in each.values.items()],
            )
            for each in found
        ]
    )
    _stamp(array.header.stamp, now)
    made: object = array
    return made


def goal(message: JointTrajectory) -> TrajectoryGoal:
    """Return what a trajectory_msgs/JointTrajectory asks for."""
    points = [
        TrajectoryPoint(
            tuple(point.positions),
            tuple(point.velocities),
            tuple(point.accelerations),
            nanoseconds(point.time_from_start) / SECOND,
        )
        for point in message.points
    ]
    return TrajectoryGoal(tuple(message.joint_names), points, start=nanoseconds(message.header.stamp))


def object_value(reply: Reply) -> ParameterValue:
    """Return the value of an object as a string; of a failure the type NOT_SET, with the reason in `string_value`."""
    kind = ParameterType.PARAMETER_STRING if reply.success else ParameterType.PARAMETER_NOT_SET
    made: ParameterValue = MadeParameterValue(type=kind, string_value=reply.value if reply.success else reply.message)
    return made


def object_text(value: ParameterValue) -> str | None:
    """Return the text of a value to write; None for an array or no value."""
    field = _FIELDS.get(value.type)
    return None if field is None else str(getattr(value, field))


def set_result(reply: Reply) -> SetResult:
    """Make a rcl_interfaces/SetParametersResult."""
    made: SetResult = MadeSetResult(successful=reply.success, reason=reply.message)
    return made


def _stamp(stamp: Stamp, time: int) -> None:
    stamp.sec, stamp.nanosec = divmod(time, SECOND)
