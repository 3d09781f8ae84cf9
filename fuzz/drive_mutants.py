"""Planted bugs of drives, on both sides. No fuzz target knows a drive; tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

LIMITS: Final = ("tests/drives/test_limits.py", "tests/drives/test_move_limits.py")
FOLLOWING: Final = ("tests/drives/test_following.py", "tests/master/test_following.py")
ANY_SITUATION: Final = ("tests/simulation/test_drive_stateful.py",)
PROCEDURES: Final = ("tests/drives/test_drive_procedures.py",)
TABLES: Final = ("tests/drives/test_cia402_tables.py",)
WALK: Final = ("tests/simulation/test_drive_state_walk.py",)
HOMING: Final = ("tests/drives/test_master_homing.py",)
HOMED: Final = ("tests/drives/test_homed_means_homed.py",)
KILLS: Final = ("tests/drives/test_kill_table.py",)
STOP_FIRST: Final = ("tests/drives/test_stop_first.py",)
BY_HAND: Final = ("tests/master/test_enabled_by_hand.py",)
EXCLUSIVE: Final = ("tests/drives/test_exclusive_motion.py",)
RUN_AT: Final = ("tests/drives/test_run_at.py",)
SEQUENCE: Final = ("tests/drives/test_target_sequence.py",)
SLOW: Final = ("tests/drives/test_slow_position.py",)
STOP_COMMAND: Final = ("tests/cli/test_stop.py",)

_STATE: Final = "drives/axis/state.py"
_HALTING: Final = "drives/axis/halting.py"
_HOMING: Final = "drives/axis/homing.py"
_WATCHING: Final = "drives/axis/watching.py"
_TABLE: Final = "drives/cia402/states.py"
_DRIVE: Final = "simulation/drive/drive.py"

DRIVE_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- the master ----
        (
            "any_speed_allowed",
            "drives/axis/limits.py",
            "abs(target - start) * SECOND / time <= self.speed.value * EXACT\n            and (lowest",
            "True\n            and (lowest",
            "a set-point is let through that is too fast for its joint",
            LIMITS,
        ),
        (
            "any_height_allowed",
            "drives/axis/limits.py",
            "            and (highest is None or target <= highest.value)\n        ):\n            return False",
            "        ):\n            return False",
            "a set-point is let through that is above the highest position of its joint",
            LIMITS,
        ),
        (
            "path_without_end",
            "drives/axis/limits.py",
            "        if set_points.reach is None:\n",
            "        if True:\n",
            "joints without position limits set out along a path to where their drives can never be sent",
            (*LIMITS, "tests/master/test_moving.py"),
        ),
        (
            "path_too_fast_for_its_object",
            "drives/axis/limits.py",
            "        if reach is None:\n            return self.speed\n",
            "        if True:\n            return self.speed\n",
            "joints set out along a path whose velocity their drives can never be given, and are halted on their way",
            ("tests/master/test_feed_forward.py",),
        ),
        (
            "rounded_beyond_the_object",
            "drives/axis/limits.py",
            "ROUNDING: Final = 2 * POSITION_TOLERANCE",
            "ROUNDING: Final = 0.0",
            "a path ends some counts beyond what the object of its set-points can hold, and is refused while the joints move",
            LIMITS,
        ),
        (
            "brakes_too_hard",
            "drives/axis/limits.py",
            "for key in (objects.MAX_ACCELERATION, objects.MAX_DECELERATION):",
            "for key in (objects.MAX_ACCELERATION,):",
            "a path brakes harder than its drive may: the joint goes on beyond its end, and beyond its limit",
            (*LIMITS, "tests/master/test_path_motion.py"),
        ),
        (
            "late_enable_behind_the_stop",
            "simulation/drive/drive.py",
            "            self._late = deque(late for late in self._late if late[1] != objects.CONTROLWORD)\n",
            "            pass\n",
            "a simulated drive that obeys late is enabled behind NMT stop, and runs with nobody to stop it",
            ("tests/simulation/test_drive_states.py",),
        ),
        (
            "runs_on_in_pre_operational",
            "local_node.py",
            "        if is_cut_off or change.previous",
            "        if change.previous",
            "a drive that was commanded by SDO in Pre-operational runs on through NMT stop, and unwatched through a reset",
            ("tests/drives/test_kill_table.py", "tests/core/test_application.py"),
        ),
        (
            "beyond_once_more",
            "drives/axis/target_sequence.py",
            "            start = start if known is None else known",
            "            pass",
            "a drive that stood beyond a limit comes back, and is sent beyond it again",
            SEQUENCE,
        ),
        (
            "runs_on_beyond",
            "drives/axis/target_sequence.py",
            "                if limit is not None:\n                    reason",
            "                if False:\n                    reason",
            "a drive that passes its target, and waits for the next one, runs on beyond its limit",
            SEQUENCE,
        ),
        (
            "halted_too_late_in_vl",
            "drives/axis/velocity.py",
            "keys = {1: objects.VL_VELOCITY_DECELERATION, 2: objects.VL_VELOCITY_QUICK_STOP}",
            "keys = {1: objects.VL_VELOCITY_DECELERATION, 2: objects.VL_VELOCITY_DECELERATION}",
            "a drive whose halt goes by a slow quick stop ramp runs on beyond its position limit",
            RUN_AT,
        ),
        (
            "stop_undone",
            "drives/axis/exclusive_motion.py",
            "if occupancy.stops == 1:",
            "if False:",
            "a command that waits behind another SDO transfer goes out behind the stop, and starts the motion",
            EXCLUSIVE,
        ),
        (
            "led_back",
            _HALTING,
            "is_last and word & COMMAND_BITS in STAYS.values():",
            "False:",
            "a halt enables a drive again that another stop has led down",
            EXCLUSIVE,
        ),
        (
            "patient_motion",
            "drives/axis/exclusive_motion.py",
            "            if occupancy.stops_begun != stops_before:",
            "            if False:",
            "a motion that waits for the halt of the one before outlives a stop, and moves the axis behind it",
            EXCLUSIVE,
        ),
        (
            "stops_drop_stops",
            "drives/axis/exclusive_motion.py",
            "if occupancy.stops == 1:",
            "if True:",
            "a stop takes the word of another stop that waits, which fails then",
            EXCLUSIVE,
        ),
        (
            "shown_is_enough",
            _STATE,
            "if state_of(statusword) is target and target in STAYS and may_be_enabled(axis):",
            "if False:",
            "a drive that was told to enable a moment ago counts as led down, and is enabled then",
            EXCLUSIVE,
        ),
        (
            "fed_behind_a_stop",
            "drives/axis/slow_position.py",
            "    if axis.occupancy.is_being_stopped:\n        raise",
            "    if False:\n        raise",
            "a target under way ends the halt of another task, or enables a drive that was led down",
            SLOW,
        ),
        (
            "stop_once",
            _STATE,
            "(insist if state in POWERED and not goes_up else command)",
            "command",
            "a stop that was lost is not sent again to a drive that has just shown its state",
            STOP_FIRST,
        ),
        (
            "homed_from_a_motion",
            _HOMING,
            "    yield from halt(axis)\n    axis.is_homed = False",
            "    axis.is_homed = False",
            "a drive that moves gets another mode before it is halted",
            HOMING,
        ),
        (
            "zeros_are_methods",
            "drives/axis/homing_parameters.py",
            "        if method:\n",
            "        if method is not None:\n",
            "a list of zeros refuses every method",
            HOMING,
        ),
        (
            "never_settled",
            _HOMING,
            "    if axis.unanswered:\n        yield from settle(axis)\n",
            "",
            "what a homing that begins late shows is taken for the end of the next one",
            HOMED,
        ),
        (
            "always_in_time",
            "drives/axis/axis.py",
            "return max(self._settings.reaction_time, 2 * (self.answer_time or self._was_answer_time))",
            "return self._settings.reaction_time",
            "a drive that answers late is not given its time, and an old end is believed",
            HOMED,
        ),
        (
            "old_end_of_a_stranger",
            _HOMING,
            "if axis.answer_time is None and judge.shows_homed(",
            "if axis.answer_time is None and not judge.shows_homed(",
            "the end of somebody else's homing is believed of a drive that was never seen to answer",
            HOMED,
        ),
        (
            "start_left_standing",
            _HOMING,
            '            axis.leave_unanswered("a homing")\n',
            "            pass\n",
            "a homing that did not begin is forgotten",
            HOMED,
        ),
        (
            "bits_clear_from_the_first",
            _HOMING,
            "self._seen_clear |= ~statusword",
            "self._seen_clear = -1",
            "a bit that shows an old end counts as seen 0",
            HOMED,
        ),
        (
            "reset_without_edge",
            _STATE,
            "    yield from command(axis, 0)\n    yield from command(axis, int(Command.FAULT_RESET))",
            "    yield from command(axis, int(Command.FAULT_RESET))",
            "a fault is reset by an edge, and another master may have left bit 7 set",
            WALK,
        ),
        (
            "old_value",
            _WATCHING,
            "return heard_at if heard_at is not None and heard_at >= self.began else None",
            "return heard_at",
            "what was shown before the command is taken for its answer",
            WALK,
        ),
        (
            "mode_display_ignored",
            _STATE,
            "is not None and axis.mode == mode else None",
            "is not None else None",
            "a mode that was written counts as taken",
            ANY_SITUATION,
        ),
        (
            "halt_taken_back",
            _HALTING,
            "    except Cancelled:\n        yield from _stop(axis)\n        raise",
            "    except Cancelled:\n        raise",
            "a halt that is cancelled before its command is none",
            ANY_SITUATION,
        ),
        (
            "halt_waits_for_an_answer",
            _HALTING,
            "report = yield Wait(FRESH, node,",
            "report = yield Wait(None, node,",
            "a drive runs on while the answer that a halt waits for is lost",
            STOP_FIRST,
        ),
        (
            "disable_reads_first",
            _STATE,
            "    if axis.fresh_statusword((yield from current_time())) is not None:\n        return\n",
            "    return\n",
            "a drive keeps its power if the answer to a read is lost",
            STOP_FIRST,
        ),
        (
            "stop_sent_once",
            "drives/axis/controlword.py",
            "TRIES: Final = 2",
            "TRIES: Final = 1",
            "a stop that is lost is not sent again",
            STOP_FIRST,
        ),
        (
            "disturbed_stop_sent_once",
            "drives/axis/controlword.py",
            "not in (AbortOrigin.TIMEOUT, AbortOrigin.CONTESTED) or not left",
            "is not AbortOrigin.TIMEOUT or not left",
            "one frame of another SDO client keeps a drive running that was told to stop",
            STOP_FIRST,
        ),
        (
            "unknown_drive_only_asked",
            _HALTING,
            "            yield from insist(axis, int(Command.QUICK_STOP))\n        raise",
            "            pass\n        raise",
            "a drive of which nothing is known is not stopped if its answer is lost",
            STOP_FIRST,
        ),
        (
            "way_out_asks_first",
            "canopen_master/motion/halting.py",
            "                yield from halt_first(device.axis)",
            "                pass",
            "on the way out of a master a drive runs on if its answers are lost",
            BY_HAND,
        ),
        (
            "stop_by_nmt_unannounced",
            "canopen_cli/drive/stop.py",
            "        yield from act(lambda now: node.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL, now))\n        outcomes",
            "        yield from act(lambda now: node.send_nmt(NmtCommand.STOP, now))\n        outcomes",
            "a node is sent another NMT command than was announced",
            STOP_COMMAND,
        ),
        (
            "standstill_by_state",
            _HALTING,
            "        return (has_obeyed and (not has_position or self._is_at_one_place())) or None",
            "        return True",
            "a halt does not wait until the drive stands",
            ANY_SITUATION,
        ),
        (
            "halt_forgets_its_bit",
            _HALTING,
            "| ControlBit.HALT\n",
            "\n",
            "a halt that commands no halt",
            ANY_SITUATION,
        ),
        (
            "failed_move_goes_on",
            "drives/axis/profile_position.py",
            "        yield from halt_after(axis, cause)\n        raise",
            "        raise",
            "a move that is cancelled leaves the drive moving",
            PROCEDURES,
        ),
        (
            "failed_homing_goes_on",
            "drives/axis/homing.py",
            "        yield from halt_after(axis, cause)\n        raise",
            "        raise",
            "a homing that is cancelled leaves the drive moving",
            ANY_SITUATION,
        ),
        (
            "homed_too_early",
            "drives/axis/homing.py",
            "return ending if is_new or heard_at - self._shown_since >= self._reaction_time else None",
            "return ending",
            "the end of the homing before is taken for this one's",
            HOMED,
        ),
        (
            "way_through_power",
            _TABLE,
            "_IN_MOTION: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)",
            "_IN_MOTION: Final = ()",
            "the way between two states without power leads through one with power",
            WALK,
        ),
        (
            "fault_not_awaited",
            _STATE,
            "state_of(word) is not State.FAULT_REACTION_ACTIVE",
            "bool(word)",
            "a fault is reset while the drive still brakes",
            WALK,
        ),
        # ---- the table that both sides share ----
        (
            "quick_stop_without_power",
            _TABLE,
            "(State.SWITCHED_ON, Command.QUICK_STOP): (State.SWITCH_ON_DISABLED, 10)",
            "(State.SWITCHED_ON, Command.QUICK_STOP): (State.QUICK_STOP_ACTIVE, 11)",
            "a quick stop leads to Quick stop active only from Operation enabled",
            TABLES,
        ),
        (
            "ready_without_quick_stop_bit",
            _TABLE,
            "State.READY_TO_SWITCH_ON: (0x6F, 0x21)",
            "State.READY_TO_SWITCH_ON: (0x4F, 0x01)",
            "bit 5 belongs to the pattern",
            ("tests/simulation/test_cia402_states.py",),
        ),
        (
            "reset_by_level",
            _TABLE,
            "if command is Command.FAULT_RESET and previous & ControlBit.FAULT_RESET:",
            "if previous < 0:",
            "a bit 7 that only stands resets a fault",
            TABLES,
        ),
        (
            "stays_from_six",
            "drives/cia402/option_codes.py",
            "STAYS_FROM: Final = 5",
            "STAYS_FROM: Final = 6",
            "605Ah = 5 stays in Quick stop active",
            TABLES,
        ),
        # ---- the simulated drive ----
        (
            "reaction_swapped",
            _DRIVE,
            "            case 2:\n                self._execute(Command.DISABLE_VOLTAGE)\n            case 3:",
            "            case 3:\n                self._execute(Command.DISABLE_VOLTAGE)\n            case 2:",
            "6007h: 2 disables the voltage, 3 is the quick stop",
            TABLES,
        ),
        (
            "slow_quick_stop",
            "simulation/drive/parameters.py",
            "        if option == 1:\n            return self.rate(objects.PROFILE_DECELERATION)",
            "        if option in (1, 2):\n            return self.rate(objects.PROFILE_DECELERATION)",
            "a quick stop by the slow-down ramp",
            (*TABLES, *KILLS),
        ),
        (
            "sync_not_awaited",
            "simulation/drive/synchronous_modes.py",
            "        self.due = self.servo.time + self._sync_timeout\n",
            "",
            "a lost SYNC stops nothing",
            KILLS,
        ),
        (
            "mode_not_sent",
            "simulation/drive/node.py",
            "        self._trigger(MODES_OF_OPERATION_DISPLAY, change.axis, now)",
            "        pass",
            "an event-driven TPDO does not tell a new mode",
            WALK,
        ),
        # ---- the watchdog ----
        (
            "watch_too_long",
            "drives/axis/watchdog.py",
            "return self.node_id << 16 | self.timeout // MILLISECOND",
            "return self.node_id << 16 | 4 * self.timeout // MILLISECOND",
            "a drive that watches for its master four times too long",
            KILLS,
        ),
        (
            "limit_nearly_kept",
            "drives/trajectory/limit_check.py",
            "EXACT: Final = 1 + 1e-6",
            "EXACT: Final = 1.02",
            "a motion may exceed its limits by two hundredths",
            LIMITS,
        ),
        (
            "silent_for_longer",
            "drives/axis/following.py",
            "SILENT_SYNCS: Final = 3",
            "SILENT_SYNCS: Final = 5",
            "a drive that falls silent is followed for two cycles more than is said",
            FOLLOWING,
        ),
        (
            "following_limit_too_late",
            "drives/axis/following_error.py",
            "UNCERTAIN: Final = 2",
            "UNCERTAIN: Final = 4",
            "a drive may be four cycles of its motion behind, not two",
            FOLLOWING,
        ),
    )
)
