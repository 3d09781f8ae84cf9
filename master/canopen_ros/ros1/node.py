"""The ROS 1 node: the services, topics and actions of names.py, by rospy.

trio has the main thread, with the bridge and the drives. rospy calls back in threads of its own, which use the Portal; all that
is published goes through one more thread (OutgoingMessages). The node ends, with all drives halted and shut down, by SIGINT,
SIGTERM, `rosnode kill`, or when the ROS master is lost.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import trio

from canopen_master.errors import MasterClosedError, MasterError
from canopen_proto.machine import SECOND
from canopen_ros.bridge import Bridge, open_bridge
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.diagnostics import Diagnostic, named
from canopen_ros.names import (
    COMMAND_VELOCITIES,
    DIAGNOSTICS,
    GET_OBJECT,
    JOINT_COMMANDS,
    JOINT_STATES,
    NO_FILE,
    SERVICE,
    SET_OBJECT,
    STATE,
    TRAJECTORY,
    Name,
)
from canopen_ros.parameters import BEST_EFFORT, NodeParameters, NoMachineError, ParameterError
from canopen_ros.reply import FILE_ERRORS, Reply
from canopen_ros.ros1 import messages
from canopen_ros.ros1.action import TrajectoryAction, trajectory_goal
from canopen_ros.ros1.roscore import RosCore
from canopen_ros.ros1.rospy_types import Message, TopicPublisher, message_class, rospy, values
from canopen_ros.samples import Sample
from canopen_ros.threads import OutgoingMessages, Portal, open_portal, until_stopped
from canopen_transports.loop.beside import beside

NODE: Final = "ros_canopen"
SIMULATED_TIME: Final = (
    "/use_sim_time is true, but this node cannot follow /clock: it leads drives in real time, and its stamps have to be those of "
    "this computer's clock. Set it to false before the node starts"
)
QUEUE: Final = 10
"""Messages that rospy keeps for each slow subscriber."""


class BridgeInterface:
    """What ROS sees of a bridge."""

    def __init__(self, bridge: Bridge, portal: Portal, outgoing: OutgoingMessages) -> None:
        self._bridge = bridge
        self._portal = portal
        self._outgoing = outgoing
        self._states: dict[str, TopicPublisher] = {}

    # ---- in a worker's thread: each registration waits for the ROS master ----

    def advertise(self) -> None:
        """Register all topics, services and actions at the ROS master; `set_object` is the last one."""
        self._joint_states = self._publisher(JOINT_STATES._replace(name=self._bridge.parameters.joint_states))
        self._diagnostics = self._publisher(DIAGNOSTICS)
        for chain in self._bridge.chains.values():
            self._advertise_chain(chain)
        self._serve(GET_OBJECT.name, GET_OBJECT.type, self._get_object)
        self._serve(SET_OBJECT.name, SET_OBJECT.type, self._set_object)

    def _advertise_chain(self, chain: ChainBridge) -> None:
        self._states[chain.name] = self._publisher(STATE, chain.name)
        for service in chain.services:
            self._serve(SERVICE.of(chain.name) + service, SERVICE.type, partial(self._call, chain, service))
        self._subscribe(COMMAND_VELOCITIES, chain, partial(self._velocities, chain))
        self._subscribe(JOINT_COMMANDS, chain, partial(self._positions, chain))
        self._subscribe(TRAJECTORY, chain, partial(self._trajectory, chain))
        TrajectoryAction(chain, self._portal, self._outgoing)

    def _publisher(self, name: Name, chain: str = "") -> TopicPublisher:
        return rospy().Publisher(name.of(chain), message_class("msg", name.type), queue_size=QUEUE, latch=name.latched)

    def _subscribe(self, name: Name, chain: ChainBridge, callback: Callable[[Message], None]) -> None:
        rospy().Subscriber(name.of(chain.name), message_class("msg", name.type), callback, queue_size=QUEUE)

    def _serve(self, name: str, kind: str, answer: Callable[[Message], Reply]) -> None:
        service = message_class("srv", kind)
        response: Callable[..., Message] = message_class("srv", f"{kind}Response")
        fields = response().__slots__

        def handle(request: Message) -> Message:
            try:
                reply = answer(request)
            except MasterClosedError as error:
                reply = Reply(False, str(error))
            return response(**{field: getattr(reply, field) for field in fields})

        rospy().Service(name, service, handle)

    # ---- in rospy's threads ----

    def _call(self, chain: ChainBridge, service: str, request: Message) -> Reply:
        return self._portal.call(chain.call, service)

    def _get_object(self, request: Message) -> Reply:
        return self._portal.call(self._bridge.get_object, request.node, request.object, request.cached)

    def _set_object(self, request: Message) -> Reply:
        return self._portal.call(self._bridge.set_object, request.node, request.object, request.value, request.cached)

    def _velocities(self, chain: ChainBridge, message: Message) -> None:
        self._portal.post(chain.command_velocities, values(message.data))

    def _positions(self, chain: ChainBridge, message: Message) -> None:
        self._portal.post(chain.command_positions, tuple(message.name), values(message.position), values(message.velocity))

    def _trajectory(self, chain: ChainBridge, message: Message) -> None:
        self._portal.submit(chain.command_trajectory, trajectory_goal(message))

    # ---- in trio's thread ----

    async def publish(self) -> None:
        """Publish joint states, states, diagnostics and reports until cancelled."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._publish_samples)
            nursery.start_soon(self._publish_diagnostics)
            nursery.start_soon(self._publish_reports)
            for chain in self._bridge.chains.values():
                nursery.start_soon(self._publish_states, chain)

    async def _publish_samples(self) -> None:
        async for sample in self._bridge.samples():
            self._outgoing.put(self._publish_sample, sample)

    async def _publish_states(self, chain: ChainBridge) -> None:
        async for state in chain.states():
            self._outgoing.put(self._publish_state, chain.name, state)

    async def _publish_diagnostics(self) -> None:
        while True:
            self._outgoing.put(self._publish_statuses, self._bridge.diagnostics())
            await self._bridge.changed()

    async def _publish_reports(self) -> None:
        async for report in self._bridge.reports():
            self._outgoing.put(rospy().logwarn, "%s: %s", report.chain, report.text)

    # ---- in the publisher's thread ----

    def _publish_sample(self, sample: Sample) -> None:
        message = message_class("msg", JOINT_STATES.type)()
        message.header.stamp = rospy().Time(*divmod(sample.stamp, SECOND))
        message.name, message.position = sample.names, sample.positions
        message.velocity, message.effort = sample.velocities, sample.efforts
        self._joint_states.publish(message)

    def _publish_state(self, chain: str, state: str) -> None:
        self._states[chain].publish(message_class("msg", STATE.type)(data=state))

    def _publish_statuses(self, found: Sequence[Diagnostic]) -> None:
        key_value = message_class("msg", "diagnostic_msgs/KeyValue")
        message = message_class("msg", DIAGNOSTICS.type)()
        message.header.stamp = rospy().Time.now()
        for each in named(found, rospy().get_name()):
            status = message_class("msg", "diagnostic_msgs/DiagnosticStatus")(
                level=int(each.level), name=each.name, message=each.message, hardware_id=each.hardware_id
            )
            status.values = [key_value(key, value) for key, value in each.values.items()]
            message.status.append(status)
        self._diagnostics.publish(message)


class Log(logging.Handler):
    """Passes on what the master tells (a drive that cannot be held, for example) to the log of ROS, /rosout."""

    def __init__(self, outgoing: OutgoingMessages) -> None:
        super().__init__()
        self._outgoing = outgoing

    def emit(self, record: logging.LogRecord) -> None:
        tell = rospy().logerr if record.levelno >= logging.ERROR else rospy().logwarn
        self._outgoing.put(tell, "%s", record.getMessage())


async def run(parameters: NodeParameters, core: RosCore) -> None:
    """Run the node until it is to end; see this module's text. Raises MasterError if a bus cannot be opened, or a halt fails."""
    with OutgoingMessages() as outgoing:
        log = Log(outgoing)
        logging.getLogger("canopen_master").addHandler(log)
        async with open_bridge(parameters) as bridge, open_portal() as portal:
            node = BridgeInterface(bridge, portal, outgoing)
            await trio.to_thread.run_sync(node.advertise)
            async with beside(trio.open_nursery()) as nursery:
                nursery.start_soon(node.publish)
                await until_stopped(lambda: rospy().is_shutdown() or bool(core.lost))


def parameters_of(arguments: Sequence[str]) -> NodeParameters:
    """Return the parameters of the ROS parameter server. arguments: the description file, if given. Raises ParameterError."""
    given = rospy().get_param("~", {})
    given = dict(given) if isinstance(given, Mapping) else {}
    if arguments:
        given["machine" if arguments[0].endswith(".toml") else "chains"] = arguments[0]
    if rospy().get_param("/use_sim_time", False):
        raise ParameterError((SIMULATED_TIME,))
    parameters = NodeParameters.from_mapping(given)
    if parameters.joint_states_reliability == BEST_EFFORT:
        raise ParameterError(("joint_states_reliability is best_effort, which ROS 1 does not have: its topics are reliable",))
    return parameters


def main() -> int:
    """Run the node; return its exit status."""
    messages.install()
    arguments = rospy().myargv()[1:]
    core = RosCore()
    if core.process_id() is None:
        if not arguments:  # nor can there be parameters
            print(NO_FILE)
            return 1
        print(
            f"there is no ROS master at {core.uri} ($ROS_MASTER_URI)\nTry: roscore, in another terminal; or roslaunch",
            file=sys.stderr,
        )
        return 1
    rospy().init_node(NODE, disable_signals=True)
    try:
        parameters = parameters_of(arguments)
        with core:
            trio.run(run, parameters, core)
    except NoMachineError:
        print(NO_FILE)
        return 1
    except (MasterError, *FILE_ERRORS) as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        rospy().signal_shutdown(core.lost)
    if core.lost:
        print(f"{core.lost}: the drives were halted", file=sys.stderr)
        return 1
    return 0
