"""The master's side of one CiA 402 drive: the `Axis`, its limits, the watch on its path; the manual's sequences as procedures.

    reset_fault   0x0000, then 0x0080: the reset is a rising edge             manual: faultReset
    enable        up to Operation enabled, step by step                       manual: initDevice
    select_motionless_mode   a mode in which power alone moves nothing
    set_mode      0x6502 checked, 0x6060 written, 0x6061 awaited              manual: driveMode
    home          homing, to its end; home_if_needed                          manual: homing
    start_interpolation                                                       manual: enableIPmode
    start_cyclic_position, start_cyclic_velocity, start_cyclic_torque
    move_to       profile position: to one target
    move_along    profile position: a set of targets, each with its own profile
    apply_torque  profile torque for a time, then a halt
    run_at        profile velocity or velocity: at a velocity, until it is cancelled
    arm_probe, wait_for_probe, watch_probe, read_probe, disarm_probe          touch probes
    read_inputs, watch_inputs, set_outputs, read_encoder                      digital inputs and outputs, second encoder
    halt          bit 8: the drive stops by 0x605D and stays enabled
    quick_stop    the drive stops by 0x605A
    engage_brake  down to Ready to switch on                                  manual: enableBreak
    shut_down     unpowered (Switch on disabled)                              manual: shutdownDevice, with NMT stop

Chains take two more from their modules: set-points in profile position, for drives without ip and csp (slow_position.py), and the
mode and the PDOs for set-points by the drive's file alone (motion_plan.py).

A procedure that moves the drive halts it if the procedure is cancelled or fails. While one moves the drive, another is refused
(AxisBusyError), and a stop takes over: the first ends with TakenOverError (exclusive_motion.py). Bit 4 is cleared before each
homing and each start of interpolation: both begin on its rising edge.

watching.py waits, controlword.py commands, state.py changes states and modes, halting.py stops; homing.py, profile_position.py,
target_sequence.py, velocity.py, interpolation.py and synchronous.py move; failures.py has the errors.

A wait ends as soon as its goal is reached or out of reach: DriveInFaultError, StateLostError (a quick stop or disable that was
not ours), ModeLostError (another master wrote 0x6060), DriveLostError (boot-up, lost heartbeat), LimitReachedError, and only then
StepTimeoutError.

Source: IEC 61800-7-201 (CiA 402-2).
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
    from canopen_proto.drives.axis.following_procedures import OutOfBoundsError as OutOfBoundsError
    from canopen_proto.drives.axis.following_procedures import watch_bounds as watch_bounds
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
    from canopen_proto.drives.axis.motionless_mode import select_motionless_mode as select_motionless_mode
    from canopen_proto.drives.axis.profile_position import move_to as move_to
    from canopen_proto.drives.axis.state import change_state as change_state
    from canopen_proto.drives.axis.state import enable as enable
    from canopen_proto.drives.axis.state import engage_brake as engage_brake
    from canopen_proto.drives.axis.state import quick_stop as quick_stop
    from canopen_proto.drives.axis.state import reset_fault as reset_fault
    from canopen_proto.drives.axis.state import set_mode as set_mode
    from canopen_proto.drives.axis.state import shut_down as shut_down
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
    from canopen_proto.drives.axis.velocity import Running as Running
    from canopen_proto.drives.axis.velocity import choose_velocity_mode as choose_velocity_mode
    from canopen_proto.drives.axis.velocity import run_at as run_at
    from canopen_proto.drives.axis.watching import read_position as read_position
    from canopen_proto.drives.axis.watching import read_statusword as read_statusword
    from canopen_proto.drives.axis.watching import wait_for_statusword as wait_for_statusword
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
