"""`Interface`: the topics and services of a machine, by the table of names.py, and their ways to the bridge and back.

**Threads.** Callbacks of ROS run in the executor's thread, and reach the bridge through the portal. Messages of the bridge go out
through `OutgoingMessages`, since a publisher may block. The handler of a service awaits its answer, and leaves the thread to
others meanwhile: so `halt` gets through while `home` runs.

**Objects.** `get_object` and `set_object` have types of rcl_interfaces: a type of our own would have to be compiled by each user.
The parameter `joint1/6041sub0` is that object of joint1. A value that could not be read has the type NOT_SET, and the reason in
its `string_value`.

Until `activate`, and from `deactivate` on, nothing is published, and each command is refused.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, Final, TypeVarTuple, Unpack

import trio
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future as RosFuture
from sensor_msgs.msg import JointState as JointStateType
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryType

from canopen_master.errors import MasterClosedError
from canopen_ros import names
from canopen_ros.bridge import Bridge
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.diagnostics import Diagnostic, named
from canopen_ros.parameters import BEST_EFFORT
from canopen_ros.reply import COMMAND_ERRORS, Reply
from canopen_ros.ros2 import messages
from canopen_ros.ros2.rcl import (
    Executor,
    GetRequest,
    GetResponse,
    JointState,
    JointTrajectory,
    LifecycleNode,
    Logger,
    Numbers,
    Publisher,
    SetRequest,
    SetResponse,
    TriggerResponse,
)
from canopen_ros.samples import Sample
from canopen_ros.threads import OutgoingMessages, Portal

Args = TypeVarTuple("Args")

QUEUE: Final = QoSProfile(depth=10)
"""Reliable, also for commands: a last one that got lost would leave the joints where they are. Not only the newest is kept: a
single zero, which takes command_vel over, would be lost behind the velocity that follows it."""
BEST: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED: Final = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

INACTIVE: Final = "the node is not active, so it commands no drive. Try: ros2 lifecycle set NODE activate"


class Interface:
    """See this module's text. is_active: whether it takes commands and publishes. Use it in the executor's thread."""

    def __init__(
        self, node: LifecycleNode, executor: Executor, bridge: Bridge, portal: Portal, outgoing: OutgoingMessages
    ) -> None:
        self.is_active = False
        self._node = node
        self._executor = executor
        self._bridge = bridge
        self._portal = portal
        self._outgoing = outgoing
        self._logger: Logger = node.get_logger()
        self._publishing: trio.CancelScope | None = None
        self._group = ReentrantCallbackGroup()  # in the node's own group, a handler that waits would keep out the others
        self._publishers: list[Publisher] = []
        self._subscriptions: list[object] = []
        self._services: list[object] = []
        try:
            quality = BEST if bridge.parameters.joint_states_reliability == BEST_EFFORT else QUEUE
            self._joint_states = self._publisher(JointStateType, bridge.parameters.joint_states, quality)
            self._diagnostics = self._publisher(DiagnosticArray, names.DIAGNOSTICS.name, QUEUE)
            self._states = {
                chain.name: self._publisher(String, names.STATE.of(chain.name), LATCHED) for chain in bridge.chains.values()
            }
            self._service(GetParameters, names.GET_OBJECT.name, self._get_objects)
            self._service(SetParameters, names.SET_OBJECT.name, self._set_objects)
            for chain in bridge.chains.values():
                self._offer(chain)
        except BaseException:
            self.destroy()
            raise

    # ---- the life cycle ----

    def activate(self) -> None:
        """Take commands, and publish."""
        self.is_active = True
        self._portal.submit(self._publish).add_done_callback(self._tell_failure)

    def deactivate(self) -> None:
        """Take no commands, and publish nothing more."""
        self.is_active = False
        self._portal.post(self._end_publishing)

    def destroy(self) -> None:
        """Take all topics and services from the node."""
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for service in self._services:
            self._node.destroy_service(service)

    # ---- what it offers ----

    def _publisher(self, kind: object, topic: str, qos: object) -> Publisher:
        publisher = self._node.create_publisher(kind, topic, qos)
        self._publishers.append(publisher)
        return publisher

    def _subscribe(self, kind: object, topic: str, command: Callable[[Any], None], qos: object) -> None:
        def heard(message: Any) -> None:
            if self.is_active:
                command(message)

        self._subscriptions.append(self._node.create_subscription(kind, topic, heard, qos))

    def _service(self, kind: object, name: str, answer: Callable[[Any, Any], Awaitable[object]]) -> None:
        self._services.append(self._node.create_service(kind, name, answer, callback_group=self._group))

    def _offer(self, chain: ChainBridge) -> None:
        for service in chain.services:
            self._service(Trigger, names.SERVICE.of(chain.name) + service, self._trigger(chain, service))

        def velocities(message: Numbers) -> None:
            self._portal.post(chain.command_velocities, tuple(message.data))

        def positions(message: JointState) -> None:
            of_joints = tuple(message.name), tuple(message.position), tuple(message.velocity)
            self._portal.post(chain.command_positions, *of_joints)

        def trajectory(message: JointTrajectory) -> None:
            self._portal.submit(chain.command_trajectory, messages.goal(message)).add_done_callback(self._tell_failure)

        self._subscribe(Float64MultiArray, names.COMMAND_VELOCITIES.of(chain.name), velocities, QUEUE)
        self._subscribe(JointStateType, names.JOINT_COMMANDS.of(chain.name), positions, QUEUE)
        self._subscribe(JointTrajectoryType, names.TRAJECTORY.of(chain.name), trajectory, QUEUE)

    # ---- services ----

    def _trigger(self, chain: ChainBridge, service: str) -> Callable[[object, TriggerResponse], Awaitable[TriggerResponse]]:
        async def answer(request: object, response: TriggerResponse) -> TriggerResponse:
            reply = await self._ask(chain.call, service) if self.is_active else Reply(False, INACTIVE)
            response.success, response.message = reply.success, reply.message
            return response

        return answer

    async def _get_objects(self, request: GetRequest, response: GetResponse) -> GetResponse:
        replies = [await self._ask(self._bridge.get_object, *_parts(name), False) for name in request.names]
        response.values = [messages.object_value(reply) for reply in replies]
        return response

    async def _set_objects(self, request: SetRequest, response: SetResponse) -> SetResponse:
        replies = []
        for wanted in request.parameters:
            value = messages.object_text(wanted.value)
            if not self.is_active:
                replies.append(Reply(False, INACTIVE))
            elif value is None:
                replies.append(Reply(False, f"{wanted.name}: the value has to be a bool, a number or a string"))
            else:
                replies.append(await self._ask(self._bridge.set_object, *_parts(wanted.name), value, False))
        response.results = [messages.set_result(reply) for reply in replies]
        return response

    async def _ask(self, function: Callable[[Unpack[Args]], Awaitable[Reply]], *args: *Args) -> Reply:
        """Let the bridge answer, and meanwhile the executor do something else."""
        answered = RosFuture()

        def answer(future: Future[Reply]) -> None:
            answered.set_result(future)
            self._executor.wake()

        self._portal.submit(function, *args).add_done_callback(answer)
        future: Future[Reply] = await answered
        try:
            return future.result()
        except COMMAND_ERRORS as error:
            return Reply(False, str(error))

    # ---- what it publishes; in trio's thread ----

    async def _publish(self) -> None:
        chains = self._bridge.chains.values()
        async with trio.open_nursery() as nursery:
            self._publishing = nursery.cancel_scope
            nursery.start_soon(self._publish_samples)
            nursery.start_soon(self._publish_diagnostics)
            nursery.start_soon(self._log_reports)
            for chain in chains:
                nursery.start_soon(self._publish_states, chain)
        for chain in chains:
            self._outgoing.put(self._send_state, chain.name, chain.state)  # the latched one has to be the last one

    def _end_publishing(self) -> None:
        if self._publishing is not None:
            self._publishing.cancel()

    async def _publish_samples(self) -> None:
        async for sample in self._bridge.samples():
            self._outgoing.put(self._send_sample, sample)

    async def _publish_diagnostics(self) -> None:
        while True:
            self._outgoing.put(self._send_diagnostics, self._bridge.diagnostics(), time.time_ns())
            await self._bridge.changed()

    async def _publish_states(self, chain: ChainBridge) -> None:
        async for state in chain.states():
            self._outgoing.put(self._send_state, chain.name, state)

    async def _log_reports(self) -> None:
        async for report in self._bridge.reports():
            self._outgoing.put(self._log_error, f"{report.chain}: {report.text}")

    # ---- in the thread of `OutgoingMessages` ----

    def _send_sample(self, sample: Sample) -> None:
        self._joint_states.publish(messages.joint_state(sample))

    def _send_diagnostics(self, found: list[Diagnostic], now: int) -> None:
        self._diagnostics.publish(messages.diagnostics(named(found, self._node.get_fully_qualified_name()), now))

    def _send_state(self, chain: str, state: str) -> None:
        self._states[chain].publish(messages.text(state))

    def _log_error(self, text: str) -> None:  # rclpy allows one severity for each line that logs
        self._logger.error(text)

    # ---- commands that nobody waits for ----

    def _tell_failure(self, future: Future[Any]) -> None:
        error = future.exception()
        if error is not None and not isinstance(error, MasterClosedError):  # the node ends: no news
            self._outgoing.put(self._log_error, f"{error}")


def _parts(name: str) -> tuple[str, str]:
    """Return node and object of `joint1/6041sub0`; no node if there is no slash."""
    node, _, wanted = name.rpartition("/")
    return node, wanted
