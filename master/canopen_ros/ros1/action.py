"""The action `follow_joint_trajectory` of a chain, by actionlib: what MoveIt and rqt speak to."""

from __future__ import annotations

from collections.abc import Sequence

from canopen_master.errors import MasterClosedError
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.goals import Feedback, GoalCode, GoalOutcome, GoalResult, Tolerance, TrajectoryGoal, TrajectoryPoint
from canopen_ros.names import FOLLOW
from canopen_ros.ros1.rospy_types import GoalHandle, Message, actionlib, message_class, rospy, values
from canopen_ros.threads import OutgoingMessages, Portal


class TrajectoryAction:
    """The action server of one chain. Several goals at a time: the chain lets a new one take over from the one before."""

    def __init__(self, chain: ChainBridge, portal: Portal, outgoing: OutgoingMessages) -> None:
        """Register at the ROS master, which takes some time: not in trio's thread."""
        self._chain = chain
        self._portal = portal
        self._outgoing = outgoing
        self._goals: dict[str, _Goal] = {}
        action = message_class("msg", f"{FOLLOW.type}Action")
        server = actionlib().ActionServer(FOLLOW.of(chain.name), action, self._on_goal, self._on_cancel, auto_start=False)
        server.start()

    def _on_goal(self, handle: GoalHandle) -> None:
        goal = _Goal(handle, self._outgoing)
        self._goals[handle.get_goal_id().id] = goal
        self._portal.submit(self._follow, handle.get_goal_id().id, goal)

    def _on_cancel(self, handle: GoalHandle) -> None:
        goal = self._goals.get(handle.get_goal_id().id)
        if goal is not None:
            goal.is_cancelled = True
            self._portal.post(self._chain.cancel, goal.goal)

    async def _follow(self, goal_id: str, goal: _Goal) -> None:
        result = GoalResult(GoalCode.INVALID_GOAL, str(MasterClosedError()), GoalOutcome.ABORTED)
        try:
            if goal.is_cancelled:  # before it has begun
                result = GoalResult(GoalCode.SUCCESSFUL, "it was cancelled", GoalOutcome.PREEMPTED)
            else:
                result = await self._chain.follow(goal.goal, goal.tell, goal.accept)
        finally:
            del self._goals[goal_id]
            goal.end(result)


class _Goal:
    """One goal, and what its client is told. All of it goes through the publisher's thread, so that it keeps its order."""

    def __init__(self, handle: GoalHandle, outgoing: OutgoingMessages) -> None:
        self.goal = action_goal(handle.get_goal())
        self.is_cancelled = False
        self._handle = handle
        self._outgoing = outgoing
        self._is_accepted = False

    def accept(self) -> None:
        """Tell the client that the goal has been checked, and that the joints begin to move."""
        self._is_accepted = True
        self._outgoing.put(self._handle.set_accepted)

    def tell(self, feedback: Feedback) -> None:
        self._outgoing.put(self._publish, feedback)

    def _publish(self, feedback: Feedback) -> None:
        self._handle.publish_feedback(feedback_message(feedback))

    def end(self, result: GoalResult) -> None:
        """Tell the client how the goal ended."""
        message = message_class("msg", f"{FOLLOW.type}Result")(error_code=int(result.code), error_string=result.text)
        outcome = result.outcome
        if not self._is_accepted and outcome in (GoalOutcome.SUCCEEDED, GoalOutcome.ABORTED):
            self.accept()  # actionlib knows no other way from "pending" to these
        if outcome is GoalOutcome.REJECTED:
            tell = self._handle.set_rejected
        elif outcome is GoalOutcome.PREEMPTED:
            tell = self._handle.set_canceled
        elif outcome is GoalOutcome.ABORTED:
            tell = self._handle.set_aborted
        else:
            tell = self._handle.set_succeeded
        self._outgoing.put(tell, message, result.text)


def trajectory_goal(trajectory: Message) -> TrajectoryGoal:
    """Return the goal of a trajectory_msgs/JointTrajectory."""
    return TrajectoryGoal(
        tuple(trajectory.joint_names),
        [
            TrajectoryPoint(
                values(point.positions),
                values(point.velocities),
                values(point.accelerations),
                point.time_from_start.to_sec(),
            )
            for point in trajectory.points
        ],
        start=trajectory.header.stamp.to_nsec(),
    )


def action_goal(message: Message) -> TrajectoryGoal:
    """Return the goal of a control_msgs/FollowJointTrajectoryGoal."""
    goal = trajectory_goal(message.trajectory)
    return TrajectoryGoal(
        goal.joint_names,
        goal.points,
        _tolerances(message.path_tolerance),
        _tolerances(message.goal_tolerance),
        message.goal_time_tolerance.to_sec(),
        goal.start,
    )


def _tolerances(given: Sequence[Message]) -> list[Tolerance]:
    return [Tolerance(each.name, each.position, each.velocity, each.acceleration) for each in given]


def feedback_message(feedback: Feedback) -> Message:
    """Return a control_msgs/FollowJointTrajectoryFeedback."""
    message = message_class("msg", f"{FOLLOW.type}Feedback")()
    message.header.stamp = rospy().Time.now()
    message.joint_names = list(feedback.joint_names)
    for field, point in (("desired", feedback.desired), ("actual", feedback.actual), ("error", feedback.error)):
        told = getattr(message, field)
        told.positions, told.velocities = list(point.positions), list(point.velocities)
        told.accelerations = list(point.accelerations)
        told.time_from_start = rospy().Duration(*divmod(round(point.time_from_start * 1e9), 10**9))
    return message
