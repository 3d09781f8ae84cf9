"""The parts of rclpy and of its messages that the node uses, as Protocols: mypy then needs no ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol


class Stamp(Protocol):
    """builtin_interfaces/Time and /Duration."""

    sec: int
    nanosec: int


class Header(Protocol):
    """std_msgs/Header."""

    stamp: Stamp


class JointState(Protocol):
    """sensor_msgs/JointState."""

    header: Header
    name: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]


class Point(Protocol):
    """trajectory_msgs/JointTrajectoryPoint."""

    positions: Sequence[float]
    velocities: Sequence[float]
    accelerations: Sequence[float]
    time_from_start: Stamp


class JointTrajectory(Protocol):
    """trajectory_msgs/JointTrajectory."""

    header: Header
    joint_names: Sequence[str]
    points: Sequence[Point]


class Numbers(Protocol):
    """std_msgs/Float64MultiArray."""

    data: Sequence[float]


class TriggerResponse(Protocol):
    """The response of std_srvs/Trigger."""

    success: bool
    message: str


class ParameterValue(Protocol):
    """rcl_interfaces/ParameterValue."""

    type: int
    bool_value: bool
    integer_value: int
    double_value: float
    string_value: str


class NamedValue(Protocol):
    """rcl_interfaces/Parameter."""

    name: str
    value: ParameterValue


class GetRequest(Protocol):
    """The request of rcl_interfaces/GetParameters."""

    names: Sequence[str]


class GetResponse(Protocol):
    """Its response."""

    values: Sequence[ParameterValue]


class SetRequest(Protocol):
    """The request of rcl_interfaces/SetParameters."""

    parameters: Sequence[NamedValue]


class SetResult(Protocol):
    """rcl_interfaces/SetParametersResult."""

    successful: bool
    reason: str


class SetResponse(Protocol):
    """The response of rcl_interfaces/SetParameters."""

    results: Sequence[SetResult]


class Publisher(Protocol):
    """Publishes on one topic."""

    def publish(self, message: object, /) -> None:
        """Publish a message."""


class Logger(Protocol):
    """The logger of a node."""

    def info(self, message: str) -> bool:
        """Log a message."""

    def warning(self, message: str) -> bool:
        """Log a message."""

    def error(self, message: str) -> bool:
        """Log a message."""


class Parameter(Protocol):
    """A parameter of a node."""

    @property
    def value(self) -> object:
        """Its value."""


class NamedParameter(Parameter, Protocol):
    """The same as rclpy/Parameter, with its name."""

    @property
    def name(self) -> str:
        """Its name."""


class LifecycleNode(Protocol):
    """A node with a life cycle."""

    def get_logger(self) -> Logger:
        """Its logger."""

    def get_fully_qualified_name(self) -> str:
        """Its namespace and name, from the root: /arm/ros_canopen."""

    def get_parameters_by_prefix(self, prefix: str) -> Mapping[str, Parameter]:
        """Its parameters; with "" all of them."""

    def create_publisher(self, kind: object, topic: str, qos: object, /) -> Publisher:
        """Publish on a topic."""

    def create_subscription(self, kind: object, topic: str, callback: Callable[[Any], None], qos: object, /) -> object:
        """Let the executor call a function with each message of a topic."""

    def create_service(self, kind: object, name: str, callback: Callable[[Any, Any], Any], *, callback_group: object) -> object:
        """Offer a service. callback: async; gets request and response, and returns the response."""

    def destroy_publisher(self, publisher: Publisher, /) -> bool:
        """Publish no longer."""

    def destroy_subscription(self, subscription: object, /) -> bool:
        """Listen no longer."""

    def destroy_service(self, service: object, /) -> bool:
        """Offer the service no longer."""

    def destroy_node(self) -> None:
        """End it."""

    def trigger_configure(self) -> object:
        """Go from unconfigured to inactive."""

    def trigger_activate(self) -> object:
        """Go from inactive to active."""


class DeclaringNode(Protocol):
    """A node whose parameters are declared."""

    def has_parameter(self, name: str, /) -> bool:
        """Whether it is declared."""

    def get_parameter(self, name: str, /) -> Parameter:
        """A declared parameter."""

    def undeclare_parameter(self, name: str, /) -> None:
        """Take it back."""

    def declare_parameter(self, name: str, value: Any, descriptor: object, /, *, ignore_override: bool) -> object:
        """Declare it with a value."""


class Executor(Protocol):
    """Runs the callbacks of a node in the thread that spins."""

    def add_node(self, node: LifecycleNode) -> bool:
        """Run this node's callbacks."""

    def spin(self) -> None:
        """Run callbacks until `shutdown`."""

    def wake(self) -> None:
        """Look again at the callbacks that wait for a Future. From any thread."""

    def shutdown(self) -> bool:
        """End `spin`."""
