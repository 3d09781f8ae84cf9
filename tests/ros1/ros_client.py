"""A program: a client of the node, a process of its own for all requests of a test. A line of JSON each, in and out.

    ["call", "/arm/init"]           [true, "chain arm is ready"]
    ["state", "/arm"]               "moving"
    ["positions"]                   {"joint1": 0.2, ...}, of a message that comes from now on
    ["begin", {"points": [[60.0, {"joint1": 2.0}]]}]            [1, ""]: it is active, and moves
    ["goals", [{"points": [[2.0, {"joint1": 0.3}]]}, ...]]      what the action client was told of each; positions meanwhile

Each goal is sent when the one before moves. With "cancel": true it is cancelled when it moves.
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import actionlib
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from canopen_ros.ros1 import messages

messages.install()
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal, JointTolerance  # noqa: E402

LIMIT = 60.0
MOVES = 0.01
"""Radians from the start: it moves."""

FINAL = {2: "preempted", 3: "succeeded", 4: "aborted", 5: "rejected", 8: "recalled"}


class Goal:
    """A goal that was sent, and all that its client is told."""

    def __init__(self, client: Any, wanted: dict[str, Any]) -> None:
        """wanted: its points, and path tolerances."""
        self.seen: list[dict[str, dict[str, float]]] = []
        self.is_over = threading.Event()
        self.moves = threading.Event()
        self._handle = client.send_goal(goal_of(wanted), self._on_transition, self._on_feedback)

    def _on_feedback(self, handle: Any, message: Any) -> None:
        point = {
            field: dict(zip(message.joint_names, getattr(message, field).positions, strict=True))
            for field in ("desired", "actual", "error")
        }
        self.seen.append(point)
        first = self.seen[0]["actual"]
        if any(abs(value - first[name]) > MOVES for name, value in point["actual"].items()):
            self.moves.set()

    def _on_transition(self, handle: Any) -> None:
        if handle.get_comm_state() == actionlib.CommState.DONE:
            self.is_over.set()
            self.moves.set()

    def cancel(self) -> None:
        self._handle.cancel()

    def report(self) -> dict[str, Any]:
        result = self._handle.get_result()
        return {
            "outcome": FINAL.get(self._handle.get_goal_status(), self._handle.get_goal_status()),
            "text": self._handle.get_goal_status_text(),
            "code": None if result is None else result.error_code,
            "seen": self.seen,
        }


def goal_of(wanted: dict[str, Any]) -> Any:
    goal = FollowJointTrajectoryGoal()
    for seconds, positions in wanted["points"]:
        goal.trajectory.joint_names = list(positions)
        point = JointTrajectoryPoint(positions=list(positions.values()), time_from_start=rospy.Duration.from_sec(seconds))
        goal.trajectory.points.append(point)
    for name, position in wanted.get("path_tolerance", {}).items():
        goal.path_tolerance.append(JointTolerance(name=name, position=position))
    return goal


class Client:
    """The requests; see this module's text."""

    def __init__(self) -> None:
        self._words: dict[str, str] = {}
        self._seen: list[dict[str, float]] = []
        self._news = threading.Condition()
        self._action: Any = None
        rospy.Subscriber("/joint_states", JointState, self._on_positions)
        rospy.Subscriber("/arm/state", String, self._on_state)

    def _on_positions(self, message: Any) -> None:
        with self._news:
            self._seen.append(dict(zip(message.name, message.position, strict=True)))
            self._news.notify_all()

    def _on_state(self, message: Any) -> None:
        with self._news:
            self._words["/arm"] = message.data
            self._news.notify_all()

    def call(self, service: str) -> list[Any]:
        rospy.wait_for_service(service, LIMIT)
        answer = rospy.ServiceProxy(service, Trigger)()
        return [answer.success, answer.message]

    def state(self, chain: str) -> str:
        with self._news:
            assert self._news.wait_for(lambda: chain in self._words, LIMIT)
            return self._words[chain]

    def positions(self) -> dict[str, float]:
        with self._news:
            before = len(self._seen)
            assert self._news.wait_for(lambda: len(self._seen) > before, LIMIT)
            return self._seen[-1]

    def _action_client(self) -> Any:
        if self._action is None:
            self._action = actionlib.ActionClient("/arm/follow_joint_trajectory", FollowJointTrajectoryAction)
            assert self._action.wait_for_server(rospy.Duration.from_sec(LIMIT))
        return self._action

    def begin(self, wanted: dict[str, Any]) -> list[Any]:
        """Send a goal; answer with its status, and the text of that, when the joints move, or when it has ended."""
        goal = Goal(self._action_client(), wanted)
        assert goal.moves.wait(LIMIT)
        return [goal.report()["outcome"], goal.report()["text"]]

    def goals(self, all_wanted: list[dict[str, Any]]) -> dict[str, Any]:
        self.positions()
        first = len(self._seen)
        goals = []
        for wanted in all_wanted:
            goal = Goal(self._action_client(), wanted)
            goals.append(goal)
            assert goal.moves.wait(LIMIT)
            if wanted.get("cancel"):
                goal.cancel()
        for goal in goals:
            assert goal.is_over.wait(LIMIT)
        return {"goals": [goal.report() for goal in goals], "states": self._seen[first:]}


def main() -> None:
    rospy.init_node("ros_client", anonymous=True)
    client = Client()
    for line in sys.stdin:
        request, *arguments = json.loads(line)
        try:
            answer = getattr(client, request)(*arguments)
        except Exception as error:  # noqa: BLE001 - the test gets it
            answer = {"raised": repr(error)}
        print(json.dumps(answer), flush=True)


main()
