"""A user's side of the node: an rclpy node in the test's own process, and the node as a process of its own.

Nothing here rests on the speed of the computer: everything waits until something is so, PATIENCE at most.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

PATIENCE = 60.0
"""Seconds, for a computer that is busy with other things."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Client:
    """An rclpy node that calls services, publishes, and keeps what it hears: `heard[topic]`, the oldest first."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("test_client", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self.arrived: dict[str, list[int]] = defaultdict(list)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    # ---- waiting ----

    def until(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        """Spin until the condition is true."""
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, f"waited in vain: {what}"
            self._executor.spin_once(timeout_sec=0.02)

    def last(self, topic: str) -> Any:
        """Return the last message of a topic that is listened to; wait for the first one, which may come later than its cause."""
        self.until(lambda: self.heard[topic], f"a message on {topic}")
        return self.heard[topic][-1]

    # ---- services ----

    def begin(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service, and return the Future of its answer. Waits for the service to be there."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}")
        self._be_known()
        return client.call_async(kind.Request() if request is None else request)

    def _be_known(self) -> None:
        """Wait until every node with a life cycle can answer the clients made so far.

        `service_is_ready` means: this side knows the service. The service may not know yet where its answers go, and drop them
        ("failed to send response"). DDS announces the endpoints of one participant in their order: whoever answers a client made
        now knows the earlier ones. The question changes nothing, so it is asked again where its own answer was dropped.
        """
        asked: dict[str, Any] = {}
        answered: set[str] = set()

        def all_answered() -> bool:
            types = dict(self.node.get_service_names_and_types())
            nodes = {name for name, kinds in types.items() if "lifecycle_msgs/srv/GetState" in kinds}
            for name in nodes - asked.keys():
                asked[name] = self.node.create_client(GetState, name)
            for name in nodes - answered:
                future = asked[name].call_async(GetState.Request())
                self._executor.spin_until_future_complete(future, timeout_sec=1.0)
                if future.done():
                    answered.add(name)
            return nodes <= answered

        self.until(all_answered, "nodes that answer get_state")
        for client in asked.values():
            self.node.destroy_client(client)

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service, and return its answer."""
        future = self.begin(kind, name, request)
        self.until(future.done, f"answer of {name}")
        return future.result()

    def trigger(self, name: str) -> Any:
        """Call a service std_srvs/Trigger."""
        return self.call(Trigger, name)

    def change_state(self, transition: int, node: str = "/ros_canopen") -> bool:
        """Ask the life cycle for a transition, by its number in lifecycle_msgs/Transition."""
        request = ChangeState.Request()
        request.transition.id = transition
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def state(self, node: str = "/ros_canopen") -> str:
        """The state of the life cycle, by its label."""
        return str(self.call(GetState, f"{node}/get_state").current_state.label)

    # ---- topics ----

    def listen(self, kind: Any, topic: str, qos: Any = 1000) -> None:
        """Keep what is published on a topic from now on."""

        def keep(message: Any) -> None:
            self.heard[topic].append(message)
            self.arrived[topic].append(time.monotonic_ns())

        self.node.create_subscription(kind, topic, keep, qos)

    def listen_to_joints(self) -> None:
        """Keep the joint states."""
        self.listen(JointState, "/joint_states")

    def listen_to_state(self, chain: str) -> None:
        """Keep the states of a chain, the latched one first."""
        self.listen(String, f"/{chain}/state", LATCHED)

    def listen_to_diagnostics(self) -> None:
        """Keep the diagnostics."""
        self.listen(DiagnosticArray, "/diagnostics")

    def next(self, topic: str) -> Any:
        """Wait for one more message, and return it."""
        count = len(self.heard[topic])
        self.until(lambda: len(self.heard[topic]) > count, f"a message on {topic}")
        return self.heard[topic][-1]

    def joints(self) -> Any:
        """The next joint state."""
        return self.next("/joint_states")

    def publish(self, kind: Any, topic: str, message: Any) -> None:
        """Publish a message, once somebody listens."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self.node.create_publisher(kind, topic, 10)
        self.until(publisher.get_subscription_count, f"somebody who listens to {topic}")
        publisher.publish(message)


def six_velocities(client: Client, velocity: float) -> None:
    """Send a velocity for six joints, in rad/s."""
    client.publish(Float64MultiArray, "/arm/command_vel", Float64MultiArray(data=[velocity] * 6))


class NodeProcess:
    """`python -m canopen_ros.ros2`, or another module, with arguments. `output()`: what it printed so far, on both streams."""

    def __init__(self, folder: Path, *arguments: str, module: str = "canopen_ros.ros2") -> None:
        self._output = folder / f"node{time.monotonic_ns()}.txt"
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "ROS_LOG_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        with self._output.open("wb") as stream:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments], stdout=stream, stderr=subprocess.STDOUT, env=environment
            )

    def output(self) -> str:
        """Its output so far."""
        return self._output.read_text(encoding="utf-8", errors="replace")

    def interrupt(self) -> None:
        """Send it SIGINT, as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)

    def ended(self) -> int:
        """Wait for its end, and return its exit status."""
        return self.process.wait(PATIENCE)


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[NodeProcess]:
    """The node, until the block ends; its output is printed if the block fails."""
    node = NodeProcess(folder, *arguments)
    try:
        yield node
    except BaseException:
        node.process.kill()
        node.process.wait()
        print(node.output())
        raise
    if node.process.poll() is None:
        node.interrupt()
        try:
            node.ended()
        finally:
            node.process.kill()
            print(node.output())


def parameters(**values: object) -> list[str]:
    """Parameters as ROS 2's command line takes them."""
    return ["--ros-args", *(word for name, value in values.items() for word in ("-p", f"{name}:={value}"))]
