"""`Drive`: a simulated CiA 402 drive, the device's side of the profile. It works on the `Values` of the node that hosts it.

The drive is the application of a `LocalNode`. The node stores an object (written by SDO or PDO alike), then calls `written`. The
drive answers by writing its own objects into the same store: statusword, actual values, mode display. It reports faults by the
events `DriveFault` and `DriveFaultCleared`; the node makes EMCYs of them.

- The state machine is the table in `states.py`. A command acts when its controlword is written; the stored word does nothing by
  itself. An edge (fault reset, new set-point) is a change from the word written before: a PDO repeated for ever makes one edge.
- The option codes decide how the drive leaves Operation enabled: 605Ah quick stop, 605Bh shutdown, 605Ch disable operation, 605Eh
  fault reaction. While a ramp of 605Bh or 605Ch runs, the state stays Operation enabled; the transition follows at its end.
- Motion is closed form (`servo.py`), so time costs little. The drive wakes every STEP while something moves or is watched, and at
  the end of a motion that something waits for; else never. `refresh(now)` brings the store up to date before a TPDO is built or
  an SDO reads.
- Connection lost (heartbeat, NMT stop or reset): 6007h says 0 nothing, 1 fault, 2 disable voltage, 3 quick stop. (Drives disagree
  on 2 and 3; this follows CiA 402.) A drive without 6007h does nothing. SYNC or an RPDO lost: see synchronous_modes.py.

Source: IEC 61800-7-201 (CiA 402-2): device control, common entries, option codes.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from canopen_proto.abort import AbortCode
from canopen_proto.communication_errors import EMCY_COMMUNICATION, EMCY_CONNECTION_LOST
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeStatus, supported
from canopen_proto.drives.cia402.option_codes import STAYS_FROM
from canopen_proto.drives.cia402.states import TRANSITIONS, Arc, Command, ControlBit, Occurrence, State, command_of
from canopen_proto.error_codes import register_bits_of
from canopen_proto.machine import MILLISECOND, NEVER, Machine, Outbox, Time
from canopen_proto.multiplexer import Mux, mux, split_mux
from canopen_proto.simulation.drive.dictionary import ALLOWED_VALUES
from canopen_proto.simulation.drive.display import show_values, statusword_of
from canopen_proto.simulation.drive.events import DriveFault, DriveFaultCleared, DriveStateChanged, ModeChanged, StatuswordChanged
from canopen_proto.simulation.drive.fallbacks import TORQUE_LIMITS
from canopen_proto.simulation.drive.homing import Homing, has_method
from canopen_proto.simulation.drive.inputs import Inputs
from canopen_proto.simulation.drive.interpolated_position import POSITION_AND_VELOCITY, InterpolatedPosition
from canopen_proto.simulation.drive.profile_modes import OperationMode, ProfileVelocity, Velocity
from canopen_proto.simulation.drive.profile_position import ProfilePosition
from canopen_proto.simulation.drive.servo import UNLIMITED, Servo
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_proto.simulation.drive.synchronous_modes import CyclicPosition
from canopen_proto.simulation.drive.torque_modes import CyclicTorque, CyclicVelocity, ProfileTorque

STEP: Final = 10 * MILLISECOND
"""Between two checks of a moving drive: following error, switches, target window. Positions do not depend on it."""

FOLLOWING_ERROR: Final = 0x8611
_CONNECTION_FAULTS: Final = frozenset((EMCY_CONNECTION_LOST, EMCY_COMMUNICATION))

_NO_STATES: Final = (State.UNKNOWN, State.NOT_READY_TO_SWITCH_ON)
_ENERGISED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_IN_ORDER: Final = (5, 8)  # transitions by which a drive that stands is disabled in order
_ACT_AT_ONCE: Final = {*TORQUE_LIMITS, objects.DIGITAL_OUTPUTS, objects.DIGITAL_OUTPUT_MASK, objects.TOUCH_PROBE_FUNCTION}
_SHOWS_FOLLOWING_ERROR: Final = (Mode.PROFILE_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION)
_STAY_IN_QUICK_STOP: Final = range(STAYS_FROM, STAYS_FROM + 4)
_LATE: Final = (objects.CONTROLWORD, objects.MODES_OF_OPERATION)
_POWER: Final = {
    State.READY_TO_SWITCH_ON: 1,
    State.SWITCHED_ON: 2,
    State.OPERATION_ENABLED: 3,
    State.QUICK_STOP_ACTIVE: 3,
    State.FAULT_REACTION_ACTIVE: 3,
}
"""How near a state is to Operation enabled; 0 for all others."""


class Drive(Machine):
    """A simulated drive. Nothing happens before `reset`, which is its power-on.

    values: of a dictionary such as `drive_dictionary` makes; objects that it lacks have the values of fallbacks.FALLBACKS. state,
    mode: as statusword and 6061h show them. axis: of its node; a further one (axes.py) has values of its own, with the numbers of
    the first axis.
    """

    def __init__(self, out: Outbox, node_id: int, values: Values, settings: DriveSettings, axis: int = 0) -> None:
        super().__init__(out)
        self.axis = axis
        self.node_id = node_id
        self.values = values
        self.settings = settings
        self.state = State.UNKNOWN
        self.mode: int = Mode.NO_MODE
        self._servo = Servo(values.store, settings)
        common = (self._servo, out, node_id)
        self._homing, self._inputs = Homing(*common), Inputs(*common, axis)
        self._modes = _modes_of(*common, self._homing)
        self._mode = self._modes[Mode.NO_MODE]
        self._controlword = 0
        self._after_stop: Command | Occurrence | None = None  # to execute when the present ramp has ended
        self._is_opening = False  # operation is enabled as soon as the brake is open
        self._torque_is_off = settings.torque_is_off
        self._ready_at: Time = NEVER
        self._deviates_since: Time | None = None
        self._faults: list[int] = []
        self._lasting_faults: set[int] = set()

    # ---- commands of the node that hosts it ----

    def set_node_id(self, node_id: int) -> None:
        """Be a drive of another node from now on (LSS): events tell it."""
        self.node_id = self._inputs.node_id = node_id
        for mode in self._modes.values():
            mode.node_id = node_id

    def reset(self, now: Time) -> None:
        """Power on: transition 0 and, after `settings.self_test`, 1. The node has restored the values before.

        The axis stays where it is, but has lost its reference: position 0 is that of the track, and it must be homed.
        """
        servo = self._servo
        servo.advance(now)
        servo.zero = 0.0
        self._homing.is_referenced = False
        self._mode.leave()
        self._faults.clear()
        self._lasting_faults.discard(self.settings.sto_fault)
        self._controlword = 0
        self._put(objects.CONTROLWORD, 0)
        self._put(objects.ERROR_CODE, 0)
        self.state = State.UNKNOWN
        self._enter(TRANSITIONS[self.state, Occurrence.POWER_ON])
        self._ready_at = servo.time + self.settings.self_test
        self.mode = Mode.NO_MODE
        self._mode = self._modes[Mode.NO_MODE]
        self._select_mode()
        servo.command_brake()
        self._look()
        self._show()

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code if the drive refuses this value now, else None. Called after the checks of type and limits,
        before the value is stored."""
        key = mux(index, subindex)
        if not isinstance(value, int):
            return None
        is_mode = key == objects.MODES_OF_OPERATION
        if is_mode:
            has_value = self._has_mode(value)
        elif key == objects.HOMING_METHOD:
            has_value = has_method(self._servo, value)
        else:
            has_value = value in ALLOWED_VALUES.get(key, (value,))
        if not has_value and value != self._servo.parameter(key):  # the value that a file gave it may be written back
            return AbortCode.INVALID_VALUE
        if is_mode and value != self.mode and not self._changes_mode():
            return AbortCode.DEVICE_STATE
        if isinstance(mode := self._mode, InterpolatedPosition) and key == mode.record_end and mode.is_full:
            return AbortCode.DEVICE_STATE
        needs_velocity = key == objects.INTERPOLATION_SUB_MODE_SELECT and value == POSITION_AND_VELOCITY
        if needs_velocity and objects.INTERPOLATION_VELOCITY not in self.values.dictionary:
            return AbortCode.INVALID_VALUE
        return None

    def written(self, index: int, subindex: int, now: Time) -> None:
        """Act on an object that was written by SDO or PDO, with a new value or the same: a command takes effect at once."""
        key = mux(index, subindex)
        if self.state in _NO_STATES:
            return
        if key == objects.CONTROLWORD:
            word = self._servo.parameter(key)
            self._controlword, self._mode.released = self._controlword & ~self._mode.released, 0
            command = command_of(word, self._controlword)
            if word == self._controlword and (command is None or (self.state, command) not in TRANSITIONS):
                return  # the same value again, as in each cycle
            self._advance(now)
            self._control(word, command)
        elif key == objects.MODES_OF_OPERATION:
            self._advance(now)
            self._select_mode()
        elif key in self._mode.listens_to and self._acts:
            self._advance(now)
            self._mode.written(key)
        elif key in _ACT_AT_ONCE:
            self._advance(now)
            if key in TORQUE_LIMITS:
                self._servo.limit_torque()
            elif key != objects.TOUCH_PROBE_FUNCTION:
                self._servo.command_brake()
        else:
            return
        self._show()

    def on_sync(self, now: Time) -> None:
        """Act on a SYNC. The node has stored the synchronous RPDOs that came before it, and called `written` for them."""
        self._advance(now)
        if self._acts:
            self._mode.on_sync()
        self._show(2 * STEP)  # the next SYNC most likely comes earlier and checks, too

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> None:
        """Bring statusword and actual values in the store up to `now`. Called before a TPDO is built, or an SDO reads."""
        if now > self._servo.time and self.deadline != NEVER:
            self._advance(now)
            self._show()

    def connection_lost(self, now: Time, error_code: int) -> None:
        """Act by 6007h: the master fell silent, or NMT has taken the node from it. error_code: of the fault, if 6007h asks for
        one. A lost heartbeat that also ends Operational makes one fault, not two."""
        self._advance(now)
        match self._servo.parameter(objects.ABORT_CONNECTION_OPTION_CODE):
            case 1:
                if not _CONNECTION_FAULTS.intersection(self._faults):
                    self._fault(error_code)
            case 2:
                self._execute(Command.DISABLE_VOLTAGE)
            case 3:
                self._execute(Command.QUICK_STOP)
        self._show()

    def rpdo_overdue(self, now: Time) -> None:
        """Stop following and brake, in ip and csp: an RPDO did not come within its event time."""
        self._advance(now)
        if self._acts:
            self._mode.rpdo_lost()
        self._show()

    def raise_fault(self, error_code: int, now: Time, *, lasting: bool = False) -> None:
        """Make a fault in the drive, for a test or demo: transition 13, and a DriveFault event.

        error_code: 1..0xFFFF, as in CiA 402. lasting: the cause stays, and no fault reset helps, until `end_fault`.
        """
        self._advance(now)
        if lasting:
            self._lasting_faults.add(error_code)
        self._fault(error_code)
        self._show()

    def end_fault(self, error_code: int) -> None:
        """End the cause of a lasting fault: a fault reset clears it then. error_code: as it was raised."""
        self._lasting_faults.discard(error_code)

    def block(self, blocked: bool, now: Time) -> None:
        """Block the axis mechanically, or free it: a blocked drive that is to move gets a following error."""
        self._advance(now)
        self._servo.block(blocked)
        self._show()

    def set_safe_torque_off(self, is_active: bool, now: Time) -> None:
        """Switch the STO input (IEC 61800-5-2). Active: no torque from now on, also after a power-on, until it is switched back.

        A drive goes to Switch on disabled; if it has power and `DriveSettings.sto_fault` names a fault, into that. The axis runs
        on until friction or the brake has stopped it. No command leads out of Switch on disabled; no reset ends the fault.
        """
        self._advance(now)
        self._torque_is_off = is_active
        fault = self.settings.sto_fault
        if not is_active:
            self._lasting_faults.discard(fault)
        else:
            had_power = self._servo.is_powered
            self._servo.release()
            if fault and had_power:
                self._lasting_faults.add(fault)
                self._fault(fault)
            self._execute(Command.DISABLE_VOLTAGE)
            self._end_stop()
        self._show()

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self._advance(now)
        if self._acts and now >= self._mode.due:  # only here: a SYNC that waited while our process slept is in time
            self._mode.sync_lost()
        self._show()

    # ---- the state machine ----

    def _control(self, word: int, command: Command | None) -> None:
        previous, self._controlword = self._controlword, word
        if command is not None:
            self._execute(command)
        if self._acts:
            self._mode.control(word, previous)

    def _execute(self, command: Command) -> None:
        """Walk the arcs of a command: one, or two for "switch on and enable operation"."""
        if self._after_stop is not None and self.state is State.OPERATION_ENABLED:
            if command is self._after_stop:
                return  # it is under way already
            if command is Command.ENABLE_OPERATION:  # the master changed its mind: the axis stops, but the drive stays enabled
                self._after_stop = None
                self._mode.enter()
                return
        if self._is_opening and command is not Command.ENABLE_OPERATION:
            self._is_opening = False
            self._servo.release()
        while (arc := TRANSITIONS.get((self.state, command))) is not None and self._permits(command):
            if self.state is State.OPERATION_ENABLED and self._stops_first(command):
                return
            if arc[0] is State.OPERATION_ENABLED and self._opens_first():
                return
            self._enter(arc)

    def _permits(self, command: Command) -> bool:
        """Return whether the drive permits a command, by conditions that are not in the table of transitions."""
        if self.state is State.FAULT:
            return not self._lasting_faults
        if self.state is State.SWITCH_ON_DISABLED:
            return not self._torque_is_off
        if self.state is State.QUICK_STOP_ACTIVE and command is Command.ENABLE_OPERATION:
            return self._servo.parameter(objects.QUICK_STOP_OPTION_CODE) in _STAY_IN_QUICK_STOP
        return True

    def _stops_first(self, command: Command) -> bool:
        """Start the ramp that comes before this command's transition (605Bh, 605Ch), if any; return whether there is one."""
        options = {
            Command.SHUTDOWN: objects.SHUTDOWN_OPTION_CODE,
            Command.DISABLE_OPERATION: objects.DISABLE_OPERATION_OPTION_CODE,
        }
        if command not in options or self._servo.parameter(options[command]) == 0 or not self._servo.is_moving:
            return False
        self._mode.leave()
        self._servo.brake(self._mode.ramp(1))
        self._after_stop = command
        return True

    def _opens_first(self) -> bool:
        """Put the power on, and return whether the brake has to open before operation is enabled (transition 4)."""
        if not self._servo.is_powered:
            self._servo.energise()
        self._is_opening = self._servo.opens_brake
        return self._is_opening

    def _occur(self, occurrence: Occurrence) -> None:
        self._enter(TRANSITIONS[self.state, occurrence])

    def _enter(self, arc: Arc) -> None:
        """Take a transition: the only place where the state changes."""
        previous = self.state
        self.state, transition = arc
        self.out.events.append(DriveStateChanged(self.node_id, previous, self.state, transition, self.axis))
        servo = self._servo
        holds = self._after_stop is not None or (transition in _IN_ORDER and not servo.is_moving)
        self._is_opening = False
        if previous is State.OPERATION_ENABLED and self._after_stop is None:
            self._mode.leave()  # unless it left before a ramp that has now ended
        self._after_stop = None
        match self.state:
            case State.OPERATION_ENABLED:
                self._deviates_since = None
                self._mode.enter()
            case State.QUICK_STOP_ACTIVE:
                option = servo.parameter(objects.QUICK_STOP_OPTION_CODE)
                stays = option in _STAY_IN_QUICK_STOP
                self._stop_by(option - STAYS_FROM + 1 if stays else option, None if stays else Occurrence.QUICK_STOP_FINISHED)
            case State.FAULT_REACTION_ACTIVE:
                option = (
                    servo.parameter(objects.FAULT_REACTION_OPTION_CODE)
                    if previous in _ENERGISED and not self._torque_is_off
                    else 0
                )
                self._stop_by(option, Occurrence.FAULT_REACTION_FINISHED)
            case State.SWITCH_ON_DISABLED if previous is State.FAULT:
                self._put(objects.ERROR_CODE, 0)
                self.out.events.extend(DriveFaultCleared(self.node_id, code, self.axis) for code in self._faults)
                self._faults.clear()
            case _:
                servo.release(holds=holds and not self._torque_is_off)

    def _stop_by(self, option: int, then: Occurrence | None) -> None:
        """Stop by an option code (0: take the power off); `then` follows."""
        if option == 0:
            self._servo.release()
        else:
            self._servo.brake(self._mode.ramp(option))
        self._after_stop = then
        self._end_stop()

    def _end_stop(self) -> None:
        """Once the axis has stopped, do what was to follow."""
        following = self._after_stop
        if following is not None and self._servo.has_stopped:
            self._enter(TRANSITIONS[self.state, following])

    def _fault(self, error_code: int) -> None:
        if self.state is State.UNKNOWN or error_code in self._faults:
            return
        self._faults.append(error_code)
        self._put(objects.ERROR_CODE, error_code)
        self.out.events.append(DriveFault(self.node_id, error_code, int(register_bits_of(error_code)), self.axis))
        if (self.state, Occurrence.FAULT_DETECTED) in TRANSITIONS:
            self._occur(Occurrence.FAULT_DETECTED)

    # ---- modes ----

    @property
    def _acts(self) -> bool:
        """Whether the mode controls the axis: operation is enabled, and not about to end."""
        return self.state is State.OPERATION_ENABLED and self._after_stop is None

    def _has_mode(self, mode: int) -> bool:
        """Return whether a mode can be selected: "no mode" always; without 6502h any; on a Schunk homing, whatever 6502h says."""
        if mode == Mode.NO_MODE or (mode == Mode.HOMING and self.settings.shape is Shape.SCHUNK_POWERBALL):
            return True
        known = self.values.store.get(objects.SUPPORTED_DRIVE_MODES)
        return mode in self._modes and (mode < 0 or not isinstance(known, int) or supported(known, mode))

    def _changes_mode(self) -> bool:
        """Return whether the drive takes another mode in its state, after its controlword."""
        if self._controlword & ControlBit.HALT and not self.settings.changes_mode_halted:
            return False
        return _POWER.get(self.state, 0) <= _POWER.get(self.settings.mode_change_state, 0)

    def _select_mode(self) -> None:
        """Select the mode of 6060h. A mode that the drive lacks, or does not take now (an RPDO can write it), changes nothing, as
        6061h shows."""
        mode = self._servo.parameter(objects.MODES_OF_OPERATION)
        if mode != self.mode and self._has_mode(mode) and self._changes_mode():
            if self._acts:
                self._mode.leave()
                self._servo.brake(self._mode.ramp(1))
            self.mode = mode
            self._mode = self._modes[mode]
            if self._acts:
                self._mode.enter()
                self._mode.control(self._controlword, self._controlword)
        if self.values.store.get(objects.MODES_OF_OPERATION_DISPLAY) != self.mode:
            self._put(objects.MODES_OF_OPERATION_DISPLAY, self.mode)
            self.out.events.append(ModeChanged(self.node_id, self.mode, self.axis))

    # ---- time, and the values in the store ----

    def _advance(self, now: Time) -> None:
        self._servo.advance(now)
        self._look()

    def _look(self) -> None:
        """Act on what has happened since the last check."""
        servo = self._servo
        if self.state is State.NOT_READY_TO_SWITCH_ON and servo.time >= self._ready_at:
            self._occur(Occurrence.SELF_TEST_PASSED)
            for code in sorted(self._lasting_faults):
                self._fault(code)
        if self._after_stop is not None:
            self._end_stop()
        if self._is_opening and not servo.opens_brake:
            self._enter(TRANSITIONS[self.state, Command.ENABLE_OPERATION])
            self._mode.control(self._controlword, self._controlword)
        if self.settings.overload_fault and servo.is_overloaded and self.state in _ENERGISED:
            self._fault(self.settings.overload_fault)
        if self._acts:
            if servo.has_met_switch:
                servo.has_met_switch = False  # told once
                self._mode.stopped_by_switch()
            self._mode.tick()
        if self.state in _ENERGISED:
            self._watch_following_error()
        else:
            self._deviates_since = None

    def _watch_following_error(self) -> None:
        """Make a fault if the axis was further from its demand than 6065h for longer than 6066h."""
        servo = self._servo
        window = servo.parameter(objects.FOLLOWING_ERROR_WINDOW)
        if abs(servo.following_error) <= window or window == UNLIMITED:
            self._deviates_since = None
            return
        if self._deviates_since is None:
            self._deviates_since = servo.time
        if servo.time - self._deviates_since >= servo.parameter(objects.FOLLOWING_ERROR_TIME_OUT) * MILLISECOND:
            self._fault(FOLLOWING_ERROR)

    def _put(self, key: Mux, value: int) -> None:
        self.values.store[key] = value

    def _show(self, step: Time = STEP) -> None:
        """Show the present values, and ask for the next wake."""
        self._publish()
        self._schedule(step)

    def _publish(self) -> None:
        shown = self.values.store.get(objects.STATUSWORD)
        statusword = self._statusword()
        self._put(objects.STATUSWORD, statusword)
        show_values(self._servo, torque_is_off=self._torque_is_off)
        self._inputs.look()
        if statusword != shown:
            self.out.events.append(StatuswordChanged(self.node_id, statusword, self.axis))

    def _statusword(self) -> int:
        mode_status = 0
        if self.state is State.OPERATION_ENABLED:
            mode_status = self._mode.status
            if self._deviates_since is not None and self.mode in _SHOWS_FOLLOWING_ERROR:
                mode_status |= ModeStatus.FOLLOWING_ERROR
        return statusword_of(self.state, mode_status, self._servo, is_referenced=self._homing.is_referenced)

    def _schedule(self, step: Time = STEP) -> None:
        servo = self._servo
        due = self._mode.due if self._acts else NEVER
        if self.state is State.NOT_READY_TO_SWITCH_ON:
            self._arm(self._ready_at)
        elif (
            servo.is_settled
            and self._deviates_since is None
            and not self._is_opening
            and not (self._acts and self._mode.is_waiting)
        ):
            self._arm(due)
        else:
            wake, end = min(servo.time + step, due), servo.demand.end
            awaits_end = self._after_stop is not None or self._mode.awaits_end
            self._arm(end if awaits_end and servo.time < end < wake else wake)


def _modes_of(servo: Servo, out: Outbox, node_id: int, homing: Homing) -> dict[int, OperationMode]:
    """Return the modes that a drive can be in, by number; which of them it has, 6502h says."""
    common = (servo, out, node_id)
    return {
        Mode.NO_MODE: OperationMode(*common),
        Mode.PROFILE_POSITION: ProfilePosition(*common),
        Mode.VELOCITY: Velocity(*common),
        Mode.PROFILE_VELOCITY: ProfileVelocity(*common),
        Mode.TORQUE: ProfileTorque(*common),
        Mode.HOMING: homing,
        Mode.INTERPOLATED_POSITION: InterpolatedPosition(*common),
        Mode.CYCLIC_SYNCHRONOUS_POSITION: CyclicPosition(*common),
        Mode.CYCLIC_SYNCHRONOUS_VELOCITY: CyclicVelocity(*common),
        Mode.CYCLIC_SYNCHRONOUS_TORQUE: CyclicTorque(*common),
        **{mode: OperationMode(*common) for mode in servo.settings.own_modes},
    }


class LateDrive(Drive):
    """A simulated drive that obeys its commands late, as real ones do.

    Controlwords and modes (6060h) take effect `DriveSettings.reaction` after they came, in the order in which they came; all else
    is as in `Drive`. Until then statusword and mode display show the old values: a master that looks too early sees the past.
    """

    def __init__(self, out: Outbox, node_id: int, values: Values, settings: DriveSettings, axis: int = 0) -> None:
        super().__init__(out, node_id, values, settings, axis)
        self._late: deque[tuple[Time, Mux, int]] = deque()  # when it takes effect, key, value
        self._obeys = False

    def reset(self, now: Time) -> None:
        self._late.clear()
        super().reset(now)

    def written(self, index: int, subindex: int, now: Time) -> None:
        key = mux(index, subindex)
        if key not in _LATE:
            super().written(index, subindex, now)
            return
        value = self._servo.parameter(key)
        last = next((late[2] for late in reversed(self._late) if late[1] == key), None)
        if value != last:  # else the same value again, as in each cycle
            self._late.append((now + self.settings.reaction, key, value))
            self._schedule()

    def connection_lost(self, now: Time, error_code: int) -> None:
        """Act as `Drive` does, and obey no controlword from before: it would enable the drive again, with nobody to stop it."""
        if self._servo.parameter(objects.ABORT_CONNECTION_OPTION_CODE):
            self._late = deque(late for late in self._late if late[1] != objects.CONTROLWORD)
        super().connection_lost(now, error_code)

    def _advance(self, now: Time) -> None:
        while not self._obeys and self._late and self._late[0][0] <= now:
            self._obey(*self._late.popleft())
        super()._advance(now)

    def _obey(self, time: Time, key: Mux, value: int) -> None:
        store = self.values.store
        newest, store[key] = store[key], value
        self._obeys = True  # one after the other, also those of one PDO
        index, subindex = split_mux(key)
        super().written(index, subindex, time)
        self._obeys = False
        store[key] = newest

    def _schedule(self, step: Time = STEP) -> None:
        super()._schedule(step)
        if self._late:
            self._arm(min(self.deadline, self._late[0][0]))
