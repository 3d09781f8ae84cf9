"""Motions of several joints as mathematics: pure functions and small machines, no I/O, no bus.

    path.py            `Path`: positions of all joints over time, in pieces of polynomials
    limit_check.py     `JointLimits`: what a joint may do

Units: positions in the user's unit of each joint, times in seconds.
"""

from canopen_proto.trajectory.limit_check import JointLimits as JointLimits
from canopen_proto.trajectory.path import Path as Path
from canopen_proto.trajectory.path import PathError as PathError
from canopen_proto.trajectory.path import PathPoint as PathPoint
from canopen_proto.trajectory.path import Segment as Segment
