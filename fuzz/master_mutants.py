"""Planted bugs of the master around the core. No fuzz target knows it; tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

EVENTS: Final = ("tests/master/test_events.py",)
BUSES: Final = ("tests/master/test_several_buses.py",)
ARGUMENTS: Final = ("tests/master/test_wrong_arguments.py",)
DISPATCH: Final = ("tests/master/test_dispatch.py",)
KEEPER: Final = ("tests/master/test_parameter_keeper.py",)
STALLS: Final = ("tests/master/test_stalls.py",)
FORKS: Final = ("tests/master/test_forks.py",)
PUMP_TIME: Final = ("tests/master/test_pump_time.py",)
ONE_PROCESS: Final = ("tests/master/test_one_process.py",)
PATIENT_CLOCK: Final = ("tests/master/test_patient_clock.py",)
NODE_PDOS: Final = ("tests/master/test_node_pdos.py",)
SLOTS: Final = ("tests/master/test_procedure_slot.py",)
WATCHDOG: Final = ("tests/master/test_watchdog.py",)
AT_ONCE: Final = ("tests/master/test_stops_at_once.py",)
PATH_MOTION: Final = ("tests/master/test_path_motion.py",)
PATH_TROUBLES: Final = ("tests/master/test_path_troubles.py",)
BACKGROUND: Final = ("tests/master/test_blocking_background.py",)
BLOCKING: Final = ("tests/master/test_blocking.py",)
BY_HAND: Final = ("tests/master/test_enabled_by_hand.py",)
MOVING: Final = ("tests/master/test_moving.py",)

_MEMBER: Final = "canopen_master/motion/member.py"
_BACKGROUND: Final = "canopen_master/blocking/background.py"
_LATE_SYNC: Final = "canopen_master/motion/late_sync.py"

MASTER_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "an_arm_wakes_up",
            _LATE_SYNC,
            "        if late > self._too_late:\n",
            "        if False:\n",
            "a laptop that slept for an hour is opened, and the arm goes on with its path by itself",
            STALLS,
        ),
        (
            "an_arm_wakes_up_on_linux",
            "canopen_master/participant/participant.py",
            "        due -= self._slept()\n",
            "",
            "the same where the clock stands still while the computer sleeps: nothing is late",
            STALLS,
        ),
        (
            "old_foreign_command",
            "canopen_master/silence.py",
            "or command.time <= since:",
            "or command.time <= 0:",
            "a node counts as stopped by another master though its heartbeat, or we, have said otherwise since",
            ("tests/master/test_silence.py",),
        ),
        (
            "a_gap_unheard_of",
            "canopen_master/participant/bus.py",
            "                network.note_gap(item.lost, item.seen, now)\n",
            "",
            "this computer lost the frames of a joint, and a cable is looked for that is not loose",
            ("tests/master/test_faults.py",),
        ),
        (
            "a_gap_for_ever",
            "canopen_master/silence.py",
            "    if gap is None or now - gap.time > within:\n",
            "    if gap is None:\n",
            "a node is without power, and the frames that were lost here an hour ago are told as the cause",
            ("tests/master/test_silence.py",),
        ),
        (
            "patience_for_ever",
            "canopen_master/motion/path_motion.py",
            "            if not scope.cancelled_caught or self._went_on > since:",
            "            if True:",
            "a motion without a SYNC waits for ever, and its chain is not halted",
            PATH_TROUBLES,
        ),
        (
            "jump_without_limits",
            "canopen_master/motion/path_check.py",
            "max(rounding, step) if math.isfinite(step) else rounding",
            "max(rounding, step)",
            "a joint whose limits of speed and acceleration are lifted jumps to the start of any path",
            MOVING,
        ),
        (
            "whole_step_in_less_than_a_period",
            "canopen_master/motion/cycles.py",
            "self._write(1.0 - late % self._period / self._period)",
            "self._write(1.0)",
            "behind a late SYNC a joint is faster than its limit",
            STALLS,
        ),
        (
            "known_after_the_pump",
            "canopen_master/participant/participant.py",
            "self._begun = self._participant.start(procedure)\n        self._participant.pump.pump()",
            "begun = self._participant.start(procedure)\n        self._participant.pump.pump()\n        self._begun = begun",
            "a procedure that ends, or is taken back, while its first frames are sent is waited for without end, or runs on",
            SLOTS,
        ),
        (
            "following_after_the_stop",
            _MEMBER,
            "period)  # which may stop it at once",
            "period)\n        self.state = ChainState.FOLLOWING",
            "a chain that is stopped while it begins to follow goes on to take set-points",
            SLOTS,
        ),
        (
            "command_outlives_its_stop",
            _MEMBER,
            "            if self._procedure is not running:  # it was stopped at the moment of its end\n",
            "            if False:\n",
            "a command whose last step comes together with a halt of the chain counts as done",
            SLOTS,
        ),
        (
            "halt_that_nothing_remembers",
            _MEMBER,
            "        self.command.stops += 1\n",
            "",
            "a command that waits for the joints to stand goes on behind a halt that came meanwhile",
            AT_ONCE,
        ),
        (
            "begins_beside_a_shut_down",
            _MEMBER,
            '"shut down" if self.shut_downs else self.name',
            "self.name",
            "a chain is initialised while it is shut down",
            AT_ONCE,
        ),
        (
            "not_halted_behind_its_path",
            _MEMBER,
            "        if self.state is ChainState.STOPPING:\n            self.stop_now(self._why_halted)\n        elif problem:",
            "        if problem:",
            "a chain that has braked along its path is not halted",
            PATH_MOTION,
        ),
        (
            "others_wait_for_the_path",
            "canopen_master/master.py",
            "        if self._brakes_along_paths():\n",
            "        if False:\n",
            "a drive off the path runs on while a chain brakes along its path, when the master is left",
            PATH_TROUBLES,
        ),
        (
            "halted_off_the_path",
            "canopen_master/master.py",
            "each.device not in led and not each.node.bus_has_failed",
            "not each.node.bus_has_failed",
            "the joints of a chain that brakes along its path are halted by their own ramps, when the master is left",
            PATH_TROUBLES,
        ),
        (
            "dropped_uncounted",
            "canopen_master/participant/subscription.py",
            "            self.dropped += lost\n",
            "",
            "a slow reader is not told what it has lost",
            EVENTS,
        ),
        (
            "end_before_the_rest",
            "canopen_master/participant/subscription.py",
            "            if events:\n                burst",
            "            if events and self._end is None:\n                burst",
            "the end of the master swallows the events before it",
            EVENTS,
        ),
        (
            "watcher_of_all_buses",
            "canopen_master/participant/dispatch.py",
            "(watcher.bus is None or watcher.bus is bus) and ",
            "",
            "a callback hears what the namesake of a node on another bus has sent",
            DISPATCH,
        ),
        (
            "any_kind_of_event",
            "canopen_master/participant/dispatch.py",
            "if not isinstance(kind, type) or not issubclass(kind, Event):",
            "if False:",
            "a wrong kind is taken, and ends the master, and its motions, at the next event",
            ARGUMENTS,
        ),
        (
            "any_callback",
            "canopen_master/participant/participant.py",
            "        check_callback(callback)\n",
            "",
            "a callback that cannot be called ends the master, and its motions, at the next event",
            ARGUMENTS,
        ),
        (
            "reset_without_a_time_limit",
            "canopen_master/node.py",
            """        check_seconds("timeout", timeout, above_zero=True, finite=False)
        with self.events(NodeBooted) as boots:
            await self.nmt""",
            """        with self.events(NodeBooted) as boots:
            await self.nmt""",
            "a reset is sent by a call whose time limit is wrong",
            ARGUMENTS,
        ),
        (
            "subscription_of_all_buses",
            "canopen_master/participant/dispatch.py",
            " and (watcher.bus is None or watcher.bus is bus):\n                number",
            ":\n                number",
            "a node hears what its namesake on another bus has sent",
            BUSES,
        ),
        (
            "keeper_forgets_the_others",
            "canopen_master/simulation/parameter_keeper.py",
            "after = {**self._kept, node_id: dict(parameters)}",
            "after = {node_id: dict(parameters)}",
            "storing the parameters of one device loses those of all others",
            KEEPER,
        ),
        (
            "one_tick_after_a_stall",
            "canopen_master/participant/pump.py",
            "self._quiet_ticks if late > _STALL else self._loop.rounds_to_hear",
            "self._loop.rounds_to_hear",
            "after a stall the master acts on what it heard before it has heard the rest",
            STALLS,
        ),
        (
            "goes_on_as_its_parent",
            "canopen_master/participant/pump.py",
            "        if self.is_inherited:\n",
            "        if False:\n",
            "a forked child takes sockets off the list of its parent's loop, which hears its drives no more",
            FORKS,
        ),
        (
            "looks_once",
            "canopen_master/participant/pump.py",
            "for _ in range(MAX_LOOKS):",
            "for _ in range(1):",
            "a stall between the look at what has come and the timeouts loses a node that sent its heartbeat meanwhile",
            PUMP_TIME,
        ),
        (
            "stalled_alone",
            "canopen_master/participant/pump.py",
            "if len(self._running) > 1:",
            "if False:",
            "a simulated device that is in time itself takes its stalled master for lost",
            ONE_PROCESS,
        ),
        (
            "time_passes_the_deadline",
            "canopen_master/participant/patient_clock.py",
            "max(latest, until), 0.0",
            "reached + to_make_up, 0.0",
            "in a world in this process everything is late once the process was",
            PATIENT_CLOCK,
        ),
        (
            "patient_beside_a_real_bus",
            "canopen_master/direct/connection.py",
            "return PatientClock() if self._simulated and is_apart else None",
            "return PatientClock() if self._simulated else None",
            "time stands still for a master of real drives beside simulated ones",
            PATIENT_CLOCK,
        ),
        (
            "never_asked_again",
            "canopen_master/node_pdos.py",
            "        elif self._error is not None and report.state is not NmtState.STOPPED:\n            self._begin()",
            "        elif False:\n            self._begin()",
            "the PDOs of a device that was Stopped are never exchanged",
            NODE_PDOS,
        ),
        (
            "late_step_as_if_in_time",
            _LATE_SYNC,
            "(at - came_from) * periods",
            "(at - came_from) * 0.0",
            "how late a SYNC is does not count for the step that its drives take",
            STALLS,
        ),
        (
            "twice_the_way_unseen",
            _LATE_SYNC,
            "> way * _EXACT for",
            "> 2.0 * way * _EXACT for",
            "a joint may be sent twice as far as its speed allows before anybody looks",
            STALLS,
        ),
        (
            "back_at_full_speed",
            _LATE_SYNC,
            "RETURN: Final = 0.2",
            "RETURN: Final = 1.0",
            "a joint begins and ends its return to the path at once, at its highest speed",
            STALLS,
        ),
        (
            "heartbeat_of_ours_not_named",
            "canopen_master/motion/device.py",
            "            self.heartbeat_missed_at = self.emcy_time\n",
            "            pass\n",
            "a drive that left Operational because our heartbeat was late is called silent, and nobody looks at this computer",
            WATCHDOG,
        ),
        (
            "blamed_for_long_ago",
            _LATE_SYNC,
            "if missed_at is not None and now - missed_at <= RECENT:",
            "if missed_at is not None:",
            "a heartbeat that was late once is the reason for whatever happens later",
            WATCHDOG,
        ),
        (
            "interrupted_call_goes_on",
            _BACKGROUND,
            "            self.take_back(call)\n            raise\n        return call.result()",
            "            raise\n        return call.result()",
            "Ctrl-C returns while the drives of the call still move",
            BLOCKING,
        ),
        (
            "begun_after_it_was_taken_back",
            _BACKGROUND,
            "        if self.is_done:  # taken back meanwhile\n",
            "        if False:\n",
            "a call that its caller has given up moves a drive later",
            BACKGROUND,
        ),
        (
            "woken_for_good",
            "canopen_master/blocking/loop_thread.py",
            "            wakers[0].wake()\n        elif self._dispatcher_waits:\n",
            (
                "            self._front_waits = False\n"
                "            wakers[0].wake()\n"
                "        elif self._dispatcher_waits:\n"
                "            self._dispatcher_waits = False\n"
            ),
            "a task counts as woken before it is: an interrupt in between leaves it asleep, and a drive is not halted",
            BACKGROUND,
        ),
        (
            "busy_and_woken",
            "canopen_master/blocking/loop_thread.py",
            "                self._front_waits = False\n                work =",
            "                work =",
            "an interrupt right behind the wake leaves the next call, which may be a halt, to a task that is busy",
            BACKGROUND,
        ),
        (
            "its_thread_may_die",
            _BACKGROUND,
            "self._owners = {threading.main_thread(), owner or threading.main_thread()}",
            "self._owners = {threading.main_thread()}",
            "drives go on when the thread has ended that held their master",
            BLOCKING,
        ),
        (
            "drives_gone_before_their_master",
            _BACKGROUND,
            "return not self.goes_last or",
            "return True or",
            "simulated drives end before the master has halted them",
            BACKGROUND,
        ),
        (
            "left_with_calls_under_way",
            _BACKGROUND,
            "            with trio.CancelScope(shield=True):\n                await self._last_call_ended.wait()\n",
            "            pass\n",
            "the master ends beside calls that still clean up",
            BACKGROUND,
        ),
        (
            "power_behind_a_stop",
            "canopen_master/node.py",
            "            if self._stops_of(axis) != stops:",
            "            if False:",
            "a word that enables waits until the drive watches the master, and goes out behind a stop",
            BY_HAND,
        ),
        (
            "back_beyond_its_limits",
            _LATE_SYNC,
            "            to = min(max(to, min(lowest, sent)), max(highest, sent))\n",
            "",
            "on its return to the path a joint leaves its range of positions",
            STALLS,
        ),
    )
)
