"""Drives and motion control (CiA 402), the master's side, and the mathematics of their paths.

cia402/       states, modes and objects of the profile, as tables; the simulated drive uses them too
axis/         `Axis` and the procedures on it: enable, home, move, follow, halt; why a drive does not move
trajectory/   paths of several joints, their limits, and the clock that runs them
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL as SCHUNK_POWERBALL
    from canopen_proto.drives.axis.axis import Axis as Axis
    from canopen_proto.drives.axis.axis import AxisSettings as AxisSettings
    from canopen_proto.drives.axis.axis import AxisStateChanged as AxisStateChanged
    from canopen_proto.drives.axis.axis import HomingStyle as HomingStyle
    from canopen_proto.drives.axis.bounds import bounds_of as bounds_of
    from canopen_proto.drives.axis.controlword import command as command
    from canopen_proto.drives.axis.digital_io import DigitalInputsChanged as DigitalInputsChanged
    from canopen_proto.drives.axis.digital_io import Input as Input
    from canopen_proto.drives.axis.digital_io import read_encoder as read_encoder
    from canopen_proto.drives.axis.digital_io import read_inputs as read_inputs
    from canopen_proto.drives.axis.digital_io import set_outputs as set_outputs
    from canopen_proto.drives.axis.digital_io import watch_inputs as watch_inputs
    from canopen_proto.drives.axis.failures import AxisBusyError as AxisBusyError
    from canopen_proto.drives.axis.failures import DriveAccessError as DriveAccessError
    from canopen_proto.drives.axis.failures import DriveError as DriveError
    from canopen_proto.drives.axis.failures import DriveInFaultError as DriveInFaultError
    from canopen_proto.drives.axis.failures import DriveLostError as DriveLostError
    from canopen_proto.drives.axis.failures import DriveTimeoutError as DriveTimeoutError
    from canopen_proto.drives.axis.failures import HomingError as HomingError
    from canopen_proto.drives.axis.failures import LimitReachedError as LimitReachedError
    from canopen_proto.drives.axis.failures import ModeLostError as ModeLostError
    from canopen_proto.drives.axis.failures import ModeUnsupportedError as ModeUnsupportedError
    from canopen_proto.drives.axis.failures import ReferenceLostError as ReferenceLostError
    from canopen_proto.drives.axis.failures import StateLostError as StateLostError
    from canopen_proto.drives.axis.failures import TakenOverError as TakenOverError
    from canopen_proto.drives.axis.failures import fault_of as fault_of
    from canopen_proto.drives.axis.following import FollowingLost as FollowingLost
    from canopen_proto.drives.axis.following import OutOfBoundsError as OutOfBoundsError
    from canopen_proto.drives.axis.following import TurnToRead as TurnToRead
    from canopen_proto.drives.axis.following import watch_bounds as watch_bounds
    from canopen_proto.drives.axis.halting import halt as halt
    from canopen_proto.drives.axis.halting import halt_after as halt_after
    from canopen_proto.drives.axis.homing import HomingProgressed as HomingProgressed
    from canopen_proto.drives.axis.homing import home as home
    from canopen_proto.drives.axis.homing import home_if_needed as home_if_needed
    from canopen_proto.drives.axis.homing_parameters import read_homing_methods as read_homing_methods
    from canopen_proto.drives.axis.identity import identify as identify
    from canopen_proto.drives.axis.identity import learn_units as learn_units
    from canopen_proto.drives.axis.interpolation import InterpolationBuffer as InterpolationBuffer
    from canopen_proto.drives.axis.interpolation import start_interpolation as start_interpolation
    from canopen_proto.drives.axis.limits import DriveLimits as DriveLimits
    from canopen_proto.drives.axis.limits import read_limits as read_limits
    from canopen_proto.drives.axis.motion_plan import MotionPlan as MotionPlan
    from canopen_proto.drives.axis.motion_plan import NoMotionPlanError as NoMotionPlanError
    from canopen_proto.drives.axis.motion_plan import plan_motion as plan_motion
    from canopen_proto.drives.axis.motionless_mode import select_motionless_mode as select_motionless_mode
    from canopen_proto.drives.axis.profile_position import move_to as move_to
    from canopen_proto.drives.axis.reasons import Reason as Reason
    from canopen_proto.drives.axis.reasons import reasons as reasons
    from canopen_proto.drives.axis.state import change_state as change_state
    from canopen_proto.drives.axis.state import enable as enable
    from canopen_proto.drives.axis.state import engage_brake as engage_brake
    from canopen_proto.drives.axis.state import quick_stop as quick_stop
    from canopen_proto.drives.axis.state import reset_fault as reset_fault
    from canopen_proto.drives.axis.state import set_mode as set_mode
    from canopen_proto.drives.axis.state import shut_down as shut_down
    from canopen_proto.drives.axis.sub_modes import RecordPoint as RecordPoint
    from canopen_proto.drives.axis.synchronous import start_cyclic_position as start_cyclic_position
    from canopen_proto.drives.axis.synchronous import start_cyclic_torque as start_cyclic_torque
    from canopen_proto.drives.axis.synchronous import start_cyclic_velocity as start_cyclic_velocity
    from canopen_proto.drives.axis.target_sequence import ProfileTarget as ProfileTarget
    from canopen_proto.drives.axis.target_sequence import RelativeTo as RelativeTo
    from canopen_proto.drives.axis.target_sequence import RotaryDirection as RotaryDirection
    from canopen_proto.drives.axis.target_sequence import Start as Start
    from canopen_proto.drives.axis.target_sequence import move_along as move_along
    from canopen_proto.drives.axis.torque import apply_torque as apply_torque
    from canopen_proto.drives.axis.touch_probe import ProbeLatched as ProbeLatched
    from canopen_proto.drives.axis.touch_probe import ProbeReading as ProbeReading
    from canopen_proto.drives.axis.touch_probe import ProbeSource as ProbeSource
    from canopen_proto.drives.axis.touch_probe import arm_probe as arm_probe
    from canopen_proto.drives.axis.touch_probe import disarm_probe as disarm_probe
    from canopen_proto.drives.axis.touch_probe import read_probe as read_probe
    from canopen_proto.drives.axis.touch_probe import wait_for_probe as wait_for_probe
    from canopen_proto.drives.axis.touch_probe import watch_probe as watch_probe
    from canopen_proto.drives.axis.units import DriveUnits as DriveUnits
    from canopen_proto.drives.axis.units import Unit as Unit
    from canopen_proto.drives.axis.velocity import Running as Running
    from canopen_proto.drives.axis.velocity import choose_velocity_mode as choose_velocity_mode
    from canopen_proto.drives.axis.velocity import run_at as run_at
    from canopen_proto.drives.axis.watchdog import NotHeldError as NotHeldError
    from canopen_proto.drives.axis.watchdog import Watchdog as Watchdog
    from canopen_proto.drives.axis.watching import read_position as read_position
    from canopen_proto.drives.axis.watching import read_statusword as read_statusword
    from canopen_proto.drives.axis.watching import wait_for_statusword as wait_for_statusword
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
    from canopen_proto.drives.trajectory.interpolation import cubic as cubic
    from canopen_proto.drives.trajectory.interpolation import from_function as from_function
    from canopen_proto.drives.trajectory.interpolation import linear as linear
    from canopen_proto.drives.trajectory.interpolation import quintic as quintic
    from canopen_proto.drives.trajectory.limit_check import JointLimits as JointLimits
    from canopen_proto.drives.trajectory.limit_check import LimitViolation as LimitViolation
    from canopen_proto.drives.trajectory.limit_check import first_violation as first_violation
    from canopen_proto.drives.trajectory.path import Path as Path
    from canopen_proto.drives.trajectory.path import PathError as PathError
    from canopen_proto.drives.trajectory.path import PathPoint as PathPoint
    from canopen_proto.drives.trajectory.path import Segment as Segment
    from canopen_proto.drives.trajectory.path_clock import PathClock as PathClock
    from canopen_proto.drives.trajectory.speed_change import SpeedChange as SpeedChange
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
