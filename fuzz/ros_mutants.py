"""Planted bugs of the ROS layer: who may move an arm, and what is told of it. No fuzz target knows it; tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

TAKE_OVER: Final = ("tests/ros/test_take_over.py",)
CONTROLLERS: Final = ("tests/ros/test_controllers.py",)

_BRIDGE: Final = "canopen_ros/bridge.py"
_CHAIN: Final = "canopen_ros/chain_bridge.py"
_TAKE_OVER: Final = "canopen_ros/take_over.py"

ROS_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "services_interrupt_nobody",
            _TAKE_OVER,
            "if self._chain.interruptions != self._interruptions:",
            "if self._chain.interruptions < self._interruptions:",
            "behind recover the arm moves to what a controller has held since before",
            CONTROLLERS,
        ),
        (
            "goals_interrupt_nobody",
            _TAKE_OVER,
            "        self.look()\n        self._forget(source)",
            "        self.look()",
            "a controller that goes on holding moves the arm back from where a goal took it",
            TAKE_OVER,
        ),
        (
            "one_zero_is_neutral",
            _TAKE_OVER,
            "if not any(velocities):",
            "if not all(velocities):",
            "a stick that is held in one axis moves the arm behind recover",
            TAKE_OVER,
        ),
        (
            "first_joint_counts",
            _TAKE_OVER,
            "if not distance <= self.tolerance and (worst",
            "if place == 0 and not distance <= self.tolerance and (worst",
            "a source is taken whose first joint alone is where it should be",
            TAKE_OVER,
        ),
        (
            "interrupted_too_late",
            _CHAIN,
            "            self._take_over.interrupt()  # before: else what comes as the chain begins to follow would move it\n",
            "",
            "what comes while a mode service runs moves the arm",
            TAKE_OVER,
        ),
        (
            "stopped_for_a_moment",
            _CHAIN,
            "        self._take_over.interrupt()\n        goals, motion",
            "        goals, motion",
            "the next message of a joystick undoes an empty trajectory, which stops the arm",
            TAKE_OVER,
        ),
        (
            "begun_in_any_order",
            "canopen_ros/threads.py",
            "await self._nursery.start(self._waiting[0])",
            "self._nursery.start_soon(self._nursery.start, self._waiting[0])",
            "a goal and the stop behind it come in one turn: the stop goes first, and the goal moves the arm",
            ("tests/ros/test_goals.py",),
        ),
        (
            "drops_what_is_later",
            _CHAIN,
            "for other in self._goals[: self._goals.index(motion)]:",
            "for other in self._goals:",
            "a goal that begins drops one that came after it: the arm goes to the older target",
            ("tests/ros/test_goals.py",),
        ),
        (
            "over_is_empty",
            "canopen_ros/goals.py",
            "if late >= points[-1].time:",
            "if late > points[-1].time:",
            "a trajectory that is just over stops the arm, and has succeeded",
            ("tests/ros/test_goals.py",),
        ),
        (
            "place_of_rest_unseen",
            _CHAIN,
            "aims = {place: target + braking_way(speeds.get(place, 0.0), limits[place]) for",
            "aims = {place: target for",
            "a source is taken that passes the joints at full speed",
            TAKE_OVER,
        ),
        (
            "told_once_for_all",
            _BRIDGE,
            "if what in self._reported and not is_news:",
            "if what in self._reported:",
            "behind recover nobody is told why a controller moves nothing",
            TAKE_OVER,
        ),
    )
)
