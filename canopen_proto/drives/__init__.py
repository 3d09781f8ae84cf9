"""Drives and motion control (CiA 402), the master's side, and the mathematics of their paths.

cia402/       states, modes and objects of the profile, as tables; the simulated drive uses them too
axis/         `Axis` and the procedures on it: enable, home, move, follow, halt; why a drive does not move
trajectory/   paths of several joints, their limits, and the clock that runs them
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.drives.axis import *  # noqa: F403 - all that the room names
    from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL as SCHUNK_POWERBALL
    from canopen_proto.drives.axis.axis import Axis as Axis
    from canopen_proto.drives.axis.axis import AxisSettings as AxisSettings
    from canopen_proto.drives.axis.axis import AxisStateChanged as AxisStateChanged
    from canopen_proto.drives.axis.axis import HomingStyle as HomingStyle
    from canopen_proto.drives.axis.following import FollowingLost as FollowingLost
    from canopen_proto.drives.axis.following import TurnToRead as TurnToRead
    from canopen_proto.drives.axis.limits import DriveLimits as DriveLimits
    from canopen_proto.drives.axis.limits import read_limits as read_limits
    from canopen_proto.drives.axis.motion_plan import MotionPlan as MotionPlan
    from canopen_proto.drives.axis.motion_plan import NoMotionPlanError as NoMotionPlanError
    from canopen_proto.drives.axis.motion_plan import plan_motion as plan_motion
    from canopen_proto.drives.axis.reasons import Reason as Reason
    from canopen_proto.drives.axis.reasons import reasons as reasons
    from canopen_proto.drives.axis.sub_modes import RecordPoint as RecordPoint
    from canopen_proto.drives.axis.units import DriveUnits as DriveUnits
    from canopen_proto.drives.axis.units import Unit as Unit
    from canopen_proto.drives.axis.watchdog import NotHeldError as NotHeldError
    from canopen_proto.drives.axis.watchdog import Watchdog as Watchdog
    from canopen_proto.drives.cia402.modes import Mode as Mode
    from canopen_proto.drives.cia402.modes import supported_modes as supported_modes
    from canopen_proto.drives.cia402.objects import CONTROLWORD as CONTROLWORD
    from canopen_proto.drives.cia402.objects import MODES_OF_OPERATION as MODES_OF_OPERATION
    from canopen_proto.drives.cia402.objects import MODES_OF_OPERATION_DISPLAY as MODES_OF_OPERATION_DISPLAY
    from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE as POSITION_ACTUAL_VALUE
    from canopen_proto.drives.cia402.objects import POSITION_WINDOW as POSITION_WINDOW
    from canopen_proto.drives.cia402.objects import STATUSWORD as STATUSWORD
    from canopen_proto.drives.cia402.objects import SUPPORTED_DRIVE_MODES as SUPPORTED_DRIVE_MODES
    from canopen_proto.drives.cia402.objects import TARGET_POSITION as TARGET_POSITION
    from canopen_proto.drives.cia402.objects import TARGET_TORQUE as TARGET_TORQUE
    from canopen_proto.drives.cia402.objects import TARGET_VELOCITY as TARGET_VELOCITY
    from canopen_proto.drives.cia402.objects import TORQUE_ACTUAL_VALUE as TORQUE_ACTUAL_VALUE
    from canopen_proto.drives.cia402.objects import VELOCITY_ACTUAL_VALUE as VELOCITY_ACTUAL_VALUE
    from canopen_proto.drives.cia402.states import Command as Command
    from canopen_proto.drives.cia402.states import State as State
    from canopen_proto.drives.cia402.states import state_of as state_of
    from canopen_proto.drives.trajectory import *  # noqa: F403 - all that the room names
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
