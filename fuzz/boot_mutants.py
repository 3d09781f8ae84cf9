"""Planted bugs of the NMT master's boot-up (CiA 302-2). No fuzz target knows it; tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

COMPARISON: Final = ("tests/manager/test_boot_comparison.py",)
ONE: Final = ("tests/manager/test_boot_node.py",)
SUPERVISED: Final = ("tests/manager/test_supervised.py",)
ALL: Final = ("tests/manager/test_boot_network.py", "tests/manager/test_boot_moments.py")
WORDS: Final = ("tests/cli/test_boot_summary.py",)
NET: Final = ("tests/cli/test_net.py",)
ANY_FAULT: Final = ("tests/manager/test_boot_twenty.py",)
CLAIMS: Final = ("tests/cli/test_claims.py",)
SEEN: Final = ("tests/manager/test_boot_seen_running.py",)

_NODE: Final = "manager/boot/node_boot.py"
_NETWORK: Final = "manager/boot/network_boot.py"
_MEMBER: Final = "manager/boot/member.py"
_SUMMARY: Final = "canopen_cli/net/boot_summary.py"
_COMMANDS: Final = "manager/boot/node_boot.py"

BOOT_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- who is supervised ----
        (
            "own_heartbeat_unwatched",
            _NODE,
            "    if timeout:\n        node.heartbeat.set_timeout(timeout, now, begun=True)\n",
            "",
            "a node whose heartbeat only its own 0x1017 tells is not watched",
            SUPERVISED,
        ),
        (
            "watched_from_its_first_heartbeat",
            _NODE,
            "set_timeout(timeout, now, begun=True)",
            "set_timeout(timeout, now)",
            "a node that dies before its first heartbeat is not missed",
            SUPERVISED,
        ),
        (
            "later_heartbeat_unwatched",
            _NETWORK,
            "                if learns and isinstance(event, HeartbeatReceived):",
            "                if False:",
            "a heartbeat that begins later is not watched",
            SUPERVISED,
        ),
        (
            "measured_by_the_shortest",
            _NETWORK,
            "longest = max(",
            "longest = min(",
            "a heartbeat that an adapter held back makes a node lost",
            SUPERVISED,
        ),
        (
            "unsupervised_unnamed",
            _NETWORK,
            "if member.is_ready and not member.is_supervised)",
            "if False)",
            "nobody says whose loss is not noticed",
            SUPERVISED,
        ),
        (
            "outage_is_a_loss",
            _NETWORK,
            "        return member.is_lost and member.may_be_unheard(",
            "        return False and member.may_be_unheard(",
            "nodes are lost, and reset, because an adapter was unplugged",
            SUPERVISED,
        ),
        (
            "lost_in_an_outage_for_ever",
            _MEMBER,
            "            heartbeat.set_timeout(timeout, now, begun=True)",
            "            pass",
            "nobody is missed any more after an outage",
            SUPERVISED,
        ),
        # ---- one node ----
        (
            "any_identity",
            _NODE,
            "                if found != expected:\n",
            "                if False:\n",
            "another device is configured and started",
            ANY_FAULT,
        ),
        (
            "kept_alive_in_any_state",
            _NODE,
            "if heard is NmtState.OPERATIONAL:",
            "if heard is not None:",
            "a node that does not run counts as running, and is not configured",
            ONE,
        ),
        (
            "update_without_end",
            _NODE,
            "        self.is_updated = True\n",
            "",
            "a node that keeps its old program is updated over and over",
            ONE,
        ),
        (
            "settings_lost",
            _NODE,
            "        if self.node.boots != self.boots:\n            raise _BootedAgain",
            "        pass",
            "a node that boots in the middle has lost its settings, and is not configured again",
            ONE,
        ),
        (
            "restarts_without_end",
            _NODE,
            "for _ in range(1 + MAX_RESTARTS):",
            "while True:",
            "a node that resets over and over is never reported",
            ONE,
        ),
        (
            "late_boot_time",
            _NODE,
            "min(self.times.pause, self.until - now)",
            "self.times.pause",
            "the boot time is looked at after each round only",
            ONE,
        ),
        (
            "watched_while_it_boots",
            _NODE,
            "        yield from act(self._stop_watching)\n        if not self.assignment.boots",
            "        if not self.assignment.boots",
            "a node that is reset is taken for lost",
            ONE,
        ),
        # ---- the network ----
        (
            "suspended_is_watched",
            _NETWORK,
            "        member.is_suspended = True\n        self._stop_watching(member, now)",
            "        member.is_suspended = True",
            "the heartbeat of a node that gets a new program is reported as lost",
            ALL,
        ),
        (
            "booted_again_is_ready",
            _MEMBER,
            "return self.is_lost or (self.is_good and self.node.boots != self.boots)",
            "return self.is_lost",
            "a node that has booted since it was configured is started",
            ALL,
        ),
        (
            "lost_is_ready",
            _MEMBER,
            "return self.is_lost or (self.is_good and self.node.boots != self.boots)",
            "return self.is_good and self.node.boots != self.boots",
            "the network starts without a node that is lost meanwhile",
            ALL,
        ),
        (
            "start_all_in_any_case",
            _NETWORK,
            "return all(member.may_start or (member.is_ready and member.is_running) for member in members)",
            "return True",
            "the command to all nodes starts one that has failed",
            ANY_FAULT,
        ),
        (
            "judged_too_early",
            _NETWORK,
            "lambda: member.may_start)",
            "lambda: True)",
            "a node that has failed is started, or one that boots in the pause before its command",
            ANY_FAULT,
        ),
        (
            "crossing",
            _NETWORK,
            "        if member.node.booted_at - member.started_at < NMT_REACTION_TIME:",
            "        if False:",
            "a start command that passes a boot-up leaves a node running without its settings",
            ALL,
        ),
        (
            "kept_alive_is_reset",
            _NETWORK,
            "if assignment.boots and not assignment.keep_alive else LossResponse.NONE",
            "if assignment.boots else LossResponse.NONE",
            "a node that is kept alive is reset because a heartbeat was late",
            ALL,
        ),
        (
            "optional_stops_all",
            _NETWORK,
            "if assignment.is_mandatory and self.startup.stop_all_on_loss:",
            "if self.startup.stop_all_on_loss:",
            "a lost node that nobody needs stops the network",
            ALL,
        ),
        (
            "reset_over_and_over",
            _NETWORK,
            "in _OF_ABSENT and (heard is None or heard < since)",
            "in _OF_ABSENT",
            "a node that beats but has no SDO is reset at each heartbeat",
            ALL,
        ),
        (
            "two_at_once",
            _COMMANDS,
            "while left := (yield",
            "if left := (yield",
            "commands that wait for the same pause are sent together",
            ALL,
        ),
        # ---- what is said of it ----
        (
            "headline_counts_ready_as_running",
            _SUMMARY,
            "        return self.state in (NodeState.RUNNING, NodeState.UNWATCHED)\n",
            "        return self.state.is_good\n",
            "nodes that were not started are said to run",
            WORDS,
        ),
        (
            "headline_of_missing_only",
            _SUMMARY,
            "    running = sum(row.is_running for row in rows)\n",
            "    running = 0 if any(not row.state.is_good for row in rows) else sum(row.is_running for row in rows)\n",
            "no node is said to run, since one failed, while the others run",
            WORDS,
        ),
        (
            "one_silent_of_several",
            _SUMMARY,
            "any(row.is_silent for row in missing)",
            "missing[0].is_silent",
            "the exit status is that of the first mandatory node only",
            WORDS,
        ),
        (
            "optional_is_mandatory",
            _SUMMARY,
            "    missing = [row for row in bad if row.is_mandatory]\n",
            "    missing = bad\n",
            "an optional node that failed is called mandatory",
            WORDS,
        ),
        (
            "stopped_is_unfinished",
            _SUMMARY,
            "    if stopped:\n        return NodeState.STOPPED\n",
            "",
            "nodes that were stopped are said to be configured in part",
            NET,
        ),
        (
            "kept_alive_does_not_run",
            _SUMMARY,
            "        if state is NodeState.FAILED and assignment.keep_alive:",
            "        if False:",
            "no node is said to run, while one that is kept alive and wrong runs on",
            WORDS,
        ),
        (
            "late_node_waits_for_ever",
            _NETWORK,
            "if not self.startup.start_all or self.is_started:",
            "if not self.startup.start_all:",
            "a node that comes when the network runs is not started",
            ALL,
        ),
        (
            "lost_twice",
            _NETWORK,
            "        member.node.heartbeat.set_timeout(0, now)  # guarding",
            "        pass  # guarding",
            "a node that is reset since it was lost is lost once more",
            ALL,
        ),
        # ---- other programs ----
        (
            "boot_resets_who_gets_a_program",
            "canopen_cli/net/boot.py",
            "        if not settings.dry_run:\n            for network",
            "        if False:\n            for network",
            "a device that gets a program is reset in the middle, by our own other command",
            CLAIMS,
        ),
        (
            "flash_under_a_watch",
            "canopen_cli/node/flash.py",
            "        session.claim_state(wanted.node_id),\n",
            "",
            "a program is written into a device that `net watch` resets when it stops",
            CLAIMS,
        ),
        (
            "unread_is_another",
            "manager/boot/outcome.py",
            "        return unread or self.letter.meaning\n",
            "        return self.letter.meaning\n",
            "a node that fell silent is called one of another maker",
            ONE,
        ),
        # ---- who runs ----
        (
            "told_to_run_is_running",
            _MEMBER,
            "return self.is_running and self.node.nmt_state is not NmtState.OPERATIONAL",
            "return False",
            "a node that shows that it does not run is told to run",
            (*SEEN, *WORDS),
        ),
        (
            "lost_start_command",
            _NETWORK,
            "            if tries == START_TRIES or not (yield from self._start_again(member)):\n",
            "            if True:\n",
            "one lost frame, and a node never runs",
            SEEN,
        ),
        (
            "lost_reset_runs_on",
            _NODE,
            "        if self.unconfirmed is not None and self.node.boots == self.first_boots:\n",
            "        if False:\n",
            "a node that has not got its reset is configured while it runs, with what was left in it",
            SEEN,
        ),
        (
            "start_all_unseen",
            _NETWORK,
            "            yield from all_of(*(self._see_all_running(member) for member in self._listed))\n",
            "            yield from ()\n",
            "nodes that are started by the command to all are told to run before they show it",
            SEEN,
        ),
        (
            "later_start_unseen",
            _NETWORK,
            "            elif member.is_unseen:\n",
            "            elif False:\n",
            "a node that comes later, and misses its start, never runs",
            SEEN,
        ),
        (
            "passed_boot_up_seen_late",
            _NETWORK,
            "        if member.node.booted_at - member.started_at < NMT_REACTION_TIME:\n",
            "        if now - member.started_at < NMT_REACTION_TIME:\n",
            "a node that was started as it booted is configured while it runs, if others are awaited",
            ALL,
        ),
        (
            "loss_waits_for_slow_heartbeats",
            _NETWORK,
            " or (one_by_one and each.is_unseen)\n",
            "\n",
            "the loss that stops all nodes waits for the heartbeat of another one",
            SEEN,
        ),
        (
            "absent_pdo_has_a_can_id",
            "manager/boot/comparison.py",
            "    return COB_ID_INVALID - 1 if cob_id & COB_ID_INVALID else _WITHOUT_RTR",
            "    return _WITHOUT_RTR",
            "the CAN-ID of a PDO that does not exist makes a configuration a different one",
            COMPARISON,
        ),
    )
)
