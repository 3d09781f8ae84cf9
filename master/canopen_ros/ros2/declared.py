"""The parameters of the ROS 2 node as `ros2 param describe` shows them: types, ranges, descriptions, and what is read-only.

A number that was given as an integer (`goal_time:=1`) is declared as the double that it means. A value of the wrong kind stays as
it was given, so that configure tells of all of them at once; it can be set rightly then.
"""

from __future__ import annotations

from typing import Final

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

from canopen_proto.dictionary.model import did_you_mean
from canopen_ros.parameters import PARAMETERS, NodeParameter
from canopen_ros.ros2.rcl import DeclaringNode

AUTOSTART: Final = "autostart"
SIM_TIME: Final = "use_sim_time"
OF_ROS: Final = (AUTOSTART, SIM_TIME, "start_type_description_service")
"""Parameters of the node that say nothing about the machine."""


def declare(node: DeclaringNode) -> None:
    """Declare all parameters but those that rclpy declares itself; what was given at the start is declared already."""
    for name, parameter in PARAMETERS.items():
        given = _undeclare(node, name)
        value = parameter.default if given is None else given
        if isinstance(value, int) and isinstance(parameter.default, float):
            value = float(value)
        is_static = parameter.default is not None and type(value) is type(parameter.default)
        descriptor = ParameterDescriptor(
            description=parameter.text, additional_constraints=_constraints(parameter), dynamic_typing=not is_static
        )
        if parameter.least is not None and not parameter.problem(value):
            descriptor.floating_point_range = [FloatingPointRange(from_value=parameter.least, to_value=parameter.most)]
        node.declare_parameter(name, value, descriptor, ignore_override=True)
    given = _undeclare(node, AUTOSTART)
    text = "true: the node configures and activates itself when it starts; false: a manager of life cycles does"
    descriptor = ParameterDescriptor(description=text, read_only=True)
    node.declare_parameter(AUTOSTART, True if given is None else given, descriptor, ignore_override=True)


def problem_of(name: str, value: object) -> str:
    """Return why configure would refuse this value, as far as one parameter alone can tell; "" if it would not. name: of the
    parameter, such as "joints.joint1.unit"."""
    table, _, key = name.partition(".")
    parameter = PARAMETERS.get(table)
    if parameter is None:
        return f"there is no parameter {name!r}{did_you_mean(name, PARAMETERS)}"
    if key:
        return "" if table in TABLES else f"{table} is no table, so there is no {name!r}"
    problem = "" if value is None and parameter.default is None else parameter.problem(value)
    return f"{name} is {value!r}; {problem}" if problem else ""


TABLES: Final = ("buses", "eds", "joints", "defaults")
"""Parameters with others below them: `joints.joint1.unit`."""


def _undeclare(node: DeclaringNode, name: str) -> object:
    """Take back what rclpy has declared without a type; return its value, None if there is none."""
    if not node.has_parameter(name):
        return None
    value = node.get_parameter(name).value
    node.undeclare_parameter(name)
    return value


def _constraints(parameter: NodeParameter) -> str:
    return f"one of {', '.join(parameter.choices)}" if parameter.choices else ""
