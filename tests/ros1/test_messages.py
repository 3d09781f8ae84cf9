"""The message classes that we make have the md5 sums of the published ones: that is all that two ROS 1 nodes compare."""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_ros.ros1 import messages
from tests.ros1.ros_world import needs_ros

pytestmark = needs_ros

PUBLISHED = {
    "control_msgs.msg": {
        "JointTolerance": "f544fe9c16cf04547e135dd6063ff5be",
        "FollowJointTrajectoryGoal": "69636787b6ecbde4d61d711979bc7ecb",
        "FollowJointTrajectoryResult": "493383b18409bfb604b4e26c676401d2",
        "FollowJointTrajectoryFeedback": "10817c60c2486ef6b33e97dcd87f4474",
        "FollowJointTrajectoryActionGoal": "cff5c1d533bf2f82dd0138d57f4304bb",
        "FollowJointTrajectoryActionResult": "c4fb3b000dc9da4fd99699380efcc5d9",
        "FollowJointTrajectoryActionFeedback": "d8920dc4eae9fc107e00999cce4be641",
        "FollowJointTrajectoryAction": "bc4f9b743838566551c0390c65f1a248",
    },
    "canopen_chain_node.srv": {
        "GetObject": "acdd041126bee1cd6a04a75c17856af5",
        "SetObject": "274034f4defad2415049232c96e24954",
    },
}
"""As in code that others generated from the published packages and made public."""


@pytest.mark.parametrize("module", PUBLISHED)
def test_each_class_has_the_published_sum(module: str) -> None:
    messages.install()
    classes = vars(importlib.import_module(module))
    assert {name: classes[name]._md5sum for name in PUBLISHED[module]} == PUBLISHED[module]


def test_every_class_of_a_definition_is_compared() -> None:
    defined = {(source.package, source.name) for package in messages.packages() for source in messages.generate(package)}
    assert defined == {(module.partition(".")[0], name) for module, names in PUBLISHED.items() for name in names}


def test_a_message_comes_back_as_it_was() -> None:
    messages.install()
    msg = importlib.import_module("control_msgs.msg")
    goal = msg.FollowJointTrajectoryActionGoal()
    goal.goal_id.id = "1"
    goal.goal.trajectory.joint_names = ["joint1"]
    goal.goal.path_tolerance = [msg.JointTolerance(name="joint1", position=0.5)]
    data = io.BytesIO()
    goal.serialize(data)
    assert msg.FollowJointTrajectoryActionGoal().deserialize(data.getvalue()) == goal


def test_a_package_that_is_installed_is_not_replaced(tmp_path: Path) -> None:
    """Others' classes come first: here those that `write` made, as another process sees them."""
    messages.write(tmp_path)
    program = "\n".join(
        [
            "from canopen_ros.ros1 import messages",
            "messages.install()",
            "import control_msgs.msg, canopen_chain_node.srv",
            "print(control_msgs.__file__, control_msgs.msg.FollowJointTrajectoryAction._md5sum)",
            "print(canopen_chain_node.srv.GetObject._request_class().node == '')",
        ]
    )
    paths = [str(tmp_path), *filter(None, sys.path)]
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {paths!r}\n{program}"], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [
        str(tmp_path / "control_msgs" / "__init__.py"),
        PUBLISHED["control_msgs.msg"]["FollowJointTrajectoryAction"],
        "True",
    ]
