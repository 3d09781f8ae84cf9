"""The parts of rospy and actionlib that the node uses, as Protocols: they have no types of their own.

Nothing here imports ROS, so that the types are checked on every machine.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol, cast

Message = Any
"""An instance of a generated message class; its fields stand in the definitions of the messages."""


class TopicPublisher(Protocol):
    def publish(self, message: Message) -> None: ...


class Time(Protocol):
    def to_nsec(self) -> int: ...

    def to_sec(self) -> float: ...


class TimeClass(Protocol):
    def __call__(self, secs: int = 0, nsecs: int = 0) -> Time: ...

    def now(self) -> Time: ...

    def from_sec(self, seconds: float) -> Time: ...


class Rospy(Protocol):
    """The module rospy."""

    @property
    def Time(self) -> TimeClass: ...

    @property
    def Duration(self) -> TimeClass: ...

    def init_node(self, name: str, *, disable_signals: bool) -> None: ...

    def myargv(self) -> list[str]: ...

    def get_name(self) -> str: ...

    def get_param(self, name: str, default: object) -> object: ...

    def is_shutdown(self) -> bool: ...

    def signal_shutdown(self, reason: str) -> None: ...

    def Publisher(self, name: str, data_class: type, *, queue_size: int, latch: bool) -> TopicPublisher: ...

    def Subscriber(self, name: str, data_class: type, callback: Callable[[Message], None], *, queue_size: int) -> object: ...

    def Service(self, name: str, service_class: type, handler: Callable[[Message], Message]) -> object: ...

    def logwarn(self, text: str, *args: object) -> None: ...

    def logerr(self, text: str, *args: object) -> None: ...


class GoalHandle(Protocol):
    """actionlib.ServerGoalHandle: one goal, and what the client is told of it."""

    def get_goal(self) -> Message: ...

    def get_goal_id(self) -> Message: ...

    def set_accepted(self, text: str = "") -> None: ...

    def set_rejected(self, result: Message, text: str) -> None: ...

    def set_canceled(self, result: Message, text: str) -> None: ...

    def set_aborted(self, result: Message, text: str) -> None: ...

    def set_succeeded(self, result: Message, text: str) -> None: ...

    def publish_feedback(self, feedback: Message) -> None: ...


class ActionServer(Protocol):
    def start(self) -> None: ...


class Actionlib(Protocol):
    """The module actionlib."""

    def ActionServer(
        self,
        ns: str,
        ActionSpec: type,
        goal_cb: Callable[[GoalHandle], None],
        cancel_cb: Callable[[GoalHandle], None],
        auto_start: bool,
    ) -> ActionServer: ...


def rospy() -> Rospy:
    return cast(Rospy, importlib.import_module("rospy"))


def actionlib() -> Actionlib:
    return cast(Actionlib, importlib.import_module("actionlib"))


def message_class(kind: str, name: str) -> type:
    """Return a generated class. kind: "msg" or "srv". name: "package/Name"."""
    package, _, name = name.partition("/")
    return cast(type, getattr(importlib.import_module(f"{package}.{kind}"), name))


def values(numbers: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers of an array field, which rospy may give as bytes or as a tuple."""
    return tuple(map(float, numbers))
