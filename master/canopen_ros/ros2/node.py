"""`python -m canopen_ros.ros2 [FILE] [--ros-args -p machine:=FILE -p simulate:=true ...]`: a node with a life cycle.

    unconfigured --configure--> inactive --activate--> active
                 <--cleanup----          <--deactivate--

- configure reads the parameters, opens the buses and makes topics and services. No drive is powered, none moves.
- activate takes commands and publishes. It powers no drive either: that is the service `init`.
- deactivate halts all joints, and shuts their drives down.
- cleanup and shutdown close the buses; so does an error. Leaving the master halts drives that still move.

A transition that fails says why in the log. Parameters are declared with their types, ranges and descriptions
(ros2/declared.py). One that would have no effect cannot be set: see `_refuse_parameters`.

With `autostart` (a parameter, true by default) the node configures and activates itself, and ends with exit status 1 if it
cannot; set it to false for a manager of life cycles.

**Threads.** trio has the main thread, and gets the signals: SIGINT and SIGTERM halt the drives, shut them down, and end the node.
The executor spins in a thread of its own. The transitions block it; they move nothing, or stop what moves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Final

import rclpy
import trio
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from canopen_ros.bridge import Bridge, open_bridge
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.parameters import NodeParameters, ParameterError
from canopen_ros.reply import COMMAND_ERRORS, FILE_ERRORS
from canopen_ros.ros2.declared import AUTOSTART, OF_ROS, SIM_TIME, declare, problem_of
from canopen_ros.ros2.interface import Interface
from canopen_ros.ros2.rcl import Executor, NamedParameter
from canopen_ros.threads import OutgoingMessages, Portal, open_portal, until_stopped

NAME: Final = "ros_canopen"

SIMULATED_TIME: Final = (
    "use_sim_time is true, but this node cannot follow /clock: it leads drives in real time, and its stamps are those of this "
    "computer's clock. Set it to false for this node"
)

PATIENCE: Final = 2.0
"""Seconds for the executor's last callbacks at the end of the node, and for its thread."""


class DrivesNotOffError(Exception):
    """Drives that did not confirm that they stand, or are off."""


EXPECTED: Final = (*COMMAND_ERRORS, *FILE_ERRORS, DrivesNotOffError, OSError)
"""A transition that raises one of these says its text; from anything else, a traceback is more use."""


class BridgeTask:
    """The bridge between `open` and `close`, in a task of its own: `open_bridge` is left by the task that entered it.

    failure: why the bridge ended by itself.
    """

    def __init__(self, nursery: trio.Nursery) -> None:
        self.failure: Exception | None = None
        self._nursery = nursery
        self._closing: trio.Event | None = None
        self._closed = trio.Event()

    async def open(self, parameters: NodeParameters) -> Bridge:
        """Open the bridge. Raises as `open_bridge`."""
        bridge: Bridge = await self._nursery.start(self._keep_open, parameters)
        return bridge

    async def close(self) -> None:
        """Halt the drives, shut them down, and close the buses. Raises HaltNotConfirmedError for a drive that does not confirm
        it."""
        if self._closing is None:
            return
        self._closing.set()
        await self._closed.wait()
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure

    async def _keep_open(self, parameters: NodeParameters, task_status: trio.TaskStatus[Bridge]) -> None:
        closing = None
        try:
            async with open_bridge(parameters) as bridge:
                closing = self._closing = trio.Event()
                self._closed = trio.Event()
                task_status.started(bridge)
                await closing.wait()
        except EXPECTED as error:
            if closing is None:
                raise
            self.failure = error
        finally:
            self._closing = None
            self._closed.set()


class CanopenNode(LifecycleNode):
    """See this module's text. The transitions run in the executor's thread, or before it begins to spin."""

    def __init__(
        self, arguments: Sequence[str], executor: Executor, machine: BridgeTask, portal: Portal, outgoing: OutgoingMessages
    ) -> None:
        """arguments: a description file, or none."""
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True, allow_undeclared_parameters=True)
        declare(self)
        self.add_on_set_parameters_callback(self._refuse_parameters)
        self.has_failed = False
        self._arguments = arguments
        self._executor_of_node = executor
        self._machine = machine
        self._portal = portal
        self._outgoing = outgoing
        self._bridge: Bridge | None = None
        self._interface: Interface | None = None

    def live(self) -> None:
        """Configure and activate, unless a manager does; then run callbacks until the executor is shut down."""
        if self.get_parameter(AUTOSTART).value:
            steps = (self.trigger_configure, self.trigger_activate)
            self.has_failed = not all(step() == TransitionCallbackReturn.SUCCESS for step in steps)
        if not self.has_failed:
            self._executor_of_node.spin()

    # ---- transitions ----

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the buses; make topics and services."""
        return self._step(self._configure, TransitionCallbackReturn.FAILURE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take commands and publish."""
        assert self._interface is not None
        self._interface.activate()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Halt the joints and shut the drives down; take no more commands."""
        return self._step(self._deactivate, TransitionCallbackReturn.ERROR)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the buses."""
        return self._step(self._close, TransitionCallbackReturn.ERROR)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Halt, shut down, and close the buses."""
        return self._step(self._close, TransitionCallbackReturn.ERROR)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the buses, which halts what still moves; the node can then be configured again."""
        return self._step(self._close, TransitionCallbackReturn.FAILURE)

    # ---- what they do ----

    def _refuse_parameters(self, parameters: Sequence[NamedParameter]) -> SetParametersResult:
        """Refuse what would have no effect, and what configure would refuse: configure reads the parameters of the machine."""
        is_configured = "is read-only while the node is configured; cleanup, set it, then configure (ros2 lifecycle set)"
        for each in parameters:
            if each.name in OF_ROS:
                why = SIMULATED_TIME if each.name == SIM_TIME and each.value is True else ""
            elif self._bridge is not None:
                why = f"{each.name} {is_configured}"
            else:
                why = problem_of(each.name, each.value)
            if why:
                return SetParametersResult(successful=False, reason=why)
        return SetParametersResult(successful=True)

    def _step(self, step: Callable[[], None], failed: TransitionCallbackReturn) -> TransitionCallbackReturn:
        try:
            step()
        except EXPECTED as error:
            self.get_logger().error(f"{error}")
            return failed
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        if self.get_parameter(SIM_TIME).value:
            raise ParameterError((SIMULATED_TIME,))
        parameters = NodeParameters.from_mapping(self._given())
        bridge = self._portal.call(self._machine.open, parameters)
        try:
            self._interface = Interface(self, self._executor_of_node, bridge, self._portal, self._outgoing)
        except BaseException:
            self._portal.call(self._machine.close)
            raise
        self._bridge = bridge

    def _deactivate(self) -> None:
        assert self._bridge is not None
        assert self._interface is not None
        self._interface.is_active = False  # a command that comes now would move what has just been stopped
        try:
            self._portal.call(_power_off, self._bridge)
        finally:
            self._interface.deactivate()

    def _close(self) -> None:
        interface, self._interface, self._bridge = self._interface, None, None
        if interface is not None:
            interface.deactivate()
        try:
            self._portal.call(self._machine.close)
        finally:
            if interface is not None:
                interface.destroy()

    def _given(self) -> dict[str, object]:
        """Return the parameters, and the file of the command line."""
        given = {name: each.value for name, each in self.get_parameters_by_prefix("").items() if name not in OF_ROS}
        if self._arguments:
            name = "machine" if self._arguments[0].endswith(".toml") else "chains"
            given[name] = self._arguments[0]
        return given


async def _power_off(bridge: Bridge) -> None:
    """Halt all chains and shut their drives down, side by side. Raises DrivesNotOffError with the texts of what failed."""
    failures: list[str] = []

    async def power_off(chain: ChainBridge) -> None:
        for service in ("halt", "shutdown"):
            reply = await chain.call(service)
            if not reply.success:
                failures.append(reply.message)

    async with trio.open_nursery() as nursery:
        for chain in bridge.chains.values():
            nursery.start_soon(power_off, chain)
    if failures:
        raise DrivesNotOffError("\n".join(failures))


async def _run(arguments: Sequence[str]) -> int:
    """Be the node until a signal comes, or the machine fails. Returns the exit status."""
    executor = SingleThreadedExecutor()
    with OutgoingMessages() as outgoing:
        async with trio.open_nursery() as nursery:
            machine = BridgeTask(nursery)
            async with open_portal() as portal:
                node = CanopenNode(arguments, executor, machine, portal, outgoing)
                executor.add_node(node)
                thread = threading.Thread(target=node.live, name="executor", daemon=True)
                thread.start()
                await until_stopped(lambda: machine.failure is not None or not thread.is_alive())
            try:
                await machine.close()
            except EXPECTED as error:
                machine.failure = error
        if machine.failure is not None:
            node.get_logger().error(f"{machine.failure}")
        executor.shutdown(timeout_sec=PATIENCE)
        thread.join(PATIENCE)
    node.destroy_node()
    return 1 if node.has_failed or machine.failure is not None else 0


def main(argv: Sequence[str]) -> int:
    """Be the node; return the exit status."""
    rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    try:
        return trio.run(_run, remove_ros_args(list(argv))[1:])
    finally:
        rclpy.try_shutdown()
