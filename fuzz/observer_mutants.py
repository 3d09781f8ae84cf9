"""Planted bugs of the observer: what it keeps behind a boot-up, and what it takes for a gap of the recording, or for a fault."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

SERVICES: Final = ("tests/observer/test_observer_services.py",)
SDO: Final = ("tests/observer/test_observer_sdo.py",)
FRAMES: Final = ("tests/observer/test_observer.py",)
MIDLIFE: Final = ("tests/observer/test_observer_midlife.py",)
GAPS: Final = ("tests/observer/test_observer_gaps.py",)

_FINDING: Final = "observer/finding.py"
_NODES: Final = "observer/node_rules.py"
_PDOS: Final = "observer/pdo_rules.py"
_SERVICES: Final = "observer/service_rules.py"
_SDO: Final = "observer/sdo.py"
_OBSERVER: Final = "observer/observer.py"
LOSSES: Final = ("tests/cli/test_log_losses.py",)
BUSES: Final = ("tests/cli/test_log_buses.py",)
CAPTURES: Final = ("tests/transports/test_capture_files.py",)
WORLD: Final = ("tests/testing/test_world.py",)

_PATTERNS: Final = "testing/patterns.py"
_RECORD: Final = "canopen_transports/record.py"
_CAPTURES: Final = "canopen_transports/capture_files.py"
_LIVE: Final = "canopen_cli/live"
RECORD: Final = ("tests/cli/test_log_data.py",)

OBSERVER_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- behind a boot-up ----
        (
            "observer_emcy_time_survives_boot",
            _SERVICES,
            "        self._emergencies[node_id] = -NEVER\n",
            "",
            "the first emergency behind a boot-up is measured from one before it",
            SERVICES,
        ),
        (
            "observer_pdo_cyclic_survives_boot",
            _PDOS,
            "            del self._timings[key]\n        self._choose()",
            "            del self._timings[key]",
            "a PDO is expected at each SYNC, by a parameter that a boot-up has reset",
            SERVICES,
        ),
        (
            "observer_identity_survives_boot",
            _SDO,
            "        self._for_good.clear()\n",
            "",
            "a device that runs another program behind its boot-up is told as two devices",
            SDO,
        ),
        # ---- where nothing was heard at all, or a recorder says that it lost frames ----
        (
            "observer_pause_accuses_all",
            _OBSERVER,
            "        if len(silent) > 1 and not",
            "        if len(silent) > 127 and not",
            "a recorder that stood still makes each node late",
            GAPS,
        ),
        (
            "observer_pause_excuses_for_good",
            _NODES,
            " <= now and not view.is_excused}",
            " <= now}",
            "nodes that stay silent behind a pause are never late, if a slow one is heard",
            GAPS,
        ),
        (
            "observer_pause_accuses_pdos",
            _PDOS,
            "        for timing in self._timings.values():\n            timing.forget()\n        self.deadline",
            "        self.deadline",
            "a recorder that stood still makes each PDO late",
            GAPS,
        ),
        (
            "observer_overrun_makes_late",
            _OBSERVER,
            "        self._not_heard(self._now)\n        return",
            "        return",
            "a heartbeat that an overrun has cost makes a node late",
            GAPS,
        ),
        (
            "monitor_away_accuses",
            f"{_LIVE}/monitor.py",
            "if taken is None and not self._is_deaf:",
            "if taken is None:",
            "an adapter that was pulled out makes each node late",
            LOSSES,
        ),
        (
            "recording_hides_overruns",
            f"{_LIVE}/source.py",
            "overrun_text(self._reader)), record] if lost else [record]",
            "overrun_text(self._reader)), record] if lost < 0 else [record]",
            "log decode takes what the recorder has lost for a fault of a node",
            LOSSES,
        ),
        (
            "record_hides_overruns",
            f"{_LIVE}/log_record.py",
            "                self._writer.lost(*self._last)\n",
            "                pass\n",
            "a recording does not say where it lacks frames",
            LOSSES,
        ),
        (
            "record_overwrites",
            f"{_LIVE}/log_record.py",
            "    while found.exists():\n",
            "    while number > 9:\n",
            "the hour that comes twice at the end of summer time takes the place of the first one",
            RECORD,
        ),
        (
            "record_into_no_file",
            f"{_LIVE}/log_record.py",
            "        if file_at(part.path) == self._is:\n",
            "        if True:\n",
            "the file is removed or renamed, and what is recorded from then on is in no file",
            RECORD,
        ),
        (
            "record_waits_for_the_old_clock",
            f"{_LIVE}/log_record.py",
            "not self._begins <= time < self._ends",
            "not time < self._ends",
            "the clock is set back by a day: no new file begins for a day",
            RECORD,
        ),
        (
            "record_of_another_day",
            f"{_LIVE}/clocks.py",
            "        if abs(zero - self.zero) > SET:\n",
            "        if False:\n",
            "a recorder that began before the clock was set, or whose computer slept, has wrong dates for weeks",
            RECORD,
        ),
        (
            "convert_hides_overruns",
            f"{_LIVE}/log.py",
            "                    writer.lost(record.time, record.channel)\n",
            "                    pass\n",
            "the copy of a recording does not say where it lacks frames",
            LOSSES,
        ),
        (
            "capture_hides_overruns",
            _CAPTURES,
            "        skip(str(reason), is_overrun=reason.is_overrun)\n",
            "        skip(str(reason))\n",
            "a capture's error frame of an overrun is passed over",
            CAPTURES,
        ),
        (
            "capture_hides_drops",
            _CAPTURES,
            "    if 0 < count < (1 << 64) - 1:\n",
            "    if count < 0:\n",
            "the recorder's own number of lost packets is passed over",
            CAPTURES,
        ),
        # ---- the judge of a test ----
        (
            "judge_pause_excuses",
            _OBSERVER,
            "        if len(silent) > 1 and not self._is_exact:\n",
            "        if len(silent) > 1:\n",
            "in a test, two devices that fall silent together are a gap of a recorder that is not there",
            WORLD,
        ),
        (
            "pattern_is_as_typed",
            _PATTERNS,
            'return Pattern("frame", text=str(Frame.parse(text)))',
            'Frame.parse(text)\n    return Pattern("frame", text=text.upper())',
            'never("123#11.22") holds whatever comes',
            WORLD,
        ),
        (
            "pattern_whole_is_beginning",
            _PATTERNS,
            "    return str(frame) == pattern.text\n",
            "    return str(frame).startswith(pattern.text)\n",
            "a frame with further bytes passes for the one that was meant",
            WORLD,
        ),
        (
            "pattern_needs_a_size",
            _PATTERNS,
            "if data[0] & SIZE_BIT else bool(wanted) and written.startswith(wanted)",
            "if data[0] & SIZE_BIT else False",
            "never(sdo_write(...)) holds for a write that does not say its size",
            WORLD,
        ),
        (
            "seen_needs_one_frame",
            "testing/seen.py",
            "            fits = is_of_many and (",
            "            fits = is_of_many and len(settled.data) > 4 and (",
            "never(sdo_write(...)) holds for a short value that is written in segments",
            WORLD,
        ),
        # ---- a clock that was set, and two buses in one recording ----
        (
            "clock_stands_still",
            _RECORD,
            "                self._ahead += self._last - shown\n",
            "",
            "behind a clock that was set back, no time passes until it is where it was",
            LOSSES,
        ),
        (
            "clock_of_all_buses",
            f"{_LIVE}/clocks.py",
            "        now = clock.set(time)\n",
            "        clock = next(iter(self._clocks.values()))\n        now = clock.set(time)\n",
            "two recordings of one hour behind each other are two hours",
            LOSSES,
        ),
        (
            "export_mixes_buses",
            f"{_LIVE}/log_export.py",
            "    has_several = len({value.record.channel for value in values}) > 1",
            "    has_several = False",
            "two nodes with one ID, on two buses, share a column",
            BUSES,
        ),
        (
            "plot_mixes_buses",
            f"{_LIVE}/log_plot.py",
            "curves.setdefault((value.record.channel, value.label)",
            'curves.setdefault(("", value.label)',
            "two nodes with one ID, on two buses, share a curve",
            BUSES,
        ),
        (
            "replay_mixes_buses",
            f"{_LIVE}/log.py",
            "    if len(names) > 1:\n        raise",
            "    if len(names) > 9:\n        raise",
            "what was said to node 5 of one bus is a command for node 5 of the other",
            BUSES,
        ),
        # ---- two devices with one node-ID ----
        (
            "observer_coarse_clock_is_two_devices",
            _NODES,
            "and most > _UNLIKE * least",
            "and most * 3 > least * 4",
            "one device that counts in coarse ticks is told as two",
            SERVICES,
        ),
        (
            "observer_queue_is_a_copy",
            _OBSERVER,
            "self._gaps.is_at_once = not self._is_exact and now - self._now < AT_ONCE",
            "self._gaps.is_at_once = False",
            "frames that a late reader took from its queue at once are told as copies",
            FRAMES,
        ),
        # ---- gaps ----
        (
            "observer_gap_told_for_each_sign",
            _FINDING,
            "if now - self.last > QUIET:",
            "if now >= self.last:",
            "one gap is told as often as it shows itself",
            SERVICES,
        ),
        (
            "observer_copies_told_each",
            _FINDING,
            "if now - self._copied > QUIET and not self.is_at_once:",
            "if now >= self._copied and not self.is_at_once:",
            "each frame of a burst is told",
            SERVICES,
        ),
        (
            "observer_burst_of_heartbeats_judged",
            _NODES,
            "elif byte == view.byte and now - view.last < min(COPY, view.period // 2 or COPY) and not view.is_late:",
            "elif byte == view.byte and now < view.last:",
            "heartbeats that were held back count as heartbeats at that time",
            SERVICES,
        ),
        # ---- evidence ----
        (
            "observer_guarding_judged_sooner",
            _NODES,
            "_SAME_TOGGLES: Final = 7",
            "_SAME_TOGGLES: Final = 2",
            "two lost guarding answers accuse a node",
            SERVICES,
        ),
        (
            "observer_lss_services_as_rivals",
            _SERVICES,
            "        self._lss_rivals += is_same_service\n        if is_same_service and self",
            "        self._lss_rivals += 1\n        if self",
            "lost LSS requests are told as two devices",
            SERVICES,
        ),
        (
            "observer_pdos_twice_not_in_a_row",
            _PDOS,
            "elif timing.twice_at != timing.at_sync:",
            "elif timing.twice_at > timing.at_sync:",
            "SYNCs that are lost now and then add up to a fault",
            SERVICES,
        ),
        (
            "observer_state_without_proof",
            _NODES,
            "if view.suspect is not None and state != view.state:\n            view.suspect = None\n        elif",
            "if",
            "a lost NMT command accuses a node that has obeyed it",
            (*FRAMES, *GAPS),
        ),
        (
            "observer_heartbeat_at_once_acquits",
            _NODES,
            "elif view.suspect is not None and now - view.suspected > LATE:\n            found.append(view.suspect)\n",
            "elif view.suspect is not None:\n            found += [view.suspect] * (now - view.suspected > LATE)\n",
            "a stopped node that answers is not found if its heartbeat follows at once",
            FRAMES,
        ),
        (
            "observer_rhythm_survives_boot",
            _NODES,
            "            view.has_new_period(0)\n            view.suspect, view.guarded",
            "            view.suspect, view.guarded",
            "a node that has lost its heartbeat time in a reset is told as silent",
            FRAMES,
        ),
        (
            "observer_silence_after_one_loss",
            _NODES,
            "SILENT: Final = 2.5",
            "SILENT: Final = 1.5",
            "one lost heartbeat is told as a node that is silent",
            FRAMES,
        ),
        (
            "observer_late_heartbeat_makes_a_copy",
            _NODES,
            "self.is_late = interval * 4 > period * 5 > 0",
            "self.is_late = False",
            "the heartbeat behind a late one is told as its copy",
            FRAMES,
        ),
        (
            "observer_rival_client_at_once",
            _SDO,
            "if self._rivals == _REPEATED:",
            "if self._rivals:",
            "one lost answer is told as a second client",
            SDO,
        ),
        (
            "observer_twin_at_once",
            _SDO,
            "if twins >= _REPEATED:",
            "if twins:",
            "one lost request is told as a second node",
            SDO,
        ),
        (
            "observer_late_copy_as_proof",
            _SDO,
            "if answer[0] & TOGGLE != self._toggle and answer == self._last_answer:",
            "if answer[0] & TOGGLE != self._toggle and answer is self._before:",
            "a copy that comes late is a certain fault of the toggle bit",
            SDO,
        ),
        (
            "observer_any_first_toggle",
            _NODES,
            "view.toggle = _TOGGLE  #",
            "view.toggle = None  #",
            "a node whose first toggle bit behind its boot-up is wrong is not found",
            SERVICES,
        ),
        (
            "observer_sync_counter_backwards",
            _SERVICES,
            "data[0] not in (1, last + 1)",
            "data[0] > last + 1",
            "a counter of SYNC that goes back counts as one in order",
            SERVICES,
        ),
        (
            "observer_event_timer_twice",
            _PDOS,
            "timing.event_timer * 3 // 2",
            "timing.event_timer * 5 // 2",
            "a PDO that its event timer should have sent twice is not missed",
            SERVICES,
        ),
        (
            "observer_turns_one_sooner",
            _NODES,
            "if len(view.turns) > _TURNS:",
            "if len(view.turns) >= _TURNS:",
            "a node that was late is two nodes after one turn less than is said",
            FRAMES,
        ),
        # ---- settings in mid-life ----
        (
            "observer_stored_forgotten",
            "observer/parameters.py",
            "        self._recorded[node_id] = dict(stored)\n",
            "        self._recorded[node_id] = {}\n",
            "a device that has stored its settings is taken to have lost them by its boot-up",
            MIDLIFE,
        ),
        (
            "observer_restored_in_vain",
            "observer/parameters.py",
            "            self._stored.pop(node_id, None)\n",
            "            pass\n",
            "a device that was restored to its defaults is taken to keep what it had stored",
            MIDLIFE,
        ),
        (
            "observer_stored_is_alive",
            "observer/parameters.py",
            "self._stored[node_id] = dict(self._recorded.get(node_id, {}))",
            "self._stored[node_id] = self._recorded.setdefault(node_id, {})",
            "what is written behind the storing counts as stored",
            MIDLIFE,
        ),
        (
            "observer_read_stores",
            "observer/observer.py",
            "        if not is_read:\n            self._parameters.store(",
            "        if data:\n            self._parameters.store(",
            "who reads 0x1010 is taken to store",
            MIDLIFE,
        ),
        (
            "observer_old_routes",
            "observer/observer.py",
            "            self._assigned = None\n        self._routes.clear()",
            "            self._assigned = None\n            self._routes.clear()",
            "a PDO that was given another CAN-ID is still named by the old one",
            MIDLIFE,
        ),
        (
            "view_counts_the_present_slot",
            "observer/bus_view.py",
            "        if slot - _SLOTS <= self.slot < slot:\n",
            "        if slot - _SLOTS <= self.slot <= slot:\n",
            "the rates are those of 1.1 s",
            MIDLIFE,
        ),
        (
            "view_commands_nodes_that_speak",
            "observer/bus_view.py",
            "node.state, node.is_said, node.state_at = state, False, now",
            "node.state, node.state_at = state, now",
            "a state that a node was told is shown as one that it has said",
            MIDLIFE,
        ),
    )
)
